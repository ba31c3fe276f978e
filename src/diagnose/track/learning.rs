//! Learning of the baselines, from throws without suspicion, trend or rain.

use std::mem;

use jiff::Timestamp;
use nalgebra::Matrix3;

use super::{Mixed, Track, Tracks, Undecided};
use crate::{
    diagnose::{
        Settings,
        baseline::{
            Baseline, BaselineRecord, BaselineThrow, Changes, Filling, Suspicion, WetSpell, filling, learn_in_order,
            learn_mixed, trend, wet_spells,
        },
        observation::Evaluated,
        statistics::{Sym3, WINDOWS},
    },
    estimate::Grade,
    throw::Direction,
};

/// Largest number of throws set aside in a direction: a longest window of throws shows every relevant drift.
const MOST_ASIDE: usize = WINDOWS[3];

/// Numbers of throws set aside in a direction at which the scatter is computed again.
const SCATTER_AT: [usize; 2] = [WINDOWS[2], MOST_ASIDE];

impl Track {
    /// Takes the baseline from the learned throws; the known `changes` are subtracted from these.
    fn take(&mut self, direction: Direction, changes: Changes, at: Timestamp, settings: &Settings) -> BaselineRecord {
        // The slope of a ratio to b0.
        let relative = |slopes: [f64; 3]| slopes.map(|slope| slope - slopes[0]);
        let slopes = if self.of_ratios { changes.slopes.map(relative) } else { changes.slopes };
        let slopes = slopes.filter(|slopes| slopes.iter().any(|slope| *slope != 0.0));
        let changes = Changes { slopes, ..changes };
        let baseline = Baseline::learn(&self.learned, self.sensor, self.of_ratios, changes, at, settings);
        let record = baseline.record(direction, self.of_ratios);
        (self.baseline, self.thresholds, self.since_baseline) = (Some(baseline), None, 0);
        self.recent.clear();
        record
    }

    /// The throws of the baseline, and those set aside.
    fn filling(&self) -> impl Iterator<Item = &BaselineThrow> {
        self.learned.iter().chain(&self.aside)
    }

    /// Keeps the ratios of a throw before the first baseline. If many of the kept throws are rough, changes the
    /// direction to a baseline of ratios, with the kept throws set aside. A rough throw cannot be compared closely with
    /// a baseline of coefficients, and a fault makes more throws rough. Returns whether the direction changed.
    fn becomes_of_ratios(&mut self, order: u64, throw: &Evaluated, settings: &Settings) -> bool {
        /// Least part of rough throws. A machine with one rough throw in ten reaches it in 3 % of its dozens of throws.
        const ROUGH_SHARE: f64 = 0.3;
        if self.of_ratios || self.baseline.is_some() {
            return false;
        }
        let mut kept = self.undecided.take().unwrap_or_default();
        let ratios = throw.clone().ratios();
        kept.rough += usize::from(throw.grade == Grade::Rough);
        kept.throws.push(BaselineThrow::new(order, &ratios));
        kept.sensor = mean_with(kept.sensor, &ratios.sensor, kept.throws.len());
        if kept.throws.len() < settings.baseline_usable_throws {
            self.undecided = Some(kept);
            return false;
        }
        let Undecided { throws, rough, sensor } = *kept;
        let is_rough = rough as f64 >= ROUGH_SHARE * throws.len() as f64;
        if is_rough {
            *self = Self { of_ratios: true, aside: throws, sensor, ..Self::default() };
        }
        is_rough
    }
}

/// The mean of `count` covariances: `last`, and the others, whose mean is `mean`.
fn mean_with(mean: Sym3, last: &Matrix3<f64>, count: usize) -> Sym3 {
    let mean = Matrix3::from(mean);
    (mean + (last - mean) / count as f64).into()
}

