//! `/metrics`: counters and states of the daemon for Prometheus, as `OpenMetrics` text. Readers that do not accept this
//! get the older text format of Prometheus.
//!
//! The number of values of each label is bounded: causes, severities, reasons of rejection, states of the disk.
//! Machines have series of their own only in fleets of up to `web.machine_metrics` machines.

use std::{
    collections::HashSet,
    fmt::Write as _,
    sync::{Arc, atomic::AtomicU64},
    time::Duration,
};

use axum::{
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use prometheus_client::{
    encoding::text::encode,
    metrics::{
        counter::{ConstCounter, Counter},
        family::Family,
        gauge::{ConstGauge, Gauge},
        info::Info,
    },
    registry::{Registry, Unit},
};
use strum::VariantArray as _;
use tokio::time;

use super::overview::{Overview, Web};
use crate::{
    daemon::{StatusReport, TaskName, View},
    diagnose::{Cause, MachineState, Severity},
    store::{DiskLevel, Dropped, FleetQuery, FleetRow},
};

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
const TEXT: &str = "text/plain; version=0.0.4; charset=utf-8";

type Labels<const N: usize> = [(&'static str, String); N];

/// Time limit for each of the two reads of the database. If the first read fails, the response has only the counters of
/// the daemon. If the second read fails, the response has no values for single machines.
const LIMIT: Duration = Duration::from_secs(2);

pub(super) async fn page(State(web): State<Arc<Web>>, headers: HeaderMap) -> Response {
    let mut registry = Registry::with_prefix("pointsd");
    let report = web.view.sources.report();
    throws(&mut registry, &web.view, &report);
    daemon(&mut registry, &report);
    if let Ok(Ok(overview)) = time::timeout(LIMIT, web.overview()).await {
        database(&mut registry, &overview);
        alarms(&mut registry, &overview);
        let (limit, total) = (web.view.config().web.machine_metrics, overview.tally.total());
        let rows = if total <= u64::from(limit) { machine_rows(&web, limit).await } else { None };
        let help = "Machines without series of their own: more than web.machine_metrics, or their read took too long";
        count(&mut registry, "machines_omitted", help, if rows.is_some() { 0 } else { total });
        if let Some(rows) = rows {
            machines(&mut registry, &rows);
        }
    }
    let mut text = String::new();
    if let Err(error) = encode(&mut text, &registry) {
        return (StatusCode::INTERNAL_SERVER_ERROR, format!("the metrics cannot be written: {error}\n"))
            .into_response();
    }
    let accept = headers.get(header::ACCEPT).and_then(|accept| accept.to_str().ok()).unwrap_or_default();
    let (kind, text) = if accept.contains("application/openmetrics-text") {
        (OPEN_METRICS, text)
    } else {
        (TEXT, prometheus_text(&text))
    };
    ([(header::CONTENT_TYPE, HeaderValue::from_static(kind))], text).into_response()
}

/// Converts `OpenMetrics` text to the older format. That has no units, no type `info` and no end mark, and its comments
/// name a counter with `_total`, as its samples do.
fn prometheus_text(open_metrics: &str) -> String {
    let of_kind = |kind: &'static str| {
        let types = open_metrics.lines().filter_map(|line| line.strip_prefix("# TYPE "));
        types.filter_map(move |it| it.strip_suffix(kind)?.strip_suffix(' ')).collect::<HashSet<_>>()
    };
    let (counters, infos) = (of_kind("counter"), of_kind("info"));
    let mut text = String::with_capacity(open_metrics.len());
    for line in open_metrics.lines() {
        let mut words = line.splitn(4, ' ');
        match (words.next(), words.next(), words.next(), words.next()) {
            (Some("#"), Some("UNIT" | "EOF"), ..) => continue,
            (Some("#"), Some(comment), Some(name), rest) => {
                let is_info = infos.contains(name);
                let end = if counters.contains(name) {
                    "_total"
                } else if is_info {
                    "_info"
                } else {
                    ""
                };
                let rest = rest.map(|rest| if is_info && comment == "TYPE" { "gauge" } else { rest });
                let _ = write!(text, "# {comment} {name}{end} {}", rest.unwrap_or_default());
            }
            _ => text.push_str(line),
        }
        text.push('\n');
    }
    text
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

/// Registers the series of each machine. Names of machines are valid labels: at most 64 characters of `A-Z a-z 0-9 _
/// -`.
fn machines(registry: &mut Registry, rows: &[FleetRow]) {
    let name = |row: &FleetRow| [("site", row.machine.site.to_string()), ("machine", row.machine.machine.to_string())];
    let with = |row: &FleetRow, label: &'static str, value: &str| {
        let [site, machine] = name(row);
        [site, machine, (label, value.to_owned())]
    };
    let state = Family::<Labels<3>, Gauge>::default();
    let last = Family::<Labels<2>, Gauge>::default();
    let drift = Family::<Labels<3>, Gauge<f64, AtomicU64>>::default();
    let limit = Family::<Labels<3>, Gauge<f64, AtomicU64>>::default();
    for row in rows {
        state.get_or_create(&with(row, "state", row.state.as_str())).set(1);
        if let Some(started_at) = row.started_at {
            last.get_or_create(&name(row)).set(started_at.as_second());
        }
        for now in &row.drifts {
            drift.get_or_create(&with(row, "cause", now.cause.as_str())).set(now.change_pct);
            if let Some(forecast) = now.limit_in_throws {
                limit.get_or_create(&with(row, "cause", now.cause.as_str())).set(forecast.mid);
            }
        }
    }
    registry.register("machine_state", "1 for the present state of the machine", state);
    let help = "Start of the last judged throw of the machine";
    registry.register_with_unit("machine_last_throw_timestamp", help, Unit::Seconds, last);
    registry.register("machine_drift_percent", "Present change from the baseline, for each active drift", drift);
    registry.register("machine_throws_to_limit", "Estimated throws until the drift reaches its critical limit", limit);
}

fn throws(registry: &mut Registry, view: &View, report: &StatusReport) {
    for (name, help, value) in [
        ("throws_received", "Messages received on the keys of throws", report.received),
        ("throws_stored", "Throws stored", report.stored),
        ("throws_judged", "Throws identified and diagnosed", report.judged),
        ("throws_duplicate", "Throws received again after they were stored", report.duplicates),
        ("replies_ignored", "Replies of loggers that did not match the query", report.ignored),
        ("messages_quarantined", "Messages that are not a valid throw", report.quarantined),
        ("messages_dropped", "Messages dropped because the queue was full", report.dropped),
        ("messages_lost", "Messages received that could not be stored", report.lost),
        ("machines_refused", "Throws of new machines refused above subscribe.max_machines", report.machines_refused),
        ("alarm_events", "Alarm events", report.alarm_events),
        ("alarm_events_lost", "Alarm events that the database rejected", report.alarm_events_lost),
        ("webhook_refused", "Alarm events that the receiver of the webhook refused", report.webhook_refused),
        ("messages_published", "Messages published", report.published),
        ("messages_unpublished", "Health messages dropped because the publishing queue was full", report.unpublished),
    ] {
        registry.register(name, help, ConstCounter::new(value));
    }
    let rejected = Family::<Labels<1>, Counter>::default();
    for (reason, number) in view.sources.status.rejected() {
        rejected.get_or_create(&[("reason", reason)]).inc_by(number);
    }
    registry.register("throws_not_evaluated", "Judged throws that were rejected, by reason", rejected);
    count(registry, "throws_backlog", "Throws still in the backlogs of their loggers", report.backlog);
    let inbox = view.sources.inbox.queued_bytes() as u64;
    gauge(registry, "inbox", "Memory of received messages not stored yet", Unit::Bytes, inbox);
}

fn database(registry: &mut Registry, overview: &Overview) {
    let statistics = &overview.statistics;
    for (name, help, value) in [
        ("throws_waiting", "Throws stored and not judged yet", statistics.pending),
        ("outbox_messages", "Alarm events not published yet", statistics.outbox),
        ("webhook_pending", "Alarm events that the webhook has not accepted yet", statistics.notifications),
        ("throws_missing", "Throw numbers in gaps", statistics.missing_throws),
        ("throws_kept", "Throws in the database", statistics.throws),
        ("traces_kept", "Throws in the database with their trace", statistics.traces),
        ("machines", "Machines with any state or throw", overview.tally.total()),
    ] {
        count(registry, name, help, value);
    }
    gauge(registry, "database", "Data in the database", Unit::Bytes, statistics.data_bytes);
    gauge(registry, "wal", "Write-ahead log of the database", Unit::Bytes, statistics.wal_bytes);
    if let Some(free) = statistics.free_disk_bytes {
        gauge(registry, "disk_free", "Free space on the disk of the database", Unit::Bytes, free);
    }
    let dropped = Family::<Labels<1>, Counter>::default();
    let counters = statistics.counters();
    for kind in Dropped::VARIANTS {
        let rows = counters.get(&kind.counter()).copied().unwrap_or(0);
        dropped.get_or_create(&[("kind", kind.as_ref().to_owned())]).inc_by(rows);
    }
    registry.register("dropped", "Rows dropped to keep the database within its bounds, since its creation", dropped);
    let failed = ConstCounter::new(statistics.failed_writes);
    registry.register("failed_writes", "Write transactions that failed", failed);
}

fn daemon(registry: &mut Registry, report: &StatusReport) {
    let build = Info::new([("version", report.version.clone())]);
    registry.register("build", "Version of the program", build);
    gauge(registry, "uptime", "Time since the daemon started", Unit::Seconds, report.uptime_s);
    count(registry, "connected", "Whether zenoh has a link", report.connected.into());
    count(registry, "loggers", "Loggers that are connected", report.loggers as u64);
    let states = MachineState::VARIANTS.iter().map(|state| (state.as_str(), report.fleet_counts.count(*state)));
    counts(registry, "machine_states", "Machines in each state", "state", states);
    count(registry, "alarms_shelved", "Open alarms that are shelved", report.fleet_counts.shelved_alarms);
    let levels = DiskLevel::VARIANTS.iter().map(|level| (level.as_ref(), u64::from(report.disk == *level)));
    counts(registry, "disk_state", "1 for the present state of the disk", "state", levels);
    let is_silent = |task: &TaskName| report.silent.iter().any(|silent| silent == task.as_ref());
    let beats = TaskName::VARIANTS.iter().map(|task| (task.as_ref(), u64::from(!is_silent(task))));
    counts(registry, "loop_alive", "Whether the heartbeat of a loop of the daemon is fresh", "loop", beats);
}

fn alarms(registry: &mut Registry, overview: &Overview) {
    let [open, active] = [(); 2].map(|()| Family::<Labels<2>, Gauge>::default());
    let cell = |cause: &str, severity: &str| [("cause", cause.to_owned()), ("severity", severity.to_owned())];
    for cause in Cause::VARIANTS {
        for severity in [Severity::Warning, Severity::Critical] {
            for alarms in [&open, &active] {
                alarms.get_or_create(&cell(cause.as_str(), severity.as_str())).set(0);
            }
        }
    }
    for count in &overview.alarms_by_kind {
        open.get_or_create(&cell(&count.cause, &count.severity)).set(count.open);
        active.get_or_create(&cell(&count.cause, &count.severity)).set(count.active);
    }
    registry.register("alarms_open", "Open alarms, by cause and severity", open);
    let help = "Open alarms that are neither over, shelved nor in maintenance, by cause and severity";
    registry.register("alarms_active", help, active);
}

/// Registers a gauge without unit.
fn count(registry: &mut Registry, name: &str, help: &str, value: u64) {
    registry.register(name, help, ConstGauge::new(value.cast_signed()));
}

/// Registers a gauge with one label.
fn counts<'a>(
    registry: &mut Registry,
    name: &str,
    help: &str,
    label: &'static str,
    values: impl Iterator<Item = (&'a str, u64)>,
) {
    let family = Family::<Labels<1>, Gauge>::default();
    for (word, value) in values {
        family.get_or_create(&[(label, word.to_owned())]).set(value.cast_signed());
    }
    registry.register(name, help, family);
}

/// Registers a gauge with a unit.
fn gauge(registry: &mut Registry, name: &str, help: &str, unit: Unit, value: u64) {
    registry.register_with_unit(name, help, unit, ConstGauge::new(value.cast_signed()));
}
