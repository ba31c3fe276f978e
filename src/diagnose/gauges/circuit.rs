//! The electrical circuit of the motor: errors of the published voltage, and changes of the back-EMF and the
//! resistance.

use super::{Gauge, Gauges, by_side, heat, mean};
use crate::diagnose::statistics::{Level, WINDOWS};

/// Largest difference of the temperatures of winding and air \[K\], in a yard with a throw every few minutes. The
/// insulation allows 80 K.
const HEATED_K: f64 = 60.0;
/// Largest difference of the temperature of the air to that of the baseline \[K\], if it is not measured.
const WEATHER_K: f64 = 30.0;
/// Least reported error of a published voltage, as a logarithm.
const VOLTAGE_ERROR: f64 = 0.08;
/// Least significance of an error of a published voltage \[standard deviations\].
const VOLTAGE_ERROR_SD: f64 = 4.0;
/// Largest difference of two changes that count as equal, as part of their size.
const ALIKE: f64 = 0.5;
/// Significance of a shorter duration, in standard deviations.
const SHORTER_SD: f64 = 3.0;
/// Significance of a changed resistance, in standard deviations of a level.
const CIRCUIT_SD: f64 = 4.0;
/// Largest change of the logarithm of the measured resistance with the delay of the start \[1/ms\]. Very dry chairs
/// wind up a soft drive, which delays the toe by 25 ms or more and unwinds while the resistance is measured; this
/// changes it by 0.25. Play, lost motion and a late position change it by 0.1 at most.
const OHMS_OF_DELAY: f64 = 0.01;
/// Least fall of the inrush with a rise of the resistance, as part of the rise (both logarithms). The inductance of an
/// armature limits this part, to 0.33 to 0.5 on an independent drive of 20 mH.
const INRUSH_OF_OHMS: f64 = 0.15;
/// Largest uncertainty of a resistance that is judged, as a logarithm: a resistance that hardly shows in the inrush may
/// have any value.
const CIRCUIT_UNCERTAINTY: f64 = 0.4;

/// Largest increase of the duration by a higher resistance, as part of the fall of the inrush (both logarithms). A
/// lower voltage slows the motor by at least as much as it lowers the inrush. A higher resistance slows it by less: by
/// 0.4 to 0.7 of the fall, on motors whose load takes a fifth of the voltage.
const SLOWER_OF_INRUSH: f64 = 0.85;

/// Largest normal delay of the start in a direction without a late brake \[ms\]. A brake that is late by 10 ms delays
/// the start by 2 ms in both directions. An elastic drive delays it by -17 to 6 ms, and never in both directions.
const PROMPT_MS: f64 = 1.0;

/// Change of the back-EMF of the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BackEmf {
    pub(crate) level: Level,
    /// Whether the change is only concluded from a shorter duration, which less friction causes too.
    pub(crate) of_duration: bool,
    /// Change of the acceleration at the start; `None` if it is unknown.
    pub(crate) at_start: Option<AtStart>,
    /// Whether dry friction winds up the drive before the toe moves.
    pub(crate) is_wound_up: bool,
}

/// Change of the acceleration per ampere at the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct AtStart {
    pub(crate) level: Level,
    /// Whether the toe of the healthy machine moves with the current, so that no brake hides a change of the motor.
    pub(crate) is_prompt: bool,
}

/// Least delay of the start by a drive that is wound up \[ms\]: play, a brake and a late position delay it by less.
const WOUND_UP_MS: f64 = 10.0;

impl BackEmf {
    /// Whether the gauges exclude a weaker motor: neither the back-EMF nor the acceleration at the start has decreased.
    ///
    /// Ratios of the coefficients do not decide this alone. If chairs become dry on a machine with a soft toe drive,
    /// all ratios change as with a loss of torque.
    pub(crate) fn excludes_weaker_motor(&self) -> bool {
        /// Significant decrease, in standard deviations.
        const SHOWN_SD: f64 = 3.0;
        let is_kept = |level: Level| level.value > -SHOWN_SD * level.sd;
        !self.of_duration
            && is_kept(self.level)
            && self.at_start.is_some_and(|start| start.is_prompt && is_kept(start.level))
    }

    /// Change of the back-EMF; `None` if only a shorter duration shows it, as less friction shortens the throw too.
    pub(crate) fn of_motor(self) -> Option<Level> {
        (!self.of_duration).then_some(self.level)
    }
}

