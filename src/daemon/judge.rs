//! The loop that judges: identifies what waits in the spool, diagnoses it in the order of arrival, commits, tells.
//! It alone owns the monitors, so operators' commands and the passing of time go through it too.

use std::{
    collections::{HashMap, HashSet, VecDeque},
    future,
    sync::{Arc, atomic::Ordering::Relaxed},
    time::{Duration, Instant},
};

use jiff::{SignedDuration, Timestamp};
use tokio::{
    sync::{Notify, broadcast, mpsc, oneshot, watch},
    time,
};
use tokio_util::sync::CancellationToken;

use super::{clock, config::Config, fleet::Fleet, heartbeat::Organ, identify::Pool, status::Status};
use crate::{
    bus::Outlet,
    diagnose::{AlarmEvent, Command},
    store::{GapRow, Judgement, Message, Outcome, Store, StoreError, StoredThrow, ThrowRow},
    throw::{Direction, MachineId, ThrowRef},
    wire::{self, Health, Kind, Reply},
};

/// Throws that are identified together. The longest traces take 16 MB each, so this bounds memory at 256 MB.
const BATCH: u32 = 16;
/// How often monitors are told that time passes; they ask for once a minute at least.
const TICK: Duration = Duration::from_secs(5);
/// Ticks in an hour.
const TICKS_AN_HOUR: u32 = 720;
/// Missing throws may still come from the logger's cache: a gap is told to the monitor after this time.
const GAP_GRACE: SignedDuration = SignedDuration::from_secs(60);
/// Gaps that are looked at in one go; those of one machine are one event.
const GAPS: u32 = 10_000;
/// Pause after a failure of the database.
const PAUSE: Duration = Duration::from_millis(500);
/// An alarm that cannot be committed for so long is told all the same. What the ballast or a new connection mends takes
/// less; longer silence would pass for health.
const LONGEST_SILENCE: Duration = Duration::from_secs(10);

/// A judged throw, for those who watch in the same process.
#[derive(Debug, Clone)]
pub struct Judged {
    /// The machine.
    pub machine: MachineId,
    /// The throw.
    pub throw: ThrowRef,
    /// Its direction.
    pub direction: Option<Direction>,
    /// Its quality.
    pub quality: String,
    /// Throws in the baseline so far, of how many.
    pub baseline: Option<(usize, usize)>,
    /// Alarm events that it caused.
    pub events: Vec<AlarmEvent>,
}

/// A command with the way back to who asked.
pub(super) struct Order {
    pub(super) machine: MachineId,
    pub(super) command: Command,
    pub(super) reply: oneshot::Sender<Reply>,
}

/// An alarm of the daemon's own that is to be stored.
pub(super) struct Own {
    machine: MachineId,
    events: Vec<AlarmEvent>,
    outcome: Outcome,
    /// Since when it could have been stored.
    since: Instant,
    /// It was published before it could be stored.
    told: bool,
}

/// The loop that judges.
pub(super) struct Judge {
    pub(super) store: Store,
    pub(super) fleet: Fleet,
    pub(super) pool: Pool,
    pub(super) config: watch::Receiver<Arc<Config>>,
    pub(super) status: Arc<Status>,
    pub(super) outlet: Option<Outlet>,
    pub(super) spooled: Arc<Notify>,
    /// Rung when something waits to be published.
    pub(super) outbox: Arc<Notify>,
    pub(super) watchers: broadcast::Sender<Judged>,
    pub(super) give_up: CancellationToken,
    /// The machines whose loggers show that they are alive.
    pub(super) loggers: watch::Receiver<HashSet<MachineId>>,
    /// The name under which the daemon's own alarms stand, as if it were a machine.
    pub(super) itself: MachineId,
    /// Its alarms that are not stored yet: a raise, an escalation, a clearance at most, as the disk is full or not.
    pub(super) own: VecDeque<Own>,
    /// Ticks since the monitors were last kept as a whole.
    pub(super) ticks: u32,
}

