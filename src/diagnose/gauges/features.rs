//! Watches the features of throws whose coefficients cannot be judged: on machines with a current sensor only, on
//! machines whose throws are rejected one after the other, and on machines whose throws are all rough, so that there is
//! no baseline. A rejection is a verdict on the data: the features may still show a fault of the machine.

use std::ops::Range;

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

use super::{Gauge, GaugeChange, Gauges, sd_of_mean};
use crate::{
    diagnose::{
        Cause, SensorChannel, Severity,
        alarm::{RuleResult, Step, count_over},
        statistics::{LONGEST_WINDOW, LastValues, Level, median, percent, to_f32},
        text,
    },
    estimate::Features,
    throw::Direction,
};

/// The watched features, each with the least change that matters, as a logarithm. From this size on, a significant
/// change is reported; from `critical_factor` times this size on, the change is critical. On a healthy machine, the
/// running current changes by some percent with the weather; the duration and the travel of a throw hardly change.
const WATCHED: [(Gauge, f64); 4] =
    [(Gauge::Duration, 0.08), (Gauge::Running, 0.15), (Gauge::Charge, 0.15), (Gauge::Travel, 0.03)];
/// Number of throws of a direction in a level, which is their median.
const LEVEL: usize = 6;
/// Least significant change of a level, in standard deviations of one throw: this standard deviation comes from 12 to
/// 24 throws only, and consecutive throws are correlated.
const SIGNIFICANT_SD: f64 = 4.0;

/// A change that has grown by this factor since it was last reported is reported again.
const LARGER: f64 = 1.5;
/// Factor on the limit of a slow change of a current on a machine without a temperature. Seasons of 20 K above and
/// below the mean change the current by 0.16 (as a logarithm), and the baseline may be from one end of this range.
const OF_SEASON: f64 = 2.0;
/// Part of a slow change that existed a week ago: a season takes months.
pub(crate) const SLOW_FROM: f64 = 1.0 / 3.0;
/// Longest time for which rain lowers the friction: two wet days and a day of drying.
const RAIN: SignedDuration = SignedDuration::from_hours(72);
/// Losses of friction by rain or grease \[%\]: water halves the friction of steel on steel, a part of the machine's
/// friction.
pub(crate) const RAIN_PCT: Range<f64> = 10.0..25.0;
/// Least time and least number of throws of a direction between a change and the earlier one to which it is compared.
const EARLIER: (SignedDuration, u32) = (SignedDuration::from_hours(7 * 24), 6);

/// Departures of the watched features from their normal values, beyond what supply and temperature explain, each with
/// its standard deviation; both as logarithms.
type Unexplained = [Option<(f32, f32)>; WATCHED.len()];
/// Changes of the watched features, as logarithms.
type FeatureChanges = [f32; WATCHED.len()];

/// The changes of a direction at two earlier times. A change by the season comes slowly, so it existed then too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Earlier {
    since: Timestamp,
    /// Time of the last throw.
    last: Timestamp,
    /// Number of throws after `since`.
    throws: u32,
    /// Changes at `since`, and at the value of `since` before it.
    changes: [FeatureChanges; 2],
}

impl Earlier {
    fn new(at: Timestamp, present: FeatureChanges) -> Self {
        Self { since: at, last: at, throws: 0, changes: [present, FeatureChanges::default()] }
    }

    /// Adds a throw of the direction with these present changes.
    fn follow(&mut self, at: Timestamp, present: FeatureChanges) {
        self.throws = self.throws.saturating_add(1);
        self.last = at;
        if self.throws >= EARLIER.1 && self.is_past() {
            *self = Self { changes: [present, self.changes[0]], ..Self::new(at, present) };
        }
    }

    /// Whether the changes at `since` are old enough for a comparison.
    fn is_past(&self) -> bool {
        self.last.duration_since(self.since) >= EARLIER.0
    }

    /// The newest changes that are old enough for a comparison.
    fn changes(&self) -> &FeatureChanges {
        &self.changes[usize::from(!self.is_past())]
    }
}

