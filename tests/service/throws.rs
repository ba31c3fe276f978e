//! Reception of throws: once, repeated, in a burst, before a crash, among invalid messages.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    thread,
    time::Duration,
};

use pointsd::{
    bus,
    daemon::config::{Document, client_session},
    simulate::{Fault, Part, Shape},
    throw::Throw,
    wire::encode_throw,
};
use serde_json::json;
use zenoh::bytes::Encoding as ContentType;

use crate::{
    http::KEY,
    json::json_message,
    region::router,
    rig::{Daemon, PATIENCE, Rig, ends, faulty_throws, matched, pointsim, put, stub, throws},
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_same_throw_three_times_is_one_row() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let made = throws("boot", 3);
    for throw in &made {
        logger.send([throw; 3]).await;
    }
    let rows = rig.judged(3).await;
    daemon.terminate();
    assert_eq!(rig.history().await.len(), 3);
    for (row, throw) in rows.iter().zip(&made) {
        assert_eq!((&row.throw, row.quality.as_str()), (&throw.id, "good"));
        assert!(row.coefficients.is_some() && row.sd.is_some());
    }
}

/// Python's `cbor2` writes a `datetime` with a tag.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_tagged_time_in_cbor_is_a_time() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let made = throws("boot", 2);
    for (throw, tag) in made.iter().zip([0xc0, 0xc1]) {
        let mut message = encode_throw(throw);
        let name = b"started_at";
        let value = message.windows(name.len()).position(|part| part == name).unwrap() + name.len();
        message.insert(value, tag);
        put(&logger.session, KEY, ContentType::APPLICATION_CBOR, message).await;
    }
    assert_eq!(rig.judged(1).await[0].started_at, made[0].started_at);
    rig.until_sql("SELECT 1 AS n FROM quarantined_messages WHERE throw_no = 2 AND reason LIKE 'started_at: %text'")
        .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn sigterm_in_a_burst_keeps_everything_that_arrived() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let made = throws("boot", 60);
    logger.send(&made).await;
    daemon.until_status("every throw as received", |status| status["received"] == made.len()).await;
    daemon.terminate();
    assert_eq!(rig.number("SELECT count(*) FROM throw"), made.len() as u64);
    // Pending throws are judged after the next start.
    let daemon = rig.start();
    let rows = rig.judged(made.len()).await;
    daemon.terminate();
    let numbers: Vec<u64> = rows.iter().map(|row| row.throw.throw_no).collect();
    assert_eq!(numbers, (1..=60).collect::<Vec<_>>());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_killed_daemon_continues_where_it_stopped() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let made = throws("boot", 12);
    logger.send(&made[..6]).await;
    rig.judged(6).await;
    daemon.kill();
    logger.close().await;

    let daemon = rig.start();
    let logger = daemon.logger(KEY).await;
    logger.send(&made).await;
    rig.judged(12).await;
    daemon.terminate();
    let rows = rig.history().await;
    assert_eq!(rows.len(), 12);
    // The baseline continues, so the monitor was restored.
    assert_eq!(rows[11].baseline.unwrap().so_far, 6);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn poison_goes_to_quarantine_and_good_throws_pass() {
    let (rig, daemon) = Rig::running_with("[subscribe]\nmax_payload_bytes = 100000\nmax_machines = 2\n");
    let session = daemon.client().await;
    let publisher = matched(&session, KEY).await;
    let good = |throw_no| json_message(&stub("boot", throw_no));
    let json = || ContentType::APPLICATION_JSON;
    publisher.put(good(1)).await.unwrap();
    put(&session, KEY, json(), b"{\"schema\": 7}".to_vec()).await;
    put(&session, KEY, ContentType::APPLICATION_CBOR, vec![0x9f; 50_000]).await;
    put(&session, KEY, ContentType::APPLICATION_CBOR, vec![b'x'; 2_000_000]).await;
    session.delete(KEY).await.unwrap();
    for machine in ["north/no name!", "fleet/pointsd", "north/all-machines", "north/second", "north/third"] {
        put(&session, &format!("points/v1/{machine}/throw"), json(), good(1)).await;
    }
    publisher.put(good(2)).await.unwrap();
    rig.judged(3).await;
    let (_, status) = daemon.operate(&["status", "--json"]);
    // The machine that the daemon refuses is an alarm of the daemon about itself.
    rig.until_sql("SELECT 1 FROM active_alarms WHERE machine = 'pointsd' AND text LIKE '%subscribe.max_machines%'")
        .await;
    daemon.until_status("an alarm of its own", |status| status["own_alarms"] == 1).await;
    daemon.says(1, &["status"]);
    daemon.terminate();
    let reasons = rig.sql("SELECT reason FROM quarantine ORDER BY quarantine_row");
    let reasons: Vec<&str> = reasons.iter().map(|row| row["reason"].as_str().unwrap()).collect();
    assert_eq!(reasons.len(), 8, "{reasons:?}");
    let says = [
        "a delete, which is no throw",
        "not a throw in JSON",
        "not valid CBOR",
        "2000000 bytes",
        "is not a site or machine name",
        "the name of pointsd itself",
        "the name of the common alarms of a site",
        "more than 2 machines",
    ];
    for word in says {
        assert!(reasons.iter().any(|reason| reason.contains(word)), "{word}: {reasons:?}");
    }
    assert!(status.contains("\"quarantined\":8"), "{status}");
    let sizes =
        rig.sql("SELECT payload_bytes, length(payload_start) AS kept FROM quarantine WHERE reason LIKE '2000000%'");
    assert_eq!((&sizes[0]["payload_bytes"], &sizes[0]["kept"]), (&2_000_000.into(), &1024.into()));
}

