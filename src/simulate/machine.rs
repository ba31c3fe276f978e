//! Physical parameters of one point machine, and the coefficients that follow from them.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::rails::Rails;
use super::supply::Waveform;
use crate::throw::{
    OutOfRange,
    Range::{Above, AtLeast, Finite, If, Within},
    settings,
};

/// Torque law of the motor: permanent magnet or series wound.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotorKind {
    /// Torque KT I, back-EMF KV w (equations (1) and (2)).
    #[default]
    PermanentMagnet,
    /// Field and armature in series: torque k I |I|, back-EMF k I w.
    Series,
}

settings! {
    /// Parameters of a point machine: motor, gearbox, ball screw, toe drive and switch rails. Values of rotating parts
    /// refer to their own shaft.
    ///
    /// The default is a plausible machine: 4.3 s a throw, 13 A of inrush, about 1 A running.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct Parameters {
        /// Kind of motor.
        pub motor: MotorKind = MotorKind::PermanentMagnet;
        /// Mean supply voltage \[V\].
        pub supply_v: f64 = 110.0, Above(0.0);
        /// Shape of the supply voltage over time.
        pub supply: Waveform = Waveform::Constant;
        /// Share of the ripple of a rectified supply that is left after smoothing; 1 without smoothing. With 0.17 the
        /// current of the default machine ripples by ±1 A, as recorded on a real machine. Without smoothing it would
        /// ripple by ±6 A.
        pub rectifier_ripple: f64 = 0.17, Within(0.0, 1.0, "");
        /// Armature resistance R at 20 °C, with the leads \[ohm\].
        pub resistance_ohm: f64 = 4.0, Above(0.0);
        /// Armature inductance L \[H\].
        pub inductance_h: f64 = 0.02, Above(0.0);
        /// Torque constant KT \[N m/A\]; of a series motor k \[N m/A²\].
        pub torque_constant: f64 = 0.7983, Above(0.0);
        /// Back-EMF constant KV \[V s/rad\]; of a series motor k \[V s/(rad A)\].
        pub back_emf_constant: f64 = 0.7983, Above(0.0);
        /// Rotor inertia `J_M` \[kg m²\].
        pub rotor_inertia_kg_m2: f64 = 4e-4, Above(0.0);
        /// Inertia of coupling and gears `J_L`, on the motor shaft \[kg m²\].
        pub load_inertia_kg_m2: f64 = 0.8e-4, AtLeast(0.0);
        /// Viscous friction of the motor `B_M` \[N m s\].
        pub motor_viscous_nms: f64 = 2e-3, AtLeast(0.0);
        /// Dry friction of the motor \[N m\].
        pub motor_dry_nm: f64 = 0.05, AtLeast(0.0);
        /// Dry friction that the holding brake adds while the motor is off \[N m on the motor shaft\].
        pub brake_nm: f64 = 6.0, AtLeast(0.0);
        /// Gear ratio n, motor turns per screw turn.
        pub gear_ratio: f64 = 8.0, Above(0.0);
        /// Torsional stiffness of the gearhead `K_gh` \[N m/rad on the screw\].
        pub gear_stiffness_nm: f64 = 4000.0, Above(0.0);
        /// Torsional damping of the gearhead `C_gh` \[N m s on the screw\].
        pub gear_damping_nms: f64 = 2.0, AtLeast(0.0);
        /// Inertia of the ball screw `J_bs` \[kg m²\].
        pub screw_inertia_kg_m2: f64 = 2e-4, Above(0.0);
        /// Viscous friction of the ball screw `B_bs` \[N m s\].
        pub screw_viscous_nms: f64 = 0.02, AtLeast(0.0);
        /// Restoring stiffness on the screw angle `K_bs` \[N m/rad\].
        pub screw_stiffness_nm: f64 = 1e-4, Finite;
        /// Dry friction of the ball screw \[N m\].
        pub screw_dry_nm: f64 = 0.2, AtLeast(0.0);
        /// Lead of the ball screw l \[mm per revolution\].
        pub lead_mm: f64 = 10.0, Above(0.0);
        /// Stiffness of the drive between nut and toe `K_fs` \[N/m\].
        pub drive_stiffness_n_m: f64 = 1e8, Above(0.0);
        /// Damping of the drive between nut and toe `C_fs` \[N s/m\].
        pub drive_damping_ns_m: f64 = 1e5, AtLeast(0.0);
        /// Force at which the friction clutch in the toe drive slips \[N\]. Clutches of point machines are set to 4 to
        /// 10 kN. A throw of the default machine needs 2.4 kN, or 3.0 kN with a slide-chair friction of 0.3 at -40 °C.
        pub clutch_n: f64 = 8000.0, Above(0.0);
        /// Travel of the toe between the stock rails \[mm\].
        pub stroke_mm: f64 = 115.0, Above(0.0);
        /// Toe position at which rails and screw spring are unstressed \[mm from normal\].
        pub neutral_mm: f64 = 0.0, Finite;
        /// Distance before the end of the stroke at which the motor is cut off \[mm\].
        pub cut_off_mm: f64 = 0.5, Above(0.0);
        /// Longest time for which the controller leaves the motor on \[s\], above 0 and at most 40.
        pub timeout_s: f64 = 12.0;
        /// The switch rails.
        pub rails: Rails = Rails::default();
        /// Ratio of break-away friction to sliding friction (Stribeck); 1 for no excess.
        pub breakaway_ratio: f64 = 1.0, AtLeast(1.0);
        /// Toe speed at which the excess of break-away over sliding friction has fallen to 1/e \[m/s\].
        pub stribeck_speed_m_s: f64 = 1e-3, Above(0.0);
        /// Change of KT and KV with temperature \[%/K\].
        pub magnet_pct_per_k: f64 = -0.15, Finite;
        /// Change of viscous friction with temperature \[%/K\].
        pub viscous_pct_per_k: f64 = -1.0, Finite;
        /// Change of the rails' stiffness with temperature \[%/K\]: thermal thrust softens them.
        pub rail_pct_per_k: f64 = -0.1, Finite;
    }
}