impl Tracks {
    /// Adds a throw to an incomplete baseline. Returns the records of baselines that became usable, better or complete.
    ///
    /// A fault must not become part of a baseline, and chance must not stop the learning. So throws with a suspected
    /// drift are set aside. They are dropped if the drift raises an alarm. They are added if the drift ends, or stays
    /// below its limit for a longest window. Before they are added, the scatter is computed from them too, around their
    /// own level: the few throws of the baseline alone give so wide limits that a large drift may stay below.
    pub(crate) fn learn(
        &mut self,
        throw: &Evaluated,
        order: u64,
        at: Timestamp,
        suspicion: Suspicion,
        settings: &Settings,
    ) -> Vec<BaselineRecord> {
        if suspicion == Suspicion::Alarmed {
            self.sides.iter_mut().for_each(|track| track.aside.clear());
            return Vec::new();
        }
        let track = &mut self.sides[throw.direction.side()];
        if !track.becomes_of_ratios(order, throw, settings) {
            let is_other = !track.of_ratios && throw.grade == Grade::Rough;
            if is_other || track.is_final(settings) {
                return Vec::new();
            }
            track.aside.push(BaselineThrow::new(order, throw));
            track.sensor = mean_with(track.sensor, &throw.sensor, track.learned.len() + track.aside.len());
        }
        self.follow_trend(settings);
        let track = &mut self.sides[throw.direction.side()];
        if suspicion == Suspicion::AboveLimit && track.aside.len() > MOST_ASIDE {
            track.aside.remove(0);
        }
        if suspicion == Suspicion::Suspected && SCATTER_AT.contains(&track.aside.len()) {
            self.learn_scatter_around_levels(settings);
            return Vec::new();
        }
        if suspicion == Suspicion::AboveLimit || suspicion == Suspicion::Suspected && track.aside.len() < MOST_ASIDE {
            return Vec::new();
        }
        let learned = mem::take(&mut track.learned).into_iter().chain(mem::take(&mut track.aside));
        track.learned = learned.take(settings.baseline_throws).collect();
        let usable = settings.baseline_usable_throws;
        let next = [usable, 2 * usable]
            .into_iter()
            .find(|stage| *stage > track.baseline.as_ref().map_or(0, |baseline| baseline.throws));
        if track.learned.len() < next.unwrap_or(usize::MAX).min(settings.baseline_throws) {
            return Vec::new();
        }
        if self.follow_wet_spells() {
            self.follow_trend(settings);
        }
        let changes = Changes { slopes: self.slopes, wet: &self.wet };
        let track = &mut self.sides[throw.direction.side()];
        let mut records = vec![track.take(throw.direction, changes, at, settings)];
        // If the last throws end a trend, the trend was chance, also in the other baseline, which is taken again.
        let is_final = track.is_final(settings);
        let direction = throw.direction.other();
        let other = &mut self.sides[direction.side()];
        let had_trend = other.is_final(settings) && other.baseline.as_ref().is_some_and(Baseline::has_trend);
        if is_final && changes.slopes.is_none() && had_trend && !other.learned.is_empty() {
            records.push(other.take(direction, changes, at, settings));
        }
        self.learn_mixed(settings);
        self.refresh_thresholds(settings);
        records
    }

    /// Looks for a trend in the throws of both baselines and in the throws set aside while a drift is suspected. Stores
    /// its slopes; `None` without a trend.
    fn follow_trend(&mut self, settings: &Settings) {
        let mut slopes = trend(&self.filling(&self.wet), settings);
        if !self.are_comparable() {
            // These are slopes of the ratios, as in a trend without b0. One direction shows b0 too.
            let throws = self.sides.each_ref().map(|track| track.filling().filter(|_| !track.of_ratios));
            let sensor =
                self.sides.iter().find(|track| !track.of_ratios).map_or_else(Sym3::default, |track| track.sensor);
            let own = trend(&filling(throws, sensor.into(), &self.wet, false), settings);
            slopes = if own[0] == 0.0 { slopes } else { own };
        }
        self.slopes = slopes.iter().any(|slope| *slope != 0.0).then_some(slopes);
    }

    /// Looks for wet spells in these throws. Returns whether the spells changed.
    fn follow_wet_spells(&mut self) -> bool {
        let wet: Box<[_]> = wet_spells(&self.filling(&[])).into();
        let is_changed = wet != self.wet;
        self.wet = wet;
        is_changed
    }

    /// Whether both directions are compared by the same values: all coefficients, or ratios only.
    fn are_comparable(&self) -> bool {
        let [normal, reverse] = &self.sides;
        normal.of_ratios == reverse.of_ratios
    }

    /// The throws of the baselines and those set aside, as ratios to b0 if a direction is compared by these; the effect
    /// of the spells `wet` is subtracted.
    fn filling(&self, wet: &[WetSpell]) -> Filling {
        let of_ratios = self.any_of_ratios();
        let sensor = self.sides.each_ref().map(|track| Matrix3::from(track.sensor));
        // Errors of ratios are mostly equal in every throw; differences are scatter of the machine.
        let sensor = if of_ratios { Matrix3::zeros() } else { 0.5 * (sensor[0] + sensor[1]) };
        filling(self.sides.each_ref().map(Track::filling), sensor, wet, of_ratios)
    }

    /// Trend while a baseline is incomplete: slopes of ln b0, ln a1, ln a0 \[per throw of the machine\]; `None` without
    /// a trend.
    pub(crate) fn trend(&self) -> Option<[f64; 3]> {
        let incomplete =
            self.sides.iter().any(|track| !track.baseline.as_ref().is_some_and(|baseline| baseline.complete));
        self.slopes.filter(|_| incomplete)
    }

