//! Plausibility of the temperature: a failed temperature sensor must not hide a fault of the machine.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use crate::throw::POSSIBLE_C;

/// Largest change by weather, sun and a warm motor \[K\]: at once; for each hour, up to a total; for each day.
const AT_ONCE_K: f64 = 20.0;
const PER_HOUR_K: f64 = 2.0;
const WITHIN_HOURS_K: f64 = 10.0;
const PER_DAY_K: f64 = 1.0;
/// Time after which a missing temperature is a fault of the sensor. The last temperature stays in use: without it, the
/// whole effect of the temperature would appear at once, as a fault of the machine.
const HOLDS: SignedDuration = SignedDuration::from_hours(24);
/// Least time and number of equal readings of a stuck sensor: weather changes even a coarse one, of 1 K, within days.
const STUCK: (SignedDuration, u32) = (SignedDuration::from_hours(120), 24);
/// Least length of the run of a stuck sensor, as multiple of the longest run before. In a tunnel, or with a logger that
/// renews the value seldom, healthy runs are long.
const STUCK_RUNS: u32 = 4;
/// Consecutive similar readings after which a jump is accepted, if no more readings were accepted before it: those were
/// wrong. After more accepted readings, a jump that stays is another unit, or a broken or moved sensor; its readings do
/// not fit the learned effect of the temperature.
const SETTLED_READINGS: u32 = 6;

/// An implausible temperature or supply voltage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Implausible {
    /// Outside of the possible range \[°C\].
    Impossible(f64),
    /// A jump from the first to the second value \[°C\].
    Jump(f64, f64),
    /// Missing since this time; earlier throws had a temperature.
    Missing(Timestamp),
    /// The same value \[°C\] since this time, after earlier changes. Still used, as there is no better value.
    Stuck(f64, Timestamp),
    /// A supply voltage out of the possible range \[V\].
    Supply(f64),
}

/// The temperature of a throw after its check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Reading {
    /// The temperature to use \[°C\]: that of the throw, or the last accepted one; `None` before the first.
    pub(crate) celsius: Option<f64>,
    /// Why the temperature of the throw is implausible; `None` if it is plausible.
    pub(crate) implausible: Option<Implausible>,
}

/// State of the temperature sensor of a machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Thermometer {
    /// The last accepted temperature \[°C\], with its time.
    believed: Option<(f64, Timestamp)>,
    /// Number of accepted readings, counted up to [`SETTLED_READINGS`] + 1.
    accepted: u32,
    /// The rejected readings since the last accepted one. Boxed, as few machines have any.
    #[serde(rename = "doubt", skip_serializing_if = "Option::is_none")]
    rejected: Option<Box<Rejected>>,
    run: Run,
}

/// A run of consecutive equal readings.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct Run {
    since: Option<Timestamp>,
    readings: u32,
    /// Readings of the longest run before this one; 0 if the temperature never changed.
    longest: u32,
}

impl Run {
    /// Adds a reading; `same`: equal to the one before. Returns the begin of the run if the sensor is stuck.
    fn follow(&mut self, same: bool, at: Timestamp) -> Option<Timestamp> {
        if !same {
            let longest = self.longest.max(self.readings);
            *self = Self { since: Some(at), readings: 0, longest };
        }
        self.readings = self.readings.saturating_add(1);
        let (least, readings) = STUCK;
        let is_long = self.longest > 0 && self.readings >= readings.max(STUCK_RUNS.saturating_mul(self.longest));
        self.since.filter(|since| is_long && at.duration_since(*since) >= least)
    }
}

/// Consecutive rejected readings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Rejected {
    /// Time of the first of them.
    since: Timestamp,
    /// The last of them \[°C\], and the number of consecutive ones like it; `None` in snapshots of an earlier program.
    last: Option<(f64, u32)>,
}

