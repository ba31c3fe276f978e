//! Compares a database after a failure with the acknowledgements before it.
//!
//! Acknowledged are throws with a published health message, and alarm events that a subscriber received.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::RangeInclusive,
    path::Path,
};

use jiff::Timestamp;
use pointsd::{
    store::{Found, OutboxRow, Reader, Selector, Settings, Store, StoredThrow, ThrowRow, UnreadableTrace},
    throw::{MachineId, ThrowRef},
    wire::{self, Alarm, Encoding},
};

use crate::{logger, rig::Rig};

/// Defects of the databases after cuts.
#[derive(Debug, Default)]
pub(crate) struct Verdict {
    /// Missing acknowledged throws and alarm events, and alarm events that would never be published.
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
}

/// Machine, boot id and number of a throw.
type Key = (String, String, u64);

fn key(machine: &MachineId, throw: &ThrowRef) -> Key {
    (machine.machine.to_string(), throw.boot_id.clone(), throw.throw_no)
}

/// Opens the database in the same way as the daemon, and compares it with the acknowledgements.
pub(crate) async fn inspect(folder: &Path, acknowledged: &str, verdict: &mut Verdict) {
    let settings = Settings { path: folder.join("points.db"), ballast_mib: 0, low_disk_mib: 0, ..Settings::default() };
    let opened = match Store::open(&settings, Timestamp::UNIX_EPOCH).await {
        Ok(opened) if !matches!(opened.report.found, Found::SetAside { .. }) => opened,
        other => {
            verdict.unreadable += 1;
            return verdict
                .notes
                .push(other.map_or_else(|error| error.to_string(), |opened| format!("{:?}", opened.report)));
        }
    };
    let reader = opened.store.reader();
    let throws = reader.throws(ThrowRow::START, 1_000_000).await.unwrap();
    let judged = reader.health_history(&Selector::default(), Timestamp::UNIX_EPOCH, 1_000_000).await.unwrap();
    let judged: BTreeSet<_> = judged.iter().map(|row| key(&row.machine, &row.throw)).collect();
    let events = events(reader).await;
    let waiting = reader.outbox_pending(0, 1_000_000).await.unwrap();

    let mut times: BTreeMap<Key, usize> = BTreeMap::new();
    for stored in &throws {
        *times.entry(key(&stored.machine, &stored.id)).or_default() += 1;
        if matches!(stored.throw, Err(UnreadableTrace::Dropped)) {
            verdict.given_up += 1;
        } else if !is_as_published(stored) {
            verdict.unreadable += 1;
            verdict.notes.push(format!("throw {:?} of {} is altered", stored.id, stored.machine));
        }
    }
    verdict.duplicated += times.values().filter(|times| **times > 1).count();
    let mut received = BTreeSet::new();
    for line in acknowledged.lines() {
        match line.split(' ').collect::<Vec<_>>()[..] {
            ["throw", machine, boot_id, number] => {
                let key = (machine.to_owned(), boot_id.to_owned(), number.parse().unwrap());
                if !times.contains_key(&key) || !judged.contains(&key) {
                    verdict.lose(line.to_owned());
                }
            }
            ["event", alarm_id, number] => {
                let event = (alarm_id.to_owned(), number.parse().unwrap());
                if !events.contains(&event) {
                    verdict.lose(line.to_owned());
                }
                received.insert(event);
            }
            _ => panic!("{line:?}"),
        }
    }
    // Events that were not acknowledged must be in the outbox.
    let about: BTreeSet<(String, u32)> = waiting.iter().map(message).collect();
    verdict.duplicated += waiting.len() - about.len();
    for event in events.iter().filter(|event| !received.contains(event) && !about.contains(event)) {
        verdict.lose(format!("{event:?} would never be published"));
    }
    opened.store.close().await.unwrap();
}

pub(crate) async fn events(reader: &Reader) -> BTreeSet<(String, u32)> {
    let rows = reader.alarm_history(&Selector::default(), Timestamp::UNIX_EPOCH, 1_000_000).await.unwrap();
    rows.into_iter().map(|row| (row.alarm_id.clone(), row.event_no)).collect()
}

/// Machine, boot id and numbers of each open gap.
fn open_gaps(rig: &Rig) -> Vec<(String, String, RangeInclusive<u64>)> {
    let gaps = rig.sql(
        "SELECT machine, boot_id, first_throw_no AS first, last_throw_no AS last FROM data_gaps WHERE filled_at IS NULL",
    );
    let text = |gap: &serde_json::Value, of: &str| gap[of].as_str().unwrap().to_owned();
    let numbers = |gap: &serde_json::Value| gap["first"].as_u64().unwrap()..=gap["last"].as_u64().unwrap();
    gaps.iter().map(|gap| (text(gap, "machine"), text(gap, "boot_id"), numbers(gap))).collect()
}

/// Stored and missing throw numbers of each machine and boot id.
#[derive(Default)]
pub(crate) struct Known {
    pub(crate) stored: BTreeMap<(String, String), Vec<u64>>,
    pub(crate) missing: BTreeMap<(String, String), Vec<u64>>,
}

impl Known {
    pub(crate) async fn of(rig: &Rig, reader: &Reader) -> Self {
        let mut known = Self::default();
        for stored in reader.throws(ThrowRow::START, 1_000_000).await.unwrap() {
            let who = (stored.machine.machine.to_string(), stored.id.boot_id);
            known.stored.entry(who).or_default().push(stored.id.throw_no);
        }
        for (machine, boot_id, numbers) in open_gaps(rig) {
            known.missing.entry((machine, boot_id)).or_default().extend(numbers);
        }
        known
    }

    /// All numbers of a machine and boot id, in order.
    pub(crate) fn all(&self, who: &(String, String)) -> Vec<u64> {
        let parts = [self.stored.get(who), self.missing.get(who)];
        let mut all: Vec<u64> = parts.into_iter().flatten().flatten().copied().collect();
        all.sort_unstable();
        all
    }

    /// Whether numbers up to `last` are neither stored nor missing. The last number alone shows nothing: it may have
    /// arrived live while an earlier one is still being fetched from the backlog.
    pub(crate) fn is_behind(&self, who: &(String, String), last: u64) -> bool {
        (self.all(who).len() as u64) < last
    }
}

fn message(row: &OutboxRow) -> (String, u32) {
    let alarm: Alarm = serde_json::from_slice(&row.payload).unwrap();
    (alarm.alarm_id.clone(), alarm.event_no)
}

fn is_as_published(stored: &StoredThrow) -> bool {
    let made = logger::throw(&stored.id.boot_id, stored.id.throw_no);
    let published = wire::decode_throw(Encoding::Cbor, &wire::encode_throw(Encoding::Cbor, &made)).unwrap();
    stored.throw.as_ref().is_ok_and(|throw| throw.trace == published.trace)
}
