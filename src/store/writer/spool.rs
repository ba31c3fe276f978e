//! Storage of received throws, each once, and of gaps for the missing numbers.

use std::collections::HashSet;

use jiff::Timestamp;
use sqlx::{Row as _, SqliteConnection};

use super::{
    batch,
    cursor::{self, Boot, ThrowPosition},
    write::Write,
};
use crate::{
    store::{
        codec::{self, Channel, Checksums, reverse_checksum},
        rows::{GapKind, RENUMBERED, ThrowRow, from_json},
        statements as sql,
    },
    throw::{Direction, MachineId, Throw},
};

/// The result of storing a throw.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spooled {
    /// Stored, with this row number.
    New(ThrowRow),
    /// Stored before, and perhaps deleted by retention since.
    Duplicate,
}

/// A throw with its machine and the time of reception.
#[derive(Debug, Clone, PartialEq)]
pub struct ReceivedThrow {
    /// The machine.
    pub machine: MachineId,
    /// The throw.
    pub throw: Throw,
    /// Time of reception.
    pub received_at: Timestamp,
}

/// A throw to store.
pub(crate) struct Spool {
    machine: MachineId,
    throw: Throw,
    received_at_us: i64,
    content_crc32: u32,
    current: Channel,
    position: Channel,
    trace_crc32: u32,
    /// Detects repeated traces: CRC-32 of the current in the upper half, of the position in the lower half (without a
    /// position: of the reversed current).
    trace_hash: i64,
}

impl Spool {
    pub(crate) fn new(ReceivedThrow { machine, throw, received_at }: ReceivedThrow) -> Self {
        let checksums = Checksums::of(throw.trace.current_a(), throw.trace.position_mm());
        let has_position = throw.trace.has_position();
        let lower_half = if has_position { checksums.channels[1] } else { reverse_checksum(throw.trace.current_a()) };
        Self {
            machine,
            received_at_us: received_at.as_microsecond(),
            content_crc32: content_checksum(&throw, checksums.both),
            current: codec::encode(throw.trace.current_a()),
            position: codec::encode(throw.trace.position_mm()),
            trace_crc32: checksums.both,
            // With 64 bits, two different traces of a machine do not get the same value by chance.
            trace_hash: (i64::from(checksums.channels[0]) << 32) | i64::from(lower_half),
            throw,
        }
    }

    async fn insert(&self, connection: &mut SqliteConnection, boot: Boot, throw_no: i64) -> sqlx::Result<ThrowRow> {
        let Boot { machine_row, boot_row, position, highest_no, .. } = boot;
        let place = Placed { throw: self, machine_row, boot_row, position, highest_no, throw_no };
        insert(connection, &[place]).await
    }

    /// Handles a throw whose number is stored already. It may be the same throw. If the logger restarted its numbers
    /// with the same `boot_id`, it is another throw, which is stored under the next number of a separate boot.
    async fn store_again(
        &self,
        connection: &mut SqliteConnection,
        taken: Stored,
        boot: Boot,
        repeated: bool,
    ) -> sqlx::Result<Spooled> {
        if taken.content_crc32 == self.content_crc32 {
            // If an earlier attempt was committed although it returned an error, the stored throw is this one.
            let is_own = repeated && taken.received_at_us == self.received_at_us;
            return Ok(if is_own { Spooled::New(ThrowRow(taken.throw_row)) } else { Spooled::Duplicate });
        }
        self.store_renumbered(connection, boot).await
    }

