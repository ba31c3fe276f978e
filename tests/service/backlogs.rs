//! Backlogs of loggers with messages that are no throws.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU32, Ordering::Relaxed},
    },
    time::Duration,
};

use pointsd::{
    throw::{Throw, ThrowRef, Trace},
    wire::{BacklogQuery, encode_throw},
};
use tokio::sync::mpsc;
use zenoh::{Session, Wait, bytes::Encoding as ContentType};

use crate::{
    http::{ALIVE, KEY, WEB, address, get},
    json::json_message,
    rig::{PATIENCE, Rig, Sender, matched, stub, throws, until},
};

/// Declares the backlog of a logger with these messages, oldest first. Returns the number of queries for it.
pub(crate) async fn keep(session: &Session, key: &'static str, kept: Vec<(ThrowRef, Vec<u8>)>) -> Arc<AtomicU32> {
    let queries = Arc::<AtomicU32>::default();
    let counting = Arc::clone(&queries);
    let on_query = move |query: zenoh::query::Query| {
        counting.fetch_add(1, Relaxed);
        let wanted = BacklogQuery::parse(query.parameters().as_str());
        let start = wanted.start(kept.iter().map(|(throw, _)| throw));
        for (_, message) in kept.iter().skip(start).take(wanted.limit) {
            query.reply(key, message.clone()).encoding(ContentType::APPLICATION_CBOR).wait().unwrap();
        }
    };
    session.declare_queryable(key).callback(on_query).background().await.unwrap();
    queries
}

fn id(throw_no: u64) -> ThrowRef {
    ThrowRef { boot_id: "boot".to_owned(), throw_no }
}

/// The throws of the second machine are long, so the daemon asks for pages of one throw.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn good_throws_behind_unusable_ones_come_from_the_backlog() {
    const MACHINES: [(&str, usize); 2] = [("points/v1/north/short/throw", 20), ("points/v1/north/long/throw", 140_000)];
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    for (key, samples) in MACHINES {
        let throw = |throw_no, samples| Throw {
            trace: Trace::new(20_000.0, vec![0.0; samples], vec![0.0; samples]).unwrap(),
            ..stub("boot", throw_no)
        };
        let mut kept: Vec<_> = (2..=5).map(|throw_no| (id(throw_no), b"no throw".to_vec())).collect();
        kept[0].1 = vec![0; 3 << 20];
        kept.extend((6..=11).map(|throw_no| (id(throw_no), encode_throw(&throw(throw_no, 20)))));
        keep(&session, key, kept).await;
        Sender::of(&session, key).await.send([1, 12].map(|throw_no| throw(throw_no, samples))).await;
    }
    rig.until_number("SELECT count(*) FROM data_gaps WHERE missing_throws > 0", 2).await;
    let gaps = rig.sql("SELECT first_throw_no, last_throw_no FROM data_gaps WHERE missing_throws > 0");
    let found: Vec<_> = gaps.iter().map(|gap| (&gap["first_throw_no"], &gap["last_throw_no"])).collect();
    assert_eq!(found, [(&2.into(), &5.into()), (&2.into(), &5.into())], "{gaps:?}");
    let stored =
        rig.sql("SELECT machine, count(*) AS throws FROM throw JOIN machine USING (machine_row) GROUP BY machine");
    assert!(stored.len() == 2 && stored.iter().all(|machine| machine["throws"] == 8), "{stored:?}");
}

/// A page has 4 MiB, and each of these throws 4.8 MB.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn throws_larger_than_a_page_come_from_the_backlog() {
    const SAMPLES: usize = 600_000;
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let trace = Trace::new(20_000.0, vec![0.0; SAMPLES], vec![0.0; SAMPLES]).unwrap();
    let large = |throw_no| Throw { trace: trace.clone(), ..stub("boot", throw_no) };
    for key in [KEY, "points/v1/north/other/throw"] {
        keep(&session, key, (2..=3).map(|throw_no| (id(throw_no), encode_throw(&large(throw_no)))).collect()).await;
        Sender::of(&session, key).await.send([1, 4].map(|throw_no| stub("boot", throw_no))).await;
    }
    rig.judged(8).await;
    assert!(rig.sql("SELECT * FROM data_gaps WHERE missing_throws > 0").is_empty());
}

