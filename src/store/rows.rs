//! Types of rows of the database.

use jiff::Timestamp;
use serde::de::DeserializeOwned;
use sqlx::{FromRow, Row, sqlite::SqliteRow};

use super::codec::{self, Channel, UnreadableTrace};
use crate::{
    diagnose::MachineState,
    throw::{Direction, MachineId, Throw, ThrowRef, Trace},
    wire::{BaselineProgress, Health},
};

/// Row number of a stored throw. Rows are numbered in the order of reception; numbers are not reused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ThrowRow(pub i64);

impl ThrowRow {
    /// The number before the first row, to start reading.
    pub const START: Self = Self(0);
}

/// Reason why throws are missing.
#[derive(Clone, Copy, strum::AsRefStr)]
#[strum(serialize_all = "snake_case")]
pub(super) enum GapKind {
    /// Missing after the first contact with the machine; a backlog may still have the throws.
    Missed,
    /// Recorded before the first throw that this daemon received of the machine.
    BeforeFirstContact,
}

/// Selects machines by `GLOB` patterns of SQLite: a name selects itself, and `*` stands for any characters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selector {
    /// Pattern of the site.
    pub site: String,
    /// Pattern of the machine name.
    pub machine: String,
}

/// Selects all machines.
impl Default for Selector {
    fn default() -> Self {
        Self { site: "*".to_owned(), machine: "*".to_owned() }
    }
}

/// Selects one machine.
impl From<&MachineId> for Selector {
    fn from(machine: &MachineId) -> Self {
        Self { site: machine.site.to_string(), machine: machine.machine.to_string() }
    }
}

/// A stored throw.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredThrow {
    /// Row of the throw.
    pub row: ThrowRow,
    /// The machine.
    pub machine: MachineId,
    /// Boot and sequence number.
    pub id: ThrowRef,
    /// Wall time of the first sample, from the logger.
    pub started_at: Timestamp,
    /// Time of reception.
    pub received_at: Timestamp,
    /// The throw, or the reason why its trace cannot be read.
    pub throw: Result<Throw, UnreadableTrace>,
    /// Whether the machine sent the same trace before.
    pub repeats: bool,
    /// Whether another throw already had the number: then this one has the next number of a separate boot.
    pub renumbered: bool,
}

/// A pending throw. The statement makes an array, so the order of the fields counts.
#[derive(Debug, serde::Deserialize)]
pub(super) struct PendingRow {
    pub(super) row: i64,
    site: String,
    machine: String,
    boot_id: String,
    throw_no: i64,
    received_at_us: i64,
    /// Whether the trace repeats an earlier one: 0 or 1.
    repeats: i64,
    /// Whether the throw is judged at another position than the position of its boot: 0 or 1.
    moved: i64,
}

/// Suffix of the separate `boot_id` for throws whose number was already stored. A logger may use this suffix too.
pub(super) const RENUMBERED: &str = "~again";

/// Whether a throw was stored in a separate boot because its number was already stored. `moved`: the throw is judged at
/// another position than the position of its boot.
fn is_renumbered(id: &ThrowRef, moved: bool) -> bool {
    moved && id.boot_id.ends_with(RENUMBERED)
}

/// A stored monitor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredMonitor {
    /// The machine.
    pub machine: MachineId,
    /// Snapshot of the monitor as JSON.
    pub snapshot: String,
    /// State of the machine; `None` if an earlier version wrote the row.
    pub state: Option<MachineState>,
}

/// A gap of missing throws.
#[derive(Debug, Clone, PartialEq, Eq, FromRow)]
pub struct Gap {
    #[sqlx(rename = "gap_row")]
    pub(super) row: i64,
    /// The machine.
    #[sqlx(flatten)]
    pub machine: MachineId,
    /// First missing throw number.
    pub first_no: u64,
    /// Last missing throw number.
    pub last_no: u64,
    /// Number of missing throws whose messages are in quarantine.
    pub refused: u64,
    /// Reason of the newest of these messages.
    pub reason: Option<String>,
}