/// Coefficients by equation (13), with all inertia referred to the screw: the true values with which estimates are
/// compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Coefficients {
    /// KT n / `J_tot` \[rad s⁻² A⁻¹\]; of a series motor k n / `J_tot` \[rad s⁻² A⁻²\].
    pub b0: f64,
    /// (viscous friction + dry friction / running speed) / `J_tot` \[s⁻¹\].
    pub a1: f64,
    /// Restoring stiffness / `J_tot` \[s⁻²\].
    pub a0: f64,
    /// The part of `a1` from viscous friction alone \[s⁻¹\].
    pub a1_viscous: f64,
    /// Total inertia `J_tot`, referred to the screw \[kg m²\].
    pub inertia_kg_m2: f64,
    /// Screw speed at which the motor's torque balances friction \[rad/s\]. Springs are left out: their effects in the
    /// two directions cancel.
    pub running_speed_rad_s: f64,
}

impl Coefficients {
    /// (b0, a1, a0).
    pub fn values(&self) -> [f64; 3] {
        [self.b0, self.a1, self.a0]
    }
}

/// Inertia, friction and stiffness of all parts, referred to the screw.
#[derive(Debug, Clone, Copy)]
pub(super) struct Loads {
    /// Inertia `J_tot` \[kg m²\].
    pub inertia: f64,
    /// Viscous friction \[N m s\].
    pub viscous: f64,
    /// Restoring stiffness \[N m/rad\].
    pub stiffness: f64,
    /// Dry friction of motor and screw \[N m\].
    pub drive_dry: f64,
    /// Dry friction at the chairs for a friction coefficient of 1 \[N m\].
    pub chair_dry_per_mu: f64,
}

impl Parameters {
    /// Toe travel for a screw angle of 1 rad \[m/rad\].
    pub(super) fn metres_per_radian(&self) -> f64 {
        self.lead_mm / 1000.0 / TAU
    }

    pub(super) fn loads(&self) -> Loads {
        let n2 = self.gear_ratio.powi(2);
        let p = self.metres_per_radian();
        let toe = self.rails.modes().quasi_static(self.rails.damping_ratio);
        Loads {
            inertia: (self.rotor_inertia_kg_m2 + self.load_inertia_kg_m2) * n2
                + self.screw_inertia_kg_m2
                + toe.mass_kg * p * p,
            viscous: self.motor_viscous_nms * n2 + self.screw_viscous_nms + toe.damping_ns_m * p * p,
            stiffness: self.screw_stiffness_nm + toe.stiffness_n_m * p * p,
            drive_dry: self.gear_ratio * self.motor_dry_nm + self.screw_dry_nm,
            chair_dry_per_mu: toe.normal_n * p,
        }
    }

