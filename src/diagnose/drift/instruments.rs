//! Distinguishes a fault of a sensor, of the logger's clock or of the supply from a fault of a part.
//!
//! A drift is a vector in (ln b0, ln a1, ln a0). A gain error of the position sensor changes it as a fault of the motor
//! does, and a gain error of the current sensor in the opposite sense. A clock that stretches time by the factor s
//! changes it by (-2, -1, -2) ln s, by the derivatives in equation 12 of the study. The coefficients alone thus cannot
//! name the faulty device. The gauges can: the table gives the change of the logarithm of each gauge for a fault of
//! size 1. The supply voltage is V, the current i and the speed of the motor ω.
//!
//! | fault | travel | back-EMF (V - R i)/ω | resistance R | duration |
//! |---|---|---|---|---|
//! | motor: torque alone, or its magnets | 0 | 0, or 1 | 0 | 0, or 1 |
//! | friction, stiffness, inertia | 0 | 0 | 0 | 0 |
//! | current sensor | 0 | 0 | 1 | 0 |
//! | position sensor | 1 | -1 | 0 | 0 |
//! | clock | 0 | 1 | 0 | 1 |
//!
//! More dry friction lowers b0 too, as it takes a part of the torque at the start of the throw: b0 and a1 alone cannot
//! distinguish motor and friction. The back-EMF shows a change of the motor; without a voltage, the no-load speed does.
//!
//! Without a supply voltage, a fault of the motor and one of the current sensor look the same, and the alarm names
//! both. A weak supply hardly changes the coefficients. Dry friction is the exception: the model has viscous friction
//! only, so at a lower speed the same dry friction looks larger, at most in proportion to the duration of the throw.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{
    Attribution, Awaited, Drift, Explanation, Naming, Origin, SensorFault, Tested, Window, fit_along, mean_of_both,
};
use crate::{
    diagnose::{
        AlarmEvent, Cause, RunnerUp, SensorChannel, Settings, Severity,
        alarm::{Rule, RuleResult, Step, count_over},
        gauges::{Circuit, Gauge, Gauges, ShownBy},
        statistics::{LONGEST_WINDOW, Level, WINDOWS, is_default, percent, streak, to_f32},
        text,
    },
    throw::{Channel, Direction},
};

/// Lead of a sensor over the machine that names the sensor: odds of 150 to 1, as twice the logarithm.
const LEAD_OF_SENSOR: f64 = 10.0;
/// Lead of the machine over a sensor that excludes the sensor: odds of 20 to 1, as twice the logarithm.
const LEAD_OF_MACHINE: f64 = 6.0;
/// Loss of the stroke of a machine without toe sensor that is critical, as a logarithm.
const SHORT_STROKE: f64 = 0.1;
/// Largest misfit of one gauge, so that a gauge that changed for another reason cannot decide alone.
const MAX_MISFIT: f64 = 40.0;
/// Change of the supply voltage that raises an alarm \[%\]: more than a battery or the mains changes in service.
const SUPPLY_LIMIT_PCT: f64 = 15.0;
/// Largest increase of friction as part of the loss of supply voltage, both as logarithms. A decrease is only scatter.
const MAX_FRICTION_PER_LOSS: f64 = 1.3;
/// Largest change of b0 by the spring's part of the torque at the start, as part of the loss of supply voltage, both as
/// logarithms. A spring that takes 0.4 of that torque causes it at a loss of 35 %.
const SPRING_PER_LOSS: f64 = 0.65;
/// Least change of the inrush current as part of the gain error of the current sensor.
const INRUSH_OF_GAIN: f64 = 0.5;
/// Slack of this limit in standard deviations of the inrush current. With less slack, a gain error beside an uncertain
/// inrush is named as a fault of the motor. With more, a slide chair that dries on a soft drive is named as a gain
/// error, as it changes the resistance like a gain error of 10 to 15 %.
const INRUSH_SLACK_SD: f64 = 1.0;

/// Throws for which a past fault of a sensor or the supply can explain a drift: a longest window of each direction.
const LINGERS: u32 = 2 * LONGEST_WINDOW;

/// Number of throws with an alarm about the current sensor after which its gain is known: the gauges are means over as
/// many.
pub(crate) const KNOWN_AFTER: u8 = 12;
const _: () = assert!(KNOWN_AFTER as usize == WINDOWS[2], "the same length, in another type");

