//! Recorded throws as CSV: `time_s,current_a,position_mm`, one line for each sample.
//!
//! If all time stamps are within 2 % of an interval of an even grid, the samples are used as they are. Otherwise, with
//! jitter or single missing samples, the channels are interpolated linearly to an even grid with the mean interval.
//! More than five intervals without a sample are a gap; a trace with a gap is an error.

use std::{
    fs,
    io::{self, Read as _},
    path::Path,
};

use anyhow::{Context, anyhow, bail};

use super::{Exit, Failure, ResultExt};
use crate::{
    throw::{MAX_SAMPLES, Trace, counted},
    wire::without_byte_order_mark,
};

const TIME: &str = "time_s";
const CURRENT: &str = "current_a";
const POSITION: &str = "position_mm";
/// Largest deviation from an even grid without interpolation \[intervals\].
const EVEN_TOLERANCE: f64 = 0.02;
/// Longest time between two samples \[intervals\]; a longer time is a gap.
const LONGEST_STEP: f64 = 5.5;

/// Largest file \[bytes\]: some 5,000 throws in JSON, or ten times the longest trace. Without a limit a device without
/// an end, as `/dev/zero`, would fill the memory.
const MAX_BYTES: u64 = 512 << 20;

/// A recorded throw, with the lines of its file for error messages.
#[derive(Debug)]
pub(super) struct Recording {
    /// Current and position on an even grid.
    pub(super) trace: Trace,
    /// Line of each sample in the file, from 1; empty if the samples were interpolated to this grid.
    pub(super) lines: Vec<u64>,
}

struct Columns {
    time_s: Vec<f64>,
    current_a: Vec<f64>,
    position_mm: Vec<f64>,
    lines: Vec<u64>,
}

/// Reads a recorded throw.
///
/// # Errors
/// [`Exit::NoInput`] when the file cannot be read, [`Exit::Data`] with line and column when its content is invalid.
pub(super) fn read(path: &Path) -> Result<Recording, Failure> {
    from_content(path, &bytes(path)?)
}

/// The recorded throw in the content of a file.
pub(super) fn from_content(path: &Path, bytes: &[u8]) -> Result<Recording, Failure> {
    let recording = parse(without_byte_order_mark(bytes)).and_then(Columns::evenly);
    recording.with_context(|| path.display().to_string()).or_exit(Exit::Data)
}

/// The content of a file, or of standard input for `-`.
pub(super) fn bytes(path: &Path) -> Result<Vec<u8>, Failure> {
    let mut bytes = Vec::new();
    let read = if path == Path::new("-") {
        io::stdin().take(MAX_BYTES + 1).read_to_end(&mut bytes)
    } else {
        fs::File::open(path).and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes))
    };
    let too_large = || io::Error::other(format!("it has more than {} MiB: divide it", MAX_BYTES >> 20));
    let read = read.and_then(|_| if bytes.len() as u64 > MAX_BYTES { Err(too_large()) } else { Ok(bytes) });
    read.with_context(|| format!("cannot read {}", path.display())).or_exit(Exit::NoInput)
}

fn parse(bytes: &[u8]) -> anyhow::Result<Columns> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = bytes[..error.valid_up_to()].split(|byte| *byte == b'\n').count();
        anyhow!("line {line}: not UTF-8 text: is this a CSV file?")
    })?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).flexible(true).from_reader(text.as_bytes());
    let header = reader.headers().context("line 1: no header")?.clone();
    let at = |name: &str| header.iter().position(|column| column == name).ok_or_else(|| missing(name, &header));
    for name in [TIME, CURRENT, POSITION] {
        if header.iter().filter(|column| *column == name).count() > 1 {
            bail!("line 1: several columns are named {name}: rename those that are not to be read");
        }
    }
    let places = [(TIME, at(TIME)?), (CURRENT, at(CURRENT)?)];
    // A recording with a current sensor only does not have this column.
    let position = at(POSITION).ok();
    let mut columns = Columns { time_s: vec![], current_a: vec![], position_mm: vec![], lines: vec![] };
    for record in reader.records() {
        let record = record.context("not readable as CSV")?;
        let line = record.position().map_or(0, csv::Position::line);
        if record.iter().skip(header.len()).any(|cell| !cell.is_empty()) {
            bail!(
                "line {line}: {} values for the {} columns of the header: write decimals with a point, not a comma",
                record.len(),
                header.len()
            );
        }
        let [time_s, current_a] = places.map(|(name, place)| number(record.get(place), line, name));
        // An exported trace without a position has this column with empty cells.
        let measured = position.filter(|place| record.get(*place) != Some(""));
        let position_mm = measured.map_or(Ok(f64::NAN), |place| number(record.get(place), line, POSITION));
        if columns.lines.len() == MAX_SAMPLES {
            bail!("line {line}: more than {MAX_SAMPLES} samples");
        }
        let time_s = time_s?;
        if !time_s.is_finite() {
            bail!("line {line}, column {TIME}: {time_s} is not a time");
        }
        if let Some(before) = columns.time_s.last().filter(|before| **before >= time_s) {
            bail!("line {line}, column {TIME}: time does not increase ({time_s} after {before})");
        }
        columns.time_s.push(time_s);
        columns.current_a.push(current_a?);
        columns.position_mm.push(position_mm?);
        columns.lines.push(line);
    }
    Ok(columns)
}

