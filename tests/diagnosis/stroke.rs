//! Points that stop at another place, and a motor that runs on where they stop. The coefficients stay as they were.

use std::cell::Cell;

use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, Command, MachineState, Observation, Settings, Severity},
    estimate::Rejection,
    throw::Direction,
};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::in_parallel,
};

fn is_about(event: &AlarmEvent, part: &str) -> bool {
    event.cause == Cause::Unattributed && event.text.contains(part)
}

/// The stroke is not configured.
#[test]
fn a_toe_that_stops_short_is_found_without_a_configured_stroke() {
    let lives = in_parallel(6, |seed| {
        let mut drive = Drive::after(60, 78_000 + seed, Voltage::alternating(seed));
        let shortened = [0.93, 0.83][usize::try_from(seed % 2).unwrap()];
        let events = if seed < 4 {
            drive.events(30, State { stroke: shortened, ..State::SOUND })
        } else {
            let at = |throw: i32| State { stroke: 1.0 - (1.0 - shortened) * f64::from(throw) / 100.0, ..State::SOUND };
            (0..=100).flat_map(|throw| drive.feed(at(throw)).events).collect()
        };
        (seed, events)
    });
    for (seed, events) in lives {
        assert!(!events.is_empty() && events.iter().all(|event| is_about(event, "the toe is shorter")), "{events:#?}");
        let is_critical = events.iter().any(|event| event.severity == Severity::Critical);
        assert_eq!(is_critical, seed % 2 == 1, "seed {seed}: {events:#?}");
    }
}

/// Without a toe sensor, the motor turns less for a throw. That is no fault of a position sensor or of the clock.
#[test]
fn a_toe_that_stops_short_is_found_without_a_toe_sensor() {
    for (seed, stroke, sides) in [(0, 0.93, 2), (1, 0.87, 2), (2, 0.83, 1), (3, 0.83, 1)] {
        let mut drive = Drive::new(78_300 + seed, Voltage::Published);
        (drive.has_toe_sensor, drive.rate_hz, drive.stroke_mm) = (false, 500.0, Some(115.0));
        drive.stay_healthy(60, State::SOUND);
        let short = State { stroke, ..State::SOUND };
        let events = drive.events_in(&Direction::BOTH[..sides], 40, short, |_| {});
        assert!(!events.is_empty(), "{stroke} in {sides} directions");
        assert!(events.iter().all(|event| is_about(event, "its motor turns")), "{events:#?}");
        assert!(events.iter().all(|event| event.text.contains("less than in the baseline")), "{events:#?}");
        if sides == 2 {
            let pct = format!("its motor turns {:.0} %", 100.0 * (1.0 - stroke));
            assert!(events.iter().all(|event| event.text.contains(&pct)), "{pct}: {events:#?}");
        }
        assert_eq!(drive.monitor.drifts(), [], "no coefficient has drifted");
        let mended: Vec<AlarmState> = drive.events(60, State::SOUND).iter().map(|event| event.state).collect();
        assert_eq!(mended, [AlarmState::ClearedUnacknowledged]);
    }
}

#[test]
fn a_toe_that_stops_short_is_found_between_rejected_throws() {
    let mut drive = Drive::after(60, 78_500, Voltage::Unknown);
    let throws = Cell::new(0);
    let reject_fifth = |throw: &mut Observation| {
        throws.set(throws.get() + 1);
        if throws.get() % 5 == 0 {
            throw.outcome = Some(Err(Rejection::Misfit { peak_mm: 2.0, at_s: 1.0 }));
        }
    };
    assert_eq!(drive.events_with(20, State::SOUND, reject_fifth), []);
    let events = drive.events_with(40, State { stroke: 0.93, ..State::SOUND }, reject_fifth);
    assert!(!events.is_empty() && events.iter().all(|event| is_about(event, "the toe is shorter")), "{events:#?}");
}

