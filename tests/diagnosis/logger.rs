//! Alarms about the logger and the daemon: silence, gaps, wrong clocks and messages, and throws that arrive late.

use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector3;
use pointsd::{
    diagnose::{
        AlarmEvent, AlarmState, Away, Cause, Command, Irregularity, MachineMonitor, MachineState, Missing, Observation,
        SensorChannel, Settings, Severity,
    },
    throw::{Direction, MachineId, Throw, ThrowRef, utc},
};

use crate::{
    drive::{Drive, State, Voltage, with_positions, with_trace},
    fleet::channels,
    operational::{ended, feed, machine, raised, summary},
};

fn missing(throws: u64) -> Missing<'static> {
    Missing { throws, ..Missing::default() }
}

#[test]
fn silence_is_noticed_and_a_jumping_clock_is_no_silence() {
    let settings = Settings::default();
    let mut machine = machine();
    let mut now = machine.throw(Vector3::zeros()).started_at;
    assert_eq!(machine.monitor.tick(now, &settings), []);
    assert_eq!(machine.monitor.tick(now + SignedDuration::from_hours(24 * 3650), &settings), []);
    assert_eq!(machine.monitor.tick(now - SignedDuration::from_hours(24), &settings), []);
    let mut events = Vec::new();
    for _ in 0..24 * 8 {
        now += SignedDuration::from_hours(1);
        events.extend(machine.monitor.tick(now, &settings));
    }
    assert_eq!(summary(&events), [raised(Cause::NotMonitored)]);
}

/// Lets minutes pass; calls `each` and the monitor every ten seconds, as the daemon does.
fn pass(
    monitor: &mut MachineMonitor,
    now: &mut jiff::Timestamp,
    minutes: i64,
    mut each: impl FnMut(&mut MachineMonitor, jiff::Timestamp) -> Vec<AlarmEvent>,
) -> Vec<AlarmEvent> {
    let mut events = Vec::new();
    for _ in 0..6 * minutes {
        *now += SignedDuration::from_secs(10);
        events.extend(each(monitor, *now));
        events.extend(monitor.tick(*now, &Settings::default()));
    }
    events
}

#[test]
fn a_logger_that_goes_is_missed_after_the_delay_and_not_before() {
    let settings = Settings::default();
    let mut machine = machine();
    let mut now = machine.throw(Vector3::zeros()).started_at;
    let there = |monitor: &mut MachineMonitor, now| monitor.logger(true, now, &Settings::default());
    let away = |monitor: &mut MachineMonitor, now| monitor.logger(false, now, &Settings::default());
    // A logger that was never connected is not missed.
    assert_eq!(pass(&mut machine.monitor, &mut now, 60, away), []);
    // An unstable link and a restart of the logger raise no alarm.
    for minutes in [1, 9, 5] {
        assert_eq!(pass(&mut machine.monitor, &mut now, 1, there), []);
        assert_eq!(pass(&mut machine.monitor, &mut now, minutes, away), []);
    }
    assert_eq!(pass(&mut machine.monitor, &mut now, 1, there), []);
    let (raised, ended) = (raised(Cause::NotMonitored), ended(Cause::NotMonitored));
    // Half of the delay passes before the daemon stops. The hours without a daemon, or of a clock jump, do not count,
    // because loggers have to connect again. After the whole delay the alarm is raised once.
    assert_eq!(pass(&mut machine.monitor, &mut now, 6, away), []);
    machine.monitor = serde_json::from_str(&serde_json::to_string(&machine.monitor).unwrap()).unwrap();
    now += SignedDuration::from_hours(30);
    assert_eq!(pass(&mut machine.monitor, &mut now, 2, away), []);
    assert_eq!(summary(&pass(&mut machine.monitor, &mut now, 120, away)), [raised]);
    assert_eq!(machine.monitor.state(), MachineState::NotMonitored);
    assert_eq!(summary(&pass(&mut machine.monitor, &mut now, 5, there)), [ended]);
    // The logger sends a throw before its liveliness token.
    assert_eq!(summary(&pass(&mut machine.monitor, &mut now, 15, away)), [raised]);
    assert_eq!(summary(&feed(&mut machine, 1, |_| {})), [ended]);
    assert_eq!(pass(&mut machine.monitor, &mut now, 5, there), []);
    // The first throw after its return is rejected.
    assert_eq!(summary(&pass(&mut machine.monitor, &mut now, 15, away)), [raised]);
    assert_eq!(feed(&mut machine, 1, |o| o.outcome = None), []);
    assert_eq!(summary(&pass(&mut machine.monitor, &mut now, 5, there)), [ended]);
    // After its return with throws without an estimate the machine is still not monitored.
    assert_eq!(summary(&pass(&mut machine.monitor, &mut now, 15, away)), [raised]);
    let many = i64::from(settings.not_monitored_throws);
    // The alarm has another reason now, which is a new event.
    let unevaluated = feed(&mut machine, many.try_into().unwrap(), |o| o.outcome = None);
    assert_eq!(summary(&unevaluated), [raised]);
    assert!(unevaluated[0].text.contains("could not be evaluated"), "{unevaluated:?}");
    assert_eq!(pass(&mut machine.monitor, &mut now, 5, there), []);
}

