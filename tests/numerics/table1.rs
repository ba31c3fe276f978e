//! The table of the study, repeated with simulator and estimator, with lumped rails and with the beam.

use pointsd::diagnose::Cause;
use pointsd::evaluate::table1::{CORRELATION_LIMIT, CaseResult, Expected, run};
use pointsd::simulate::RailModel;

/// Models of the rails, and seeds.
const RUNS: [(RailModel, u64); 4] =
    [(RailModel::Lumped, 1), (RailModel::Beam, 1), (RailModel::Beam, 2), (RailModel::Beam, 3)];

fn results(rails: RailModel, seed: u64) -> Vec<CaseResult> {
    run(rails, 10, seed, &|| {}).unwrap()
}

#[test]
fn every_row_is_as_expected() {
    for (rails, seed) in RUNS {
        for result in results(rails, seed) {
            for test in &result.tests[1..] {
                let expected = test.expected.unwrap();
                for (at, name) in ["b0", "a1", "a0"].iter().enumerate() {
                    let (change, expected) = (test.change_pct[at], expected[at]);
                    assert!(
                        expected.holds(change),
                        "{rails:?} {} = {}: {name} moved by {change:.2} %, expected {expected:?}",
                        result.case.symbol,
                        test.value
                    );
                }
            }
        }
    }
}

#[test]
fn the_correlations_name_inertia_and_nothing_else() {
    for (rails, seed) in RUNS {
        for result in results(rails, seed) {
            assert_eq!(result.verdict(), Some(result.case.cause), "{rails:?}, seed {seed}: {:?}", result.correlation);
            let beyond_scatter = result.correlation_beyond_scatter;
            let inertia = result.correlation.iter().all(|pair| *pair >= CORRELATION_LIMIT);
            assert_eq!(
                inertia,
                result.case.cause == Cause::Inertia,
                "{rails:?}, seed {seed}: {:?}",
                result.correlation
            );
            if result.case.cause == Cause::Inertia {
                assert!(result.correlation.iter().all(|pair| *pair > 0.995), "{:?}", result.correlation);
                assert!(beyond_scatter.iter().all(|pair| *pair > 0.99), "{beyond_scatter:?}");
                for test in &result.tests {
                    let [b0, a1, a0] = test.change_pct;
                    assert!((b0 - a1).abs().max((a1 - a0).abs()).max((a0 - b0).abs()) < 1.0, "{:?}", test.change_pct);
                }
            } else {
                assert!(beyond_scatter.iter().any(|pair| *pair < 0.5), "{beyond_scatter:?}");
            }
        }
    }
}

#[test]
fn the_check_of_a_row_can_fail() {
    assert!(Expected::Change(1019.0).holds(1019.0 + 30.0) && !Expected::Change(1019.0).holds(1019.0 + 31.0));
    assert!(Expected::Change(-3.0).holds(-4.9) && !Expected::Change(-3.0).holds(-5.1));
    assert!(Expected::Within(1.5).holds(-1.5) && !Expected::Within(1.5).holds(1.6));
}
