//! Which samples of each publisher are still to come, and what to ask its cache for.
//!
//! An advanced publisher numbers its samples from 0, keeps the last of them in a cache that can be asked by number, and
//! tells now and then how far it is. The follower holds the number that comes next: what is there in order is handed on;
//! what is missing is asked for in pages, the oldest first, as fast as the asker takes them. So no more than a page of a
//! publisher is ever on its way, however much it has cached and however long it was out of reach, and nothing is given up
//! while the publisher cannot be reached.
//!
//! It takes events and returns samples and questions; whoever holds it asks them and brings the answers.

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    ops::RangeInclusive,
    time::{Duration, Instant},
};

use super::room;

/// Samples that are asked for together.
pub(super) const PAGE: u32 = 32;
/// Samples of a publisher that came before their turn and are kept until it is.
const HELD: usize = 64;
/// Together they take at most this \[bytes\]. What is not kept is asked for when its turn comes.
const HELD_BYTES: usize = 32 << 20;
/// A sample that is further behind than this tells that its publisher counts from 0 again: pages overtake no more live
/// samples than can wait in the queue.
#[expect(clippy::cast_possible_truncation, reason = "16,384")]
const RESTART: u32 = room::MESSAGES as u32;
/// After a question that nobody answered comes this pause, doubled each time.
const PAUSE: Duration = Duration::from_secs(1);
/// So many questions in a row without an answer, in 7 s, and what they asked for is given up: there is no such cache.
const TRIES: u32 = 4;
/// Publishers of one key that are remembered: the last starts of its logger.
const ORIGINS: usize = 8;
/// Keys whose publishers are remembered. Of one that was forgotten all is asked for that it has cached.
const KEYS: usize = 4_096;

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
    /// Since when the publisher was there.
    visit: u32,
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
    /// Those with something to ask, in turn.
    asking: VecDeque<Origin>,
    /// Those that were asked and did not answer.
    resting: Vec<(Instant, Origin)>,
    held_bytes: usize,
    clock: u64,
}

#[derive(Debug)]
struct Track<T> {
    zid: String,
    eid: u32,
    /// The number that comes next.
    next: u32,
    /// One more than the highest number that is known to be published.
    end: u32,
    /// What is skipped before the first sample was never ours to miss.
    begun: bool,
    held: BTreeMap<u32, (usize, T)>,
    /// Whether its liveliness token is there; none was ever seen of some.
    alive: Option<bool>,
    /// Counts its comings and goings: an answer from before one says nothing about afterwards.
    visit: u32,
    step: Step,
    /// It waits for its turn, for an answer, or until it is asked again.
    is_busy: bool,
    tries: u32,
    used: u64,
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
}

impl<T> Follower<T> {
    pub(super) fn new() -> Self {
        Self { tracks: HashMap::new(), asking: VecDeque::new(), resting: Vec::new(), held_bytes: 0, clock: 0 }
    }

    /// A sample came on its own. One from before its turn may be new all the same: the database knows.
    pub(super) fn live(&mut self, origin: &Origin, number: u32, bytes: usize, sample: T) -> Outcome<T> {
        let room = self.held_bytes + bytes <= HELD_BYTES;
        self.change(origin, |track, outcome| {
            if number.saturating_add(RESTART) < track.next || number == 0 && track.next > 1 {
                track.restart(outcome);
            }
            track.is_there_up_to(number);
            if number < track.next {
                outcome.samples.push(sample);
            } else if number == track.next {
                track.hand_on(number, sample, outcome);
            } else if room && track.held.len() < HELD {
                track.held.insert(number, (bytes, sample));
            }
        })
    }

    /// It has published up to this number.
    pub(super) fn reached(&mut self, origin: &Origin, number: u32) -> Outcome<T> {
        self.change(origin, |track, outcome| {
            if number.saturating_add(RESTART) < track.next {
                track.restart(outcome);
            }
            track.is_there_up_to(number);
        })
    }

