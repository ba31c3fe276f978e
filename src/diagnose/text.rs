//! Alarm texts: one plain sentence of what and how sure, one of what to look at, one of when.

use super::{
    cause::{Finding, Naming, Rival},
    event::{Cause, RunnerUp},
    explain::{Explanation, percent},
    trend::LimitForecast,
};
use crate::throw::Direction;

/// "Machine 21B, normal to reverse"; both directions are not mentioned.
pub(super) fn subject(name: &str, direction: Option<Direction>) -> String {
    match direction {
        Some(direction) => format!("Machine {name}, {direction}"),
        None => format!("Machine {name}"),
    }
}

/// What a drift is, how sure, what to look at, and when it gets critical.
pub(super) fn drift(subject: &str, finding: &Finding, throws: u64, forecast: Option<&LimitForecast>) -> String {
    let over = if throws == 1 { "1 throw".to_owned() } else { format!("{throws} throws") };
    let what = match &finding.naming {
        Naming::One(one) => format!("{} over {over}{}", change(one), runner_up(finding.runner_up.as_ref())),
        Naming::Either(a, b) => {
            format!("{} or {}, too close to call: {} or {} over {over}", a.cause, b.cause, change(a), change(b))
        }
        Naming::Both(a, b) => {
            let together = format!("{} and {} together", a.cause, b.cause);
            format!("{together}{}: {} and {} over {over}", rival(finding.rival), change(a), change(b))
        }
        Naming::Neither => format!("a change that no cause explains over {over}: {}", coefficients(finding)),
    };
    let c = finding.correlation;
    let rule = if finding.is_contradicted() {
        format!(" The cross-correlation rule disagrees ({:.2}, {:.2}, {:.2}).", c.b0_a1, c.b0_a0, c.a1_a0)
    } else {
        String::new()
    };
    let when = forecast.map_or_else(String::new, |f| {
        format!(" Reaches the critical limit in about {} throws ({} to {}).", round(f.mid), round(f.low), round(f.high))
    });
    format!("{subject}: {what}.{rule} {}{when}", advice(finding))
}

/// A drift that went away.
pub(super) fn cleared(subject: &str, cause: Cause, at_once: bool) -> String {
    let repair = if at_once {
        " It came back within a few throws, as after a repair: if there was one, take a new baseline (rebaseline)."
    } else {
        ""
    };
    format!("{subject}: {cause} is back to normal.{repair}")
}

/// Most of a drift went away at once, and something is left.
pub(super) fn maybe_repaired(subject: &str, cause: Cause) -> String {
    format!(
        "{subject}: most of the {} went away within a few throws, as after a repair, but the machine is not as its \
         baseline. If it was repaired, take a new baseline (rebaseline).",
        if cause == Cause::Unattributed { "drift".to_owned() } else { format!("change of {cause}") }
    )
}

/// A drift that turned out to be something else.
pub(super) fn withdrawn(subject: &str, cause: Cause, other: Cause) -> String {
    format!("{subject}: the drift is no longer taken for {cause}, but for {other}.")
}

fn change(e: &Explanation) -> String {
    let pct = percent(e.size);
    let way = if pct < 0.0 { "down" } else { "up" };
    // One decimal for small changes only; the interval is given as finely as the change.
    let decimals = usize::from(pct.abs() < 9.95);
    let least = if decimals == 0 { 1.0 } else { 0.1 };
    let interval = interval_pct(e).max(least);
    format!("{} {way} {:.decimals$} % (±{interval:.decimals$} %)", e.cause, pct.abs())
}

/// Half width of the 95 % interval of a size \[%\].
fn interval_pct(e: &Explanation) -> f64 {
    1.96 * sd_pct(e)
}

/// Standard deviation of a size \[%\].
pub(super) fn sd_pct(e: &Explanation) -> f64 {
    100.0 * e.size_sd * e.size.exp()
}

fn rival(rival: Option<Rival>) -> String {
    match rival {
        Some(Rival::Alone(cause)) => format!(" (or {cause} alone)"),
        Some(Rival::Together(a, b)) => format!(" (or {a} and {b})"),
        None => String::new(),
    }
}

fn coefficients(finding: &Finding) -> String {
    let part = |name: &str, i: usize| format!("{name} {:+.1} %", percent(finding.mean[i]));
    format!("{}, {}, {}", part("b0", 0), part("a1", 1), part("a0", 2))
}

fn runner_up(runner_up: Option<&RunnerUp>) -> String {
    /// Misfits as log-likelihood ratios: odds of 1000 to 1, and of 20 to 1.
    const UNLIKELY: f64 = 13.8;
    const LESS_LIKELY: f64 = 6.0;
    runner_up.map_or_else(String::new, |r| {
        let how = match r.margin {
            m if m >= UNLIKELY => "unlikely",
            m if m >= LESS_LIKELY => "less likely",
            _ => "possible",
        };
        format!("; runner-up {}, {how}", r.cause)
    })
}

fn advice(finding: &Finding) -> String {
    match &finding.naming {
        Naming::One(e) => look_at(e.cause, e.size).to_owned(),
        Naming::Either(a, b) | Naming::Both(a, b) => {
            format!("{} {}", look_at(a.cause, a.size), look_at(b.cause, b.size))
        }
        Naming::Neither => "Check the sensors first, then the whole drive.".to_owned(),
    }
}

fn look_at(cause: Cause, size: f64) -> &'static str {
    match (cause, size > 0.0) {
        (Cause::Kt, false) => "Check the motor: magnets, brushes, commutator.",
        (Cause::Kt, true) => "Check the current sensor and the motor.",
        (Cause::Friction, true) => "Check slide chairs and lubrication.",
        (Cause::Friction, false) => "If it was cleaned or lubricated, take a new baseline.",
        (Cause::Stiffness, true) => "Check rods, stretcher bars and heel for binding.",
        (Cause::Stiffness, false) => "Check rods, stretcher bars and fastenings for looseness or cracks.",
        (Cause::Inertia, true) => "Check for added load: ice, ballast, a dragging second drive.",
        (Cause::Inertia, false) => "Check couplings and rods: a moving part may be disconnected.",
        _ => "Check the machine.",
    }
}

/// Two significant figures: a forecast is no better.
fn round(throws: f64) -> f64 {
    let scale = 10_f64.powf((throws.max(1.0).log10().floor() - 1.0).max(0.0));
    (throws / scale).round() * scale
}
