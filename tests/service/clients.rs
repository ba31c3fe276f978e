//! Many clients, slow clients and malicious clients: none slows down the daemon.

use std::{
    io::{Read, Write},
    net::TcpStream,
    thread,
    time::{Duration, Instant},
};

use pointsd::{
    bus::QueryQueue,
    throw::{Throw, ThrowRef, Trace},
};
use tokio::runtime::Handle;

use crate::{
    cable::Cable,
    http::{KEY, get, small_history},
    questions::large,
    rig::{PATIENCE, Rig, client_of, status_of, stub, throws},
};

/// Without a reply, the daemon would look like a daemon without data.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_query_that_finds_a_full_queue_gets_an_error() {
    const KEY: &str = "points/v1/north/21B/health";
    let mut config = zenoh::Config::default();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    config.insert_json5("listen/endpoints", "[]").unwrap();
    let session = zenoh::open(config).await.unwrap();
    let tasks = || Handle::current().metrics().num_alive_tasks();
    let before = tasks();
    let mut questions = QueryQueue::declare(&session, KEY).await.unwrap();
    assert_eq!(tasks(), before, "the queue started a task that nothing supervises");
    let mut queries = Vec::new();
    for _ in 0..65 {
        queries.push(session.get(KEY).await.unwrap());
    }
    let reply = tokio::time::timeout(Duration::from_secs(5), queries[64].recv_async()).await.unwrap().unwrap();
    let error = reply.result().unwrap_err().payload().try_to_string().unwrap().into_owned();
    assert!(error.contains("ask again"), "{error}");
    assert_eq!(questions.take_dropped(), 1);
    for waiting in &queries[..64] {
        assert!(waiting.is_empty(), "the others wait");
    }
    let (_, first) = questions.next().await.unwrap();
    assert_eq!(first.key_expr().as_str(), KEY);
}

/// Replies that fill a hanging link wait until zenoh closes it; replies to others do not wait with them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_link_that_hangs_delays_no_answer_to_others() {
    const HISTORY: &str = "points/v1/**/health?limit=10000";
    let rig = Rig::new();
    large(&rig, 100, 20_000).await;
    let daemon = rig.start();
    let cable = Cable::to(&daemon.endpoint).await;
    let (slow, quick) = (client_of(&cable.endpoint).await, daemon.client().await);
    let mut histories = Vec::new();
    for _ in 0..4 {
        histories.push(slow.get(HISTORY).await.unwrap());
    }
    histories[0].recv_async().await.unwrap();
    cable.cut();
    // Until the buffers of the link are full.
    tokio::time::sleep(Duration::from_secs(1)).await;
    let begin = Instant::now();
    let replies = quick.get("points/v1/north/m1/health").await.unwrap();
    assert!(replies.recv_async().await.unwrap().into_result().is_ok());
    assert!(begin.elapsed() < Duration::from_secs(2), "an answer took {:?}", begin.elapsed());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_hundred_readers_at_once_do_not_hold_up_the_throws() {
    const CLIENTS: usize = 200;
    let (rig, daemon, address) = small_history().await;
    let resident_kib = || status_of(daemon.id(), "VmRSS").parse::<u64>().unwrap();
    let before = resident_kib();
    let logger = daemon.logger(KEY).await;
    let paths = ["/", "/machines/north/21B?span=all", "/machines/north/21B/throws/boot/2", "/metrics"];
    let readers: Vec<_> = (0..CLIENTS)
        .map(|client| {
            let address = address.clone();
            thread::spawn(move || [0, 1, 2].map(|turn| get(&address, paths[(client + turn) % paths.len()]).status))
        })
        .collect();
    let made = throws("during", 40);
    logger.send(&made).await;
    rig.judged(3 + made.len()).await;
    let mut busy = 0;
    for reader in readers {
        for status in reader.join().unwrap() {
            assert!(status == 200 || status == 503, "{status}");
            busy += usize::from(status == 503);
        }
    }
    let grown = resident_kib().saturating_sub(before);
    println!("{CLIENTS} readers, {busy} of {} answers were busy; memory {before} KiB + {grown} KiB", 3 * CLIENTS);
    // 64 connections, each with a page and its buffers, and the throws.
    assert!(grown < 64 << 10, "{grown} KiB more");
}

/// Each client has a trace of 10 MB in the memory of the daemon until it has read it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_a_few_large_responses_are_in_memory_at_once() {
    let (rig, daemon, address) = small_history().await;
    let values = vec![0.123_456_7; 300_000];
    let throw = Throw { trace: Trace::new(20_000.0, values.clone(), values).unwrap(), ..stub("large", 1) };
    let logger = daemon.logger(KEY).await;
    logger.send([&throw]).await;
    rig.judged(4).await;
    let begun = || {
        let mut stream = TcpStream::connect(&address).unwrap();
        let path = "/machines/north/21B/throws/large/1/trace.csv";
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
        let mut status = [0; 12];
        stream.read_exact(&mut status).unwrap();
        (String::from_utf8_lossy(&status).into_owned(), stream)
    };
    let mut clients: Vec<_> = (0..5).map(|_| begun()).collect();
    let statuses: Vec<&str> = clients.iter().map(|(status, _)| &status[9..]).collect();
    assert_eq!(statuses, ["200", "200", "200", "200", "503"]);
    // A client that has read its trace makes way for the next.
    let mut trace = String::new();
    clients[0].1.read_to_string(&mut trace).unwrap();
    assert!(trace.lines().count() > 300_000);
    let begin = Instant::now();
    while begun().0.ends_with("503") {
        assert!(begin.elapsed() < PATIENCE);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn slow_and_endless_requests_are_cut_and_the_daemon_continues() {
    let (rig, daemon, address) = small_history().await;
    // More connections than the limit, each with an incomplete request.
    let crowd = || -> Vec<TcpStream> {
        let slow = |_| {
            let mut stream = TcpStream::connect(&address).unwrap();
            stream.write_all(b"GET / HTTP/1.1\r\nHost: ").unwrap();
            stream
        };
        (0..100).map(slow).collect()
    };
    let mut slow = crowd();
    let logger = daemon.logger(KEY).await;
    logger.send([&throws("after", 1)[0]]).await;
    assert_eq!(rig.judged(4).await.last().unwrap().throw, ThrowRef { boot_id: "after".to_owned(), throw_no: 1 });
    // The slow connections make way at once, before their time limit, although others replace them.
    for path in ["/healthz", "/"] {
        // New slow connections, before their time limit.
        slow.extend(crowd());
        let begin = Instant::now();
        assert_eq!(get(&address, path).status, 200);
        assert!(begin.elapsed() < Duration::from_secs(2), "{path} took {:?}", begin.elapsed());
    }
    for stream in &mut slow {
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        // All of them are closed: by an end, a reset, or an error response.
        let gone = stream.read_to_end(&mut Vec::new());
        assert!(
            gone.as_ref().err().is_none_or(|error| error.kind() == std::io::ErrorKind::ConnectionReset),
            "{gone:?}"
        );
    }
    // An endless request is cut before it fills the memory.
    let mut endless = TcpStream::connect(&address).unwrap();
    endless.set_write_timeout(Some(PATIENCE)).unwrap();
    endless.write_all(b"GET / HTTP/1.1\r\n").unwrap();
    let cut = (0..100_000)
        .find(|_| endless.write_all(b"X-Filler: aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa\r\n").is_err());
    assert!(cut.is_some(), "5 MB of headers were accepted");
    assert_eq!(get(&address, "/healthz").status, 200);
}
