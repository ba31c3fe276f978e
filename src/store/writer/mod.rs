//! The task that writes: commits queued writes in groups.
//!
//! The caller of a write gets its answer after the commit. No future in this module is cancelled: SQLite may still
//! complete the commit of a dropped future.

pub(super) mod backlog_page;
pub(super) mod batch;
pub(super) mod connection;
pub(super) mod cursor;
pub(super) mod judgement;
pub(super) mod quarantine;
pub(super) mod retention;
pub(super) mod spool;
pub(super) mod write;

use tokio::sync::{mpsc, oneshot};

use self::{
    connection::WritingConnection,
    write::{Job, QueuedWrite, Write},
};
use super::error::StoreError;

/// Largest number of writes in a commit. At the measured rates it takes 5 to 20 ms; larger groups are not faster.
const GROUP: usize = 64;
/// Capacity of the queue \[writes\]: four groups, about a tenth of a second. Further callers wait.
const QUEUE: usize = 4 * GROUP;

enum Request {
    Write(Box<dyn Job>),
    /// Marks a clean stop, runs a checkpoint, closes.
    Close(oneshot::Sender<Result<(), StoreError>>),
}

/// Handle to the writer. Cheap to clone.
#[derive(Clone)]
pub(super) struct Writer {
    requests: mpsc::Sender<Request>,
}

impl Writer {
    pub(super) fn start(writing: WritingConnection) -> Self {
        let (requests, inbox) = mpsc::channel(QUEUE);
        tokio::spawn(serve(inbox, writing));
        Self { requests }
    }

    /// Queues a write and waits for the commit.
    pub(super) async fn write<W: Write>(&self, write: W) -> Result<W::Output, StoreError> {
        self.request(|reply| Request::Write(Box::new(QueuedWrite { write, output: None, reply }))).await
    }

    pub(super) async fn close(&self) -> Result<(), StoreError> {
        self.request(Request::Close).await
    }

    async fn request<T>(
        &self,
        request: impl FnOnce(oneshot::Sender<Result<T, StoreError>>) -> Request,
    ) -> Result<T, StoreError> {
        let (reply, answer) = oneshot::channel();
        self.requests.send(request(reply)).await.map_err(|_| StoreError::Closed)?;
        answer.await.map_err(|_| StoreError::Closed)?
    }

    /// Resolves when the writer has ended.
    pub(super) async fn stopped(&self) {
        self.requests.closed().await;
    }
}

async fn serve(mut inbox: mpsc::Receiver<Request>, mut connection: WritingConnection) {
    let mut requests = Vec::with_capacity(GROUP);
    while inbox.recv_many(&mut requests, GROUP).await > 0 {
        let mut group: Vec<Box<dyn Job>> = Vec::with_capacity(GROUP);
        for request in requests.drain(..) {
            match request {
                Request::Write(job) => group.push(job),
                Request::Close(reply) => {
                    connection.commit(std::mem::take(&mut group)).await;
                    let _ = reply.send(connection.close().await);
                    return;
                }
            }
        }
        connection.commit(group).await;
        if connection.broken {
            tracing::error!("the database is broken: the writer ends; the next start sets the file aside");
            return;
        }
    }
}
