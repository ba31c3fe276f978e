//! `pointsd import`: runs recorded throws through the whole pipeline into the database.

use std::{
    collections::HashMap,
    ffi::{OsStr, OsString},
    fmt::Display,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, anyhow, bail};
use indicatif::ProgressBar;
use jiff::{SignedDuration, Timestamp};
use serde::Deserialize;
use serde_json::json;

use super::{Exit, Failure, Outcome, ResultExt, argument, output, recording, run::located, runtime, terminal};
use crate::{
    daemon::{
        Offline, clock,
        config::{Config, Monitor},
    },
    store::{Judgement, Spooled},
    throw::{Direction, MachineId, Throw, ThrowRef, counted, utc},
    wire::{self, Encoding, Health},
};

/// Number of folders above an exported trace that are searched for its `throws.csv`: the folder of the machine, of the
/// site, of all traces, and the parent of that.
const EXPORT_FOLDERS: usize = 4;

/// Imports recorded throws: stores, identifies and diagnoses them in the order of the command line. The daemon of this
/// database must not run. Without --machine each throw must name its machine, by the fields `site` and `machine` of its
/// JSON, or by its line in the `throws.csv` of `pointsd export`.
///
/// FILE is CSV with the columns of a recorded trace, one throw in a file. Or FILE is JSON as on zenoh, one throw in a
/// file or one on each line: a file with the extension json, jsonl or ndjson, or - for standard input. A throw that the
/// database has already is skipped. Imported throws are judged as the newest throws of the machine; a warning is
/// printed if they are older than those in the database. A trace of `pointsd export --traces` gets time, direction,
/// boot, number, temperature, supply and filter from its line in `throws.csv`, in the folder of the traces or in its
/// parent. Without this line the throw has the time of the file. With --machine a throw is refused if it names another
/// machine.
///
/// Exit codes: 0 imported; 64 the name of the machine is reserved, or a throw names none and --machine is missing; 65
/// the content of a file is invalid, or of another machine; 66 a file cannot be read; 69 the daemon is running; 74 the
/// database cannot be used; 78 the configuration is invalid. Nothing is imported if a file is missing; files before an
/// invalid one are imported.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd import --machine north/21B --config config/pointsd.toml throws/*.csv")]
pub(super) struct Arguments {
    /// Files with recorded throws.
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    /// The machine that made the throws [default: the machine that each throw names].
    #[arg(long, value_name = "SITE/MACHINE", value_parser = argument::machine)]
    machine: Option<MachineId>,
    /// Configuration file [default: built-in values].
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Time of the throw in the first CSV file: a date, or a time as 2026-05-04T06:00:00Z. Each further file is a
    /// minute later, and nothing is taken from `throws.csv`, so give --machine too [default: the times in `throws.csv`,
    /// else those of the files].
    #[arg(long, value_name = "TIME", value_parser = argument::moment)]
    started_at: Option<Timestamp>,
    /// Print one JSON object for each throw; that of a throw which the database has already has `"known": true`.
    #[arg(long)]
    json: bool,
}

#[derive(Default)]
struct Count {
    new: u64,
    known: u64,
    rejected: u64,
    alarms: u64,
}

/// Throws with their machines.
type Recorded = Vec<(MachineId, Throw)>;

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let config = Config::load(arguments.config.as_deref()).or_exit(Exit::Config)?;
    if let Some(machine) = &arguments.machine
        && let Some(problem) = config.monitor.reserves(machine)
    {
        return Err(Failure::new(Exit::Usage, anyhow!("--machine {machine}: {problem}")));
    }
    let mut recordings = Recordings { arguments, monitor: config.monitor.clone(), exports: Exports::default() };
    // Checked before the database is opened: if a file is missing or the first one is invalid, no database is created.
    let missing = |file: &&PathBuf| file.as_path() != Path::new("-") && fs::metadata(file).is_err();
    if let Some(file) = arguments.files.iter().find(missing) {
        recordings.read(0, file)?;
    }
    let first = recordings.read(0, &arguments.files[0])?;
    runtime::block_on(async {
        let config_file = arguments.config.as_deref();
        let mut pipeline = Offline::open(config).await.map_err(|error| located(error, config_file))?;
        let mut count = Count::default();
        let template = "{wide_bar} {human_pos} of {human_len} files, {msg}";
        let bar = output::progress(arguments.files.len() as u64, template);
        let outcome = import(first, &mut recordings, &mut pipeline, &mut count, &bar).await;
        bar.finish_and_clear();
        let rest = pipeline.judge().await.or_exit(Exit::Io)?;
        let printed = report(arguments, &rest, &mut count);
        pipeline.close().await.or_exit(Exit::Io)?;
        printed?;
        if !arguments.json {
            let Count { new, known, rejected, alarms } = count;
            print(format_args!(
                "{} imported ({rejected} not evaluated), {known} known before, {}",
                counted(new, "throw"),
                counted(alarms, "alarm event")
            ))?;
        }
        outcome
    })
}

