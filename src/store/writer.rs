//! The one task that writes: it takes what waits and commits it in groups.
//!
//! A write is answered after the commit that holds it. Nothing in here is ever cancelled: a dropped commit may still
//! happen.

use std::pin::Pin;

use sqlx::SqliteConnection;
use tokio::sync::{mpsc, oneshot};

use super::{error::StoreError, link::Link};

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

/// Comes after the commit.
pub(super) type Answer<T> = oneshot::Receiver<Result<T, StoreError>>;

type Running<'a> = Pin<Box<dyn Future<Output = sqlx::Result<()>> + Send + 'a>>;

/// A [`Write`] of any kind, with the caller who waits for it.
pub(super) trait Job: Send {
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
    /// Mark a clean stop, checkpoint, close.
    Close(oneshot::Sender<Result<(), StoreError>>),
}

/// The way to the writer.
#[derive(Clone)]
pub(super) struct Writer {
    requests: mpsc::Sender<Request>,
}

impl Writer {
    /// Starts the writer.
    pub(super) fn start(link: Link) -> Self {
        let (requests, inbox) = mpsc::channel(QUEUE);
        tokio::spawn(serve(inbox, link));
        Self { requests }
    }

    /// Hands a write over; the receiver gets its answer after the commit.
    pub(super) async fn submit<W: Write + Sync>(&self, write: W) -> Result<Answer<W::Output>, StoreError> {
        let (reply, answer) = oneshot::channel();
        let job = Box::new(Waiting { write, output: None, reply });
        self.requests.send(Request::Write(job)).await.map_err(|_| StoreError::Closed)?;
        Ok(answer)
    }

    /// Writes and waits for the commit.
    pub(super) async fn write<W: Write + Sync>(&self, write: W) -> Result<W::Output, StoreError> {
        self.submit(write).await?.await.map_err(|_| StoreError::Closed)?
    }

    pub(super) async fn close(&self) -> Result<(), StoreError> {
        let (reply, answer) = oneshot::channel();
        self.requests.send(Request::Close(reply)).await.map_err(|_| StoreError::Closed)?;
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
                Request::Close(reply) => {
                    link.commit(std::mem::take(&mut group)).await;
                    let _ = reply.send(link.close().await);
                    return;
                }
            }
        }
        link.commit(group).await;
        if link.broken {
            tracing::error!("the database is broken: the writer ends, and the next start sets the file aside");
            return;
        }
    }
}