/// Counts of throws with and without a fault of a sensor or the supply.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
struct FaultCounts {
    /// Consecutive throws with the fault above its limit.
    named: u32,
    /// Consecutive throws with the measured quantity far below its limit.
    over: u32,
    /// Consecutive throws without the fault.
    unseen: u32,
    /// Whether the fault still explains a drift: its throws may be in the windows.
    lingers: bool,
}

/// Gauges of a machine, and the alarms about its sensors and supply.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Instruments {
    pub(crate) gauges: Gauges,
    /// The sensor whose fault the gauges showed last; also before the fault is named.
    channel: Option<SensorChannel>,
    /// Size of its fault: logarithm of the gain, or of the rate of the clock.
    size: f32,
    /// Consecutive throws with an alarm about the gain of the current sensor, which the gauges show.
    #[serde(skip_serializing_if = "is_default")]
    standing: u8,
    /// Logarithm of this gain, once it is known. Its effect is taken out of the coefficients, so that a fault of a part
    /// beside it is found, with its own size. Back-EMF, travel and duration do not depend on this gain; other sensors
    /// change the gauges that distinguish the parts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) known_gain: Option<f32>,
    sensor: FaultCounts,
    supply: FaultCounts,
    circuit: FaultCounts,
    /// For an offset of the current sensor.
    rest: FaultCounts,
    /// For an offset of the position sensor.
    shift: FaultCounts,
}

/// A sensor, or the clock, that may explain a drift.
struct Suspect {
    channel: SensorChannel,
    /// Change of (ln b0, ln a1, ln a0) by a fault of size 1.
    effect: [f64; 3],
    /// Change of the gauges in [`DISTINGUISHING`] by a fault of size 1.
    gauges: [f64; 4],
    /// Logarithm of the gain, or of the rate of the clock, in a fault of size 1.
    gain: f64,
}

const SUSPECTS: [Suspect; 3] = [
    Suspect { channel: SensorChannel::Current, effect: [1.0, 0.0, 0.0], gauges: [0.0, 0.0, 1.0, 0.0], gain: -1.0 },
    Suspect { channel: SensorChannel::Position, effect: [1.0, 0.0, 0.0], gauges: [1.0, -1.0, 0.0, 0.0], gain: 1.0 },
    Suspect { channel: SensorChannel::Clock, effect: [-2.0, -1.0, -2.0], gauges: [0.0, 1.0, 0.0, 1.0], gain: 1.0 },
];

/// The gauges that distinguish sensors from parts.
const DISTINGUISHING: [Gauge; 4] = [Gauge::Travel, Gauge::BackEmf, Gauge::Resistance, Gauge::Duration];

