//! `pointsd evaluate`: scores the diagnosis on simulated fleets.

use std::{
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
    thread,
};

use clap::Args;
use comfy_table::{Cell, Table};
use parking_lot::Mutex;

use super::{Exit, Outcome, output, terminal};
use crate::{
    diagnose::Settings,
    evaluate::{self, Amount, Depth, Plan, Report, Row, Tally},
};

/// Scores the diagnosis on simulated fleets. Counts the false alarms on healthy machines. For every cause, shape, size
/// and noise, shows the share of faults named right and the delay in throws. The rule of the paper and a CUSUM are
/// scored on the same throws.
///
/// The same seed gives the same report with any number of threads. In a release build a full run takes more than half
/// an hour on two cores, `--quick` some ten minutes. Exit codes: 0 all goals met; 1 some goals not
/// met, each named on stderr; 64 --out is no .svg or .html; 73 the file of --out cannot be created.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  pointsd evaluate --quick\n  pointsd evaluate --seed 7 --out delays.svg\n  pointsd \
                        evaluate --json > report.json"
)]
pub(super) struct Arguments {
    /// Seed of the whole run.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Simulate only a tenth of the lives of machines (a quarter in the section about the budget).
    #[arg(long)]
    quick: bool,
    /// Number of threads [default: number of cores].
    #[arg(long, value_name = "N")]
    threads: Option<NonZeroUsize>,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
    /// Write charts to this file, `.svg` or `.html`: delay, and share named right, over the size of the fault.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    arguments.out.as_deref().map_or(Ok(()), |out| output::of_format(out, ["svg", "html"]))?;
    let amount = if arguments.quick { Amount::QUICK } else { Amount::FULL };
    let plan = Plan::new(arguments.seed, amount, Settings::default());
    arguments.out.as_deref().map_or(Ok(()), output::creatable)?;
    let threads = arguments.threads.or_else(|| thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
    let report = plan.report(&live_all(&plan, threads));
    if let Some(path) = &arguments.out {
        output::file(path, picture(path, &report))?;
    }
    output::result(arguments.json, &report, || tables(&report))?;
    let shortfalls = report.shortfalls();
    for shortfall in &shortfalls {
        terminal::complain(format_args!("goal not met: {shortfall}"));
    }
    Ok(if shortfalls.is_empty() { Exit::Ok } else { Exit::Negative })
}

/// Simulates all lives of machines on `threads` threads; returns the outcomes in the order of the lives.
fn live_all(plan: &Plan, threads: usize) -> Vec<evaluate::Outcome> {
    let progress = output::progress(plan.lives() as u64, "{wide_bar} {human_pos} of {human_len} lives, {eta} left");
    let (next, outcomes) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(plan.lives())));
    let work = || {
        loop {
            let life = next.fetch_add(1, Ordering::Relaxed);
            if life >= plan.lives() {
                return;
            }
            let outcome = plan.live(life);
            outcomes.lock().push((life, outcome));
            progress.inc(1);
        }
    };
    thread::scope(|scope| (0..threads.min(plan.lives())).for_each(|_| drop(scope.spawn(work))));
    progress.finish_and_clear();
    let mut outcomes = outcomes.into_inner();
    outcomes.sort_unstable_by_key(|(life, _)| *life);
    outcomes.into_iter().map(|(_, outcome)| outcome).collect()
}

/// The charts as SVG, or with the tables as HTML, by the extension of the file.
fn picture(path: &Path, report: &Report) -> String {
    let svg = evaluate::picture(report);
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("html")) {
        return svg;
    }
    let (seed, tables) = (report.seed, tables(report).replace('&', "&amp;").replace('<', "&lt;"));
    format!(
        "<!doctype html>\n<meta charset=\"utf-8\">\n<title>pointsd evaluate, seed {seed}</title>\n{svg}\n<pre>{tables}</pre>\n"
    )
}

fn tables(report: &Report) -> String {
    let mut sections = vec![format!("Seed {}", report.seed)];
    if !report.healthy.is_empty() {
        sections.push(format!("Healthy machines\n{}", healthy_table(report)));
    }
    for depth in [Depth::Parameter, Depth::Trace] {
        let table = rows_table(report, depth);
        if !table.is_empty() {
            let depth = depth.as_ref();
            sections.push(format!("Faults at {depth} depth: lives named right, throws from onset to name\n{table}"));
        }
    }
    if !report.budget.is_empty() {
        sections.push(format!("False-alarm budget, with limits of size that stop no alarm\n{}", budget_table(report)));
    }
    sections.join("\n\n")
}

fn healthy_table(report: &Report) -> Table {
    let mut table =
        output::plain_table(["depth", "fleet", "throws", "false alarms", "not monitored", "paper", "CUSUM"]);
    for healthy in &report.healthy {
        let counts = [
            healthy.throws,
            healthy.false_alarms,
            healthy.not_monitored,
            healthy.paper_false_alarms,
            healthy.cusum_false_alarms,
        ];
        let texts = [healthy.depth.as_ref(), healthy.fleet.unwrap_or("usual")].map(str::to_owned);
        table.add_row([texts.to_vec(), counts.map(|n| n.to_string()).to_vec()].concat());
    }
    output::numbers(table, 2)
}

fn rows_table(report: &Report, depth: Depth) -> Table {
    let header = "case,cause,shape,noise,size %,lives,right %,wrong,critical,ambig.,missed,delay,p95,interval %,\
                  forecast %,paper %,wrong,CUSUM %,wrong";
    let mut table = output::plain_table(header.split(','));
    for row in report.rows.iter().filter(|row| row.depth == depth) {
        table.add_row(row_cells(row));
    }
    output::numbers(table, 4)
}

fn row_cells(row: &Row) -> Vec<Cell> {
    let share = |tally: &Tally| format!("{:.1}", 100.0 * tally.right as f64 / row.trials as f64);
    let delay = |delay: Option<f64>| delay.map_or_else(|| "-".to_owned(), |throws| format!("{throws:.0}"));
    let monitor = &row.monitor;
    let texts = [row.case, &row.cause, row.shape.as_ref(), row.noise.as_ref()];
    let mut cells: Vec<Cell> = texts.into_iter().map(Cell::new).collect();
    cells.push(Cell::new(row.size_pct));
    cells.push(Cell::new(row.trials));
    let mark = if row.shortfalls().is_empty() { "" } else { "! " };
    cells.push(Cell::new(format!("{mark}{}", share(monitor))));
    cells.extend([monitor.wrong, row.wrong_critical, monitor.ambiguous, monitor.missed].map(Cell::new));
    cells.extend([monitor.delay_median, monitor.delay_p95].map(|throws| Cell::new(delay(throws))));
    let coverage = |share: Option<f64>| share.map_or_else(|| "-".to_owned(), |share| format!("{:.1}", 100.0 * share));
    cells.extend([row.size_coverage, row.forecast_coverage].map(|share| Cell::new(coverage(share))));
    for comparator in [&row.paper, &row.cusum] {
        cells.extend([Cell::new(share(comparator)), Cell::new(comparator.wrong)]);
    }
    cells
}

fn budget_table(report: &Report) -> Table {
    let mut table = output::plain_table(["phi", "throws", "alarms", "expected", "measured / configured"]);
    for budget in &report.budget {
        let expected = budget.throws as f64 / budget.throws_per_false_alarm;
        table.add_row([
            format!("{}", budget.phi),
            budget.throws.to_string(),
            budget.false_alarms.to_string(),
            format!("{expected:.0}"),
            format!("{:.2}", budget.ratio),
        ]);
    }
    output::numbers(table, 0)
}
