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
/// incomplete; `is_usual_current`: its current was that of a complete throw; `is_first`: the travel of complete throws
/// is not known yet.
pub(crate) fn incomplete(
    name: &str,
    direction: Option<Direction>,
    in_a_row: u32,
    last: Option<&Rejection>,
    (is_usual_current, is_first): (bool, bool),
) -> String {
    let (throws, were) = throws_in_a_row(in_a_row);
    let what = format!("{throws} {were} not completed");
    let name = subject(name, direction);
    let check = "Check for an obstruction between the rails, and detection.";
    match last {
        // The sum with 0 has no minus sign before 0.
        Some(Rejection::Obstructed { position_mm, .. }) if is_first => format!(
            "{name}: {what}. {check} If the stroke ends at {:.1} mm, where the toe stood still while the motor \
             ran on, the machine locks there: set stroke_mm, so that its throws are evaluated.",
            (10.0 * position_mm).round() / 10.0 + 0.0
        ),
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

/// Text of `in_a_row` consecutive throws of a machine without toe position, of one direction or of the machine, whose
/// motor ran much longer or shorter than usual \[s\].
pub(crate) fn unusual_run(
    name: &str,
    direction: Option<Direction>,
    in_a_row: u32,
    [run_s, usual_s]: [f64; 2],
) -> String {
    let (throws, _) = throws_in_a_row(in_a_row);
    let check = if run_s > usual_s {
        "look for an obstruction between the rails, and check detection, limit switches and clutch: the motor may have \
         run until its time-out"
    } else {
        "check limit switches, overload protection, supply and control: the motor stopped early, or the recording was \
         cut off. If all throws seem as short, check the logger's sampling rate"
    };
    format!(
        "{}: {throws} did not end as usual: the motor ran for {run_s:.1} s, usually {usual_s:.1} s. Without a toe position it is not known \
         whether the points closed. Check this at once, then {check}. If motor, supply or logger were changed, take a \
         new baseline (rebaseline).",
        subject(name, direction)
    )
}

pub(crate) fn complete_again(name: &str, in_a_row: u32) -> String {
    let (throws, were) = throws_in_a_row(in_a_row);
    format!("Machine {name}: {throws} {were} completed.")
}

/// Subject of a sentence about consecutive throws, with its verb.
fn throws_in_a_row(count: u32) -> (String, &'static str) {
    if count == 1 { ("a throw".to_owned(), "was") } else { (format!("{count} throws in a row"), "were") }
}

/// Text for throws that take longer; `has_position`: until the arrival of the toe, not until the end of the motor.
pub(crate) fn slow(name: &str, direction: Option<Direction>, longer_pct: f64, has_position: bool) -> String {
    format!(
        "{}: throws take {longer_pct:.0} % longer than the baseline's. Check the supply voltage and connections, then \
         the drive for binding.{}",
        subject(name, direction),
        if has_position { "" } else { RUNS_ON_UNSEEN }
    )
}

/// What lengthens a throw as well on a machine without toe position.
const RUNS_ON_UNSEEN: &str = " A motor that runs on at the end of the stroke does this too: check detection, limit \
                              switches, lock and clutch.";

pub(crate) const FAST_AGAIN: &str = "throws are as fast as the baseline's again.";

/// Least fall of the load, as a logarithm, that lubrication explains.
const LEAST_FALL: f64 = 0.05;
/// Change of the duration, as a logarithm, from which the motor may run on: 30 %.
const LONG_RUN: f64 = 0.26;
/// Change of the running current, as a logarithm, from which a sensor is a likelier reason than the load: a factor 1.7.
const LARGE_CHANGE: f64 = 0.53;

/// Text for changed features of throws without coefficients, over `throws` throws of a direction; `has_position`: the
/// duration ends with the arrival of the toe; `runs_light`: the usual running current is so small that the load may
/// change it by a multiple.
pub(crate) fn features(
    name: &str,
    changes: &[GaugeChange],
    throws: usize,
    [has_position, runs_light]: [bool; 2],
) -> String {
    let change = |change: &GaugeChange| {
        let what = match change.gauge {
            Gauge::Duration => "duration",
            Gauge::Running => "running current",
            Gauge::Charge => "charge of a throw",
            _ => "travel",
        };
        format!("{what} {:+.0} % (±{:.0} %)", change.level.pct(), change.level.half_width_pct())
    };
    let of = |gauge: Gauge| changes.iter().find(|change| change.gauge == gauge).map(|change| change.level.value);
    let [duration, running, charge, travel] = [Gauge::Duration, Gauge::Running, Gauge::Charge, Gauge::Travel].map(of);
    // The charge falls with the duration too, whatever the load.
    let load = running.or(charge.map(|charge| charge - duration.unwrap_or_default()));
    let is_easier = changes.iter().all(|change| change.gauge != Gauge::Travel && change.level.value < 0.0)
        && load.is_some_and(|load| load < -LEAST_FALL);
    let check = if travel.is_some_and(|travel| travel > 0.0) {
        "The rails cannot move beyond the stock rail: check the position sensor, its gain and the adjustment of the stroke."
    } else if travel.is_some() && duration.is_none_or(|duration| duration > 0.0) {
        "The toe seems to stop earlier, but the throws do not end sooner: check whether the points close, then the \
         position sensor, its gain and the adjustment of the stroke."
    } else if duration.is_some_and(|duration| duration < 0.0) && !is_easier {
        "The throws end sooner: check at once whether the points close and lock. Then check limit switches, adjustment of \
         the stroke, overload protection and clutch, a higher supply voltage, weaker magnets, and the logger's sampling \
         rate. A motor of another make does this too: then take a new baseline."
    } else if duration.is_none() && !runs_light && running.is_some_and(|running| running.abs() > LARGE_CHANGE) {
        "A change of the current this large at the usual speed comes rather from the current sensor, its range or its \
         unit than from the load: check these, then slide chairs, lubrication and drive."
    } else if is_easier {
        "The machine moves more easily: rain and lubrication do this. Take a new baseline if it was cleaned or \
         lubricated; otherwise check the supply, and drive and rods for a loose part."
    } else {
        "Check slide chairs, lubrication, drive and supply."
    };
    let is_longer = duration.is_some_and(|duration| duration > LONG_RUN);
    let runs_on = if is_longer && !has_position { RUNS_ON_UNSEEN } else { "" };
    let changes: Vec<String> = changes.iter().map(change).collect();
    format!(
        "Machine {name}: the throws have changed, over {throws} throws of a direction: {}. These features alone name \
         no part. {check}{runs_on}",
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
         of the current, and accelerates {:.0} % (±{:.0} %) {more}, as fitted over its first millimetres. The running current ({} %) does not explain \
         this, so no running part is named. Check the brake, which may release late, play and lost motion in drive \
         and rods, and whether the position sensor is loose or its values are late. Then look for added load.",
        gain.pct().abs(),
        gain.half_width_pct(),
        signed(running.pct())
    )
}

/// A whole number with its sign; zero has "+".
fn signed(value: f64) -> String {
    format!("{:+.0}", value.round() + 0.0)
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
/// most since this began.
pub(crate) fn runs_on(name: &str, count: u32, longest_s: f64, usual_s: f64) -> String {
    format!(
        "Machine {name}: in {count} of the last 8 throws the motor ran on after the toe had arrived where it always \
         stops: for up to {longest_s:.1} s since this began, usually {usual_s:.2} s. The machine does not detect its end, or does not \
         switch off; motor and clutch become hot. Check detector contacts, limit switch and contactor, whether the lock \
         enters, and the clutch."
    )
}

/// The current at the end of the stroke has changed by `rise_a` from `expected_a` \[A\], while the logarithm of the
/// running current changed by `running`.
pub(crate) fn end_change(direction: Direction, expected_a: f64, rise_a: Level, running: f64) -> String {
    let pct = if expected_a > 0.0 { format!(" ({:+.0} %)", 100.0 * rise_a.value / expected_a) } else { String::new() };
    format!(
        "{direction} from {expected_a:.2} to {:.2} A (±{:.2} A){pct}, while the running current changed by {} %",
        expected_a + rise_a.value,
        1.96 * rise_a.sd,
        signed(percent(running))
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
            features("21B", &[change(Gauge::Duration, duration), change(Gauge::Charge, charge)], 6, [false; 2])
        };
        let easier = "if it was cleaned or lubricated";
        assert!(
            text(-0.1, -0.2).contains(easier) && !text(0.1, -0.2).contains(easier) && !text(0.1, 0.2).contains(easier)
        );
        // The load is as before.
        for duration in [-0.17, -2.3] {
            let text = text(duration, 0.9 * duration);
            assert!(text.contains("check at once whether the points close") && !text.contains(easier), "{text}");
        }
    }

    #[test]
    fn a_current_of_half_the_size_at_the_usual_speed_is_that_of_its_sensor() {
        let change = |gauge| GaugeChange { gauge, level: Level { value: -0.69, sd: 0.01 } };
        let text = features("21B", &[change(Gauge::Running), change(Gauge::Charge)], 6, [false; 2]);
        assert!(text.contains("rather from the current sensor"), "{text}");
    }
}