/// Change of the resistance between supply and motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Circuit {
    pub(crate) level: Level,
    /// Size relative to the largest change that heat explains, or to the scatter if that is larger.
    pub(crate) size: f64,
    /// Whether the resistance has changed for certain in the last three throws, by heat or by a fault.
    pub(crate) is_shown: bool,
    /// Whether something else may have changed instead: motor, play or position sensor.
    pub(crate) is_doubtful: bool,
    /// The gauge that shows the change.
    pub(crate) shown_by: ShownBy,
}

/// The gauge that shows a changed resistance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ShownBy {
    /// The resistance, beside a back-EMF that has not changed.
    Resistance,
    /// The resistance of a series-wound motor, whose back-EMF is unknown, beside the inrush.
    SeriesResistance,
    /// The inrush, as the resistance is unknown. Then the level is the fall of the inrush, which is at most as large.
    Inrush,
}

impl Circuit {
    /// The change of the resistance if a sensor may explain a change of b0 (a logarithm): the fault of this sensor
    /// would change the resistance as much.
    pub(crate) fn beside(self, change: f64) -> Self {
        Self { is_doubtful: self.is_doubtful || change.abs() > ALIKE * self.level.value.abs(), ..self }
    }
}

impl Gauges {
    /// Error of the published supply voltage, as a logarithm. Resistance and back-EMF constant are computed from this
    /// voltage, so both have its error. Either the published voltage has changed as much, while the speed of the motor
    /// has not; or it has not changed and should have, as with a stuck sensor, and both changes are larger than heat
    /// explains. Weaker magnets do not change the resistance, and draw more current; so does a motor with another
    /// winding. The level is that of the last three throws; six throws must show the error too.
    pub(crate) fn voltage_error(&self) -> Option<Level> {
        self.voltage_error_in(WINDOWS[1]).and_then(|_| self.voltage_error_in(WINDOWS[0]))
    }

    /// [`Self::voltage_error`] over the last `throws`.
    pub(crate) fn voltage_error_in(&self, throws: usize) -> Option<Level> {
        let level = |gauge| self.level(gauge, throws);
        let (back_emf, ohms, volts) = (level(Gauge::BackEmf)?, level(Gauge::Resistance)?, level(Gauge::Volts)?);
        let is_like = |of: f64, sd: f64| (of - back_emf.value).abs() < ALIKE * back_emf.value.abs() + sd;
        let size = back_emf.value.abs();
        let is_shown = error_size(back_emf, ohms) > 1.0 && is_like(ohms.value, 0.0);
        let is_alone = is_like(volts.value, volts.sd) || size.min(ohms.value.abs()) > heat(HEATED_K + WEATHER_K);
        let running = level(Gauge::Running).map_or(0.0, |running| running.value.abs() - running.sd);
        (is_shown && is_alone && running < ALIKE * size).then_some(back_emf)
    }

    /// Size of the change of the back-EMF, in which an error of the voltage shows, relative to the least reported
    /// error; `None` if it is unknown.
    pub(crate) fn voltage_error_size(&self) -> Option<f64> {
        let [back_emf, ohms] = [Gauge::BackEmf, Gauge::Resistance].map(|gauge| self.level(gauge, WINDOWS[0]));
        Some(error_size(back_emf?, ohms?))
    }

    /// Change of the back-EMF over the last `throws`: of its constant, without a supply voltage from the no-load speed,
    /// and without both, as with a stroke that unlocks, from a shorter duration.
    pub(crate) fn back_emf(&self, throws: usize) -> Option<BackEmf> {
        let of_speed = || self.level(Gauge::NoLoadSpeed, throws).map(|Level { value, sd }| Level { value: -value, sd });
        let of_constant = self.level(Gauge::BackEmf, throws).filter(|_| self.voltage_error().is_none());
        let shown = of_constant.or_else(of_speed);
        let of_duration = || self.level(Gauge::Duration, throws).filter(|level| level.value < -SHORTER_SD * level.sd);
        let level = shown.or_else(of_duration)?;
        let at_start = self.scattered_level(Gauge::StartGain, throws);
        let is_prompt = self.normals(Gauge::StartDelay).any(|delay_ms| delay_ms < PROMPT_MS);
        let at_start = at_start.map(|level| AtStart { level, is_prompt });
        Some(BackEmf { level, of_duration: shown.is_none(), at_start, is_wound_up: self.is_wound_up(throws) })
    }

