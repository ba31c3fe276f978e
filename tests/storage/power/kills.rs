//! Repeated `kill -9` at random moments, with the same database.

use std::{fs, process::Command, time::Duration};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{Acknowledged, inspect, worker};

#[tokio::test]
async fn a_worker_that_is_killed_again_and_again_loses_nothing() {
    let kills: usize =
        std::env::var("POINTSD_KILLS").map_or(8, |kills| kills.parse().expect("POINTSD_KILLS is a number"));
    let folder = tempfile::tempdir().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let acknowledged =
        || Acknowledged::of_lines(&fs::read_to_string(folder.path().join("points.db.ack")).unwrap_or_default());
    let mut killed_at_work = 0;
    for _ in 0..kills {
        let before = acknowledged();
        let mut worker = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "power::worker::run"])
            .env(worker::FOLDER, folder.path())
            .env(worker::THROWS, "100000")
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        tokio::time::sleep(Duration::from_millis(rng.random_range(20..400))).await;
        worker.kill().unwrap();
        worker.wait().unwrap();
        killed_at_work += usize::from(acknowledged() != before);
    }
    assert!(killed_at_work > 0, "no worker stored a throw");
    let acknowledged = acknowledged();
    let verdict = inspect(folder.path(), &acknowledged).await;
    println!("{kills} kills, {killed_at_work} of them at work, {} throws acknowledged", acknowledged.throws.len());
    assert_eq!((verdict.lost, verdict.duplicated, verdict.unreadable), (0, 0, 0), "{:?}", verdict.notes);
}
