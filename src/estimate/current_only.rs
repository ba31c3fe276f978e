//! A throw without a toe position: its features from the current, and its coefficients if supply voltage and stroke are
//! known.
//!
//! The back-EMF shows the speed of the motor. The armature is V = R i + L i' + K y', with supply voltage V, resistance
//! R, inductance L and back-EMF constant K. Let V be constant from the motor's start, Q = ∫i and P = ∫Q. With the model
//! of equation (12), the armature's equation integrated twice is linear in five unknowns,
//!
//! ```text
//! V (t + a0 t³/6) - a0 R ∫P = L i + (R + a1 L) Q + (K b0 + a1 R + a0 L) P + c t² + d
//! ```
//!
//! which are found by least squares over the inrush. (c contains friction and the preload of the spring, d the moment
//! of the start.) Then the movement is y = (V t - R Q - L i) / K, and K follows from the stroke. The ratios a1/b0 and
//! a0/b0 follow from this movement as from a measured one (see `ratios`), and b0 from the third unknown. The terms with
//! a1 and a0 are corrected in a few rounds.

use nalgebra::{Matrix2, Matrix5, Vector5};

use super::{
    acceptance::brake,
    features::Features,
    identification::{Estimate, Grade},
    matrix::invert,
    ratios::{self, Ratios},
    settings::{Motor, Settings},
    trace::{
        movement::{Movement, NEAR_END_SHARE},
        samples::{has_rate, integrate, mean, median_of_magnitudes, samples_in},
        window::{self, Window},
    },
};
use crate::throw::{Channel, Direction, Throw};

/// Lowest sampling rate that resolves the inrush well enough for the coefficients \[Hz\].
const LEAST_RATE_HZ: f64 = 500.0;
/// Length of the part of the inrush from which the armature's constants are estimated \[s\].
const INRUSH_S: f64 = 0.2;
/// Number of corrections of the terms with a1 and a0. Each is smaller than the previous one by the factor a1 L / R, a
/// few per cent.
const ROUNDS: usize = 6;
/// Standard deviation of ln b0, and that added to the logarithms of the ratios. In simulated throws with 20 mA of noise
/// b0 scatters by 0.15 % and a1 by 0.3 % at 1 kHz, and twice as much at 500 Hz.
const SCALE_SD: f64 = 0.005;
const RATIO_SD: f64 = 0.003;
/// Standard deviation of the logarithms of the ratios from errors that are equal in every throw of a machine: because
/// of dry friction, or a filter, the armature's constants are wrong by some per cent.
const SYSTEMATIC_RATIO_SD: f64 = 0.04;

/// A motor that stalls at the end of the stroke until it is switched off has a peak of the current there. The peak of
/// the second half of the throw is above this multiple of the median there.
const STALL_FACTOR: f64 = 2.0;
/// The stalled motor has its supply voltage while its current is above this share of the peak.
const STALLED_SHARE: f64 = 0.95;
/// Longest current without a supply voltage, after the stall \[s\]. A longer current is that of a movement after a
/// heavy load.
const FREEWHEEL_S: f64 = 0.3;
/// A current without a supply voltage decays: the mean of its second half is at most this share of that of its first
/// half.
const FREEWHEEL_SHARE: f64 = 0.5;

/// Reasons why a throw without a toe position has no coefficients.
pub(super) const NO_MOTOR: &str = "the current shows no motor: its channel is dead, or the motor did not start";
pub(super) const NOT_ENDED: &str = "the recording does not show that the motor is switched off at the end of the throw";
const NO_ARMATURE: &str = "the inrush does not give resistance, inductance and back-EMF of the motor: it may be smoothed by a \
                           filter, or supply_v be wrong";
const NO_MODEL: &str = "the movement that follows from the current does not fit the model of a point machine";

/// The features of a throw without a toe position; its duration is the time of the motor.
pub(super) fn features(movement: &Movement<'_>) -> Features {
    let duration_s = movement.motor_off.map(|off| off.saturating_sub(movement.start()) as f64 * movement.interval_s);
    Features { duration_s, ..movement.features().without(Channel::Position) }
}

/// Solves the equation of the module for its five unknowns L, R + a1 L, K b0 + a1 R + a0 L, c and d, over the first
/// `samples`. `integrals` are the current, Q, P and ∫P.
fn solve(
    integrals: &[Vec<f64>; 4],
    samples: usize,
    (supply_v, interval_s): (f64, f64),
    (a0, resistance): (f64, f64),
) -> Option<Vector5<f64>> {
    let [amperes, charge, double, triple] = integrals;
    let (mut normal, mut right) = (Matrix5::zeros(), Vector5::zeros());
    for k in 1..samples {
        let t = k as f64 * interval_s;
        let row = Vector5::new(amperes[k], charge[k], double[k], t * t, 1.0);
        let left = supply_v * t * (1.0 + a0 * t * t / 6.0) - a0 * resistance * triple[k];
        normal += row * row.transpose();
        right += row * left;
    }
    Some(invert(&normal)?.0 * right)
}

