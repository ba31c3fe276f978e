//! The running daemon keeps its database within its limits: it deletes traces first, then throws with their estimates,
//! alarms last.

use std::time::Duration;

use pointsd::throw::{Throw, Trace};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::{
    logger::{Logger, Plan, QUICK_ALARMS},
    rig::{PATIENCE, Rig, stub, until},
};

/// Selects every alarm event.
const ALARM_EVENTS: &str = "SELECT alarm_id, event_no FROM alarm_events";

/// Number of stored rows of each kind.
#[derive(Debug)]
struct Kept {
    traces: u64,
    throws: u64,
    alarms: u64,
    bytes: u64,
}

impl Kept {
    fn of(rig: &Rig) -> Self {
        let row = rig.sql(
            "SELECT (SELECT count(*) FROM trace) AS traces, (SELECT count(*) FROM health_history) AS throws, \
             (SELECT count(*) FROM alarm_events) AS alarms, (page_count - freelist_count) * page_size AS bytes \
             FROM pragma_page_count, pragma_freelist_count, pragma_page_size",
        );
        let number = |name: &str| row[0][name].as_u64().unwrap();
        Self { traces: number("traces"), throws: number("throws"), alarms: number("alarms"), bytes: number("bytes") }
    }

    /// Waits until the daemon has deleted enough.
    async fn until(rig: &Rig, is_enough: impl Fn(&Self) -> bool) -> Self {
        until(PATIENCE, async || {
            let kept = Self::of(rig);
            if is_enough(&kept) { Ok(kept) } else { Err(format!("{kept:?}")) }
        })
        .await
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rows_are_bounded_traces_before_throws_before_alarms() {
    // Without bounds until every throw is judged: a bound drops pending throws too, if throws arrive faster than they are
    // judged.
    let (rig, daemon) = Rig::running_with(QUICK_ALARMS);
    let plan = Plan { throws: 120, pace: Duration::from_millis(1), ..Plan::default() };
    let _logger = Logger::start(&daemon.endpoint, plan).await;
    rig.until_sql("SELECT 1 FROM (SELECT count(*) AS judged FROM health_history) WHERE judged = 240").await;
    daemon.terminate();
    let raised = rig.sql(ALARM_EVENTS);
    assert!(!raised.is_empty());

    let rig = rig.store("max_traces = 100\nmax_throws = 150\nballast_mib = 0\nlow_disk_mib = 0\n");
    let daemon = rig.start();
    let kept = Kept::until(&rig, |kept| kept.traces <= 100 && kept.throws <= 150).await;
    assert_eq!((kept.traces, kept.throws), (100, 150));
    let left = rig.sql(ALARM_EVENTS);
    assert!(raised.iter().all(|event| left.contains(event)), "an alarm was deleted: {raised:?}, {left:?}");
    // The newest throws stay, the same number for both machines.
    let oldest = rig.sql("SELECT min(throw_no) AS oldest FROM health_history GROUP BY machine");
    assert_eq!(oldest, [46, 46].map(|oldest| serde_json::json!({"oldest": oldest})), "120 - 75 + 1");
    daemon.until_log("dropped the oldest");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn bytes_are_bounded_and_estimates_outlive_their_traces() {
    let rig = Rig::with(QUICK_ALARMS).store("max_size_mib = 16\nballast_mib = 0\nlow_disk_mib = 0\n");
    let daemon = rig.start();
    let logger = daemon.logger("points/v1/north/21B/throw").await;
    // Noise cannot be compressed: each throw has two thirds of a megabyte.
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut noise = || (0..100_000).map(|_| rng.random_range(-1.0..1.0)).collect::<Vec<f64>>();
    for throw_no in 1..=40 {
        let trace = Trace::new(1000.0, noise(), noise()).unwrap();
        logger.send([Throw { trace, ..stub("b1", throw_no) }]).await;
    }
    rig.judged(40).await;
    let kept = Kept::until(&rig, |kept| kept.bytes <= 16 << 20).await;
    assert!(kept.traces > 0 && kept.traces < 40, "{kept:?}");
    assert_eq!(kept.throws, 40);
    assert!(kept.alarms > 0);
}

/// Three hundred cleared alarms with two events each, written by SQL, as a machine would need weeks for them.
const OLD_ALARMS: &str = "
    INSERT INTO machine (site, machine) VALUES ('north', '21B');
    INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state)
    WITH RECURSIVE number (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM number WHERE n < 300)
    SELECT 'north.21B.friction.' || n, 1, 'friction', n, 2, CASE n WHEN 1 THEN 'active_unacknowledged' ELSE 'normal' END FROM number;
    INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, payload)
    SELECT alarm_row, event_no, raised_at_us, 'warning', state, '{}'
      FROM alarm, (SELECT 1 AS event_no UNION ALL SELECT 2)";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn closed_alarms_are_bounded_and_go_with_their_events_and_open_ones_stay() {
    let rig = Rig::new().store("max_alarms = 100\nballast_mib = 0\nlow_disk_mib = 0\n");
    rig.start().terminate();
    for statement in OLD_ALARMS.split(';') {
        rig.change(statement).await;
    }
    let daemon = rig.start();
    daemon.until_log("dropped the oldest");
    let left =
        "SELECT count(*) AS alarms, min(alarm_row) AS oldest, (SELECT count(*) FROM alarm_event) AS events FROM alarm";
    rig.until_sql(&format!("SELECT 1 FROM ({left}) WHERE alarms <= 101")).await;
    let left = &rig.sql(left)[0];
    assert_eq!((&left["alarms"], &left["oldest"], &left["events"]), (&101.into(), &1.into(), &202.into()), "{left}");
    let oldest_closed = &rig.sql("SELECT min(alarm_row) AS oldest FROM alarm WHERE state = 'normal'")[0];
    assert_eq!(oldest_closed["oldest"], 201);
}