    /// Stores another throw under a number that is taken: under the next number of a separate boot.
    async fn store_renumbered(&self, connection: &mut SqliteConnection, boot: Boot) -> sqlx::Result<Spooled> {
        let boot_id = format!("{}{RENUMBERED}", self.throw.id.boot_id);
        let again = if let Some(again) = self::boot(connection, boot.machine_row, &boot_id).await? {
            again
        } else {
            // The separate boot gets a position before that of the real boot: backlog queries take the boot with the
            // highest position as the last one.
            let position = boot.position.saturating_sub(SPACING / 2);
            let new = NewBoot { boot_id: &boot_id, position, highest_no: 0, tail_open: false };
            add_boot(connection, boot.machine_row, new, self.received_at_us).await?
        };
        let same: Option<i64> = sqlx::query_scalar(sql::SAME_CONTENT)
            .bind(boot.machine_row)
            .bind(self.trace_hash)
            .bind(self.content_crc32)
            .bind(again.boot_row)
            .fetch_optional(&mut *connection)
            .await?;
        if same.is_some() {
            return Ok(Spooled::Duplicate);
        }
        count(connection, "contradicted_throws", 1).await?;
        // A logger may send this `boot_id` itself, with the highest number: then SQLite refuses the throw.
        let throw_no = again.highest_no.saturating_add(1);
        // The throw was recorded after the stored throws of the real boot, so it is judged after them.
        let judged_as = Boot { position: boot.position.saturating_add(SPACING / 2), ..again };
        self.insert(connection, judged_as, throw_no).await.map(Spooled::New)
    }
}

/// CRC-32 of the whole throw except its boot and number.
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

/// A throw with its place among the throws of its machine.
struct Placed<'a> {
    throw: &'a Spool,
    machine_row: i64,
    boot_row: i64,
    position: i64,
    /// Highest number of the boot so far.
    highest_no: i64,
    throw_no: i64,
}

/// Adds throws of different machines, with gaps for the missing numbers before them, their traces and the highest
/// numbers of their boots. Returns the row of the first throw. The rows of the others follow without gaps: there is one
/// writer, and no row number is used again.
async fn insert(connection: &mut SqliteConnection, places: &[Placed<'_>]) -> sqlx::Result<ThrowRow> {
    let (mut gaps, mut backlogs) = (Vec::new(), Vec::new());
    for &Placed { throw, machine_row, boot_row, position, highest_no, throw_no } in places {
        if highest_no < throw_no - 1 {
            let missing = (highest_no + 1, throw_no - 1);
            gaps.push(NewGap { boot_row, missing, kind: GapKind::Missed, at_us: throw.received_at_us });
            let last = ThrowPosition { boot_row: Some(boot_row), position, throw_no: highest_no };
            backlogs.push((machine_row, last, throw.received_at_us));
        }
    }
    if !gaps.is_empty() {
        add_gaps(connection, &gaps).await?;
        cursor::open(connection, &backlogs).await?;
    }
    let mut add = batch::query(sql::ADD_THROWS, places.len());
    for &Placed { throw: spool, machine_row, boot_row, position, throw_no, .. } in places {
        let throw = &spool.throw;
        add = add
            .bind(machine_row)
            .bind(boot_row)
            .bind(position)
            .bind(throw_no)
            .bind(throw.started_at.as_microsecond())
            .bind(spool.received_at_us)
            .bind(throw.direction.map(Direction::as_str))
            .bind(throw.trace.sample_rate_hz())
            .bind(i64::try_from(throw.trace.len()).unwrap_or(i64::MAX))
            .bind(throw.temperature_c)
            .bind(throw.supply_v)
            .bind(throw.anti_alias_hz)
            .bind(spool.content_crc32)
            .bind(spool.trace_hash);
    }
    let added = add.execute(&mut *connection).await?;
    let count = places.len() as u64;
    if added.rows_affected() != count {
        return Err(sqlx::Error::RowNotFound);
    }
    let first = added.last_insert_rowid() - count.cast_signed() + 1;
    let mut add = batch::query(sql::ADD_TRACES, places.len());
    for (row, Placed { throw, .. }) in (first..).zip(places) {
        add = add
            .bind(row)
            .bind(&throw.current.codec)
            .bind(&throw.current.data)
            .bind(&throw.position.codec)
            .bind(&throw.position.data)
            .bind(throw.trace_crc32);
    }
    add.execute(&mut *connection).await?;
    Ok(ThrowRow(first))
}

/// Received throws.
pub(crate) struct Spools(pub(crate) Vec<Spool>);

impl Write for Spools {
    type Output = Vec<Spooled>;

    async fn run(&self, connection: &mut SqliteConnection, repeated: bool) -> sqlx::Result<Vec<Spooled>> {
        let mut spooled = Vec::with_capacity(self.0.len());
        for throws in self.0.chunks(batch::MAX_ROWS) {
            let in_sequence = in_sequence(connection, throws).await?;
            let mut together = in_sequence.iter().peekable();
            let mut row =
                if in_sequence.is_empty() { ThrowRow::START } else { insert(connection, &in_sequence).await? };
            for throw in throws {
                if together.next_if(|place| std::ptr::eq(place.throw, throw)).is_some() {
                    spooled.push(Spooled::New(row));
                    row.0 += 1;
                    continue;
                }
                let (result, boot) = throw.store(connection, repeated, None).await?;
                cursor::advance(connection, boot.machine_row, throw.received_at_us).await?;
                spooled.push(result);
            }
        }
        Ok(spooled)
    }
}

/// The throws that are inserted together: of each machine its first throw here that is later than all stored ones of its
/// boot and leaves the cursor where it is, or that has the number 1 if the machine is new.
async fn in_sequence<'a>(connection: &mut SqliteConnection, throws: &'a [Spool]) -> sqlx::Result<Vec<Placed<'a>>> {
    let found = next_of_known_boots(connection, throws).await?;
    let is_found = |throw: &Spool| found.iter().any(|place| std::ptr::eq(place.throw, throw));
    let first: Vec<&Spool> = throws.iter().filter(|throw| throw.throw_no() == FIRST_NO && !is_found(throw)).collect();
    if !first.is_empty() && add_new_machines(connection, &first).await? > 0 {
        return next_of_known_boots(connection, throws).await;
    }
    Ok(found)
}

