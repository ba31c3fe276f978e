//! Simulates a throw step by step: armature, contactor, stops and friction.
//!
//! The equation of the armature, (1), is integrated exactly over a step for a constant speed, that at the middle of the
//! step. The mean torque over the step drives the mechanics, which are exact for constant forces (see
//! [`super::dynamics`]). While no contact sticks and the toe touches no stop, the error is of second order in the step.

use crate::throw::{
    Direction, OutOfRange,
    Range::{Finite, If, Within},
    settings,
};

use super::drive::Drive;
use super::dynamics::{MOTOR_SPEED, Phase, State, Step, add_scaled, at_rest, position, stop_force, stop_offset_force};
use super::friction::{Friction, Response};
use super::machine::{MotorKind, Parameters};
use super::rails::Modes;

/// Usual step of the simulation \[s\].
pub const STEP_S: f64 = 2e-4;
/// Time constant with which the current decays in the arc of the opening contactor \[s\].
const ARC_TIME_S: f64 = 1e-3;
/// Coldest and hottest machine \[°C\].
pub(super) const TEMPERATURES_C: [f64; 2] = [-60.0, 80.0];
/// Time simulated after the motor was cut off \[s\].
const SETTLE_S: f64 = 0.4;

settings! {
    /// Conditions of one throw.
    #[derive(Debug, Clone, Copy, PartialEq)]
    pub struct Conditions {
        /// Temperature of the machine \[°C\].
        pub temperature_c: f64 = 20.0, Within(TEMPERATURES_C[0], TEMPERATURES_C[1], "°C");
        /// Ratio of the supply voltage to the nominal voltage.
        pub supply_ratio: f64 = 1.0, Within(0.0, 3.0, "");
        /// Position of an obstacle between rail and stock rail \[mm from normal\]; `None` for no obstacle.
        pub obstruction_mm: Option<f64> = None;
        /// Phase of the mains of a rectified supply when the motor is switched on \[rad\].
        pub supply_phase_rad: f64 = 0.0, Finite;
    }
}

impl Conditions {
    fn check(&self, stroke_mm: f64) -> Result<(), OutOfRange> {
        self.check_ranges()?;
        Within(0.0, stroke_mm, "mm").check("obstruction_mm", self.obstruction_mm.unwrap_or(0.0))
    }
}

/// True motion of a throw at each step of the simulation, from the moment when the motor is switched on.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Step \[s\].
    pub step_s: f64,
    /// Armature current \[A\], positive when it drives the throw.
    pub current_a: Vec<f64>,
    /// Toe position \[mm from normal\].
    pub toe_mm: Vec<f64>,
    /// Index of the step at which the motor was cut off.
    pub cut_off: usize,
    /// Whether the toe reached the cut-off point before the end of the stroke.
    pub completed: bool,
}

impl Parameters {
    /// Simulates one throw in steps of `step_s` (usually [`STEP_S`]), from the start of the motor to 0.4 s after its
    /// cut-off.
    ///
    /// # Errors
    /// When a parameter or condition is out of its range, or the parameters together cannot be simulated.
    pub fn simulate(&self, direction: Direction, conditions: &Conditions, step_s: f64) -> Result<Motion, OutOfRange> {
        self.check()?;
        conditions.check(self.stroke_mm)?;
        let machine = self.at_temperature(conditions.temperature_c);
        let modes = machine.rails.modes();
        let motion = Machine::new(&machine, &modes, direction, conditions, step_s).run();
        // With some combinations of valid parameters the states grow without bound.
        for (key, values) in [("current_a", &motion.current_a), ("toe_mm", &motion.toe_mm)] {
            let last = values[values.len() - 1];
            If(last.is_finite(), "finite: these parameters together cannot be simulated").check(key, last)?;
        }
        Ok(motion)
    }
}

