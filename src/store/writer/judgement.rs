//! Writes of a judged throw, of an operator's command, and of a tick (the daemon's periodic check of a machine), each
//! in a single transaction.

use std::sync::Arc;

use jiff::Timestamp;
use sqlx::{Row as _, Sqlite, SqliteConnection, query::Query, sqlite::SqliteArguments};

use super::{batch, spool::machine_row, write::Write};
use crate::{
    diagnose::{AlarmEvent, BaselineRecord, Command, MachineState, Present},
    estimate::{Estimate, Identification},
    store::{
        rows::{Gap, ThrowRow},
        statements as sql,
    },
    throw::{Direction, MachineId},
    wire::{Alarm, Health, Kind, json, machine_key},
};

/// Number of operators' commands kept: a hundred a day for ten years, 100 MB. The daemon accepts at most 14,400 a day.
pub const COMMANDS_KEPT: u32 = 500_000;

/// Number of events kept of an alarm besides its first event: the last ones.
const EVENTS_KEPT: u32 = 1_000;

/// The result of judging one throw.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// Row of the throw.
    pub row: ThrowRow,
    /// Health of the throw, as published.
    pub health: Health,
    /// The result of the estimator; `None` when the stored trace could not be read.
    pub identification: Option<Identification>,
    /// Baselines that became usable or complete with this throw.
    pub baselines: Vec<BaselineRecord>,
    /// The alarm events of this throw, and the monitor after it.
    pub outcome: Outcome,
}

/// A change of the monitor of a machine, by a throw, a command or a tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The machine.
    pub machine: MachineId,
    /// Time of the change.
    pub at: Timestamp,
    /// Monitor after the change; `None` if it did not change, or if a later outcome of the same transaction has it.
    pub monitor: Option<MonitorRecord>,
    /// Alarm events in order; each is added to the history and to the outbox, once.
    pub events: Vec<AlarmEvent>,
    /// Gaps that were reported to the monitor.
    pub reported_gaps: Vec<Gap>,
    /// Command of an operator that caused the change.
    pub command: Option<Command>,
}

/// The stored form of a monitor.
#[derive(Debug, Clone, PartialEq)]
pub struct MonitorRecord {
    /// Snapshot of the monitor as JSON.
    pub snapshot: String,
    /// State, drifts and caveats of the machine, for queries.
    pub present: Present,
}

impl Judgement {
    /// Two replacements for a judgement that the database rejects; in both the throw counts as not evaluated. The first
    /// one keeps the events and the monitor. The second one, in case the database rejects the first, keeps nothing.
    pub fn instead(&self, problem: &str) -> [Self; 2] {
        let Health { machine, throw, started_at, .. } = self.health.clone();
        let detail = format!("the database rejects the result: {problem}");
        let health = Health {
            direction: self.health.direction,
            state: self.health.state,
            caveats: self.health.caveats.clone(),
            baseline: self.health.baseline,
            throws_since_baseline: self.health.throws_since_baseline,
            ..Health::rejected(machine, throw, started_at, NOT_STORABLE, Some(detail))
        };
        let outcome = Outcome { command: None, ..self.outcome.clone() };
        let nothing = Outcome { monitor: None, events: Vec::new(), reported_gaps: Vec::new(), ..outcome.clone() };
        [outcome, nothing].map(|outcome| Self {
            row: self.row,
            health: health.clone(),
            identification: None,
            baselines: Vec::new(),
            outcome,
        })
    }
}

/// `quality` of a throw whose judgement the database rejects.
const NOT_STORABLE: &str = "not_storable";

type BoundStatement<'q> = Query<'q, Sqlite, SqliteArguments>;

impl MonitorRecord {
    fn bind<'q>(&'q self, query: BoundStatement<'q>) -> BoundStatement<'q> {
        let Present { state, drifts, caveats } = &self.present;
        query
            .bind(&self.snapshot)
            .bind(state.as_str())
            .bind((!drifts.is_empty()).then(|| json(drifts)))
            .bind((!caveats.is_empty()).then(|| json(caveats)))
    }
}

impl Write for Arc<[Judgement]> {
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<()> {
        for judgements in self.chunks(batch::MAX_ROWS) {
            if Judgement::write_all(connection, judgements).await? {
                continue;
            }
            for judgement in judgements {
                if !Judgement::write_all(connection, std::slice::from_ref(judgement)).await? {
                    judgement.write_late(connection).await?;
                }
            }
        }
        Ok(())
    }
}

