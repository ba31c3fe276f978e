//! Sensor, supply or machine: a drift that a sensor, the logger's clock or the supply explains is no part's fault.
//!
//! In (ln b0, ln a1, ln a0) a gain of the current sensor is the motor's direction turned round, a gain of the position sensor
//! is the motor's direction, and a clock that stretches time by s moves (-2, -1, -2) ln s, as equation (12) has y'' in b0 u and
//! a0 y, and y'' in a1 y'. What tells them from a part are the gauges:
//!
//! | for 1 of its size | travel | back-EMF (V - R i)/ω | resistance | duration |
//! |---|---|---|---|---|
//! | motor: torque alone, or its magnets | 0 | 0, or 1 | 0 | 0, or 1 |
//! | friction, stiffness, inertia | 0 | 0 | 0 | 0 |
//! | current sensor | 0 | 0 | 1 | 0 |
//! | position sensor | 1 | -1 | 0 | 0 |
//! | clock | 0 | 1 | 0 | 1 |
//!
//! Without a supply voltage motor and current sensor look the same, and both are said. A weak supply moves no coefficient of
//! the model. Dry friction, which the model takes for viscous, counts for more at a lower speed: by no more than the throw gets
//! longer.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{
    alarm::{Alarms, Evidence},
    cause::Attribution,
    drift::Drift,
    event::{AlarmEvent, Cause, RunnerUp, SensorChannel, Severity},
    explain::{fit, fit_along, percent, single},
    gauges::{Gauge, Gauges, Level},
    operational::Context,
    settings::Settings,
    testimony::{Fault, Testimony},
    text,
    threshold::WINDOWS,
    window::Window,
};

/// A lead that decides between sensor and machine: odds of 150 to 1, as twice the logarithm.
const DECIDES: f64 = 10.0;
/// A lead of the machine that leaves no sensor: odds of 20 to 1.
const EXCLUDES: f64 = 6.0;
/// What an effect of a size on a gauge may err by, as a part of it.
const GAUGE_ERROR: f64 = 0.15;
/// Most that one gauge can say: a gauge may be moved by something else.
const MOST: f64 = 40.0;
/// Standard deviations from which the supply has changed, and the least change that matters, as a logarithm.
const SUPPLY_SD: f64 = 4.0;
const SUPPLY_CHANGE: f64 = 0.05;
/// Change of the supply voltage that is alarmed by itself \[%\]: more than a battery or mains has in service.
const SUPPLY_LIMIT_PCT: f64 = 15.0;
/// A throw gets longer by between these shares of what the supply lost.
const LONGER: std::ops::Range<f64> = 0.6..1.7;
/// Dry friction counts for more by up to this share of it, and for less by no more than the scatter.
const DRIER: f64 = 1.3;

/// Throws for which a sensor or the supply that explained a drift still may: a longest window of each direction.
const LINGERS: u32 = 48;

/// Streaks of throws that speak for an alarm and for its end, and whether the end is not long ago.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Streaks {
    named: u32,
    over: u32,
    lingers: bool,
}

/// Gauges of a machine and the alarms about its sensors and supply.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Instruments {
    pub(super) gauges: Gauges,
    /// The sensor that explained the drift of the last throw.
    channel: Option<SensorChannel>,
    sensor: Streaks,
    supply: Streaks,
}

/// A sensor as an explanation: its effect on the coefficients and on travel, back-EMF, resistance, duration.
struct Suspect {
    channel: SensorChannel,
    effect: [f64; 3],
    gauges: [f64; 4],
    /// Its gain is this many times its size along the effect.
    gain: f64,
}

const SUSPECTS: [Suspect; 3] = [
    Suspect { channel: SensorChannel::Current, effect: [1.0, 0.0, 0.0], gauges: [0.0, 0.0, 1.0, 0.0], gain: -1.0 },
    Suspect { channel: SensorChannel::Position, effect: [1.0, 0.0, 0.0], gauges: [1.0, -1.0, 0.0, 0.0], gain: 1.0 },
    Suspect { channel: SensorChannel::Clock, effect: [-2.0, -1.0, -2.0], gauges: [0.0, 1.0, 0.0, 1.0], gain: 1.0 },
];

/// The gauges that tell sensors from parts.
const TELLING: [Gauge; 4] = [Gauge::Travel, Gauge::BackEmf, Gauge::Resistance, Gauge::Duration];