/// A throw in progress.
struct Machine<'a> {
    parameters: &'a Parameters,
    conditions: &'a Conditions,
    /// Sign of the throw, see [`Direction::sign`].
    sign: f64,
    /// Position of the stock rail at which the throw ends \[mm from normal\].
    end_mm: f64,
    /// Step \[s\].
    h: f64,
    /// The linear step for each [`Phase`], with the response of the friction. Each is built at its first use, as a
    /// throw in which the toe touches no stop and the clutch holds needs only one.
    steps: [Option<(Step, Response)>; 4],
    modes: &'a Modes,
    drive: Drive,
    friction: Friction<'a>,
    state: State,
    /// Toe position in `state` \[m from neutral\].
    toe_m: f64,
    /// Armature current \[A\], positive when it drives towards reverse.
    current: f64,
    decay: Decay,
    /// Motor speed at the previous step \[rad/s\], referred to the screw, to extrapolate the speed at the middle of the
    /// next.
    last_speed: f64,
    /// Position of the stop that the toe touches \[m from neutral\].
    contact: Option<f64>,
}

impl<'a> Machine<'a> {
    fn new(
        parameters: &'a Parameters,
        modes: &'a Modes,
        direction: Direction,
        conditions: &'a Conditions,
        h: f64,
    ) -> Self {
        let (start_mm, end_mm) = match direction {
            Direction::NormalToReverse => (0.0, parameters.stroke_mm),
            Direction::ReverseToNormal => (parameters.stroke_mm, 0.0),
        };
        let toe_m = (start_mm - parameters.neutral_mm) / 1000.0;
        Self {
            parameters,
            conditions,
            sign: direction.sign(),
            end_mm,
            h,
            steps: Default::default(),
            modes,
            drive: Drive::new(parameters, modes),
            friction: Friction::new(parameters, modes),
            state: at_rest(parameters, modes, toe_m),
            toe_m,
            current: 0.0,
            decay: Decay::over(parameters.resistance_ohm * h / parameters.inductance_h),
            last_speed: 0.0,
            contact: None,
        }
    }

    fn run(mut self) -> Motion {
        let p = self.parameters;
        let steps_on = steps(p.timeout_s, self.h);
        let settle = steps(SETTLE_S, self.h);
        let cut_off_mm = self.end_mm - self.sign * p.cut_off_mm;
        let mut motion = Motion {
            step_s: self.h,
            current_a: vec![0.0],
            toe_mm: vec![self.toe_mm()],
            cut_off: steps_on,
            completed: false,
        };
        let mut on = true;
        for at in 0..steps_on + settle {
            self.step(at, on);
            motion.current_a.push(self.current * self.sign);
            let toe_mm = self.toe_mm();
            motion.toe_mm.push(toe_mm);
            let arrived = (toe_mm - cut_off_mm) * self.sign >= 0.0;
            if on && (arrived || at + 1 >= steps_on) {
                on = false;
                motion.completed = arrived;
                motion.cut_off = at + 1;
                self.friction.close_brake();
            }
            if !on && at >= motion.cut_off + settle {
                break;
            }
        }
        motion
    }

    fn toe_mm(&self) -> f64 {
        self.toe_m * 1000.0 + self.parameters.neutral_mm
    }

    /// Advances the throw by the step number `at`; `on` is whether the motor has its supply.
    fn step(&mut self, at: usize, on: bool) {
        let torque = self.armature(at, on) * self.parameters.gear_ratio;
        let mut next = self.reached(torque, on);
        self.toe_m = position(&self.modes.toe, &next);
        if self.drive.breaks_away(&next, self.toe_m) {
            self.friction.forget_effect();
            next = self.reached(torque, on);
            self.toe_m = position(&self.modes.toe, &next);
        }
        if self.drive.engages(&next) {
            self.friction.forget_effect();
        }
        self.last_speed = self.state[MOTOR_SPEED];
        self.state = next;
        self.update_contact();
    }

