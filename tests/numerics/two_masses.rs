//! A simulated machine that shares no code with the estimator and the simulator: motor and toe as two masses, in steps
//! of 10 us, with effects of real drives and loggers.

use std::f64::consts::TAU;

use pointsd::estimate::{Identification, Identifier, Settings};
use pointsd::throw::{Throw, Trace};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::StandardNormal;

/// Step of the integration \[s\].
const STEP_S: f64 = 1e-5;
/// Sampling interval \[s\].
const INTERVAL_S: f64 = 1e-3;
const MM_PER_RADIAN: f64 = 10.0 / TAU;
/// Torque per ampere \[N m/A\], and back-EMF per speed \[V s/rad\], at the screw.
pub(crate) const TORQUE: f64 = 6.3864;
/// Inertia of the drive at the screw \[kg m²\].
pub(crate) const DRIVE_INERTIA: f64 = 0.0308;
/// Inertia of the toe at the screw \[kg m²\].
pub(crate) const TOE_INERTIA: f64 = 6e-4;
/// Viscous friction at the screw \[N m s\].
pub(crate) const FRICTION: f64 = 0.185;
/// Stiffness at the screw \[N m/rad\].
pub(crate) const STIFFNESS: f64 = 0.049;
/// Dry friction of the slide chairs at the screw, for a friction coefficient of 1 \[N m\].
const DRY_PER_MU: f64 = 9.0;
/// Stiffness \[N m/rad\] and damping \[N m s\] of a stiff toe drive, at the screw.
const STIFF: (f64, f64) = (6000.0, 3.0);
/// Stiffness and damping of a soft toe drive, 5e6 N/m, at the screw.
const SOFT: (f64, f64) = (12.7, 0.25);

/// Which samples the logger records. The numbers of samples count from the motor's start.
#[derive(Clone, Copy, Default)]
pub(crate) enum Recorded {
    #[default]
    Whole,
    /// Five samples from this one on are lost.
    Lost(usize),
    /// Five samples from this one on were not measured.
    Null(usize),
    /// The recording begins after so many samples.
    Late(usize),
}

#[derive(Clone, Copy, Default)]
pub(crate) struct Drive {
    /// Play between drive and toe \[mm\].
    pub(crate) lost_mm: f64,
    /// Play between toe and sensor \[mm\].
    pub(crate) play_mm: f64,
    /// Torque of the brake at the screw \[N m\].
    pub(crate) brake_nm: f64,
    /// Release of the brake after the start of the motor \[s\].
    pub(crate) brake_s: f64,
    /// Random load as a share of the friction.
    pub(crate) wander: f64,
    /// Time constant of the random load \[s\], 0 for 50 ms.
    pub(crate) wander_s: f64,
    /// Jitter of the sampling times \[s\].
    pub(crate) jitter_s: f64,
    /// Noise of the current in addition to 20 mA \[A\].
    pub(crate) noise_a: f64,
    /// Set value of a current-controlled drive \[A\]; `None` for a constant voltage.
    pub(crate) controlled_a: Option<f64>,
    /// Low-pass of the position \[Hz\], 0 without one.
    pub(crate) lag_hz: f64,
    /// Delay of the position behind the current \[s\].
    pub(crate) skew_s: f64,
    /// Hum of the mains on the current, amplitude \[A\].
    pub(crate) hum_a: f64,
    pub(crate) recorded: Recorded,
    /// Coulomb friction coefficient of the slide chairs.
    pub(crate) mu: f64,
    /// Whether the toe drive is soft.
    pub(crate) soft: bool,
    /// Where the rails are unstressed \[mm\].
    pub(crate) neutral_mm: f64,
    /// Step of the position's converter \[mm\], 0 without one.
    pub(crate) step_mm: f64,
    /// Samples from one new position to the next, 0 for a new one in each sample.
    pub(crate) position_every: usize,
    /// Time from the motor's start until which the position stays at its value at rest \[s\].
    pub(crate) stuck_s: f64,
}

impl Drive {
    pub(crate) fn identify(self, seed: u64) -> Identification {
        let settings = Settings { neutral_mm: self.neutral_mm, ..Settings::default() };
        Identifier::default().identify(&Throw::recorded(self.record(seed)), &settings)
    }

