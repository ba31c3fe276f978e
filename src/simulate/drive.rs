//! The toe drive of equation (8) and the friction clutch in it.
//!
//! The drive's force is F = `K_fs` (p theta - x - s) + `C_fs` (p theta' - x'), with the screw angle theta, the toe
//! travel p per radian, the toe position x and the slip s of the clutch so far. The clutch holds up to a limit of the
//! force. Then it slips with this force until screw and toe move at the same speed again. This limits the force on an
//! obstacle: without a clutch the motor would stall with 27 A at 110 V and press 110 kN on the rails.

use super::dynamics::{SCREW, SCREW_SPEED, State, position, speed};
use super::machine::Parameters;
use super::rails::{MAX_MODES, Modes};

/// State of the toe drive between two steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drive {
    metres_per_radian: f64,
    stiffness: f64,
    damping: f64,
    limit_n: f64,
    /// Deflection of each mode at the toe.
    toe: [f64; MAX_MODES],
    /// Slip of the clutch so far \[m at the toe\].
    slip_m: f64,
    /// Signed force of the slipping clutch \[N\]; `None` while it holds.
    slipping_n: Option<f64>,
}

impl Drive {
    pub(super) fn new(parameters: &Parameters, modes: &Modes) -> Self {
        Self {
            metres_per_radian: parameters.metres_per_radian(),
            stiffness: parameters.drive_stiffness_n_m,
            damping: parameters.drive_damping_ns_m,
            limit_n: parameters.clutch_n,
            toe: modes.toe,
            slip_m: 0.0,
            slipping_n: None,
        }
    }

    pub(super) fn slips(&self) -> bool {
        self.slipping_n.is_some()
    }

    /// The part of the drive's force that does not depend on the state \[N\].
    #[inline]
    pub(super) fn constant_force(&self) -> f64 {
        self.slipping_n.unwrap_or(-self.stiffness * self.slip_m)
    }

    /// Force on the toe at `toe_m` \[N\] if the clutch holds in this state.
    #[inline]
    fn holding_force(&self, state: &State, toe_m: f64) -> f64 {
        let stretch = self.metres_per_radian * state[SCREW] - toe_m - self.slip_m;
        self.stiffness * stretch + self.damping * self.relative_speed(state)
    }

    /// Speed of the screw's end of the drive relative to the toe \[m/s\].
    #[inline]
    fn relative_speed(&self, state: &State) -> f64 {
        self.metres_per_radian * state[SCREW_SPEED] - speed(&self.toe, state)
    }

    /// Lets the clutch slip if the force at the end of the step exceeds the limit; `reached` is the state there,
    /// computed with a holding clutch. Returns true if the clutch begins to slip: then the caller computes the step
    /// again.
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

    /// Lets a slipping clutch hold again when the relative speed no longer has the sign of its force, with a slip for
    /// which the force does not jump. Returns whether the clutch began to hold.
    #[inline]
    pub(super) fn engages(&mut self, reached: &State) -> bool {
        let Some(force) = self.slipping_n.filter(|force| force * self.relative_speed(reached) <= 0.0) else {
            return false;
        };
        self.slip_m += (self.holding_force(reached, position(&self.toe, reached)) - force) / self.stiffness;
        self.slipping_n = None;
        true
    }
}
