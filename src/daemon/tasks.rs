//! The tasks of the daemon, whose ends are observed.

use std::{collections::HashMap, time::Duration};

use tokio::{
    task::{Id, JoinSet},
    time,
};

/// The name of a task that ended unexpectedly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TaskEnded(pub &'static str);

/// Tasks with their names; running tasks are aborted when this is dropped.
#[derive(Default)]
pub(super) struct Tasks {
    running: JoinSet<()>,
    names: HashMap<Id, &'static str>,
}

impl Tasks {
    pub(super) fn spawn<T>(&mut self, name: &'static str, task: impl Future<Output = T> + Send + 'static) {
        let handle = self.running.spawn(async move {
            task.await;
        });
        self.names.insert(handle.id(), name);
    }

    /// Waits until a task ends or panics.
    pub(super) async fn next_end(&mut self) -> TaskEnded {
        let id = match self.running.join_next_with_id().await {
            Some(Ok((id, ()))) => id,
            Some(Err(error)) => error.id(),
            None => return TaskEnded("every task"),
        };
        TaskEnded(self.names.remove(&id).unwrap_or("a task"))
    }

    /// Waits at most `limit` until the task `name` has ended; returns whether it has.
    pub(super) async fn end_of(&mut self, name: &'static str, limit: Duration) -> bool {
        let end = async {
            while self.names.values().any(|running| *running == name) {
                self.next_end().await;
            }
        };
        time::timeout(limit, end).await.is_ok()
    }
}
