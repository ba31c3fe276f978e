//! The evaluation: its results do not depend on the order of the lives, and its report has the documented form.

use pointsd::{
    diagnose::Settings,
    evaluate::{Amount, Growth, Plan, Report},
};

const SMALL: Amount = Amount {
    trials: 6,
    trace_trials: 0,
    healthy_throws: 20_000,
    trace_healthy_throws: 0,
    fleet_throws: 0,
    budget_lives: 2,
};

fn report(seed: u64, amount: Amount) -> Report {
    let plan = Plan::new(seed, amount, Settings::default());
    plan.report(&(0..plan.lives()).map(|life| plan.live(life)).collect::<Vec<_>>())
}

#[test]
fn the_order_of_the_simulated_lives_changes_nothing() {
    let amount = Amount { trials: 2, healthy_throws: 500, budget_lives: 1, ..SMALL };
    let plan = Plan::new(5, amount, Settings::default());
    let mut backwards: Vec<_> = (0..plan.lives()).rev().map(|life| plan.live(life)).collect();
    backwards.reverse();
    assert_eq!(plan.report(&backwards), report(5, amount));
}

#[test]
fn plain_faults_are_named_right_and_health_is_not_alarmed() {
    let report = report(11, SMALL);
    let plain: Vec<_> = report.rows.iter().filter(|row| !row.hard).collect();
    // Four causes, steps and ramps, three sizes at default noise and one at low noise.
    assert_eq!(plain.len(), 32);
    for row in plain {
        assert_eq!(row.monitor.right, row.trials, "{row:?}");
    }
    // Wear from the first throw on is right when it is named, or its trend is stated, in time.
    let wear = report.rows.iter().find(|row| row.shape == Growth::Wear).unwrap();
    assert!(wear.monitor.right > 0 && wear.monitor.wrong == 0, "{wear:?}");
    for row in report.rows.iter().filter(|row| row.shape == Growth::Accelerating || row.case.contains("summer")) {
        assert_eq!((row.monitor.right, row.hard), (row.trials, true), "{row:?}");
        assert!(row.size_coverage.unwrap() > 0.5, "{row:?}");
    }
    assert_eq!(report.healthy[0].throws, 20_000);
    assert_eq!(report.healthy[0].false_alarms, 0);
}

#[test]
fn the_json_has_the_keys_of_the_contract() {
    let amount = Amount { trials: 1, healthy_throws: 100, fleet_throws: 100, budget_lives: 1, ..SMALL };
    let json = serde_json::to_value(report(1, amount)).unwrap();
    assert_eq!(json["seed"], 1);
    for key in ["depth", "throws", "false_alarms"] {
        assert!(!json["healthy"][0][key].is_null(), "{key}");
    }
    // The usual fleet is first and has no label; every other fleet has one.
    let fleets: Vec<_> = json["healthy"].as_array().unwrap().iter().map(|healthy| &healthy["fleet"]).collect();
    assert_eq!(fleets.len(), 8);
    assert!(fleets[0].is_null() && fleets[1..].iter().all(|label| label.is_string()), "{fleets:?}");
    let row = json["rows"][0].as_object().unwrap();
    let keys = "depth cause shape size_pct noise hard trials right wrong ambiguous missed delay_median delay_p95";
    for key in keys.split(' ') {
        assert!(row.contains_key(key), "{key}");
    }
    for key in ["size_coverage", "forecast_coverage"] {
        assert!(row[key].is_null() || row[key].is_f64(), "{key}");
    }
    for comparator in ["paper", "cusum"] {
        let tally = row[comparator].as_object().unwrap();
        let sum: u64 = ["right", "wrong", "missed"].iter().map(|key| tally[*key].as_u64().unwrap()).sum();
        assert_eq!(sum, 1, "{comparator}");
    }
}
