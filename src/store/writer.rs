//! The one task that writes: it owns the only writing connection and commits what waits in groups.
//!
//! A write is answered after the commit that holds it. When a write transaction fails for any reason its connection
//! is closed and another one opened, because SQLite may have rolled back by itself and because a failed commit means
//! "not known", not "not stored". The group is then written once more; every write may be repeated without harm.
//! Nothing in here is ever cancelled: a dropped commit may still happen.

use std::{pin::Pin, sync::Arc};

use sqlx::{Connection, SqliteConnection, sqlite::SqliteConnectOptions};
use tokio::sync::{mpsc, oneshot};

use super::{
    disk::Disk,
    error::{StoreError, is_full, is_refused},
    statements,
};

/// Most writes in one commit. At the measured rates a group of this size takes 5 to 20 ms; larger ones gain nothing.
const GROUP: usize = 64;
/// Writes that may wait: four groups, a tenth of a second. Whoever writes faster waits.
pub(super) const QUEUE: usize = 4 * GROUP;

/// One write: runs inside a transaction together with others, and may be run again when that transaction failed.
pub(super) trait Write: Send + 'static {
    /// What the caller gets once it is committed.
    type Output: Send + 'static;

    /// Does it. `repeated`: an earlier attempt may have been committed without our knowing.
    fn run(
        &self,
        connection: &mut SqliteConnection,
        repeated: bool,
    ) -> impl Future<Output = sqlx::Result<Self::Output>> + Send;
}

type Running<'a> = Pin<Box<dyn Future<Output = sqlx::Result<()>> + Send + 'a>>;

/// A [`Write`] of any kind, with the caller who waits for it.
trait Job: Send {
    fn run<'a>(&'a mut self, connection: &'a mut SqliteConnection, repeated: bool) -> Running<'a>;
    fn answer(self: Box<Self>, committed: Result<(), StoreError>);
}

struct Waiting<W: Write> {
    write: W,
    output: Option<W::Output>,
    reply: oneshot::Sender<Result<W::Output, StoreError>>,
}

impl<W: Write + Sync> Job for Waiting<W> {
    fn run<'a>(&'a mut self, connection: &'a mut SqliteConnection, repeated: bool) -> Running<'a> {
        Box::pin(async move {
            self.output = Some(self.write.run(connection, repeated).await?);
            Ok(())
        })
    }

    fn answer(self: Box<Self>, committed: Result<(), StoreError>) {
        let Self { output, reply, .. } = *self;
        // The caller may have gone; what it asked for is done all the same.
        let _ = reply.send(committed.and_then(|()| output.ok_or(StoreError::Closed)));
    }
}

/// What the writer is asked for.
enum Request {
    Write(Box<dyn Job>),
    /// Copy the log into the database and start it anew; answers whether all of it was copied.
    Checkpoint(oneshot::Sender<Result<bool, StoreError>>),
    /// Mark a clean stop, checkpoint, close.
    Close(oneshot::Sender<Result<(), StoreError>>),
}

/// The way to the writer.
#[derive(Clone)]
pub(super) struct Writer {
    requests: mpsc::Sender<Request>,
}

impl Writer {
    /// Starts the writer on a connection that is already open.
    pub(super) fn start(options: SqliteConnectOptions, connection: SqliteConnection, disk: Arc<Disk>) -> Self {
        let (requests, inbox) = mpsc::channel(QUEUE);
        let link = Link { options, connection: Some(connection), disk };
        tokio::spawn(serve(inbox, link));
        Self { requests }
    }

    /// Hands a write over; the receiver gets its answer after the commit.
    pub(super) async fn submit<W: Write + Sync>(
        &self,
        write: W,
    ) -> Result<oneshot::Receiver<Result<W::Output, StoreError>>, StoreError> {
        let (reply, answer) = oneshot::channel();
        let job = Box::new(Waiting { write, output: None, reply });
        self.requests.send(Request::Write(job)).await.map_err(|_| StoreError::Closed)?;
        Ok(answer)
    }

    /// Writes and waits for the commit.
    pub(super) async fn write<W: Write + Sync>(&self, write: W) -> Result<W::Output, StoreError> {
        self.submit(write).await?.await.map_err(|_| StoreError::Closed)?
    }

    pub(super) async fn checkpoint(&self) -> Result<bool, StoreError> {
        self.ask(Request::Checkpoint).await
    }

    pub(super) async fn close(&self) -> Result<(), StoreError> {
        self.ask(Request::Close).await
    }

    async fn ask<T>(
        &self,
        request: impl FnOnce(oneshot::Sender<Result<T, StoreError>>) -> Request,
    ) -> Result<T, StoreError> {
        let (reply, answer) = oneshot::channel();
        self.requests.send(request(reply)).await.map_err(|_| StoreError::Closed)?;
        answer.await.map_err(|_| StoreError::Closed)?
    }

    /// Resolves when the writer is gone.
    pub(super) async fn stopped(&self) {
        self.requests.closed().await;
    }
}

