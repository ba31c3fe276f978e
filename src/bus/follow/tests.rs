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
