//! Intermittent faults, which some throws show and others do not: a loose contact, a stone in the ballast.
//!
//! The mean over a window does not show a fault in every fifth throw. So the rule counts single throws. A throw is a
//! departure if it is far from the median of the previous throws of its direction: beyond the scatter of the machine,
//! and beyond a warning limit. Consecutive throws count as one departure at most; a longer run is a step, which the
//! windows detect. The number of departures in the last throws is compared with the earlier rate of the machine. With a
//! gamma prior on this rate, the number has a negative binomial distribution.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use statrs::function::beta::checked_beta_reg;

use super::{CLOSE, Explanation, Fit, PLAIN_LEAKS, fit, single};
use crate::diagnose::{
    Cause, Settings,
    statistics::{LastValues, Level, SparseValues, is_default, sym3, to_f32},
};

/// Lengths of the two windows of departures \[throws\].
const COUNTED: [u32; 2] = [50, 100];
/// A least size of departures, with the prior of their rate.
#[derive(Debug, Clone, Copy)]
struct Size {
    /// Least squared distance from the median, in variances of one throw.
    far: f64,
    /// Prior of the rate: number of departures, and number of throws.
    prior: (f64, f64),
}

/// Every departure: 1 in 1,000 throws of a usual machine.
const ANY: Size = Size { far: 16.0, prior: (0.5, 50.0) };
/// Large departures, of which fewer are enough: 2 in 1,000 throws of Student's t with three degrees of freedom.
const LARGE: Size = Size { far: 100.0, prior: (0.5, 300.0) };
/// Most consecutive throws of a direction in a departure; more are a step.
const LONGEST_RUN: u32 = 2;
/// Least squared distance of a throw far out, in variances: 5 in 10,000 throws of Gaussian scatter, 2 in 100 throws of
/// Student's t with three degrees of freedom.
const FAR_OUT: f64 = 20.0;
/// Rate of throws far out from which the scatter has heavy tails: between the two rates at [`FAR_OUT`].
const HEAVY_FROM: f64 = 0.006;
/// Throws until a throw far out counts for the tails of the scatter: by then, a fault that began with it shows.
const DECIDED_AFTER: usize = 24;
/// Number of throws far out in the prior of their rate.
const TAIL_PRIOR: f64 = 0.5;
/// Number of throws in this prior.
const TAIL_PRIOR_THROWS: f64 = 100.0;
/// Throws of a machine from which its rate is known: a baseline of one direction.
const KNOWN_FROM: f64 = 50.0;
/// Consecutive throws whose tests count as one in the budget: their windows overlap, so their counts are nearly equal.
const OVERLAP: f64 = 10.0;

/// Departures of a machine, and their healthy rate.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Intermittent {
    /// The last throws; one that ended a departure has the departure as value, in (ln b0, ln a1, ln a0).
    recent: SparseValues,
    /// The unfinished departure of each direction: its first throw, and its number of throws.
    begun: [Option<([f32; 3], u32)>; 2],
    /// Departures, and throws, of the healthy past before `recent`.
    past: (f64, f64),
    /// Large departures in the healthy past.
    past_large: f64,
    /// Throws far out, and all throws; they show how heavy the tails of the scatter are.
    tail: (f64, f64),
    /// Whether each of the last throws was far out. Later it counts for `tail`, unless a drift is suspected then.
    undecided: LastValues<bool, DECIDED_AFTER>,
    /// Consecutive throws whose departure is not known.
    #[serde(skip_serializing_if = "is_default")]
    unknown: u32,
}

/// Frequent departures, with their cause.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct IntermittentFault {
    /// Throws per departure.
    pub(crate) one_in: f64,
    /// Mean of the departures, explained by one cause.
    pub(crate) explanation: Explanation,
    /// The named cause; [`Cause::Unattributed`] if two causes explain the mean.
    pub(crate) cause: Cause,
}

/// The departure of a throw from the median of the previous throws of its direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Departure {
    /// Index of the direction.
    pub(crate) side: usize,
    /// Change of ln b0, ln a1, ln a0.
    pub(crate) change: Vector3<f64>,
    /// Covariance of one throw.
    pub(crate) of_one_throw: Matrix3<f64>,
    /// Whether the baseline of the direction has all its throws.
    pub(crate) is_complete: bool,
}