impl Judgement {
    /// Writes judgements; false, without writing, if one of the throws was judged before.
    async fn write_all(connection: &mut SqliteConnection, judgements: &[Self]) -> sqlx::Result<bool> {
        let mut pending = batch::query(sql::PENDING_AMONG, judgements.len());
        let mut judge = batch::query(sql::SET_JUDGED, judgements.len());
        let mut estimates = batch::query(sql::ADD_ESTIMATES, judgements.len());
        let mut monitors = batch::query(sql::SET_MONITORS_OF, judgements.len());
        for judgement in judgements {
            let (row, at_us) = (judgement.row.0, judgement.outcome.at.as_microsecond());
            pending = pending.bind(row);
            judge = judge.bind(row).bind(at_us);
            estimates = judgement.bind_estimate(estimates.bind(row));
            if let Some(monitor) = &judgement.outcome.monitor {
                monitors = monitor.bind(monitors.bind(row).bind(at_us));
            }
        }
        let pending: i64 = pending.fetch_one(&mut *connection).await?.try_get(0)?;
        if usize::try_from(pending) != Ok(judgements.len()) {
            return Ok(false);
        }
        for statement in [judge, estimates, monitors] {
            statement.execute(&mut *connection).await?;
        }
        for judgement in judgements {
            if !(judgement.baselines.is_empty() && judgement.outcome.has_only_a_monitor()) {
                judgement.write_rare(connection).await?;
            }
        }
        Ok(true)
    }

    /// Writes the baselines and the events, which only few throws have.
    async fn write_rare(&self, connection: &mut SqliteConnection) -> sqlx::Result<()> {
        let machine_row = sqlx::query_scalar(sql::MACHINE_OF).bind(self.row.0).fetch_one(&mut *connection).await?;
        self.write_baselines(connection, machine_row).await?;
        self.outcome.write_events(connection, machine_row).await
    }

    async fn write_baselines(&self, connection: &mut SqliteConnection, machine_row: i64) -> sqlx::Result<()> {
        for baseline in &self.baselines {
            sqlx::query(sql::ADD_BASELINE)
                .bind(machine_row)
                .bind(baseline.direction.as_str())
                .bind(baseline.taken_at.as_microsecond())
                .bind(json(baseline))
                .execute(&mut *connection)
                .await?;
        }
        Ok(())
    }

    /// Handles a throw that is not pending any more. If it was judged before, nothing is written. If retention deleted it
    /// after it was read, writes the outcome and the baselines: they are in the monitor in memory, and would never be
    /// stored otherwise.
    async fn write_late(&self, connection: &mut SqliteConnection) -> sqlx::Result<()> {
        let stored: Option<i64> =
            sqlx::query_scalar(sql::MACHINE_OF).bind(self.row.0).fetch_optional(&mut *connection).await?;
        if stored.is_none() {
            let machine_row = machine_row(connection, &self.outcome.machine).await?;
            self.write_baselines(connection, machine_row).await?;
            self.outcome.write(connection).await?;
        }
        Ok(())
    }

    fn bind_estimate<'q>(&'q self, query: BoundStatement<'q>) -> BoundStatement<'q> {
        let (health, found) = (&self.health, self.identification.as_ref());
        let features = found.map(|found| found.features.clone()).unwrap_or_default();
        let estimate: Option<&Estimate> = found.and_then(|found| found.outcome.as_ref().ok());
        let mut add = query
            .bind(health.direction.map(Direction::as_str))
            .bind(found.is_some_and(|found| found.direction_contradicted == Some(true)))
            .bind(&health.quality)
            .bind(&health.detail);
        for three in [health.coefficients, health.sd, health.change_pct] {
            for at in 0..3 {
                add = add.bind(three.map(|three| three[at]));
            }
        }
        for (row, column) in [(0, 1), (0, 2), (1, 2)] {
            add = add.bind(estimate.map(|estimate| estimate.total_covariance()[(row, column)]));
        }
        add.bind(health.fit_pct)
            .bind(health.a1_per_b0)
            .bind(health.a1_per_b0_sd)
            .bind(health.a0_per_b0)
            .bind(health.a0_per_b0_sd)
            .bind(estimate.and_then(|estimate| i64::try_from(estimate.fit?.iterations).ok()))
            .bind(estimate.map(|estimate| estimate.start_s))
            .bind(estimate.map(|estimate| estimate.end_s))
            .bind(health.duration_s)
            .bind(health.peak_current_a)
            .bind(health.mean_current_a)
            .bind(features.charge_as)
            .bind(features.travel_mm)
            .bind(features.end_position_mm)
            .bind(features.release_s)
            .bind(features.running_current_a)
            .bind(features.energy_j)
            .bind(features.quiet_current_a)
            .bind(features.start_position_mm)
            .bind(features.resistance_ohm)
            .bind(features.back_emf_v_s_per_rad)
            .bind(features.no_load_speed_rad_per_s)
            .bind(features.start_delay_s)
            .bind(features.start_gain)
            .bind(health.baseline.map(|baseline| baseline.so_far.cast_signed()))
            .bind(health.baseline.map(|baseline| baseline.needed.cast_signed()))
            .bind(health.throws_since_baseline.cast_signed())
            .bind(health.state.map(MachineState::as_str))
            .bind(health.drift.as_ref().map(json))
    }
}

