//! `/metrics`: counters and states of the daemon in the text format of Prometheus, version 0.0.4.
//!
//! The number of values of each label is bounded: causes, severities, reasons of rejection, states of the disk.
//! Machines have series of their own only in fleets of up to `web.machine_metrics` machines.

use std::{
    collections::BTreeMap,
    fmt::{Display, Write as _},
    sync::Arc,
    time::Duration,
};

use axum::{
    extract::State,
    http::header,
    response::{IntoResponse, Response},
};
use strum::VariantArray as _;
use tokio::time;

use super::overview::{Overview, Web};
use crate::{
    daemon::{StatusReport, TaskName, View},
    diagnose::{Cause, MachineState, Severity},
    store::{DiskLevel, Dropped, FleetQuery, FleetRow},
};

/// Time limit for each of the two reads of the database. If the first read fails, the response has only the counters of
/// the daemon. If the second read fails, the response has no values for single machines.
const LIMIT: Duration = Duration::from_secs(2);

type Labels<'a, const N: usize> = [(&'static str, &'a str); N];

/// The text of a response.
#[derive(Default)]
struct Text(String);

impl Text {
    /// Appends a family: its comments, also if it has no series, and a line for each series.
    fn family<'a, const N: usize>(
        &mut self,
        kind: &str,
        (name, help): (&str, &str),
        series: impl IntoIterator<Item = (Labels<'a, N>, impl Display)>,
    ) {
        let text = &mut self.0;
        let _ = writeln!(text, "# HELP pointsd_{name} {help}.\n# TYPE pointsd_{name} {kind}");
        for (labels, value) in series {
            let _ = write!(text, "pointsd_{name}");
            for (at, (label, value)) in labels.iter().enumerate() {
                let before = if at == 0 { '{' } else { ',' };
                let _ = write!(text, "{before}{label}=\"{}\"", escaped(value));
            }
            let _ = writeln!(text, "{} {value}", if N > 0 { "}" } else { "" });
        }
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) {
        self.family("counter", (name, help), [([], value)]);
    }

    fn gauge(&mut self, name: &str, help: &str, value: u64) {
        self.family("gauge", (name, help), [([], value)]);
    }
}

/// The value of a label, escaped for its quotation marks.
fn escaped(value: &str) -> String {
    value.replace('\\', r"\\").replace('"', "\\\"").replace('\n', r"\n")
}

pub(super) async fn page(State(web): State<Arc<Web>>) -> Response {
    let mut text = Text::default();
    let report = web.view.report();
    throws(&mut text, &web.view, &report);
    daemon(&mut text, &report);
    if let Ok(Ok(overview)) = time::timeout(LIMIT, web.overview()).await {
        database(&mut text, &overview);
        alarms(&mut text, &overview);
        let (limit, total) = (web.view.config().web.machine_metrics, overview.tally.total());
        let rows = if total <= u64::from(limit) { machine_rows(&web, limit).await } else { None };
        let help = "Machines without series of their own: more than web.machine_metrics, or their read took too long";
        text.gauge("machines_omitted", help, if rows.is_some() { 0 } else { total });
        if let Some(rows) = rows {
            machines(&mut text, &rows);
        }
    }
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text.0).into_response()
}

/// The rows of up to `limit` machines; `None` without an answer of the database in time.
async fn machine_rows(web: &Web, limit: u32) -> Option<Vec<FleetRow>> {
    let read = async {
        let _permit = web.read_permit().await?;
        let query = FleetQuery { limit, ..FleetQuery::default() };
        web.reader().fleet(&query, &web.view.config().monitor.as_machine()).await
    };
    time::timeout(LIMIT, read).await.ok()?.ok()
}

/// Appends the series of each machine.
fn machines(text: &mut Text, rows: &[FleetRow]) {
    fn labels(row: &FleetRow) -> Labels<'_, 2> {
        [("site", row.machine.site.as_str()), ("machine", row.machine.machine.as_str())]
    }
    fn with<'a>(row: &'a FleetRow, label: &'static str, value: &'a str) -> Labels<'a, 3> {
        let [site, machine] = labels(row);
        [site, machine, (label, value)]
    }
    let states = rows.iter().map(|row| (with(row, "state", row.state.as_str()), 1));
    text.family("gauge", ("machine_state", "1 for the present state of the machine"), states);
    let last = rows.iter().filter_map(|row| Some((labels(row), row.started_at?.as_second())));
    let help = "Start of the last judged throw of the machine";
    text.family("gauge", ("machine_last_throw_timestamp_seconds", help), last);
    let drifts = || rows.iter().flat_map(|row| row.drifts.iter().map(move |drift| (row, drift)));
    let changes = drifts().map(|(row, drift)| (with(row, "cause", drift.cause.as_str()), drift.change_pct));
    let help = "Present change from the baseline, for each active drift";
    text.family("gauge", ("machine_drift_percent", help), changes);
    let forecasts = drifts()
        .filter_map(|(row, drift)| Some((with(row, "cause", drift.cause.as_str()), drift.limit_in_throws?.mid)));
    let help = "Estimated throws until the drift reaches its critical limit";
    text.family("gauge", ("machine_throws_to_limit", help), forecasts);
}

