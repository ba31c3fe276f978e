//! The answers of the judge loop to operators' commands.

use jiff::Timestamp;

use super::{commands::PendingCommand, judge_loop::JudgeLoop};
use crate::{
    daemon::{clock, config::Config},
    diagnose::Command,
    store::{ALL_MACHINES, StoreError},
    throw::MachineId,
    wire::{self, Reply},
};

impl JudgeLoop {
    /// Applies a command, and sends the answer to its operator.
    pub(super) async fn answer_command(&mut self, pending: PendingCommand) -> Result<(), StoreError> {
        let PendingCommand { machine, command, reply } = pending;
        // While the database accepts no writes, commands may wait for hours. The operator may have given them up.
        if reply.is_closed() {
            tracing::warn!(%machine, command = wire::json(&command), "operator's command dropped: its reply was a time-out");
            return Ok(());
        }
        let (config, now) = (self.judge.config(), clock::now());
        let applied = match self.budget.take(clock::monotonic()) {
            Err(wait) => Err(format!("too many commands at once: retry in {} s", wait.as_secs() + 1)),
            Ok(()) => self.apply_command(&machine, &command, now, &config).await?,
        };
        let done = applied.is_ok();
        let (Ok(text) | Err(text)) = applied;
        let answer = Reply { done, text, monitor: config.monitor.as_machine().to_string() };
        // Fails if the operator stopped waiting.
        let _ = reply.send(answer);
        Ok(())
    }

    /// Applies a command; returns a confirmation for the operator, or the reason why the command is refused.
    async fn apply_command(
        &mut self,
        machine: &MachineId,
        command: &Command,
        now: Timestamp,
        config: &Config,
    ) -> Result<Result<String, String>, StoreError> {
        let needs_throws = !matches!(command, Command::Ack { .. } | Command::Shelve { .. } | Command::Unshelve { .. });
        if needs_throws && (machine.machine.as_str() == ALL_MACHINES || *machine == self.own_machine) {
            let text = format!("{machine} is no machine with throws: its alarms can be acknowledged and shelved only");
            return Ok(Err(text));
        }
        if *machine == self.own_machine && !self.judge.monitors.knows(machine) {
            return Ok(Err("this daemon has no alarm about itself".to_owned()));
        }
        if matches!(command, Command::Retire { .. }) && self.shared.loggers.borrow().alive.contains(machine) {
            let text =
                format!("the logger of {machine} is connected: switch it off first, as its next throw would undo this");
            return Ok(Err(text));
        }
        let applied = self.judge.monitors.apply_command(machine, command, now, &config.diagnosis);
        let (outcome, confirmation) = match applied {
            Ok(applied) => applied,
            Err(reason) => return Ok(Err(reason)),
        };
        let is_stored = self.record(outcome).await?;
        self.update_report();
        if !is_stored {
            self.judge.monitors.store_again(machine);
            let text = "the database did not store the command. It may hold until the next start only, and is missing in \
                        operator_commands: look in the log";
            return Ok(Err(text.to_owned()));
        }
        tracing::info!(%machine, command = wire::json(command), "operator's command applied");
        // The logger may have made throws before the repair that it could not send yet.
        let late = if matches!(command, Command::Rebaseline { .. }) && self.judge.monitors.may_send_undated(machine) {
            ". Throws that the logger made before this command and sends later may be learned too, as it has not yet \
             sent two throws as they were made, from which the difference of the clocks is known. If there are any, \
             repeat the command when they have arrived"
        } else {
            ""
        };
        Ok(Ok(confirmation + late))
    }
}
