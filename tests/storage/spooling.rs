//! Each throw is stored once and in order; missing throws are recorded as gaps.

use std::time::Duration;

use pointsd::{
    diagnose::AlarmState,
    store::{DiskLevel, QuarantinedMessage, ReceivedThrow, Settings, Spooled, Store, StoreError, ThrowRow},
    throw::ThrowRef,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::given::{
    alarm, at, change, fresh, fresh_with, gaps, machine, open, pending, query, received, spooled, throw,
};

#[tokio::test]
async fn a_throw_comes_back_as_it_went_in_and_a_repeat_is_one_row() {
    let (_folder, store) = fresh().await;
    let mut sent = throw("b1", 1);
    let (mut current, position) = (sent.trace.current_a().to_vec(), sent.trace.position_mm().to_vec());
    current[7] = f64::NAN;
    current[8] = f64::NEG_INFINITY;
    sent.trace = pointsd::throw::Trace::new(1000.0, current, position).unwrap();
    let Spooled::New(row) = store.spool(&machine("21B"), &sent, at(5)).await.unwrap() else { panic!() };
    for _ in 0..2 {
        let again = store.spool(&machine("21B"), &sent, at(6)).await.unwrap();
        assert_eq!(again, Spooled::Duplicate);
    }
    let pending = store.reader().throws(ThrowRow::START, 10).await.unwrap();
    let [stored] = &pending[..] else { panic!("{} rows", pending.len()) };
    assert_eq!((stored.row, stored.received_at, &stored.machine), (row, at(5), &machine("21B")));
    let back = stored.throw.as_ref().unwrap();
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(back.trace.current_a()), bits(sent.trace.current_a()));
    assert_eq!(bits(back.trace.position_mm()), bits(sent.trace.position_mm()));
    assert_eq!((&back.id, back.started_at, back.direction), (&sent.id, sent.started_at, sent.direction));
    assert_eq!(back.temperature_c, Some(12.5));
}

/// A logger that restarts without a new boot id counts from 1 again. A logger whose counter is stuck repeats its
/// number.
#[tokio::test]
async fn another_throw_under_a_taken_number_is_kept_once_under_a_free_one() {
    let (_folder, store) = fresh().await;
    for throw_no in 1..=3 {
        spooled(&store, "21B", "b1", throw_no).await;
    }
    let other = |throw_no, celsius| {
        let mut other = throw("b1", throw_no);
        other.temperature_c = Some(celsius);
        other
    };
    for (throw_no, celsius) in [(1, 13.0), (2, 13.0), (2, 14.0), (2, 15.0)] {
        let answer = store.spool(&machine("21B"), &other(throw_no, celsius), at(1)).await.unwrap();
        assert!(matches!(answer, Spooled::New(_)), "{throw_no} at {celsius}");
        let again = store.spool(&machine("21B"), &other(throw_no, celsius), at(2)).await.unwrap();
        assert_eq!(again, Spooled::Duplicate);
    }
    assert_eq!(store.spool(&machine("21B"), &throw("b1", 2), at(3)).await.unwrap(), Spooled::Duplicate);
    spooled(&store, "21B", "b1", 4).await;
    assert_eq!(store.statistics().await.unwrap().counters()["contradicted_throws"], 4);
    let throws = store.reader().throws(ThrowRow::START, 100).await.unwrap();
    let ids: Vec<_> = throws.iter().map(|throw| (throw.id.boot_id.as_str(), throw.id.throw_no)).collect();
    let again: Vec<_> = (1..=4).map(|throw_no| ("b1~again", throw_no)).collect();
    assert_eq!(ids, [&[("b1", 1), ("b1", 2), ("b1", 3)][..], &again, &[("b1", 4)]].concat());
    assert!(throws.iter().all(|throw| throw.renumbered == (throw.id.boot_id != "b1")));
    // A logger may send a boot id with this suffix itself.
    spooled(&store, "22A", "mine~again", 1).await;
    let (pending, _) = store.reader().to_judge(None, 100, at(9), Duration::ZERO).await.unwrap();
    let renumbered: Vec<_> =
        pending.iter().filter(|throw| throw.renumbered).map(|throw| &throw.id.boot_id[..]).collect();
    assert_eq!((pending.len(), renumbered), (9, vec!["b1~again"; 4]));
    let all = store.reader().throws(ThrowRow::START, 100).await.unwrap();
    assert!(!all.last().unwrap().renumbered);
    assert!(gaps(&store).await.is_empty());
}

