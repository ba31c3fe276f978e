//! The queue of operators' commands to the judge loop, with the channels for the answers.

use std::time::Duration;

use tokio::{
    sync::{mpsc, oneshot},
    time::{self, Instant},
};

use crate::{bus::ANSWER_TIMEOUT, diagnose::Command, throw::MachineId, wire::Reply};

/// Capacity of the queue. A sender waits while it is full.
const CAPACITY: usize = 16;
/// Time after which a command fails. The judge loop may first have to finish a batch.
const LIMIT: Duration = Duration::from_secs(20);

/// A command with the channel for its answer.
pub(crate) struct PendingCommand {
    pub(crate) machine: MachineId,
    pub(crate) command: Command,
    pub(crate) reply: oneshot::Sender<Reply>,
}

/// Sender of commands to the judge loop. Cheap to clone.
#[derive(Debug, Clone)]
pub(crate) struct CommandSender(mpsc::Sender<PendingCommand>);

impl CommandSender {
    pub(crate) fn new() -> (Self, mpsc::Receiver<PendingCommand>) {
        let (sender, receiver) = mpsc::channel(CAPACITY);
        (Self(sender), receiver)
    }

    /// Sends a command, which arrived at `arrived`, and waits until it is applied and committed.
    ///
    /// # Errors
    /// A sentence, if the loop does not answer in time. The loop then drops the command, unless it is applying it.
    pub(crate) async fn apply(&self, machine: MachineId, command: Command, arrived: Instant) -> Result<Reply, String> {
        let (reply, answer) = oneshot::channel();
        // Its operator gives it up then.
        let limit = ANSWER_TIMEOUT.saturating_sub(arrived.elapsed()).min(LIMIT);
        let answer = time::timeout(limit, async {
            self.0.send(PendingCommand { machine, command, reply }).await.ok()?;
            answer.await.ok()
        });
        let busy = || "the daemon is busy: check whether the command was applied before you repeat it".to_owned();
        answer.await.ok().flatten().ok_or_else(busy)
    }
}
