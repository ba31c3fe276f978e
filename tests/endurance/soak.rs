//! An hour with fifty times the load of a cabinet: memory, files, threads and database must not grow.
//!
//! A cabinet has 20 machines that throw 200 times a day each; fifty times this load is 2.3 throws per second. Links are
//! sometimes cut, parts wear, the logger restarts after half the time, and retention has small limits.
//! `POINTSD_SOAK_SECONDS` sets the length; the folder `POINTSD_SOAK_OUT` gets the samples as `soak.csv` and `soak.svg`.
//!
//! Growth is judged after ten minutes. A long run starts with many long cuts. After each cut the whole backlog of the
//! loggers arrives, so that queues and buffers reach their largest size in these ten minutes. The allocated memory, as
//! the allocator reports it, shows a leak earlier than the resident memory. Its growth is judged as a share of the
//! resident memory, and only after the monitors have all throws that they keep: until then it grows without a leak.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::PathBuf,
    process::Stdio,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
    time::{Duration, Instant},
};

use pointsd::report::{Panel, Sheet};
use zenoh::Session;

use crate::{
    cable::Cable,
    gauge::{Heap, Usage, file_mib, status},
    rig::{Daemon, PATIENCE, Program, Rig, pointsim, send_signal, size},
    shim,
};

const MACHINES: u32 = 20;
const THROWS_A_DAY: f64 = 200.0;
/// Load of the test as a multiple of the load of a cabinet.
const TIMES: f64 = 50.0;
/// Throws a second: 2.3.
const RATE: f64 = MACHINES as f64 * THROWS_A_DAY * TIMES / 86_400.0;
/// Retention limit for throws and traces, reached within the first ten minutes.
const KEPT: u32 = 1_000;
/// Throws of each machine in the backlog, which is full after seven minutes.
const BACKLOG: u32 = 50;
/// Time in which backlogs, allocator and database reach their full size in a long run \[s\].
const WARM_UP_S: f64 = 600.0;
/// Period and length of the eight cuts in this time.
const WARM_UP_CUT: (Duration, Duration) = (Duration::from_secs(75), Duration::from_secs(25));
/// Most throws that a monitor keeps: a baseline and the longest window of each direction.
const KEPT_BY_MONITOR: u32 = 2 * (50 + 24);
/// Allowed growth per hour after this time \[%\].
const FLAT_PCT: f64 = 5.0;

#[derive(Debug, Clone)]
struct Sample {
    at_s: f64,
    usage: Usage,
    /// `None` without a C compiler for `heap.c`.
    heap: Option<Heap>,
    database_mib: f64,
    log_mib: f64,
    /// Received messages that are not stored yet.
    waiting: u64,
    /// Stored throws that are not judged yet.
    unjudged: u64,
    stored: u64,
    judged: u64,
    alarm_events: u64,
    link: bool,
}

const HEADER: &str = "at_s,rss_mib,own_mib,live_mib,free_mib,files,threads,database_mib,log_mib,waiting,unjudged,\
                      stored,judged,alarm_events,link_up\n";

impl Sample {
    fn line(&self) -> String {
        let Self { at_s, usage, heap: _, database_mib, log_mib, waiting, unjudged, stored, judged, alarm_events, link } =
            self;
        let Usage { rss_mib, own_mib, files, threads } = usage;
        let (live_mib, free_mib) = (self.live_mib(), self.kept_mib());
        let link = u8::from(*link);
        format!(
            "{at_s:.1},{rss_mib:.2},{own_mib:.2},{live_mib:.3},{free_mib:.3},{files},{threads},{database_mib:.3},\
             {log_mib:.3},{waiting},{unjudged},{stored},{judged},{alarm_events},{link}\n"
        )
    }

    /// Allocated memory; NaN without a report.
    fn live_mib(&self) -> f64 {
        self.heap.map_or(f64::NAN, |heap| heap.live_mib)
    }

    /// Memory that the allocator keeps for later; NaN without a report.
    fn kept_mib(&self) -> f64 {
        self.heap.map_or(f64::NAN, |heap| heap.free_mib)
    }
}

/// Times of the events of a run, from its length.
struct Plan {
    length: Duration,
    sample: Duration,
    cut: Duration,
}

