//! The observations of a life at parameter depth, and the times of its throws.

use jiff::{SignedDuration, Timestamp};

use super::weather::THROWS_A_DAY;
use crate::{
    diagnose::{Estimated, Observation},
    throw::{Direction, ThrowRef},
};

/// Start time of throw `at`.
pub(super) fn started_at(at: usize) -> Timestamp {
    #[expect(clippy::cast_possible_wrap, reason = "a life has few throws")]
    let seconds = (at * 86_400 / THROWS_A_DAY) as i64;
    Timestamp::UNIX_EPOCH + SignedDuration::from_secs(seconds)
}

/// Observation of throw `at`. The directions alternate; the throws have equal distances in time.
pub(super) fn observation(at: usize, estimate: Option<Estimated>, temperature_c: Option<f64>) -> Observation {
    let throw = ThrowRef { boot_id: "evaluate".to_owned(), throw_no: at as u64 + 1 };
    Observation {
        direction: Some(if at.is_multiple_of(2) { Direction::NormalToReverse } else { Direction::ReverseToNormal }),
        outcome: estimate.map(Ok),
        temperature_c,
        ..Observation::without_trace(throw, started_at(at))
    }
}
