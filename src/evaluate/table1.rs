//! The study's Table 1 of 4 cases x 6 tests, repeated with the simulated machine and the estimator.
//!
//! In each case one physical parameter has six values; test 1 is the nominal machine. A test is the mean of several
//! throws, as the estimates of one throw scatter by half a per cent and more. The expected changes come from an
//! independent simulation of the study (20 mA and 20 um of noise).
//!
//! The study's rule uses the correlation of the three inertia estimates J = nominal/estimate over the six tests: the
//! cause is inertia if all pairs reach 0.8. A correlation has no scale, so a change of a tenth of a per cent, by noise
//! or dry friction, counts as much as a doubling. Without noise, the friction case has 0.98 in all pairs, as friction
//! on the chairs of a beam changes b0 and a0 by a tenth of the change of a1. Therefore the table shows the correlation
//! of the study (one throw for each test, mean over the throws), and the verdict uses the correlation beyond the
//! scatter of a machine in service.

use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;

use crate::diagnose::Cause;
use crate::estimate::{Estimate, Identifier, Rejection, Settings};
use crate::simulate::{Conditions, Parameters, RailModel, Sensors};
use crate::throw::{Direction, OutOfRange, Throw, Trace};

/// Least correlation of two inertia estimates that agree, as in the study.
pub const CORRELATION_LIMIT: f64 = 0.8;
/// Least significant change of a coefficient \[standard deviations\].
const MOVED_SIGMAS: f64 = 4.0;
/// Scatter of the coefficients between healthy throws, as a fraction: running currents repeat within 0.3 to 2 %.
const SERVICE_SCATTER: f64 = 0.01;
/// Direction of all throws of the study.
const DIRECTION: Direction = Direction::NormalToReverse;

/// Expected change of one coefficient since test 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expected {
    /// A change by this value \[%\].
    Change(f64),
    /// A change by at most this value \[%\], of either sign.
    Within(f64),
}

impl Expected {
    /// Whether a change \[%\] is as expected. With [`Self::Change`] it may differ by 2 percentage points, or by 3 % of
    /// the expected change if this is more.
    pub fn holds(self, change_pct: f64) -> bool {
        match self {
            Self::Change(expected) => (change_pct - expected).abs() <= (0.03 * expected.abs()).max(2.0),
            Self::Within(limit) => change_pct.abs() <= limit,
        }
    }
}

/// One case of the study.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    /// Symbol of the parameter.
    pub symbol: &'static str,
    /// Unit of the parameter.
    pub unit: &'static str,
    /// The cause that the parameter stands for.
    pub cause: Cause,
    /// Values of the parameter in tests 2 to 6.
    pub values: [f64; 5],
    parameter: fn(&mut Parameters) -> &mut f64,
    expected: fn(usize) -> [Expected; 3],
}

/// The four cases, in the study's order.
const CASES: [Case; 4] = [
    Case {
        symbol: "KT",
        unit: "N m/A",
        cause: Cause::Kt,
        values: [0.5, 0.6, 0.7, 0.9, 1.0],
        parameter: |machine| &mut machine.torque_constant,
        expected: |at| {
            let b0 = [-37.4, -25.4, -11.1, 14.1, 24.8][at];
            [Expected::Change(b0), Expected::Within(2.0), Expected::Within(2.0)]
        },
    },
    Case {
        symbol: "mu",
        unit: "",
        cause: Cause::Friction,
        values: [0.001, 0.0025, 0.005, 0.01, 0.02],
        parameter: |machine| &mut machine.rails.slide_friction,
        expected: |at| {
            // The study gives the change for the largest value only; smaller values have smaller changes.
            let a1 = if at == 4 { Expected::Change(2.5) } else { Expected::Within(2.5) };
            [Expected::Within(2.0), a1, Expected::Within(2.0)]
        },
    },
    Case {
        symbol: "K_bs",
        unit: "N m/rad",
        cause: Cause::Stiffness,
        values: [0.1, 0.2, 0.3, 0.4, 0.5],
        parameter: |machine| &mut machine.screw_stiffness_nm,
        expected: |at| {
            let a0 = [208.0, 410.0, 618.0, 817.0, 1019.0][at];
            [Expected::Within(1.5), Expected::Within(1.5), Expected::Change(a0)]
        },
    },
    Case {
        symbol: "J_L",
        unit: "kg m²",
        cause: Cause::Inertia,
        values: [1e-4, 2e-4, 4e-4, 6e-4, 7.5e-4],
        parameter: |machine| &mut machine.load_inertia_kg_m2,
        expected: |at| [Expected::Change([-3.0, -19.0, -39.0, -51.0, -57.5][at]); 3],
    },
];

