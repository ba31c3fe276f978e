//! Backlogs of loggers, complete, with gaps, or false: a daemon reads the missing throws once, at its own rate, in
//! bounded memory.

use std::{fs, time::Duration};

use pointsd::{
    throw::{Throw, Trace},
    wire,
};
use zenoh::Wait;

use crate::{
    gauge::{peak_mib, status},
    logger::{Logger, Plan, throw},
    rig::{Rig, Sender, stub},
};

const MACHINES: usize = 3;
/// Throws of each machine: together they are larger than [`BUDGET`].
const THROWS: u64 = 1_600;
/// Memory that the daemon has for received messages \[bytes\].
const BUDGET: usize = 128 << 20;
/// Limit of the daemon's memory while it reads the backlogs, below their size \[MiB\]. Measured: 87 on a quiet
/// computer, 112 with compilers on both cores.
const MEMORY_MIB: f64 = 130.0;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_that_starts_with_full_backlogs_stores_every_throw() {
    let of_one = (1..=THROWS).map(|throw_no| wire::encode_throw(&throw("b1", throw_no)).len());
    let bytes = MACHINES * of_one.sum::<usize>();
    assert!(bytes > BUDGET, "{bytes} bytes in the backlogs");
    let rig = Rig::new().same_port();
    let daemon = rig.start();
    let plan = Plan { throws: THROWS, machines: MACHINES, kept: 2_000, pace: Duration::ZERO, ..Plan::default() };
    let logger = Logger::start(&daemon.endpoint, plan).await;
    // Each machine has sent a throw, so all publishers are connected to the daemon.
    daemon.until_status("a throw of the last machine", |now| now["received"].as_u64() >= Some(MACHINES as u64)).await;
    daemon.kill();
    for file in fs::read_dir(rig.database().parent().unwrap()).unwrap() {
        let file = file.unwrap().path();
        if file.to_string_lossy().contains("points.db") {
            fs::remove_file(file).unwrap();
        }
    }
    let silent = logger.finish();
    let daemon = rig.start();
    let all = MACHINES as u64 * silent.published;
    daemon.until_status("all throws", |now| now["stored"] == all).await;
    let session = daemon.client().await;
    let (now, peak) = (status(&session).await.unwrap(), peak_mib(daemon.id()));
    println!("{all} throws, {} MiB, from backlogs: at most {peak:.0} MiB of memory; {now:?}", bytes >> 20);
    assert_eq!((now.dropped, now.lost, now.quarantined), (0, 0, 0));
    daemon.until_status("an empty backlog", |now| now["backlog"] == 0).await;
    assert!(rig.sql("SELECT * FROM data_gaps WHERE missing_throws > 0").is_empty());
    assert!(now.duplicates < all / 20, "{now:?}");
    assert!(peak < MEMORY_MIB, "{peak:.0} MiB");
}

/// A logger without a backlog leaves out a throw: later throws are stored at once, and no other machine waits.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn throws_behind_a_missing_one_are_stored_at_once_in_bounded_memory() {
    const THROWS: u64 = 4_000;
    const SAMPLES: usize = 2_500;
    const MEMORY_MIB: f64 = 200.0;
    let (rig, daemon) = Rig::running_with("[subscribe]\nbacklog_wait_s = 86400\n");
    let session = daemon.client().await;
    let (bad, good) = (daemon.logger("points/v1/bad/1/throw").await, daemon.logger("points/v1/good/1/throw").await);
    let trace = Trace::new(1000.0, vec![0.0; SAMPLES], vec![0.0; SAMPLES]).unwrap();
    for throw_no in (1..=THROWS).filter(|throw_no| *throw_no != 2) {
        bad.send([Throw { trace: trace.clone(), ..stub("b1", throw_no) }]).await;
        if throw_no % 200 == 100 {
            good.send([stub("b1", throw_no / 200 + 1)]).await;
        }
    }
    let all = THROWS - 1 + THROWS / 200;
    // The daemon drops throws above the share of one sender, and counts them.
    let accounted = move |now: &serde_json::Value| {
        let count = |name: &str| now[name].as_u64().unwrap();
        count("stored") + count("dropped") == all && count("judged") == count("stored")
    };
    daemon.until_status("every throw as stored or counted", accounted).await;
    let (now, peak) = (status(&session).await.unwrap(), peak_mib(daemon.id()));
    println!("{THROWS} throws behind a missing one: at most {peak:.0} MiB of memory; {now:?}");
    assert!(now.stored > THROWS / 2 && now.backlog == 0, "{now:?}");
    let order = rig.sql("SELECT throw_no FROM health_history WHERE site = 'bad' AND throw_no < 5");
    assert_eq!(order.len(), 3);
    assert!(peak < MEMORY_MIB, "{peak:.0} MiB");
}

