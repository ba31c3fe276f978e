//! The course of a throw from its two channels, without a model: start and end of the motor, positions before and after
//! the movement, and levels of the sensors at rest.

use std::f64::consts::SQRT_2;

use super::samples::{
    Level, first, first_difference_noise, mean, mean_distance, median_distance, median_of, peak, quantum, samples_in,
    second_difference_noise,
};
use crate::{estimate::features::Features, throw::Channel};

/// The search for the start of the motor begins where the current exceeds this share of its peak: above sensor noise,
/// below the first crest.
const START_SHARE: f64 = 0.05;
/// Least distance of the first two samples of a starting motor from the current at rest, in standard deviations of the
/// noise.
const START_SIGMAS: f64 = 6.0;
/// A recording whose current at its beginning departs from the current at its end by more than this share of the peak
/// begins after the start of the motor.
pub(super) const LATE_START_SHARE: f64 = 0.25;
/// Duration of the inrush \[s\].
pub(crate) const INRUSH_S: f64 = 0.15;
/// Period of the mains \[s\].
const HUM_S: f64 = 0.02;
/// Largest current after the inrush, as share of a current within it. The current of a running motor changes by less in
/// this time.
const DECAYED_SHARE: f64 = 0.75;
/// Duration of the shortest rise of the current \[s\]: inductance over resistance of a point machine is 2 ms or more.
const SHORTEST_RISE_S: f64 = 0.008;
/// In a slow recording it is chance how many samples are in the inrush. The charge of the throw counts as known if one
/// sample of the inrush has at most this share of it.
const SAMPLE_SHARE: f64 = 0.1;
/// A slow recording may have one sample of the inrush, which is at least this share of the peak.
const INRUSH_SHARE: f64 = 0.5;
/// The foot of the current's rise is the last sample within this many standard deviations of the noise, or within this
/// share of the peak if the noise is smaller.
const FOOT_SIGMAS: f64 = 3.0;
const FOOT_SHARE: f64 = 0.002;
/// The motor counts as on above this share of the peak current, and above this many standard deviations of the noise.
/// The share is small because a throw in which the spring helps needs very little current.
const ON_SHARE: f64 = 0.005;
const ON_SIGMAS: f64 = 5.0;
/// After the arrival of the toe the motor counts as on above this share of the current before the arrival: a motor that
/// drives a standing toe takes more than a running one, a detection circuit takes less.
const DRIVING_SHARE: f64 = 0.5;
/// Share of the travel at which the estimation stops: after it the toe runs into the stock rail.
pub(crate) const NEAR_END_SHARE: f64 = 0.95;
/// Parts of the travel in which the current of the running motor, and that at the end of the stroke, are compared. The
/// end is after the window of the estimate, and before a cut-off at the end position and a push against the stock rail.
const RUNNING_PART: [f64; 2] = [0.5, 0.85];
const END_PART: [f64; 2] = [0.98, 0.995];
/// Least number of samples in each of these parts.
const LEAST_IN_PART: usize = 3;
/// The toe has arrived within this many standard deviations of the noise from its end position, or within this share of
/// the travel if the noise is smaller.
const ARRIVED_SIGMAS: f64 = 4.0;
const ARRIVED_SHARE: f64 = 0.002;
/// Largest noise of a position that still gives coefficients and shows the arrival of the toe, as share of the travel.
pub(super) const LARGEST_POSITION_SHARE: f64 = 0.005;
/// Share of the travel at which the toe counts as released: 0.6 mm of 115 mm. This is above the noise of position
/// sensors, and reached within the first 50 ms.
const RELEASE_SHARE: f64 = 0.005;
/// Least number of quiet samples, those before the start of the motor, for noise and offset of a sensor.
pub(crate) const MIN_QUIET: usize = 8;
/// With fewer quiet samples their standard deviation may be too small, down to a half of the true one with
/// [`MIN_QUIET`], so that some of a thousand samples at rest exceed [`ON_SIGMAS`] of it.
const KNOWN_NOISE: usize = 50;

