//! Jumps of the wall clock during operation: a day back, ten years ahead, and correct again. Alarms and their order are
//! the same as without jumps, and no row is deleted for its age.

use std::fs;

use serde_json::Value;

use crate::{
    logger::{Logger, Plan, QUICK_ALARMS},
    rig::Rig,
    witness::Witness,
};

#[path = "../support/faketime.rs"]
mod faketime;

/// Throws of each of two machines between two jumps.
const THROWS: u64 = 30;

/// A run of the daemon with a clock jump before each part; ends when the witness received all alarm events.
async fn life(jumps: &[&str]) -> Option<Rig> {
    let mut rig = Rig::with(QUICK_ALARMS).same_port();
    let clock = faketime::clock_of(&mut rig)?;
    rig.set("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    let mut daemon = rig.start();
    let witness = Witness::listen(&daemon.endpoint, None).await;
    let mut loggers = Vec::new();
    for (part, jump) in jumps.iter().enumerate() {
        fs::write(&clock, jump).unwrap();
        // Half of the parts start with a restart, so the daemon opens a database with other times.
        if part % 2 == 1 {
            daemon.terminate();
            daemon = rig.start();
        }
        let plan = Plan { throws: THROWS, boot_id: format!("b{part}"), ..Plan::default() };
        loggers.push(Logger::start(&daemon.endpoint, plan).await);
        let all = 2 * THROWS * (part as u64 + 1);
        witness.until("every throw", |received| received.health.len() as u64 == all).await;
    }
    let events = alarm_events(&rig).len();
    witness.until("every alarm event", |received| received.events.len() == events).await;
    daemon.terminate();
    Some(rig)
}

fn alarm_events(rig: &Rig) -> Vec<Value> {
    rig.sql("SELECT machine, cause, event_no, severity, state, text FROM alarm_events ORDER BY machine, raised_at, event_no")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_clock_that_jumps_harms_neither_order_nor_alarms_nor_retention() {
    let Some(steady) = life(&["+0", "+0", "+0", "+0", "+0"]).await else { return };
    let Some(jumped) = life(&["+0", "-1d", "+3650d", "-1d", "+0"]).await else { return };
    assert!(!alarm_events(&steady).is_empty());
    assert_eq!(alarm_events(&jumped), alarm_events(&steady), "the same alarms, in the same order");

    let received_us = jumped.number("SELECT max(received_at_us) - min(received_at_us) FROM throw");
    assert!(received_us > 3600 * 24 * 3650 * 1_000_000, "the daemon's clock did not jump by ten years");
    let order = jumped.sql(
        "SELECT boot_id, throw_no FROM throw JOIN boot USING (boot_row) WHERE throw.machine_row = 1 ORDER BY throw_row",
    );
    let order: Vec<_> = order.iter().map(|row| (row["boot_id"].as_str().unwrap(), row["throw_no"].as_u64())).collect();
    assert!(order.is_sorted(), "{order:?}");
    assert_eq!(order.len() as u64, 5 * THROWS);
    assert_eq!(jumped.number("SELECT count(*) FROM trace"), 10 * THROWS, "a trace was deleted");
    assert!(jumped.sql("SELECT * FROM data_gaps").is_empty());
}