/// The features of the last throws whose coefficients are not judged.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct FeatureWatch {
    /// The last throws of each direction, the newest last.
    sides: [LastValues<Unexplained, LEVEL>; 2],
    /// Number of consecutive throws without a change.
    calm: u32,
    /// Largest change when one was last reported, as a multiple of the change that matters; 0 without a report.
    reported: f64,
    /// Time of the first throw of a fall of the load, and number of throws since.
    #[serde(skip_serializing_if = "Option::is_none")]
    fallen: Option<(Timestamp, u32)>,
    /// The earlier changes of each direction, if the machine has no temperature.
    earlier: [Option<Box<Earlier>>; 2],
    /// Change of a current \[%\] that raises no alarm, as it is slow enough to come from the season.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) season_pct: Option<f32>,
}

/// Usual running current, as part of the inrush, below which the load may change it by a multiple: a spring drives one
/// direction.
const LIGHT: f64 = 0.08;

/// The departure of a feature in the last throws of a direction.
struct JudgedChange {
    /// Size as a multiple of the least change that matters and is significant.
    size: f64,
    change: GaugeChange,
    /// Whether the change may come from the season.
    is_slow: bool,
}

/// Whether rain may still be the reason of a fall of the load `since` a time, after this number of throws. Throws that
/// are made at once do not show that the fall lasts.
pub(crate) fn may_rain_last(since: Timestamp, throws: u64, at: Timestamp) -> bool {
    at.duration_since(since).abs() < RAIN || throws < LONGEST_WINDOW.into()
}

impl FeatureWatch {
    /// Applies a throw whose coefficients are not judged.
    pub(crate) fn on_features(
        &mut self,
        direction: Direction,
        (features, celsius): (&Features, Option<f64>),
        gauges: &Gauges,
        step: &Step,
    ) -> RuleResult {
        let side = direction.side();
        let departures = gauges.unexplained(WATCHED.map(|(gauge, _)| gauge), direction, features, celsius);
        if departures.iter().all(Option::is_none) {
            // A damaged throw among good ones must not hide their change.
            return RuleResult::Unclear;
        }
        self.sides[side].push(departures);
        // A temperature that is published only after the normal values were learned does not show the season.
        let is_known = |gauge| gauges.normal(direction, gauge).is_some();
        let compared = celsius.filter(|_| is_known(Gauge::Air) || !is_known(Gauge::Running));
        self.follow_season(side, compared, step.at);
        let levels: Vec<JudgedChange> = (0..WATCHED.len()).filter_map(|at| self.largest(at)).collect();
        let largest = levels.iter().map(|level| level.size).max_by(f64::total_cmp);
        count_over(&mut self.calm, largest);
        let seasonal = levels.iter().find(|level| level.is_slow && level.size <= 1.0 && OF_SEASON * level.size > 1.0);
        let pct = |departure: &JudgedChange| to_f32(percent(departure.change.level.value));
        self.season_pct = seasonal.map(pct);
        let changes: Vec<GaugeChange> =
            levels.iter().filter(|level| level.size > 1.0).map(|level| level.change).collect();
        let waits = self.is_new_fall(&changes, step.at) && self.reported == 0.0;
        if let Some(largest) = largest.filter(|_| !changes.is_empty() && !waits) {
            let runs_light = (f64::EPSILON..LIGHT).contains(&gauges.running_of_inrush());
            let text = text::features(step.name, &changes, LEVEL, [features.run_on_s.is_some(), runs_light]);
            let is_larger = self.reported > 0.0 && largest > LARGER * self.reported;
            if is_larger || self.reported == 0.0 {
                self.reported = largest;
            }
            let is_critical = largest > step.settings.critical_factor;
            let severity = if is_critical { Severity::Critical } else { Severity::Warning };
            let event = Box::new(step.event(Cause::Unattributed, severity, text));
            return if is_larger { RuleResult::Larger(event) } else { RuleResult::Fault(event) };
        }
        if self.calm < step.settings.off_delay_throws {
            return RuleResult::Unclear;
        }
        self.reported = 0.0;
        RuleResult::Nothing
    }

