//! The one task that writes: it commits the writes that wait in groups.
//!
//! A write is answered after its commit. No future in this file is ever cancelled: a dropped commit may still happen.

use tokio::sync::{mpsc, oneshot};

use super::{
    error::StoreError,
    link::Link,
    write::{Answer, Job, Write, job},
};

/// Most writes in one commit. At the measured rates a group of this size takes 5 to 20 ms; larger ones gain nothing.
const GROUP: usize = 64;
/// Writes that may wait: four groups, a tenth of a second. Callers beyond that wait.
const QUEUE: usize = 4 * GROUP;

/// A request to the writer.
enum Request {
    Write(Box<dyn Job>),
    /// Mark a clean stop, checkpoint, close.
    Close(oneshot::Sender<Result<(), StoreError>>),
}

/// A handle to the writer. Cheap to clone.
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

    /// Queues a write; its answer comes after the commit.
    pub(super) async fn submit<W: Write>(&self, write: W) -> Result<Answer<W::Output>, StoreError> {
        let (job, answer) = job(write);
        self.requests.send(Request::Write(job)).await.map_err(|_| StoreError::Closed)?;
        Ok(answer)
    }

    /// Writes and waits for the commit.
    pub(super) async fn write<W: Write>(&self, write: W) -> Result<W::Output, StoreError> {
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
