//! The rows of the table, in order.

use super::scenario::{Depth, Growth, Instrument, Limits, Noise, Scenario, Situation};
use crate::{diagnose::Cause, simulate::Parameters};

/// Sizes of the faults as multiples of the warning limit.
pub(super) const MULTIPLES: [f64; 4] = [1.5, 2.0, 3.0, 6.0];

/// Least multiple of the warning limit in a plain row: with a smaller fault, scatter hides the size.
const PLAIN_FROM: f64 = 2.0;

/// Size of the friction fault in the rows with leakage into b0 and a0, as a fraction of nominal.
const LEAKING_FRICTION: f64 = 0.54;
/// Friction coefficient of the slide chairs in the row with a soft toe drive.
const SOFT_TOE_MU: f64 = 0.15;

/// Rows with a faulty instrument: instrument, whether the voltage is published, correct cause, size as a fraction.
const INSTRUMENTS: [(Instrument, bool, Cause, f64); 6] = [
    (Instrument::Current, true, Cause::Sensor, 0.08),
    (Instrument::Current, false, Cause::Sensor, 0.08),
    (Instrument::Position, false, Cause::Sensor, 0.06),
    (Instrument::Clock, false, Cause::Sensor, 0.05),
    (Instrument::Supply, true, Cause::Supply, -0.35),
    (Instrument::Supply, false, Cause::SlowThrow, -0.35),
];

/// Rows with an intermittent fault: the part, the size in the throws with the fault as a fraction, and how often.
const INTERMITTENT: [(Cause, f64, Growth); 3] = [
    (Cause::Friction, 0.60, Growth::EveryFifth),
    (Cause::Kt, -0.15, Growth::EveryFifth),
    (Cause::Friction, 1.00, Growth::EveryTenth),
];

/// Friction at the end of the row with wear, as a fraction of nominal: 240 throws with 0.25 % each.
const WORN_FRICTION: f64 = 0.60;

/// All rows of the table, in order. The index of a row determines its random streams.
pub(super) fn catalogue(limits: Limits) -> Vec<Scenario> {
    let mut rows = parameter_rows(limits);
    rows.extend(trace_rows(limits));
    rows.extend(field_rows(limits));
    rows
}

/// A row with default noise; hard unless its situation is plain.
fn row(depth: Depth, situation: Situation, faults: Vec<(Cause, f64)>, shape: Growth) -> Scenario {
    let hard = situation != Situation::Plain;
    Scenario { depth, situation, faults, earlier: None, shape, noise: Noise::Default, hard }
}

fn parameter_rows(limits: Limits) -> Vec<Scenario> {
    let row = |situation, faults, shape| row(Depth::Parameter, situation, faults, shape);
    let parts = || Cause::PHYSICAL.into_iter().zip(limits);
    let mut rows = Vec::new();
    for (part, limit) in parts() {
        for shape in [Growth::Step, Growth::Ramp] {
            for multiple in MULTIPLES {
                let plain = row(Situation::Plain, vec![(part, multiple * limit)], shape);
                rows.push(Scenario { hard: multiple < PLAIN_FROM, ..plain });
            }
            for (noise, hard) in [(Noise::Low, false), (Noise::High, true)] {
                let plain = row(Situation::Plain, vec![(part, PLAIN_FROM * limit)], shape);
                rows.push(Scenario { noise, hard, ..plain });
            }
        }
    }
    for first in 0..Cause::PHYSICAL.len() {
        for second in first + 1..Cause::PHYSICAL.len() {
            for multiple in [2.0, 6.0] {
                let faults = [first, second].map(|part| (Cause::PHYSICAL[part], multiple * limits[part])).to_vec();
                rows.push(row(Situation::Pair, faults, Growth::Step));
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
            rows.push(row(situation, vec![(part, PLAIN_FROM * limit)], Growth::Step));
        }
    }
    for shape in [Growth::Step, Growth::Ramp] {
        rows.push(row(Situation::Leakage, vec![(Cause::Friction, LEAKING_FRICTION)], shape));
    }
    rows
}

fn trace_rows(limits: Limits) -> Vec<Scenario> {
    let row = |situation, fault, shape| row(Depth::Trace, situation, vec![fault], shape);
    let mut rows = Vec::new();
    for (part, limit) in Cause::PHYSICAL.into_iter().zip(limits) {
        for shape in [Growth::Step, Growth::Ramp] {
            rows.push(row(Situation::Plain, (part, PLAIN_FROM * limit), shape));
        }
    }
    for (part, limit) in Cause::PHYSICAL.into_iter().zip(limits) {
        rows.push(row(Situation::Slow, (part, PLAIN_FROM * limit), Growth::Step));
    }
    rows.push(row(Situation::SoftToe, (Cause::Friction, added_by_dry_chairs(SOFT_TOE_MU)), Growth::Step));
    for (which, volts, cause, size) in INSTRUMENTS {
        rows.push(row(Situation::Instrument { which, volts }, (cause, size), Growth::Step));
    }
    rows
}

/// Rows of faults that machines have in the field, at parameter depth. All are hard.
fn field_rows(limits: Limits) -> Vec<Scenario> {
    let row = |situation, fault, shape| Scenario { hard: true, ..row(Depth::Parameter, situation, vec![fault], shape) };
    let [kt, friction, stiffness, _] = limits.map(|limit| PLAIN_FROM * limit);
    let mut rows = Vec::new();
    for (situation, shape) in [(Situation::Season, Growth::Step), (Situation::Plain, Growth::Accelerating)] {
        for (part, limit) in Cause::PHYSICAL.into_iter().zip(limits) {
            rows.push(row(situation, (part, PLAIN_FROM * limit), shape));
        }
    }
    for (part, size, shape) in INTERMITTENT {
        rows.push(row(Situation::Plain, (part, size), shape));
    }
    rows.push(row(Situation::Wear, (Cause::Friction, WORN_FRICTION), Growth::Wear));
    for (first, second) in
        [((Cause::Friction, friction), (Cause::Kt, kt)), ((Cause::Kt, kt), (Cause::Stiffness, stiffness))]
    {
        rows.push(Scenario { earlier: Some(first), ..row(Situation::OnTop, second, Growth::Step) });
    }
    rows
}

/// Increase of a1 of the simulated machine by slide chairs with the friction coefficient `mu`, as a fraction of a1.
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
