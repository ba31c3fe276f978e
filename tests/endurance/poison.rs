//! Invalid messages on the live subscription: noise, huge and deeply nested payloads, wrong types and keys, good
//! messages with a changed field, thousands of invented machines. Each good throw among them is stored once, and the
//! memory and the quarantine of the daemon stay within their limits. `POINTSD_POISON=1000000` sets the number of
//! messages.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use pointsd::{
    daemon::StatusReport,
    store::{Reader, ThrowRow},
    throw::Throw,
    wire,
};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;
use zenoh::{Session, bytes::Encoding as ContentType};

use crate::{
    gauge::{Usage, peak_mib, status},
    json::json_message,
    rig::{PATIENCE, Rig, matched, put, size, stub, throws, until, until_matched},
};

const GOOD: &str = "points/v1/good/1/throw";
/// Period of the good throws among the messages.
const EVERY: usize = 100;
/// Messages between two queries of the daemon's status, fewer than its queue holds.
const ROUND: usize = 2_000;
/// Limit of the memory. The limits of the daemon are 128 MiB in the queue and 256 MiB for the longest traces; the
/// messages of this test reach none of them.
const MEMORY_MIB: f64 = 400.0;
/// Configured limit of the quarantine \[messages\].
const QUARANTINE: u64 = 500;
/// Log level without the line for each rejected message, of which there may be a million.
const QUIET: &str = "info,zenoh=warn,pointsd::daemon::receive=error,pointsd::store=error";
/// Configured limit of the machines.
const MACHINES: usize = 2_000;

/// Generator of messages.
struct Poison {
    rng: ChaCha8Rng,
    like: Throw,
    number: usize,
}

/// Key, content type, payload.
type Message = (String, ContentType, Vec<u8>);

impl Poison {
    fn next(&mut self) -> Message {
        self.number += 1;
        let machine = format!("points/v1/bad/m{}/throw", self.rng.random_range(0..10));
        let (cbor, json) = (ContentType::APPLICATION_CBOR, ContentType::APPLICATION_JSON);
        match self.rng.random_range(0..20) {
            0 | 12 | 13 => (machine, cbor, self.noise(300)),
            1 | 14 | 15 => (machine, json, self.noise(300)),
            2 | 16 => (machine, ContentType::default(), self.noise(40)),
            // Nested arrays and maps, and declared lengths without content.
            3 => (machine, cbor, vec![[0x81, 0xa1, 0x9f, 0xbf, 0xd8][self.rng.random_range(0..5)]; 5_000]),
            4 => (machine, json, vec![[b'[', b'{', b'"'][self.rng.random_range(0..3)]; 5_000]),
            5 => (machine, cbor, [&[0x9b][..], &u64::MAX.to_be_bytes(), &[0xfb; 30]].concat()),
            6 | 17 => (machine, cbor, self.damaged()),
            7 | 18 | 19 => (machine, json, self.changed_field()),
            8 => {
                let name = format!("points/v1/many/x{}/throw", self.rng.random_range(0..20_000));
                (name, cbor, wire::encode_throw(&stub("boot", self.number as u64)))
            }
            9 => (self.key(), cbor, wire::encode_throw(&stub("boot", 1))),
            // The same boot and numbers, with different content each time.
            10 => {
                let mut again = stub("boot", 1 + self.number as u64 % 3);
                again.temperature_c = Some(self.rng.random_range(-40.0..60.0));
                (machine, cbor, wire::encode_throw(&again))
            }
            _ => {
                let boot_id = format!("boot-{}", self.number);
                let no = [0, 1, u64::MAX, i64::MAX.cast_unsigned(), 1 << 40][self.rng.random_range(0..5)];
                (machine, cbor, wire::encode_throw(&stub(&boot_id, no)))
            }
        }
    }

    fn noise(&mut self, most: usize) -> Vec<u8> {
        let mut bytes = vec![0; self.rng.random_range(0..most)];
        self.rng.fill_bytes(&mut bytes);
        bytes
    }

