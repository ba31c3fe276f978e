//! `pointsd replay`: runs stored throws with other settings, and compares the alarms.

use std::{
    cmp::Ordering,
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use anyhow::anyhow;
use jiff::Timestamp;
use serde::Serialize;

use super::{Exit, Failure, Outcome, ResultExt as _, database, output, runtime};
use crate::{
    daemon::{
        Offline,
        config::{Config, Document},
    },
    diagnose::{Cause, Severity},
    store::{Reader, Selector, StoreError, ThrowRow, beside},
    throw::{MachineId, counted},
    wire::{Alarm, BaselineProgress},
};

/// Runs stored throws again with a changed configuration, into a new database, and shows which alarms differ. The old
/// database is only read; its daemon may run.
///
/// The throws come from the database of the configuration, or from `--from`. Commands of operators are not repeated.
/// Alarms about silent loggers and lost throws do not depend on throws and are not compared. Throws whose trace was
/// removed to save space cannot be run again; their number is shown. The baselines of their machines then come from the
/// throws that are left, and their alarms from the time before these baselines are complete are not compared, unless
/// the new database has them too; their number is shown as well.
///
/// Exit codes: 0 replayed; 65 the database has no throw that can be run again, is of another version, or is no database
/// of pointsd; 66 there is no database, or it cannot be opened; 73 the new database exists already; 74 a database
/// cannot be used; 78 the configuration is invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd replay --config stricter.toml\n  pointsd replay --config stricter.toml \
                        --from /var/lib/pointsd/points.db --into /tmp/stricter.db --json")]
pub(super) struct Arguments {
    /// The changed configuration. The files that it names for the webhook and zenoh are not read.
    #[arg(long, value_name = "NEW")]
    config: PathBuf,
    /// The database with the stored throws [default: that of the configuration].
    #[arg(long, value_name = "FILE")]
    from: Option<PathBuf>,
    /// The new database [default: name of the old one with `.replay` added].
    #[arg(long, value_name = "FILE")]
    into: Option<PathBuf>,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// An occurrence of an alarm: its first event, with the highest severity of all its events.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Occurrence {
    raised_at: Timestamp,
    throw_no: Option<u64>,
    severity: Severity,
}

/// Machine and cause of an alarm.
type Named = (MachineId, Cause);

/// The n-th occurrence of an alarm in both databases; `None` in the database that does not have it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct Comparison {
    #[serde(flatten)]
    machine: MachineId,
    cause: Cause,
    before: Option<Occurrence>,
    after: Option<Occurrence>,
    difference: &'static str,
}

#[derive(Debug, Serialize)]
struct Report {
    throws: u64,
    without_trace: u64,
    database: PathBuf,
    /// Number of alarms that are not compared, as the baselines were not complete yet when they were raised.
    not_replayed: usize,
    /// Number of alarms of both databases that are not compared, as no throw raised them.
    not_compared: usize,
    alarms: Vec<Comparison>,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let document = Document::read(&arguments.config).or_exit(Exit::Config)?;
    let mut config = Config::offline(&document).or_exit(Exit::Config)?;
    let from = arguments.from.clone().unwrap_or_else(|| config.store.path.clone());
    let into = arguments.into.clone().unwrap_or_else(|| beside(&from, ".replay"));
    require(from.exists(), Exit::NoInput, || format!("no database at {}; name one with --from FILE", from.display()))?;
    require(!into.exists(), Exit::CannotCreate, || {
        format!("{} exists already; remove it, or name another with --into FILE", into.display())
    })?;
    config.store.path.clone_from(&into);
    runtime::block_on(async {
        let old = Reader::open_outside(&from).await.map_err(database::unreadable)?;
        // Checked before the new database is created, so that an error leaves no file behind.
        let order = old.judged_order().await.or_exit(Exit::Io)?;
        require(!order.is_empty(), Exit::Data, || format!("{} has no throws: nothing to run", from.display()))?;
        let mut new = Offline::open(config).await?;
        let replayed = replay(&old, &order, &mut new).await.or_exit(Exit::Io)?;
        new.close().await.or_exit(Exit::Io)?;
        let new = Reader::open(&into).await.or_exit(Exit::Io)?;
        let report = compare(&old, &new, replayed, into).await?;
        output::result(arguments.json, &report, || sentences(&report))?;
        Ok(Exit::Ok)
    })
}

