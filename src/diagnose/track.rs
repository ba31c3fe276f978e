//! What the monitor keeps of the throws of each direction: the baseline and how it is learned, and the last throws.

use jiff::Timestamp;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::{
    BaselineRecord, Cause, Settings,
    baseline::{Baseline, Learned, learn_mixed},
    drift::{Recent, Ring, Tail, Window},
    monitor::Evaluated,
    scatter::Scatter,
    sym3::Sym3,
    threshold::{Thresholds, WINDOWS},
    verdict::Drift,
};
use crate::throw::Direction;

/// Throws of a direction that are set aside: a longest window of them shows any drift that matters.
const MOST_ASIDE: usize = WINDOWS[3];

/// What stands when a throw is to be learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// Nothing speaks against it.
    Plain,
    /// The last throws may show a drift.
    Suspected,
    /// They do, above its limit, and its alarm waits for its name.
    Shown,
    /// A drift is alarmed.
    Alarmed,
}

/// One direction.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct Track {
    /// Throws for the baseline; kept until both directions have theirs.
    learned: Vec<Learned>,
    /// Throws that may show a drift already: not yet in the baseline, nor out of it.
    aside: Vec<Learned>,
    /// Mean covariance of the estimates of both.
    sensor: Sym3,
    baseline: Option<Baseline>,
    thresholds: Option<Thresholds>,
    recent: Ring,
    since_baseline: u64,
}

/// Both directions together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Mixed {
    scatter: Scatter,
    thresholds: Thresholds,
}

/// Baselines and last throws of a machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Tracks {
    sides: [Track; 2],
    mixed: Option<Mixed>,
}

fn side(direction: Direction) -> usize {
    match direction {
        Direction::NormalToReverse => 0,
        Direction::ReverseToNormal => 1,
    }
}

impl Tracks {
    /// Residual of a throw from its direction's baseline, and its distance from the reference temperature \[K\].
    pub(super) fn residual(&self, throw: &Evaluated) -> Option<(Vector3<f64>, f64)> {
        let baseline = self.sides[side(throw.direction)].baseline.as_ref()?;
        Some(baseline.residual(&throw.log, throw.temperature_c))
    }

    /// Takes a throw into the last throws of its direction. `None` while it has no baseline.
    pub(super) fn push(&mut self, throw: &Evaluated, order: u64, settings: &Settings) -> Option<Vector3<f64>> {
        let (residual, distance) = self.residual(throw)?;
        self.refresh_thresholds(settings);
        let track = &mut self.sides[side(throw.direction)];
        track.since_baseline += 1;
        track.recent.push(Recent::new(order, residual, distance, throw.sensor.into()));
        Some(residual)
    }

    /// A new baseline, a new stream or a changed budget asks for new thresholds.
    fn refresh_thresholds(&mut self, settings: &Settings) {
        // Every throw asks its own direction's stream, and the mixed one where there is one.
        let streams = if self.mixed.is_some() { 2.0 } else { 1.0 };
        let share = settings.false_alarms_per_throw() / streams;
        for track in &mut self.sides {
            if let Some(baseline) = &track.baseline
                && track.thresholds.is_none_or(|thresholds| !thresholds.are_for(share))
            {
                track.thresholds = Some(Thresholds::compute(baseline.scatter(), share));
            }
        }
        if let Some(mixed) = &mut self.mixed
            && !mixed.thresholds.are_for(share)
        {
            mixed.thresholds = Thresholds::compute(&mixed.scatter, share);
        }
    }

    /// What the last throws say, the latest being one of `direction`. `open` are the causes with an active alarm.
    pub(super) fn drift(&self, direction: Direction, open: &[Cause], settings: &Settings) -> Drift {
        let [normal, reverse] = &self.sides;
        let baselines = [normal.baseline.as_ref(), reverse.baseline.as_ref()];
        let tails = [Tail::of(&normal.recent, 0), Tail::of(&reverse.recent, 1)];
        let mut best: Option<(Window, &Scatter)> = None;
        let mut consider = |tail: &Tail, scatter, thresholds| {
            if let Some(window) = tail.strongest(scatter, thresholds, baselines)
                && best.is_none_or(|(best, _)| window.excess > best.excess)
            {
                best = Some((window, scatter));
            }
        };
        for (tail, track) in tails.iter().zip(&self.sides) {
            if let (Some(baseline), Some(thresholds)) = (&track.baseline, &track.thresholds) {
                consider(tail, baseline.scatter(), thresholds);
            }
        }
        let mixed_tail = Tail::mixed([&normal.recent, &reverse.recent]);
        if let Some(mixed) = &self.mixed
            && mixed_tail.is_balanced()
        {
            consider(&mixed_tail, &mixed.scatter, &mixed.thresholds);
        }
        let level = |at: usize, longest: usize| {
            let scatter = baselines[at]?.scatter();
            let throws = WINDOWS.into_iter().rev().find(|w| *w <= longest && *w <= tails[at].len())?;
            tails[at].window(throws, scatter, baselines)
        };
        let levels = [level(0, WINDOWS[2]), level(1, WINDOWS[2])];
        let latest = side(direction);
        let provisional = baselines.iter().flatten().any(|baseline| !baseline.is_complete());
        Drift::new(best, provisional, levels, (latest, level(latest, WINDOWS[0])), open, settings)
    }

