//! Rows of the database as values.

use jiff::Timestamp;
use serde::de::DeserializeOwned;
use sqlx::{FromRow, Row, sqlite::SqliteRow};

use super::codec::{self, Channel, UnreadableTrace};
use crate::{
    diagnose::MachineState,
    throw::{Direction, MachineId, Name, Throw, ThrowRef, Trace},
    wire::Health,
};

/// The row of a stored throw. Rows are numbered in the order of arrival and never used again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ThrowRow(pub i64);

impl ThrowRow {
    /// Before the first row: where reading starts.
    pub const START: Self = Self(0);
}

/// The row of a gap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct GapRow(pub(super) i64);

/// Why throws are missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, strum::AsRefStr, strum::EnumString)]
#[strum(serialize_all = "snake_case")]
pub enum GapKind {
    /// The logger made them and they never came.
    Missed,
    /// The logger made them before this daemon first heard of the machine.
    BeforeFirstContact,
}

/// Which machines a query is about; `None` means all.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Selector {
    /// Only this site.
    pub site: Option<Name>,
    /// Only machines of this name.
    pub machine: Option<Name>,
}

impl Selector {
    pub(super) fn site(&self) -> Option<&str> {
        self.site.as_ref().map(Name::as_str)
    }

    pub(super) fn machine(&self) -> Option<&str> {
        self.machine.as_ref().map(Name::as_str)
    }
}

/// A throw as it was stored.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredThrow {
    /// Its row.
    pub row: ThrowRow,
    /// Which machine.
    pub machine: MachineId,
    /// Its identity within the machine.
    pub id: ThrowRef,
    /// Wall time of its first sample, from the logger.
    pub started_at: Timestamp,
    /// When it arrived.
    pub received_at: Timestamp,
    /// The throw; or why its trace cannot be read.
    pub throw: Result<Throw, UnreadableTrace>,
    /// The machine sent the same trace before.
    pub repeats: bool,
    /// The number of the throw was taken by another one: it stands under the next free one of a boot of its own.
    pub renumbered: bool,
}

/// What is added to the `boot_id` of throws whose numbers were taken.
pub(super) const RENUMBERED: &str = "~again";

/// The monitor of a machine as it was stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredMonitor {
    /// Which machine.
    pub machine: MachineId,
    /// The monitor, JSON.
    pub snapshot: String,
    /// The state of the machine beside it; `None` when an earlier version wrote it.
    pub state: Option<MachineState>,
}

/// Throws that are missing, from the first to the last number, both included.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gap {
    /// Its row.
    pub row: GapRow,
    /// Which machine.
    pub machine: MachineId,
    /// Which start of its logger.
    pub boot_id: String,
    /// First missing number.
    pub first_no: u64,
    /// Last missing number.
    pub last_no: u64,
    /// Why.
    pub kind: GapKind,
    /// When it was noticed.
    pub detected_at: Timestamp,
}

/// A message that waits to be published.
#[derive(Debug, Clone, PartialEq, Eq, FromRow)]
pub struct OutboxRow {
    /// Its number, in the order of publication.
    #[sqlx(rename = "outbox_row")]
    pub row: i64,
    /// The key to publish it on.
    pub key: String,
    /// The message.
    pub payload: Vec<u8>,
}

/// A message in quarantine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Quarantined {
    /// When it arrived.
    pub received_at: Timestamp,
    /// On which key.
    pub key: String,
    /// Why it is no throw.
    pub reason: String,
    /// Its whole length \[bytes\].
    pub payload_bytes: u64,
    /// Its beginning.
    pub payload_start: Vec<u8>,
}

fn decode_error(error: impl std::error::Error + Send + Sync + 'static) -> sqlx::Error {
    sqlx::Error::Decode(Box::new(error))
}

/// The time of a column; the nearest that exists for a number out of range, so that one odd row does not hide all others.
pub(super) fn timestamp(at_us: i64) -> Timestamp {
    let nearest = if at_us < 0 { Timestamp::MIN } else { Timestamp::MAX };
    Timestamp::from_microsecond(at_us).unwrap_or(nearest)
}

pub(super) fn machine_id(row: &SqliteRow) -> sqlx::Result<MachineId> {
    MachineId::new(row.try_get("site")?, row.try_get("machine")?).map_err(decode_error)
}

fn throw_ref(row: &SqliteRow) -> sqlx::Result<ThrowRef> {
    Ok(ThrowRef { boot_id: row.try_get("boot_id")?, throw_no: unsigned(row, "throw_no")? })
}

