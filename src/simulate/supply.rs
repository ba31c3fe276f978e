//! The supply voltage over time.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use crate::throw::{OutOfRange, Range::Within};

/// Shape of the supply voltage over time. Its mean is `Parameters::supply_v`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Waveform {
    /// A constant voltage, as of a battery.
    #[default]
    Constant,
    /// Full-wave rectified mains, |sin|: the current ripples at twice the mains frequency. The current may flow
    /// backwards into the supply, as recorded currents of such machines go below zero.
    RectifiedMains {
        /// Mains frequency \[Hz\].
        mains_hz: f64,
    },
}

impl Waveform {
    /// Mean voltage over the step number `at` of `h` seconds, as ratio to the mean over a period. `phase_rad` is the
    /// phase of the mains at time 0.
    pub(super) fn mean(self, at: usize, h: f64, phase_rad: f64) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::RectifiedMains { mains_hz } => {
                let w = 2.0 * PI * mains_hz;
                // The integral of |sin| from 0 to x: 2 for each complete half wave, 1 - cos within the last one.
                let integral = |x: f64| {
                    let half_waves = (x / PI).floor();
                    2.0 * half_waves + 1.0 - (x - half_waves * PI).cos()
                };
                let from = w * h * at as f64 + phase_rad;
                (integral(from + w * h) - integral(from)) / (w * h) * (PI / 2.0)
            }
        }
    }

    pub(super) fn check(self) -> Result<(), OutOfRange> {
        match self {
            Self::Constant => Ok(()),
            Self::RectifiedMains { mains_hz } => Within(10.0, 100.0, "Hz").check("mains_hz", mains_hz),
        }
    }
}