/// A trigger stands for a throw that SQLite refuses for a reason that nobody knows yet. The first page has four throws.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_throw_that_the_database_refuses_holds_up_no_other_of_its_page() {
    let (rig, daemon) = Rig::running();
    rig.change(
        "CREATE TRIGGER refuse BEFORE INSERT ON throw WHEN NEW.throw_no = 4 BEGIN SELECT RAISE(ABORT, 'refused'); END",
    )
    .await;
    let session = daemon.client().await;
    let of_throw = |throw_no| (id(throw_no), encode_throw(&stub("boot", throw_no)));
    keep(&session, KEY, (2..=6).map(of_throw).collect()).await;
    Sender::of(&session, KEY).await.send([1, 7].map(|throw_no| stub("boot", throw_no))).await;
    rig.judged(6).await;
    let gaps = rig.sql("SELECT first_throw_no, last_throw_no FROM data_gaps WHERE missing_throws > 0");
    assert_eq!(gaps, [serde_json::json!({"first_throw_no": 4, "last_throw_no": 4})]);
    let quarantined = rig.sql("SELECT reason FROM quarantined_messages");
    assert!(
        quarantined.len() == 1 && quarantined[0].to_string().contains("the database rejects it"),
        "{quarantined:?}"
    );
    let status = daemon.status();
    assert_eq!(
        (&status["quarantined"], &status["stored"], &status["lost"]),
        (&1.into(), &6.into(), &0.into()),
        "{status}"
    );
}

/// The logger declares its token before its backlog is ready, as after each cut of its link.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_outage_does_not_count_as_replies_without_the_throws() {
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let (asked, mut queries) = mpsc::channel(64);
    let is_ready = Arc::new(AtomicBool::new(false));
    let ready = Arc::clone(&is_ready);
    let on_query = move |query: zenoh::query::Query| {
        // An error is no problem: the channel is full of queries, or the test has ended.
        let _ = asked.try_send(());
        for throw_no in [2, 3].into_iter().filter(|_| ready.load(Relaxed)) {
            let message = encode_throw(&stub("boot", throw_no));
            query.reply(KEY, message).encoding(ContentType::APPLICATION_CBOR).wait().unwrap();
        }
    };
    session.declare_queryable(KEY).callback(on_query).background().await.unwrap();
    let token = session.liveliness().declare_token(ALIVE).await.unwrap();
    daemon.until_status("the token", |status| status["loggers"] == 1).await;
    let mut more_queries = async |more: u32| {
        while queries.try_recv().is_ok() {}
        for _ in 0..more {
            tokio::time::timeout(PATIENCE, queries.recv()).await.unwrap().unwrap();
        }
    };
    Sender::of(&session, KEY).await.send([1, 4].map(|throw_no| stub("boot", throw_no))).await;
    rig.until_sql("SELECT 1 FROM throw WHERE throw_no = 4").await;
    // The six queries of a turn that finds nothing, and the first one of the next turn.
    more_queries(7).await;
    token.undeclare().await.unwrap();
    daemon.until_status("no token", |status| status["loggers"] == 0).await;
    // Longer than a connected logger may reply without the missing throws.
    tokio::time::sleep(Duration::from_secs(6)).await;
    let _token = session.liveliness().declare_token(ALIVE).await.unwrap();
    more_queries(7).await;
    is_ready.store(true, Relaxed);
    rig.judged(4).await;
    assert!(rig.sql("SELECT * FROM data_gaps WHERE missing_throws > 0").is_empty());
}

/// A logger that is connected and sends nothing is named, and so is the error of its backlog.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_logger_without_a_throw_is_named() {
    let (_rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let refuse = |query: zenoh::query::Query| query.reply_err("no backlog").wait().unwrap();
    session.declare_queryable(KEY).callback(refuse).background().await.unwrap();
    let _token = session.liveliness().declare_token(ALIVE).await.unwrap();
    daemon.until_log("the query for the backlog of a logger failed");
    daemon.until_status("its name", |status| status["without_throw"] == serde_json::json!(["north/21B"])).await;
    let (_, text) = daemon.operate(&["status"]);
    assert!(text.contains("connected, but no throw yet: north/21B") && text.contains("1 logger,"), "{text}");
}

