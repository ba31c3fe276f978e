//! The texts of alarms: what happened, how certain it is, what to check, and the forecast.

use jiff::Timestamp;

use super::{
    cause::{Attribution, Naming, Rival},
    course::LimitForecast,
    event::{Cause, RunnerUp, SensorChannel},
    explain::{Explanation, percent},
    gauges::{Change, Gauge, Level},
    intermittent::Departures,
    start,
    testimony::{Awaited, Fault},
    thermometer::Disbelief,
    verdict::{Blindness, HidingTemperature},
};
use crate::throw::{Direction, brief};

/// "Machine 21B, normal to reverse"; without a direction for both.
pub(super) fn subject(name: &str, direction: Option<Direction>) -> String {
    match direction {
        Some(direction) => format!("Machine {name}, {direction}"),
        None => format!("Machine {name}"),
    }
}

/// Name of a part that loses torque, if the back-EMF of the motor has not changed.
const MOTOR_OR_GEAR: &str = "motor or gear";

/// Text of a drift: causes with sizes, what to check, and the forecast of the critical limit. `alike` is a sensor that
/// explains the drift equally well, and what would decide.
pub(super) fn drift(
    subject: &str,
    attribution: &Attribution,
    alike: Option<(SensorChannel, Awaited)>,
    throws: u64,
    forecast: Option<&LimitForecast>,
) -> String {
    let over = if throws == 1 { "1 throw".to_owned() } else { format!("{throws} throws") };
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
            format!("{} over {over}, in addition to {}", change(new), change(known))
        }
        Naming::Both(a, b) => {
            let together = format!("{} and {} together", name(a), name(b));
            format!("{together}{}: {} and {} over {over}", rival(attribution.rival), change(a), change(b))
        }
        Naming::Neither => format!("a change that no cause explains over {over}: {}", coefficients(attribution)),
    };
    let c = attribution.correlation;
    let rule = if attribution.is_contradicted() {
        format!(" The cross-correlation rule disagrees ({:.2}, {:.2}, {:.2}).", c.b0_a1, c.b0_a0, c.a1_a0)
    } else {
        String::new()
    };
    let when = forecast.map_or_else(String::new, |f| {
        let [low, mid, high] = [f.low, f.mid, f.high].map(round);
        if mid < 1.0 {
            return " The critical limit is reached about now.".to_owned();
        }
        format!(" Reaches the critical limit in about {mid} throws ({low} to {high}).")
    });
    let sensor = alike.map_or_else(String::new, |(sensor, waits)| {
        let more = match waits {
            Awaited::Throws => "",
            Awaited::Resistance => {
                " The motor's resistance would distinguish them, but most of these throws do not show it."
            }
            Awaited::Voltage => " With a permanent-magnet motor, a published supply_v would distinguish them.",
        };
        format!(" {}{more}", look_at_sensor(sensor))
    });
    format!("{subject}: {what}.{rule} {}{sensor}{when}", advice(attribution))
}

/// Text about a drift that only a sensor or the clock explains.
pub(super) fn sensor(name: &str, fault: &Fault) -> String {
    let pct = percent(fault.size);
    let (what, why) = match fault.channel {
        SensorChannel::Current => ("reads", "the motor's resistance seems changed as much, its back-EMF not"),
        SensorChannel::Position => ("reads", "the travel differs from the stroke"),
        SensorChannel::Clock => ("runs", "the duration of all movements seems changed"),
        SensorChannel::Temperature => ("reads", "it differs from the weather"),
        SensorChannel::Supply => ("reads", "the motor's resistance and back-EMF seem changed as much, its current not"),
    };
    let way = match (fault.channel, pct > 0.0) {
        (SensorChannel::Clock, true) => "fast",
        (SensorChannel::Clock, false) => "slow",
        (_, true) => "too much",
        (_, false) => "too little",
    };
    format!(
        "Machine {name}: the {} {what} {:.1} % {way} (±{:.1} %): {why}. The machine itself shows no fault. {}",
        fault.channel,
        pct.abs(),
        196.0 * fault.size_sd * fault.size.exp(),
        look_at_sensor(fault.channel)
    )
}

/// Text about a changed supply voltage.
pub(super) fn supply(name: &str, change_pct: f64) -> String {
    let way = if change_pct < 0.0 { "lower" } else { "higher" };
    format!(
        "Machine {name}: the supply voltage is {:.0} % {way} than the baseline's, and the throws' duration agrees. Check \
         battery, charger, feeder and connections.",
        change_pct.abs()
    )
}