/// A daemon that is repeatedly killed does not read the same page of a backlog again.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_that_is_started_twenty_times_receives_no_throw_twice() {
    const STARTS: usize = 20;
    const MACHINES: usize = 3;
    /// Number of throws in a page.
    const PAGE: u64 = 32;
    let rig = Rig::new().same_port();
    let mut daemon = rig.start();
    let plan = Plan { machines: MACHINES, pace: Duration::from_millis(20), ..Plan::default() };
    let logger = Logger::start(&daemon.endpoint, plan).await;
    let mut duplicates = 0;
    for _ in 0..STARTS {
        daemon.until_status("its loggers, and throws", |now| now["loggers"] == MACHINES && now["stored"] != 0).await;
        duplicates += daemon.status()["duplicates"].as_u64().unwrap();
        daemon.kill();
        daemon = rig.start();
    }
    let silent = logger.stop();
    let last = silent.published;
    rig.until_number("SELECT count(*) FROM throw", last * MACHINES as u64).await;
    duplicates += daemon.status()["duplicates"].as_u64().unwrap();
    println!("{STARTS} starts, {last} throws of each of {MACHINES} machines: {duplicates} came twice");
    assert!(duplicates <= PAGE * MACHINES as u64, "{duplicates} throws came twice");
}

/// Loggers with endless backlogs, known throws, foreign names, or messages that are no throws harm only themselves.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn loggers_with_false_replies_harm_only_themselves() {
    const LIES: [&str; 4] = ["endless", "known", "other", "noise"];
    const REPLIES: u64 = 3_000;
    const MEMORY_MIB: f64 = 150.0;
    let (rig, daemon) = Rig::running_with("[log]\nlevel = \"info,pointsd::daemon=error\"\n");
    let session = daemon.client().await;
    let throw_of = |throw_no| wire::encode_throw(&stub("b1", throw_no));
    for lie in LIES {
        let key = format!("points/v1/bad/{lie}/throw");
        let queryable = session.declare_queryable(key.clone()).callback(move |query| {
            std::thread::spawn(move || {
                for number in 0..REPLIES {
                    let (key, payload) = match lie {
                        "endless" => (query.key_expr().to_string(), throw_of(1_000_000 + number)),
                        "known" => (query.key_expr().to_string(), throw_of(1)),
                        "other" => ("points/v1/good/1/throw".to_owned(), throw_of(1_000_000 + number)),
                        _ => (query.key_expr().to_string(), vec![b'x'; 10_000]),
                    };
                    if query.reply(key, payload).wait().is_err() {
                        return;
                    }
                }
            });
        });
        queryable.background().await.unwrap();
        Sender::of(&session, &key).await.send([1, 5].map(|throw_no| stub("b1", throw_no))).await;
    }
    // A correct logger has a gap, which its backlog fills.
    let plan = Plan { throws: 40, machine: "m", machines: 1, ..Plan::default() };
    let honest = Logger::start(&daemon.endpoint, plan).await;
    rig.until_number("SELECT count(*) FROM health_history WHERE site = 'north'", 40).await;
    for lie in LIES {
        let known = format!("SELECT 1 FROM health_history WHERE machine = '{lie}' AND throw_no = 5");
        rig.until_sql(&known).await;
    }
    daemon.until_status("lies are counted", |now| now["ignored"].as_u64() > Some(REPLIES)).await;
    let (now, peak) = (status(&session).await.unwrap(), peak_mib(daemon.id()));
    println!("lying loggers: at most {peak:.0} MiB of memory; {now:?}");
    assert!(
        rig.sql("SELECT 1 FROM health_history WHERE site = 'good'").is_empty(),
        "a throw with a foreign name was stored"
    );
    assert!(peak < MEMORY_MIB, "{peak:.0} MiB");
    drop(honest.stop());
}
