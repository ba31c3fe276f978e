//! The rate of false alarms of healthy machines whose scatter the diagnosis does not assume: strong serial correlation,
//! heavy tails, three times the usual size.

use nalgebra::Vector3;
use pointsd::diagnose::{Cause, Settings};

use crate::fleet::{Machine, Scatter, in_parallel, shift};

/// Number of lives in a row.
const LIVES: u64 = 100;
/// Throws of a life after the baseline.
const LIFE: usize = 2_000;

/// Number of throws of all lives of a row.
const THROWS: f64 = LIVES as f64 * LIFE as f64;

/// Raised alarms of [`LIVES`] healthy lives.
fn raised(scatter: Scatter, first_seed: u64, settings: &Settings) -> usize {
    let live = |seed| {
        let mut machine = Machine::in_field(first_seed + seed, scatter);
        machine.settings = settings.clone();
        let events = machine.events(2 * settings.baseline_throws + LIFE, Vector3::zeros());
        events.iter().filter(|event| event.event_no == 1 && event.cause.is_drift()).count()
    };
    in_parallel(LIVES, live).into_iter().sum()
}

/// The settings with practically no warning limits, and a budget of one false alarm in `throws`.
pub(crate) fn free(throws: f64) -> Settings {
    Settings {
        kt_limit_pct: 0.001,
        friction_limit_pct: 0.001,
        stiffness_limit_pct: 0.001,
        inertia_limit_pct: 0.001,
        false_alarm_years: 1.0,
        throws_per_day: throws / 365.25,
        ..Settings::default()
    }
}

#[test]
#[ignore = "prints a table, in some minutes"]
fn table_of_the_budget() {
    let usual = Settings::default();
    println!(
        "| correlation | tails | scatter | usual limits: alarms of budget | no limits, 1 in 1,000 | 1 in 10,000 |"
    );
    for phi in [0.0, 0.5, 0.8, 0.9] {
        for tail in [None, Some(3)] {
            for scale in [1.0, 3.0] {
                let scatter = Scatter { sd: Scatter::USUAL.sd.map(|sd| scale * sd), phi, tail };
                let alarms = raised(scatter, 0, &usual);
                let budget = THROWS * usual.false_alarms_per_throw();
                let free = [1_000.0, 10_000.0].map(|each: f64| {
                    let alarms = raised(scatter, 5_000, &free(each));
                    alarms as f64 / (THROWS / each)
                });
                let tails = tail.map_or("Gauss".to_owned(), |degrees| format!("t{degrees}"));
                println!("| {phi} | {tails} | {scale} | {alarms} of {budget:.1} | {:.2} | {:.2} |", free[0], free[1]);
            }
        }
    }
}

#[test]
fn heavy_tails_correlation_and_three_times_the_scatter_stay_within_the_budget() {
    let settings = Settings::default();
    let (mut alarms, mut budget) = (0, 0.0);
    for (phi, tail) in [(0.0, Some(3)), (0.5, Some(3)), (0.0, None), (0.8, None)] {
        let scatter = Scatter { sd: Scatter::USUAL.sd.map(|sd| 3.0 * sd), phi, tail };
        let raised = raised(scatter, 20_000, &settings);
        println!("correlation {phi}, tails {tail:?}: {raised} alarms in {THROWS} throws");
        alarms += raised;
        budget += THROWS * settings.false_alarms_per_throw();
    }
    assert!(alarms as f64 <= budget, "{alarms} alarms, {budget:.1} in the budget");
}

/// With heavy tails and strong correlation one large deviation fades over the next throws, as no drift does.
#[test]
fn a_large_deviation_that_fades_is_no_drift() {
    let scatter = Scatter { phi: 0.8, ..Scatter::USUAL };
    for (cause, pct) in [(Cause::Kt, 30.0), (Cause::Friction, 100.0), (Cause::Stiffness, -40.0)] {
        let (size, mut alarmed) = (shift(cause, pct), Vec::new());
        for seed in 0..10 {
            let mut machine = Machine::after(200, 60_000 + seed, scatter);
            alarmed.extend((0..60).flat_map(|at| machine.feed(size * 0.9_f64.powi(at)).events));
            let lasting = machine.events(40, size);
            assert!(lasting.iter().any(|event| event.cause == cause), "{cause} {pct} %, seed {seed}: {lasting:?}");
        }
        // Scatter in the same sense may add to the deviation: one alarm, with its end, is allowed.
        assert!(alarmed.len() <= 2, "{alarmed:?}");
    }
}
