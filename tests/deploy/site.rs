//! The shipped configurations with nothing changed but addresses and folders: a cabinet, its clients, a central router.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
    time::Duration,
};

use tempfile::TempDir;
use zenoh::{Config, Session};

/// How long something that must happen may take on a busy machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(20);
/// How long is waited for what must not happen, after the same was seen to happen for someone else.
pub(crate) const SILENCE: Duration = Duration::from_millis(500);

pub(crate) const THROW_A: &str = "points/v1/north/21A/throw";
pub(crate) const THROW_B: &str = "points/v1/north/21B/throw";

pub(crate) fn deploy(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy").join(file)
}

pub(crate) fn read(file: &str) -> String {
    fs::read_to_string(deploy(file)).unwrap_or_else(|error| panic!("deploy/{file}: {error}"))
}

/// A text with a marked part replaced; the shipped file must hold it, or the test would test something else.
pub(crate) fn replaced(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "the shipped file no longer holds {from:?}");
    text.replace(from, to)
}

/// One certificate authority with the certificates of its devices, made by the shipped script.
pub(crate) struct Authority(TempDir);

impl Authority {
    fn new(names: &[&str]) -> Self {
        let authority = Self(tempfile::tempdir().unwrap());
        Self::certify(authority.0.path(), names, "30");
        authority
    }

    fn certify(folder: &Path, names: &[&str], days: &str) {
        let script = deploy("make-test-certificates");
        let output = Command::new(script).arg(folder).args(names).env("DAYS", days).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    /// The folder of a certificate that ends as it begins.
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

/// The railway's authority. `guest` has a certificate of it, and is on no list.
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

/// An authority of somebody else, who took the name of a logger.
pub(crate) fn stranger() -> &'static Authority {
    static AUTHORITY: OnceLock<Authority> = OnceLock::new();
    AUTHORITY.get_or_init(|| Authority::new(&["logger.north.21A", "cabinet.north"]))
}

/// `cabinet.toml`, listening on a port of the system's choice, joined to `router` if there is one.
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

/// The cabinet's zenoh session, without the daemon in it: what reaches it would reach the daemon.
pub(crate) async fn cabinet() -> (Session, String) {
    open_and_locate(zenoh_table(&cabinet_toml("tls/127.0.0.1:0", None))).await
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

/// A client of the railway that is connected to `endpoint`.
pub(crate) async fn client(name: &str, endpoint: &str) -> Session {
    tokio::time::timeout(PATIENCE, zenoh::open(client_config(&railway().folder(name), endpoint)))
        .await
        .expect("a certificate of the authority opens a link")
        .unwrap()
}

/// Whether a session with this configuration gets a link at all, when it tries only once.
pub(crate) async fn gets_a_link(mut config: Config) -> bool {
    config.insert_json5("connect/timeout_ms", "0").unwrap();
    config.insert_json5("connect/exit_on_failure", "true").unwrap();
    zenoh::open(config).await.is_ok()
}

pub(crate) type Publisher = zenoh::pubsub::Publisher<'static>;
pub(crate) type Subscriber = zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<zenoh::sample::Sample>>;

/// A publisher of throws as a logger declares it.
pub(crate) async fn throw_publisher(session: &Session, key: &'static str) -> Publisher {
    session.declare_publisher(key).await.unwrap()
}

/// A subscriber to every throw as the daemon declares it.
pub(crate) async fn throw_subscriber(session: &Session) -> Subscriber {
    session.declare_subscriber("points/v1/*/*/throw").await.unwrap()
}

/// Waits until what this publisher sends has somewhere to go.
pub(crate) async fn until_heard(publisher: &Publisher) {
    tokio::time::timeout(PATIENCE, async {
        let matching = publisher.matching_listener().await.unwrap();
        while !publisher.matching_status().await.unwrap().matching() {
            let _ = matching.recv_async().await;
        }
    })
    .await
    .expect("the cabinet's subscription reaches the logger");
}

/// The next sample: its key and payload.
pub(crate) async fn next(subscriber: &Subscriber) -> (String, Vec<u8>) {
    let sample = tokio::time::timeout(PATIENCE, subscriber.recv_async()).await.expect("a sample arrives").unwrap();
    (sample.key_expr().to_string(), sample.payload().to_bytes().into_owned())
}

/// The keys of all replies to a query; a refused query ends at its time limit with none.
pub(crate) async fn ask(session: &Session, selector: &str, payload: Option<&str>) -> Vec<String> {
    let get = session.get(selector).timeout(Duration::from_secs(1));
    let replies = match payload {
        Some(payload) => get.payload(payload).await,
        None => get.await,
    };
    let replies = replies.unwrap();
    let mut keys = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result() {
            keys.push(sample.key_expr().to_string());
        }
    }
    keys
}

/// The tokens that are alive for this session.
pub(crate) async fn alive(session: &Session, key: &str) -> Vec<String> {
    let replies = session.liveliness().get(key).timeout(Duration::from_secs(1)).await.unwrap();
    let mut keys = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result() {
            keys.push(sample.key_expr().to_string());
        }
    }
    keys
}

/// Answers queries on `key` with one reply on `reply_key`, and counts them.
pub(crate) async fn answer(
    session: &Session,
    key: &'static str,
    reply_key: &'static str,
) -> std::sync::Arc<std::sync::atomic::AtomicUsize> {
    let count = std::sync::Arc::new(std::sync::atomic::AtomicUsize::new(0));
    let counter = count.clone();
    session
        .declare_queryable(key)
        .callback(move |query| {
            use zenoh::Wait;
            counter.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
            let _ = query.reply(reply_key, "{}").wait();
        })
        .background()
        .await
        .unwrap();
    count
}
