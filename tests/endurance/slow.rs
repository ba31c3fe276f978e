//! A subscriber that never reads and an SQL reader that never closes: the rates of storing and judging stay the same,
//! and memory and the write-ahead log stay within their limits. `POINTSD_SLOW_THROWS` sets the number of throws.

use std::{
    env,
    io::{BufRead, BufReader, Lines},
    process::{ChildStdout, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    thread,
    time::{Duration, Instant},
};

use pointsd::{daemon::StatusReport, throw::Throw, wire};
use sqlx::{Connection, SqliteConnection, sqlite::SqliteConnectOptions};
use zenoh::{Session, pubsub::Publisher};

use crate::{
    gauge::{file_mib, peak_mib, status},
    rig::{self, PATIENCE, Program, Rig, matched, size, throws},
};

const KEY: &str = "points/v1/north/21B/throw";
/// Configured limit of the write-ahead log \[MiB\].
const LOG_MIB: f64 = 32.0;
/// Allowed excess over this limit, by one group of writes \[MiB\].
const GROUP_MIB: f64 = 8.0;
/// Memory for readers that hang: buffers of a link, and of the bounded queues before it \[MiB\].
const MEMORY_MIB: f64 = 64.0;
/// Throws published before the test waits for the daemon.
const AHEAD: u64 = 1_000;
/// Largest factor between the rates of two equal runs on a busy computer.
const NOISE: f64 = 3.0;

/// Environment variable for the process of the subscriber that hangs: endpoint of the daemon.
const HANGING_AT: &str = "POINTSD_HANGING_AT";
/// Line that this process prints when it has subscribed.
const LISTENS: &str = "listens";
/// Line that this process prints at its first message.
const RECEIVES: &str = "receives";

/// A subscriber to all messages that stays in its first callback. It has its own process, because the sessions of a
/// process share their threads.
struct Hanging {
    _program: Program,
    said: Lines<BufReader<ChildStdout>>,
}

impl Hanging {
    fn start(endpoint: &str) -> Self {
        let mut child = Command::new(env::current_exe().unwrap())
            .args(["--exact", "slow::hang", "--nocapture"])
            .env(HANGING_AT, endpoint)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let said = BufReader::new(child.stdout.take().unwrap()).lines();
        Self { _program: Program(child), said }
    }

    fn until(&mut self, said: &str) {
        assert!(self.said.any(|line| line.unwrap().contains(said)), "the subscriber ended before {said:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hang() {
    let Ok(endpoint) = env::var(HANGING_AT) else { return };
    let session = rig::client_of(&endpoint).await;
    let hangs = |_| {
        println!("{RECEIVES}");
        loop {
            thread::park();
        }
    };
    let _subscriber = session.declare_subscriber("points/v1/**").callback(hangs).await.unwrap();
    println!("{LISTENS}");
    // The test kills this process, at the latest after the longest run.
    tokio::time::sleep(20 * PATIENCE).await;
    std::process::exit(1);
}

/// Samples the size of the write-ahead log until `stop` is set; returns the largest \[MiB\].
fn watch_log(rig: &Rig, stop: Arc<AtomicBool>) -> thread::JoinHandle<f64> {
    let database = rig.database();
    thread::spawn(move || {
        let mut most = 0.0_f64;
        while !stop.load(Relaxed) {
            most = most.max(file_mib(&database, "-wal"));
            thread::sleep(Duration::from_millis(10));
        }
        most
    })
}

struct Source<'a> {
    session: &'a Session,
    publisher: Publisher<'static>,
    like: std::iter::Cycle<std::vec::IntoIter<Throw>>,
    published: u64,
}

impl Source<'_> {
    /// Publishes throws at the rate of the daemon; returns the throws stored and judged per second.
    async fn rates(&mut self, count: u64) -> [f64; 2] {
        let start = Instant::now();
        for number in 0..count {
            // Never publish more than the queue of the daemon holds: the daemon would drop the rest.
            if number % AHEAD == AHEAD - 1 {
                self.until(|now| now.stored, start).await;
            }
            self.published += 1;
            let mut throw = self.like.next().unwrap();
            throw.id.throw_no = self.published;
            self.publisher.put(wire::encode_throw(&throw)).await.unwrap();
        }
        self.until(|now| now.stored, start).await;
        let stored = start.elapsed();
        self.until(|now| now.judged, start).await;
        [stored, start.elapsed()].map(|time| count as f64 / time.as_secs_f64())
    }

    /// Waits until a counter of the status has reached the number of published throws.
    async fn until(&self, counter: impl Fn(&StatusReport) -> u64, start: Instant) {
        loop {
            let now = status(self.session).await;
            assert!(start.elapsed() < 10 * PATIENCE, "{} published: {now:?}", self.published);
            if let Some(now) = now {
                assert_eq!(now.dropped, 0, "{now:?}");
                if counter(&now) >= self.published {
                    return;
                }
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn readers_that_hang_neither_slow_ingestion_nor_grow_memory_or_log() {
    let count = size("POINTSD_SLOW_THROWS", 800) as u64;
    let rig = Rig::new().store(&format!("ballast_mib = 0\nmax_wal_mib = {LOG_MIB:.0}\n"));
    let daemon = rig.start();
    let session = daemon.client().await;
    let publisher = matched(&session, KEY).await;
    let mut source =
        Source { session: &session, publisher, like: throws("boot", 40).into_iter().cycle(), published: 0 };
    source.rates(100).await;

    let without = source.rates(count).await;
    let before_mib = peak_mib(daemon.id());

    let mut hanging = Hanging::start(&daemon.endpoint);
    hanging.until(LISTENS);
    source.rates(20).await;
    hanging.until(RECEIVES);
    // Another connection has started a read transaction.
    let options = SqliteConnectOptions::new().filename(rig.database()).read_only(true);
    let mut reader = SqliteConnection::connect_with(&options).await.unwrap();
    let mut transaction = reader.begin().await.unwrap();
    let rows: i64 =
        sqlx::query_scalar("SELECT count(*) FROM health_history").fetch_one(&mut *transaction).await.unwrap();

    let stop = Arc::new(AtomicBool::new(false));
    let watching = watch_log(&rig, Arc::clone(&stop));
    let with = source.rates(count).await;
    stop.store(true, Relaxed);
    let (log_mib, after_mib) = (watching.join().unwrap(), peak_mib(daemon.id()));
    let seen: i64 =
        sqlx::query_scalar("SELECT count(*) FROM health_history").fetch_one(&mut *transaction).await.unwrap();
    drop(hanging);
    transaction.rollback().await.unwrap();
    let end = status(&session).await.unwrap();
    daemon.terminate();

    let ratio = [with[0] / without[0], with[1] / without[1]];
    println!(
        "stored {:.0}/s and judged {:.0}/s without, {:.0}/s and {:.0}/s with a subscriber and an SQL reader that hang: \
         ratios {:.2} and {:.2}; memory at most {before_mib:.1} MiB without, {after_mib:.1} MiB with; log at most \
         {log_mib:.1} MiB; {end:?}",
        without[0], without[1], with[0], with[1], ratio[0], ratio[1]
    );
    assert_eq!(rows, seen, "the reader did not keep its state");
    assert_eq!((end.stored, end.dropped, end.lost), (source.published, 0, 0));
    assert!(ratio.iter().all(|ratio| *ratio > 1.0 / NOISE), "ingestion is slowed: {ratio:?}");
    assert!(after_mib < before_mib + MEMORY_MIB, "memory grows to {after_mib:.0} MiB");
    assert!(log_mib < LOG_MIB + GROUP_MIB, "the log grows to {log_mib:.0} MiB");
}
