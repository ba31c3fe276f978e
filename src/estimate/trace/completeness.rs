//! Checks of the course of a throw. It must be one complete movement, driven by a motor that starts in the recording.

use super::{
    damage::LEAST_SLIP,
    movement::{LARGEST_POSITION_SHARE, LATE_START_SHARE, MIN_QUIET, Movement, has_decayed},
    samples::{Level, SD_PER_MEDIAN, every, first_difference_noise, mean, median_distance, median_of, peak},
};
use crate::{
    estimate::{rejection::Rejection, settings::Settings},
    throw::Channel,
};

/// Shortest movement: \[mm\], as share of the stroke, and in standard deviations of the position noise. The toe of a
/// locked rail that bends moves less.
const LEAST_TRAVEL_MM: f64 = 2.0;
const LEAST_TRAVEL_SHARE: f64 = 0.02;
const LEAST_TRAVEL_SIGMAS: f64 = 8.0;
/// The rails bend when the toe is locked, so the toe moves up to this distance \[mm\]. With a larger travel (from the
/// mean at rest to the median at the end), larger also than this many standard deviations of the noise, the toe was not
/// locked.
const LARGEST_BEND_MM: f64 = 20.0;
const MEDIAN_SIGMAS: f64 = 3.0;
/// The toe was displaced before the throw if the means of the first and the last quarter of the quiet samples (those
/// before the start of the motor) differ by more than this many of their standard deviations. Over 200 samples, white
/// noise or hum gives less than 0.8, a displacement at any time 0.9 or more.
const DISPLACED_SIGMAS: f64 = 0.85;
/// In a noisy position the toe still moves if it is faster than this share of its mean speed, and moves by more than
/// this many standard deviations of the noise.
const LEAST_SPEED_SHARE: f64 = 0.25;
const MOVED_SIGMAS: f64 = 4.0;
/// Range of possible strokes if none is configured \[mm\], to recognise a position in metres.
const USUAL_STROKES_MM: (f64, f64) = (50.0, 500.0);
/// Least ratio of the travel to noise and converter step in a position in metres: a sensor with 0.2 mm of noise over
/// 115 mm has 575. If the same numbers were millimetres, the sensor would have less than 0.3 um of noise.
const METRES_RESOLUTION: f64 = 400.0;
/// Least and largest travel of a complete throw, as share of the stroke.
const COMPLETE_SHARE: f64 = 0.95;
const TOO_LONG_SHARE: f64 = 1.15;
/// A shorter travel, down to this share of the stroke, may be that of a complete throw, if the gain of the position
/// sensor or `stroke_mm` is wrong. Then the throw must end as a complete one.
const WRONG_GAIN_SHARE: f64 = 0.85;
/// Time from the arrival of the toe to the end of the motor in a complete throw \[s\]: the motor pushes the toe against
/// the stock rail until the detection ends the throw. A motor that lost its supply does not push. At an obstruction the
/// motor slips its clutch, or stalls, until a time-out of seconds or an overload protection, which lets an inrush of
/// 0.1 s pass.
const PUSH_S: (f64, f64) = (0.01, 0.1);
/// Least peak of the current of a pushing motor, as multiple of the running current.
const PUSH_FACTOR: f64 = 1.5;
/// Least mean speed of a toe over its last movement before the arrival, as share of its mean speed before that. At the
/// stock rail the toe stops at once, at a soft obstruction it slows down first.
const SHARP_STOP_SHARE: f64 = 0.7;
/// Length of this last movement, as share of the travel; the movement before it is nine times as long.
const LAST_SHARE: f64 = 0.01;
/// Largest movement back after the end of a complete throw \[mm\], beyond the noise: an obstruction pushes the toe
/// back.
const LARGEST_REBOUND_MM: f64 = 1.0;
/// Largest movement back of a toe that stays closed \[mm\], beyond the noise: the rails and the drive spring back from
/// the stock rail. Simulated sound machines with magnets spring back by up to 4 mm, and a lock must detect a gap of
/// 5 mm. If the toe then ends before the least travel of a complete throw, the smaller value counts.
const LARGEST_RETURN_MM: f64 = 5.0;
const LARGEST_SHORT_RETURN_MM: f64 = 3.0;
/// Least travel, as share of the stroke, of a complete throw whose motor runs on after the toe has stopped: the scale
/// of the sensor may be wrong by 1.5 %, and the configured stroke by 0.5 %. A shorter throw is obstructed. Noise may
/// reduce the travel by this many standard deviations.
const WHOLE_SHARE: f64 = 0.98;
const WHOLE_SIGMAS: f64 = 4.0;
/// Longest movement \[s\]: machines take 0.5 to 10 s, and their overload protection ends much longer movements.
pub(crate) const LONGEST_MOVEMENT_S: f64 = 30.0;
/// Longest time that the motor of a complete throw runs after the arrival of the toe \[s\].
pub(crate) const LONGEST_STALL_S: f64 = 0.5;
/// Least peak current, in standard deviations of the noise. White noise exceeds six once in 10^9 samples.
const LEAST_CURRENT_SIGMAS: f64 = 6.0;
/// Largest movement backwards, or before the start of the motor: as share of the travel, as the rails spring, plus a
/// multiple of the noise's standard deviation, as the largest noise of several thousand samples counts.
const WRONG_WAY_SHARE: f64 = 0.02;
const WRONG_WAY_SIGMAS: f64 = 10.0;
/// Largest travel of a toe that returned to its start, as share of its movement back.
const RETURNED_SHARE: f64 = 0.1;
/// Largest displacement of three consecutive positions at the start of the motor, in standard deviations of the noise.
/// Noise exceeds it in 1 of 1,000,000 healthy throws.
const EARLY_SIGMAS: f64 = 2.8;
/// Least ratio of the peak current at the start of a motor to its running current. A sound machine has 1.5 and more, a
/// machine with dry slide chairs at least this.
const INRUSH_FACTOR: f64 = 1.1;