/// What is active while a throw is made.
#[derive(Debug, Clone, Copy)]
pub(super) struct During {
    /// The suspicion of a drift.
    pub(super) suspicion: bool,
    /// The alarm about an intermittent fault.
    pub(super) alarm: bool,
}

impl Intermittent {
    /// Adds a throw. Until the baseline has all its throws, the throw belongs to the healthy past. During a suspicion of a
    /// drift no throw counts for the tails, during an alarm the healthy rate stays as it is, and while the departures
    /// become more frequent they do not count for it.
    pub(super) fn push(&mut self, departure: &Departure, during: During, settings: &Settings) {
        let Departure { side, change: departure, ref of_one_throw, is_complete } = *departure;
        self.unknown = 0;
        let inverse = sym3::inverse(of_one_throw);
        let square = |d: Vector3<f64>| inverse.map_or(0.0, |inverse| (d.transpose() * inverse * d).x);
        let decided = self.undecided.push(square(departure) > FAR_OUT);
        if let Some(far_out) = decided.filter(|_| !during.suspicion) {
            self.tail.0 += f64::from(u8::from(far_out));
            self.tail.1 += 1.0;
        }
        let far = |d: Vector3<f64>| {
            let part = |cause| single(cause, &d, of_one_throw, settings).relevance(settings);
            square(d) > ANY.far && Cause::PHYSICAL.into_iter().any(|cause| part(cause) > 1.0)
        };
        let ended = if far(departure) {
            let (first, throws) = self.begun[side].unwrap_or(([0, 1, 2].map(|i| to_f32(departure[i])), 0));
            self.begun[side] = Some((first, throws + 1));
            None
        } else {
            let begun = self.begun[side].take().filter(|(_, throws)| *throws <= LONGEST_RUN);
            begun.map(|(first, _)| first).filter(|first| far(Vector3::from(first.map(f64::from)) - departure))
        };
        self.recent.push(ended);
        if !is_complete || self.recent.throws() > COUNTED[1] {
            let is_rising = self.is_rising();
            let oldest = self.recent.pop_oldest().filter(|_| !is_rising);
            if !during.alarm {
                let is_large = oldest.is_some_and(|d| square(Vector3::from(d.map(f64::from))) > LARGE.far);
                self.past.0 += f64::from(u8::from(oldest.is_some()));
                self.past_large += f64::from(u8::from(is_large));
                self.past.1 += 1.0;
            }
        }
    }

    /// Departures more frequent than the healthy rate.
    pub(crate) fn found(&self, of_one_throw: &Matrix3<f64>, settings: &Settings) -> Option<IntermittentFault> {
        if self.past.1 < KNOWN_FROM {
            return None;
        }
        let sizes = [ANY, LARGE];
        let share = settings.false_alarms_per_throw() * OVERLAP / (sizes.len() * COUNTED.len()) as f64;
        let mut tests = sizes.into_iter().flat_map(|size| COUNTED.map(|throws| (size, throws)));
        let inverse = sym3::inverse(of_one_throw)?;
        let shows = |(size, throws): (Size, u32)| {
            let counted = f64::from(self.recent.throws().min(throws));
            let last = self.recent.last(throws).map(|(age, d)| (f64::from(*age), Vector3::from(d.map(f64::from))));
            let all: Vec<_> = last.filter(|(_, d)| (d.transpose() * inverse * d).x > size.far).collect();
            let enough = |count: usize| count >= 3 && self.chance(size, count, counted) < share;
            if !enough(all.len()) {
                return None;
            }
            // The departures of a fault are of one kind; those of heavy tails are of all kinds.
            let kind = |(cause, sign): (Cause, f64)| -> Vec<(f64, Vector3<f64>)> {
                let is_of_kind = |(_, departure): &&(f64, Vector3<f64>)| {
                    let part = single(cause, departure, of_one_throw, settings);
                    sign * part.size > 0.0 && part.relevance(settings) > 1.0
                };
                all.iter().filter(is_of_kind).copied().collect()
            };
            let kinds = Cause::PHYSICAL.into_iter().flat_map(|cause| [(cause, 1.0), (cause, -1.0)]);
            let most = kinds.map(kind).max_by_key(Vec::len).filter(|most| enough(most.len()))?;
            let (count, (newest, _), (oldest, _)) = (most.len() as f64, most.first()?, most.last()?);
            // Throws per departure, between the first and the last one: the window may have begun before the fault.
            let one_in = (oldest - newest) / (count - 1.0);
            Some((one_in, most.iter().map(|(_, departure)| departure).sum::<Vector3<f64>>() / count, count))
        };
        let (one_in, mean, count) = tests.find_map(shows)?;
        let covariance = of_one_throw / count;
        let [best, second, ..] = ranked(&mean, &covariance, settings);
        let explanation = best.parts[0];
        let is_clear = second.score - best.score > CLOSE;
        let cause = if is_clear { explanation.cause } else { Cause::Unattributed };
        Some(IntermittentFault { one_in, explanation, cause })
    }

