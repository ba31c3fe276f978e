//! The running daemon keeps its database within its limits: it deletes traces first, then throws with their estimates,
//! alarms last.

use std::time::Duration;

use crate::{
    logger::{Logger, Plan, QUICK_ALARMS},
    rig::Rig,
};

/// Selects every alarm event.
const ALARM_EVENTS: &str = "SELECT alarm_id, event_no FROM alarm_events";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rows_are_bounded_traces_before_throws_before_alarms() {
    // The limits are set after every throw is judged: when throws arrive faster than they are judged, a limit also
    // drops pending throws.
    let (rig, daemon) = Rig::running_with(QUICK_ALARMS);
    let plan = Plan { throws: 120, pace: Duration::from_millis(1), ..Plan::default() };
    let _logger = Logger::start(&daemon.endpoint, plan).await;
    rig.until_number("SELECT count(*) FROM health_history", 240).await;
    daemon.terminate();
    let raised = rig.sql(ALARM_EVENTS);
    assert!(!raised.is_empty());

    let rig = rig.store("max_traces = 100\nmax_throws = 150\nballast_mib = 0\nlow_disk_mib = 0\n");
    let daemon = rig.start();
    let kept = "SELECT (SELECT count(*) FROM trace) AS traces, (SELECT count(*) FROM health_history) AS throws";
    rig.until_sql(&format!("SELECT 1 FROM ({kept}) WHERE traces <= 100 AND throws <= 150")).await;
    assert_eq!(rig.sql(kept), [serde_json::json!({"traces": 100, "throws": 150})]);
    let left = rig.sql(ALARM_EVENTS);
    assert!(raised.iter().all(|event| left.contains(event)), "an alarm was deleted: {raised:?}, {left:?}");
    // The newest throws stay, the same number for both machines.
    let oldest = rig.sql("SELECT min(throw_no) AS oldest FROM health_history GROUP BY machine");
    assert_eq!(oldest, [46, 46].map(|oldest| serde_json::json!({"oldest": oldest})), "120 - 75 + 1");
    daemon.until_log("dropped the oldest");
}