/// A message in the outbox.
#[derive(Debug, Clone, PartialEq, Eq, FromRow)]
pub struct OutboxRow {
    /// Row number, in the order of publication.
    #[sqlx(rename = "outbox_row")]
    pub row: i64,
    /// Key of the publication.
    pub key: String,
    /// The message.
    pub payload: Vec<u8>,
}

fn decode_error(error: impl std::error::Error + Send + Sync + 'static) -> sqlx::Error {
    sqlx::Error::Decode(Box::new(error))
}

/// The time at `at_us` \[µs since 1970\]. A number out of range gives the nearest time, so that one invalid row does
/// not hide the others.
pub(super) fn timestamp(at_us: i64) -> Timestamp {
    let nearest = if at_us < 0 { Timestamp::MIN } else { Timestamp::MAX };
    Timestamp::from_microsecond(at_us).unwrap_or(nearest)
}

impl FromRow<'_, SqliteRow> for MachineId {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Self::new(row.try_get("site")?, row.try_get("machine")?).map_err(decode_error)
    }
}

impl FromRow<'_, SqliteRow> for ThrowRef {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self { boot_id: row.try_get("boot_id")?, throw_no: unsigned(row, "throw_no")? })
    }
}

pub(super) fn time(row: &SqliteRow, column: &str) -> sqlx::Result<Timestamp> {
    row.try_get(column).map(timestamp)
}

fn unsigned(row: &SqliteRow, column: &str) -> sqlx::Result<u64> {
    row.try_get(column).map(i64::cast_unsigned)
}

/// Parses a word of an enum; `None` for NULL and for unknown words.
pub(super) fn word<T: std::str::FromStr>(row: &SqliteRow, column: &str) -> sqlx::Result<Option<T>> {
    let word: Option<&str> = row.try_get(column)?;
    Ok(word.and_then(|word| word.parse().ok()))
}

/// Parses JSON that a statement made.
pub(super) fn from_json<T: DeserializeOwned>(text: &str) -> sqlx::Result<T> {
    serde_json::from_str(text).map_err(decode_error)
}

/// Parses JSON; `None` for NULL and for JSON that this version cannot read.
pub(super) fn json<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> sqlx::Result<Option<T>> {
    let json: Option<&str> = row.try_get(column)?;
    Ok(json.and_then(|json| serde_json::from_str(json).ok()))
}

pub(super) fn baseline(row: &SqliteRow) -> sqlx::Result<Option<BaselineProgress>> {
    let [so_far, needed] = ["baseline_throws", "baseline_needed"].map(|column| row.try_get::<Option<i64>, _>(column));
    let progress = |(so_far, needed): (i64, i64)| BaselineProgress {
        so_far: so_far.cast_unsigned(),
        needed: needed.cast_unsigned(),
    };
    Ok(so_far?.zip(needed?).map(progress))
}

fn three(row: &SqliteRow, columns: [&str; 3]) -> sqlx::Result<Option<[f64; 3]>> {
    let [b0, a1, a0] = columns.map(|column| row.try_get::<Option<f64>, _>(column));
    Ok(b0?.zip(a1?).zip(a0?).map(|((b0, a1), a0)| [b0, a1, a0]))
}

/// Decodes the trace of a row. The outer error is about the row, the inner one about the trace.
fn trace(row: &SqliteRow) -> sqlx::Result<Result<Trace, UnreadableTrace>> {
    let channel = |codec: &str, data: &str| -> sqlx::Result<Option<Channel>> {
        let (codec, data): (Option<String>, Option<Vec<u8>>) = (row.try_get(codec)?, row.try_get(data)?);
        Ok(codec.zip(data).map(|(codec, data)| Channel { codec, data }))
    };
    let current = channel("current_codec", "current_data")?;
    let (Some(current), Some(position)) = (current, channel("position_codec", "position_data")?) else {
        return Ok(Err(UnreadableTrace::Dropped));
    };
    let crc32: Option<u32> = row.try_get("crc32")?;
    let samples = usize::try_from(row.try_get::<i64, _>("samples")?).map_err(decode_error)?;
    Ok(codec::trace(row.try_get("sample_rate_hz")?, samples, &current, &position, crc32.unwrap_or_default()))
}