impl Plan {
    fn of(seconds: usize) -> Self {
        let length = Duration::from_secs(seconds as u64);
        let share = |part: u32, least: u64, most: u64| {
            (length / part).clamp(Duration::from_secs(least), Duration::from_secs(most))
        };
        Self { length, sample: share(720, 1, 5), cut: share(12, 6, 300) }
    }

    /// Whether growth is judged at the end.
    fn is_long(&self) -> bool {
        self.length.as_secs_f64() > 2.0 * WARM_UP_S
    }

    /// In a run of an hour the periods have a cut of 5 s or 25 s in turn. Zenoh closes a link after the longer one.
    fn link_is_up(&self, at: Duration) -> bool {
        if self.is_long() && at.as_secs_f64() < WARM_UP_S {
            let (period, down) = (WARM_UP_CUT.0.as_millis(), WARM_UP_CUT.1.as_millis());
            return at.as_millis() % period + down < period;
        }
        let period = at.as_millis() / self.cut.as_millis();
        let part = at.as_secs_f64() / self.cut.as_secs_f64() - period as f64;
        let down = if period.is_multiple_of(2) { 1.0 / 60.0 } else { 1.0 / 12.0 };
        !(0.5..0.5 + down).contains(&part) || at + self.cut > self.length
    }
}

/// A running `pointsim run`.
struct Logger(Program);

impl Logger {
    fn start(rig: &Rig, endpoint: &str) -> Self {
        let config = rig.folder().join("pointsim.toml");
        fs::write(&config, format!("[logger]\nbacklog_throws = {BACKLOG}\n")).unwrap();
        let machines = MACHINES.to_string();
        let scale = (86_400.0 / THROWS_A_DAY).recip() * 600.0 * TIMES;
        let child = pointsim(&["run", "--machines", &machines, "--connect", endpoint, "--time-scale"])
            .arg(scale.to_string())
            .arg("--config")
            .arg(config)
            .args(["--fault", "1:kt:-20:60", "--fault", "2:friction:60:60:100", "--fault", "3:stiffness:25:90"])
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self(Program(child))
    }