/// Text about a changed resistance between supply and motor.
pub(super) fn circuit(name: &str, level: &Level) -> String {
    let (way, what) = if level.value > 0.0 {
        ("up", "A bad contact, worn brushes or a damaged cable do this. Check terminals, brushes, contactor and cable.")
    } else {
        (
            "down",
            "Turns of the winding that touch, or a contact that was repaired, do this. Check the winding, then take a new \
             baseline (rebaseline).",
        )
    };
    format!(
        "Machine {name}: the resistance of the motor and its supply line is {way} {:.0} % (±{:.0} %), more than heat explains, and \
         the motor's back-EMF has not changed. {what}",
        percent(level.value).abs(),
        196.0 * level.sd * level.value.exp()
    )
}

/// Text about a common change of all machines of a site.
pub(super) fn site(name: &str, cause: Cause, pct: f64) -> String {
    let way = if pct < 0.0 { "down" } else { "up" };
    format!(
        "{name}: {cause} {way} {:.0} % on all of them together: the weather (rain, frost, heat), or work on \
         all. No machine has an alarm for it.",
        pct.abs()
    )
}

pub(super) fn site_over(name: &str, cause: Cause) -> String {
    format!("{name}: {cause} no longer changes on all of them together.")
}

fn look_at_sensor(channel: SensorChannel) -> &'static str {
    match channel {
        SensorChannel::Current => "Check the current sensor's gain and wiring.",
        SensorChannel::Position => "Check the position sensor's gain and mounting.",
        SensorChannel::Clock => "Check the logger's sampling rate against sample_rate_hz.",
        SensorChannel::Temperature => "Check the temperature sensor and its cable.",
        SensorChannel::Supply => "Check the sensor of the supply voltage and its cable.",
    }
}

/// Text of an intermittent fault.
pub(super) fn intermittent(name: &str, found: &Departures) -> String {
    let Departures { one_in, explanation, cause } = found;
    let advice = match cause {
        Cause::Unattributed => "Check the drive, its contacts and the sensors' cables.",
        _ => look_at(explanation.cause, explanation.size),
    };
    format!("Machine {name}: 1 in {one_in:.0} throws: {}. The other throws are normal. {advice}", change(explanation))
}

/// Text of an incomplete throw, the `in_a_row`th in a row.
pub(super) fn incomplete(name: &str, in_a_row: u32) -> String {
    let what = match in_a_row {
        1 => "a throw was not completed".to_owned(),
        _ => format!("{in_a_row} throws in a row were not completed"),
    };
    format!("Machine {name}: {what}. Check for an obstruction between the rails, and detection.")
}

pub(super) fn complete_again(name: &str, in_a_row: u32) -> String {
    format!("Machine {name}: {in_a_row} throws in a row were completed.")
}

pub(super) fn slow(name: &str, direction: Direction, longer_pct: f64) -> String {
    format!(
        "{}: throws take {longer_pct:.0} % longer than the baseline's. Check the supply voltage and connections, then the \
         drive for binding.",
        subject(name, Some(direction))
    )
}

pub(super) fn fast_again(name: &str) -> String {
    format!("Machine {name}: throws are as fast as the baseline's again.")
}

/// Text for throws without an estimate, of one direction or of both, with the code of the last reason.
pub(super) fn unevaluated(name: &str, direction: Option<Direction>, in_a_row: u32, reason: Option<&str>) -> String {
    let (throws, what) = match direction {
        None => (String::new(), "the machine is"),
        Some(direction) => (format!(" {direction}"), "this direction is"),
    };
    // A misfit of all throws is nearly always the load of the machine, and seldom a setting.
    let check = match reason {
        Some("misfit") => {
            "for a load that varies along the stroke (slide chairs, rods, locking), then for play, then whether current and \
             position are of the same moment, and neutral_mm"
        }
        _ => "the machine and its sensors",
    };
    format!(
        "Machine {name}: the last {in_a_row} throws{throws} could not be evaluated, so {what} not monitored. See the \
         reasons in throws_not_evaluated, and check {check}."
    )
}

/// Text for an alarm whose rule starts anew, after maintenance or with a new baseline.
pub(super) fn checked_anew(name: &str) -> String {
    format!("Machine {name}: this alarm ends, and is raised again by the next throws if its reason is still there.")
}

