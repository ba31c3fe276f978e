//! The webhook with a real HTTP server: down, slow, failing, redirecting, silent; a killed daemon; a flood; TLS.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    process::{Command, Stdio},
    sync::mpsc,
    thread,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use tokio_rustls::rustls::{
    ServerConfig, ServerConnection, StreamOwned,
    crypto::ring,
    pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
};

use crate::{
    http::{self, address, get},
    operators::logger,
    rig::{Daemon, PATIENCE, Program, Rig, ends, free_address, has},
};

/// Reaction of the server to a request.
#[derive(Clone, Copy)]
enum Answer {
    Reply(&'static str),
    /// A reply after [`LATE_BY`].
    Late(&'static str),
    /// The connection stays open without a reply.
    Silence,
}

const ACCEPTED: Answer = Answer::Reply("HTTP/1.1 204 No Content\r\n\r\n");
const FAILED: Answer = Answer::Reply("HTTP/1.1 500 Internal Server Error\r\nContent-Length: 4\r\n\r\noops");
const MOVED: Answer =
    Answer::Reply("HTTP/1.1 307 Temporary Redirect\r\nLocation: /elsewhere\r\nContent-Length: 0\r\n\r\n");
const REFUSED: Answer = Answer::Reply("HTTP/1.1 422 Unprocessable Content\r\nContent-Length: 0\r\n\r\n");
const ACCEPTED_LATE: Answer = Answer::Late("HTTP/1.1 202 Accepted\r\n\r\n");
/// Less than the 10 s for which the daemon waits.
const LATE_BY: Duration = Duration::from_secs(8);

/// A request of the webhook.
#[derive(Debug)]
struct Post {
    head: String,
    body: Value,
}

/// A server that gives a list of answers, and repeats the last one.
struct Server {
    address: SocketAddr,
    posts: mpsc::Receiver<Post>,
}

impl Server {
    fn start(address: &str, answers: &'static [Answer]) -> Self {
        Self::with(address, answers, |stream| Box::new(stream))
    }

    fn with(
        address: &str,
        answers: &'static [Answer],
        accept: impl Fn(TcpStream) -> Box<dyn ReadWrite> + Send + 'static,
    ) -> Self {
        let listener = TcpListener::bind(address).unwrap();
        let address = listener.local_addr().unwrap();
        let (sender, posts) = mpsc::channel();
        thread::spawn(move || {
            let mut silent = Vec::new();
            for (number, stream) in listener.incoming().enumerate() {
                let mut stream = BufReader::new(accept(stream.unwrap()));
                let Some(post) = read(&mut stream) else { continue };
                let mut reply = |text: &str| {
                    let _ = stream.get_mut().write_all(text.as_bytes()).and_then(|()| stream.get_mut().flush());
                };
                match answers[number.min(answers.len() - 1)] {
                    Answer::Reply(text) => reply(text),
                    Answer::Late(text) => {
                        thread::sleep(LATE_BY);
                        reply(text);
                    }
                    Answer::Silence => silent.push(stream),
                }
                if sender.send(post).is_err() {
                    return;
                }
            }
        });
        Self { address, posts }
    }

    fn next(&self) -> Post {
        self.posts.recv_timeout(PATIENCE).unwrap_or_else(|_| panic!("no request of the webhook"))
    }
}

trait ReadWrite: Read + Write + Send {}
impl<Stream: Read + Write + Send> ReadWrite for Stream {}

/// Reads a request; `None` if the connection ends before.
fn read(stream: &mut impl BufRead) -> Option<Post> {
    let (mut head, mut length) = (String::new(), 0);
    loop {
        let start = head.len();
        if stream.read_line(&mut head).ok()? == 0 {
            return None;
        }
        let line = head[start..].to_ascii_lowercase();
        if let Some(value) = line.strip_prefix("content-length: ") {
            length = value.trim().parse().ok()?;
        }
        if line == "\r\n" {
            break;
        }
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).ok()?;
    Some(Post { head, body: serde_json::from_slice(&body).unwrap() })
}

fn rig(url: &str, more: &str) -> Rig {
    Rig::with(&format!("[webhook]\nurl = \"{url}\"\n{more}\n"))
}

/// Raises the alarm that the motor of the first machine is weak.
fn weak_motor(daemon: &Daemon) {
    logger(&daemon.endpoint, &["--machines", "1", "--throws", "50", "--fault", "1:kt:-25:36"]);
}

fn pending(rig: &Rig) -> u64 {
    rig.number("SELECT count(*) FROM notification")
}

#[test]
fn an_alarm_waits_for_its_receiver_and_is_sent_until_it_is_accepted() {
    let address = free_address();
    let rig = rig(&format!("http://{address}/points?to=north"), "authorization = \"Bearer secret\"");
    let daemon = rig.start();
    weak_motor(&daemon);
    daemon.until_log("webhook: sending an alarm failed");
    assert_eq!(daemon.status()["webhook_fails"], true);
    let waiting = pending(&rig);
    assert!(waiting > 0);

    let server = Server::start(&address.to_string(), &[FAILED, MOVED, ACCEPTED]);
    let posts = [server.next(), server.next(), server.next()];
    for post in &posts {
        let head = post.head.to_ascii_lowercase();
        assert!(post.head.starts_with("POST /points?to=north HTTP/1.1\r\n"), "{}", post.head);
        for line in [&format!("host: {address}"), "content-type: application/json", "authorization: bearer secret"] {
            assert!(head.contains(&format!("\r\n{line}\r\n")), "{line}: {head}");
        }
        assert_eq!(post.body, posts[0].body, "the same event until it is accepted");
    }
    let alarm = &posts[0].body;
    let shown = ["schema", "machine", "cause", "event_no"].map(|key| alarm[key].clone());
    assert_eq!(shown, [json!("points.alarm/1"), json!("machine-1"), json!("kt"), json!(1)]);
    assert!(alarm["text"].as_str().unwrap().len() > 20 && alarm.get("by").is_none(), "{alarm}");

    // The other events arrive in order, each once.
    let mut numbers = vec![1];
    while numbers.len() < usize::try_from(waiting).unwrap() {
        numbers.push(server.next().body["event_no"].as_i64().unwrap());
    }
    assert!(numbers.is_sorted_by(|one, next| one < next), "{numbers:?}");
    daemon.says(0, &["ack", "north/machine-1", "kt", "--by", "A. Meyer"]);
    assert_eq!(server.next().body["state"], "active_acknowledged");
    assert!(!daemon.log().iter().any(|line| line.contains("secret")), "the secret is not in the log");
    daemon.terminate();
    assert_eq!(pending(&rig), 0);
}

/// Another program locks the database: as on a full disk, sent events cannot be removed, and the alarm that nothing can be
/// stored cannot be stored itself.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn alarms_are_sent_once_while_the_database_accepts_no_writes() {
    let address = free_address();
    let rig = rig(&format!("http://{address}/"), "");
    let daemon = rig.start();
    weak_motor(&daemon);
    rig.judged(50).await;
    daemon.says(0, &["ack", "north/machine-1", "kt", "--by", "A. Meyer"]);
    let waiting = pending(&rig);
    assert!(waiting > 1);
    let mut other = rig.locked("BEGIN IMMEDIATE").await;
    let server = Server::start(&address.to_string(), &[ACCEPTED]);
    let numbers: Vec<i64> = (0..waiting).map(|_| server.next().body["event_no"].as_i64().unwrap()).collect();
    assert!(numbers.is_sorted_by(|one, next| one < next), "{numbers:?}");
    let own = server.next().body;
    assert_eq!((&own["cause"], &own["machine"]), (&json!("data_loss"), &json!("pointsd")), "{own}");
    assert_eq!(pending(&rig), waiting);

    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
    rig.until_sql("SELECT 1 FROM active_alarms WHERE cause = 'data_loss'").await;
    rig.until_number("SELECT count(*) FROM notification", 0).await;
    assert!(server.posts.try_recv().is_err(), "each event once");
}

/// Without an answer within 10 s the daemon sends again after a pause of 1 s, then of 2 s. An answer after 8 s counts.
/// The loop of the webhook beats during all this, and without events: its heartbeat may be 30 s old.
#[test]
fn a_receiver_may_be_slow_and_gets_the_request_again_after_ten_seconds() {
    let idle_server = Server::start("127.0.0.1:0", &[ACCEPTED]);
    let idle_rig = rig(&format!("http://{}/", idle_server.address), "");
    let idle = idle_rig.start();
    let began = Instant::now();
    let server = Server::start("127.0.0.1:0", &[Answer::Silence, Answer::Silence, ACCEPTED_LATE, ACCEPTED]);
    let rig = rig(&format!("http://{}/", server.address), "");
    let daemon = rig.start();
    weak_motor(&daemon);
    let first = (server.next().body, Instant::now());
    let second = (server.next().body, Instant::now());
    daemon.until_log("the receiver does not answer within 10 s");
    assert_eq!(daemon.status()["webhook_fails"], true);
    let third = (server.next().body, Instant::now());
    assert_eq!((&second.0, &third.0), (&first.0, &first.0), "the same event until it is accepted");
    let seconds = |from: Instant, to: Instant| to.duration_since(from).as_secs_f64();
    let waits = [seconds(first.1, second.1), seconds(second.1, third.1) - LATE_BY.as_secs_f64()];
    assert!(waits[0] > 10.0 && waits[0] < 16.0 && waits[1] > 11.0 && waits[1] < 18.0, "{waits:?}");
    daemon.says(0, &["ack", "north/machine-1", "kt", "--by", "A. Meyer"]);
    while server.next().body["state"] != "active_acknowledged" {}
    thread::sleep(Duration::from_secs(32).saturating_sub(began.elapsed()));
    assert_eq!((&daemon.status()["silent"], &idle.status()["silent"]), (&json!([]), &json!([])));
    assert_eq!(daemon.status()["webhook_fails"], false);
    daemon.terminate();
    idle.terminate();
}

#[test]
fn a_killed_daemon_sends_unaccepted_alarms_after_its_start() {
    // The receiver does not answer the first request: the daemon cannot know whether the receiver has the alarm.
    let server = Server::start("127.0.0.1:0", &[Answer::Silence, ACCEPTED]);
    let rig = rig(&format!("http://{}/", server.address), "");
    let daemon = rig.start();
    weak_motor(&daemon);
    let first = server.next().body;
    daemon.kill();
    let daemon = rig.start();
    assert_eq!(server.next().body, first);
    daemon.terminate();

    // Without a webhook in the configuration no notification is stored.
    let rig = Rig::with("").in_folder(rig.folder());
    let daemon = rig.start();
    daemon.says(0, &["ack", "north/machine-1", "kt", "--by", "A. Meyer"]);
    assert_eq!(pending(&rig), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn filtered_alarms_are_not_sent_refused_ones_are_counted_and_a_flood_is_summed_up() {
    // The receiver refuses the first message, and the daemon does not send it again. Five of twelve machines have the
    // same alarm; two messages are allowed in a period.
    let server = Server::start("127.0.0.1:0", &[REFUSED, ACCEPTED]);
    let filters = "causes = [\"kt\"]\nmax_messages = 2\nperiod_s = 8.0\n[web]\nlisten = \"127.0.0.1:0\"";
    let rig = rig(&format!("http://{}/", server.address), filters);
    let daemon = rig.start();
    let faults: Vec<String> = (1..=5).map(|machine| format!("{machine}:kt:-25:36")).collect();
    let mut arguments = vec!["--machines", "12", "--throws", "50", "--fault", "12:friction:60:36"];
    for fault in &faults {
        arguments.extend(["--fault", fault]);
    }
    logger(&daemon.endpoint, &arguments);
    let (mut alarms, mut summaries) = (Vec::new(), Vec::new());
    let all = |alarms: &[Value], summaries: &[Value]| {
        alarms.len() as u64 + summaries.iter().map(|it| it["events"].as_u64().unwrap()).sum::<u64>()
    };
    rig.judged(12 * 50).await;
    let events = rig.number("SELECT count(*) FROM alarm_events WHERE cause = 'kt'");
    while all(&alarms, &summaries) < events {
        let body = server.next().body;
        let list = if body["schema"] == "points.alarm/1" { &mut alarms } else { &mut summaries };
        list.push(body);
    }
    assert_eq!(all(&alarms, &summaries), events, "each event once");
    assert!(alarms.iter().all(|alarm| alarm["cause"] == "kt"), "{alarms:?}");
    let summary = &summaries[0];
    assert_eq!(summary["schema"], "points.alarm_summary/1");
    assert!(summary["events"].as_u64().unwrap() > 1 && alarms.len() + summaries.len() <= 8, "{summaries:?}");
    let group = &summary["groups"][0];
    assert_eq!((&group["cause"], &group["site"]), (&json!("kt"), &json!("north")), "{summary}");
    assert!(summary["text"].as_str().unwrap().contains(" motor "), "{summary}");
    assert_eq!(daemon.status()["webhook_refused"], 1);
    let (_, status) = daemon.operate(&["status"]);
    assert!(status.contains("WEBHOOK REFUSED 1 alarm event:"), "{status}");
    let page = get(&address(&daemon), "/").body;
    assert!(page.contains("WEBHOOK REFUSED 1 alarm event:"), "{page}");
    daemon.terminate();
    assert_eq!(pending(&rig), 0);
}

#[test]
fn a_receiver_with_tls_needs_a_certificate_of_the_authority() {
    if !has("openssl") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/make-test-certificates");
    ends(0, Command::new(script).arg(folder.path()).arg("router"));
    let file = |name: &str| folder.path().join("router").join(name);
    let chain = vec![CertificateDer::from_pem_file(file("cert.pem")).unwrap()];
    let key = PrivateKeyDer::from_pem_file(file("key.pem")).unwrap();
    let tls =
        ServerConfig::builder_with_provider(ring::default_provider().into()).with_safe_default_protocol_versions();
    let tls = std::sync::Arc::new(tls.unwrap().with_no_client_auth().with_single_cert(chain, key).unwrap());
    let server = Server::with("127.0.0.1:0", &[ACCEPTED], move |stream| {
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        Box::new(StreamOwned::new(ServerConnection::new(std::sync::Arc::clone(&tls)).unwrap(), stream))
    });
    let url = format!("https://localhost:{}/", server.address.port());

    // No authority in the list of Mozilla signed the certificate.
    let unknown = rig(&url, "");
    let daemon = unknown.start();
    weak_motor(&daemon);
    daemon.until_log("UnknownIssuer");
    daemon.terminate();

    let known = rig(&url, &format!("ca_file = {:?}", file("ca.pem"))).in_folder(unknown.folder());
    let _daemon = known.start();
    assert_eq!(server.next().body["cause"], "kt");
}

/// Takes the connections of a mail client; the receiver gets the text of each mail.
fn mail_server() -> (SocketAddr, mpsc::Receiver<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let (sender, mails) = mpsc::channel();
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = BufReader::new(stream.unwrap());
            let say = |stream: &mut BufReader<TcpStream>, text: &str| stream.get_mut().write_all(text.as_bytes());
            say(&mut stream, "220 test\r\n").unwrap();
            let (mut line, mut mail) = (String::new(), String::new());
            while stream.read_line(&mut line).is_ok_and(|read| read > 0) {
                if line.eq_ignore_ascii_case("DATA\r\n") {
                    say(&mut stream, "354 go on\r\n").unwrap();
                    while !mail.ends_with("\r\n.\r\n") {
                        stream.read_line(&mut mail).unwrap();
                    }
                    sender.send(std::mem::take(&mut mail)).unwrap();
                }
                let is_end = line.eq_ignore_ascii_case("QUIT\r\n");
                let _ = say(&mut stream, if is_end { "221 bye\r\n" } else { "250 well\r\n" });
                if is_end {
                    break;
                }
                line.clear();
            }
        }
    });
    (address, mails)
}