fn throws(text: &mut Text, view: &View, report: &StatusReport) {
    for (name, help, value) in [
        ("throws_received_total", "Messages received on the keys of throws", report.received),
        ("throws_stored_total", "Throws stored", report.stored),
        ("throws_judged_total", "Throws identified and diagnosed", report.judged),
        ("throws_duplicate_total", "Throws received again after they were stored", report.duplicates),
        ("replies_ignored_total", "Replies of loggers that did not match the query", report.ignored),
        ("messages_quarantined_total", "Messages that are not a valid throw", report.quarantined),
        ("messages_dropped_total", "Messages dropped because the queue was full", report.dropped),
        ("messages_lost_total", "Messages received that could not be stored", report.lost),
        (
            "machines_refused_total",
            "Throws of new machines refused above subscribe.max_machines",
            report.machines_refused,
        ),
        ("alarm_events_total", "Alarm events", report.alarm_events),
        ("alarm_events_lost_total", "Alarm events that the database rejected", report.alarm_events_lost),
        ("webhook_refused_total", "Alarm events that the receiver of the webhook refused", report.webhook_refused),
        ("messages_published_total", "Messages published", report.published),
        (
            "messages_unpublished_total",
            "Health messages dropped because the publishing queue was full",
            report.unpublished,
        ),
    ] {
        text.counter(name, help, value);
    }
    let rejected = view.status.rejected();
    let rejected = rejected.iter().map(|(reason, number)| ([("reason", reason.as_str())], number));
    text.family("counter", ("throws_not_evaluated_total", "Judged throws that were rejected, by reason"), rejected);
    text.gauge("throws_backlog", "Throws still in the backlogs of their loggers", report.backlog);
    let inbox = view.status.inbox.queued_bytes() as u64;
    text.gauge("inbox_bytes", "Memory of received messages not stored yet", inbox);
}

fn database(text: &mut Text, overview: &Overview) {
    let statistics = &overview.statistics;
    for (name, help, value) in [
        ("throws_waiting", "Throws stored and not judged yet", statistics.pending),
        ("outbox_messages", "Alarm events not published yet", statistics.outbox),
        ("webhook_pending", "Alarm events that the webhook has not accepted yet", statistics.notifications),
        ("throws_missing", "Throw numbers in gaps", statistics.missing_throws),
        ("throws_kept", "Throws in the database", statistics.throws),
        ("traces_kept", "Throws in the database with their trace", statistics.traces),
        ("machines", "Machines with any state or throw", overview.tally.total()),
        ("database_bytes", "Data in the database", statistics.data_bytes),
        ("wal_bytes", "Write-ahead log of the database", statistics.wal_bytes),
    ] {
        text.gauge(name, help, value);
    }
    if let Some(free) = statistics.free_disk_bytes {
        text.gauge("disk_free_bytes", "Free space on the disk of the database", free);
    }
    let counters = statistics.counters();
    let dropped = Dropped::VARIANTS
        .iter()
        .map(|kind| ([("kind", kind.as_ref())], counters.get(&kind.counter()).copied().unwrap_or(0)));
    let help = "Rows dropped to keep the database within its bounds, since its creation";
    text.family("counter", ("dropped_total", help), dropped);
    text.counter("failed_writes_total", "Write transactions that failed", statistics.failed_writes);
}

fn daemon(text: &mut Text, report: &StatusReport) {
    text.family("gauge", ("build_info", "Version of the program"), [([("version", report.version.as_str())], 1)]);
    text.gauge("uptime_seconds", "Time since the daemon started", report.uptime_s);
    text.gauge("connected", "Whether zenoh has a link", report.connected.into());
    text.gauge("loggers", "Loggers that are connected", report.loggers as u64);
    let states =
        MachineState::VARIANTS.iter().map(|state| ([("state", state.as_str())], report.fleet_counts.count(*state)));
    text.family("gauge", ("machine_states", "Machines in each state"), states);
    text.gauge("alarms_shelved", "Open alarms that are shelved", report.fleet_counts.shelved_alarms);
    let levels = DiskLevel::VARIANTS.iter().map(|level| ([("state", level.as_ref())], u8::from(report.disk == *level)));
    text.family("gauge", ("disk_state", "1 for the present state of the disk"), levels);
    let is_silent = |task: &TaskName| report.silent.iter().any(|silent| silent == task.as_ref());
    let beats = TaskName::VARIANTS.iter().map(|task| ([("loop", task.as_ref())], u8::from(!is_silent(task))));
    text.family("gauge", ("loop_alive", "Whether the heartbeat of a loop of the daemon is fresh"), beats);
}

fn alarms(text: &mut Text, overview: &Overview) {
    let mut counts = BTreeMap::new();
    for cause in Cause::VARIANTS {
        for severity in [Severity::Warning, Severity::Critical] {
            counts.insert((cause.as_str(), severity.as_str()), [0; 2]);
        }
    }
    for count in &overview.alarms_by_kind {
        counts.insert((&count.cause, &count.severity), [count.open, count.active]);
    }
    for (at, name, help) in [
        (0, "alarms_open", "Open alarms, by cause and severity"),
        (1, "alarms_active", "Open alarms that are neither over, shelved nor in maintenance, by cause and severity"),
    ] {
        let series =
            counts.iter().map(|((cause, severity), counts)| ([("cause", *cause), ("severity", *severity)], counts[at]));
        text.family("gauge", (name, help), series);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_quoted_and_a_family_without_series_has_its_comments() {
        let mut text = Text::default();
        text.family("gauge", ("odd", "Odd"), [([("a", "\\ \" \n"), ("b", "")], 1.5)]);
        text.family("counter", ("none", "None"), [([("a", ""); 1], 0); 0]);
        let expected = "# HELP pointsd_odd Odd.\n# TYPE pointsd_odd gauge\npointsd_odd{a=\"\\\\ \\\" \\n\",b=\"\"} 1.5\n\
                        # HELP pointsd_none None.\n# TYPE pointsd_none counter\n";
        assert_eq!(text.0, expected);
    }
}