/// One test of a case: the value of the parameter, and the estimates.
#[derive(Debug, Clone)]
pub struct Test {
    /// Value of the parameter.
    pub value: f64,
    /// Mean estimates of b0, a1, a0.
    pub coefficients: [f64; 3],
    /// Stated standard deviations of the coefficients.
    pub sd: [f64; 3],
    /// Change of b0, a1, a0 from test 1 \[%\].
    pub change_pct: [f64; 3],
    /// Expected changes; `None` for test 1.
    pub expected: Option<[Expected; 3]>,
    /// The first throw of the test, as recorded.
    pub trace: Trace,
}

/// One case with its six tests.
#[derive(Debug, Clone)]
pub struct CaseResult {
    /// The case.
    pub case: Case,
    /// The six tests; test 1 is the nominal machine.
    pub tests: Vec<Test>,
    /// Correlations of the inertia estimates, in the order (b0, a1), (b0, a0), (a1, a0): with one throw for each test,
    /// mean over the throws. 0 if an estimate is constant.
    pub correlation: [f64; 3],
    /// Correlations of the tests' means with an added scatter of 1 %, so that only larger changes count.
    pub correlation_beyond_scatter: [f64; 3],
}

/// An error that ends the study.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// A parameter of the machine is out of its range.
    #[error(transparent)]
    Machine(#[from] OutOfRange),
    /// More throws of a test were rejected than the test needs.
    #[error("{symbol} = {value}: {reason}")]
    Refused {
        /// Symbol of the parameter.
        symbol: &'static str,
        /// Value of the parameter.
        value: f64,
        /// Reason of the last rejection.
        reason: Rejection,
    },
}

/// Number of tests in all cases: the nominal machine and five values of the parameter in each.
pub const TESTS: usize = 6 * CASES.len();

/// Runs all four cases with this model of the rails. `throws`: throws of each test, at least 1, each with new noise of
/// the sensors; `seed`: that of this noise. `is_done` is called after each test, for a progress bar.
///
/// # Errors
/// When a throw cannot be simulated or identified.
///
/// # Panics
/// When `throws` is 0.
pub fn run(rails: RailModel, throws: usize, seed: u64, is_done: &dyn Fn()) -> Result<Vec<CaseResult>, Failure> {
    let mut nominal = Parameters::default();
    nominal.rails.model = rails;
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    let mut identifier = Identifier::default();
    CASES.iter().map(|case| run_case(case, nominal.clone(), throws, &mut rng, &mut identifier, is_done)).collect()
}

fn run_case(
    case: &Case,
    mut machine: Parameters,
    throws: usize,
    rng: &mut ChaCha12Rng,
    identifier: &mut Identifier,
    is_done: &dyn Fn(),
) -> Result<CaseResult, Failure> {
    let sensors = Sensors::default();
    let mut tests: Vec<Test> = Vec::with_capacity(6);
    let mut singles: Vec<Vec<[f64; 3]>> = Vec::with_capacity(6);
    let first = *(case.parameter)(&mut machine);
    for (at, value) in std::iter::once(first).chain(case.values).enumerate() {
        *(case.parameter)(&mut machine) = value;
        let motion = machine.simulate(DIRECTION, &Conditions::default(), sensors.step_s())?;
        let mut traces = Vec::with_capacity(throws);
        let mut estimates = Vec::with_capacity(throws);
        let mut refusals = 0;
        while estimates.len() < throws {
            let trace = sensors.record(&motion, DIRECTION, rng)?.trace;
            match identify(identifier, &machine, &trace) {
                Ok(estimate) => {
                    estimates.push(estimate);
                    traces.push(trace);
                }
                // Noise sometimes looks like a damaged trace; such a throw is repeated.
                Err(_) if refusals < throws => refusals += 1,
                Err(reason) => return Err(Failure::Refused { symbol: case.symbol, value, reason }),
            }
        }
        let (coefficients, sd) = mean(&estimates);
        singles.push(estimates.iter().map(Estimate::coefficients).collect());
        let first = tests.first().map_or(coefficients, |first| first.coefficients);
        tests.push(Test {
            value,
            coefficients,
            sd,
            change_pct: change_pct(coefficients, first),
            expected: at.checked_sub(1).map(case.expected),
            trace: traces.swap_remove(0),
        });
        is_done();
    }
    let means: Vec<[f64; 3]> = tests.iter().map(|test| test.coefficients).collect();
    let of_one_throw = |throw: usize| -> Vec<[f64; 3]> { singles.iter().map(|test| test[throw]).collect() };
    let single: Vec<[f64; 3]> = (0..throws).map(|throw| correlations(&of_one_throw(throw), 0.0)).collect();
    Ok(CaseResult {
        case: *case,
        correlation: std::array::from_fn(|pair| single.iter().map(|of| of[pair]).sum::<f64>() / throws as f64),
        correlation_beyond_scatter: correlations(&means, SERVICE_SCATTER),
        tests,
    })
}

