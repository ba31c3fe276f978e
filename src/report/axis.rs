//! Axes of a chart: their range, ticks at round numbers, and the position of a value.

use super::calendar::{self, Tick};

/// Shortest time axis \[s\]; needed as the values of a single throw have no span.
const LEAST_TIME: f64 = 60.0;

/// An axis with its range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Axis {
    low: f64,
    high: f64,
}

impl Axis {
    /// An axis over all finite `values`. With `from_zero` it includes 0.
    pub(super) fn over(values: impl Iterator<Item = f64>, from_zero: bool) -> Self {
        let shown = values.filter(|value| value.is_finite());
        let (mut low, mut high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if from_zero {
            (low, high) = (low.min(0.0), high.max(0.0));
        }
        if high - low < 1e-12 * high.abs().max(1e-3) {
            (low, high) = (low - 0.5, high + 0.5);
        }
        let step = round_step((high - low) / 6.0);
        // A value that is beyond a round number by less than 5 % of a step does not extend the axis by a whole step.
        Self { low: (low / step + 0.05).floor() * step, high: (high / step - 0.05).ceil() * step }
    }

    /// An axis from the lowest to the highest value, without margins.
    pub(super) fn tight(values: &(impl Iterator<Item = f64> + Clone)) -> Self {
        let rounded = Self::over(values.clone(), false);
        let finite = || values.clone().filter(|value| value.is_finite());
        let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
        if high > low { Self { low, high } } else { rounded }
    }

    /// A time axis over the values \[s since 1970\], at least [`LEAST_TIME`] long.
    pub(super) fn of_time(values: &(impl Iterator<Item = f64> + Clone)) -> Self {
        let Self { low, high } = Self::tight(values);
        let widen = 0.5 * (LEAST_TIME - (high - low)).max(0.0);
        Self { low: low - widen, high: high + widen }
    }

    /// Ticks with dates and times. `characters` is the length of the axis in characters of a label.
    pub(super) fn dates(&self, characters: f64) -> Vec<Tick> {
        calendar::ticks(self.low, self.high, characters)
    }

    /// Position of a value on the axis, from 0 at the low end to 1 at the high end; `None` for a value that is not
    /// finite.
    pub(super) fn place(&self, value: f64) -> Option<f64> {
        let place = (value - self.low) / (self.high - self.low);
        place.is_finite().then_some(place)
    }

    /// Ticks with numbers.
    pub(super) fn numbers(&self) -> Vec<Tick> {
        let tick = |value| Tick { value, label: self.label(value), below: None };
        self.ticks().into_iter().map(tick).collect()
    }

    /// The values of the ticks.
    fn ticks(&self) -> Vec<f64> {
        let step = round_step((self.high - self.low) / 6.0);
        let first = (self.low / step - 1e-9).ceil();
        let tick = |at: i32| (first + f64::from(at)) * step;
        (0..40).map(tick).take_while(|value| *value <= self.high + step * 1e-9).collect()
    }

    /// Label of a tick, with enough decimals to distinguish neighbouring ticks.
    fn label(&self, tick: f64) -> String {
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
        let axis = Axis::over([0.3, 97.0].into_iter(), true);
        assert_eq!(axis.ticks(), [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]);
        assert_eq!(axis.label(20.0), "20");
        assert_eq!(axis.place(50.0), Some(0.5));
        assert_eq!(axis.place(f64::NAN), None);
        assert_eq!(Axis::over(std::iter::empty(), false).ticks().len(), 6);
        let fine = Axis::over([0.97, 1.03].into_iter(), false);
        assert_eq!(fine.label(0.98), "0.98");
    }
}
