//! `pointsim limits`: the limits of the method, from estimates of simulated throws.

use std::path::PathBuf;

use comfy_table::{Table, presets};

use super::{Exit, Outcome, ResultExt, output};
use crate::evaluate::limits::{FINDINGS, Finding, NAMES, Row, run};
use crate::report::{Panel, Sheet};

/// Least error drawn in the charts \[%\], as their axis is logarithmic.
const LEAST_DRAWN_PCT: f64 = 0.01;

/// The command line of `pointsim limits`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  pointsim limits
  pointsim limits --out figures --seed 7 > limits.md
  pointsim limits --json --throws 500

Exit codes: 0 done; 64 wrong command line; 70 a machine could not be simulated; 73 a chart cannot be written.")]
pub(super) struct Arguments {
    /// Write a chart of each finding into this directory, as SVG.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Number of throws with noise in each row.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u16).range(4..=10_000))]
    throws: u16,
    /// Seed of noise and loads.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print the findings as JSON, with the errors of every throw.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    output::create_folder(arguments.out.as_deref())?;
    let bar = output::progress(FINDINGS as u64, "{wide_bar} {human_pos} of {human_len} findings, {eta} left");
    let findings = run(arguments.throws.into(), arguments.seed, || bar.inc(1)).or_exit(Exit::Software)?;
    bar.finish_and_clear();
    if let Some(folder) = &arguments.out {
        output::figures(folder, findings.iter().map(|finding| (format!("limits_{}", finding.name), picture(finding))))?;
    }
    output::result(arguments.json, &findings, || findings.iter().map(text).collect::<Vec<_>>().join("\n"))?;
    Ok(Exit::Ok)
}

fn text(finding: &Finding) -> String {
    let mut table = Table::new();
    table.load_style(presets::ASCII_MARKDOWN);
    table.set_header([finding.label, "b0 [%]", "a1 [%]", "a0 [%]", "rejected"]);
    for row in &finding.rows {
        let mut cells = vec![row.label.clone()];
        cells.extend((0..3).map(|at| cell(row, at)));
        cells.push(rejected(row));
        table.add_row(cells);
    }
    format!("### {}\n\n{}\n\n{}\n", finding.title, finding.about, output::numbers(table, 0))
}

fn cell(row: &Row, at: usize) -> String {
    match (row.mean_pct(), row.sd_pct().filter(|_| row.noisy), row.worst_pct()) {
        (Some(mean), Some(sd), _) => format!("{:+.2} ± {:.2} ({:.2})", mean[at], sd[at], row.stated_sd_pct[at]),
        (_, _, Some(worst)) => format!("{:+.2}", worst[at]),
        _ => String::new(),
    }
}

fn rejected(row: &Row) -> String {
    let Some(reason) = &row.refusal else { return String::new() };
    let rejected = row.throws - row.errors_pct.len();
    if rejected == row.throws { format!("`{reason}`") } else { format!("{rejected} of {}: `{reason}`", row.throws) }
}

/// A chart of the root mean square errors as bars, with a line at 1 %.
fn picture(finding: &Finding) -> Sheet {
    let mut panel = Panel::bars(finding.label, "root mean square [%]", NAMES).log_y().level(1.0, "1 %");
    for row in &finding.rows {
        let count = row.errors_pct.len() as f64;
        let square = |at: usize| row.errors_pct.iter().map(|errors| errors[at] * errors[at]).sum::<f64>();
        let shown = |at: usize| if count > 0.0 { (square(at) / count).sqrt().max(LEAST_DRAWN_PCT) } else { f64::NAN };
        let label = if count > 0.0 { row.label.clone() } else { format!("{} (rejected)", row.label) };
        panel = panel.group(label, (0..3).map(shown));
    }
    Sheet::new(finding.title).panel(panel)
}
