//! Which samples of each publisher are still to come, and what to ask its cache for.
//!
//! An advanced publisher numbers its samples from 0, keeps the last of them in a cache that can be asked by number, and
//! tells now and then how far it is. The follower holds the number that comes next: what is there in order is handed on;
//! what is missing is asked for in pages, the oldest first, as fast as the asker takes them. So no more than a page of a
//! publisher is ever on its way, however much it has cached and however long it was out of reach, and nothing is given up
//! while its liveliness token is away.
//!
//! It takes events and returns samples and questions; whoever holds it asks them and brings the answers.

use std::{
    collections::{BTreeMap, HashMap, HashSet, VecDeque},
    ops::RangeInclusive,
    time::{Duration, Instant},
};

use super::room;

/// Samples that are asked for together, fewer when they are large or their link is slow.
pub(super) const PAGE: u32 = 32;
/// What a page is meant to have \[bytes\]: with 70 kB a second it comes before its time is up.
const PAGE_BYTES: usize = 1 << 20;
/// Samples of the first page of a publisher, whose size is not known.
const FIRST_PAGE: u32 = 4;
/// Samples of a publisher that came before their turn and are kept until it is. The next are handed on at once.
const HELD: usize = 64;
/// Together they take at most this \[bytes\].
const HELD_BYTES: usize = 32 << 20;
/// Runs of numbers that were handed on before their turn. What is in more of them is asked for again, and counts as missed
/// when it is not there.
const RUNS: usize = 64;
/// A sample that is further behind than this tells that its publisher counts from 0 again: pages overtake no more live
/// samples than can wait in the queue.
#[expect(clippy::cast_possible_truncation, reason = "16,384")]
const RESTART: u32 = room::MESSAGES as u32;
/// After a question that nobody answered comes this pause, doubled each time.
const PAUSE: Duration = Duration::from_secs(1);
/// So many questions in a row without an answer, in 7 s, and what they asked for is given up.
const TRIES: u32 = 4;
/// The same for one that never answered, but shows a token: it has no cache, and what came is not to wait for nothing.
const TRIES_WITHOUT_CACHE: u32 = 2;
/// Publishers of one key that are remembered: those that are there, and the last starts of its logger.
const ORIGINS: usize = 32;
/// Entries that wait and may be of publishers that were forgotten, before they are looked through.
const STALE: usize = 1_024;

/// A publisher: what it publishes on, its session and its number in it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Origin {
    pub(super) key: String,
    pub(super) zid: String,
    pub(super) eid: u32,
}

/// What to ask the cache of a publisher for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Question {
    pub(super) origin: Origin,
    pub(super) numbers: RangeInclusive<u32>,
    /// Only the newest of them.
    pub(super) newest: bool,
    /// The number that came next when it was asked.
    next: u32,
    id: u64,
}

/// How a question ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Ending {
    /// All that there is has come.
    Complete,
    /// The time was up first, or something failed: what did not come may still be there.
    Broken,
    /// It could not be asked at all.
    Unasked,
}

/// What follows of an event.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Outcome<T> {
    /// Samples whose turn it is, in order.
    pub(super) samples: Vec<T>,
    /// Samples that no cache has any more.
    pub(super) missed: u64,
}

impl<T> Outcome<T> {
    fn none() -> Self {
        Self { samples: Vec::new(), missed: 0 }
    }
}

/// All publishers.
#[derive(Debug)]
pub(super) struct Follower<T> {
    /// The publishers of each key.
    tracks: HashMap<String, Vec<Track<T>>>,
    /// Keys whose publishers are remembered. Of one that was forgotten all is asked for that it has cached.
    keys: usize,
    /// Those with something to ask, in turn.
    asking: VecDeque<Origin>,
    /// The size of a sample \[bytes\].
    bytes_of: fn(&T) -> usize,
    /// Those that were asked and did not answer.
    resting: Vec<(Instant, Origin)>,
    held_bytes: usize,
    clock: u64,
    /// When there was nobody to forget: not before this it is tried again.
    full_until: u64,
}

#[derive(Debug)]
struct Track<T> {
    zid: String,
    eid: u32,
    /// The number that comes next.
    next: u32,
    /// One more than the highest number that is known to be published.
    end: u32,
    /// The lowest number that was handed on: what was before it is none of ours to miss.
    first: u32,
    /// Samples that wait for their turn, with their bytes.
    held: BTreeMap<u32, (usize, T)>,
    /// What was handed on before its turn: from a number up to another.
    ahead: BTreeMap<u32, u32>,
    /// Whether its liveliness token is there; none was ever seen of some.
    alive: Option<bool>,
    /// One more than the highest number that came on its own.
    seen: u32,
    step: Step,
    turn: Turn,
    /// The size of its last sample \[bytes\]; 0 before the first.
    bytes: usize,
    /// Samples that its link brings in time.
    page: u32,
    /// Questions in a row that nobody answered.
    tries: u32,
    /// Whether it has a cache: it has answered.
    has_cache: bool,
    /// When it was last heard of, by the follower's clock.
    used: u64,
    /// Since when its numbers are those of now.
    since: u64,
}

