//! Alarms for throws that fail, become slow, have no estimate, or never arrive.

use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector3;
use pointsd::{
    diagnose::{
        AlarmEvent, AlarmState, Cause, Command, Irregularity, MachineMonitor, MachineState, Missing, Observation,
        Parameters, SensorChannel, Settings, Severity,
    },
    estimate::{self, Features},
    throw::{Direction, ThrowRef, utc},
};

use crate::{
    drive::{Drive, State, with_positions},
    fleet::{Machine, Scatter, channels, shift},
};

fn machine() -> Machine {
    Machine::learned(21, Scatter::USUAL)
}

fn feed(machine: &mut Machine, throws: usize, change: impl Fn(&mut Observation)) -> Vec<AlarmEvent> {
    let observe = |_| {
        let mut throw = machine.throw(Vector3::zeros());
        change(&mut throw);
        machine.observe(&throw).events
    };
    (0..throws).flat_map(observe).collect()
}

fn missing(throws: u64) -> Missing<'static> {
    Missing { throws, ..Missing::default() }
}

/// The event that raises a warning.
fn raised(cause: Cause) -> (Cause, Severity, AlarmState) {
    (cause, Severity::Warning, AlarmState::ActiveUnacknowledged)
}

/// The event that ends a warning.
fn ended(cause: Cause) -> (Cause, Severity, AlarmState) {
    (cause, Severity::Warning, AlarmState::ClearedUnacknowledged)
}

fn summary(events: &[AlarmEvent]) -> Vec<(Cause, Severity, AlarmState)> {
    events.iter().map(|event| (event.cause, event.severity, event.state)).collect()
}

#[test]
fn an_incomplete_throw_is_reported_at_once_and_a_second_is_critical() {
    use AlarmState::{ActiveUnacknowledged, ClearedUnacknowledged};
    let mut machine = machine();
    let failed = feed(&mut machine, 2, |o| (o.incomplete, o.estimate) = (true, None));
    assert_eq!(
        summary(&failed),
        [
            (Cause::IncompleteThrow, Severity::Warning, ActiveUnacknowledged),
            (Cause::IncompleteThrow, Severity::Critical, ActiveUnacknowledged)
        ]
    );
    let well = feed(&mut machine, 20, |_| {});
    assert_eq!(summary(&well), [(Cause::IncompleteThrow, Severity::Critical, ClearedUnacknowledged)]);
}

/// With an off delay of one throw, each complete throw of the other direction ends the alarm.
#[test]
fn each_incomplete_throw_of_one_direction_has_an_alarm_if_complete_ones_end_it() {
    let settings = Settings { off_delay_throws: 1, ..Settings::default() };
    let mut machine = Machine::learned_with(21, Scatter::USUAL, settings);
    let failing = Direction::BOTH[machine.side()];
    let events = feed(&mut machine, 8, |o| {
        if o.direction == Some(failing) {
            (o.incomplete, o.estimate) = (true, None);
        }
    });
    let raised = events.iter().filter(|event| event.cause == Cause::IncompleteThrow && event.state.is_active());
    let severities: Vec<_> = raised.map(|event| event.severity).collect();
    assert_eq!(severities, [Severity::Warning, Severity::Critical, Severity::Critical, Severity::Critical]);
}

#[test]
fn traces_that_show_nothing_do_not_complete_a_throw() {
    let mut machine = machine();
    let failed = feed(&mut machine, 1, |o| (o.incomplete, o.estimate) = (true, None));
    assert_eq!(summary(&failed), [raised(Cause::IncompleteThrow)]);
    let unread = feed(&mut machine, 20, |o| (o.features, o.estimate) = (Features::default(), None));
    assert!(unread.iter().all(|event| event.cause != Cause::IncompleteThrow), "{unread:?}");
    let failed = feed(&mut machine, 1, |o| (o.incomplete, o.estimate) = (true, None));
    assert!(
        summary(&failed).contains(&(Cause::IncompleteThrow, Severity::Critical, AlarmState::ActiveUnacknowledged)),
        "{failed:?}"
    );
    let well = feed(&mut machine, 20, |_| {});
    assert!(well.iter().any(|event| event.cause == Cause::IncompleteThrow && !event.state.is_active()), "{well:?}");
}

