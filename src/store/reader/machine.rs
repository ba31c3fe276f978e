//! Queries of the pages of a machine and of a throw; each reads a bounded number of rows by an index.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::{FromRow, Row, sqlite::SqliteRow};

use super::{Reader, machine_query};
use crate::{
    diagnose::{BaselineRecord, Cause, Present},
    store::{
        error::StoreError,
        rows::{StoredThrow, ThrowRow, json, time, word},
        statements as sql,
    },
    throw::{Direction, MachineId, ThrowRef, utc},
    wire::{Alarm, Health},
};

/// An applied command of an operator.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct CommandRow {
    /// Time of the command.
    pub at: Timestamp,
    /// Name of the command, for example `ack`.
    pub command: String,
    /// Cause of the alarm, for commands about an alarm.
    pub cause: Option<Cause>,
    /// End of the shelving or of the maintenance window.
    pub until: Option<Timestamp>,
    /// Name of the operator.
    pub by: String,
    /// Reason given by the operator.
    pub why: Option<String>,
}

/// Selects throws of a machine in one direction, at most the given number.
#[derive(Debug, Clone, Copy)]
pub(crate) enum ThrowSelection {
    /// The newest throws.
    Newest(u32),
    /// Throws spread evenly over the whole stored history.
    Spread(u32),
    /// The last throws up to this time, searched among four times as many throws of both directions.
    Until(Timestamp, u32),
}

impl FromRow<'_, SqliteRow> for Present {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self {
            state: word(row, "state")?.unwrap_or_default(),
            drifts: json(row, "drifts")?.unwrap_or_default(),
            caveats: json(row, "caveats")?.unwrap_or_default(),
        })
    }
}

impl FromRow<'_, SqliteRow> for CommandRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self {
            at: time(row, "at_us")?,
            command: row.try_get("command")?,
            cause: word(row, "cause")?,
            until: word(row, "until")?,
            by: row.try_get("by_whom")?,
            why: row.try_get("why")?,
        })
    }
}

impl Reader {
    /// Whether the database has a throw, an alarm or a monitor of a machine.
    pub(crate) async fn is_known(&self, machine: &MachineId) -> Result<bool, StoreError> {
        Ok(self.external_row(machine_query(sql::IS_KNOWN, machine)).await?.is_some_and(|(is_known,): (bool,)| is_known))
    }

    /// Throws of a machine in one direction, oldest first.
    pub(crate) async fn throws_in(
        &self,
        machine: &MachineId,
        direction: Direction,
        selection: ThrowSelection,
    ) -> Result<Vec<Health>, StoreError> {
        let of = |statement| machine_query(statement, machine).bind(direction.as_str());
        let query = match selection {
            ThrowSelection::Newest(limit) => of(sql::DIRECTION_NEWEST).bind(limit),
            ThrowSelection::Spread(limit) => of(sql::DIRECTION_SPREAD).bind(limit),
            ThrowSelection::Until(at, limit) => of(sql::DIRECTION_UNTIL).bind(limit).bind(at.as_microsecond()),
        };
        let mut rows = self.external(query).await?;
        rows.reverse();
        Ok(rows)
    }

    /// The newest `limit` judged throws of a machine, those of unknown direction too, newest first.
    pub(crate) async fn newest_throws_of(&self, machine: &MachineId, limit: u32) -> Result<Vec<Health>, StoreError> {
        self.external(machine_query(sql::MACHINE_NEWEST, machine).bind(limit)).await
    }

    /// The newest `limit` alarm events of a machine, of its newest `limit` alarms, newest first.
    pub(crate) async fn alarm_events_of(&self, machine: &MachineId, limit: u32) -> Result<Vec<Alarm>, StoreError> {
        self.external_alarms(machine_query(sql::MACHINE_ALARM_EVENTS, machine).bind(limit)).await
    }

    /// A throw of a machine with its health; the health is `None` while the throw is pending. `None` if the throw does
    /// not exist.
    pub(crate) async fn throw_of(
        &self,
        machine: &MachineId,
        throw: &ThrowRef,
    ) -> Result<Option<(StoredThrow, Option<Health>)>, StoreError> {
        // The throw does not exist: the database stores no larger numbers.
        let Ok(throw_no) = i64::try_from(throw.throw_no) else { return Ok(None) };
        let query = machine_query(sql::THROW_AT, machine).bind(throw.boot_id.as_str()).bind(throw_no);
        let Some(stored) = self.external_row::<StoredThrow>(query).await? else { return Ok(None) };
        let health = self.external_row(sqlx::query_as(sql::HEALTH_AT).bind(stored.row.0)).await?;
        Ok(Some((stored, health)))
    }

