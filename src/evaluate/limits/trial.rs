//! A trial: a machine, its sensors, and the settings of the estimator.

use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;

use super::finding::Row;
use crate::estimate::{Grade, Identifier, Settings};
use crate::simulate::{Conditions, Parameters, Sensors};
use crate::throw::{Direction, OutOfRange, Throw};

/// The throws of one row of a table.
#[derive(Debug, Clone)]
pub(super) struct Trial {
    pub machine: Parameters,
    pub sensors: Sensors,
    pub temperature_c: f64,
    pub settings: Settings,
    /// Cut-off of the anti-alias filter that the throws declare \[Hz\]; `None`: no filter.
    pub declared_hz: Option<f64>,
    pub directions: Vec<Direction>,
    /// Number of phases of the mains at which the motor starts, evenly spread over half a period.
    pub phases: u32,
    pub repeats: usize,
    /// Coefficients from which the errors are counted; `None` for the true ones.
    pub reference: Option<[f64; 3]>,
}

impl Default for Trial {
    fn default() -> Self {
        Self {
            machine: without_dry_friction(),
            sensors: Sensors::perfect(1000.0),
            temperature_c: 20.0,
            settings: Settings::default(),
            declared_hz: None,
            directions: Direction::BOTH.to_vec(),
            phases: 1,
            repeats: 1,
            reference: None,
        }
    }
}

/// The default machine without dry friction. The model of the estimator has no dry friction either, so the true
/// coefficients of this machine are known exactly.
pub(super) fn without_dry_friction() -> Parameters {
    Parameters { motor_dry_nm: 0.0, screw_dry_nm: 0.0, ..Parameters::default() }
}

/// Runs trials, all with one random number generator.
pub(super) struct Bench {
    rng: ChaCha12Rng,
    identifier: Identifier,
}

impl Bench {
    pub(super) fn new(seed: u64) -> Self {
        Self { rng: ChaCha12Rng::seed_from_u64(seed), identifier: Identifier::default() }
    }

    /// The row with the throws of a trial; a rough estimate counts as rejected.
    pub(super) fn row(&mut self, label: impl Into<String>, trial: &Trial) -> Result<Row, OutOfRange> {
        let known = trial.machine.at_temperature(trial.temperature_c).coefficients()?;
        let reference = trial.reference.unwrap_or(known.values());
        let mut row = Row::new(label, 0);
        row.noisy = trial.sensors.current.noise > 0.0 || trial.repeats > 1;
        let cases = trial.directions.iter().flat_map(|way| (0..trial.phases).map(move |phase| (way, phase)));
        for (direction, phase) in cases {
            let supply_phase_rad = std::f64::consts::PI * f64::from(phase) / f64::from(trial.phases);
            let conditions =
                Conditions { temperature_c: trial.temperature_c, supply_phase_rad, ..Conditions::default() };
            let motion = trial.machine.simulate(*direction, &conditions, trial.sensors.step_s())?;
            for _ in 0..trial.repeats {
                let trace = trial.sensors.record(&motion, *direction, &mut self.rng)?.trace;
                let throw =
                    Throw { direction: Some(*direction), anti_alias_hz: trial.declared_hz, ..Throw::recorded(trace) };
                row.throws += 1;
                let found = self.identifier.identify(&throw, &trial.settings);
                let quality = found.quality();
                match found.outcome {
                    Ok(estimate) if estimate.grade == Grade::Good => {
                        // The throws differ by noise only, so the covariance without the error of the model is
                        // compared.
                        let noise_sd = estimate.covariance.diagonal().map(f64::sqrt).into();
                        row.add(estimate.coefficients(), noise_sd, reference);
                    }
                    _ => row.refusal = Some(quality.to_owned()),
                }
            }
        }
        Ok(row)
    }
}
