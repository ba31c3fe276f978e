//! Copies the readable rows of a broken database into the new one, table by table.
//!
//! SQLite can read a b-tree from any key that is reachable through intact pages. So a table is copied in ranges of its
//! key. A range that fails is halved down to single keys, and only the keys that fail are lost. At the end, rows whose
//! parent row is lost are removed.

use std::{collections::BTreeMap, path::Path};

use sqlx::{AssertSqlSafe, Connection, SqliteConnection};

use super::{GRAFTED, LAYOUT, graft::graft, path::beside};
use crate::store::{error::is_full, statements::is_absent, writer::spool::SPACING};

/// Number of keys that one statement copies.
const RANGE: i64 = 1024;
/// Highest key that is tried in a table whose bounds cannot be read: such a table has far fewer rows.
const HIGHEST_TRIED: i64 = 1 << 20;
/// Largest key that is copied: 10,000 throws a second reach it in 800 years. A garbage row with the largest key of
/// SQLite would let no other row be added.
const LARGEST_KEY: i64 = 1 << 48;
/// Number of failed statements after which the rest of a table is skipped. They take a minute at most.
const MOST_FAILURES: u32 = 50_000;
/// Number of keys that are tried before the whole table counts as lost.
const PROBES: i64 = 64;

/// A table to copy.
struct Table {
    name: &'static str,
    key: &'static str,
    /// Condition for valid rows, as SQLite also returns rows of garbage. The texts of garbage rows often contain a NUL
    /// byte. Then `length`, which counts up to the NUL, is smaller than `octet_length`.
    sound: &'static str,
}

/// The tables in the order of their references. The traces are last: they are large, and the diagnosis does not need
/// them.
static TABLES: [Table; 15] = [
    Table {
        name: "machine",
        key: "machine_row",
        sound: "(site || machine) NOT GLOB '*[^A-Za-z0-9_-]*' AND octet_length(site || machine) = length(site || machine) \
                AND length(site) BETWEEN 1 AND 64 AND length(machine) BETWEEN 1 AND 64",
    },
    Table {
        name: "boot",
        key: "boot_row",
        sound: "boot_id NOT GLOB '*[^ -~]*' AND octet_length(boot_id) = length(boot_id)",
    },
    Table { name: "monitor", key: "machine_row", sound: "json_valid(snapshot)" },
    Table {
        name: "alarm",
        key: "alarm_row",
        sound: "(alarm_id || cause || state) NOT GLOB '*[^A-Za-z0-9_.-]*' AND octet_length(alarm_id) = length(alarm_id)",
    },
    Table {
        name: "alarm_event",
        key: "alarm_row",
        sound: "json_valid(payload) AND (severity || state) NOT GLOB '*[^a-z_]*'",
    },
    Table { name: "baseline", key: "baseline_row", sound: "direction IS NOT NULL" },
    Table {
        name: "outbox",
        key: "outbox_row",
        sound: "key NOT GLOB '*[^A-Za-z0-9_/-]*' AND json_valid(CAST(payload AS TEXT))",
    },
    Table { name: "notification", key: "notification_row", sound: "json_valid(payload)" },
    Table { name: "command", key: "command_row", sound: "json_valid(payload) AND command NOT GLOB '*[^a-z_]*'" },
    Table { name: "gap", key: "gap_row", sound: "kind IS NOT NULL" },
    Table { name: "backlog", key: "machine_row", sound: "since_us IS NOT NULL" },
    Table {
        name: "quarantine",
        key: "quarantine_row",
        sound: "(key || reason) NOT GLOB '*[^ -~]*' AND octet_length(key || reason) = length(key || reason)",
    },
    Table { name: "throw", key: "throw_row", sound: "samples > 0" },
    Table {
        name: "estimate",
        key: "throw_row",
        sound: "quality NOT GLOB '*[^a-z_]*' AND octet_length(quality) = length(quality)",
    },
    Table {
        name: "trace",
        key: "throw_row",
        sound: "current_codec IN ('packed-f32', 'pco-f32', 'pco-f64', 'raw-f64') \
                AND position_codec IN ('packed-f32', 'pco-f32', 'pco-f64', 'raw-f64')",
    },
];

