//! Throws as they arrive: once each, with the numbers that never came kept as gaps.

use jiff::Timestamp;
use sqlx::SqliteConnection;
use tokio::sync::OwnedSemaphorePermit;

use super::{
    codec::{self, Channel},
    error::StoreError,
    statements as sql,
    writer::Write,
};
use crate::throw::{Direction, MachineId, Throw, ThrowRef};

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

/// What became of a throw that was handed over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spooled {
    /// It is on the disk, under this row.
    New(ThrowRow),
    /// Its number was stored before (and perhaps pruned since).
    Duplicate {
        /// Another throw was stored under this number: the logger counts wrongly. Counted and quarantined.
        differs: bool,
    },
}

/// Why throws are missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum GapKind {
    /// The logger made them and they never came.
    Missed,
    /// The logger made them before this daemon first heard of the machine.
    BeforeFirstContact,
}

impl GapKind {
    /// All kinds.
    pub const ALL: [Self; 2] = [Self::Missed, Self::BeforeFirstContact];

    /// The word in the view `data_gaps`.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Missed => "missed",
            Self::BeforeFirstContact => "before_first_contact",
        }
    }
}

/// A throw ready to be written.
pub(super) struct Spool {
    machine: MachineId,
    id: ThrowRef,
    throw_no: i64,
    started_at_us: i64,
    received_at_us: i64,
    direction: Option<Direction>,
    sample_rate_hz: f64,
    samples: i64,
    temperature_c: Option<f64>,
    supply_v: Option<f64>,
    anti_alias_hz: Option<f64>,
    content_crc32: u32,
    current: Channel,
    position: Channel,
    trace_crc32: u32,
    /// Its share of the room for waiting throws; given back when it is answered.
    pub(super) room: Option<OwnedSemaphorePermit>,
}

impl Spool {
    /// What it takes while it waits \[KiB\].
    pub(super) fn kib(&self) -> u32 {
        u32::try_from((self.current.data.len() + self.position.data.len()) / 1024 + 1).unwrap_or(u32::MAX)
    }

    pub(super) fn new(machine: &MachineId, throw: &Throw, received_at: Timestamp) -> Result<Self, StoreError> {
        let throw_no = i64::try_from(throw.id.throw_no).map_err(|_| StoreError::ThrowNumber(throw.id.throw_no))?;
        let trace_crc32 = codec::checksum(throw.trace.current_a(), throw.trace.position_mm());
        Ok(Self {
            machine: machine.clone(),
            id: throw.id.clone(),
            throw_no,
            started_at_us: throw.started_at.as_microsecond(),
            received_at_us: received_at.as_microsecond(),
            direction: throw.direction,
            sample_rate_hz: throw.trace.sample_rate_hz(),
            samples: i64::try_from(throw.trace.len()).unwrap_or(i64::MAX),
            temperature_c: throw.temperature_c,
            supply_v: throw.supply_v,
            anti_alias_hz: throw.anti_alias_hz,
            content_crc32: content_checksum(throw, trace_crc32),
            current: codec::encode(throw.trace.current_a()),
            position: codec::encode(throw.trace.position_mm()),
            trace_crc32,
            room: None,
        })
    }

    async fn insert(
        &self,
        connection: &mut SqliteConnection,
        machine_row: i64,
        boot_row: i64,
    ) -> sqlx::Result<ThrowRow> {
        let row: i64 = sqlx::query_scalar(sql::ADD_THROW)
            .bind(machine_row)
            .bind(boot_row)
            .bind(self.throw_no)
            .bind(self.started_at_us)
            .bind(self.received_at_us)
            .bind(self.direction.map(Direction::as_str))
            .bind(self.sample_rate_hz)
            .bind(self.samples)
            .bind(self.temperature_c)
            .bind(self.supply_v)
            .bind(self.anti_alias_hz)
            .bind(self.content_crc32)
            .fetch_one(&mut *connection)
            .await?;
        sqlx::query(sql::ADD_TRACE)
            .bind(row)
            .bind(&self.current.codec)
            .bind(&self.current.data)
            .bind(&self.position.codec)
            .bind(&self.position.data)
            .bind(self.trace_crc32)
            .execute(connection)
            .await?;
        Ok(ThrowRow(row))
    }

    /// The throw's number is stored already. After an unknown commit that may be our own doing.
    async fn already_there(
        &self,
        connection: &mut SqliteConnection,
        stored: Stored,
        repeated: bool,
    ) -> sqlx::Result<Spooled> {
        let same = stored.content_crc32 == self.content_crc32;
        if same && repeated && stored.received_at_us == self.received_at_us {
            return Ok(Spooled::New(ThrowRow(stored.throw_row)));
        }
        if !same {
            count(connection, "contradicted_throws", 1).await?;
        }
        Ok(Spooled::Duplicate { differs: !same })
    }
}

/// CRC-32 over all that the logger said of the throw.
fn content_checksum(throw: &Throw, trace_crc32: u32) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&trace_crc32.to_le_bytes());
    hasher.update(&throw.started_at.as_microsecond().to_le_bytes());
    hasher.update(throw.direction.map_or("", Direction::as_str).as_bytes());
    for value in [Some(throw.trace.sample_rate_hz()), throw.temperature_c, throw.supply_v, throw.anti_alias_hz] {
        hasher.update(&[u8::from(value.is_some())]);
        hasher.update(&value.unwrap_or_default().to_le_bytes());
    }
    hasher.finalize()
}

#[derive(sqlx::FromRow)]
struct Stored {
    throw_row: i64,
    content_crc32: u32,
    received_at_us: i64,
}

#[derive(sqlx::FromRow)]
struct KnownBoot {
    boot_row: i64,
    highest_no: i64,
    pruned_to_no: i64,
}