/// Another program locks the database for longer than two attempts to store a throw, then releases it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_locked_database_sends_no_valid_throw_to_quarantine() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let mut other = rig.locked("BEGIN IMMEDIATE").await;
    logger.send([&stub("boot", 1)]).await;
    daemon.until_log("storing throws failed");
    // Each write of the daemon takes two busy timeouts of 5 s. The daemon tries to store the throw with others, then
    // alone, and other loops write in between. The lock lasts longer than both attempts.
    tokio::time::sleep(Duration::from_secs(26)).await;
    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
    daemon.until_log("the database accepts throws again");
    assert_eq!(rig.number("SELECT count(*) FROM throw"), 1);
    assert!(rig.sql("SELECT * FROM quarantine").is_empty());
}

/// Another program locks the database beyond the stop of the daemon.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn throws_that_a_stop_cannot_store_are_counted_as_lost() {
    let (rig, mut daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let mut other = rig.locked("BEGIN IMMEDIATE").await;
    logger.send((1..=5).map(|throw_no| stub("boot", throw_no))).await;
    daemon.until_status("throws", |status| status["received"] == 5).await;
    daemon.signal("-TERM");
    daemon.until_log("a throw is LOST");
    daemon.until_log("5 messages LOST");
    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
    assert_eq!(daemon.wait(PATIENCE).code(), Some(74));
    daemon.until_log("5 received messages could not be stored before the stop");
    assert_eq!(rig.number("SELECT value FROM counter WHERE name = 'lost_messages'"), 5);
}

/// Far more throws than the daemon can handle, at the speed of one link.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_from_one_sender_leaves_room_for_the_throws_of_others() {
    const GOOD: u64 = 60;
    let (rig, daemon) = Rig::running();
    let (mad, sound) = (daemon.client().await, daemon.logger(KEY).await);
    let flood = matched(&mad, "points/v1/north/mad/throw").await;
    for throw_no in 1..=GOOD {
        for _ in 0..2_000 {
            flood.put(vec![0xff; 40]).await.unwrap();
        }
        sound.send([stub("boot", throw_no)]).await;
    }
    let rows = rig.judged(usize::try_from(GOOD).unwrap()).await;
    assert!(rows.iter().map(|row| row.throw.throw_no).eq(1..=GOOD));
    // Dropped throws are counted.
    let sent = GOOD * 2_000 + GOOD;
    let count = |status: &serde_json::Value, what: &str| status[what].as_u64().unwrap();
    daemon
        .until_status("everything is accounted for", |status| {
            ["stored", "quarantined", "dropped"].iter().map(|what| count(status, what)).sum::<u64>() == sent
        })
        .await;
    let dropped = count(&daemon.status(), "dropped");
    rig.until_number("SELECT total(value) = 0 FROM counter WHERE name = 'dropped_received_messages'", 0).await;
    rig.until_sql(
        "SELECT 1 AS n FROM active_alarms WHERE cause = 'data_loss' AND text LIKE '%dropped since the start%'",
    )
    .await;
    daemon.until_log("messages DROPPED");
    daemon.terminate();
    assert_eq!(rig.number("SELECT value FROM counter WHERE name = 'dropped_received_messages'"), dropped);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_missing_throw_number_is_a_gap() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    logger.send([1, 2, 5, 6].map(|number| stub("boot", number))).await;
    rig.judged(4).await;
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE cause = 'data_loss'").await;
    let gaps = rig.sql("SELECT first_throw_no, last_throw_no, missing_throws FROM data_gaps WHERE kind = 'missed'");
    assert_eq!(gaps.len(), 1, "{gaps:?}");
    assert_eq!((&gaps[0]["first_throw_no"], &gaps[0]["last_throw_no"]), (&3.into(), &4.into()));

    // A gap before each throw; without gaps so many throws would end the alarm.
    logger.send((4..44).map(|at| stub("boot", 2 * at))).await;
    rig.judged(44).await;
    // The alarm gives the sum of missing throws when it passes a power of two: 32 of the 42.
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE text LIKE '%: 3_ throws %' OR text LIKE '%: 4_ throws %'")
        .await;
    daemon.terminate();
    let events = texts(&rig, "data_loss");
    assert!(events.iter().all(|text| text.contains("never arrived")), "{events:?}");
}

