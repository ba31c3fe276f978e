//! Every throw once, in order, and the missing ones in gaps.

use pointsd::store::{GapKind, Spooled, StoreError, ThrowRow};

use crate::given::{at, machine, open, query, spooled, throw};

#[tokio::test]
async fn a_throw_comes_back_as_it_went_in_and_a_repeat_is_one_row() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).await.store;
    let mut sent = throw("b1", 1);
    let (mut current, position) = sent.trace.into_channels();
    current[7] = f64::NAN;
    current[8] = f64::NEG_INFINITY;
    sent.trace = pointsd::throw::Trace::new(1000.0, current, position).unwrap();
    let Spooled::New(row) = store.spool(&machine("21B"), &sent, at(5)).await.unwrap() else { panic!() };
    for _ in 0..2 {
        let again = store.spool(&machine("21B"), &sent, at(6)).await.unwrap();
        assert_eq!(again, Spooled::Duplicate { differs: false });
    }
    let pending = store.reader().pending(ThrowRow::START, 10).await.unwrap();
    let [stored] = &pending[..] else { panic!("{} rows", pending.len()) };
    assert_eq!((stored.row, stored.received_at, &stored.machine), (row, at(5), &machine("21B")));
    let back = stored.throw.as_ref().unwrap();
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(back.trace.current_a()), bits(sent.trace.current_a()));
    assert_eq!(bits(back.trace.position_mm()), bits(sent.trace.position_mm()));
    assert_eq!((&back.id, back.started_at, back.direction), (&sent.id, sent.started_at, sent.direction));
    assert_eq!(back.temperature_c, Some(12.5));
}

#[tokio::test]
async fn another_throw_under_a_stored_number_is_refused_counted_and_quarantined() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).await.store;
    spooled(&store, "21B", "b1", 1).await;
    let mut other = throw("b1", 1);
    other.temperature_c = Some(13.0);
    let answer = store.spool(&machine("21B"), &other, at(1)).await.unwrap();
    assert_eq!(answer, Spooled::Duplicate { differs: true });
    assert_eq!(store.statistics().await.unwrap().counters["contradicted_throws"], 1);
    let noted = store.reader().quarantined(10).await.unwrap();
    assert!(noted[0].reason.contains("throw_no 1 of boot \"b1\""), "{}", noted[0].reason);
    // As it came: on which key, and how it begins.
    assert_eq!(noted[0].key, "points/v1/north/21B/throw");
    assert!(noted[0].payload_bytes > 1024 && noted[0].payload_start.len() == 1024, "{:?}", noted[0]);
}

#[tokio::test]
async fn gaps_open_split_and_close() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).await.store;
    for throw_no in [1, 2, 8, 5, 3, 7, 6, 12] {
        spooled(&store, "21B", "b1", throw_no).await;
    }
    let missing =
        |gaps: Vec<pointsd::store::Gap>| gaps.iter().map(|gap| (gap.first_no, gap.last_no)).collect::<Vec<_>>();
    assert_eq!(missing(store.reader().open_gaps(10).await.unwrap()), [(4, 4), (9, 11)]);
    spooled(&store, "21B", "b1", 4).await;
    assert_eq!(missing(store.reader().open_gaps(10).await.unwrap()), [(9, 11)]);
    assert_eq!(store.statistics().await.unwrap().missing_throws, 3);
    let rows: Vec<(i64, i64, i64, i64)> =
        query(&store, "SELECT first_throw_no, last_throw_no, missing_throws, recovered_throws FROM data_gaps").await;
    assert_eq!(rows.iter().map(|row| row.3).sum::<i64>(), 5, "five of the throws came late: {rows:?}");
}

#[tokio::test]
async fn throws_before_the_first_one_heard_are_a_gap_of_their_own_kind() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).await.store;
    spooled(&store, "21B", "b1", 400).await;
    spooled(&store, "21B", "b2", 3).await;
    spooled(&store, "22A", "c1", 1).await;
    let gaps = store.reader().open_gaps(10).await.unwrap();
    let found: Vec<_> = gaps.iter().map(|gap| (gap.boot_id.as_str(), gap.first_no, gap.last_no, gap.kind)).collect();
    assert_eq!(found, [("b1", 1, 399, GapKind::BeforeFirstContact), ("b2", 1, 2, GapKind::Missed)]);
}

#[tokio::test]
async fn a_batch_is_answered_in_its_order() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).await.store;
    let mut batch: Vec<_> = (1..=150).map(|no| (machine("21B"), throw("b1", no), at(0))).collect();
    batch.push((machine("21B"), throw("b1", 3), at(0)));
    batch.push((machine("21B"), throw("b1", 1), at(0)));
    batch[151].1.id.throw_no = u64::MAX;
    let answers = store.spool_all(&batch).await;
    let rows: Vec<_> = answers[..150].iter().map(|answer| answer.as_ref().unwrap()).collect();
    assert_eq!(rows, (1..=150).map(|row| Spooled::New(ThrowRow(row))).collect::<Vec<_>>().iter().collect::<Vec<_>>());
    assert_eq!(*answers[150].as_ref().unwrap(), Spooled::Duplicate { differs: false });
    assert!(matches!(answers[151], Err(StoreError::ThrowNumber(u64::MAX))));
}

/// A logger gone mad must not stop the writer.
#[tokio::test]
async fn the_largest_numbers_and_oddest_times_are_taken() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).await.store;
    let largest = u64::try_from(i64::MAX).unwrap();
    for boot_id in ["b1", "b2", ""] {
        spooled(&store, "21B", boot_id, 1).await;
        let mut odd = throw(boot_id, 2);
        odd.id.throw_no = largest;
        odd.started_at = if boot_id.is_empty() { jiff::Timestamp::MIN } else { jiff::Timestamp::MAX };
        assert!(matches!(store.spool(&machine("21B"), &odd, at(0)).await.unwrap(), Spooled::New(_)));
        spooled(&store, "21B", boot_id, 3).await;
    }
    assert_eq!(store.reader().pending(ThrowRow::START, 100).await.unwrap().len(), 9);
    assert!(store.statistics().await.unwrap().missing_throws > 1 << 60);
}