    /// Whether the toe starts later than a weaker motor explains: dry friction at the toe winds up an elastic drive
    /// before the toe moves. The time of the start goes with the square root of the acceleration, so a motor that kept
    /// a quarter of its torque delays it by its normal delay again.
    fn is_wound_up(&self, throws: usize) -> bool {
        let later = self.scattered_level(Gauge::StartDelay, throws);
        later.is_some_and(|later| later.value - CIRCUIT_SD * later.sd > self.normal_delay_ms().max(WOUND_UP_MS))
    }

    /// Range of the change of the inrush, as logarithms, by the change of the resistance of the winding with the
    /// temperature of the air. The inductance limits the inrush too, so the inrush may follow this change completely,
    /// or not at all.
    pub(crate) fn winding_of_air(&self, throws: usize) -> [f64; 2] {
        let warmer = self.level(Gauge::Air, throws).map(|air| heat(air.value));
        warmer.map_or([-heat(WEATHER_K), heat(WEATHER_K)], |warmer| [warmer.min(0.0), warmer.max(0.0)])
    }

    /// Change of the resistance between supply and motor that heat does not explain. The level is that of the last
    /// three throws; six throws must show the change too, so a single throw does not. If the published voltage is
    /// wrong, this explains the change. `None` if the change is unknown.
    pub(crate) fn circuit(&self) -> Option<Circuit> {
        // With a published temperature, its effect on the winding is compensated.
        let knows_weather = self.level(Gauge::Air, WINDOWS[0]).is_some();
        self.circuit_of_resistance(knows_weather).or_else(|| self.circuit_of_inrush(knows_weather))
    }

    /// [`Self::circuit`] from the inrush, where the resistance is unknown, as without a supply voltage. A higher
    /// resistance lowers the inrush, slows the motor less than a lower voltage would, and does not change the running
    /// current. A wrong gain of the current sensor would change the running current too.
    fn circuit_of_inrush(&self, knows_weather: bool) -> Option<Circuit> {
        let lost = |throws: usize| {
            if self.level(Gauge::Resistance, throws).is_some() {
                return None;
            }
            let [inrush, running, longer] =
                [Gauge::Inrush, Gauge::Running, Gauge::Duration].map(|gauge| self.level(gauge, throws));
            let (inrush, running, longer) = (inrush?, running?, longer?);
            let volts = self.level(Gauge::Volts, throws).unwrap_or(Level { value: 0.0, sd: 0.0 });
            let level = Level { value: volts.value - inrush.value, sd: inrush.sd.hypot(volts.sd) };
            let is_slower = longer.value > SHORTER_SD * longer.sd && longer.value < SLOWER_OF_INRUSH * level.value;
            let is_gain = -running.value > ALIKE * level.value;
            Some((level, if is_slower && !is_gain { level.value.max(0.0) } else { 0.0 }))
        };
        let (level, shown) = lost(WINDOWS[0])?;
        let (longer, longer_shown) = lost(WINDOWS[1])?;
        let latest = relative_size(shown, level, knows_weather);
        let size = latest.min(relative_size(longer_shown, longer, knows_weather));
        let is_shown = latest > 0.0 && level.value.abs() > CIRCUIT_SD * level.sd;
        Some(Circuit { level, size, is_shown, is_doubtful: false, shown_by: ShownBy::Inrush })
    }

    /// Whether the last throws show the resistance of a series-wound motor, which has no constant of the back-EMF.
    pub(crate) fn is_series_with_resistance(&self) -> bool {
        let is_known = |gauge| self.level(gauge, WINDOWS[0]).is_some();
        is_known(Gauge::Resistance) && !is_known(Gauge::BackEmf)
    }

