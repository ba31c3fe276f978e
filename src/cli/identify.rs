//! `pointsd identify`: runs the estimator on a recorded trace.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;
use serde_json::{Value, json};

use super::{Exit, Failure, Outcome, ResultExt, argument, output, recording, terminal};
use crate::{
    estimate::{Estimate, Identification, Identifier, Motor, Rejection, Settings},
    throw::{Direction, Throw},
};

/// Identifies b0, a1 and a0 from one recorded throw.
///
/// FILE is CSV with the columns `time_s`, `current_a` and `position_mm` (in any order; other columns are ignored).
/// Uneven samples are resampled to an even grid; a trace with a gap is rejected.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  pointsim throw --out throw.csv && pointsd identify throw.csv\n\n\
    Exit codes: 0 accepted, 1 rejected (the reason is printed), 64 an option is wrong, 65 the file is not a recording, 66 it \
    cannot be read.")]
pub(super) struct Arguments {
    /// The recorded trace, or - for standard input.
    #[arg(value_name = "FILE.csv")]
    file: PathBuf,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
    /// Ball-screw lead [mm per revolution].
    #[arg(long, default_value_t = Settings::default().lead_mm, value_name = "MM")]
    lead_mm: f64,
    /// Toe position at which the rails are unstressed [mm from normal].
    #[arg(long, default_value_t = Settings::default().neutral_mm, value_name = "MM", allow_negative_numbers = true)]
    neutral_mm: f64,
    /// Nominal stroke in mm; without it an incomplete throw is detected from the trace alone.
    #[arg(long, value_name = "MM")]
    stroke_mm: Option<f64>,
    /// Supply voltage in V: adds energy, resistance and back-EMF, and with --stroke-mm identifies a throw without
    /// position.
    #[arg(long, value_name = "V")]
    supply_v: Option<f64>,
    /// Direction of the throw. Without a position the current may fit both; then it counts as normal-to-reverse.
    #[arg(long, value_parser = argument::direction())]
    direction: Option<Direction>,
    /// Kind of motor.
    #[arg(long, default_value = "permanent-magnet", value_parser = argument::motor())]
    motor: Motor,
    /// Cut-off of the anti-alias filter of both channels, in Hz.
    #[arg(long, value_name = "HZ")]
    anti_alias_hz: Option<f64>,
    /// Standard deviation of the current sensor's noise in A, for traces without quiet samples.
    #[arg(long, default_value_t = Settings::default().current_noise_a, value_name = "A")]
    current_noise_a: f64,
    /// Standard deviation of the position sensor's noise in mm, for traces without quiet samples.
    #[arg(long, default_value_t = Settings::default().position_noise_mm, value_name = "MM")]
    position_noise_mm: f64,
    /// Refine the estimate with a prefilter for white sensor noise; halves the scatter.
    #[arg(long)]
    refined: bool,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let settings = arguments.settings();
    settings.check_ranges().map_err(|error| anyhow!(renamed(&error.to_string()))).or_exit(Exit::Usage)?;
    let recording = recording::read(&arguments.file)?;
    let throw = Throw {
        direction: arguments.direction,
        supply_v: arguments.supply_v,
        anti_alias_hz: arguments.anti_alias_hz,
        ..Throw::recorded(recording.trace)
    };
    let problems: Vec<String> = throw.impossible_fields().iter().map(ToString::to_string).collect();
    if !problems.is_empty() {
        return Err(Failure::new(Exit::Usage, anyhow!(renamed(&problems.join("; ")))));
    }
    let found = Identifier::default().identify(&throw, &settings);
    let travel_mm = found.features.travel_mm.filter(|travel_mm| *travel_mm < LEAST_STROKE_MM);
    if let Some(travel_mm) = travel_mm.filter(|_| found.outcome.is_ok() && settings.stroke_mm.is_none()) {
        terminal::complain(format_args!(
            "warning: {}: the toe moved only {travel_mm:.1} mm: if the position is in centimetres or inches, convert it to \
             millimetres (position_mm); if this is the stroke, give it with --stroke-mm",
            arguments.file.display()
        ));
    }
    let reason = reason(&found, &recording.lines);
    if arguments.json {
        output::json(&report(&found, reason.as_deref(), recording.lines.is_empty()).or_exit(Exit::Software)?)?;
    } else {
        output::line(match &found.outcome {
            Ok(estimate) => text(&found, estimate, reason.as_deref()),
            Err(_) => features_text(&found),
        })?;
    }
    match reason.filter(|_| found.outcome.is_err()) {
        None => Ok(Exit::Ok),
        Some(reason) => {
            terminal::complain(format_args!("rejected: {}: {reason}", arguments.file.display()));
            Ok(Exit::Negative)
        }
    }
}

impl Arguments {
    fn settings(&self) -> Settings {
        Settings {
            lead_mm: self.lead_mm,
            neutral_mm: self.neutral_mm,
            stroke_mm: self.stroke_mm,
            motor: self.motor,
            current_noise_a: self.current_noise_a,
            position_noise_mm: self.position_noise_mm,
            refined: self.refined,
            ..Settings::default()
        }
    }
}

/// Least plausible stroke \[mm\]: rails that open less do not let a wheel flange pass. In centimetres and in inches most
/// strokes are smaller numbers than this.
const LEAST_STROKE_MM: f64 = 30.0;

