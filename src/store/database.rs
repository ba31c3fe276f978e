//! The store: the interface of the database for the rest of the program.

use std::{path::Path, sync::Arc};

use jiff::Timestamp;
use tokio::task::{self, JoinError};

use super::{
    dropped::DropCounts,
    error::StoreError,
    files::{
        DatabaseFiles,
        disk::Disk,
        open::{self, Report},
    },
    reader::Reader,
    settings::{MIB, Settings},
    statements as sql,
    writer::{
        Writer,
        backlog_page::{BacklogPage, PageStored, WriteOff},
        connection::WritingConnection,
        cursor::Cursor,
        judgement::{Judgement, Outcome},
        quarantine::{Losses, Quarantine, QuarantinedMessage, Statement},
        spool::{ReceivedThrow, Spool, Spooled, Spools},
    },
};
use crate::throw::{MachineId, Throw, ThrowRef};

/// The database of a running daemon. Cheap to clone. After `Ok` of a write, its data are on the disk. After an error the
/// same write may be repeated.
#[derive(Clone)]
pub struct Store {
    pub(super) writer: Writer,
    pub(super) reader: Reader,
    pub(super) disk: Arc<Disk>,
    pub(super) drop_counts: Arc<DropCounts>,
    pub(super) settings: Arc<Settings>,
    pub(super) files: DatabaseFiles,
}

/// The result of [`Store::open`].
pub struct Opened {
    /// The store, ready for throws.
    pub store: Store,
    /// Condition of the database when it was opened, and the changes to it.
    pub report: Report,
}

#[expect(clippy::missing_errors_doc, reason = "the documentation of `Store` says when its methods fail")]
impl Store {
    /// Opens the database; creates, recovers or migrates it as needed. `now` becomes part of the new
    /// names of files that are set aside: renamed and kept.
    ///
    /// # Errors
    /// When the folder is missing or not writable, or the disk is full even without the ballast.
    pub async fn open(settings: &Settings, now: Timestamp) -> Result<Opened, StoreError> {
        let files = DatabaseFiles::new(&settings.path);
        let settings = Settings { path: files.path().to_owned(), ..settings.clone() };
        let disk = Arc::new(Disk::new(files.path(), settings.ballast_mib, settings.low_disk_mib));
        let (mut connection, report) = open::open(&settings, &disk, &files, now).await?;
        // SQLite copies each page that a statement changes; in memory this takes a tenth less processor time than in a
        // file. Set after the migrations: the indexes that they create are too large for memory.
        let options = open::write_options(&settings, false).pragma("temp_store", "memory");
        let set = sqlx::query("PRAGMA temp_store = memory").execute(&mut connection).await;
        set.map_err(StoreError::open(&settings.path))?;
        let reader = Reader::open(&settings.path).await?;
        let writer = Writer::start(WritingConnection {
            options,
            connection: Some(connection),
            disk: Arc::clone(&disk),
            files: files.clone(),
            reader: reader.clone(),
            broken: false,
            identity: None,
            next_file_check: None,
            foreign: None,
            max_log_bytes: settings.max_wal_mib * MIB,
            failed_log_bytes: 0,
        });
        if let Err(error) = disk.restore_ballast() {
            tracing::warn!(%error, "no ballast file: recovery from a full disk will be harder");
        }
        let store = Self { writer, reader, disk, drop_counts: Arc::default(), settings: Arc::new(settings), files };
        Ok(Opened { store, report })
    }

    /// The reader of this database.
    pub fn reader(&self) -> &Reader {
        &self.reader
    }

    /// Path of the database: the configured one, or the target of a link there into another folder.
    pub fn path(&self) -> &Path {
        &self.settings.path
    }

    /// Stores a received throw.
    pub async fn spool(
        &self,
        machine: &MachineId,
        throw: &Throw,
        received_at: Timestamp,
    ) -> Result<Spooled, StoreError> {
        let mut spooled =
            self.spool_all(&[ReceivedThrow { machine: machine.clone(), throw: throw.clone(), received_at }]).await?;
        spooled.pop().ok_or(StoreError::Closed)
    }

    /// Stores several throws in one transaction; returns the results in their order.
    pub async fn spool_all(&self, throws: &[ReceivedThrow]) -> Result<Vec<Spooled>, StoreError> {
        let spools = compress(throws.to_vec()).await?;
        let spooled = self.writer.write(Spools(spools)).await?;
        for (received, spooled) in throws.iter().zip(&spooled) {
            if let Spooled::New(row) = spooled {
                self.reader.recent.keep(*row, &received.throw);
            }
        }
        Ok(spooled)
    }

