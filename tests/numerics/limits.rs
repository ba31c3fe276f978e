//! The statements and the numbers on the page about the limits of the method, checked with the runs that made them.

use pointsd::evaluate::limits::{FINDINGS, Finding, Row, run};

fn largest(row: &Row) -> f64 {
    row.worst_pct().unwrap_or([f64::NAN; 3]).iter().fold(0.0, |most, error| error.abs().max(most))
}

fn find<'a>(findings: &'a [Finding], name: &str) -> &'a [Row] {
    &findings.iter().find(|finding| finding.name == name).unwrap().rows
}

#[test]
fn the_page_about_the_limits_is_true() {
    let findings = run(8, 3, || {}).unwrap();
    assert_eq!(findings.len(), FINDINGS);
    let row = |finding: &str, label: &str| {
        find(&findings, finding).iter().find(|row| row.label == label).unwrap_or_else(|| panic!("{finding}: {label}"))
    };
    // Raw samples: rejected if the rate is too low for the inrush, otherwise close to the true coefficients.
    for rate in ["25", "50", "100", "200"] {
        assert!(row("sampling_raw", rate).errors_pct.is_empty(), "{rate} Hz raw");
    }
    for (rate, limit) in [("500", 3.0), ("1000", 1.0), ("5000", 0.3), ("20000", 0.3)] {
        assert!(largest(row("sampling_raw", rate)) < limit, "{rate} Hz raw: {:?}", row("sampling_raw", rate));
    }
    for (rate, limit) in [("50", 5.0), ("100", 3.0), ("200", 1.5), ("500", 1.5), ("1000", 1.0), ("20000", 0.3)] {
        assert!(largest(row("sampling_filtered", rate)) < limit, "{rate} Hz: {:?}", row("sampling_filtered", rate));
    }
    // A load appears as friction.
    let loaded = row("load", "1, +40.0 %").worst_pct().unwrap();
    assert!(loaded[0].abs() < 1.0 && (loaded[1] - 40.0).abs() < 2.0 && loaded[2].abs() < 1.0, "{loaded:?}");
    // The neutral position has an effect on a1.
    assert!(largest(row("neutral", "57.5, 57.5, R to N")) < 1.0);
    assert!(largest(row("neutral", "0, 57.5, N to R")) > 50.0);
    assert_eq!(findings.len(), 11);
    // Results without noise do not depend on the seed, so the page must have the same numbers.
    let page = include_str!("../../src/evaluate/limits/limits.md");
    for row in findings.iter().flat_map(|finding| &finding.rows).filter(|row| !row.noisy) {
        let errors = row.worst_pct().map_or([""; 3].map(str::to_owned), |worst| worst.map(|pct| format!("{pct:+.2}")));
        let rejected = match (&row.refusal, row.errors_pct.len()) {
            (Some(code), 0) => format!("`{code}`"),
            (Some(code), accepted) => format!("{} of {}: `{code}`", row.throws - accepted, row.throws),
            (None, _) => String::new(),
        };
        let line = format!("| {} | {} | {rejected} |", row.label, errors.join(" | "));
        assert!(page.contains(&line), "not on the page: {line}");
    }
}
