//! Two loggers that use the name of one machine; and single loggers whose throws look like those of two.
//!
//! The tests set the clock of the daemon forward before each throw, because the daemon compares reception times.

use std::{fs, path::PathBuf};

use crate::{
    backlogs::keep,
    faketime,
    http::KEY,
    rig::{Daemon, Rig, Sender, faulty_throws, throws},
};
use jiff::{SignedDuration, Timestamp};
use pointsd::{
    simulate::{Fault, Part, Shape},
    throw::{Throw, ThrowRef},
    wire::encode_throw,
};

/// Settings with short baselines and without a wait for backlogs.
const SETTINGS: &str = "[diagnosis]\nbaseline_throws = 12\n[subscribe]\nbacklog_wait_s = 0.0\n";
/// Throws that complete the baselines of both directions, and some more.
const HEALTHY: usize = 30;

/// A running daemon whose clock the test sets.
struct Bench {
    rig: Rig,
    daemon: Option<Daemon>,
    clock: PathBuf,
    /// How far the clock of the daemon is ahead of that of the test.
    ahead: SignedDuration,
    /// Throws that are judged so far.
    judged: usize,
}

impl Bench {
    /// `None` without libfaketime.
    fn new() -> Option<Self> {
        let mut rig = Rig::with(SETTINGS);
        let clock = faketime::clock_of(&mut rig)?;
        rig.set("FAKETIME_DONT_FAKE_MONOTONIC", "1");
        let daemon = Some(rig.start());
        Some(Self { rig, daemon, clock, ahead: SignedDuration::ZERO, judged: 0 })
    }

    fn daemon(&self) -> &Daemon {
        self.daemon.as_ref().unwrap()
    }

    async fn logger(&self) -> Sender {
        self.daemon().logger(KEY).await
    }

    /// Sets the clock of the daemon forward.
    fn advance(&mut self, minutes: i64) {
        self.ahead += SignedDuration::from_mins(minutes);
        fs::write(&self.clock, format!("+{}m", self.ahead.as_mins())).unwrap();
    }

    fn now(&self) -> Timestamp {
        Timestamp::now() + self.ahead
    }

    /// Sends a throw made at this time, and waits until it is judged.
    async fn send(&mut self, logger: &Sender, throw: &Throw, made_at: Timestamp) {
        logger.send([Throw { started_at: made_at, ..throw.clone() }]).await;
        self.judged += 1;
        self.rig.judged(self.judged).await;
    }

    /// Sends throws that were just made, one every ten minutes.
    async fn live(&mut self, logger: &Sender, throws: impl IntoIterator<Item = &Throw>) {
        for throw in throws {
            self.advance(10);
            self.send(logger, throw, self.now()).await;
        }
    }

    fn kill_and_restart(&mut self) {
        self.daemon.take().unwrap().kill();
        self.daemon = Some(self.rig.start());
    }

    fn state(&self) -> String {
        self.rig.sql("SELECT DISTINCT state FROM machine_health")[0]["state"].as_str().unwrap().to_owned()
    }

    fn rows(&self, question: &str) -> usize {
        self.rig.sql(question).len()
    }

    /// Asserts that no alarm was raised, every throw was evaluated, and the machine is healthy.
    fn assert_silent(&self, what: &str) {
        let alarms = self.rig.sql("SELECT cause, text FROM alarm_history");
        assert!(alarms.is_empty(), "{what}: {alarms:?}");
        assert_eq!(self.rows("SELECT 1 FROM throws_not_evaluated"), 0, "{what}");
        assert_eq!(self.state(), "healthy", "{what}");
    }
}

/// Throws of one machine in several boots of its logger, with the number of throws in each.
fn boots<const N: usize>(counts: [(&str, u64); N]) -> [Vec<Throw>; N] {
    let mut throws = throws("", counts.iter().map(|(_, count)| count).sum()).into_iter();
    counts.map(|(boot_id, count)| {
        let id = |throw_no| ThrowRef { boot_id: boot_id.to_owned(), throw_no };
        (1..=count).zip(&mut throws).map(|(throw_no, throw)| Throw { id: id(throw_no), ..throw }).collect()
    })
}

