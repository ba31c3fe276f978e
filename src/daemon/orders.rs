//! Operators' commands on their way to the loop that judges, and the answers on their way back.

use std::time::Duration;

use tokio::{
    sync::{mpsc, oneshot},
    time,
};

use crate::{diagnose::Command, throw::MachineId, wire::Reply};

/// Commands that may wait.
const WAITING: usize = 16;
/// Longest wait for an answer: the loop that judges may be in the middle of a batch.
const LIMIT: Duration = Duration::from_secs(20);

/// A command with the way back to the operator.
pub(super) struct Order {
    pub(super) machine: MachineId,
    pub(super) command: Command,
    pub(super) reply: oneshot::Sender<Reply>,
}

/// Takes commands for the loop that judges. Cheap to clone.
#[derive(Debug, Clone)]
pub(super) struct Orders(mpsc::Sender<Order>);

impl Orders {
    pub(super) fn new() -> (Self, mpsc::Receiver<Order>) {
        let (sender, receiver) = mpsc::channel(WAITING);
        (Self(sender), receiver)
    }

    /// Has a command carried out and committed.
    ///
    /// # Errors
    /// A sentence, when the loop does not answer in time. The command may be carried out later all the same.
    pub(super) async fn carry_out(&self, machine: MachineId, command: Command) -> Result<Reply, String> {
        let (reply, answer) = oneshot::channel();
        let busy = || "the daemon is busy: look whether the command was carried out before you repeat it".to_owned();
        let answer = time::timeout(LIMIT, async {
            self.0.send(Order { machine, command, reply }).await.map_err(|_| busy())?;
            answer.await.map_err(|_| busy())
        });
        answer.await.map_err(|_| busy())?
    }
}
