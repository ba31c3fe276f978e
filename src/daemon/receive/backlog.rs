//! Fetches missing throws from the loggers' backlogs.
//!
//! The database has the cursor of each machine: the last throw up to which all throws are stored or written off as
//! gaps. A logger is queried for the throws after the cursor when its liveliness token appears, when a throw number is
//! missing, when one of its messages was dropped, and every few minutes. A logger without a token is also queried
//! several times in the first minutes, in which it connects again. The next page is queried when the previous page is
//! stored. The queries of several pages in a row are the turn of the logger; then other loggers have their turn.

use std::{
    collections::{HashMap, HashSet, hash_map::Entry},
    mem,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    time::Duration,
};

use tokio::{
    sync::{Semaphore, SemaphorePermit, mpsc, watch},
    time::{self, Instant},
};
use tokio_util::task::JoinMap;

use super::{
    Intake,
    pages::{LONG_TURN, NextPage, QueryEnd},
};
use crate::{
    daemon::{clock, shared::Shared},
    store::seldom,
    throw::MachineId,
    wire::{self, Kind},
};

/// Largest number of loggers queried at the same time. A page has at most 4 MiB, and its decoded throws take up to four
/// times as much, so this bounds the memory to 160 MiB. A larger throw comes alone, and only one at a time: by default
/// another 80 MiB.
const AT_A_TIME: usize = 8;
/// Largest number of slow loggers among them, so that the other loggers always make progress.
const SLOW_AT_A_TIME: usize = AT_A_TIME / 2;
/// If a connected logger replies for this long without the awaited throws, or has no queryable, it does not have them.
/// They are written off as a gap.
const PATIENCE: Duration = Duration::from_secs(5);
/// Pause after a failed query, doubled up to [`LONGEST_PAUSE`].
const PAUSE: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_mins(1);
/// Time between two queries of all loggers, in case another trigger was missed.
const ROUND: Duration = Duration::from_mins(5);
/// The time between the first rounds, which query only the loggers without a token, grows by this factor from [`PAUSE`].
const LATER: u32 = 4;
/// Least time between two database queries for missing throws.
const MISSING_CHECK: Duration = Duration::from_millis(100);
/// Largest number of machines with missing throws in one database query.
const MISSING: u32 = 10_000;

/// The places of the loggers that are queried at the same time.
struct Places {
    all: Semaphore,
    slow: Semaphore,
    /// The place of the logger whose next throw is larger than a page: its query takes the memory of several pages.
    large: Semaphore,
}

impl Default for Places {
    fn default() -> Self {
        Self { all: Semaphore::new(AT_A_TIME), slow: Semaphore::new(SLOW_AT_A_TIME), large: Semaphore::new(1) }
    }
}

impl Places {
    /// Waits for a place, in the order of the calls. A logger that waits for one of the scarce places holds no other one.
    async fn take(&self, is_slow: bool, is_large: bool) -> [Option<SemaphorePermit<'_>>; 3] {
        // The results are always `Ok`, as nothing closes the semaphores.
        let large = if is_large { self.large.acquire().await.ok() } else { None };
        let slow = if is_slow { self.slow.acquire().await.ok() } else { None };
        [large, slow, self.all.acquire().await.ok()]
    }
}

/// State that [`Backlog`] shares with the task that queries a logger.
#[derive(Default)]
struct Turns {
    requests: watch::Sender<()>,
    /// Whether the logger was not connected at the last query.
    was_away: AtomicBool,
}

/// The task that starts the queries of the loggers.
pub(crate) struct Backlog {
    shared: Arc<Shared>,
    intake: Arc<Intake>,
    /// Machines whose loggers had a token at their last change.
    seen: HashSet<MachineId>,
    /// Keys of live messages that were dropped.
    dropped: mpsc::Receiver<String>,
    places: Arc<Places>,
    turns: HashMap<MachineId, Arc<Turns>>,
    /// The tasks that query these loggers, see [`Intake::query_in_turns`].
    queries: JoinMap<MachineId, watch::Receiver<()>>,
}

impl Backlog {
    pub(in crate::daemon) fn new(shared: Arc<Shared>, intake: Arc<Intake>, dropped: mpsc::Receiver<String>) -> Self {
        let (seen, places, turns, queries) = (HashSet::new(), Arc::default(), HashMap::new(), JoinMap::new());
        Self { shared, intake, seen, dropped, places, turns, queries }
    }

    pub(crate) async fn run(mut self) {
        let (mut round, mut until_next_round) = (Instant::now(), PAUSE);
        let mut check = clock::every(MISSING_CHECK);
        let mut may_miss = true;
        let mut loggers = self.shared.loggers.clone();
        loop {
            tokio::select! {
                () = self.shared.stops.receive.cancelled() => return self.queries.shutdown().await,
                Ok(()) = loggers.changed() => {
                    let alive = loggers.borrow_and_update().alive.clone();
                    let seen = mem::replace(&mut self.seen, alive.clone());
                    alive.difference(&seen).for_each(|machine| self.request(machine));
                }
                Some(key) = self.dropped.recv() => {
                    seldom!(warn, key, "the queue of received messages is full: messages DROPPED");
                    // Not any machine, as a flood may have any number of keys.
                    if let Ok((machine, Kind::Throw)) = wire::parse_key(&key)
                        && (self.seen.contains(&machine) || self.intake.knows(&machine))
                    {
                        self.request(&machine);
                    }
                }
                () = self.shared.missing.notified() => may_miss = true,
                _ = check.tick(), if may_miss => {
                    may_miss = false;
                    self.request_missing().await;
                }
                () = time::sleep_until(round) => {
                    for machine in self.intake.without_token() {
                        if !self.turns.contains_key(&machine) {
                            self.request(&machine);
                        }
                    }
                    if until_next_round >= ROUND {
                        self.seen.clone().iter().for_each(|machine| self.request(machine));
                    }
                    round += until_next_round;
                    until_next_round = (LATER * until_next_round).min(ROUND);
                }
                Some((machine, ended)) = self.queries.join_next() => match ended {
                    Ok(requests) => {
                        may_miss = true;
                        let is_requested = matches!(requests.has_changed(), Ok(true));
                        self.turns.remove(&machine);
                        if is_requested {
                            self.request(&machine);
                        }
                    }
                    // This task ends, and with it the daemon.
                    Err(error) => return tracing::error!(%machine, %error, "querying a logger failed"),
                },
            }
        }
    }