/// The throws of [`in_sequence`] whose boots are known.
async fn next_of_known_boots<'a>(
    connection: &mut SqliteConnection,
    throws: &'a [Spool],
) -> sqlx::Result<Vec<Placed<'a>>> {
    let mut find = batch::query(sql::NEXT_THROWS, throws.len());
    for (at, throw) in (0_i64..).zip(throws) {
        let MachineId { site, machine } = &throw.machine;
        find = find.bind(at).bind(site.as_str()).bind(machine.as_str());
        find = find.bind(&throw.throw.id.boot_id).bind(throw.throw_no());
    }
    // The columns of the statement, in its order.
    let found: Vec<(usize, i64, i64, i64, i64)> = from_json(find.fetch_one(connection).await?.try_get(0)?)?;
    let mut machines = HashSet::new();
    let first = found.into_iter().filter_map(|(at, machine_row, boot_row, position, highest_no)| {
        let throw = &throws[at];
        let throw_no = throw.throw_no();
        let place = Placed { throw, machine_row, boot_row, position, highest_no, throw_no };
        machines.insert(machine_row).then_some(place)
    });
    Ok(first.collect())
}

/// Adds the new machines among those of the throws `first`, each with the boot of its throw. Returns the number of
/// added machines. When the loggers of a large fleet start, 64 throws need three statements here, instead of ten each.
async fn add_new_machines(connection: &mut SqliteConnection, first: &[&Spool]) -> sqlx::Result<u64> {
    let mut machines = batch::query(sql::ADD_NEW_MACHINES, first.len());
    for throw in first {
        machines = machines.bind(throw.machine.site.as_str()).bind(throw.machine.machine.as_str());
    }
    let added = machines.execute(&mut *connection).await?.rows_affected();
    if added > 0 {
        let mut boots = batch::query(sql::ADD_FIRST_BOOTS, first.len());
        for throw in first {
            boots = boots.bind(throw.machine.site.as_str()).bind(throw.machine.machine.as_str());
            boots = boots.bind(&throw.throw.id.boot_id).bind(throw.received_at_us).bind(SPACING);
        }
        boots.execute(connection).await?;
    }
    Ok(added)
}

impl Spool {
    /// Sequence number of the throw; the decoder of messages accepts none above `i64::MAX`.
    pub(crate) fn throw_no(&self) -> i64 {
        self.throw.id.throw_no.cast_signed()
    }