    fn circuit_of_resistance(&self, knows_weather: bool) -> Option<Circuit> {
        let (level, longer) = (self.level(Gauge::Resistance, WINDOWS[0])?, self.level(Gauge::Resistance, WINDOWS[1])?);
        // A series-wound motor has no constant of the back-EMF. Its flux does not change: it has no magnets.
        let back_emf = self.level(Gauge::BackEmf, WINDOWS[0]);
        let is_motor = back_emf.is_some_and(|own| own.value.abs() > ALIKE * level.value.abs());
        let size_of = |level: Level| relative_size(level.value.abs(), level, knows_weather);
        let latest = if self.voltage_error().is_some() { 0.0 } else { size_of(level) };
        let size = latest.min(size_of(longer));
        // The inrush is at most V/R, so it falls with a higher resistance. An error of the position changes the
        // computed resistance, but not the inrush.
        let [volts, inrush] = [Gauge::Volts, Gauge::Inrush].map(|gauge| self.level(gauge, WINDOWS[1]));
        let [from, to] = if knows_weather { self.winding_of_air(WINDOWS[1]) } else { [0.0; 2] };
        let by_air = if longer.value > 0.0 { to } else { -from };
        let lost_inrush = volts.zip(inrush).map(|(volts, inrush)| volts.value - inrush.value);
        let is_inrush_as_before = lost_inrush.zip(inrush).is_some_and(|(lost, inrush)| {
            // The published voltage may be wrong, and no back-EMF shows it: then the inrush itself must have changed.
            let lost = if back_emf.is_some() { [lost; 2] } else { [lost, -inrush.value] };
            let lower = lost.map(|lost| lost * longer.value.signum()).into_iter().fold(f64::INFINITY, f64::min);
            lower - by_air < INRUSH_OF_OHMS * longer.value.abs() - inrush.sd
        });
        // With an elastic drive, the motor moves differently from the toe, whose position is measured.
        let by_elasticity =
            self.level(Gauge::StartDelay, WINDOWS[1]).map_or(0.0, |delay| OHMS_OF_DELAY * delay.value.abs());
        let is_elastic = by_elasticity > ALIKE * level.value.abs();
        // The scatter of a series-wound motor's resistance is near this limit. A change beyond it, with the fall of the
        // inrush, is measured well enough.
        let most = if back_emf.is_none() { CIRCUIT_UNCERTAINTY.max(level.value.abs()) } else { CIRCUIT_UNCERTAINTY };
        let is_measured = CIRCUIT_SD * level.sd < most;
        let is_doubtful = is_motor || is_elastic || is_inrush_as_before || self.falls_in_one_direction(longer);
        let is_shown = latest > 0.0 && level.value.abs() > CIRCUIT_SD * level.sd;
        let (level, shown_by) = if back_emf.is_some() {
            (level, ShownBy::Resistance)
        } else {
            (between(lost_inrush.unwrap_or(level.value), level), ShownBy::SeriesResistance)
        };
        is_measured.then_some(Circuit { level, size, is_shown, is_doubtful, shown_by })
    }

    /// Whether a resistance with this level has fallen in one direction only. A bad contact may raise it in one
    /// direction, but a fault of the winding lowers it in both. Where a stiff spring pushes the drive through its play,
    /// the computed resistance is too low.
    fn falls_in_one_direction(&self, level: Level) -> bool {
        let departures = self.departures(Gauge::Resistance, WINDOWS[1]).unwrap_or_default();
        // The mean of a direction without departures is NaN, which is not greater.
        level.value < 0.0 && by_side(&departures).iter().any(|own| mean(own) > ALIKE * level.value)
    }
}

/// The change of the resistance of a series-wound motor: from the fall of the inrush, the least possible change, to the
/// change `level` that saturation of the iron makes too large. The standard deviation is that of an even distribution.
fn between(lost_inrush: f64, level: Level) -> Level {
    let least = lost_inrush * level.value.signum();
    let (least, most) = (least.clamp(0.0, level.value.abs()), level.value.abs());
    let value = level.value.signum() * f64::midpoint(least, most);
    Level { value, sd: level.sd.hypot((most - least) / 12.0_f64.sqrt()) }
}

/// Size of an error of the voltage relative to the least reported error.
fn error_size(back_emf: Level, ohms: Level) -> f64 {
    back_emf.value.abs() / VOLTAGE_ERROR.max(VOLTAGE_ERROR_SD * back_emf.sd.max(ohms.sd))
}

/// The change `shown` relative to the largest change that heat explains, or to the scatter of `level` if that is
/// larger.
fn relative_size(shown: f64, level: Level, knows_weather: bool) -> f64 {
    let heat = heat(HEATED_K + if knows_weather { 0.0 } else { WEATHER_K });
    shown / heat.max(CIRCUIT_SD * level.sd)
}