/// A new logger whose every message is refused is a problem, with the reason, until a throw is valid.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_logger_without_a_valid_message_is_a_problem() {
    let (rig, daemon) = Rig::running_with(WEB);
    let session = daemon.client().await;
    let _token = session.liveliness().declare_token(ALIVE).await.unwrap();
    let publisher = matched(&session, KEY).await;
    publisher.put(r#"{"started_at": "2026-01-01 06:00:00"}"#).await.unwrap();
    let is_named = |status: &serde_json::Value| status["refused"][0] == "north/21B (the field schema is missing)";
    daemon.until_status("the machine after its first message", is_named).await;
    daemon.terminate();
    let daemon = rig.start();
    daemon.until_status("the machine after a restart", is_named).await;
    let session = daemon.client().await;
    let publisher = matched(&session, KEY).await;
    for _ in 0..12 {
        publisher.put(r#"{"started_at": "2026-01-01 06:00:00"}"#).await.unwrap();
    }
    daemon.until_status("the machine", |status| status["refused"][0].as_str().is_some()).await;
    for text in [daemon.says(1, &["status"]), get(&address(&daemon), "/").body] {
        assert!(text.contains("EVERY MESSAGE REFUSED: north/21B (the field schema is missing)"), "{text}");
    }
    publisher.put(json_message(&stub("boot", 1))).await.unwrap();
    rig.judged(1).await;
    daemon.until_status("no machine", |status| status["refused"].as_array().is_some_and(Vec::is_empty)).await;
    // The last messages of a logger that dies, and then the replacement of its retired machine.
    publisher.put(r#"{"started_at": "2026-01-01 06:00:00"}"#).await.unwrap();
    rig.until_number("SELECT count(*) FROM quarantine", 14).await;
    daemon.says(0, &["retire", "north/21B", "--why", "replaced", "--by", "tester"]);
    // The list is read again, as another machine has a message.
    matched(&session, "points/v1/north/other/throw").await.put("no throw").await.unwrap();
    let has_other = |status: &serde_json::Value| status["refused"].to_string().contains("north/other (");
    daemon.until_status("the other machine", has_other).await;
    assert!(!daemon.status()["refused"].to_string().contains("north/21B"), "messages from before the removal count");
    for _ in 0..6 {
        publisher.put(r#"{"started_at": "2026-01-01 06:00:00"}"#).await.unwrap();
    }
    daemon.until_status("the machine after its removal", is_named).await;
}

/// A name that was tried once, long ago.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_refused_machine_is_no_problem_an_hour_after_its_last_message() {
    let rig = Rig::new();
    rig.start().terminate();
    for (machine, hours) in [("old", 2), ("new", 0), ("new", 0), ("other", 0)] {
        rig.change(format!(
            "INSERT INTO quarantine (received_at_us, key, reason, payload_bytes, payload_start)
             VALUES ((unixepoch() - {hours} * 3600) * 1000000, 'points/v1/north/{machine}/throw', 'no throw', 1, x'00')"
        ))
        .await;
    }
    let daemon = rig.start();
    daemon.until_status("a machine", |status| status["refused"] != serde_json::json!([])).await;
    assert_eq!(daemon.status()["refused"], serde_json::json!(["north/new (no throw)", "north/other (no throw)"]));
    rig.change("UPDATE quarantine SET received_at_us = received_at_us - 3600 * 1000000").await;
    daemon.until_status("no machine", |status| status["refused"] == serde_json::json!([])).await;
    daemon.says(0, &["status"]);
}

/// Its throws would go to quarantine, page by page, in each round.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_logger_of_a_refused_machine_is_not_queried() {
    let (rig, daemon) = Rig::running_with("[subscribe]\nmax_machines = 1\n");
    let session = daemon.client().await;
    Sender::of(&session, KEY).await.send([stub("boot", 1)]).await;
    rig.judged(1).await;
    let queries = Arc::new(AtomicBool::new(false));
    let mut tokens = Vec::new();
    for machine in ["north/second", "fleet/pointsd"] {
        let queried = Arc::clone(&queries);
        let on_query = move |_query| queried.store(true, Relaxed);
        let key = format!("points/v1/{machine}/throw");
        session.declare_queryable(key.clone()).callback(on_query).background().await.unwrap();
        tokens.push(session.liveliness().declare_token(format!("points/v1/{machine}/alive")).await.unwrap());
        Sender::of(&session, &key).await.send([stub("boot", 1)]).await;
    }
    rig.until_number("SELECT count(*) FROM quarantine", 2).await;
    daemon.until_status("both loggers", |status| status["loggers"] == 2 && status["machines_refused"] == 1).await;
    assert!(!queries.load(Relaxed), "a logger of a refused machine was queried");
}

/// The backlog ends with a message that is no throw, and the reply to every query contains it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_message_that_is_no_throw_is_in_quarantine_once() {
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    keep(&session, KEY, vec![(id(2), b"no throw".to_vec())]).await;
    Sender::of(&session, KEY).await.send([1, 3].map(|throw_no| stub("boot", throw_no))).await;
    rig.until_sql("SELECT 1 FROM data_gaps WHERE missing_throws = 1").await;
    assert_eq!(rig.sql("SELECT reason FROM quarantined_messages").len(), 1);
    let status = daemon.status();
    assert_eq!(status["quarantined"], 1, "{status}");
}