    /// It has come, or come back: it may have published since.
    pub(super) fn appeared(&mut self, origin: &Origin) -> Outcome<T> {
        let resting = self.resting.len();
        self.resting.retain(|(_, resting)| resting != origin);
        let has_rested = self.resting.len() < resting;
        self.change(origin, |track, _| {
            (track.alive, track.step, track.tries) = (Some(true), Step::Probe, 0);
            track.is_busy &= !has_rested;
            track.visit += 1;
        })
    }

    /// It cannot be reached. What it has cached is asked for when it is back, if it ever is; what is here is handed on.
    pub(super) fn gone(&mut self, origin: &Origin) -> Outcome<T> {
        self.change(origin, |track, outcome| {
            (track.alive, track.step, track.tries) = (Some(false), Step::Page, 0);
            track.visit += 1;
            track.hand_on_held(outcome);
        })
    }

    /// The next question, if there is one now.
    pub(super) fn question(&mut self, now: Instant) -> Option<Question> {
        for (_, origin) in self.resting.extract_if(.., |(until, _)| *until <= now) {
            self.asking.push_back(origin);
        }
        while let Some(origin) = self.asking.pop_front() {
            let Some(track) = of(&mut self.tracks, &origin) else { continue };
            if let Some((numbers, newest)) = track.question() {
                track.is_busy = true;
                return Some(Question { origin, numbers, newest, visit: track.visit });
            }
            track.is_busy = false;
        }
        None
    }

    /// When there may be a question, if there is none now and nothing happens.
    pub(super) fn rests_until(&self) -> Option<Instant> {
        self.resting.iter().map(|(until, _)| *until).min()
    }

    /// The answer to a question: the samples with their numbers, in any order. `complete`, unless the time was up first:
    /// then what did not come may still be there.
    pub(super) fn answered(
        &mut self,
        question: &Question,
        answer: Vec<(u32, T)>,
        complete: bool,
        now: Instant,
    ) -> Outcome<T> {
        let answer: BTreeMap<u32, T> =
            answer.into_iter().filter(|(number, _)| question.numbers.contains(number)).collect();
        let known = of(&mut self.tracks, &question.origin).is_some_and(|track| {
            track.is_busy = false;
            track.visit == question.visit
        });
        if !known {
            // It went or came meanwhile, or was forgotten: what is missing here may not be missing there.
            let mut outcome = self.change(&question.origin, |_, _| ());
            if !question.newest {
                outcome.samples.extend(answer.into_values());
            }
            return outcome;
        }
        let mut pause = None;
        let outcome = self.change(&question.origin, |track, outcome| {
            let is_known = if question.newest {
                track.learn(answer.into_keys().next_back(), complete, outcome)
            } else {
                track.turn(answer, complete, outcome)
            };
            if is_known {
                track.tries = 0;
            } else {
                pause = track.unanswered(outcome);
                track.is_busy = pause.is_some();
            }
        });
        if let Some(pause) = pause {
            self.resting.push((now + pause, question.origin.clone()));
        }
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

    /// Does something to a publisher, and gives it its turn when it has something to ask then.
    fn change(&mut self, origin: &Origin, to_do: impl FnOnce(&mut Track<T>, &mut Outcome<T>)) -> Outcome<T> {
        let mut outcome = Outcome::none();
        self.know(origin);
        self.clock += 1;
        if let Some(track) = of(&mut self.tracks, origin) {
            let before = track.held_bytes();
            track.used = self.clock;
            to_do(track, &mut outcome);
            track.hand_on_ready(&mut outcome);
            self.held_bytes = self.held_bytes + track.held_bytes() - before;
            if !track.is_busy && track.question().is_some() {
                track.is_busy = true;
                self.asking.push_back(origin.clone());
            }
        }
        outcome
    }

    /// Makes a publisher known. Whoever invents many makes its own forgotten.
    fn know(&mut self, origin: &Origin) {
        if of(&mut self.tracks, origin).is_some() {
            return;
        }
        if self.tracks.len() >= KEYS && !self.tracks.contains_key(&origin.key) {
            self.forget_half();
        }
        let tracks = self.tracks.entry(origin.key.clone()).or_default();
        if tracks.len() >= ORIGINS
            && let Some(oldest) = (0..tracks.len()).min_by_key(|&at| tracks[at].worth())
        {
            self.held_bytes -= tracks.swap_remove(oldest).held_bytes();
        }
        tracks.push(Track::new(origin));
    }

    fn forget_half(&mut self) {
        let worth = |tracks: &Vec<Track<T>>| tracks.iter().map(Track::worth).max().unwrap_or_default();
        let mut worths: Vec<_> = self.tracks.values().map(worth).collect();
        let (_, median, _) = worths.select_nth_unstable(KEYS / 2);
        let median = *median;
        self.tracks.retain(|_, tracks| worth(tracks) >= median);
        self.held_bytes = self.tracks.values().flatten().map(Track::held_bytes).sum();
    }
}

fn of<'a, T>(tracks: &'a mut HashMap<String, Vec<Track<T>>>, origin: &Origin) -> Option<&'a mut Track<T>> {
    tracks.get_mut(&origin.key)?.iter_mut().find(|track| track.zid == origin.zid && track.eid == origin.eid)
}

