//! Compares a database after a failure with the acknowledgements before it.
//!
//! Each acknowledgement is a line: `stored` or `judged` with machine, boot id and number of a throw; `raised` or
//! `received` with alarm id and number of an alarm event. `received` means that a subscriber has the event.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use jiff::Timestamp;
use pointsd::{
    store::{Found, OutboxRow, Reader, Selector, Settings, Store, ThrowRow, UnreadableTrace},
    throw::{MachineId, ThrowRef, Trace},
    wire::Alarm,
};
use sqlx::{Connection, SqliteConnection, sqlite::SqliteConnectOptions};

/// Defects of the databases after failures.
#[derive(Debug, Default)]
pub(crate) struct Verdict {
    /// Acknowledged throws and alarm events that are missing, and alarm events that would never be published.
    pub(crate) lost: usize,
    pub(crate) duplicated: usize,
    pub(crate) unreadable: usize,
    /// Traces deleted for lack of space; their throws exist.
    pub(crate) given_up: usize,
    pub(crate) notes: Vec<String>,
}

impl Verdict {
    fn lose(&mut self, what: String) {
        self.lost += 1;
        self.notes.push(what);
    }

    fn cannot_read(&mut self, what: String) {
        self.unreadable += 1;
        self.notes.push(what);
    }
}

/// Machine, boot id and number of a throw.
type Key = (String, String, u64);

fn key(machine: &MachineId, throw: &ThrowRef) -> Key {
    (machine.machine.to_string(), throw.boot_id.clone(), throw.throw_no)
}

/// Opens the database in `folder` in the same way as the daemon, and compares it with the acknowledgements. `sent`
/// returns the trace that was published for a throw.
pub(crate) async fn inspect(
    folder: &Path,
    acknowledged: &str,
    sent: impl Fn(&ThrowRef) -> Trace,
    verdict: &mut Verdict,
) {
    let settings = Settings { path: folder.join("points.db"), ballast_mib: 0, low_disk_mib: 0, ..Settings::default() };
    let opened = match Store::open(&settings, Timestamp::UNIX_EPOCH).await {
        Ok(opened) if !matches!(opened.report.found, Found::SetAside { .. }) => opened,
        Ok(opened) => return verdict.cannot_read(format!("{:?}", opened.report)),
        Err(error) => return verdict.cannot_read(error.to_string()),
    };
    let damage = damage(&settings.path).await;
    if damage != ["ok"] {
        verdict.cannot_read(format!("{damage:?}"));
    }
    let reader = opened.store.reader();
    let throws = reader.throws(ThrowRow::START, 1_000_000).await.unwrap();
    let judged = reader.health_history(&Selector::default(), Timestamp::UNIX_EPOCH, 1_000_000).await.unwrap();
    let judged: BTreeSet<_> = judged.iter().map(|row| key(&row.machine, &row.throw)).collect();
    let events = events(reader).await;
    let messages = reader.outbox_pending(0, 1_000_000).await.unwrap();

    let mut times: BTreeMap<Key, usize> = BTreeMap::new();
    for stored in &throws {
        *times.entry(key(&stored.machine, &stored.id)).or_default() += 1;
        match &stored.throw {
            Ok(throw) if throw.trace == sent(&stored.id) => {}
            Err(UnreadableTrace::Dropped) => verdict.given_up += 1,
            altered => {
                verdict.cannot_read(format!("{:?} of {}: {:?}", stored.id, stored.machine, altered.as_ref().err()));
            }
        }
    }
    verdict.duplicated += times.values().filter(|times| **times > 1).count();
    let mut received = BTreeSet::new();
    for line in acknowledged.lines() {
        let is_there = match line.split(' ').collect::<Vec<_>>()[..] {
            [what @ ("stored" | "judged"), machine, boot_id, number] => {
                let key = (machine.to_owned(), boot_id.to_owned(), number.parse().unwrap());
                times.contains_key(&key) && (what == "stored" || judged.contains(&key))
            }
            [what @ ("raised" | "received"), alarm_id, number] => {
                let event = (alarm_id.to_owned(), number.parse().unwrap());
                let is_there = events.contains(&event);
                received.extend((what == "received").then_some(event));
                is_there
            }
            _ => panic!("{line:?}"),
        };
        if !is_there {
            verdict.lose(line.to_owned());
        }
    }
    let pending: BTreeSet<_> = messages.iter().map(message).collect();
    verdict.duplicated += messages.len() - pending.len();
    for event in events.iter().filter(|event| !received.contains(event) && !pending.contains(event)) {
        verdict.lose(format!("{event:?} would never be published"));
    }
    for event in pending.difference(&events) {
        verdict.lose(format!("{event:?} waits to be published, and is not stored"));
    }
    opened.store.close().await.unwrap();
}

/// The findings of SQLite's check, `ok` without damage.
async fn damage(database: &Path) -> Vec<String> {
    let options = SqliteConnectOptions::new().filename(database).read_only(true);
    let mut connection = SqliteConnection::connect_with(&options).await.unwrap();
    let findings = sqlx::query_scalar("PRAGMA integrity_check").fetch_all(&mut connection).await.unwrap();
    connection.close().await.unwrap();
    findings
}

/// Alarm id and number of every alarm event.
pub(crate) async fn events(reader: &Reader) -> BTreeSet<(String, u32)> {
    let rows = reader.alarm_history(&Selector::default(), Timestamp::UNIX_EPOCH, 1_000_000).await.unwrap();
    rows.into_iter().map(|row| (row.alarm_id.clone(), row.event_no)).collect()
}

fn message(row: &OutboxRow) -> (String, u32) {
    let alarm: Alarm = serde_json::from_slice(&row.payload).unwrap();
    (alarm.alarm_id.clone(), alarm.event_no)
}
