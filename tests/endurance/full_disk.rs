//! A full disk during operation, and free space again: without a crash, a loss or a restart.

use crate::{
    database::inspect,
    logger::{Logger, Plan, QUICK_ALARMS},
    rig::Rig,
    small_disk::SmallDisk,
    verdict::Verdict,
    witness::Witness,
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_disk_filled_and_freed_loses_nothing_and_needs_no_restart() {
    fill_and_free(1).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_without_ballast_raises_an_alarm_too() {
    fill_and_free(0).await;
}

async fn fill_and_free(ballast_mib: u64) {
    let Some(disk) = SmallDisk::mount() else { return };
    let rig = Rig::with(QUICK_ALARMS)
        .in_folder(disk.folder())
        .store(&format!("ballast_mib = {ballast_mib}\nlow_disk_mib = 2\n"));
    let daemon = rig.start();
    let witness = Witness::listen(&daemon.endpoint, None).await;
    let first = Logger::start(&daemon.endpoint, Plan { throws: 10, ..Plan::default() }).await;
    witness.until("a healthy start", |received| received.health.len() == 20).await;

    disk.fill();
    // The daemon removes its ballast, if any, whose space is enough to commit the alarm.
    let about_disk = |(alarm_id, _): &(String, u32)| alarm_id.starts_with("fleet.pointsd.data_loss.");
    witness.until("an alarm about the disk", |received| received.events.iter().any(about_disk)).await;
    // Now no write can succeed.
    disk.fill();
    let logger = Logger::start(&daemon.endpoint, Plan { boot_id: "b2".to_owned(), ..Plan::default() }).await;
    daemon.until_status("a full disk", |status| status["disk"] == "full").await;
    let published = witness.received().health.len();
    let (_, line) = daemon.operate(&["status"]);
    assert!(line.contains("DISK FULL"), "{line}");
    let log = daemon.log();
    assert!(log.iter().any(|line| line.contains("ERROR") && line.contains("storing throws failed")), "{log:?}");
    let count = log.iter().filter(|line| line.contains("write transaction failed")).count();
    assert!(count <= 3, "the same log line {count} times");
    let (exit_code, open) = daemon.operate(&["alarms", "--check"]);
    assert_eq!(exit_code, Some(1), "{open}");
    assert!(open.contains("data loss"), "{open}");
    // The daemon still runs and answers while throws arrive.
    let received = daemon.status()["received"].as_u64().unwrap();
    daemon.until_status("throws that wait", |status| status["received"].as_u64() > Some(received + 20)).await;
    assert!(witness.received().health.len() < published + 20, "the disk was not full");

    disk.free();
    daemon.until_status("a disk with room", |status| status["disk"] == "ok").await;
    let silent = logger.stop();
    let all = 20 + 2 * usize::try_from(silent.published).unwrap();
    witness.until("every throw", |received| received.health.len() >= all).await;
    let status = daemon.status();
    assert_eq!((&status["lost"], &status["dropped"]), (&0.into(), &0.into()), "{status}");
    drop(first);
    daemon.terminate();
    assert!(rig.sql("SELECT * FROM data_gaps").is_empty());
    let mut verdict = Verdict::default();
    let acknowledged = witness.received().acknowledged();
    inspect(rig.folder(), &acknowledged, &mut verdict).await;
    let Verdict { lost, duplicated, unreadable, notes, .. } = verdict;
    assert_eq!((lost, duplicated, unreadable), (0, 0, 0), "{notes:?}");
}