/// Rejects a trace that is not one complete movement driven by a measurable current.
pub(crate) fn course(movement: &Movement<'_>, settings: &Settings, scratch: &mut Vec<f64>) -> Result<(), Rejection> {
    let Movement { current_a: current, position_mm: position, interval_s, travel_mm, .. } = *movement;
    let at = |k: usize| k as f64 * interval_s;
    let furthest = peak(position, position[0]);
    let noise_mm = whole_noise(movement, scratch);
    if is_in_metres(movement, settings, noise_mm) {
        return Err(Rejection::WrongUnit { travel_mm });
    }
    let noisy = Rejection::Noisy { channel: Channel::Position, measured: noise_mm, expected: None };
    let least =
        LEAST_TRAVEL_MM.max(LEAST_TRAVEL_SHARE * settings.stroke_mm.unwrap_or(0.0)).max(LEAST_TRAVEL_SIGMAS * noise_mm);
    if travel_mm.max(furthest) < least {
        // In noise that may hide a whole stroke, nothing shows that the toe stood still.
        let hides_stroke = LEAST_TRAVEL_SIGMAS * noise_mm > settings.stroke_mm.unwrap_or(USUAL_STROKES_MM.0);
        return Err(if hides_stroke || travel_mm > LARGEST_BEND_MM.max(MEDIAN_SIGMAS * noise_mm) {
            noisy
        } else {
            Rejection::NoMovement
        });
    }
    motor(movement, scratch)?;
    let start = movement.start();
    let moved_mm = peak(&position[..=start], position[0]);
    if moved_mm > WRONG_WAY_SHARE * travel_mm.max(furthest) + WRONG_WAY_SIGMAS * noise_mm {
        return Err(Rejection::MovedBeforeCurrent { moved_mm });
    }
    jumps(movement, furthest, noise_mm)?;
    let back_mm = backwards(movement);
    if back_mm > WRONG_WAY_SHARE * travel_mm + WRONG_WAY_SIGMAS * noise_mm {
        return Err(Rejection::MovedBackwards { back_mm, returned: travel_mm < RETURNED_SHARE * back_mm });
    }
    if travel_mm < least {
        // The toe moved and returned to its start, or the movement is noise.
        let is_noise = travel_mm < LEAST_TRAVEL_SIGMAS * noise_mm && travel_mm > LEAST_TRAVEL_MM;
        return Err(if is_noise {
            noisy
        } else {
            Rejection::MovedBackwards { back_mm: furthest - travel_mm, returned: true }
        });
    }
    let off = movement.motor_off.unwrap_or(movement.arrived);
    let stalled_s = at(off.saturating_sub(movement.arrived));
    let is_frozen = |stalled: &[f64]| stalled.iter().all(|x| x.to_bits() == stalled[0].to_bits());
    // A standing toe still shows the noise of its sensor; a stuck sensor does not.
    if stalled_s > LONGEST_STALL_S
        && movement.position.hides(movement.position.quantum)
        && is_frozen(&position[movement.arrived.midpoint(off)..=off])
    {
        let (value, at_s) = (position[off], at(movement.arrived));
        return Err(Rejection::Stuck { channel: Channel::Position, value, at_s, stuck_s: stalled_s });
    }
    let reopened = reopened(movement, settings, noise_mm);
    if let Some(stroke_mm) = settings.stroke_mm {
        stroke(movement, stroke_mm, noise_mm, reopened.as_ref(), scratch)?;
    }
    let is_whole = |stroke_mm| travel_mm + WHOLE_SIGMAS * noise_mm > WHOLE_SHARE * stroke_mm;
    if stalled_s > LONGEST_STALL_S && !settings.stroke_mm.is_some_and(is_whole) {
        if noise_mm > LARGEST_POSITION_SHARE * travel_mm && moves_until(off, movement, noise_mm) {
            return Err(noisy);
        }
        return Err(Rejection::Obstructed { position_mm: movement.end_mm, stalled_s });
    }
    if let Some(reopened) = reopened {
        return Err(reopened);
    }
    let duration_s = at(movement.near_end.saturating_sub(start));
    if duration_s > LONGEST_MOVEMENT_S {
        return Err(Rejection::TooSlow { duration_s, longest_s: LONGEST_MOVEMENT_S, rate_hz: 1.0 / interval_s });
    }
    // A recording without the decay of the inrush begins in the middle of the movement.
    let has_decayed = has_decayed(current[0], current, movement.current.mean, interval_s);
    if has_decayed { Ok(()) } else { motor_start(movement) }
}