/// Correlations of the inertia estimates nominal/estimate over the tests: (b0, a1), (b0, a0), (a1, a0).
pub(super) fn correlations(tests: &[[f64; 3]], scatter: f64) -> [f64; 3] {
    let inertia = |at: usize| -> Vec<f64> { tests.iter().map(|test| tests[0][at] / test[at]).collect() };
    let (b0, a1, a0) = (inertia(0), inertia(1), inertia(2));
    [(&b0, &a1), (&b0, &a0), (&a1, &a0)].map(|(a, b)| correlation(a, b, scatter))
}

/// Means of b0, a1, a0, and the standard deviations of these means.
fn mean(estimates: &[Estimate]) -> ([f64; 3], [f64; 3]) {
    let count = estimates.len() as f64;
    let values = |at: usize| estimates.iter().map(move |e| e.coefficients()[at]).sum::<f64>() / count;
    let sd = |at: usize| estimates.iter().map(|e| e.covariance[(at, at)]).sum::<f64>().sqrt() / count;
    (std::array::from_fn(values), std::array::from_fn(sd))
}

fn identify(identifier: &mut Identifier, machine: &Parameters, trace: &Trace) -> Result<Estimate, Rejection> {
    let settings = Settings { lead_mm: machine.lead_mm, neutral_mm: machine.neutral_mm, ..Settings::default() };
    let throw = Throw { direction: Some(DIRECTION), ..Throw::recorded(trace.clone()) };
    match identifier.identify(&throw, &settings).outcome {
        // The table needs the coefficients. An estimate with ratios only counts as rejected.
        Ok(Estimate { ratios_only: true, reason: Some(reason), .. }) => Err(reason),
        outcome => outcome,
    }
}

fn change_pct(is: [f64; 3], was: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|at| (is[at] / was[at] - 1.0) * 100.0)
}

/// Pearson's correlation of two series, each with an added uncorrelated scatter; 0 if a series is constant.
fn correlation(a: &[f64], b: &[f64], scatter: f64) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product: f64 = a.iter().zip(b).map(|(x, y)| (x - mean_a) * (y - mean_b)).sum();
    let square = |values: &[f64], mean: f64| values.iter().map(|x| (x - mean).powi(2) + scatter * scatter).sum::<f64>();
    let scale = (square(a, mean_a) * square(b, mean_b)).sqrt();
    if scale > 0.0 { product / scale } else { 0.0 }
}

impl CaseResult {
    /// Whether b0, a1, a0 changed significantly in any test.
    pub fn moved(&self) -> [bool; 3] {
        let first = &self.tests[0];
        std::array::from_fn(|at| {
            self.tests.iter().any(|test| {
                let limit = MOVED_SIGMAS * first.sd[at].hypot(test.sd[at]);
                (test.coefficients[at] - first.coefficients[at]).abs() > limit
            })
        })
    }

    /// The cause by the study's rule: inertia, the cause of the coefficient that changed most, or `None`.
    pub fn verdict(&self) -> Option<Cause> {
        let moved = self.moved();
        if self.correlation_beyond_scatter.iter().all(|pair| *pair >= CORRELATION_LIMIT) {
            return Some(Cause::Inertia);
        }
        let most = |at: usize| self.tests.iter().map(|test| test.change_pct[at].abs()).fold(0.0, f64::max);
        let largest = (0..3).filter(|&at| moved[at]).max_by(|&a, &b| most(a).total_cmp(&most(b)));
        // The parameters of the first three cases belong to b0, a1 and a0.
        largest.map(|at| CASES[at].cause)
    }
}
