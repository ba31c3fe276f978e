//! A force that closes or locks the points and grows over the last millimetres of the stroke, after the window of the
//! estimate.

use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, Command, Observation, Severity},
    estimate::Rejection,
    throw::Direction,
};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::in_parallel,
};

fn is_about_the_end(event: &AlarmEvent) -> bool {
    event.cause == Cause::Unattributed && event.text.contains("over the last millimetres of the stroke")
}

/// The state with a locking force, which grows over this number of throws to 80 % of the stall force.
fn locking(throw: u32, throws: u32, state: State) -> State {
    State { lock: 0.8 * f64::from(throw.min(throws)) / f64::from(throws), ..state }
}

/// The slowest of these currents at the end doubles after two thirds of the ramp.
#[test]
fn a_growing_force_at_the_end_of_the_stroke_has_an_alarm_before_the_points_do_not_lock() {
    let of_ratios = |seed| Drive::after_in(State::OF_RATIOS, 60, seed, Voltage::Unknown);
    let series = |seed| {
        let mut drive = Drive::series(seed);
        drive.stay_healthy(60, State::SOUND);
        drive
    };
    let slow = |seed| {
        let mut drive = Drive::new(seed, Voltage::Unknown);
        drive.rate_hz = 100.0;
        drive.stay_healthy(60, State::SOUND);
        drive
    };
    let lives = in_parallel(8, |seed| {
        let (mut drive, state) = match seed {
            0..3 => (Drive::after(60, 77_000 + seed, Voltage::alternating(seed)), State::SOUND),
            3..5 => (of_ratios(77_000 + seed), State::OF_RATIOS),
            5..7 => (series(77_000 + seed), State::SOUND),
            _ => (slow(77_000 + seed), State::SOUND),
        };
        let (mut events, mut throws) = (Vec::new(), Vec::new());
        for throw in 1..=250 {
            let new = drive.feed(locking(throw, 250, state)).events;
            throws.extend(new.iter().map(|_| throw));
            events.extend(new);
        }
        (seed, events, throws)
    });
    for (seed, events, throws) in lives {
        println!("{seed}: {throws:?} {:?}", events.iter().map(|event| &event.text).collect::<Vec<_>>());
        let raised = events.first().filter(|event| is_about_the_end(event)).unwrap();
        assert!(raised.severity == Severity::Warning && throws[0] <= 83, "seed {seed}, {}: {raised:?}", throws[0]);
        assert!(
            events.iter().any(|event| is_about_the_end(event) && event.severity == Severity::Critical),
            "{events:?}"
        );
        assert!(events.iter().all(|event| !event.cause.is_part()), "seed {seed}: {events:?}");
    }
}

#[test]
fn a_force_in_one_direction_is_named_with_its_direction_and_ends_with_its_mending() {
    let mut drive = Drive::after(60, 77_100, Voltage::Unknown);
    let mut feed = |lock: f64, throws: usize| {
        drive.events_in(&[Direction::ReverseToNormal], throws, State { lock, ..State::SOUND }, |_| {})
    };
    let raised = feed(0.03, 40);
    assert!(!raised.is_empty() && raised.iter().all(is_about_the_end), "{raised:?}");
    assert_eq!(raised[0].direction, Some(Direction::ReverseToNormal));
    let mended = feed(0.0, 60);
    let states: Vec<AlarmState> = mended.iter().map(|event| event.state).collect();
    assert_eq!(states, [AlarmState::ClearedUnacknowledged], "{mended:?}");
}

/// The throws of the direction with the fault become incomplete, which shows no end of the fault.
#[test]
fn sound_throws_of_the_other_direction_do_not_end_an_alarm_about_the_end() {
    let mut drive = Drive::after(60, 77_100, Voltage::Unknown);
    let mut feed = |lock: f64, throws: usize, are_incomplete: bool| {
        let change = |throw: &mut Observation| {
            if are_incomplete {
                throw.outcome = Some(Err(Rejection::NoMovement));
            }
        };
        let mut events = drive.events_in(&[Direction::ReverseToNormal], throws, State { lock, ..State::SOUND }, change);
        events.retain(|event: &AlarmEvent| event.cause == Cause::Unattributed);
        events
    };
    assert!(feed(0.03, 40, false).iter().all(|event| event.state.is_active()));
    assert_eq!(feed(0.03, 60, true), []);
    let mended: Vec<AlarmState> = feed(0.0, 60, false).iter().map(|event| event.state).collect();
    assert_eq!(mended, [AlarmState::ClearedUnacknowledged]);
}

