//! Gauges: quantities of a throw beside the coefficients (travel, back-EMF constant, resistance, duration, voltage,
//! inrush, running current, charge, no-load speed, start, current at rest, middle, air temperature). Each is used as the
//! logarithm of its ratio to the normal value of the direction; delay of the start, current at rest, middle and temperature as a
//! difference. Errors of sensors, clock and supply change the gauges in other ways than faults of parts do, which distinguishes
//! the two.

use serde::{Deserialize, Deserializer, Serialize};

use super::{
    last::Last,
    robust::{centre_and_sd, median, moving_range_sd, skewed_sd},
    threshold::WINDOWS,
};
use crate::{estimate::Features, throw::Direction};

/// A quantity of a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Gauge {
    Travel,
    BackEmf,
    Resistance,
    Duration,
    Volts,
    /// The largest current, about the supply voltage over the resistance.
    Inrush,
    /// The mean current from the half to nine tenths of the time of the motor.
    Running,
    /// The integral of the current; the energy of the motor over the supply voltage.
    Charge,
    /// Supply voltage over back-EMF constant, known without the supply voltage.
    NoLoadSpeed,
    /// Delay of the start \[ms\], as a difference and not as a logarithm, as it has either sign.
    StartDelay,
    /// b0 of the start alone.
    StartGain,
    /// Mean current at rest \[A\], as a difference and not as a logarithm, as it has either sign.
    Rest,
    /// Middle between the positions at the begin and at the end \[mm\], as a difference: it shifts with the sensor's zero.
    Middle,
    /// Published temperature \[°C\], as a difference.
    Air,
}

impl Gauge {
    const COUNT: usize = 14;

    /// Range of the changes that a changed supply explains, as logarithms. The charge is that of the inrush, and of the running
    /// motor: its current is the same before a dry load, and follows the speed before a viscous one.
    fn range(self, Supplied { slower, inrush }: Supplied) -> [f32; 2] {
        let [from, to] = match self {
            Self::Duration => [0.0, slower],
            Self::Running => [0.0, -slower],
            Self::Charge => [inrush, slower],
            _ => [0.0, 0.0],
        };
        [from.min(to).min(0.0), from.max(to).max(0.0)]
    }

    /// Least standard deviation of a level: the effect of sampling, adjustment and temperature on a healthy machine.
    pub(super) fn floor(self) -> f64 {
        match self {
            Self::Travel => 0.003,
            Self::BackEmf => 0.005,
            Self::Resistance | Self::Duration | Self::Volts | Self::NoLoadSpeed => 0.01,
            Self::Inrush | Self::Running | Self::Charge | Self::StartGain | Self::Rest => 0.02,
            Self::StartDelay | Self::Middle => 0.2,
            Self::Air => 0.0,
        }
    }

    /// Sign of the change with the field of the magnets; 0 without one.
    fn sign_of_magnets(self) -> f64 {
        match self {
            Self::BackEmf => 1.0,
            Self::NoLoadSpeed => -1.0,
            _ => 0.0,
        }
    }
}