/// The gap comes from refused messages, not from the link.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_gap_of_refused_messages_names_the_reason() {
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let publisher = matched(&session, KEY).await;
    let good = |throw_no| json_message(&stub("boot", throw_no));
    let text = |throw_no| String::from_utf8(good(throw_no)).unwrap();
    publisher.put(good(1)).await.unwrap();
    // NaN, as Python writes it; an unreadable time; a message without a throw number.
    publisher.put(text(2).replacen("\"current_a\":[", "\"current_a\":[NaN,", 1)).await.unwrap();
    publisher.put(text(3).replacen("\"started_at\":\"", "\"started_at\":\"on ", 1)).await.unwrap();
    publisher.put("{}").await.unwrap();
    // Messages of one batch have the same time of reception: the next throw must not be in this batch.
    rig.until_sql("SELECT 1 FROM quarantine WHERE quarantine_row = 3").await;
    publisher.put(good(5)).await.unwrap();
    rig.until_sql(
        "SELECT 1 FROM active_alarms WHERE text LIKE '%: 3 throws are missing because their messages were refused%'",
    )
    .await;
    publisher.put(good(8)).await.unwrap();
    rig.until_sql(
        "SELECT 1 FROM active_alarms WHERE text LIKE '%: 5 throws are missing, 3 of them because of refused%'",
    )
    .await;
    let gaps = rig.sql("SELECT missing_throws, refused_throws FROM data_gaps WHERE kind = 'missed' ORDER BY 1 DESC");
    assert_eq!(
        gaps,
        [json!({"missing_throws": 3, "refused_throws": 3}), json!({"missing_throws": 2, "refused_throws": 0})]
    );
    let refused = rig.sql("SELECT boot_id, throw_no, reason FROM quarantined_messages");
    let numbers: Vec<_> = refused.iter().map(|row| (row["boot_id"].as_str(), row["throw_no"].as_u64())).collect();
    assert_eq!(numbers, [(Some("boot"), Some(2)), (Some("boot"), Some(3)), (None, None)]);
    let reason = refused[0]["reason"].as_str().unwrap();
    assert!(reason.contains("current_a: NaN is no JSON"), "{reason}");
}

/// Settings with short baselines.
const QUICK: &str = "[diagnosis]\nbaseline_throws = 12\n";

/// Throws of a machine whose motor weakens by 20 %: at `from_throw`, or over `ramp` throws from there.
fn weakened(count: u64, from_throw: u64, ramp: Option<u64>) -> Vec<Throw> {
    let shape = ramp.map_or(Shape::Step, |throws| Shape::Ramp { throws });
    let fault = Fault { part: Part::Kt, shape, size_pct: -20.0, from_throw };
    faulty_throws(fault, "boot", count)
}

/// Publishes throws, and waits until each is judged.
async fn send(rig: &Rig, daemon: &Daemon, throws: &[Throw]) {
    let logger = daemon.logger(KEY).await;
    logger.send(throws).await;
    rig.judged(throws.len()).await;
}