/// Where the asking is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    /// How far is it?
    Probe,
    /// The next samples.
    Page,
    /// They are not there: which is the newest that is?
    Newest,
    /// Which is the oldest? Not below `low`, not above `high`, which is there.
    Oldest { low: u32, high: u32 },
    /// This is the oldest, it seems: the page from there on. When it comes, nothing before it does.
    From(u32),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turn {
    /// Nothing to ask.
    Idle,
    /// It waits for its turn.
    Waits,
    /// This question is on its way.
    Asked(u64),
    /// It did not answer, and is asked again later.
    Rests,
}

impl<T> Follower<T> {
    pub(super) fn new(keys: usize, bytes_of: fn(&T) -> usize) -> Self {
        Self {
            tracks: HashMap::new(),
            keys,
            bytes_of,
            asking: VecDeque::new(),
            resting: Vec::new(),
            held_bytes: 0,
            clock: 0,
            full_until: 0,
        }
    }

    /// A sample came on its own. One from before its turn may be new all the same: the database knows.
    pub(super) fn live(&mut self, origin: &Origin, number: u32, sample: T) -> Outcome<T> {
        let bytes = (self.bytes_of)(&sample);
        let has_room = self.held_bytes + bytes <= HELD_BYTES;
        self.change(origin, |track, outcome| {
            let Some(track) = track else { return outcome.samples.push(sample) };
            if number.saturating_add(RESTART) < track.next || number == 0 && track.next > 1 {
                // Or pages overtook one that waited in the queue: the probe tells.
                track.restart(outcome);
                track.step = Step::Probe;
            }
            track.knows_of(number);
            track.has_seen(number);
            track.bytes = bytes;
            // One that waited in the queue while its publisher went says nothing about the publisher.
            let can_wait = has_room && track.held.len() < HELD && track.alive != Some(false);
            if number == track.next {
                track.hand_on(number, sample, outcome);
            } else if number > track.next && can_wait {
                outcome.samples.extend(track.held.insert(number, (bytes, sample)).map(|(_, displaced)| displaced));
            } else {
                track.hand_on_ahead(number, sample, outcome);
            }
        })
    }

    /// It has published up to this number.
    pub(super) fn reached(&mut self, origin: &Origin, number: u32) -> Outcome<T> {
        self.change(origin, |track, outcome| {
            if let Some(track) = track {
                track.reach(number, outcome);
            }
        })
    }

    /// A sample came on its own, and there was no room for it.
    pub(super) fn refused(&mut self, origin: &Origin, number: u32) -> Outcome<T> {
        self.change(origin, |track, outcome| match track {
            Some(track) => {
                track.reach(number, outcome);
                track.has_seen(number);
                track.first = track.first.min(number);
            }
            None => outcome.missed += 1,
        })
    }

    /// How many samples are known to be published, are not here, and are not given up.
    pub(super) fn behind(&self) -> u64 {
        self.tracks.values().flatten().map(Track::behind).sum()
    }

    /// It has come, or come back: it may have published since.
    pub(super) fn appeared(&mut self, origin: &Origin) -> Outcome<T> {
        self.change(origin, |track, _| {
            if let Some(track) = track {
                track.visit(true, Step::Probe);
            }
        })
    }

    /// It cannot be reached. What it has cached is asked for when it is back, if it ever is; what is here is handed on.
    pub(super) fn gone(&mut self, origin: &Origin) -> Outcome<T> {
        self.change(origin, |track, outcome| {
            if let Some(track) = track {
                track.visit(false, Step::Page);
                track.hand_on_held(outcome);
            }
        })
    }

    /// The next question, if there is one now.
    pub(super) fn question(&mut self, now: Instant) -> Option<Question> {
        for (_, origin) in self.resting.extract_if(.., |(until, _)| *until <= now) {
            if let Some(track) = of(&mut self.tracks, &origin)
                && track.turn == Turn::Rests
            {
                track.turn = Turn::Waits;
                self.asking.push_back(origin);
            }
        }
        while let Some(origin) = self.asking.pop_front() {
            let Some(track) = of(&mut self.tracks, &origin).filter(|track| track.turn == Turn::Waits) else { continue };
            if let Some((numbers, newest)) = track.question() {
                self.clock += 1;
                track.turn = Turn::Asked(self.clock);
                let next = track.next;
                return Some(Question { origin, numbers, newest, next, id: self.clock });
            }
            track.turn = Turn::Idle;
        }
        None
    }

    /// When there may be a question, if there is none now and nothing happens.
    pub(super) fn rests_until(&self) -> Option<Instant> {
        self.resting.iter().map(|(until, _)| *until).min()
    }

