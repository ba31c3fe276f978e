//! One judged throw, one operator's command, one tick: everything that follows from it in a single transaction.

use std::sync::Arc;

use jiff::Timestamp;
use serde::Serialize;
use sqlx::SqliteConnection;

use super::{
    spool::{GapRow, ThrowRow, count, machine_row},
    statements as sql,
    writer::Write,
};
use crate::{
    diagnose::{AlarmEvent, Command},
    estimate::Identification,
    throw::{Direction, MachineId},
    wire::{GOOD, alarm_id},
};

/// Operators' commands that are kept, the newest: thirty a day for ten years.
const COMMANDS: i64 = 100_000;

/// What is known after a throw was identified and diagnosed.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The throw.
    pub row: ThrowRow,
    /// Its machine.
    pub machine: MachineId,
    /// When it was judged.
    pub judged_at: Timestamp,
    /// What the estimator found; `None` when the stored trace could not be read.
    pub identification: Option<Identification>,
    /// [`GOOD`], or the code of why the throw was not evaluated.
    pub quality: String,
    /// The same as a sentence, where it was not evaluated.
    pub detail: Option<String>,
    /// Change of b0, a1, a0 from the baseline \[%\].
    pub change_pct: Option<[f64; 3]>,
    /// Throws in this direction's baseline so far, of how many.
    pub baseline: Option<(usize, usize)>,
    /// Baselines that were completed by this throw.
    pub baselines: Vec<BaselineRecord>,
    /// The monitor after this throw, its alarms and messages.
    pub outcome: Outcome,
}

/// What changed in a machine's monitor.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outcome {
    /// The whole monitor as JSON; `None` leaves the stored one.
    pub snapshot: Option<String>,
    /// Alarm events, in order.
    pub alarms: Vec<AlarmRecord>,
    /// Messages to be published, in order. Repeating the write adds none twice.
    pub outbox: Vec<Message>,
    /// Gaps that the monitor knows of from now on.
    pub told_gaps: Vec<GapRow>,
    /// The operator's command that all this follows from.
    pub command: Option<Command>,
}

/// An alarm event, with the message that tells the world.
#[derive(Debug, Clone, PartialEq)]
pub struct AlarmRecord {
    /// The event with its evidence.
    pub event: AlarmEvent,
    /// The message as published, JSON.
    pub payload: String,
}

/// A message to be published.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// The key expression it goes to.
    pub key: String,
    /// Its payload.
    pub payload: Vec<u8>,
}

/// A baseline, kept for the history: the diagnosis itself goes on from its snapshot.
#[derive(Debug, Clone, PartialEq)]
pub struct BaselineRecord {
    /// The direction.
    pub direction: Direction,
    /// Throws in it.
    pub throws: usize,
    /// Robust centre of b0 \[rad s⁻² A⁻¹\], a1 \[s⁻¹\], a0 \[s⁻²\].
    pub centre: [f64; 3],
    /// Everything else of it, JSON.
    pub details: String,
    /// Who asked for it; `None` when it was taken by itself.
    pub by: Option<String>,
    /// Why.
    pub why: Option<String>,
}

/// The word of an enum in messages and in the database.
fn word<T: Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        other => format!("{other:?}"),
    }
}

/// Judgements to be written, in their order.
pub(super) struct Judge {
    pub(super) judgements: Arc<[Judgement]>,
    /// Space is short: the traces have done their work and go.
    pub(super) drop_traces: bool,
}

impl Write for Judge {
    /// Of each, whether it was written; false when its throw was judged before.
    type Output = Vec<bool>;

    async fn run(&self, connection: &mut SqliteConnection, repeated: bool) -> sqlx::Result<Vec<bool>> {
        let mut written = Vec::with_capacity(self.judgements.len());
        for judgement in &*self.judgements {
            written.push(judgement.write(connection, self.drop_traces, repeated).await?);
        }
        Ok(written)
    }
}

impl Judgement {
    /// False when the throw was judged before; then nothing was written.
    async fn write(&self, connection: &mut SqliteConnection, drop_trace: bool, repeated: bool) -> sqlx::Result<bool> {
        let at_us = self.judged_at.as_microsecond();
        let machine_row: Option<i64> =
            sqlx::query_scalar(sql::JUDGED).bind(self.row.0).bind(at_us).fetch_optional(&mut *connection).await?;
        let Some(machine_row) = machine_row else {
            return self.was_written_at(connection, repeated, at_us).await;
        };
        self.add_estimate(connection, machine_row).await?;
        for baseline in &self.baselines {
            add_baseline(connection, machine_row, baseline, at_us).await?;
        }
        add_outcome(connection, machine_row, &self.machine, &self.outcome, at_us).await?;
        if drop_trace {
            sqlx::query(sql::DROP_TRACE).bind(self.row.0).execute(&mut *connection).await?;
            count(connection, "dropped_traces", 1).await?;
        }
        Ok(true)
    }

