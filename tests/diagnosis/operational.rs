//! Alarms for throws that fail, become slow, or have no estimate, and about sensors.

use nalgebra::Vector3;
use pointsd::{
    diagnose::{
        AlarmEvent, AlarmState, Cause, Command, Estimated, MachineMonitor, MachineState, Observation, Parameters,
        SensorChannel, Settings, Severity,
    },
    estimate::{self, Features, Rejection},
    throw::{Channel, Direction},
};

use crate::{
    drive::{Drive, State, Voltage, with_positions},
    fleet::{Machine, Scatter, channels, shift},
};

pub(crate) fn machine() -> Machine {
    Machine::learned(21, Scatter::USUAL)
}

/// Makes the throw an incomplete one.
pub(crate) fn fail(throw: &mut Observation) {
    throw.outcome = Some(Err(Rejection::NoMovement));
}

/// Makes the position of the throw useless.
pub(crate) fn disturb(throw: &mut Observation) {
    let noisy = Rejection::Noisy { channel: Channel::Position, measured: 2.0, expected: Some(0.02) };
    throw.outcome = Some(Err(noisy));
}

/// The estimate of an evaluated throw.
fn estimate_of(throw: &mut Observation) -> &mut Estimated {
    throw.outcome.as_mut().unwrap().as_mut().unwrap()
}

pub(crate) fn feed(machine: &mut Machine, throws: usize, change: impl Fn(&mut Observation)) -> Vec<AlarmEvent> {
    let observe = |_| {
        let mut throw = machine.throw(Vector3::zeros());
        change(&mut throw);
        machine.observe(&throw).events
    };
    (0..throws).flat_map(observe).collect()
}

/// The event that raises a warning.
pub(crate) fn raised(cause: Cause) -> (Cause, Severity, AlarmState) {
    (cause, Severity::Warning, AlarmState::ActiveUnacknowledged)
}

/// The event that ends a warning.
pub(crate) fn ended(cause: Cause) -> (Cause, Severity, AlarmState) {
    (cause, Severity::Warning, AlarmState::ClearedUnacknowledged)
}

pub(crate) fn summary(events: &[AlarmEvent]) -> Vec<(Cause, Severity, AlarmState)> {
    events.iter().map(|event| (event.cause, event.severity, event.state)).collect()
}

#[test]
fn an_incomplete_throw_is_reported_at_once_and_a_second_is_critical() {
    use AlarmState::{ActiveUnacknowledged, ClearedUnacknowledged};
    let mut machine = machine();
    let failed = feed(&mut machine, 2, fail);
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
            fail(o);
        }
    });
    let raised = events.iter().filter(|event| event.cause == Cause::IncompleteThrow && event.state.is_active());
    let severities: Vec<_> = raised.map(|event| event.severity).collect();
    assert_eq!(severities, [Severity::Warning, Severity::Critical, Severity::Critical, Severity::Critical]);
}

#[test]
fn traces_that_show_nothing_do_not_complete_a_throw() {
    let mut machine = machine();
    let failed = feed(&mut machine, 1, fail);
    assert_eq!(summary(&failed), [raised(Cause::IncompleteThrow)]);
    let unread = feed(&mut machine, 20, |o| (o.features, o.outcome) = (Features::default(), None));
    assert!(unread.iter().all(|event| event.cause != Cause::IncompleteThrow), "{unread:?}");
    let failed = feed(&mut machine, 1, fail);
    assert!(
        summary(&failed).contains(&(Cause::IncompleteThrow, Severity::Critical, AlarmState::ActiveUnacknowledged)),
        "{failed:?}"
    );
    let well = feed(&mut machine, 20, |_| {});
    assert!(well.iter().any(|event| event.cause == Cause::IncompleteThrow && !event.state.is_active()), "{well:?}");
}

