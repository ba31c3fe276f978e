//! The cursor of each machine: the last throw up to which every throw is stored or written off.
//!
//! Without missing throws the cursor is the newest throw and is not stored. While throws are awaited from the logger's
//! backlog, a row of the table `backlog` stores the cursor. A gap is awaited while the backlog may still fill it: until
//! it is filled or written off.

use sqlx::SqliteConnection;

use super::batch;
use crate::{
    store::statements as sql,
    throw::{MachineId, ThrowRef},
};

/// A position in the order of a machine's throws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, sqlx::FromRow)]
pub(crate) struct ThrowPosition {
    /// `None` before all throws.
    pub(crate) boot_row: Option<i64>,
    /// Position of the boot in the order of the machine's boots.
    pub(crate) position: i64,
    pub(crate) throw_no: i64,
}

/// The position before all throws.
impl Default for ThrowPosition {
    fn default() -> Self {
        Self { boot_row: None, position: i64::MIN, throw_no: -1 }
    }
}

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
    /// The place of `after` in the order of the machine's throws.
    pub(crate) at: ThrowPosition,
    /// The last stored throw. A gap after this throw opened later, so a query with this cursor does not write it off.
    pub(crate) newest: ThrowPosition,
}

impl Cursor {
    /// Whether this cursor comes later than another in the order of the machine's throws.
    pub(crate) fn is_after(&self, other: &Self) -> bool {
        (self.at.position, self.at.throw_no) > (other.at.position, other.at.throw_no)
    }
}

/// A boot of a logger.
#[derive(Debug, Clone, Copy, sqlx::FromRow)]
#[expect(clippy::struct_field_names, reason = "the name of the column")]
pub(crate) struct Boot {
    pub(crate) machine_row: i64,
    pub(crate) boot_row: i64,
    pub(crate) position: i64,
    pub(crate) highest_no: i64,
    pub(crate) pruned_to_no: i64,
    /// Whether the backlog may have later throws of this boot.
    pub(crate) tail_open: bool,
}

impl Boot {
    /// The position of a throw of this boot.
    pub(crate) fn at(&self, throw_no: i64) -> ThrowPosition {
        ThrowPosition { boot_row: Some(self.boot_row), position: self.position, throw_no }
    }

    /// The position of the throw with the highest number.
    pub(crate) fn last(&self) -> ThrowPosition {
        self.at(self.highest_no)
    }
}

/// The stored cursor of a machine; `None` without missing throws.
pub(crate) async fn stored(connection: &mut SqliteConnection, machine_row: i64) -> sqlx::Result<Option<ThrowPosition>> {
    sqlx::query_as(sql::BACKLOG).bind(machine_row).fetch_optional(connection).await
}

/// Opens the backlogs of machines, each with its cursor and the time, unless they are open already.
pub(crate) async fn open(
    connection: &mut SqliteConnection,
    backlogs: &[(i64, ThrowPosition, i64)],
) -> sqlx::Result<()> {
    let mut open = batch::query(sql::OPEN_BACKLOGS, backlogs.len());
    for &(machine_row, ThrowPosition { boot_row, position, throw_no }, at_us) in backlogs {
        open = open.bind(machine_row).bind(boot_row).bind(position).bind(throw_no).bind(at_us);
    }
    open.execute(connection).await.map(drop)
}

/// The boot after a position.
pub(super) async fn next_boot(
    connection: &mut SqliteConnection,
    machine_row: i64,
    position: i64,
) -> sqlx::Result<Option<Boot>> {
    sqlx::query_as(sql::NEXT_BOOT).bind(machine_row).bind(position).fetch_optional(connection).await
}

/// First and last throw number of the first awaited gap of a boot; `None` if no gap is awaited.
pub(crate) async fn awaited(connection: &mut SqliteConnection, boot_row: i64) -> sqlx::Result<Option<(i64, i64)>> {
    sqlx::query_as(sql::FIRST_AWAITED).bind(boot_row).fetch_optional(connection).await
}

