//! The store: what the rest of the program asks of the database.

use std::{path::Path, sync::Arc};

use jiff::Timestamp;
use tokio::sync::Semaphore;

use super::{
    disk::{Disk, DiskLevel},
    error::StoreError,
    judgement::{Judgement, Judgements, Outcome},
    link::Link,
    open::{self, Report},
    page::{Page, PageStored, WriteOff},
    place::Place,
    quarantine::{Quarantine, Refused, Sent},
    reader::Reader,
    settings::{MIB, Settings},
    spool::{Spool, Spooled},
    write::Answer,
    writer::Writer,
};
use crate::throw::{MachineId, Throw, ThrowRef};

/// The database of a running daemon. Cheap to clone.
#[derive(Clone)]
pub struct Store {
    pub(super) writer: Writer,
    pub(super) reader: Reader,
    pub(super) disk: Arc<Disk>,
    pub(super) settings: Arc<Settings>,
    pub(super) place: Place,
    /// Bounds the bytes of the throws that wait for their commit.
    room: Arc<Semaphore>,
}

/// Throws that may wait for their commit \[KiB\]: 64 MiB, four of the largest possible throws, or a thousand usual
/// ones. Whoever brings more waits.
const ROOM_KIB: usize = 64 * 1024;

/// An opened store, and how it was found.
pub struct Opened {
    /// The store.
    pub store: Store,
    /// What opening found and did.
    pub report: Report,
}

impl Store {
    /// Opens the database, creating it, repairing its place or bringing its schema up to date as needed. `now` names
    /// what has to be set aside.
    ///
    /// # Errors
    /// When the folder is missing or cannot be written to, or the disk is full even without the ballast.
    pub async fn open(settings: &Settings, now: Timestamp) -> Result<Opened, StoreError> {
        let disk = Arc::new(Disk::new(&settings.path, settings.ballast_mib, settings.low_disk_mib));
        let place = Place::new(&settings.path);
        let (connection, report) = open::open(settings, &disk, &place, now).await?;
        let reader = Reader::open(&settings.path).await?;
        let writer = Writer::start(Link {
            options: open::writing(settings, false),
            connection: Some(connection),
            disk: Arc::clone(&disk),
            place: place.clone(),
            reader: reader.clone(),
            broken: false,
            identity: None,
            looked: None,
            log_bound: settings.max_wal_mib * MIB,
        });
        if let Err(error) = disk.restore_ballast() {
            tracing::warn!(%error, "no ballast: a full disk will be harder to clear");
        }
        let room = Arc::new(Semaphore::new(ROOM_KIB));
        let store = Self { writer, reader, disk, settings: Arc::new(settings.clone()), place, room };
        Ok(Opened { store, report })
    }

    /// The reading side.
    #[must_use]
    pub fn reader(&self) -> &Reader {
        &self.reader
    }

