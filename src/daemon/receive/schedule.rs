//! The times at which the loggers are queried for their backlogs. Slow loggers may occupy only half of the places.

use std::{
    collections::{BTreeSet, HashMap},
    time::Duration,
};

use tokio::time::Instant;

use crate::{store::Cursor, throw::MachineId};

/// Largest number of loggers queried at the same time. A page has at most 4 MiB, and its decoded throws take up to four
/// times as much, so this bounds the memory to 160 MiB.
pub(super) const AT_A_TIME: usize = 8;
/// Largest number of slow loggers among them, so that the other loggers always make progress.
const SLOW_AT_A_TIME: usize = AT_A_TIME / 2;
/// Throws in the first page, while the size of the throws and the speed of the link are unknown.
const FIRST_PAGE: usize = 4;

/// A logger in the schedule.
#[derive(Debug)]
pub(crate) struct Turn {
    /// Time of the next query.
    at: Instant,
    in_progress: bool,
    /// Index of the logger's queue in [`Schedule::due`]: 1 if its last query was slow.
    class: usize,
    /// Whether a query was requested while one was in progress: the next one then starts at once.
    again: bool,
    /// Number of consecutive failed queries.
    pub(crate) tries: u32,
    /// Time since which the logger replies without the awaited throws.
    pub(super) without_since: Option<Instant>,
    /// Whether the logger was not connected at the last query.
    pub(super) was_away: bool,
    /// `None` before the first query, and while a query is in progress.
    pub(super) next_page: Option<NextPage>,
}

/// The query with which the next turn of a logger begins.
#[derive(Debug)]
pub(super) struct NextPage {
    /// Largest number of throws.
    pub(super) size: usize,
    /// The position after the last stored page; `None` to begin at the cursor of the database.
    pub(super) after: Option<Cursor>,
    /// Whether throws of the machine were missing when its logger was queried from the cursor of the database.
    pub(super) awaits: bool,
    /// Number of pages without a new throw, since the last page with one.
    pub(super) repeated: usize,
}

/// The times of the next queries of the loggers.
#[derive(Default)]
pub(crate) struct Schedule {
    pub(super) turns: HashMap<MachineId, Turn>,
    /// Queues of the fast and of the slow loggers.
    due: [BTreeSet<(Instant, MachineId)>; 2],
    /// Number of slow loggers that are being queried.
    slow_in_progress: usize,
}

impl Schedule {
    /// Schedules a query as soon as possible.
    pub(crate) fn request(&mut self, machine: &MachineId) {
        let now = Instant::now();
        match self.turns.get_mut(machine) {
            Some(turn) if turn.in_progress => turn.again = true,
            Some(turn) => {
                let due = &mut self.due[turn.class];
                due.remove(&(turn.at, machine.clone()));
                turn.at = turn.at.min(now);
                due.insert((turn.at, machine.clone()));
            }
            None => {
                let turn = Turn {
                    at: now,
                    in_progress: false,
                    class: 0,
                    again: false,
                    tries: 0,
                    without_since: None,
                    was_away: false,
                    next_page: None,
                };
                self.turns.insert(machine.clone(), turn);
                self.due[0].insert((now, machine.clone()));
            }
        }
    }

    /// The time at which the next logger is due, and the index of its queue.
    fn first(&self) -> Option<(Instant, usize)> {
        let classes = if self.slow_in_progress < SLOW_AT_A_TIME { 2 } else { 1 };
        (0..classes).filter_map(|class| Some((self.due[class].first()?.0, class))).min()
    }

    /// Notes whether the last query of a logger, which has ended, was slow.
    pub(super) fn set_slow(&mut self, machine: &MachineId, was_slow: bool) {
        let Some(turn) = self.turns.get_mut(machine) else { return };
        self.slow_in_progress -= turn.class;
        turn.class = usize::from(was_slow);
    }

    /// Starts the turn of the next logger that is due; returns its machine and the query of its next page.
    pub(super) fn next(&mut self) -> Option<(MachineId, NextPage)> {
        let (at, class) = self.first()?;
        if at > Instant::now() {
            return None;
        }
        let (_, machine) = self.due[class].pop_first()?;
        self.slow_in_progress += class;
        let turn = self.turns.get_mut(&machine)?;
        (turn.in_progress, turn.again) = (true, false);
        let first = NextPage { size: FIRST_PAGE, after: None, awaits: false, repeated: 0 };
        Some((machine, turn.next_page.take().unwrap_or(first)))
    }

    /// The time at which the next logger is due.
    pub(super) fn wakes_at(&self) -> Option<Instant> {
        self.first().map(|(at, _)| at)
    }

    /// Ends the turn of a logger, and schedules the next one after a pause.
    pub(crate) fn rest(&mut self, machine: &MachineId, pause: Duration) {
        let Some(turn) = self.turns.get_mut(machine) else { return };
        turn.in_progress = false;
        turn.at = Instant::now() + if turn.again { Duration::ZERO } else { pause };
        self.due[turn.class].insert((turn.at, machine.clone()));
    }

    /// Ends the turn of a logger without missing throws.
    pub(crate) fn done(&mut self, machine: &MachineId) {
        if self.turns.remove(machine).is_some_and(|turn| turn.again) {
            self.request(machine);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_loggers_leave_places_to_the_others() {
        let named = |name: String| MachineId::new("north", &name).unwrap();
        let mut schedule = Schedule::default();
        let slow: Vec<MachineId> = (0..2 * AT_A_TIME).map(|number| named(format!("slow-{number}"))).collect();
        // The schedule does not know yet that they are slow.
        for machine in &slow {
            schedule.request(machine);
        }
        while let Some((machine, _)) = schedule.next() {
            schedule.set_slow(&machine, true);
            schedule.rest(&machine, Duration::ZERO);
            if schedule.due[1].len() == slow.len() {
                break;
            }
        }
        let taken: Vec<_> = std::iter::from_fn(|| schedule.next()).collect();
        assert_eq!(taken.len(), SLOW_AT_A_TIME);
        assert_eq!(schedule.wakes_at(), None, "it would wait without a pause");
        let fast = named("fast".to_owned());
        schedule.request(&fast);
        assert_eq!(schedule.next().unwrap().0, fast);
        // A place of a slow logger becomes free.
        schedule.set_slow(&taken[0].0, false);
        schedule.rest(&taken[0].0, Duration::ZERO);
        assert!(slow.contains(&schedule.next().unwrap().0));
    }
}
