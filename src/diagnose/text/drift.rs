//! Texts of drifts: causes with sizes, checks, forecast, and end.

use super::sensor::look_at_sensor;
use crate::{
    diagnose::{
        Cause, RunnerUp, SensorChannel,
        drift::{
            Attribution, Awaited, CLOSE, DECISIVE, Explanation, HEALTHY_BELOW, IntermittentFault, Left, LimitForecast,
            Naming, Rival,
        },
        statistics::percent,
    },
    throw::{Direction, counted},
};

/// Addition to the text of a rise of friction soon after a baseline: rain may have lowered the baseline's friction.
pub(crate) const RAIN_IN_BASELINE: &str = " The baseline is new: if it rained while it was taken, dry rails look the same. Then take another one (rebaseline).";

/// Addition to the text of a lower inertia of a machine without toe sensor.
pub(crate) const OR_FILTER: &str = " Without a toe sensor, the inertia shows in the inrush only: a new low-pass filter in \
                                    the logger looks the same. If it was changed, take a new baseline (rebaseline).";

/// Name for the cause of a loss of torque without a change of the back-EMF.
const MOTOR_OR_GEAR: &str = "motor or gear";

/// Text of a drift: causes with sizes, checks, and the forecast of the critical limit. `alike`: a sensor that explains
/// the drift equally well, and the evidence that would decide.
pub(crate) fn drift(
    subject: &str,
    attribution: &Attribution,
    alike: Option<(SensorChannel, Awaited)>,
    throws: u64,
    forecast: Option<&LimitForecast>,
) -> String {
    let over = counted(throws, "throw");
    let is_sound = alike.is_none() && attribution.sound_magnets().is_some();
    let name =
        |e: &Explanation| if is_sound && e.cause == Cause::Kt { MOTOR_OR_GEAR.to_owned() } else { e.cause.to_string() };
    let change = |e: &Explanation| change_of(&name(e), e);
    let what = match &attribution.naming {
        Naming::One(one) => match alike {
            Some((sensor, _)) => format!("{} or {sensor}: {} over {over}, or a faulty sensor", name(one), change(one)),
            None => format!("{} over {over}{}", change(one), runner_up(attribution.runner_up.as_ref())),
        },
        Naming::Either(a, b) => {
            format!("{} or {}, too close to call: {} or {} over {over}", name(a), name(b), change(a), change(b))
        }
        Naming::Another { new, known } => {
            // The throws are counted from the beginning of the known drift.
            format!("{}, in addition to {}", change(new), change(known))
        }
        Naming::Both(a, b) => {
            let together = format!("{} and {} together", name(a), name(b));
            format!("{together}{}: {} and {} over {over}", rival(attribution.rival), change(a), change(b))
        }
        Naming::Beside { known, first, second } => format!(
            "{} and something else over {over}: {} or {} ({})",
            change(known),
            name(first),
            name(second),
            coefficients(attribution)
        ),
        Naming::Neither(a, b) => format!(
            "a change of more than two parts, or of another kind, over {over}: {}; {} and {} are nearest",
            coefficients(attribution),
            name(a),
            name(b)
        ),
        Naming::Opposite(parts) => {
            let [a, b] = std::array::from_fn(|at| format!("{}: {}", Direction::BOTH[at], change(&parts[at])));
            format!("opposite changes of the two directions over {over}, like {a}; {b}")
        }
    };
    let c = attribution.correlation;
    let rule = if attribution.is_contradicted() {
        let would =
            if attribution.main().is_some_and(|main| main.cause == Cause::Inertia) { "not name" } else { "name" };
        let [a, b, c] = [c.b0_a1, c.b0_a0, c.a1_a0];
        format!(" The study's rule, from correlations ({a:.2}, {b:.2}, {c:.2}), would {would} inertia.")
    } else {
        String::new()
    };
    let when = forecast.map_or_else(String::new, |f| {
        let [low, mid, high] = [f.low, f.mid, f.high].map(round);
        if mid < 1.0 {
            return " The critical limit is reached about now.".to_owned();
        }
        format!(" Reaches the critical limit in about {} ({low} to {high}).", counted(mid, "throw"))
    });
    let sensor = alike.map_or_else(String::new, |(sensor, waits)| {
        let more = match waits {
            Awaited::Throws => "",
            Awaited::Resistance => {
                " The motor's resistance would distinguish them, but most of these throws do not show it."
            }
            Awaited::Voltage => " With a permanent-magnet motor, a published supply_v would distinguish them.",
        };
        // The other names do not say that a sensor may be the reason.
        let is_said = matches!(attribution.naming, Naming::One(_));
        let same = if is_said { String::new() } else { format!(" A faulty {sensor} would look the same.") };
        format!("{same} {}{more}", look_at_sensor(sensor))
    });
    format!("{subject}: {what}.{rule} {}{sensor}{when}", advice(attribution))
}