/// Supply voltage \[V\] and stroke \[mm\] of a throw whose current may give the coefficients, or the reason why it does
/// not.
pub(super) fn known(movement: &Movement<'_>, throw: &Throw, settings: &Settings) -> Result<(f64, f64), String> {
    if movement.motor_off.is_none() {
        return Err(NO_MOTOR.to_owned());
    }
    let known = throw.possible_supply_v().zip(settings.stroke_mm).filter(|_| settings.motor == Motor::PermanentMagnet);
    let known = known.ok_or_else(|| unknown(throw, settings))?;
    if !has_rate(movement.interval_s, LEAST_RATE_HZ) {
        return Err(format!("the coefficients need at least {LEAST_RATE_HZ} samples/s"));
    }
    Ok(known)
}

/// The coefficients from current, supply voltage and stroke, the values of [`known`], or the reason why these do not
/// determine them. Adds resistance and back-EMF constant to the features. A throw without a direction counts as normal to
/// reverse if it fits.
pub(super) fn estimate(
    movement: &Movement<'_>,
    direction: Option<Direction>,
    (supply_v, stroke_mm): (f64, f64),
    settings: &Settings,
    features: &mut Features,
) -> Result<Estimate, String> {
    let interval_s = movement.interval_s;
    let integrals = integrals(movement).ok_or(NOT_ENDED)?;
    // The motor is cut off when the toe arrives, so the current of the last two samples may be falling already.
    let last = integrals[0].len().checked_sub(3).ok_or(NOT_ENDED)?;
    let solve = |direction: Direction| {
        let from_start_mm = match direction {
            Direction::NormalToReverse => settings.neutral_mm,
            Direction::ReverseToNormal => stroke_mm - settings.neutral_mm,
        };
        let mut window = Window {
            equilibrium: from_start_mm * settings.radians_per_mm(),
            from: movement.start(),
            interval_s,
            offsets: [window::current_offset_variance(movement), 0.0],
            rest_a: window::rest(movement),
            ..Window::default()
        };
        let angle = stroke_mm * settings.radians_per_mm();
        solve_in_rounds(&integrals, last, (supply_v, angle), &mut window).map(|machine| (machine, window))
    };
    let (machine, window) = match direction {
        Some(direction) => solve(direction)?,
        // The current alone may fit both directions.
        None => solve(Direction::NormalToReverse).or_else(|why| solve(Direction::ReverseToNormal).map_err(|_| why))?,
    };
    features.resistance_ohm = Some(machine.resistance);
    features.back_emf_v_s_per_rad = Some(machine.back_emf);
    Ok(machine.estimate(&window, last))
}

/// The current from the start of the motor to the end of its supply voltage, and its integrals Q, P and ∫P; `None` if
/// the recording does not show this end.
fn integrals(movement: &Movement<'_>) -> Option<[Vec<f64>; 4]> {
    let drive = movement.drive();
    let current = movement.current_a.get(movement.start()..=end_of_voltage(movement)?)?;
    let amperes: Vec<f64> = current.iter().map(|i| drive * (i - movement.current.mean)).collect();
    let integral = |values: &[f64]| {
        let mut integral = Vec::new();
        integrate(&mut integral, values, 0.0, movement.interval_s);
        integral
    };
    let charge = integral(&amperes);
    let double = integral(&charge);
    let triple = integral(&double);
    Some([amperes, charge, double, triple])
}

/// Motor and machine as the current shows them.
struct Solved {
    resistance: f64,
    back_emf: f64,
    b0: f64,
    ratios: Ratios,
}