/// Moves the cursor of a machine over stored and written-off throws; closes the backlog if no throw is awaited any
/// more.
pub(super) async fn advance(connection: &mut SqliteConnection, machine_row: i64, at_us: i64) -> sqlx::Result<()> {
    let Some(before) = stored(connection, machine_row).await? else { return Ok(()) };
    let mut cursor = before;
    let mut boot: Option<Boot> = match before.boot_row {
        Some(row) => sqlx::query_as(sql::BOOT_OF_ROW).bind(row).fetch_optional(&mut *connection).await?,
        None => None,
    };
    loop {
        if let Some(boot) = boot {
            if let Some((first_no, _)) = awaited(connection, boot.boot_row).await? {
                cursor.throw_no = cursor.throw_no.max(first_no - 1);
                break;
            }
            cursor.throw_no = cursor.throw_no.max(boot.highest_no);
            if boot.tail_open {
                break;
            }
        }
        let Some(next) = next_boot(connection, machine_row, cursor.position).await? else {
            return sqlx::query(sql::CLOSE_BACKLOG).bind(machine_row).execute(connection).await.map(drop);
        };
        // The cursor names an existing throw, so it cannot enter a boot whose first throw is still awaited.
        if awaited(connection, next.boot_row).await?.is_some_and(|(first_no, _)| first_no <= 1) {
            break;
        }
        cursor = next.at(-1);
        boot = Some(next);
    }
    if cursor != before {
        let moved = sqlx::query(sql::MOVE_CURSOR).bind(machine_row).bind(cursor.boot_row).bind(cursor.position);
        moved.bind(cursor.throw_no).bind(at_us).execute(connection).await?;
    }
    Ok(())
}

/// The cursor after a throw of a page; it skips the throws that are stored already.
pub(super) async fn after(
    connection: &mut SqliteConnection,
    machine_row: i64,
    last: ThrowPosition,
) -> sqlx::Result<Cursor> {
    let newest = newest(connection, machine_row).await?;
    let Some(boot_row) = last.boot_row else { return Ok(Cursor { newest, ..Cursor::default() }) };
    let boot_id = sqlx::query_scalar(sql::BOOT_ID).bind(boot_row).fetch_one(&mut *connection).await?;
    let boot: Boot = sqlx::query_as(sql::BOOT_OF_ROW).bind(boot_row).fetch_one(&mut *connection).await?;
    let gap = awaited(connection, boot_row).await?;
    let samples: Option<i64> =
        sqlx::query_scalar(sql::NEWEST_SAMPLES).bind(boot_row).fetch_optional(&mut *connection).await?;
    let has_later = next_boot(connection, machine_row, boot.position).await?.is_some();
    let throw_no = gap.map_or(boot.highest_no, |(first_no, _)| first_no - 1).max(last.throw_no);
    Ok(Cursor {
        after: Some(ThrowRef { boot_id, throw_no: throw_no.cast_unsigned() }),
        missing: gap.map(|(first_no, last_no)| last_no.abs_diff(first_no).saturating_add(1)),
        awaits: gap.is_some() || has_later,
        samples: samples.map(i64::cast_unsigned),
        at: boot.at(throw_no),
        newest,
    })
}

/// The last throw of the last boot.
async fn newest(connection: &mut SqliteConnection, machine_row: i64) -> sqlx::Result<ThrowPosition> {
    let boot: Option<Boot> = sqlx::query_as(sql::LAST_BOOT).bind(machine_row).fetch_optional(connection).await?;
    Ok(boot.as_ref().map(Boot::last).unwrap_or_default())
}

/// The cursor of a machine.
pub(crate) async fn current(connection: &mut SqliteConnection, machine: &MachineId) -> sqlx::Result<Cursor> {
    let row: Option<(i64, bool)> = sqlx::query_as(sql::MACHINE_BACKLOG)
        .bind(machine.site.as_str())
        .bind(machine.machine.as_str())
        .fetch_optional(&mut *connection)
        .await?;
    let Some((machine_row, is_read)) = row else { return Ok(Cursor::default()) };
    let open = stored(connection, machine_row).await?;
    let place = match open {
        Some(place) => place,
        None => newest(connection, machine_row).await?,
    };
    let cursor = Cursor { awaits: open.is_some(), ..after(connection, machine_row, place).await? };
    Ok(if is_read { cursor } else { Cursor { after: None, missing: None, at: ThrowPosition::default(), ..cursor } })
}
