//! The throws of each direction in the monitor: the baseline with its learning, and the last throws.

mod courses;
mod learning;

pub(super) use courses::Courses;

use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    Blindness, Cause, HidingTemperature, Settings,
    baseline::{Baseline, BaselineRecord, BaselineThrow, LONGEST_SPELL, Suspicion, WetSpell, covariance_of_effect},
    drift::{
        Departure, Drift, Known, Origin, RecentThrow, RecentThrows, Stream, Tested, Thresholds, UNKNOWN_SCALE_SD,
        Window, attribute, visible_pct, with_middle_kept,
    },
    observation::{Evaluated, relative_to},
    statistics::{LONGEST_WINDOW, Scatter, Sym3, WINDOWS, median, to_f32},
};
use crate::throw::Direction;

/// Time after which the rails are dry again after rain.
const LONGEST_RAIN: SignedDuration = SignedDuration::from_hours(14 * 24);

/// The temperature hides a fault if its uncertain effect makes the least visible size larger by more than this factor.
const HIDES_FROM: f64 = 1.5;

/// The throws of one direction.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
struct Track {
    /// Throws of the baseline, until both directions are complete. No spare memory, as a whole fleet may learn at once.
    learned: Box<[BaselineThrow]>,
    /// Throws set aside while a drift is suspected.
    aside: Vec<BaselineThrow>,
    /// Mean covariance of the estimates of `learned` and `aside`.
    sensor: Sym3,
    baseline: Option<Baseline>,
    thresholds: Option<Thresholds>,
    recent: RecentThrows,
    since_baseline: u64,
    /// Present while the direction has no baseline and is not `of_ratios`.
    #[serde(skip_serializing_if = "Option::is_none")]
    undecided: Option<Box<Undecided>>,
    /// Whether the throws are compared by their ratios only, as many throws have no reliable common scale.
    of_ratios: bool,
    rough: RoughErrors,
}

impl Track {
    /// Whether the baseline has all its throws.
    fn is_final(&self, settings: &Settings) -> bool {
        self.baseline.as_ref().is_some_and(|baseline| baseline.is_final(settings))
    }
}

/// Throws of a direction before its first baseline. They decide whether the direction compares ratios only.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct Undecided {
    /// The ratios of these throws.
    throws: Vec<BaselineThrow>,
    /// Number of rough throws among them.
    rough: usize,
    /// Mean covariance of the ratios.
    sensor: Sym3,
}

/// Size of the errors of rough throws, whose ratios are compared with a baseline of coefficients. The misfit of the
/// model is much the same in each of them, so their stated variance is too large, as healthy throws show.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct RoughErrors {
    throws: u32,
    /// Sum of their squared departures from the baseline beyond the machine's scatter, in stated variances.
    squares: f32,
}

impl RoughErrors {
    /// Number of healthy throws from which the errors are used, and number up to which they are learned.
    const THROWS: (u32, u32) = (6, 24);
    /// Factor on the mean square, as few throws determine it roughly, and least value of the mean square.
    const MARGIN: f64 = 3.0;
    const LEAST: f64 = 0.02;

    /// Adds the squared departure of a throw, beyond the scatter of the machine, relative to the stated variance. A
    /// departure larger than stated is left out, as it may be a fault that is not detected yet.
    fn learn(&mut self, square: f64) {
        if self.throws < Self::THROWS.1 && square < 1.0 {
            (self.throws, self.squares) = (self.throws + 1, self.squares + to_f32(square));
        }
    }

    /// Ratio of the variance of the errors to the stated variance, at most 1. Learned from both directions together, as
    /// their misfit has the same reasons.
    fn share([one, other]: [Self; 2]) -> f64 {
        let throws = one.throws + other.throws;
        if throws < Self::THROWS.0 {
            return 1.0;
        }
        let mean = f64::from(one.squares + other.squares) / f64::from(throws);
        (Self::MARGIN * mean.max(Self::LEAST)).min(1.0)
    }
}