impl StoredThrow {
    /// A throw from memory, with the columns that were computed when it was stored.
    pub(super) fn from_memory(row: PendingRow, throw: Throw) -> sqlx::Result<Self> {
        let PendingRow { row, site, machine, boot_id, throw_no, received_at_us, repeats, moved } = row;
        let id = ThrowRef { boot_id, throw_no: throw_no.cast_unsigned() };
        Ok(Self {
            row: ThrowRow(row),
            machine: MachineId::new(&site, &machine).map_err(decode_error)?,
            renumbered: is_renumbered(&id, moved != 0),
            id: id.clone(),
            started_at: throw.started_at,
            received_at: timestamp(received_at_us),
            repeats: repeats != 0,
            throw: Ok(Throw { id, ..throw }),
        })
    }
}

impl FromRow<'_, SqliteRow> for StoredThrow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        let (id, started_at) = (ThrowRef::from_row(row)?, time(row, "started_at_us")?);
        let throw = match trace(row)? {
            Ok(trace) => Ok(Throw {
                id: id.clone(),
                started_at,
                direction: word::<Direction>(row, "direction")?,
                trace,
                temperature_c: row.try_get("temperature_c")?,
                supply_v: row.try_get("supply_v")?,
                anti_alias_hz: row.try_get("anti_alias_hz")?,
            }),
            Err(unreadable) => Err(unreadable),
        };
        Ok(Self {
            row: ThrowRow(row.try_get("throw_row")?),
            machine: MachineId::from_row(row)?,
            renumbered: is_renumbered(&id, row.try_get("moved")?),
            id,
            started_at,
            received_at: time(row, "received_at_us")?,
            throw,
            repeats: row.try_get("repeats")?,
        })
    }
}

impl FromRow<'_, SqliteRow> for Health {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self {
            schema: Self::SCHEMA.to_owned(),
            machine: MachineId::from_row(row)?,
            throw: ThrowRef::from_row(row)?,
            started_at: time(row, "started_at_us")?,
            direction: word(row, "direction")?,
            quality: row.try_get("quality")?,
            coefficients: three(row, ["b0", "a1", "a0"])?,
            sd: three(row, ["b0_sd", "a1_sd", "a0_sd"])?,
            change_pct: three(row, ["b0_pct", "a1_pct", "a0_pct"])?,
            fit_pct: row.try_get("fit_pct")?,
            a1_per_b0: row.try_get("a1_per_b0")?,
            a1_per_b0_sd: row.try_get("a1_per_b0_sd")?,
            a0_per_b0: row.try_get("a0_per_b0")?,
            a0_per_b0_sd: row.try_get("a0_per_b0_sd")?,
            a1_per_b0_pct: row.try_get("a1_per_b0_pct")?,
            a0_per_b0_pct: row.try_get("a0_per_b0_pct")?,
            duration_s: row.try_get("duration_s")?,
            peak_current_a: row.try_get("peak_current_a")?,
            mean_current_a: row.try_get("mean_current_a")?,
            state: word(row, "state")?,
            drift: json(row, "drift")?,
            drifts: json(row, "drifts")?.unwrap_or_default(),
            caveats: json(row, "caveats")?.unwrap_or_default(),
            detail: row.try_get("detail")?,
            baseline: baseline(row)?,
            throws_since_baseline: unsigned(row, "throws_since_baseline")?,
        })
    }
}

impl FromRow<'_, SqliteRow> for StoredMonitor {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self { machine: MachineId::from_row(row)?, snapshot: row.try_get("snapshot")?, state: word(row, "state")? })
    }
}
