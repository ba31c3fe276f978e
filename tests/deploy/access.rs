//! Access rules of a cabinet: who may publish, read and command. Each test includes the permitted case, so that a
//! missing message proves a rejection.

use std::{
    sync::{Arc, Mutex, atomic::Ordering},
    time::Duration,
};

use tokio::{io::AsyncReadExt, net::TcpStream};
use zenoh::{Wait, query::ConsolidationMode};

use super::{
    cable::Cable,
    rig::{has, listen, matched},
    site::*,
};

const ALARM: &str = "points/v1/north/21A/alarm";
const HEALTH: &str = "points/v1/north/21A/health";
const COMMAND: &str = "points/v1/north/21A/command";
const ALIVE_A: &str = "points/v1/north/21A/alive";
const ALIVE_B: &str = "points/v1/north/21B/alive";

#[tokio::test(flavor = "multi_thread")]
async fn each_logger_publishes_for_its_own_machine_only() {
    let Some((cabinet, endpoint)) = cabinet().await else { return };
    let throws = throw_subscriber(&cabinet).await;
    let logger = client("logger.north.21A", &endpoint).await;
    let (own, foreign) = (matched(&logger, THROW_A).await, matched(&logger, THROW_B).await);

    // A link keeps the order: after the second message the first cannot arrive any more.
    foreign.put("forged").await.unwrap();
    own.put("true").await.unwrap();
    assert_eq!(next(&throws).await, (THROW_A.to_owned(), b"true".to_vec()));

    let other = client("logger.north.21B", &endpoint).await;
    let publisher = matched(&other, THROW_B).await;
    publisher.put("also true").await.unwrap();
    assert_eq!(next(&throws).await, (THROW_B.to_owned(), b"also true".to_vec()));
    assert!(tokio::time::timeout(SILENCE, throws.recv_async()).await.is_err(), "the forged throw came late");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_logger_cannot_answer_or_be_alive_for_another() {
    let Some((cabinet, endpoint)) = cabinet().await else { return };
    let logger = client("logger.north.21A", &endpoint).await;
    let _forged = answer(&logger, "points/v1/north/21B/throw/@adv/**", THROW_B).await;
    let smuggled = answer(&logger, "points/v1/north/21A/throw/@adv/pub/smuggled", THROW_B).await;
    let honest = answer(&logger, "points/v1/north/21A/throw/@adv/pub/honest", THROW_A).await;
    let _forged_token = logger.liveliness().declare_token(ALIVE_B).await.unwrap();
    let _own_token = logger.liveliness().declare_token(ALIVE_A).await.unwrap();

    until("a logger may answer for its own machine", async || {
        ask(&cabinet, "points/v1/*/*/throw/@adv/pub/honest?_anyke", None).await == [THROW_A]
    })
    .await;
    assert!(honest.load(Ordering::SeqCst) > 0, "the query must reach the logger");

    assert!(ask(&cabinet, "points/v1/*/*/throw/@adv/pub/smuggled?_anyke", None).await.is_empty());
    assert!(
        smuggled.load(Ordering::SeqCst) > 0,
        "the query must reach the logger: its reply in the name of another machine is what the rules drop"
    );
    assert!(ask(&cabinet, "points/v1/north/21B/throw/@adv/**?_anyke", None).await.is_empty());
    assert_eq!(alive(&cabinet, "points/v1/**/alive").await, [ALIVE_A]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_without_a_certificate_of_the_authority_gets_no_link() {
    let Some((_cabinet, endpoint)) = cabinet().await else { return };
    let good = client_config(&railway().folder("logger.north.21A"), &endpoint);
    assert!(gets_a_link(good.clone()).await);

    // A certificate of a foreign authority with a known name; the client trusts our authority.
    let mut forged = good.clone();
    for (key, file) in [("connect_certificate", "cert.pem"), ("connect_private_key", "key.pem")] {
        let path = stranger().folder("logger.north.21A").join(file);
        forged.insert_json5(&format!("transport/link/tls/{key}"), &format!("{path:?}")).unwrap();
    }
    assert!(!gets_a_link(forged).await, "a foreign certificate opened a link");

    let mut anonymous = good;
    anonymous.insert_json5("transport/link/tls/enable_mtls", "false").unwrap();
    anonymous.insert_json5("transport/link/tls/connect_certificate", "null").unwrap();
    anonymous.insert_json5("transport/link/tls/connect_private_key", "null").unwrap();
    assert!(!gets_a_link(anonymous).await, "a client without a certificate opened a link");

    let mut plain = zenoh::Config::default();
    plain.insert_json5("mode", "\"client\"").unwrap();
    plain.insert_json5("scouting/multicast/enabled", "false").unwrap();
    plain.insert_json5("connect/endpoints", &format!("[\"{}\"]", endpoint.replace("tls/", "tcp/"))).unwrap();
    assert!(!gets_a_link(plain).await, "a client without TLS opened a link");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_expired_certificate_opens_no_link() {
    let Some((_cabinet, endpoint)) = cabinet().await else { return };
    let config = client_config(&railway().expiring("logger.north.21A"), &endpoint);
    // This certificate is valid for a second; a valid one of the same name shows that only the time matters.
    until("the certificate expires", async || !gets_a_link(config.clone()).await).await;
    assert!(gets_a_link(client_config(&railway().folder("logger.north.21A"), &endpoint)).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_logger_does_not_connect_to_a_false_cabinet() {
    if !has("openssl") {
        return;
    }
    let mut config = zenoh_table(&cabinet_toml("tls/127.0.0.1:0", None));
    for (key, file) in
        [("listen_certificate", "cert.pem"), ("listen_private_key", "key.pem"), ("root_ca_certificate", "ca.pem")]
    {
        let path = stranger().folder("cabinet.north").join(file);
        config.insert_json5(&format!("transport/link/tls/{key}"), &format!("{path:?}")).unwrap();
    }
    let (_false_cabinet, endpoint) = open_and_locate(config).await;
    let link = async |authority: &Authority| {
        gets_a_link(client_config(&authority.folder("logger.north.21A"), &endpoint)).await
    };
    assert!(!link(railway()).await, "the logger connected to a cabinet of a foreign authority");
    assert!(link(stranger()).await, "the cabinet must accept clients of its own authority");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_the_access_rules_do_not_list_gets_nothing() {
    let Some((cabinet, endpoint)) = cabinet().await else { return };
    let throws = throw_subscriber(&cabinet).await;
    let health = answer(&cabinet, "points/v1/*/*/health", HEALTH).await;
    let commands = answer(&cabinet, "points/v1/*/*/command", COMMAND).await;
    let _alive = cabinet.liveliness().declare_token("points/v1/north/monitor/cabinet/alive").await.unwrap();
    let guest = client("guest", &endpoint).await;
    // A session receives its own messages, so a second session of the guest publishes.
    let publisher = client("guest", &endpoint).await;
    let viewer = client("viewer", &endpoint).await;
    let (messages, viewed) = (guest.declare_subscriber("**").await.unwrap(), listen(&viewer).await);
    let alarms = listen(&guest).await;

    publisher.put(THROW_A, "forged").await.unwrap();
    publisher.put(ALARM, "forged").await.unwrap();
    publish_until(&cabinet, ALARM, &viewed).await;
    assert!(tokio::time::timeout(SILENCE, alarms.recv_async()).await.is_err(), "the guest read an alarm");
    assert!(messages.try_recv().unwrap().is_none(), "the guest read a message");
    assert!(throws.try_recv().unwrap().is_none(), "the throw of the guest was accepted");

    assert!(ask(&guest, "points/v1/*/*/health", None).await.is_empty());
    assert!(ask(&guest, COMMAND, Some("{}")).await.is_empty());
    assert!(alive(&guest, "points/v1/**/alive").await.is_empty());
    assert_eq!((health.load(Ordering::SeqCst), commands.load(Ordering::SeqCst)), (0, 0));
    assert_eq!(ask(&viewer, "points/v1/*/*/health", None).await, [HEALTH]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_viewer_reads_and_an_operator_commands() {
    let Some((cabinet, endpoint)) = cabinet().await else { return };
    let throws = throw_subscriber(&cabinet).await;
    let alarms_of_cabinet = cabinet.declare_subscriber("points/v1/*/*/alarm").await.unwrap();
    let _health = answer(&cabinet, "points/v1/*/*/health", HEALTH).await;
    let _alarm = answer(&cabinet, "points/v1/*/*/alarm", ALARM).await;
    let commands = answer(&cabinet, "points/v1/*/*/command", COMMAND).await;
    let _alive = cabinet.liveliness().declare_token("points/v1/north/monitor/cabinet/alive").await.unwrap();
    let viewer = client("viewer", &endpoint).await;
    let operator = client("operator", &endpoint).await;

    for reader in [&viewer, &operator] {
        let alarms = listen(reader).await;
        publish_until(&cabinet, ALARM, &alarms).await;
        assert_eq!(ask(reader, "points/v1/**/health?limit=1", None).await, [HEALTH]);
        assert_eq!(ask(reader, "points/v1/north/*/alarm", None).await, [ALARM]);
        assert_eq!(alive(reader, "points/v1/**/alive").await, ["points/v1/north/monitor/cabinet/alive"]);
    }
    while alarms_of_cabinet.try_recv().unwrap().is_some() {}

    for key in [COMMAND, "points/v1/*/*/command", "points/v1/**", "points/v1/*/*/*", "**"] {
        assert!(ask(&viewer, key, Some("{}")).await.is_empty(), "{key} was answered");
    }
    assert_eq!(commands.load(Ordering::SeqCst), 0, "a viewer commanded");
    assert_eq!(ask(&operator, COMMAND, Some("{}")).await, [COMMAND]);
    assert_eq!(commands.load(Ordering::SeqCst), 1);

    for reader in [&viewer, &operator] {
        reader.put(ALARM, "forged").await.unwrap();
        reader.put(THROW_A, "forged").await.unwrap();
        // The link keeps the order: the reply to a later query shows that the puts before it are decided.
        assert_eq!(ask(reader, "points/v1/**/health", None).await, [HEALTH]);
        assert!(throws.try_recv().unwrap().is_none(), "a forged throw was accepted");
        assert!(alarms_of_cabinet.try_recv().unwrap().is_none(), "a forged alarm was accepted");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_logger_neither_reads_alarms_nor_commands() {
    let Some((cabinet, endpoint)) = cabinet().await else { return };
    let health = answer(&cabinet, "points/v1/*/*/health", HEALTH).await;
    let commands = answer(&cabinet, "points/v1/*/*/command", COMMAND).await;
    let logger = client("logger.north.21A", &endpoint).await;
    let viewer = client("viewer", &endpoint).await;
    let (messages, viewed) = (listen(&logger).await, listen(&viewer).await);
    publish_until(&cabinet, ALARM, &viewed).await;
    assert!(tokio::time::timeout(SILENCE, messages.recv_async()).await.is_err(), "a logger read an alarm");
    assert!(ask(&logger, HEALTH, None).await.is_empty(), "a logger read health");
    assert!(ask(&logger, COMMAND, Some("{}")).await.is_empty(), "a logger's command was answered");
    assert_eq!((health.load(Ordering::SeqCst), commands.load(Ordering::SeqCst)), (0, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_above_the_limit_is_refused_and_the_next_good_one_is_taken() {
    const LIMIT: usize = 2 * 1024 * 1024;
    let Some((cabinet, endpoint)) = cabinet().await else { return };
    let throws = throw_subscriber(&cabinet).await;
    let logger = client("logger.north.21A", &endpoint).await;
    // A logger without a backlog, so that nobody requests a rejected message again.
    let publisher = matched(&logger, THROW_A).await;
    // The rejected sizes are a byte above the limit, and so much that zenoh sends the message in fragments.
    for (size, taken) in [(LIMIT, true), (LIMIT + 1, false), (64, true), (3 * LIMIT, false), (65, true)] {
        publisher.put(vec![7_u8; size]).await.unwrap();
        if taken {
            assert_eq!(next(&throws).await.1.len(), size);
        }
    }
    let commands = answer(&cabinet, "points/v1/*/*/command", COMMAND).await;
    let operator = client("operator", &endpoint).await;
    assert!(ask(&operator, COMMAND, Some(&"x".repeat(16 * 1024 + 1))).await.is_empty());
    assert_eq!(commands.load(Ordering::SeqCst), 0);
    assert_eq!(ask(&operator, COMMAND, Some("{}")).await, [COMMAND]);
}

#[tokio::test(flavor = "multi_thread")]
async fn throws_made_while_the_link_was_down_are_read_from_the_backlog_through_the_rules() {
    let Some((cabinet, endpoint)) = cabinet().await else { return };
    let relay = Cable::to(&endpoint).await;
    let mut config = client_config(&railway().folder("logger.north.21A"), &relay.endpoint);
    config.insert_json5("connect/retry", "{ period_init_ms: 100, period_max_ms: 200 }").unwrap();
    let logger = zenoh::open(config).await.unwrap();
    let kept = Arc::new(Mutex::new(Vec::<Vec<u8>>::new()));
    let answering = Arc::clone(&kept);
    let backlog = logger.declare_queryable(THROW_A).callback(move |query| {
        for payload in answering.lock().unwrap().iter() {
            query.reply(THROW_A, payload.clone()).wait().unwrap();
        }
    });
    let _backlog = backlog.await.unwrap();
    let page = async || {
        let get = cabinet.get(format!("{THROW_A}?limit=9")).consolidation(ConsolidationMode::None);
        let replies = get.timeout(Duration::from_secs(1)).await.unwrap();
        let mut page = Vec::new();
        while let Ok(reply) = replies.recv_async().await {
            page.extend(reply.result().ok().map(|sample| sample.payload().to_bytes().into_owned()));
        }
        page
    };
    kept.lock().unwrap().push(b"before the first cut".to_vec());
    for outage in 0..2_u8 {
        until("the backlog is read", async || page().await == *kept.lock().unwrap()).await;
        relay.break_off();
        until("the link is down", async || page().await.is_empty()).await;
        kept.lock().unwrap().push(vec![outage]);
        relay.mend();
    }
    until("the backlog is read after the last cut", async || page().await == *kept.lock().unwrap()).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flood_of_connections_keeps_others_out_only_while_it_lasts() {
    if !has("openssl") {
        return;
    }
    // The shipped limits, with smaller values and times.
    let text = cabinet_toml("tls/127.0.0.1:0", None);
    let text = replaced(&text, "accept_timeout = 10000", "accept_timeout = 1000");
    let text = replaced(&text, "accept_pending = 32", "accept_pending = 4");
    let text = replaced(&text, "max_sessions = 256", "max_sessions = 2");
    let (_cabinet, endpoint) = open_and_locate(zenoh_table(&text)).await;
    let address = endpoint.trim_start_matches("tls/").to_owned();
    let logger = client_config(&railway().folder("logger.north.21A"), &endpoint);

    // The cabinet closes silent connections.
    let mut silent = Vec::new();
    for _ in 0..40 {
        silent.push(TcpStream::connect(&address).await.unwrap());
    }
    for socket in &mut silent {
        let end = tokio::time::timeout(PATIENCE, socket.read(&mut [0; 64])).await.expect("it is closed");
        assert!(matches!(end, Ok(0) | Err(_)), "{end:?}");
    }
    until("after the flood a logger has its link", async || gets_a_link(logger.clone()).await).await;

    // Links with a good certificate count too; the end of a link frees its place.
    let first = client("viewer", &endpoint).await;
    let _second = client("operator", &endpoint).await;
    assert!(!gets_a_link(logger.clone()).await, "a third link was accepted, above the limit");
    first.close().await.unwrap();
    until("the end of a link frees its place", async || gets_a_link(logger.clone()).await).await;
}

/// Publishes until `reader` receives the alarm, because a new subscription takes some time to spread.
async fn publish_until(session: &zenoh::Session, key: &'static str, reader: &Subscriber) {
    until("a reader gets the alarm", async || {
        session.put(key, "{}").wait().unwrap();
        tokio::time::timeout(Duration::from_millis(50), reader.recv_async()).await.is_ok()
    })
    .await;
}