/// Both directions together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Mixed {
    scatter: Scatter,
    thresholds: Thresholds,
}

impl Mixed {
    /// Every throw tests the mixed stream, if there is one, and that of its direction: each gets half of the budget.
    const SHARE: f64 = 0.5;

    fn new(scatter: Scatter, settings: &Settings) -> Self {
        let thresholds = Thresholds::compute(&scatter, Self::SHARE * settings.false_alarms_per_throw());
        Self { scatter, thresholds }
    }
}

/// Baselines and last throws of a machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Tracks {
    sides: [Track; 2],
    mixed: Option<Mixed>,
    /// Trend while the baselines fill: slopes of ln b0, ln a1, ln a0 \[per throw of the machine\]; `None` without a
    /// trend.
    slopes: Option<[f64; 3]>,
    /// Wet spells in the throws of incomplete baselines.
    #[serde(default, skip_serializing_if = "<[WetSpell]>::is_empty")]
    wet: Box<[WetSpell]>,
}

impl Tracks {
    /// The throw with the values that its direction compares: all coefficients, or ratios only.
    pub(super) fn compared(&self, throw: Evaluated) -> Evaluated {
        let track = &self.sides[throw.direction.side()];
        if track.of_ratios { throw.ratios() } else { throw }
    }

    /// Residual of a throw from the baseline of its direction, with temperature compensation. `None` without a
    /// baseline, or if the throw has ratios only.
    pub(super) fn residual(&self, throw: &Evaluated) -> Option<Vector3<f64>> {
        let baseline = self.sides[throw.direction.side()].baseline.as_ref().filter(|_| !throw.ratios_only)?;
        Some(baseline.compensated(baseline.residual(&throw.log, throw.temperature_c)))
    }

    /// Adds a throw to the last throws of its direction; the throw that leaves them updates the temperature
    /// compensation. Returns the residual (of ratios: with the last known common scale); `None` without a baseline.
    pub(super) fn push(
        &mut self,
        throw: &Evaluated,
        order: u64,
        suspicion: Suspicion,
        settings: &Settings,
    ) -> Option<Vector3<f64>> {
        self.refresh_thresholds(settings);
        let side = throw.direction.side();
        let rough_of_other = self.sides[1 - side].rough;
        let track = &mut self.sides[side];
        let baseline = track.baseline.as_mut()?;
        let (mut raw, distance) = baseline.residual(&throw.log, throw.temperature_c);
        let mut sensor = if track.of_ratios { baseline.differing(throw.sensor) } else { throw.sensor };
        if throw.ratios_only && !track.of_ratios {
            // The common scale is unknown. The coefficient with the middle residual counts as unchanged, as a single
            // fault leaves two of the three unchanged. The errors of the others are those of their ratios to this one.
            let compensated = baseline.compensated((raw, distance));
            let mut order = [0, 1, 2];
            order.sort_by(|a, b| compensated[*a].total_cmp(&compensated[*b]));
            let fixed = order[1];
            raw.add_scalar_mut(-compensated[fixed]);
            sensor = relative_to(fixed, &sensor);
            if suspicion.is_none() {
                let departure = baseline.compensated((raw, distance));
                let of_machine = relative_to(fixed, &baseline.scatter.of_one_throw()).trace();
                let stated = sensor.trace() / f64::from(LONGEST_WINDOW);
                track.rough.learn((departure.norm_squared() - of_machine) / stated.max(f64::MIN_POSITIVE));
            }
            sensor *= RoughErrors::share([track.rough, rough_of_other]);
        }
        track.since_baseline += 1;
        let residual = baseline.compensated((raw, distance));
        let known = track.recent.iter().rev().find(|recent| throw.ratios_only && recent.has_scale());
        let scale =
            known.map_or(0.0, |known| baseline.scatter.of_scale().dot(&(baseline.compensated(known.raw()) - residual)));
        let recent = RecentThrow::new(order, raw, distance, sensor.into(), throw.ratios_only);
        let oldest = track.recent.push(recent);
        if let Some(oldest) = oldest.filter(|throw| track.of_ratios || throw.has_scale()) {
            let (raw, distance) = oldest.raw();
            baseline.temperature.learn_on(raw, distance, suspicion, &baseline.scatter);
        }
        if track.of_ratios {
            return Some(with_middle_kept(residual));
        }
        Some(residual.add_scalar(scale))
    }