impl Write for Spool {
    type Output = Spooled;

    async fn run(&self, connection: &mut SqliteConnection, repeated: bool) -> sqlx::Result<Spooled> {
        let (machine_row, known) = machine_row(connection, &self.machine).await?;
        let Some(boot) = boot(connection, machine_row, &self.id.boot_id).await? else {
            let boot = NewBoot { machine_row, known, boot_id: &self.id.boot_id, at_us: self.received_at_us };
            let boot_row = boot.begin(connection, self.throw_no).await?;
            return self.insert(connection, machine_row, boot_row).await.map(Spooled::New);
        };
        let stored: Option<Stored> = sqlx::query_as(sql::STORED)
            .bind(boot.boot_row)
            .bind(self.throw_no)
            .fetch_optional(&mut *connection)
            .await?;
        if let Some(stored) = stored {
            return self.already_there(connection, stored, repeated).await;
        }
        if self.throw_no > boot.highest_no {
            let missing = (boot.highest_no + 1, self.throw_no - 1);
            add_gap(connection, boot.boot_row, missing, GapKind::Missed, self.received_at_us).await?;
            set_highest(connection, boot.boot_row, self.throw_no).await?;
        } else if !fill_gap(connection, boot.boot_row, self.throw_no, self.received_at_us).await?
            && self.throw_no <= boot.pruned_to_no
        {
            return Ok(Spooled::Duplicate { differs: false });
        }
        self.insert(connection, machine_row, boot.boot_row).await.map(Spooled::New)
    }
}

/// The row of a machine, and whether it was there before.
pub(super) async fn machine_row(connection: &mut SqliteConnection, id: &MachineId) -> sqlx::Result<(i64, bool)> {
    let (site, machine) = (id.site.as_str(), id.machine.as_str());
    let row: Option<i64> =
        sqlx::query_scalar(sql::MACHINE).bind(site).bind(machine).fetch_optional(&mut *connection).await?;
    if let Some(row) = row {
        return Ok((row, true));
    }
    let row = sqlx::query_scalar(sql::ADD_MACHINE).bind(site).bind(machine).fetch_one(connection).await?;
    Ok((row, false))
}

/// Adds to a lasting total.
pub(super) async fn count(connection: &mut SqliteConnection, name: &str, more: i64) -> sqlx::Result<()> {
    sqlx::query(sql::COUNT).bind(name).bind(more).execute(connection).await.map(drop)
}

async fn boot(connection: &mut SqliteConnection, machine_row: i64, boot_id: &str) -> sqlx::Result<Option<KnownBoot>> {
    sqlx::query_as(sql::BOOT).bind(machine_row).bind(boot_id).fetch_optional(connection).await
}

/// A start of a logger that is heard for the first time.
struct NewBoot<'a> {
    machine_row: i64,
    known: bool,
    boot_id: &'a str,
    at_us: i64,
}

impl NewBoot<'_> {
    /// Adds it, with a gap for the throws before the first one heard. Numbers start at 1, unless this logger is
    /// known to start at 0.
    async fn begin(&self, connection: &mut SqliteConnection, heard_no: i64) -> sqlx::Result<i64> {
        let boot_row = sqlx::query_scalar(sql::ADD_BOOT)
            .bind(self.machine_row)
            .bind(self.boot_id)
            .bind(self.at_us)
            .bind(heard_no)
            .fetch_one(&mut *connection)
            .await?;
        let from_zero: bool =
            sqlx::query_scalar(sql::COUNTS_FROM_ZERO).bind(self.machine_row).fetch_one(&mut *connection).await?;
        let kind = if self.known { GapKind::Missed } else { GapKind::BeforeFirstContact };
        add_gap(connection, boot_row, (i64::from(!from_zero), heard_no - 1), kind, self.at_us).await?;
        Ok(boot_row)
    }
}

async fn set_highest(connection: &mut SqliteConnection, boot_row: i64, throw_no: i64) -> sqlx::Result<()> {
    sqlx::query(sql::SET_HIGHEST).bind(boot_row).bind(throw_no).execute(connection).await.map(drop)
}

/// Adds the gap from the first to the last number, both included; nothing when that is empty.
async fn add_gap(
    connection: &mut SqliteConnection,
    boot_row: i64,
    (first_no, last_no): (i64, i64),
    kind: GapKind,
    at_us: i64,
) -> sqlx::Result<()> {
    if first_no > last_no {
        return Ok(());
    }
    let gap = sqlx::query(sql::ADD_GAP).bind(boot_row).bind(first_no).bind(last_no).bind(kind.as_str()).bind(at_us);
    gap.execute(connection).await.map(drop)
}

/// Takes a late throw out of its gap: from an end, or by splitting it. Returns whether there was one.
async fn fill_gap(connection: &mut SqliteConnection, boot_row: i64, throw_no: i64, at_us: i64) -> sqlx::Result<bool> {
    let gap: Option<(i64, i64, i64)> =
        sqlx::query_as(sql::GAP_AT).bind(boot_row).bind(throw_no).fetch_optional(&mut *connection).await?;
    let Some((gap_row, first_no, last_no)) = gap else { return Ok(false) };
    if first_no == last_no {
        sqlx::query(sql::FILL_GAP).bind(gap_row).bind(at_us).execute(connection).await?;
        return Ok(true);
    }
    let (first, last) = if throw_no == first_no { (first_no + 1, last_no) } else { (first_no, throw_no - 1) };
    if throw_no != first_no && throw_no != last_no {
        sqlx::query(sql::SPLIT_GAP).bind(gap_row).bind(throw_no + 1).execute(&mut *connection).await?;
    }
    sqlx::query(sql::SHRINK_GAP).bind(gap_row).bind(first).bind(last).execute(connection).await?;
    Ok(true)
}