/// The normal value of a gauge in a direction is used from the first number of values on, and fixed from the second.
const LEARNED: (usize, usize) = (12, 24);
/// Largest number of throws of both directions in a level.
const RECENT: usize = WINDOWS[2];
/// Relative error of an expected effect on a gauge.
const EXPECTED_ERROR: f64 = 0.15;
/// Temperature coefficient of the resistance of copper \[1/K\], and reference temperature \[°C\].
const COPPER: (f64, f64) = (0.0039, 20.0);
/// Change of the field of a magnet with its temperature \[1/K\], and its standard deviation: -0.2 % per K for ferrite, -0.1 % for
/// rare earths, hardly any for Alnico and for a wound field. The air is the magnet's temperature, as a throw warms the winding.
const MAGNETS: (f64, f64) = (-0.001, 0.0006);
/// Largest temperature of a winding above the air \[K\]: in a yard with a throw every few minutes. The limit of its
/// insulation is 80 K.
const HEATED_K: f64 = 60.0;
/// Largest temperature of the air above that of the baseline \[K\], where it is not measured.
const WEATHER_K: f64 = 30.0;
/// Significance of a changed resistance, in standard deviations of a level.
const CIRCUIT_SD: f64 = 4.0;
/// Largest change of the logarithm of the resistance with the delay of the start \[1/ms\]: a soft drive that very dry chairs
/// wind up delays the toe by 25 ms or more, and unwinds while the resistance is measured, which changes it by 0.25. Play, lost
/// motion and a late position change it by 0.1 at most.
const OHMS_OF_DELAY: f64 = 0.01;
/// Least change of the inrush with the resistance, as logarithms: the inductance of an armature limits it, to 0.33 to 0.5 on an
/// independent drive of 20 mH.
const INRUSH_OF_OHMS: f64 = 0.15;
/// Largest uncertainty of a resistance that is judged, as a logarithm: one whose inrush hardly shows it may be anything.
const CIRCUIT_UNCERTAINTY: f64 = 0.4;
/// Least reported error of a published voltage, as a logarithm.
const VOLTAGE_ERROR: f64 = 0.08;
/// Least significance of such an error \[standard deviations\].
const VOLTAGE_ERROR_SD: f64 = 4.0;
/// Least reported change of the current at rest \[A\]: the zero of a Hall sensor drifts by 0.1 to 0.3 A with its temperature,
/// one way from the cold and back.
const REST_A: f64 = 0.6;
/// The same as share of the inrush: a sensor for large currents drifts in proportion to its range.
const REST_SHARE: f64 = 0.02;
/// Least significance of such a change, in standard deviations of a level: hum in a few quiet samples scatters.
const REST_SD: f64 = 4.0;
/// Least reported shift of the position sensor's zero, as share of the travel: it changes friction by 5 % in one direction and
/// by -5 % in the other.
const SHIFT_SHARE: f64 = 0.04;
/// Least change of an end of the movement that is elsewhere, as share of the travel.
const END_SHARE: f64 = 0.01;
/// Least significance of a shift, in standard deviations of a level.
const SHIFT_SD: f64 = 4.0;
/// Largest difference of two changes that are the same, as part of them.
const ALIKE: f64 = 0.5;
/// Largest part of the normal voltage across the resistance: more would be a motor near its stall.
const LARGEST_SHARE: f32 = 0.6;
/// Least speed that a supply leaves, as part of the normal one; it bounds a logarithm.
const LEAST_SPEED: f32 = 0.1;
/// Significance of a shorter duration, in standard deviations.
const SHORTER_SD: f64 = 3.0;
/// Factor on the standard deviation of a mean, as consecutive throws are correlated: √((1 + 0.5) / (1 - 0.5)) for a
/// correlation of 0.5.
const CORRELATED: f64 = 1.7;

/// Logarithms of a throw; `None` for unknown ones.
type Values = [Option<f32>; Gauge::COUNT];

/// Mean departure of the last throws from normal, as a logarithm, with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Level {
    pub(super) value: f64,
    pub(super) sd: f64,
}

impl Level {
    /// Misfit to an expected value, at most `most`, so that a change for another reason does not decide alone.
    pub(super) fn misfit(self, expected: f64, most: f64) -> f64 {
        ((self.value - expected).powi(2) / (self.sd * self.sd + (EXPECTED_ERROR * expected).powi(2))).min(most)
    }
}

/// Changes of a throw by its supply, as logarithms.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Supplied {
    /// By how much the motor is slower.
    slower: f32,
    /// Change of the inrush, V/R.
    inrush: f32,
}

/// Change of the back-EMF of the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BackEmf {
    pub(super) level: Level,
    /// Whether it is only that of the duration, which less friction shortens too.
    pub(super) of_duration: bool,
}

impl BackEmf {
    /// The change, if it is not only that of the duration.
    pub(super) fn of_motor(self) -> Option<Level> {
        (!self.of_duration).then_some(self.level)
    }
}

/// Change of the resistance between supply and motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Circuit {
    pub(super) level: Level,
    /// Size relative to what heat explains, and to the scatter.
    pub(super) size: f64,
    /// Whether it may be something else that changed, as the motor, the play or the position sensor.
    pub(super) is_doubtful: bool,
}

/// The sensors whose offset is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Offset {
    /// By the current at rest.
    Current,
    /// By both ends of the movement.
    Position,
}