/// Names of settings and message fields in the sentences of the estimator, and the options of this command for them.
const NAMES: [(&str, &str); 10] = [
    ("half of sample_rate_hz", "half of the sampling rate"),
    ("supply_v in the message and stroke_mm in the configuration", "--supply-v and --stroke-mm"),
    ("sample_rate_hz", "the column time_s"),
    ("supply_v", "--supply-v"),
    ("stroke_mm", "--stroke-mm"),
    ("anti_alias_hz", "--anti-alias-hz"),
    ("neutral_mm", "--neutral-mm"),
    ("lead_mm", "--lead-mm"),
    ("current_noise_a", "--current-noise-a"),
    ("position_noise_mm", "--position-noise-mm"),
];

/// A sentence of the estimator with the names of this command.
fn renamed(text: &str) -> String {
    NAMES.iter().fold(text.to_owned(), |text, (field, name)| text.replace(field, name))
}

/// The reason why the throw is rejected or rough, with the line of the file if one sample is the reason.
fn reason(found: &Identification, lines: &[u64]) -> Option<String> {
    let detail = renamed(&found.detail()?);
    let line = match found.reason() {
        Some(Rejection::NotFinite { sample, .. }) => lines.get(*sample),
        _ => None,
    };
    Some(match line {
        Some(line) => format!("line {line}: {detail}"),
        None => detail,
    })
}

fn report(found: &Identification, reason: Option<&str>, resampled: bool) -> serde_json::Result<Value> {
    let estimate = found.outcome.as_ref().ok();
    let scaled = estimate.filter(|estimate| !estimate.ratios_only);
    let [b0, a1, a0] = scaled.map_or([None; 3], |estimate| estimate.coefficients().map(Some));
    let [b0_sd, a1_sd, a0_sd] = scaled.map_or([None; 3], |estimate| estimate.sd().map(Some));
    let covariance = scaled.map(|estimate| <[[f64; 3]; 3]>::from(estimate.total_covariance()));
    let fit = estimate.and_then(|estimate| estimate.fit);
    let [a1_per_b0, a0_per_b0] = estimate.map_or([None; 2], |estimate| estimate.ratios().map(Some));
    let [a1_per_b0_sd, a0_per_b0_sd] = estimate.map_or([None; 2], |estimate| estimate.ratios_sd().map(Some));
    let mut report = json!({
        "accepted": estimate.is_some(), "reason": reason, "quality": found.quality(),
        "b0": b0, "a1": a1, "a0": a0, "b0_sd": b0_sd, "a1_sd": a1_sd, "a0_sd": a0_sd, "covariance": covariance,
        "a1_per_b0": a1_per_b0, "a1_per_b0_sd": a1_per_b0_sd, "a0_per_b0": a0_per_b0, "a0_per_b0_sd": a0_per_b0_sd,
        "fit_pct": fit.map(|fit| fit.pct), "iterations": fit.map(|fit| fit.iterations),
        "start_s": estimate.map(|e| e.start_s), "end_s": estimate.map(|e| e.end_s),
        "direction": found.direction.map(Direction::as_str), "resampled": resampled,
    });
    if let (Some(report), Value::Object(features)) = (report.as_object_mut(), serde_json::to_value(&found.features)?) {
        report.extend(features);
    }
    Ok(report)
}

fn text(found: &Identification, estimate: &Estimate, reason: Option<&str>) -> String {
    // Intervals of 95 %, as in every text for people.
    let row = |name: &str, value: f64, sd: f64, unit: &str| {
        let half_width = 1.96 * sd;
        format!("{name:<5}  {value:>10.5} ± {half_width:.5} {unit}  (± {:.2} %)\n", 100.0 * half_width / value)
    };
    let ([b0, a1, a0], [b0_sd, a1_sd, a0_sd]) = (estimate.coefficients(), estimate.sd());
    let coefficients = if estimate.ratios_only {
        "only the ratios are given\n".to_owned()
    } else {
        row("b0", b0, b0_sd, "rad/s²/A") + &row("a1", a1, a1_sd, "1/s") + &row("a0", a0, a0_sd, "1/s²")
    };
    let (ratios, ratios_sd) = (estimate.ratios(), estimate.ratios_sd());
    [
        reason.map(|reason| format!("{}: {reason}\n", found.quality())).unwrap_or_default(),
        coefficients,
        row("a1/b0", ratios[0], ratios_sd[0], "A s/rad"),
        row("a0/b0", ratios[1], ratios_sd[1], "A/rad"),
        "± is the half width of the 95 % interval\n".to_owned(),
        // That of the ratios is unknown: `fit` is of the model that was not accepted.
        estimate
            .fit
            .filter(|_| !estimate.ratios_only)
            .map(|fit| format!("fit {:.4} % in {} iterations, ", fit.pct, fit.iterations))
            .unwrap_or_default(),
        format!("from {:.3} s to {:.3} s\n", estimate.start_s, estimate.end_s),
        features_text(found),
    ]
    .concat()
}

fn features_text(found: &Identification) -> String {
    let features = &found.features;
    let value = |value: Option<f64>, unit: &str| {
        value.map_or_else(|| "unknown".to_owned(), |value| format!("{value:.3} {unit}"))
    };
    format!(
        "{}: duration {}, peak current {}, mean current {}, travel {}",
        found.direction.map_or_else(|| "direction unknown".to_owned(), |direction| direction.to_string()),
        value(features.duration_s, "s"),
        value(features.peak_current_a, "A"),
        value(features.mean_current_a, "A"),
        value(features.travel_mm, "mm"),
    )
}