    /// The departure of a throw from the previous throws of its direction; `None` with too few throws.
    pub(super) fn departure(&self, throw: &Evaluated, settings: &Settings) -> Option<Departure> {
        /// Number of previous throws: few enough that the median follows the weather, and enough that a third of
        /// departures does not change it.
        const BEFORE: std::ops::RangeInclusive<usize> = 6..=12;
        let at = throw.direction.side();
        let track = &self.sides[at];
        let baseline = track.baseline.as_ref().filter(|_| track.of_ratios || !throw.ratios_only)?;
        let residual = baseline.compensated(baseline.residual(&throw.log, throw.temperature_c));
        let compared = track.recent.iter().rev().filter(|throw| track.of_ratios || throw.has_scale());
        let before: Vec<Vector3<f64>> =
            compared.take(*BEFORE.end()).map(|throw| baseline.compensated(throw.raw())).collect();
        let middle = |i: usize| median(&mut before.iter().map(|residual| residual[i]).collect::<Vec<_>>());
        (before.len() >= *BEFORE.start()).then(|| {
            let change = residual - Vector3::from_fn(|i, _| middle(i));
            let of_one_throw = baseline.scatter.of_one_throw();
            let (change, of_one_throw) = if track.of_ratios {
                (with_middle_kept(change), of_one_throw + Matrix3::repeat(UNKNOWN_SCALE_SD * UNKNOWN_SCALE_SD))
            } else {
                (change, of_one_throw)
            };
            Departure { side: at, change, of_one_throw, is_complete: baseline.is_final(settings) }
        })
    }

    /// Whether a direction has a baseline of complete coefficients.
    pub(super) fn has_coefficients(&self, direction: Direction) -> bool {
        let track = &self.sides[direction.side()];
        track.baseline.is_some() && !track.of_ratios
    }

    /// Covariance of one throw of a direction; `None` without a baseline.
    pub(super) fn of_one_throw(&self, direction: Direction) -> Option<Matrix3<f64>> {
        Some(self.sides[direction.side()].baseline.as_ref()?.scatter.of_one_throw())
    }

    /// Converts a snapshot of version 1, whose residuals contain the temperature compensation.
    pub(super) fn add_temperature(&mut self) {
        for track in &mut self.sides {
            if let Some(baseline) = &mut track.baseline {
                track.recent.iter_mut().for_each(|throw| throw.add_temperature(baseline));
            }
        }
    }

    /// Whether a baseline may contain rain that began before it or lasted until its end. Such a spell cannot be taken
    /// out, as its throws do not distinguish it from a fault. Within the longest spell, the rails are dry again.
    pub(super) fn may_have_learned_rain(&self, at: Timestamp) -> bool {
        let is_new = |track: &Track, baseline: &Baseline| {
            track.since_baseline <= LONGEST_SPELL as u64 && at.duration_since(baseline.taken_at) <= LONGEST_RAIN
        };
        self.sides.iter().any(|track| track.baseline.as_ref().is_some_and(|baseline| is_new(track, baseline)))
    }

    fn baselines(&self) -> [Option<&Baseline>; 2] {
        self.sides.each_ref().map(|track| track.baseline.as_ref())
    }