#[test]
fn a_throw_received_before_the_loss_of_the_logger_is_no_sign_of_life() {
    let settings = Settings::default();
    let mut machine = machine();
    let mut now = machine.throw(Vector3::zeros()).started_at;
    let received = now;
    pass(&mut machine.monitor, &mut now, 1, |monitor, now| monitor.logger(true, now, &settings));
    let gone = pass(&mut machine.monitor, &mut now, 15, |monitor, now| monitor.logger(false, now, &settings));
    assert_eq!(summary(&gone), [raised(Cause::NotMonitored)]);
    assert_eq!(feed(&mut machine, 5, |throw| throw.received_at = Some(received)), []);
    let events = feed(&mut machine, 1, |throw| throw.received_at = Some(now));
    assert_eq!(summary(&events), [ended(Cause::NotMonitored)]);
}

/// The machine of an unreadable snapshot has made throws.
#[test]
fn silence_after_the_return_to_an_earlier_version_is_noticed() {
    let start = Timestamp::UNIX_EPOCH;
    let silent = |mut monitor: MachineMonitor| {
        let tick = |hour| monitor.tick(start + SignedDuration::from_hours(hour), &Settings::default());
        summary(&(0..24 * 8).flat_map(tick).collect::<Vec<_>>())
    };
    assert_eq!(silent(MachineMonitor::instead_of("{}".to_owned(), "21B")), [raised(Cause::NotMonitored)]);
    assert_eq!(silent(MachineMonitor::new("21B")), []);
}

#[test]
fn a_further_daemon_that_is_away_needs_a_new_acknowledgement() {
    use AlarmState::{ActiveAcknowledged, ActiveUnacknowledged, Normal};
    let (settings, mut monitor) = (Settings::default(), MachineMonitor::new("pointsd"));
    let mut states = Vec::new();
    for away in [&["one"][..], &["one", "two"], &["two"], &["one", "two"], &[]] {
        let at = Timestamp::UNIX_EPOCH;
        let daemons = away.iter().map(|id| (MachineId::new("north", id).unwrap(), Some(at))).collect();
        states.push(monitor.peers(&Away { daemons, has_link: true }, at, &settings)[0].state);
        let ack = Command::Ack { cause: Cause::NotMonitored, by: "mia".to_owned() };
        let _ = monitor.command(&ack, at, &settings);
    }
    assert_eq!(states, [ActiveUnacknowledged, ActiveUnacknowledged, ActiveAcknowledged, ActiveUnacknowledged, Normal]);
}