/// Imports the files. `first` has the throws of the first file, which is read already.
async fn import(
    first: Recorded,
    recordings: &mut Recordings<'_>,
    pipeline: &mut Offline,
    count: &mut Count,
    bar: &ProgressBar,
) -> Outcome {
    let arguments = recordings.arguments;
    let mut first = Some(first);
    // The start of the last throw of each machine.
    let mut last = HashMap::<MachineId, Option<Timestamp>>::new();
    let mut is_warned = false;
    for (number, file) in arguments.files.iter().enumerate() {
        let throws = first.take().map_or_else(|| recordings.read(number, file), Ok)?;
        for (machine, throw) in throws {
            bar.set_message(counted(count.new, "throw"));
            // A copied CSV file may have another time, and the store would take it for another throw with the same
            // number.
            if !is_json(file) && pipeline.has(&machine, &throw.id).await.or_exit(Exit::Io)? {
                bar.suspend(|| report_known(arguments, &machine, &throw.id, count))?;
                continue;
            }
            if !last.contains_key(&machine) {
                let start = pipeline.last_start(&machine).await.or_exit(Exit::Io)?;
                last.insert(machine.clone(), start);
            }
            let (spooled, judged) = pipeline.take(&machine, &throw, clock::now()).await.or_exit(Exit::Io)?;
            match spooled {
                Spooled::New(_) => {
                    count.new += 1;
                    match last.get(&machine).copied().flatten() {
                        Some(before) if throw.started_at < before => {
                            if !std::mem::replace(&mut is_warned, true) {
                                bar.suspend(|| warn_about_order(&machine, throw.started_at, before, file));
                            }
                        }
                        _ => drop(last.insert(machine, Some(throw.started_at))),
                    }
                }
                Spooled::Duplicate => bar.suspend(|| report_known(arguments, &machine, &throw.id, count))?,
            }
            bar.suspend(|| report(arguments, &judged, count))?;
        }
        bar.inc(1);
    }
    Ok(Exit::Ok)
}

/// Warns that a throw is older than an earlier one in the database: throws are judged in the order of the import.
fn warn_about_order(machine: &MachineId, started_at: Timestamp, last: Timestamp, file: &Path) {
    terminal::complain(format_args!(
        "warning: {}: this throw is of {}, before the last one of {machine} in the database, of {}. Imported throws are \
         judged as the newest, so the state and the alarms of the machine are now those of an older time. To evaluate old \
         recordings only, import them into another database ([store] path)",
        file.display(),
        utc(&started_at),
        utc(&last)
    ));
}

fn is_json(file: &Path) -> bool {
    let is_name = |extension: &OsStr| ["json", "jsonl", "ndjson"].iter().any(|name| extension == *name);
    file == Path::new("-") || file.extension().is_some_and(is_name)
}

/// The site and the machine in a JSON message, if it has both. The message has no fields for them, but a program that
/// records throws of several machines may add them.
#[derive(Deserialize)]
struct Names {
    site: String,
    machine: String,
}

/// Reads the files.
struct Recordings<'a> {
    arguments: &'a Arguments,
    monitor: Monitor,
    exports: Exports,
}