    /// Computes new thresholds after a new baseline, a new stream or a changed budget.
    fn refresh_thresholds(&mut self, settings: &Settings) {
        let share = if self.mixed.is_some() { Mixed::SHARE } else { 1.0 } * settings.false_alarms_per_throw();
        for track in &mut self.sides {
            if let Some(baseline) = &track.baseline
                && track.thresholds.is_none_or(|thresholds| !thresholds.are_for(share))
            {
                track.thresholds = Some(Thresholds::compute(&baseline.scatter, share));
            }
        }
        if let Some(mixed) = &mut self.mixed
            && !mixed.thresholds.are_for(share)
        {
            mixed.thresholds = Thresholds::compute(&mixed.scatter, share);
        }
    }

    /// The drift in the last throws; the latest of them is in `direction`. `heavy_tails`: the scatter has heavy tails.
    pub(super) fn drift(&self, direction: Direction, heavy_tails: bool, known: &Known, settings: &Settings) -> Drift {
        let [normal, reverse] = &self.sides;
        let baselines = self.baselines();
        let tails = [Stream::of(&normal.recent, 0, baselines), Stream::of(&reverse.recent, 1, baselines)];
        let mixed_tail = Stream::mixed([&normal.recent, &reverse.recent], baselines);
        let own = tails.iter().zip(&self.sides).enumerate().filter_map(|(side, (tail, track))| {
            Some((Some(side), tail, &track.baseline.as_ref()?.scatter, track.thresholds.as_ref()?))
        });
        let mixed = self.mixed.as_ref().filter(|_| mixed_tail.is_balanced());
        let mixed = mixed.map(|mixed| (None, &mixed_tail, &mixed.scatter, &mixed.thresholds));
        // The strongest window, its scatter, and its side; `None` for the mixed stream.
        let mut best: Option<(Tested, &Scatter, Option<usize>)> = None;
        for (side, tail, scatter, thresholds) in own.chain(mixed) {
            if let Some(tested) = tail.strongest(heavy_tails, scatter, thresholds)
                && best.is_none_or(|(best, ..)| tested.excess > best.excess)
            {
                best = Some((tested, scatter, side));
            }
        }
        let level = |at: usize, longest: usize| {
            let scatter = &baselines[at]?.scatter;
            let throws = WINDOWS.into_iter().rev().find(|w| *w <= longest && *w <= tails[at].len())?;
            tails[at].window(throws, scatter)
        };
        let [levels, last_few] = [WINDOWS[2], WINDOWS[1]].map(|longest| [level(0, longest), level(1, longest)]);
        let latest = direction.side();
        let provisional = baselines.iter().flatten().any(|baseline| !baseline.complete);
        let is_half_seen = baselines.iter().zip(&levels).any(|(baseline, level)| baseline.is_some() && level.is_none());
        let hidden = self.hidden(latest, levels[latest].as_ref(), settings);
        // The known level is a mean of both directions, but the machine may have changed differently in each of them.
        let of_side = || {
            let (Tested { window, .. }, _, side) = best?;
            Some(0.5 * (window.mean - level(1 - side?, window.throws)?.mean))
        };
        let known_level = known.level.map(|level| level + of_side().unwrap_or_default());
        let known = &Known { level: known_level, baselines, ..known.clone() };
        let detected = best.as_ref().filter(|(tested, ..)| tested.excess > 1.0);
        Drift {
            provisional,
            attribution: detected.map(|(tested, scatter, side)| {
                let found = attribute((&tested.window, scatter, *side), &last_few, known, settings);
                found.unless_opposite([&levels, &last_few], settings)
            }),
            strongest: best.map(|(tested, ..)| tested),
            origin: Origin::default(),
            alarmed: known.causes.clone(),
            is_half_seen,
            levels,
            last_few,
            latest: (latest, level(latest, WINDOWS[0])),
            hidden,
        }
    }