    /// Requests a query of a logger as soon as possible. Throws that would go to quarantine are not requested: their
    /// logger would send its whole backlog in each round. Nor are the missing throws of a machine that this daemon does
    /// not serve any more.
    fn request(&mut self, machine: &MachineId) {
        if !self.shared.config.subscribe.serves(machine) || !self.intake.may_store(machine) {
            return;
        }
        let turns = match self.turns.entry(machine.clone()) {
            Entry::Occupied(turns) => return turns.get().requests.send_replace(()),
            Entry::Vacant(new) => Arc::clone(new.insert(Arc::default())),
        };
        let (intake, places) = (Arc::clone(&self.intake), Arc::clone(&self.places));
        self.queries.spawn(machine.clone(), intake.query_in_turns(machine.clone(), turns, places));
    }

    /// Requests queries of the loggers with missing throws, except those that wait for their next try.
    async fn request_missing(&mut self) {
        match self.shared.store.reader().backlogs(MISSING).await {
            Ok(machines) => {
                for machine in machines {
                    let was_away = self.turns.get(&machine).map(|turns| turns.was_away.load(Relaxed));
                    if was_away.is_none_or(|was_away| was_away && self.intake.is_connected(&machine)) {
                        self.request(&machine);
                    }
                }
            }
            Err(error) => seldom!(warn, %error, "reading the missing throws failed; retrying"),
        }
        if let Ok(awaited) = self.shared.store.reader().awaited().await {
            self.shared.status.edit().backlog = awaited;
        }
    }
}

impl Intake {
    /// Queries a logger in turns, until it has no newer throw and none is missing. Returns the requests: one may have come
    /// after the last query.
    async fn query_in_turns(
        self: Arc<Self>,
        machine: MachineId,
        turns: Arc<Turns>,
        places: Arc<Places>,
    ) -> watch::Receiver<()> {
        let mut requests = turns.requests.subscribe();
        let mut next = NextPage::default();
        // Number of consecutive failed turns, and the time since which the logger replies without the awaited throws.
        let (mut failures, mut without_since, mut is_slow) = (0, None, false);
        loop {
            let place = places.take(is_slow, next.is_large).await;
            requests.mark_unchanged();
            let start = Instant::now();
            // In a box, as thousands of loggers may wait for a place.
            let ended = Box::pin(self.query(&machine, &mut next)).await;
            is_slow = start.elapsed() >= LONG_TURN;
            drop(place);
            let may_reply = self.may_reply(&machine).await;
            let is_connected = self.is_connected(&machine);
            turns.was_away.store(!is_connected, Relaxed);
            self.shared.missing.notify_one();
            let (failed, since) = (mem::take(&mut failures), without_since.take());
            let pause = match ended {
                QueryEnd::Complete => return requests,
                QueryEnd::More => Duration::ZERO,
                // Its link is closed, and its backlog may still have the throws.
                QueryEnd::Without(_) if is_connected && !may_reply => PAUSE,
                QueryEnd::Without(cursor) if is_connected => {
                    let since = *without_since.insert(since.unwrap_or_else(Instant::now));
                    if since.elapsed() >= PATIENCE {
                        match self.shared.store.write_off(&machine, &cursor, clock::now()).await {
                            Ok(()) => return requests,
                            Err(error) => seldom!(warn, %error, "storing a gap failed; retrying"),
                        }
                    }
                    PAUSE
                }
                // Queried earlier if its token or one of its throws appears. Its machine may have been retired, or the
                // missing throws stored.
                QueryEnd::Without(_) => match self.shared.store.reader().cursor(&machine).await {
                    Ok(cursor) if !cursor.awaits => return requests,
                    _ => LONGEST_PAUSE,
                },
                QueryEnd::Broken => {
                    failures = (failed + 1).min(16);
                    (PAUSE * 2_u32.saturating_pow(failed)).min(LONGEST_PAUSE)
                }
            };
            // A request ends the pause.
            let _ = time::timeout(pause, requests.changed()).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::pin::pin;

    use super::*;

    #[tokio::test]
    async fn slow_loggers_leave_places_to_the_others() {
        let places = Places::default();
        let take = async |is_slow| time::timeout(Duration::ZERO, places.take(is_slow, false)).await.ok();
        let mut slow = Vec::new();
        while let Some(place) = take(true).await {
            slow.push(place);
        }
        assert_eq!(slow.len(), SLOW_AT_A_TIME);
        let fast = take(false).await;
        assert!(fast.is_some());
        slow.pop();
        assert!(take(true).await.is_some());
    }

    #[tokio::test]
    async fn one_logger_at_a_time_sends_large_throws_and_the_next_holds_no_place() {
        let places = Places::default();
        let large = places.take(false, true).await;
        let mut waiting = pin!(places.take(false, true));
        assert!(time::timeout(Duration::ZERO, &mut waiting).await.is_err());
        assert_eq!(places.all.available_permits(), AT_A_TIME - 1);
        drop(large);
        assert!(time::timeout(Duration::ZERO, waiting).await.is_ok());
    }
}