/// Throws of a machine of the same type with a stronger motor.
fn of_another_machine(boot_id: &str, count: u64) -> Vec<Throw> {
    let fault = Fault { part: Part::Kt, shape: Shape::Step, size_pct: 25.0, from_throw: 0 };
    faulty_throws(fault, boot_id, count)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_loggers_of_one_name_are_named_and_accuse_no_part() {
    let Some(mut bench) = Bench::new() else { return };
    let (own, other) = (throws("own-boot", 60), of_another_machine("other-boot", 12));
    let own_logger = bench.logger().await;
    bench.live(&own_logger, &own[..HEALTHY]).await;
    bench.assert_silent("before");

    let other_logger = bench.logger().await;
    for (first, second) in other[..6].iter().zip(&own[HEALTHY..]) {
        bench.live(&other_logger, [first]).await;
        bench.live(&own_logger, [second]).await;
    }
    let drifts = "SELECT cause, text FROM alarm_history WHERE cause NOT IN ('not_monitored')";
    assert_eq!(bench.rig.sql(drifts), Vec::<serde_json::Value>::new());
    let caveat = "SELECT 1 FROM machine_caveats WHERE caveat LIKE '%boots own-boot and other-boot%own machine name%'";
    let alarm =
        "SELECT 1 FROM active_alarms WHERE cause = 'not_monitored' AND text LIKE '%boots own-boot and other-boot%'";
    for question in [caveat, alarm] {
        assert!(bench.rows(question) > 0, "{:?}", bench.rig.sql("SELECT * FROM active_alarms"));
    }
    assert_eq!(bench.state(), "not_monitored");
    // Before the boots had alternated often enough, two throws of the other logger were judged.
    let withheld = "SELECT 1 FROM throws_not_evaluated WHERE quality = 'two_loggers'";
    assert_eq!(bench.rows(withheld), 8);
    assert_eq!(bench.rows("SELECT 1 FROM trace"), HEALTHY + 12, "all are stored");

    // The state survives a kill; each logger connects again.
    bench.kill_and_restart();
    let [own_logger, other_logger] = [bench.logger().await, bench.logger().await];
    bench.live(&other_logger, &other[6..]).await;
    assert_eq!(bench.rows(withheld), 14);
    let from = HEALTHY + 6;
    bench.live(&own_logger, [&own[from]]).await;
    assert_eq!((bench.rows(withheld), bench.state().as_str()), (15, "not_monitored"));

    // From now on only one logger uses the name.
    for throw in &own[from + 1..from + 12] {
        bench.advance(110);
        bench.live(&own_logger, [throw]).await;
        assert_eq!(bench.state(), "not_monitored");
    }
    bench.advance(230);
    bench.live(&own_logger, &own[from + 12..]).await;
    assert_eq!(bench.state(), "healthy", "{:?}", bench.rig.sql("SELECT * FROM active_alarms"));
    assert_eq!(bench.rows(caveat), 0);
    assert_eq!(bench.rows(drifts), 0);
}

/// The daemon discards a baseline that it learned from both machines. The `rebaseline` of an operator ends the state
/// "not monitored" at once.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_baseline_of_two_machines_is_not_used() {
    let Some(mut bench) = Bench::new() else { return };
    let (own, other) = (throws("own-boot", 12), of_another_machine("other-boot", 6));
    let loggers = [bench.logger().await, bench.logger().await];
    let mut of_own = own.chunks(2);
    for throw in &other {
        bench.live(&loggers[0], of_own.next().unwrap()).await;
        bench.live(&loggers[1], [throw]).await;
    }
    assert_eq!(bench.state(), "not_monitored");
    let learned = "SELECT 1 FROM machine_health WHERE baseline_throws > 0";
    assert_eq!(bench.rows(learned), 0);
    assert_eq!(bench.rows("SELECT 1 FROM operator_commands WHERE why LIKE 'two loggers published%'"), 1);
    bench.daemon().says(0, &["rebaseline", "north/21B", "--why", "the other one is renamed", "--by", "tester"]);
    bench.live(&loggers[0], &throws("own-boot", 40)[12..]).await;
    assert_eq!(bench.state(), "healthy");
}

/// A router, or the logger itself, sends throws from before a restart late, between newer throws, and each of them
/// twice. The clock of the logger also jumped for some of them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn throws_from_before_a_restart_that_come_late_are_of_one_logger() {
    let Some(mut bench) = Bench::new() else { return };
    let [old, new] = boots([("old-boot", 50), ("new-boot", 24)]);
    let logger = bench.logger().await;
    bench.live(&logger, &old[..HEALTHY]).await;
    // The logger makes 20 throws, one every ten minutes, that do not arrive.
    let lost_since = bench.now();
    bench.advance(210);
    for (late, throw) in old[HEALTHY..].iter().zip(&new) {
        let jump = SignedDuration::from_hours(if late.id.throw_no % 3 == 0 { -5 } else { 0 });
        bench.live(&logger, [throw]).await;
        bench.advance(5);
        let number = i64::try_from(late.id.throw_no).unwrap() - 30;
        let made_at = lost_since + SignedDuration::from_mins(10 * number) + jump;
        bench.send(&logger, late, made_at).await;
        logger.send([&Throw { started_at: made_at, ..late.clone() }]).await;
    }
    bench.kill_and_restart();
    let logger = bench.logger().await;
    bench.live(&logger, &new[20..]).await;
    bench.assert_silent("late throws");
}

/// The logger restarts twice. Throws of its older boots come in pages from its backlog while it publishes new throws.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pages_of_older_boots_are_of_one_logger() {
    let Some(mut bench) = Bench::new() else { return };
    let [first, second, third] = boots([("boot-1", 50), ("boot-2", 60), ("boot-3", 60)]);
    let logger = bench.logger().await;
    bench.live(&logger, &first[..HEALTHY]).await;
    logger.close().await;
    // Made while the link is cut: the rest of the first boot, and the second boot.
    let since = bench.now();
    let dated =
        |(at, throw): (i64, &Throw)| Throw { started_at: since + SignedDuration::from_mins(10 * at), ..throw.clone() };
    let kept: Vec<Throw> = (1..).zip(first[HEALTHY..].iter().chain(&second)).map(dated).collect();
    bench.advance(10 * 81);
    let session = bench.daemon().client().await;
    let (away, most) = kept.split_at(40);
    for (part, from) in [(away, 0), (most, 6)] {
        let message = |throw: &Throw| (throw.id.clone(), encode_throw(throw));
        let so_far = if part == most { &kept } else { away };
        keep(&session, KEY, so_far.iter().map(message).collect()).await;
        bench.judged += part.len();
        let logger = bench.logger().await;
        bench.live(&logger, &third[from..from + 6]).await;
    }
    bench.assert_silent("pages");
    assert_eq!(bench.rows("SELECT 1 FROM throw"), HEALTHY + kept.len() + 12);
}