impl Instruments {
    /// What the gauges say about a drift.
    pub(super) fn testimony(&self, drift: &Drift, settings: &Settings) -> Testimony {
        let (Some(attribution), Some(window)) = (&drift.attribution, &drift.strongest) else {
            return Testimony::Machine;
        };
        if self.supply_explains(attribution, window, settings) {
            return Testimony::Supply;
        }
        let levels = TELLING.map(|gauge| self.gauges.level(gauge, window.throws));
        // With a voltage the back-EMF says what the duration says, without the supply's own scatter.
        let levels = if levels[1].is_some() { [levels[0], levels[1], levels[2], None] } else { levels };
        let (part, score) = best_part(window, &levels, settings);
        let judged = SUSPECTS.iter().filter_map(|suspect| {
            let Suspect { channel, effect, gauges, gain } = suspect;
            let told = levels.iter().zip(gauges).any(|(level, effect)| level.is_some() && *effect != 0.0);
            let alone = fit_along(&Vector3::from(*effect), &window.mean, &window.covariance, settings);
            let (size, size_sd, own) = alone?;
            let lead = score - own - misfit(&levels, &gauges.map(|gauge| gauge * size));
            // A current sensor that nothing tells from the motor is always possible.
            let (size, size_sd) = weighed((size, size_sd), &levels, gauges);
            (told || *channel == SensorChannel::Current).then_some((lead, *channel, told, gain * size, size_sd))
        });
        let best = judged.max_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((lead, channel, true, size, size_sd)) if lead >= DECIDES => {
                Testimony::Sensor(Fault { channel, size, size_sd, runner_up: RunnerUp { cause: part, margin: lead } })
            }
            Some((lead, channel, waits, ..)) if lead > -EXCLUDES && !self.sensor.lingers => {
                Testimony::Either { channel, waits }
            }
            _ if self.sensor.lingers || self.supply.lingers && self.supply.over > 0 => Testimony::Lingers,
            _ => Testimony::Machine,
        }
    }

    /// Whether the supply explains a rise or fall of friction.
    fn supply_explains(&self, attribution: &Attribution, window: &Window, settings: &Settings) -> bool {
        let Some(lost) = self.supply_lost(window.throws) else { return false };
        let friction = single(Cause::Friction, &window.mean, &window.covariance, settings);
        let share = friction.size / lost.value;
        let slack = 2.0 * friction.size_sd / lost.value.abs();
        attribution.main().is_some_and(|main| main.cause == Cause::Friction) && (-slack..DRIER + slack).contains(&share)
    }

    /// How much less the supply gives, as a logarithm, where it changed and the throws' duration agrees: by its voltage, or by
    /// the inrush that it drives.
    fn supply_lost(&self, throws: usize) -> Option<Level> {
        let gauge = self.gauges.level(Gauge::Volts, throws).or_else(|| self.gauges.level(Gauge::Inrush, throws))?;
        let longer = self.gauges.level(Gauge::Duration, throws)?;
        let lost = Level { value: -gauge.value, ..gauge };
        let changed = lost.value.abs() > SUPPLY_CHANGE.max(SUPPLY_SD * lost.sd);
        (changed && LONGER.contains(&(longer.value / lost.value))).then_some(lost)
    }

    /// Follows the alarms about sensor and supply, after a throw with this testimony.
    pub(super) fn judge(
        &mut self,
        drift: &Drift,
        testimony: Testimony,
        alarms: &mut Alarms,
        context: Context,
    ) -> Vec<AlarmEvent> {
        let Context { name, at, throw, settings } = context;
        let mut events = Vec::new();
        let fault = if let Testimony::Sensor(fault) = testimony { Some(fault) } else { None };
        let same = fault.is_some_and(|fault| self.channel == Some(fault.channel));
        if fault.is_some() && !same {
            self.sensor.named = 0;
        }
        self.channel = fault.map_or(self.channel, |fault| Some(fault.channel));
        self.sensor.follow(fault.is_some(), drift.matters());
        if let Some(fault) = fault.filter(|_| self.sensor.named >= settings.on_delay_throws) {
            let evidence = Evidence {
                channel: Some(fault.channel),
                change_pct: Some(percent(fault.size)),
                change_pct_sd: Some(100.0 * fault.size_sd * fault.size.exp()),
                runner_up: Some(fault.runner_up),
                correlation: drift.attribution.as_ref().map(|attribution| attribution.correlation),
                ..Evidence::plain(Severity::Warning, throw, text::sensor(name, &fault))
            };
            events.extend(alarms.raise(Cause::Sensor, evidence, at));
        } else if self.sensor.over == settings.off_delay_throws
            && alarms.active().any(|event| event.cause == Cause::Sensor && event.channel == self.channel)
        {
            events.extend(alarms.clear(Cause::Sensor, text::cleared(name, Cause::Sensor, false), at));
        }
        let volts = self.gauges.level(Gauge::Volts, WINDOWS[0]);
        let lost = volts.and_then(|_| self.supply_lost(WINDOWS[0]));
        let matters = lost.is_some_and(|lost| percent(-lost.value).abs() > SUPPLY_LIMIT_PCT);
        let explains = testimony == Testimony::Supply;
        self.supply.follow(lost.is_some() || explains, matters || explains && drift.matters());
        if let Some(lost) = lost.filter(|_| self.supply.named >= settings.on_delay_throws) {
            let change_pct = percent(-lost.value);
            let evidence = Evidence {
                change_pct: Some(change_pct),
                change_pct_sd: Some(100.0 * lost.sd * (-lost.value).exp()),
                ..Evidence::plain(Severity::Warning, throw, text::supply(name, change_pct))
            };
            events.extend(alarms.raise(Cause::Supply, evidence, at));
        } else if self.supply.over >= settings.off_delay_throws {
            events.extend(alarms.clear(Cause::Supply, text::cleared(name, Cause::Supply, false), at));
        }
        events
    }

    /// Forgets the last throws, not what is normal: the machine was out of service.
    pub(super) fn forget_recent(&mut self) {
        self.gauges.forget_recent();
        (self.channel, self.sensor, self.supply) = (None, Streaks::default(), Streaks::default());
    }
}

