//! Observation and health of a throw, from its identification and its verdict.

use crate::{
    diagnose::{BaselineRecord, Observation, Present, Verdict},
    estimate::{Features, Identification},
    store::StoredThrow,
    wire::{BaselineProgress, Health},
};

/// `quality` of a throw whose stored trace cannot be read.
const UNREADABLE: &str = "unreadable_trace";
/// `quality` of a throw with a repeated trace.
const REPEATED: &str = "repeated_trace";
/// `quality` of a throw of a machine under whose name two loggers publish.
pub(super) const TWO_LOGGERS: &str = "two_loggers";
/// `quality` of a throw that made the estimator or the diagnosis panic.
const ESTIMATOR_FAILED: &str = "estimator_failed";

/// `detail` of a throw that does not count, as it is older than the machine's new baseline or its maintenance.
pub(super) const OUTDATED: &str = "made before the new baseline or the end of the maintenance: it does not count";

/// The observation of a throw for its monitor; without an identification it has only the fields of the message.
pub(super) fn observation(stored: &StoredThrow, found: Option<&Identification>) -> Observation {
    let unread = || Observation::without_trace(stored.id.clone(), stored.started_at);
    let observation = match (stored.throw.as_ref().ok(), found) {
        (Some(throw), Some(found)) => Observation::of(throw, found),
        (Some(throw), None) => {
            Observation { direction: throw.direction, temperature_c: throw.temperature_c, ..unread() }
        }
        (None, _) => unread(),
    };
    Observation { throw: stored.id.clone(), received_at: Some(stored.received_at), ..observation }
}

/// `quality` and sentence of a throw with a repeated trace.
pub(crate) fn repeated() -> (&'static str, String) {
    (REPEATED, "the machine sent the same trace before; two real throws are never identical".to_owned())
}

/// The health of a throw. `withheld` has the code and the sentence about a throw that is no evidence. `baseline` is the
/// baseline after the throw, for the changes of its ratios; `None` if the verdict has the changes of its coefficients.
/// `throws_since_baseline` counts from the completion of the baseline.
pub(crate) fn health(
    stored: &StoredThrow,
    found: Option<&Identification>,
    withheld: Option<(&'static str, String)>,
    verdict: &Verdict,
    baseline: Option<&BaselineRecord>,
    throws_since_baseline: u64,
) -> Health {
    let (quality, detail) = match (&stored.throw, found) {
        (_, Some(found)) => (found.quality(), found.detail()),
        (Err(unreadable), None) => (UNREADABLE, Some(unreadable.to_string())),
        (Ok(_), None) if let Some((code, sentence)) = withheld => (code, Some(sentence)),
        (Ok(_), None) => {
            let detail = "the estimator or the diagnosis failed on this throw: please report it, with the throw";
            (ESTIMATOR_FAILED, Some(detail.to_owned()))
        }
    };
    let Present { state, drifts, caveats } = &verdict.present;
    let health = Health {
        direction: stored.throw.as_ref().ok().and_then(|throw| throw.direction),
        change_pct: verdict.change_pct,
        state: Some(*state),
        drift: drifts.first().copied(),
        drifts: drifts.clone(),
        caveats: caveats.clone(),
        baseline: verdict
            .baseline
            .map(|(so_far, needed)| BaselineProgress { so_far: so_far as u64, needed: needed as u64 }),
        throws_since_baseline,
        ..Health::rejected(stored.machine.clone(), stored.id.clone(), stored.started_at, quality, detail)
    };
    let Some(found) = found else { return health };
    let Features { duration_s, peak_current_a, mean_current_a, .. } = found.features;
    let health = Health { direction: found.direction, duration_s, peak_current_a, mean_current_a, ..health };
    let Ok(estimate) = &found.outcome else { return health };
    let ([a1_per_b0, a0_per_b0], [a1_per_b0_sd, a0_per_b0_sd]) = (estimate.ratios(), estimate.ratios_sd());
    let ratio_changes = baseline.map(|baseline| baseline.ratio_changes_pct([a1_per_b0, a0_per_b0]));
    Health {
        coefficients: (!estimate.ratios_only).then(|| estimate.coefficients()),
        sd: (!estimate.ratios_only).then(|| estimate.sd()),
        fit_pct: estimate.fit.map(|fit| fit.pct),
        a1_per_b0: Some(a1_per_b0),
        a1_per_b0_sd: Some(a1_per_b0_sd),
        a0_per_b0: Some(a0_per_b0),
        a0_per_b0_sd: Some(a0_per_b0_sd),
        a1_per_b0_pct: ratio_changes.map(|changes| changes[0]),
        a0_per_b0_pct: ratio_changes.map(|changes| changes[1]),
        ..health
    }
}
