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
const IMPLAUSIBLE_IN_A_ROW: u32 = 3;
/// Throws with an unusable channel among the last eight that raise the alarm: one or two are disturbances.
const UNUSABLE_OF_EIGHT: u32 = 3;

impl Operation {
    /// Applies an implausible temperature or supply voltage of a throw; `None` if both are plausible.
    pub(crate) fn on_sensors(&mut self, implausible: Option<Implausible>, step: &mut Step) {
        streak(&mut self.disbelieved, implausible.is_some());
        streak(&mut self.believed, implausible.is_none());
        if let Some(implausible) = implausible.filter(|_| self.disbelieved >= IMPLAUSIBLE_IN_A_ROW) {
            let channel = match implausible {
                Implausible::Supply(_) => SensorChannel::Supply,
                Implausible::Impossible(_)
                | Implausible::Jump(..)
                | Implausible::Missing(_)
                | Implausible::Stuck(..) => SensorChannel::Temperature,
            };
            let event = step.sensor(channel, text::sensor_implausible(step.name, implausible));
            step.alarms.raise_another(Rule::Usual, event, self.disbelieved == IMPLAUSIBLE_IN_A_ROW);
        } else if self.believed >= step.settings.off_delay_throws
            && step.alarms.rule(Cause::Sensor) == Some(Rule::Usual)
            && matches!(step.alarms.faulty_sensor(), None | Some(SensorChannel::Temperature | SensorChannel::Supply))
        {
            step.clear(Cause::Sensor, text::machine(step.name, text::SENSOR_PLAUSIBLE));
        }
    }

    /// Applies the channel that is unusable in a throw; `None` if all are usable.
    pub(crate) fn on_channel(&mut self, found: Option<Unusable>, step: &mut Step) {
        let faulty = found.map(Unusable::channel);
        streak(&mut self.usable, faulty.is_none());
        let before = self.unusable;
        if let Some((channel, throws)) = &mut self.unusable {
            *throws = *throws << 1 | u8::from(faulty == Some(*channel));
        }
        let over = self.unusable.is_none_or(|(_, throws)| throws == 0);
        if let Some(channel) = faulty.filter(|_| over) {
            self.unusable = Some((channel, 1));
        }
        let Some((channel, throws)) = self.unusable else { return };
        if throws.count_ones() >= UNUSABLE_OF_EIGHT {
            let found = found.filter(|found| found.channel() == channel).unwrap_or(Unusable::Values(channel));
            let event = step.sensor(channel, text::sensor_unusable(step.name, found));
            let is_new = before.is_none_or(|(of, throws)| of != channel || throws.count_ones() < UNUSABLE_OF_EIGHT);
            step.alarms.raise_another(Rule::Usual, event, is_new);
        } else if self.usable >= step.settings.off_delay_throws.max(u8::BITS) {
            self.unusable = None;
            if step.alarms.faulty_sensor() == Some(channel) && step.alarms.rule(Cause::Sensor) == Some(Rule::Usual) {
                step.clear(Cause::Sensor, text::sensor_usable(step.name, channel));
            }
        }
    }
}