/// A changed gauge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Change {
    pub(super) gauge: Gauge,
    /// Median change of the last throws, as a logarithm, and its standard deviation.
    pub(super) size: f64,
    pub(super) size_sd: f64,
}

/// Largest change of running current and charge of a usual current, as logarithms: that of the weather.
const USUAL_CURRENT: f64 = 0.15;

/// Normal values of a direction: centre and standard deviation of each gauge.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct Normal {
    /// Values of each gauge for learning; empty if there are none.
    learned: Vec<Vec<f32>>,
    #[serde(deserialize_with = "padded")]
    known: [Option<(f32, f32)>; Gauge::COUNT],
}

/// Reads the normal values. The list is shorter in snapshots of a version with fewer gauges.
fn padded<'de, D: Deserializer<'de>>(from: D) -> Result<[Option<(f32, f32)>; Gauge::COUNT], D::Error> {
    let known = Vec::deserialize(from)?;
    Ok(std::array::from_fn(|at| known.get(at).copied().flatten()))
}

/// Direction and gauges of a throw. Snapshots have the values of the known gauges only.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "(u16, Vec<f32>)", into = "(u16, Vec<f32>)")]
struct Shown {
    /// The direction in bit 0, and whether gauge `at` is known in bit `at + 1`.
    bits: u16,
    /// Values of the gauges, 0 for unknown ones.
    values: [f32; Gauge::COUNT],
}

impl Shown {
    fn new(side: usize, values: Values) -> Self {
        let bits = (0..Gauge::COUNT).filter(|at| values[*at].is_some()).fold(side, |bits, at| bits | (2 << at));
        Self { bits: u16::try_from(bits).unwrap_or_default(), values: values.map(Option::unwrap_or_default) }
    }

    fn side(self) -> usize {
        usize::from(self.bits & 1)
    }

    fn value(self, gauge: Gauge) -> Option<f32> {
        is_known(self.bits, gauge as usize).then(|| self.values[gauge as usize])
    }
}

fn is_known(bits: u16, at: usize) -> bool {
    bits & (2 << at) != 0
}

impl From<(u16, Vec<f32>)> for Shown {
    fn from((bits, known): (u16, Vec<f32>)) -> Self {
        let mut known = known.into_iter();
        let mut value = |at| if is_known(bits, at) { known.next() } else { None };
        Self { bits, values: std::array::from_fn(|at| value(at).unwrap_or_default()) }
    }
}

impl From<Shown> for (u16, Vec<f32>) {
    fn from(Shown { bits, values }: Shown) -> Self {
        (bits, (0..Gauge::COUNT).filter(|at| is_known(bits, *at)).map(|at| values[at]).collect())
    }
}

/// The gauges of one machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Gauges {
    sides: [Normal; 2],
    /// The last throws, the newest last.
    recent: Last<Shown, RECENT>,
}

impl Gauges {
    /// Adds a throw; that of a `suspicious` machine is not used for the normal values.
    pub(super) fn push(&mut self, direction: Direction, features: &Features, celsius: Option<f64>, suspicious: bool) {
        let (side, values) = (direction.side(), values(features, celsius));
        if !suspicious {
            self.sides[side].learn(values);
        }
        self.recent.push(Shown::new(side, values));
    }

    /// Throws from which the normal duration of a direction is learned so far, and those that it needs.
    pub(super) fn progress(&self, direction: Direction) -> (usize, usize) {
        let Normal { learned, known } = &self.sides[direction.side()];
        let at = Gauge::Duration as usize;
        let so_far = if known[at].is_some() { LEARNED.0 } else { learned.get(at).map_or(0, Vec::len) };
        (so_far, LEARNED.0)
    }

    /// Departures of some gauges of this throw from normal that its supply does not explain, as logarithms, with the
    /// standard deviation of one throw; `None` if the gauge or its normal value is unknown.
    pub(super) fn unexplained<const N: usize>(
        &self,
        gauges: [Gauge; N],
        direction: Direction,
        features: &Features,
        celsius: Option<f64>,
    ) -> [Option<(f32, f32)>; N] {
        let (normal, values) = (&self.sides[direction.side()], values(features, celsius));
        let supplied = normal.supplied(&values);
        gauges.map(|gauge| {
            let (centre, sd) = normal.of(gauge)?;
            let change = values[gauge as usize]? - centre;
            let [from, to] = gauge.range(supplied);
            Some((change - change.clamp(from, to), sd))
        })
    }

