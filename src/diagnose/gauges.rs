//! Gauges: quantities of a throw beside the coefficients (travel, back-EMF constant, resistance, duration, voltage,
//! inrush, running current, charge, no-load speed, start). Each is used as the logarithm of its ratio to the normal value of
//! the direction, except for the delay of the start. Errors of sensors, clock and supply change the gauges in other ways than faults of parts do, which
//! distinguishes the two.

use serde::{Deserialize, Deserializer, Serialize};

use super::{last::Last, robust::centre_and_sd, threshold::WINDOWS};
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
}

impl Gauge {
    const COUNT: usize = 11;

    /// Least standard deviation of a level: the effect of sampling, adjustment and temperature on a healthy machine.
    pub(super) fn floor(self) -> f64 {
        match self {
            Self::Travel => 0.003,
            Self::BackEmf => 0.005,
            Self::Resistance | Self::Duration | Self::Volts | Self::NoLoadSpeed => 0.01,
            Self::Inrush | Self::Running | Self::Charge | Self::StartGain => 0.02,
            Self::StartDelay => 0.2,
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

/// Change of the back-EMF of the motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BackEmf {
    pub(super) level: Level,
    /// Whether it is only that of the duration, which less friction shortens too.
    pub(super) of_duration: bool,
}

/// A changed gauge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Change {
    pub(super) gauge: Gauge,
    /// Median change of the last throws, as a logarithm, and its standard deviation.
    pub(super) size: f64,
    pub(super) size_sd: f64,
}

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

    /// Departures of some gauges of this throw from normal, as logarithms, with the standard deviation of one throw;
    /// `None` if the gauge or its normal value is unknown.
    pub(super) fn departures<const N: usize>(
        &self,
        gauges: [Gauge; N],
        direction: Direction,
        features: &Features,
    ) -> [Option<(f32, f32)>; N] {
        let (normal, values) = (&self.sides[direction.side()], values(features, None));
        gauges.map(|gauge| {
            let (centre, sd) = normal.of(gauge)?;
            Some((values[gauge as usize]? - centre, sd))
        })
    }

    /// Level of a gauge over the last `throws` that show it; `None` if hardly any do, or its normal value is unknown.
    pub(super) fn level(&self, gauge: Gauge, throws: usize) -> Option<Level> {
        let departures: Vec<(f64, f64)> = self
            .recent
            .iter()
            .rev()
            .filter_map(|shown| {
                let (centre, sd) = self.sides[shown.side()].of(gauge)?;
                Some((f64::from(shown.value(gauge)? - centre), f64::from(sd)))
            })
            .take(throws)
            .collect();
        let count = departures.len() as f64;
        let mean = |values: fn(&(f64, f64)) -> f64| departures.iter().map(values).sum::<f64>() / count;
        (2 * departures.len() > throws.min(self.recent.len()))
            .then(|| Level { value: mean(|(value, _)| *value), sd: sd_of_mean(gauge, mean(|(_, sd)| *sd), count) })
    }

    /// Change of the back-EMF: from its constant, without a supply voltage from the no-load speed, and without both, as with
    /// a stroke that unlocks, from a shorter duration.
    pub(super) fn back_emf(&self, throws: usize) -> Option<BackEmf> {
        let of_speed = || self.level(Gauge::NoLoadSpeed, throws).map(|Level { value, sd }| Level { value: -value, sd });
        let shown = self.level(Gauge::BackEmf, throws).or_else(of_speed);
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

impl Normal {
    /// Centre and standard deviation of a gauge.
    fn of(&self, gauge: Gauge) -> Option<(f32, f32)> {
        self.known[gauge as usize]
    }

    fn learn(&mut self, values: Values) {
        for (at, value) in values.into_iter().enumerate() {
            let is_final = self.known[at].is_some() && self.learned.get(at).is_none_or(Vec::is_empty);
            let Some(value) = value.filter(|_| !is_final) else { continue };
            self.learned.resize(Gauge::COUNT, Vec::new());
            let learned = &mut self.learned[at];
            learned.push(value);
            if learned.len() >= LEARNED.0 {
                let (centre, sd) = centre_and_sd(&learned.iter().copied().map(f64::from).collect::<Vec<_>>());
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

/// The gauges of a throw, as logarithms except for the delay of the start.
fn values(features: &Features, celsius: Option<f64>) -> Values {
    let warm = celsius.map_or(1.0, |celsius| 1.0 + COPPER.0 * (celsius - COPPER.1));
    let shown = [
        features.travel_mm,
        features.back_emf_v_s_per_rad,
        features.resistance_ohm.map(|ohm| ohm / warm),
        features.duration_s,
        features.supply_v,
        features.peak_current_a,
        features.running_current_a,
        features.charge_as,
        features.no_load_speed_rad_per_s,
        features.start_delay_s.map(|delay_s| (1e3 * delay_s).exp()),
        features.start_gain,
    ];
    // Rounded to 1e-4, below any relevant scatter, to keep the snapshot small.
    #[expect(clippy::cast_possible_truncation, reason = "rounded anyway")]
    let rounded = |value: f64| ((1e4 * value.ln()).round() / 1e4) as f32;
    shown.map(|value| value.map(rounded).filter(|ln| ln.is_finite()))
}
