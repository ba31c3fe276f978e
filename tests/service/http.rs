//! Requests to the dashboard of a daemon.

use std::{
    io::{Read, Write},
    net::TcpStream,
};

use crate::rig::{Daemon, PATIENCE, Rig, stub, throws, until};

pub(crate) const KEY: &str = "points/v1/north/21B/throw";
/// Liveliness token of the logger that publishes on [`KEY`].
pub(crate) const ALIVE: &str = "points/v1/north/21B/alive";
pub(crate) const WEB: &str = "[web]\nlisten = \"127.0.0.1:0\"\n";
/// A boot id that a browser would run as a script if it were not escaped.
pub(crate) const HOSTILE: &str = "<script>alert(1)</script>\"'&";

/// A response.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: String,
}

impl Answer {
    /// Sends a request and parses the response.
    pub(crate) fn to(address: &str, request: &str) -> Self {
        let text = exchange(address, request);
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{request}: {text:?}"));
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        Self { status, head: head.to_owned(), body: body.to_owned() }
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.head.lines().find_map(|line| {
            let (key, value) = line.split_once(':')?;
            key.eq_ignore_ascii_case(name).then(|| value.trim())
        })
    }
}

/// `127.0.0.1:PORT` of the daemon's dashboard.
pub(crate) fn address(daemon: &Daemon) -> String {
    let line = daemon.until_log("the dashboard is at");
    line.split("http://").nth(1).unwrap().trim_end_matches('/').to_owned()
}

/// Sends a request and returns the bytes of the response until the connection ends.
pub(crate) fn exchange(address: &str, request: &str) -> String {
    String::from_utf8(exchange_bytes(address, request.as_bytes())).unwrap()
}

pub(crate) fn exchange_bytes(address: &str, request: &[u8]) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(request).unwrap();
    let mut answer = Vec::new();
    // The response of a cut connection ends early.
    let _ = stream.read_to_end(&mut answer);
    answer
}

pub(crate) fn ask(address: &str, method: &str, path: &str, host: &str) -> Answer {
    Answer::to(address, &format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\n\r\n"))
}

pub(crate) fn get(address: &str, path: &str) -> Answer {
    ask(address, "GET", path, address)
}

/// Waits until a page contains these words.
pub(crate) async fn until_page(address: &str, path: &str, words: &str) {
    until(PATIENCE, async || {
        let page = get(address, path).body;
        if page.contains(words) { Ok(()) } else { Err(page) }
    })
    .await;
}

/// A daemon with throws of one machine: two good ones, and a rejected one with a hostile boot id.
pub(crate) async fn small_history() -> (Rig, Daemon, String) {
    history_in(Rig::with(WEB)).await
}

pub(crate) async fn history_in(rig: Rig) -> (Rig, Daemon, String) {
    let daemon = rig.start();
    let logger = daemon.logger(KEY).await;
    logger.send(throws("boot", 2).iter().chain([&stub(HOSTILE, 1)])).await;
    rig.judged(3).await;
    let address = address(&daemon);
    (rig, daemon, address)
}

/// Checks that all elements are closed, in order.
pub(crate) fn check_nesting(html: &str) {
    const VOID: [&str; 4] = ["meta", "link", "!doctype", "input"];
    let mut open = Vec::new();
    for tag in html.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').unwrap_or_else(|| panic!("a < that begins no element: {tag:.60}"));
        let name = tag.split([' ', '\n', '/']).next().unwrap();
        match tag.strip_prefix('/') {
            Some(closed) => assert_eq!(open.pop(), Some(closed), "in {html}"),
            None if VOID.contains(&name) || tag.ends_with('/') => {}
            None => open.push(name),
        }
    }
    assert!(open.is_empty(), "{open:?} stay open");
}