    /// Whether the current of a throw is as in a normal one: it is as large, and flows as long.
    pub(super) fn is_usual_current(&self, direction: Direction, features: &Features, celsius: Option<f64>) -> bool {
        let changes = self.unexplained([Gauge::Running, Gauge::Charge], direction, features, celsius);
        changes.iter().all(|change| change.is_some_and(|(change, _)| f64::from(change.abs()) < USUAL_CURRENT))
    }

    /// Level of a gauge over the last `throws` that show it, without the effect of the temperature on magnets: their mean, or in
    /// the shortest window their median; `None` if hardly any do, or its normal value is unknown.
    pub(super) fn level(&self, gauge: Gauge, throws: usize) -> Option<Level> {
        let departures = self.departures(gauge, throws)?;
        let mut values: Vec<f64> = departures.iter().map(|(_, value, _)| *value).collect();
        let sds: Vec<f64> = departures.iter().map(|(.., sd)| *sd).collect();
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let sd = sd_of_mean(gauge, mean(&sds), values.len() as f64);
        // The median has the whole size of a change as soon as most of the throws show it.
        let value = if throws == WINDOWS[0] { median(&mut values) } else { mean(&values) };
        let of_magnets = gauge.sign_of_magnets();
        let warmer_k =
            if of_magnets == 0.0 { 0.0 } else { self.level(Gauge::Air, throws).map_or(0.0, |air| air.value) };
        Some(Level { value: value - of_magnets * MAGNETS.0 * warmer_k, sd: sd.hypot(MAGNETS.1 * warmer_k) })
    }

    /// The same, with the scatter of these throws if it is larger than normal, as behind a sensor that has become noisy.
    pub(super) fn scattered_level(&self, gauge: Gauge, throws: usize) -> Option<Level> {
        let (level, departures) = (self.level(gauge, throws)?, self.departures(gauge, throws)?);
        // The directions may change otherwise.
        let of = |side: usize| {
            let own = departures.iter().filter(|(of, ..)| *of == side);
            own.map(|(_, value, _)| *value).collect::<Vec<_>>()
        };
        let sd = sd_of_mean(gauge, moving_range_sd(&[of(0), of(1)]), departures.len() as f64);
        Some(Level { sd: level.sd.max(sd), ..level })
    }

    /// Side, departure from normal, and standard deviation of one throw, of the last `throws` that show a gauge, newest first;
    /// `None` if hardly any do, or its normal value is unknown.
    fn departures(&self, gauge: Gauge, throws: usize) -> Option<Vec<(usize, f64, f64)>> {
        let departure = |shown: &Shown| {
            let (centre, sd) = self.sides[shown.side()].of(gauge)?;
            Some((shown.side(), f64::from(shown.value(gauge)? - centre), f64::from(sd)))
        };
        let departures: Vec<_> = self.recent.iter().rev().filter_map(departure).take(throws).collect();
        // The throws of one direction may all be without it.
        let are_enough = !departures.is_empty() && 2 * departures.len() >= throws.min(self.recent.len());
        are_enough.then_some(departures)
    }

    /// Error of the published supply voltage. Resistance and back-EMF constant are computed from it and have the same error,
    /// and the no-load speed is not: the voltage changed, and the speed did not follow. A voltage that is not changed, but
    /// should be, as with a sensor that is stuck, has the same error in both too, beyond what heat does to a resistance.
    /// Weaker magnets do not change the resistance, and draw more current; a motor with another winding too. The level is
    /// that of the last few throws; the longer window must show it too.
    pub(super) fn voltage_error(&self) -> Option<Level> {
        self.voltage_error_in(WINDOWS[1]).and_then(|_| self.voltage_error_in(WINDOWS[0]))
    }