#[test]
fn an_alarm_of_the_daemon_itself_rises_and_ends_after_its_problem() {
    let settings = Settings::default();
    let mut monitor = MachineMonitor::new("pointsd");
    let mut now: jiff::Timestamp = "2026-05-04T10:00:00Z".parse().unwrap();
    let full = |monitor: &mut MachineMonitor, now| {
        monitor.trouble(Some((Severity::Critical, "full")), now, &Settings::default())
    };
    let well = |monitor: &mut MachineMonitor, now| monitor.trouble(None, now, &Settings::default());
    assert_eq!(pass(&mut monitor, &mut now, 60, well), []);
    let low = monitor.trouble(Some((Severity::Warning, "nearly full")), now, &settings);
    assert_eq!(summary(&low), [raised(Cause::DataLoss)]);
    let events = pass(&mut monitor, &mut now, 1, full);
    assert_eq!(summary(&events), [(Cause::DataLoss, Severity::Critical, AlarmState::ActiveUnacknowledged)]);
    assert_eq!(events[0].text, "full");
    // At its limit the alarm does not toggle.
    assert_eq!(pass(&mut monitor, &mut now, 9, well), []);
    assert_eq!(pass(&mut monitor, &mut now, 1, full), []);
    // Another problem of the same severity is a new event of the same alarm. Another number in the text is no new
    // event.
    let also = |throws: u32| {
        move |monitor: &mut MachineMonitor, now| {
            let text = format!("full; {throws} throws refused");
            monitor.trouble(Some((Severity::Critical, &text)), now, &Settings::default())
        }
    };
    let events = pass(&mut monitor, &mut now, 60, also(1));
    assert_eq!(summary(&events), [(Cause::DataLoss, Severity::Critical, AlarmState::ActiveUnacknowledged)]);
    assert_eq!(events[0].text, "full; 1 throws refused");
    assert_eq!(pass(&mut monitor, &mut now, 60, also(23)), []);
    let events = pass(&mut monitor, &mut now, 60 * 24 * 30, well);
    assert_eq!(summary(&events), [(Cause::DataLoss, Severity::Critical, AlarmState::ClearedUnacknowledged)]);
}

#[test]
fn lost_throws_are_an_alarm_until_none_was_lost_for_a_while() {
    let settings = Settings::default();
    let mut machine = machine();
    let at = machine.throw(Vector3::zeros()).started_at;
    assert_eq!(machine.monitor.gap(missing(0), at, &settings), []);
    assert_eq!(summary(&machine.monitor.gap(missing(3), at, &settings)), [raised(Cause::DataLoss)]);
    assert_eq!(summary(&feed(&mut machine, 12, |_| {})), [ended(Cause::DataLoss)]);
}

/// Throws that were received before the gap was known may be older than the gap, so they do not end its alarm. The end
/// of an alarm is not dated before its start, also if the throws that end it are older.
#[test]
fn throws_from_before_the_news_of_a_gap_do_not_end_its_alarm() {
    let settings = Settings::default();
    let mut machine = machine();
    let known_at = machine.throw(Vector3::zeros()).started_at + SignedDuration::from_hours(24 * 365);
    let raised = machine.monitor.gap(missing(3), known_at, &settings);
    let at = |seconds| move |o: &mut Observation| o.received_at = Some(known_at + SignedDuration::from_secs(seconds));
    assert_eq!(feed(&mut machine, 40, at(-1)), []);
    assert_eq!(feed(&mut machine, 11, at(1)), []);
    let events = feed(&mut machine, 1, at(1));
    assert_eq!(summary(&events), [ended(Cause::DataLoss)]);
    assert_eq!((events[0].event_at, raised[0].raised_at), (known_at, known_at));
    // The clock of the daemon's computer was ahead by months.
    let lost = machine.monitor.gap(missing(1), known_at, &settings);
    assert_eq!(lost.len(), 1);
    let right = known_at - SignedDuration::from_hours(24 * 300);
    machine.monitor.tick(right, &settings);
    let now = |o: &mut Observation| o.received_at = Some(right + SignedDuration::from_secs(1));
    assert_eq!(feed(&mut machine, 12, now).len(), 1);
}

