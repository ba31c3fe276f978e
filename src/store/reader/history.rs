//! Answers to queries on zenoh: health and alarms, now or in the past.

use jiff::Timestamp;

use super::Reader;
use crate::{
    store::{error::StoreError, rows::Selector, statements as sql},
    wire::{Alarm, BaselineProgress, Health},
};

#[expect(clippy::missing_errors_doc, reason = "the documentation of `Reader` says when its methods fail")]
impl Reader {
    /// The latest health of each selected machine and direction, with the state of the machine now, and changes from
    /// its present baseline.
    pub async fn latest_health(&self, which: &Selector) -> Result<Vec<Health>, StoreError> {
        let query = sqlx::query_as(sql::LATEST_HEALTH).bind(&which.site).bind(&which.machine);
        let mut rows: Vec<Health> = self.external(query).await?;
        for health in &mut rows {
            // A new baseline without a throw began after this throw.
            health.change_pct = health.change_pct.filter(|_| health.baseline.is_none_or(BaselineProgress::has_begun));
        }
        Ok(rows)
    }

    /// The newest `limit` rows of the health history since `since`, oldest first. A time up to 1970 means no bound.
    pub async fn health_history(
        &self,
        which: &Selector,
        since: Timestamp,
        limit: u32,
    ) -> Result<Vec<Health>, StoreError> {
        let since_us = if since <= Timestamp::UNIX_EPOCH { i64::MIN } else { since.as_microsecond() };
        let query = if since_us == i64::MIN && *which == Selector::default() {
            sqlx::query_as(sql::NEWEST_HEALTH).bind(limit)
        } else {
            sqlx::query_as(sql::HEALTH_SINCE).bind(limit).bind(&which.site).bind(&which.machine).bind(since_us)
        };
        let mut rows = self.external(query).await?;
        rows.reverse();
        Ok(rows)
    }

    /// The last event of every open alarm of the selected machines, oldest alarm first.
    pub async fn open_alarms(&self, which: &Selector) -> Result<Vec<Alarm>, StoreError> {
        let query = sqlx::query_as(sql::OPEN_ALARMS).bind(&which.site).bind(&which.machine);
        self.external_alarms(query).await
    }

    /// The newest `limit` alarm events since `since`, oldest first.
    pub async fn alarm_history(
        &self,
        which: &Selector,
        since: Timestamp,
        limit: u32,
    ) -> Result<Vec<Alarm>, StoreError> {
        let of_machine = !which.machine.contains('*');
        let statement = if of_machine { sql::ALARM_HISTORY_OF_MACHINE } else { sql::ALARM_HISTORY };
        let query = sqlx::query_as(statement).bind(&which.site).bind(&which.machine);
        let mut alarms = self.external_alarms(query.bind(since.as_microsecond()).bind(limit)).await?;
        alarms.reverse();
        Ok(alarms)
    }
}