/// An alarm without a named part, or about a sensor, hides no force at the end; the earlier fault stays in the text.
#[test]
fn an_earlier_fault_hides_no_force_at_the_end() {
    let late = State { brake_s: 0.04, ..State::OF_RATIOS };
    let long = State { position_gain: 0.85, ..State::SOUND };
    for (before, earlier, cause) in [(State::OF_RATIOS, late, Cause::Unattributed), (State::SOUND, long, Cause::Sensor)]
    {
        let mut drive = Drive::after_in(before, 60, 77_400, Voltage::Published);
        let first = drive.events(40, earlier);
        assert!(!first.is_empty() && first.iter().all(|event| event.cause == cause), "{first:?}");
        let mut events: Vec<AlarmEvent> = Vec::new();
        for throw in 1..=120 {
            events.extend(drive.feed(locking(throw, 120, earlier)).events);
        }
        let found: Vec<&AlarmEvent> = events.iter().filter(|event| is_about_the_end(event)).collect();
        assert!(found.iter().any(|event| event.severity == Severity::Critical), "{cause}: {events:?}");
        assert!(found[0].state == AlarmState::ActiveUnacknowledged, "{cause}: {:?}", found[0]);
        if cause == Cause::Unattributed {
            assert!(found[0].text.starts_with(&first.last().unwrap().text), "{}", found[0].text);
        }
        println!("{:?}", events.iter().map(|event| (&event.text, event.severity, event.state)).collect::<Vec<_>>());
    }
}

/// The force of a lock vanishes: it is broken, or its spring is.
#[test]
fn a_lock_that_gives_no_force_any_more_is_named() {
    let lives = in_parallel(4, |seed| {
        let mut drive =
            Drive::after_in(State { lock: 0.08, ..State::SOUND }, 60, 77_500 + seed, Voltage::alternating(seed));
        drive.events(30, State::SOUND)
    });
    for events in lives {
        let [event] = &events[..] else { panic!("{events:?}") };
        assert!(is_about_the_end(event) && event.severity == Severity::Warning, "{event:?}");
        assert!(event.text.contains("has fallen") && event.text.contains("whether the points lock"), "{}", event.text);
    }
}

#[test]
fn a_force_that_is_lost_in_one_direction_and_grows_a_little_in_the_other_is_a_warning() {
    let mut drive = Drive::new(77_600, Voltage::Unknown);
    let mut feed = |locks: [f64; 2], throws: u32| {
        let mut events = Vec::new();
        for _ in 0..throws {
            let lock = locks[usize::from(drive.next() == Direction::ReverseToNormal)];
            events.extend(drive.feed(State { lock, ..State::SOUND }).events);
        }
        events
    };
    assert_eq!(feed([0.15, 0.0], 60), []);
    let events = feed([0.0, 0.02], 30);
    assert_eq!(events.len(), 1, "{events:?}");
    assert!(events[0].severity == Severity::Warning && events[0].text.contains("has fallen"), "{events:?}");
    let events = feed([0.0, 0.2], 30);
    let text = &events[0].text;
    assert_eq!(events[0].severity, Severity::Critical);
    assert!(text.contains("has risen in one direction and fallen in the other"), "{text}");
}

#[test]
fn an_adjusted_lock_is_normal_after_a_new_baseline() {
    let mut drive = Drive::after(60, 77_200, Voltage::Unknown);
    let locked = State { lock: 0.03, ..State::SOUND };
    let raised = drive.events(40, locked);
    assert!(!raised.is_empty() && raised.iter().all(is_about_the_end), "{raised:?}");
    let command = Command::Rebaseline { by: "meier".to_owned(), why: "lock adjusted".to_owned() };
    let at = drive.throw(locked).started_at;
    drive.monitor.command(&command, at, &pointsd::diagnose::Settings::default()).unwrap();
    drive.stay_healthy(120, locked);
}

#[test]
fn a_fault_of_another_part_is_no_force_at_the_end() {
    let sound = State::SOUND;
    let faults = [
        State { friction: 2.0, ..sound },
        State { friction: 0.5, ..sound },
        State { torque: 0.7, back_emf: 0.7, ..sound },
        State { stiffness: 2.0, ..sound },
        State { stiffness: 0.4, ..sound },
        State { inertia: 1.5, ..sound },
        State { volts: 0.75, ..sound },
        State { ohms: 1.5, ..sound },
        State { current_gain: 1.5, ..sound },
        State { current_offset_a: 0.3, ..sound },
        State { position_gain: 0.85, ..sound },
        State { position_offset_mm: 5.0, ..sound },
        State { position_noise_mm: 0.4, ..sound },
        State { clock: 1.3, ..sound },
        State { brake_s: 0.03, ..sound },
        State { play_mm: 1.0, ..sound },
        State { late_s: 0.01, ..sound },
    ];
    let about_the_end = in_parallel(4 * faults.len() as u64, |life| {
        let fault = faults[usize::try_from(life / 4).unwrap()];
        let mut drive = Drive::new(77_300 + life, Voltage::alternating(life));
        if life % 2 == 0 {
            (drive.stroke_mm, drive.push_s) = (Some(115.0), 0.035);
        }
        // Every second machine has a lock, whose force could seem to fall too.
        let lock = if life % 4 < 2 { 0.0 } else { 0.05 };
        drive.stay_healthy(60, State { lock, ..sound });
        let events = drive.events(60, State { lock, ..fault });
        events.into_iter().find(is_about_the_end).map(|event| format!("{fault:?}: {}", event.text))
    });
    assert_eq!(about_the_end.into_iter().flatten().collect::<Vec<_>>(), [] as [String; 0]);
}