/// Rejects a trace whose current does not show a motor.
pub(crate) fn motor(movement: &Movement<'_>, scratch: &mut Vec<f64>) -> Result<(), Rejection> {
    let Movement { current_a, current: quiet, travel_mm, .. } = *movement;
    // Without quiet samples the noise comes from differences of samples, which include the ripple of the supply.
    let noise_a = if quiet.samples >= MIN_QUIET { quiet.sd } else { first_difference_noise(current_a, scratch) };
    let is_dead = movement.motor_off.is_none() || movement.peak_a < LEAST_CURRENT_SIGMAS * noise_a;
    if is_dead { Err(Rejection::NoCurrent { travel_mm }) } else { Ok(()) }
}

/// Rejects a recording that begins after the start of the motor.
pub(crate) fn motor_start(movement: &Movement<'_>) -> Result<(), Rejection> {
    let first_a = movement.current_a[0] - movement.current.mean;
    let is_late = movement.quiet < MIN_QUIET && first_a.abs() > LATE_START_SHARE * movement.peak_a;
    if is_late { Err(Rejection::StartMissing { current_a: first_a }) } else { Ok(()) }
}

/// Rejects a recording that begins after the inrush, while the motor runs: its current is larger at the beginning than
/// at the end, and does not decay.
pub(crate) fn begins_at_rest(movement: &Movement<'_>, scratch: &mut Vec<f64>) -> Result<(), Rejection> {
    let current = movement.current_a;
    let few = current.len().min(5);
    let [lead, tail] = [&current[..few], &current[current.len() - few..]].map(|part| median_of(part, scratch));
    let is_running = lead.abs() > tail.abs() && (lead - tail).abs() > LATE_START_SHARE * peak(current, tail);
    let is_inrush = movement.quiet < MIN_QUIET || has_decayed(lead, current, tail, movement.interval_s);
    if is_running && !is_inrush { Err(Rejection::StartMissing { current_a: lead - tail }) } else { Ok(()) }
}

