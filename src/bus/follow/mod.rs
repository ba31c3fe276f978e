//! Which samples of each publisher are still to come, and what to ask its cache for.
//!
//! An advanced publisher numbers its samples from 0, keeps the last of them in a cache that can be asked by number, and
//! tells now and then how far it is. The follower holds the number that comes next: what is there in order is handed on;
//! what is missing is asked for in pages, the oldest first, as fast as the asker takes them. So no more than a page of a
//! publisher is ever on its way, however much it has cached and however long it was out of reach, and nothing is given up
//! while its liveliness token is away.
//!
//! It takes events and returns samples and questions; whoever holds it asks them and brings the answers.

mod track;

use std::{
    collections::{BTreeMap, HashMap, HashSet, VecDeque},
    ops::RangeInclusive,
    time::{Duration, Instant},
};

use track::{RESTART, Step, Track, Turn};

/// Samples that are asked for together, fewer when they are large or their link is slow.
pub(super) const PAGE: u32 = 32;
/// Samples of a publisher that came before their turn and are kept until it is. The next are handed on at once.
const HELD: usize = 64;
/// Together they take at most this \[bytes\].
const HELD_BYTES: usize = 32 << 20;
/// After a question that nobody answered comes this pause, doubled each time.
const PAUSE: Duration = Duration::from_secs(1);
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

#[cfg(test)]
mod tests;
