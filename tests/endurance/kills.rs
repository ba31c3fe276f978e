//! Repeated `kill -9` of the daemon at random moments, while a logger publishes.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use pointsd::store::Reader;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{
    database::{Published, settled},
    logger::{Logger, Plan, QUICK_ALARMS},
    rig::{Rig, size},
    verdict::events as events_of,
    witness::Witness,
};

/// Longest life of most daemons.
const SHORT: Duration = Duration::from_millis(1500);
/// Longest life of every twelfth daemon, which has time to publish the outbox of the others.
const LONG: Duration = Duration::from_secs(9);
/// Machines whose backlog covers every absence of the daemon; one more machine has a backlog of one throw.
const REMEMBERED: usize = 3;

fn plan(machine: &'static str, machines: usize, kept: usize) -> Plan {
    Plan { machine, machines, kept, pace: Duration::from_millis(25), ..Plan::default() }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_that_is_killed_again_and_again_loses_nothing() {
    let kills = size("POINTSD_KILLS", 6);
    let rig = Rig::with(QUICK_ALARMS).same_port();
    let mut daemon = rig.start();
    let witness = Witness::listen(&daemon.endpoint, None).await;
    let plain = Witness::listen_plainly(&daemon.endpoint).await;
    let logger = Logger::start(&daemon.endpoint, plan("m", REMEMBERED, 10_000)).await;
    let forgetful = Logger::start(&daemon.endpoint, plan("f", 1, 1)).await;
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for kill in 1..=kills {
        let longest = if kill % 12 == 0 { LONG } else { SHORT };
        tokio::time::sleep(rng.random_range(Duration::ZERO..longest)).await;
        daemon.kill();
        daemon = rig.launch().0;
    }
    daemon.kill();
    let daemon = rig.start();
    let (silent, forgotten) = (logger.stop(), forgetful.stop());

    let reader = Reader::open(&rig.database()).await.unwrap();
    let who = |name: &str| (name.to_owned(), "b1".to_owned());
    let machines = (1..=REMEMBERED).map(|number| (who(&format!("m{number}")), silent.published));
    let machines: Published = machines.chain([(who("f1"), forgotten.published)]).collect();
    let settled = settled(&rig, &reader, &machines).await;
    let events = events_of(&reader).await;
    witness.until("every alarm event", |received| received.events.len() >= events.len()).await;
    plain.until("every alarm event, without asking,", |received| received.events.len() >= events.len()).await;
    daemon.terminate();
    // The alarm for a gap comes a minute after its detection, so more events may have come during the wait.
    let at_the_end = events_of(&reader).await;

    let received = witness.received();
    println!("{} alarm events, {} messages received", events.len(), received.messages);
    settled.check(&machines, &format!("{kills} kills"));
    for received in [received, plain.received()] {
        let all: BTreeSet<_> = received.events.iter().cloned().collect();
        assert_eq!(events.difference(&all).collect::<Vec<_>>(), Vec::<&(String, u32)>::new(), "not received");
        assert_eq!(all.difference(&at_the_end).collect::<Vec<_>>(), Vec::<&(String, u32)>::new(), "not stored");
    }
    // A subscriber that also queries gets events in any order; only the plain subscriber shows the order of
    // publication.
    for (alarm_id, numbers) in in_order_of_arrival(&plain.received().events) {
        assert!(numbers.is_sorted(), "{alarm_id}: events arrived as {numbers:?}");
    }
}

fn in_order_of_arrival(received: &[(String, u32)]) -> BTreeMap<String, Vec<u32>> {
    let mut alarms: BTreeMap<String, Vec<u32>> = BTreeMap::new();
    for (alarm_id, event_no) in received {
        alarms.entry(alarm_id.clone()).or_default().push(*event_no);
    }
    alarms
}