    /// Whether the throw was judged by an earlier attempt of this very write.
    async fn was_written_at(
        &self,
        connection: &mut SqliteConnection,
        repeated: bool,
        at_us: i64,
    ) -> sqlx::Result<bool> {
        let judged_at_us: Option<i64> =
            sqlx::query_scalar(sql::JUDGED_AT).bind(self.row.0).fetch_optional(connection).await?.flatten();
        Ok(repeated && judged_at_us == Some(at_us))
    }

    async fn add_estimate(&self, connection: &mut SqliteConnection, machine_row: i64) -> sqlx::Result<()> {
        let found = self.identification.as_ref();
        let direction = found.and_then(|found| found.direction).map(Direction::as_str);
        let since_baseline = self.throws_since_baseline(connection, machine_row, direction).await?;
        let features = found.map(|found| found.features.clone()).unwrap_or_default();
        let estimate = found.and_then(|found| found.outcome.as_ref().ok());
        let covariance = |row, column| estimate.map(|estimate| estimate.covariance[(row, column)]);
        let sd = |at| covariance(at, at).map(f64::sqrt);
        let change = |at: usize| self.change_pct.map(|change| change[at]);
        sqlx::query(sql::ADD_ESTIMATE)
            .bind(self.row.0)
            .bind(machine_row)
            .bind(direction)
            .bind(found.is_some_and(|found| found.direction_contradicted))
            .bind(&self.quality)
            .bind(&self.detail)
            .bind(estimate.map(|estimate| estimate.b0))
            .bind(estimate.map(|estimate| estimate.a1))
            .bind(estimate.map(|estimate| estimate.a0))
            .bind(sd(0))
            .bind(sd(1))
            .bind(sd(2))
            .bind(covariance(0, 1))
            .bind(covariance(0, 2))
            .bind(covariance(1, 2))
            .bind(change(0))
            .bind(change(1))
            .bind(change(2))
            .bind(estimate.map(|estimate| estimate.fit_pct))
            .bind(estimate.map(|estimate| integer(estimate.iterations)))
            .bind(estimate.map(|estimate| estimate.start_s))
            .bind(estimate.map(|estimate| estimate.end_s))
            .bind(features.duration_s)
            .bind(features.peak_current_a)
            .bind(features.mean_current_a)
            .bind(features.charge_as)
            .bind(features.travel_mm)
            .bind(features.end_position_mm)
            .bind(self.baseline.map(|(so_far, _)| integer(so_far)))
            .bind(self.baseline.map(|(_, needed)| integer(needed)))
            .bind(since_baseline)
            .execute(connection)
            .await
            .map(drop)
    }

    /// Good throws since this direction's baseline was complete: counted on from the throw before.
    async fn throws_since_baseline(
        &self,
        connection: &mut SqliteConnection,
        machine_row: i64,
        direction: Option<&str>,
    ) -> sqlx::Result<i64> {
        if self.baseline.is_some_and(|(so_far, needed)| so_far < needed) {
            return Ok(0);
        }
        let before: Option<i64> = sqlx::query_scalar(sql::SINCE_BASELINE)
            .bind(machine_row)
            .bind(direction)
            .bind(self.row.0)
            .fetch_optional(connection)
            .await?;
        Ok(before.unwrap_or(0) + i64::from(self.quality == GOOD && self.baseline.is_some()))
    }
}

/// What follows from an operator's command or from time passing.
pub(super) struct Record {
    pub(super) machine: MachineId,
    pub(super) at_us: i64,
    pub(super) outcome: Outcome,
}

impl Write for Record {
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<()> {
        let (machine_row, _) = machine_row(connection, &self.machine).await?;
        add_outcome(connection, machine_row, &self.machine, &self.outcome, self.at_us).await
    }
}