    /// The answer to a question: the samples with their numbers, in any order.
    pub(super) fn answered(
        &mut self,
        question: &Question,
        answer: Vec<(u32, T)>,
        ending: Ending,
        now: Instant,
    ) -> Outcome<T> {
        let answer: BTreeMap<u32, T> =
            answer.into_iter().filter(|(number, _)| question.numbers.contains(number)).collect();
        let bytes = answer.values().last().map(self.bytes_of).filter(|_| !question.newest);
        let mut rests_for = None;
        let outcome = self.change(&question.origin, |track, outcome| {
            let Some(track) = track else {
                return outcome.samples.extend(answer.into_values().filter(|_| !question.newest));
            };
            if track.turn != Turn::Asked(question.id) {
                return track.hear_late(question, answer, outcome);
            }
            track.turn = Turn::Idle;
            track.has_cache |= !answer.is_empty();
            track.bytes = bytes.unwrap_or(track.bytes);
            let page = track.page;
            let is_known = if question.newest {
                track.learn(answer.into_keys().next_back(), question.next, ending, outcome)
            } else {
                track.page = match ending {
                    Ending::Complete => (2 * page).min(PAGE),
                    Ending::Broken => (page / 2).max(1),
                    Ending::Unasked => page,
                };
                track.turn_page(answer, ending, outcome)
            };
            if is_known {
                track.tries = 0;
            } else if ending == Ending::Unasked || track.page < page {
                rests_for = Some(PAUSE);
            } else {
                rests_for = track.unanswered(ending, outcome);
            }
            if rests_for.is_some() {
                track.turn = Turn::Rests;
            }
        });
        if let Some(pause) = rests_for {
            self.resting.push((now + pause, question.origin.clone()));
        }
        self.sweep();
        outcome
    }

    /// Hands on whatever is held.
    pub(super) fn finish(&mut self) -> Vec<T> {
        let mut outcome = Outcome::none();
        for track in self.tracks.values_mut().flatten() {
            track.hand_on_held(&mut outcome);
        }
        self.held_bytes = 0;
        outcome.samples
    }

    /// Does something to a publisher, if it is or can be remembered, and gives it its turn when it has something to ask.
    fn change(&mut self, origin: &Origin, to_do: impl FnOnce(Option<&mut Track<T>>, &mut Outcome<T>)) -> Outcome<T> {
        let mut outcome = Outcome::none();
        self.clock += 1;
        self.remember(origin, &mut outcome);
        let Some(track) = of(&mut self.tracks, origin) else {
            to_do(None, &mut outcome);
            return outcome;
        };
        let before = track.held_bytes();
        track.used = self.clock;
        to_do(Some(track), &mut outcome);
        track.hand_on_ready(&mut outcome);
        self.held_bytes = self.held_bytes + track.held_bytes() - before;
        if track.turn == Turn::Idle && track.question().is_some() {
            track.turn = Turn::Waits;
            self.asking.push_back(origin.clone());
            self.sweep();
        }
        outcome
    }

    /// Remembers a publisher. Whoever invents many makes its own forgotten.
    fn remember(&mut self, origin: &Origin, outcome: &mut Outcome<T>) {
        if of(&mut self.tracks, origin).is_some() {
            return;
        }
        if self.tracks.len() >= self.keys && !self.tracks.contains_key(&origin.key) {
            if self.clock >= self.full_until {
                self.forget_half(outcome);
            }
            if self.tracks.len() >= self.keys {
                return;
            }
        }
        let tracks = self.tracks.entry(origin.key.clone()).or_default();
        if tracks.len() >= ORIGINS
            && let Some(oldest) = (0..tracks.len()).min_by_key(|&at| (tracks[at].alive == Some(true), tracks[at].used))
        {
            self.held_bytes -= tracks.swap_remove(oldest).forgotten(outcome);
        }
        tracks.push(Track::new(origin, self.clock));
    }

    /// Forgets those that were not heard of for longest, of those that do not show that they are there.
    fn forget_half(&mut self, outcome: &mut Outcome<T>) {
        let shows = |tracks: &Vec<Track<T>>| tracks.iter().any(|track| track.alive == Some(true));
        let used = |tracks: &Vec<Track<T>>| tracks.iter().map(|track| track.used).max().unwrap_or(0);
        let mut candidates: Vec<_> = self.tracks.values().filter(|tracks| !shows(tracks)).map(used).collect();
        self.full_until = self.clock + self.keys as u64 / 2;
        if candidates.is_empty() {
            return;
        }
        let middle = candidates.len() / 2;
        let (_, median, _) = candidates.select_nth_unstable(middle);
        let median = *median;
        for (_, tracks) in self.tracks.extract_if(|_, tracks| !shows(tracks) && used(tracks) <= median) {
            for track in tracks {
                self.held_bytes -= track.forgotten(outcome);
            }
        }
    }

    /// Drops what waits of publishers that were forgotten.
    fn sweep(&mut self) {
        let tracks = &mut self.tracks;
        let most = STALE + 2 * ORIGINS * tracks.len();
        if self.asking.len() > most {
            let mut seen = HashSet::new();
            self.asking.retain(|origin| {
                of(tracks, origin).is_some_and(|track| track.turn == Turn::Waits) && seen.insert(origin.clone())
            });
        }
        if self.resting.len() > most {
            let mut seen = HashSet::new();
            self.resting.retain(|(_, origin)| {
                of(tracks, origin).is_some_and(|track| track.turn == Turn::Rests) && seen.insert(origin.clone())
            });
        }
    }
}