impl Thermometer {
    /// Checks the temperature of a throw, `None` if the throw has none.
    pub(crate) fn read(&mut self, celsius: Option<f64>, at: Timestamp) -> Reading {
        let before = self.believed.map(|(celsius, _)| celsius);
        let Some(celsius) = celsius else {
            let missing = self.believed.filter(|(_, then)| at.duration_since(*then).abs() > HOLDS);
            return Reading { celsius: before, implausible: missing.map(|(_, then)| Implausible::Missing(then)) };
        };
        if !POSSIBLE_C.contains(&celsius) {
            // Says nothing about the weather: the next possible reading is compared with the last accepted one.
            self.rejected = None;
            return Reading { celsius: before, implausible: Some(Implausible::Impossible(celsius)) };
        }
        if let Some((last, then)) = self.believed {
            let since = self.rejected.as_ref().map_or(at, |rejected| rejected.since);
            let hours = since.duration_since(then).as_secs_f64().abs() / 3600.0;
            let weather_k = AT_ONCE_K + (PER_HOUR_K * hours).min(WITHIN_HOURS_K) + PER_DAY_K * hours / 24.0;
            let rejected = self.rejected.as_ref().and_then(|rejected| rejected.last);
            // A sensor in another unit has plausible readings now and then; they are close to the rejected ones.
            let is_like_rejected =
                rejected.is_some_and(|(rejected, _)| (celsius - rejected).abs() < (celsius - last).abs());
            if (celsius - last).abs() > weather_k || is_like_rejected {
                let like = rejected.filter(|(rejected, _)| (celsius - rejected).abs() <= AT_ONCE_K);
                let count = like.map_or(1, |(_, count)| count.saturating_add(1));
                if count < SETTLED_READINGS || self.accepted > SETTLED_READINGS {
                    self.rejected = Some(Box::new(Rejected { since, last: Some((celsius, count)) }));
                    return Reading { celsius: before, implausible: Some(Implausible::Jump(last, celsius)) };
                }
            }
        }
        self.accepted = (self.accepted + 1).min(SETTLED_READINGS + 1);
        self.rejected = None;
        self.believed = Some((celsius, at));
        let stuck = self.run.follow(before == Some(celsius), at);
        Reading { celsius: Some(celsius), implausible: stuck.map(|since| Implausible::Stuck(celsius, since)) }
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
        assert_eq!(thermometer.read(None, start), Reading { celsius: None, implausible: None });
        assert_eq!(thermometer.read(Some(-10.0), start).celsius, Some(-10.0));
        assert_eq!(thermometer.read(None, later(20)), Reading { celsius: Some(-10.0), implausible: None });
        let missing = Reading { celsius: Some(-10.0), implausible: Some(Implausible::Missing(start)) };
        assert_eq!(thermometer.read(None, later(25)), missing);
        assert_eq!(thermometer.read(Some(-8.0), later(26)).celsius, Some(-8.0));
    }

    #[test]
    fn a_temperature_that_stays_for_days_after_changes_is_stuck() {
        type Sensor = fn(i64) -> f64;
        let later = |hours| Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hours);
        let outdoors: Sensor = |hour| (hour % 24).min(24 - hour % 24) as f64 / 2.0;
        let renewed_daily: Sensor = |hour| (hour / 24) as f64;
        let cellar: Sensor = |_| 12.0;
        for (celsius, is_found) in [(outdoors, true), (renewed_daily, true), (cellar, false)] {
            let mut thermometer = Thermometer::default();
            let mut read = |hour, celsius| thermometer.read(Some(celsius), later(hour)).implausible;
            assert!((0..400).all(|hour| read(hour, celsius(hour)).is_none()));
            let stuck = (400..700).find_map(|hour| read(hour, 12.0));
            assert_eq!(stuck, is_found.then(|| Implausible::Stuck(12.0, later(400))));
            assert_eq!(read(701, 12.5), None);
        }
    }

    #[test]
    fn a_sensor_in_another_unit_is_not_believed_on_a_cool_day() {
        let mut thermometer = Thermometer::default();
        let later = |hours| Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hours);
        let celsius = |hour: i64| 4.0 + 5.0 * (hour as f64 / 24.0 * std::f64::consts::TAU).sin();
        for hour in 0..200 {
            assert_eq!(thermometer.read(Some(celsius(hour)), later(hour)).implausible, None);
        }
        let fahrenheit = |hour: i64| 32.0 + 1.8 * (celsius(hour) - (hour - 200) as f64 / 100.0);
        for hour in 200..800 {
            let reading = thermometer.read(Some(fahrenheit(hour)), later(hour));
            assert!(matches!(reading.implausible, Some(Implausible::Jump(..))), "{hour}: {reading:?}");
        }
        assert_eq!(thermometer.read(Some(-6.0), later(801)).implausible, None, "mended");
    }

    #[test]
    fn the_weather_goes_on_while_a_sensor_sends_impossible_values() {
        let mut thermometer = Thermometer::default();
        let later = |hours| Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hours);
        for hour in 0..200 {
            assert_eq!(thermometer.read(Some(-5.0), later(hour)).implausible, None);
        }
        for hour in 200..2400 {
            let impossible = Reading { celsius: Some(-5.0), implausible: Some(Implausible::Impossible(-200.0)) };
            assert_eq!(thermometer.read(Some(-200.0), later(hour)), impossible);
        }
        assert_eq!(thermometer.read(Some(21.0), later(2400)), Reading { celsius: Some(21.0), implausible: None });
    }
}
