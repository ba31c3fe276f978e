//! What the dashboard reads: a bounded number of rows each, found by index, however long the history.

use super::{
    Reader,
    error::StoreError,
    reader::{AlarmColumns, AlarmRow, HealthColumns, HealthRow, StoredThrow, ThrowColumns},
    statements as sql,
};
use crate::throw::{Direction, MachineId, ThrowRef};

/// One event in the life of a machine's alarm.
#[derive(Debug, Clone, PartialEq, Eq, sqlx::FromRow)]
pub struct AlarmEventRow {
    /// The message as it was published, JSON.
    pub payload: String,
    /// Who acted, where somebody did.
    #[sqlx(rename = "by_whom")]
    pub by: Option<String>,
    /// Why.
    pub why: Option<String>,
}

impl Reader {
    /// The latest health of each direction of up to `machines` machines, those with the worst alarms first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn fleet_health(&self, machines: u32) -> Result<Vec<HealthRow>, StoreError> {
        self.asked(sqlx::query_as(sql::FLEET_HEALTH).bind(machines), HealthColumns::read).await
    }

    /// How many machines were ever heard, the daemon itself included where it had alarms.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn machine_count(&self) -> Result<u64, StoreError> {
        self.asked_figure(sql::MACHINE_COUNT).await
    }

    /// The last event of every open alarm of the same machines as [`fleet_health`](Self::fleet_health): at most one a
    /// cause each. Critical ones first, then the newest.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn fleet_alarms(&self, machines: u32) -> Result<Vec<AlarmRow>, StoreError> {
        self.asked(sqlx::query_as(sql::FLEET_ALARMS).bind(machines), AlarmColumns::read).await
    }

    /// The number of open alarms of each cause and severity that there is.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn open_alarms_by_kind(&self) -> Result<Vec<(String, String, u64)>, StoreError> {
        let read = |(cause, severity, count): (String, String, i64)| Ok((cause, severity, count.cast_unsigned()));
        self.asked(sqlx::query_as(sql::OPEN_ALARMS_BY_KIND), read).await
    }

    /// The newest `limit` throws of a machine in one direction, oldest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn newest_of(
        &self,
        machine: &MachineId,
        direction: Direction,
        limit: u32,
    ) -> Result<Vec<HealthRow>, StoreError> {
        self.way(sql::WAY_NEWEST, machine, direction, limit).await
    }

    /// Up to `limit` throws of a machine in one direction, spread evenly over all that are kept, oldest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn spread_of(
        &self,
        machine: &MachineId,
        direction: Direction,
        limit: u32,
    ) -> Result<Vec<HealthRow>, StoreError> {
        self.way(sql::WAY_SPREAD, machine, direction, limit).await
    }

    async fn way(
        &self,
        statement: &'static str,
        machine: &MachineId,
        direction: Direction,
        limit: u32,
    ) -> Result<Vec<HealthRow>, StoreError> {
        let query = sqlx::query_as(statement).bind(machine.site.as_str()).bind(machine.machine.as_str());
        let mut rows = self.asked(query.bind(direction.as_str()).bind(limit), HealthColumns::read).await?;
        rows.reverse();
        Ok(rows)
    }

    /// The newest `limit` throws of a machine, those of unknown direction too, newest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn newest_throws_of(&self, machine: &MachineId, limit: u32) -> Result<Vec<HealthRow>, StoreError> {
        let query = sqlx::query_as(sql::MACHINE_NEWEST).bind(machine.site.as_str()).bind(machine.machine.as_str());
        self.asked(query.bind(limit), HealthColumns::read).await
    }

    /// The newest `limit` alarm events of a machine, of its newest `limit` alarms, newest first.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn alarm_events_of(&self, machine: &MachineId, limit: u32) -> Result<Vec<AlarmEventRow>, StoreError> {
        let query = sqlx::query_as(sql::MACHINE_ALARM_EVENTS);
        self.asked(query.bind(machine.site.as_str()).bind(machine.machine.as_str()).bind(limit), Ok).await
    }

    /// One throw of a machine with what was made of it, which is `None` while it waits to be judged. `None` when there
    /// is no such throw.
    ///
    /// # Errors
    /// When the database cannot be read.
    pub async fn throw_of(
        &self,
        machine: &MachineId,
        throw: &ThrowRef,
    ) -> Result<Option<(StoredThrow, Option<HealthRow>)>, StoreError> {
        // SQLite has no larger numbers, so there is no such throw.
        let Ok(throw_no) = i64::try_from(throw.throw_no) else { return Ok(None) };
        let query = sqlx::query_as(sql::THROW_AT).bind(machine.site.as_str()).bind(machine.machine.as_str());
        let stored = self.asked(query.bind(throw.boot_id.as_str()).bind(throw_no), ThrowColumns::read).await?;
        let Some(stored) = stored.into_iter().next() else { return Ok(None) };
        let health = self.asked(sqlx::query_as(sql::HEALTH_AT).bind(stored.row.0), HealthColumns::read).await?;
        Ok(Some((stored, health.into_iter().next())))
    }
}