async fn serve(mut inbox: mpsc::Receiver<Request>, mut link: Link) {
    let mut requests = Vec::with_capacity(GROUP);
    while inbox.recv_many(&mut requests, GROUP).await > 0 {
        let mut group: Vec<Box<dyn Job>> = Vec::with_capacity(GROUP);
        for request in requests.drain(..) {
            match request {
                Request::Write(job) => group.push(job),
                Request::Checkpoint(reply) => {
                    link.commit(std::mem::take(&mut group)).await;
                    let _ = reply.send(link.checkpoint().await);
                }
                Request::Close(reply) => {
                    link.commit(std::mem::take(&mut group)).await;
                    let _ = reply.send(link.close().await);
                    return;
                }
            }
        }
        link.commit(group).await;
    }
}

/// Where in a transaction it failed.
enum Failed {
    /// Before or after the jobs: none of them is to blame.
    Around(sqlx::Error),
    /// In a job.
    Within(sqlx::Error),
}

impl Failed {
    const fn error(&self) -> &sqlx::Error {
        match self {
            Self::Around(error) | Self::Within(error) => error,
        }
    }
}

/// The writing connection, replaced after every failure.
struct Link {
    options: SqliteConnectOptions,
    connection: Option<SqliteConnection>,
    disk: Arc<Disk>,
}

impl Link {
    /// Commits the jobs together and answers each of them.
    async fn commit(&mut self, mut jobs: Vec<Box<dyn Job>>) {
        if jobs.is_empty() {
            return;
        }
        let Err(first) = self.transaction(&mut jobs, false).await else {
            return jobs.into_iter().for_each(|job| job.answer(Ok(())));
        };
        self.recover(first.error()).await;
        match self.transaction(&mut jobs, true).await {
            Ok(()) => jobs.into_iter().for_each(|job| job.answer(Ok(()))),
            Err(Failed::Within(error)) if is_refused(&error) && jobs.len() > 1 => self.commit_one_by_one(jobs).await,
            Err(failed) => {
                self.recover(failed.error()).await;
                jobs.into_iter().for_each(|job| job.answer(Err(told(failed.error()))));
            }
        }
    }

    /// One of the jobs is refused by the database: it must not take the others with it.
    async fn commit_one_by_one(&mut self, jobs: Vec<Box<dyn Job>>) {
        for job in jobs {
            let mut alone = [job];
            let outcome = self.transaction(&mut alone, true).await;
            if let Err(failed) = &outcome {
                self.recover(failed.error()).await;
            }
            let [job] = alone;
            job.answer(outcome.map_err(|failed| told(failed.error())));
        }
    }

    async fn transaction(&mut self, jobs: &mut [Box<dyn Job>], repeated: bool) -> Result<(), Failed> {
        let connection = self.connected().await.map_err(Failed::Around)?;
        sqlx::query("BEGIN IMMEDIATE").execute(&mut *connection).await.map_err(Failed::Around)?;
        for job in jobs {
            job.run(connection, repeated).await.map_err(Failed::Within)?;
        }
        sqlx::query("COMMIT").execute(connection).await.map_err(Failed::Around)?;
        self.disk.note_success();
        Ok(())
    }

    async fn connected(&mut self) -> sqlx::Result<&mut SqliteConnection> {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None => SqliteConnection::connect_with(&self.options).await?,
        };
        Ok(self.connection.insert(connection))
    }

    /// Gives up the connection, and the ballast if the disk is full.
    async fn recover(&mut self, error: &sqlx::Error) {
        tracing::warn!(%error, "a write transaction failed; its connection is replaced");
        if let Some(connection) = self.connection.take() {
            // It may fail for the same reason; the file handle is gone either way.
            let _ = connection.close().await;
        }
        self.disk.note_failure(is_full(error));
    }

    async fn checkpoint(&mut self) -> Result<bool, StoreError> {
        let connection = self.connected().await.map_err(|error| told(&error))?;
        let outcome: Result<(i64, i64, i64), _> =
            sqlx::query_as("PRAGMA wal_checkpoint(TRUNCATE)").fetch_one(connection).await;
        match outcome {
            Ok((busy, ..)) => Ok(busy == 0),
            Err(error) => {
                self.recover(&error).await;
                Err(told(&error))
            }
        }
    }

    async fn close(&mut self) -> Result<(), StoreError> {
        let connection = self.connected().await.map_err(|error| told(&error))?;
        let marked = sqlx::query(statements::SET_CLEAN).bind(true).execute(&mut *connection).await;
        let copied = self.checkpoint().await;
        if let Some(connection) = self.connection.take() {
            connection.close().await.map_err(|error| told(&error))?;
        }
        marked.map_err(|error| told(&error))?;
        copied.map(|_| ())
    }
}

/// The error as the caller sees it.
fn told(error: &sqlx::Error) -> StoreError {
    if is_full(error) { StoreError::Full } else { StoreError::Write(error.to_string()) }
}
