//! The cursor of each machine: the last throw up to which every throw is stored or written off.
//!
//! Without missing throws the cursor is the newest throw and is not stored. While throws are awaited from the logger's
//! backlog, a row of the table `backlog` stores the cursor. A gap is awaited while the backlog may still fill it: until
//! it is filled or written off.

use sqlx::SqliteConnection;

use crate::store::statements as sql;

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

/// Opens the backlog of a machine with its cursor at `after`, unless the backlog is open already.
pub(crate) async fn open(
    connection: &mut SqliteConnection,
    machine_row: i64,
    after: ThrowPosition,
    at_us: i64,
) -> sqlx::Result<()> {
    let ThrowPosition { boot_row, position, throw_no } = after;
    let open =
        sqlx::query(sql::OPEN_BACKLOG).bind(machine_row).bind(boot_row).bind(position).bind(throw_no).bind(at_us);
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