    /// Whether retention has deleted the throws of a boot up to this one; `None` for an unknown boot, as one whose throws
    /// are all deleted.
    pub(crate) async fn is_pruned(&self, machine: &MachineId, throw: &ThrowRef) -> Result<Option<bool>, StoreError> {
        let throw_no = i64::try_from(throw.throw_no).unwrap_or(i64::MAX);
        let query = machine_query(sql::IS_PRUNED, machine).bind(throw.boot_id.as_str()).bind(throw_no);
        Ok(self.external_row(query).await?.map(|(is_pruned,): (bool,)| is_pruned))
    }

    /// Resistance \[Ω\], back-EMF constant \[V s/rad\] and no-load speed \[rad/s\] of the motor in a throw, if known.
    pub(crate) async fn motor_of(&self, row: ThrowRow) -> Result<[Option<f64>; 3], StoreError> {
        let motor: Option<(Option<f64>, Option<f64>, Option<f64>)> =
            self.external_row(sqlx::query_as(sql::MOTOR_AT).bind(row.0)).await?;
        Ok(motor.map(Into::into).unwrap_or_default())
    }

    /// The newest `limit` commands for a machine, newest first.
    pub(crate) async fn commands_of(&self, machine: &MachineId, limit: u32) -> Result<Vec<CommandRow>, StoreError> {
        self.external(machine_query(sql::COMMANDS, machine).bind(limit)).await
    }

    /// The newest `limit` baselines of a machine, newest first.
    pub(crate) async fn baselines_of(
        &self,
        machine: &MachineId,
        limit: u32,
    ) -> Result<Vec<BaselineRecord>, StoreError> {
        let rows: Vec<(String,)> = self.external(machine_query(sql::BASELINES, machine).bind(limit)).await?;
        // Baselines of another version that cannot be read are left out.
        Ok(rows.iter().filter_map(|(payload,)| serde_json::from_str(payload).ok()).collect())
    }

    /// The state of a machine now, with its drifts and caveats. A retired machine has only a caveat that says so.
    pub(crate) async fn state_of(&self, machine: &MachineId) -> Result<Present, StoreError> {
        if let Some(present) = self.external_row(machine_query(sql::STATE, machine)).await? {
            return Ok(present);
        }
        // Without a monitor the last command may have retired the machine: its state alone would hide this.
        let last = self.commands_of(machine, 1).await?;
        let caveat = |command: &CommandRow| {
            let (at, by, why) = (utc(&command.at), &command.by, command.why.as_deref().unwrap_or_default());
            format!("Machine {machine}: it is not monitored, as it was retired at {at} by {by}: {why}.")
        };
        let caveats = last.iter().filter(|command| command.command == "retire").map(caveat).collect();
        Ok(Present { caveats, ..Present::default() })
    }

    /// The previous and the next throw of a machine, in the order of their start.
    pub(crate) async fn neighbours_of(
        &self,
        machine: &MachineId,
        throw: &ThrowRef,
    ) -> Result<[Option<ThrowRef>; 2], StoreError> {
        let statement = machine_query(sql::THROW_NEIGHBOURS, machine);
        let statement = statement.bind(throw.boot_id.as_str()).bind(throw.throw_no.cast_signed());
        let rows: Vec<(String, i64, bool)> = self.external(statement).await?;
        let mut neighbours = [None, None];
        for (boot_id, throw_no, is_later) in rows {
            neighbours[usize::from(is_later)] = Some(ThrowRef { boot_id, throw_no: throw_no.cast_unsigned() });
        }
        Ok(neighbours)
    }

    /// A typical throw of the baseline taken at `at`: the last good throw of the direction until then with a trace, or
    /// without a good one the last accepted one.
    pub(crate) async fn typical_of(
        &self,
        machine: &MachineId,
        direction: Direction,
        at: Timestamp,
    ) -> Result<Option<StoredThrow>, StoreError> {
        let statement = machine_query(sql::TYPICAL, machine).bind(direction.as_str()).bind(at.as_microsecond());
        self.external_row(statement).await
    }
}