    /// Size of the back-EMF, in which an error of the voltage shows, relative to the least error that is named; `None` if it
    /// is unknown.
    pub(super) fn voltage_error_size(&self) -> Option<f64> {
        let [back_emf, ohms] = [Gauge::BackEmf, Gauge::Resistance].map(|gauge| self.level(gauge, WINDOWS[0]));
        Some(error_size(back_emf?, ohms?))
    }

    /// The same over the last `throws`.
    pub(super) fn voltage_error_in(&self, throws: usize) -> Option<Level> {
        let level = |gauge| self.level(gauge, throws);
        let (back_emf, ohms, volts) = (level(Gauge::BackEmf)?, level(Gauge::Resistance)?, level(Gauge::Volts)?);
        let is_like = |of: f64, sd: f64| (of - back_emf.value).abs() < ALIKE * back_emf.value.abs() + sd;
        let size = back_emf.value.abs();
        let is_shown = error_size(back_emf, ohms) > 1.0 && is_like(ohms.value, 0.0);
        let is_alone = is_like(volts.value, volts.sd) || size.min(ohms.value.abs()) > heat(HEATED_K + WEATHER_K);
        let running = level(Gauge::Running).map_or(0.0, |running| running.value.abs() - running.sd);
        (is_shown && is_alone && running < ALIKE * size).then_some(back_emf)
    }

    /// Change of the resistance between supply and motor that heat does not explain; `knows_weather`: the resistance is
    /// known at the temperature of the air. The level is that of the last few throws; the longer window must show it too, so
    /// that a single throw does not. A wrong voltage explains it. `None` if it is unknown.
    pub(super) fn circuit(&self, knows_weather: bool) -> Option<Circuit> {
        let [level, longer] = [WINDOWS[0], WINDOWS[1]].map(|throws| self.level(Gauge::Resistance, throws));
        let (level, longer) = (level?, longer?);
        let heat = heat(HEATED_K + if knows_weather { 0.0 } else { WEATHER_K });
        let is_motor =
            self.level(Gauge::BackEmf, WINDOWS[0]).is_none_or(|own| own.value.abs() > ALIKE * level.value.abs());
        let size_of = |level: Level| level.value.abs() / heat.max(CIRCUIT_SD * level.sd);
        let size = if self.voltage_error().is_some() { 0.0 } else { size_of(level).min(size_of(longer)) };
        // The inrush, V/R at most, follows the resistance, and not an error of the position, from which the resistance is computed.
        let [volts, inrush] = [Gauge::Volts, Gauge::Inrush].map(|gauge| self.level(gauge, WINDOWS[1]));
        let is_inrush_as_before = volts.zip(inrush).is_some_and(|(volts, inrush)| {
            let lower = (volts.value - inrush.value) * longer.value.signum();
            lower < INRUSH_OF_OHMS * longer.value.abs() - inrush.sd
        });
        // An elastic drive turns otherwise than the toe.
        let idle = self.level(Gauge::StartDelay, WINDOWS[1]).map_or(0.0, |delay| OHMS_OF_DELAY * delay.value.abs());
        let is_idle = idle > ALIKE * level.value.abs();
        let is_measured = CIRCUIT_SD * level.sd < CIRCUIT_UNCERTAINTY;
        is_measured.then_some(Circuit { level, size, is_doubtful: is_motor || is_idle || is_inrush_as_before })
    }

    /// Offset of a sensor and its size relative to the least one that is named. The level is that of the last few throws; the
    /// longer window must show it too.
    pub(super) fn offset(&self, sensor: Offset) -> Option<(Level, f64)> {
        let [level, longer] = [WINDOWS[0], WINDOWS[1]].map(|throws| self.offset_in(sensor, throws));
        let (level, longer) = (level?, longer?);
        Some((level.0, level.1.min(longer.1)))
    }

    /// The same over the last `throws`.
    fn offset_in(&self, sensor: Offset, throws: usize) -> Option<(Level, f64)> {
        let (level, least) = match sensor {
            Offset::Current => {
                let level = self.level(Gauge::Rest, throws)?;
                (level, self.least_rest_a().max(REST_SD * level.sd))
            }
            Offset::Position => {
                let [level, travel] = [Gauge::Middle, Gauge::Travel].map(|gauge| self.level(gauge, throws));
                let (level, changed, travel_mm) = (level?, travel?.value, self.normal_travel_mm()?);
                // With another travel an end of the movement is elsewhere, or the gain of the sensor has changed.
                let is_shift = (travel_mm * changed).abs() < level.value.abs();
                let least = if is_shift { SHIFT_SHARE * travel_mm } else { f64::INFINITY };
                (level, least.max(SHIFT_SD * level.sd))
            }
        };
        Some((level, level.value.abs() / least))
    }