pub(super) fn time(row: &SqliteRow, column: &str) -> sqlx::Result<Timestamp> {
    row.try_get(column).map(timestamp)
}

fn unsigned(row: &SqliteRow, column: &str) -> sqlx::Result<u64> {
    row.try_get(column).map(i64::cast_unsigned)
}

/// A word of an enum; `None` for NULL and for words that this version does not know.
pub(super) fn word<T: std::str::FromStr>(row: &SqliteRow, column: &str) -> sqlx::Result<Option<T>> {
    let word: Option<&str> = row.try_get(column)?;
    Ok(word.and_then(|word| word.parse().ok()))
}

/// A value from its JSON; `None` for NULL and for what this version cannot read.
pub(super) fn json<T: DeserializeOwned>(row: &SqliteRow, column: &str) -> sqlx::Result<Option<T>> {
    let json: Option<&str> = row.try_get(column)?;
    Ok(json.and_then(|json| serde_json::from_str(json).ok()))
}

fn three(row: &SqliteRow, columns: [&str; 3]) -> sqlx::Result<Option<[f64; 3]>> {
    let [b0, a1, a0] = columns.map(|column| row.try_get::<Option<f64>, _>(column));
    Ok(b0?.zip(a1?).zip(a0?).map(|((b0, a1), a0)| [b0, a1, a0]))
}

/// The trace of a row; the outer error is one of the row itself.
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
    /// A throw that is still in memory, with the columns that storing it added.
    pub(super) fn from_memory(row: &SqliteRow, throw: Throw) -> sqlx::Result<Self> {
        let throw = Throw { id: throw_ref(row)?, ..throw };
        Self::new(row, throw.started_at, Ok(throw))
    }

    fn new(row: &SqliteRow, started_at: Timestamp, throw: Result<Throw, UnreadableTrace>) -> sqlx::Result<Self> {
        let id = throw_ref(row)?;
        Ok(Self {
            row: ThrowRow(row.try_get("throw_row")?),
            machine: machine_id(row)?,
            renumbered: id.boot_id.ends_with(RENUMBERED),
            id,
            started_at,
            received_at: time(row, "received_at_us")?,
            throw,
            repeats: row.try_get("repeats")?,
        })
    }
}

impl FromRow<'_, SqliteRow> for StoredThrow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        let started_at = time(row, "started_at_us")?;
        let throw = match trace(row)? {
            Ok(trace) => Ok(Throw {
                id: throw_ref(row)?,
                started_at,
                direction: word::<Direction>(row, "direction")?,
                trace,
                temperature_c: row.try_get("temperature_c")?,
                supply_v: row.try_get("supply_v")?,
                anti_alias_hz: row.try_get("anti_alias_hz")?,
            }),
            Err(unreadable) => Err(unreadable),
        };
        Self::new(row, started_at, throw)
    }
}

impl FromRow<'_, SqliteRow> for Health {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        let baseline = [row.try_get("baseline_throws")?, row.try_get("baseline_needed")?];
        let [so_far, needed] = baseline.map(|count: Option<i64>| count.map(i64::cast_unsigned));
        Ok(Self {
            schema: Self::SCHEMA.to_owned(),
            machine: machine_id(row)?,
            throw: throw_ref(row)?,
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
            duration_s: row.try_get("duration_s")?,
            peak_current_a: row.try_get("peak_current_a")?,
            mean_current_a: row.try_get("mean_current_a")?,
            state: word(row, "state")?,
            drift: json(row, "drift")?,
            detail: row.try_get("detail")?,
            baseline: so_far.zip(needed),
            throws_since_baseline: unsigned(row, "throws_since_baseline")?,
        })
    }
}

impl FromRow<'_, SqliteRow> for StoredMonitor {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self { machine: machine_id(row)?, snapshot: row.try_get("snapshot")?, state: word(row, "state")? })
    }
}

impl FromRow<'_, SqliteRow> for Gap {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self {
            row: GapRow(row.try_get("gap_row")?),
            machine: machine_id(row)?,
            boot_id: row.try_get("boot_id")?,
            first_no: unsigned(row, "first_no")?,
            last_no: unsigned(row, "last_no")?,
            kind: word(row, "kind")?.unwrap_or(GapKind::Missed),
            detected_at: time(row, "detected_at_us")?,
        })
    }
}

impl FromRow<'_, SqliteRow> for Quarantined {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self {
            received_at: time(row, "received_at_us")?,
            key: row.try_get("key")?,
            reason: row.try_get("reason")?,
            payload_bytes: unsigned(row, "payload_bytes")?,
            payload_start: row.try_get("payload_start")?,
        })
    }
}
