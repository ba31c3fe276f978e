//! Texts about sensors, supply and the circuit of the motor.

use crate::{
    diagnose::{
        SensorChannel, drift::SensorFault, gauges::ShownBy, observation::Unusable, operation::Implausible,
        statistics::Level,
    },
    throw::{Channel, POSSIBLE_C, brief, rounded, utc},
};

/// Begin of the fault before in the text of another one.
const BEFORE: &str = " Reported before: ";

/// The text about a sensor or the supply, with that of the fault that the alarm was about before.
pub(crate) fn after_another(text: &str, before: &str) -> String {
    let last = before.split(BEFORE).next().unwrap_or_default();
    format!("{text}{BEFORE}{last}")
}

/// Text about a fault of a sensor or the clock that explains a drift, or about a wrong supply voltage. `is_alone`: the
/// machine has no alarm about a drift.
pub(crate) fn sensor(name: &str, fault: &SensorFault, is_alone: bool) -> String {
    let pct = fault.size.pct();
    let (what, why) = match fault.channel {
        SensorChannel::Current => ("reads", "the motor's resistance seems changed as much, its back-EMF not"),
        SensorChannel::Position => ("reads", "the travel differs from its usual value"),
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
        "Machine {name}: the {} {what} {:.1} % {way} (±{:.1} %): {why}.{} {}",
        fault.channel,
        pct.abs(),
        fault.size.half_width_pct(),
        if is_alone && fault.channel != SensorChannel::Supply { " This alone explains the drift so far." } else { "" },
        look_at_sensor(fault.channel)
    )
}

/// Text about a machine without toe sensor whose motor turns less or more for a throw. `size`: logarithm of the assumed
/// stroke over the present one.
pub(crate) fn stroke(name: &str, size: &Level) -> String {
    let change = Level { value: -size.value, ..*size };
    let (way, check) = if change.value < 0.0 {
        (
            "less",
            "Check at once whether the points close and lock; then limit switches and the adjustment of the stroke",
        )
    } else {
        ("more", "Check whether the points lock, a worn or missing stop, and limit switches; then the clutch")
    };
    format!(
        "Machine {name}: for a throw its motor turns {:.0} % (±{:.0} %) {way} than in the baseline, as a mean of both \
         directions and as far as current and supply voltage show it without a toe sensor: the points stop at another place, or motor or supply_v have \
         changed. {check}. If the stroke was adjusted or the motor was exchanged, set stroke_mm and take a new baseline \
         (rebaseline).",
        change.pct().abs(),
        change.half_width_pct()
    )
}

/// Text about an offset of a sensor.
pub(crate) fn offset(name: &str, sensor: Channel, level: &Level) -> String {
    let Level { value, sd } = *level;
    let half_width = (1.96 * sd).max(0.1);
    match sensor {
        Channel::Current => format!(
            "Machine {name}: between throws the current sensor reads {value:+.1} A (±{half_width:.1} A) against its \
             baseline: an offset. It is subtracted from each throw, so the machine is monitored as before. Check the \
             current sensor's zero and supply, then whether the logger's circuit feeds something new."
        ),
        Channel::Position => format!(
            "Machine {name}: the position sensor reads {value:+.1} mm (±{half_width:.1} mm) at both ends against its \
             baseline: it moved, or its zero was set again. The shift is compensated, so the machine is monitored as \
             before. Check how the sensor is fixed, and set its zero; if it is right now, take a new baseline \
             (rebaseline)."
        ),
    }
}

/// Caveat about a current at rest that the baseline has too.
pub(crate) fn at_rest(name: &str, amperes: f64) -> String {
    format!(
        "Machine {name}: between throws its current sensor reads {amperes:+.1} A, since its baseline began: an offset \
         of the sensor, or a current that flows at rest. It is subtracted from each throw. Check the sensor's zero."
    )
}

/// Caveat about a current sensor whose known gain is taken out of the coefficients.
pub(crate) fn known_gain(name: &str, pct: f64) -> String {
    let sense = if pct > 0.0 { "much" } else { "little" };
    format!(
        "Machine {name}: its current sensor reads {:.1} % of the current too {sense}, which is subtracted from the \
         coefficients before parts are judged. Sizes of faults are less certain. Repair the sensor.",
        pct.abs()
    )
}

pub(crate) fn offset_over(name: &str, sensor: Channel) -> String {
    let reads = match sensor {
        Channel::Current => "between throws the current sensor",
        Channel::Position => "at both ends the position sensor",
    };
    format!("Machine {name}: {reads} reads as in its baseline again.")
}

/// Text about a changed supply voltage.
pub(crate) fn supply(name: &str, change_pct: f64) -> String {
    let way = if change_pct < 0.0 { "lower" } else { "higher" };
    format!(
        "Machine {name}: the supply voltage is {:.0} % {way} than the baseline's, and the throws' duration agrees. \
         Check battery, charger, feeder and connections.",
        change_pct.abs()
    )
}