    /// Shift of the position at the normal end, as part of the travel, if the position sensor was moved or set anew, so that both
    /// ends read otherwise. An obstruction changes one end. `None` if it is small, or unknown.
    pub(super) fn shift(&self, direction: Direction, features: &Features) -> Option<f64> {
        let (normal, values) = (&self.sides[direction.side()], values(features, None));
        let [now, before] = [values[Gauge::Middle as usize]?, normal.of(Gauge::Middle)?.0].map(f64::from);
        let [travel_mm, usual_mm] =
            [values[Gauge::Travel as usize]?, normal.of(Gauge::Travel)?.0].map(|ln| f64::from(ln).exp());
        let [middle, half] = [now - before, (travel_mm - usual_mm) / 2.0];
        let ends = [middle - half, middle + half];
        let is_other = ends.iter().all(|change_mm| change_mm.abs() > END_SHARE * usual_mm);
        (is_other && ends[0].abs() > SHIFT_SHARE * usual_mm).then_some(ends[0] / travel_mm)
    }

    /// Largest normal delay of the start \[ms\]: that of an unlocking stroke, or of play and an elastic drive.
    pub(super) fn normal_delay_ms(&self) -> f64 {
        let normal = self.sides.iter().filter_map(|side| side.of(Gauge::StartDelay));
        normal.map(|(centre, _)| f64::from(centre).abs()).fold(0.0, f64::max)
    }

    fn normal_travel_mm(&self) -> Option<f64> {
        self.sides.iter().find_map(|side| side.of(Gauge::Travel)).map(|(centre, _)| f64::from(centre).exp())
    }

    /// Normal current at rest \[A\], if it is as large as a change that is named.
    pub(super) fn normal_rest_a(&self) -> Option<f64> {
        let normal = self.sides.iter().filter_map(|side| side.of(Gauge::Rest)).map(|(centre, _)| f64::from(centre));
        normal.max_by(|a, b| a.abs().total_cmp(&b.abs())).filter(|normal| normal.abs() > self.least_rest_a())
    }

    /// Least change of the current at rest that is named \[A\].
    fn least_rest_a(&self) -> f64 {
        let inrush = self.sides.iter().filter_map(|side| side.of(Gauge::Inrush)).map(|(centre, _)| f64::from(centre));
        REST_A.max(REST_SHARE * inrush.map(f64::exp).fold(0.0, f64::max))
    }

    /// Change of the back-EMF: from its constant, without a supply voltage from the no-load speed, and without both, as with
    /// a stroke that unlocks, from a shorter duration.
    pub(super) fn back_emf(&self, throws: usize) -> Option<BackEmf> {
        let of_speed = || self.level(Gauge::NoLoadSpeed, throws).map(|Level { value, sd }| Level { value: -value, sd });
        let of_constant = self.level(Gauge::BackEmf, throws).filter(|_| self.voltage_error().is_none());
        let shown = of_constant.or_else(of_speed);
        let of_duration = || self.level(Gauge::Duration, throws).filter(|level| level.value < -SHORTER_SD * level.sd);
        let level = shown.or_else(of_duration)?;
        Some(BackEmf { level, of_duration: shown.is_none() })
    }

    /// Deletes the last throws.
    pub(super) fn forget_recent(&mut self) {
        self.recent.clear();
    }
}

/// Standard deviation of the mean departure of `count` throws from the normal value of `gauge`; `sd` is that of one
/// throw.
pub(super) fn sd_of_mean(gauge: Gauge, sd: f64, count: f64) -> f64 {
    (CORRELATED * sd * (1.0 / count + 1.0 / LEARNED.0 as f64).sqrt()).hypot(gauge.floor())
}

