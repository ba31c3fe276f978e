//! The rows of the table: fault, development and conditions.

use nalgebra::Vector3;
use serde::Serialize;

use crate::{diagnose::Cause, simulate::Parameters};

/// Depth of the simulation of a life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Depth {
    /// Coefficients from a calibrated scatter.
    Parameter,
    /// Complete simulated throws with the estimator.
    Trace,
}

/// Development of a fault from its first throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// Full size from the first throw on.
    Step,
    /// Linear growth over `RAMP_THROWS` throws of the machine.
    Ramp,
}

impl Depth {
    /// The word in tables and JSON.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Parameter => "parameter",
            Self::Trace => "trace",
        }
    }
}

impl Shape {
    /// The word in tables and JSON.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Step => "step",
            Self::Ramp => "ramp",
        }
    }
}

/// Noise of the current sensor; the position sensor always has 20 µm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Noise {
    /// 0.005 A.
    Low,
    /// 0.02 A.
    Default,
    /// 0.05 A.
    High,
}

impl Noise {
    /// The word in tables and JSON.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Low => "low",
            Self::Default => "default",
            Self::High => "high",
        }
    }
}

/// The conditions of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Situation {
    /// A complete baseline, steady weather.
    Plain,
    /// Two causes at once.
    Pair,
    /// Temperature with a swing of 12 K, plus 3 K over a day.
    Temperature {
        /// Whether the throws contain the temperature.
        measured: bool,
    },
    /// The fault begins after 15 throws in each direction.
    ShortBaseline,
    /// The fault exists from the first throw, so the baseline learns it.
    FromFirstThrow,
    /// A first fault is repaired without a new baseline; then another part fails.
    Repaired,
    /// Dry friction that also shifts all coefficients, at parameter depth.
    Leakage,
    /// A toe drive of 5e6 N/m and dry friction, at trace depth.
    SoftToe,
    /// Sampling at 100 Hz with an anti-alias filter, at trace depth.
    Slow,
    /// Complete throws with a fault of sensor, clock or supply, with or without a published supply voltage.
    Instrument {
        /// The faulty instrument.
        which: Instrument,
        /// Whether the throws contain the supply voltage.
        volts: bool,
    },
}

/// An instrument that is faulty instead of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Instrument {
    /// Gain of the current sensor.
    Current,
    /// Gain of the position sensor.
    Position,
    /// Rate of the logger's clock.
    Clock,
    /// The supply voltage.
    Supply,
}

impl Situation {
    /// Name in the table.
    pub(super) fn label(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Pair => "two causes at once",
            Self::Temperature { measured: true } => "temperature swings, measured",
            Self::Temperature { measured: false } => "temperature swings, not measured",
            Self::ShortBaseline => "short baseline",
            Self::FromFirstThrow => "fault from the first throw",
            Self::Repaired => "second fault after a repair, no rebaseline",
            Self::Leakage => "dry friction leaking into b0 and a0",
            Self::SoftToe => "soft toe drive, dry friction",
            Self::Slow => "100 Hz, anti-aliased",
            Self::Instrument { which, volts } => match (which, volts) {
                (Instrument::Current, true) => "current sensor's gain, supply_v published",
                (Instrument::Current, false) => "current sensor's gain",
                (Instrument::Position, _) => "position sensor's gain",
                (Instrument::Clock, _) => "logger's clock",
                (Instrument::Supply, true) => "weak supply, supply_v published",
                (Instrument::Supply, false) => "weak supply",
            },
        }
    }
}

/// Throws of a machine, in both directions, until a ramp has its full size.
pub(super) const RAMP_THROWS: usize = 100;

/// The four parts that drift, in the order of the table.
pub(super) const PARTS: [Cause; 4] = [Cause::Kt, Cause::Friction, Cause::Stiffness, Cause::Inertia];

/// Sizes of the faults as multiples of the warning limit.
pub(super) const MULTIPLES: [f64; 4] = [1.5, 2.0, 3.0, 6.0];

/// Least multiple of the warning limit in a plain row: with a smaller fault, scatter hides the size.
const PLAIN_FROM: f64 = 2.0;

/// Size of the friction fault in the rows with leakage.
const LEAKING_FRICTION: f64 = 0.54;
/// Friction coefficient of the slide chairs in the row with a soft toe drive.
const SOFT_TOE_MU: f64 = 0.15;

/// Faulty instrument, whether the supply voltage is published, correct cause, and size.
const INSTRUMENTS: [(Instrument, bool, Cause, f64); 6] = [
    (Instrument::Current, true, Cause::Sensor, 0.08),
    (Instrument::Current, false, Cause::Sensor, 0.08),
    (Instrument::Position, false, Cause::Sensor, 0.06),
    (Instrument::Clock, false, Cause::Sensor, 0.05),
    (Instrument::Supply, true, Cause::Supply, -0.35),
    (Instrument::Supply, false, Cause::SlowThrow, -0.35),
];