fn of<'a, T>(tracks: &'a mut HashMap<String, Vec<Track<T>>>, origin: &Origin) -> Option<&'a mut Track<T>> {
    tracks.get_mut(&origin.key)?.iter_mut().find(|track| track.zid == origin.zid && track.eid == origin.eid)
}

impl<T> Track<T> {
    fn new(origin: &Origin, since: u64) -> Self {
        Self {
            zid: origin.zid.clone(),
            eid: origin.eid,
            next: 0,
            end: 0,
            first: u32::MAX,
            held: BTreeMap::new(),
            ahead: BTreeMap::new(),
            alive: None,
            seen: 0,
            step: Step::Page,
            turn: Turn::Idle,
            bytes: 0,
            page: PAGE,
            tries: 0,
            has_cache: false,
            used: 0,
            since,
        }
    }

    fn held_bytes(&self) -> usize {
        self.held.values().map(|(bytes, _)| bytes).sum()
    }

    /// The numbers to ask for, and whether only the newest of them. Who is away is asked when it is back.
    fn question(&self) -> Option<(RangeInclusive<u32>, bool)> {
        match self.step {
            _ if self.alive == Some(false) => None,
            Step::Probe => Some((0..=u32::MAX, true)),
            _ if self.next >= self.end => None,
            Step::Page => Some((self.page(self.next), false)),
            Step::From(first) => Some((self.page(first), false)),
            Step::Newest => Some((self.next..=u32::MAX, true)),
            Step::Oldest { low, high } => Some((low..=middle(low, high), true)),
        }
    }

    fn page(&self, first: u32) -> RangeInclusive<u32> {
        let held = self.held.range(first..).next().map_or(self.end, |(held, _)| *held);
        let ahead = self.ahead.range(first..).next().map_or(self.end, |(from, _)| *from);
        let fit = PAGE_BYTES.checked_div(self.bytes).and_then(|fit| u32::try_from(fit).ok()).unwrap_or(FIRST_PAGE);
        let page = fit.clamp(1, self.page);
        let last = self.end.min(held).min(ahead).min(first.saturating_add(page)).saturating_sub(1);
        first..=last.max(first)
    }

    /// It is forgotten: hands on what is held, and misses what was seen and is not here. Returns the bytes that were held.
    fn forgotten(mut self, outcome: &mut Outcome<T>) -> usize {
        let freed = self.held_bytes();
        self.skip_to(self.seen, outcome);
        self.hand_on_held(outcome);
        freed
    }

    /// It has published up to a number, and so is there, whatever its token says.
    fn reach(&mut self, number: u32, outcome: &mut Outcome<T>) {
        if number.saturating_add(RESTART) < self.next {
            self.restart(outcome);
        }
        self.knows_of(number);
        if self.alive == Some(false) {
            self.alive = None;
        }
    }

    fn knows_of(&mut self, number: u32) {
        self.end = self.end.max(number.saturating_add(1));
    }

    fn has_seen(&mut self, number: u32) {
        self.seen = self.seen.max(number.saturating_add(1));
    }

    /// Its token came or went: a question that is on its way says nothing any more.
    fn visit(&mut self, is_there: bool, step: Step) {
        (self.alive, self.step, self.turn, self.tries) = (Some(is_there), step, Turn::Idle, 0);
    }

    /// The answer to a question that is no longer the one that is asked: it went, came or began anew meanwhile, and what is
    /// missing in it may not be missing now.
    fn hear_late(&mut self, question: &Question, answer: BTreeMap<u32, T>, outcome: &mut Outcome<T>) {
        for (number, sample) in answer.into_iter().filter(|_| !question.newest) {
            if self.since > question.id {
                outcome.samples.push(sample);
            } else if number == self.next {
                self.hand_on(number, sample, outcome);
            } else {
                self.hand_on_ahead(number, sample, outcome);
            }
        }
    }

    /// The answer to a question for the newest, and the number that came next when it was asked. Whether there was one.
    fn learn(&mut self, newest: Option<u32>, next: u32, ending: Ending, outcome: &mut Outcome<T>) -> bool {
        match (self.step, newest) {
            (_, None) if ending != Ending::Complete => return false,
            (Step::Newest, None) => return false,
            (Step::Probe, newest) => {
                let end = newest.map_or(0, |newest| newest.saturating_add(1));
                if newest.is_some() && end < next {
                    self.restart(outcome);
                }
                self.end = self.end.max(end);
                self.step = Step::Page;
            }
            (Step::Newest, Some(newest)) => {
                self.knows_of(newest);
                self.narrow(self.next, newest);
            }
            (Step::Oldest { low, .. }, Some(newest)) => self.narrow(low, newest),
            (Step::Oldest { low, high }, None) => self.narrow(middle(low, high) + 1, high),
            (Step::Page | Step::From(_), _) => {}
        }
        true
    }