/// Size of an error of the voltage relative to the least one that is named.
fn error_size(back_emf: Level, ohms: Level) -> f64 {
    back_emf.value.abs() / VOLTAGE_ERROR.max(VOLTAGE_ERROR_SD * back_emf.sd.max(ohms.sd))
}

impl Normal {
    /// Centre and standard deviation of a gauge.
    fn of(&self, gauge: Gauge) -> Option<(f32, f32)> {
        self.known[gauge as usize]
    }

    /// How much slower supply voltage and resistance of a throw make the motor, as a logarithm. The speed is (V - R i)/K; of the
    /// normal voltage the resistance takes the part s = R i/V, so the speed changes by (V/V0 - s R/R0)/(1 - s). The current
    /// is the normal one, as before a dry load; before a viscous load it follows the speed, and the change is smaller. If
    /// the resistance is unknown, the inrush, at most V/R, gives an upper bound of s. No change if the voltage is unknown.
    fn supplied(&self, values: &Values) -> Supplied {
        let change = |gauge: Gauge| Some(values[gauge as usize]? - self.of(gauge)?.0);
        let centre = |gauge: Gauge| self.of(gauge).map(|(centre, _)| centre);
        let of_resistance = || Some(centre(Gauge::Resistance)? + centre(Gauge::Running)? - centre(Gauge::Volts)?);
        let of_inrush = || Some(centre(Gauge::Running)? - centre(Gauge::Inrush)?);
        let share = of_resistance().or_else(of_inrush).map_or(0.0, f32::exp).min(LARGEST_SHARE);
        change(Gauge::Volts).map_or(Supplied::default(), |volts| {
            let ohms = change(Gauge::Resistance).unwrap_or_default();
            let speed = ((volts.exp() - share * ohms.exp()) / (1.0 - share)).max(LEAST_SPEED);
            Supplied { slower: -speed.ln(), inrush: volts - ohms }
        })
    }

    fn learn(&mut self, values: Values) {
        for (at, value) in values.into_iter().enumerate() {
            let is_final = self.known[at].is_some() && self.learned.get(at).is_none_or(Vec::is_empty);
            let Some(value) = value.filter(|_| !is_final) else { continue };
            self.learned.resize(Gauge::COUNT, Vec::new());
            let learned = &mut self.learned[at];
            learned.push(value);
            if learned.len() >= LEARNED.0 {
                let values: Vec<f64> = learned.iter().copied().map(f64::from).collect();
                let (centre, sd) = centre_and_sd(&values);
                // Without a toe sensor, at 25 Hz, half of the throws have no sample of the inrush in their charge.
                let sd = sd.max(skewed_sd(&values, centre));
                #[expect(clippy::cast_possible_truncation, reason = "the values are rounded more")]
                let known = (centre as f32, sd as f32);
                self.known[at] = Some(known);
            }
            if learned.len() >= LEARNED.1 {
                *learned = Vec::new();
            }
        }
        if self.learned.iter().all(Vec::is_empty) {
            self.learned = Vec::new();
        }
    }
}

/// Change of the logarithm of a resistance by a temperature.
fn heat(kelvin: f64) -> f64 {
    (COPPER.0 * kelvin).ln_1p()
}

