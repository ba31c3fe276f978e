//! Faults of the simulated machine: the part, the size, and the development over the throws.
//!
//! The size of a fault is the change of a coefficient: a motor of -10 % lowers b0 by 10 %, friction of +25 % raises a1
//! by 25 %, stiffness of +15 % raises a0 by 15 %, inertia of +10 % divides all three by 1.1.
//!
//! Estimates show this change, with two exceptions. First, a weaker motor runs faster, so that dry friction counts as
//! less viscous friction: a motor of -20 % is estimated as -20 % in b0 and -4 % in a1. Second, on a beam the chairs
//! near the heel stick until the rail has bent. Their friction builds up over the first centimetres of toe travel,
//! which no constant coefficient describes. So friction of +25 % there is estimated as +30 % in a1 and +4 to +5 % in b0
//! and a0. With lumped rails the estimates are +24.5 % in a1, -0.4 % in b0 and 0 % in a0.

use serde::{Deserialize, Serialize};

use super::machine::{Loads, Parameters};
use crate::throw::OutOfRange;

/// The part that a fault changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, strum::EnumString)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Part {
    /// Magnets of the motor: torque constant and back-EMF constant, which are equal in SI units. A weaker motor needs
    /// more current and runs faster.
    Kt,
    /// Dry friction on the slide chairs (mu). A decrease scales every friction of the machine.
    Friction,
    /// Restoring stiffness of the drive on the screw angle (`K_bs`).
    Stiffness,
    /// Bending stiffness of the rails.
    RailStiffness,
    /// Inertia on the motor shaft (`J_L`).
    Inertia,
}

impl Part {
    /// The cause that the monitor should name, as in messages: "kt", "friction", "stiffness" or "inertia".
    pub const fn cause(self) -> &'static str {
        match self {
            Self::Kt => "kt",
            Self::Friction => "friction",
            Self::Stiffness | Self::RailStiffness => "stiffness",
            Self::Inertia => "inertia",
        }
    }
}

/// Development of a fault over the throws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    /// Full size from the first throw on.
    Step,
    /// Linear growth to the full size, then constant.
    Ramp {
        /// Number of throws until the full size.
        throws: u64,
    },
    /// A random walk without a preferred direction.
    RandomWalk {
        /// Number of throws after which its standard deviation is the full size.
        throws: u64,
    },
}

/// A fault of one part, from one throw on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// The part.
    pub part: Part,
    /// How the size of the fault develops over the throws.
    pub shape: Shape,
    /// Full size, as a change of the coefficient \[%\]; negative for a loss.
    pub size_pct: f64,
    /// The first throw with the fault, counted from 0 over both directions.
    pub from_throw: u64,
}

impl Fault {
    /// Size at a throw \[%\]. `walk` is the sum of standard normal steps up to this throw, and is for a random walk
    /// only.
    pub fn size_at(&self, throw_index: u64, walk: f64) -> f64 {
        let Some(since) = throw_index.checked_sub(self.from_throw) else { return 0.0 };
        match self.shape {
            Shape::Step => self.size_pct,
            Shape::Ramp { throws } => self.size_pct * ((since + 1) as f64 / throws.max(1) as f64).min(1.0),
            Shape::RandomWalk { throws } => (self.size_pct * walk / (throws.max(1) as f64).sqrt()).max(-90.0),
        }
    }
}

/// Condition of the parts, for each [`Part`] as ratio of its coefficient to that of a new machine; 1 means unchanged. By
/// the inertia all three coefficients are divided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Condition([f64; 5]);

impl Default for Condition {
    fn default() -> Self {
        Self([1.0; 5])
    }
}

impl Condition {
    /// Changes `part` by `size_pct` \[%\], beside its changes so far: by a fault, or as a healthy machine differs from
    /// others. A loss is limited to 95 %, as the simulation needs positive coefficients.
    pub fn change(&mut self, part: Part, size_pct: f64) {
        self.0[part as usize] *= (1.0 + size_pct / 100.0).max(0.05);
    }
}

impl Parameters {
    /// The parameters of this machine with its parts in this condition. Additional friction is dry friction on the
    /// chairs, which counts in a1 as in [`Parameters::coefficients`].
    ///
    /// # Errors
    /// When a parameter is out of its range.
    pub fn in_condition(&self, condition: &Condition) -> Result<Self, OutOfRange> {
        self.check()?;
        let Condition([kt, friction, stiffness, rail_stiffness, inertia]) = *condition;
        let loads = self.loads();
        let mut worn = self.clone();
        worn.add_friction(friction, &loads);
        worn.torque_constant *= kt;
        worn.back_emf_constant *= kt;
        let n2 = self.gear_ratio.powi(2);
        worn.load_inertia_kg_m2 += (inertia - 1.0) * loads.inertia / n2;
        // A loss larger than the inertia of the couplings reduces the rotor's inertia.
        if worn.load_inertia_kg_m2 < 0.0 {
            worn.rotor_inertia_kg_m2 += worn.load_inertia_kg_m2;
            worn.load_inertia_kg_m2 = 0.0;
        }
        worn.screw_stiffness_nm += (stiffness - 1.0) * loads.stiffness;
        let rails = loads.stiffness - self.screw_stiffness_nm;
        worn.rails.bending_stiffness_n_m2 *= 1.0 + (rail_stiffness - 1.0) * loads.stiffness / rails;
        worn.check()?;
        Ok(worn)
    }

    /// Changes the friction of a machine with these loads so that its a1 is multiplied by `ratio`.
    fn add_friction(&mut self, ratio: f64, loads: &Loads) {
        if ratio < 1.0 {
            self.scale_friction(ratio);
        } else if ratio > 1.0 {
            let chairs = loads.chair_dry_per_mu * self.rails.slide_friction;
            let speed = self.running_speed(loads.viscous, loads.drive_dry + chairs);
            let drag = ratio * (loads.viscous + (loads.drive_dry + chairs) / speed);
            // More friction slows the machine, and at a lower speed the same dry torque counts as more a1. So the
            // torque is computed at the lower speed.
            let slower = self.running_speed(drag, 0.0);
            let dry = (drag - loads.viscous) * slower;
            self.rails.slide_friction = (dry - loads.drive_dry) / loads.chair_dry_per_mu;
        }
    }

    /// Scales every friction of the machine, viscous and dry.
    pub(super) fn scale_friction(&mut self, ratio: f64) {
        self.motor_viscous_nms *= ratio;
        self.screw_viscous_nms *= ratio;
        self.motor_dry_nm *= ratio;
        self.screw_dry_nm *= ratio;
        self.rails.slide_friction *= ratio;
    }
}
