//! Offsets of the sensors of current and position.

use super::{Gauge, Gauges, normal::least_rest_a, values};
use crate::{
    diagnose::statistics::{Level, WINDOWS},
    estimate::Features,
    throw::{Channel, Direction},
};

/// Least significance of a change of the current at rest, in standard deviations of a level: the mean of a few samples
/// with hum scatters.
const REST_SD: f64 = 4.0;
/// Least reported shift of the position sensor's zero, as part of the travel. A shift of 4 % changes the friction by
/// 5 % in one direction and by -5 % in the other.
const SHIFT_SHARE: f64 = 0.04;
/// Least change of a start or end position that counts as changed, as part of the travel.
const END_SHARE: f64 = 0.01;
/// Least significance of a shift, in standard deviations of a level.
const SHIFT_SD: f64 = 4.0;

impl Gauges {
    /// Offset of a sensor, and its size relative to the least reported offset: that of the current sensor by the
    /// current at rest, that of the position sensor by both ends of the movement. The level is that of the last three
    /// throws; six throws must show the offset too.
    pub(crate) fn offset(&self, sensor: Channel) -> Option<(Level, f64)> {
        let ((level, size), (_, longer)) = (self.offset_in(sensor, WINDOWS[0])?, self.offset_in(sensor, WINDOWS[1])?);
        Some((level, size.min(longer)))
    }

    /// [`Self::offset`] over the last `throws`.
    fn offset_in(&self, sensor: Channel, throws: usize) -> Option<(Level, f64)> {
        let (level, least) = match sensor {
            Channel::Current => {
                let level = self.level(Gauge::Rest, throws)?;
                (level, self.least_rest_a().max(REST_SD * level.sd))
            }
            Channel::Position => {
                let [level, travel] = [Gauge::Middle, Gauge::Travel].map(|gauge| self.level(gauge, throws));
                let (level, changed, travel_mm) = (level?, travel?.value, self.normal_travel_mm()?);
                // If the travel changed as much, only one end has moved, or the gain of the sensor has changed.
                let is_shift = (travel_mm * changed).abs() < level.value.abs();
                let least = if is_shift { SHIFT_SHARE * travel_mm } else { f64::INFINITY };
                (level, least.max(SHIFT_SD * level.sd))
            }
        };
        Some((level, level.value.abs() / least))
    }

    /// Shift of the position at the normal end, as part of the travel, if the positions of both ends have changed, as
    /// after the position sensor was moved or set anew. An obstruction changes only one end. `None` if the shift is
    /// small or unknown.
    pub(crate) fn shift(&self, direction: Direction, features: &Features) -> Option<f64> {
        let (normal, values) = (&self.sides[direction.side()], values(features, None));
        let [now, before] = [values[Gauge::Middle as usize]?, normal.of(Gauge::Middle)?.0].map(f64::from);
        let [travel_mm, usual_mm] =
            [values[Gauge::Travel as usize]?, normal.of(Gauge::Travel)?.0].map(|ln| f64::from(ln).exp());
        let [middle, half] = [now - before, (travel_mm - usual_mm) / 2.0];
        let ends = [middle - half, middle + half];
        let is_other = ends.iter().all(|change_mm| change_mm.abs() > END_SHARE * usual_mm);
        (is_other && ends[0].abs() > SHIFT_SHARE * usual_mm).then_some(ends[0] / travel_mm)
    }

    /// Normal current at rest \[A\], if it is as large as a change that is reported.
    pub(crate) fn normal_rest_a(&self) -> Option<f64> {
        let normal = self.normals(Gauge::Rest).max_by(|a, b| a.abs().total_cmp(&b.abs()));
        normal.filter(|normal| normal.abs() > self.least_rest_a())
    }

    /// Least change of the current at rest that is reported \[A\].
    fn least_rest_a(&self) -> f64 {
        least_rest_a(self.normals(Gauge::Inrush).map(f64::exp).fold(0.0, f64::max))
    }
}
