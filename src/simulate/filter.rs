//! The logger's anti-alias filter: a 4th-order Butterworth low-pass, as two second-order sections by the bilinear
//! transform.

use std::f64::consts::PI;

/// A second-order section in transposed direct form II.
#[derive(Debug, Clone, Copy)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Butterworth {
    sections: [Section; 2],
}

impl Butterworth {
    /// A filter with the cut-off `cut_off_hz`, below half of `rate_hz`, for a signal sampled at `rate_hz`.
    pub(super) fn new(cut_off_hz: f64, rate_hz: f64) -> Self {
        // Prewarped, so that the cut-off stays where it is in the analogue filter.
        let k = (PI * cut_off_hz / rate_hz).tan();
        let section = |index: f64| {
            // Damping of the pole pair of a 4th-order Butterworth: 2 sin(pi (2 i + 1) / 8).
            let damping = 2.0 * (PI * (2.0 * index + 1.0) / 8.0).sin();
            let norm = (1.0 + damping * k + k * k).recip();
            let b = k * k * norm;
            Section { b: [b, 2.0 * b, b], a: [2.0 * (k * k - 1.0) * norm, (1.0 - damping * k + k * k) * norm] }
        };
        Self { sections: [section(0.0), section(1.0)] }
    }

    /// Filters the signal in place, as if it had its first value for ever before.
    pub(super) fn run(&self, signal: &mut [f64]) {
        for section in &self.sections {
            let Some(&first) = signal.first() else { return };
            let [b0, b1, b2] = section.b;
            let [a1, a2] = section.a;
            let mut s2 = (b2 - a2) * first;
            let mut s1 = (b1 - a1) * first + s2;
            for value in &mut *signal {
                let input = *value;
                let output = b0 * input + s1;
                s1 = b1 * input - a1 * output + s2;
                s2 = b2 * input - a2 * output;
                *value = output;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_filter_passes_a_constant_and_halves_the_power_at_its_cut_off() {
        let filter = Butterworth::new(40.0, 5000.0);
        let mut constant = vec![115.0; 100];
        filter.run(&mut constant);
        assert!(constant.iter().all(|value| (value - 115.0).abs() < 1e-9));

        let amplitude = |hz: f64| {
            let mut wave: Vec<f64> = (0..20_000).map(|at| (2.0 * PI * hz * f64::from(at) / 5000.0).sin()).collect();
            filter.run(&mut wave);
            wave[10_000..].iter().fold(0.0_f64, |most, value| most.max(value.abs()))
        };
        assert!((amplitude(40.0) - 0.5_f64.sqrt()).abs() < 1e-3);
        // Fourth order: 24 dB an octave.
        assert!((amplitude(80.0) - (1.0_f64 + 2.0_f64.powi(8)).sqrt().recip()).abs() < 3e-3);
    }
}
