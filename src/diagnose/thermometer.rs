//! Plausibility of the temperature: a failed sensor must not hide a fault.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use crate::throw::POSSIBLE_C;

/// Fastest change by weather, sun and a warm motor: at once \[K\], and per hour \[K/h\].
const JUMP_K: (f64, f64) = (20.0, 2.0);
/// Time after which a missing temperature is a fault of the sensor. The last one is used all the same: without it the
/// whole effect of the temperature would appear at once, as a fault of the machine.
const HOLDS: SignedDuration = SignedDuration::from_hours(24);
/// Consecutive similar readings after which a jump is accepted, as the sensor was moved.
const SETTLED_READINGS: u32 = 6;

/// An implausible temperature or supply voltage, which is not used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Disbelief {
    /// Outside of the possible range \[°C\].
    Impossible(f64),
    /// A jump from the first to the second value \[°C\].
    Jump(f64, f64),
    /// No temperature since this time, after earlier ones.
    Missing(Timestamp),
    /// A supply voltage out of the possible range \[V\].
    Supply(f64),
}

/// The temperature of a throw after the check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    /// The temperature to use \[°C\]: that of the throw, or the last accepted one; `None` without.
    pub(super) celsius: Option<f64>,
    /// Reason for the rejection of the throw's temperature.
    pub(super) disbelief: Option<Disbelief>,
}

/// State of the temperature sensor of a machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Thermometer {
    believed: Option<(f64, Timestamp)>,
    /// The last rejected reading, and the number of consecutive readings like it.
    doubted: Option<(f64, u32)>,
}

impl Thermometer {
    /// Checks the temperature of a throw at a time.
    pub(super) fn read(&mut self, celsius: Option<f64>, at: Timestamp) -> Reading {
        let before = self.believed.map(|(celsius, _)| celsius);
        let Some(celsius) = celsius else {
            let missing = self.believed.filter(|(_, then)| at.duration_since(*then).abs() > HOLDS);
            return Reading { celsius: before, disbelief: missing.map(|(_, then)| Disbelief::Missing(then)) };
        };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_temperature_is_the_last_one_and_a_fault_after_a_day() {
        let mut thermometer = Thermometer::default();
        let start = Timestamp::UNIX_EPOCH;
        let later = |hours| start + SignedDuration::from_hours(hours);
        assert_eq!(thermometer.read(None, start), Reading { celsius: None, disbelief: None });
        assert_eq!(thermometer.read(Some(-10.0), start).celsius, Some(-10.0));
        assert_eq!(thermometer.read(None, later(20)), Reading { celsius: Some(-10.0), disbelief: None });
        let missing = Reading { celsius: Some(-10.0), disbelief: Some(Disbelief::Missing(start)) };
        assert_eq!(thermometer.read(None, later(25)), missing);
        assert_eq!(thermometer.read(Some(-8.0), later(26)).celsius, Some(-8.0));
    }
}