/// Finds motor and machine, with [`ROUNDS`] corrections of the terms with a1 and a0. Fills `window` with the movement
/// before the sample `last`. `angle`: that of the stroke \[rad\].
fn solve_in_rounds(
    integrals: &[Vec<f64>; 4],
    last: usize,
    (supply_v, angle): (f64, f64),
    window: &mut Window,
) -> Result<Solved, &'static str> {
    let [amperes, charge, ..] = integrals;
    let interval_s = window.interval_s;
    let inrush = samples_in(INRUSH_S, interval_s).min(last);
    let (mut a1, mut a0, mut resistance) = (0.0, 0.0, 0.0);
    let (mut integrals_of_movement, mut scratch) = Default::default();
    let mut found = None;
    for _ in 0..ROUNDS {
        let solved = solve(integrals, inrush, (supply_v, interval_s), (a0, resistance)).ok_or(NO_ARMATURE)?;
        let inductance = solved[0];
        resistance = solved[1] - a1 * inductance;
        let late_v_s = solved[4];
        let flux =
            |k: usize| supply_v * (k as f64 * interval_s) - late_v_s - resistance * charge[k] - inductance * amperes[k];
        let back_emf = flux(last) / angle;
        if !(inductance > 0.0 && resistance > 0.0 && back_emf > 0.0) {
            return Err(NO_ARMATURE);
        }
        window.output.clear();
        window.output.extend((0..last).map(|k| flux(k) / back_emf).take_while(|y| *y <= NEAR_END_SHARE * angle));
        window.input.clear();
        window.input.extend_from_slice(&amperes[..window.output.len()]);
        let load = ratios::load(window, &mut integrals_of_movement, &mut scratch);
        let ratios = load.and_then(|load| ratios::of(window, &load, &integrals_of_movement)).ok_or(NO_MODEL)?;
        let [r1, r0] = ratios.values;
        let b0: f64 = solved[2] / (back_emf + r1 * resistance + r0 * inductance);
        (a1, a0) = (r1 * b0, r0 * b0);
        found = Some(Solved { resistance, back_emf, b0, ratios });
    }
    found.filter(|found| found.b0.is_finite() && found.b0 > 0.0).ok_or(NO_MODEL)
}

impl Solved {
    /// The estimate, from the movement in `window`; `last`: first sample after it.
    fn estimate(&self, window: &Window, last: usize) -> Estimate {
        let Self { b0, ratios, .. } = self;
        let [a1, a0] = ratios.values.map(|ratio| ratio * b0);
        // An error of ln b0 is common to all three; the ratios have additional errors.
        let covariance = |scale_sd: f64, ratio_sd: f64, of_ratios: Matrix2<f64>| {
            let of_ratios = Matrix2::from_diagonal_element(ratio_sd * ratio_sd) + of_ratios;
            ratios::covariance([*b0, a1, a0], scale_sd, of_ratios)
        };
        let estimate = ratios.estimate(window, None, None);
        Estimate {
            grade: Grade::CurrentOnly,
            b0: *b0,
            a1,
            a0,
            ratios_only: false,
            covariance: covariance(SCALE_SD, RATIO_SD, ratios.log_covariance),
            // Without a position a brake that drags while the motor starts cannot be distinguished from inertia.
            systematic: covariance(brake::LARGEST_SD, SYSTEMATIC_RATIO_SD, ratios.log_systematic),
            // The errors of a1 and a0 were for b0 = 1.
            offset: estimate.offset.map(|error| b0 * error),
            end_s: (window.from + last - 1) as f64 * window.interval_s,
            ..estimate
        }
    }
}

/// The reason why the coefficients are not estimated from the current: a missing value, or the kind of motor.
fn unknown(throw: &Throw, settings: &Settings) -> &'static str {
    if settings.motor != Motor::PermanentMagnet {
        "the current gives the coefficients of a permanent-magnet motor only"
    } else if throw.supply_v.is_some() && settings.stroke_mm.is_some() {
        "the coefficients need a possible supply_v"
    } else {
        "the coefficients need supply_v in the message and stroke_mm in the configuration"
    }
}

/// The last sample with the supply voltage at the motor; `None` if the motor was never on. A motor that stalls at the
/// end of the stroke winds up the drive, which turns the motor back after the cut-off. Then a current flows for a tenth
/// of a second without a supply voltage.
fn end_of_voltage(movement: &Movement<'_>) -> Option<usize> {
    let off = movement.motor_off?;
    let from = movement.start().midpoint(off);
    let mut late: Vec<f64> =
        movement.current_a.get(from..=off)?.iter().map(|i| (i - movement.current.mean).abs()).collect();
    let peak = late.iter().copied().fold(0.0, f64::max);
    let stalled = late.iter().rposition(|i| *i >= STALLED_SHARE * peak)?;
    let (first, second) = late[stalled..].split_at((late.len() - stalled) / 2);
    let decays = mean(second) < FREEWHEEL_SHARE * mean(first);
    let is_short = (late.len() - stalled) as f64 * movement.interval_s <= FREEWHEEL_S;
    let stalls = is_short && decays && peak > STALL_FACTOR * median_of_magnitudes(&mut late);
    Some(if stalls { from + stalled } else { off })
}