/// Text of a drift whose text names one direction, once it is certain that only this direction has the drift.
pub(crate) fn one_direction(text: &str) -> String {
    format!("{text} The other direction has not changed as much.")
}

/// Text of an intermittent fault.
pub(crate) fn intermittent(name: &str, found: &IntermittentFault) -> String {
    let IntermittentFault { one_in, explanation, cause } = found;
    let change = change_of(&explanation.cause.to_string(), explanation);
    let (change, advice) = match cause {
        Cause::Unattributed => (
            format!("a change like {change}; another part explains it as well"),
            "Check the drive, its contacts and the sensors' cables.",
        ),
        _ => (change, look_at(explanation.cause, explanation.size)),
    };
    format!("Machine {name}: 1 in {one_in:.0} throws: {change}. The throws between are as before. {advice}")
}

/// Text of the end of an alarm about an intermittent fault that the throws no longer show or exclude.
pub(crate) fn intermittent_unknown(name: &str, cause: Cause) -> String {
    format!(
        "Machine {name}: whether single throws still have the fault ({cause}) is not known: the throws give only the ratios \
         of the coefficients now, and no single one is judged."
    )
}

/// Text of a drift that has ended, with the size that is `left`; `rise`: whether it was a rise.
pub(crate) fn cleared(name: &str, cause: Cause, left: Left, rise: bool) -> String {
    let change = match cause {
        Cause::Unattributed => "the reported change".to_owned(),
        _ => format!("the change of {cause}"),
    };
    let state = if left.in_sense >= 1.0 {
        format!("Machine {name}: {change} is no longer certain: the last throws scatter too much to show it.")
    } else if left.size >= 1.0 {
        format!("Machine {name}: {cause} has now changed in the opposite sense.")
    } else if left.size >= HEALTHY_BELOW {
        format!("Machine {name}: {change} is below its warning limit again.")
    } else {
        back_to_normal(name, cause)
    };
    // Rain lowers friction, also that of worn slide chairs, and dry rails raise it again.
    let advice = if cause == Cause::Friction && rise {
        "It is as after a repair, or in rain, which passes: if there was a repair, take a new baseline on dry rails"
    } else {
        "If there was a repair, take a new baseline"
    };
    format!("{state} {advice} (rebaseline).")
}

/// Text of an alarm whose reason has ended.
pub(crate) fn back_to_normal(name: &str, cause: Cause) -> String {
    match cause {
        Cause::Unattributed => format!("Machine {name}: the reported change has ended."),
        _ => format!("Machine {name}: {cause} is back to normal."),
    }
}

/// Text of a drift that counts as weather now, as other machines of the site have it too.
pub(crate) fn cleared_as_shared(name: &str, cause: Cause, pct: f64) -> String {
    format!(
        "Machine {name}: {cause} has not come back to normal ({pct:+.0} %), but most machines of the site have the \
         same change, so the weather or the supply is the probable reason. The common change is subtracted from the throws of this \
         machine."
    )
}

/// Caveat about a change that most machines of the site have too.
pub(crate) fn shared(name: &str, cause: Cause, pct: f64) -> String {
    format!(
        "Machine {name}: a change of {cause} by {pct:+.0} % is common to most machines of the site, as by the \
         weather or the supply, and raises no alarm of this machine."
    )
}

/// Text of a drift that another cause explains now.
pub(crate) fn withdrawn(name: &str, cause: Cause, other: Cause) -> String {
    let change = match (cause, other) {
        _ if other == cause => "another alarm explains the drift".to_owned(),
        (_, Cause::Unattributed) => format!("the drift is no longer that of the {cause} alone"),
        (Cause::Unattributed, _) => format!("the cause of the drift is known now: {other}"),
        _ => format!("the cause of the drift is no longer {cause}, but {other}"),
    };
    format!("Machine {name}: {change}.")
}

/// Text at the end of an alarm without a named part, when `part` explains its reason.
pub(crate) fn explained(name: &str, part: Cause) -> String {
    format!("Machine {name}: this alarm is withdrawn: {part} explains the change.")
}

/// Text about a common change of the machines of a site.
pub(crate) fn site(name: &str, cause: Cause, pct: f64) -> String {
    let way = if pct < 0.0 { "down" } else { "up" };
    format!(
        "{name}: {cause} {way} by {:.0} % or more on most of them together: the weather (rain, frost, heat), the supply, or \
         work on all. This change is subtracted from the throws of each machine; a machine that changed by much more has \
         its own alarm.",
        pct.abs()
    )
}