impl Streaks {
    fn follow(&mut self, holds: bool, matters: bool) {
        let count = |streak: u32, holds: bool| if holds { streak.saturating_add(1) } else { 0 };
        let (named, over) = (count(self.named, holds && matters), count(self.over, !holds));
        *self = Self { named, over, lingers: holds && matters || self.lingers && over < LINGERS };
    }
}

/// The part that explains a drift and the gauges best, and its score.
fn best_part(window: &Window, levels: &[Option<Level>; 4], settings: &Settings) -> (Cause, f64) {
    let (m, v) = (&window.mean, &window.covariance);
    let scored = |cause: Cause, motor: Option<f64>, score: f64| {
        let magnets = [0.0, 1.0, 0.0, 1.0].map(|gauge| gauge * motor.unwrap_or_default());
        (cause, score + misfit(levels, &[0.0; 4]).min(misfit(levels, &magnets)))
    };
    let parts = Cause::PHYSICAL;
    let singles = parts.into_iter().map(|cause| {
        let found = fit([cause], m, v, settings);
        scored(cause, (cause == Cause::Kt).then_some(found.parts[0].size), found.score)
    });
    let pairs = (0..4).flat_map(|first| (first + 1..4).map(move |second| [parts[first], parts[second]])).map(|pair| {
        let found = fit(pair, m, v, settings);
        scored(pair[0], (pair[0] == Cause::Kt).then_some(found.parts[0].size), found.score)
    });
    singles.chain(pairs).min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((Cause::Unattributed, f64::INFINITY))
}

/// A size with its standard deviation, with what the gauges say of it that it moves by `effects`.
fn weighed((size, size_sd): (f64, f64), levels: &[Option<Level>; 4], effects: &[f64; 4]) -> (f64, f64) {
    let own = size_sd.powi(-2);
    let (mut sum, mut weight) = (own * size, own);
    for (level, effect) in levels.iter().zip(effects) {
        if let Some(Level { value, sd }) = level {
            sum += effect * value / (sd * sd);
            weight += (effect / sd).powi(2);
        }
    }
    (sum / weight, weight.sqrt().recip())
}

/// How badly the gauges fit what is expected of them.
fn misfit(levels: &[Option<Level>; 4], expected: &[f64; 4]) -> f64 {
    let of = |(level, expected): (&Option<Level>, &f64)| {
        level.map_or(0.0, |Level { value, sd }| {
            ((value - expected).powi(2) / (sd * sd + (GAUGE_ERROR * expected).powi(2))).min(MOST)
        })
    };
    levels.iter().zip(expected).map(of).sum()
}