/// Text for messages of a machine that are no valid throws.
pub(super) fn invalid(name: &str, count: u32, reason: &str) -> String {
    format!(
        "Machine {name}: the last {count} messages of its logger are not valid throws, so the machine is not monitored: \
         {reason}. Correct the logger; the messages are in quarantined_messages."
    )
}

/// Text for a logger whose clock is wrong: the time of a throw by it, and by the clock of this computer.
pub(super) fn wrong_clock(name: &str, started_at: Timestamp, received_at: Timestamp) -> String {
    let shown = |at: Timestamp| at.strftime("%Y-%m-%d %H:%M:%S UTC").to_string();
    format!(
        "Machine {name}: the clock of the logger is wrong: it dates a throw {}, received {}. Set the clock; until then the \
         times of alarms are those of reception.",
        shown(started_at),
        shown(received_at)
    )
}

pub(super) fn right_clock(name: &str) -> String {
    format!("Machine {name}: the clock of the logger is right again.")
}

/// Text for a logger that sends fields with impossible values.
pub(super) fn unused_fields(name: &str, sentence: &str) -> String {
    format!("Machine {name}: a field in the messages of the logger is not used: {sentence}. Correct the logger.")
}

/// Text for a machine with many rejected throws among evaluated ones.
pub(super) fn often_rejected(name: &str, direction: Direction, rejected: u32, of: u32, code: &str) -> String {
    format!(
        "Machine {name}, {direction}: {rejected} of the last {of} throws were rejected, the last one as {code}, so a fault is \
         detected later. throws_not_evaluated has the reasons."
    )
}

/// Text for a logger whose directions are not those of the movement.
pub(super) fn contradicted(name: &str) -> String {
    format!(
        "Machine {name}: the logger names another direction than the position shows, which must rise from normal to \
         reverse. pointsd uses the position: correct its sign, or the directions of the logger."
    )
}

/// Text for throws without an estimate whose features have changed.
pub(super) fn features(name: &str, changes: &[Change], throws: usize) -> String {
    let change = |change: &Change| {
        let what = match change.gauge {
            Gauge::Duration => "duration",
            Gauge::Running => "running current",
            Gauge::Charge => "charge of a throw",
            _ => "travel",
        };
        format!("{what} {:+.0} % (±{:.0} %)", percent(change.size), 196.0 * change.size_sd * change.size.exp())
    };
    let changes: Vec<String> = changes.iter().map(change).collect();
    format!(
        "Machine {name}: the throws have changed, over {throws} throws of a direction: {}. Their coefficients are not known, \
         so no part can be named. Check slide chairs, lubrication, drive and supply.",
        changes.join(", ")
    )
}

/// Text for throws whose start has changed, over the last `throws`.
pub(super) fn start(name: &str, change: &start::Change, throws: usize) -> String {
    let start::Change { delay, gain, running } = change;
    let moves = if delay.value.abs() < 0.05 {
        format!("the toe moves as soon as usual (±{:.1} ms)", 1.96 * delay.sd)
    } else {
        let later = if delay.value < 0.0 { "earlier" } else { "later" };
        format!("the toe moves {:.1} ms (±{:.1} ms) {later}", delay.value.abs(), 1.96 * delay.sd)
    };
    let more = if gain.value < 0.0 { "less" } else { "more" };
    format!(
        "Machine {name}: the start of the movement has changed, over {throws} throws: {moves} after the start \
         of the current, and accelerates {:.0} % (±{:.0} %) {more}. The running current ({:+.0} %) does not explain this, so \
         no running part is named. Check the brake, which may release late, play and lost motion in drive and rods, and whether \
         the position sensor is loose or its values are late. Then look for added load.",
        percent(gain.value).abs(),
        196.0 * gain.sd * gain.value.exp(),
        percent(running.value)
    )
}

/// Text for a machine whose throws end before the configured stroke.
pub(super) fn short_of_stroke(name: &str, travel_mm: f64, stroke_mm: f64) -> String {
    format!(
        "Machine {name}: its throws end at {travel_mm:.1} mm of a stroke of {stroke_mm:.1} mm, without an obstruction. Correct \
         stroke_mm if this is the whole stroke; else check the gain of the position sensor."
    )
}

