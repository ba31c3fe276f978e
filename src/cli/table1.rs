//! `pointsim table1`: repeats the 4 cases x 6 tests of the study, with measured and expected changes as tables and
//! charts.

use std::path::PathBuf;

use serde_json::json;

use super::{Exit, Outcome, ResultExt, output};
use crate::diagnose::Cause;
use crate::estimate::{Settings, modelled_position_mm};
use crate::evaluate::table1::{CORRELATION_LIMIT, CaseResult, Expected, TESTS, Test, run};
use crate::report::{Panel, Sheet};
use crate::simulate::RailModel;
use crate::throw::counted;

const NAMES: [&str; 3] = ["b0", "a1", "a0"];
const PAIRS: [&str; 3] = ["b0, a1", "b0, a0", "a1, a0"];

/// The command line of `pointsim table1`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  pointsim table1
  pointsim table1 --out figures --seed 7
  pointsim table1 --lumped --json

Exit codes: 0 every row is as expected and every case is named right; 1 otherwise; 64 wrong command line; 70 a throw
could not be identified; 73 a figure cannot be written.")]
pub(super) struct Arguments {
    /// Write the figures into this directory, as SVG.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Simulate the rails as one mass and spring instead of a beam.
    #[arg(long)]
    lumped: bool,
    /// Number of throws of each test; the table shows their mean.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..=1000))]
    throws: u16,
    /// Seed of the sensors' noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print the results as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    output::create_folder(arguments.out.as_deref())?;
    let rails = if arguments.lumped { RailModel::Lumped } else { RailModel::Beam };
    let bar = output::progress(TESTS as u64, "{wide_bar} {human_pos} of {human_len} tests, {eta} left");
    let results = run(rails, arguments.throws.into(), arguments.seed, &|| bar.inc(1)).or_exit(Exit::Software)?;
    bar.finish_and_clear();
    if let Some(folder) = &arguments.out {
        output::figures(folder, figures(&results))?;
    }
    let as_expected = results
        .iter()
        .all(|result| result.verdict() == Some(result.case.cause) && result.tests.iter().all(is_as_expected));
    output::result(arguments.json, &report(&results), || tables(&results, arguments))?;
    Ok(if as_expected { Exit::Ok } else { Exit::Negative })
}

fn holds(test: &Test, at: usize) -> bool {
    test.expected.is_none_or(|expected| expected[at].holds(test.change_pct[at]))
}

fn is_as_expected(test: &Test) -> bool {
    (0..3).all(|at| holds(test, at))
}

fn tables(results: &[CaseResult], arguments: &Arguments) -> String {
    let rails = if arguments.lumped { "lumped rails" } else { "finite-element rails" };
    let mut text = format!(
        "Change of the coefficients from test 1 [%], {rails}, mean of {} for each test.\n\
         Each cell: measured (standard deviation) | expected; * if they differ by more than 2 points or 3 %.\n",
        counted(arguments.throws, "throw")
    );
    for result in results {
        let parameter = format!("{}{}", result.case.symbol, unit(result));
        let mut table = output::table(["test", &parameter, NAMES[0], NAMES[1], NAMES[2]]);
        for (at, test) in result.tests.iter().enumerate() {
            let [b0, a1, a0] = [0, 1, 2].map(|coefficient| cell(test, coefficient));
            table.add_row([(at + 1).to_string(), test.value.to_string(), b0, a1, a0]);
        }
        let table = output::numbers(table, 0);
        let line = |[b0_a1, b0_a0, a1_a0]: [f64; 3]| format!("b0, a1 {b0_a1:.2}; b0, a0 {b0_a0:.2}; a1, a0 {a1_a0:.2}");
        let verdict = format!("verdict: {} (changed: {})", verdict(result), result.case.cause.as_str());
        let [scatter, beyond] = [result.correlation, result.correlation_beyond_scatter].map(line);
        text.extend([
            format!("\n{table}\ncorrelation of the inertia estimates: {scatter}\n"),
            format!("of the means, beyond a scatter of 1 %: {beyond}\n{verdict}\n"),
        ]);
    }
    text
}

/// The unit as " [N/m]"; empty for a number without unit.
fn unit(result: &CaseResult) -> String {
    if result.case.unit.is_empty() { String::new() } else { format!(" [{}]", result.case.unit) }
}

fn cell(test: &Test, at: usize) -> String {
    let Some(expected) = test.expected else { return format!("{:.4}", test.coefficients[at]) };
    let expected = match expected[at] {
        Expected::Change(pct) => format!("{pct:+.1}"),
        Expected::Within(pct) => format!("within {pct}"),
    };
    let sd_pct = test.sd[at] / test.coefficients[at] * 100.0;
    let mark = if holds(test, at) { "" } else { " *" };
    format!("{:+.1} ({sd_pct:.1}) | {expected}{mark}", test.change_pct[at])
}

fn verdict(result: &CaseResult) -> &'static str {
    result.verdict().map_or("none", Cause::as_str)
}

