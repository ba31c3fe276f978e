//! Common changes of the machines of a site: weather, not a fault of a machine.
//!
//! Every monitor stores its last departures from the baseline. The common change is the part of these departures that
//! three quarters of the other machines have at least, beyond chance; at least three machines must have had throws in
//! the last hours. It is subtracted from a throw before the throw is judged. So defined, the common change has no step
//! when a single machine changes; a step would look like an intermittent fault of the others. The subtraction only
//! reduces a departure: it never increases one or changes its sign. A machine without the change is judged as it is.

use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::Operation;
use crate::diagnose::{
    AlarmEvent, Cause,
    alarm::{OVER_BELOW, Rule, Step},
    statistics::{LastValues, median, percent, to_rounded_f32},
    text,
};

/// Number of stored departures of a machine. Throws of other machines that are judged later need the earlier ones.
const KEPT: usize = 4;
/// Largest age \[h\] of the latest departure of another machine: weather changes within half a day.
const HOURS: i64 = 12;
/// Least number of other machines for a common change.
const LEAST_OTHERS: usize = 3;
/// Largest number of other machines in the comparison, the first ones of the site by name. A bound, so that the cost of
/// a throw does not grow with the site.
const MOST_OTHERS: usize = 32;
/// Part of the other machines whose departures are at least as large as the common change.
const AGREE: f64 = 0.75;
/// Time without a known common change after which the alarm of a site ends \[days\]: the machines of a site in use make
/// throws on most days, and weather changes within a week.
const UNKNOWN_DAYS: f64 = 7.0;
/// Part of a common change that counts as chance, in standard deviations of the mean of the other machines.
const BEYOND_CHANCE: f64 = 2.0;

/// Common change of machines of a site.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Common {
    /// Change of ln b0, ln a1, ln a0; 0 if the machines do not agree.
    change: Vector3<f64>,
    /// Whether enough machines had throws in the last hours.
    is_known: bool,
}

impl Common {
    /// Whether there is a common change.
    pub fn is_change(&self) -> bool {
        self.change != Vector3::zeros()
    }
}

/// The last departures of a machine from its baseline, for the comparison with other machines.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Trail {
    /// Time, and departure of ln b0, ln a1, ln a0; the oldest first.
    last: LastValues<(Timestamp, [f32; 3]), KEPT>,
    /// Standard deviations of one throw.
    sd: [f32; 3],
}

impl Trail {
    /// Adds the departure of a throw. `of_one_throw`: covariance of one throw of the machine.
    pub(crate) fn push(&mut self, at: Timestamp, departure: &Vector3<f64>, of_one_throw: &Matrix3<f64>) {
        self.sd = [0, 1, 2].map(|i| to_rounded_f32(of_one_throw[(i, i)].sqrt().max(1e-3)));
        self.last.push((at, [0, 1, 2].map(|i| to_rounded_f32(departure[i]))));
    }

    /// The latest departure in the hours before `at`, with the standard deviations of one throw.
    fn latest(&self, at: Timestamp) -> Option<([f32; 3], [f32; 3])> {
        let hours = SignedDuration::ZERO..=SignedDuration::from_hours(HOURS);
        let latest = self.last.iter().rev().find(|(then, _)| hours.contains(&at.duration_since(*then)))?;
        Some((latest.1, self.sd))
    }
}

/// Common change at `at` of the machines with these trails.
pub(crate) fn common<'a>(trails: impl Iterator<Item = &'a Trail>, at: Timestamp) -> Common {
    let latest: Vec<_> = trails.filter_map(|trail| trail.latest(at)).take(MOST_OTHERS).collect();
    let count = latest.len() as f64;
    if latest.len() < LEAST_OTHERS {
        return Common::default();
    }
    let change = Vector3::from_fn(|i, _| {
        let mut logs: Vec<f64> = latest.iter().map(|(log, _)| log[i].into()).collect();
        logs.sort_unstable_by(f64::total_cmp);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of at most 32 machines")]
        let disagree = ((1.0 - AGREE) * count) as usize;
        let (at_least, at_most) = (logs[disagree], logs[latest.len() - 1 - disagree]);
        let sd = median(&mut latest.iter().map(|(_, sd)| sd[i].into()).collect::<Vec<_>>());
        let chance = BEYOND_CHANCE * sd / count.sqrt();
        (at_least - chance).max(0.0) + (at_most + chance).min(0.0)
    });
    Common { change, is_known: true }
}

/// The part of a departure that the common change explains.
pub(crate) fn shared_part(departure: &Vector3<f64>, common: &Common) -> Vector3<f64> {
    departure.zip_map(
        &common.change,
        |own, common| {
            if own * common > 0.0 { own.signum() * own.abs().min(common.abs()) } else { 0.0 }
        },
    )
}

impl Operation {
    /// Raises and clears the alarm about all machines of a site. It stays while the common change is unknown, as at
    /// night and on days without traffic, for at most [`UNKNOWN_DAYS`].
    pub(crate) fn on_common(&mut self, common: &Common, step: &mut Step) {
        if common.is_known {
            self.silence_s = 0.0;
        }
        let is_forgotten = self.silence_s >= 86_400.0 * UNKNOWN_DAYS;
        for (cause, log) in Cause::OF_COEFFICIENTS.into_iter().zip(&common.change) {
            let size = step.settings.relevance(cause, *log);
            if size > 1.0 {
                let event = step.warning(cause, text::site(step.name, cause, percent(*log)));
                let event = AlarmEvent { change_pct: Some(percent(*log)), ..event };
                let before = step.alarms.find_active(cause).and_then(|alarm| alarm.last.change_pct);
                if before.is_some_and(|pct| pct * log < 0.0) {
                    // Rain in the evening and frost in the morning, with no throws between.
                    step.alarms.raise_anew(Rule::Usual, event);
                } else {
                    step.raise(event);
                }
            } else if common.is_known && size < OVER_BELOW {
                step.clear(cause, |name| text::site_over(name, cause));
            } else if is_forgotten {
                step.clear(cause, |name| text::site_unknown(name, cause, UNKNOWN_DAYS));
            }
        }
    }
}
