//! `/metrics`: the daemon's counts as `OpenMetrics` text, for Prometheus.
//!
//! Label sets are bounded by the program: causes and severities of alarms, reasons of refusal, states of the disk. None
//! grows with the fleet.

use std::{sync::Arc, time::Duration};

use axum::{
    extract::State,
    http::{HeaderValue, StatusCode, header},
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
use tokio::time;

use super::{Web, overview::Overview, page};
use crate::{
    daemon::{Organ, StatusReport, View},
    diagnose::{Cause, Severity},
};

const KIND: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// What the disk may be, as in the status.
const DISK_STATES: [&str; 4] = ["ok", "low", "full", "failing"];

type Labels<const N: usize> = [(&'static str, String); N];

/// Longest wait for the database: what the daemon itself counts is told without it.
const LIMIT: Duration = Duration::from_secs(2);

pub(super) async fn page(State(web): State<Arc<Web>>) -> Response {
    let mut registry = Registry::with_prefix("pointsd");
    throws(&mut registry, &web.view);
    daemon(&mut registry, &web.view.report());
    if let Ok(Ok(overview)) = time::timeout(LIMIT, web.overview()).await {
        database(&mut registry, &overview);
        alarms(&mut registry, &overview);
    }
    let mut text = String::new();
    match encode(&mut text, &registry) {
        Ok(()) => ([(header::CONTENT_TYPE, HeaderValue::from_static(KIND))], text).into_response(),
        Err(error) => {
            page::text(StatusCode::INTERNAL_SERVER_ERROR, format!("the metrics cannot be written: {error}\n"))
        }
    }
}

fn throws(registry: &mut Registry, view: &View) {
    let report = view.report();
    for (name, help, value) in [
        ("throws_received", "Messages that arrived on the keys of throws", report.received),
        ("throws_stored", "Throws that were stored", report.stored),
        ("throws_judged", "Throws that were identified and diagnosed", report.judged),
        ("throws_duplicate", "Throws that were stored before", report.duplicates),
        ("throws_missed", "Throws that were missed beyond recovery", report.missed),
        ("messages_quarantined", "Messages that were no throw, or could not be kept as one", report.quarantined),
        ("messages_dropped", "Messages that were dropped because too many waited to be stored", report.dropped),
        ("messages_lost", "Messages that arrived and could not be kept at all", report.lost),
        ("alarm_events", "Events in the life of alarms", report.alarm_events),
        ("messages_published", "Messages that were published", report.published),
        (
            "messages_unpublished",
            "Messages about health that were dropped because nobody took them in time",
            report.unpublished,
        ),
    ] {
        registry.register(name, help, ConstCounter::new(value));
    }
    let refused = Family::<Labels<1>, Counter>::default();
    for (reason, number) in view.refused() {
        refused.get_or_create(&[("reason", reason)]).inc_by(number);
    }
    registry.register("throws_not_evaluated", "Judged throws that gave no estimate, by reason", refused);
    let behind = ConstGauge::new(report.behind.cast_signed());
    registry.register("throws_behind", "Throws that are still in the caches of their loggers", behind);
    gauge(
        registry,
        "inbox",
        "Room taken by messages that arrived and wait to be stored",
        Unit::Bytes,
        view.queued_bytes() as u64,
    );
}

fn database(registry: &mut Registry, overview: &Overview) {
    let statistics = &overview.statistics;
    for (name, help, value) in [
        ("throws_waiting", "Stored throws that wait to be judged", statistics.pending),
        ("outbox_messages", "Alarm events that wait to be published", statistics.outbox),
        ("throws_missing", "Throws that were made and never came", statistics.missing_throws),
        ("throws_kept", "Throws in the database", statistics.throws),
        ("traces_kept", "Throws in the database whose traces are kept", statistics.traces),
        ("machines", "Machines that were ever heard", overview.machines),
    ] {
        registry.register(name, help, ConstGauge::new(value.cast_signed()));
    }
    gauge(registry, "database", "Data in the database", Unit::Bytes, statistics.data_bytes);
    gauge(registry, "wal", "The database's write-ahead log", Unit::Bytes, statistics.wal_bytes);
    if let Some(free) = statistics.free_disk_bytes {
        gauge(registry, "disk_free", "Free space on the disk of the database", Unit::Bytes, free);
    }
    let failed = ConstCounter::new(statistics.failed_writes);
    registry.register("failed_writes", "Write transactions that failed", failed);
}

fn daemon(registry: &mut Registry, report: &StatusReport) {
    let build = Info::new([("version", report.version.clone())]);
    registry.register("build", "The program", build);
    gauge(registry, "uptime", "Time since the daemon started", Unit::Seconds, report.uptime_s);
    let connected = ConstGauge::new(i64::from(report.connected));
    registry.register("connected", "Whether a link to others is up", connected);
    let loggers = ConstGauge::new(i64::try_from(report.loggers).unwrap_or(i64::MAX));
    registry.register("loggers", "Loggers that are connected", loggers);
    let disk = Family::<Labels<1>, Gauge>::default();
    for state in DISK_STATES {
        disk.get_or_create(&[("state", state.to_owned())]).set(i64::from(report.disk == state));
    }
    registry.register("disk_state", "1 for the state in which the disk is", disk);
    let beats = Family::<Labels<1>, Gauge>::default();
    for organ in Organ::ALL {
        let silent = report.silent.iter().any(|silent| silent == organ.as_str());
        beats.get_or_create(&[("loop", organ.as_str().to_owned())]).set(i64::from(!silent));
    }
    registry.register("loop_alive", "Whether a loop of the daemon beats", beats);
}

fn alarms(registry: &mut Registry, overview: &Overview) {
    let open = Family::<Labels<2>, Gauge>::default();
    let cell = |cause: &str, severity: &str| [("cause", cause.to_owned()), ("severity", severity.to_owned())];
    for cause in Cause::ALL {
        for severity in [Severity::Warning, Severity::Critical] {
            open.get_or_create(&cell(cause.as_str(), severity.as_str())).set(0);
        }
    }
    for (cause, severity, number) in &overview.alarms_by_kind {
        open.get_or_create(&cell(cause, severity)).set(number.cast_signed());
    }
    registry.register("alarms_open", "Alarms that are not back to normal", open);
}

fn gauge(registry: &mut Registry, name: &str, help: &str, unit: Unit, value: u64) {
    registry.register_with_unit(name, help, unit, ConstGauge::new(value.cast_signed()));
}
