//! `pointsim limits`: the limits of the method, from estimates of simulated throws.

use comfy_table::{Table, presets};

use super::{Exit, Outcome, ResultExt, output};
use crate::evaluate::limits::{FINDINGS, Finding, Row, run};

/// The command line of `pointsim limits`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  pointsim limits
  pointsim limits --seed 7 > limits.md
  pointsim limits --json --throws 500

Exit codes: 0 done; 64 wrong command line; 70 a machine could not be simulated.")]
pub(super) struct Arguments {
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
    let bar = output::progress(FINDINGS as u64, "{wide_bar} {human_pos} of {human_len} findings, {eta} left");
    let findings = run(arguments.throws.into(), arguments.seed, || bar.inc(1)).or_exit(Exit::Software)?;
    bar.finish_and_clear();
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