/// The tables that are copied. If there is no space for them, a smaller extent is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Extent {
    #[default]
    All,
    WithoutTraces,
    /// The tables that the diagnosis needs, and the boots, without which the backlogs would be fetched again.
    Diagnosis,
}

impl Extent {
    pub(super) const LARGEST_FIRST: [Self; 3] = [Self::All, Self::WithoutTraces, Self::Diagnosis];

    fn tables(self) -> &'static [Table] {
        match self {
            Self::All => &TABLES,
            Self::WithoutTraces => &TABLES[..TABLES.len() - 1],
            Self::Diagnosis => &TABLES[..9],
        }
    }
}

/// Statements that also read machines and boots from the index of their names: a lost row would lose all its throws. A
/// boot gets a position in the order of the rows, ?1 apart from the next.
const FROM_INDEX: [&str; 2] = [
    "INSERT OR IGNORE INTO main.machine (machine_row, site, machine) \
     SELECT machine_row, site, machine FROM broken.machine INDEXED BY sqlite_autoindex_machine_1",
    "INSERT OR IGNORE INTO main.boot (boot_row, machine_row, boot_id, first_seen_us, position, highest_no) \
     SELECT boot_row, machine_row, boot_id, 0, boot_row * ?1, \
            coalesce((SELECT max(throw_no) FROM main.throw WHERE throw.boot_row = boot.boot_row), 0) \
     FROM broken.boot INDEXED BY sqlite_autoindex_boot_1",
];

/// Statements that remove rows whose parent row is lost. Then they complete the latest throws, which a trigger has filled
/// during the copy, and count the rows of each machine, as a machine from the index was copied after its throws.
const ORPHANS: [&str; 14] = [
    "DELETE FROM monitor WHERE machine_row NOT IN (SELECT machine_row FROM machine)",
    "DELETE FROM alarm WHERE machine_row NOT IN (SELECT machine_row FROM machine)",
    "DELETE FROM alarm_event WHERE alarm_row NOT IN (SELECT alarm_row FROM alarm)",
    "DELETE FROM baseline WHERE machine_row NOT IN (SELECT machine_row FROM machine)",
    "DELETE FROM command WHERE machine_row NOT IN (SELECT machine_row FROM machine)",
    "DELETE FROM boot WHERE machine_row NOT IN (SELECT machine_row FROM machine)",
    "DELETE FROM gap WHERE boot_row NOT IN (SELECT boot_row FROM boot)",
    "DELETE FROM backlog WHERE cursor_boot_row NOT IN (SELECT boot_row FROM boot) \
     OR machine_row NOT IN (SELECT machine_row FROM machine)",
    "DELETE FROM throw WHERE boot_row NOT IN (SELECT boot_row FROM boot) \
     OR machine_row NOT IN (SELECT machine_row FROM machine)",
    "DELETE FROM estimate WHERE throw_row NOT IN (SELECT throw_row FROM throw)",
    "DELETE FROM trace WHERE throw_row NOT IN (SELECT throw_row FROM throw)",
    concat!(
        "DELETE FROM latest WHERE throw_row NOT IN (SELECT throw_row FROM estimate) OR machine_row NOT IN \
         (SELECT machine.machine_row FROM machine LEFT JOIN monitor USING (machine_row) WHERE NOT ",
        is_absent!(),
        ")"
    ),
    concat!(
        "INSERT INTO latest (machine_row, direction, throw_row, start_us) \
         SELECT machine.machine_row, coalesce(estimate.direction, ''), max(throw_row), started_at_us \
         FROM estimate JOIN throw USING (machine_row, throw_row) JOIN machine USING (machine_row) \
         LEFT JOIN monitor USING (machine_row) WHERE NOT ",
        is_absent!(),
        " GROUP BY machine.machine_row, estimate.direction ON CONFLICT DO NOTHING"
    ),
    // As in migration 11.
    "UPDATE machine SET (throws, traces, stored_bytes) = (SELECT count(*), count(trace.throw_row), 800 * count(*) \
     + coalesce(sum(length(trace.current_data) + coalesce(length(trace.position_data), 0)), 0) \
     FROM throw LEFT JOIN trace USING (throw_row) WHERE throw.machine_row = machine.machine_row)",
];