/// Scenario of a row of the table.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scenario {
    /// Depth of the simulation of its lives.
    pub(super) depth: Depth,
    /// The conditions.
    pub(super) situation: Situation,
    /// The faulty parts with the size as a fraction of nominal; two for a pair.
    pub(super) faults: Vec<(Cause, f64)>,
    /// Development of the fault.
    pub(super) shape: Shape,
    /// Noise of the current sensor.
    pub(super) noise: Noise,
    /// Whether the row is hard.
    pub(super) hard: bool,
}

/// Warning limits as fractions, in the order of [`PARTS`].
pub(super) type Limits = [f64; 4];

/// All rows of the table, in order. The position of a row determines its random streams.
pub(super) fn catalogue(limits: Limits) -> Vec<Scenario> {
    let mut rows = parameter_rows(limits);
    rows.extend(trace_rows(limits));
    rows
}

fn parameter_rows(limits: Limits) -> Vec<Scenario> {
    let row = |situation, faults, shape, noise, hard| Scenario {
        depth: Depth::Parameter,
        situation,
        faults,
        shape,
        noise,
        hard,
    };
    let parts = || PARTS.into_iter().zip(limits);
    let mut rows = Vec::new();
    for (part, limit) in parts() {
        for shape in [Shape::Step, Shape::Ramp] {
            for multiple in MULTIPLES {
                let faults = vec![(part, multiple * limit)];
                rows.push(row(Situation::Plain, faults, shape, Noise::Default, multiple < PLAIN_FROM));
            }
            for (noise, hard) in [(Noise::Low, false), (Noise::High, true)] {
                rows.push(row(Situation::Plain, vec![(part, PLAIN_FROM * limit)], shape, noise, hard));
            }
        }
    }
    for first in 0..PARTS.len() {
        for second in first + 1..PARTS.len() {
            for multiple in [2.0, 6.0] {
                let faults = [first, second].map(|part| (PARTS[part], multiple * limits[part])).to_vec();
                rows.push(row(Situation::Pair, faults, Shape::Step, Noise::Default, true));
            }
        }
    }
    let alone = [
        Situation::Temperature { measured: true },
        Situation::Temperature { measured: false },
        Situation::ShortBaseline,
        Situation::FromFirstThrow,
        Situation::Repaired,
    ];
    for situation in alone {
        for (part, limit) in parts() {
            rows.push(row(situation, vec![(part, PLAIN_FROM * limit)], Shape::Step, Noise::Default, true));
        }
    }
    for shape in [Shape::Step, Shape::Ramp] {
        rows.push(row(Situation::Leakage, vec![(Cause::Friction, LEAKING_FRICTION)], shape, Noise::Default, true));
    }
    rows
}

fn trace_rows(limits: Limits) -> Vec<Scenario> {
    let row = |situation, fault, shape| Scenario {
        depth: Depth::Trace,
        situation,
        faults: vec![fault],
        shape,
        noise: Noise::Default,
        hard: situation != Situation::Plain,
    };
    let mut rows = Vec::new();
    for (part, limit) in PARTS.into_iter().zip(limits) {
        for shape in [Shape::Step, Shape::Ramp] {
            rows.push(row(Situation::Plain, (part, PLAIN_FROM * limit), shape));
        }
    }
    for (part, limit) in PARTS.into_iter().zip(limits) {
        rows.push(row(Situation::Slow, (part, PLAIN_FROM * limit), Shape::Step));
    }
    rows.push(row(Situation::SoftToe, (Cause::Friction, added_by_dry_chairs(SOFT_TOE_MU)), Shape::Step));
    for (which, volts, cause, size) in INSTRUMENTS {
        rows.push(row(Situation::Instrument { which, volts }, (cause, size), Shape::Step));
    }
    rows
}

/// Increase of a1 of the simulated machine by the friction coefficient `mu` of the slide chairs, as a fraction.
#[expect(
    clippy::expect_used,
    reason = "the default machine is within its ranges, and so is every friction coefficient used here"
)]
fn added_by_dry_chairs(mu: f64) -> f64 {
    let a1 = |mu| {
        let mut machine = Parameters::default();
        machine.rails.slide_friction = mu;
        machine.coefficients().expect("a machine within its ranges").a1
    };
    a1(mu) / a1(Parameters::default().rails.slide_friction) - 1.0
}

/// The change of (ln b0, ln a1, ln a0) when `part` changes by the fraction `size`, from equation (13).
pub(super) fn displacement(part: Cause, size: f64) -> Vector3<f64> {
    let direction = match part {
        Cause::Kt => Vector3::x(),
        Cause::Friction => Vector3::y(),
        Cause::Stiffness => Vector3::z(),
        Cause::Inertia => Vector3::repeat(-1.0),
        _ => Vector3::zeros(),
    };
    direction * size.ln_1p()
}
