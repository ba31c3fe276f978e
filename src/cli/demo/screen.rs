//! Output of the demo. A terminal shows the progress of throws and baselines, and the alarms; a pipe gets a line for
//! each complete baseline and each alarm.

use std::io::IsTerminal;

use indicatif::{MultiProgress, ProgressBar};

use super::output;
use crate::{
    diagnose::{AlarmEvent, AlarmState, Severity},
    store::Judgement,
    throw::MachineId,
    wire::BaselineProgress,
};

const BOLD: &str = "\x1b[1m";
const YELLOW: &str = "\x1b[33m";
const RED: &str = "\x1b[31m";
const GREEN: &str = "\x1b[32m";
const PLAIN: &str = "\x1b[0m";

pub(super) struct Screen {
    bars: MultiProgress,
    machines: Vec<Line>,
    terminal: bool,
}

struct Line {
    bar: ProgressBar,
    throws: u64,
    /// Progress of the baseline of each direction.
    baselines: [BaselineProgress; 2],
    learned: bool,
}

impl Screen {
    pub(super) fn new(machines: usize, throws: u64) -> Self {
        let terminal = std::io::stdout().is_terminal();
        let bars = MultiProgress::new();
        let template = "  {prefix:<12} {bar:30.cyan/blue} {pos:>4} throws  {wide_msg}";
        let line = |_| {
            let bar = output::progress(throws, template);
            let bar = if terminal { bars.add(bar) } else { ProgressBar::hidden() };
            Line { bar, throws: 0, baselines: [BaselineProgress { so_far: 0, needed: 1 }; 2], learned: false }
        };
        let machines = (0..machines).map(line).collect();
        Self { bars, machines, terminal }
    }

    pub(super) fn throw(&mut self, machines: &[MachineId], Judgement { health, outcome, .. }: &Judgement) {
        let Some(number) = machines.iter().position(|machine| *machine == health.machine) else { return };
        let line = &mut self.machines[number];
        line.throws += 1;
        line.bar.set_prefix(health.machine.machine.to_string());
        line.bar.set_position(line.throws);
        if let (Some(direction), Some(baseline)) = (health.direction, health.baseline) {
            line.baselines[direction.side()] = baseline;
        }
        let so_far: u64 = line.baselines.iter().map(|baseline| baseline.so_far).sum();
        let needed: u64 = line.baselines.iter().map(|baseline| baseline.needed).sum();
        if !line.learned {
            line.bar.set_message(format!("baseline {so_far} of {needed}"));
        }
        if !line.learned && needed > 2 && so_far >= needed {
            line.learned = true;
            line.bar.set_message("monitored");
            self.print(&format!("{}: baseline complete, {so_far} throws", health.machine));
        }
        for event in &outcome.events {
            self.alarm(number, event);
        }
    }

    fn alarm(&self, number: usize, event: &AlarmEvent) {
        let (colour, word) = match (event.state, event.severity) {
            (AlarmState::Normal | AlarmState::ClearedUnacknowledged, _) => (GREEN, "cleared"),
            (_, Severity::Warning) => (YELLOW, "WARNING"),
            (_, Severity::Critical) => (RED, "CRITICAL"),
        };
        if self.terminal {
            self.machines[number].bar.set_message(format!("{colour}{word}: {}{PLAIN}", event.cause));
            self.print(&format!("{BOLD}{colour}{word}{PLAIN} {}", event.text));
        } else {
            self.print(&format!("{word} {}", event.text));
        }
    }

    /// Prints a line above the bars. Errors are ignored: the result of the demo is its exit code.
    fn print(&self, line: &str) {
        if self.terminal {
            let _ = self.bars.println(line);
        } else {
            let _ = output::line(line);
        }
    }

    pub(super) fn finish(&self) {
        for line in &self.machines {
            line.bar.abandon();
        }
        let _ = output::line("");
    }
}