    /// The state after one step, with the motor's `torque` referred to the screw \[N m\].
    fn reached(&mut self, torque: f64, on: bool) -> State {
        let phase = Phase { at_stop: self.contact.is_some(), slipping: self.drive.slips() };
        let number = 2 * usize::from(phase.at_stop) + usize::from(phase.slipping);
        let (step, response) = self.steps[number].get_or_insert_with(|| {
            let step = Step::new(self.parameters, self.modes, self.h, phase);
            let response = self.friction.response(&step);
            (step, response)
        });
        let mut next = step.advance(&self.state);
        add_scaled(&mut next, &step.motor, torque);
        let force = self.drive.constant_force();
        if force != 0.0 {
            add_scaled(&mut next, &step.drive, force);
        }
        if let Some(stop) = self.contact {
            add_scaled(&mut next, &step.toe, stop_offset_force(stop));
        }
        self.friction.apply(&self.state, &mut next, response, on);
        next
    }

    /// Advances the current by one step; returns the mean torque of the motor \[N m\].
    fn armature(&mut self, at: usize, on: bool) -> f64 {
        let p = self.parameters;
        let speed = self.state[MOTOR_SPEED];
        let mid_speed = (speed + 0.5 * (speed - self.last_speed)) * p.gear_ratio;
        // R i + L i' = V - back-EMF. The back-EMF of a series motor acts as a resistance that grows with speed.
        let (resistance, volts) = if on {
            let phase = self.conditions.supply_phase_rad;
            let ripple = p.rectifier_ripple * (p.supply.mean(at, self.h, phase) - 1.0);
            let supply = p.supply_v * self.conditions.supply_ratio * (1.0 + ripple);
            let driving = supply * self.sign;
            match p.motor {
                MotorKind::PermanentMagnet => (p.resistance_ohm, driving - p.back_emf_constant * mid_speed),
                MotorKind::Series => (p.resistance_ohm + p.back_emf_constant * mid_speed * self.sign, driving),
            }
        } else {
            (p.inductance_h / ARC_TIME_S, 0.0)
        };
        let exponent = resistance * self.h / p.inductance_h;
        if exponent.to_bits() != self.decay.exponent.to_bits() {
            self.decay = Decay::over(exponent);
        }
        let Decay { left, mean, mean_square, .. } = self.decay;
        let settled = volts / resistance;
        let excess = self.current - settled;
        self.current = settled + excess * left;
        match p.motor {
            MotorKind::PermanentMagnet => p.torque_constant * (settled + excess * mean),
            MotorKind::Series => {
                let square = settled * settled + 2.0 * settled * excess * mean + excess * excess * mean_square;
                p.torque_constant * square * self.sign
            }
        }
    }

    /// Ends the contact with a stop, or begins one, in the state after the step.
    fn update_contact(&mut self) {
        let was = self.contact;
        if let Some(stop) = was {
            // A stop only pushes: the contact ends when its force would pull.
            if stop_force(&self.modes.toe, &self.state, stop) * self.sign > 0.0 {
                self.contact = None;
            }
        } else {
            let toe_mm = self.toe_mm();
            let mut stops = self.conditions.obstruction_mm.into_iter().chain([self.end_mm]);
            let touched = stops.find(|mm| (toe_mm - mm) * self.sign > 0.0);
            self.contact = touched.map(|mm| (mm - self.parameters.neutral_mm) / 1000.0);
        }
        if was.is_some() != self.contact.is_some() {
            self.friction.forget_effect();
        }
    }
}

/// Decay of a current from its steady value over one step, e^(-R t / L). It is kept while the resistance is constant.
#[derive(Debug, Clone, Copy)]
struct Decay {
    /// R h / L for a step of h.
    exponent: f64,
    /// Share of the current that is left after the step.
    left: f64,
    /// Mean of this share over the step, and mean of its square.
    mean: f64,
    mean_square: f64,
}

impl Decay {
    fn over(exponent: f64) -> Self {
        let mean = |exponent: f64| -(-exponent).exp_m1() / exponent;
        Self { exponent, left: (-exponent).exp(), mean: mean(exponent), mean_square: mean(2.0 * exponent) }
    }
}

/// Number of steps of `h` in `duration_s`, at least one.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked parameters: a few million steps")]
fn steps(duration_s: f64, h: f64) -> usize {
    (duration_s / h).ceil().max(1.0) as usize
}
