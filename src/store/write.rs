//! A write: a part of a transaction, with the caller that waits for its commit.

use std::pin::Pin;

use sqlx::SqliteConnection;
use tokio::sync::oneshot;

use super::error::StoreError;

/// A write, which runs in a transaction with others, and runs again if the transaction failed.
pub(super) trait Write: Send + Sync + 'static {
    /// Result for the caller after the commit.
    type Output: Send + 'static;

    /// Runs the write. If `repeated`, an earlier attempt may have been committed.
    fn run(
        &self,
        connection: &mut SqliteConnection,
        repeated: bool,
    ) -> impl Future<Output = sqlx::Result<Self::Output>> + Send;
}

/// The result of a write, sent after the commit.
pub(super) type Answer<T> = oneshot::Receiver<Result<T, StoreError>>;

type Running<'a> = Pin<Box<dyn Future<Output = sqlx::Result<()>> + Send + 'a>>;

/// A [`Write`] with its caller.
pub(super) trait Job: Send {
    fn run<'a>(&'a mut self, connection: &'a mut SqliteConnection, repeated: bool) -> Running<'a>;
    fn answer(self: Box<Self>, committed: Result<(), StoreError>);
}

struct Waiting<W: Write> {
    write: W,
    output: Option<W::Output>,
    reply: oneshot::Sender<Result<W::Output, StoreError>>,
}

/// Makes a job from a write, with the receiver of its result.
pub(super) fn job<W: Write>(write: W) -> (Box<dyn Job>, Answer<W::Output>) {
    let (reply, answer) = oneshot::channel();
    (Box::new(Waiting { write, output: None, reply }), answer)
}

impl<W: Write> Job for Waiting<W> {
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
