//! Power cuts, and disks that fail.
//!
//! A worker process fills a database while a preloaded shim logs every write and sync, or makes some of them fail. The
//! power-cut test reconstructs the disk after a cut at any point of the log, with unsynced data dropped, kept or torn,
//! and opens the database. `POINTSD_CUTS` and `POINTSD_FAULTS` set the number of runs.

mod cuts;
mod faults;
#[path = "../../disk/replay.rs"]
mod replay;
#[path = "../../disk/shim.rs"]
mod shim;
mod worker;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use jiff::Timestamp;
use pointsd::store::{Found, Settings, Store, ThrowRow, UnreadableTrace};

use crate::given::{query, throw};

/// Acknowledgements of the worker.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Acknowledged {
    /// Machine and number of throws that were stored.
    throws: BTreeSet<(String, u64)>,
    /// Machine and number of judged throws.
    judged: BTreeSet<(String, u64)>,
    /// Alarm events: machine and event number.
    events: BTreeSet<(String, u64)>,
}

impl Acknowledged {
    fn of_lines(text: &str) -> Self {
        let mut acknowledged = Self::default();
        for line in text.lines() {
            let [what, machine, number] = line.split(' ').collect::<Vec<_>>()[..] else { panic!("{line:?}") };
            let set = match what {
                "throw" => &mut acknowledged.throws,
                "judged" => &mut acknowledged.judged,
                "event" => &mut acknowledged.events,
                other => panic!("{other}"),
            };
            set.insert((machine.to_owned(), number.parse().unwrap()));
        }
        acknowledged
    }
}

/// Defects of a database after a failure.
#[derive(Debug, Default)]
pub(crate) struct Verdict {
    lost: usize,
    duplicated: usize,
    unreadable: usize,
    /// Traces of judged throws that were dropped as the disk was full; their throws exist.
    given_up: usize,
    notes: Vec<String>,
}

/// Opens the database in `folder` in the same way as the daemon, and compares it with the acknowledgements.
async fn inspect(folder: &Path, acknowledged: &Acknowledged) -> Verdict {
    let mut verdict = Verdict::default();
    let settings = Settings { ballast_mib: 0, low_disk_mib: 0, ..crate::given::settings(folder) };
    let opened = match Store::open(&settings, Timestamp::UNIX_EPOCH).await {
        Ok(opened) => opened,
        Err(error) => return Verdict { unreadable: 1, notes: vec![error.to_string()], ..verdict },
    };
    if let Found::SetAside { why, .. } = &opened.report.found {
        return Verdict { unreadable: 1, notes: vec![why.clone()], ..verdict };
    }
    let store = opened.store;
    let sound: Vec<(String,)> = query(&store, "PRAGMA integrity_check").await;
    if sound != [("ok".to_owned(),)] {
        verdict.unreadable += 1;
        verdict.notes.push(format!("{sound:?}"));
    }
    let stored = store.reader().throws(ThrowRow::START, 100_000).await.unwrap();
    let mut times: BTreeMap<(String, u64), usize> = BTreeMap::new();
    for found in &stored {
        let key = (found.machine.machine.to_string(), found.id.throw_no);
        match &found.throw {
            Ok(read) if read.trace == throw("b1", key.1).trace => {}
            Err(UnreadableTrace::Dropped) => {
                verdict.given_up += 1;
                verdict.notes.push(format!("{key:?}: the trace was dropped"));
            }
            other => {
                verdict.unreadable += 1;
                verdict.notes.push(format!(
                    "{key:?}: {}",
                    other.as_ref().map_or_else(ToString::to_string, |_| "altered".to_owned())
                ));
            }
        }
        *times.entry(key).or_default() += 1;
    }
    verdict.duplicated += times.values().filter(|&&times| times > 1).count();
    verdict.lost += acknowledged.throws.iter().filter(|key| !times.contains_key(key)).count();

    let judged = pairs(&store, "SELECT machine, throw_no FROM health_history").await;
    let events = pairs(&store, "SELECT machine, event_no FROM alarm_events").await;
    let messages =
        pairs(&store, "SELECT CAST(payload AS TEXT) ->> 'machine', CAST(payload AS TEXT) ->> 'event_no' FROM outbox")
            .await;
    for (promised, found) in
        [(&acknowledged.judged, &judged), (&acknowledged.events, &events), (&acknowledged.events, &messages)]
    {
        verdict.lost += promised.iter().filter(|key| !found.contains(key)).count();
    }
    verdict.duplicated += messages.len() - messages.iter().collect::<BTreeSet<_>>().len();
    // Each event has its message.
    verdict.lost += events.iter().collect::<BTreeSet<_>>().symmetric_difference(&messages.iter().collect()).count();
    store.close().await.unwrap();
    verdict
}

async fn pairs(store: &Store, sql: &'static str) -> Vec<(String, u64)> {
    let rows: Vec<(String, i64)> = query(store, sql).await;
    rows.into_iter().map(|(machine, number)| (machine, number.cast_unsigned())).collect()
}