/// Result of the recovery.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Salvaged {
    /// Number of copied rows of each table.
    pub rows: BTreeMap<&'static str, u64>,
    /// Number of unreadable rows of each table; for a table without readable rows, its whole range of keys.
    pub lost: BTreeMap<&'static str, u64>,
    /// The tables that were copied.
    extent: Extent,
}

impl Salvaged {
    /// Number of copied rows of a table.
    pub fn saved(&self, table: &str) -> u64 {
        self.rows.get(table).copied().unwrap_or(0)
    }

    /// Number of lost rows of a table.
    pub fn lost(&self, table: &str) -> u64 {
        self.lost.get(table).copied().unwrap_or(0)
    }

    /// One sentence for a person.
    pub fn text(&self) -> String {
        if self.saved("machine") == 0 {
            return "nothing of it could be read: every machine learns a new baseline".to_owned();
        }
        let part = |table, noun| match (self.saved(table), self.lost(table)) {
            (0, 0) => None,
            (saved, 0) => Some(format!("all {saved} {noun}")),
            (saved, lost) if lost >= HIGHEST_TRIED.unsigned_abs() => {
                Some(format!("{saved} {noun} (an unknown number lost)"))
            }
            (saved, lost) => Some(format!("{saved} {noun} ({lost} lost)")),
        };
        let parts = [
            part("monitor", "machines with their baselines and alarm states"),
            part("alarm", "alarms"),
            part("estimate", "estimates"),
            part("trace", "traces"),
        ];
        let saved: Vec<String> = parts.into_iter().flatten().collect();
        let left_out = match self.extent {
            Extent::All => "",
            Extent::WithoutTraces => ". Its traces were not copied, as there is too little space",
            Extent::Diagnosis => {
                ". Its throws, estimates and traces were not copied, as there is too little space. Throws that were not \
                 judged yet are among them"
            }
        };
        format!("what could be read is in the new one: {}{left_out}", saved.join(", "))
    }
}

/// Copies the readable rows of the tables in `extent` of the file `broken` into the new database `new`, which
/// `connection` has open.
///
/// # Errors
/// When the new database cannot be written.
pub(super) async fn salvage(
    connection: &mut SqliteConnection,
    broken: &Path,
    new: &Path,
    extent: Extent,
) -> sqlx::Result<Salvaged> {
    if attach(connection, broken).await {
        return copy_tables(connection, extent).await;
    }
    let grafted = beside(new, GRAFTED);
    match graft(connection, broken, &grafted, &beside(new, LAYOUT)).await {
        Ok(true) if attach(connection, &grafted).await => {}
        Ok(_) => return Ok(Salvaged::default()),
        // The rows of this file may be readable when there is space for its copy.
        Err(error) if is_full(&error) => return Err(error),
        Err(error) => {
            tracing::error!(%error, "the schema of the broken database cannot be replaced");
            return Ok(Salvaged::default());
        }
    }
    let salvaged = copy_tables(connection, extent).await?;
    std::fs::remove_file(grafted)?;
    Ok(salvaged)
}