fn missing(name: &str, header: &csv::StringRecord) -> anyhow::Error {
    let found = header.iter().collect::<Vec<_>>().join(",");
    let found: String = found.chars().take(100).collect();
    let hint = match found.chars().find(|separator| [';', '\t'].contains(separator)) {
        Some(';') => "; separate the columns by commas, not semicolons",
        Some(_) => "; separate the columns by commas, not tabs",
        None => "",
    };
    anyhow!(
        "line 1: column {name} is missing: the header must name {TIME},{CURRENT} and, with a toe sensor, {POSITION}, and is {found:?}{hint}"
    )
}

fn number(cell: Option<&str>, line: u64, column: &str) -> anyhow::Result<f64> {
    let cell = cell.filter(|cell| !cell.is_empty()).ok_or_else(|| anyhow!("line {line}, column {column}: no value"))?;
    cell.parse().map_err(|_| {
        let cell: String = cell.chars().take(40).collect();
        anyhow!("line {line}, column {column}: {cell:?} is not a number")
    })
}

impl Columns {
    /// The recording on an even grid.
    fn evenly(self) -> anyhow::Result<Recording> {
        let len = self.time_s.len();
        if len < 2 {
            bail!("the file has {}, too few for a throw", counted(len, "sample"));
        }
        let interval_s = self.interval_s()?;
        let start_s = self.time_s[0];
        let uneven =
            |(k, time_s): (usize, &f64)| (time_s - start_s - k as f64 * interval_s).abs() > EVEN_TOLERANCE * interval_s;
        let rate_hz = 1.0 / interval_s;
        let (current_a, position_mm, lines) = if self.time_s.iter().enumerate().any(uneven) {
            (self.interpolated(&self.current_a, interval_s), self.interpolated(&self.position_mm, interval_s), vec![])
        } else {
            (self.current_a, self.position_mm, self.lines)
        };
        Ok(Recording { trace: Trace::new(rate_hz, current_a, position_mm)?, lines })
    }

    /// Mean sample interval \[s\]. A step over missing samples counts as several intervals.
    fn interval_s(&self) -> anyhow::Result<f64> {
        let steps: Vec<f64> = self.time_s.array_windows().map(|[before, after]| after - before).collect();
        let median = *steps.clone().select_nth_unstable_by(steps.len() / 2, f64::total_cmp).1;
        if let Some(k) = steps.iter().position(|step| *step > LONGEST_STEP * median) {
            bail!("line {}: no samples for {:.4} s before this line, a gap", self.lines[k + 1], steps[k]);
        }
        let intervals: f64 = steps.iter().map(|step| (step / median).round().max(1.0)).sum();
        Ok((self.time_s[self.time_s.len() - 1] - self.time_s[0]) / intervals)
    }

    /// A channel, interpolated linearly to the even grid with this interval.
    fn interpolated(&self, values: &[f64], interval_s: f64) -> Vec<f64> {
        let mut grid = Vec::with_capacity(values.len());
        let mut at = 0;
        let last = self.time_s.len() - 1;
        loop {
            let time_s = self.time_s[0] + grid.len() as f64 * interval_s;
            if time_s > self.time_s[last] + 1e-9 * interval_s {
                return grid;
            }
            while at + 2 <= last && self.time_s[at + 1] < time_s {
                at += 1;
            }
            let share = ((time_s - self.time_s[at]) / (self.time_s[at + 1] - self.time_s[at])).min(1.0);
            let [before, after] = [values[at], values[at + 1]];
            // A slow toe sensor has no value in most samples, so each value stays at the nearest time of the grid.
            grid.push(if before.is_nan() == after.is_nan() {
                before + share * (after - before)
            } else if share < 0.5 {
                before
            } else {
                after
            });
        }
    }
}
