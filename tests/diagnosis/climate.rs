//! Days and seasons, and their effect on the coefficients.

use nalgebra::Vector3;

/// Change of ln b0, ln a1, ln a0 per kelvin: weaker magnets, thinner grease, less thrust of the rails.
pub(crate) const PER_KELVIN: [f64; 3] = [-0.0015, -0.008, -0.001];

/// Temperature over the throws of a life, with 20 throws on each day.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Climate {
    /// Winter and summer mean \[°C\].
    pub(crate) season_c: (f64, f64),
    /// Throws in winter, and throws from winter to summer.
    pub(crate) change: (u64, u64),
    /// Daily swing \[K\].
    pub(crate) day_k: f64,
}

impl Climate {
    pub(crate) fn celsius(&self, throw: u64) -> f64 {
        let (from, over) = self.change;
        let part = ((throw as f64 - from as f64) / (over as f64).max(1.0)).clamp(0.0, 1.0);
        let (winter, summer) = self.season_c;
        let day = (throw as f64 / 20.0 * std::f64::consts::TAU).sin();
        winter + (summer - winter) * 0.5 * (1.0 - (std::f64::consts::PI * part).cos()) + self.day_k * day
    }

    /// Effect of the temperature on the logarithms, and the temperature.
    pub(crate) fn effect(&self, throw: u64) -> (Vector3<f64>, f64) {
        let celsius = self.celsius(throw);
        (Vector3::from(PER_KELVIN) * (celsius - 10.0), celsius)
    }
}