/// A recorded throw with its course. Times are indices of its samples.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Movement<'a> {
    /// The channels: finite, of equal length and not empty.
    pub(crate) current_a: &'a [f64],
    pub(crate) position_mm: &'a [f64],
    pub(crate) interval_s: f64,
    /// Number of quiet samples, those before the start of the motor.
    pub(crate) quiet: usize,
    /// Last sample with the motor on; `None` if it was never on.
    pub(crate) motor_off: Option<usize>,
    /// Current at rest, before the start or after the end of the motor.
    pub(crate) current: Level,
    /// Position before the start.
    pub(crate) position: Level,
    /// Number of samples from one measured position to the next; more than 1 if lines join the measured positions.
    pub(crate) position_every: f64,
    /// Standard deviation of the noise of the position \[mm\], also if there are no samples at rest.
    pub(crate) position_noise_mm: f64,
    /// Sign of the toe's movement; 0 without movement.
    pub(crate) sign: f64,
    /// Distance of the toe from its start to its end position \[mm\].
    pub(crate) travel_mm: f64,
    /// First sample at which 95 % of the travel is done.
    pub(crate) near_end: usize,
    /// First sample at which the toe is at its end position, within the noise.
    pub(super) arrived: usize,
    /// Position at the end \[mm\].
    pub(super) end_mm: f64,
    /// Largest magnitude of the current, offset removed \[A\].
    pub(crate) peak_a: f64,
    /// Mean magnitude of the current while the motor was on, offset removed \[A\]. In a slow recording, the mean leaves
    /// out the first sample with the motor on, as this sample may be in the inrush.
    pub(crate) mean_a: f64,
}

impl<'a> Movement<'a> {
    /// Determines the course of a throw; `start`: the result of [`start_of_motor`].
    pub(crate) fn of(
        current: &'a [f64],
        position: &'a [f64],
        interval_s: f64,
        start: Option<usize>,
        scratch: &mut Vec<f64>,
    ) -> Self {
        let len = current.len();
        let quiet = start.map_or(len, |start| start + 1);
        let before = if start == Some(0) { 0 } else { quiet };
        let mut level = Level::of(&current[..before]);
        // Few samples at rest may show too little noise; most recordings end at rest.
        let last = &current[len - (len / 20).max(MIN_QUIET).min(len)..];
        let end_sd = if before < MIN_QUIET { first_difference_noise(last, scratch) } else { 0.0 };
        let threshold = |level: &Level, peak: f64| {
            let noise = if level.samples >= MIN_QUIET {
                ON_SIGMAS * level.sd
            } else {
                // One pulse from a contact looks like noise as large as the running current.
                (ON_SIGMAS * level.sd.max(end_sd)).min(START_SHARE * peak)
            };
            noise.max(ON_SHARE * peak)
        };
        let mut peak_a = peak(current, level.mean);
        let mut motor_off = start.and_then(|_| last_beyond(current, &level, threshold(&level, peak_a)));
        if let Some(off) = motor_off.filter(|_| level.samples < MIN_QUIET) {
            // The current decays for a moment after the cut-off.
            let tail = &current[(off + 1 + len / 100 + 2).min(len)..];
            level = if tail.len() >= MIN_QUIET { Level::of(tail) } else { Level::default() };
            peak_a = peak(current, level.mean);
            if level.samples > 0 {
                motor_off = last_beyond(current, &level, threshold(&level, peak_a));
            }
        }
        // Without a motor the toe may move from the first samples on.
        let mut position_level = Level::of(&position[..if start.is_some() { before } else { len.min(MIN_QUIET) }]);
        if before == 0 {
            position_level.mean = position[0];
        }
        (level.quantum, position_level.quantum) = (quantum(current), quantum(position));
        let end_mm = median_of(&position[len - (len / 50).clamp(1, 50)..], scratch);
        // An obstructed drive springs back after the cut-off, so the furthest position counts.
        let with_motor = motor_off.map_or(end_mm, |off| median_of(&position[off.saturating_sub(4)..=off], scratch));
        let distance = |mm: f64| (mm - position_level.mean).abs();
        let reached_mm = if distance(with_motor) > distance(end_mm) { with_motor } else { end_mm };
        let moved = reached_mm - position_level.mean;
        let sign = if moved == 0.0 { 0.0 } else { moved.signum() };
        let reached = |from, least_mm| first(position, from, least_mm, |x| sign * (x - position_level.mean));
        let travel_mm = moved.abs();
        let near_end = reached(0, NEAR_END_SHARE * travel_mm).unwrap_or(len - 1);
        let slack = (ARRIVED_SIGMAS * position_level.sd).max(ARRIVED_SHARE * travel_mm);
        let arrived = reached(near_end, travel_mm - slack).unwrap_or(len - 1);
        // A noisy position does not show the arrival.
        let is_clear = arrived > quiet && position_level.sd <= LARGEST_POSITION_SHARE * travel_mm;
        if let Some(off) = motor_off.filter(|off| *off > arrived && is_clear) {
            let since = arrived - (arrived - quiet) / 4;
            let before_a = median_distance(&current[since..=arrived], level.mean, scratch);
            let driving = threshold(&level, peak_a).max(DRIVING_SHARE * before_a);
            // A mean decides, as single samples of a noisy detection circuit are as large as those of a motor.
            let drives = |values: &[f64]| (mean(values) - level.mean).abs() > driving;
            let after = current[arrived..=off].windows(MIN_QUIET).rposition(drives);
            motor_off = Some(arrived + after.map_or(0, |from| from + MIN_QUIET / 2));
        }
        // In a slow recording one sample of the inrush would have as much charge as the rest of the throw.
        let from = (quiet + usize::from(hides_inrush(interval_s))).min(len - 1);
        let on = from..motor_off.map_or(0, |off| off + 1).max(from);
        let mean_a = mean_distance(&current[on], level.mean);
        Self {
            current_a: current,
            position_mm: position,
            interval_s,
            quiet,
            motor_off,
            current: level,
            position: position_level,
            position_every: 1.0,
            position_noise_mm: second_difference_noise(position, scratch),
            sign,
            travel_mm,
            near_end,
            arrived,
            end_mm,
            peak_a,
            mean_a,
        }
    }