impl Judge {
    /// Runs until `stop`, then judges what still waits.
    ///
    /// # Errors
    /// When the store is closed under it.
    pub(super) async fn run(
        mut self,
        mut orders: mpsc::Receiver<Order>,
        stop: CancellationToken,
    ) -> Result<(), StoreError> {
        let mut tick = time::interval(TICK);
        let mut beat = time::interval(Duration::from_secs(1));
        let mut more_waits = true;
        loop {
            self.status.heartbeats.beat(Organ::Identify);
            // One batch at a time: operators and the passing of time take turns with a long queue of throws.
            tokio::select! {
                () = stop.cancelled() => {
                    self.drain().await?;
                    return Ok(());
                }
                Some(order) = orders.recv() => self.obey(order).await?,
                _ = tick.tick() => self.let_time_pass().await?,
                () = future::ready(()), if more_waits => more_waits = self.judge_next().await?,
                () = self.spooled.notified() => more_waits = true,
                _ = beat.tick() => more_waits = true,
            }
        }
    }

    /// Judges everything that waits, and stores what was told before it could be.
    pub(super) async fn drain(&mut self) -> Result<(), StoreError> {
        while !self.give_up.is_cancelled() && self.judge_next().await? {}
        Ok(())
    }

    /// Judges the next batch of what waits. Returns whether there was any.
    async fn judge_next(&mut self) -> Result<bool, StoreError> {
        if !self.own.is_empty() {
            self.look_after_itself().await?;
        }
        match self.store.reader().pending(ThrowRow::START, BATCH).await {
            Ok(waiting) if waiting.is_empty() => Ok(false),
            Ok(waiting) => self.judge(waiting).await.map(|()| true),
            Err(StoreError::Closed) => Err(StoreError::Closed),
            Err(error) => {
                tracing::error!(%error, "the spool cannot be read; it is tried again");
                self.pause().await;
                Ok(false)
            }
        }
    }

    async fn judge(&mut self, waiting: Vec<StoredThrow>) -> Result<(), StoreError> {
        let config = Arc::clone(&self.config.borrow());
        let readable = waiting
            .iter()
            .filter_map(|stored| {
                Some((stored.throw.as_ref().ok()?.clone(), config.machines.of(&stored.machine).clone()))
            })
            .collect();
        let mut found = self.pool.identify(readable).await.into_iter();
        let (mut judgements, mut events) = (Vec::with_capacity(waiting.len()), Vec::with_capacity(waiting.len()));
        for stored in &waiting {
            let identification = stored.throw.is_ok().then(|| found.next().flatten()).flatten();
            let (judgement, verdict) = self.fleet.judge(stored, identification, &config.diagnosis, clock::now());
            judgements.push(judgement);
            events.push(verdict.events);
        }
        self.status.heartbeats.beat(Organ::Identify);
        let judgements: Arc<[Judgement]> = judgements.into();
        if self.commit(&judgements).await? {
            for ((stored, judgement), events) in waiting.iter().zip(&*judgements).zip(events) {
                self.tell(stored, judgement, events);
            }
        }
        Ok(())
    }

    /// Commits together what was identified together: a burst after a cut link costs the disk one sync for all of it.
    /// False when the daemon must end first. The monitors in memory are then ahead of the database, which nobody will
    /// see: the next start goes on from the database.
    async fn commit(&mut self, judgements: &Arc<[Judgement]>) -> Result<bool, StoreError> {
        loop {
            match self.store.judge_all(Arc::clone(judgements)).await {
                Ok(_) => return Ok(true),
                Err(StoreError::Closed) => return Err(StoreError::Closed),
                Err(error) => tracing::warn!(%error, "judgements cannot be stored; it is tried again"),
            }
            self.look_after_itself().await?;
            self.status.heartbeats.beat(Organ::Identify);
            if self.give_up.is_cancelled() {
                return Ok(false);
            }
            self.pause().await;
        }
    }