impl<T> Track<T> {
    fn new(origin: &Origin) -> Self {
        Self {
            zid: origin.zid.clone(),
            eid: origin.eid,
            next: 0,
            end: 0,
            begun: false,
            held: BTreeMap::new(),
            alive: None,
            visit: 0,
            step: Step::Page,
            is_busy: false,
            tries: 0,
            used: 0,
        }
    }

    /// What is alive and was heard of lately is the last to be forgotten.
    fn worth(&self) -> (bool, u64) {
        (self.alive == Some(true), self.used)
    }

    fn held_bytes(&self) -> usize {
        self.held.values().map(|(bytes, _)| bytes).sum()
    }

    /// The numbers to ask for, and whether only the newest of them. Who is away is asked when it is back.
    fn question(&self) -> Option<(RangeInclusive<u32>, bool)> {
        match self.step {
            _ if self.alive == Some(false) => None,
            Step::Probe => Some((self.next..=u32::MAX, true)),
            _ if self.next >= self.end => None,
            Step::Page => {
                let held = self.held.keys().next().copied().unwrap_or(self.end);
                let end = self.end.min(held).min(self.next.saturating_add(PAGE));
                Some((self.next..=end - 1, false))
            }
            Step::Newest => Some((self.next..=self.end - 1, true)),
            Step::Oldest { low, high } => Some((low..=middle(low, high), true)),
        }
    }

    /// The answer to a question for the newest. Whether there was one.
    fn learn(&mut self, newest: Option<u32>, complete: bool, outcome: &mut Outcome<T>) -> bool {
        match (self.step, newest) {
            (_, None) if !complete => return false,
            (Step::Probe, newest) => {
                self.end = self.end.max(newest.map_or(0, |newest| newest.saturating_add(1)));
                self.step = Step::Page;
            }
            (Step::Newest, None) => return false,
            (Step::Newest, Some(newest)) => self.narrow(self.next, newest, outcome),
            (Step::Oldest { low, .. }, Some(newest)) => self.narrow(low, newest, outcome),
            (Step::Oldest { low, high }, None) => self.narrow(middle(low, high) + 1, high, outcome),
            (Step::Page, _) => {}
        }
        true
    }

    /// The oldest is between these, both included, and the higher one is there.
    fn narrow(&mut self, low: u32, high: u32, outcome: &mut Outcome<T>) {
        if low < high {
            self.step = Step::Oldest { low, high };
        } else {
            self.step = Step::Page;
            self.skip_to(high, outcome);
        }
    }

    /// The answer to a question for a page. Whether there was one.
    fn turn(&mut self, answer: BTreeMap<u32, T>, complete: bool, outcome: &mut Outcome<T>) -> bool {
        let before = self.next;
        for (number, sample) in answer {
            if number >= self.next {
                // A cache answers in order: what does not come before this one is not there at all.
                self.skip_to(number, outcome);
                self.hand_on(number, sample, outcome);
            }
        }
        if self.next == before && complete {
            self.step = Step::Newest;
        }
        self.next > before || complete
    }

    /// Notes that a number is published, by somebody who is there whatever its token says.
    fn is_there_up_to(&mut self, number: u32) {
        self.end = self.end.max(number.saturating_add(1));
        if self.alive == Some(false) {
            self.alive = None;
        }
    }

