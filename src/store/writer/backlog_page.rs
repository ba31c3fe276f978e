//! Storage of a page of a logger's backlog: its throws, and gaps for the numbers that the backlog does not have.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::{
    cursor::{self, Boot, ThrowPosition},
    spool::{Spool, Spooled, boot, machine_row},
    write::Write,
};
use crate::{
    store::statements as sql,
    throw::{MachineId, ThrowRef},
};

/// The position for the next backlog query of a machine.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Cursor {
    /// The last throw up to which every throw is stored or written off; `None` to read from the oldest.
    pub after: Option<ThrowRef>,
    /// Number of throws missing right after `after`; `None` if unknown.
    pub missing: Option<u64>,
    /// Whether later throws are stored already, so that the backlog should have the throws in between.
    pub awaits: bool,
    /// Samples of the newest throw, to estimate the size of the next ones.
    pub samples: Option<u64>,
    /// The last stored throw. A gap after this throw opened later, so a query with this cursor does not write it off.
    pub(crate) newest: ThrowPosition,
}

/// Result of storing a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PageStored {
    /// Throws stored now.
    pub new: u64,
    /// Throws stored before.
    pub duplicates: u64,
    /// Position for the next query.
    pub cursor: Cursor,
}

/// A page, oldest throw first.
pub(crate) struct Page {
    pub(crate) machine: MachineId,
    /// The throw after which the query asked for the page; `None` for the oldest throws.
    pub(crate) after: Option<ThrowRef>,
    pub(crate) throws: Vec<Spool>,
    pub(crate) at: Timestamp,
}

impl Write for Page {
    type Output = PageStored;

    async fn run(&self, connection: &mut SqliteConnection, repeated: bool) -> sqlx::Result<PageStored> {
        let machine_row = machine_row(connection, &self.machine).await?;
        let at_us = self.at.as_microsecond();
        let mut last = ThrowPosition::default();
        if let Some(after) = &self.after
            && let Some(boot) = boot(connection, machine_row, &after.boot_id).await?
        {
            let throw_no = i64::try_from(after.throw_no).unwrap_or(i64::MAX);
            last = boot.at(throw_no);
        }
        let mut stored = PageStored { new: 0, duplicates: 0, cursor: Cursor::default() };
        for throw in &self.throws {
            let (spooled, boot) = throw.store(connection, repeated, Some(last.position)).await?;
            match spooled {
                Spooled::New(_) => stored.new += 1,
                Spooled::Duplicate => stored.duplicates += 1,
            }
            if last.boot_row != Some(boot.boot_row) {
                write_off_boots(connection, machine_row, (last.position, boot.position), at_us).await?;
            }
            last = boot.at(throw.throw_no());
            let gone = sqlx::query(sql::WRITE_OFF_BEFORE).bind(boot.boot_row).bind(last.throw_no).bind(at_us);
            gone.execute(&mut *connection).await?;
        }
        if self.after.is_none() {
            // The backlog was read from its start, so the cursor is valid from now on.
            sqlx::query(sql::SET_BACKLOG_READ).bind(machine_row).execute(&mut *connection).await?;
        }
        cursor::advance(connection, machine_row, at_us).await?;
        stored.cursor = after(connection, machine_row, last).await?;
        Ok(stored)
    }
}

/// Writes off the awaited gaps of the boot at position `from` and of the boots before position `to`, and expects no
/// later throws of them: the backlog does not have these.
async fn write_off_boots(
    connection: &mut SqliteConnection,
    machine_row: i64,
    (from, to): (i64, i64),
    at_us: i64,
) -> sqlx::Result<()> {
    let to = to.max(from.saturating_add(1));
    let gaps = sqlx::query(sql::WRITE_OFF_BOOTS).bind(machine_row).bind(from).bind(to).bind(at_us);
    gaps.execute(&mut *connection).await?;
    let tails = sqlx::query(sql::CLOSE_TAILS).bind(machine_row).bind(from).bind(to);
    tails.execute(connection).await.map(drop)
}

/// The cursor after a throw of a page; it skips the throws that are stored already.
async fn after(connection: &mut SqliteConnection, machine_row: i64, last: ThrowPosition) -> sqlx::Result<Cursor> {
    let newest = newest(connection, machine_row).await?;
    let Some(boot_row) = last.boot_row else { return Ok(Cursor { newest, ..Cursor::default() }) };
    let boot_id = sqlx::query_scalar(sql::BOOT_ID).bind(boot_row).fetch_one(&mut *connection).await?;
    let boot: Boot = sqlx::query_as(sql::BOOT_OF_ROW).bind(boot_row).fetch_one(&mut *connection).await?;
    let gap = cursor::awaited(connection, boot_row).await?;
    let samples: Option<i64> =
        sqlx::query_scalar(sql::NEWEST_SAMPLES).bind(boot_row).fetch_optional(&mut *connection).await?;
    let has_later = cursor::next_boot(connection, machine_row, boot.position).await?.is_some();
    let throw_no = gap.map_or(boot.highest_no, |(first_no, _)| first_no - 1).max(last.throw_no);
    Ok(Cursor {
        after: Some(ThrowRef { boot_id, throw_no: throw_no.cast_unsigned() }),
        missing: gap.map(|(first_no, last_no)| last_no.abs_diff(first_no).saturating_add(1)),
        awaits: gap.is_some() || has_later,
        samples: samples.map(i64::cast_unsigned),
        newest,
    })
}

/// The last throw of the last boot.
async fn newest(connection: &mut SqliteConnection, machine_row: i64) -> sqlx::Result<ThrowPosition> {
    let boot: Option<Boot> = sqlx::query_as(sql::LAST_BOOT).bind(machine_row).fetch_optional(connection).await?;
    Ok(boot.as_ref().map(Boot::last).unwrap_or_default())
}

/// Writes off the throws that were missing when a query was sent, as the backlog does not have them.
pub(crate) struct WriteOff {
    pub(crate) machine: MachineId,
    /// The last throw stored before the query.
    pub(crate) newest: ThrowPosition,
    pub(crate) at: Timestamp,
}

impl Write for WriteOff {
    type Output = ();

    async fn run(&self, connection: &mut SqliteConnection, _repeated: bool) -> sqlx::Result<()> {
        let machine_row = machine_row(connection, &self.machine).await?;
        let at_us = self.at.as_microsecond();
        write_off_boots(connection, machine_row, (i64::MIN, self.newest.position), at_us).await?;
        let last = sqlx::query(sql::WRITE_OFF_BEFORE).bind(self.newest.boot_row).bind(self.newest.throw_no).bind(at_us);
        last.execute(&mut *connection).await?;
        cursor::advance(connection, machine_row, at_us).await
    }
}

/// The cursor of a machine.
pub(crate) async fn current(connection: &mut SqliteConnection, machine: &MachineId) -> sqlx::Result<Cursor> {
    let row: Option<(i64, bool)> = sqlx::query_as(sql::MACHINE_BACKLOG)
        .bind(machine.site.as_str())
        .bind(machine.machine.as_str())
        .fetch_optional(&mut *connection)
        .await?;
    let Some((machine_row, is_read)) = row else { return Ok(Cursor::default()) };
    let open = cursor::stored(connection, machine_row).await?;
    let place = match open {
        Some(place) => place,
        None => newest(connection, machine_row).await?,
    };
    let cursor = Cursor { awaits: open.is_some(), ..after(connection, machine_row, place).await? };
    Ok(if is_read { cursor } else { Cursor { after: None, missing: None, ..cursor } })
}
