//! Faults that show in some throws only: a loose contact, a stone that comes and goes.
//!
//! A mean over a window never sees every fifth throw. A throw departs when it is far from the median of the throws before
//! it in its direction, beyond the machine's scatter and beyond a warning limit. Departures in a row count once: a step is
//! one departure, and the windows are there for it. The number of departures in the last throws is compared with the
//! machine's own rate before them: under a gamma prior on the rate it follows a negative binomial law.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use statrs::function::gamma::ln_gamma;

use super::{
    event::Cause,
    explain::{Explanation, single},
    settings::Settings,
};

/// Throws in which departures are counted, the shorter and the longer.
const COUNTED: [usize; 2] = [50, 100];
/// A departure is at least so far away, as the square in standard deviations: 1 in 1,000 throws of a usual machine.
const FAR: f64 = 16.0;
/// Throws of a direction that a departure lasts at most.
const LONGEST_RUN: u32 = 2;
/// A throw is far out from here: 5 in 10,000 throws of Gaussian scatter, 2 in 100 of Student's t with three degrees.
const FAR_OUT: f64 = 20.0;
/// Tails are heavy from this rate of throws far out, with this many usual throws added.
const HEAVY_FROM: f64 = 0.006;
const TAIL_PRIOR_THROWS: f64 = 100.0;
/// Throws after which a throw far out is known to be none of a fault's first.
const DECIDED_AFTER: usize = 24;
/// The rate before anything is known of a machine: half a departure in so many throws.
const PRIOR: (f64, f64) = (0.5, 50.0);
/// Throws that must be known of a machine before its rate counts: a baseline of one direction.
const KNOWN_FROM: f64 = 50.0;
/// Throws over which counts of overlapping windows are the same chance.
const OVERLAP: f64 = 10.0;

/// Departures of one machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Intermittent {
    /// For each of the last throws the departure that it ended, if it did; newest last.
    recent: VecDeque<Option<[f32; 3]>>,
    /// The departure that the last throws of each direction began, and how many they are.
    #[serde(default)]
    begun: [Option<([f32; 3], u32)>; 2],
    /// Departures and throws of the machine's healthy past, before the last throws.
    past: (f64, f64),
    /// Throws far out, of any size, and throws: how heavy the tails of the machine's scatter are.
    tail: (f64, f64),
    /// Whether each of the last throws was far out; newest last. A fault must not pass for a heavy tail.
    undecided: VecDeque<bool>,
    /// The cause under which it is alarmed.
    pub(super) alarmed: Option<Cause>,
}

/// What the last throws show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Departures {
    /// One in so many throws.
    pub(super) one_in: f64,
    /// Their mean, as one cause explains it.
    pub(super) explanation: Explanation,
    /// The cause to be named: [`Cause::Unattributed`] when two explain it.
    pub(super) cause: Cause,
}

impl Intermittent {
    /// Takes in how far a throw of one side is from the ones before it; `of_one_throw` is the covariance of that. While the
    /// baseline is not `complete`, the throw belongs to the past; while a drift is `suspicious`, throws say nothing of the
    /// tails of the scatter.
    pub(super) fn push(
        &mut self,
        side: usize,
        departure: Vector3<f64>,
        of_one_throw: &Matrix3<f64>,
        complete: bool,
        suspicious: bool,
        settings: &Settings,
    ) {
        let inverse = of_one_throw.try_inverse();
        let square = |d: Vector3<f64>| inverse.map_or(0.0, |inverse| (d.transpose() * inverse * d).x);
        self.undecided.push_back(square(departure) > FAR_OUT);
        if self.undecided.len() > DECIDED_AFTER {
            let far_out = self.undecided.pop_front().unwrap_or_default();
            if !suspicious {
                self.tail.0 += f64::from(u8::from(far_out));
                self.tail.1 += 1.0;
            }
        }
        let far = |d: Vector3<f64>| {
            let part = |cause| single(cause, &d, of_one_throw, settings).relevance(settings);
            square(d) > FAR && Cause::PHYSICAL.into_iter().any(|cause| part(cause) > 1.0)
        };
        #[expect(clippy::cast_possible_truncation, reason = "1e-7 of a logarithm is far below any scatter")]
        let ended = if far(departure) {
            let (first, throws) = self.begun[side].unwrap_or(([0, 1, 2].map(|i| departure[i] as f32), 0));
            self.begun[side] = Some((first, throws + 1));
            None
        } else {
            let begun = self.begun[side].take().filter(|(_, throws)| *throws <= LONGEST_RUN);
            begun.map(|(first, _)| first).filter(|first| far(Vector3::from(first.map(f64::from)) - departure))
        };
        self.recent.push_back(ended);
        if !complete || self.recent.len() > COUNTED[1] {
            let oldest = self.recent.pop_front().flatten();
            if self.alarmed.is_none() {
                self.past.0 += f64::from(u8::from(oldest.is_some()));
                self.past.1 += 1.0;
            }
        }
    }