    /// The cause that the uncertain effect of the temperature hides most in this direction, with its least visible
    /// size, if this is above the warning limit; and the mean temperature of these throws.
    fn hidden(&self, side: usize, level: Option<&Window>, settings: &Settings) -> Option<Blindness> {
        let track = &self.sides[side];
        let thresholds = track.thresholds.as_ref().filter(|_| track.is_final(settings))?;
        let window = level.filter(|window| window.temperature_sd != Vector3::zeros())?;
        let limit = thresholds.of(WINDOWS.iter().position(|throws| *throws == window.throws)?);
        let over_limit = |cause: Cause| {
            let limit_pct = settings.limit_pct(cause)?;
            let visible = visible_pct(cause, window.tested(limit), limit)?;
            let otherwise = visible_pct(cause, window.covariance - covariance_of_effect(window.temperature_sd), limit)?;
            (visible > limit_pct.max(HIDES_FROM * otherwise)).then_some((cause, visible, visible / limit_pct))
        };
        let (cause, below_pct, _) = most_hidden(Cause::PHYSICAL.into_iter().filter_map(over_limit))?;
        let baseline_c = track.baseline.as_ref()?.temperature.reference_c?;
        let distances = track.recent.iter().rev().take(window.throws).map(|throw| throw.raw().1);
        let temperature_c = baseline_c + distances.sum::<f64>() / window.throws as f64;
        Some(Blindness { cause, below_pct, temperature: Some(HidingTemperature { temperature_c, baseline_c }) })
    }

    /// The cause that the scatter of the throws hides most, with its least visible size, if no window shows a change at
    /// the critical limit. It depends on the baselines only, so it does not change from throw to throw.
    pub(super) fn hidden_by_scatter(&self, settings: &Settings) -> Option<Blindness> {
        let hidden = self.sides.iter().filter_map(|track| self.hidden_by_scatter_of(track, settings));
        let (cause, below_pct, _) = most_hidden(hidden)?;
        Some(Blindness { cause, below_pct, temperature: None })
    }

    /// The cause that the scatter of one direction hides most; its least visible size \[%\], also relative to the
    /// critical limit.
    fn hidden_by_scatter_of(&self, track: &Track, settings: &Settings) -> Option<(Cause, f64, f64)> {
        let baseline = track.baseline.as_ref().filter(|baseline| baseline.is_final(settings))?;
        let own = (&baseline.scatter, track.thresholds.as_ref()?, baseline.centre_throws());
        let all: f64 = self.sides.iter().flat_map(|track| &track.baseline).map(Baseline::centre_throws).sum();
        let mixed = self.mixed.as_ref().map(|mixed| (&mixed.scatter, &mixed.thresholds, all));
        let streams = [mixed, Some(own)].into_iter().flatten();
        let means: Vec<(Matrix3<f64>, f64)> = streams
            .flat_map(|(scatter, thresholds, centre_throws)| {
                let of_scale = Matrix3::repeat(if track.of_ratios { UNKNOWN_SCALE_SD * UNKNOWN_SCALE_SD } else { 0.0 });
                let of_mean = move |throws| scatter.of_mean(throws, &scatter.sensor(), centre_throws) + of_scale;
                WINDOWS.into_iter().enumerate().map(move |(at, throws)| (of_mean(throws), thresholds.of(at)))
            })
            .collect();
        let over_limit = |cause: Cause| {
            let critical_pct = settings.critical_factor * settings.limit_pct(cause)?;
            let visible = means.iter().filter_map(|(covariance, limit)| visible_pct(cause, *covariance, *limit));
            let least = visible.min_by(f64::total_cmp).filter(|least| *least > critical_pct)?;
            Some((cause, least, least / critical_pct))
        };
        // Ratios never show the inertia, of which a caveat says so.
        let is_shown = |cause: &Cause| !(track.of_ratios && *cause == Cause::Inertia);
        most_hidden(Cause::PHYSICAL.into_iter().filter(is_shown).filter_map(over_limit))
    }

    /// Whether no baseline has a temperature.
    pub(super) fn has_no_temperature(&self) -> bool {
        self.sides.iter().flat_map(|track| &track.baseline).all(|baseline| baseline.temperature.reference_c.is_none())
    }