/// Writes off all missing throws, as after a backlog query without a reply.
async fn write_off(store: &Store) {
    let cursor = store.reader().cursor(&machine("21B")).await.unwrap();
    store.write_off(&machine("21B"), &cursor, at(1)).await.unwrap();
}

#[tokio::test]
async fn a_gap_that_opens_after_the_query_is_not_written_off_with_the_others() {
    let (_folder, store) = fresh().await;
    for (boot_id, throw_no) in [("b1", 1), ("b1", 4)] {
        spooled(&store, "21B", boot_id, throw_no).await;
    }
    let cursor = store.reader().cursor(&machine("21B")).await.unwrap();
    for (boot_id, throw_no) in [("b1", 7), ("b2", 3)] {
        spooled(&store, "21B", boot_id, throw_no).await;
    }
    store.write_off(&machine("21B"), &cursor, at(1)).await.unwrap();
    assert_eq!(gaps(&store).await, [("b1".to_owned(), 2, 3)]);
    write_off(&store).await;
    assert_eq!(gaps(&store).await.len(), 3);
}

#[tokio::test]
async fn gaps_open_split_and_close() {
    let (_folder, store) = fresh().await;
    for throw_no in [1, 2, 8, 5, 3, 7, 6, 12] {
        spooled(&store, "21B", "b1", throw_no).await;
    }
    assert!(gaps(&store).await.is_empty(), "they may be in the backlog");
    assert_eq!(store.statistics().await.unwrap().missing_throws, 0);
    write_off(&store).await;
    assert_eq!(gaps(&store).await, [("b1".to_owned(), 4, 4), ("b1".to_owned(), 9, 11)]);
    spooled(&store, "21B", "b1", 4).await;
    assert_eq!(gaps(&store).await, [("b1".to_owned(), 9, 11)]);
    assert_eq!(store.statistics().await.unwrap().missing_throws, 3);
    let rows: Vec<(i64, i64, i64, i64)> =
        query(&store, "SELECT first_throw_no, last_throw_no, missing_throws, recovered_throws FROM data_gaps").await;
    assert_eq!(rows.iter().map(|row| row.3).sum::<i64>(), 5, "five of the throws came late: {rows:?}");
}

#[tokio::test]
async fn throws_before_the_first_received_one_are_a_gap_of_their_own_kind() {
    let (_folder, store) = fresh().await;
    spooled(&store, "21B", "b1", 400).await;
    spooled(&store, "21B", "b2", 3).await;
    spooled(&store, "22A", "c1", 1).await;
    write_off(&store).await;
    assert_eq!(gaps(&store).await, [("b1".to_owned(), 1, 399), ("b2".to_owned(), 1, 2)]);
    let kinds: Vec<(String,)> = query(&store, "SELECT kind FROM data_gaps").await;
    assert_eq!(kinds, [("before_first_contact".to_owned(),), ("missed".to_owned(),)]);
}

#[tokio::test]
async fn a_batch_is_answered_in_its_order() {
    let (_folder, store) = fresh().await;
    let mut batch: Vec<_> = (1..=150).map(|no| received("21B", "b1", no, 0)).collect();
    batch.push(received("21B", "b1", 3, 0));
    let answers = store.spool_all(&batch).await.unwrap();
    let stored: Vec<_> = (1..=150).map(|row| Spooled::New(ThrowRow(row))).collect();
    assert_eq!(answers[..150], stored);
    assert_eq!(answers[150..], [Spooled::Duplicate]);
}

