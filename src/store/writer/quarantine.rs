//! Small writes: messages for the quarantine, counters of losses, and single statements.

use jiff::Timestamp;
use sqlx::{Encode, Sqlite, SqliteConnection, Type};

use super::{spool::count, write::Write};
use crate::{
    store::statements as sql,
    throw::{MachineId, Throw, ThrowRef},
    wire::{Kind, QUARANTINED_BYTES, encode_throw, machine_key},
};

/// Largest number of messages stored in one commit: of a flood, the newest messages are enough.
const MAX_STORED: usize = 256;
/// Largest stored length of the key \[characters\].
const MAX_KEY: usize = 512;

/// A message for quarantine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QuarantinedMessage {
    /// Key of the message.
    pub key: String,
    /// Reason for the rejection.
    pub reason: String,
    /// Size of the whole message \[bytes\].
    pub bytes: usize,
    /// Boot and number of the throw, if both can be read from the message.
    pub id: Option<Box<ThrowRef>>,
    /// The start of the message, of which the first [`QUARANTINED_BYTES`] are stored.
    pub beginning: Vec<u8>,
    /// Time of reception.
    pub at: Timestamp,
}

impl QuarantinedMessage {
    /// A valid throw that the daemon does not accept, for example of an unknown machine.
    pub fn throw(machine: &MachineId, throw: &Throw, reason: String, at: Timestamp) -> Self {
        let beginning = encode_throw(throw);
        Self {
            key: machine_key(machine, Kind::Throw),
            reason,
            bytes: beginning.len(),
            id: Some(Box::new(throw.id.clone())),
            beginning,
            at,
        }
    }
}

/// Messages for quarantine, in the order of arrival.
pub(crate) struct Quarantine {
    pub(crate) refused: Vec<QuarantinedMessage>,
    /// Largest number of messages kept in the database; the oldest of the keys with the most are removed first.
    pub(crate) keep: u32,
}

impl Write for Quarantine {
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, repeated: bool) -> sqlx::Result<()> {
        let kept = self.refused.len().min(self.keep as usize).min(MAX_STORED);
        let short = |text: &str| text.chars().take(MAX_KEY).collect::<String>();
        if let Some(newest) = self.refused.last().filter(|_| repeated && kept > 0) {
            let is_stored = sqlx::query_scalar(sql::IS_QUARANTINED)
                .bind(newest.at.as_microsecond())
                .bind(short(&newest.key))
                .bind(i64::try_from(newest.bytes).unwrap_or(i64::MAX));
            if is_stored.fetch_one(&mut *connection).await? {
                return Ok(());
            }
        }
        for refused in &self.refused[self.refused.len() - kept..] {
            sqlx::query(sql::ADD_QUARANTINE)
                .bind(refused.at.as_microsecond())
                .bind(short(&refused.key))
                .bind(&refused.reason)
                .bind(i64::try_from(refused.bytes).unwrap_or(i64::MAX))
                .bind(&refused.beginning[..refused.beginning.len().min(QUARANTINED_BYTES)])
                .bind(refused.id.as_ref().map(|id| id.boot_id.as_str()))
                .bind(refused.id.as_ref().map(|id| id.throw_no.cast_signed()))
                .execute(&mut *connection)
                .await?;
        }
        sqlx::query(sql::TRIM_QUARANTINE).bind(self.keep).execute(&mut *connection).await?;
        count(connection, "quarantined_messages", i64::try_from(self.refused.len()).unwrap_or(i64::MAX)).await
    }
}

/// Received messages that were dropped from the queue, and that could not be stored, since the last such write.
pub(crate) struct Losses {
    pub(crate) dropped: u64,
    pub(crate) lost: u64,
    /// Whether a row changes also without losses.
    pub(crate) is_probe: bool,
}

impl Write for Losses {
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<()> {
        let counters = [
            // SQLite does not write a page whose content stays the same.
            ("probes", u64::from(self.is_probe)),
            ("dropped_received_messages", self.dropped),
            ("lost_messages", self.lost),
        ];
        for (name, more) in counters {
            if more > 0 {
                count(connection, name, more.cast_signed()).await?;
            }
        }
        Ok(())
    }
}

/// A statement with one parameter, without a result.
pub(crate) struct Statement<T>(pub(crate) &'static str, pub(crate) T);

impl<T> Write for Statement<T>
where
    T: Clone + Send + Sync + 'static + for<'q> Encode<'q, Sqlite> + Type<Sqlite>,
{
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<()> {
        sqlx::query(self.0).bind(self.1.clone()).execute(connection).await.map(drop)
    }
}