    fn tell(&self, stored: &StoredThrow, judgement: &Judgement, events: Vec<AlarmEvent>) {
        self.status.judged.fetch_add(1, Relaxed);
        if judgement.quality != wire::GOOD {
            self.status.refuse(&judgement.quality);
        }
        if let Some(outlet) = &self.outlet {
            outlet.health(wire::machine_key(&stored.machine, Kind::Health), health(stored, judgement).to_json());
        }
        self.announce(&stored.machine, &events);
        // Nobody needs to watch.
        let _ = self.watchers.send(Judged {
            machine: stored.machine.clone(),
            throw: stored.id.clone(),
            direction: judgement.identification.as_ref().and_then(|found| found.direction),
            quality: judgement.quality.clone(),
            baseline: judgement.baseline,
            events,
        });
    }

    fn announce(&self, machine: &MachineId, events: &[AlarmEvent]) {
        for event in events {
            tracing::warn!(%machine, cause = event.cause.as_str(), state = event.state.as_str(), "{}", event.text);
        }
        if !events.is_empty() {
            self.status.alarm_events.fetch_add(events.len() as u64, Relaxed);
            self.outbox.notify_one();
        }
    }

    async fn record(&mut self, machine: &MachineId, outcome: Outcome, at: Timestamp) -> Result<bool, StoreError> {
        loop {
            match self.store.record(machine, at, outcome.clone()).await {
                Ok(()) => return Ok(true),
                Err(StoreError::Closed) => return Err(StoreError::Closed),
                Err(error) => tracing::warn!(%error, "a change of an alarm cannot be stored; it is tried again"),
            }
            self.look_after_itself().await?;
            self.status.heartbeats.beat(Organ::Identify);
            if self.give_up.is_cancelled() {
                return Ok(false);
            }
            self.pause().await;
        }
    }

    async fn let_time_pass(&mut self) -> Result<(), StoreError> {
        let config = Arc::clone(&self.config.borrow());
        let now = clock::now();
        // Silence adds up inside the monitors: kept once an hour, so that restarts do not forget it.
        self.ticks += 1;
        let keep_all = self.ticks.is_multiple_of(TICKS_AN_HOUR);
        self.look_after_itself().await?;
        let changed = self.fleet.tick(now, &config.diagnosis, &self.loggers.borrow(), keep_all);
        for (machine, events, outcome) in changed {
            if self.record(&machine, outcome, now).await? {
                self.announce(&machine, &events);
            }
        }
        for (machine, (lost, rows)) in self.ripe_gaps(now).await {
            let (events, mut outcome) = self.fleet.gap(&machine, lost, now, &config.diagnosis);
            outcome.told_gaps = rows;
            if self.record(&machine, outcome, now).await? {
                self.announce(&machine, &events);
            }
        }
        Ok(())
    }