    /// Stops it; returns the number of published throws.
    fn stop(mut self) -> u64 {
        let Self(Program(child)) = &mut self;
        send_signal("-TERM", child.id());
        let lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let last = lines.filter(|line| line.contains("stopped")).last().expect("a line about its stop");
        let (_, published) = last.split_once("published=").expect("the number of published throws");
        assert!(child.wait().unwrap().success());
        published.trim().parse().unwrap()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_grows_at_fifty_times_a_cabinets_load() {
    let plan = Plan::of(size("POINTSD_SOAK_SECONDS", 15));
    let mut rig = Rig::new().store(&format!("max_throws = {KEPT}\nmax_traces = {}\nballast_mib = 1\n", KEPT / 4));
    for (variable, value) in unit_environment() {
        rig.set(variable, value);
    }
    if let Some(library) = shim::built("tests/endurance/heap.c") {
        rig.set("LD_PRELOAD", library);
        rig.set("HEAP_FILE", heap_file(&rig));
    }
    let daemon = rig.start();
    let session = daemon.client().await;
    let received = Arc::new(AtomicU64::new(0));
    let counting = Arc::clone(&received);
    let alarms = session.declare_subscriber("points/v1/**/alarm").callback(move |_| {
        counting.fetch_add(1, Relaxed);
    });
    let alarms = alarms.await.unwrap();
    let cable = Cable::to(&daemon.endpoint).await;
    let mut recording = Recording::create();
    let mut logger = Logger::start(&rig, &cable.endpoint);
    let (start, mut published, mut restarted) = (Instant::now(), 0, false);
    let mut pace = tokio::time::interval(plan.sample);
    while start.elapsed() < plan.length {
        pace.tick().await;
        let at = start.elapsed();
        let link = plan.link_is_up(at);
        if link {
            cable.mend();
        } else {
            cable.cut();
        }
        if !restarted && at > plan.length / 2 && link {
            published += logger.stop();
            logger = Logger::start(&rig, &cable.endpoint);
            restarted = true;
        }
        if let Some(sample) = sample(&rig, &daemon, &session, at, link).await {
            recording.add(sample);
        }
    }
    published += logger.stop();
    // A throw after a missing one is judged after a minute: the daemon waits for the backlog of the stopped logger.
    let all_stored = async { while status(&session).await.is_none_or(|status| status.judged < published) {} };
    let in_time = tokio::time::timeout(2 * PATIENCE, all_stored).await;
    let end = status(&session).await.unwrap();
    let missing = rig.number("SELECT coalesce(sum(missing_throws), 0) FROM data_gaps");
    drop(alarms);
    daemon.terminate();
    recording.draw();
    println!("{published} throws published; {} alarm events received; at the end {end:?}", received.load(Relaxed));
    assert!(in_time.is_ok(), "{published} published, {} stored and judged, {missing} missing", end.judged);
    assert_eq!((end.stored, end.judged, end.dropped, end.lost, end.quarantined), (published, published, 0, 0, 0));
    assert!(received.load(Relaxed) >= end.alarm_events, "alarm events were not received");
    let expected = RATE * plan.length.as_secs_f64();
    assert!(published as f64 > 0.8 * expected, "{published} of {expected:.0} throws: the load was too small");
    recording.judge();
}

/// Environment variables of the systemd unit.
fn unit_environment() -> impl Iterator<Item = (&'static str, &'static str)> {
    let unit = include_str!("../../deploy/systemd/pointsd.service");
    let set = unit.lines().filter_map(|line| line.strip_prefix("Environment="));
    set.map(|set| set.split_once('=').expect("NAME=value"))
}

/// File with the report of the daemon's allocator.
fn heap_file(rig: &Rig) -> PathBuf {
    rig.folder().join("heap")
}

async fn sample(rig: &Rig, daemon: &Daemon, session: &Session, at: Duration, link: bool) -> Option<Sample> {
    let report = status(session).await?;
    let handled = report.stored + report.duplicates + report.quarantined + report.lost + report.dropped;
    Some(Sample {
        at_s: at.as_secs_f64(),
        usage: Usage::of(daemon.id()),
        heap: Heap::read(&heap_file(rig)),
        database_mib: file_mib(&rig.database(), ""),
        log_mib: file_mib(&rig.database(), "-wal"),
        waiting: report.received.saturating_sub(handled),
        unjudged: report.stored.saturating_sub(report.judged),
        stored: report.stored,
        judged: report.judged,
        alarm_events: report.alarm_events,
        link,
    })
}

/// A quantity of a sample.
type Figure = fn(&Sample) -> f64;

/// The samples, in memory and in a file.
struct Recording {
    folder: PathBuf,
    file: fs::File,
    samples: Vec<Sample>,
}

impl Recording {
    fn create() -> Self {
        let folder = std::env::var_os("POINTSD_SOAK_OUT").map_or(env!("CARGO_TARGET_TMPDIR").into(), PathBuf::from);
        fs::create_dir_all(&folder).unwrap();
        let mut file = fs::File::create(folder.join("soak.csv")).unwrap();
        file.write_all(HEADER.as_bytes()).unwrap();
        Self { folder, file, samples: Vec::new() }
    }

    fn add(&mut self, sample: Sample) {
        self.file.write_all(sample.line().as_bytes()).unwrap();
        self.samples.push(sample);
    }

    fn curve(&self, of: impl Fn(&Sample) -> f64) -> Vec<(f64, f64)> {
        let points = self.samples.iter().map(|sample| (sample.at_s / 60.0, of(sample)));
        points.filter(|(_, value)| value.is_finite()).collect()
    }

    fn draw(&self) {
        let panel = |title: &str, y: &str| Panel::curves(title, "time [min]", y);
        let rate = self.samples.windows(13).map(|run| {
            let (first, last) = (&run[0], &run[run.len() - 1]);
            (last.at_s / 60.0, (last.judged - first.judged) as f64 / (last.at_s - first.at_s))
        });
        let svg = Sheet::new(format!("pointsd at {RATE:.1} throws/s, {TIMES:.0} times a cabinet's load"))
            .columns(2)
            .panel(
                panel("Memory", "MiB")
                    .line("resident", self.curve(|sample| sample.usage.rss_mib))
                    .line("of this its own", self.curve(|sample| sample.usage.own_mib))
                    .line("allocated", self.curve(Sample::live_mib))
                    .line("free, kept by the allocator", self.curve(Sample::kept_mib))
                    .level(0.0, ""),
            )
            .panel(
                panel("Open files and threads", "number")
                    .line("files", self.curve(|sample| sample.usage.files as f64))
                    .line("threads", self.curve(|sample| f64::from(sample.usage.threads)))
                    .level(0.0, ""),
            )
            .panel(
                panel("Database", "MiB")
                    .line("database", self.curve(|sample| sample.database_mib))
                    .line("write-ahead log", self.curve(|sample| sample.log_mib))
                    .level(0.0, ""),
            )
            .panel(
                panel("Waiting throws, and the link", "throws")
                    .line("to be stored", self.curve(|sample| sample.waiting as f64))
                    .line("to be judged", self.curve(|sample| sample.unjudged as f64))
                    .line("link down", self.curve(|sample| f64::from(u8::from(!sample.link)))),
            )
            .panel(panel("Throws judged, over twelve samples", "1/s").line("judged", rate).level(RATE, "published"))
            .panel(panel("Alarm events", "number").line("so far", self.curve(|sample| sample.alarm_events as f64)))
            .to_svg();
        let path = self.folder.join("soak.svg");
        fs::write(&path, svg).unwrap();
        println!("{} samples: {}", self.samples.len(), path.display());
    }

    /// Growth of a quantity per hour by least squares, as a share of the mean of another quantity, `whole` \[%\].
    fn growth_pct(samples: &[Sample], of: Figure, whole: Figure) -> f64 {
        let count = samples.len() as f64;
        let mean = |value: &dyn Fn(&Sample) -> f64| samples.iter().map(value).sum::<f64>() / count;
        let (at, level) = (mean(&|sample| sample.at_s), mean(&of));
        let covariance: f64 = samples.iter().map(|sample| (sample.at_s - at) * (of(sample) - level)).sum();
        let variance: f64 = samples.iter().map(|sample| (sample.at_s - at).powi(2)).sum();
        100.0 * 3600.0 * covariance / variance / mean(&whole)
    }

    fn judge(&self) {
        let since = |from_s: f64| -> Vec<Sample> {
            self.samples.iter().filter(|sample| sample.at_s > from_s).cloned().collect()
        };
        let settled = since(WARM_UP_S);
        let monitors_full_s = f64::from(KEPT_BY_MONITOR * MACHINES) / RATE;
        let full = since(monitors_full_s);
        if settled.last().is_none_or(|last| last.at_s < 2.0 * monitors_full_s) {
            println!("too short to judge growth: use POINTSD_SOAK_SECONDS=3600");
            return;
        }
        let resident: Figure = |sample| sample.usage.rss_mib;
        let own: Figure = |sample| sample.usage.own_mib;
        let files: Figure = |sample| sample.usage.files as f64;
        let threads: Figure = |sample| f64::from(sample.usage.threads);
        let database: Figure = |sample| sample.database_mib;
        let figures: [(&str, &[Sample], Figure, Figure); 6] = [
            ("resident memory [MiB]", &settled, resident, resident),
            ("its own of this [MiB]", &settled, own, own),
            ("allocated memory [MiB]", &full, Sample::live_mib, resident),
            ("open files", &settled, files, files),
            ("threads", &settled, threads, threads),
            ("database [MiB]", &settled, database, database),
        ];
        let mut grows = Vec::new();
        for (name, samples, of, whole) in figures {
            let growth = Self::growth_pct(samples, of, whole);
            let (low, high) =
                samples.iter().map(of).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
            let from = samples[0].at_s;
            println!("{name}: {low:.1} to {high:.1} after the first {from:.0} s, {growth:+.2} % of the whole an hour");
            if growth > FLAT_PCT {
                grows.push(name);
            }
        }
        let most = |of: Figure| settled.iter().map(of).fold(0.0, f64::max);
        println!(
            "at most {} throws waited; the write-ahead log had at most {:.1} MiB; the allocator kept at most {:.1} MiB free",
            most(|sample| (sample.waiting + sample.unjudged) as f64),
            most(|sample| sample.log_mib),
            most(Sample::kept_mib)
        );
        assert!(grows.is_empty(), "{grows:?} grow by more than {FLAT_PCT} % an hour");
    }
}
