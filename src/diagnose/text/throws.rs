//! Texts about throws that are incomplete, slow or different; these alarms name no part.

use super::subject;
use crate::{
    diagnose::{
        gauges::{Gauge, GaugeChange},
        statistics::{Level, percent},
    },
    estimate::Rejection,
    throw::Direction,
};

/// Text of `in_a_row` consecutive incomplete throws, of one direction or of the machine. `last`: why the last one is
/// incomplete; `is_usual_current`: its current was that of a complete throw.
pub(crate) fn incomplete(
    name: &str,
    direction: Option<Direction>,
    in_a_row: u32,
    last: Option<&Rejection>,
    is_usual_current: bool,
) -> String {
    let what = match in_a_row {
        1 => "a throw was not completed".to_owned(),
        _ => format!("{in_a_row} throws in a row were not completed"),
    };
    let name = subject(name, direction);
    let check = "Check for an obstruction between the rails, and detection.";
    match last {
        Some(Rejection::Reopened { back_mm, position_mm }) => format!(
            "{name}: {what}: after its arrival the toe came back by {back_mm:.1} mm, and stands open at {position_mm:.1} \
             mm. Check at once whether the points are closed and locked. Then check lock, brake and drive, which must \
             hold the toe, and for an obstruction between the rails."
        ),
        Some(Rejection::MovedBackwards { back_mm, returned: true }) => format!(
            "{name}: {what}: the toe moved {back_mm:.1} mm and returned to its start. A throw that is reversed midway \
             does this. If it was not reversed, an obstruction between the rails pushed the toe back."
        ),
        Some(Rejection::MovedBackwards { back_mm, returned: false }) => {
            format!("{name}: {what}: the toe moved back by {back_mm:.1} mm during the throw. {check}")
        }
        _ if is_usual_current => format!(
            "{name}: {what}. {check} The current was that of a complete throw, so check the position sensor too: it \
             may be stuck."
        ),
        _ => format!("{name}: {what}. {check}"),
    }
}

pub(crate) fn complete_again(name: &str, in_a_row: u32) -> String {
    let what = if in_a_row == 1 { "a throw was".to_owned() } else { format!("{in_a_row} throws in a row were") };
    format!("Machine {name}: {what} completed.")
}

pub(crate) fn slow(name: &str, direction: Option<Direction>, longer_pct: f64) -> String {
    format!(
        "{}: throws take {longer_pct:.0} % longer than the baseline's. Check the supply voltage and connections, then \
         the drive for binding.",
        subject(name, direction)
    )
}

pub(crate) const FAST_AGAIN: &str = "throws are as fast as the baseline's again.";

/// Text for changed features of throws without coefficients, over `throws` throws of a direction.
pub(crate) fn features(name: &str, changes: &[GaugeChange], throws: usize) -> String {
    let change = |change: &GaugeChange| {
        let what = match change.gauge {
            Gauge::Duration => "duration",
            Gauge::Running => "running current",
            Gauge::Charge => "charge of a throw",
            _ => "travel",
        };
        format!("{what} {:+.0} % (±{:.0} %)", change.level.pct(), change.level.half_width_pct())
    };
    let is_longer = changes.iter().any(|change| change.gauge == Gauge::Travel && change.level.value > 0.0);
    let is_easier = changes.iter().all(|change| change.gauge != Gauge::Travel && change.level.value < 0.0);
    let check = if is_longer {
        "The rails cannot move beyond the stock rail: check the position sensor, its gain and the adjustment of the stroke."
    } else if is_easier {
        "The machine moves more easily: rain and lubrication do this. Take a new baseline if it was cleaned or \
         lubricated; otherwise check the supply, and drive and rods for a loose part."
    } else {
        "Check slide chairs, lubrication, drive and supply."
    };
    let changes: Vec<String> = changes.iter().map(change).collect();
    format!(
        "Machine {name}: the throws have changed, over {throws} throws of a direction: {}. These features alone name \
         no part. {check}",
        changes.join(", ")
    )
}

/// Text for a changed start of the movement, over the last `throws`: delay of the toe \[ms\], acceleration, current.
pub(crate) fn start(name: &str, [delay, gain, running]: [Level; 3], throws: usize) -> String {
    let moves = if delay.value.abs() < 0.05 {
        format!("the toe moves as soon as usual (±{:.1} ms)", 1.96 * delay.sd)
    } else {
        let later = if delay.value < 0.0 { "earlier" } else { "later" };
        format!("the toe moves {:.1} ms (±{:.1} ms) {later}", delay.value.abs(), 1.96 * delay.sd)
    };
    let more = if gain.value < 0.0 { "less" } else { "more" };
    format!(
        "Machine {name}: the start of the movement has changed, over {throws} throws: {moves} after the start \
         of the current, and accelerates {:.0} % (±{:.0} %) {more}. The running current ({:+.0} %) does not explain \
         this, so no running part is named. Check the brake, which may release late, play and lost motion in drive \
         and rods, and whether the position sensor is loose or its values are late. Then look for added load.",
        gain.pct().abs(),
        gain.half_width_pct(),
        running.pct()
    )
}

