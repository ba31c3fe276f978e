//! Dry friction at the motor, the screw and every slide chair, with contacts that stick.
//!
//! The force f of each contact is constant over a step and follows Coulomb's law at the end of the step: |f| <= limit,
//! and f = -limit sign(v) where the contact slides with velocity v. The velocities at the end of the step are
//! `v = v_free + D f`, with the velocities `v_free` without friction and the response D of the step. This is a small
//! complementarity problem. Projected Gauss-Seidel iteration solves it, from the forces of the previous step. Nearly
//! always all contacts slide: then these forces already satisfy the law, and nothing is solved.

use super::dynamics::{MOTOR_SPEED, SCREW_SPEED, STATES, State, Step, add_scaled, shaped, speed};
use super::machine::Parameters;
use super::rails::{Chair, MAX_MODES, Modes};

/// Largest number of Gauss-Seidel iterations in a step. Sticking contacts converge in a few, as they start with the
/// forces of the previous step.
const MAX_SWEEPS: usize = 60;

/// Place of a contact. A chair has the deflection of each mode there.
#[derive(Debug, Clone, Copy)]
enum Site {
    Motor,
    Screw,
    Chair([f64; MAX_MODES]),
}

impl Site {
    fn velocity(&self, state: &State) -> f64 {
        match self {
            Self::Motor => state[MOTOR_SPEED],
            Self::Screw => state[SCREW_SPEED],
            Self::Chair(shape) => speed(shape, state),
        }
    }