    /// The oldest is between these, both included, and the higher one is there.
    fn narrow(&mut self, low: u32, high: u32) {
        self.step = if low < high { Step::Oldest { low, high } } else { Step::From(high) };
    }

    /// The answer to a question for a page. Whether there was one.
    fn turn_page(&mut self, answer: BTreeMap<u32, T>, ending: Ending, outcome: &mut Outcome<T>) -> bool {
        let before = self.next;
        for (number, sample) in answer {
            if number >= self.next {
                // A cache answers in order: what does not come before this one is not there at all.
                self.skip_to(number, outcome);
                self.hand_on(number, sample, outcome);
            }
        }
        let complete = ending == Ending::Complete;
        if self.next == before && complete {
            self.step = Step::Newest;
        }
        self.next > before || complete
    }

    /// It counts from 0 again, as a publisher with a fixed session id does after its restart.
    fn restart(&mut self, outcome: &mut Outcome<T>) {
        self.hand_on_held(outcome);
        self.ahead.clear();
        self.since = self.used;
        (self.next, self.end, self.seen, self.first) = (0, 0, 0, u32::MAX);
        (self.step, self.turn, self.tries) = (Step::Page, Turn::Idle, 0);
    }

    fn hand_on(&mut self, number: u32, sample: T, outcome: &mut Outcome<T>) {
        outcome.samples.push(sample);
        self.next = number.saturating_add(1);
        self.first = self.first.min(number);
        if self.step != Step::Probe {
            self.step = Step::Page;
        }
    }

    /// Hands on a sample before its turn.
    fn hand_on_ahead(&mut self, number: u32, sample: T, outcome: &mut Outcome<T>) {
        outcome.samples.push(sample);
        self.first = self.first.min(number);
        let has_room = self.ahead.len() < RUNS;
        match self.ahead.range_mut(..=number).next_back() {
            Some((_, to)) if number < *to => {}
            Some((_, to)) if number == *to => *to = number.saturating_add(1),
            _ if number > self.next && has_room => {
                self.ahead.insert(number, number.saturating_add(1));
            }
            _ => {}
        }
    }

    /// Hands on what is held and has its turn.
    fn hand_on_ready(&mut self, outcome: &mut Outcome<T>) {
        loop {
            if let Some(run) = self.ahead.first_entry().filter(|run| *run.key() <= self.next) {
                self.next = self.next.max(run.remove());
            } else if let Some(first) = self.held.first_entry().filter(|first| *first.key() <= self.next) {
                let (number, (_, sample)) = first.remove_entry();
                if number == self.next {
                    self.hand_on(number, sample, outcome);
                }
            } else {
                return;
            }
        }
    }

    /// Hands on all that is held, before its turn.
    fn hand_on_held(&mut self, outcome: &mut Outcome<T>) {
        for (number, (_, sample)) in std::mem::take(&mut self.held) {
            self.hand_on_ahead(number, sample, outcome);
        }
    }

    /// Goes on with a number: between, there is only what is held.
    fn skip_to(&mut self, number: u32, outcome: &mut Outcome<T>) {
        while let Some(first) = self.held.first_entry().filter(|first| *first.key() < number) {
            let (held, (_, sample)) = first.remove_entry();
            self.miss_until(held, outcome);
            self.hand_on(held, sample, outcome);
        }
        self.miss_until(number, outcome);
    }

    fn miss_until(&mut self, number: u32, outcome: &mut Outcome<T>) {
        outcome.missed += u64::from(self.absent_below(number));
        self.next = self.next.max(number);
    }

    /// How many before this number did not come, of those that are ours to miss.
    fn absent_below(&self, number: u32) -> u32 {
        let between = self.next.max(self.first)..number;
        let common = |from: u32, to: u32| to.min(between.end).saturating_sub(from.max(between.start));
        let came: u32 = self.ahead.iter().map(|(from, to)| common(*from, *to)).sum();
        common(between.start, between.end) - came
    }

    fn behind(&self) -> u64 {
        let held = self.held.range(self.next.max(self.first)..).count();
        u64::from(self.absent_below(self.end)).saturating_sub(held as u64)
    }

    /// Nobody answered: when to ask again. After many times there is no cache, and it goes on with what came on its own.
    fn unanswered(&mut self, ending: Ending, outcome: &mut Outcome<T>) -> Option<Duration> {
        self.tries += 1;
        let tries = match self.alive {
            _ if self.has_cache || ending == Ending::Broken => TRIES,
            Some(_) => TRIES_WITHOUT_CACHE,
            None => 1,
        };
        if self.tries < tries {
            return Some(PAUSE * (1 << (self.tries - 1)));
        }
        (self.tries, self.step) = (0, Step::Page);
        self.skip_to(self.seen, outcome);
        // What was only told of may never have been.
        self.end = self.next;
        None
    }
}

