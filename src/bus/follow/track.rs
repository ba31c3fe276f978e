//! How far one publisher is: what came, what waits, and what to ask for next.

use std::{collections::BTreeMap, ops::RangeInclusive, time::Duration};

use super::{Ending, Origin, Outcome, PAGE, PAUSE, Question};
use crate::bus::room;

/// What a page is meant to have \[bytes\]: with 70 kB a second it comes before its time is up.
const PAGE_BYTES: usize = 1 << 20;
/// Samples of the first page of a publisher, whose size is not known.
const FIRST_PAGE: u32 = 4;
/// Runs of numbers that were handed on before their turn. What is in more of them is asked for again, and counts as missed
/// when it is not there.
const RUNS: usize = 64;
/// A sample that is further behind than this tells that its publisher counts from 0 again: pages overtake no more live
/// samples than can wait in the queue.
#[expect(clippy::cast_possible_truncation, reason = "16,384")]
pub(super) const RESTART: u32 = room::MESSAGES as u32;
/// So many questions in a row without an answer, in 7 s, and what they asked for is given up.
const TRIES: u32 = 4;
/// The same for one that never answered, but shows a token: it has no cache, and what came is not to wait for nothing.
const TRIES_WITHOUT_CACHE: u32 = 2;

#[derive(Debug)]
pub(super) struct Track<T> {
    pub(super) zid: String,
    pub(super) eid: u32,
    /// The number that comes next.
    pub(super) next: u32,
    /// One more than the highest number that is known to be published.
    pub(super) end: u32,
    /// The lowest number that was handed on: what was before it is none of ours to miss.
    pub(super) first: u32,
    /// Samples that wait for their turn, with their bytes.
    pub(super) held: BTreeMap<u32, (usize, T)>,
    /// What was handed on before its turn: from a number up to another.
    pub(super) ahead: BTreeMap<u32, u32>,
    /// Whether its liveliness token is there; none was ever seen of some.
    pub(super) alive: Option<bool>,
    /// One more than the highest number that came on its own.
    pub(super) seen: u32,
    pub(super) step: Step,
    pub(super) turn: Turn,
    /// The size of its last sample \[bytes\]; 0 before the first.
    pub(super) bytes: usize,
    /// Samples that its link brings in time.
    pub(super) page: u32,
    /// Questions in a row that nobody answered.
    pub(super) tries: u32,
    /// Whether it has a cache: it has answered.
    pub(super) has_cache: bool,
    /// When it was last heard of, by the follower's clock.
    pub(super) used: u64,
    /// Since when its numbers are those of now.
    pub(super) since: u64,
}

/// Where the asking is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
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
pub(super) enum Turn {
    /// Nothing to ask.
    Idle,
    /// It waits for its turn.
    Waits,
    /// This question is on its way.
    Asked(u64),
    /// It did not answer, and is asked again later.
    Rests,
}

