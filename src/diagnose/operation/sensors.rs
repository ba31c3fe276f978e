//! Alarms about the values of sensors: implausible temperature or voltage, unusable current or position.

use super::{Implausible, Operation};
use crate::diagnose::{
    Cause, SensorChannel,
    alarm::{Rule, Step},
    observation::Unusable,
    statistics::streak,
    text,
};

/// Consecutive rejected temperatures or voltages that raise the alarm: one is a disturbance.
const IMPLAUSIBLE_IN_A_ROW: i32 = 3;
/// Throws with an unusable channel among the last eight that raise the alarm: one or two are disturbances.
const UNUSABLE_OF_EIGHT: u32 = 3;
/// The sensors beside the throw, in the order of their counters.
const BESIDE: [SensorChannel; 2] = [SensorChannel::Temperature, SensorChannel::Supply];
/// The sensors of the trace, in the order of their counters.
const OF_TRACE: [SensorChannel; 3] = [SensorChannel::Current, SensorChannel::Position, SensorChannel::Clock];

impl Operation {
    /// Applies temperature and supply voltage of a throw: whether the throw has the value, and why it is implausible;
    /// `None` if it is plausible. A throw without the value does not show that the sensor works.
    pub(crate) fn on_sensors(&mut self, values: [(bool, Option<Implausible>); 2], step: &mut Step) {
        for ((channel, (has_value, found)), run) in BESIDE.into_iter().zip(values).zip(&mut self.plausible) {
            if found.is_some() {
                *run = (*run).min(0).saturating_sub(1);
            } else if has_value {
                *run = (*run).max(0).saturating_add(1);
            }
            if let Some(implausible) = found.filter(|_| *run <= -IMPLAUSIBLE_IN_A_ROW) {
                let event = step.sensor(channel, text::sensor_implausible(step.name, implausible));
                step.alarms.raise_another(Rule::Usual, event, *run == -IMPLAUSIBLE_IN_A_ROW);
            } else if i64::from(*run) >= step.settings.off_delay_throws.into() && is_about(&[channel], step) {
                step.clear(Cause::Sensor, |name| text::sensor_again(name, channel, "plausible"));
            }
        }
    }

    /// Applies the channel that is unusable in a throw; `None` if all are usable.
    pub(crate) fn on_channel(&mut self, found: Option<Unusable>, step: &mut Step) {
        let faulty = found.map(Unusable::channel);
        streak(&mut self.usable, faulty.is_none());
        let is_unusable = |throws: u8| throws.count_ones() >= UNUSABLE_OF_EIGHT;
        for (channel, throws) in OF_TRACE.into_iter().zip(&mut self.unusable_in) {
            let before = *throws;
            *throws = before << 1 | u8::from(faulty == Some(channel));
            if is_unusable(*throws) {
                let found = found.filter(|found| found.channel() == channel).unwrap_or(Unusable::Values(channel));
                let event = step.sensor(channel, text::sensor_unusable(step.name, found));
                step.alarms.raise_another(Rule::Usual, event, !is_unusable(before));
            }
        }
        if self.usable >= step.settings.off_delay_throws.max(u8::BITS)
            && is_about(&OF_TRACE, step)
            && let Some(channel) = step.alarms.faulty_sensor()
        {
            step.clear(Cause::Sensor, |name| text::sensor_again(name, channel, "usable"));
        }
    }
}

/// Whether the active sensor alarm is of this rule, about one of these sensors.
fn is_about(channels: &[SensorChannel], step: &Step) -> bool {
    step.alarms.rule(Cause::Sensor) == Some(Rule::Usual)
        && step.alarms.faulty_sensor().is_some_and(|channel| channels.contains(&channel))
}
