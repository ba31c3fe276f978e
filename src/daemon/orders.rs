//! The queue of operators' commands to the judge loop, with the channels for the answers.

use std::time::Duration;

use tokio::{
    sync::{mpsc, oneshot},
    time,
};

use crate::{diagnose::Command, throw::MachineId, wire::Reply};

/// Capacity of the queue.
const WAITING: usize = 16;
/// Time until a command fails; the judge loop may be in the middle of a batch.
const LIMIT: Duration = Duration::from_secs(20);

/// A command with the channel for its answer.
pub(super) struct Order {
    pub(super) machine: MachineId,
    pub(super) command: Command,
    pub(super) reply: oneshot::Sender<Reply>,
}

/// Sender of commands to the judge loop. Cheap to clone.
#[derive(Debug, Clone)]
pub(crate) struct Orders(mpsc::Sender<Order>);

impl Orders {
    pub(super) fn new() -> (Self, mpsc::Receiver<Order>) {
        let (sender, receiver) = mpsc::channel(WAITING);
        (Self(sender), receiver)
    }

    /// Sends a command and waits until it is applied and committed.
    ///
    /// # Errors
    /// A sentence, if the loop does not answer in time. The command may still be applied later.
    pub(crate) async fn carry_out(&self, machine: MachineId, command: Command) -> Result<Reply, String> {
        let (reply, answer) = oneshot::channel();
        let busy = || "the daemon is busy: check whether the command was applied before you repeat it".to_owned();
        let answer = time::timeout(LIMIT, async {
            self.0.send(Order { machine, command, reply }).await.map_err(|_| busy())?;
            answer.await.map_err(|_| busy())
        });
        answer.await.map_err(|_| busy())?
    }
}