/// Copies the readable rows of the attached database.
async fn copy_tables(connection: &mut SqliteConnection, extent: Extent) -> sqlx::Result<Salvaged> {
    let mut salvaged = Salvaged { extent, ..Salvaged::default() };
    sqlx::query("PRAGMA foreign_keys = OFF").execute(&mut *connection).await?;
    for table in extent.tables() {
        if let Some(columns) = columns(connection, table.name).await? {
            let lost = TableCopy { table, columns }.all(connection).await?;
            salvaged.lost.insert(table.name, lost);
        }
    }
    for copy in FROM_INDEX {
        // An error is ignored: the index may be broken too.
        let _ = sqlx::query(copy).bind(SPACING).execute(&mut *connection).await;
    }
    // The counters have a text as key, and fit into one page. An error is ignored: they may be lost.
    let _ =
        sqlx::query("INSERT OR IGNORE INTO main.counter SELECT * FROM broken.counter").execute(&mut *connection).await;
    for orphans in ORPHANS {
        sqlx::query(orphans).execute(&mut *connection).await?;
    }
    sqlx::query("PRAGMA foreign_keys = ON").execute(&mut *connection).await?;
    sqlx::query("DETACH broken").execute(&mut *connection).await?;
    for Table { name, .. } in &TABLES {
        let count = AssertSqlSafe(format!("SELECT count(*) FROM {name}"));
        let rows: i64 = sqlx::query_scalar(count).fetch_one(&mut *connection).await?;
        salvaged.rows.insert(name, rows.cast_unsigned());
    }
    Ok(salvaged)
}

/// Attaches the broken file read-only; without its log if the log cannot be read.
async fn attach(connection: &mut SqliteConnection, broken: &Path) -> bool {
    let path = broken.to_string_lossy().replace('%', "%25").replace('?', "%3f").replace('#', "%23").replace('\'', "''");
    for mode in ["mode=ro", "mode=ro&immutable=1"] {
        let attach = AssertSqlSafe(format!("ATTACH 'file:{path}?{mode}' AS broken"));
        if sqlx::query(attach).execute(&mut *connection).await.is_err() {
            continue;
        }
        if sqlx::query("SELECT count(*) FROM broken.sqlite_schema").execute(&mut *connection).await.is_ok() {
            return true;
        }
        if sqlx::query("DETACH broken").execute(&mut *connection).await.is_err() {
            return false;
        }
    }
    false
}

/// The columns of a table in both databases, as lists for INSERT and SELECT; `None` if the broken one has no such
/// table.
async fn columns(connection: &mut SqliteConnection, table: &str) -> sqlx::Result<Option<(String, String)>> {
    let of = |schema: &str| AssertSqlSafe(format!("SELECT name FROM pragma_table_info('{table}', '{schema}')"));
    let new: Vec<String> = sqlx::query_scalar(of("main")).fetch_all(&mut *connection).await?;
    let Ok(old) = sqlx::query_scalar::<_, String>(of("broken")).fetch_all(connection).await else { return Ok(None) };
    // These counters are computed again while rows are copied.
    let counted = ["throws", "traces", "stored_bytes", "traces_from"];
    let both: Vec<(&str, &str)> = new
        .iter()
        .filter(|column| table != "machine" || !counted.contains(&column.as_str()))
        .filter_map(|column| match column.as_str() {
            // Migration 10 renamed this column.
            "payload" if table == "baseline" && !old.contains(column) => Some(("payload", "details")),
            column => old.iter().any(|old| old == column).then_some((column, column)),
        })
        .collect();
    let (to, from): (Vec<_>, Vec<_>) = both.into_iter().unzip();
    Ok((!to.is_empty()).then(|| (to.join(", "), from.join(", "))))
}

/// The copy of one table.
struct TableCopy {
    table: &'static Table,
    columns: (String, String),
}