/// Whether the position is in metres: the travel is a thousandth of a stroke, and finely resolved. The travel of a
/// locked toe may be as small, but is not as finely resolved.
fn is_in_metres(movement: &Movement<'_>, settings: &Settings, noise_mm: f64) -> bool {
    let (low, high) = settings.stroke_mm.map_or(USUAL_STROKES_MM, |stroke_mm| (0.9 * stroke_mm, 1.1 * stroke_mm));
    (low..=high).contains(&(1000.0 * movement.travel_mm))
        && movement.travel_mm > METRES_RESOLUTION * noise_mm.max(movement.position.quantum)
}

/// Standard deviation of the noise of the position \[mm\], also for hum and other noise that is not white: then the
/// positions at rest scatter more than the differences of neighbouring samples. A toe that is displaced before the
/// throw does not count as noise.
fn whole_noise(movement: &Movement<'_>, scratch: &mut Vec<f64>) -> f64 {
    let Movement { position_mm: position, position_noise_mm: noise_mm, .. } = *movement;
    let Level { mean: centre, sd, samples, .. } = movement.position;
    let quarter = samples / 4;
    if quarter < MIN_QUIET || sd < 2.0 * noise_mm {
        return noise_mm;
    }
    let of = |from: usize| mean(&position[from..from + quarter]);
    if (of(samples - quarter) - of(0)).abs() > DISPLACED_SIGMAS * sd {
        return noise_mm;
    }
    noise_mm.max(SD_PER_MEDIAN * median_distance(&position[..samples], centre, scratch))
}

/// Whether a travel is shorter than that of a complete throw, even if the noise is added.
pub(crate) fn is_short(travel_mm: f64, stroke_mm: f64, noise_mm: f64) -> bool {
    travel_mm + noise_mm < COMPLETE_SHARE * stroke_mm
}

/// A toe that arrived and came back; `None` if it stayed. The furthest mean of a few samples counts, as single ones are
/// noise, and the end of the motor may be known too late.
fn reopened(movement: &Movement<'_>, settings: &Settings, noise_mm: f64) -> Option<Rejection> {
    let Movement { position_mm: position, sign, travel_mm, near_end, end_mm: position_mm, .. } = *movement;
    let progress_mm = |mm: f64| sign * (mm - movement.position.mean);
    let means = position[near_end..].chunks_exact(MIN_QUIET).map(|part| progress_mm(mean(part)));
    let ended_mm = progress_mm(position_mm);
    let back_mm = means.fold(travel_mm, f64::max) - ended_mm;
    let ends_short = settings.stroke_mm.is_some_and(|stroke_mm| {
        is_short(ended_mm, stroke_mm, noise_mm) && !is_at_end(movement, position_mm, stroke_mm)
    });
    let largest_mm = if ends_short { LARGEST_SHORT_RETURN_MM } else { LARGEST_RETURN_MM };
    (back_mm > largest_mm + WHOLE_SIGMAS * noise_mm).then_some(Rejection::Reopened { back_mm, position_mm })
}

/// Whether a position is at the end of the stroke. A throw that begins with an open toe is short, and ends there.
fn is_at_end(movement: &Movement<'_>, position_mm: f64, stroke_mm: f64) -> bool {
    let end_mm = if movement.sign > 0.0 { stroke_mm } else { 0.0 };
    (position_mm - end_mm).abs() < (1.0 - COMPLETE_SHARE) * stroke_mm
}