    /// Effect on the state of a unit force (a unit torque at motor and screw) over one step.
    fn effect(&self, step: &Step) -> State {
        match self {
            Self::Motor => step.motor,
            Self::Screw => step.screw,
            Self::Chair(shape) => shaped(&step.modal, shape),
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Contact {
    site: Site,
    /// Sliding friction \[N m at motor and screw, N at a chair\].
    sliding: f64,
    /// Present limit of the force, in the same unit: sliding friction, or more near standstill or with a closed brake.
    limit: f64,
    /// Force in the last step, in the same unit.
    force: f64,
}

/// Effect of the force at each contact on the state and on all contacts, for one [`Step`].
#[derive(Debug, Clone)]
pub(super) struct Response {
    /// Effect on the state of a unit force at each contact.
    effect: Vec<State>,
    /// The matrix D: a row for the velocity of each contact, a column for the force of each contact.
    velocity: Vec<Vec<f64>>,
}

impl Response {
    /// Effect of the forces of all contacts on the state.
    fn effect_of(&self, contacts: &[Contact]) -> State {
        let mut sum = [0.0; STATES];
        for (contact, effect) in contacts.iter().zip(&self.effect) {
            add_scaled(&mut sum, effect, contact.force);
        }
        sum
    }
}

/// Dry friction of a machine, with the forces of the last step.
#[derive(Debug, Clone)]
pub(super) struct Friction<'a> {
    parameters: &'a Parameters,
    /// Motor, screw, then the chairs.
    contacts: Vec<Contact>,
    /// Effect of the present forces on the state; `None` after a change of the response or of the forces.
    effect: Option<State>,
}

impl<'a> Friction<'a> {
    pub(super) fn new(parameters: &'a Parameters, modes: &Modes) -> Self {
        let contact = |site, sliding| Contact { site, sliding, limit: sliding, force: 0.0 };
        let mut contacts = vec![
            contact(Site::Motor, parameters.motor_dry_nm * parameters.gear_ratio),
            contact(Site::Screw, parameters.screw_dry_nm),
        ];
        if parameters.rails.slide_friction > 0.0 {
            let slide =
                |chair: &Chair| contact(Site::Chair(chair.shape), parameters.rails.slide_friction * chair.normal_n);
            contacts.extend(modes.chairs.iter().map(slide));
        }
        Self { parameters, contacts, effect: Some([0.0; STATES]) }
    }

    /// Torque of the closed brake \[N m on the screw\].
    fn brake(&self) -> f64 {
        self.parameters.brake_nm * self.parameters.gear_ratio
    }

    pub(super) fn response(&self, step: &Step) -> Response {
        let effect: Vec<State> = self.contacts.iter().map(|contact| contact.site.effect(step)).collect();
        let row = |at: &Contact| effect.iter().map(|effect| at.site.velocity(effect)).collect();
        let velocity = self.contacts.iter().map(row).collect();
        Response { effect, velocity }
    }

    /// Adds the torque of the brake to the friction of the motor.
    pub(super) fn close_brake(&mut self) {
        let brake = self.brake();
        let motor = &mut self.contacts[0];
        motor.limit = motor.sliding + brake;
        // The force may be above the new limit because of break-away friction, but the iteration must start within the
        // limits.
        motor.force = motor.force.clamp(-motor.limit, motor.limit);
        self.effect = None;
    }

    /// Adds this step's friction to `next`, the state that the step would reach without friction. `state` is the state
    /// at the start of the step, from which the break-away friction follows.
    pub(super) fn apply(&mut self, state: &State, next: &mut State, response: &Response, motor_on: bool) {
        if self.parameters.breakaway_ratio > 1.0 {
            self.update_limits(state, motor_on);
        }
        let effect = self.effect.get_or_insert_with(|| response.effect_of(&self.contacts));
        let mut reached = *next;
        add_scaled(&mut reached, effect, 1.0);
        if !self.contacts.iter().all(|contact| contact.holds(&reached)) {
            self.solve(next, response);
            let effect = self.effect.insert(response.effect_of(&self.contacts));
            reached = *next;
            add_scaled(&mut reached, effect, 1.0);
        }
        *next = reached;
    }

    /// Discards the stored effect of the forces, which is wrong after a change of the response.
    pub(super) fn forget_effect(&mut self) {
        self.effect = None;
    }

    /// Computes the limit of each contact from its speed: the excess over sliding friction falls with the square of the
    /// speed in the exponent (Stribeck). A sliding contact gets the new limit as its force.
    fn update_limits(&mut self, state: &State, motor_on: bool) {
        let Parameters { breakaway_ratio, stribeck_speed_m_s, .. } = *self.parameters;
        let (brake, metres_per_radian) =
            (if motor_on { 0.0 } else { self.brake() }, self.parameters.metres_per_radian());
        for (at, contact) in self.contacts.iter_mut().enumerate() {
            let speed = contact.site.velocity(state).abs();
            let toe_speed = if matches!(contact.site, Site::Chair(_)) { speed } else { speed * metres_per_radian };
            let relative = toe_speed / stribeck_speed_m_s;
            // Far above the Stribeck speed, as in most of a throw, the excess is negligible.
            let excess = if relative < 5.0 { (breakaway_ratio - 1.0) * (-relative * relative).exp() } else { 0.0 };
            let limit = contact.sliding * (1.0 + excess) + if at == 0 { brake } else { 0.0 };
            if limit.to_bits() != contact.limit.to_bits() {
                let slides = contact.force.abs() >= contact.limit;
                contact.limit = limit;
                contact.force = if slides { limit.copysign(contact.force) } else { contact.force.clamp(-limit, limit) };
                self.effect = None;
            }
        }
    }

    /// Computes the forces that satisfy Coulomb's law, by projected Gauss-Seidel iteration; `free` is the state without
    /// friction.
    fn solve(&mut self, free: &State, response: &Response) {
        let mut velocity: Vec<f64> = self.contacts.iter().map(|contact| contact.site.velocity(free)).collect();
        for (row, v) in response.velocity.iter().zip(&mut velocity) {
            *v += row.iter().zip(&self.contacts).map(|(d, contact)| d * contact.force).sum::<f64>();
        }
        for _ in 0..MAX_SWEEPS {
            let mut moved = 0.0_f64;
            for at in 0..self.contacts.len() {
                let own = response.velocity[at][at];
                let contact = &mut self.contacts[at];
                let force = (contact.force - velocity[at] / own).clamp(-contact.limit, contact.limit);
                let change = force - contact.force;
                if change.abs() > 1e-9 * contact.limit {
                    contact.force = force;
                    moved = moved.max(change.abs() / contact.limit);
                    for (row, v) in response.velocity.iter().zip(&mut velocity) {
                        *v += row[at] * change;
                    }
                }
            }
            if moved < 1e-6 {
                break;
            }
        }
    }
}

impl Contact {
    /// Whether the contact slides in `state`, with its force at the limit and against its speed, or has no friction.
    /// Then the force satisfies Coulomb's law.
    #[inline]
    fn holds(&self, state: &State) -> bool {
        let against = || self.force * self.site.velocity(state);
        self.limit == 0.0 || (self.force.abs() >= self.limit && against() < 0.0)
    }
}