/// Text about a changed resistance between supply and motor.
pub(crate) fn circuit(name: &str, level: &Level, shown_by: ShownBy) -> String {
    let beside = match shown_by {
        ShownBy::SeriesResistance if level.value > 0.0 => "its inrush has fallen",
        ShownBy::SeriesResistance => "its inrush has risen",
        ShownBy::Resistance | ShownBy::Inrush => "the motor's back-EMF has changed less",
    };
    let (way, what) = if level.value > 0.0 {
        ("up", "A bad contact, worn brushes or a damaged cable do this. Check terminals, brushes, contactor and cable.")
    } else {
        (
            "down",
            "Turns of the winding that touch, or a contact that was repaired, do this. Check the winding, then take a \
             new baseline (rebaseline).",
        )
    };
    format!(
        "Machine {name}: the resistance of the motor and its supply line is {way} {:.0} % (±{:.0} %), more than a \
         winding 60 K above the air explains, and {beside}. {what}",
        level.pct().abs(),
        level.half_width_pct()
    )
}

/// Text about a lower inrush current of a machine whose resistance is unknown.
pub(crate) fn inrush(name: &str, level: &Level) -> String {
    format!(
        "Machine {name}: the inrush of the motor is down {:.0} % (±{:.0} %), more than a winding 60 K above the air explains. Its throws take \
         longer, and its running current has not fallen as much. A bad contact, worn brushes, a damaged cable or a \
         weak supply do this. Check terminals, brushes, contactor and cable, and the voltage at the motor while it \
         runs.",
        level.pct().abs(),
        level.half_width_pct()
    )
}

/// 0 °C \[K\].
const ZERO_C_IN_K: f64 = 273.15;

pub(crate) fn sensor_implausible(name: &str, implausible: Implausible) -> String {
    let what = match implausible {
        Implausible::Impossible(celsius) => {
            let kelvin = celsius - ZERO_C_IN_K;
            let unit = if POSSIBLE_C.contains(&kelvin) {
                format!(" (as kelvin it would be {kelvin:.1} °C)")
            } else {
                String::new()
            };
            format!(
                "temperature sensor reads {celsius:.1} °C, which is impossible{unit}. The last good temperature is \
                 used, if there is one"
            )
        }
        Implausible::Jump(from, to) => format!(
            "temperature sensor jumped from {from:.0} to {to:.0} °C, faster than any weather: another unit, or a \
             broken or moved sensor. The last good temperature is used"
        ),
        Implausible::Missing(since) => format!(
            "temperature is missing since {}. The last one is used, so weather can look like a fault",
            utc(&since)
        ),
        Implausible::Stuck(celsius, since) => format!(
            "temperature sensor has read exactly {celsius:.1} °C since {}: it is stuck, or the logger repeats a \
             value. It is used all the same, so weather can look like a fault",
            utc(&since)
        ),
        Implausible::Supply(volts) => {
            let volts = brief(rounded(volts));
            format!(
                "sensor of the supply voltage reads {volts} V, which is impossible. Checks with the voltage are omitted"
            )
        }
    };
    let moved = match implausible {
        Implausible::Jump(..) => " If it is right now, take a new baseline (rebaseline).",
        _ => "",
    };
    format!("Machine {name}: the {what}. Check the sensor and its cable.{moved}")
}

/// Text for the end of an alarm about a sensor; `word`: plausible or usable.
pub(crate) fn sensor_again(name: &str, channel: SensorChannel, word: &str) -> String {
    format!("Machine {name}: the values of the {channel} are {word} again.")
}

pub(crate) fn sensor_unusable(name: &str, found: Unusable) -> String {
    let (what, check): (String, String) = match found {
        Unusable::Values(SensorChannel::Clock) => (
            "the recordings of its throws last longer than a point machine can move".into(),
            "sample_rate_hz in the logger, which may have another unit than Hz; throws_not_evaluated has the duration \
             of each throw"
                .into(),
        ),
        Unusable::Values(channel) => {
            let unit = if channel == SensorChannel::Current { "A" } else { "mm" };
            (
                format!("the {channel} reads impossible, stuck or very noisy values"),
                format!(
                    "the sensor, its cable and its supply, and that the logger sends {unit}; throws_not_evaluated has \
                     the reason of each throw"
                ),
            )
        }
        Unusable::Clipped => (
            "the values of the current sensor are clipped at the limit of a range".into(),
            "the measuring range of the logger, which is too small for these values, then the range of the sensor; \
             throws_not_evaluated has the limit"
                .into(),
        ),
        Unusable::NoCurrent => (
            "the toe moved without a motor current".into(),
            "whether the points were moved by hand (hand crank); if they were not, the current sensor, its cable and its \
             supply"
                .into(),
        ),
        Unusable::Missing => (
            "the logger no longer sends a toe position (position_mm)".into(),
            "the sensor and its cable, and the logger's configuration".into(),
        ),
        Unusable::Reversed => (
            "the position moves against the direction that the logger names, unlike before".into(),
            "whether the axis of the position or the names of the directions were changed. If both are right now, \
             take a new baseline (rebaseline)"
                .into(),
        ),
    };
    format!("Machine {name}: {what}, so the throws cannot be evaluated. Check {check}.")
}

pub(super) fn look_at_sensor(channel: SensorChannel) -> &'static str {
    match channel {
        SensorChannel::Current => "Check the current sensor's gain and wiring.",
        SensorChannel::Position => "Check the position sensor's gain and mounting.",
        SensorChannel::Clock => "Check the logger's sampling rate against sample_rate_hz.",
        SensorChannel::Temperature => "Check the temperature sensor and its cable.",
        SensorChannel::Supply => "Check the sensor of the supply voltage and its cable.",
    }
}
