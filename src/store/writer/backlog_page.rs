//! Storage of a page of a logger's backlog: its throws, and gaps for the numbers that the backlog does not have.

use jiff::Timestamp;
use sqlx::SqliteConnection;

use super::{
    cursor::{self, Cursor, ThrowPosition},
    spool::{Spool, Spooled, boot, machine_row},
    write::Write,
};
use crate::{
    store::statements as sql,
    throw::{MachineId, ThrowRef},
};

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
pub(crate) struct BacklogPage {
    pub(crate) machine: MachineId,
    /// The throw after which the query asked for the page; `None` for the oldest throws.
    pub(crate) after: Option<ThrowRef>,
    pub(crate) throws: Vec<Spool>,
    pub(crate) at: Timestamp,
}

impl Write for BacklogPage {
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
        stored.cursor = cursor::after(connection, machine_row, last).await?;
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
