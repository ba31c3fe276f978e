//! A constant load torque: its effect on the three coefficients, and the load as a fourth coefficient.

use super::finding::{Finding, Row};
use super::trial::{Bench, Trial, fit, without_dry_friction};
use crate::estimate::Hold;
use crate::simulate::{Conditions, Parameters, Sensors};
use crate::throw::{Direction, OutOfRange};

/// Loads against the movement, simulated as dry friction of the screw \[N m\].
const LOADS_NM: [f64; 5] = [0.0, 0.2, 0.5, 1.0, 2.0];
/// Load for the fourth coefficient \[N m\].
const TRIED_NM: f64 = 0.5;

/// Effect of a constant load on the three coefficients.
pub(super) fn torque(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let known = without_dry_friction().coefficients()?;
    let reference = Some(known.values());
    let mut rows = Vec::new();
    for screw_dry_nm in LOADS_NM {
        let machine = Parameters { screw_dry_nm, ..without_dry_friction() };
        let speed = machine.coefficients()?.running_speed_rad_s;
        let as_friction_pct = screw_dry_nm / speed / known.inertia_kg_m2 / known.a1 * 100.0;
        let label = format!("{screw_dry_nm}, {as_friction_pct:+.1} %");
        rows.push(bench.row(label, &Trial { machine, reference, ..Trial::default() })?);
    }
    Ok(Finding {
        name: "load",
        title: "A constant load torque looks like friction",
        about: "Change of the estimates from those without load, without noise; the larger of both directions.",
        label: "load [N m on the screw], in a1 at running speed",
        rows,
    })
}

/// Estimates with three coefficients, and with the load as a fourth one, on the same throws.
pub(super) fn fourth_coefficient(bench: &mut Bench, throws: usize) -> Result<Finding, OutOfRange> {
    let machine = Parameters { screw_dry_nm: TRIED_NM, ..without_dry_friction() };
    let known = machine.coefficients()?;
    let sensors = Sensors { before_s: 0.0, ..Sensors::default() };
    let motion = machine.simulate(Direction::NormalToReverse, &Conditions::default(), sensors.step_s())?;
    let radians_per_mm = std::f64::consts::TAU / machine.lead_mm;
    let empty = |label| Row::new(label, throws);
    let (mut three, mut four) = (empty("b0, a1, a0"), empty("b0, a1, a0 and the load"));
    for _ in 0..throws {
        let trace = sensors.record(&motion, Direction::NormalToReverse, &mut bench.rng)?.trace;
        let end = trace.position_mm().iter().position(|mm| *mm > 0.95 * machine.stroke_mm).unwrap_or(trace.len());
        let output: Vec<f64> = trace.position_mm()[..end].iter().map(|mm| mm * radians_per_mm).collect();
        let input = (&trace.current_a()[..end], Hold::First);
        let ones = vec![1.0; end];
        let variances = [sensors.current.noise.powi(2), (sensors.position.noise * radians_per_mm).powi(2)];
        let interval_s = trace.sample_rate_hz().recip();
        fit::<1, 3>(&mut three, [input], interval_s, &output, variances, known.values());
        let viscous = [known.b0, known.a1_viscous, known.a0];
        fit::<2, 4>(&mut four, [input, (&ones, Hold::Zero)], interval_s, &output, variances, viscous);
    }
    Ok(Finding {
        name: "fourth_coefficient",
        title: "The load as a fourth coefficient",
        about: "The same throws under a load of 0.5 N m with 20 mA and 20 um of noise, with exactly known start: mean error \
                ± observed standard deviation (stated standard deviation).",
        label: "estimated",
        rows: vec![three, four],
    })
}