    /// Whether the last throws of the machine show only ratios of coefficients; they do not show a change of inertia.
    pub(super) fn lacks_scale(&self) -> bool {
        /// Number of consecutive throws with ratios only that decide. A machine that also has throws with complete
        /// coefficients has shorter runs of ratios only.
        const LAST: usize = WINDOWS[2];
        let [normal, reverse] = &self.sides;
        let recent = Stream::all([&normal.recent, &reverse.recent], self.baselines());
        normal.of_ratios && reverse.of_ratios || recent.len() >= LAST && recent.is_without_scale(LAST)
    }

    /// Takes the effect of a sensor's fault out of the last throws from number `first` on, and discards those before.
    pub(super) fn take_out(&mut self, effect: impl Fn(bool) -> Vector3<f64>, first: u64) {
        for track in &mut self.sides {
            let since = track.recent.iter().filter(|throw| u64::from(throw.order) >= first).cloned();
            track.recent = since.map(|throw| throw.without(&effect)).collect();
        }
    }

    /// Discards the last throws, and keeps the baselines.
    pub(super) fn forget_recent(&mut self) {
        self.sides.iter_mut().for_each(|track| track.recent.clear());
    }

    /// Whether a direction has a baseline of ratios, with which only the ratios of its throws are compared.
    pub(super) fn any_of_ratios(&self) -> bool {
        self.sides.iter().any(|track| track.of_ratios)
    }

    pub(super) fn any_baseline(&self) -> bool {
        self.sides.iter().any(|track| track.baseline.is_some())
    }

    /// Whether a baseline is incomplete and has throws already.
    pub(super) fn is_learning(&self, settings: &Settings) -> bool {
        let has_throws =
            |track: &Track| track.undecided.is_some() || !track.learned.is_empty() || !track.aside.is_empty();
        self.sides.iter().any(|track| has_throws(track) && !track.is_final(settings))
    }

    /// Centres of the baselines of both directions: of coefficients or ratios, and of the duration \[s\].
    pub(super) fn centres(&self) -> [Option<([f64; 3], f64)>; 2] {
        self.baselines().map(|baseline| baseline.and_then(|of| Some((of.centre.map(f64::exp), of.duration_s?))))
    }

    pub(super) fn duration_s(&self, direction: Direction) -> Option<f64> {
        self.sides[direction.side()].baseline.as_ref()?.duration_s
    }

    pub(super) fn progress(&self, direction: Direction, settings: &Settings) -> (usize, usize) {
        let track = &self.sides[direction.side()];
        match &track.baseline {
            Some(baseline) if baseline.is_final(settings) => (baseline.throws, baseline.throws),
            // After a lower setting there may be more throws, of which some are suspected.
            _ => (track.learned.len().min(settings.baseline_throws - 1), settings.baseline_throws),
        }
    }

    pub(super) fn record(&self, direction: Direction) -> Option<BaselineRecord> {
        let track = &self.sides[direction.side()];
        track.baseline.as_ref().map(|baseline| baseline.record(direction, track.of_ratios))
    }

    /// Evaluated throws of the machine per day, since its baselines; `None` without throws since.
    pub(super) fn throws_per_day(&self, at: Timestamp) -> Option<f64> {
        let rate = |track: &Track| {
            let days = at.duration_since(track.baseline.as_ref()?.taken_at).as_secs_f64() / 86_400.0;
            (days > 0.0 && track.since_baseline > 0).then(|| track.since_baseline as f64 / days)
        };
        self.sides.iter().filter_map(rate).reduce(|a, b| a + b)
    }

    pub(super) fn since_baseline(&self, direction: Direction) -> u64 {
        self.sides[direction.side()].since_baseline
    }
}

/// The most hidden cause of these: each has its least visible size \[%\], also relative to a limit.
fn most_hidden(causes: impl Iterator<Item = (Cause, f64, f64)>) -> Option<(Cause, f64, f64)> {
    causes.max_by(|a, b| a.2.total_cmp(&b.2))
}
