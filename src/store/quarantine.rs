//! Small writes: messages that could not be taken, and messages that were published.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::{spool::count, statements as sql, writer::Write};

/// Longest beginning of a message that is kept \[bytes\]: enough to recognise its format and sender.
pub const QUARANTINED_BYTES: usize = 1024;
/// Longest key and reason that are kept \[characters\].
const TEXT: usize = 512;

/// A message that could not be taken.
pub(super) struct Quarantine {
    key: String,
    reason: String,
    payload_bytes: i64,
    payload_start: Vec<u8>,
    at_us: i64,
    keep: u32,
}

impl Quarantine {
    pub(super) fn new(key: &str, payload: &[u8], reason: &str, at: Timestamp, keep: u32) -> Self {
        Self {
            key: key.chars().take(TEXT).collect(),
            reason: reason.chars().take(TEXT).collect(),
            payload_bytes: i64::try_from(payload.len()).unwrap_or(i64::MAX),
            payload_start: payload[..payload.len().min(QUARANTINED_BYTES)].to_vec(),
            at_us: at.as_microsecond(),
            keep,
        }
    }
}

impl Write for Quarantine {
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<()> {
        sqlx::query(sql::ADD_QUARANTINE)
            .bind(self.at_us)
            .bind(&self.key)
            .bind(&self.reason)
            .bind(self.payload_bytes)
            .bind(&self.payload_start)
            .execute(&mut *connection)
            .await?;
        sqlx::query(sql::TRIM_QUARANTINE).bind(self.keep).execute(&mut *connection).await?;
        count(connection, "quarantined_messages", 1).await
    }
}

/// Messages that zenoh took.
pub(super) struct Sent(pub(super) Vec<i64>);

impl Write for Sent {
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<()> {
        for row in &self.0 {
            sqlx::query(sql::SENT).bind(row).execute(&mut *connection).await?;
        }
        Ok(())
    }
}