/// A rejected throw shows no travel that the other direction could speak for.
#[test]
fn an_alarm_about_the_travel_stays_while_only_the_sound_direction_is_seen() {
    let mut drive = Drive::after(60, 78_400, Voltage::Unknown);
    let mut feed = |stroke: f64, throws: usize, are_rejected: bool| {
        let change = |throw: &mut Observation| {
            if are_rejected {
                throw.outcome = Some(Err(Rejection::Misfit { peak_mm: 2.0, at_s: 1.0 }));
            }
        };
        let mut events =
            drive.events_in(&[Direction::NormalToReverse], throws, State { stroke, ..State::SOUND }, change);
        events.retain(|event: &AlarmEvent| event.cause == Cause::Unattributed);
        events
    };
    let raised = feed(0.93, 30, false);
    assert!(!raised.is_empty() && raised.iter().all(|event| is_about(event, "the toe is shorter")), "{raised:#?}");
    let rejected = feed(0.93, 30, true);
    assert!(rejected.iter().all(|event| event.state.is_active()), "{rejected:#?}");
    let mended: Vec<AlarmState> = feed(1.0, 40, false).iter().map(|event| event.state).collect();
    assert_eq!(mended, [AlarmState::ClearedUnacknowledged]);
}

#[test]
fn an_adjusted_stroke_is_normal_after_a_new_baseline() {
    let mut drive = Drive::after(60, 78_100, Voltage::Unknown);
    let long = State { stroke: 1.15, ..State::SOUND };
    let events = drive.events(30, long);
    assert!(!events.is_empty() && events.iter().all(|event| is_about(event, "the toe is longer")), "{events:#?}");
    let command = Command::Rebaseline { by: "meier".to_owned(), why: "new stop".to_owned() };
    let at = drive.throw(long).started_at;
    drive.monitor.command(&command, at, &Settings::default()).unwrap();
    drive.stay_healthy(120, long);
}

/// The motor is switched off by time, as nothing detects the end. With a configured stroke the throws are complete; without
/// one, the travel is that of all throws before.
/// The throws back begin where such a throw ended: they are whole.
#[test]
fn a_motor_that_runs_on_in_one_direction_hides_no_throw_of_the_other() {
    let mut drive = Drive::after(60, 86, Voltage::Published);
    let mut events = Vec::new();
    for throw in 0..36 {
        drive.push_s = if throw % 2 == 0 { 1.5 } else { 0.0 };
        events.extend(drive.events(1, State::SOUND));
    }
    let causes: Vec<_> = events.iter().map(|event| (event.cause, event.severity)).collect();
    assert_eq!(causes, [(Cause::Unattributed, Severity::Warning)], "{events:?}");
}

#[test]
fn a_motor_that_runs_on_at_the_end_is_named_and_is_no_obstruction() {
    for stroke_mm in [None, Some(115.0)] {
        let mut drive = Drive::new(78_200, Voltage::Published);
        (drive.stroke_mm, drive.push_s) = (stroke_mm, 0.035);
        drive.stay_healthy(60, State::SOUND);
        drive.push_s = 1.5;
        let events = drive.events(8, State::SOUND);
        let severities: Vec<Severity> = events.iter().map(|event| event.severity).collect();
        assert_eq!(severities, [Severity::Warning, Severity::Critical], "{stroke_mm:?}: {events:#?}");
        for event in &events {
            assert!(is_about(event, "the motor ran on") && event.text.contains("for up to 1.5 s"), "{}", event.text);
        }
        drive.push_s = 0.035;
        let mended: Vec<AlarmState> = drive.events(40, State::SOUND).iter().map(|event| event.state).collect();
        assert_eq!(mended, [AlarmState::ClearedUnacknowledged], "{stroke_mm:?}");
        assert_eq!(drive.monitor.state(), MachineState::Healthy);
    }
}

/// A machine whose motor is always switched off late; and single throws in which a stone gave way.
#[test]
fn a_usual_late_switch_off_and_single_long_throws_are_no_fault() {
    let mut drive = Drive::new(78_300, Voltage::Unknown);
    (drive.stroke_mm, drive.push_s) = (Some(115.0), 0.9);
    drive.stay_healthy(80, State::SOUND);
    for _ in 0..10 {
        drive.push_s = 2.0;
        drive.stay_healthy(1, State::SOUND);
        drive.push_s = 0.9;
        drive.stay_healthy(7, State::SOUND);
    }
}