fn report(results: &[CaseResult]) -> Vec<serde_json::Value> {
    let test = |test: &Test| {
        json!({
            "value": test.value, "b0": test.coefficients[0], "a1": test.coefficients[1], "a0": test.coefficients[2],
            "sd": test.sd, "change_pct": test.change_pct, "as_expected": is_as_expected(test),
        })
    };
    let case = |result: &CaseResult| {
        let pairs = |[b0_a1, b0_a0, a1_a0]: [f64; 3]| json!({"b0_a1": b0_a1, "b0_a0": b0_a0, "a1_a0": a1_a0});
        json!({
            "parameter": result.case.symbol, "cause": result.case.cause.as_str(), "verdict": verdict(result),
            "correlation": pairs(result.correlation),
            "correlation_beyond_scatter": pairs(result.correlation_beyond_scatter),
            "tests": result.tests.iter().map(test).collect::<Vec<_>>(),
        })
    };
    results.iter().map(case).collect()
}

/// The figures of the study with their file names.
fn figures(results: &[CaseResult]) -> Vec<(String, Sheet)> {
    let mut figures = vec![("figure05_pulse_response".to_owned(), pulse_response(&results[0].tests[0]))];
    for (at, result) in results.iter().enumerate() {
        let name = format!("figure{:02}_case_{}", at + 6, result.case.symbol.to_lowercase());
        figures.push((name, estimates(result)));
    }
    figures.push(("figure10_inertia_estimates".to_owned(), inertia_estimates(results)));
    figures.push(("figure11_correlations".to_owned(), correlations(results)));
    figures
}

/// Current above which the simulated motor counts as running \[A\]: ten times the noise of its sensor, so that no
/// sample at rest is above it.
const RUNNING_A: f64 = 0.2;

/// Charts of the recorded throw of the nominal machine, of the position that the identified model gives for its
/// current, and of the difference.
fn pulse_response(test: &Test) -> Sheet {
    let period = test.trace.sample_rate_hz().recip();
    let samples = |values: &[f64]| -> Vec<(f64, f64)> {
        values.iter().enumerate().map(|(at, value)| (at as f64 * period, *value)).collect()
    };
    // The model is shown only until the current ends. Afterwards the stock rail and the brake hold the toe; the model
    // includes neither.
    let running = test.trace.current_a().iter().rposition(|current| current.abs() > RUNNING_A).unwrap_or(0);
    let mut model = modelled_position_mm(&test.trace, test.coefficients, f64::INFINITY, &Settings::default());
    model.truncate(running);
    let error: Vec<f64> = test.trace.position_mm().iter().zip(&model).map(|(is, model)| is - model).collect();
    Sheet::new("Pulse response of the nominal machine")
        .panel(
            Panel::curves("Motor current", "time [s]", "current [A]").line("recorded", samples(test.trace.current_a())),
        )
        .panel(
            Panel::curves("Toe position", "time [s]", "position [mm]")
                .line("recorded", samples(test.trace.position_mm()))
                .line("identified model", samples(&model)),
        )
        .panel(
            Panel::curves("Error of the model", "time [s]", "difference [mm]")
                .line("recorded - identified model", samples(&error)),
        )
}

fn estimates(result: &CaseResult) -> Sheet {
    let nominal = result.tests[0].coefficients;
    let empty = |title: &str| {
        let axis = format!("% of nominal, over {}{}", result.case.symbol, unit(result));
        Panel::bars(title, axis, NAMES).level(100.0, "")
    };
    let (mut ours, mut expected) = (empty("This run"), empty("Expected (no more than 2.5 % where flat)"));
    for test in &result.tests {
        ours = ours.group(test.value.to_string(), (0..3).map(|at| test.coefficients[at] / nominal[at] * 100.0));
        expected = expected.group(test.value.to_string(), (0..3).map(|at| expected_pct(test, at)));
    }
    Sheet::new(format!("Estimates while {} changes", result.case.symbol)).columns(2).panel(ours).panel(expected)
}

/// Expected coefficient of a test \[% of nominal\].
fn expected_pct(test: &Test, at: usize) -> f64 {
    match test.expected.map(|expected| expected[at]) {
        Some(Expected::Change(pct)) => 100.0 + pct,
        Some(Expected::Within(_)) | None => 100.0,
    }
}

fn inertia_estimates(results: &[CaseResult]) -> Sheet {
    let mut sheet = Sheet::new("Inertia estimates, nominal / estimate").columns(2);
    for result in results {
        let nominal = result.tests[0].coefficients;
        let mut panel = Panel::curves(format!("{} changes", result.case.symbol), "test", "ratio");
        for (coefficient, name) in NAMES.iter().enumerate() {
            let ratio =
                |(at, test): (usize, &Test)| ((at + 1) as f64, nominal[coefficient] / test.coefficients[coefficient]);
            panel = panel.dotted_line(format!("J from {name}"), result.tests.iter().enumerate().map(ratio));
        }
        sheet = sheet.panel(panel);
    }
    sheet
}

fn correlations(results: &[CaseResult]) -> Sheet {
    let mut panel =
        Panel::bars("Pairs of inertia estimates over the six tests, mean over the throws", "correlation", PAIRS);
    for result in results {
        panel = panel.group(format!("{} changes", result.case.symbol), result.correlation);
    }
    Sheet::new("Correlation of the inertia estimates")
        .panel(panel.level(CORRELATION_LIMIT, "inertia when all three are above"))
}