impl Recordings<'_> {
    fn read(&mut self, number: usize, file: &Path) -> Result<Recorded, Failure> {
        if is_json(file) {
            return self.read_json(file);
        }
        let (names, throw) = self.read_csv(number, file)?;
        Ok(vec![(self.machine(names, || file.display().to_string())?, throw)])
    }

    /// The machine of a throw that names itself so, or `--machine`. `place`: of the throw, for an error.
    fn machine(&self, names: Option<Names>, place: impl Fn() -> String) -> Result<MachineId, Failure> {
        let Some(Names { site, machine: name }) = names else {
            let unnamed = || anyhow!("this throw does not name its machine: give --machine SITE/MACHINE");
            return self.arguments.machine.clone().ok_or_else(unnamed).with_context(place).or_exit(Exit::Usage);
        };
        let checked = || match &self.arguments.machine {
            Some(machine) if site == machine.site.as_str() && name == machine.machine.as_str() => Ok(machine.clone()),
            Some(machine) => bail!(
                "a throw of {site}/{name}, and --machine is {machine}: import each machine alone, or without --machine"
            ),
            None => {
                let machine = MachineId::new(&site, &name)?;
                match self.monitor.reserves(&machine) {
                    Some(problem) => bail!("a throw of {machine}: {problem}"),
                    None => Ok(machine),
                }
            }
        };
        checked().with_context(place).or_exit(Exit::Data)
    }

    /// The throw in a CSV file, with the names in its line of `throws.csv`.
    fn read_csv(&mut self, number: usize, file: &Path) -> Result<(Option<Names>, Throw), Failure> {
        // Read once: the content of a pipe is gone then.
        let content = recording::bytes(file)?;
        let recording = recording::from_content(file, &content)?;
        let first_start = self.arguments.started_at;
        if first_start.is_none()
            && let Some(line) = self.exports.line(file).or_exit(Exit::Data)?
        {
            let names = Names { site: line.site.clone(), machine: line.machine.clone() };
            let throw = Throw {
                id: ThrowRef { boot_id: line.boot_id.clone(), throw_no: line.throw_no },
                started_at: line.started_at,
                direction: line.direction.parse().ok(),
                trace: recording.trace.with_exact_rate(line.sample_rate_hz),
                temperature_c: line.temperature_c,
                supply_v: line.supply_v,
                anti_alias_hz: line.anti_alias_hz,
            };
            return Ok((Some(names), throw));
        }
        let started_at = if let Some(first) = first_start {
            let later = SignedDuration::from_mins(i64::try_from(number).unwrap_or(0));
            first.checked_add(later).or_exit(Exit::Usage)?
        } else {
            let modified = fs::metadata(file).and_then(|file| file.modified());
            let modified = modified.with_context(|| format!("cannot read {}", file.display()));
            Timestamp::try_from(modified.or_exit(Exit::NoInput)?).or_exit(Exit::Data)?
        };
        let throw = Throw {
            // Boot and number depend only on the content, so that a repeated import of the file is a duplicate.
            id: ThrowRef {
                boot_id: format!("import-{:08x}-{}", crc32fast::hash(&content), content.len()),
                throw_no: 1,
            },
            started_at,
            ..Throw::recorded(recording.trace)
        };
        Ok((None, throw))
    }

    fn read_json(&self, file: &Path) -> Result<Recorded, Failure> {
        let name = || file.display().to_string();
        let bytes = recording::bytes(file)?;
        let bytes = wire::without_byte_order_mark(&bytes);
        if bytes.trim_ascii_start().starts_with(b"[") {
            let problem =
                "a JSON array: write each throw as an object on a line of its own, without brackets around them";
            return Err(anyhow!("{}: {problem}", name())).or_exit(Exit::Data);
        }
        let is_one_object = || serde_json::from_slice::<serde_json::Map<String, serde_json::Value>>(bytes).is_ok();
        match wire::decode_throw(Encoding::Json, bytes) {
            Ok(throw) => return Ok(vec![(self.machine(serde_json::from_slice(bytes).ok(), name)?, throw)]),
            // Any other file may have a throw on each line, and an error must name the line.
            Err(error) if file.extension().is_some_and(|extension| extension == "json") && is_one_object() => {
                return Err(error).with_context(name).or_exit(Exit::Data);
            }
            Err(_) => {}
        }
        let lines = bytes.split(|byte| *byte == b'\n').enumerate().filter(|(_, line)| !line.trim_ascii().is_empty());
        lines
            .map(|(at, line)| {
                let place = || format!("{}, line {}", name(), at + 1);
                let throw = wire::decode_throw(Encoding::Json, line).with_context(place).or_exit(Exit::Data)?;
                Ok((self.machine(serde_json::from_slice(line).ok(), place)?, throw))
            })
            .collect()
    }
}

