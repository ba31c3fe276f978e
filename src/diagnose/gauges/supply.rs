//! The supply of the motor: a change of its voltage, and what this change does to the motion.

use super::{Gauge, Gauges};
use crate::diagnose::statistics::{Level, WINDOWS};

/// Least significance of a change of the supply \[standard deviations\].
const SIGNIFICANT_SD: f64 = 4.0;
/// Least relevant change of the supply, as a logarithm.
const LEAST_CHANGE: f64 = 0.05;
/// Range of the increase in duration as part of the loss of supply voltage, both as logarithms.
const DURATION_PER_LOSS: std::ops::Range<f64> = 0.6..1.7;
/// Largest apparent change of the motor, as part of the change of the logarithm of the inrush current. Measured on an
/// independent drive at 250 Hz: a change by 0.08 with twice the resistance.
const MOTOR_OF_INRUSH: f64 = 0.12;
/// Dry part of the friction of a machine: mean and standard deviation of an even distribution from 0 to 1. The part is
/// unknown, as the speed in a throw hardly changes and so a constant torque looks like viscous friction.
const DRY: (f64, f64) = (0.5, 0.29);

/// Rise of ln a1 by dry friction in a movement that takes `longer`, a change of the duration as a logarithm: dry
/// friction F at the speed v adds F/v to a1.
pub(crate) fn dry_rise(longer: Level) -> Level {
    let Level { value, sd } = longer;
    Level { value: DRY.0 * value, sd: (DRY.1 * value).hypot(DRY.0 * sd) }
}

impl Gauges {
    /// Loss of supply voltage as a logarithm; `None` unless the loss is significant and the duration agrees.
    pub(crate) fn supply_lost(&self, throws: usize) -> Option<Level> {
        let lost = self.supply_change(throws)?;
        let longer = self.level(Gauge::Duration, throws)?;
        let changed = lost.value.abs() > LEAST_CHANGE.max(SIGNIFICANT_SD * lost.sd);
        (changed && DURATION_PER_LOSS.contains(&(longer.value / lost.value))).then_some(lost)
    }

    /// Loss of supply voltage as a logarithm: from the published voltage less its error, else from the inrush current.
    pub(crate) fn supply_change(&self, throws: usize) -> Option<Level> {
        let gauge = self.level(Gauge::Volts, throws).or_else(|| self.level(Gauge::Inrush, throws))?;
        let is_wrong = self.voltage_error_in(WINDOWS[0]).is_some();
        let error = self.level(Gauge::BackEmf, throws).filter(|_| is_wrong);
        Some(Level { value: error.map_or(0.0, |error| error.value) - gauge.value, ..gauge })
    }

    /// Largest apparent change of the motor by a change of the inrush current, both as logarithms. With a smaller
    /// inrush, dry friction takes a larger part of the torque: at most the ratio of the running current to the inrush
    /// current.
    pub(crate) fn motor_of_inrush(&self, change: f64) -> f64 {
        MOTOR_OF_INRUSH.max(self.running_of_inrush()) * change.abs()
    }
}
