//! The normal values of the gauges in a direction, and the effect of a changed supply on them.

use serde::{Deserialize, Serialize};

use super::{Gauge, Values, values};
use crate::{
    diagnose::statistics::{centre_and_sd, skewed_sd, to_f32},
    estimate::Features,
};

/// Number of values from which the normal value of a gauge in a direction is used, and number from which it is fixed.
pub(super) const LEARNED: (usize, usize) = (12, 24);
/// Least reported change of the current at rest \[A\]: the zero of a Hall sensor drifts by 0.1 to 0.3 A from cold to
/// warm, and back.
const REST_A: f64 = 0.6;
/// Least reported change of the current at rest, as part of the inrush: the zero of a sensor drifts in proportion to
/// its range.
const REST_SHARE: f64 = 0.02;
/// Departure of the current at rest that is no part of its normal value: as part of the least change that is reported,
/// and in standard deviations.
const OFFSET_SHARE: f64 = 0.5;
const OFFSET_SD: f32 = 4.0;
/// Largest part of the normal voltage that drops across the resistance: with more, the motor would be near its stall.
const LARGEST_SHARE: f32 = 0.6;
/// Least speed with a changed supply, as part of the normal speed; it bounds a logarithm.
const LEAST_SPEED: f32 = 0.1;
/// Largest change of the logarithm of the running current with the temperature \[1/K\]: -0.6 % per K on two independent
/// drives.
const CURRENT_PER_K: f32 = -0.008;
/// Factor on the standard deviation of a mean, as consecutive throws are correlated: √((1 + 0.5) / (1 - 0.5)) for a
/// correlation of 0.5.
const CORRELATED: f64 = 1.7;

/// Normal values of a direction: centre and standard deviation of each gauge.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Normal {
    /// The values of each gauge while its normal value is learned; empty if there are none.
    learned: Vec<Vec<f32>>,
    known: [Option<(f32, f32)>; Gauge::COUNT],
}

/// The effects of a changed supply on a throw, as logarithms.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Supplied {
    /// Decrease of the speed of the motor.
    slower: f32,
    /// Change of the inrush, V/R.
    inrush: f32,
}

impl Supplied {
    /// Range of the change of a gauge that the supply explains, as logarithms. With a dry load the running current does
    /// not depend on the speed; with a viscous load it follows the speed. The charge is that of the inrush and of the
    /// running motor.
    pub(super) fn range(self, gauge: Gauge) -> [f32; 2] {
        let Self { slower, inrush } = self;
        let [from, to] = match gauge {
            Gauge::Duration => [0.0, slower],
            Gauge::Running => [0.0, -slower],
            Gauge::Charge => [inrush, slower],
            _ => [0.0, 0.0],
        };
        [from.min(to).min(0.0), from.max(to).max(0.0)]
    }
}

impl Normal {
    /// Centre and standard deviation of a gauge.
    pub(super) fn of(&self, gauge: Gauge) -> Option<(f32, f32)> {
        self.known[gauge as usize]
    }

    /// The gauges of a throw. A temperature that is published only after the normal values were learned says nothing
    /// about the weather in which they were, so it is not used.
    pub(super) fn values(&self, features: &Features, celsius: Option<f64>) -> Values {
        let has_air =
            self.of(Gauge::Air).is_some() || self.learned.get(Gauge::Air as usize).is_some_and(|air| !air.is_empty());
        values(features, celsius.filter(|_| has_air || self.of(Gauge::Running).is_none()))
    }

    /// Number of throws from which the normal value of a gauge is learned so far, and the number that it needs.
    pub(super) fn progress(&self, gauge: Gauge) -> (usize, usize) {
        let so_far = || self.learned.get(gauge as usize).map_or(0, Vec::len);
        (if self.of(gauge).is_some() { LEARNED.0 } else { so_far() }, LEARNED.0)
    }

