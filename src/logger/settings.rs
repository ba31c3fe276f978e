//! Settings of the simulated logger.

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use crate::throw::{MachineId, Name, OutOfRange, Range::Within, settings};

settings! {
    /// The `[logger]` section of `pointsim`'s configuration.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct LoggerSettings {
        /// Site of the machines.
        pub site: Name = Name::fixed("north");
        /// Prefix of the machines' names, followed by a number from 1: `machine-1`.
        pub machine: Name = Name::fixed("machine");
        /// Seed of all random numbers. `None`: the machines are the same at each start, and their throws differ.
        pub seed: Option<u64> = None;
        /// Throws of each machine, 1 to 1,000,000,000; `None` for an unlimited number.
        pub throws: Option<u64> = None, Within(1.0, 1e9, "");
        /// Time between two throws of a machine \[s\], 1 to 1,000,000.
        pub interval_s: f64 = 600.0, Within(1.0, 1e6, "s");
        /// Ratio of simulated to real time, 0.001 to 1,000,000. Time stamps are simulated time.
        pub time_scale: f64 = 1.0, Within(1e-3, 1e6, "");
        /// Largest backlog of each machine \[throws\], 1 to 100,000.
        #[serde(alias = "cache")]
        pub backlog_throws: usize = 1_000, Within(1.0, 1e5, "throws");
        /// Largest backlog of each machine \[MiB\], 1 to 4,096.
        pub backlog_mib: usize = 64, Within(1.0, 4096.0, "MiB");
        /// Whether the first throw waits until a daemon has subscribed.
        pub wait_for_monitor: bool = true;
        /// Time of the first throw. `None` for the time of the start; with a limited number of throws and `time_scale`
        /// above 1, so much earlier that the last throw is not in the future.
        pub started_at: Option<Timestamp> = None;
    }
}

impl LoggerSettings {
    /// Longest prefix of a name \[characters\]: a hyphen and a number of six digits must follow.
    const MAX_NAME: usize = Name::MAX_LEN - 7;

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), OutOfRange> {
        Within(1.0, Self::MAX_NAME as f64, "characters").check("machine", self.machine.as_str().len() as f64)?;
        self.check_ranges()
    }

    /// Time of the first throw of a logger that starts `now`.
    pub(super) fn first_throw_at(&self, now: Timestamp) -> Timestamp {
        let simulated_s = self.throws.map_or(0.0, |throws| throws as f64 * self.interval_s);
        let ahead = SignedDuration::try_from_secs_f64((simulated_s * (1.0 - 1.0 / self.time_scale)).max(0.0));
        self.started_at.or_else(|| now.checked_sub(ahead.ok()?).ok()).unwrap_or(now)
    }

    /// The machine with index `number`, from 0.
    pub fn machine_id(&self, number: usize) -> MachineId {
        let name = format!("{}-{}", self.machine, number + 1);
        // `validate` keeps the prefix short, so that the name is valid.
        let machine = name.parse().unwrap_or_else(|_| self.machine.clone());
        MachineId { site: self.site.clone(), machine }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_of_some_throws_in_fast_motion_is_not_in_the_future() {
        let now = Timestamp::UNIX_EPOCH + SignedDuration::from_hours(1_000_000);
        let age = |throws, time_scale| {
            let settings = LoggerSettings { throws, time_scale, interval_s: 3_600.0, ..LoggerSettings::default() };
            now.duration_since(settings.first_throw_at(now))
        };
        assert_eq!(age(Some(100), 1.0), SignedDuration::ZERO);
        assert_eq!(age(None, 10.0), SignedDuration::ZERO);
        assert_eq!(age(Some(100), 10.0), SignedDuration::from_hours(90), "and ten hours pass while they are published");
    }
}
