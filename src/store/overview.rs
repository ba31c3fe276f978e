//! Queries of the dashboard; each reads a bounded number of rows by an index.

use jiff::Timestamp;

use super::{
    error::StoreError,
    reader::{Reader, about},
    rows::{StoredThrow, ThrowRow},
    statements as sql,
};
use crate::{
    throw::{Direction, MachineId, ThrowRef},
    wire::{Alarm, Health},
};

/// Number of open alarms of one cause and severity.
#[derive(Debug, sqlx::FromRow)]
pub(crate) struct AlarmCount {
    pub(crate) cause: String,
    pub(crate) severity: String,
    pub(crate) open: i64,
    /// Number of these that are neither over, shelved nor in maintenance.
    pub(crate) active: i64,
}

/// Up to so many throws of a machine in one direction.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Choice {
    /// The newest.
    Newest(u32),
    /// Spread evenly over all stored ones.
    Spread(u32),
    /// The last up to this time, among the last throws of both directions.
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
        choice: Choice,
    ) -> Result<Vec<Health>, StoreError> {
        let of = |statement| about(statement, machine).bind(direction.as_str());
        let query = match choice {
            Choice::Newest(limit) => of(sql::DIRECTION_NEWEST).bind(limit),
            Choice::Spread(limit) => of(sql::DIRECTION_SPREAD).bind(limit),
            Choice::Until(at, limit) => of(sql::DIRECTION_UNTIL).bind(limit).bind(at.as_microsecond()),
        };
        let mut rows = self.external(query).await?;
        rows.reverse();
        Ok(rows)
    }

    /// The newest `limit` throws of a machine, those of unknown direction too, newest first.
    pub(crate) async fn newest_throws_of(&self, machine: &MachineId, limit: u32) -> Result<Vec<Health>, StoreError> {
        self.external(about(sql::MACHINE_NEWEST, machine).bind(limit)).await
    }

    /// The newest `limit` alarm events of a machine, of its newest `limit` alarms, newest first.
    pub(crate) async fn alarm_events_of(&self, machine: &MachineId, limit: u32) -> Result<Vec<Alarm>, StoreError> {
        self.external_alarms(about(sql::MACHINE_ALARM_EVENTS, machine).bind(limit)).await
    }

    /// A throw of a machine with its health; the health is `None` while the throw is pending. `None` if the throw does
    /// not exist.
    pub(crate) async fn throw_of(
        &self,
        machine: &MachineId,
        throw: &ThrowRef,
    ) -> Result<Option<(StoredThrow, Option<Health>)>, StoreError> {
        // SQLite has no larger numbers, so the throw does not exist.
        let Ok(throw_no) = i64::try_from(throw.throw_no) else { return Ok(None) };
        let query = about(sql::THROW_AT, machine).bind(throw.boot_id.as_str()).bind(throw_no);
        let stored: Vec<StoredThrow> = self.external(query).await?;
        let Some(stored) = stored.into_iter().next() else { return Ok(None) };
        let health = self.external(sqlx::query_as(sql::HEALTH_AT).bind(stored.row.0)).await?;
        Ok(Some((stored, health.into_iter().next())))
    }

    /// Resistance \[Ω\], back-EMF constant \[V s/rad\] and no-load speed \[rad/s\] of the motor in a throw, as far as known.
    pub(crate) async fn motor_of(&self, row: ThrowRow) -> Result<[Option<f64>; 3], StoreError> {
        let rows: Vec<(Option<f64>, Option<f64>, Option<f64>)> =
            self.external(sqlx::query_as(sql::MOTOR_AT).bind(row.0)).await?;
        Ok(rows.into_iter().next().map(Into::into).unwrap_or_default())
    }
}