/// Text for a machine without a toe position whose throws no longer give the coefficients of its baseline.
pub(super) fn lost_coefficients(name: &str, throws: u32) -> String {
    format!(
        "Machine {name}: its last {throws} throws give no coefficients, as those of its baseline did, so only duration, running \
         current and charge are monitored. The reasons are in throws_not_evaluated; a fault may be one: inspect the machine."
    )
}

/// Text for a machine without a baseline of its coefficients.
pub(super) fn only_features(name: &str) -> String {
    format!(
        "Machine {name}: its throws do not give the complete coefficients of a baseline, so only duration, running current, \
         charge and travel are monitored. A change of these is reported without its cause."
    )
}

/// Text for a machine without a change of its inertia; `of_baseline`: its baseline has only ratios, whatever its last throws
/// have.
pub(super) fn ratios_only(name: &str, of_baseline: bool) -> String {
    let reasons =
        "a load that varies along the stroke, play, a brake that releases late, a position behind the current";
    let (what, advice) = if of_baseline {
        let what = "its baseline has only the ratios of the coefficients, as throws in it were rough";
        (
            what,
            format!(
                "If its last throws are good, take a new baseline (rebaseline); else look for the reason: {reasons}."
            ),
        )
    } else {
        let what = "its last throws are all rough: they give the ratios of the coefficients, but not the coefficients";
        (what, format!("Each throw names its reason: {reasons}."))
    };
    format!(
        "Machine {name}: {what}, so a change of inertia is not monitored. Motor, friction and stiffness are. {advice}"
    )
}

pub(super) fn evaluated_again(name: &str) -> String {
    format!("Machine {name}: its throws can be evaluated again.")
}

/// Text for a machine whose faults are hidden, at this temperature or by the scatter of its throws.
pub(super) fn blind(name: &str, blind: &Blindness) -> String {
    let Blindness { cause, below_pct, temperature } = blind;
    let Some(HidingTemperature { temperature_c, baseline_c }) = temperature else {
        return format!(
            "Machine {name}: its throws scatter so much, or vary so slowly, that a change of {cause} below {below_pct:.0} % cannot be \
             distinguished from that; so the machine is not monitored for changes up to this. Look for the reason (weather, supply, \
             sensors), then take a new baseline (rebaseline)."
        );
    };
    format!(
        "Machine {name}: at {temperature_c:.0} °C a change of {cause} below {below_pct:.0} % cannot be distinguished from \
         the effect of the temperature, as the baseline is from {baseline_c:.0} °C; so the machine is not monitored. It learns this \
         from its next throws. Until then inspect it, or take a new baseline (rebaseline) when it is known to be healthy."
    )
}

/// Text for a slow change of the friction of a machine without a temperature.
pub(super) fn season(name: &str, pct: f64) -> String {
    let way = if pct < 0.0 { "fell" } else { "rose" };
    format!(
        "Machine {name}: its friction {way} by {:.0} % over more than a week. Without a temperature, the season looks the \
         same as wear or lubrication, so only a change at the critical limit raises an alarm. Publish temperature_c.",
        pct.abs()
    )
}

/// Text for a machine whose throws changed steadily while its baseline was taken; slopes of the logarithms per throw.
pub(super) fn trend(name: &str, slopes: [f64; 3]) -> String {
    let of = |(slope, what): (f64, &str)| (slope != 0.0).then(|| format!("{what} {:+.2} %", percent(slope)));
    let names = ["b0 (motor or inertia)", "a1 (friction)", "a0 (stiffness)"];
    let changes: Vec<String> = slopes.into_iter().zip(names).filter_map(of).collect();
    format!(
        "Machine {name}: the baseline has a trend ({} a throw), from wear or weather while it was taken. It stays \
         provisional, and changes count from its first throw. Inspect the machine, then take a new baseline (rebaseline).",
        changes.join(", ")
    )
}

pub(super) fn sensor_implausible(name: &str, disbelief: Disbelief) -> String {
    let what = match disbelief {
        Disbelief::Impossible(celsius) => {
            let celsius = brief(celsius);
            format!("temperature sensor reads {celsius} °C, which is impossible. The last good temperature is used")
        }
        Disbelief::Jump(from, to) => format!(
            "temperature sensor jumped from {from:.0} to {to:.0} °C, faster than any weather. The last good temperature is used"
        ),
        Disbelief::Missing(since) => format!(
            "temperature is missing since {}. The last one is used, so weather can look like a fault",
            since.strftime("%Y-%m-%d %H:%M:%S UTC")
        ),
        Disbelief::Supply(volts) => {
            let volts = brief(volts);
            format!(
                "sensor of the supply voltage reads {volts} V, which is impossible. Checks with the voltage are omitted"
            )
        }
    };
    format!("Machine {name}: the {what}. Check the sensor and its cable.")
}

