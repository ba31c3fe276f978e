//! Loggers with a wrong clock or with impossible values in a field: no throw is lost, and people can see the fault.

use jiff::{SignedDuration, Timestamp};
use pointsd::throw::{Throw, ThrowRef, Trace};

use crate::{
    faketime,
    http::{KEY, WEB, address, get},
    rig::{Rig, stub, throws},
};

const DAY: SignedDuration = SignedDuration::from_hours(24);

fn dated(throw_no: u64, started_at: Timestamp) -> Throw {
    Throw { started_at, ..stub("boot", throw_no) }
}

/// Number of throws in a row until an alarm about a clock is raised, or ends.
const ENOUGH: u64 = 12;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_clock_that_jumps_is_one_alarm_about_it_which_ends_when_the_clock_is_right() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let mut throw_no = 0;
    let alarms = "SELECT state, text FROM alarm_history WHERE cause = 'sensor' AND channel = 'clock'";
    for (jump, raised) in [(DAY * 200, 1), (-DAY * 7, 2)] {
        for offset in [SignedDuration::ZERO, jump, SignedDuration::ZERO] {
            for _ in 0..ENOUGH {
                throw_no += 1;
                logger.send([dated(throw_no, Timestamp::now() + offset)]).await;
            }
            rig.judged(usize::try_from(throw_no).unwrap()).await;
            let open = rig.sql("SELECT raised_at FROM active_alarms WHERE channel = 'clock' AND state LIKE 'active%'");
            assert_eq!(open.len(), usize::from(offset != SignedDuration::ZERO), "{jump}: {offset}: {open:?}");
            // The alarm has the time of reception.
            for alarm in open {
                let raised_at: Timestamp = alarm["raised_at"].as_str().unwrap().parse().unwrap();
                assert!(raised_at.duration_since(Timestamp::now()).abs() < DAY, "{raised_at}");
            }
        }
        assert_eq!(rig.sql(alarms).len(), 1, "an unacknowledged alarm is raised again");
        let events = rig.sql("SELECT text FROM alarm_events WHERE text LIKE '%clock of the logger is wrong%'");
        assert_eq!(events.len(), raised, "{events:?}");
    }
    assert!(rig.sql("SELECT * FROM alarm_history WHERE cause = 'data_loss'").is_empty());
}

/// A logger without a battery starts with the date of its software, and with a new boot.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_clock_that_is_behind_after_a_restart_is_an_alarm() {
    let mut rig = Rig::new();
    let Some(clock) = faketime::clock_of(&mut rig) else { return };
    rig.set("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    let daemon = rig.start();
    let loggers = [daemon.logger(KEY).await, daemon.logger("points/v1/north/22/throw").await];
    for throw_no in 1..=10 {
        let minutes = 2 * i64::try_from(throw_no).unwrap();
        std::fs::write(&clock, format!("+{minutes}m")).unwrap();
        let now = Timestamp::now() + SignedDuration::from_mins(minutes);
        let restarted = throw_no > 4;
        let mut throw = dated(throw_no, if restarted { now - DAY * 1000 } else { now });
        if restarted {
            throw.id = ThrowRef { boot_id: "restarted".into(), throw_no: throw_no - 4 };
        }
        loggers[0].send([throw]).await;
        loggers[1].send([dated(throw_no, now)]).await;
        rig.judged(2 * usize::try_from(throw_no).unwrap()).await;
    }
    let alarms = rig.sql("SELECT machine, raised_at, state FROM alarm_history WHERE channel = 'clock'");
    assert!(alarms.len() == 1 && alarms[0]["machine"] == "21B", "{alarms:?}");
    assert_eq!(alarms[0]["state"], "active_unacknowledged");
    let raised_at: Timestamp = alarms[0]["raised_at"].as_str().unwrap().parse().unwrap();
    assert!(raised_at.duration_since(Timestamp::now()).abs() < DAY, "the time of reception: {raised_at}");
}

