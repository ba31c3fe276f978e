//! What a throw shows beside its coefficients: travel, back-EMF constant, resistance, duration, voltage and inrush, each as its
//! logarithm's departure from what is normal for the direction. Sensors, clock and supply move them in other ways than parts do.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::{robust::centre_and_sd, threshold::WINDOWS};
use crate::{estimate::Features, throw::Direction};

/// What is gauged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Gauge {
    Travel,
    BackEmf,
    Resistance,
    Duration,
    Volts,
    /// The largest current: the supply over the resistance, nearly.
    Inrush,
}

impl Gauge {
    const COUNT: usize = 6;

    /// Least standard deviation of a level: sampling, adjustment and warmth move a gauge by this much with nothing wrong.
    fn floor(self) -> f64 {
        match self {
            Self::Travel => 0.003,
            Self::BackEmf => 0.005,
            Self::Resistance | Self::Duration | Self::Volts => 0.01,
            Self::Inrush => 0.02,
        }
    }
}

/// Throws of a direction from which its normal is known, and after which it stays.
const LEARNED: (usize, usize) = (12, 24);
/// Throws of both directions that a level is taken over at most.
const RECENT: usize = WINDOWS[2];
/// Change of copper's resistance with temperature \[1/K\], and the temperature that it is brought to \[°C\].
const COPPER: (f64, f64) = (0.0039, 20.0);
/// Standard deviation of a mean of correlated throws over that of independent ones, at a correlation of 0.5.
const CORRELATED: f64 = 1.7;

/// Logarithms of one throw, `None` where it does not show them.
type Values = [Option<f32>; Gauge::COUNT];

/// How far the last throws are from normal, as a logarithm, with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Level {
    pub(super) value: f64,
    pub(super) sd: f64,
}

/// What is normal for one direction: centre and standard deviation of each gauge.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct Normal {
    /// Each gauge's values that it is learned from; empty once it is.
    learned: [Vec<f32>; Gauge::COUNT],
    throws: usize,
    known: [Option<(f32, f32)>; Gauge::COUNT],
}

/// Side and gauges that a throw shows, as bits, and their values: a throw without most gauges takes little room.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Shown(u8, Vec<f32>);

impl Shown {
    fn new(side: usize, values: Values) -> Self {
        let bits = (0..Gauge::COUNT).filter(|at| values[*at].is_some()).fold(side, |bits, at| bits | (2 << at));
        Self(u8::try_from(bits).unwrap_or_default(), values.into_iter().flatten().collect())
    }

    fn side(&self) -> usize {
        usize::from(self.0 & 1)
    }

    fn value(&self, gauge: Gauge) -> Option<f32> {
        let bit = 2 << gauge as u8;
        let before = (self.0 & (bit - 1) & !1).count_ones();
        if self.0 & bit == 0 { None } else { self.1.get(before as usize).copied() }
    }
}

/// The gauges of one machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Gauges {
    sides: [Normal; 2],
    /// The last throws, newest last.
    recent: VecDeque<Shown>,
}

impl Gauges {
    /// Takes in a throw; one of a `suspicious` machine is no example of what is normal.
    pub(super) fn push(&mut self, direction: Direction, features: &Features, celsius: Option<f64>, suspicious: bool) {
        let warm = celsius.map_or(1.0, |celsius| 1.0 + COPPER.0 * (celsius - COPPER.1));
        let resistance = features.resistance_ohm.map(|ohm| ohm / warm);
        let shown = [
            features.travel_mm,
            features.back_emf_v_s_per_rad,
            resistance,
            features.duration_s,
            features.supply_v,
            features.peak_current_a,
        ];
        // Rounded to 1e-4, below any scatter that counts, so that the state stays small.
        #[expect(clippy::cast_possible_truncation, reason = "rounded anyway")]
        let rounded = |value: f64| ((1e4 * value.ln()).round() / 1e4) as f32;
        let values = shown.map(|value| value.map(rounded).filter(|ln| ln.is_finite()));
        let side = usize::from(direction == Direction::ReverseToNormal);
        if !suspicious {
            self.sides[side].learn(values);
        }
        self.recent.push_back(Shown::new(side, values));
        if self.recent.len() > RECENT {
            self.recent.pop_front();
        }
    }

    /// Where a gauge is over the last `throws`; `None` where it is not known, or what is normal is not.
    pub(super) fn level(&self, gauge: Gauge, throws: usize) -> Option<Level> {
        let departures: Vec<(f64, f64)> = self
            .recent
            .iter()
            .rev()
            .take(throws)
            .filter_map(|shown| {
                let (centre, sd) = self.sides[shown.side()].known[gauge as usize]?;
                Some((f64::from(shown.value(gauge)? - centre), f64::from(sd)))
            })
            .collect();
        let count = departures.len() as f64;
        let mean = |values: fn(&(f64, f64)) -> f64| departures.iter().map(values).sum::<f64>() / count;
        (2 * departures.len() > throws.min(self.recent.len())).then(|| {
            let spread = CORRELATED * mean(|(_, sd)| *sd);
            let learned = spread * (1.0 / count + 1.0 / LEARNED.0 as f64).sqrt();
            Level { value: mean(|(value, _)| *value), sd: learned.hypot(gauge.floor()) }
        })
    }

    /// Forgets the last throws.
    pub(super) fn forget_recent(&mut self) {
        self.recent.clear();
    }
}

impl Normal {
    fn learn(&mut self, values: Values) {
        if self.throws >= LEARNED.1 {
            return;
        }
        self.throws += 1;
        for (at, value) in values.into_iter().enumerate() {
            self.learned[at].extend(value);
            if self.learned[at].len() >= LEARNED.0 {
                let (centre, sd) = centre_and_sd(&self.learned[at].iter().copied().map(f64::from).collect::<Vec<_>>());
                #[expect(clippy::cast_possible_truncation, reason = "the values are rounded more")]
                let known = (centre as f32, sd as f32);
                self.known[at] = Some(known);
            }
        }
        if self.throws >= LEARNED.1 {
            self.learned = Default::default();
        }
    }
}
