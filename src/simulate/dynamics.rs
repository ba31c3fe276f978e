//! Motor, gearbox, ball screw, toe drive and rails as one linear system, discretised exactly.
//!
//! All quantities are referred to the screw: psi is the motor angle divided by the gear ratio n, theta the screw angle,
//! `q_k` the coordinates of the modes of the rails, with frequency `w_k` and damping ratio zeta. Angles and toe
//! position x are 0 at the neutral position. p is the toe travel for a screw angle of 1 rad.
//!
//! ```text
//! (J_M + J_L) n² psi'' = n T_motor - B_M n² psi' - T_gh            (3)
//! T_gh = K_gh (psi - theta) + C_gh (psi' - theta')
//! J_bs theta'' = T_gh - B_bs theta' - K_bs theta - p F             (6)
//! F = K_fs (p theta - x - s) + C_fs (p theta' - x')                (8)
//! q_k'' = -2 zeta w_k q_k' - w_k² q_k + f_k(toe) F + chairs and stops
//! ```
//!
//! with the gearhead's torque opposing the motor, the slip s of the clutch, and x as the sum of the modes at the toe.
//!
//! With the state z and the torques and forces f this is z' = A z + B f. A is constant as long as no contact changes,
//! so a step of h with constant f is exact: z(t + h) = e^(A h) z(t) + G f. Both matrices come from the matrix
//! exponential of the augmented system.

use nalgebra::DMatrix;

use super::machine::Parameters;
use super::rails::{MAX_MODES, Modes};

/// Length of the state vector: psi, psi', theta, theta', then `MAX_MODES` values of q and as many of q'. Unused modes
/// stay 0.
pub(super) const STATES: usize = 4 + 2 * MAX_MODES;
/// Index of theta in the state.
pub(super) const SCREW: usize = 2;
/// Index of psi' in the state.
pub(super) const MOTOR_SPEED: usize = 1;
/// Index of theta' in the state.
pub(super) const SCREW_SPEED: usize = 3;
/// Index of the first q in the state.
const MODE: usize = 4;
/// Index of the first q' in the state.
const MODE_SPEED: usize = 4 + MAX_MODES;

/// A state, or the change of the state by a constant force over one step.
pub(super) type State = [f64; STATES];

/// Stiffness \[N/m\] and damping \[N s/m\] of the stock rail, or an obstacle, where it stops the toe.
const STOP_STIFFNESS_N_M: f64 = 2e7;
const STOP_DAMPING_NS_M: f64 = 1e5;

/// The connections that hold during a step; each combination has its own matrix A.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Phase {
    /// The toe touches a stop: A includes the stop's spring and damper.
    pub at_stop: bool,
    /// The clutch slips: the toe drive has a constant force, and A excludes its spring and damper.
    pub slipping: bool,
}

/// Exact step of the linear system.
#[derive(Debug, Clone)]
pub(super) struct Step {
    /// Columns of e^(A h).
    transition: [State; STATES],
    /// Effect on the state of 1 N m at the motor, referred to the screw.
    pub motor: State,
    /// Effect of 1 N m at the screw.
    pub screw: State,
    /// Effect of 1 N on the toe.
    pub toe: State,
    /// Effect of 1 N in the toe drive: on the toe, and against the screw.
    pub drive: State,
    /// Effect of a unit force on each mode.
    pub modal: [State; MAX_MODES],
}

impl Step {
    /// The step of `h` seconds in this phase.
    pub(super) fn new(parameters: &Parameters, modes: &Modes, h: f64, phase: Phase) -> Self {
        let n = modes.count;
        let active: Vec<usize> = (0..4).chain((0..n).map(|k| MODE + k)).chain((0..n).map(|k| MODE_SPEED + k)).collect();
        let (a, b) = continuous(parameters, modes, phase);
        let inputs = 2 + n;
        let size = active.len() + inputs;
        let mut augmented = DMatrix::zeros(size, size);
        for (row, &i) in active.iter().enumerate() {
            for (column, &j) in active.iter().enumerate() {
                augmented[(row, column)] = a[i][j] * h;
            }
            for input in 0..inputs {
                augmented[(row, active.len() + input)] = b[i][input] * h;
            }
        }
        let exponential = augmented.exp();
        let column = |at: usize| {
            let mut full = [0.0; STATES];
            for (row, &i) in active.iter().enumerate() {
                full[i] = exponential[(row, at)];
            }
            full
        };
        let mut transition = [[0.0; STATES]; STATES];
        for (at, &j) in active.iter().enumerate() {
            transition[j] = column(at);
        }
        let first = active.len();
        let modal = std::array::from_fn(|k| if k < n { column(first + 2 + k) } else { [0.0; STATES] });
        let screw = column(first + 1);
        let toe = shaped(&modal, &modes.toe);
        let mut drive = toe;
        add_scaled(&mut drive, &screw, -parameters.metres_per_radian());
        Self { transition, motor: column(first), screw, toe, drive, modal }
    }

    /// The state after a step without torques and forces, e^(A h) z.
    #[inline]
    pub(super) fn advance(&self, state: &State) -> State {
        let mut next = [0.0; STATES];
        for (column, value) in self.transition.iter().zip(state) {
            add_scaled(&mut next, column, *value);
        }
        next
    }
}

