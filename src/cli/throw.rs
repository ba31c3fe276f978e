//! `pointsim throw`: simulates one throw, writes its trace as CSV, and prints its true coefficients.

use std::{
    fmt::Write as _,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use anyhow::{Context, anyhow, bail};
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use serde::{Deserialize, Serialize};

use super::{Exit, Failure, Outcome, ResultExt, argument, output, terminal};
use crate::daemon::config::{Document, overlay, set};
use crate::simulate::{Coefficients, Condition, Conditions, Parameters, Recording, Sensors};
use crate::throw::{Direction, OutOfRange};

/// The command line of `pointsim throw`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  pointsim throw --out throw.csv
  pointsim throw --out - | pointsd identify -
  pointsim throw --out worn.csv --direction reverse-to-normal --fault friction=25 --seed 7 --json
  pointsim throw --out slow.csv --set sensors.sample_rate_hz=100 --set sensors.anti_alias_hz=40
  pointsim throw --out other.csv --set machine.stroke_mm=150 --set machine.rails.slide_friction=0.1

Exit codes: 0 written; 64 wrong command line; 73 the CSV file cannot be created; 78 the configuration file cannot be
read, or a machine or sensor value is unknown or out of its range.")]
pub(super) struct Arguments {
    /// The CSV file to write: `time_s,current_a,position_mm`; - for standard output, with the coefficients on standard
    /// error.
    #[arg(long, value_name = "FILE.csv")]
    out: PathBuf,
    /// Direction of the throw.
    #[arg(long, default_value = "normal-to-reverse", value_parser = argument::direction())]
    direction: Direction,
    /// Seed of the sensors' noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// TOML file with tables `[machine]` and `[sensors]`; missing keys have their defaults.
    #[arg(long, value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Change one value of the configuration, for example `machine.lead_mm=8` (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    changes: Vec<String>,
    /// Change the coefficient of a part by PCT %: kt, friction, stiffness, `rail_stiffness` or inertia (repeatable).
    #[arg(long = "fault", value_name = "PART=PCT", allow_hyphen_values = true)]
    faults: Vec<String>,
    /// Use a machine with a series-wound motor.
    #[arg(long)]
    series: bool,
    /// Temperature of the machine [°C].
    #[arg(long, default_value_t = 20.0, allow_hyphen_values = true)]
    temperature_c: f64,
    /// Position of an obstacle in the way of the toe [mm from normal].
    #[arg(long)]
    obstruction_mm: Option<f64>,
    /// Print the true coefficients as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Settings {
    machine: Parameters,
    sensors: Sensors,
}

/// The output about a throw: its true coefficients and its conditions.
#[derive(Debug, Serialize)]
struct Truth {
    #[serde(flatten)]
    coefficients: Coefficients,
    direction: Direction,
    completed: bool,
    duration_s: f64,
    peak_current_a: f64,
    lead_mm: f64,
    stroke_mm: f64,
    neutral_mm: f64,
    sample_rate_hz: f64,
    samples: usize,
    temperature_c: f64,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let document = arguments.config.as_deref().map(Document::read).transpose().or_exit(Exit::Config)?;
    let Settings { machine, sensors } = settings(arguments, document.as_ref())?;
    let wrong = |section: &str, error: OutOfRange| match &document {
        Some(document) if arguments.changes.is_empty() => {
            document.in_section(section, Err(error)).or_exit(Exit::Config)
        }
        _ => Err(error.within(section)).or_exit(Exit::Config),
    };
    let condition = condition(&arguments.faults).or_exit(Exit::Usage)?;
    machine.check().or_else(|error| wrong("machine", error))?;
    let worn = machine.in_condition(&condition).context("the worn machine").or_exit(Exit::Config)?;
    let direction = arguments.direction;
    let conditions = Conditions {
        temperature_c: arguments.temperature_c,
        obstruction_mm: arguments.obstruction_mm,
        ..Conditions::default()
    };
    sensors.check().or_else(|error| wrong("sensors", error))?;
    let motion = worn.simulate(direction, &conditions, sensors.step_s()).map_err(|error| {
        let from_command_line = ["obstruction_mm", "temperature_c"].contains(&error.key.as_str());
        let exit = if from_command_line { Exit::Usage } else { Exit::Config };
        Failure::new(exit, error)
    })?;
    let mut rng = ChaCha12Rng::seed_from_u64(arguments.seed);
    let recording = sensors.record(&motion, direction, &mut rng).or_exit(Exit::Config)?;
    let is_stdout = arguments.out == Path::new("-");
    if is_stdout {
        output::written(io::stdout().write_all(csv(&recording).as_bytes()))?;
    } else {
        output::file(&arguments.out, csv(&recording))?;
    }
    let coefficients = worn.at_temperature(arguments.temperature_c).coefficients().or_exit(Exit::Config)?;
    let truth = Truth {
        coefficients,
        direction,
        completed: motion.completed,
        duration_s: motion.cut_off as f64 * motion.step_s,
        peak_current_a: motion.current_a.iter().fold(0.0, |most, current| current.abs().max(most)),
        lead_mm: worn.lead_mm,
        stroke_mm: worn.stroke_mm,
        neutral_mm: worn.neutral_mm,
        sample_rate_hz: sensors.sample_rate_hz,
        samples: recording.trace.len(),
        temperature_c: arguments.temperature_c,
    };
    let summary = if arguments.json {
        serde_json::to_string_pretty(&truth).or_exit(Exit::Software)?
    } else {
        text(&truth, &arguments.out)
    };
    if is_stdout {
        terminal::complain(summary);
    } else {
        output::line(summary)?;
    }
    Ok(Exit::Ok)
}

fn text(truth: &Truth, file: &Path) -> String {
    let Coefficients { b0, a1, a0, .. } = truth.coefficients;
    let end = if truth.completed { "completed" } else { "not completed" };
    let (duration, peak) = (truth.duration_s, truth.peak_current_a);
    format!(
        "{}: {} samples at {} Hz\n{}, {end} in {duration:.2} s, peak current {peak:.1} A\n\
         true coefficients: b0 = {b0:.2}, a1 = {a1:.3}, a0 = {a0:.4}",
        file.display(),
        truth.samples,
        truth.sample_rate_hz,
        truth.direction
    )
}

fn settings(arguments: &Arguments, document: Option<&Document>) -> Result<Settings, Failure> {
    let machine = if arguments.series { Parameters::series() } else { Parameters::default() };
    let start = Settings { machine, sensors: Sensors::default() };
    let mut table = toml::Table::try_from(start).or_exit(Exit::Software)?;
    if let Some(document) = document {
        overlay(&mut table, &document.deserialize().or_exit(Exit::Config)?);
    }
    for change in &arguments.changes {
        apply(&mut table, change).or_exit(Exit::Usage)?;
    }
    // The error of the parser has several lines.
    let one_line = |error: toml::de::Error| anyhow!("{}", error.to_string().trim().replace('\n', " "));
    let settings = table.try_into().map_err(one_line).context("the configuration is wrong").or_exit(Exit::Config);
    // If the file is wrong by itself, its own error is better, as it names the line.
    match document.map(Document::deserialize::<Settings>) {
        Some(Err(error)) if settings.is_err() => Err(Failure::new(Exit::Config, error)),
        _ => settings,
    }
}

/// Applies a change `a.b.c=value`. A value that is not valid TOML counts as a text.
fn apply(table: &mut toml::Table, change: &str) -> anyhow::Result<()> {
    let (key, text) = change.split_once('=').ok_or_else(|| anyhow!("--set {change}: write it as KEY=VALUE"))?;
    let value = format!("v = {text}")
        .parse::<toml::Table>()
        .ok()
        .and_then(|mut parsed| parsed.remove("v"))
        .unwrap_or_else(|| toml::Value::String(text.to_owned()));
    set(table, &key.split('.').collect::<Vec<_>>(), value);
    Ok(())
}

fn condition(faults: &[String]) -> anyhow::Result<Condition> {
    let mut condition = Condition::default();
    for fault in faults {
        let (part, size) = fault.split_once('=').ok_or_else(|| anyhow!("--fault {fault}: write it as PART=PCT"))?;
        let part = argument::part(part).map_err(|error| anyhow!("--fault {fault}: {error}"))?;
        let size_pct: f64 = size.parse().with_context(|| format!("--fault {fault}: {size} is not a number"))?;
        if !(-90.0..=2000.0).contains(&size_pct) {
            bail!("--fault {fault}: the size must be -90 to 2000 %");
        }
        condition.change(part, size_pct);
    }
    Ok(condition)
}

fn csv(recording: &Recording) -> String {
    let mut text = "time_s,current_a,position_mm\n".to_owned();
    let samples = recording.trace.current_a().iter().zip(recording.trace.position_mm());
    for (time_s, (current_a, position_mm)) in recording.time_s.iter().zip(samples) {
        let _ = writeln!(text, "{time_s:.7},{current_a:.6},{position_mm:.6}");
    }
    text
}
