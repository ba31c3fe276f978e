//! One write: a part of a transaction, with the caller who waits for its commit.

use std::pin::Pin;

use sqlx::SqliteConnection;
use tokio::sync::oneshot;

use super::error::StoreError;

/// One write: runs inside a transaction together with others, and may run again when that transaction failed.
pub(super) trait Write: Send + Sync + 'static {
    /// What the caller gets after the commit.
    type Output: Send + 'static;

    /// Writes. `repeated`: an earlier attempt may have been committed although its commit failed.
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

/// A job for a write, and where its answer comes.
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
        // The caller may have gone; its write is done all the same.
        let _ = reply.send(committed.and_then(|()| output.ok_or(StoreError::Closed)));
    }
}