    /// Computes the scatter of the throws of incomplete baselines and of those set aside, each around its own level.
    fn learn_scatter_around_levels(&mut self, settings: &Settings) {
        let (mut all, mut sensor, mut centres, mut sides) = (Vec::new(), Matrix3::zeros(), 0, 0);
        for track in &mut self.sides {
            let Some(baseline) = track.baseline.as_mut().filter(|baseline| !baseline.is_final(settings)) else {
                continue;
            };
            let groups = [&track.learned[..], &track.aside[..]].into_iter().filter(|throws| !throws.is_empty());
            let levels = groups.clone().count();
            let residuals: Vec<_> = groups.flat_map(|throws| baseline.around_own_level(throws, &self.wet)).collect();
            let own = baseline.differing(track.sensor.into());
            baseline.scatter = learn_in_order(residuals.clone(), own, levels);
            track.thresholds = None;
            sensor += own * residuals.len() as f64;
            (centres, sides) = (centres + levels, sides + 1);
            all.extend(residuals);
        }
        if self.mixed.is_some() && sides == 2 {
            let sensor = sensor / all.len() as f64;
            let scatter = learn_in_order(all, sensor, centres);
            self.mixed = Some(Mixed::new(scatter, settings));
        }
        self.refresh_thresholds(settings);
    }

    fn learn_mixed(&mut self, settings: &Settings) {
        let [normal, reverse] = &self.sides;
        let (Some(first), Some(second)) = (&normal.baseline, &reverse.baseline) else { return };
        let done = self.sides.iter().all(|track| track.is_final(settings));
        if self.are_comparable() {
            let scatter = learn_mixed([&normal.learned, &reverse.learned], [first, second], &self.wet);
            self.mixed = Some(Mixed::new(scatter, settings));
        }
        if done {
            self.sides.iter_mut().for_each(|track| track.learned = Box::default());
            self.wet = Box::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::diagnose::Cause;

    fn evaluated(order: u64, log: [f64; 3]) -> Evaluated {
        Evaluated {
            direction: Direction::BOTH[usize::from(order % 2 == 1)],
            log,
            sensor: Matrix3::identity() * 1e-6,
            grade: Grade::Good,
            ratios_only: false,
            running: None,
            temperature_c: None,
            duration_s: None,
        }
    }

    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
    }

    #[test]
    fn a_baseline_that_a_lower_setting_makes_full_becomes_complete() {
        let mut tracks = Tracks::default();
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut learn = |order: u64, suspicion, baseline_throws| {
            let settings = Settings { baseline_throws, ..Settings::default() };
            let noise = 0.03 * normal(&mut rng);
            let throw = evaluated(order, [5.0, 2.0 + noise, 1.0]);
            tracks.learn(&throw, order, Timestamp::UNIX_EPOCH, suspicion, &settings);
            Direction::BOTH.map(|way| (tracks.record(way).map(|own| own.complete), tracks.progress(way, &settings)))
        };
        let before = (0..60).map(|order| learn(order, Suspicion::None, 50)).last().unwrap();
        assert_eq!(before, [(Some(false), (30, 50)); 2]);
        let suspected = (60..80).map(|order| learn(order, Suspicion::Suspected, 50)).last().unwrap();
        assert_eq!(suspected, before, "throws set aside do not count");
        let after = (80..82).map(|order| learn(order, Suspicion::None, 20)).last().unwrap();
        assert_eq!(after, [(Some(true), (20, 20)); 2]);
    }

    /// Ratios show a motor less well than friction and stiffness, whose scatter they have too.
    #[test]
    fn scatter_of_ratios_that_hides_the_motor_is_stated() {
        let settings = Settings::default();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut tracks = Tracks::default();
        for order in 0..120 {
            let [friction, spring] = [normal(&mut rng), normal(&mut rng)].map(|noise| 0.22 * noise);
            let throw = evaluated(order, [0.0, 2.0 + friction, 1.0 + spring]);
            let throw = Evaluated { grade: Grade::Rough, ratios_only: true, ..throw };
            tracks.learn(&throw, order, Timestamp::UNIX_EPOCH, Suspicion::None, &settings);
        }
        assert!(tracks.any_of_ratios());
        let hidden = tracks.hidden_by_scatter(&settings).unwrap();
        assert!(hidden.cause == Cause::Kt && hidden.below_pct > 15.0, "{hidden:?}");
    }

    /// A chance trend in one baseline, which the last throw of the other ends, must not leave wide limits unannounced.
    #[test]
    fn baselines_without_a_trend_are_complete() {
        let settings = Settings::default();
        let mut ended = 0;
        for seed in 0..100 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut tracks = Tracks::default();
            let mut had_trend = false;
            for order in 0..100_u64 {
                let noise = normal(&mut rng);
                // The last throw of the second direction is against the trend.
                let rise = if order < 99 { 0.07 * order as f64 / 99.0 + 0.03 * noise } else { -0.07 };
                let throw = evaluated(order, [5.0, 2.0 + rise, 1.0]);
                let records = tracks.learn(&throw, order, Timestamp::UNIX_EPOCH, Suspicion::None, &settings);
                had_trend |= order == 98 && records.iter().any(|record| !record.complete);
            }
            let complete = Direction::BOTH.into_iter().all(|way| tracks.record(way).is_some_and(|own| own.complete));
            assert!(complete || tracks.trend().is_some(), "seed {seed}");
            ended += u32::from(had_trend && complete);
        }
        assert!(ended > 0, "no trend ended: the test cannot fail");
    }
}
