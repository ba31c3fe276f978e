//! The toe drive of equation (8) and the friction clutch in it.
//!
//! The drive's force is F = `K_fs` (p theta - x - s) + `C_fs` (p theta' - x'), where s is how far the clutch has slipped. It
//! holds up to its limit, then slips at just that force until screw and toe move alike again. What the motor does to an
//! obstacle is so bounded: without a clutch 110 V would stall it at 27 A and press 110 kN on the rails.

use super::dynamics::{SCREW, SCREW_SPEED, State, Toe};
use super::machine::Parameters;

/// State of the toe drive between two steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drive {
    metres_per_radian: f64,
    stiffness: f64,
    damping: f64,
    limit_n: f64,
    toe: Toe,
    /// Slip of the clutch so far \[m at the toe\].
    slip_m: f64,
    /// The force of a slipping clutch, with its sign \[N\].
    slipping_n: Option<f64>,
}

impl Drive {
    pub(super) fn new(parameters: &Parameters, toe: Toe) -> Self {
        Self {
            metres_per_radian: parameters.metres_per_radian(),
            stiffness: parameters.drive_stiffness_n_m,
            damping: parameters.drive_damping_ns_m,
            limit_n: parameters.clutch_n,
            toe,
            slip_m: 0.0,
            slipping_n: None,
        }
    }

    pub(super) fn slips(&self) -> bool {
        self.slipping_n.is_some()
    }

    /// The part of the force that does not follow from the state \[N\].
    #[inline]
    pub(super) fn constant_force(&self) -> f64 {
        self.slipping_n.unwrap_or(-self.stiffness * self.slip_m)
    }

    /// Force on the toe at `toe_m` in this state, were the clutch to hold \[N\].
    #[inline]
    fn holding_force(&self, state: &State, toe_m: f64) -> f64 {
        let stretch = self.metres_per_radian * state[SCREW] - toe_m - self.slip_m;
        self.stiffness * stretch + self.damping * self.relative_speed(state)
    }

    /// Speed of the screw's push relative to the toe \[m/s\].
    #[inline]
    fn relative_speed(&self, state: &State) -> f64 {
        self.metres_per_radian * state[SCREW_SPEED] - self.toe.speed(state)
    }

    /// Whether the clutch, which held in the step to `reached`, could not have: then it slips, and the step is void.
    #[inline]
    pub(super) fn breaks_away(&mut self, reached: &State, toe_m: f64) -> bool {
        if self.slips() {
            return false;
        }
        let force = self.holding_force(reached, toe_m);
        if force.abs() > self.limit_n {
            self.slipping_n = Some(self.limit_n.copysign(force));
        }
        self.slips()
    }

    /// Whether the slipping clutch has come to hold: it no longer slips the way its force says. The slip is then what
    /// leaves the force as it is.
    #[inline]
    pub(super) fn engages(&mut self, reached: &State) -> bool {
        let Some(force) = self.slipping_n.filter(|force| force * self.relative_speed(reached) <= 0.0) else {
            return false;
        };
        self.slip_m += (self.holding_force(reached, self.toe.position(reached)) - force) / self.stiffness;
        self.slipping_n = None;
        true
    }
}