/// The sum of the lost throws is reported as it grows, but not every gap of a link that flaps.
#[test]
fn a_growing_loss_is_reported_at_each_power_of_two() {
    let settings = Settings::default();
    let mut machine = machine();
    let at = machine.throw(Vector3::zeros()).started_at;
    let mut said = Vec::new();
    for lost in [1, 0, 1, 1, 1, 1, 500, 1] {
        said.extend(machine.monitor.gap(missing(lost), at, &settings).into_iter().map(|event| event.text));
    }
    assert_eq!(said.len(), 4, "{said:?}");
    for (text, sum) in
        said.iter().zip([": 1 throw never", ": 2 throws never", ": 4 throws never", ": 505 throws never"])
    {
        assert!(text.contains(sum) && text.contains(&format!("(counted at {}", utc(&at))), "{sum}: {text}");
    }
}

/// One message with an absurd throw number makes a gap of up to 2^63 throws, which is no number of lost throws.
#[test]
fn a_jump_of_the_throw_number_is_no_number_of_lost_throws() {
    let settings = Settings::default();
    let mut machine = machine();
    let at = machine.throw(Vector3::zeros()).started_at;
    let events = machine.monitor.gap(missing(Missing::MOST), at, &settings);
    let text = &events[0].text;
    assert!(text.contains("the number of lost ones is not known") && !text.contains("1099511627776"), "{text}");
}

/// Missing throws whose messages were refused are no fault of the link.
#[test]
fn refused_messages_are_named_as_the_reason_of_a_gap() {
    let settings = Settings::default();
    let mut machine = machine();
    let at = machine.throw(Vector3::zeros()).started_at;
    let mut said = |throws, refused| {
        let missing = Missing { throws, refused, reason: "throw_no: -1, must be a whole number from 0" };
        machine.monitor.gap(missing, at, &settings).into_iter().next().unwrap().text
    };
    let all = said(1, 1);
    assert!(all.contains("1 throw is missing because its message was refused (counted at"), "{all}");
    assert!(all.contains("must be a whole number from 0. Correct the logger") && !all.contains("link"), "{all}");
    let some = said(4, 2);
    assert!(some.contains("5 throws are missing, 3 of them because of refused messages"), "{some}");
}

/// A logger may fail in another way while the alarm about its gap is open.
#[test]
fn another_irregularity_during_an_alarm_about_lost_data_is_an_event() {
    let (mut machine, settings) = (machine(), Settings::default());
    let last = machine.throw(Vector3::zeros()).started_at;
    let [gap, soon, later] = [1, 5, 20].map(|minutes| last + SignedDuration::from_mins(minutes));
    assert_eq!(summary(&machine.monitor.gap(missing(3), gap, &settings)), [raised(Cause::DataLoss)]);
    let mut repeats = |at| machine.monitor.irregular(Irregularity::RepeatedTrace, None, at, &settings).len();
    assert_eq!([repeats(soon), repeats(later), repeats(later)], [0, 1, 0]);
}

#[test]
fn messages_that_are_no_throws_and_a_wrong_clock_are_alarms_and_wrong_directions_a_caveat() {
    let mut machine = machine();
    let last = machine.throw(Vector3::zeros());
    let invalid = Irregularity::Invalid { count: 5, reason: "direction \"N\" is unknown" };
    let event = &machine.monitor.irregular(invalid, None, last.started_at, &Settings::default())[0];
    assert_eq!((event.cause, event.severity), (Cause::DataLoss, Severity::Warning));
    assert!(event.text.contains("the last 5 messages") && event.text.contains("\"N\""), "{}", event.text);

    let mut machine = self::machine();
    let mut date = || {
        let received_at = Some(last.started_at);
        let dated = machine.monitor.date(&last.throw, Timestamp::UNIX_EPOCH, received_at, false, &Settings::default());
        assert_eq!(dated.at, last.started_at);
        machine.monitor.take_events()
    };
    assert_eq!([date(), date()], [[], []]);
    let event = &date()[0];
    assert_eq!((event.cause, event.channel), (Cause::Sensor, Some(SensorChannel::Clock)));
    assert!(event.text.contains("1970-01-01"), "{}", event.text);

    let mut named = |throws, contradicted| {
        feed(&mut machine, throws, |throw| throw.direction_contradicted = Some(contradicted));
        machine.monitor.caveats().len()
    };
    assert_eq!([named(4, true), named(1, true), named(1, false)], [0, 1, 0]);
}

