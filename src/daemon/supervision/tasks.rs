//! The tasks of the daemon. Their ends are observed, as the daemon ends with any of them.

use std::time::Duration;

use tokio::time;
use tokio_util::task::JoinMap;

/// Tasks by name. Dropping the set aborts the tasks that still run.
#[derive(Default)]
pub(crate) struct Tasks(JoinMap<&'static str, ()>);

impl Tasks {
    pub(crate) fn spawn<T>(&mut self, name: &'static str, task: impl Future<Output = T> + Send + 'static) {
        self.0.spawn(name, async move {
            task.await;
        });
    }

    /// Waits until a task ends or panics; returns its name.
    pub(crate) async fn next_end(&mut self) -> &'static str {
        self.0.join_next().await.map_or("every task", |(name, _)| name)
    }

    /// Waits at most `limit` until the task `name` has ended; returns whether it has.
    pub(crate) async fn end_of(&mut self, name: &str, limit: Duration) -> bool {
        let end = async {
            while self.0.contains_key(name) {
                self.next_end().await;
            }
        };
        time::timeout(limit, end).await.is_ok()
    }
}