fn texts(rig: &Rig, cause: &str) -> Vec<String> {
    let events = rig.sql(&format!("SELECT text FROM alarm_events WHERE cause = '{cause}' ORDER BY event_at, event_no"));
    events.iter().map(|event| event["text"].as_str().unwrap().to_owned()).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn throws_under_taken_numbers_are_judged_and_the_logger_that_repeats_them_is_named() {
    const BEFORE: u64 = 40;
    let (rig, daemon) = Rig::running_with(QUICK);
    let mut all = weakened(2 * BEFORE, BEFORE, None);
    for throw in &mut all[usize::try_from(BEFORE).unwrap()..] {
        throw.id.throw_no -= BEFORE;
    }
    send(&rig, &daemon, &all).await;
    assert!(!texts(&rig, "kt").is_empty(), "the weak motor is hidden");
    let texts = texts(&rig, "data_loss");
    assert!(texts.first().is_some_and(|text| text.contains("without a new boot_id")), "{texts:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frozen_recorder_is_named_and_is_no_evidence_about_the_machine() {
    const FROZEN: u64 = 20;
    let (rig, daemon) = Rig::running_with(QUICK);
    let mut all = throws("boot", 30);
    for number in 0..FROZEN {
        let mut again = all[usize::try_from(10 + number % 2).unwrap()].clone();
        (again.id.throw_no, again.started_at) = (31 + number, all[29].started_at);
        all.push(again);
    }
    send(&rig, &daemon, &all).await;
    let texts = texts(&rig, "data_loss");
    assert!(texts.first().is_some_and(|text| text.contains("repeats itself")), "{texts:?}");
    let states = rig.sql("SELECT DISTINCT state FROM machine_health");
    assert!(states.iter().all(|row| row["state"] != "healthy"), "{states:?}");
    let repeated = "SELECT count(*) FROM throws_not_evaluated WHERE quality = 'repeated_trace'";
    assert_eq!(rig.number(repeated), FROZEN);
    let unknown = "SELECT count(*) FROM estimate WHERE direction IS NULL";
    assert_eq!(rig.number(unknown), 0, "a repeated throw keeps the direction that its message has");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_drift_is_seen_although_each_trace_comes_five_times() {
    let (rig, daemon) = Rig::running_with(QUICK);
    let mut all = Vec::new();
    for throw in weakened(110, 30, Some(60)) {
        for _ in 0..5 {
            let mut again = throw.clone();
            again.id.throw_no = all.len() as u64 + 1;
            all.push(again);
        }
    }
    send(&rig, &daemon, &all).await;
    assert!(!texts(&rig, "kt").is_empty(), "the weak motor is hidden");
}

/// The load generator sends the requested throws, each different from all others, and counts the judged ones.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_throw_of_the_load_generator_is_judged() {
    let (rig, daemon) = Rig::running();
    let load = ["load", "--machines", "10", "--rate", "50", "--seconds", "2", "--json", "--connect", &daemon.endpoint];
    let output = pointsim(&load).output().unwrap();
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &report["published"], &report["judged"]), (Some(0), &100.into(), &100.into()));
    assert!(report["latency_ms"]["p50"].as_f64().unwrap() > 0.0, "{report}");
    let stored =
        rig.sql("SELECT machine, count(*) AS throws FROM health_history WHERE quality = 'good' GROUP BY machine");
    assert!(stored.len() == 10 && stored.iter().all(|machine| machine["throws"] == 10), "{stored:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_load_without_a_daemon_ends_with_an_error() {
    let (_router, endpoint) = router().await;
    let load = ["load", "--machines", "1", "--rate", "50", "--seconds", "2", "--connect", &endpoint];
    let said = ends(69, &mut pointsim(&load));
    assert!(said.contains("no daemon subscribes to the throws of"), "{said}");
}

/// A slow subscriber receives every health message, or the daemon counts it as dropped.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_health_message_is_received_or_counted_as_dropped() {
    const THROWS: u64 = 4_000;
    let small_buffers = "[zenoh.transport.link.tcp]\nso_sndbuf = 8192\nso_rcvbuf = 8192\n";
    let (_rig, daemon) = Rig::running_with(small_buffers);
    let client = format!("{small_buffers}[zenoh]\nconnect.endpoints = [{:?}]\n", daemon.endpoint);
    let client = client_session(&Document::parse("slow".as_ref(), client).unwrap()).unwrap();
    let slow = bus::open(client).await.unwrap();
    let received = Arc::new(AtomicU64::new(0));
    let count = Arc::clone(&received);
    let on_health = move |_| {
        thread::sleep(Duration::from_millis(1));
        count.fetch_add(1, Relaxed);
    };
    let _subscriber = slow.declare_subscriber("points/v1/**/health").callback(on_health).await.unwrap();
    let logger = daemon.logger(KEY).await;
    logger.send((1..=THROWS).map(|number| stub("boot", number))).await;
    daemon.until_status("judged throws", |status| status["judged"] == THROWS).await;
    let all = async {
        while received.load(Relaxed) + daemon.status()["unpublished"].as_u64().unwrap() < THROWS {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let _ = tokio::time::timeout(PATIENCE, all).await;
    let dropped = daemon.status()["unpublished"].as_u64().unwrap();
    println!("{} received, {dropped} counted as dropped", received.load(Relaxed));
    assert_eq!(received.load(Relaxed) + dropped, THROWS);
}