/// The first throws of a large fleet arrive together. The stored rows are the same as if each throw had arrived alone.
#[tokio::test]
async fn new_machines_in_a_batch_are_stored_like_single_ones() {
    let mut batch: Vec<_> = (1..=60).map(|n| received(&n.to_string(), "b1", 1, n)).collect();
    let also = |n: u32, boot_id: &str, throw_no| received(&n.to_string(), boot_id, throw_no, 100);
    // Another boot, a repeated throw, the next throw; missing throws before the first, numbers from 0, a late number 0.
    batch.extend([also(5, "b2", 1), also(7, "b1", 1), also(9, "b1", 2)]);
    batch.extend([also(70, "b1", 4), also(71, "b1", 0), also(72, "b1", 1), also(72, "b1", 0), also(70, "b0", 1)]);
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let [together, alone] = [open(folders[0].path()).await.store, open(folders[1].path()).await.store];
    let answers = together.spool_all(&batch).await.unwrap();
    for (ReceivedThrow { machine, throw, received_at }, answer) in batch.iter().zip(answers) {
        let single = alone.spool(machine, throw, *received_at).await.unwrap();
        assert_eq!(matches!(answer, Spooled::New(_)), matches!(single, Spooled::New(_)), "{machine} {:?}", throw.id);
    }
    for what in [
        "SELECT machine || ' ' || boot_id, highest_no, position, tail_open + 10 * counts_from_zero \
         FROM boot JOIN machine USING (machine_row) ORDER BY machine, position",
        "SELECT machine || ' ' || boot_id, throw_no, boot_position, received_at_us \
         FROM throw JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
         ORDER BY machine, boot_position, throw_no",
        "SELECT machine || ' ' || boot_id || ' ' || kind, detected_at_us, first_no, last_no \
         FROM gap JOIN boot USING (boot_row) JOIN machine USING (machine_row) ORDER BY 1, first_no",
        "SELECT machine, cursor_position, cursor_no, since_us FROM backlog JOIN machine USING (machine_row) ORDER BY 1",
    ] {
        let [together, alone]: [Vec<(String, i64, i64, i64)>; 2] =
            [query(&together, what).await, query(&alone, what).await];
        assert!(!alone.is_empty() && together == alone, "{what}:\n{together:?}\n{alone:?}");
    }
}

/// Extreme numbers and times from a defective logger do not stop the writer.
#[tokio::test]
async fn the_largest_numbers_and_oddest_times_are_taken() {
    let (_folder, store) = fresh().await;
    let largest = u64::try_from(i64::MAX).unwrap();
    for boot_id in ["b1", "b2", ""] {
        spooled(&store, "21B", boot_id, 1).await;
        let mut odd = throw(boot_id, 2);
        odd.id.throw_no = largest;
        odd.started_at = if boot_id.is_empty() { jiff::Timestamp::MIN } else { jiff::Timestamp::MAX };
        assert!(matches!(store.spool(&machine("21B"), &odd, at(0)).await.unwrap(), Spooled::New(_)));
        spooled(&store, "21B", boot_id, 3).await;
    }
    assert_eq!(pending(&store).await, 9);
    write_off(&store).await;
    // Each gap counts at most 2^40 throws, as in the view.
    assert!((3 << 40..4 << 40).contains(&store.statistics().await.unwrap().missing_throws));
    // The sum of the gaps fits into 64 bits in SQL too.
    let missing = query::<(i64,)>(&store, "SELECT sum(missing_throws) FROM data_gaps").await;
    assert!(missing[0].0 > 1 << 40, "{missing:?}");
}

/// A throw whose number is stored already gets the next number of a separate boot. If that boot has the highest number,
/// there is no next one.
#[tokio::test]
async fn a_logger_that_uses_up_the_numbers_for_taken_numbers_does_not_stop_the_writer() {
    let (_folder, store) = fresh().await;
    spooled(&store, "21B", "b1", 1).await;
    let mut last = throw("b1~again", 2);
    last.id.throw_no = u64::try_from(i64::MAX).unwrap();
    assert!(matches!(store.spool(&machine("21B"), &last, at(0)).await.unwrap(), Spooled::New(_)));
    let mut other = throw("b1", 3);
    other.id.throw_no = 1;
    let refused = store.spool(&machine("21B"), &other, at(0)).await;
    assert!(matches!(refused, Err(StoreError::Refused(_))), "{refused:?}");
    // A refused row says nothing about the disk.
    assert_eq!((store.disk_level(), store.trouble([])), (DiskLevel::Ample, None));
    assert_eq!(store.statistics().await.unwrap().failed_writes, 0);
    spooled(&store, "21B", "b1", 2).await;
}