impl<T> Track<T> {
    pub(super) fn new(origin: &Origin, since: u64) -> Self {
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

    pub(super) fn held_bytes(&self) -> usize {
        self.held.values().map(|(bytes, _)| bytes).sum()
    }

    /// The numbers to ask for, and whether only the newest of them. Who is away is asked when it is back.
    pub(super) fn question(&self) -> Option<(RangeInclusive<u32>, bool)> {
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

    pub(super) fn page(&self, first: u32) -> RangeInclusive<u32> {
        let held = self.held.range(first..).next().map_or(self.end, |(held, _)| *held);
        let ahead = self.ahead.range(first..).next().map_or(self.end, |(from, _)| *from);
        let fit = PAGE_BYTES.checked_div(self.bytes).and_then(|fit| u32::try_from(fit).ok()).unwrap_or(FIRST_PAGE);
        let page = fit.clamp(1, self.page);
        let last = self.end.min(held).min(ahead).min(first.saturating_add(page)).saturating_sub(1);
        first..=last.max(first)
    }

    /// It is forgotten: hands on what is held, and misses what was seen and is not here. Returns the bytes that were held.
    pub(super) fn forgotten(mut self, outcome: &mut Outcome<T>) -> usize {
        let freed = self.held_bytes();
        self.skip_to(self.seen, outcome);
        self.hand_on_held(outcome);
        freed
    }

    /// It has published up to a number, and so is there, whatever its token says.
    pub(super) fn reach(&mut self, number: u32, outcome: &mut Outcome<T>) {
        if number.saturating_add(RESTART) < self.next {
            self.restart(outcome);
        }
        self.knows_of(number);
        if self.alive == Some(false) {
            self.alive = None;
        }
    }

    pub(super) fn knows_of(&mut self, number: u32) {
        self.end = self.end.max(number.saturating_add(1));
    }

    pub(super) fn has_seen(&mut self, number: u32) {
        self.seen = self.seen.max(number.saturating_add(1));
    }

    /// Its token came or went: a question that is on its way says nothing any more.
    pub(super) fn visit(&mut self, is_there: bool, step: Step) {
        (self.alive, self.step, self.turn, self.tries) = (Some(is_there), step, Turn::Idle, 0);
    }

    /// The answer to a question that is no longer the one that is asked: it went, came or began anew meanwhile, and what is
    /// missing in it may not be missing now.
    pub(super) fn hear_late(&mut self, question: &Question, answer: BTreeMap<u32, T>, outcome: &mut Outcome<T>) {
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
    pub(super) fn learn(&mut self, newest: Option<u32>, next: u32, ending: Ending, outcome: &mut Outcome<T>) -> bool {
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
    pub(super) fn narrow(&mut self, low: u32, high: u32) {
        self.step = if low < high { Step::Oldest { low, high } } else { Step::From(high) };
    }

    /// The answer to a question for a page. Whether there was one.
    pub(super) fn turn_page(&mut self, answer: BTreeMap<u32, T>, ending: Ending, outcome: &mut Outcome<T>) -> bool {
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
    pub(super) fn restart(&mut self, outcome: &mut Outcome<T>) {
        self.hand_on_held(outcome);
        self.ahead.clear();
        self.since = self.used;
        (self.next, self.end, self.seen, self.first) = (0, 0, 0, u32::MAX);
        (self.step, self.turn, self.tries) = (Step::Page, Turn::Idle, 0);
    }

    pub(super) fn hand_on(&mut self, number: u32, sample: T, outcome: &mut Outcome<T>) {
        outcome.samples.push(sample);
        self.next = number.saturating_add(1);
        self.first = self.first.min(number);
        if self.step != Step::Probe {
            self.step = Step::Page;
        }
    }

    /// Hands on a sample before its turn.
    pub(super) fn hand_on_ahead(&mut self, number: u32, sample: T, outcome: &mut Outcome<T>) {
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
    pub(super) fn hand_on_ready(&mut self, outcome: &mut Outcome<T>) {
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
    pub(super) fn hand_on_held(&mut self, outcome: &mut Outcome<T>) {
        for (number, (_, sample)) in std::mem::take(&mut self.held) {
            self.hand_on_ahead(number, sample, outcome);
        }
    }

    /// Goes on with a number: between, there is only what is held.
    pub(super) fn skip_to(&mut self, number: u32, outcome: &mut Outcome<T>) {
        while let Some(first) = self.held.first_entry().filter(|first| *first.key() < number) {
            let (held, (_, sample)) = first.remove_entry();
            self.miss_until(held, outcome);
            self.hand_on(held, sample, outcome);
        }
        self.miss_until(number, outcome);
    }

    pub(super) fn miss_until(&mut self, number: u32, outcome: &mut Outcome<T>) {
        outcome.missed += u64::from(self.absent_below(number));
        self.next = self.next.max(number);
    }

    /// How many before this number did not come, of those that are ours to miss.
    pub(super) fn absent_below(&self, number: u32) -> u32 {
        let between = self.next.max(self.first)..number;
        let common = |from: u32, to: u32| to.min(between.end).saturating_sub(from.max(between.start));
        let came: u32 = self.ahead.iter().map(|(from, to)| common(*from, *to)).sum();
        common(between.start, between.end) - came
    }

    pub(super) fn behind(&self) -> u64 {
        let held = self.held.range(self.next.max(self.first)..).count();
        u64::from(self.absent_below(self.end)).saturating_sub(held as u64)
    }

    /// Nobody answered: when to ask again. After many times there is no cache, and it goes on with what came on its own.
    pub(super) fn unanswered(&mut self, ending: Ending, outcome: &mut Outcome<T>) -> Option<Duration> {
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