/// A logger may fail in another way while the alarm about its gap is open.
#[test]
fn another_irregularity_during_an_alarm_about_lost_data_is_an_event() {
    let (mut machine, settings) = (machine(), Settings::default());
    let last = machine.throw(Vector3::zeros()).started_at;
    let [gap, soon, later] = [1, 5, 20].map(|minutes| last + SignedDuration::from_mins(minutes));
    assert_eq!(summary(&machine.monitor.gap(missing(3), gap, &settings)), [raised(Cause::DataLoss)]);
    let mut repeats = |at| machine.monitor.irregular(Irregularity::RepeatedTrace, None, at, &settings).is_some();
    assert_eq!([repeats(soon), repeats(later), repeats(later)], [false, true, false]);
}

/// With a weak gain of the position sensor complete throws seem shorter than 95 % of the configured stroke.
#[test]
fn a_weak_gain_of_the_position_is_an_alarm_about_its_sensor_and_no_incomplete_throw() {
    for publishes_volts in [true, false] {
        let mut drive = Drive::with_stroke(120, 71, publishes_volts);
        let weak = State { position_gain: 0.94, ..State::SOUND };
        let events = drive.events(30, weak);
        assert_eq!(channels(&events), [(Cause::Sensor, Some(SensorChannel::Position))], "{events:?}");
    }
}

/// The position ends as with a weak gain of its sensor, but for another reason: the motor stalls before an obstruction
/// for longer than the detection of the end needs, or loses its supply.
#[test]
fn an_obstruction_shortly_before_the_end_is_an_incomplete_throw() {
    for push_s in [0.0, 0.15, 0.3, 1.0, 4.0] {
        let mut drive = Drive::with_stroke(40, 74, true);
        drive.push_s = push_s;
        let blocked = State { stroke: 0.94, ..State::SOUND };
        let events = drive.events(2, blocked);
        let named: Vec<_> = events.iter().map(|event| (event.cause, event.severity)).collect();
        let expected = [Severity::Warning, Severity::Critical].map(|severity| (Cause::IncompleteThrow, severity));
        assert_eq!(named, expected, "{push_s} s: {events:?}");
    }
}

#[test]
fn slow_throws_show_even_where_the_coefficients_do_not() {
    let mut machine = machine();
    let slow = |o: &mut Observation| o.features.duration_s = Some(4.3 * 1.3);
    let events = feed(&mut machine, 10, slow);
    assert_eq!(summary(&events), [raised(Cause::SlowThrow)]);
    assert!((events[0].change_pct.unwrap() - 30.0).abs() < 1.0);
}