    /// Sees to the daemon's own alarms. That nothing can be stored for long cannot be stored either: such an alarm is told
    /// before it is committed, and told again once it is.
    async fn look_after_itself(&mut self) -> Result<(), StoreError> {
        let (config, now) = (Arc::clone(&self.config.borrow()), clock::now());
        let news = self.fleet.trouble(&self.itself, self.store.trouble().as_ref(), now, &config.diagnosis);
        let since = clock::monotonic();
        self.own.extend(news.map(|(machine, events, outcome)| Own { machine, events, outcome, since, told: false }));
        while let Some(own) = self.own.pop_front() {
            match self.store.record(&own.machine, now, own.outcome.clone()).await {
                Ok(()) => self.announce(&own.machine, &own.events),
                Err(StoreError::Closed) => return Err(StoreError::Closed),
                Err(_) => {
                    self.own.push_front(own);
                    self.tell_uncommitted().await;
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    async fn tell_uncommitted(&mut self) {
        let Some(outlet) = &self.outlet else { return };
        for own in self
            .own
            .iter_mut()
            .filter(|own| !own.told && clock::monotonic().duration_since(own.since) >= LONGEST_SILENCE)
        {
            own.told = true;
            for Message { key, payload } in &own.outcome.outbox {
                tracing::error!(key, "an alarm cannot be stored yet and is told all the same");
                // The log has it, whatever becomes of this.
                let _ = time::timeout(PAUSE, outlet.alarm(key.clone(), payload.clone())).await;
            }
        }
    }

    /// Gaps that nobody will fill any more, and that the monitors do not know of: of each machine the number of throws
    /// that are missing, and the rows.
    async fn ripe_gaps(&self, now: Timestamp) -> HashMap<MachineId, (u64, Vec<GapRow>)> {
        let mut ripe = HashMap::<_, (u64, Vec<_>)>::new();
        let gaps = self.store.reader().untold_gaps(GAPS).await.unwrap_or_else(|error| {
            tracing::warn!(%error, "gaps cannot be read; they are looked at again");
            Vec::new()
        });
        for gap in gaps.into_iter().filter(|gap| now.duration_since(gap.detected_at).abs() >= GAP_GRACE) {
            let (lost, rows) = ripe.entry(gap.machine).or_default();
            *lost = lost.saturating_add(gap.last_no - gap.first_no + 1);
            rows.push(gap.row);
        }
        ripe
    }

    async fn obey(&mut self, order: Order) -> Result<(), StoreError> {
        let Order { machine, command, reply } = order;
        let config = Arc::clone(&self.config.borrow());
        let now = clock::now();
        let answer = match self.fleet.command(&machine, &command, now, &config.diagnosis) {
            None => {
                Reply { done: false, text: format!("no machine {machine} is known here: it has sent no throw yet") }
            }
            Some(Err(error)) => Reply { done: false, text: error.to_string() },
            Some(Ok((events, outcome))) => {
                let stored = self.record(&machine, outcome, now).await?;
                self.announce(&machine, &events);
                tracing::info!(%machine, ?command, "an operator's command was carried out");
                let text = match events.last() {
                    Some(event) => event.text.clone(),
                    None => format!("{machine}: done"),
                };
                Reply { done: stored, text }
            }
        };
        // Who asked may have gone.
        let _ = reply.send(answer);
        Ok(())
    }

    async fn pause(&self) {
        tokio::select! {
            () = time::sleep(PAUSE) => {}
            () = self.give_up.cancelled() => {}
        }
    }
}

fn health(stored: &StoredThrow, judgement: &Judgement) -> Health {
    let found = judgement.identification.as_ref();
    let estimate = found.and_then(|found| found.outcome.as_ref().ok());
    let sd = |at: usize| estimate.map(|estimate| estimate.covariance[(at, at)].sqrt());
    let change = |at: usize| judgement.change_pct.map(|change| change[at]);
    let direction = found.and_then(|found| found.direction);
    let features = found.map(|found| found.features.clone()).unwrap_or_default();
    Health {
        schema: Health::SCHEMA.to_owned(),
        site: stored.machine.site.to_string(),
        machine: stored.machine.machine.to_string(),
        boot_id: stored.id.boot_id.clone(),
        throw_no: stored.id.throw_no,
        started_at: stored.started_at,
        direction: direction.map_or("unknown", Direction::as_str).to_owned(),
        quality: judgement.quality.clone(),
        b0: estimate.map(|estimate| estimate.b0),
        a1: estimate.map(|estimate| estimate.a1),
        a0: estimate.map(|estimate| estimate.a0),
        b0_sd: sd(0),
        a1_sd: sd(1),
        a0_sd: sd(2),
        b0_pct: change(0),
        a1_pct: change(1),
        a0_pct: change(2),
        fit_pct: estimate.map(|estimate| estimate.fit_pct),
        duration_s: features.duration_s,
        peak_current_a: features.peak_current_a,
        mean_current_a: features.mean_current_a,
    }
}