pub(crate) fn site_over(name: &str, cause: Cause) -> String {
    format!("{name}: {cause} is no longer changed on most of them together.")
}

pub(crate) fn site_unknown(name: &str, cause: Cause, days: f64) -> String {
    format!(
        "{name}: whether {cause} is still changed on most of them together is not known: for {days} days too few of the \
         machines made throws. This alarm ends."
    )
}

fn change_of(name: &str, e: &Explanation) -> String {
    let pct = e.level().pct();
    let way = if pct < 0.0 { "down" } else { "up" };
    // One decimal for small changes only; the interval has the same decimals as the change.
    let decimals = usize::from(pct.abs() < 9.95);
    let least = if decimals == 0 { 1.0 } else { 0.1 };
    let interval = e.level().half_width_pct().max(least);
    format!("{name} {way} {:.decimals$} % (±{interval:.decimals$} %)", pct.abs())
}

fn rival(rival: Option<Rival>) -> String {
    match rival {
        Some(Rival::Alone(cause)) => format!(" (or {cause} alone)"),
        Some(Rival::Together(a, b)) => format!(" (or {a} and {b})"),
        None => String::new(),
    }
}

fn coefficients(attribution: &Attribution) -> String {
    let part = |name: &str, i: usize| format!("{name} {:+.1} %", percent(attribution.mean[i]));
    format!("{}, {}, {}", part("b0", 0), part("a1", 1), part("a0", 2))
}

fn runner_up(runner_up: Option<&RunnerUp>) -> String {
    runner_up.map_or_else(String::new, |r| {
        let how = match r.margin {
            m if m >= DECISIVE => "unlikely",
            m if m >= CLOSE => "less likely",
            _ => "possible",
        };
        format!("; runner-up {}, {how}", r.cause)
    })
}

fn advice(attribution: &Attribution) -> String {
    let look_at = |e: &Explanation| match attribution.sound_magnets() {
        Some(level) if e.cause == Cause::Kt => format!(
            "The motor's back-EMF has not changed as much ({:+.1} %, ±{:.1} %), so its magnets are sound. Check gear, \
             clutch and screw for wear and lubrication, then brushes and commutator.",
            level.pct(),
            level.half_width_pct()
        ),
        _ => look_at(e.cause, e.size).to_owned(),
    };
    match &attribution.naming {
        Naming::One(e) | Naming::Another { new: e, .. } => match attribution.may_hide() {
            Some(Cause::Kt) => format!(
                "{} Then check gear, clutch and brushes: torque that was lost at the same time would look the same.",
                look_at(e)
            ),
            Some(_) => format!(
                "{} Then check rods, stretcher bars and heel for binding: a stiffness that rose at the same time \
                 would look the same.",
                look_at(e)
            ),
            None => look_at(e),
        },
        Naming::Either(a, b) | Naming::Both(a, b) | Naming::Beside { first: a, second: b, .. } => {
            format!("{} {}", look_at(a), look_at(b))
        }
        Naming::Neither(a, b) => format!("{} {} Then check the rest of the drive.", look_at(a), look_at(b)),
        Naming::Opposite(_) => {
            "No worn part does this: a constant force helps one direction and hinders the other, friction has changed \
             along a part of the stroke, or the position sensor is no longer linear. Check the adjustment of the rods, \
             creep of the rails, what presses on the switch rails, single dry slide chairs, and the sensor."
                .to_owned()
        }
    }
}

fn look_at(cause: Cause, size: f64) -> &'static str {
    match (cause, size > 0.0) {
        (Cause::Kt, false) => "Check the motor: magnets, brushes, commutator.",
        (Cause::Kt, true) => "Check the motor: a part may have been replaced.",
        (Cause::Friction, true) => "Check slide chairs and lubrication.",
        (Cause::Friction, false) => {
            "Rain and point heating do this and pass. Take a new baseline only if it was cleaned or lubricated."
        }
        (Cause::Stiffness, true) => "Check rods, stretcher bars and heel for binding.",
        (Cause::Stiffness, false) => "Check rods, stretcher bars and fastenings for looseness or cracks.",
        (Cause::Inertia, true) => {
            "Check the brake, which may release late, play in the drive, and whether the toe sticks where it starts \
             (rust, ice): these look the same. Then look for added \
             load: ice, ballast, a dragging second drive."
        }
        (Cause::Inertia, false) => "Check couplings and rods: a moving part may be disconnected.",
        _ => "Check the machine.",
    }
}

/// Rounds a forecast to two significant figures.
fn round(throws: f64) -> f64 {
    let scale = 10_f64.powf((throws.max(1.0).log10().floor() - 1.0).max(0.0));
    (throws / scale).round() * scale
}