/// The clock of the daemon's computer stands in 1970, or some weeks back, after a loss of power.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_daemon_with_a_wrong_clock_accuses_no_logger() {
    for behind_days in [30, 20_000] {
        let mut rig = Rig::new();
        let Some(clock) = faketime::clock_of(&mut rig) else { return };
        rig.set("FAKETIME_DONT_FAKE_MONOTONIC", "1");
        let daemon = rig.start();
        let loggers = [daemon.logger(KEY).await, daemon.logger("points/v1/north/22/throw").await];
        let mut sent = 0;
        for (round, faked) in ["+0".to_owned(), format!("-{behind_days}d")].iter().enumerate() {
            std::fs::write(&clock, faked).unwrap();
            for throw_no in 1..=ENOUGH {
                for logger in &loggers {
                    logger.send([dated(ENOUGH * round as u64 + throw_no, Timestamp::now())]).await;
                }
                sent += loggers.len();
                rig.judged(sent).await;
            }
        }
        let received = rig.sql("SELECT min(received_at_us) AS at FROM throw")[0]["at"].as_i64().unwrap();
        let earlier = Timestamp::now() - DAY * (behind_days - 1);
        assert!(received < earlier.as_microsecond(), "the clock of the daemon is right");
        assert!(rig.sql("SELECT * FROM alarm_history WHERE channel = 'clock'").is_empty());
        daemon.terminate();
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fields_out_of_range_are_kept_not_used_and_stated() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let made = throws("boot", 17);
    let with = |at: usize, change: &dyn Fn(&mut Throw)| {
        let mut throw = made[at].clone();
        change(&mut throw);
        throw
    };
    let rate_hz = made[0].trace.sample_rate_hz();
    let samples = made[0].trace.len();
    // Multiplies one sample of the current, and sets all positions if `position` is given.
    let replace_trace = |throw: &mut Throw, current_factor: f64, position: Option<f64>| {
        let position = position.map_or_else(|| throw.trace.position_mm().to_vec(), |mm| vec![mm; samples]);
        let mut amperes = throw.trace.current_a().to_vec();
        amperes.resize(position.len(), 0.0);
        amperes[5] *= current_factor;
        throw.trace = Trace::new(rate_hz, amperes, position).unwrap();
    };
    let sent = [
        with(0, &|throw| throw.anti_alias_hz = Some(0.75 * rate_hz)),
        with(1, &|throw| throw.anti_alias_hz = Some(-1.0)),
        with(2, &|throw| throw.supply_v = Some(0.0)),
        with(3, &|throw| throw.temperature_c = Some(1e300)),
        with(4, &|throw| replace_trace(throw, 1.0, Some(0.0))),
        with(5, &|throw| replace_trace(throw, 1.0, Some(f64::NAN))),
        with(6, &|throw| replace_trace(throw, 1e30, None)),
    ];
    logger.send(&sent).await;
    rig.judged(sent.len()).await;
    let half = 0.5 * rate_hz;
    let rows =
        rig.sql("SELECT detail, anti_alias_hz FROM throw_features JOIN throw USING (throw_no) ORDER BY throw_no");
    let says = [
        format!(
            "anti_alias_hz is {}, must be above 0 and up to {half} Hz, half of sample_rate_hz, and is not used",
            0.75 * rate_hz
        ),
        "anti_alias_hz is -1, must be above 0".to_owned(),
        "supply_v is 0, must be 5 to 1000 V, and is not used".to_owned(),
        "temperature_c is 1e300, must be -60 to 90 °C, and is not used".to_owned(),
        "position_mm is 0 in all samples".to_owned(),
        "position_mm is absent, or no sample of it was measured".to_owned(),
        "which is not possible for a point machine".to_owned(),
    ];
    for (row, says) in rows.iter().zip(says) {
        let detail = row["detail"].as_str().unwrap_or_default();
        assert!(detail.contains(&says) && detail.len() < 300, "{says}: {row}");
    }
    assert_eq!(rows[1]["anti_alias_hz"], -1.0, "as it was sent");

    // A field that stays wrong is a caveat of the machine until the logger is corrected.
    let caveats = "SELECT caveat FROM machine_caveats WHERE caveat LIKE '%anti_alias_hz is -1%'";
    let wrong: Vec<_> = (7..16).map(|at| with(at, &|throw| throw.anti_alias_hz = Some(-1.0))).collect();
    logger.send(&wrong).await;
    rig.judged(sent.len() + wrong.len()).await;
    assert!(!rig.sql(caveats).is_empty());
    logger.send(&made[16..]).await;
    rig.judged(made.len()).await;
    assert!(rig.sql(caveats).is_empty());
}