/// The gauges of a throw, as logarithms except for the delay of the start \[ms\], the current at rest \[A\], the middle \[mm\]
/// and the temperature \[°C\].
fn values(features: &Features, celsius: Option<f64>) -> Values {
    let warm = celsius.map_or(1.0, |celsius| 1.0 + COPPER.0 * (celsius - COPPER.1));
    let ln = |value: Option<f64>| value.map(f64::ln);
    let shown = [
        ln(features.travel_mm),
        ln(features.back_emf_v_s_per_rad),
        ln(features.resistance_ohm.map(|ohm| ohm / warm)),
        ln(features.duration_s),
        ln(features.supply_v),
        ln(features.peak_current_a),
        ln(features.running_current_a),
        ln(features.charge_as),
        ln(features.no_load_speed_rad_per_s),
        features.start_delay_s.map(|delay_s| 1e3 * delay_s),
        ln(features.start_gain),
        features.quiet_current_a,
        features.start_position_mm.zip(features.end_position_mm).map(|(start, end)| f64::midpoint(start, end)),
        celsius,
    ];
    // Rounded to 1e-4, below any relevant scatter, to keep the snapshot small.
    #[expect(clippy::cast_possible_truncation, reason = "rounded anyway")]
    let rounded = |value: f64| ((1e4 * value).round() / 1e4) as f32;
    shown.map(|value| value.map(rounded).filter(|value| value.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const NORMAL: Direction = Direction::NormalToReverse;

    /// 5 A through 0.9 Ω take 4.5 of 36 V, so the speed follows V - 4.5 V.
    fn features(supply_v: f64, duration_s: f64, resistance_ohm: Option<f64>) -> Features {
        Features {
            supply_v: Some(supply_v),
            duration_s: Some(duration_s),
            resistance_ohm,
            running_current_a: Some(5.0),
            peak_current_a: Some(30.0),
            ..Features::default()
        }
    }

    #[test]
    fn the_field_of_magnets_follows_a_published_temperature() {
        let learned = |celsius: Option<f64>| {
            let mut gauges = Gauges::default();
            for _ in 0..LEARNED.1 {
                let features = Features { back_emf_v_s_per_rad: Some(4.0), ..features(36.0, 7.0, Some(0.9)) };
                gauges.push(NORMAL, &features, celsius, false);
            }
            gauges
        };
        for per_k in [0.0_f64, -0.001, -0.002] {
            let mut gauges = learned(Some(0.0));
            for _ in 0..WINDOWS[1] {
                let warm = Features { back_emf_v_s_per_rad: Some(4.0 * (1.0 + 25.0 * per_k)), ..Features::default() };
                gauges.push(NORMAL, &warm, Some(25.0), false);
            }
            let level = gauges.level(Gauge::BackEmf, WINDOWS[1]).unwrap();
            assert!(level.value.abs() < 2.0 * level.sd && level.sd < 0.03, "{per_k} per K: {level:?}");
        }
        let mut gauges = learned(None);
        gauges.push(NORMAL, &Features { back_emf_v_s_per_rad: Some(3.8), ..Features::default() }, None, false);
        let level = gauges.level(Gauge::BackEmf, WINDOWS[0]).unwrap();
        assert!(level.sd < 0.01, "without a temperature nothing is known about its effect: {level:?}");
    }

    #[test]
    fn a_resistance_that_scatters_much_is_not_judged() {
        for (scatter, is_judged) in [(0.02_f64, true), (0.3, false)] {
            let mut gauges = Gauges::default();
            let mut push = |ohm: f64| {
                let features = Features { back_emf_v_s_per_rad: Some(4.0), ..features(36.0, 7.0, Some(ohm)) };
                gauges.push(NORMAL, &features, None, false);
            };
            for at in 0..LEARNED.1 {
                push(0.9 * if at % 2 == 0 { scatter.exp() } else { (-scatter).exp() });
            }
            for _ in 0..WINDOWS[1] {
                push(18.0);
            }
            assert_eq!(gauges.circuit(true).is_some_and(|circuit| circuit.size > 1.0), is_judged, "{scatter}");
        }
    }

    #[test]
    fn a_voltage_explains_a_duration_up_to_that_of_the_back_emf() {
        for (ohm, longest) in
            [(Some(0.9), (36.0 - 4.5) / (30.0 - 4.5)), (None, (1.0 - 5.0 / 30.0) / (30.0 / 36.0 - 5.0 / 30.0))]
        {
            let mut gauges = Gauges::default();
            for _ in 0..LEARNED.0 {
                gauges.push(NORMAL, &features(36.0, 7.0, ohm), None, false);
            }
            for (factor, rest) in [
                (1.0, 0.0),
                (longest, 0.0),
                (1.2 * longest, 1.2_f64.ln()),
                // A shorter throw is not the effect of a lower voltage.
                (0.9, 0.9_f64.ln()),
            ] {
                let throw = features(30.0, 7.0 * factor, ohm);
                let [found] = gauges.unexplained([Gauge::Duration], NORMAL, &throw, None);
                let found = f64::from(found.unwrap().0);
                assert!((found - rest).abs() < 1e-3, "{ohm:?}, {factor}: {found}");
            }
        }
    }
}