/// The counter of some loggers goes on at a restart. With small numbers the first throws of the new boot may be lost.
#[tokio::test]
async fn a_logger_whose_numbers_go_on_in_a_new_boot_misses_no_throw() {
    for (last, first, missing) in [(10, 11, None), (10, 12, Some(11)), (9, 10, Some(9)), (20, 5, Some(4))] {
        let (_folder, store) = fresh().await;
        for throw_no in 1..=last {
            spooled(&store, "21B", "b1", throw_no).await;
        }
        for throw_no in first..first + 2 {
            spooled(&store, "21B", "b2", throw_no).await;
        }
        write_off(&store).await;
        let expected: Vec<_> = missing.map(|last| ("b2".to_owned(), 1, last)).into_iter().collect();
        assert_eq!(gaps(&store).await, expected, "{last}, {first}");
        assert!(!store.reader().cursor(&machine("21B")).await.unwrap().awaits);
    }
}

/// A logger with a new boot id for each throw slows neither its own throws nor the throws of other machines.
#[tokio::test]
async fn the_cost_of_a_throw_does_not_grow_with_the_starts_of_its_logger() {
    const STARTS: u64 = 200;
    let (_folder, store) = fresh().await;
    spooled(&store, "21B", "b1", 1).await;
    let many = "INSERT INTO boot (machine_row, boot_id, first_seen_us, highest_no, position) \
                WITH RECURSIVE number (n) AS (SELECT 2 UNION ALL SELECT n + 1 FROM number WHERE n < 20000) \
                SELECT 1, 'old ' || n, 0, 1, n * 1048576 FROM number";
    change(store.path(), [many]).await;
    let mut seconds = [Vec::new(), Vec::new()];
    for number in 0..STARTS {
        // Both machines in turn, so that other load on the computer slows both.
        for (machine, seconds) in ["21B", "22A"].into_iter().zip(&mut seconds) {
            let start = tokio::time::Instant::now();
            spooled(&store, machine, &format!("new {number}"), 1).await;
            seconds.push(start.elapsed().as_secs_f64());
        }
    }
    let [after_many, after_none] = seconds.map(|mut seconds| {
        seconds.sort_by(f64::total_cmp);
        seconds[seconds.len() / 2]
    });
    // If the cost were proportional to the number of starts, the factor would be ten.
    assert!(after_many < 3.0 * after_none, "{after_many} s after 20,000 starts, {after_none} s after none");
}

/// The throws that would be judged next while the backlog is open.
async fn next(store: &Store) -> Vec<(String, u64)> {
    let (throws, _) = store.reader().to_judge(None, 16, at(100), Duration::from_hours(1)).await.unwrap();
    throws.into_iter().map(|throw| (throw.id.boot_id, throw.id.throw_no)).collect()
}

fn ids(list: &[(&str, u64)]) -> Vec<(String, u64)> {
    list.iter().map(|(boot_id, throw_no)| ((*boot_id).to_owned(), *throw_no)).collect()
}

