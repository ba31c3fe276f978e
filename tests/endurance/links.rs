//! Links that are cut for longer than the lease of zenoh, a router that ends, a logger that restarts. Twenty machines
//! throw all the time. Afterwards each throw is stored once, or is in a recorded gap that the logger's backlog could
//! not fill, and every alarm event reached a subscriber, whose own link was cut too.
//!
//! `POINTSD_CUT_SECONDS=30` sets the length of the cuts, with 10 throws/s; the default is faster.

use std::{collections::BTreeSet, time::Duration};

use pointsd::store::Reader;

use crate::{
    cable::Cable,
    database::{Published, settled},
    logger::{Logger, Plan, QUICK_ALARMS},
    rig::{Rig, size},
    verdict::events,
    witness::Witness,
};

const MACHINES: usize = 20;
/// Throws of each machine in the backlog of its logger: more than it makes during a cut.
const BACKLOG: usize = 64;

/// Length of a cut, and throws per second.
fn scale() -> (Duration, f64) {
    match size("POINTSD_CUT_SECONDS", 0) {
        0 => (Duration::from_secs(4), 50.0),
        seconds => (Duration::from_secs(seconds as u64), 10.0),
    }
}

/// A logger of twenty machines, and a logger of one machine with a backlog of one throw.
async fn loggers(endpoint: &str, boot_id: &str, rate: f64) -> [Logger; 2] {
    let plan = |machine, machines, kept, rate| Plan {
        machine,
        machines,
        kept,
        pace: Duration::from_secs_f64(1.0 / rate),
        boot_id: boot_id.to_owned(),
        ..Plan::default()
    };
    let remembers = Logger::start(endpoint, plan("m", MACHINES, BACKLOG, rate)).await;
    [remembers, Logger::start(endpoint, plan("f", 1, 1, rate / 10.0)).await]
}

/// Stops the loggers; their backlogs reply until the returned values are dropped.
fn stop([remembers, forgets]: [Logger; 2], boot_id: &str, published: &mut Published) -> [crate::logger::Silent; 2] {
    let silent = [remembers.stop(), forgets.stop()];
    let machines = (1..=MACHINES).map(|number| (format!("m{number}"), silent[0].published));
    for (machine, last) in machines.chain([("f1".to_owned(), silent[1].published)]) {
        published.insert((machine, boot_id.to_owned()), last);
    }
    silent
}

/// Waits until all throws are stored or missing, judged and published; checks and prints the result.
async fn settle(rig: &Rig, witness: &Witness, published: &Published, what: &str) {
    let reader = Reader::open(&rig.database()).await.unwrap();
    let known = settled(rig, &reader, published).await;
    let events = events(&reader).await;
    witness.until("every alarm event", |received| received.events.len() >= events.len()).await;
    let received = witness.received();
    println!("{} alarm events, {} messages received", events.len(), received.messages);
    known.check(published, what);
    assert_eq!(received.events.iter().cloned().collect::<BTreeSet<_>>(), events, "every event, and nothing else");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cut_links_and_new_loggers_lose_nothing_that_a_backlog_holds() {
    let (cut, rate) = scale();
    let (rig, daemon) = Rig::running_with(QUICK_ALARMS);
    let (field, control_room) = (Cable::to(&daemon.endpoint).await, Cable::to(&daemon.endpoint).await);
    let witness = Witness::listen(&control_room.endpoint, None).await;
    let mut published = Published::new();
    let mut silent = Vec::new();
    for boot_id in ["b1", "b2"] {
        let loggers = loggers(&field.endpoint, boot_id, rate).await;
        tokio::time::sleep(cut).await;
        field.cut();
        tokio::time::sleep(cut / 2).await;
        control_room.cut();
        tokio::time::sleep(cut / 2).await;
        field.mend();
        tokio::time::sleep(cut / 2).await;
        control_room.mend();
        // The next loggers replace these backlogs, so their throws must be stored before.
        silent.extend(stop(loggers, boot_id, &mut published));
        settle(&rig, &witness, &published, &format!("a cut of {cut:?}, start {boot_id}")).await;
        silent.clear();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_router_that_dies_loses_nothing_that_a_backlog_holds() {
    let (cut, rate) = scale();
    // Every pointsd is a router; this one serves a site without machines.
    let router_rig = Rig::with("[subscribe]\nkey = \"points/v1/nowhere/**\"\n[monitor]\nid = \"router\"\n").same_port();
    let router = router_rig.start();
    let endpoint = router.endpoint.clone();
    let rig = Rig::with(QUICK_ALARMS).behind(&endpoint);
    let _daemon = rig.start();
    let witness = Witness::listen(&endpoint, None).await;
    let loggers = loggers(&endpoint, "b1", rate).await;
    tokio::time::sleep(cut).await;
    router.kill();
    tokio::time::sleep(cut).await;
    let _router = router_rig.start();
    tokio::time::sleep(cut / 2).await;
    let mut published = Published::new();
    let silent = stop(loggers, "b1", &mut published);
    settle(&rig, &witness, &published, &format!("a router down for {cut:?}")).await;
    drop(silent);
}
