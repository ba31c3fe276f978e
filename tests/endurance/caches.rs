//! What loggers have cached, and what they leave out: a daemon takes all of it at its own pace, in bounded memory.

use std::{fs, time::Duration};

use pointsd::wire::{self, Encoding};
use zenoh::{Session, bytes::Encoding as ContentType, qos::CongestionControl, sample::SourceInfo};

use crate::{
    gauge::{peak_mib, status},
    logger::{Logger, Plan, throw},
    rig::{PATIENCE, Rig, matched, stub},
};

/// Machines and throws of each: together more than the daemon has room for.
const MACHINES: usize = 3;
const THROWS: u64 = 1_600;
const ROOM: usize = 128 << 20;
/// What a daemon may take at most while it fetches them, which is far less than they are \[MiB\].
const MEMORY_MIB: f64 = 110.0;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_that_starts_behind_full_caches_takes_all_of_them() {
    let cached = (1..=THROWS).map(|throw_no| wire::encode_throw(Encoding::Cbor, &throw("b1", throw_no)).len());
    let cached = MACHINES * cached.sum::<usize>();
    assert!(cached > ROOM, "{cached} bytes in the caches");
    let rig = Rig::new().same_port();
    let daemon = rig.start();
    let plan = Plan { throws: THROWS, machines: MACHINES, cache: 2_000, pace: Duration::ZERO, ..Plan::default() };
    let logger = Logger::start(&daemon.endpoint, plan).await;
    // All of its publishers have seen the daemon then.
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
    println!("{all} throws, {} MiB, from caches: at most {peak:.0} MiB of memory; {now:?}", cached >> 20);
    assert_eq!((now.dropped, now.missed, now.lost, now.quarantined), (0, 0, 0, 0));
    daemon.until_status("nothing is behind", |now| now["behind"] == 0).await;
    assert!(now.duplicates < all / 20, "{now:?}");
    assert!(peak < MEMORY_MIB, "{peak:.0} MiB");
    assert!(daemon.terminate().success());
}

/// A sender that numbers its messages, leaves one out and has no cache to ask for it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_behind_a_missing_one_take_bounded_memory() {
    const MESSAGES: u32 = 20_000;
    const BYTES: usize = 20_000;
    /// Half of the room for what waits, and what is on the way to the database; 400 MB are sent.
    const MEMORY_MIB: f64 = 230.0;
    let rig = Rig::with("[log]\nlevel = \"info,pointsd::daemon::receive=error\"\n");
    let daemon = rig.start();
    let session = daemon.client().await;
    let bad = matched(&session, "points/v1/bad/1/throw").await;
    let mut sent = 0;
    for number in (0..=MESSAGES).filter(|number| *number != 1) {
        bad.put(vec![b'x'; BYTES]).source_info(SourceInfo::new(bad.id(), number)).await.unwrap();
        sent += 1;
        if number % 1_000 == 500 {
            good(&session, u64::from(number / 1_000) + 1).await;
        }
    }
    let accounted = |now: &serde_json::Value| {
        let count = |name: &str| now[name].as_u64().unwrap();
        count("quarantined") + count("missed") + count("dropped") > sent && count("stored") == 20
    };
    daemon.until_status("each message in quarantine or counted", accounted).await;
    let (now, peak) = (status(&session).await.unwrap(), peak_mib(daemon.id()));
    println!("{sent} messages behind a missing one: at most {peak:.0} MiB of memory; {now:?}");
    assert!(now.missed >= 1 && now.dropped == 0, "{now:?}");
    assert!(peak < MEMORY_MIB, "{peak:.0} MiB");
    assert!(daemon.terminate().success());
}

async fn good(session: &Session, throw_no: u64) {
    let payload = wire::encode_throw(Encoding::Cbor, &stub("boot", throw_no));
    let put = session.put("points/v1/good/1/throw", payload).encoding(ContentType::APPLICATION_CBOR);
    tokio::time::timeout(PATIENCE, put.congestion_control(CongestionControl::Block).into_future())
        .await
        .unwrap()
        .unwrap();
}