    pub(crate) fn values(&self, channel: Channel) -> &'a [f64] {
        match channel {
            Channel::Current => self.current_a,
            Channel::Position => self.position_mm,
        }
    }

    pub(crate) fn level(&self, channel: Channel) -> Level {
        match channel {
            Channel::Current => self.current,
            Channel::Position => self.position,
        }
    }

    /// Sign of a current that drives the throw: that of the inrush, as later a stiff spring may drive the motor.
    pub(crate) fn drive(&self) -> f64 {
        let beyond = |i: &&f64| (*i - self.current.mean).abs() >= 0.5 * self.peak_a;
        self.current_a[self.start()..].iter().find(beyond).map_or(1.0, |i| (i - self.current.mean).signum())
    }

    /// Whether the trace ends while the toe is moving.
    pub(crate) fn ends_moving(&self) -> bool {
        let position = self.position_mm;
        let last = position.len() - 1;
        let stretch = (last / 50).max(3).min(last);
        let speed = |from: usize, to: usize| (position[to] - position[from]).abs() / (to - from).max(1) as f64;
        let running = speed(self.start().min(self.near_end.saturating_sub(1)), self.near_end.max(1));
        speed(last - stretch, last) > 0.5 * running
    }

    /// Whether the motor still drives at the end of the trace: the current is at least half of that in the last tenth
    /// of the motor's time. The inrush does not count, as a motor that a spring helps then takes a tenth of its mean.
    pub(crate) fn ends_driven(&self) -> bool {
        let Some(off) = self.motor_off else { return false };
        let last = &self.current_a[self.current_a.len().saturating_sub(MIN_QUIET / 2)..];
        let before = &self.current_a[self.tenth_before(off)..=off];
        mean_distance(last, self.current.mean) > 0.5 * mean_distance(before, self.current.mean)
    }

    /// The beginning of the last tenth of the time from the start to `off`, at least one sample before it.
    fn tenth_before(&self, off: usize) -> usize {
        off.saturating_sub((off.saturating_sub(self.start()) / 10).max(1))
    }

    /// Last sample before the motor's start, or the first of the trace.
    pub(crate) fn start(&self) -> usize {
        self.quiet.saturating_sub(1)
    }

    /// First sample at which the toe is released; `None` if it is never.
    pub(crate) fn released(&self) -> Option<usize> {
        self.reached(self.start(), (RELEASE_SHARE * self.travel_mm).max(4.0 * self.position.sd))
    }

    /// First sample from `from` on at which the toe has moved by `least_mm`.
    fn reached(&self, from: usize, least_mm: f64) -> Option<usize> {
        first(self.position_mm, from, least_mm, |x| self.sign * (x - self.position.mean))
    }

    /// Distance of the toe from its position at rest \[mm\], positive in the direction of the throw.
    pub(crate) fn progress_mm(&self, sample: usize) -> f64 {
        self.sign * (self.position_mm[sample] - self.position.mean)
    }

    /// Last sample of the window: the first sample at 95 % of the travel, or an earlier one where the motor current
    /// ends and the toe then slows down. If the toe does not slow down, the motor is still switched on: a spring that
    /// drives the throw has reduced the motor current to zero, or to less than its noise. A speed before the end of the
    /// current that is lost in the noise of the position shows nothing.
    pub(crate) fn end(&self) -> usize {
        let position = self.position_mm;
        let Some(off) = self.motor_off.filter(|off| *off < self.near_end) else { return self.near_end };
        let back = self.tenth_before(off);
        let speed = |from: usize, to: usize| (position[to] - position[from]) * self.sign / (to - from).max(1) as f64;
        let (before, after) = (speed(back, off), speed(off, self.near_end));
        let noise = SQRT_2 * self.position_noise_mm / (off - back).max(1) as f64;
        if after < 0.7 * before && noise < 0.1 * before { off } else { self.near_end }
    }

    /// Sets the number of samples from one measured position to the next. The samples on the lines between measured
    /// positions have no noise of their own, so only measured positions count as samples at rest. For the same reason
    /// the noise of the whole trace is that at rest, or `expected_noise_mm` without enough samples at rest.
    pub(crate) fn measure_position_every(&mut self, samples: f64, expected_noise_mm: f64) {
        self.position_every = samples.max(1.0);
        self.position.samples = samples_in(self.position.samples as f64, self.position_every);
        if self.position_every > 1.0 {
            self.position_noise_mm =
                if self.position.samples >= MIN_QUIET { self.position.sd } else { expected_noise_mm };
        }
    }

    /// The current at the end of the stroke, less that of the running motor \[A\]. It is a difference, so that friction
    /// over the whole stroke cancels.
    fn end_rise_a(&self) -> Option<f64> {
        let off = self.motor_off?;
        let is_clear = self.travel_mm > 0.0 && self.position_noise_mm <= LARGEST_POSITION_SHARE * self.travel_mm;
        let drive = self.drive();
        let mean_a = |[from, to]: [f64; 2], since: usize| {
            let from = self.reached(since, from * self.travel_mm)?;
            let to = self.reached(from, to * self.travel_mm)?.min(off + 1);
            (to >= from + LEAST_IN_PART).then(|| drive * mean(&self.current_a[from..to]))
        };
        let end_a = is_clear.then(|| mean_a(END_PART, self.near_end)).flatten()?;
        Some(end_a - mean_a(RUNNING_PART, self.start())?).filter(|rise_a| rise_a.is_finite())
    }

    /// The features that follow from the course alone.
    pub(crate) fn features(&self) -> Features {
        let start = self.start();
        let since_start_s = |k: usize| k.saturating_sub(start) as f64 * self.interval_s;
        let on_s = self.motor_off.map(since_start_s);
        let is_measured =
            |charge_as: f64| !hides_inrush(self.interval_s) || self.peak_a * self.interval_s < SAMPLE_SHARE * charge_as;
        let running = self.motor_off.map(|off| start.midpoint(off)..off - off.saturating_sub(start) / 10);
        Features {
            duration_s: self.motor_off.map(|_| since_start_s(self.arrived)),
            release_s: self.motor_off.and_then(|_| self.released()).map(since_start_s),
            // For a huge current the difference from its offset overflows.
            peak_current_a: Some(self.peak_a).filter(|peak_a| peak_a.is_finite()),
            running_current_a: running
                .filter(|running| !running.is_empty())
                .map(|running| mean_distance(&self.current_a[running], self.current.mean)),
            mean_current_a: self.motor_off.map(|_| self.mean_a).filter(|mean_a| mean_a.is_finite()),
            end_rise_a: self.end_rise_a(),
            run_on_s: self.motor_off.map(|off| off.saturating_sub(self.arrived) as f64 * self.interval_s),
            charge_as: on_s
                .map(|on_s| on_s * self.mean_a)
                .filter(|charge_as| charge_as.is_finite() && is_measured(*charge_as)),
            quiet_current_a: (self.current.samples >= MIN_QUIET).then_some(self.current.mean),
            travel_mm: Some(self.travel_mm),
            start_position_mm: Some(self.position.mean),
            end_position_mm: Some(self.end_mm),
            ..Features::default()
        }
    }
}

