//! The shipped configurations with changed addresses and folders only: a cabinet, its clients, a central router.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use tempfile::TempDir;
use zenoh::{Config, Session, Wait, handlers::FifoChannelHandler, query::Reply, sample::Sample};

use super::rig;

/// Time limit for an expected event on a busy computer.
pub(crate) const PATIENCE: Duration = Duration::from_secs(20);
/// How long a test waits for an event that must not happen, after it happened for another client.
pub(crate) const SILENCE: Duration = Duration::from_millis(500);

pub(crate) const THROW_A: &str = "points/v1/north/21A/throw";
pub(crate) const THROW_B: &str = "points/v1/north/21B/throw";

pub(crate) fn deploy(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy").join(file)
}

pub(crate) fn read(file: &str) -> String {
    fs::read_to_string(deploy(file)).unwrap_or_else(|error| panic!("deploy/{file}: {error}"))
}

/// The text with `from` replaced; fails if the shipped file does not contain it.
pub(crate) fn replaced(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "the shipped file does not contain {from:?}");
    text.replace(from, to)
}

/// A certificate authority and the certificates of its devices, made by the shipped script.
pub(crate) struct Authority(TempDir);

impl Authority {
    fn new(names: &[&str]) -> Self {
        let authority = Self(tempfile::tempdir().unwrap());
        Self::certify(authority.0.path(), names, "30");
        authority
    }

    fn certify(folder: &Path, names: &[&str], days: &str) {
        let script = deploy("make-test-certificates");
        rig::ends(0, Command::new(script).arg(folder).args(names).env("DAYS", days));
    }

    /// Folder with a certificate that expires a second after it was made.
    pub(crate) fn expiring(&self, name: &str) -> PathBuf {
        let folder = self.0.path().join("expiring");
        fs::create_dir_all(&folder).unwrap();
        for file in ["ca.pem", "ca-key.pem"] {
            fs::copy(self.0.path().join(file), folder.join(file)).unwrap();
        }
        Self::certify(&folder, &[name], "0");
        folder.join(name)
    }

    pub(crate) fn folder(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

/// The authority of the railway. The access rules do not contain its client `guest`.
pub(crate) fn railway() -> &'static Authority {
    static AUTHORITY: OnceLock<Authority> = OnceLock::new();
    AUTHORITY.get_or_init(|| {
        Authority::new(&[
            "cabinet.north",
            "router",
            "logger.north.21A",
            "logger.north.21B",
            "viewer",
            "operator",
            "guest",
        ])
    })
}

/// A foreign authority with a certificate for the name of a logger.
pub(crate) fn stranger() -> &'static Authority {
    static AUTHORITY: OnceLock<Authority> = OnceLock::new();
    AUTHORITY.get_or_init(|| Authority::new(&["logger.north.21A", "cabinet.north"]))
}

/// `cabinet.toml` with a free port, connected to `router` if given.
pub(crate) fn cabinet_toml(listen: &str, router: Option<&str>) -> String {
    let folder = railway().folder("cabinet.north");
    let text = read("zenoh/cabinet.toml");
    let text = replaced(&text, "/run/credentials/pointsd.service/tls_", &format!("{}/", folder.display()));
    let text = replaced(&text, "tls/[::]:7447", listen);
    match router {
        Some(router) => replaced(&text, "tls/router.example:7447", router),
        None => replaced(&text, "[\"tls/router.example:7447\"]", "[]"),
    }
}

pub(crate) fn zenoh_table(text: &str) -> Config {
    let table: toml::Table = toml::from_str(text).unwrap();
    table["zenoh"].clone().try_into().unwrap()
}

/// The zenoh session of the cabinet without the daemon; each message to it would reach the daemon. `None`, with a
/// message, without openssl.
pub(crate) async fn cabinet() -> Option<(Session, String)> {
    if !rig::has("openssl") {
        return None;
    }
    Some(open_and_locate(zenoh_table(&cabinet_toml("tls/127.0.0.1:0", None))).await)
}

pub(crate) async fn open_and_locate(config: Config) -> (Session, String) {
    let session = zenoh::open(config).await.unwrap();
    let locator = session.info().locators().await.first().expect("it listens").to_string();
    (session, locator)
}

/// `client.json5` with the certificate in `folder`.
pub(crate) fn client_config(folder: &Path, endpoint: &str) -> Config {
    let text = replaced(&read("zenoh/client.json5"), "/etc/pointsd/client/", &format!("{}/", folder.display()));
    Config::from_json5(&replaced(&text, "tls/cabinet.example:7447", endpoint)).unwrap()
}

/// A client with a certificate of the railway, connected to `endpoint`.
pub(crate) async fn client(name: &str, endpoint: &str) -> Session {
    tokio::time::timeout(PATIENCE, zenoh::open(client_config(&railway().folder(name), endpoint)))
        .await
        .expect("a certificate of the authority opens a link")
        .unwrap()
}

/// Whether a session with this configuration gets a link at the first attempt.
pub(crate) async fn gets_a_link(mut config: Config) -> bool {
    config.insert_json5("connect/timeout_ms", "0").unwrap();
    config.insert_json5("connect/exit_on_failure", "true").unwrap();
    zenoh::open(config).await.is_ok()
}

pub(crate) type Subscriber = zenoh::pubsub::Subscriber<FifoChannelHandler<Sample>>;

/// A subscriber to all throws with the settings of the daemon.
pub(crate) async fn throw_subscriber(session: &Session) -> Subscriber {
    session.declare_subscriber("points/v1/*/*/throw").await.unwrap()
}

/// Polls until `happens` is true; for states of which no message informs.
pub(crate) async fn until(what: &str, mut happens: impl AsyncFnMut() -> bool) {
    rig::until(PATIENCE, async || if happens().await { Ok(()) } else { Err(what) }).await;
}

/// The next sample: its key and payload.
pub(crate) async fn next(subscriber: &Subscriber) -> (String, Vec<u8>) {
    let sample = tokio::time::timeout(PATIENCE, subscriber.recv_async()).await.expect("a sample arrives").unwrap();
    (sample.key_expr().to_string(), sample.payload().to_bytes().into_owned())
}

/// The keys of all replies to a query; none if the rules reject the query, which then ends at its time limit.
pub(crate) async fn ask(session: &Session, selector: &str, payload: Option<&str>) -> Vec<String> {
    let get = session.get(selector).timeout(Duration::from_secs(1));
    let replies = match payload {
        Some(payload) => get.payload(payload).await,
        None => get.await,
    };
    keys(replies.unwrap()).await
}

/// The liveliness tokens visible to this session.
pub(crate) async fn alive(session: &Session, key: &str) -> Vec<String> {
    keys(session.liveliness().get(key).timeout(Duration::from_secs(1)).await.unwrap()).await
}

/// The keys of the replies that are no errors.
async fn keys(replies: FifoChannelHandler<Reply>) -> Vec<String> {
    let mut keys = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result() {
            keys.push(sample.key_expr().to_string());
        }
    }
    keys
}

/// Answers queries on `key` with a reply on `reply_key`, and counts the queries.
pub(crate) async fn answer(session: &Session, key: &'static str, reply_key: &'static str) -> Arc<AtomicUsize> {
    let count = Arc::<AtomicUsize>::default();
    let counter = Arc::clone(&count);
    session
        .declare_queryable(key)
        .callback(move |query| {
            counter.fetch_add(1, Ordering::SeqCst);
            let _ = query.reply(reply_key, "{}").wait();
        })
        .background()
        .await
        .unwrap();
    count
}