/// The database takes no message into the quarantine for a time.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_message_that_the_quarantine_could_not_take_is_counted_and_taken_later() {
    let (rig, daemon) = Rig::running();
    rig.change("CREATE TRIGGER refuse BEFORE INSERT ON quarantine BEGIN SELECT RAISE(ABORT, 'refused'); END").await;
    let session = daemon.client().await;
    keep(&session, KEY, vec![(id(2), b"no throw".to_vec())]).await;
    Sender::of(&session, KEY).await.send([1, 3].map(|throw_no| stub("boot", throw_no))).await;
    daemon.until_status("a lost message", |status| status["lost"].as_u64() > Some(0)).await;
    rig.until_sql("SELECT 1 AS n FROM counter WHERE name = 'lost_messages'").await;
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE text LIKE '%could not be stored since the start%'").await;
    rig.change("DROP TRIGGER refuse").await;
    // The daemon queries the logger again.
    Sender::of(&session, KEY).await.send([stub("boot", 5)]).await;
    rig.until_sql("SELECT 1 AS n FROM quarantined_messages").await;
    assert_eq!(daemon.status()["lost"], 1, "each query counted it");
}

/// A backlog on the throw key is all that a logger needs.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn throws_made_while_the_daemon_was_down_come_from_a_logger_without_a_token() {
    let rig = Rig::new().same_port();
    let daemon = rig.start();
    let logger = daemon.logger(KEY).await;
    let made: Vec<_> = (1..=6).map(|throw_no| stub("boot", throw_no)).collect();
    logger.send(&made[..3]).await;
    rig.judged(3).await;
    daemon.terminate();
    keep(&logger.session, KEY, made.iter().map(|throw| (throw.id.clone(), encode_throw(throw))).collect()).await;
    let _daemon = rig.start();
    rig.judged(6).await;
}

/// The logger makes a throw available that it did not publish.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_logger_that_goes_on_without_its_token_is_queried_now_and_then() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    logger.send([stub("boot", 1)]).await;
    rig.judged(1).await;
    let token = logger.session.liveliness().declare_token(ALIVE).await.unwrap();
    daemon.until_status("the token", |status| status["loggers"] == 1).await;
    token.undeclare().await.unwrap();
    daemon.until_status("no token", |status| status["loggers"] == 0).await;
    keep(&logger.session, KEY, vec![(id(2), encode_throw(&stub("boot", 2)))]).await;
    rig.judged(2).await;
}

/// The link closes after the first live throw, so the queries for the missing throw end without a reply. Nothing but the
/// queryable shows that the logger is not connected.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_closed_link_of_a_logger_without_a_token_is_no_reply_without_the_throws() {
    let (rig, daemon) = Rig::running();
    let made = [1, 2, 3, 4].map(|throw_no| stub("boot", throw_no));
    let kept = |made: &[Throw]| made.iter().map(|throw| (throw.id.clone(), encode_throw(throw))).collect::<Vec<_>>();
    let logger = daemon.logger(KEY).await;
    keep(&logger.session, KEY, kept(&made[..1])).await;
    logger.send(&made[..1]).await;
    rig.until_sql("SELECT 1 AS n FROM machine WHERE backlog_read = 1").await;
    // The end of the turn.
    tokio::time::sleep(Duration::from_secs(1)).await;
    logger.close().await;
    let logger = daemon.logger(KEY).await;
    logger.send(&made[2..3]).await;
    rig.until_sql("SELECT 1 FROM throw WHERE throw_no = 3").await;
    logger.close().await;
    // Longer than a connected logger may reply without the missing throw.
    tokio::time::sleep(Duration::from_secs(8)).await;
    let logger = daemon.logger(KEY).await;
    keep(&logger.session, KEY, kept(&made)).await;
    logger.send(&made[3..]).await;
    rig.judged(4).await;
    assert!(rig.sql("SELECT * FROM data_gaps WHERE missing_throws > 0").is_empty());
}