fn require(right: bool, exit: Exit, problem: impl FnOnce() -> String) -> Result<(), Failure> {
    if right { Ok(()) } else { Err(Failure::new(exit, anyhow!(problem()))) }
}

struct Replayed {
    throws: u64,
    without_trace: u64,
    /// Start of the earliest throw with a trace.
    since: Option<Timestamp>,
    /// Machines of which a throw was left out.
    incomplete: BTreeSet<MachineId>,
}

/// Runs all throws in `old` that have a trace through `new`, in their `order`: throws from a backlog were received after
/// later ones, but judged before them.
async fn replay(old: &Reader, order: &[ThrowRow], new: &mut Offline) -> Result<Replayed, StoreError> {
    let template = "{wide_bar} {human_pos} of {human_len} throws, {eta} left";
    let progress = output::progress(order.len() as u64, template);
    let mut replayed = Replayed { throws: 0, without_trace: 0, since: None, incomplete: BTreeSet::new() };
    for row in order {
        progress.inc(1);
        // Retention may have deleted the throw in the meantime.
        let Some(stored) = old.stored(*row).await? else { continue };
        let Ok(throw) = stored.throw else {
            replayed.without_trace += 1;
            replayed.incomplete.insert(stored.machine);
            continue;
        };
        new.take(&stored.machine, &throw, stored.received_at).await?;
        replayed.throws += 1;
        replayed.since = Some(replayed.since.map_or(stored.started_at, |since| since.min(stored.started_at)));
    }
    new.judge().await?;
    progress.finish_and_clear();
    Ok(replayed)
}

async fn compare(old: &Reader, new: &Reader, replayed: Replayed, into: PathBuf) -> Result<Report, Failure> {
    let Some(since) = replayed.since else {
        let count = replayed.without_trace;
        return Err(anyhow!("the traces of all {count} stored throws were removed: nothing to run"))
            .or_exit(Exit::Data);
    };
    let mut lists: BTreeMap<_, [Vec<Occurrence>; 2]> = BTreeMap::new();
    let mut not_compared = 0;
    for (at, database) in [old, new].into_iter().enumerate() {
        let (compared, others) = occurrences(database, since).await?;
        not_compared += others;
        for (alarm, occurrence) in compared {
            let list = &mut lists.entry(alarm).or_default()[at];
            match list.iter_mut().find(|known| known.raised_at == occurrence.raised_at) {
                Some(known) => known.severity = known.severity.max(occurrence.severity),
                None => list.push(occurrence),
            }
        }
    }
    let Replayed { throws, without_trace, incomplete, .. } = replayed;
    let mut not_replayed = 0;
    for ((machine, _), [before, after]) in &mut lists {
        if before.len() > after.len() && incomplete.contains(machine) {
            let learned_at = learned_at(new, machine).await.or_exit(Exit::Io)?;
            let is_early = |alarm: &&Occurrence| learned_at.is_none_or(|learned_at| alarm.raised_at <= learned_at);
            let early = before.iter().take(before.len() - after.len()).take_while(is_early).count();
            before.drain(..early);
            not_replayed += early;
        }
    }
    let alarms = lists.into_iter().flat_map(pairs).collect();
    Ok(Report { throws, without_trace, database: into, not_replayed, not_compared, alarms })
}

/// Start of the last throw of the baselines of a machine; `None` while a baseline is not complete.
async fn learned_at(new: &Reader, machine: &MachineId) -> Result<Option<Timestamp>, StoreError> {
    let latest = new.latest_health(&machine.into()).await?;
    let mut throws = latest.iter().filter(|throw| throw.direction.is_some());
    let are_complete = throws.all(|throw| throw.baseline.is_some_and(BaselineProgress::is_complete));
    let baselines = new.baselines_of(machine, u32::MAX).await?;
    Ok(baselines.iter().map(|baseline| baseline.taken_at).max().filter(|_| are_complete))
}