impl Instruments {
    /// The origin of a drift, by the gauges.
    pub(crate) fn origin(&self, drift: &Drift, settings: &Settings) -> Origin {
        let (Some(attribution), Some(Tested { window, .. })) = (&drift.attribution, &drift.strongest) else {
            return Origin::Machine;
        };
        if self.supply_explains(attribution, window, &drift.last_few, settings)
            || self.circuit_explains(attribution, window)
        {
            return Origin::Supply;
        }
        let mut levels = self.levels(window.throws);
        if let (Some(gain), [_, _, Some(resistance), _]) = (self.known_gain, &mut levels) {
            resistance.value += f64::from(gain);
        }
        let (part, score) = best_part(window, &levels, settings);
        let lingers = self.sensor.lingers && self.known_gain.is_none();
        let judged = SUSPECTS.iter().filter_map(|suspect| {
            let Suspect { channel, effect, gauges, gain } = suspect;
            let is_known = levels.iter().zip(gauges).any(|(level, effect)| level.is_some() && *effect != 0.0);
            let alone = fit_along(&Vector3::from(*effect), &window.mean, &window.covariance, settings);
            let (size, own) = alone?;
            let is_possible = match channel {
                SensorChannel::Clock => self.may_be_clock(size.value, window),
                SensorChannel::Current => self.may_be_current(gain * size.value, window),
                _ => true,
            };
            if !is_possible {
                return None;
            }
            let lead = score - own - misfit(&levels, &gauges.map(|gauge| gauge * size.value));
            // Without a supply voltage the current sensor is always possible.
            let size = weighed(size, &levels, gauges);
            let size = Level { value: gain * size.value, ..size };
            (is_known || *channel == SensorChannel::Current).then_some((lead, *channel, is_known, size))
        });
        let best = judged.max_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((lead, channel, true, size))
                if lead >= LEAD_OF_SENSOR || lead > -LEAD_OF_MACHINE && self.is_of_stroke(channel) =>
            {
                let cause = if self.is_of_stroke(channel) { Cause::Unattributed } else { Cause::Sensor };
                Origin::Sensor(SensorFault { cause, channel, size, runner_up: RunnerUp { cause: part, margin: lead } })
            }
            Some((lead, channel, is_known, ..)) if lead > -LEAD_OF_MACHINE && !lingers => {
                let waits = match self.gauges.level(Gauge::Volts, WINDOWS[0]) {
                    _ if is_known => Awaited::Throws,
                    Some(_) => Awaited::Resistance,
                    None => Awaited::Voltage,
                };
                Origin::Either { channel, waits }
            }
            _ if lingers || self.supply.lingers && self.supply.unseen > 0 => {
                let is_alike = |(lead, channel, ..): (f64, SensorChannel, bool, Level)| {
                    lead > -LEAD_OF_MACHINE && self.channel == Some(channel)
                };
                Origin::Past { is_alike: best.is_some_and(is_alike) }
            }
            _ => Origin::Machine,
        }
    }

    /// Whether a gain of this channel is that of the stroke, which a machine without toe sensor assumes. A motor with
    /// weaker magnets has the opposite sign, so this names the points also if it does not lead clearly.
    fn is_of_stroke(&self, channel: SensorChannel) -> bool {
        channel == SensorChannel::Position && self.gauges.is_without_toe_sensor()
    }

    /// Whether a clock that is wrong by the factor exp(`size`) may explain a drift. With ratios of coefficients only, a
    /// wrong clock cannot be distinguished from friction. Friction changes the running current; a wrong clock does not.
    /// A wrong clock changes the duration of both directions alike.
    fn may_be_clock(&self, size: f64, window: &Window) -> bool {
        /// Change of the running current, or difference between the changes of the durations of both directions, less
        /// its standard deviation, that excludes the clock; as part of `size`.
        const PART: f64 = 0.5;
        let running = self.gauges.level(Gauge::Running, window.throws);
        let has_changed = running.is_some_and(|level| level.value.abs() - level.sd > PART * size.abs());
        let [one, other] = Direction::BOTH.map(|direction| self.gauges.longer(Some(direction)));
        let differ = one
            .zip(other)
            .is_some_and(|(one, other)| (one.value - other.value).abs() - one.sd.hypot(other.sd) > PART * size.abs());
        window.shows(Cause::Inertia) && !has_changed && !differ
    }

    /// Whether a gain error of the current sensor may explain a drift: then the inrush current has changed as well, by
    /// at least half of the error, beyond the changes by the supply voltage and by the temperature of the winding. The
    /// resistance is no evidence here: it is wrong if the toe moves differently from the motor.
    fn may_be_current(&self, gain: f64, window: &Window) -> bool {
        let level = |gauge| self.gauges.level(gauge, window.throws);
        let (Some(inrush), Some(volts)) = (level(Gauge::Inrush), level(Gauge::Volts)) else { return true };
        let [from, to] = self.gauges.winding_of_air(window.throws);
        let change = inrush.value - volts.value;
        let slack = INRUSH_SLACK_SD * inrush.sd.hypot(volts.sd);
        let shown = if gain > 0.0 { change + to } else { -(change + from) } + slack;
        shown > INRUSH_OF_GAIN * gain.abs()
    }

    /// Whether a changed resistance between supply and motor explains a drift. The resistance changes the inrush
    /// current and the speed. The inrush accelerates the machine, so b0 changes a little too.
    fn circuit_explains(&self, attribution: &Attribution, window: &Window) -> bool {
        let Some(circuit) = self.gauges.circuit() else { return false };
        let of_inrush = self.gauges.motor_of_inrush(circuit.level.value);
        // Heat changes the motion as a bad contact does, so a change that heat explains counts as well.
        let is_changed = circuit.is_shown && !circuit.is_doubtful;
        is_changed && self.speed_explains(attribution, window, circuit.level.value.signum(), [of_inrush, 0.0])
    }

    /// Whether a motor that the supply makes slower (`sense` 1) or faster (-1) explains a drift, where the motor may
    /// seem to change by `of_motor`, and the inertia by `of_inertia`. Dry friction F at the speed v adds F/v to a1, and
    /// a speed that changes along the stroke looks like stiffness. Both grow at most as much as the duration. In the
    /// ratios to b0, they look like a weaker motor.
    fn speed_explains(
        &self,
        attribution: &Attribution,
        window: &Window,
        sense: f64,
        [of_motor, of_inertia]: [f64; 2],
    ) -> bool {
        let slower = self.gauges.level(Gauge::Duration, window.throws).map_or(0.0, |longer| longer.value);
        let slower = (slower * sense).max(0.0);
        let is_explained = |part: &Explanation| {
            let explained = match part.cause {
                Cause::Inertia => of_inertia,
                Cause::Kt if window.shows(Cause::Inertia) => of_motor,
                Cause::Kt => of_motor + slower,
                _ => slower,
            };
            part.size.abs() < explained + 2.0 * part.size_sd
        };
        match &attribution.naming {
            Naming::One(main) | Naming::Either(main, _) => is_explained(main),
            Naming::Both(one, other) => is_explained(one) && is_explained(other),
            _ => false,
        }
    }

    /// Whether the supply explains a change of friction, alone or beside a small change of the motor, or a change of
    /// the inertia. The model has no dry friction, whose effect on the coefficients depends on the speed. `last_few`:
    /// as [`Drift::last_few`].
    fn supply_explains(
        &self,
        attribution: &Attribution,
        window: &Window,
        last_few: &[Option<Window>; 2],
        settings: &Settings,
    ) -> bool {
        let Some(lost) = self.gauges.supply_lost(window.throws) else { return false };
        // A machine has one motor and one inertia. The mean of both directions shows them without the spring, which
        // helps the start of one direction and hinders that of the other.
        let show_start = last_few.iter().flatten().all(|window| window.shows(Cause::Inertia));
        let both = mean_of_both(last_few).filter(|_| show_start);
        let (both, of_spring) = both.map_or((*window, SPRING_PER_LOSS * lost.value.abs()), |both| (both, 0.0));
        let of_start = self.gauges.motor_of_inrush(lost.value);
        if both.exceeds_motor(of_start + of_spring) {
            return false;
        }
        let of_inertia = of_start + of_spring + (window.mean.x - both.mean.x).abs();
        let friction = window.single(Cause::Friction, settings);
        let share = friction.size / lost.value;
        let slack = 2.0 * friction.size_sd / lost.value.abs();
        let is_friction = |found: &Explanation| found.cause == Cause::Friction;
        let is_of_friction = attribution.main().is_some_and(is_friction)
            || match &attribution.naming {
                Naming::Either(_, second) => is_friction(second),
                Naming::Both(main, second) => {
                    is_friction(second) && main.size.abs() < settings.model_error * lost.value.abs()
                }
                _ => false,
            };
        is_of_friction && (-slack..MAX_FRICTION_PER_LOSS + slack).contains(&share)
            || self.speed_explains(attribution, window, lost.value.signum(), [of_start, of_inertia])
    }

    /// Present fault of a sensor, by the gauges that it changes, as part of `named`, its size when it was named. `None`
    /// if the gauges are unknown.
    fn left_of(&self, (sensor, named): (SensorChannel, f64)) -> Option<f64> {
        if sensor == SensorChannel::Supply {
            return self.gauges.voltage_error_size();
        }
        let suspect = SUSPECTS.iter().find(|suspect| suspect.channel == sensor)?;
        let levels = self.levels(WINDOWS[1]);
        let left = weighed(Level { value: 0.0, sd: f64::INFINITY }, &levels, &suspect.gauges);
        let named = named / suspect.gain;
        (left.sd.is_finite() && named != 0.0).then_some(left.value / named)
    }

    /// The levels of the gauges that distinguish sensors from parts.
    fn levels(&self, throws: usize) -> [Option<Level>; 4] {
        let is_wrong = self.gauges.voltage_error().is_some();
        let is_of_voltage = |gauge: Gauge| matches!(gauge, Gauge::BackEmf | Gauge::Resistance);
        let levels = DISTINGUISHING
            .map(|gauge| self.gauges.level(gauge, throws).filter(|_| !(is_wrong && is_of_voltage(gauge))));
        // With a supply voltage, the back-EMF replaces the duration, as the duration has the scatter of the supply. The
        // resistance of a series-wound motor, which has no back-EMF here, is too uncertain for the gain of a sensor.
        let [travel, back_emf, ohms, duration] = levels;
        if back_emf.is_some() { [travel, back_emf, ohms, None] } else { [travel, None, None, duration] }
    }

    /// Makes the gain of the current sensor known, after enough throws with an alarm about it; then returns true.
    pub(crate) fn learn_gain(&mut self) -> bool {
        let learns = self.standing == KNOWN_AFTER && self.known_gain.is_none();
        if learns {
            self.known_gain = Some(self.size);
        }
        learns
    }

    /// The change of (ln b0, ln a1, ln a0), or of their ratios to b0, by the known gain of the current sensor.
    pub(crate) fn of_known_gain(&self, of_ratios: bool) -> Vector3<f64> {
        let of_b0 = -f64::from(self.known_gain.unwrap_or_default());
        Vector3::new(of_b0, 0.0, 0.0).add_scalar(if of_ratios { -of_b0 } else { 0.0 })
    }

    /// Updates the alarm about a sensor after a throw with this drift.
    pub(crate) fn judge(&mut self, drift: &Drift, step: &mut Step) {
        let settings = step.settings;
        let of_drift = if let Origin::Sensor(fault) = drift.origin { Some(fault) } else { None };
        let of_voltage = || {
            let size = self.gauges.voltage_error()?;
            let runner_up = RunnerUp { cause: Cause::Supply, margin: (size.value / size.sd).powi(2).min(MAX_MISFIT) };
            Some(SensorFault { cause: Cause::Sensor, channel: SensorChannel::Supply, size, runner_up })
        };
        // A drift of the known gain is its end, which the gauges show, or its growth.
        let is_known = |fault: &SensorFault| self.known_gain.is_some() && fault.channel == SensorChannel::Current;
        let has_changed = of_drift.is_some_and(|fault| is_known(&fault)) && drift.matters();
        let fault = of_drift.filter(|fault| !is_known(fault)).or_else(of_voltage);
        let same = fault.is_some_and(|fault| self.channel == Some(fault.channel));
        if fault.is_some() && !same {
            self.sensor.named = 0;
        }
        if let Some(SensorFault { channel, size, .. }) = fault {
            (self.channel, self.size) = (Some(channel), to_f32(size.value));
        }
        let is_alike = drift.origin == Origin::Past { is_alike: true };
        let delay = settings.on_delay_throws;
        let is_of_stroke = step.alarms.owned_by(Rule::Stroke).is_some();
        let open = step.alarms.find_active(Cause::Sensor).filter(|alarm| alarm.rule == Rule::Gauges);
        let is_of_sensor = open.is_some();
        // The gauges may have shown another sensor since then, for some throws.
        let of_alarm = open.and_then(|open| Some((open.last.channel?, (open.last.change_pct? / 100.0).ln_1p())));
        let shown = self.channel.map(|channel| (channel, f64::from(self.size)));
        let shown = shown.filter(|(channel, _)| !is_of_stroke || *channel == SensorChannel::Position);
        let shown = of_alarm.filter(|_| !is_of_stroke).or(shown);
        let left = shown.and_then(|shown| self.left_of(shown)).or_else(|| drift.attribution.is_none().then_some(0.0));
        let matters = fault.map(|_| of_drift.is_none() || drift.matters());
        self.sensor.follow(matters, is_alike, left, delay);
        let is_of_current = of_alarm.is_some_and(|(channel, _)| channel == SensorChannel::Current);
        let stands = is_of_current && self.channel == Some(SensorChannel::Current) && self.sensor.over == 0;
        self.standing = if stands && !has_changed { (self.standing + 1).min(KNOWN_AFTER) } else { 0 };
        if self.standing == 0 && self.known_gain.take().is_some() {
            // The effect was taken out of throws that did not have it any more.
            (self.sensor.lingers, self.sensor.unseen) = (true, 0);
        }
        // A wrong voltage changes no coefficient, so it cannot explain a drift.
        self.sensor.lingers &= self.channel != Some(SensorChannel::Supply);
        let named = fault.filter(|_| self.sensor.named >= delay);
        if let Some(SensorFault { cause: cause @ Cause::Unattributed, size, .. }) = named {
            let severity = if size.value > SHORT_STROKE { Severity::Critical } else { Severity::Warning };
            let event = step.event(cause, severity, text::stroke(step.name, &size));
            RuleResult::Fault(Box::new(event)).apply(Rule::Stroke, step);
        } else if let Some(fault) = named {
            let is_alone = !step.alarms.active().any(|event| event.cause.is_drift());
            let event = AlarmEvent {
                runner_up: Some(fault.runner_up),
                correlation: drift.attribution.as_ref().map(|attribution| attribution.correlation),
                ..step.sensor(fault.channel, text::sensor(step.name, &fault, is_alone)).of_size(fault.size)
            };
            step.alarms.raise_another(Rule::Gauges, event, self.sensor.named == delay);
        } else if self.sensor.over >= settings.off_delay_throws {
            RuleResult::Nothing.apply(Rule::Stroke, step);
            if is_of_sensor {
                step.clear(Cause::Sensor, |name| text::back_to_normal(name, Cause::Sensor));
            }
        }
    }

    /// Updates the alarm about an offset of a sensor after a throw. The estimator subtracts the current at rest, so an
    /// offset of the current changes neither coefficients nor features, and explains no other alarm.
    pub(crate) fn judge_offset(&mut self, sensor: Channel, step: &mut Step) {
        let Some((level, size)) = self.gauges.offset(sensor) else { return };
        let channel = sensor.into();
        let counts = match sensor {
            Channel::Current => &mut self.rest,
            Channel::Position => &mut self.shift,
        };
        let delay = step.settings.on_delay_throws;
        counts.follow((size > 1.0).then_some(true), false, Some(size), delay);
        let is_own =
            || step.alarms.rule(Cause::Sensor) == Some(Rule::Offset) && step.alarms.faulty_sensor() == Some(channel);
        if counts.named >= delay {
            let event = step.sensor(channel, text::offset(step.name, sensor, &level));
            step.alarms.raise_another(Rule::Offset, event, counts.named == delay);
        } else if counts.over >= step.settings.off_delay_throws && is_own() {
            step.clear(Cause::Sensor, |name| text::offset_over(name, sensor));
        }
    }

    /// Updates the alarm about the supply after a throw. `explained`: `None` if the supply explains no drift, else
    /// whether this drift is above its limit. `circuit`: the resistance between supply and motor, which counts as a
    /// part of the supply, as the voltage is measured before it.
    pub(crate) fn judge_supply(&mut self, explained: Option<bool>, circuit: Option<Circuit>, step: &mut Step) {
        let volts = self.gauges.level(Gauge::Volts, WINDOWS[0]);
        let lost = volts.and_then(|_| self.gauges.supply_lost(WINDOWS[0]));
        let of_limit = |lost: Level| percent(-lost.value).abs() / SUPPLY_LIMIT_PCT;
        let left = self.gauges.supply_change(WINDOWS[0]).map(of_limit);
        let delay = step.settings.on_delay_throws;
        let matters = lost.map(|lost| of_limit(lost) > 1.0);
        self.supply.follow(matters.max(explained), false, left, delay);
        // A gain error of the current sensor changes the resistance too.
        let is_doubtful = self.sensor.named > 0 || self.sensor.lingers || self.known_gain.is_some();
        let is_explained = is_doubtful && self.channel == Some(SensorChannel::Current);
        let left = circuit.map(|circuit| if is_explained { 0.0 } else { circuit.size });
        let circuit = circuit.filter(|circuit| circuit.size > 1.0 && !circuit.is_doubtful && !is_doubtful);
        self.circuit.follow(circuit.map(|_| true), false, left, delay);
        let event = |level: Level, text: String| step.warning(Cause::Supply, text).of_size(level);
        let of_voltage = lost.filter(|_| self.supply.named >= delay).map(|lost| {
            let level = Level { value: -lost.value, ..lost };
            (self.supply, Rule::Usual, event(level, text::supply(step.name, level.pct())))
        });
        let of_circuit = circuit.filter(|_| self.circuit.named >= delay).map(|circuit| {
            let Circuit { level, shown_by, .. } = circuit;
            let lower = Level { value: -level.value, ..level };
            let event = match shown_by {
                ShownBy::Inrush => event(lower, text::inrush(step.name, &lower)),
                _ => event(level, text::circuit(step.name, &level, shown_by)),
            };
            (self.circuit, Rule::Circuit, event)
        });
        let owner = if step.alarms.rule(Cause::Supply) == Some(Rule::Circuit) { self.circuit } else { self.supply };
        let is_over = owner.over >= step.settings.off_delay_throws;
        for (counts, rule, event) in of_voltage.into_iter().chain(of_circuit) {
            if step.alarms.raise_another(rule, event, counts.named == delay || is_over) {
                return;
            }
        }
        if is_over {
            step.clear(Cause::Supply, |name| text::back_to_normal(name, Cause::Supply));
        }
    }

    /// Forgets the last throws, as after maintenance; keeps the normal values.
    pub(crate) fn forget_recent(&mut self) {
        self.gauges.forget_recent();
        *self = Self { gauges: std::mem::take(&mut self.gauges), ..Self::default() };
    }
}

