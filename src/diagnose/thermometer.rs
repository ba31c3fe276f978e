//! Whether a temperature can be believed: a failed sensor must not explain a fault away.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// Temperatures that a machine at the track can have \[°C\]: the coldest place with rails, and a drive in the sun.
const POSSIBLE_C: std::ops::RangeInclusive<f64> = -60.0..=90.0;
/// Fastest change that weather, sun and a warm motor make: at once \[K\], and each hour \[K/h\].
const JUMP_K: (f64, f64) = (20.0, 2.0);
/// Readings in a row, each near the one before, after which a jump is a new place of the sensor and is believed.
const SETTLED_READINGS: u32 = 6;

/// A temperature or a supply voltage that is not used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Disbelief {
    /// Outside of what is possible \[°C\].
    Impossible(f64),
    /// It jumped from the first to the second \[°C\].
    Jump(f64, f64),
    /// A supply voltage outside of what is possible \[V\].
    Supply(f64),
}

/// What a throw's temperature is worth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    /// The temperature to count with \[°C\]: the throw's, or the last one that was believed; `None` before any.
    pub(super) celsius: Option<f64>,
    /// Why the throw's own was not used.
    pub(super) disbelief: Option<Disbelief>,
}

/// The temperature sensor of one machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Thermometer {
    believed: Option<(f64, Timestamp)>,
    /// The last reading that was not believed, and how many like it there were in a row.
    doubted: Option<(f64, u32)>,
}

impl Thermometer {
    /// Reads the temperature of a throw at this time.
    pub(super) fn read(&mut self, celsius: Option<f64>, at: Timestamp) -> Reading {
        let before = self.believed.map(|(celsius, _)| celsius);
        let Some(celsius) = celsius else { return Reading { celsius: before, disbelief: None } };
        if !POSSIBLE_C.contains(&celsius) {
            self.doubted = None;
            return Reading { celsius: before, disbelief: Some(Disbelief::Impossible(celsius)) };
        }
        if let Some((last, then)) = self.believed {
            let hours = at.duration_since(then).as_secs_f64().abs() / 3600.0;
            let (at_once, each_hour) = JUMP_K;
            if (celsius - last).abs() > at_once + each_hour * hours {
                let like = self.doubted.filter(|(doubted, _)| (celsius - doubted).abs() <= at_once);
                let count = like.map_or(1, |(_, count)| count + 1);
                self.doubted = Some((celsius, count));
                if count < SETTLED_READINGS {
                    return Reading { celsius: before, disbelief: Some(Disbelief::Jump(last, celsius)) };
                }
            }
        }
        self.doubted = None;
        self.believed = Some((celsius, at));
        Reading { celsius: Some(celsius), disbelief: None }
    }
}
