//! A changed start of the movement: the toe moves later behind the current, or accelerates less, than the running current
//! explains. A late brake, play, lost motion and a delayed position do this, and leave friction, motor and stiffness of
//! the running machine. The throws are rough then, and their ratios look healthy.

use serde::{Deserialize, Serialize};

use super::{
    condition::streak,
    event::Cause,
    found::{Found, count_over},
    gauges::{Gauge, Gauges, Level},
    step::Step,
    text,
    threshold::WINDOWS,
};

/// Change of the delay that matters \[ms\]: play or lost motion of 0.1 mm causes 2 to 4 ms.
const DELAY_MS: f64 = 1.0;
/// Change of the delay that friction can cause, for each 1 of the logarithm of the running current \[ms\]: dry friction
/// winds up an elastic drive before the toe moves. Drives of 1.5e7 N/m have 10 to 26 ms.
const DELAY_OF_FRICTION_MS: f64 = 30.0;
/// Change of the delay of an unlocking stroke, as multiple of that of the duration: its time follows the speed of the motor.
const DELAY_OF_DURATION: f64 = 1.5;
/// Change of the delay with the logarithm of the inrush, as part of the normal delay: the toe has moved visibly after a time that
/// follows the square root of the acceleration. A hot winding or a bad contact takes a part of the inrush, a late brake does not.
const DELAY_OF_INRUSH: f64 = 0.5;
/// Change of the logarithm of the acceleration that matters, in addition to that of the running current, which a motor
/// changes as much.
const GAIN: f64 = 0.1;
/// Significant change, in standard deviations of a level.
const SIGNIFICANT_SD: f64 = 4.0;
/// Consecutive throws with the change: a fault of a part shows in the coefficients within fewer, and has a name there.
const NAMED_THROWS: u32 = 8;

/// The alarm about a changed start.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct StartWatch {
    /// Consecutive throws with a change, and without.
    named: u32,
    calm: u32,
}

/// The changes of the start of the last throws.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Change {
    /// Change of the delay \[ms\].
    pub(super) delay: Level,
    /// Changes of the logarithms of the acceleration per ampere and of the running current.
    pub(super) gain: Level,
    pub(super) running: Level,
    /// Change of the delay by the speed and the inrush of the motor \[ms\].
    pub(super) of_motor_ms: f64,
    /// Lost part of the inrush, as a logarithm.
    pub(super) lost_inrush: f64,
}

impl Change {
    /// `None` if a gauge or its normal value is unknown.
    fn of(gauges: &Gauges) -> Option<Self> {
        let level = |gauge| gauges.scattered_level(gauge, WINDOWS[2]);
        let (delay, gain) = (level(Gauge::StartDelay)?, level(Gauge::StartGain)?);
        let duration = gauges.level(Gauge::Duration, WINDOWS[2]).map_or(0.0, |duration| duration.value.abs());
        let lost_inrush = gauges.level(Gauge::Inrush, WINDOWS[2]).map_or(0.0, |inrush| (-inrush.value).max(0.0));
        let of_motor = DELAY_OF_DURATION * duration + DELAY_OF_INRUSH * lost_inrush;
        let of_motor_ms = of_motor * gauges.normal_delay_ms();
        Some(Self { delay, gain, running: level(Gauge::Running)?, of_motor_ms, lost_inrush })
    }

    /// Size relative to what matters and to what the running current explains.
    fn size(&self) -> f64 {
        let running = self.running.value.abs();
        let of = |level: Level, least: f64| level.value.abs() / least.max(SIGNIFICANT_SD * level.sd);
        let of_delay = DELAY_MS + DELAY_OF_FRICTION_MS * running + self.of_motor_ms;
        of(self.delay, of_delay).max(of(self.gain, GAIN + running + self.lost_inrush))
    }
}

impl StartWatch {
    /// Applies an estimated throw, whose gauges are the last; `excused`: a sensor or the supply explains its drift. A fault
    /// of a part can change the start too, as stiffness does in an elastic drive.
    pub(super) fn judge(&mut self, gauges: &Gauges, excused: bool, step: &Step) -> Found {
        let change = Change::of(gauges);
        let size = change.map(|change| change.size());
        let is_changed = size.is_some_and(|size| size > 1.0);
        streak(&mut self.named, is_changed && !excused);
        count_over(&mut self.calm, size);
        match change {
            Some(change) if self.named >= NAMED_THROWS => {
                let text = text::start(step.name, &change, WINDOWS[2]);
                Found::Fault(Box::new(step.warning(Cause::Unattributed, text)))
            }
            _ if self.calm >= step.settings.off_delay_throws => Found::Nothing,
            _ => Found::Unclear,
        }
    }
}
