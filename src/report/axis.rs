//! Axes of a chart: their range, ticks at round numbers, and the position of a value.

use super::calendar::{self, Tick};

/// Shortest time axis \[s\]; needed as the values of a single throw have no span.
const LEAST_TIME: f64 = 60.0;

/// An axis with its range, linear or logarithmic.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    low: f64,
    high: f64,
    log: bool,
}

impl Axis {
    /// An axis over all finite `values`, or over the positive values if it is logarithmic. With `from_zero` a linear
    /// axis includes 0.
    pub(super) fn over(values: impl Iterator<Item = f64>, log: bool, from_zero: bool) -> Self {
        let shown = values.filter(|value| value.is_finite() && (!log || *value > 0.0));
        let (mut low, mut high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = if log { (1.0, 10.0) } else { (0.0, 1.0) };
        }
        if log {
            low = 10.0_f64.powf(low.log10().floor());
            high = 10.0_f64.powf(high.log10().ceil()).max(low * 10.0);
            return Self { low, high, log };
        }
        if from_zero {
            (low, high) = (low.min(0.0), high.max(0.0));
        }
        if high - low < 1e-12 * high.abs().max(1e-3) {
            (low, high) = (low - 0.5, high + 0.5);
        }
        let step = round_step((high - low) / 6.0);
        // A value that is beyond a round number by less than 5 % of a step does not extend the axis by a whole step.
        Self { low: (low / step + 0.05).floor() * step, high: (high / step - 0.05).ceil() * step, log }
    }

    /// A linear axis from the lowest to the highest value, without margins.
    pub(super) fn tight(values: &(impl Iterator<Item = f64> + Clone)) -> Self {
        let rounded = Self::over(values.clone(), false, false);
        let finite = || values.clone().filter(|value| value.is_finite());
        let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
        if high > low { Self { low, high, log: false } } else { rounded }
    }

    /// A time axis over the values \[s since 1970\], at least [`LEAST_TIME`] long.
    pub(super) fn of_time(values: &(impl Iterator<Item = f64> + Clone)) -> Self {
        let Self { low, high, log } = Self::tight(values);
        let widen = 0.5 * (LEAST_TIME - (high - low)).max(0.0);
        Self { low: low - widen, high: high + widen, log }
    }

    /// Ticks with dates and times. `characters` is the length of the axis in characters of a label.
    pub(super) fn dates(&self, characters: f64) -> Vec<Tick> {
        calendar::ticks(self.low, self.high, characters)
    }

    /// Position of a value on the axis, from 0 at the low end to 1 at the high end; `None` for a value that the axis
    /// cannot show (not finite, or not positive on a logarithmic axis).
    pub(super) fn place(&self, value: f64) -> Option<f64> {
        let place = if self.log {
            (value / self.low).log10() / (self.high / self.low).log10()
        } else {
            (value - self.low) / (self.high - self.low)
        };
        place.is_finite().then_some(place)
    }

    /// Ticks with numbers.
    pub(super) fn numbers(&self) -> Vec<Tick> {
        let tick = |value| Tick { value, label: self.label(value), below: None };
        self.ticks().into_iter().map(tick).collect()
    }

    /// The values of the ticks.
    fn ticks(&self) -> Vec<f64> {
        if self.log {
            let decades = (self.high / self.low).log10().round();
            return (0..=30)
                .map(f64::from)
                .take_while(|d| *d <= decades)
                .map(|d| self.low * 10.0_f64.powf(d))
                .collect();
        }
        let step = round_step((self.high - self.low) / 6.0);
        let first = (self.low / step - 1e-9).ceil();
        let tick = |at: i32| (first + f64::from(at)) * step;
        (0..40).map(tick).take_while(|value| *value <= self.high + step * 1e-9).collect()
    }

    /// Label of a tick, with enough decimals to distinguish neighbouring ticks.
    fn label(&self, tick: f64) -> String {
        if self.log {
            return format!("{tick}");
        }
        let step = round_step((self.high - self.low) / 6.0);
        let decimals: usize = [1.0, 0.1, 0.01, 0.001, 1e-4].iter().take_while(|unit| step < **unit * 0.999).count();
        let tick = if tick.abs() < step * 1e-9 { 0.0 } else { tick };
        format!("{tick:.decimals$}")
    }
}

/// The smallest number of the form 1, 2 or 5 times a power of ten that is at least `rough`.
fn round_step(rough: f64) -> f64 {
    let power = 10.0_f64.powf(rough.log10().floor());
    [1.0, 2.0, 5.0]
        .into_iter()
        .map(|digit| digit * power)
        .find(|step| *step >= rough * 0.999_999)
        .unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let axis = Axis::over([0.3, 97.0].into_iter(), false, true);
        assert_eq!(axis.ticks(), [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]);
        assert_eq!(axis.label(20.0), "20");
        assert_eq!(axis.place(50.0), Some(0.5));
        let log = Axis::over([3.0, 800.0, 0.0, f64::NAN].into_iter(), true, false);
        assert_eq!(log.ticks(), [1.0, 10.0, 100.0, 1000.0]);
        assert_eq!(log.place(0.0), None);
        assert_eq!(Axis::over(std::iter::empty(), false, false).ticks().len(), 6);
        let fine = Axis::over([0.97, 1.03].into_iter(), false, false);
        assert_eq!(fine.label(0.98), "0.98");
    }
}
