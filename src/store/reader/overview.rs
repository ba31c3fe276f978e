//! Queries of the dashboard; each reads a bounded number of rows by an index.

use jiff::Timestamp;

use super::{Reader, machine_query};
use crate::{
    store::{
        error::StoreError,
        rows::{StoredThrow, ThrowRow},
        statements as sql,
    },
    throw::{Direction, MachineId, ThrowRef},
    wire::{Alarm, Health},
};

/// Number of open alarms of one cause and severity.
#[derive(Debug, sqlx::FromRow)]
pub(crate) struct AlarmCount {
    pub(crate) cause: String,
    pub(crate) severity: String,
    pub(crate) open: i64,
    /// Number of these alarms that are neither over, nor shelved, nor in maintenance.
    pub(crate) active: i64,
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

impl Reader {
    /// Number of open alarms for each cause and severity.
    pub(crate) async fn open_alarms_by_kind(&self) -> Result<Vec<AlarmCount>, StoreError> {
        self.external(sqlx::query_as(sql::OPEN_ALARMS_BY_KIND)).await
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

    /// The newest `limit` throws of a machine, those of unknown direction too, newest first.
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
}