    /// Stores a page of a logger's backlog (the throws after `after`, oldest first) in one transaction.
    pub async fn spool_page(
        &self,
        machine: &MachineId,
        after: Option<&ThrowRef>,
        throws: &[Throw],
        at: Timestamp,
    ) -> Result<PageStored, StoreError> {
        let received =
            |throw: &Throw| ReceivedThrow { machine: machine.clone(), throw: throw.clone(), received_at: at };
        let throws = compress(throws.iter().map(received).collect()).await?;
        self.writer.write(BacklogPage { machine: machine.clone(), after: after.cloned(), throws, at }).await
    }

    /// Writes off the throws of a machine that were missing when the backlog query with `cursor` was sent: the backlog
    /// does not have them.
    pub async fn write_off(&self, machine: &MachineId, cursor: &Cursor, at: Timestamp) -> Result<(), StoreError> {
        self.writer.write(WriteOff { machine: machine.clone(), newest: cursor.newest, at }).await
    }

    /// Begins the wait of the judge for all backlogs anew, at the start of the daemon: the loggers have to connect again.
    pub async fn renew_backlogs(&self, at: Timestamp) -> Result<(), StoreError> {
        self.writer.write(Statement(sql::RENEW_BACKLOGS, at.as_microsecond())).await
    }

    /// Stores judgements (estimate, monitor, baselines, alarms, messages) in order and in one transaction. A throw that was
    /// judged before keeps its judgement.
    pub async fn judge_all(&self, judgements: Arc<[Judgement]>) -> Result<(), StoreError> {
        self.writer.write(judgements).await
    }

    /// Stores the outcome of an operator's command or of a periodic check, in one transaction.
    pub async fn record(&self, outcome: Outcome) -> Result<(), StoreError> {
        self.record_all(Arc::new([outcome])).await
    }

    /// Stores outcomes in order and in one transaction.
    pub(crate) async fn record_all(&self, outcomes: Arc<[Outcome]>) -> Result<(), StoreError> {
        self.writer.write(outcomes).await
    }

    /// Adds to the counters of the received messages that were dropped and lost. A probe changes a row in any case, and
    /// so shows whether the disk takes writes.
    pub(crate) async fn count_losses(&self, dropped: u64, lost: u64, is_probe: bool) -> Result<(), StoreError> {
        self.writer.write(Losses { dropped, lost, is_probe }).await
    }

    /// Removes messages that zenoh has accepted from the outbox.
    pub async fn outbox_sent(&self, rows: &[i64]) -> Result<(), StoreError> {
        self.writer.write(Statement(sql::DROP_MESSAGES, serde_json::Value::from(rows).to_string())).await
    }

    /// Sets whether alarm events are kept for a webhook from now on.
    pub(crate) async fn set_webhook(&self, is_on: bool) -> Result<(), StoreError> {
        self.writer.write(Statement(sql::SET_WEBHOOK, i64::from(is_on))).await
    }

    /// Removes the notifications up to the row `last`, after the webhook accepted them.
    pub(crate) async fn notified(&self, last: i64) -> Result<(), StoreError> {
        self.writer.write(Statement(sql::NOTIFIED, last)).await
    }

    /// Stores the first bytes of rejected messages, with the reasons, in one transaction.
    pub async fn quarantine(&self, refused: Vec<QuarantinedMessage>) -> Result<(), StoreError> {
        self.writer.write(Quarantine { refused, keep: self.settings.max_quarantined }).await
    }

    /// Resolves when the writer has ended (after [`close`](Self::close), or unexpectedly), or when a write or a query
    /// found the file broken. Then the process should end: the next start sets a broken file aside.
    pub async fn stopped(&self) {
        tokio::select! {
            () = self.writer.stopped() => {}
            () = self.reader.breaks() => {}
        }
    }

    /// Completes the queued writes, marks a clean stop, and closes the files.
    ///
    /// # Errors
    /// When the file is broken or the mark could not be written: the next start will check the database.
    pub async fn close(&self) -> Result<(), StoreError> {
        self.reader.close().await;
        self.writer.close().await
    }
}

/// Compresses throws, on a blocking thread. A throw on which the compression panics is refused, as it would panic again.
async fn compress(throws: Vec<ReceivedThrow>) -> Result<Vec<Spool>, StoreError> {
    let compress = move || throws.into_iter().map(Spool::new).collect();
    task::spawn_blocking(compress).await.map_err(|error| failed(&error))
}

/// The error of a compression that did not end: it panicked, or the runtime shuts down.
fn failed(error: &JoinError) -> StoreError {
    let refused = || StoreError::Refused("its compression failed: please report it".to_owned());
    if error.is_panic() { refused() } else { StoreError::Closed }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Any other error would be retried for ever.
    #[tokio::test]
    async fn a_throw_on_which_the_compression_panics_is_refused() {
        let panicked = task::spawn_blocking(|| panic!("a defect of the compressor")).await;
        assert!(matches!(failed(&panicked.unwrap_err()), StoreError::Refused(_)));
        let aborted = tokio::spawn(std::future::pending::<()>());
        aborted.abort();
        assert!(matches!(failed(&aborted.await.unwrap_err()), StoreError::Closed));
    }
}