/// A trigger stands for a schema that another program has changed: the throw whose result the database rejects is not
/// evaluated, and the next throws are.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_judgement_that_the_database_rejects_holds_up_no_other() {
    let (rig, daemon) = Rig::running();
    let logger = daemon.logger(KEY).await;
    let made = throws("boot", 6);
    logger.send(&made[..2]).await;
    rig.judged(2).await;
    rig.change(
        "CREATE TRIGGER reject BEFORE INSERT ON estimate WHEN NEW.b0 IS NOT NULL AND (SELECT throw_no FROM throw WHERE \
         throw_row = NEW.throw_row) = 4 BEGIN SELECT RAISE(ABORT, 'no such estimate'); END",
    )
    .await;
    logger.send(&made[2..]).await;
    let rows = rig.judged(6).await;
    let qualities: Vec<&str> = rows.iter().map(|row| row.quality.as_str()).collect();
    assert_eq!(qualities, ["good", "good", "good", "not_storable", "good", "good"]);
    let rejected = rig.sql("SELECT throw_no, quality, detail FROM throws_not_evaluated");
    assert_eq!((rejected.len(), &rejected[0]["throw_no"]), (1, &4.into()), "{rejected:?}");
    assert!(rejected[0].to_string().contains("no such estimate"), "{rejected:?}");
    daemon.until_status("the rejection", |status| status["not_evaluated"] == 1).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_new_baseline_shows_at_once() {
    let (rig, daemon) = Rig::running_with(WEB);
    let logger = daemon.logger(KEY).await;
    let made = throws("boot", 30);
    logger.send(&made).await;
    rig.judged(made.len()).await;
    let progress = "SELECT direction FROM machine_health WHERE baseline_throws > 0 OR throws_since_baseline > 0";
    assert_eq!(rig.sql(progress).len(), 2);
    let said = daemon.says(0, &["rebaseline", "north/21B", "--why", "new motor", "--by", "tester"]);
    // These throws were sent faster than they were made.
    assert!(said.contains("sends later may be learned too"), "{said}");
    assert!(rig.sql(progress).is_empty());
    let page = get(&address(&daemon), "/machines/north/21B").body;
    assert_eq!(page.matches("0 of 50 throws").count(), 2, "{page}");
}

/// The machines are sound: the reason says what to correct at the logger.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_machine_that_is_not_monitored_has_the_reason_and_the_missing_direction() {
    let (rig, daemon) = Rig::running();
    let changed = |change: fn(&Trace) -> Trace| {
        let of_throw = move |throw: Throw| Throw { trace: change(&throw.trace), direction: None, ..throw };
        throws("boot", 20).into_iter().map(of_throw)
    };
    let without_position = changed(|trace| {
        Trace::new(trace.sample_rate_hz(), trace.current_a().to_vec(), vec![f64::NAN; trace.len()]).unwrap()
    });
    let swapped = changed(|trace| {
        Trace::new(trace.sample_rate_hz(), trace.position_mm().to_vec(), trace.current_a().to_vec()).unwrap()
    });
    // Kept until the throws are judged: a session that is dropped loses what it has not sent yet.
    let loggers = [daemon.logger(KEY).await, daemon.logger("points/v1/north/22A/throw").await];
    loggers[0].send(without_position).await;
    loggers[1].send(swapped).await;
    rig.judged(40).await;
    let alarms = rig.sql("SELECT machine, text FROM active_alarms WHERE cause = 'not_monitored' ORDER BY machine");
    let text = |at: usize| alarms[at]["text"].as_str().unwrap();
    assert!(alarms.len() == 2 && text(0).contains("(last reason: current_only)"), "{alarms:?}");
    assert!(text(0).contains("without a toe sensor, the direction"), "{alarms:?}");
    assert!(text(1).contains("(last reason: moved_before_current)"), "{alarms:?}");
}