/// Whether a recording with this sampling interval may have only one sample of the inrush.
fn hides_inrush(interval_s: f64) -> bool {
    interval_s > SHORTEST_RISE_S / 2.0
}

/// Whether `first`, a current at the beginning of a recording, is one of an inrush, which has decayed after
/// [`INRUSH_S`]. `rest` is the current at rest.
pub(super) fn has_decayed(first: f64, current: &[f64], rest: f64, interval_s: f64) -> bool {
    let settled = current[samples_in(INRUSH_S, interval_s).min(current.len() - 1)];
    (settled - rest).abs() < DECAYED_SHARE * (first - rest).abs()
}

/// The last sample before the start of the motor, where the current exceeds its noise; `None` if it never does. It is the
/// first sample of a recording that begins in the inrush.
///
/// Two neighbouring samples above the threshold show the start, as a single one may be a disturbance. A start after
/// which the current is above the threshold for three fifths of a period of the mains is preferred. A recording that is
/// too slow for this has at most one sample of the inrush, and this one sample then shows the start: after it, the
/// current of a throw in which the spring helps is hardly above 0.
pub(crate) fn start_of_motor(current: &[f64], interval_s: f64, scratch: &mut Vec<f64>) -> Option<usize> {
    let few = current.len().min(5);
    let [lead, tail] = [&current[..few], &current[current.len() - few..]].map(|part| median_of(part, scratch));
    // The smaller of the two currents is that at rest, as a recording may also end with the motor on.
    let is_late = lead.abs() > tail.abs() && (lead - tail).abs() > LATE_START_SHARE * peak(current, tail);
    if is_late && has_decayed(lead, current, tail, interval_s) {
        return Some(0);
    }
    let peak = peak(current, lead);
    let is_beyond = |k: usize, threshold: f64| current.get(k).is_none_or(|i| (i - lead).abs() > threshold);
    let is_inrush = |k: usize| {
        let motor = |k: &usize| is_beyond(*k, ON_SHARE * peak);
        is_beyond(k, INRUSH_SHARE * peak) && (k + 1..current.len()).filter(motor).count() >= MIN_QUIET
    };
    let period = samples_in(HUM_S, interval_s);
    let crossing = |threshold: f64| {
        let is_beyond = |k: usize| is_beyond(k, threshold);
        let first = (0..current.len()).find(|&k| is_beyond(k))?;
        if hides_inrush(interval_s) && is_inrush(first) {
            return Some(first);
        }
        // A recording may begin at a crest of hum, whose other half-waves are then beyond the threshold.
        let mut ahead = (first..first + period).filter(|&k| is_beyond(k)).count();
        let mut earliest = None;
        for k in first..current.len() {
            if is_beyond(k) && is_beyond(k + 1) {
                if 5 * ahead >= 3 * period {
                    return Some(k);
                }
                earliest = earliest.or(Some(k));
            }
            ahead = ahead + usize::from(is_beyond(k + period)) - usize::from(is_beyond(k));
        }
        earliest
    };
    let first = crossing(START_SHARE * peak)?;
    let noise = Level::of(&current[..first.saturating_sub(2)]);
    let first =
        if noise.samples >= MIN_QUIET { crossing((START_SHARE * peak).max(START_SIGMAS * noise.sd))? } else { first };
    if peak == 0.0 || first == 0 {
        return (peak > 0.0).then_some(0);
    }
    // The foot is the last sample within the noise before the rise.
    let band = (FOOT_SIGMAS * noise.sd).max(FOOT_SHARE * peak);
    let centre = if noise.samples >= MIN_QUIET { noise.mean } else { lead };
    Some((0..first).rev().find(|&k| (current[k] - centre).abs() <= band).unwrap_or(0))
}

/// The last value beyond a threshold from the level. If the noise of the level is not well known, the threshold may be
/// within the noise, so the mean of some values around this one must be beyond it too, or in an alternating current
/// their mean distance from the level twice as far.
fn last_beyond(values: &[f64], level: &Level, threshold: f64) -> Option<usize> {
    let is_beyond = |value: f64| (value - level.mean).abs() > threshold;
    let mut end = values.len();
    if level.samples < KNOWN_NOISE {
        let few = MIN_QUIET.min(end);
        let are_beyond = |part: &[f64]| is_beyond(mean(part)) || mean_distance(part, level.mean) > 2.0 * threshold;
        end = few + values.windows(few).rposition(are_beyond)?;
    }
    values[..end].iter().rposition(|value| is_beyond(*value))
}