    /// Stores the throw, and a gap for the missing numbers before it; also returns the boot of the throw. A new boot of
    /// a live throw is the last one of the machine, as a logger sends live throws of its newest boot only. A new boot in
    /// a backlog follows right after the boot at the position `after`.
    pub(crate) async fn store(
        &self,
        connection: &mut SqliteConnection,
        repeated: bool,
        after: Option<i64>,
    ) -> sqlx::Result<(Spooled, Boot)> {
        let machine_row = machine_row(connection, &self.machine).await?;
        let boot_id = &self.throw.id.boot_id;
        let (spooled, boot) = if let Some(boot) = boot(connection, machine_row, boot_id).await? {
            (self.store_in(connection, boot, repeated).await?, boot)
        } else {
            let boot = self.begin_boot(connection, machine_row, after).await?;
            (Spooled::New(self.insert(connection, boot, self.throw_no()).await?), boot)
        };
        if self.throw_no() == 0 {
            sqlx::query(sql::SET_COUNTS_FROM_ZERO).bind(machine_row).execute(connection).await?;
        }
        Ok((spooled, boot))
    }

    async fn store_in(&self, connection: &mut SqliteConnection, boot: Boot, repeated: bool) -> sqlx::Result<Spooled> {
        let throw_no = self.throw_no();
        let stored = sqlx::query_as(sql::STORED).bind(boot.boot_row).bind(throw_no);
        if let Some(stored) = stored.fetch_optional(&mut *connection).await? {
            return self.store_again(connection, stored, boot, repeated).await;
        }
        if throw_no <= boot.highest_no
            && !fill_gap(connection, boot.boot_row, throw_no, self.received_at_us).await?
            && throw_no <= boot.pruned_to_no
        {
            // Retention deleted the throw with this number. A throw that was made after all others of its boot is
            // another one, of a logger that restarted its numbers.
            let latest = sqlx::query_scalar(sql::LATEST_START).bind(boot.boot_row);
            let latest: Option<i64> = latest.fetch_optional(&mut *connection).await?;
            if latest.is_none_or(|latest_us| self.throw.started_at.as_microsecond() <= latest_us) {
                return Ok(Spooled::Duplicate);
            }
            return self.store_renumbered(connection, boot).await;
        }
        self.insert(connection, boot, throw_no).await.map(Spooled::New)
    }

    /// Adds the boot of the throw, with a gap before the throw. Numbers start at 1, or at 0 for a machine that has sent a
    /// throw 0. If a boot begins with the number after the last one of the boot before, the numbers of this logger go on
    /// at a restart, and there is no gap. With a number below [`GOES_ON`] that may be chance: a logger that counts from 1
    /// lost the first throws of a boot as long as the one before.
    async fn begin_boot(
        &self,
        connection: &mut SqliteConnection,
        machine_row: i64,
        after: Option<i64>,
    ) -> sqlx::Result<Boot> {
        let (position, is_last) = new_position(connection, machine_row, after).await?;
        let before = sqlx::query_as(sql::BOOT_BEFORE).bind(machine_row).bind(position);
        let before: Option<Boot> = before.fetch_optional(&mut *connection).await?;
        let (first_no, at_us) = (self.throw_no(), self.received_at_us);
        let new = NewBoot { boot_id: &self.throw.id.boot_id, position, highest_no: first_no, tail_open: !is_last };
        let boot = add_boot(connection, machine_row, new, at_us).await?;
        let from_zero = sqlx::query_scalar(sql::COUNTS_FROM_ZERO).bind(machine_row);
        let from_zero: bool = from_zero.fetch_one(&mut *connection).await?;
        let kind = if before.is_some() { GapKind::Missed } else { GapKind::BeforeFirstContact };
        let goes_on = before.is_some_and(|before| before.highest_no >= GOES_ON && first_no - 1 == before.highest_no);
        let first_missing = if goes_on { first_no } else { i64::from(!from_zero) };
        let begins_later = first_missing < first_no;
        if begins_later {
            let missing = (first_missing, first_no - 1);
            add_gaps(connection, &[NewGap { boot_row: boot.boot_row, missing, kind, at_us }]).await?;
        }
        if let Some(before) = before {
            // The backlog may have more throws of the previous boot, and boots in between.
            sqlx::query(sql::OPEN_TAIL).bind(before.boot_row).execute(&mut *connection).await?;
            cursor::open(connection, &[(machine_row, before.last(), at_us)]).await?;
        } else if begins_later || !is_last {
            cursor::open(connection, &[(machine_row, ThrowPosition::default(), at_us)]).await?;
        }
        Ok(boot)
    }
}