fn middle(low: u32, high: u32) -> u32 {
    low + (high - low - 1) / 2
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn origin() -> Origin {
        Origin { key: "points/v1/north/m1/throw".to_owned(), zid: "a1".to_owned(), eid: 7 }
    }

    /// A publisher with its cache, behind a link, and the follower at the other end.
    struct World {
        follower: Follower<u32>,
        now: Instant,
        published: u32,
        cached: u32,
        is_up: bool,
        has_token: bool,
        handed_on: Vec<u32>,
        missed: u64,
        questions: usize,
    }

    impl World {
        fn new(cached: u32, has_token: bool) -> Self {
            let mut world = Self {
                follower: Follower::new(100, |_| 10),
                now: tokio::time::Instant::now().into_std(),
                published: 0,
                cached,
                is_up: true,
                has_token,
                handed_on: Vec::new(),
                missed: 0,
                questions: 0,
            };
            world.presence(true);
            world
        }

        fn accept(&mut self, outcome: Outcome<u32>) {
            self.handed_on.extend(outcome.samples);
            self.missed += outcome.missed;
        }

        fn presence(&mut self, is_there: bool) {
            self.is_up = is_there;
            if self.has_token {
                let outcome = if is_there { self.follower.appeared(&origin()) } else { self.follower.gone(&origin()) };
                self.accept(outcome);
            }
        }

        fn publish(&mut self, arrives: bool) {
            let number = self.published;
            self.published += 1;
            if arrives && self.is_up {
                let outcome = self.follower.live(&origin(), number, number);
                self.accept(outcome);
            }
        }

        /// Publishes what arrives and finds no room.
        fn refuse(&mut self, count: u32) {
            for _ in 0..count {
                let outcome = self.follower.refused(&origin(), self.published);
                self.published += 1;
                self.accept(outcome);
            }
        }

        fn pulse(&mut self) {
            if self.is_up && self.published > 0 {
                let outcome = self.follower.reached(&origin(), self.published - 1);
                self.accept(outcome);
            }
        }

        /// Asks one question; false when there is none.
        fn ask(&mut self) -> bool {
            let Some(question) = self.follower.question(self.now) else { return false };
            self.answer(&question);
            true
        }

        fn answer(&mut self, question: &Question) {
            self.questions += 1;
            let oldest = self.published.saturating_sub(self.cached);
            let there = (oldest..self.published).filter(|number| self.is_up && question.numbers.contains(number));
            let mut answer: Vec<(u32, u32)> = there.map(|number| (number, number)).collect();
            if question.newest {
                answer.drain(..answer.len().saturating_sub(1));
            } else {
                assert!(question.numbers.clone().count() <= PAGE as usize);
            }
            let outcome = self.follower.answered(question, answer, Ending::Complete, self.now);
            self.accept(outcome);
        }

        /// Until nothing is asked any more, whatever the time.
        fn settle(&mut self) {
            for _ in 0..10_000 {
                while self.ask() {}
                let Some(until) = self.follower.rests_until() else { return };
                self.now = until;
            }
            panic!("it never ends");
        }

        fn distinct(&self) -> Vec<u32> {
            let mut distinct = self.handed_on.clone();
            distinct.sort_unstable();
            distinct.dedup();
            distinct
        }
    }

    #[test]
    fn what_was_published_before_comes_first_and_in_order() {
        let mut world = World::new(1_000, true);
        world.is_up = false;
        (0..5_000).for_each(|_| world.publish(true));
        world.presence(true);
        world.publish(true);
        world.settle();
        assert_eq!(world.handed_on, (4_001..5_001).collect::<Vec<_>>());
        assert_eq!(world.missed, 0, "what was before its time is none of its business");
        assert!(world.questions < 2 + 1_000 / PAGE as usize + 1 + 2 * 16, "{} questions", world.questions);
    }

    #[test]
    fn what_no_cache_has_is_missed_and_counted() {
        let mut world = World::new(8, true);
        world.publish(true);
        (0..20).for_each(|_| world.publish(false));
        world.publish(true);
        world.settle();
        assert_eq!(world.handed_on, [vec![0], (14..22).collect()].concat());
        assert_eq!(world.missed, 13);
    }

    #[test]
    fn without_a_cache_it_goes_on_with_what_there_is() {
        let mut world = World::new(0, false);
        for number in 0..10 {
            world.publish(number != 3);
        }
        assert_eq!(world.handed_on, [0, 1, 2], "the others wait for the one before them");
        while world.ask() {}
        assert_eq!(world.follower.rests_until(), None, "they wait no longer than for one answer");
        assert_eq!((world.distinct(), world.missed), (vec![0, 1, 2, 4, 5, 6, 7, 8, 9], 1));
        world.publish(true);
        assert_eq!(world.handed_on.last(), Some(&10));
    }

    #[test]
    fn while_it_is_away_nothing_is_asked_and_nothing_given_up() {
        let mut world = World::new(1_000, true);
        (0..300).for_each(|_| world.publish(false));
        world.pulse();
        assert!(world.ask() && world.ask(), "it begins to catch up");
        world.presence(false);
        let before = world.questions;
        world.settle();
        assert_eq!(world.questions, before);
        world.presence(true);
        world.settle();
        assert_eq!((world.distinct(), world.missed), ((0..300).collect(), 0));
    }

    #[test]
    fn a_publisher_that_counts_from_the_beginning_again_is_followed() {
        let mut world = World::new(64, true);
        (0..20).for_each(|_| world.publish(true));
        world.settle();
        (world.published, world.handed_on) = (0, Vec::new());
        (0..5).for_each(|number| world.publish(number != 2));
        world.settle();
        assert_eq!(world.distinct(), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn invented_publishers_take_bounded_memory_and_leave_those_that_are_there() {
        let mut follower = Follower::new(100, |_| HELD_BYTES / 9);
        follower.appeared(&origin());
        let mut handed_on = Vec::new();
        for number in 0..20_000_u32 {
            let of_a_key = Origin { key: "points/v1/x/y/throw".to_owned(), zid: number.to_string(), eid: 0 };
            let of_keys = Origin { key: format!("points/v1/x/{number}/throw"), zid: "b".to_owned(), eid: 0 };
            handed_on.extend(follower.live(&of_a_key, 5, 2 * number).samples);
            handed_on.extend(follower.live(&of_keys, 5, 2 * number + 1).samples);
            follower.reached(&of_keys, 6);
            assert!(follower.held_bytes <= HELD_BYTES);
        }
        assert!(follower.tracks.len() <= 100 && follower.tracks["points/v1/x/y/throw"].len() <= ORIGINS);
        assert!(follower.asking.len() <= STALE + 2 * ORIGINS * 100, "{}", follower.asking.len());
        assert_eq!(follower.held_bytes, follower.tracks.values().flatten().map(Track::held_bytes).sum::<usize>());
        assert!(of(&mut follower.tracks, &origin()).is_some());
        handed_on.extend(follower.finish());
        handed_on.sort_unstable();
        assert_eq!(handed_on, (0..40_000).collect::<Vec<_>>(), "each message that came, once");
    }

    #[test]
    fn when_all_publishers_show_that_they_are_there_another_is_not_followed_but_heard() {
        let mut follower = Follower::new(100, |_| 10);
        for number in 0..100 {
            follower.appeared(&Origin { key: number.to_string(), ..origin() });
        }
        assert_eq!(follower.live(&origin(), 5, "sample").samples, ["sample"]);
        assert_eq!(follower.tracks.len(), 100);
    }

    #[test]
    fn a_sample_that_waited_in_the_queue_does_not_bring_its_publisher_back() {
        let mut world = World::new(1_000, true);
        (0..21).for_each(|_| world.publish(false));
        world.presence(false);
        let outcome = world.follower.live(&origin(), 21, 21);
        assert_eq!(outcome.samples, [21], "it is handed on");
        world.accept(outcome);
        world.settle();
        assert_eq!((world.questions, world.missed), (0, 0));
        world.published = 22;
        world.presence(true);
        world.settle();
        assert_eq!((world.distinct(), world.missed), ((0..22).collect(), 0));
    }

    #[test]
    fn a_cut_in_the_midst_of_the_search_skips_nothing() {
        for cut_at in 1..40 {
            let mut world = World::new(1_000, true);
            world.is_up = false;
            (0..3_000).for_each(|_| world.publish(false));
            world.presence(true);
            for _ in 0..cut_at {
                world.ask();
            }
            // The end of the answers is heard before the token goes.
            world.is_up = false;
            for _ in 0..2 {
                world.ask();
            }
            world.presence(false);
            world.presence(true);
            world.settle();
            assert_eq!((world.distinct(), world.missed), ((2_000..3_000).collect(), 0), "cut at {cut_at}");
        }
    }

    #[test]
    fn an_old_answer_says_nothing_about_a_publisher_that_is_asked_again() {
        let mut world = World::new(1_000, true);
        (0..40).for_each(|_| world.publish(false));
        world.ask();
        let old = world.follower.question(world.now).unwrap();
        world.presence(false);
        world.presence(true);
        world.is_up = false;
        world.answer(&old);
        world.is_up = true;
        world.settle();
        assert_eq!((world.distinct(), world.missed), ((0..40).collect(), 0));
    }

    #[test]
    fn a_late_answer_to_a_probe_is_no_restart() {
        let mut world = World::new(100, true);
        world.publish(true);
        let probe = world.follower.question(world.now).unwrap();
        world.publish(true);
        world.refuse(2);
        let outcome = world.follower.answered(&probe, vec![(0, 0)], Ending::Complete, world.now);
        world.accept(outcome);
        world.settle();
        assert_eq!((world.handed_on.clone(), world.missed), (vec![0, 1, 2, 3], 0));
    }

    #[test]
    fn a_first_sample_that_waited_while_pages_overtook_it_leaves_nothing_behind() {
        let mut world = World::new(100, true);
        (0..4).for_each(|_| world.publish(false));
        world.pulse();
        world.settle();
        world.publish(true);
        world.refuse(1);
        let outcome = world.follower.live(&origin(), 0, 0);
        world.accept(outcome);
        world.settle();
        assert_eq!((world.distinct(), world.follower.behind(), world.missed), ((0..6).collect(), 0, 0));
    }

    #[test]
    fn what_is_only_claimed_is_not_missed() {
        let mut world = World::new(8, true);
        (0..3).for_each(|_| world.publish(true));
        for claimed in [16_000, u32::MAX - 1, u32::MAX] {
            let outcome = world.follower.reached(&origin(), claimed);
            world.accept(outcome);
            world.settle();
        }
        (0..3).for_each(|_| world.publish(true));
        world.settle();
        assert_eq!((world.distinct(), world.missed), ((0..6).collect(), 0));
    }

    #[test]
    fn large_samples_and_slow_links_make_small_pages() {
        let mut world = World::new(1_000, true);
        (0..200).for_each(|_| world.publish(false));
        world.pulse();
        let mut page = |bytes_of: fn(&u32) -> usize, ending| {
            world.follower.bytes_of = bytes_of;
            let question = loop {
                let question = world.follower.question(world.now).unwrap();
                if !question.newest {
                    break question;
                }
                world.answer(&question);
            };
            let answer = question.numbers.clone().map(|number| (number, number)).collect();
            world.follower.answered(&question, answer, ending, world.now);
            question.numbers.count()
        };
        let small = |_: &u32| 40_000;
        let large = |_: &u32| 1_500_000;
        assert_eq!([page(small, Ending::Complete), page(small, Ending::Complete)], [4, 26]);
        assert_eq!([page(large, Ending::Complete), page(small, Ending::Broken)], [26, 1]);
        assert_eq!([page(small, Ending::Broken), page(small, Ending::Complete)], [16, 8]);
        assert_eq!(page(small, Ending::Complete), 16);
    }

    #[test]
    fn what_found_no_room_is_behind_until_it_is_asked_for_and_missed_when_it_cannot_be() {
        let mut world = World::new(100, true);
        world.refuse(10);
        assert_eq!(world.follower.behind(), 10);
        world.settle();
        assert_eq!((world.distinct(), world.follower.behind(), world.missed), ((0..10).collect(), 0, 0));
        world.refuse(10);
        world.presence(false);
        world.settle();
        assert_eq!((world.follower.behind(), world.missed), (10, 0), "it may come back");
        for other in (0..ORIGINS).map(|other| Origin { zid: format!("b{other}"), ..origin() }) {
            let outcome = world.follower.appeared(&other);
            world.accept(outcome);
        }
        assert_eq!((world.follower.behind(), world.missed), (0, 10), "others came in its place");
    }

    #[test]
    fn without_a_router_nothing_is_given_up() {
        let mut world = World::new(100, false);
        (0..5).for_each(|_| world.publish(false));
        world.publish(true);
        for _ in 0..100 {
            let question = world.follower.question(world.now).unwrap();
            let outcome = world.follower.answered(&question, Vec::new(), Ending::Unasked, world.now);
            world.accept(outcome);
            world.now = world.follower.rests_until().unwrap();
        }
        world.settle();
        assert_eq!(world.handed_on, [0, 1, 2, 3, 4, 5]);
    }

    #[derive(Debug, Clone)]
    enum Happening {
        Publish { count: u32, arrives: bool },
        Pulse,
        Ask(u8),
        Cut,
        Back,
    }

    fn happening() -> impl Strategy<Value = Happening> {
        prop_oneof![
            (1..80_u32, any::<bool>()).prop_map(|(count, arrives)| Happening::Publish { count, arrives }),
            Just(Happening::Pulse),
            (1..6_u8).prop_map(Happening::Ask),
            Just(Happening::Cut),
            Just(Happening::Back),
        ]
    }

    proptest! {
        /// Whatever happens to the link: all that arrived or is cached in the end is handed on, and what is missing between
        /// was counted.
        #[test]
        fn nothing_is_lost_that_arrived_or_is_cached(
            happenings in prop::collection::vec(happening(), 1..60),
            cached in 0..200_u32,
        ) {
            let mut world = World::new(cached, true);
            let mut arrived = Vec::new();
            for happening in happenings {
                match happening {
                    Happening::Publish { count, arrives } => for _ in 0..count {
                        if arrives && world.is_up {
                            arrived.push(world.published);
                        }
                        world.publish(arrives);
                    },
                    Happening::Pulse => world.pulse(),
                    Happening::Ask(count) => drop((0..count).map(|_| world.ask()).collect::<Vec<_>>()),
                    Happening::Cut => world.presence(false),
                    Happening::Back => world.presence(true),
                }
            }
            world.presence(true);
            world.settle();
            world.pulse();
            world.settle();
            let distinct = world.distinct();
            let cached = world.published.saturating_sub(world.cached)..world.published;
            for number in arrived.into_iter().chain(cached) {
                prop_assert!(distinct.binary_search(&number).is_ok(), "{number} is lost");
            }
            let absent = distinct.windows(2).map(|pair| u64::from(pair[1] - pair[0] - 1)).sum::<u64>();
            prop_assert_eq!(world.missed, absent, "missed, and absent");
            prop_assert_eq!(world.follower.held_bytes, 0);
        }
    }
}