impl FaultCounts {
    /// Counts a throw. `matters`: `None` without a fault, else whether its size is above the limit; `is_alike`: a throw
    /// without a fault may show it all the same; `left`: the measured quantity as part of its limit, `None` if unknown;
    /// `delay`: throws until an alarm. A fault without an alarm explains no later drift.
    fn follow(&mut self, matters: Option<bool>, is_alike: bool, left: Option<f64>, delay: u32) {
        streak(&mut self.named, matters == Some(true));
        streak(&mut self.unseen, matters.is_none() && !is_alike);
        count_over(&mut self.over, if matters.is_some() { Some(1.0) } else { left });
        let is_recent = self.unseen < LINGERS && self.over < LINGERS;
        self.lingers = matters == Some(true) && self.named >= delay || self.lingers && is_recent;
    }
}

/// The part that fits drift and gauges best, alone or with a second part, and the misfit.
fn best_part(window: &Window, levels: &[Option<Level>; 4], settings: &Settings) -> (Cause, f64) {
    let singles = Cause::PHYSICAL.into_iter().filter(|part| window.shows(*part));
    let singles = singles.map(|part| scored([part], window, levels, settings));
    let pairs = Cause::PAIRS.into_iter().filter(|pair| pair.iter().all(|part| window.shows(*part)));
    let pairs = pairs.map(|pair| scored(pair, window, levels, settings));
    singles.chain(pairs).min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((Cause::Unattributed, f64::INFINITY))
}

