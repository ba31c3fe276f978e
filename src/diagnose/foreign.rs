//! Throws that do not belong to the machine, as its own history shows: with the current or the position of another
//! machine or of another throw, or a whole throw of another machine.
//!
//! The current ends at a nearly constant time after the arrival of the toe, which lock, detection and limit switch of the
//! machine determine. Faults of motor, friction, stiffness and inertia change the duration of the throw, but hardly this
//! time. A single throw with another time is rejected. Several are an alarm, as the machine may have changed; from then on
//! such throws are rough, so that no fault of the machine is hidden.

use serde::{Deserialize, Serialize};

use super::{
    alarm::{Alarms, Evidence},
    event::{AlarmEvent, Cause, SensorChannel, Severity},
    gauges::{Gauge, Gauges},
    operational::Context,
    text,
};
use crate::{
    estimate::{Features, Rejection},
    throw::Direction,
};

/// Least difference from the usual time: \[s\], and in standard deviations. In healthy throws of one machine the time
/// varies by 8 ms or less.
const LEAST_S: f64 = 0.02;
const LEAST_SD: f64 = 6.0;
/// Share of the usual inrush below which a throw without a toe position has none. At 25 Hz the inrush scatters by 17 %.
const LEAST_INRUSH: f64 = 0.5;
/// Largest excess of the duration of such a throw, as a logarithm: its scatter.
const LONGER: f64 = 0.05;
/// Number of such throws among the last 32 that raises the alarm.
const SEVERAL: u32 = 3;

/// A doubt whether a throw with an estimate belongs to the machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Doubt {
    /// The reason.
    pub reason: Rejection,
    /// Whether the throw is rejected; otherwise it is rough.
    pub rejects: bool,
}

/// The throws with doubts about the end of the current.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Foreign {
    /// Whether each of the last 32 throws was doubtful, as bits; the lowest is the newest.
    doubtful: u32,
    alarmed: bool,
}

impl Foreign {
    /// Applies a throw with an estimate.
    pub(super) fn doubt(&mut self, direction: Direction, features: &Features, gauges: &Gauges) -> Option<Doubt> {
        let late_s = late_s(direction, features, gauges);
        self.doubtful = self.doubtful << 1 | u32::from(late_s.is_some());
        let reason = Rejection::OtherMachine { late_ms: 1e3 * late_s? };
        Some(Doubt { reason, rejects: self.doubtful.count_ones() < SEVERAL })
    }

    /// Updates the alarm after a throw.
    pub(super) fn judge(&mut self, alarms: &mut Alarms, context: Context) -> Option<AlarmEvent> {
        let Context { name, at, throw, .. } = context;
        if self.doubtful.count_ones() >= SEVERAL {
            self.alarmed = true;
            let evidence = Evidence::plain(Severity::Warning, throw, text::foreign(name, self.doubtful.count_ones()));
            let evidence = Evidence { channel: Some(SensorChannel::Current), ..evidence };
            alarms.raise(Cause::Sensor, evidence, at)
        } else if self.alarmed && self.doubtful == 0 {
            self.alarmed = false;
            alarms.clear(Cause::Sensor, text::foreign_over(name), at)
        } else {
            None
        }
    }
}

/// Doubt whether a throw without a toe position has its start: its inrush is missing, and it is not longer than usual. (A weak
/// supply makes it longer.) Where the spring of the rails helps, hardly any current flows after the inrush, so the current
/// alone does not show it.
pub(super) fn start_missing(direction: Direction, features: &Features, gauges: &Gauges) -> Option<Doubt> {
    let [peak, duration] = gauges.departures([Gauge::Inrush, Gauge::Duration], direction, features);
    let is_small = f64::from(peak?.0) < LEAST_INRUSH.ln() && f64::from(duration?.0) < LONGER;
    let (usual, _) = gauges.normal(Gauge::Inrush, direction)?;
    let reason = Rejection::InrushMissing { peak_a: features.peak_current_a?, usual_a: usual.exp() };
    is_small.then_some(Doubt { reason, rejects: true })
}

/// Difference of the end of the current to its usual time after the arrival \[s\]; `None` if it is usual or unknown. A
/// slower machine may need more time for the lock too, so both the usual time and the same share of the duration are
/// usual.
fn late_s(direction: Direction, features: &Features, gauges: &Gauges) -> Option<f64> {
    let (usual_s, sd) = gauges.normal(Gauge::Stop, direction)?;
    let (duration, _) = gauges.normal(Gauge::Duration, direction)?;
    let slower = features.duration_s? / duration.exp();
    let (one, other) = (usual_s, usual_s * slower);
    let room = LEAST_S.max(LEAST_SD * sd);
    let (late, early) = (features.stop_s? - one.max(other), features.stop_s? - one.min(other));
    if late > room { Some(late) } else { (early < -room).then_some(early) }
}