    /// The database file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.settings.path
    }

    /// Stores a throw that arrived. On `Ok` it is on the disk.
    ///
    /// # Errors
    /// When it could not be stored; the same call may be repeated.
    pub async fn spool(
        &self,
        machine: &MachineId,
        throw: &Throw,
        received_at: Timestamp,
    ) -> Result<Spooled, StoreError> {
        self.submit(machine, throw, received_at).await?.await.map_err(|_| StoreError::Closed)?
    }

    /// Stores several throws in as few commits as possible; the answers are in their order.
    pub async fn spool_all(&self, throws: &[(MachineId, Throw, Timestamp)]) -> Vec<Result<Spooled, StoreError>> {
        let mut submitted = Vec::with_capacity(throws.len());
        for (machine, throw, received_at) in throws {
            submitted.push(self.submit(machine, throw, *received_at).await);
        }
        let mut answers = Vec::with_capacity(throws.len());
        for (submitted, (_, throw, _)) in submitted.into_iter().zip(throws) {
            let answer = match submitted {
                Ok(answer) => answer.await.unwrap_or(Err(StoreError::Closed)),
                Err(error) => Err(error),
            };
            if let Ok(Spooled::New(row)) = answer {
                self.reader.recent.keep(row, throw);
            }
            answers.push(answer);
        }
        answers
    }

    async fn submit(
        &self,
        machine: &MachineId,
        throw: &Throw,
        received_at: Timestamp,
    ) -> Result<Answer<Spooled>, StoreError> {
        let mut write = Spool::new(machine, throw, received_at)?;
        let room = Arc::clone(&self.room).acquire_many_owned(write.kib());
        write.room = Some(room.await.map_err(|_| StoreError::Closed)?);
        self.writer.submit(write).await
    }

    /// Stores a page of a logger's backlog, oldest throw first, that was asked for after `after`: all or nothing.
    ///
    /// # Errors
    /// When it could not be stored; the same call may be repeated.
    pub async fn spool_page(
        &self,
        machine: &MachineId,
        after: Option<&ThrowRef>,
        throws: &[Throw],
        at: Timestamp,
    ) -> Result<PageStored, StoreError> {
        let mut page = Page { machine: machine.clone(), after: after.cloned(), throws: Vec::new(), at };
        for throw in throws {
            let mut spool = Spool::new(machine, throw, at)?;
            let room = Arc::clone(&self.room).acquire_many_owned(spool.kib());
            spool.room = Some(room.await.map_err(|_| StoreError::Closed)?);
            page.throws.push(spool);
        }
        self.writer.write(page).await
    }

    /// Writes off what is awaited of a machine: it is in no backlog.
    ///
    /// # Errors
    /// When it could not be stored; the same call may be repeated.
    pub async fn write_off(&self, machine: &MachineId, at: Timestamp) -> Result<(), StoreError> {
        self.writer.write(WriteOff { machine: machine.clone(), at }).await
    }

    /// Stores a judgement: estimate, monitor, baselines, alarms and messages, all or nothing. Returns false when the
    /// throw was judged before; then nothing was written.
    ///
    /// # Errors
    /// When it could not be stored; the same call may be repeated.
    pub async fn judge(&self, judgement: Judgement) -> Result<bool, StoreError> {
        Ok(self.judge_all(Arc::new([judgement])).await? == [true])
    }

    /// Stores judgements in their order and in one commit, so all or none; of each, whether it was written.
    ///
    /// # Errors
    /// When they could not be stored; the same call may be repeated.
    pub async fn judge_all(&self, judgements: Arc<[Judgement]>) -> Result<Vec<bool>, StoreError> {
        let drop_traces = matches!(self.disk.level(), DiskLevel::Low | DiskLevel::Full);
        self.writer.write(Judgements { judgements, drop_traces }).await
    }

    /// Stores what follows from an operator's command, or from time passing: all or nothing.
    ///
    /// # Errors
    /// When it could not be stored; the same call may be repeated.
    pub async fn record(&self, outcome: Outcome) -> Result<(), StoreError> {
        self.writer.write(outcome).await
    }

    /// Forgets messages that zenoh took.
    ///
    /// # Errors
    /// When it could not be stored; the same call may be repeated.
    pub async fn outbox_sent(&self, rows: &[i64]) -> Result<(), StoreError> {
        self.writer.write(Sent(rows.to_vec())).await
    }

    /// Keeps the beginnings of messages that could not be taken, each with its reason, in one commit.
    ///
    /// # Errors
    /// When they could not be stored.
    pub async fn quarantine(&self, refused: Vec<Refused>) -> Result<(), StoreError> {
        self.writer.write(Quarantine { refused, keep: self.settings.max_quarantined }).await
    }

    /// Resolves when the writer is gone, after [`close`](Self::close) or because it died, or when the file turned out
    /// to be broken, be it in a write or in a query. Then the process should end: opening the store again sets a broken
    /// file aside.
    pub async fn stopped(&self) {
        tokio::select! {
            () = self.writer.stopped() => {}
            () = self.reader.breaks() => {}
        }
    }

    /// Writes what waits, marks a clean stop, and closes the files.
    ///
    /// # Errors
    /// When the mark could not be written, or must not because the file is broken: the next start will check the
    /// database.
    pub async fn close(&self) -> Result<(), StoreError> {
        self.reader.close().await;
        self.writer.close().await
    }
}