pub(super) fn sensor_unusable(name: &str, channel: SensorChannel) -> String {
    let unit = if channel == SensorChannel::Current { "A" } else { "mm" };
    format!(
        "Machine {name}: the {channel} reads impossible, stuck or very noisy values, so the throws cannot be evaluated. Check \
         the sensor, its cable and its supply, and that the logger sends {unit}; throws_not_evaluated has the reason of each \
         throw."
    )
}

pub(super) fn sensor_usable(name: &str, channel: SensorChannel) -> String {
    format!("Machine {name}: the values of the {channel} are usable again.")
}

pub(super) fn sensor_plausible(name: &str) -> String {
    format!("Machine {name}: the sensors of temperature and supply voltage are plausible again.")
}

pub(super) fn silent(name: &str, hours: f64) -> String {
    format!(
        "Machine {name}: no throw arrived for {hours:.0} hours, so the machine is not monitored. Check the logger and the \
         network; if the machine was not used, acknowledge."
    )
}

pub(super) fn logger_gone(name: &str, minutes: f64) -> String {
    format!(
        "Machine {name}: its logger has been gone for {minutes:.0} minutes, so the machine is not monitored. Check the \
         logger's supply and the network."
    )
}

pub(super) fn logger_back(name: &str) -> String {
    format!("Machine {name}: its logger is connected again.")
}

pub(super) fn orphaned(name: &str) -> String {
    format!(
        "{name}: what the daemon knew about this alarm is lost, and it learns a new baseline. The fault may still exist: \
         inspect the machine, then acknowledge this alarm."
    )
}

/// Text for a machine whose stored monitor cannot be read.
pub(super) fn unread(name: &str) -> String {
    format!(
        "Machine {name}: this version of pointsd cannot read its stored baselines and alarms, so it learns a new baseline. They \
         are kept: install the version that wrote them, or inspect the machine and take a new baseline (rebaseline)."
    )
}

pub(super) fn daemon_calm() -> String {
    "pointsd stores all data again.".to_owned()
}

pub(super) fn peers_away(away: &[(String, Timestamp)]) -> String {
    let daemons: Vec<String> =
        away.iter().map(|(name, since)| format!("{name} since {}", since.strftime("%Y-%m-%d %H:%M:%S UTC"))).collect();
    let (daemons_are, their, those) = if away.len() == 1 {
        ("The daemon", "Its", "that computer and its link")
    } else {
        ("These daemons", "Their", "those computers and their links")
    };
    format!(
        "{daemons_are} cannot be reached: {}. {their} machines are not monitored. Check {those}.",
        daemons.join(", ")
    )
}

pub(super) fn peers_back() -> String {
    "All watched daemons can be reached again.".to_owned()
}

pub(super) fn gap(name: &str, lost: u64) -> String {
    let throws = if lost == 1 { "1 throw".to_owned() } else { format!("{lost} throws") };
    format!(
        "Machine {name}: {throws} never arrived. Check the link to the logger; what happened in between is not known."
    )
}

pub(super) fn repeated_trace(name: &str) -> String {
    format!(
        "Machine {name}: the logger repeats itself: it sends the same recordings again, so the machine itself is not \
         monitored. Check the recorder."
    )
}

pub(super) fn repeated_number(name: &str) -> String {
    format!(
        "Machine {name}: its logger restarted without a new boot_id, or its counter is stuck: different throws have the same \
         number. They are stored and judged. Give the logger a new boot_id at each start."
    )
}

pub(super) fn no_gap(name: &str, throws: u32) -> String {
    format!("Machine {name}: no throw was lost in the last {throws}.")
}

/// Text of a new baseline.
pub(super) fn rebaselined(name: &str, by: &str, why: &str) -> String {
    format!("Machine {name}: a new baseline is being taken ({by}: {why}).")
}

/// Text of a drift that has ended.
pub(super) fn cleared(name: &str, cause: Cause, at_once: bool) -> String {
    let repair = if at_once {
        " It came back within a few throws, as after a repair: if there was one, take a new baseline (rebaseline)."
    } else {
        ""
    };
    format!("Machine {name}: {cause} is back to normal.{repair}")
}

