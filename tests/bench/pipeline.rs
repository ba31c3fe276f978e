//! The whole pipeline: throws go to the socket of a real daemon, which commits, judges and publishes them. A Python
//! program does the same work for comparison.

use std::{
    fs,
    io::{BufRead as _, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};

use serde_json::Value;

use crate::{fleet::throws, message::floats, table::Row};

/// Throws per second of the load.
const RATE: u32 = 500;
/// Duration of each of the two runs \[s\].
const SECONDS: u32 = 20;

/// A running daemon; the drop of this value kills it.
struct Daemon(Child);

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Daemon {
    /// Processor time until now \[s\].
    fn processor_s(&self) -> f64 {
        let stat = fs::read_to_string(format!("/proc/{}/stat", self.0.id())).expect("Linux");
        let fields: Vec<&str> = stat.rsplit(')').next().expect("the name").split_whitespace().collect();
        let ticks: f64 = [11, 12].map(|at| fields[at].parse::<f64>().expect("ticks")).iter().sum();
        // Linux gives times to programs in hundredths of a second on every architecture.
        ticks / 100.0
    }
}

/// Runs the daemon under load, then the Python program, and prints their rates. Returns the processor times of one
/// throw; `None` without Python, numpy or scipy.
pub(crate) fn compare() -> Option<Row> {
    let folder = tempfile::tempdir().expect("a folder");
    let (time_s, load) = measure_daemon(folder.path());
    println!(
        "\npointsd: {RATE} throws a second for {SECONDS} s, published by a program on the same processor: {} of {} judged, the last \
         {:.2} s after its publication",
        load["judged"],
        load["published"],
        load["behind_s"].as_f64().expect("a number")
    );
    let python = measure_python(folder.path())?;
    let peer_ms = python["processor_ms"].as_f64().expect("a number");
    println!(
        "Python, two processes at full speed: {:.0} throws a second\n",
        python["throws_per_s"].as_f64().expect("a number")
    );
    Some(Row {
        what: "socket to judged row, processor time",
        time_s,
        peer: "numpy, scipy and sqlite3, without a network",
        peer_s: 1e-3 * peer_ms,
    })
}

/// Processor time of the daemon for each throw \[s\], and the report of `pointsim load`.
fn measure_daemon(folder: &Path) -> (f64, Value) {
    let config = folder.join("pointsd.toml");
    let database = folder.join("points.db").display().to_string();
    let text =
        format!("[store]\npath = {database:?}\nballast_mib = 0\n[zenoh]\nlisten.endpoints = [\"tcp/127.0.0.1:0\"]\n");
    fs::write(&config, text).expect("a file");
    let mut daemon = Command::new(env!("CARGO_BIN_EXE_pointsd"))
        .args(["run", "--config"])
        .arg(&config)
        .stderr(Stdio::piped())
        .spawn()
        .expect("the daemon");
    let mut log = BufReader::new(daemon.stderr.take().expect("its log")).lines().map_while(Result::ok);
    let daemon = Daemon(daemon);
    let ready = log.find(|line| line.contains(" ready ")).expect("a daemon that is ready");
    let endpoint = &ready[ready.find("tcp/127.0.0.1:").expect("its address")..];
    let endpoint: String = endpoint.chars().take_while(|c| *c != '"').collect();
    std::thread::spawn(move || log.for_each(drop));
    let before_s = daemon.processor_s();
    let load = Command::new(env!("CARGO_BIN_EXE_pointsim"))
        .args(["load", "--json", "--connect", &endpoint])
        .args(["--rate", &RATE.to_string(), "--seconds", &SECONDS.to_string()])
        .output()
        .expect("the load");
    let report: Value = serde_json::from_slice(&load.stdout).expect("a report");
    ((daemon.processor_s() - before_s) / report["judged"].as_f64().expect("a number"), report)
}

/// The report of `peer.py` on the throws of one machine.
fn measure_python(folder: &Path) -> Option<Value> {
    let throws = throws(16);
    let samples = throws[0].trace.len();
    let traces = throws.iter().flat_map(|throw| [throw.trace.current_a(), throw.trace.position_mm()]).flat_map(floats);
    let file = folder.join("traces.f32");
    fs::write(&file, traces.collect::<Vec<u8>>()).expect("a file");
    let python = Command::new("python3")
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/bench/peer.py"))
        .arg(&file)
        .args([samples.to_string(), SECONDS.to_string()])
        .arg(folder.join("peer.db"))
        .env("OMP_NUM_THREADS", "1")
        .output();
    match python {
        Ok(output) if output.status.success() => {
            let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
            check_estimate(&throws[0], &report);
            Some(report)
        }
        Ok(output) => {
            println!("no comparison with Python: {}", String::from_utf8_lossy(&output.stderr).trim());
            None
        }
        Err(error) => {
            println!("no comparison with Python: {error}");
            None
        }
    }
}

/// Checks that the Python program really identifies: its coefficients of the first throw are within 5 % of ours.
fn check_estimate(throw: &pointsd::throw::Throw, report: &Value) {
    let found = pointsd::estimate::Identifier::default().identify(throw, &pointsd::estimate::Settings::default());
    let ours = found.outcome.expect("a healthy throw").coefficients();
    for (at, ours) in ours.into_iter().enumerate() {
        let theirs = report["first"][at].as_f64().expect("a number");
        assert!((theirs / ours - 1.0).abs() < 0.05, "coefficient {at}: {ours} here, {theirs} in Python");
    }
}