/// Effect of 1 N on the rails at a place where the modes have these deflections; `modal` is that of [`Step`].
pub(super) fn shaped(modal: &[State; MAX_MODES], shape: &[f64; MAX_MODES]) -> State {
    let mut effect = [0.0; STATES];
    for (column, weight) in modal.iter().zip(shape) {
        add_scaled(&mut effect, column, *weight);
    }
    effect
}

#[inline]
pub(super) fn add_scaled(target: &mut State, source: &State, factor: f64) {
    for (to, from) in target.iter_mut().zip(source) {
        *to += factor * from;
    }
}

type Inputs = [f64; 2 + MAX_MODES];

/// A and B of the system. Its inputs are the torque at psi, the torque at theta, and a force on each mode.
fn continuous(parameters: &Parameters, modes: &Modes, phase: Phase) -> ([State; STATES], [Inputs; STATES]) {
    let n2 = parameters.gear_ratio.powi(2);
    let motor_inertia = (parameters.rotor_inertia_kg_m2 + parameters.load_inertia_kg_m2) * n2;
    let screw_inertia = parameters.screw_inertia_kg_m2;
    let p = parameters.metres_per_radian();
    let (k_gh, c_gh) = (parameters.gear_stiffness_nm, parameters.gear_damping_nms);
    let (k_fs, c_fs) =
        if phase.slipping { (0.0, 0.0) } else { (parameters.drive_stiffness_n_m, parameters.drive_damping_ns_m) };
    let (k_stop, c_stop) = if phase.at_stop { (STOP_STIFFNESS_N_M, STOP_DAMPING_NS_M) } else { (0.0, 0.0) };

    let mut a = [[0.0; STATES]; STATES];
    let mut b = [[0.0; 2 + MAX_MODES]; STATES];
    a[0][1] = 1.0;
    a[1][0] = -k_gh / motor_inertia;
    a[1][1] = -(c_gh + parameters.motor_viscous_nms * n2) / motor_inertia;
    a[1][2] = k_gh / motor_inertia;
    a[1][3] = c_gh / motor_inertia;
    a[2][3] = 1.0;
    a[3][0] = k_gh / screw_inertia;
    a[3][1] = c_gh / screw_inertia;
    a[3][2] = -(k_gh + parameters.screw_stiffness_nm + k_fs * p * p) / screw_inertia;
    a[3][3] = -(c_gh + parameters.screw_viscous_nms + c_fs * p * p) / screw_inertia;
    b[1][0] = motor_inertia.recip();
    b[3][1] = screw_inertia.recip();
    for k in 0..modes.count {
        let (row, toe) = (MODE_SPEED + k, modes.toe[k]);
        a[3][MODE + k] = p * k_fs * toe / screw_inertia;
        a[3][MODE_SPEED + k] = p * c_fs * toe / screw_inertia;
        a[MODE + k][row] = 1.0;
        a[row][2] = toe * k_fs * p;
        a[row][3] = toe * c_fs * p;
        for j in 0..modes.count {
            a[row][MODE + j] = -toe * (k_fs + k_stop) * modes.toe[j];
            a[row][MODE_SPEED + j] = -toe * (c_fs + c_stop) * modes.toe[j];
        }
        a[row][MODE + k] -= modes.stiffness[k];
        a[row][row] -= 2.0 * parameters.rails.damping_ratio * modes.stiffness[k].sqrt();
        b[row][2 + k] = 1.0;
    }
    (a, b)
}

/// Position of the toe or of a chair \[m from neutral\]; `shape` is the deflection of each mode there.
#[inline]
pub(super) fn position(shape: &[f64; MAX_MODES], state: &State) -> f64 {
    shape.iter().zip(&state[MODE..]).map(|(shape, q)| shape * q).sum()
}

/// Speed of the toe or of a chair \[m/s\]; `shape` is the deflection of each mode there.
#[inline]
pub(super) fn speed(shape: &[f64; MAX_MODES], state: &State) -> f64 {
    shape.iter().zip(&state[MODE_SPEED..]).map(|(shape, q)| shape * q).sum()
}

/// Force on the toe \[N\] of a stop at `stop_m` from neutral; `toe` is the deflection of each mode at the toe.
pub(super) fn stop_force(toe: &[f64; MAX_MODES], state: &State, stop_m: f64) -> f64 {
    STOP_STIFFNESS_N_M * (stop_m - position(toe, state)) - STOP_DAMPING_NS_M * speed(toe, state)
}

/// The constant part of the force of a stop at `stop_m` from neutral \[N\]. The part that depends on the state is in
/// the matrix A.
pub(super) fn stop_offset_force(stop_m: f64) -> f64 {
    STOP_STIFFNESS_N_M * stop_m
}

/// State of the machine at rest with the toe at `toe_m` from neutral, where the bent rails strain the drive.
pub(super) fn at_rest(parameters: &Parameters, modes: &Modes, toe_m: f64) -> State {
    let p = parameters.metres_per_radian();
    let force = toe_m / modes.toe_compliance();
    let theta = (toe_m + force / parameters.drive_stiffness_n_m) / p;
    let torque = p * force + parameters.screw_stiffness_nm * theta;
    let mut state = [0.0; STATES];
    state[0] = theta + torque / parameters.gear_stiffness_nm;
    state[2] = theta;
    state[MODE..MODE_SPEED].copy_from_slice(&modes.held_at(toe_m));
    state
}