impl TableCopy {
    /// Copies the whole table; returns the number of lost keys.
    async fn all(&self, connection: &mut SqliteConnection) -> sqlx::Result<u64> {
        let (first, last) = self.bounds(connection).await;
        if self.has_no_root(connection, first, last).await {
            return Ok(HIGHEST_TRIED.unsigned_abs().max(last.abs_diff(first)));
        }
        let (mut lost, mut failures) = (0, 0);
        let mut start = first;
        while start <= last {
            // A damaged key may be far from all others, so ranges without rows are skipped.
            match self.next_key(connection, start).await {
                Ok(Some(next)) => start = next,
                Ok(None) => return Ok(lost),
                Err(_) => failures += 1,
            }
            let mut ranges = vec![(start, start.saturating_add(RANGE - 1).min(last))];
            while let Some((low, high)) = ranges.pop() {
                if failures > MOST_FAILURES {
                    return Ok(last.abs_diff(low).saturating_add(lost + 1));
                }
                if let Some(unsound) = self.range(connection, low, high).await? {
                    lost += unsound;
                    continue;
                }
                failures += 1;
                if low == high {
                    lost += 1;
                } else {
                    let middle = low + (high - low) / 2;
                    ranges.extend([(middle + 1, high), (low, middle)]);
                }
            }
            let Some(next) = start.checked_add(RANGE) else { break };
            start = next;
        }
        Ok(lost)
    }

    /// The lowest key of the table that is not below this one.
    async fn next_key(&self, connection: &mut SqliteConnection, from: i64) -> sqlx::Result<Option<i64>> {
        let Table { name, key, .. } = self.table;
        let next = format!("SELECT {key} FROM broken.{name} WHERE {key} >= ?1 ORDER BY {key} LIMIT 1");
        sqlx::query_scalar(AssertSqlSafe(next)).bind(from).fetch_optional(connection).await
    }

    /// Whether none of the tried keys is readable, which means that the root page of the table is broken.
    async fn has_no_root(&self, connection: &mut SqliteConnection, first: i64, last: i64) -> bool {
        let Table { name, key, .. } = self.table;
        let probe = format!("SELECT count(*) FROM broken.{name} WHERE {key} = ?1");
        for step in 0..PROBES {
            let at = first.saturating_add(last.saturating_sub(first) / PROBES * step);
            let found = sqlx::query(AssertSqlSafe(probe.clone())).bind(at).fetch_optional(&mut *connection).await;
            if found.is_ok() {
                return false;
            }
        }
        true
    }

    /// Lowest and highest key, as far as they can be read.
    async fn bounds(&self, connection: &mut SqliteConnection) -> (i64, i64) {
        let Table { name, key, .. } = self.table;
        let mut ask = async |question: String| {
            let answer = sqlx::query_scalar(AssertSqlSafe(question)).fetch_optional(&mut *connection).await;
            answer.ok().flatten().flatten()
        };
        let first: Option<i64> = ask(format!("SELECT min({key}) FROM broken.{name}")).await;
        let last = match ask(format!("SELECT max({key}) FROM broken.{name}")).await {
            Some(last) => Some(last),
            None if *key == "throw_row" => {
                ask("SELECT seq FROM broken.sqlite_sequence WHERE name = 'throw'".to_owned()).await
            }
            None => None,
        };
        (first.unwrap_or(0).max(0), last.unwrap_or(HIGHEST_TRIED).min(LARGEST_KEY))
    }

    /// Copies the valid rows of a range of keys and returns the number of invalid ones; `None` if a row cannot be read.
    async fn range(&self, connection: &mut SqliteConnection, low: i64, high: i64) -> sqlx::Result<Option<u64>> {
        let Self { table: Table { name, key, sound }, columns: (to, from) } = self;
        let rows = format!("FROM broken.{name} WHERE {key} BETWEEN ?1 AND ?2");
        let copy = format!("INSERT OR IGNORE INTO main.{name} ({to}) SELECT {from} {rows} AND ({sound})");
        let unsound = format!("SELECT count(*) {rows} AND ({sound}) IS NOT TRUE");
        let copied = sqlx::query(AssertSqlSafe(copy)).bind(low).bind(high).execute(&mut *connection).await;
        let counted = match copied {
            Ok(_) => sqlx::query_scalar(AssertSqlSafe(unsound)).bind(low).bind(high).fetch_one(&mut *connection).await,
            Err(error) => Err(error),
        };
        match counted {
            Ok(unsound) => Ok(Some(i64::cast_unsigned(unsound))),
            Err(error) if is_full(&error) || connection.ping().await.is_err() => Err(error),
            Err(_) => Ok(None),
        }
    }
}