    /// Departures beyond the machine's own rate, with less than `budget` false ones a throw.
    pub(super) fn found(&self, of_one_throw: &Matrix3<f64>, budget: f64, settings: &Settings) -> Option<Departures> {
        if self.past.1 < KNOWN_FROM {
            return None;
        }
        let share = budget * OVERLAP / COUNTED.len() as f64;
        let shows = |throws: &usize| {
            let counted = self.recent.len().min(*throws);
            let all = || self.recent.iter().rev().take(counted).flatten();
            let count = all().count();
            (count >= 3 && self.chance(count, counted as f64) < share).then(|| {
                let mean = all().map(|d| Vector3::from(d.map(f64::from))).sum::<Vector3<f64>>() / count as f64;
                (counted as f64 / count as f64, mean, count as f64)
            })
        };
        let (one_in, mean, count) = COUNTED.iter().find_map(shows)?;
        let covariance = of_one_throw / count;
        let mut parts = Cause::PHYSICAL.map(|cause| (single(cause, &mean, &covariance, settings), cause));
        let misfit = |part: &Explanation| {
            let model = settings.model_error * part.size;
            let covariance = covariance + Matrix3::from_diagonal_element((0.5 * model).powi(2));
            let effect = super::explain::direction_of(part.cause).unwrap_or_default() * part.size;
            covariance.try_inverse().map_or(f64::INFINITY, |u| ((mean - effect).transpose() * u * (mean - effect)).x)
        };
        parts.sort_by(|(a, _), (b, _)| misfit(a).total_cmp(&misfit(b)));
        let (best, named) = parts[0];
        let clear = misfit(&parts[1].0) - misfit(&best) > CLEAR;
        Some(Departures { one_in, explanation: best, cause: if clear { named } else { Cause::Unattributed } })
    }

    /// Whether the machine's scatter has heavier tails than usual.
    pub(super) fn is_wild(&self) -> bool {
        let (far, throws) = self.tail;
        (far + PRIOR.0) / (throws + TAIL_PRIOR_THROWS) > HEAVY_FROM
    }

    /// Ends the alarm: the departures that it was about are done with.
    pub(super) fn end(&mut self) {
        self.alarmed = None;
        self.recent.iter_mut().for_each(|departure| *departure = None);
    }

    /// Whether departures are as rare again as they were.
    pub(super) fn is_over(&self) -> bool {
        let count = self.recent.iter().rev().take(COUNTED[0]).flatten().count();
        count == 0 || self.chance(count, COUNTED[0] as f64) > OVER_FROM
    }

    /// Forgets the last throws: they are of another machine state.
    pub(super) fn reset(&mut self) {
        *self = Self { past: self.past, tail: self.tail, ..Self::default() };
    }

    /// Probability of at least `count` departures in `throws` under the machine's own rate.
    fn chance(&self, count: usize, throws: f64) -> f64 {
        let (shape, exposure) = (self.past.0 + PRIOR.0, self.past.1 + PRIOR.1);
        let p = throws / (throws + exposure);
        let of = |k: f64| {
            let ln = ln_gamma(shape + k) - ln_gamma(shape) - ln_gamma(k + 1.0);
            (ln + shape * (1.0 - p).ln() + k * p.ln()).exp()
        };
        // The tail itself, as one minus the rest would be lost in rounding.
        (count..count + TAIL_TERMS).map(|k| of(k as f64)).sum()
    }
}

/// A lead of the best cause over the next that decides: odds of 20 to 1, as twice the logarithm.
const CLEAR: f64 = 6.0;
/// Departures are over when their number is more likely than this under the machine's own rate.
const OVER_FROM: f64 = 0.05;
/// Terms of the tail that are added up.
const TAIL_TERMS: usize = 60;