#[test]
fn a_machine_whose_throws_cannot_be_evaluated_is_not_monitored() {
    let mut machine = machine();
    assert_eq!(summary(&feed(&mut machine, 25, |o| o.estimate = None)), [raised(Cause::NotMonitored)]);
    assert_eq!(machine.monitor.state(), MachineState::NotMonitored);
    // One accepted throw among many rejected ones does not end the alarm.
    for _ in 0..5 {
        assert_eq!(feed(&mut machine, 1, |_| {}), []);
        assert_eq!(feed(&mut machine, 12, |o| o.estimate = None), []);
    }
    assert_eq!(summary(&feed(&mut machine, 8, |_| {})), [ended(Cause::NotMonitored)]);
    assert_eq!(machine.monitor.state(), MachineState::Healthy);
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
    mut each: impl FnMut(&mut MachineMonitor, jiff::Timestamp) -> Option<AlarmEvent>,
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
    // After its return with throws without an estimate the machine is still not monitored.
    assert_eq!(summary(&pass(&mut machine.monitor, &mut now, 15, away)), [raised]);
    let many = i64::from(settings.not_monitored_throws);
    assert_eq!(feed(&mut machine, many.try_into().unwrap(), |o| o.estimate = None), []);
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
    assert_eq!(summary(&Vec::from_iter(low)), [raised(Cause::DataLoss)]);
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

#[test]
fn impossible_estimates_cause_no_panic_and_are_not_learned() {
    let settings = Settings::default();
    let mut machine = Machine::new(22, Scatter::USUAL);
    for at in 0..3 {
        for value in [f64::NAN, f64::INFINITY, 0.0, -1.0, f64::MIN_POSITIVE] {
            let mut observation = machine.throw(Vector3::zeros());
            observation.estimate.as_mut().unwrap().0[at] = value;
            machine.observe(&observation);
        }
        for value in [f64::NAN, f64::INFINITY, -1.0, 1e9] {
            let mut observation = machine.throw(Vector3::zeros());
            observation.estimate.as_mut().unwrap().1[(at, at)] = value;
            machine.observe(&observation);
        }
    }
    for direction in pointsd::throw::Direction::BOTH {
        assert_eq!(machine.monitor.baseline_progress(direction, &settings).0, 0);
    }
}

/// With a wrong zero of the position all throws of one direction may be rejected, while the other is healthy.
#[test]
fn a_direction_whose_throws_cannot_be_evaluated_is_not_monitored() {
    let mut machine = machine();
    let back = |o: &mut Observation| {
        o.estimate = o.estimate.filter(|_| o.direction == Some(Direction::NormalToReverse));
        o.rejected = o.estimate.is_none().then_some("misfit");
    };
    let events = feed(&mut machine, 60, back);
    assert_eq!(summary(&events), [raised(Cause::NotMonitored)]);
    let text = &events[0].text;
    assert!(text.contains("reverse to normal") && text.contains("Check for a load that varies"), "{text}");
    assert_eq!(machine.monitor.state(), MachineState::NotMonitored);
    assert_eq!(summary(&feed(&mut machine, 8, |_| {})), [ended(Cause::NotMonitored)]);
}

/// Estimates with another `neutral_mm` cannot be compared with the baseline.
#[test]
fn another_configuration_of_the_machine_starts_a_new_baseline() {
    let mut machine = machine();
    let before = estimate::Settings::default();
    let after = estimate::Settings { neutral_mm: 57.3, ..estimate::Settings::default() };
    let at = machine.throw(Vector3::zeros()).started_at;
    let mut configured = |settings: &estimate::Settings| machine.monitor.configured(Parameters::of(settings), at);
    assert_eq!(configured(&before), None);
    assert_eq!(configured(&before), None);
    let (command, _) = configured(&after).unwrap();
    assert_eq!(command.why(), Some("the configuration of the machine changed: neutral_mm from 0 to 57.3"));
    assert_eq!(configured(&after), None);
    assert_eq!(machine.monitor.state(), MachineState::Learning);
}

#[test]
fn messages_that_are_no_throws_and_a_wrong_clock_are_alarms_and_wrong_directions_a_caveat() {
    let mut machine = machine();
    let last = machine.throw(Vector3::zeros());
    let invalid = Irregularity::Invalid { count: 5, reason: "direction \"N\" is unknown" };
    let event = machine.monitor.irregular(invalid, None, last.started_at, &Settings::default()).unwrap();
    assert_eq!((event.cause, event.severity), (Cause::DataLoss, Severity::Warning));
    assert!(event.text.contains("the last 5 messages") && event.text.contains("\"N\""), "{}", event.text);

    let mut machine = self::machine();
    let dated = [1, 2, 3].map(|_| {
        machine.monitor.date(&last.throw, Timestamp::UNIX_EPOCH, Some(last.started_at), false, &Settings::default())
    });
    assert!(dated.iter().all(|dated| dated.at == last.started_at) && dated[1].event.is_none());
    let event = dated[2].event.as_ref().unwrap();
    assert_eq!((event.cause, event.channel), (Cause::Sensor, Some(SensorChannel::Clock)));
    assert!(event.text.contains("1970-01-01"), "{}", event.text);

    let mut named = |throws, contradicted| {
        feed(&mut machine, throws, |throw| throw.direction_contradicted = Some(contradicted));
        machine.monitor.caveats().len()
    };
    assert_eq!([named(4, true), named(1, true), named(1, false)], [0, 1, 0]);
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

/// After the loss of a snapshot nothing else would end the alarm, and its fault may still exist.
#[test]
fn the_alarm_of_a_lost_monitor_stays_until_it_is_acknowledged() {
    let mut machine = machine();
    let lost = feed(&mut machine, 1, |o| (o.incomplete, o.estimate) = (true, None)).remove(0);
    let mut fresh = MachineMonitor::new("21");
    let adopted = fresh.adopt(lost.clone(), lost.event_at).remove(0);
    assert_eq!((adopted.event_no, adopted.state), (lost.event_no + 1, AlarmState::ClearedUnacknowledged));
    let ack = Command::Ack { cause: lost.cause, by: "mia".to_owned() };
    let events = fresh.command(&ack, lost.event_at, &Settings::default()).unwrap();
    assert_eq!((events[0].event_no, events[0].state), (lost.event_no + 2, AlarmState::Normal));
    assert!(fresh.open_alarms().is_empty());
}

/// Points move to and fro, so a fault of one direction never shows in two consecutive throws.
#[test]
fn slow_and_incomplete_throws_of_one_direction_are_counted() {
    let there = |o: &Observation| o.direction == Some(Direction::NormalToReverse);
    let mut first = machine();
    let slow = |o: &mut Observation| {
        if there(o) {
            o.features.duration_s = Some(4.3 * 1.68);
        }
    };
    let events = feed(&mut first, 10, slow);
    assert_eq!(summary(&events), [(Cause::SlowThrow, Severity::Critical, AlarmState::ActiveUnacknowledged)]);

    let mut second = machine();
    let events = feed(&mut second, 4, |o| {
        if there(o) {
            (o.incomplete, o.estimate) = (true, None);
        }
    });
    let severities: Vec<_> = events.iter().map(|event| (event.cause, event.severity)).collect();
    assert_eq!(severities, [(Cause::IncompleteThrow, Severity::Warning), (Cause::IncompleteThrow, Severity::Critical)]);
}

/// The present size of a drift must not come from old throws.
#[test]
fn without_evaluated_throws_the_present_size_is_unknown() {
    let mut machine = machine();
    machine.events(30, shift(Cause::Friction, 45.0));
    assert_eq!(machine.monitor.drifts().len(), 1);
    feed(&mut machine, 23, |o| o.estimate = None);
    assert_eq!(machine.monitor.drifts().len(), 1);
    feed(&mut machine, 1, |o| o.estimate = None);
    assert_eq!(machine.monitor.drifts(), []);
    assert!(machine.monitor.open_alarms().iter().any(|alarm| alarm.cause == Cause::Friction));
    machine.feed(shift(Cause::Friction, 45.0));
    assert_eq!(machine.monitor.drifts().len(), 1);
}

#[test]
fn a_toe_sensor_that_disappears_is_an_alarm_until_a_new_baseline() {
    let mut machine = machine();
    let without =
        |o: &mut Observation| (o.features_only, o.estimate, o.features.running_current_a) = (true, None, Some(2.0));
    let events = feed(&mut machine, 25, without);
    assert_eq!(events[0].channel, Some(SensorChannel::Position));
    assert_eq!(machine.monitor.state(), MachineState::NotMonitored);
    // The sensor was removed for good.
    let at = machine.throw(Vector3::zeros()).started_at;
    let rebaseline = Command::Rebaseline { by: "mia".to_owned(), why: "no toe sensor any more".to_owned() };
    machine.monitor.command(&rebaseline, at, &Settings::default()).unwrap();
    let events = feed(&mut machine, 25, without);
    assert!(events.iter().all(|event| event.cause != Cause::Sensor), "{events:?}");
    assert_ne!(machine.monitor.state(), MachineState::NotMonitored);
}

/// All sensors share one alarm, so a second faulty sensor is a new event of this alarm.
#[test]
fn a_second_faulty_sensor_is_not_hidden_by_the_first() {
    let mut machine = machine();
    let hot = |o: &mut Observation| o.temperature_c = Some(850.0);
    let both = |o: &mut Observation| {
        hot(o);
        (o.faulty, o.estimate) = (Some(SensorChannel::Position), None);
    };
    let sensors = |events: &[AlarmEvent]| -> Vec<_> {
        let sensor = events.iter().filter(|event| event.cause == Cause::Sensor);
        sensor.map(|event| (event.channel, event.state)).collect()
    };
    let (unseen, over) = (AlarmState::ActiveUnacknowledged, AlarmState::ClearedUnacknowledged);
    let events = feed(&mut machine, 20, hot);
    assert_eq!(sensors(&events), [(Some(SensorChannel::Temperature), unseen)]);
    let ack = Command::Ack { cause: Cause::Sensor, by: "mia".to_owned() };
    machine.monitor.command(&ack, events[0].event_at, &Settings::default()).unwrap();
    // One event, although both sensors are faulty in each throw.
    let events = feed(&mut machine, 10, both);
    assert_eq!(sensors(&events), [(Some(SensorChannel::Position), unseen)]);
    assert!(events[0].text.contains("position sensor"), "{}", events[0].text);
    // The position sensor is mended, and the other is still faulty.
    let events = feed(&mut machine, 20, hot);
    assert_eq!(sensors(&events), [(Some(SensorChannel::Position), over), (Some(SensorChannel::Temperature), unseen)]);
    let events = feed(&mut machine, 20, |_| {});
    assert_eq!(sensors(&events), [(Some(SensorChannel::Temperature), over)]);
}

/// At the end of a maintenance the rules forget the last throws, so the alarms that come from them must end too.
#[test]
fn no_alarm_of_a_sensor_outlives_a_maintenance_that_mends_it() {
    let mut machine = machine();
    feed(&mut machine, 5, |o| (o.faulty, o.estimate) = (Some(SensorChannel::Position), None));
    assert_eq!(machine.monitor.state(), MachineState::Warning);
    let at = machine.throw(Vector3::zeros()).started_at;
    let start = Command::MaintenanceStart {
        until: at + SignedDuration::from_hours(1),
        by: "mia".to_owned(),
        why: "new sensor".to_owned(),
    };
    for command in [start, Command::MaintenanceEnd { by: "mia".to_owned() }] {
        machine.monitor.command(&command, at, &Settings::default()).unwrap();
    }
    feed(&mut machine, 40, |_| {});
    assert_eq!(machine.monitor.state(), MachineState::Healthy);
}

#[test]
fn a_position_in_another_unit_is_a_caveat_and_no_throw_is_refused() {
    let mut drive = Drive::after(40, 72, true);
    let asks = |drive: &Drive| drive.monitor.caveats().iter().any(|caveat| caveat.contains("in centimetres (115 mm)"));
    assert!(!asks(&drive), "{:?}", drive.monitor.caveats());
    drive = Drive::new(72, true);
    drive.logger = |throw| with_positions(throw, |mm| 0.1 * mm);
    drive.stay_healthy(40, State::SOUND);
    assert!(asks(&drive), "{:?}", drive.monitor.caveats());
    for (travel_mm, unit) in [(11.4, "centimetres"), (4.5, "inches")] {
        let text = estimate::Rejection::Incomplete { travel_mm, stroke_mm: 115.0 }.to_string();
        assert!(text.contains(unit), "{text}");
    }
    let stuck = estimate::Rejection::Incomplete { travel_mm: 60.0, stroke_mm: 115.0 }.to_string();
    assert!(!stuck.contains("position_mm"), "{stuck}");
}