    /// Applies a throw with an estimate, after which the drift rule judges this direction again.
    pub(crate) fn on_estimate(&mut self, direction: Option<Direction>) -> RuleResult {
        if let Some(direction) = direction {
            self.sides[direction.side()].pop_oldest();
        }
        if !self.sides.iter().all(|side| side.is_empty()) {
            return RuleResult::Unclear;
        }
        (self.reported, self.season_pct) = (0.0, None);
        RuleResult::Nothing
    }

    /// Whether a fault of this sensor explains all features that are changed in the last throws.
    pub(crate) fn is_explained_by(&self, sensor: SensorChannel) -> bool {
        let found = (0..WATCHED.len()).filter_map(|at| self.largest(at)).filter(|change| change.size > 1.0);
        let changed: Vec<Gauge> = found.map(|found| found.change.gauge).collect();
        let is_measured = |gauge: &Gauge| match gauge {
            Gauge::Duration => matches!(sensor, SensorChannel::Position | SensorChannel::Clock),
            Gauge::Charge => matches!(sensor, SensorChannel::Current | SensorChannel::Clock),
            Gauge::Travel => sensor == SensorChannel::Position,
            _ => sensor == SensorChannel::Current,
        };
        !changed.is_empty() && changed.iter().all(is_measured)
    }

    /// Whether features of the last throws were compared with normal values.
    pub(crate) fn is_monitoring(&self) -> bool {
        self.sides.iter().flat_map(|side| side.iter()).any(|departures| departures.iter().any(Option::is_some))
    }

    /// Whether these `changes` are a fall of the load that may pass: rain and grease lower the friction for some days.
    /// The charge falls with both current and duration, so these two count.
    fn is_new_fall(&mut self, changes: &[GaugeChange], at: Timestamp) -> bool {
        let is_fall = |change: &GaugeChange| change.gauge != Gauge::Travel && change.level.value < 0.0;
        let is_small = |change: &GaugeChange| change.gauge == Gauge::Charge || -change.level.pct() < RAIN_PCT.end;
        // Weak magnets or a higher voltage shorten the throws too, but the load stays.
        let is_of_load = |change: &GaugeChange| matches!(change.gauge, Gauge::Running | Gauge::Charge);
        let is_of_fall = changes.iter().all(is_fall) && (changes.is_empty() || changes.iter().any(is_of_load));
        if self.calm > 0 || !is_of_fall {
            self.fallen = None;
        } else if let Some((_, throws)) = &mut self.fallen {
            *throws = throws.saturating_add(1);
        } else if !changes.is_empty() {
            self.fallen = Some((at, 0));
        }
        self.fallen.is_some_and(|(since, throws)| may_rain_last(since, throws.into(), at))
            && changes.iter().all(is_small)
    }

    /// Stores the earlier changes of a side of a machine without a temperature.
    fn follow_season(&mut self, side: usize, celsius: Option<f64>, at: Timestamp) {
        if celsius.is_some() {
            self.earlier[side] = None;
            return;
        }
        let present: FeatureChanges = std::array::from_fn(|gauge| {
            self.level(side, gauge).map_or(0.0, |departure| to_f32(departure.change.level.value))
        });
        self.earlier[side].get_or_insert_with(|| Box::new(Earlier::new(at, present))).follow(at, present);
    }

    /// The departure of a watched feature in the direction with the larger one; `None` if neither is known.
    fn largest(&self, at: usize) -> Option<JudgedChange> {
        [0, 1].into_iter().filter_map(|side| self.level(side, at)).max_by(|a, b| a.size.total_cmp(&b.size))
    }

    /// The departure of a watched feature in the last throws of a side; `None` with too few throws.
    fn level(&self, side: usize, at: usize) -> Option<JudgedChange> {
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
        // Only without an alarm: one about a change that came at once must not end because the change lasts.
        let is_slow = gauge.follows_weather()
            && self.reported == 0.0
            && self.earlier[side].as_ref().is_some_and(|before| f64::from(before.changes()[at]) / size > SLOW_FROM);
        let limit = if is_slow { OF_SEASON * limit } else { limit };
        let change = GaugeChange { gauge, level: Level { value: size, sd: size_sd } };
        Some(JudgedChange { size: size.abs() / limit.max(SIGNIFICANT_SD * sd), change, is_slow })
    }
}
