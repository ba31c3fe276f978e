//! The real programs in a folder of their own, on ports that the system gives.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::PathBuf,
    process::{Child, Command, ExitStatus, Stdio},
    sync::{Arc, Mutex, mpsc},
    thread,
    time::{Duration, Instant},
};

use pointsd::{
    bus,
    daemon::config::{Document, client_session},
    simulate::{Fleet, FleetSettings},
    store::{HealthRow, Reader, Selector},
    throw::{Throw, ThrowRef, Trace},
};
use zenoh::{Session, bytes::Encoding, qos::CongestionControl};

/// Longest wait for anything: far beyond what a loaded machine takes.
pub(crate) const PATIENCE: Duration = Duration::from_mins(1);

/// A folder with a configuration and a database.
pub(crate) struct Rig {
    folder: tempfile::TempDir,
    extra: String,
}

/// A running `pointsd run`.
pub(crate) struct Daemon {
    child: Child,
    /// Where it listens.
    pub(crate) endpoint: String,
    log: Arc<Mutex<Vec<String>>>,
}

impl Rig {
    pub(crate) fn new() -> Self {
        Self::with("")
    }

    /// A rig with more lines of configuration.
    pub(crate) fn with(extra: &str) -> Self {
        Self { folder: tempfile::tempdir().unwrap(), extra: extra.to_owned() }
    }

    pub(crate) fn database(&self) -> PathBuf {
        self.folder.path().join("points.db")
    }

    fn config(&self) -> PathBuf {
        let path = self.folder.path().join("pointsd.toml");
        let text = format!(
            "{}\n[store]\npath = {:?}\nballast_mib = 0\n[zenoh]\nlisten.endpoints = [\"tcp/127.0.0.1:0\"]\n",
            self.extra,
            self.database().display().to_string()
        );
        fs::write(&path, text).unwrap();
        path
    }

    /// Starts the daemon and waits until it is ready.
    pub(crate) fn start(&self) -> Daemon {
        let mut child = pointsd(&["run", "--config"]).arg(self.config()).stderr(Stdio::piped()).spawn().unwrap();
        let log = Arc::new(Mutex::new(Vec::new()));
        let (ready, endpoint) = mpsc::channel();
        let lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let kept = Arc::clone(&log);
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                if let Some(at) = line.find("tcp/127.0.0.1:").filter(|_| line.contains(" ready ")) {
                    let endpoint: String = line[at..].chars().take_while(|c| *c != '"').collect();
                    let _ = ready.send(endpoint);
                }
                kept.lock().unwrap().push(line);
            }
        });
        let endpoint = endpoint.recv_timeout(PATIENCE);
        let endpoint = endpoint.unwrap_or_else(|_| panic!("the daemon is not ready: {:?}", log.lock().unwrap()));
        Daemon { child, endpoint, log }
    }

    /// Every row of the health history, in the order of arrival.
    pub(crate) async fn history(&self) -> Vec<HealthRow> {
        let reader = Reader::open(&self.database()).await.unwrap();
        reader.health_history(&Selector::default(), jiff::Timestamp::UNIX_EPOCH, 1_000_000).await.unwrap()
    }

    /// Waits until so many throws are judged.
    pub(crate) async fn judged(&self, count: usize) -> Vec<HealthRow> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let history = self.history().await;
            if history.len() >= count {
                return history;
            }
            assert!(Instant::now() < deadline, "{} of {count} throws are judged: {history:?}", history.len());
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Runs `pointsd sql` and returns the rows.
    pub(crate) fn sql(&self, question: &str) -> Vec<serde_json::Value> {
        let output = pointsd(&["sql", "--json", question, "--database"]).arg(self.database()).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }
}

impl Daemon {
    /// SIGTERM, and the exit code within the limit that systemd's unit promises.
    pub(crate) fn terminate(mut self) -> ExitStatus {
        self.signal("-TERM");
        self.wait(Duration::from_secs(10))
    }