/// Rejects a travel that is too short or too long for the stroke. `reopened`: the toe did not stay at its furthest
/// position, which was perhaps the end of the stroke.
fn stroke(
    movement: &Movement<'_>,
    stroke_mm: f64,
    noise_mm: f64,
    reopened: Option<&Rejection>,
    scratch: &mut Vec<f64>,
) -> Result<(), Rejection> {
    let travel_mm = movement.travel_mm;
    if travel_mm - noise_mm > TOO_LONG_SHARE * stroke_mm {
        return Err(Rejection::TravelTooLong { travel_mm, stroke_mm });
    }
    if !is_short(travel_mm, stroke_mm, noise_mm) {
        return Ok(());
    }
    if movement.ends_moving() && movement.ends_driven() {
        return Err(Rejection::EndMissing { travel_mm });
    }
    if let Some(&Rejection::Reopened { back_mm, position_mm }) = reopened
        && is_at_end(movement, position_mm + movement.sign * back_mm, stroke_mm)
    {
        return Err(Rejection::Reopened { back_mm, position_mm });
    }
    let has_wrong_gain = travel_mm > WRONG_GAIN_SHARE * stroke_mm && ends_complete(movement, noise_mm, scratch);
    if has_wrong_gain { Ok(()) } else { Err(Rejection::Incomplete { travel_mm, stroke_mm }) }
}

/// Whether the throw ends as a complete one: the toe stops at once and stays there, and the motor pushes it for a
/// moment. False if the motor is off before the toe arrives, as a motor that loses its supply leaves the same trace.
fn ends_complete(movement: &Movement<'_>, noise_mm: f64, scratch: &mut Vec<f64>) -> bool {
    let Movement { current_a: current, sign, travel_mm, arrived, .. } = *movement;
    let start = movement.start();
    let Some(off) = movement.motor_off.filter(|off| *off > arrived) else { return false };
    let progress = |k: usize| movement.progress_mm(k);
    let reach = |share: f64| (start..arrived).find(|&k| progress(k) >= share * travel_mm);
    let (Some(before), Some(last)) = (reach(1.0 - 10.0 * LAST_SHARE), reach(1.0 - LAST_SHARE)) else { return false };
    let speed = |from: usize, to: usize| (progress(to) - progress(from)) / to.saturating_sub(from).max(1) as f64;
    let rebound_mm = travel_mm - sign * (movement.end_mm - movement.position.mean);
    let push_s = (off - arrived) as f64 * movement.interval_s;
    let push_a = peak(&current[arrived..=off], movement.current.mean);
    let running_a = median_distance(&current[start.midpoint(arrived)..arrived], movement.current.mean, scratch);
    (PUSH_S.0..=PUSH_S.1).contains(&push_s)
        && push_a > PUSH_FACTOR * running_a
        && speed(last, arrived) >= SHARP_STOP_SHARE * speed(before, last)
        && rebound_mm < LARGEST_REBOUND_MM + WHOLE_SIGMAS * noise_mm
}

/// Whether the toe moves until the end of the motor. In a noisy position the first sample near the end of the travel is
/// much too early. So the time from this sample to the end of the motor is cut into thirds, and the mean positions of
/// the second and the last third are compared.
fn moves_until(off: usize, movement: &Movement<'_>, noise_mm: f64) -> bool {
    let third = off.saturating_sub(movement.near_end) / 3;
    if third == 0 {
        return false;
    }
    let of = |from: usize| mean(&movement.position_mm[from..from + third]);
    let moved = movement.sign * (of(off - third) - of(off - 2 * third));
    let usual = movement.travel_mm * third as f64 / off.saturating_sub(movement.start()).max(1) as f64;
    moved > (LEAST_SPEED_SHARE * usual).max(MOVED_SIGMAS * noise_mm * (2.0 / third as f64).sqrt())
}

/// Rejects a toe that already moves at the start of the motor. The mean of three consecutive positions decides, as
/// noise can displace a single one.
pub(crate) fn early(movement: &Movement<'_>) -> Result<(), Rejection> {
    if movement.quiet <= 2 * MIN_QUIET {
        return Ok(());
    }
    let start = movement.start();
    let moved_mm = (mean(&movement.position_mm[start - 2..=start]) - movement.position.mean).abs();
    let noise_mm = (EARLY_SIGMAS * movement.position.sd).max(movement.position.quantum);
    if moved_mm > noise_mm.max(LEAST_SLIP * movement.travel_mm) {
        return Err(Rejection::MovedBeforeCurrent { moved_mm });
    }
    Ok(())
}

