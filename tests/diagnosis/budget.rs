//! The rate of false alarms of healthy machines whose scatter the diagnosis does not assume: strong serial correlation,
//! heavy tails, three times the usual size.

use std::{
    num::NonZero,
    sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed},
    thread,
};

use nalgebra::Vector3;
use pointsd::diagnose::{MachineMonitor, Settings};

use crate::field::{Machine, Scatter};

/// Number of lives in a row.
const LIVES: u64 = 100;
/// Throws of a life after the baseline.
const LIFE: u64 = 2_000;

/// Raised alarms of healthy lives, with the throws after their baselines.
fn raised(scatter: Scatter, first_seed: u64, lives: u64, life: u64, settings: &Settings) -> (usize, u64) {
    let (alarms, throws, next) = (AtomicUsize::new(0), AtomicU64::new(0), AtomicU64::new(0));
    let live = || {
        loop {
            let seed = next.fetch_add(1, Relaxed);
            if seed >= lives {
                return;
            }
            let mut machine = Machine::new(first_seed + seed, scatter);
            let mut monitor = MachineMonitor::new("21B");
            for _ in 0..2 * settings.baseline_throws as u64 + life {
                let verdict = machine.feed(&mut monitor, Vector3::zeros(), None, settings);
                alarms.fetch_add(
                    verdict.events.iter().filter(|event| event.event_no == 1 && event.cause.is_drift()).count(),
                    Relaxed,
                );
            }
            throws.fetch_add(life, Relaxed);
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, NonZero::get) {
            scope.spawn(live);
        }
    });
    (alarms.into_inner(), throws.into_inner())
}

/// The settings with practically no warning limits, and a budget of one false alarm in `throws`.
fn free(throws: f64) -> Settings {
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
                let (alarms, throws) = raised(scatter, 0, LIVES, LIFE, &usual);
                let budget = throws as f64 * usual.false_alarms_per_throw();
                let free = [1_000.0, 10_000.0].map(|each: f64| {
                    let (alarms, throws) = raised(scatter, 5_000, LIVES, LIFE, &free(each));
                    alarms as f64 / (throws as f64 / each)
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
        let (raised, throws) = raised(scatter, 20_000, LIVES, LIFE, &settings);
        println!("correlation {phi}, tails {tail:?}: {raised} alarms in {throws} throws");
        alarms += raised;
        budget += throws as f64 * settings.false_alarms_per_throw();
    }
    assert!(alarms as f64 <= budget, "{alarms} alarms, {budget:.1} in the budget");
}
