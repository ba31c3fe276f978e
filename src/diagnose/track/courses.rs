//! The courses of a drift over the last throws of each direction, and whether only one direction has the drift.

use std::{cell::RefCell, rc::Rc};

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

/// The courses of the drift at the latest throw. Each is computed when it is needed first: it takes longer than
/// everything else about a throw, and its size, direction and forecast are needed several times.
pub(crate) struct Courses<'a> {
    tracks: &'a Tracks,
    temperature_sd: Vector3<f64>,
    /// Number of the latest throw.
    now: u64,
    known: RefCell<Vec<KnownCourse>>,
}

/// The course along some weights, in the direction with an index; `None` for both directions.
#[derive(Clone)]
struct KnownCourse {
    weights: Vector3<f64>,
    side: Option<usize>,
    course: Option<Rc<Course>>,
}

impl<'a> Courses<'a> {
    /// `temperature_sd`: standard deviation of the effect of the temperature on each coefficient; `now`: number of the
    /// latest throw.
    pub(crate) fn new(tracks: &'a Tracks, temperature_sd: Vector3<f64>, now: u64) -> Self {
        Self { tracks, temperature_sd, now, known: RefCell::default() }
    }

    /// The course of a drift along `weights` over the last throws. With `direction`, the course in this direction only.
    /// Otherwise the course over both directions if they agree. If one direction has hardly a drift, the course of the
    /// other: just after a step, a direction has one throw with the drift, or none. If both have a drift of different
    /// sizes, the size is between the two: friction that grows along the stroke seems larger in the direction in which
    /// the spring helps, and smaller in the other; `differ`: this is known, so neither counts as without a drift.
    pub(crate) fn course(
        &self,
        weights: &Vector3<f64>,
        (direction, differ): (Option<Direction>, bool),
        history: &History,
    ) -> Option<Rc<Course>> {
        if let Some(direction) = direction {
            return self.of_side(direction.side(), weights);
        }
        let [first, second] = match [0, 1].map(|at| self.of_side(at, weights)) {
            [Some(first), Some(second)] => [first, second],
            [first, second] => return first.or(second),
        };
        let ((a, a_sd), (b, b_sd)) = (first.now(), second.now());
        let agree = (a - b).abs() <= AGREE_SD * a_sd.hypot(b_sd);
        let Some(mixed) = self.tracks.mixed.as_ref().filter(|_| agree) else {
            let [(larger, size), (other, smaller)] = larger_first([(first, a), (second, b)], |(_, size)| *size);
            let is_one_sided = smaller / size < ONE_SIDED && !differ;
            return Some(if is_one_sided { larger } else { larger.or_as(&other).into() });
        };
        self.known_or(weights, None, || self.of_both(&mixed.scatter, weights, history))
    }

    /// The only direction that has a drift along `weights`. `None` if both have it, and until it has lasted for enough
    /// throws.
    pub(crate) fn one_sided(&self, weights: &Vector3<f64>) -> Option<Direction> {
        let of = |direction: Direction| Some((direction, self.of_side(direction.side(), weights)?));
        let [normal, reverse] = Direction::BOTH;
        let courses = match self.tracks.baselines() {
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

    /// The course with these weights and this side, from `compute` if it is not known yet.
    fn known_or(
        &self,
        weights: &Vector3<f64>,
        side: Option<usize>,
        compute: impl FnOnce() -> Option<Course>,
    ) -> Option<Rc<Course>> {
        let is_it = |known: &&KnownCourse| known.weights == *weights && known.side == side;
        let found = self.known.borrow().iter().find(is_it).cloned();
        let known = found.unwrap_or_else(|| {
            let new = KnownCourse { weights: *weights, side, course: compute().map(Rc::new) };
            self.known.borrow_mut().push(new.clone());
            new
        });
        known.course
    }

    /// The course over the last throws of both directions, and the means of earlier ones.
    fn of_both(&self, scatter: &Scatter, weights: &Vector3<f64>, history: &History) -> Option<Course> {
        let baselines = self.tracks.baselines();
        let stream = Stream::all(self.tracks.sides.each_ref().map(|track| &track.recent), baselines);
        let (recent, since) = stream.points(weights, self.now);
        // The history consists of blocks, each with throws of both directions.
        let oldest = recent.first()?.age;
        let blocks = history.along(weights, self.now).map(|block| Point { age: block.age - since as f64, ..block });
        let before = blocks.filter(|block| block.age - block.throws / 2.0 > oldest);
        let points: Vec<_> = before.chain(recent).collect();
        let centre_throws = baselines.iter().flatten().map(|baseline| baseline.centre_throws()).sum();
        Course::of(&points, self.noise(scatter, centre_throws, weights))
    }

    /// The course over the last throws of the direction with index `at`.
    fn of_side(&self, at: usize, weights: &Vector3<f64>) -> Option<Rc<Course>> {
        self.known_or(weights, Some(at), || self.compute_of_side(at, weights))
    }

    fn compute_of_side(&self, at: usize, weights: &Vector3<f64>) -> Option<Course> {
        let baselines = self.tracks.baselines();
        let baseline = baselines[at]?;
        let stream = Stream::of(&self.tracks.sides[at].recent, at, baselines);
        let (points, _) = stream.points(weights, self.now);
        Course::of(&points, self.noise(&baseline.scatter, baseline.centre_throws(), weights))
    }

    /// Noise along `weights` of throws compared with the centre of a baseline, which is a mean of `centre_throws`
    /// throws.
    fn noise(&self, scatter: &Scatter, centre_throws: f64, weights: &Vector3<f64>) -> Noise {
        let noise = scatter.along(weights, centre_throws);
        Noise { offset_sd: noise.offset_sd.hypot(weights.dot(&self.temperature_sd)), ..noise }
    }
}

/// The two values, that with the larger `size` first; with equal sizes in the other order.
fn larger_first<T>([first, second]: [T; 2], size: impl Fn(&T) -> f64) -> [T; 2] {
    if size(&first).abs() > size(&second).abs() { [first, second] } else { [second, first] }
}