    /// It counts from 0 again, as a publisher with a fixed session id does after its restart.
    fn restart(&mut self, outcome: &mut Outcome<T>) {
        self.hand_on_held(outcome);
        (self.next, self.end, self.begun, self.step, self.tries) = (0, 0, false, Step::Page, 0);
        self.visit += 1;
    }

    fn hand_on(&mut self, number: u32, sample: T, outcome: &mut Outcome<T>) {
        outcome.samples.push(sample);
        self.next = number.saturating_add(1);
        self.begun = true;
        if self.step != Step::Probe {
            self.step = Step::Page;
        }
    }

    /// Hands on what is held and has its turn.
    fn hand_on_ready(&mut self, outcome: &mut Outcome<T>) {
        while let Some(first) = self.held.first_entry().filter(|first| *first.key() <= self.next) {
            let (number, (_, sample)) = first.remove_entry();
            if number == self.next {
                self.hand_on(number, sample, outcome);
            }
        }
    }

    /// Hands on all that is held, before its turn. What is then asked for and is no longer there counts as missed, these
    /// with it.
    fn hand_on_held(&mut self, outcome: &mut Outcome<T>) {
        self.begun |= !self.held.is_empty();
        outcome.samples.extend(std::mem::take(&mut self.held).into_values().map(|(_, sample)| sample));
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
        if self.begun {
            outcome.missed += u64::from(number.saturating_sub(self.next));
        }
        self.next = self.next.max(number);
    }

    /// Nobody answered: when to ask again. After many times there is no cache, and it goes on with what is held.
    fn unanswered(&mut self, outcome: &mut Outcome<T>) -> Option<Duration> {
        self.tries += 1;
        if self.tries < TRIES {
            return Some(PAUSE * (1 << (self.tries - 1)));
        }
        (self.tries, self.step) = (0, Step::Page);
        self.skip_to(self.end, outcome);
        self.begun = true;
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
                follower: Follower::new(),
                now: Instant::now(),
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
                let outcome = self.follower.live(&origin(), number, 10, number);
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
            self.questions += 1;
            let oldest = self.published.saturating_sub(self.cached);
            let there = (oldest..self.published).filter(|number| self.is_up && question.numbers.contains(number));
            let mut answer: Vec<(u32, u32)> = there.map(|number| (number, number)).collect();
            if question.newest {
                answer.drain(..answer.len().saturating_sub(1));
            } else {
                assert!(question.numbers.clone().count() <= PAGE as usize);
            }
            let outcome = self.follower.answered(&question, answer, true, self.now);
            self.accept(outcome);
            true
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
        world.settle();
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
        let mut follower = Follower::new();
        follower.appeared(&origin());
        for number in 0..5_000_u32 {
            let of_a_key = Origin { key: "points/v1/x/y/throw".to_owned(), zid: number.to_string(), eid: 0 };
            let of_keys = Origin { key: format!("points/v1/x/{number}/throw"), zid: "b".to_owned(), eid: 0 };
            follower.live(&of_a_key, 5, HELD_BYTES / 4, ());
            follower.live(&of_keys, 5, HELD_BYTES / 4, ());
        }
        assert!(follower.tracks.len() <= KEYS && follower.tracks["points/v1/x/y/throw"].len() <= ORIGINS);
        assert!(follower.held_bytes <= HELD_BYTES);
        assert_eq!(follower.held_bytes, follower.tracks.values().flatten().map(Track::held_bytes).sum::<usize>());
        assert!(of(&mut follower.tracks, &origin()).is_some());
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
        /// Whatever happens to the link: all that arrived or is cached in the end is handed on, and what is missing then
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
                        // More than can be held is left to the cache, when there is one.
                        let is_kept = world.follower.tracks.values().flatten().all(|track| track.held.len() < HELD);
                        if arrives && world.is_up && is_kept {
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
            let first = distinct.first().copied().unwrap_or(world.published);
            let absent = u64::from(world.published - first) - distinct.len() as u64;
            prop_assert!(world.missed >= absent, "{} missed, {absent} absent", world.missed);
            prop_assert_eq!(world.follower.held_bytes, 0);
        }
    }
}