/// Rejects a movement without inrush: a starting motor takes more current than a running one.
pub(crate) fn inrush(movement: &Movement<'_>, scratch: &mut Vec<f64>) -> Result<(), Rejection> {
    let current = movement.current_a;
    let (start, end) = (movement.start(), movement.near_end.max(movement.start() + 1));
    let early = start + ((end - start) / 5).max(1);
    let peak_a = peak(&current[start..early], movement.current.mean);
    let running = &current[early..end];
    // The median is below the peak if more than half of the values are; counting takes less time.
    let is_below = |i: &&f64| INRUSH_FACTOR * (**i - movement.current.mean).abs() <= peak_a;
    if running.iter().filter(is_below).count() > running.len() / 2 {
        return Ok(());
    }
    let running_a = median_distance(running, movement.current.mean, scratch);
    if peak_a < INRUSH_FACTOR * running_a { Err(Rejection::NoInrush { peak_a, running_a }) } else { Ok(()) }
}

/// Least height of the first crest of the current, as share of the peak.
const CREST_SHARE: f64 = 0.9;
/// The crest lasts while the current is above this share of its height.
const CREST_FLATNESS: f64 = 0.97;

/// Number of samples from the start of the motor to the end of the first crest of the current; 0 without a crest.
pub(crate) fn rise_samples(movement: &Movement<'_>) -> usize {
    let (current, start) = (movement.current_a, movement.start());
    let level = |k: usize| (current[k] - movement.current.mean).abs();
    let falls = |k: usize| k + 1 == current.len() || level(k + 1) <= level(k);
    let Some(crest) = (start..current.len()).find(|&k| level(k) >= CREST_SHARE * movement.peak_a && falls(k)) else {
        return 0;
    };
    let flat = (crest + 1..current.len()).take_while(|&k| level(k) >= CREST_FLATNESS * level(crest)).count();
    crest + flat - start + 1
}

/// Largest step of the position between two samples. It is the sum of a multiple of the mean step of the movement, of
/// the noise's standard deviation, and of the converter's step, which counts as 0.5 mm at most.
const JUMP_MEAN_STEPS: f64 = 5.0;
const JUMP_SIGMAS: f64 = 10.0;
const JUMP_QUANTA: f64 = 3.0;
const LARGEST_QUANTUM_MM: f64 = 0.5;

/// Rejects a step of the position between two samples that the speed of the machine does not explain. `furthest_mm`:
/// largest distance from the first position.
fn jumps(movement: &Movement<'_>, furthest_mm: f64, noise_mm: f64) -> Result<(), Rejection> {
    let since_start = |sample: usize| sample.saturating_sub(movement.start()).max(1) as f64;
    let mut mean_step = movement.travel_mm / since_start(movement.arrived);
    // A toe that returned to its start moved both ways, at least once, while the motor was on.
    if movement.travel_mm < RETURNED_SHARE * furthest_mm {
        mean_step = mean_step.max(2.0 * furthest_mm / since_start(movement.motor_off.unwrap_or(movement.arrived)));
    }
    let allowed = JUMP_MEAN_STEPS * mean_step
        + JUMP_SIGMAS * noise_mm
        + JUMP_QUANTA * movement.position.quantum.min(LARGEST_QUANTUM_MM);
    let steps = movement.position_mm.array_windows().map(|[before, after]| (after - before).abs());
    if every(steps.clone().map(|step| step <= allowed)) {
        return Ok(());
    }
    match steps.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((at, jump_mm)) if jump_mm > allowed => {
            Err(Rejection::PositionJump { jump_mm, at_s: at as f64 * movement.interval_s })
        }
        _ => Ok(()),
    }
}

/// Largest distance of the toe behind its furthest position so far, while the motor is on \[mm\].
fn backwards(movement: &Movement<'_>) -> f64 {
    let position = movement.position_mm;
    let last = movement.motor_off.unwrap_or(position.len() - 1);
    let sign = if movement.sign == 0.0 { 1.0 } else { movement.sign };
    let (mut furthest, mut worst) = (f64::NEG_INFINITY, 0.0);
    for x in &position[..=last] {
        let x = sign * x;
        furthest = if x > furthest { x } else { furthest };
        worst = if furthest - x > worst { furthest - x } else { worst };
    }
    worst
}