/// Throws do not show whether a clock is right, so a new baseline and the end of a maintenance change nothing.
#[test]
fn an_alarm_about_a_clock_stays_at_a_new_baseline() {
    let mut machine = machine();
    let last = machine.throw(Vector3::zeros());
    let (now, settings) = (last.started_at, Settings::default());
    for _ in 0..3 {
        machine.monitor.date(&last.throw, Timestamp::UNIX_EPOCH, Some(now), false, &settings);
    }
    let raised = machine.monitor.take_events();
    assert_eq!(channels(&raised), [(Cause::Sensor, Some(SensorChannel::Clock))]);
    let by = "A. Person".to_owned();
    let command = Command::Rebaseline { by: by.clone(), why: "new motor".to_owned() };
    assert_eq!(machine.monitor.command(&command, now, &settings).unwrap(), []);
    let until = now + SignedDuration::from_hours(1);
    let commands =
        [Command::MaintenanceStart { until, by: by.clone(), why: "grease".into() }, Command::MaintenanceEnd { by }];
    let states = commands.map(|command| machine.monitor.command(&command, now, &settings).unwrap().remove(0).state);
    assert_eq!(states, [AlarmState::OutOfService, AlarmState::ActiveUnacknowledged]);
}

/// The remaining logger sends throws that cannot be evaluated: the alarm is about these, no longer about two loggers.
#[test]
fn the_alarm_about_two_loggers_ends_when_one_of_them_is_gone() {
    let settings = Settings::default();
    let mut machine = machine();
    let mut now = machine.throw(Vector3::zeros()).started_at;
    let mut publish = |boot_id: &str, minutes: i64| {
        now += SignedDuration::from_mins(minutes);
        let mut throw = machine.throw(Vector3::zeros());
        throw.throw = ThrowRef { boot_id: boot_id.to_owned(), ..throw.throw };
        throw.started_at = now;
        machine.monitor.boot(&throw.throw, now, Some(now), now, &settings);
        throw.outcome = None;
        machine.monitor.observe(&throw, &settings).events
    };
    let of_two: Vec<AlarmEvent> = (0..8).flat_map(|at| publish(["a", "b"][at % 2], 10)).collect();
    assert_eq!(summary(&of_two), [raised(Cause::NotMonitored)]);
    assert!(of_two[0].text.contains("two loggers publish"), "{}", of_two[0].text);
    let of_one: Vec<AlarmEvent> = (0..45).flat_map(|_| publish("a", 60)).collect();
    assert_eq!(summary(&of_one), [ended(Cause::NotMonitored), raised(Cause::NotMonitored)]);
    assert!(of_one[0].text.contains("only one logger"), "{}", of_one[0].text);
    assert!(of_one[1].text.contains("could not be evaluated"), "{}", of_one[1].text);
}

/// A logger that always names the other direction is no fault. A throw without a movement says nothing about its names.
#[test]
fn throws_without_a_movement_do_not_reverse_the_position_of_a_logger_with_exchanged_names() {
    let exchanged = |throw: Throw| {
        let direction = throw.direction.map(|direction| match direction {
            Direction::NormalToReverse => Direction::ReverseToNormal,
            Direction::ReverseToNormal => Direction::NormalToReverse,
        });
        Throw { direction, ..throw }
    };
    let mut drive = Drive::new(1, Voltage::Unknown);
    drive.logger = exchanged;
    drive.stay_healthy(40, State::SOUND);
    drive.logger = |throw| with_positions(throw, |_| 3.0);
    let events = drive.events(8, State::SOUND);
    assert!(!events.is_empty() && events.iter().all(|event| event.cause == Cause::IncompleteThrow), "{events:?}");
}