    /// A real throw with changed or missing bytes.
    fn damaged(&mut self) -> Vec<u8> {
        let mut bytes = wire::encode_throw(&self.like);
        for _ in 0..self.rng.random_range(1..20) {
            let at = self.rng.random_range(0..bytes.len().min(400));
            bytes[at] = self.rng.random();
        }
        if self.rng.random_bool(0.3) {
            bytes.truncate(self.rng.random_range(0..bytes.len()));
        }
        bytes
    }

    /// A throw in JSON with one field of another type or size.
    fn changed_field(&mut self) -> Vec<u8> {
        let text = String::from_utf8(json_message(&stub("boot", self.number as u64))).unwrap();
        let mut throw: Value = serde_json::from_str(&text).unwrap();
        let fields: Vec<String> = throw.as_object().unwrap().keys().cloned().collect();
        let field = &fields[self.rng.random_range(0..fields.len())];
        let values = [
            json!(null),
            json!(-1),
            json!(u64::MAX),
            json!(1e308),
            json!(-0.0),
            json!(""),
            json!("x".repeat(3_000)),
            json!("9999-12-31T23:59:59Z"),
            json!("-009999-01-01T00:00:00Z"),
            json!([]),
            json!([[[]]]),
            json!({}),
            json!(vec![1e308; 100]),
            json!(vec![Value::Null; 100]),
            json!(true),
            json!("\u{0}\u{202e}"),
        ];
        throw[field] = values[self.rng.random_range(0..values.len())].clone();
        throw.to_string().into_bytes()
    }

    /// A key that matches the subscription and may name no machine.
    fn key(&mut self) -> String {
        let name = [
            "no name!",
            "\u{e9}",
            "a.b",
            "%2e",
            "x".repeat(64).as_str(),
            "x".repeat(65).as_str(),
            "-",
            "é".repeat(500).as_str(),
            "*",
        ][self.rng.random_range(0..9)]
        .to_owned();
        format!("points/v1/keys/{name}/throw")
    }
}

/// Messages just below the limit of 16 MiB, of which a careless decoder makes many times as much memory: a tree of
/// arrays, and an error with escaped characters.
fn swelling() -> [Vec<u8>; 2] {
    let nested = format!("{{\"supply_v\":[{}]}}", vec!["[0]"; (4 << 20) - 8].join(","));
    let text = format!("{{\"sample_rate_hz\":\"{}\"}}", "\u{7f}".repeat((16 << 20) - 32));
    [nested, text].map(String::into_bytes)
}