    /// The effects of supply voltage and resistance of a throw. With the voltage V, the resistance R, the current i and
    /// the back-EMF constant K, the speed is (V - R i)/K. Of the normal voltage V0, the normal resistance R0 takes the
    /// part s = R0 i/V0, so the speed changes by the factor (V/V0 - s R/R0)/(1 - s). Here the current is the normal
    /// one, as with a dry load; with a viscous load it follows the speed, and the change is smaller. If the resistance
    /// is unknown, the inrush, at most V/R, gives an upper bound of s. No effect if the voltage is unknown.
    pub(super) fn supplied(&self, values: &Values) -> Supplied {
        let change = |gauge: Gauge| Some(values[gauge as usize]? - self.of(gauge)?.0);
        let centre = |gauge: Gauge| self.of(gauge).map(|(centre, _)| centre);
        let of_resistance = || Some(centre(Gauge::Resistance)? + centre(Gauge::Running)? - centre(Gauge::Volts)?);
        let of_inrush = || Some(centre(Gauge::Running)? - centre(Gauge::Inrush)?);
        let share = of_resistance().or_else(of_inrush).map_or(0.0, f32::exp).min(LARGEST_SHARE);
        change(Gauge::Volts).map_or(Supplied::default(), |volts| {
            // Without K, as for a series-wound motor, the speed at another resistance is unknown.
            let ohms = change(Gauge::BackEmf).and_then(|_| change(Gauge::Resistance)).unwrap_or_default();
            let speed = ((volts.exp() - share * ohms.exp()) / (1.0 - share)).max(LEAST_SPEED);
            Supplied { slower: -speed.ln(), inrush: volts - ohms }
        })
    }

    /// Largest change of a gauge that the published temperature explains, as a logarithm: the drive needs more current
    /// in the cold.
    pub(super) fn of_weather(&self, gauge: Gauge, values: &Values) -> f32 {
        let warmer_k = values[Gauge::Air as usize].zip(self.of(Gauge::Air)).map_or(0.0, |(now, (then, _))| now - then);
        if gauge.follows_weather() { CURRENT_PER_K * warmer_k } else { 0.0 }
    }

    pub(super) fn learn(&mut self, values: Values) {
        let inrush_a = self.of(Gauge::Inrush).map_or(0.0, |(centre, _)| f64::from(centre.exp()));
        let offset_a = to_f32(OFFSET_SHARE * least_rest_a(inrush_a));
        for (at, value) in values.into_iter().enumerate() {
            let is_final = self.known[at].is_some() && self.learned.get(at).is_none_or(Vec::is_empty);
            let Some(value) = value.filter(|_| !is_final) else { continue };
            self.learned.resize(Gauge::COUNT, Vec::new());
            let is_rest = at == Gauge::Rest as usize;
            // The zero of a sound sensor hardly moves. A step while its normal value is learned would count as scatter.
            let is_offset = |(centre, sd): (f32, f32)| is_rest && (value - centre).abs() > offset_a.max(OFFSET_SD * sd);
            if self.known[at].is_some_and(is_offset) {
                continue;
            }
            let learned = &mut self.learned[at];
            learned.push(value);
            if learned.len() >= LEARNED.0 {
                let values: Vec<f64> = learned.iter().copied().map(f64::from).collect();
                let (centre, sd) = centre_and_sd(&values);
                // On a machine without a toe sensor, sampled at 25 Hz, the charge of half of the throws contains no
                // sample of the inrush.
                let sd = if is_rest { sd } else { sd.max(skewed_sd(&values, centre)) };
                self.known[at] = Some((to_f32(centre), to_f32(sd)));
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

/// Least change of the current at rest that is reported \[A\], with this inrush.
pub(super) fn least_rest_a(inrush_a: f64) -> f64 {
    REST_A.max(REST_SHARE * inrush_a)
}

/// Standard deviation of the mean departure of `count` throws from the normal value of `gauge`; `sd` is that of one
/// throw.
pub(crate) fn sd_of_mean(gauge: Gauge, sd: f64, count: f64) -> f64 {
    (CORRELATED * sd * (1.0 / count + 1.0 / LEARNED.0 as f64).sqrt()).hypot(gauge.floor())
}
