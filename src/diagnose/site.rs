//! Common changes of the machines of a site: weather, not a fault of a machine.
//!
//! Every monitor stores its last departures. Before the judgement of a throw the change that three quarters of the other
//! machines have at least, beyond chance, is subtracted, if at least three machines had throws in the last hours. This
//! change has no steps, however the others differ: steps would look like an intermittent fault. The subtraction can only
//! reduce a departure: a machine without the common change is judged without it, and no departure increases or changes
//! its sign.

use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    event::{AlarmEvent, Cause},
    explain::{percent, relevance},
    last::Last,
    robust::median,
    step::Step,
    text,
};

/// Number of stored departures of a machine; enough for throws of other machines that are judged later.
const KEPT: usize = 4;
/// Largest age of the latest departure of another machine: weather changes within half a day.
const HOURS: i64 = 12;
/// Least number of other machines for a common change.
const WITNESSES: usize = 3;
/// Most other machines that are compared, the first of the site in the order of names: the cost of a throw must not grow
/// with the size of a site.
const MOST_WITNESSES: usize = 32;
/// Share of them that have at least the common change.
const AGREE: f64 = 0.75;
/// Standard deviations of the mean of the others that are chance.
const BEYOND_CHANCE: f64 = 2.0;

/// Part of the warning limit below which a common change has ended.
const OVER_BELOW: f64 = 0.5;

/// Common change of machines of a site.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Common {
    /// Logarithms of b0, a1, a0; 0 if the machines do not agree.
    change: Vector3<f64>,
    /// Whether enough machines had throws in the last hours.
    is_known: bool,
}

impl Common {
    /// Whether there is a common change.
    pub fn is_change(&self) -> bool {
        self.change != Vector3::zeros()
    }
}

/// The last departures of a machine from its baseline.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Trail {
    /// Times and logarithms, the oldest first.
    last: Last<(Timestamp, [f32; 3]), KEPT>,
    /// Standard deviations of a throw.
    sd: [f32; 3],
}

impl Trail {
    /// Adds the departure of a throw of a machine with this covariance.
    pub(super) fn push(&mut self, at: Timestamp, departure: &Vector3<f64>, of_one_throw: &Matrix3<f64>) {
        // Rounded to 1e-4, below any relevant scatter, to keep the snapshot small.
        #[expect(clippy::cast_possible_truncation, reason = "rounded anyway")]
        let rounded = |values: &Vector3<f64>| [0, 1, 2].map(|i| ((1e4 * values[i]).round() / 1e4) as f32);
        self.sd = rounded(&of_one_throw.diagonal().map(|variance| variance.sqrt().max(1e-3)));
        self.last.push((at, rounded(departure)));
    }

    pub(super) fn is_empty(&self) -> bool {
        self.last.is_empty()
    }

    /// The latest departure, and the standard deviations, in the hours before `at`.
    fn latest(&self, at: Timestamp) -> Option<([f32; 3], [f32; 3])> {
        let hours = SignedDuration::ZERO..=SignedDuration::from_hours(HOURS);
        let latest = self.last.iter().rev().find(|(then, _)| hours.contains(&at.duration_since(*then)))?;
        Some((latest.1, self.sd))
    }
}

/// Common change of the machines with these trails at `at`.
pub(super) fn common<'a>(trails: impl Iterator<Item = &'a Trail>, at: Timestamp) -> Common {
    let latest: Vec<_> = trails.filter_map(|trail| trail.latest(at)).take(MOST_WITNESSES).collect();
    let count = latest.len() as f64;
    if latest.len() < WITNESSES {
        return Common::default();
    }
    let change = Vector3::from_fn(|i, _| {
        let mut logs: Vec<f64> = latest.iter().map(|(log, _)| log[i].into()).collect();
        logs.sort_unstable_by(f64::total_cmp);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of at most 32 machines")]
        let disagree = ((1.0 - AGREE) * count) as usize;
        let (at_least, at_most) = (logs[disagree], logs[latest.len() - 1 - disagree]);
        let sd = median(&mut latest.iter().map(|(_, sd)| sd[i].into()).collect::<Vec<_>>());
        let chance = BEYOND_CHANCE * sd / count.sqrt();
        (at_least - chance).max(0.0) + (at_most + chance).min(0.0)
    });
    Common { change, is_known: true }
}

/// The part of a departure that belongs to the common change.
pub(super) fn excused(departure: &Vector3<f64>, common: &Common) -> Vector3<f64> {
    departure.zip_map(
        &common.change,
        |own, common| {
            if own * common > 0.0 { own.signum() * own.abs().min(common.abs()) } else { 0.0 }
        },
    )
}

/// Raises and clears the alarm about all machines of a site with the change `common`. While it is unknown, as in a night
/// without throws, the alarm stays.
pub(super) fn judge(common: &Common, step: &mut Step) {
    for (cause, log) in Cause::OF_COEFFICIENTS.into_iter().zip(&common.change) {
        let size = relevance(cause, *log, step.settings);
        if size > 1.0 {
            let event = step.warning(cause, text::site(step.name, cause, percent(*log)));
            step.raise(AlarmEvent { change_pct: Some(percent(*log)), ..event });
        } else if common.is_known && size < OVER_BELOW {
            step.clear(cause, text::site_over(step.name, cause));
        }
    }
}