    /// SIGKILL.
    pub(crate) fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    pub(crate) fn signal(&self, signal: &str) {
        assert!(Command::new("kill").args([signal, &self.child.id().to_string()]).status().unwrap().success());
    }

    pub(crate) fn log(&self) -> Vec<String> {
        self.log.lock().unwrap().clone()
    }

    fn wait(&mut self, limit: Duration) -> ExitStatus {
        let deadline = Instant::now() + limit;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < deadline, "still running after {limit:?}: {:?}", self.log());
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// A client of this daemon.
    pub(crate) async fn client(&self) -> Session {
        let text = format!("zenoh.connect.endpoints = [{:?}]", self.endpoint);
        let document = Document::parse("test".as_ref(), text).unwrap();
        bus::open(client_session(&document).unwrap()).await.unwrap()
    }

    /// Runs an operator's command; returns its exit code and what it printed.
    pub(crate) fn operate(&self, arguments: &[&str]) -> (Option<i32>, String) {
        let output = pointsd(arguments).args(["--connect", &self.endpoint]).output().unwrap();
        let text = [output.stdout, output.stderr].concat();
        (output.status.code(), String::from_utf8(text).unwrap())
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        // A test that failed must not leave it behind.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub(crate) fn pointsd(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pointsd"));
    command.args(arguments).env_remove("NOTIFY_SOCKET").env_remove("WATCHDOG_USEC");
    command
}

pub(crate) fn pointsim(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pointsim"));
    command.args(arguments);
    command
}

/// Real throws of one simulated machine.
pub(crate) fn throws(boot_id: &str, count: u64) -> Vec<Throw> {
    let settings = FleetSettings { machines: 1, ..FleetSettings::default() };
    let mut machine = Fleet::new(&settings, 5).unwrap().into_machines().remove(0);
    let first: jiff::Timestamp = "2026-05-04T10:00:00Z".parse().unwrap();
    (1..=count)
        .map(|throw_no| {
            let simulated = machine.next_throw().unwrap();
            Throw {
                id: ThrowRef { boot_id: boot_id.to_owned(), throw_no },
                started_at: first + jiff::SignedDuration::from_mins(10 * throw_no.cast_signed()),
                direction: Some(simulated.direction),
                trace: simulated.trace,
                temperature_c: Some(simulated.temperature_c),
                supply_v: None,
                anti_alias_hz: simulated.anti_alias_hz,
            }
        })
        .collect()
}

/// A throw that cannot be evaluated, and costs nothing.
pub(crate) fn stub(boot_id: &str, throw_no: u64) -> Throw {
    Throw {
        id: ThrowRef { boot_id: boot_id.to_owned(), throw_no },
        started_at: "2026-05-04T10:00:00Z".parse().unwrap(),
        direction: None,
        trace: Trace::new(100.0, vec![0.0; 20], vec![0.0; 20]).unwrap(),
        temperature_c: None,
        supply_v: None,
        anti_alias_hz: None,
    }
}

/// Puts a payload on a key.
pub(crate) async fn put(session: &Session, key: &str, encoding: Encoding, payload: Vec<u8>) {
    session.put(key, payload).encoding(encoding).congestion_control(CongestionControl::Block).await.unwrap();
}

/// A publisher whose subscriber is there.
pub(crate) async fn matched(session: &Session, key: &'static str) -> zenoh::pubsub::Publisher<'static> {
    let publisher = session
        .declare_publisher(key)
        .encoding(Encoding::APPLICATION_CBOR)
        .congestion_control(CongestionControl::Block)
        .await
        .unwrap();
    let listener = publisher.matching_listener().await.unwrap();
    while !publisher.matching_status().await.unwrap().matching() {
        tokio::time::timeout(PATIENCE, listener.recv_async()).await.unwrap().unwrap();
    }
    drop(listener);
    publisher
}
