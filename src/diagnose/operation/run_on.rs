//! A motor that runs on after the toe has arrived: the machine does not detect the end, or does not switch off.

use serde::{Deserialize, Serialize};

use crate::{
    diagnose::{
        Cause, Severity,
        alarm::{RuleResult, Step},
        statistics::to_f32,
        text,
    },
    throw::Direction,
};

/// Number of throws of a direction from which the usual time is learned: their mean.
const LEARNED: u8 = 12;
/// Time beyond the usual one that matters \[s\].
const LONGER_S: f64 = 0.5;
/// Throws among the last eight of the machine that raise the alarm, and that make it critical: one or two may be a
/// stone that gave way.
const LONG_OF_EIGHT: u32 = 3;
const CRITICAL_OF_EIGHT: u32 = 6;
/// Throws without a longer time that end the alarm: a contact that fails now and then must not make an alarm each time.
const CALM: u32 = 24;

/// The time for which the motor runs after the arrival of the toe.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct RunOn {
    /// The usual time of each direction \[s\], and the number of throws from which it is known.
    usual_s: [f32; 2],
    learned: [u8; 2],
    /// The last 32 throws of the machine as bits, 1 for a longer time.
    long: u32,
    /// The longest time of each direction since [`CALM`] throws without a longer one \[s\].
    longest: [f32; 2],
}

impl RunOn {
    /// Applies a whole throw whose motor ran for `run_on_s` after the arrival of the toe.
    pub(crate) fn judge(&mut self, direction: Direction, run_on_s: f64, step: &Step) -> RuleResult {
        let side = direction.side();
        let usual_s = f64::from(self.usual_s[side]);
        let is_known = self.learned[side] >= LEARNED;
        if !is_known {
            self.learned[side] += 1;
            self.usual_s[side] = to_f32(usual_s + (run_on_s - usual_s) / f64::from(self.learned[side]));
        }
        let is_long = is_known && run_on_s > usual_s + LONGER_S;
        self.long = self.long << 1 | u32::from(is_long);
        if is_long {
            self.longest[side] = self.longest[side].max(to_f32(run_on_s));
        } else if self.long.trailing_zeros() >= CALM {
            self.longest = [0.0; 2];
            return RuleResult::Nothing;
        }
        let count = (self.long & 0xff).count_ones();
        if count < LONG_OF_EIGHT {
            return RuleResult::Unclear;
        }
        let severity = if count >= CRITICAL_OF_EIGHT { Severity::Critical } else { Severity::Warning };
        let [beyond, beyond_of_other] = [side, 1 - side].map(|side| self.longest[side] - self.usual_s[side]);
        let side = if beyond_of_other > beyond { 1 - side } else { side };
        let text = text::runs_on(step.name, count, self.longest[side].into(), self.usual_s[side].into());
        RuleResult::Fault(Box::new(step.event(Cause::Unattributed, severity, text)))
    }

    /// Forgets the last throws, and keeps the usual time.
    pub(super) fn forget_recent(self) -> Self {
        Self { long: 0, longest: [0.0; 2], ..self }
    }
}
