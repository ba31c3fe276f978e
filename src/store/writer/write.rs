//! A write: a part of a transaction, whose caller waits for the commit.

use std::pin::Pin;

use sqlx::SqliteConnection;
use tokio::sync::oneshot;

use crate::store::error::StoreError;

/// A write. It runs in a transaction together with other writes, and again if the transaction failed.
pub(crate) trait Write: Send + Sync + 'static {
    /// Result for the caller after the commit.
    type Output: Send + 'static;

    /// Runs the write. If `repeated`, an earlier attempt may have been committed.
    fn run(
        &self,
        connection: &mut SqliteConnection,
        repeated: bool,
    ) -> impl Future<Output = sqlx::Result<Self::Output>> + Send;
}

type Running<'a> = Pin<Box<dyn Future<Output = sqlx::Result<()>> + Send + 'a>>;

/// A [`Write`] with its caller, without the type of its result: so that a queue can hold different writes.
pub(crate) trait Job: Send {
    /// Runs the write and keeps its result.
    fn run<'a>(&'a mut self, connection: &'a mut SqliteConnection, repeated: bool) -> Running<'a>;
    /// Sends the result of the write, or the error of the commit, to the caller.
    fn answer(self: Box<Self>, committed: Result<(), StoreError>);
}

/// A write in the queue.
pub(super) struct QueuedWrite<W: Write> {
    pub(super) write: W,
    /// Result of the last run, for the answer after the commit.
    pub(super) output: Option<W::Output>,
    pub(super) reply: oneshot::Sender<Result<W::Output, StoreError>>,
}

impl<W: Write> Job for QueuedWrite<W> {
    fn run<'a>(&'a mut self, connection: &'a mut SqliteConnection, repeated: bool) -> Running<'a> {
        Box::pin(async move {
            self.output = Some(self.write.run(connection, repeated).await?);
            Ok(())
        })
    }

    fn answer(self: Box<Self>, committed: Result<(), StoreError>) {
        let Self { output, reply, .. } = *self;
        // Fails if the caller stopped waiting; the write is done anyway.
        let _ = reply.send(committed.and_then(|()| output.ok_or(StoreError::Closed)));
    }
}