/// The logger does not know the boot of the newest throw, as after an import of recordings, so its pages begin with the
/// oldest throw. The missing throws come after more pages of stored throws than a turn has.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn missing_throws_behind_many_stored_boots_come_from_the_backlog() {
    const BOOTS: usize = 14;
    const EACH: u64 = 33;
    let (rig, daemon) = Rig::running();
    let session = daemon.client().await;
    let sender = Sender::of(&session, KEY).await;
    let boots = (0..BOOTS).map(|boot| format!("boot-{boot}"));
    let made: Vec<_> = boots.flat_map(|boot| (1..=EACH).map(move |throw_no| stub(&boot, throw_no))).collect();
    let (last, stored) = (&made[made.len() - 1], made.len() - usize::try_from(EACH).unwrap());
    sender.send(&made[..stored]).await;
    sender.send([stub("imported", 1)]).await;
    rig.judged(stored + 1).await;
    rig.until_number("SELECT count(*) FROM backlog", 0).await;
    let kept = made.iter().map(|throw| (throw.id.clone(), encode_throw(throw))).collect();
    let queries = keep(&session, KEY, kept).await;
    // No throw is missing, so a turn with repeated pages is the last one.
    let _token = session.liveliness().declare_token(ALIVE).await.unwrap();
    until(PATIENCE, async || if queries.load(Relaxed) < 4 { Err("no turn") } else { Ok(()) }).await;
    tokio::time::sleep(Duration::from_millis(500)).await;
    let asked = queries.load(Relaxed);
    tokio::time::sleep(Duration::from_millis(2_500)).await;
    assert_eq!(queries.load(Relaxed), asked, "the daemon asks on");
    sender.send([last]).await;
    rig.judged(made.len() + 1).await;
    rig.until_number("SELECT count(*) FROM backlog", 0).await;
    assert!(rig.sql("SELECT * FROM data_gaps WHERE missing_throws > 0").is_empty());
}

/// While the link is cut, the motor is replaced. Its throws from before would be a baseline of the worn machine.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn throws_of_a_backlog_from_before_a_repair_do_not_count() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let recorded = throws("boot", 30);
    let now = jiff::Timestamp::now;
    let mut sent = 0;
    // The ages of two throws are compared that arrive a second apart or more. Two are enough, unless this computer is
    // busy at the moment of one.
    while rig.sql("SELECT 1 AS n FROM monitor WHERE snapshot LIKE '%\"at_once\":\"%'").is_empty() {
        logger.send([Throw { started_at: now(), ..recorded[sent].clone() }]).await;
        sent += 1;
        rig.judged(sent).await;
        assert!(sent < 20, "no two throws of the same age");
        tokio::time::sleep(Duration::from_millis(1_500)).await;
    }
    logger.close().await;
    let said = daemon.says(0, &["rebaseline", "north/21B", "--why", "new motor", "--by", "tester"]);
    assert!(!said.contains("may be learned"), "{said}");

    let session = daemon.client().await;
    let of_throw = |throw: &Throw| (throw.id.clone(), encode_throw(throw));
    let made_at = now() - jiff::SignedDuration::from_hours(1);
    let late = recorded[sent..sent + 4].iter().map(|throw| of_throw(&Throw { started_at: made_at, ..throw.clone() }));
    keep(&session, KEY, late.collect()).await;
    let current = Throw { started_at: now(), ..recorded[sent + 4].clone() };
    Sender::of(&session, KEY).await.send([current]).await;
    let mut history = rig.judged(sent + 5).await;
    history.sort_by_key(|health| health.throw.throw_no);
    let (late, current) = history[sent..].split_at(4);
    for health in late {
        let detail = health.detail.as_deref().unwrap_or_default();
        assert!(detail.contains("does not count") && health.coefficients.is_some(), "{health:?}");
        assert_eq!(health.baseline.map(|baseline| baseline.so_far), Some(0), "{health:?}");
    }
    assert_eq!((current[0].detail.as_deref(), current[0].baseline.map(|baseline| baseline.so_far)), (None, Some(1)));
}