fn integer(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

async fn add_baseline(
    connection: &mut SqliteConnection,
    machine_row: i64,
    baseline: &BaselineRecord,
    at_us: i64,
) -> sqlx::Result<()> {
    let [b0, a1, a0] = baseline.centre;
    sqlx::query(sql::ADD_BASELINE)
        .bind(machine_row)
        .bind(baseline.direction.as_str())
        .bind(at_us)
        .bind(integer(baseline.throws))
        .bind(b0)
        .bind(a1)
        .bind(a0)
        .bind(&baseline.details)
        .bind(&baseline.by)
        .bind(&baseline.why)
        .execute(connection)
        .await
        .map(drop)
}

async fn add_outcome(
    connection: &mut SqliteConnection,
    machine_row: i64,
    machine: &MachineId,
    outcome: &Outcome,
    at_us: i64,
) -> sqlx::Result<()> {
    if let Some(snapshot) = &outcome.snapshot {
        sqlx::query(sql::SET_MONITOR).bind(machine_row).bind(snapshot).bind(at_us).execute(&mut *connection).await?;
    }
    for GapRow(gap_row) in &outcome.told_gaps {
        sqlx::query(sql::TELL_GAP).bind(gap_row).bind(at_us).execute(&mut *connection).await?;
    }
    if let Some(command) = &outcome.command {
        add_command(connection, machine_row, command, at_us).await?;
    }
    let mut news = outcome.alarms.is_empty();
    for record in &outcome.alarms {
        news |= add_alarm_event(connection, machine_row, machine, record).await?;
    }
    if news {
        for message in &outcome.outbox {
            let add = sqlx::query(sql::ADD_MESSAGE).bind(&message.key).bind(&message.payload).bind(at_us);
            add.execute(&mut *connection).await?;
        }
    }
    Ok(())
}

async fn add_command(
    connection: &mut SqliteConnection,
    machine_row: i64,
    command: &Command,
    at_us: i64,
) -> sqlx::Result<()> {
    // Words into memory: nothing in it can fail.
    let payload = serde_json::to_value(command).unwrap_or_default();
    sqlx::query(sql::ADD_COMMAND)
        .bind(machine_row)
        .bind(at_us)
        .bind(payload["command"].as_str())
        .bind(command.by())
        .bind(command.why())
        .bind(payload.to_string())
        .execute(&mut *connection)
        .await?;
    sqlx::query(sql::TRIM_COMMANDS).bind(COMMANDS).execute(connection).await.map(drop)
}

/// Returns whether the event was not there before.
async fn add_alarm_event(
    connection: &mut SqliteConnection,
    machine_row: i64,
    machine: &MachineId,
    AlarmRecord { event, payload }: &AlarmRecord,
) -> sqlx::Result<bool> {
    let id = alarm_id(machine, event.cause, event.raised_at);
    let state = word(&event.state);
    sqlx::query(sql::ADD_ALARM)
        .bind(&id)
        .bind(machine_row)
        .bind(word(&event.cause))
        .bind(event.raised_at.as_microsecond())
        .bind(event.event_no)
        .bind(&state)
        .execute(&mut *connection)
        .await?;
    let no = |throw: &Option<crate::throw::ThrowRef>| throw.as_ref().map(|throw| throw.throw_no.cast_signed());
    let boot = |throw: &Option<crate::throw::ThrowRef>| throw.as_ref().map(|throw| throw.boot_id.clone());
    let added = sqlx::query(sql::ADD_ALARM_EVENT)
        .bind(&id)
        .bind(event.event_no)
        .bind(event.event_at.as_microsecond())
        .bind(word(&event.severity))
        .bind(&state)
        .bind(event.change_pct)
        .bind(event.change_pct_sd)
        .bind(event.direction.map(Direction::as_str))
        .bind(event.runner_up.map(|other| word(&other.cause)))
        .bind(event.runner_up.map(|other| other.margin))
        .bind(event.correlation.map(|correlation| correlation.b0_a1))
        .bind(event.correlation.map(|correlation| correlation.b0_a0))
        .bind(event.correlation.map(|correlation| correlation.a1_a0))
        .bind(boot(&event.first_throw))
        .bind(no(&event.first_throw))
        .bind(boot(&event.last_throw))
        .bind(no(&event.last_throw))
        .bind(event.limit_in_throws.map(|limit| limit.low))
        .bind(event.limit_in_throws.map(|limit| limit.mid))
        .bind(event.limit_in_throws.map(|limit| limit.high))
        .bind(&event.text)
        .bind(&event.by)
        .bind(&event.why)
        .bind(payload)
        .execute(&mut *connection)
        .await?;
    sqlx::query(sql::SET_ALARM).bind(&id).bind(event.event_no).bind(&state).execute(connection).await?;
    Ok(added.rows_affected() > 0)
}