/// The sensor is mounted the wrong way round during a maintenance, whose throws count for no alarm.
#[test]
fn a_position_that_is_reversed_in_a_maintenance_is_an_alarm_after_it() {
    for thrown in [0, 1, 3] {
        let mut drive = Drive::after(40, 2, Voltage::Published);
        let (settings, by) = (Settings::default(), "A. Person".to_owned());
        let now = Timestamp::UNIX_EPOCH + SignedDuration::from_hours(2 * 24);
        let until = now + SignedDuration::from_hours(24 * 14);
        let start = Command::MaintenanceStart { until, by: by.clone(), why: "sensor".into() };
        drive.monitor.command(&start, now, &settings).unwrap();
        drive.logger = |throw| with_positions(throw, |mm| 115.0 - mm);
        assert_eq!(drive.events(thrown, State::SOUND), []);
        drive.monitor.command(&Command::MaintenanceEnd { by }, now, &settings).unwrap();
        let events = drive.events(8, State::SOUND);
        assert_eq!(channels(&events), [(Cause::Sensor, Some(SensorChannel::Position))], "{thrown}: {events:?}");
    }
}

/// Which throws count as made before a new baseline at 0 s. `before` and `after` are the throws that arrive before and
/// after it: their start and reception \[s\].
fn outdated(before: &[(f64, f64)], after: &[(f64, f64)]) -> Vec<bool> {
    let at =
        |seconds: f64| "2026-03-01T12:00:00Z".parse::<Timestamp>().unwrap() + SignedDuration::from_secs_f64(seconds);
    let mut monitor = MachineMonitor::new("21");
    let mut throw_no = 0;
    let mut dates = |monitor: &mut MachineMonitor, throws: &[(f64, f64)]| -> Vec<bool> {
        let of_throw = |&(started, received): &(f64, f64)| {
            throw_no += 1;
            let throw = ThrowRef { boot_id: "a".to_owned(), throw_no };
            let settings = Settings::default();
            monitor.date(&throw, at(started), Some(at(received)), false, &settings).is_outdated
        };
        throws.iter().map(of_throw).collect()
    };
    dates(&mut monitor, before);
    let command = Command::Rebaseline { by: "A. Person".to_owned(), why: "new motor".to_owned() };
    monitor.command(&command, at(0.0), &Settings::default()).unwrap();
    dates(&mut monitor, after)
}

/// A logger whose link is cut sends throws from before a repair after it.
#[test]
fn throws_that_were_made_before_a_new_baseline_and_arrive_later_do_not_count() {
    const HOUR: f64 = 3600.0;
    let live = |from: i32, to: i32, slow: f64| -> Vec<(f64, f64)> {
        (from..to)
            .map(|hour| HOUR * f64::from(hour))
            .map(|at| (at - slow, at + 7.0 + at.rem_euclid(3.0) / 10.0))
            .collect()
    };
    let late = |slow: f64| -> Vec<(f64, f64)> {
        (0..6).map(|throw| (HOUR * f64::from(throw - 5) - 60.0 - slow, 900.0 + f64::from(throw) / 50.0)).collect()
    };
    // The clock of the second logger is five hours behind, that of the third one ahead.
    for slow in [0.0, 5.0 * HOUR, -2.0 * HOUR] {
        assert_eq!(outdated(&live(-20, -5, slow), &late(slow)), [true; 6], "{slow}");
        assert_eq!(outdated(&live(-20, -5, slow), &live(1, 7, slow)), [false; 6], "{slow}");
    }
    assert_eq!(outdated(&live(-20, -5, 0.0), &[(-HOUR, -1.0)]), [true], "received before, and judged after");
    assert_eq!(outdated(&[], &late(0.0)), [false; 6], "the clock of the logger is unknown");
    let fast = |from: i32, to: i32| -> Vec<(f64, f64)> {
        (from..to).map(|throw| (HOUR * f64::from(throw) - 1e7, 1.5 * f64::from(throw))).collect()
    };
    assert_eq!(outdated(&fast(-20, 0), &fast(1, 7)), [false; 6], "a simulation in fast motion, dated in the past");
    let stopped = [true, false, false, false, false, false];
    assert_eq!(outdated(&live(-20, -5, 0.0), &live(1, 7, 9.0 * HOUR)), stopped, "the clock stood still in the repair");
}