/// The row of a machine, which is added if it is new.
pub(crate) async fn machine_row(connection: &mut SqliteConnection, id: &MachineId) -> sqlx::Result<i64> {
    let (site, machine) = (id.site.as_str(), id.machine.as_str());
    match sqlx::query_scalar(sql::MACHINE).bind(site).bind(machine).fetch_optional(&mut *connection).await? {
        Some(row) => Ok(row),
        None => sqlx::query_scalar(sql::ADD_MACHINE).bind(site).bind(machine).fetch_one(connection).await,
    }
}

/// Adds to a stored counter.
pub(crate) async fn count(connection: &mut SqliteConnection, name: &str, more: i64) -> sqlx::Result<()> {
    sqlx::query(sql::COUNT).bind(name).bind(more).execute(connection).await.map(drop)
}

pub(crate) async fn boot(
    connection: &mut SqliteConnection,
    machine_row: i64,
    boot_id: &str,
) -> sqlx::Result<Option<Boot>> {
    sqlx::query_as(sql::BOOT).bind(machine_row).bind(boot_id).fetch_optional(connection).await
}

/// Number of the first throw of a boot. Some loggers begin with 0: their first throw 0 sets `counts_from_zero`.
const FIRST_NO: i64 = 1;

/// Least last number of a boot with which the next boot may go on.
const GOES_ON: i64 = 10;

/// Distance between the positions of live boots. Boots that only the backlog has get positions in between.
pub(crate) const SPACING: i64 = 1 << 20;

/// The position of a new boot after the position `after` (`None`: after all boots), and whether it is the last boot.
async fn new_position(
    connection: &mut SqliteConnection,
    machine_row: i64,
    after: Option<i64>,
) -> sqlx::Result<(i64, bool)> {
    if let Some(after) = after
        && let Some(next) = cursor::next_boot(connection, machine_row, after).await?
    {
        let place = if after == i64::MIN { next.position.saturating_sub(SPACING) } else { after + 1 };
        if place < next.position {
            return Ok((place, false));
        }
    }
    let last: Option<Boot> = sqlx::query_as(sql::LAST_BOOT).bind(machine_row).fetch_optional(connection).await?;
    Ok((last.map_or(0, |last| last.position).saturating_add(SPACING), true))
}

/// A boot to add.
struct NewBoot<'a> {
    boot_id: &'a str,
    position: i64,
    highest_no: i64,
    /// Whether later throws of it may be in the backlog.
    tail_open: bool,
}

async fn add_boot(
    connection: &mut SqliteConnection,
    machine_row: i64,
    NewBoot { boot_id, position, highest_no, tail_open }: NewBoot<'_>,
    at_us: i64,
) -> sqlx::Result<Boot> {
    let boot_row = sqlx::query_scalar(sql::ADD_BOOT)
        .bind(machine_row)
        .bind(boot_id)
        .bind(at_us)
        .bind(highest_no)
        .bind(position)
        .bind(tail_open)
        .fetch_one(connection)
        .await?;
    Ok(Boot { machine_row, boot_row, position, highest_no, pruned_to_no: -1, tail_open })
}

/// A gap to add.
struct NewGap {
    boot_row: i64,
    /// The first and the last missing number.
    missing: (i64, i64),
    kind: GapKind,
    at_us: i64,
}

async fn add_gaps(connection: &mut SqliteConnection, new: &[NewGap]) -> sqlx::Result<()> {
    let mut add = batch::query(sql::ADD_GAPS, new.len());
    for NewGap { boot_row, missing: (first_no, last_no), kind, at_us } in new {
        add = add.bind(boot_row).bind(first_no).bind(last_no).bind(kind.as_ref()).bind(at_us);
    }
    add.execute(connection).await.map(drop)
}

/// Removes the number of a late throw from its gap: shortens, splits or fills the gap. Returns whether there was a gap.
async fn fill_gap(connection: &mut SqliteConnection, boot_row: i64, throw_no: i64, at_us: i64) -> sqlx::Result<bool> {
    let gap: Option<(i64, i64, i64)> =
        sqlx::query_as(sql::GAP_AT).bind(boot_row).bind(throw_no).fetch_optional(&mut *connection).await?;
    let Some((gap_row, first_no, last_no)) = gap.filter(|(.., last_no)| throw_no <= *last_no) else { return Ok(false) };
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
