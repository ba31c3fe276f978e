//! The scenario of a row of the table: fault, its shape, and conditions.

use nalgebra::Vector3;
use serde::Serialize;

use crate::diagnose::Cause;

/// Depth of the simulation of a life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, strum::AsRefStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Depth {
    /// Coefficients from a calibrated scatter.
    Parameter,
    /// Complete simulated throws with the estimator.
    Trace,
}

/// Growth of a fault from its first throw on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, strum::AsRefStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Growth {
    /// Full size from the first throw on.
    Step,
    /// Linear growth over 100 throws of the machine.
    Ramp,
    /// Growth with the square of the throws, over 200 throws.
    Accelerating,
    /// Linear growth by 0.25 % of nominal a throw, over 240 throws.
    Wear,
    /// Full size in every fifth throw, none in the others.
    EveryFifth,
    /// Full size in every tenth throw, all of one direction; none in the others.
    EveryTenth,
}

impl Growth {
    /// Throws of a machine, in both directions, until a fault is complete. An intermittent fault is complete at once;
    /// it is followed for this number of throws, so that even one in ten throws is a usable sample.
    pub(super) fn throws(self) -> usize {
        match self {
            Self::Step => 0,
            Self::Ramp => 100,
            Self::Accelerating | Self::EveryFifth | Self::EveryTenth => 200,
            Self::Wear => 240,
        }
    }

    /// Size at a throw of the fault, as a fraction of its full size; `throw` counts from 1.
    pub(super) fn part_at(self, throw: usize) -> f64 {
        let grown = || (throw as f64 / self.throws() as f64).min(1.0);
        let every = |period: usize| if throw % period == 1 { 1.0 } else { 0.0 };
        match self {
            Self::Step => 1.0,
            Self::Ramp | Self::Wear => grown(),
            Self::Accelerating => grown().powi(2),
            Self::EveryFifth => every(5),
            Self::EveryTenth => every(10),
        }
    }
}

/// Noise of the current sensor; the position sensor always has 20 µm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, strum::AsRefStr)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Noise {
    /// 0.005 A.
    Low,
    /// 0.02 A.
    Default,
    /// 0.05 A.
    High,
}

/// The conditions of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Situation {
    /// Nothing unusual.
    Plain,
    /// Two faults that begin together.
    Pair,
    /// A temperature swing of 12 K over days, plus 3 K over a day.
    Temperature {
        /// Whether the throws publish the temperature.
        measured: bool,
    },
    /// The fault begins after 15 throws in each direction.
    ShortBaseline,
    /// The fault exists from the first throw, so the baseline learns it.
    FromFirstThrow,
    /// A first fault is repaired without a new baseline; then another part fails.
    Repaired,
    /// A baseline in winter, and a fault in summer. The throws publish the temperature.
    Season,
    /// A fault that grows from the first throw on.
    Wear,
    /// The fault begins while an earlier fault of another part still exists.
    OnTop,
    /// Dry friction that also changes b0 and a0, at parameter depth.
    Leakage,
    /// A toe drive of 5e6 N/m and dry friction, at trace depth.
    SoftToe,
    /// Sampling at 100 Hz with an anti-alias filter, at trace depth.
    Slow,
    /// A faulty sensor, clock or supply, at trace depth.
    Instrument {
        /// The faulty instrument.
        which: Instrument,
        /// Whether the throws publish the supply voltage.
        volts: bool,
    },
}

/// An instrument, or the supply, that is faulty instead of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Instrument {
    /// Gain of the current sensor.
    Current,
    /// Gain of the position sensor.
    Position,
    /// Rate of the logger's clock.
    Clock,
    /// The supply voltage, not its sensor.
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
            Self::Season => "baseline in winter, fault in summer",
            Self::Wear => "wear from the first throw",
            Self::OnTop => "second fault, the first still exists",
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

/// The scenario of a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scenario {
    pub(super) depth: Depth,
    pub(super) situation: Situation,
    /// The faulty parts, each with its size as a fraction of nominal; two for a pair.
    pub(super) faults: Vec<(Cause, f64)>,
    /// Part and size of a fault that begins earlier and still exists.
    pub(super) earlier: Option<(Cause, f64)>,
    pub(super) shape: Growth,
    pub(super) noise: Noise,
    pub(super) hard: bool,
}

/// Warning limits as fractions, in the order of [`Cause::PHYSICAL`].
pub(super) type Limits = [f64; 4];

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
