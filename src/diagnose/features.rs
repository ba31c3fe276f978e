//! The features of throws whose coefficients cannot be judged: of machines with a current sensor only, of machines
//! whose throws are rejected one after the other, and of machines whose throws are all rough, so that they have no
//! baseline. A rejection concerns the data: the features may still show a fault.

use serde::{Deserialize, Serialize};

use super::{
    event::{Cause, Severity},
    found::{Found, count_over},
    gauges::{Change, Gauge, Gauges, sd_of_mean},
    last::Last,
    robust::median,
    step::Step,
    text,
};
use crate::{estimate::Features, throw::Direction};

/// The watched features, with the change that matters as a logarithm; `critical_factor` times it is critical. The running
/// current of a healthy machine follows the weather by some percent; the duration and the travel hardly change.
const WATCHED: [(Gauge, f64); 4] =
    [(Gauge::Duration, 0.08), (Gauge::Running, 0.15), (Gauge::Charge, 0.15), (Gauge::Travel, 0.03)];
/// Throws of a direction in a level.
const LEVEL: usize = 6;
/// Significant change of a level, in standard deviations of one throw: the standard deviation comes from a dozen throws
/// or two, and consecutive throws are correlated.
const SIGNIFICANT_SD: f64 = 4.0;

/// A change that has grown by this factor since it was last reported is reported again.
const LARGER: f64 = 1.5;

/// Departures of the watched features from normal, beyond what the supply explains, and their standard deviations.
type Departures = [Option<(f32, f32)>; WATCHED.len()];

/// The features of the last throws without an estimate.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct FeatureWatch {
    /// The throws of each direction, the newest last.
    sides: [Last<Departures, LEVEL>; 2],
    calm: u32,
    /// Largest change when it was last reported, as multiple of the change that matters.
    #[serde(default)]
    reported: f64,
}

impl FeatureWatch {
    /// Applies a throw without an estimate.
    pub(super) fn on_features(
        &mut self,
        direction: Direction,
        (features, celsius): (&Features, Option<f64>),
        gauges: &Gauges,
        step: &Step,
    ) -> Found {
        let recent = &mut self.sides[direction.side()];
        recent.push(gauges.unexplained(WATCHED.map(|(gauge, _)| gauge), direction, features, celsius));
        let levels = self.levels();
        let largest = levels.iter().map(|(size, _)| *size).max_by(f64::total_cmp);
        count_over(&mut self.calm, largest);
        let changes: Vec<Change> =
            levels.into_iter().filter_map(|(size, change)| (size > 1.0).then_some(change)).collect();
        if let Some(largest) = largest.filter(|_| !changes.is_empty()) {
            let text = text::features(step.name, &changes, LEVEL);
            let is_larger = self.reported > 0.0 && largest > LARGER * self.reported;
            if is_larger || self.reported == 0.0 {
                self.reported = largest;
            }
            let is_critical = largest > step.settings.critical_factor;
            let severity = if is_critical { Severity::Critical } else { Severity::Warning };
            let event = Box::new(step.event(Cause::Unattributed, severity, text));
            return if is_larger { Found::Larger(event) } else { Found::Fault(event) };
        }
        if self.calm < step.settings.off_delay_throws {
            return Found::Unclear;
        }
        self.reported = 0.0;
        Found::Nothing
    }

    /// Applies a throw with an estimate: the drift rule judges its direction again.
    pub(super) fn on_estimate(&mut self, direction: Option<Direction>) -> Found {
        if let Some(direction) = direction {
            self.sides[direction.side()].pop_oldest();
        }
        if !self.sides.iter().all(|side| side.is_empty()) {
            return Found::Unclear;
        }
        self.reported = 0.0;
        Found::Nothing
    }

    /// Whether features of the last throws were compared with normal values.
    pub(super) fn is_monitoring(&self) -> bool {
        self.sides.iter().flat_map(|side| side.iter()).any(|departures| departures.iter().any(Option::is_some))
    }

    /// Deletes the last throws, after maintenance.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// The change of each feature that is known, in the direction with the larger one, and its size relative to what is
    /// significant and relevant.
    fn levels(&self) -> Vec<(f64, Change)> {
        let in_side = |side: usize, at: usize| {
            let (gauge, limit) = WATCHED[at];
            let of = |part: fn(&(f32, f32)) -> f32| -> Vec<f64> {
                let known = self.sides[side].iter().filter_map(|departures| departures[at].as_ref());
                known.map(part).map(f64::from).collect()
            };
            let mut values = of(|(value, _)| *value);
            if values.len() < LEVEL {
                return None;
            }
            let size = median(&mut values);
            let sd = median(&mut of(|(_, sd)| *sd)).max(gauge.floor());
            let size_sd = sd_of_mean(gauge, sd, LEVEL as f64);
            Some((size.abs() / limit.max(SIGNIFICANT_SD * sd), Change { gauge, size, size_sd }))
        };
        let largest =
            |at: usize| [0, 1].into_iter().filter_map(|side| in_side(side, at)).max_by(|a, b| a.0.total_cmp(&b.0));
        (0..WATCHED.len()).filter_map(largest).collect()
    }
}