    pub(crate) fn record(self, seed: u64) -> Trace {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (current, mut toe) = self.throw(&mut rng);
        if self.lag_hz > 0.0 {
            let keep = (-TAU * self.lag_hz * STEP_S).exp();
            let mut state = 0.0;
            for mm in &mut toe {
                state = keep * state + (1.0 - keep) * *mm;
                *mm = state;
            }
        }
        let mut shown = 0.0_f64;
        for mm in &mut toe {
            shown = shown.clamp(*mm - self.play_mm, *mm);
            *mm = shown;
        }
        let part = rng.random::<f64>() * INTERVAL_S;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index within the throw")]
        let at = |grid: &[f64], time_s: f64| grid[((time_s / STEP_S).max(0.0) as usize).min(grid.len() - 1)];
        let (mut amperes, mut millimetres) = (Vec::new(), Vec::new());
        for k in 0..200 + current.len() / 100 + 200 {
            let time_s = k as f64 * INTERVAL_S - 0.2 + part + self.jitter_s * rng.sample::<f64, _>(StandardNormal);
            let hum = self.hum_a * (TAU * 50.03 * time_s).sin();
            amperes.push(at(&current, time_s) + hum + self.noise_a.hypot(0.02) * rng.sample::<f64, _>(StandardNormal));
            millimetres.push(at(&toe, time_s - self.skew_s) + 0.02 * rng.sample::<f64, _>(StandardNormal));
        }
        let rest_mm = millimetres[199];
        for (k, mm) in millimetres[200..].iter_mut().enumerate() {
            if (k as f64) * INTERVAL_S < self.stuck_s {
                *mm = rest_mm;
            }
        }
        if self.step_mm > 0.0 {
            for mm in &mut millimetres {
                *mm = (*mm / self.step_mm).round() * self.step_mm;
            }
        }
        if self.position_every > 0 {
            let first = rng.random_range(0..self.position_every);
            for k in (1..millimetres.len()).filter(|k| k % self.position_every != first) {
                millimetres[k] = millimetres[k - 1];
            }
        }
        for channel in [&mut amperes, &mut millimetres] {
            match self.recorded {
                Recorded::Whole => {}
                Recorded::Lost(from) => drop(channel.drain(200 + from..205 + from)),
                Recorded::Null(from) => channel[200 + from..205 + from].fill(f64::NAN),
                Recorded::Late(count) => drop(channel.drain(..200 + count)),
            }
        }
        Trace::new(1.0 / INTERVAL_S, amperes, millimetres).unwrap()
    }

    /// True current \[A\] and toe position \[mm\] from the motor's start on.
    fn throw(self, rng: &mut ChaCha8Rng) -> (Vec<f64>, Vec<f64>) {
        let keep = (-STEP_S / if self.wander_s > 0.0 { self.wander_s } else { 0.05 }).exp();
        let mut wander = 0.0;
        let (mut amperes, mut on) = (0.0, true);
        let (stiffness, damping) = if self.soft { SOFT } else { STIFF };
        let ([mut drive, mut toe], [mut drive_speed, mut toe_speed]) = ([0.0; 2], [0.0; 2]);
        let (mut current, mut position, mut rest) = (Vec::new(), Vec::new(), 0);
        while rest < 25_000 {
            current.push(amperes);
            position.push(toe * MM_PER_RADIAN);
            if self.wander > 0.0 {
                wander = keep * wander + (1.0 - keep * keep).sqrt() * rng.sample::<f64, _>(StandardNormal);
            }
            let back = 4.0 * amperes + TORQUE * drive_speed;
            let volts = self.controlled_a.map_or(110.0, |a| (back + 400.0 * (a - amperes)).clamp(-110.0, 110.0));
            amperes += if on { STEP_S / 0.02 * (volts - back) } else { -STEP_S / 1e-3 * amperes };
            let gap = self.lost_mm / MM_PER_RADIAN;
            let stretch = drive - toe;
            let free = (0.0..gap).contains(&stretch);
            let pressed = if stretch > gap { stretch - gap } else { stretch };
            let contact = if free { 0.0 } else { stiffness * pressed + damping * (drive_speed - toe_speed) };
            let load = 0.75 * FRICTION * (drive_speed + self.wander * wander * 17.0) + contact;
            let brake = if position.len() as f64 * STEP_S > self.brake_s { 0.0 } else { self.brake_nm };
            drive_speed = (drive_speed + STEP_S / DRIVE_INERTIA * (TORQUE * amperes - load - brake))
                .max(if brake > 0.0 { 0.0 } else { f64::NEG_INFINITY });
            drive += STEP_S * drive_speed;
            toe_speed += STEP_S / TOE_INERTIA
                * (contact - 0.25 * FRICTION * toe_speed - STIFFNESS * (toe - self.neutral_mm / MM_PER_RADIAN));
            // Coulomb's law: the friction stops the toe, and holds it.
            let lost = STEP_S / TOE_INERTIA * DRY_PER_MU * self.mu;
            toe_speed -= lost.min(toe_speed.abs()).copysign(toe_speed);
            toe += STEP_S * toe_speed;
            on &= toe * MM_PER_RADIAN < 114.5;
            if !on {
                (drive_speed, toe_speed, rest) = (0.98 * drive_speed, 0.98 * toe_speed, rest + 1);
            }
        }
        (current, position)
    }

    /// The true coefficients b0, a1, a0: dry friction counts as the viscous friction with the same torque at the mean
    /// speed of the movement.
    pub(crate) fn truth(self) -> [f64; 3] {
        let (_, toe) = self.throw(&mut ChaCha8Rng::seed_from_u64(0));
        let reach = |share: f64| toe.iter().position(|mm| *mm > share * 114.5).unwrap();
        let (from, to) = (reach(0.05), reach(0.95));
        let speed = (toe[to] - toe[from]) / MM_PER_RADIAN / ((to - from) as f64 * STEP_S);
        let inertia = DRIVE_INERTIA + TOE_INERTIA;
        [TORQUE, FRICTION + DRY_PER_MU * self.mu / speed, STIFFNESS].map(|part| part / inertia)
    }
}