/// The first of `parts`, and the misfit of all of them to drift and gauges.
fn scored<const K: usize>(
    parts: [Cause; K],
    window: &Window,
    levels: &[Option<Level>; 4],
    settings: &Settings,
) -> (Cause, f64) {
    let found = window.fit(parts, settings);
    // A weaker motor loses torque alone, or its magnets weaken: then back-EMF and duration change too.
    let motor = if parts[0] == Cause::Kt { found.parts[0].size } else { 0.0 };
    let magnets = [0.0, 1.0, 0.0, 1.0].map(|gauge| gauge * motor);
    (parts[0], found.score + misfit(levels, &[0.0; 4]).min(misfit(levels, &magnets)))
}

/// Weighted mean of the size `own` and of the sizes that the gauges show. `effects`: change of
/// the gauges by a fault of size 1.
fn weighed(own: Level, levels: &[Option<Level>; 4], effects: &[f64; 4]) -> Level {
    let mut weight = own.sd.powi(-2);
    let mut sum = weight * own.value;
    for (level, effect) in levels.iter().zip(effects) {
        if let Some(Level { value, sd }) = level {
            sum += effect * value / (sd * sd);
            weight += (effect / sd).powi(2);
        }
    }
    Level { value: sum / weight, sd: weight.sqrt().recip() }
}

/// Misfit of the gauges to their expected values: sum of squares in variances, each at most [`MAX_MISFIT`].
fn misfit(levels: &[Option<Level>; 4], expected: &[f64; 4]) -> f64 {
    let of = |(level, expected): (&Option<Level>, &f64)| level.map_or(0.0, |level| level.misfit(*expected, MAX_MISFIT));
    levels.iter().zip(expected).map(of).sum()
}