/// The events of the alarms that were raised at `since` or later, in order. [`compare`] merges the events of one
/// occurrence. Alarms about lost data are left out, and alarms about machines not monitored that no throw raised; the
/// second value is their number.
async fn occurrences(database: &Reader, since: Timestamp) -> Result<(Vec<(Named, Occurrence)>, usize), Failure> {
    let mut rows = database.alarm_history(&Selector::default(), since, u32::MAX).await.or_exit(Exit::Io)?;
    // The first event of an alarm that a throw raised names this throw.
    let of_throw = |alarm: &Alarm| alarm.last_throw.is_some() && alarm.event_no == 1;
    let of_throws: BTreeSet<_> =
        rows.iter().filter(|alarm| of_throw(alarm)).map(|alarm| alarm.alarm_id.clone()).collect();
    rows.retain(|alarm| alarm.raised_at >= since);
    let (rows, others): (Vec<Alarm>, Vec<Alarm>) = rows.into_iter().partition(|alarm| match alarm.cause {
        Cause::DataLoss => false,
        Cause::NotMonitored => of_throws.contains(&alarm.alarm_id),
        _ => true,
    });
    let others: BTreeSet<_> = others.into_iter().map(|alarm| alarm.alarm_id).collect();
    let occurrence = |alarm: Alarm| {
        let throw_no = alarm.last_throw.as_ref().map(|throw| throw.throw_no);
        let occurrence = Occurrence { raised_at: alarm.raised_at, throw_no, severity: alarm.severity };
        ((alarm.machine.clone(), alarm.cause), occurrence)
    };
    Ok((rows.into_iter().map(occurrence).collect(), others.len()))
}

/// Compares the n-th occurrences of one alarm for each n.
fn pairs(((machine, cause), [before, after]): (Named, [Vec<Occurrence>; 2])) -> Vec<Comparison> {
    let count = before.len().max(after.len());
    let (mut before, mut after) = (before.into_iter(), after.into_iter());
    let pair = |_| {
        let (before, after) = (before.next(), after.next());
        let difference = difference(before.as_ref(), after.as_ref());
        Comparison { machine: machine.clone(), cause, before, after, difference }
    };
    (0..count).map(pair).collect()
}

/// The difference of the time, of the severity, or of both, in words.
fn difference(before: Option<&Occurrence>, after: Option<&Occurrence>) -> &'static str {
    let (Some(before), Some(after)) = (before, after) else {
        return if before.is_some() { "gone" } else { "new" };
    };
    match (after.raised_at.cmp(&before.raised_at), after.severity.cmp(&before.severity)) {
        (Ordering::Equal, Ordering::Equal) => "same",
        (Ordering::Equal, Ordering::Less) => "milder",
        (Ordering::Equal, Ordering::Greater) => "more severe",
        (Ordering::Less, Ordering::Equal) => "earlier",
        (Ordering::Less, Ordering::Less) => "earlier, milder",
        (Ordering::Less, Ordering::Greater) => "earlier, more severe",
        (Ordering::Greater, Ordering::Equal) => "later",
        (Ordering::Greater, Ordering::Less) => "later, milder",
        (Ordering::Greater, Ordering::Greater) => "later, more severe",
    }
}

fn sentences(report: &Report) -> String {
    let mut lines = vec![format!("{} run again into {}", counted(report.throws, "throw"), report.database.display())];
    if report.without_trace > 0 {
        lines.push(format!("left out, as the trace was removed: {}", counted(report.without_trace, "stored throw")));
    }
    if report.not_replayed > 0 {
        let alarms = counted(report.not_replayed, "alarm");
        lines.push(format!("not compared, as the baselines were not complete at that time: {alarms}"));
    }
    if report.not_compared > 0 {
        let alarms = counted(report.not_compared, "alarm");
        lines.push(format!("not compared, as no throw raised them (data_loss, not_monitored): {alarms}"));
    }
    if report.alarms.is_empty() {
        let other = if report.not_replayed + report.not_compared > 0 { "other " } else { "" };
        lines.push(format!("no {other}alarms in either database"));
        return lines.join("\n");
    }
    let mut table = output::plain_table(["machine", "cause", "before", "now", "difference"]);
    for alarm in &report.alarms {
        table.add_row([
            alarm.machine.to_string(),
            alarm.cause.to_string(),
            words(alarm.before.as_ref()),
            words(alarm.after.as_ref()),
            alarm.difference.to_owned(),
        ]);
    }
    lines.push(table.to_string());
    lines.join("\n")
}

fn words(occurrence: Option<&Occurrence>) -> String {
    let Some(occurrence) = occurrence else { return "-".to_owned() };
    let throw = occurrence.throw_no.map_or_else(String::new, |throw_no| format!(", throw {throw_no}"));
    format!("{}, {}{throw}", occurrence.severity.as_str(), occurrence.raised_at)
}