impl Write for Arc<[Outcome]> {
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<()> {
        for outcome in &**self {
            outcome.write(connection).await?;
        }
        Ok(())
    }
}

impl Outcome {
    async fn write(&self, connection: &mut SqliteConnection) -> sqlx::Result<()> {
        let machine_row = machine_row(connection, &self.machine).await?;
        if let Some(monitor) = &self.monitor {
            let set = sqlx::query(sql::SET_MONITOR).bind(machine_row).bind(self.at.as_microsecond());
            monitor.bind(set).execute(&mut *connection).await?;
        }
        self.write_events(connection, machine_row).await
    }

    fn has_only_a_monitor(&self) -> bool {
        self.events.is_empty() && self.reported_gaps.is_empty() && self.command.is_none()
    }

    /// Writes the outcome without the monitor.
    async fn write_events(&self, connection: &mut SqliteConnection, machine_row: i64) -> sqlx::Result<()> {
        let at_us = self.at.as_microsecond();
        for Gap { row, refused, .. } in &self.reported_gaps {
            let report = sqlx::query(sql::REPORT_GAP).bind(row).bind(at_us).bind(refused.cast_signed());
            report.execute(&mut *connection).await?;
        }
        if let Some(command) = &self.command {
            add_command(connection, machine_row, command, at_us).await?;
            let effect = match command {
                Command::Rebaseline { .. } => Some(sql::RESTART_BASELINES),
                Command::Retire { .. } => Some(sql::RETIRE),
                _ => None,
            };
            if let Some(effect) = effect {
                sqlx::query(effect).bind(machine_row).bind(at_us).execute(&mut *connection).await?;
            }
        }
        for event in &self.events {
            let alarm = Alarm::new(&self.machine, event);
            // If an earlier attempt was committed although it returned an error, the event exists already.
            if add_alarm_event(connection, machine_row, &alarm, at_us).await? {
                let key = machine_key(&self.machine, Kind::Alarm);
                let add = sqlx::query(sql::ADD_MESSAGE).bind(key).bind(alarm.into_message()).bind(at_us);
                add.execute(&mut *connection).await?;
            }
        }
        Ok(())
    }
}

async fn add_command(
    connection: &mut SqliteConnection,
    machine_row: i64,
    command: &Command,
    at_us: i64,
) -> sqlx::Result<()> {
    sqlx::query(sql::ADD_COMMAND)
        .bind(machine_row)
        .bind(at_us)
        .bind(command.name())
        .bind(command.by())
        .bind(command.why())
        .bind(json(command))
        .execute(&mut *connection)
        .await?;
    sqlx::query(sql::TRIM_COMMANDS).bind(COMMANDS_KEPT).execute(connection).await.map(drop)
}

/// Adds an event unless it exists already; returns whether it was added.
async fn add_alarm_event(
    connection: &mut SqliteConnection,
    machine_row: i64,
    alarm: &Alarm,
    at_us: i64,
) -> sqlx::Result<bool> {
    sqlx::query(sql::ADD_ALARM)
        .bind(&alarm.alarm_id)
        .bind(machine_row)
        .bind(alarm.cause.as_str())
        .bind(alarm.raised_at.as_microsecond())
        .bind(alarm.event_no)
        .bind(alarm.state.as_str())
        .execute(&mut *connection)
        .await?;
    let added = sqlx::query(sql::ADD_ALARM_EVENT)
        .bind(&alarm.alarm_id)
        .bind(alarm.event_no)
        .bind(alarm.event_at.as_microsecond())
        .bind(alarm.severity.as_str())
        .bind(alarm.state.as_str())
        .bind(json(alarm))
        .bind(at_us.max(alarm.event_at.as_microsecond()))
        .execute(&mut *connection)
        .await?;
    if alarm.event_no > EVENTS_KEPT {
        let trim = sqlx::query(sql::TRIM_ALARM_EVENTS).bind(&alarm.alarm_id).bind(alarm.event_no).bind(EVENTS_KEPT);
        trim.execute(&mut *connection).await?;
    }
    let set = sqlx::query(sql::SET_ALARM).bind(&alarm.alarm_id).bind(alarm.event_no).bind(alarm.state.as_str());
    set.execute(connection).await?;
    Ok(added.rows_affected() > 0)
}