/// Waits until the daemon has received and handled `sent` messages.
async fn until_handled(session: &Session, sent: u64) -> StatusReport {
    let is_handled = |now: &StatusReport| {
        let handled = now.stored + now.duplicates + now.quarantined + now.lost + now.dropped;
        now.received >= sent && handled >= now.received
    };
    until(PATIENCE, async || {
        let now = status(session).await;
        now.clone().filter(is_handled).ok_or_else(|| format!("{sent} messages sent: {now:?}"))
    })
    .await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_that_arrives_stops_the_daemon_or_fills_its_memory() {
    let messages = size("POINTSD_POISON", 4_000);
    let rig = Rig::with(&format!("[subscribe]\nmax_machines = {MACHINES}\n[log]\nlevel = {QUIET:?}\n"))
        .store(&format!("ballast_mib = 0\nmax_quarantined = {QUARANTINE}\n"));
    let mut daemon = rig.start();
    let session = daemon.client().await;
    let mut good = throws("boot", 40).into_iter().cycle();
    let publisher = matched(&session, GOOD).await;
    let mut poison = Poison { rng: ChaCha8Rng::seed_from_u64(14), like: good.next().unwrap(), number: 0 };
    let (mut sent, mut published) = (0_u64, 0_u64);
    let start = Instant::now();
    for number in 0..messages {
        if number % EVERY == 0 {
            published += 1;
            let mut throw = good.next().unwrap();
            throw.id.throw_no = published;
            publisher.put(wire::encode_throw(&throw)).await.unwrap();
        } else {
            let (key, content_type, payload) = poison.next();
            put(&session, &key, content_type, payload).await;
        }
        sent += 1;
        if number % ROUND == ROUND - 1 {
            until_handled(&session, sent).await;
        }
        if number % (messages / 2) == messages / 4 {
            for payload in swelling() {
                put(&session, "points/v1/bad/m0/throw", ContentType::APPLICATION_JSON, payload).await;
                sent += 1;
            }
            until_handled(&session, sent).await;
            // Above the limit of a link, at this limit, and at the limit of a message.
            for bytes in [17 << 20, 31 << 20, 100 << 20] {
                let payload = wire::encode_throw(&poison.like).into_iter().cycle().take(bytes).collect();
                put(&session, GOOD, ContentType::APPLICATION_CBOR, payload).await;
            }
            session.delete(GOOD).await.unwrap();
            // The daemon may have closed the link: wait until it replies and receives again.
            sent = until_handled(&session, 0).await.received;
            until_matched(&publisher).await;
        }
    }
    until_handled(&session, sent).await;
    // The judgements may be behind the receipts by a part of the run.
    let limit = PATIENCE + Duration::from_millis(messages as u64);
    let end = until(limit, async || {
        let now = status(&session).await;
        now.clone().filter(|now| now.judged >= now.stored).ok_or_else(|| format!("not all throws are judged: {now:?}"))
    })
    .await;
    let seconds = start.elapsed().as_secs_f64();
    assert!(daemon.is_running(), "the daemon has ended: {:?}", daemon.log());
    let most = peak_mib(daemon.id());

    let mut stored: BTreeMap<u64, usize> = BTreeMap::new();
    let reader = Reader::open(&rig.database()).await.unwrap();
    let mut from = ThrowRow::START;
    loop {
        let rows = reader.throws(from, 10_000).await.unwrap();
        let Some(last) = rows.last() else { break };
        from = last.row;
        for row in rows.iter().filter(|row| row.machine.site.as_str() == "good") {
            *stored.entry(row.id.throw_no).or_default() += 1;
        }
    }
    let quarantined = rig.number("SELECT count(*) FROM quarantined_messages");
    println!(
        "{messages} messages in {seconds:.0} s, {published} good throws, {} of them stored; at most {most:.0} MiB; \
         {quarantined} kept in quarantine of {} that went there; {end:?}",
        stored.len(),
        end.quarantined
    );
    assert!(stored.keys().copied().eq(1..=published) && stored.values().all(|times| *times == 1), "{stored:?}");
    assert_eq!((end.dropped, end.lost), (0, 0));
    assert!(end.quarantined > messages as u64 / 3 && end.silent.is_empty(), "{end:?}");
    assert!(quarantined <= QUARANTINE, "{quarantined} messages in quarantine");
    assert!(most < MEMORY_MIB, "{most:.0} MiB");
}

/// Links that are used once, silent connections, and connections that send noise.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn links_that_come_and_go_leave_no_memory_behind() {
    const LINKS: u64 = 200;
    const SOCKETS: usize = 2_000;
    /// Allowed growth \[MiB\]: memory of the first links, and memory that the allocator keeps.
    const GROWTH_MIB: f64 = 24.0;
    let (rig, daemon) = Rig::running();
    let before = Usage::of(daemon.id()).rss_mib;
    for throw_no in 1..=LINKS {
        let logger = daemon.logger(GOOD).await;
        logger.send([stub("boot", throw_no)]).await;
        logger.close().await;
    }
    let address = daemon.endpoint.trim_start_matches("tcp/");
    let mut rng = ChaCha8Rng::seed_from_u64(15);
    for number in 0..SOCKETS {
        let mut socket = tokio::net::TcpStream::connect(address).await.unwrap();
        if number % 2 == 0 {
            let mut noise = [0; 100];
            rng.fill_bytes(&mut noise);
            // The daemon may have closed the connection already.
            let _ = socket.write_all(&noise).await;
        }
    }
    rig.judged(usize::try_from(LINKS).unwrap()).await;
    let growth = Usage::of(daemon.id()).rss_mib - before;
    println!("{LINKS} links and {SOCKETS} sockets: {growth:+.1} MiB");
    assert!(growth < GROWTH_MIB, "{growth:.1} MiB");
}
