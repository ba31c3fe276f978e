//! The courses of a drift over the last throws of each direction, and whether only one direction has the drift.

use nalgebra::Vector3;

use super::Tracks;
use crate::{
    diagnose::{
        drift::{Course, History, Point, Stream},
        statistics::{Noise, Scatter},
    },
    throw::Direction,
};

/// Largest difference of the drifts of both directions that counts as agreement, in standard deviations.
const AGREE_SD: f64 = 2.0;

/// Largest size of the other direction, as part of the size, of a drift in one direction only. From this part on, both
/// directions have the drift: chairs that become dry under a rail that bends showed 0.46 and more in simulations.
const ONE_SIDED: f64 = 1.0 / 3.0;
/// Least difference of the two sizes for this, in standard deviations.
const ONE_SIDED_SD: f64 = 3.0;
/// Age \[throws\] at which the drift must have existed for this, so that each direction has six throws with it.
const ONE_SIDED_AGE: f64 = 11.0;
/// Least size at that age, as part of the present size.
const LASTED: f64 = 0.5;

impl Tracks {
    /// The course of a drift along `weights` over the last throws. With `direction`, the course in this direction only.
    /// Otherwise the course over both directions if they agree. If one direction has hardly a drift, the course of the
    /// other: just after a step, a direction has one throw with the drift, or none. If both have a drift of different
    /// sizes, the size is between the two: friction that grows along the stroke seems larger in the direction in which
    /// the spring helps, and smaller in the other; `differ`: this is known, so neither counts as without a drift.
    /// `now`: number of the latest throw.
    pub(crate) fn course(
        &self,
        weights: &Vector3<f64>,
        temperature_sd: &Vector3<f64>,
        (direction, differ): (Option<Direction>, bool),
        history: &History,
        now: u64,
    ) -> Option<Course> {
        let one = |at: usize| self.course_of(at, weights, temperature_sd, now);
        if let Some(direction) = direction {
            return one(direction.side());
        }
        let [first, second] = match [one(0), one(1)] {
            [Some(first), Some(second)] => [first, second],
            [first, second] => return first.or(second),
        };
        let ((a, a_sd), (b, b_sd)) = (first.now(), second.now());
        let agree = (a - b).abs() <= AGREE_SD * a_sd.hypot(b_sd);
        let Some(mixed) = self.mixed.as_ref().filter(|_| agree) else {
            let [(larger, size), (other, smaller)] = larger_first([(first, a), (second, b)], |(_, size)| *size);
            return Some(if smaller / size < ONE_SIDED && !differ { larger } else { larger.or_as(other) });
        };
        let baselines = self.baselines();
        let stream = Stream::all(self.sides.each_ref().map(|track| &track.recent), baselines);
        // The course ends with the last throw that shows the size.
        let since = stream.since_counted(weights);
        let recent = stream.points(weights, now - since);
        // The history consists of blocks, each with throws of both directions.
        let oldest = recent.first()?.age;
        let blocks = history.along(weights, now).map(|block| Point { age: block.age - since as f64, ..block });
        let before = blocks.filter(|block| block.age - block.throws / 2.0 > oldest);
        let points: Vec<_> = before.chain(recent).collect();
        let centre_throws = baselines.iter().flatten().map(|baseline| baseline.centre_throws()).sum();
        Course::of(&points, noise(&mixed.scatter, centre_throws, weights, temperature_sd))
    }

    /// The course of a drift along `weights` over the last throws of the direction with index `at`.
    fn course_of(&self, at: usize, weights: &Vector3<f64>, temperature_sd: &Vector3<f64>, now: u64) -> Option<Course> {
        let baselines = self.baselines();
        let baseline = baselines[at]?;
        let stream = Stream::of(&self.sides[at].recent, at, baselines);
        let points = stream.points(weights, now - stream.since_counted(weights));
        Course::of(&points, noise(&baseline.scatter, baseline.centre_throws(), weights, temperature_sd))
    }

    /// The only direction that has a drift along `weights`. `None` if both have it, and until it has lasted for enough
    /// throws. `now`: number of the latest throw.
    pub(crate) fn one_sided(
        &self,
        weights: &Vector3<f64>,
        temperature_sd: &Vector3<f64>,
        now: u64,
    ) -> Option<Direction> {
        let of =
            |direction: Direction| Some((direction, self.course_of(direction.side(), weights, temperature_sd, now)?));
        let [normal, reverse] = Direction::BOTH;
        let courses = match self.baselines() {
            [Some(_), None] => return Some(normal),
            [None, Some(_)] => return Some(reverse),
            _ => [of(normal)?, of(reverse)?],
        };
        let [(direction, course), (_, other)] = larger_first(courses, |(_, course)| course.now().0);
        let [(larger, larger_sd), (smaller, smaller_sd)] = [course.now(), other.now()];
        let difference = larger.abs() - smaller.abs();
        let is_one_sided = smaller / larger < ONE_SIDED && difference > ONE_SIDED_SD * larger_sd.hypot(smaller_sd);
        let has_lasted = course.at(ONE_SIDED_AGE) / larger > LASTED;
        (is_one_sided && has_lasted).then_some(direction)
    }
}

/// The two values, that with the larger `size` first; with equal sizes in the other order.
fn larger_first<T>([first, second]: [T; 2], size: impl Fn(&T) -> f64) -> [T; 2] {
    if size(&first).abs() > size(&second).abs() { [first, second] } else { [second, first] }
}

/// Noise along `weights` of throws compared with the centre of a baseline, which is a mean of `centre_throws` throws.
fn noise(scatter: &Scatter, centre_throws: f64, weights: &Vector3<f64>, temperature_sd: &Vector3<f64>) -> Noise {
    let noise = scatter.along(weights, centre_throws);
    Noise { offset_sd: noise.offset_sd.hypot(weights.dot(temperature_sd)), ..noise }
}