/// While its clock was years ahead, a cabinet applied a command. Then no throw would count for years.
#[test]
fn a_new_baseline_in_the_future_does_not_make_throws_outdated() {
    let settings = Settings::default();
    let mut machine = machine();
    let now = machine.throw(Vector3::zeros()).started_at;
    let command =
        Command::MaintenanceStart { until: now + SignedDuration::from_hours(9_000), by: "A".into(), why: "B".into() };
    let ahead = now + SignedDuration::from_hours(8_900);
    machine.monitor.command(&command, ahead, &settings).unwrap();
    machine.monitor.command(&Command::MaintenanceEnd { by: "A".into() }, ahead, &settings).unwrap();
    let dated = |monitor: &mut MachineMonitor, throw_no| {
        let throw = ThrowRef { boot_id: "a".to_owned(), throw_no };
        monitor.date(&throw, now, Some(now), false, &settings).is_outdated
    };
    assert!(dated(&mut machine.monitor, 1));
    machine.monitor.tick(now, &settings);
    assert!(!dated(&mut machine.monitor, 2));
}

/// The motor runs on after the arrival of the toe, so a throw with a position seems shorter than one without.
#[test]
fn a_toe_sensor_that_is_fitted_later_starts_a_new_baseline() {
    for stroke_mm in [None, Some(115.0)] {
        let mut drive = Drive::new(79_900, Voltage::Published);
        (drive.has_toe_sensor, drive.stroke_mm, drive.push_s) = (false, stroke_mm, 0.12);
        drive.stay_healthy(130, State::SOUND);
        let mut started = Vec::new();
        for throw in 0..160 {
            // Throw 10 comes from another machine.
            drive.has_toe_sensor = throw == 10 || throw >= 20;
            let observation = drive.throw(State::SOUND);
            started.extend(drive.monitor.fitted(&observation).map(|_| throw));
            assert_eq!(drive.observe(&observation).events, [], "throw {throw}, stroke {stroke_mm:?}");
        }
        assert_eq!(started, [24], "stroke {stroke_mm:?}");
        assert_eq!(drive.monitor.state(), MachineState::Healthy);
        let events = drive.events(40, State { friction: 1.5, ..State::SOUND });
        assert!(events.iter().any(|event| event.cause == Cause::Friction), "{events:#?}");
    }
}

/// Duration, current and charge of such a recording are those of a part of the throw.
#[test]
fn a_recording_that_begins_after_the_inrush_shows_nothing_about_the_points() {
    for (voltage, stroke_mm) in [(Voltage::Unknown, None), (Voltage::Published, Some(115.0))] {
        let mut drive = Drive::new(79_950, voltage);
        drive.stroke_mm = stroke_mm;
        drive.stay_healthy(120, State::SOUND);
        drive.logger = |throw| {
            with_trace(throw, |rate_hz, current, position| {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0.4 s of samples")]
                let from = (0.4 * rate_hz) as usize;
                (rate_hz, current[from..].to_vec(), position[from..].to_vec())
            })
        };
        let events = drive.events(40, State::SOUND);
        let [event] = &events[..] else { panic!("{voltage:?}: {events:#?}") };
        assert_eq!(event.cause, Cause::NotMonitored, "{}", event.text);
        assert!(event.text.contains("before the motor starts"), "{}", event.text);
    }
}