    /// Takes a throw into a baseline that is not complete; gives its record when it became usable, better or complete.
    ///
    /// A fault must not become normal, nor may an unlucky first dozen end the learning: while a drift is suspected,
    /// throws are set aside. They are dropped when it is alarmed, and taken when it passes, or when a longest window of
    /// them has not shown it above its limit.
    pub(super) fn learn(
        &mut self,
        throw: &Evaluated,
        order: u64,
        at: Timestamp,
        standing: Standing,
        settings: &Settings,
    ) -> Option<BaselineRecord> {
        if standing == Standing::Alarmed {
            self.sides.iter_mut().for_each(|track| track.aside.clear());
            return None;
        }
        let track = &mut self.sides[side(throw.direction)];
        if track.baseline.as_ref().is_some_and(Baseline::is_complete) {
            return None;
        }
        track.aside.push(Learned::new(order, throw));
        let mean = Matrix3::from(track.sensor);
        let count = track.learned.len() + track.aside.len();
        track.sensor = (mean + (throw.sensor - mean) / count as f64).into();
        if standing == Standing::Shown && track.aside.len() > MOST_ASIDE {
            track.aside.remove(0);
        }
        if standing == Standing::Shown || standing == Standing::Suspected && track.aside.len() < MOST_ASIDE {
            return None;
        }
        track.learned.append(&mut track.aside);
        track.learned.truncate(settings.baseline_throws);
        let usable = settings.baseline_usable_throws;
        let next =
            [usable, 2 * usable].into_iter().find(|stage| *stage > track.baseline.as_ref().map_or(0, Baseline::throws));
        if track.learned.len() < next.unwrap_or(usize::MAX).min(settings.baseline_throws) {
            return None;
        }
        let baseline = Baseline::learn(&track.learned, track.sensor, at, settings);
        let record = baseline.record(throw.direction);
        track.thresholds = None;
        track.baseline = Some(baseline);
        track.recent.clear();
        track.since_baseline = 0;
        self.learn_mixed(settings);
        self.refresh_thresholds(settings);
        Some(record)
    }

    fn learn_mixed(&mut self, settings: &Settings) {
        let [normal, reverse] = &self.sides;
        let (Some(first), Some(second)) = (&normal.baseline, &reverse.baseline) else { return };
        let scatter = learn_mixed([&normal.learned, &reverse.learned], [first, second]);
        let done = first.is_complete() && second.is_complete();
        let thresholds = Thresholds::compute(&scatter, settings.false_alarms_per_throw());
        self.mixed = Some(Mixed { scatter, thresholds });
        if done {
            self.sides.iter_mut().for_each(|track| track.learned = Vec::new());
        }
    }

    /// Forgets the last throws, not the baselines.
    pub(super) fn forget_recent(&mut self) {
        self.sides.iter_mut().for_each(|track| track.recent.clear());
    }

    /// All recent throws of one direction, or of both in their order, newest first.
    pub(super) fn recent(&self, direction: Option<Direction>) -> Tail<'_> {
        match direction {
            Some(direction) => Tail::of(&self.sides[side(direction)].recent, side(direction)),
            None => Tail::all([&self.sides[0].recent, &self.sides[1].recent]),
        }
    }

    pub(super) fn any_baseline(&self) -> bool {
        self.sides.iter().any(|track| track.baseline.is_some())
    }

    pub(super) fn duration_s(&self, direction: Direction) -> Option<f64> {
        self.sides[side(direction)].baseline.as_ref()?.duration_s()
    }

    pub(super) fn progress(&self, direction: Direction, settings: &Settings) -> (usize, usize) {
        let track = &self.sides[side(direction)];
        match &track.baseline {
            Some(baseline) if baseline.is_complete() => (baseline.throws(), baseline.throws()),
            _ => (track.learned.len() + track.aside.len(), settings.baseline_throws),
        }
    }

    pub(super) fn record(&self, direction: Direction) -> Option<BaselineRecord> {
        self.sides[side(direction)].baseline.as_ref().map(|baseline| baseline.record(direction))
    }

    pub(super) fn since_baseline(&self, direction: Direction) -> u64 {
        self.sides[side(direction)].since_baseline
    }
}
