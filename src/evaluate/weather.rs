//! Weather of a life: the temperature with its effect on the coefficients, and wet spells.

use nalgebra::Vector3;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// Throws of a machine per day.
pub(super) const THROWS_A_DAY: usize = 20;

/// Change of ln b0, ln a1 and ln a0 per kelvin: warmth weakens the magnets, thins the grease, and lowers the stiffness
/// of the rails, which are under thermal thrust.
const PER_KELVIN: [f64; 3] = [-0.0015, -0.008, -0.001];
/// Mean temperature of a swing \[°C\]; the coefficients are nominal at this temperature.
const MEAN_C: f64 = 12.0;
/// Period of a fast swing \[throws\].
pub(super) const SWING_THROWS: usize = 240;
/// Seasonal and daily amplitude of a fast swing \[K\].
const SWING_K: [f64; 2] = [12.0, 3.0];
/// Period of a year \[throws\].
const YEAR_THROWS: usize = 365 * THROWS_A_DAY;
/// Seasonal and daily amplitude over a year \[K\].
const YEAR_K: [f64; 2] = [20.0, 3.0];
/// Temperature in winter and in summer \[°C\].
const SEASONS_C: [f64; 2] = [-10.0, 29.0];
/// Daily amplitude in winter and in summer \[K\].
const SEASONS_DAY_K: f64 = 2.0;
/// Throws from winter to summer: 30 days, faster than real weather, but long enough to learn the effect.
pub(super) const SEASON_THROWS: usize = 600;

/// Temperature over the throws of a life.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Course {
    /// A sine over `period` throws plus one over a day, with these amplitudes \[K\] and the same phase \[turns\].
    Swing { period: usize, amplitudes: [f64; 2], phase: f64 },
    /// Winter until throw `from`, then a rise to summer.
    Summer { from: usize },
}

/// A varying temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Climate {
    course: Course,
    /// Whether the throws publish the temperature.
    pub(super) measured: bool,
}

impl Climate {
    /// A swing over days, with a random phase.
    pub(super) fn swing(measured: bool, random: &mut ChaCha8Rng) -> Self {
        let course = Course::Swing { period: SWING_THROWS, amplitudes: SWING_K, phase: random.random() };
        Self { course, measured }
    }

    /// A swing over a year, with a random phase, not measured.
    pub(super) fn year(random: &mut ChaCha8Rng) -> Self {
        let course = Course::Swing { period: YEAR_THROWS, amplitudes: YEAR_K, phase: random.random() };
        Self { course, measured: false }
    }

    /// Winter until throw `from`, then a rise to summer over [`SEASON_THROWS`] throws; measured.
    pub(super) fn summer(from: usize) -> Self {
        Self { course: Course::Summer { from }, measured: true }
    }

    /// Temperature at throw `at` \[°C\].
    pub(super) fn temperature_c(self, at: usize) -> f64 {
        let turn = |period: usize, phase: f64| (std::f64::consts::TAU * (at as f64 / period as f64 + phase)).sin();
        match self.course {
            Course::Swing { period, amplitudes: [season, day], phase } => {
                MEAN_C + season * turn(period, phase) + day * turn(THROWS_A_DAY, phase)
            }
            Course::Summer { from } => {
                let part = (at.saturating_sub(from) as f64 / SEASON_THROWS as f64).min(1.0);
                let [winter, summer] = SEASONS_C;
                let warmed = 0.5 * (1.0 - (std::f64::consts::PI * part).cos());
                winter + (summer - winter) * warmed + SEASONS_DAY_K * turn(THROWS_A_DAY, 0.0)
            }
        }
    }

    /// Change of (ln b0, ln a1, ln a0) at throw `at`.
    pub(super) fn displacement(self, at: usize) -> Vector3<f64> {
        Vector3::from(PER_KELVIN) * (self.temperature_c(at) - MEAN_C)
    }
}

/// Throws in a wet spell.
const WET_THROWS: usize = 15;
/// Change of the friction in a wet spell, as a fraction of nominal.
const WET_FRICTION: f64 = -0.20;
/// Range of the random number of throws between two wet spells: 20 days in the mean.
const DRY_THROWS: std::ops::Range<usize> = 0..800;

/// Wet spells: the first throw of each, in order.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct WetSpells(Vec<usize>);

impl WetSpells {
    /// Random wet spells in a life of `throws` throws.
    pub(super) fn new(throws: usize, random: &mut ChaCha8Rng) -> Self {
        let mut spells = Vec::new();
        let mut at = random.random_range(DRY_THROWS);
        while at < throws {
            spells.push(at);
            at += WET_THROWS + random.random_range(DRY_THROWS);
        }
        Self(spells)
    }

    /// Change of (ln b0, ln a1, ln a0) at throw `at`.
    pub(super) fn displacement(&self, at: usize) -> Vector3<f64> {
        let begun = self.0.partition_point(|first| *first <= at);
        let wet = begun > 0 && at < self.0[begun - 1] + WET_THROWS;
        Vector3::y() * if wet { WET_FRICTION.ln_1p() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::random::stream;

    #[test]
    fn the_temperature_rises_from_winter_to_summer() {
        let climate = Climate::summer(100);
        let mean = |from: usize| (from..from + THROWS_A_DAY).map(|at| climate.temperature_c(at)).sum::<f64>() / 20.0;
        for (from, celsius) in [(0, -10.0), (80, -10.0), (700, 29.0), (900, 29.0)] {
            assert!((mean(from) - celsius).abs() < 0.01, "{} °C from throw {from}", mean(from));
        }
        assert!((mean(390) - 9.5).abs() < 1.0, "{} °C half-way", mean(390));
    }

    #[test]
    fn wet_spells_lower_the_friction_for_fifteen_throws_and_are_rare() {
        let throws = 100_000;
        let wet = WetSpells::new(throws, &mut stream(3, 0, 0, 0));
        let changes: Vec<f64> = (0..throws).map(|at| wet.displacement(at).y).collect();
        let wet_throws = changes.iter().filter(|change| **change < 0.0).count();
        let expected = throws as f64 * 15.0 / 415.0;
        assert!((wet_throws as f64 / expected - 1.0).abs() < 0.2, "{wet_throws} of {expected}");
        let first = changes.iter().position(|change| *change < 0.0).unwrap();
        assert!((changes[first].exp() - 0.8).abs() < 1e-12 && changes[first + 14] < 0.0);
    }
}