/// Text of a drift that has ended at once, except for a part.
pub(super) fn maybe_repaired(name: &str, cause: Cause) -> String {
    format!(
        "Machine {name}: most of the {} ended within a few throws, as after a repair, but the machine is not as its \
         baseline. If it was repaired, take a new baseline (rebaseline).",
        if cause == Cause::Unattributed { "drift".to_owned() } else { format!("change of {cause}") }
    )
}

/// Text of a drift that another cause explains now.
pub(super) fn withdrawn(name: &str, cause: Cause, other: Cause) -> String {
    format!("Machine {name}: the cause of the drift is no longer {cause}, but {other}.")
}

/// Text of an alarm without a name whose reason `part` explains.
pub(super) fn explained(name: &str, part: Cause) -> String {
    format!("Machine {name}: this alarm is withdrawn: {part} explains the change.")
}

fn change(e: &Explanation) -> String {
    change_of(&e.cause.to_string(), e)
}

fn change_of(name: &str, e: &Explanation) -> String {
    let pct = percent(e.size);
    let way = if pct < 0.0 { "down" } else { "up" };
    // One decimal for small changes only; the interval has the same decimals as the change.
    let decimals = usize::from(pct.abs() < 9.95);
    let least = if decimals == 0 { 1.0 } else { 0.1 };
    let interval = interval_pct(e).max(least);
    format!("{name} {way} {:.decimals$} % (±{interval:.decimals$} %)", pct.abs())
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

fn coefficients(attribution: &Attribution) -> String {
    let part = |name: &str, i: usize| format!("{name} {:+.1} %", percent(attribution.mean[i]));
    format!("{}, {}, {}", part("b0", 0), part("a1", 1), part("a0", 2))
}

fn runner_up(runner_up: Option<&RunnerUp>) -> String {
    /// Margins as twice the log-likelihood ratio: odds of 1000 to 1, and of 20 to 1.
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

fn advice(attribution: &Attribution) -> String {
    let look_at = |e: &Explanation| match attribution.sound_magnets() {
        Some(Level { value, sd }) if e.cause == Cause::Kt => format!(
            "The motor's back-EMF has not changed as much ({:+.1} %, ±{:.1} %), so its magnets are sound. Check gear, clutch and \
             screw for wear and lubrication, then brushes and commutator.",
            percent(value),
            196.0 * sd * value.exp()
        ),
        _ => look_at(e.cause, e.size).to_owned(),
    };
    match &attribution.naming {
        Naming::One(e) | Naming::Another { new: e, .. } => look_at(e),
        Naming::Either(a, b) | Naming::Both(a, b) => format!("{} {}", look_at(a), look_at(b)),
        Naming::Neither => "Check the sensors first, then the whole drive.".to_owned(),
    }
}

fn look_at(cause: Cause, size: f64) -> &'static str {
    match (cause, size > 0.0) {
        (Cause::Kt, false) => "Check the motor: magnets, brushes, commutator.",
        (Cause::Kt, true) => "Check the motor: a part may have been replaced.",
        (Cause::Friction, true) => "Check slide chairs and lubrication.",
        (Cause::Friction, false) => {
            "Rain does this and passes. Take a new baseline only if it was cleaned or lubricated."
        }
        (Cause::Stiffness, true) => "Check rods, stretcher bars and heel for binding.",
        (Cause::Stiffness, false) => "Check rods, stretcher bars and fastenings for looseness or cracks.",
        (Cause::Inertia, true) => {
            "Check the brake, which may release late, and play in the drive: both look the same. Then look for added load: \
             ice, ballast, a dragging second drive."
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_delay_that_rounds_to_zero_is_not_earlier_or_later() {
        let of = |delay_ms: f64| {
            let level = |value: f64, sd: f64| Level { value, sd };
            let change =
                start::Change { delay: level(delay_ms, 0.2), gain: level(-0.3, 0.02), running: level(0.0, 0.01) };
            start("21B", &change, 12)
        };
        assert!(of(-0.04).contains("the toe moves as soon as usual (±0.4 ms) after the start"), "{}", of(-0.04));
        assert!(of(-2.0).contains("the toe moves 2.0 ms (±0.4 ms) earlier after the start"), "{}", of(-2.0));
    }
}