/// Live throws of the third boot arrive before the rest of the first boot and the whole second boot. The backlog
/// delivers the missing throws, and all throws are judged in the order in which they were recorded.
#[tokio::test]
async fn pages_fill_what_is_missing_and_put_the_starts_of_a_logger_in_order() {
    let (_folder, store) = fresh().await;
    let id = |boot_id: &str, throw_no| ThrowRef { boot_id: boot_id.to_owned(), throw_no };
    for (boot_id, throw_no) in [("b1", 1), ("b1", 2), ("b3", 2), ("b3", 3), ("b3", 7)] {
        spooled(&store, "21B", boot_id, throw_no).await;
    }
    assert_eq!(next(&store).await, ids(&[("b1", 1), ("b1", 2)]));
    // The backlog has throw 4 of b1, the unknown boot b2, and b3 from throw 1.
    let page: Vec<_> = [("b1", 4), ("b2", 1), ("b2", 2), ("b3", 1)].map(|(boot, no)| throw(boot, no)).into();
    let stored = store.spool_page(&machine("21B"), Some(&id("b1", 2)), &page, at(1)).await.unwrap();
    assert_eq!((stored.new, stored.duplicates), (4, 0));
    assert_eq!(stored.cursor.after, Some(id("b3", 3)));
    assert_eq!((stored.cursor.missing, stored.cursor.awaits), (Some(3), true));
    let until_gap = [("b1", 1), ("b1", 2), ("b1", 4), ("b2", 1), ("b2", 2), ("b3", 1), ("b3", 2), ("b3", 3)];
    assert_eq!(next(&store).await, ids(&until_gap));
    // A page that starts after the next expected number makes a gap.
    let page = [throw("b3", 6), throw("b3", 7)];
    let stored = store.spool_page(&machine("21B"), Some(&id("b3", 3)), &page, at(2)).await.unwrap();
    assert_eq!((stored.new, stored.duplicates, stored.cursor.awaits), (1, 1, false));
    assert_eq!(next(&store).await, ids(&[&until_gap[..], &[("b3", 6), ("b3", 7)]].concat()));
    let mut gaps = gaps(&store).await;
    gaps.sort_unstable();
    assert_eq!(gaps, [("b1".to_owned(), 3, 3), ("b3".to_owned(), 4, 5)]);
}

/// Live throws with gaps, starts of the logger, pages of its backlog, and gaps that are written off. A throw that is
/// stored twice makes the writer place the cursor again: it stays.
#[tokio::test]
async fn the_cursor_is_at_its_place_after_every_throw() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..6 {
        let (_folder, store) = fresh().await;
        let cursors = async || -> Vec<(Option<i64>, i64, i64)> {
            query(&store, "SELECT cursor_boot_row, cursor_position, cursor_no FROM backlog").await
        };
        // Of each boot of the logger the number of its throws.
        let mut boots = vec![rng.random_range(0..3_u64)];
        for _ in 0..60 {
            let boot = rng.random_range(0..boots.len());
            let last = boots.len() - 1;
            match rng.random_range(0..10) {
                0 if boots.len() < 5 => boots.push(0),
                1 => {
                    let cursor = store.reader().cursor(&machine("21B")).await.unwrap();
                    let page = (1..=boots[boot]).filter(|_| rng.random_bool(0.5));
                    let page: Vec<_> = page.map(|no| throw(&format!("b{boot}"), no)).collect();
                    store.spool_page(&machine("21B"), cursor.after.as_ref(), &page, at(0)).await.unwrap();
                }
                2 => {
                    let cursor = store.reader().cursor(&machine("21B")).await.unwrap();
                    store.write_off(&machine("21B"), &cursor, at(0)).await.unwrap();
                }
                _ => {
                    let boot = if rng.random_bool(0.8) { last } else { boot };
                    boots[boot] += if rng.random_bool(0.6) { 1 } else { rng.random_range(1..4) };
                    let late = rng.random_range(0..4).min(boots[boot] - 1);
                    let both = [boots[boot], boots[boot] - late].map(|no| received("21B", &format!("b{boot}"), no, 0));
                    store.spool_all(&both[..rng.random_range(1..=2)]).await.unwrap();
                    let before = cursors().await;
                    assert_eq!(store.spool_all(&both[..1]).await.unwrap(), [Spooled::Duplicate]);
                    assert_eq!(cursors().await, before, "after {} of boot {boot} of {boots:?}", boots[boot]);
                }
            }
        }
    }
}