/// A line of `throws.csv`, which `pointsd export --traces` wrote.
#[derive(Debug, Deserialize)]
struct Exported {
    site: String,
    machine: String,
    trace: PathBuf,
    boot_id: String,
    throw_no: u64,
    started_at: Timestamp,
    direction: String,
    temperature_c: Option<f64>,
    supply_v: Option<f64>,
    anti_alias_hz: Option<f64>,
    /// Missing in files of another program.
    #[serde(default)]
    sample_rate_hz: Option<f64>,
}

/// The files `throws.csv` beside the imported traces.
#[derive(Default)]
struct Exports {
    /// The lines of each `throws.csv` that was read, by the file names of their traces.
    lists: HashMap<PathBuf, HashMap<OsString, Exported>>,
}

impl Exports {
    /// The line of a trace in its `throws.csv`; `None` without such a file or line.
    fn line(&mut self, trace: &Path) -> anyhow::Result<Option<&Exported>> {
        let Ok(full) = fs::canonicalize(trace) else { return Ok(None) };
        let folders = full.ancestors().skip(1).take(EXPORT_FOLDERS);
        let Some(list) = folders.map(|folder| folder.join("throws.csv")).find(|list| list.is_file()) else {
            return Ok(None);
        };
        if !self.lists.contains_key(&list) {
            let lines = lines(&list).with_context(|| {
                format!("{}: restore it, or give --started-at to import without it", list.display())
            })?;
            self.lists.insert(list.clone(), lines);
        }
        Ok(full.file_name().and_then(|name| self.lists[&list].get(name)))
    }
}

/// The lines of a `throws.csv`; empty if another program wrote the file, with other columns.
fn lines(list: &Path) -> anyhow::Result<HashMap<OsString, Exported>> {
    let mut reader = csv::Reader::from_path(list)?;
    let header: Vec<&str> = reader.headers()?.iter().flat_map(|cell| cell.split([';', '\t'])).collect();
    if !["trace", "throw_no"].iter().all(|name| header.contains(name)) {
        return Ok(HashMap::new());
    }
    let mut lines = HashMap::new();
    for line in reader.into_deserialize() {
        let line: Exported = line?;
        let is_valid = wire::is_boot_id(&line.boot_id)
            && i64::try_from(line.throw_no).is_ok()
            && (line.direction == "unknown" || line.direction.parse::<Direction>().is_ok());
        if !is_valid {
            bail!("boot_id, throw_no or direction of {} is wrong", line.trace.display());
        }
        // A throw without a stored trace has no file name. File names are unique, as they include the row number.
        if let Some(name) = line.trace.file_name() {
            lines.insert(name.to_owned(), line);
        }
    }
    Ok(lines)
}

/// Prints a line. A closed pipe does not end the import.
fn print(line: impl Display) -> Outcome {
    output::after(output::line(line), Exit::Ok)
}

/// Counts a throw that the database has already, and prints its JSON object.
fn report_known(arguments: &Arguments, machine: &MachineId, id: &ThrowRef, count: &mut Count) -> Result<(), Failure> {
    count.known += 1;
    if arguments.json {
        print(
            json!({"site": machine.site, "machine": machine.machine, "boot_id": id.boot_id, "throw_no": id.throw_no, "known": true}),
        )?;
    }
    Ok(())
}

fn report(arguments: &Arguments, judged: &[Arc<[Judgement]>], count: &mut Count) -> Result<(), Failure> {
    for Judgement { health, outcome, .. } in judged.iter().flat_map(|batch| &**batch) {
        count.rejected += u64::from(health.is_rejected());
        count.alarms += outcome.events.len() as u64;
        if arguments.json {
            let Health { machine, throw: id, quality, direction, .. } = health;
            let events: Vec<_> =
                outcome.events.iter().map(|event| wire::Alarm::new(machine, event).published()).collect();
            print(
                json!({"site": machine.site, "machine": machine.machine, "boot_id": id.boot_id, "throw_no": id.throw_no, "quality": quality, "direction": direction,
                       "alarms": events}),
            )?;
        } else {
            for event in &outcome.events {
                print(&event.text)?;
            }
        }
    }
    Ok(())
}