    /// Size of a fault by `cause` in the last departures that it explains; `None` without one, or without a part.
    pub(super) fn size(&self, cause: Cause, of_one_throw: &Matrix3<f64>, settings: &Settings) -> Option<Level> {
        let departures = self.recent.last(COUNTED[1]).map(|(_, d)| Vector3::from(d.map(f64::from)));
        let is_of_cause = |departure: &Vector3<f64>| ranked(departure, of_one_throw, settings)[0].includes(cause);
        let faulty: Vec<_> = departures.filter(is_of_cause).collect();
        let count = faulty.len() as f64;
        let mean = faulty.iter().sum::<Vector3<f64>>() / count;
        (!faulty.is_empty()).then(|| single(cause, &mean, &(of_one_throw / count), settings).level())
    }

    pub(crate) fn has_heavy_tails(&self) -> bool {
        let (far, throws) = self.tail;
        (far + TAIL_PRIOR) / (throws + TAIL_PRIOR_THROWS) > HEAVY_FROM
    }

    /// Discards the departures when their alarm ends.
    pub(crate) fn end(&mut self) {
        self.recent.forget_values();
        self.unknown = 0;
    }

    /// Counts a throw whose departure is not known. Returns whether these are too many in a row for the alarm to end by
    /// its own rule.
    pub(crate) fn on_unknown(&mut self) -> bool {
        self.unknown = self.unknown.saturating_add(1);
        self.unknown >= COUNTED[0]
    }

    /// Whether departures are as rare again as in the healthy past.
    pub(crate) fn is_over(&self) -> bool {
        let count = self.recent.last(COUNTED[0]).count();
        count == 0 || self.chance(ANY, count, COUNTED[0].into()) > OVER_FROM
    }

    /// Whether departures are so frequent that they may come from a fault; the healthy rate must not include them.
    pub(super) fn is_rising(&self) -> bool {
        let throws = self.recent.throws();
        let count = self.recent.last(throws).count();
        count >= 3 && self.chance(ANY, count, throws.into()) < RISING_FROM
    }

    /// Discards the last throws after a change of the machine; keeps the healthy rate.
    pub(crate) fn reset(&mut self) {
        *self = Self { past: self.past, past_large: self.past_large, tail: self.tail, ..Self::default() };
    }

    /// Probability of at least `count` departures of this size in so many `throws`, with the healthy rate; `count` is
    /// at least 1.
    fn chance(&self, size: Size, count: usize, throws: f64) -> f64 {
        let past = if size.far > ANY.far { self.past_large } else { self.past.0 };
        let (shape, exposure) = (past + size.prior.0, self.past.1 + size.prior.1);
        checked_beta_reg(count as f64, shape, throws / (throws + exposure)).unwrap_or(1.0)
    }
}

/// Explanations of a departure with this covariance by each cause alone, the best first.
fn ranked(departure: &Vector3<f64>, covariance: &Matrix3<f64>, settings: &Settings) -> [Fit<1>; 4] {
    let mut fits = Cause::PHYSICAL.map(|cause| fit(PLAIN_LEAKS, [cause], departure, covariance, settings));
    fits.sort_by(|a, b| a.score.total_cmp(&b.score));
    fits
}

/// Least probability of the present number of departures, at the healthy rate, that shows the end of the fault.
const OVER_FROM: f64 = 0.05;
/// Probability of the present number of departures below which the rate may be rising: far above a false alarm's.
const RISING_FROM: f64 = 0.001;