/// The pending throws of one machine do not fill a batch while other machines have pending throws.
#[tokio::test]
async fn machines_take_turns_in_the_batches_to_judge() {
    let (_folder, store) = fresh().await;
    for throw_no in 1..=30 {
        spooled(&store, "21B", "b1", throw_no).await;
    }
    for name in ["22A", "23"] {
        spooled(&store, name, "b1", 1).await;
    }
    let judged = async |last: Option<&str>, most| {
        let last = last.map(machine);
        let (throws, _) = store.reader().to_judge(last.as_ref(), most, at(100), Duration::ZERO).await.unwrap();
        ["21B", "22A", "23"].map(|name| throws.iter().filter(|throw| throw.machine == machine(name)).count())
    };
    assert_eq!(judged(None, 8).await, [6, 1, 1]);
    // With more machines than places in the batch, the machines after the last judged one come first.
    assert_eq!(judged(None, 1).await, [1, 0, 0]);
    assert_eq!(judged(Some("21B"), 1).await, [0, 1, 0]);
}

#[tokio::test]
async fn a_missing_throw_holds_up_its_machine_for_a_time_and_no_other() {
    let (_folder, store) = fresh().await;
    for throw_no in [1, 3] {
        spooled(&store, "21B", "b1", throw_no).await;
    }
    spooled(&store, "22A", "c1", 1).await;
    let judged = async |at_s, wait_s| {
        let (throws, _) = store.reader().to_judge(None, 16, at(at_s), Duration::from_secs(wait_s)).await.unwrap();
        throws.iter().map(|throw| (throw.machine.machine.to_string(), throw.id.throw_no)).collect::<Vec<_>>()
    };
    let of = |list: &[(&str, u64)]| ids(list);
    assert_eq!(judged(10, 60).await, of(&[("21B", 1), ("22A", 1)]));
    assert_eq!(judged(70, 60).await, of(&[("21B", 1), ("21B", 3), ("22A", 1)]));
    // If the clock was set back after the gap was found, no throw waits until that time.
    assert_eq!(judged(-1000, 60).await, of(&[("21B", 1), ("21B", 3), ("22A", 1)]));
    // After a start of the daemon the wait begins anew: the logger has to connect again.
    store.renew_backlogs(at(1000)).await.unwrap();
    assert_eq!(judged(1010, 60).await, of(&[("21B", 1), ("22A", 1)]));
}

/// Writes that arrive together share a transaction. If the database refuses one of them, the others are still stored.
#[tokio::test]
async fn a_refused_write_costs_no_other_write_of_its_group() {
    let (_folder, store) = fresh().await;
    let refuse = "CREATE TRIGGER refuse BEFORE INSERT ON throw WHEN NEW.throw_no = 99 \
                  BEGIN SELECT RAISE(ABORT, 'refused'); END";
    change(store.path(), [refuse]).await;
    let (name, bad, good) = (machine("21B"), throw("b1", 99), throw("b1", 1));
    let (before, refused, after) = tokio::join!(
        store.record(alarm(1, AlarmState::ActiveUnacknowledged)),
        store.spool(&name, &bad, at(0)),
        store.spool(&name, &good, at(0)),
    );
    assert!(matches!(refused, Err(StoreError::Refused(_))), "{refused:?}");
    assert!(before.is_ok(), "{before:?}");
    assert!(matches!(after, Ok(Spooled::New(_))), "{after:?}");
}

/// The reasons for which the messages of other machines were refused stay.
#[tokio::test]
async fn a_flood_of_refused_messages_removes_only_its_own() {
    let (_folder, store) = fresh_with(|settings| Settings { max_quarantined: 20, ..settings }).await;
    let refused = |name: &str, count: i64| {
        let message = |at_s| QuarantinedMessage {
            key: format!("points/v1/north/{name}/throw"),
            reason: "no throw".to_owned(),
            bytes: 1,
            id: None,
            beginning: vec![0],
            at: at(at_s),
        };
        (0..count).map(message).collect::<Vec<_>>()
    };
    for (name, count) in [("a", 3), ("b", 15), ("flood", 200), ("flood", 200)] {
        store.quarantine(refused(name, count)).await.unwrap();
    }
    let kept = "SELECT key, count(*), min(received_at_us) FROM quarantine GROUP BY key";
    let us = |seconds| at(seconds).as_microsecond();
    let expected = [("a", 3, 0), ("b", 8, 7), ("flood", 9, 191)]
        .map(|(name, count, first)| (format!("points/v1/north/{name}/throw"), count, us(first)));
    assert_eq!(query::<(String, i64, i64)>(&store, kept).await, expected);
}