/// Text for a current at the end of the stroke that has changed, over `throws` throws of a direction; `changes`: a part
/// by [`end_change`] for each direction with a change; whether it has `risen`, and `fallen`, in one of them.
pub(crate) fn end(name: &str, changes: &str, [risen, fallen]: [bool; 2], throws: usize) -> String {
    let grown = "a force that closes or locks the points has grown. If it grows further, the points will not lock. Check \
                 the adjustment of lock, stretcher bar and detector, the lock for dirt and lubrication, and the gap \
                 between switch rail and stock rail";
    let lost = "a force that closes or locks the points is lost. Check whether the points lock, then the lock and its \
                springs for damage, and the adjustment of the rods";
    let (way, reason) = match (risen, fallen) {
        (true, true) => {
            ("risen in one direction and fallen in the other", &*format!("{grown}. In the other direction {lost}"))
        }
        (true, false) => ("risen", grown),
        _ => ("fallen", lost),
    };
    format!(
        "Machine {name}: the current over the last millimetres of the stroke has {way}, over {throws} throws of a \
         direction: {changes}. The running current does not explain this: {reason}."
    )
}

/// Text for a changed travel of the toe, over `throws` throws of a direction; `changes`: a part by [`travel_change`]
/// for each direction with a change; whether it is `shorter`, and `longer`, in one of them.
pub(crate) fn travel(name: &str, changes: &str, [shorter, longer]: [bool; 2], throws: usize) -> String {
    let what = match (shorter, longer) {
        (true, true) => "shorter in one direction and longer in the other",
        (true, false) => "shorter",
        _ => "longer",
    };
    let check = if shorter {
        "Check at once whether the points close and lock. Look for an obstruction between the rails, then for a"
    } else {
        "Check whether the points lock, and look for a worn or missing stop, then for a"
    };
    format!(
        "Machine {name}: the travel of the toe is {what}, over {throws} throws of a direction: {changes}. The duration \
         has changed too, so this is no fault of the position sensor: the toe stops at another place. {check} changed \
         adjustment of drive, rods and lock. If the stroke was adjusted, take a new baseline (rebaseline)."
    )
}

/// The normal travel and the present one \[mm\].
pub(crate) fn travel_change(direction: Direction, [from_mm, to_mm]: [f64; 2]) -> String {
    format!("{direction} from {from_mm:.1} to {to_mm:.1} mm")
}

/// Text for a motor that ran on after the arrival of the toe in `count` of the last eight throws, for `longest_s` at
/// most.
pub(crate) fn runs_on(name: &str, count: u32, longest_s: f64, usual_s: f64) -> String {
    format!(
        "Machine {name}: in {count} of the last 8 throws the motor ran on after the toe had arrived where it always \
         stops: for up to {longest_s:.1} s, usually {usual_s:.2} s. The machine does not detect its end, or does not \
         switch off; motor and clutch become hot. Check detector contacts, limit switch and contactor, whether the lock \
         enters, and the clutch."
    )
}

/// The current at the end of the stroke has changed by `rise_a` from `expected_a` \[A\], while the logarithm of the
/// running current changed by `running`.
pub(crate) fn end_change(direction: Direction, expected_a: f64, rise_a: Level, running: f64) -> String {
    let pct = if expected_a > 0.0 { format!(" ({:+.0} %)", 100.0 * rise_a.value / expected_a) } else { String::new() };
    format!(
        "{direction} from {expected_a:.2} to {:.2} A (±{:.2} A){pct}, with a running current of {:+.0} %",
        expected_a + rise_a.value,
        1.96 * rise_a.sd,
        percent(running)
    )
}

pub(crate) const REPEATED_TRACE: &str = "\
    the logger repeats itself: it sends the same recordings again, so the machine itself is not monitored. Check the \
    recorder.";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_delay_that_rounds_to_zero_is_not_earlier_or_later() {
        let of = |delay_ms: f64| {
            let level = |value: f64, sd: f64| Level { value, sd };
            start("21B", [level(delay_ms, 0.2), level(-0.3, 0.02), level(0.0, 0.01)], 12)
        };
        assert!(of(-0.04).contains("the toe moves as soon as usual (±0.4 ms) after the start"), "{}", of(-0.04));
        assert!(of(-2.0).contains("the toe moves 2.0 ms (±0.4 ms) earlier after the start"), "{}", of(-2.0));
    }

    #[test]
    fn a_fall_of_the_load_has_advice_of_its_own() {
        let text = |duration: f64, charge: f64| {
            let change = |gauge, value| GaugeChange { gauge, level: Level { value, sd: 0.01 } };
            features("21B", &[change(Gauge::Duration, duration), change(Gauge::Charge, charge)], 6)
        };
        let easier = "if it was cleaned or lubricated";
        assert!(
            text(-0.1, -0.2).contains(easier) && !text(0.1, -0.2).contains(easier) && !text(0.1, 0.2).contains(easier)
        );
    }
}
