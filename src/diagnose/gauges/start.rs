//! A changed start of the movement: the toe moves later after the current, or accelerates less, than the running
//! current explains. The reason is a late brake, play, lost motion or a delayed position. Friction, motor and stiffness
//! of the running machine stay as they were. Such throws are often rough; then only ratios are compared, and these look
//! healthy.

use serde::{Deserialize, Serialize};

use super::{Gauge, Gauges};
use crate::diagnose::{
    Cause,
    alarm::{RuleResult, Step, count_over},
    statistics::{Level, WINDOWS, streak},
    text,
};

/// Change of the delay between current and toe that matters \[ms\]: play or lost motion of 0.1 mm causes 2 to 4 ms.
const DELAY_MS: f64 = 1.0;
/// Largest change of the delay by friction \[ms\], for a change of 1 in the logarithm of the running current: dry
/// friction winds up an elastic drive before the toe moves. For drives of 1.5e7 N/m it is 10 to 26 ms.
const DELAY_OF_FRICTION_MS: f64 = 30.0;
/// Change of the delay with the duration, both relative to normal: an unlocking stroke follows the motor's speed.
const DELAY_OF_DURATION: f64 = 1.5;
/// Change of the delay as part of the normal delay, for a change of 1 in the logarithm of the inrush current. The toe
/// has moved visibly after a time that goes with the square root of the acceleration. A hot winding or a bad contact
/// lowers the inrush; a late brake does not.
const DELAY_OF_INRUSH: f64 = 0.5;
/// Change of the logarithm of the acceleration that matters, beyond that of the running current: a motor changes both.
const GAIN: f64 = 0.1;
/// Least significance of a change, in standard deviations of a level.
const SIGNIFICANT_SD: f64 = 4.0;
/// Consecutive throws with the change until the alarm. A fault of a part is named earlier, by the coefficients.
const NAMED_THROWS: u32 = 8;

/// Watches for a changed start.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct StartWatch {
    /// Consecutive throws with a change, and without one.
    named: u32,
    calm: u32,
}

/// Changes of the start in the last throws.
#[derive(Debug, Clone, Copy, PartialEq)]
struct StartChange {
    /// Change of the delay \[ms\].
    delay: Level,
    /// Change of the logarithm of the acceleration per ampere.
    gain: Level,
    /// Change of the logarithm of the running current.
    running: Level,
    /// Change of the delay that speed and inrush of the motor explain \[ms\].
    of_motor_ms: f64,
    /// Lost part of the inrush, as a logarithm.
    lost_inrush: f64,
}

impl StartChange {
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

    /// Size relative to the largest change that does not matter, or that motor and running current explain.
    fn size(&self) -> f64 {
        let running = self.running.value.abs();
        let of = |level: Level, least: f64| level.value.abs() / least.max(SIGNIFICANT_SD * level.sd);
        let of_delay = DELAY_MS + DELAY_OF_FRICTION_MS * running + self.of_motor_ms;
        of(self.delay, of_delay).max(of(self.gain, GAIN + running + self.lost_inrush))
    }
}

impl StartWatch {
    /// Applies a throw with an estimate, which the `gauges` contain already. `explained`: a sensor or the supply
    /// explains the drift. A changed start alone names no part: stiffness in an elastic drive changes it too.
    pub(crate) fn judge(&mut self, gauges: &Gauges, explained: bool, step: &Step) -> RuleResult {
        let change = StartChange::of(gauges);
        let size = change.map(|change| change.size());
        let is_changed = size.is_some_and(|size| size > 1.0);
        streak(&mut self.named, is_changed && !explained);
        count_over(&mut self.calm, size);
        match change {
            Some(change) if self.named >= NAMED_THROWS => {
                let text = text::start(step.name, [change.delay, change.gain, change.running], WINDOWS[2]);
                RuleResult::Fault(Box::new(step.warning(Cause::Unattributed, text)))
            }
            _ => RuleResult::after_calm(self.calm, step.settings),
        }
    }
}