/// The receiver of `deploy/`: an alarm becomes an e-mail.
#[test]
fn an_alarm_becomes_a_mail() {
    if !has("python3") {
        return;
    }
    let (mail, mails) = mail_server();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/webhook-to-mail");
    // An IPv6 address, if this computer has one.
    let host = if TcpListener::bind("[::1]:0").is_ok() { "[::1]" } else { "127.0.0.1" };
    let arguments = [&format!("{host}:0"), &mail.to_string(), "points@example.org", "duty@example.org"];
    let mut receiver = Program(Command::new(script).args(arguments).stdout(Stdio::piped()).spawn().unwrap());
    let mut line = String::new();
    BufReader::new(receiver.0.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let receiver_at = format!("{host}:{}", line.trim().rsplit(' ').next().unwrap());
    let post = |alarm: &str| {
        let length = alarm.len();
        http::Answer::to(&receiver_at, &format!("POST / HTTP/1.0\r\nContent-Length: {length}\r\n\r\n{alarm}")).status
    };
    // A text with a boot_id of a logger, and a text that no e-mail can have.
    assert_eq!(post("{\"severity\": \"warning\", \"text\": \"Machine\u{2028}north/1:\u{85}\\r\\nworn\"}"), 204);
    let text = mails.recv_timeout(PATIENCE).unwrap();
    assert!(text.contains("Subject: [warning] Machine north/1: worn"), "{text}");
    assert_eq!(post("{\"text\": \"\\ud800\"}"), 400);
    let rig = rig(&format!("http://{receiver_at}/"), "");
    let daemon = rig.start();
    weak_motor(&daemon);
    // The alarm may begin as a warning.
    let mail_of = |subject: &str| {
        loop {
            let mail = mails.recv_timeout(PATIENCE).unwrap();
            if mail.contains(&format!("Subject: [{subject}] Machine north/machine-1")) {
                break mail;
            }
        }
    };
    let text = mail_of("critical");
    assert!(text.contains("To: duty@example.org"), "{text}");
    // The id of the mail contains the number and the time of the event.
    assert!(text.contains(".1.20") && text.contains("Z@pointsd>"), "{text}");
    daemon.says(0, &["ack", "north/machine-1", "kt", "--by", "A. Meyer"]);
    mail_of("critical, acknowledged");
}