/// With a weak gain of the position sensor complete throws seem shorter than 95 % of the configured stroke.
#[test]
fn a_weak_gain_of_the_position_is_an_alarm_about_its_sensor_and_no_incomplete_throw() {
    for voltage in Voltage::BOTH {
        let mut drive = Drive::with_stroke(120, 71, voltage);
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
        let mut drive = Drive::with_stroke(40, 74, Voltage::Published);
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
    assert_eq!(summary(&feed(&mut machine, 25, |o| o.outcome = None)), [raised(Cause::NotMonitored)]);
    assert_eq!(machine.monitor.state(), MachineState::NotMonitored);
    // One accepted throw among many rejected ones does not end the alarm.
    for _ in 0..5 {
        assert_eq!(feed(&mut machine, 1, |_| {}), []);
        assert_eq!(feed(&mut machine, 12, |o| o.outcome = None), []);
    }
    assert_eq!(summary(&feed(&mut machine, 8, |_| {})), [ended(Cause::NotMonitored)]);
    assert_eq!(machine.monitor.state(), MachineState::Healthy);
}

#[test]
fn impossible_estimates_cause_no_panic_and_are_not_learned() {
    let settings = Settings::default();
    let mut machine = Machine::new(22, Scatter::USUAL);
    for at in 0..3 {
        for value in [f64::NAN, f64::INFINITY, 0.0, -1.0, f64::MIN_POSITIVE] {
            let mut observation = machine.throw(Vector3::zeros());
            estimate_of(&mut observation).coefficients[at] = value;
            machine.observe(&observation);
        }
        for value in [f64::NAN, f64::INFINITY, -1.0, 1e9] {
            let mut observation = machine.throw(Vector3::zeros());
            estimate_of(&mut observation).covariance[(at, at)] = value;
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
        if o.direction != Some(Direction::NormalToReverse) {
            o.outcome = Some(Err(Rejection::Misfit { peak_mm: 2.0, at_s: 1.0 }));
        }
    };
    let events = feed(&mut machine, 60, back);
    assert_eq!(summary(&events), [raised(Cause::NotMonitored)]);
    let text = &events[0].text;
    assert!(text.contains("reverse to normal") && text.contains("Check for a load that varies"), "{text}");
    assert_eq!(events[0].direction, Some(Direction::ReverseToNormal));
    assert_eq!(machine.monitor.state(), MachineState::NotMonitored);
    // The other direction too is a worse fault.
    let both = feed(&mut machine, 40, |o| o.outcome = Some(Err(Rejection::Misfit { peak_mm: 2.0, at_s: 1.0 })));
    assert_eq!(summary(&both), [raised(Cause::NotMonitored)]);
    assert!(
        both[0].direction.is_none() && both[0].text.contains("so the machine is not monitored"),
        "{}",
        both[0].text
    );
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
    let command = configured(&after).unwrap();
    assert_eq!(command.why(), Some("the configuration of the machine changed: neutral_mm from 0 to 57.3"));
    assert_eq!(configured(&after), None);
    assert_eq!(machine.monitor.state(), MachineState::Learning);
}

/// Without a toe sensor the coefficients come from the configured stroke, so a corrected one changes them all.
#[test]
fn a_corrected_stroke_starts_a_new_baseline_only_without_a_toe_sensor() {
    let mut machine = machine();
    let at = machine.throw(Vector3::zeros()).started_at;
    let stroke = |stroke_mm| Parameters::of(&estimate::Settings { stroke_mm, ..estimate::Settings::default() });
    let strokes = [None, Some(100.0), Some(115.0), Some(115.0), None];
    let mut without = MachineMonitor::new("22");
    for (monitor, expected) in [(&mut machine.monitor, 0), (&mut without, 1)] {
        let commands: Vec<_> = strokes.iter().filter_map(|mm| monitor.configured(stroke(*mm), at)).collect();
        let why = "the configuration of the machine changed: stroke_mm from 100 to 115";
        assert_eq!(commands.len(), expected);
        assert!(commands.iter().all(|command| command.why() == Some(why)), "{commands:?}");
    }
}

/// After the loss of a snapshot nothing else would end the alarm, and its fault may still exist.
#[test]
fn the_alarm_of_a_lost_monitor_stays_until_it_is_acknowledged() {
    let mut machine = machine();
    let lost = feed(&mut machine, 1, fail).remove(0);
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
            fail(o);
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
    feed(&mut machine, 23, |o| o.outcome = None);
    assert_eq!(machine.monitor.drifts().len(), 1);
    feed(&mut machine, 1, |o| o.outcome = None);
    assert_eq!(machine.monitor.drifts(), []);
    assert!(machine.monitor.open_alarms().iter().any(|alarm| alarm.cause == Cause::Friction));
    machine.feed(shift(Cause::Friction, 45.0));
    assert_eq!(machine.monitor.drifts().len(), 1);
}

#[test]
fn a_toe_sensor_that_disappears_is_an_alarm_until_a_new_baseline() {
    let mut machine = machine();
    let without = |o: &mut Observation| {
        let no_position = Rejection::NoPosition { sent: "", why: String::new() };
        (o.outcome, o.features.running_current_a) = (Some(Err(no_position)), Some(2.0));
    };
    let events = feed(&mut machine, 25, without);
    assert_eq!(events[0].channel, Some(SensorChannel::Position));
    assert_eq!(machine.monitor.state(), MachineState::NotMonitored);
    let caveats = machine.monitor.caveats();
    assert!(!caveats.iter().any(|caveat| caveat.contains("charge are monitored")), "{caveats:?}");
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
        disturb(o);
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
    let events = feed(&mut machine, 20, |throw| throw.temperature_c = Some(12.0));
    assert_eq!(sensors(&events), [(Some(SensorChannel::Temperature), over)]);
}

/// The alarm about a mended sensor ends, although another one was disturbed once in the meantime.
#[test]
fn a_disturbance_of_another_sensor_keeps_no_alarm_of_a_mended_one() {
    let mut machine = machine();
    let events = feed(&mut machine, 4, disturb);
    assert_eq!(channels(&events), [(Cause::Sensor, Some(SensorChannel::Position))]);
    assert_eq!(feed(&mut machine, 8, |_| {}), []);
    let noisy = Rejection::Noisy { channel: Channel::Current, measured: 2.0, expected: Some(0.02) };
    assert_eq!(feed(&mut machine, 1, |throw| throw.outcome = Some(Err(noisy.clone()))), []);
    assert_eq!(summary(&feed(&mut machine, 20, |_| {})), [ended(Cause::Sensor)]);
}

/// A sensor that fails while another one is faulty has its own event, and the text still names the first.
#[test]
fn a_wrong_voltage_is_not_hidden_by_a_wrong_temperature() {
    let mut machine = machine();
    let hot = |throw: &mut Observation| throw.temperature_c = Some(850.0);
    let both = |throw: &mut Observation| {
        hot(throw);
        throw.features.supply_v = Some(0.0);
    };
    let only_volts = |throw: &mut Observation| throw.features.supply_v = Some(0.0);
    assert_eq!(channels(&feed(&mut machine, 20, hot)), [(Cause::Sensor, Some(SensorChannel::Temperature))]);
    let events = feed(&mut machine, 20, both);
    assert_eq!(channels(&events), [(Cause::Sensor, Some(SensorChannel::Supply))]);
    assert!(events[0].text.contains("0 V") && events[0].text.contains("850"), "{}", events[0].text);
    assert_eq!(feed(&mut machine, 20, only_volts), [], "the voltage is still wrong");
    let right = |throw: &mut Observation| throw.features.supply_v = Some(110.0);
    assert_eq!(summary(&feed(&mut machine, 20, right)), [ended(Cause::Sensor)]);
}

/// A logger may leave out a value that its sensor does not give, and a trace may be unreadable.
#[test]
fn throws_without_a_value_do_not_end_the_alarm_about_its_sensor() {
    type Change = fn(&mut Observation);
    let cold: Change = |throw| throw.temperature_c = Some(-200.0);
    let mild: Change = |throw| throw.temperature_c = Some(12.0);
    let dead: Change = |throw| throw.features.supply_v = Some(0.0);
    let live: Change = |throw| throw.features.supply_v = Some(110.0);
    let unread: Change = |throw| (throw.features, throw.outcome) = (Features::default(), None);
    for (wrong, missing, right) in [(cold, (|_| {}) as Change, mild), (dead, |_| {}, live), (disturb, unread, |_| {})] {
        let mut machine = machine();
        assert_eq!(summary(&feed(&mut machine, 4, wrong)), [raised(Cause::Sensor)]);
        assert_eq!(feed(&mut machine, 15, missing), []);
        assert_eq!(summary(&feed(&mut machine, 20, right)), [ended(Cause::Sensor)]);
    }
}

#[test]
fn a_position_in_another_unit_is_a_caveat_and_no_throw_is_refused() {
    let mut drive = Drive::after(40, 72, Voltage::Published);
    let asks = |drive: &Drive| drive.monitor.caveats().iter().any(|caveat| caveat.contains("in centimetres (115 mm)"));
    assert!(!asks(&drive), "{:?}", drive.monitor.caveats());
    drive = Drive::new(72, Voltage::Published);
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

/// The motor runs on after the arrival of the toe, which only a toe sensor shows.
#[test]
fn a_lost_toe_sensor_makes_no_throw_slow() {
    let mut drive = Drive::new(31, Voltage::Unknown);
    (drive.stroke_mm, drive.push_s) = (Some(115.0), 1.0);
    drive.stay_healthy(110, State::SOUND);
    drive.has_toe_sensor = false;
    let events = drive.events(40, State::SOUND);
    let causes: Vec<Cause> = events.iter().map(|event| event.cause).collect();
    assert_eq!(causes, [Cause::Sensor, Cause::NotMonitored], "{events:?}");
}

/// The duration of a recording that ends before the toe arrives is a lower bound.
#[test]
fn throws_that_are_cut_off_do_not_end_the_alarm_about_slow_ones() {
    let mut machine = machine();
    let lasts = |factor: f64| move |o: &mut Observation| o.features.duration_s = Some(4.3 * factor);
    let cut = |o: &mut Observation| {
        (o.outcome, o.features.duration_s) = (Some(Err(Rejection::EndMissing { travel_mm: 80.0 })), Some(4.0));
    };
    assert_eq!(summary(&feed(&mut machine, 10, lasts(1.3))), [raised(Cause::SlowThrow)]);
    let events = feed(&mut machine, 40, cut);
    assert!(events.iter().all(|event| event.cause != Cause::SlowThrow), "{events:?}");
    let events = feed(&mut machine, 20, lasts(1.0));
    assert!(summary(&events).contains(&ended(Cause::SlowThrow)), "{events:?}");
}

/// Fast throws of the other direction say nothing about a slow one that is cut off now.
#[test]
fn fast_throws_of_one_direction_do_not_end_the_alarm_about_the_other() {
    let mut machine = machine();
    let one_slow = |is_cut: bool| {
        move |o: &mut Observation| {
            let is_slow = o.direction == Some(Direction::ReverseToNormal);
            o.features.duration_s = Some(if is_slow && !is_cut { 4.3 * 1.3 } else { 4.3 });
            if is_slow && is_cut {
                o.outcome = Some(Err(Rejection::EndMissing { travel_mm: 80.0 }));
            }
        }
    };
    assert_eq!(summary(&feed(&mut machine, 10, one_slow(false))), [raised(Cause::SlowThrow)]);
    let events = feed(&mut machine, 60, one_slow(true));
    assert!(events.iter().all(|event| event.cause != Cause::SlowThrow), "{events:?}");
    let events = feed(&mut machine, 40, |o| o.features.duration_s = Some(4.3));
    assert!(summary(&events).contains(&ended(Cause::SlowThrow)), "{events:?}");
}

#[test]
fn a_wrong_clock_explains_slow_throws() {
    for (is_clock, slow) in [(true, 0), (false, 1)] {
        let mut machine = machine();
        let too_slow = |o: &mut Observation| {
            o.outcome = Some(Err(Rejection::TooSlow { duration_s: 60.0, longest_s: 30.0, rate_hz: 33.0 }));
        };
        let events = feed(&mut machine, if is_clock { 3 } else { 0 }, too_slow);
        assert_eq!(events.iter().any(|event| event.channel == Some(SensorChannel::Clock)), is_clock, "{events:?}");
        let events = feed(&mut machine, 6, |o| o.features.duration_s = Some(4.3 * 1.3));
        assert_eq!(events.iter().filter(|event| event.cause == Cause::SlowThrow).count(), slow, "{events:?}");
    }
}

/// Less friction does not make a throw slow, and hides no other reason.
#[test]
fn only_a_drift_that_lengthens_a_throw_explains_slow_throws() {
    let slow_beside = |pct: f64| {
        let mut machine = machine();
        let drift = shift(Cause::Friction, pct);
        assert_eq!(machine.events(40, drift)[0].cause, Cause::Friction);
        let feed = |_| {
            let mut throw = machine.throw(drift);
            throw.features.duration_s = throw.features.duration_s.map(|duration_s| 1.35 * duration_s);
            machine.observe(&throw).events
        };
        (0..12).flat_map(feed).any(|event| event.cause == Cause::SlowThrow)
    };
    assert!(slow_beside(-40.0));
    assert!(!slow_beside(30.0));
}

/// The last good temperature counts while the alarm about the sensor is active.
#[test]
fn a_failed_thermometer_explains_no_change_of_the_features() {
    let mut drive = Drive::new(32, Voltage::Unknown);
    drive.has_toe_sensor = false;
    let at = |celsius: f64| move |throw: &mut Observation| throw.temperature_c = Some(celsius);
    assert_eq!(drive.events_with(120, State::SOUND, at(10.0)), []);
    let events = drive.events_with(60, State { friction: 1.6, ..State::SOUND }, at(-127.0));
    assert!(events.iter().any(|event| event.cause == Cause::Unattributed), "{events:?}");
}

/// Their normal values are learned anew, so these alarms do not come back.
#[test]
fn a_new_baseline_ends_the_alarms_that_compare_with_the_old_one() {
    let mut drive = Drive::after(110, 34, Voltage::Published);
    let [raised] = &drive.events(40, State { ohms: 2.0, ..State::SOUND })[..] else { panic!("one alarm") };
    assert_eq!(raised.cause, Cause::Supply);
    let rebaseline = Command::Rebaseline { by: "mia".to_owned(), why: "new cable".to_owned() };
    let ended = drive.monitor.command(&rebaseline, raised.event_at, &Settings::default()).unwrap();
    assert_eq!(summary(&ended), [(Cause::Supply, Severity::Warning, AlarmState::Normal)]);
    assert!(ended[0].text.contains("new baseline"), "{}", ended[0].text);

    let mut slow = machine();
    feed(&mut slow, 5, |o| o.features.duration_s = Some(8.0));
    let mut hot = machine();
    feed(&mut hot, 20, |o| o.temperature_c = Some(850.0));
    // Its scatter hides critical changes, so that its alarm asks for a new baseline.
    let natural = Scatter::USUAL;
    let wide = Scatter { sd: natural.sd.map(|sd| 3.0 * sd), phi: 0.97, ..natural };
    let mut blind = Machine::learned(90_000, wide);
    blind.events(100, Vector3::zeros());
    for (mut machine, cause, severity) in [
        (slow, Cause::SlowThrow, Severity::Critical),
        (hot, Cause::Sensor, Severity::Warning),
        (blind, Cause::NotMonitored, Severity::Warning),
    ] {
        let at = machine.throw(Vector3::zeros()).started_at;
        let ended = machine.monitor.command(&rebaseline, at, &Settings::default()).unwrap();
        assert_eq!(summary(&ended), [(cause, severity, AlarmState::Normal)]);
        // Throws from before the command are not counted on.
        assert_eq!(feed(&mut machine, 1, |o| o.temperature_c = Some(850.0)), []);
    }
}
