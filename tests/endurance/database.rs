//! The database of a daemon that runs with the test's logger: throws and gaps, and its state after a failure.

use std::{collections::BTreeMap, ops::RangeInclusive, path::Path};

use pointsd::{
    store::{Reader, ThrowRow},
    throw::Trace,
    wire::{self, Encoding},
};

use crate::{
    logger,
    rig::{PATIENCE, Rig, until},
    verdict::{self, Verdict},
};

/// Compares the database in `folder` with the acknowledgements.
pub(crate) async fn inspect(folder: &Path, acknowledged: &str, verdict: &mut Verdict) {
    verdict::inspect(folder, acknowledged, |id| published(&id.boot_id, id.throw_no), verdict).await;
}

/// The trace of a throw as it was published: CBOR carries 32-bit floats.
fn published(boot_id: &str, throw_no: u64) -> Trace {
    let message = wire::encode_throw(&logger::throw(boot_id, throw_no));
    wire::decode_throw(Encoding::Cbor, &message).unwrap().trace
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

/// Last published number of each machine and boot id.
pub(crate) type Published = BTreeMap<(String, String), u64>;

/// Stored and missing throw numbers of each machine and boot id.
#[derive(Default)]
pub(crate) struct Known {
    stored: BTreeMap<(String, String), Vec<u64>>,
    missing: BTreeMap<(String, String), Vec<u64>>,
}

impl Known {
    async fn of(rig: &Rig, reader: &Reader) -> Self {
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
    fn all(&self, who: &(String, String)) -> Vec<u64> {
        let parts = [self.stored.get(who), self.missing.get(who)];
        let mut all: Vec<u64> = parts.into_iter().flatten().flatten().copied().collect();
        all.sort_unstable();
        all
    }

    /// Prints the counts. Checks that each published throw is stored once, or missing once. No throw may be missing of
    /// the machines `m…`, whose loggers have a long backlog; the machine `f1` has a backlog of one throw.
    pub(crate) fn check(&self, published: &Published, what: &str) {
        let count = |numbers: &BTreeMap<(String, String), Vec<u64>>, prefix: char| -> usize {
            let chosen = numbers.iter().filter(|((machine, _), _)| machine.starts_with(prefix));
            chosen.map(|(_, numbers)| numbers.len()).sum()
        };
        println!(
            "{what}: {} throws stored, {} missing; of the machine with a backlog of one throw {} stored, {} missing",
            count(&self.stored, 'm'),
            count(&self.missing, 'm'),
            count(&self.stored, 'f'),
            count(&self.missing, 'f')
        );
        for (who, last) in published {
            assert_eq!(self.all(who), (1..=*last).collect::<Vec<_>>(), "{who:?}: each is stored once, or missing once");
        }
        assert_eq!(count(&self.missing, 'm'), 0, "throws in the backlogs were not stored: {:?}", self.missing);
    }
}

/// Waits until each published throw is stored or missing, every stored throw is judged, and all events are published.
/// `published` has the last number of each machine and boot id. It is not enough that this throw is stored: it may have
/// arrived live while the daemon still reads earlier throws from the backlog.
pub(crate) async fn settled(rig: &Rig, reader: &Reader, published: &Published) -> Known {
    until(5 * PATIENCE, async || {
        let known = Known::of(rig, reader).await;
        let behind: Vec<_> = published.iter().filter(|(who, last)| (known.all(who).len() as u64) < **last).collect();
        let waiting = rig.sql("SELECT 1 AS n FROM throw WHERE judged_at_us IS NULL LIMIT 1").len();
        let unpublished = reader.outbox_pending(0, 1).await.unwrap().len();
        if behind.is_empty() && waiting + unpublished == 0 {
            return Ok(known);
        }
        Err(format!("behind: {behind:?}; {waiting} unjudged, {unpublished} unpublished"))
    })
    .await
}