    /// Speed of the screw in steady state \[rad/s\], with this viscous friction \[N m s\] and this constant load \[N
    /// m\].
    pub(super) fn running_speed(&self, viscous: f64, constant: f64) -> f64 {
        let (kt, kv) = (self.torque_constant * self.gear_ratio, self.back_emf_constant * self.gear_ratio);
        let r = self.resistance_ohm;
        match self.motor {
            MotorKind::PermanentMagnet => (kt * self.supply_v / r - constant) / (viscous + kt * kv / r),
            MotorKind::Series => {
                // The torque k n I², with I = V / (R + k n w), falls with the speed w and the load rises: bisection.
                let surplus = |w: f64| kt * (self.supply_v / (r + kv * w)).powi(2) - viscous * w - constant;
                let (mut low, mut high) = (0.0, 1e4);
                for _ in 0..80 {
                    let mid = 0.5 * (low + high);
                    if surplus(mid) > 0.0 { low = mid } else { high = mid }
                }
                0.5 * (low + high)
            }
        }
    }

    /// The coefficients that follow from these parameters at 20 °C.
    ///
    /// Rails count with the mass, damping and stiffness of their bending line in slow movement. Equation (10) has no
    /// dry friction. Dry friction counts as the viscous friction with the same torque at running speed, as in an
    /// estimate from one throw.
    ///
    /// # Errors
    /// When a parameter is out of its range.
    pub fn coefficients(&self) -> Result<Coefficients, OutOfRange> {
        self.check()?;
        let loads = self.loads();
        let dry = loads.drive_dry + loads.chair_dry_per_mu * self.rails.slide_friction;
        let speed = self.running_speed(loads.viscous, dry);
        let a1_viscous = loads.viscous / loads.inertia;
        Ok(Coefficients {
            b0: self.torque_constant * self.gear_ratio / loads.inertia,
            a1: a1_viscous + dry / speed / loads.inertia,
            a0: loads.stiffness / loads.inertia,
            a1_viscous,
            inertia_kg_m2: loads.inertia,
            running_speed_rad_s: speed,
        })
    }

    /// Checks that every parameter is finite and in its range.
    ///
    /// # Errors
    /// The first parameter out of its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        self.check_ranges()?;
        let is_short = self.timeout_s > 0.0 && self.timeout_s <= 40.0;
        If(is_short, "above 0 and at most 40").check("timeout_s", self.timeout_s)?;
        If(self.cut_off_mm < self.stroke_mm, "less than the stroke").check("cut_off_mm", self.cut_off_mm)?;
        self.supply.check().map_err(|error| error.within("supply.rectified_mains"))?;
        self.rails.check_ranges().map_err(|error| error.within("rails"))
    }

    /// These parameters, which hold at 20 °C, at `temperature_c`: torque and back-EMF constants, copper resistance,
    /// viscous friction, and stiffness of the rails.
    #[must_use]
    pub fn at_temperature(&self, temperature_c: f64) -> Self {
        /// Change of the resistance of copper with temperature \[%/K\].
        const COPPER_PCT_PER_K: f64 = 0.39;
        let kelvin = temperature_c - 20.0;
        let linear = |pct: f64| (1.0 + pct / 100.0 * kelvin).max(0.05);
        let magnet = if self.motor == MotorKind::PermanentMagnet { linear(self.magnet_pct_per_k) } else { 1.0 };
        // Viscosity falls by a constant share per kelvin, which is exponential over a large difference.
        let viscous = (self.viscous_pct_per_k / 100.0 * kelvin).exp();
        let mut warm = self.clone();
        warm.torque_constant *= magnet;
        warm.back_emf_constant *= magnet;
        warm.resistance_ohm *= linear(COPPER_PCT_PER_K);
        warm.motor_viscous_nms *= viscous;
        warm.screw_viscous_nms *= viscous;
        warm.rails.bending_stiffness_n_m2 *= linear(self.rail_pct_per_k);
        warm
    }

    /// A machine with a series-wound motor that throws in about 4 s.
    pub fn series() -> Self {
        Self {
            motor: MotorKind::Series,
            torque_constant: 0.1,
            back_emf_constant: 0.1,
            gear_ratio: 20.0,
            motor_viscous_nms: 8e-4,
            ..Self::default()
        }
    }
}
