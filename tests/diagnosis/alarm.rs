//! The life cycle of alarms: acknowledge, shelve, out of service, clear, raise again, without chatter.

use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector3;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, Command, CommandError, Settings, Severity},
    estimate::Rejection,
    throw::{Direction, MachineId},
};
use proptest::prelude::*;

use crate::fleet::{Machine, Scatter, shift};

fn now() -> Timestamp {
    "2026-03-01T00:00:00Z".parse().unwrap()
}

fn by() -> String {
    "A. Fitter".to_owned()
}

/// A machine with an active friction warning, and the event that raised it.
fn alarmed(seed: u64) -> (Machine, AlarmEvent) {
    let mut machine = Machine::learned(seed, Scatter::USUAL);
    let raised = (0..20).find_map(|_| machine.feed(shift(Cause::Friction, 25.0)).events.pop()).unwrap();
    (machine, raised)
}

/// Gives a command to the monitor.
fn act(machine: &mut Machine, command: &Command) -> Result<Vec<AlarmEvent>, CommandError> {
    machine.monitor.command(command, now(), &machine.settings)
}

fn states(events: &[AlarmEvent]) -> Vec<AlarmState> {
    events.iter().map(|event| event.state).collect()
}

#[test]
fn an_alarm_cleared_before_it_was_acknowledged_waits_for_the_acknowledgement() {
    let (mut machine, raised) = alarmed(1);
    assert_eq!((raised.state, raised.event_no), (AlarmState::ActiveUnacknowledged, 1));
    let cleared = machine.events(60, Vector3::zeros());
    assert_eq!(states(&cleared), [AlarmState::ClearedUnacknowledged]);
    let again = machine.events(10, shift(Cause::Friction, 25.0));
    assert_eq!(states(&again), [AlarmState::ActiveUnacknowledged]);
    assert_eq!((again[0].raised_at, again[0].event_no), (raised.raised_at, 3));
}

/// The records show who acknowledged an alarm, in whatever state it was.
#[test]
fn an_alarm_keeps_who_acknowledged_it() {
    let ack = Command::Ack { cause: Cause::Friction, by: by() };
    let (mut machine, _) = alarmed(1);
    machine.events(60, Vector3::zeros());
    let [over] = &act(&mut machine, &ack).unwrap()[..] else { panic!("one event") };
    assert_eq!((over.state, over.acknowledged_by.as_deref()), (AlarmState::Normal, Some("A. Fitter")));

    let (mut machine, _) = alarmed(1);
    act(&mut machine, &ack).unwrap();
    let [cleared] = &machine.events(60, Vector3::zeros())[..] else { panic!("one event") };
    assert_eq!((cleared.state, cleared.acknowledged_by.as_deref()), (AlarmState::Normal, Some("A. Fitter")));

    let (mut machine, _) = alarmed(1);
    let until = now() + SignedDuration::from_hours(8);
    act(&mut machine, &Command::Shelve { cause: Cause::Friction, until, by: by(), why: "known".to_owned() }).unwrap();
    let [shelved] = &act(&mut machine, &ack).unwrap()[..] else { panic!("one event") };
    assert_eq!((shelved.state, shelved.acknowledged_by.as_deref()), (AlarmState::Shelved, Some("A. Fitter")));
    let [over] = &machine.events(60, Vector3::zeros())[..] else { panic!("one event") };
    assert_eq!((shelved.over, over.state, over.over), (false, AlarmState::Shelved, true));
}

/// Just after a step the levels of the last throws still look healthy. Throws of one direction show nothing about a
/// fault of the other.
#[test]
fn a_constant_fault_is_not_cleared() {
    let settings = Settings { off_delay_throws: 3, ..Settings::default() };
    for seed in 0..10 {
        let mut machine = Machine::learned_with(70 + seed, Scatter::USUAL, settings.clone());
        let fault = shift(Cause::Friction, 45.0);
        let events = machine.events(60, fault);
        assert!(
            states(&events).iter().all(|state| *state == AlarmState::ActiveUnacknowledged),
            "seed {seed}: {events:?}"
        );
    }
    let mut machine = Machine::learned(80, Scatter::USUAL);
    let faulty = Direction::NormalToReverse;
    let feed = |machine: &mut Machine, only| {
        machine.only = only;
        let healthy = machine.throw(Vector3::zeros());
        let mut observation = machine.throw(shift(Cause::Friction, 45.0));
        if observation.direction != Some(faulty) {
            observation = healthy;
        }
        machine.observe(&observation).events
    };
    let raised: Vec<_> = (0..40).flat_map(|at| feed(&mut machine, Some(Direction::BOTH[at % 2]))).collect();
    assert!(raised.iter().any(|event| event.cause == Cause::Friction), "{raised:?}");
    let until = now() + SignedDuration::from_hours(8);
    let start = Command::MaintenanceStart { until, by: by(), why: "looked".to_owned() };
    for command in [start, Command::MaintenanceEnd { by: by() }] {
        act(&mut machine, &command).unwrap();
    }
    let events: Vec<_> = (0..30).flat_map(|_| feed(&mut machine, Some(Direction::ReverseToNormal))).collect();
    assert_eq!(states(&events), [], "the other direction was not thrown");
}

#[test]
fn an_acknowledged_and_cleared_alarm_is_normal_and_the_next_is_a_new_one() {
    let (mut machine, raised) = alarmed(2);
    let ack = Command::Ack { cause: Cause::Friction, by: by() };
    let seen = act(&mut machine, &ack).unwrap();
    assert_eq!(states(&seen), [AlarmState::ActiveAcknowledged]);
    assert_eq!(seen[0].by.as_deref(), Some("A. Fitter"));
    let twice = act(&mut machine, &ack);
    assert_eq!(twice, Err(CommandError::AlreadyAcknowledged { cause: Cause::Friction, by: by() }));
    let cleared = machine.events(60, Vector3::zeros());
    assert_eq!(states(&cleared), [AlarmState::Normal]);
    assert_eq!(machine.monitor.open_alarms(), [] as [&AlarmEvent; 0]);
    let again = machine.events(10, shift(Cause::Friction, 25.0));
    assert_eq!(again[0].event_no, 1);
    assert_ne!(again[0].raised_at, raised.raised_at);
    let none = act(&mut machine, &Command::Ack { cause: Cause::Kt, by: by() });
    assert_eq!(none, Err(CommandError::NoSuchAlarm(Cause::Kt)));
}

/// The operator who ends a maintenance has not acknowledged the alarm, and its text is as old as before.
#[test]
fn a_command_changes_neither_the_acknowledgement_nor_the_time_of_the_text() {
    let (mut machine, raised) = alarmed(2);
    assert_eq!((raised.text_at, &raised.acknowledged_by), (Some(raised.event_at), &None));
    let (other, until) = ("B. Other".to_owned(), now() + SignedDuration::from_hours(8));
    for command in [
        Command::Ack { cause: Cause::Friction, by: by() },
        Command::MaintenanceStart { until, by: other.clone(), why: "looked".to_owned() },
        Command::MaintenanceEnd { by: other.clone() },
    ] {
        act(&mut machine, &command).unwrap();
    }
    let [last] = &machine.monitor.open_alarms()[..] else { panic!("one alarm") };
    assert_eq!((last.state, last.by.as_ref()), (AlarmState::ActiveAcknowledged, Some(&other)));
    assert_eq!((last.acknowledged_by.as_deref(), last.text_at), (Some("A. Fitter"), raised.text_at));
}

#[test]
fn severity_rises_within_the_same_alarm_and_asks_to_be_seen_again() {
    let (mut machine, raised) = alarmed(3);
    act(&mut machine, &Command::Ack { cause: Cause::Friction, by: by() }).unwrap();
    let worse = machine.events(20, shift(Cause::Friction, 70.0));
    assert_eq!(states(&worse), [AlarmState::ActiveUnacknowledged]);
    assert_eq!((worse[0].severity, worse[0].raised_at, worse[0].event_no), (Severity::Critical, raised.raised_at, 3));
}

/// Ice after rain: the alarm about the lower friction must not hide the higher friction.
#[test]
fn a_change_in_the_other_sense_is_a_new_event_of_the_same_alarm() {
    for (first, then) in [(-30.0, 30.0), (30.0, -30.0)] {
        let mut machine = Machine::learned(7, Scatter::USUAL);
        let raised = machine.events(40, shift(Cause::Friction, first)).remove(0);
        assert!(raised.cause == Cause::Friction && raised.change_pct.unwrap() * first > 0.0, "{}", raised.text);
        act(&mut machine, &Command::Ack { cause: Cause::Friction, by: by() }).unwrap();
        let events = machine.events(20, shift(Cause::Friction, then));
        let turned = events.iter().find(|event| event.change_pct.is_some_and(|pct| pct * then > 0.0)).unwrap();
        assert_eq!((turned.state, turned.raised_at), (AlarmState::ActiveUnacknowledged, raised.raised_at));
        assert!((turned.change_pct.unwrap() - then).abs() < 8.0, "{}", turned.text);
    }
}

/// A new motor ends a critical loss of torque; a slightly stronger one is no critical fault.
#[test]
fn a_change_in_the_other_sense_is_as_severe_as_its_present_size() {
    for seed in 20..28 {
        let mut machine = Machine::learned(seed, Scatter::USUAL);
        let raised = machine.events(60, shift(Cause::Kt, -20.0));
        assert_eq!(raised.last().unwrap().severity, Severity::Critical);
        let events = machine.events(80, shift(Cause::Kt, 7.0));
        let turned: Vec<_> = events.iter().filter(|event| event.change_pct.is_some_and(|pct| pct > 0.0)).collect();
        assert!(!turned.is_empty() && turned.iter().all(|event| event.severity == Severity::Warning), "{turned:#?}");
    }
}

#[test]
fn shelved_until_a_time_or_a_command() {
    let settings = Settings::default();
    let (mut machine, _) = alarmed(4);
    let until = now() + SignedDuration::from_hours(8);
    let shelve = Command::Shelve { cause: Cause::Friction, until, by: by(), why: "parts ordered".to_owned() };
    assert_eq!(states(&act(&mut machine, &shelve).unwrap()), [AlarmState::Shelved]);
    assert_eq!(machine.monitor.tick(now() + SignedDuration::from_hours(7), &settings), []);
    let ended = machine.monitor.tick(until, &settings);
    assert_eq!(states(&ended), [AlarmState::ActiveUnacknowledged]);
    act(&mut machine, &shelve).unwrap();
    let unshelve = Command::Unshelve { cause: Cause::Friction, by: by() };
    assert_eq!(states(&act(&mut machine, &unshelve).unwrap()), [AlarmState::ActiveUnacknowledged]);
    assert_eq!(act(&mut machine, &unshelve), Err(CommandError::NotShelved(Cause::Friction)));
    assert!(matches!(machine.monitor.command(&shelve, until, &settings), Err(CommandError::UntilIsPast { .. })));
    let long = Command::Shelve {
        cause: Cause::Friction,
        until: now() + SignedDuration::from_hours(24 * 365),
        by: by(),
        why: "never".to_owned(),
    };
    let too_far = act(&mut machine, &long).unwrap_err();
    assert!(matches!(too_far, CommandError::UntilTooFar { .. }));
    let at_second = format!("which is at {}: give", now().strftime("%Y-%m-%d %H:%M:%S UTC"));
    assert!(too_far.to_string().contains(&at_second), "{too_far}");
}

/// Names and reasons are printed on terminals, which execute control characters.
#[test]
fn a_name_or_reason_with_control_characters_is_refused() {
    let (mut machine, _) = alarmed(4);
    let until = now() + SignedDuration::from_hours(8);
    let long = format!("greased{}", " ".repeat(Command::MAX_TEXT));
    for (by, why, field) in [
        ("mia\u{1b}[2J", "greased", "by"),
        ("mia", "greased\u{9b}31m", "why"),
        ("mia", &long, "why"),
        (" ", "greased", "by"),
    ] {
        let command = Command::MaintenanceStart { until, by: by.to_owned(), why: why.to_owned() };
        assert_eq!(act(&mut machine, &command), Err(CommandError::Text { field }));
    }
}

#[test]
fn throws_in_maintenance_are_neither_diagnosed_nor_learned() {
    let settings = Settings::default();
    let mut machine = Machine::new(5, Scatter::USUAL);
    machine.events(20, Vector3::zeros());
    let progress = machine.monitor.baseline_progress(Direction::NormalToReverse, &settings);
    let until = now() + SignedDuration::from_hours(8);
    let start = Command::MaintenanceStart { until, by: by(), why: "slide chairs".to_owned() };
    act(&mut machine, &start).unwrap();
    assert_eq!(machine.events(50, shift(Cause::Friction, 80.0)), []);
    assert_eq!(machine.monitor.baseline_progress(Direction::NormalToReverse, &settings), progress);
    act(&mut machine, &Command::MaintenanceEnd { by: by() }).unwrap();
    machine.events(2, Vector3::zeros());
    assert_ne!(machine.monitor.baseline_progress(Direction::NormalToReverse, &settings), progress);

    let (mut machine, raised) = alarmed(6);
    let out = act(&mut machine, &start).unwrap();
    assert_eq!(states(&out), [AlarmState::OutOfService]);
    let longer = until + SignedDuration::from_hours(1);
    let again = Command::MaintenanceStart { until: longer, by: by(), why: "still at work".to_owned() };
    act(&mut machine, &again).unwrap();
    let mut later = machine.monitor.clone();
    assert_eq!(later.tick(until, &settings), [], "the new window replaces the old one");
    assert_eq!(states(&later.tick(longer, &settings)), [AlarmState::ActiveUnacknowledged]);
    let back = act(&mut machine, &Command::MaintenanceEnd { by: by() }).unwrap();
    assert_eq!(states(&back), [AlarmState::ActiveUnacknowledged]);
    assert!(back[0].text.contains("before the maintenance"), "{}", back[0].text);
    let text = Command::MaintenanceEnd { by: by() }.consequence(&back);
    let named = format!("Alarms from before: {} friction", raised.severity.as_str());
    assert!(text.contains(&named), "{text}");
    let cleared = machine.events(60, Vector3::zeros());
    assert_eq!(states(&cleared), [AlarmState::ClearedUnacknowledged]);
    assert_eq!(cleared[0].raised_at, raised.raised_at);
}

#[test]
fn a_new_baseline_ends_drift_alarms_and_makes_the_present_normal() {
    let (mut machine, _) = alarmed(7);
    let rebaseline = Command::Rebaseline { by: by(), why: "new slide chairs".to_owned() };
    let events = act(&mut machine, &rebaseline).unwrap();
    assert_eq!(states(&events), [AlarmState::Normal]);
    assert_eq!(events[0].why.as_deref(), Some("new slide chairs"));
    assert_eq!(machine.events(200, shift(Cause::Friction, 25.0)), []);
    let record = machine.monitor.baseline(Direction::ReverseToNormal).unwrap();
    assert!(record.complete);
    assert!((record.center[1] / (1.25 * crate::fleet::NOMINAL[1]) - 1.0).abs() < 0.03);
}

#[test]
fn the_end_of_a_drift_names_the_repair_and_changes_no_baseline() {
    let (mut machine, _) = alarmed(8);
    machine.events(40, shift(Cause::Friction, 40.0));
    let events = machine.events(80, Vector3::zeros());
    let cleared = events.last().unwrap();
    assert_eq!(cleared.state, AlarmState::ClearedUnacknowledged);
    assert!(cleared.text.contains("as after a repair, or in rain"), "{}", cleared.text);
    assert!(machine.monitor.baseline(Direction::NormalToReverse).is_some());
}

/// Fresh grease leaves less friction than the baseline has: the alarm about the rise is over.
#[test]
fn a_repair_that_does_more_than_restore_the_baseline_ends_the_alarm() {
    for (seed, (cause, fault_pct, after_pct)) in
        [(Cause::Friction, 50.0, -8.0), (Cause::Kt, -15.0, 4.0), (Cause::Stiffness, 35.0, -8.0)].into_iter().enumerate()
    {
        let mut machine = Machine::learned(900 + seed as u64, Scatter::USUAL);
        let raised = machine.events(60, shift(cause, fault_pct));
        assert!(!raised.is_empty() && raised.iter().all(|event| event.cause == cause), "{raised:?}");
        let ended = machine.events(40, shift(cause, after_pct));
        assert_eq!(states(&ended), [AlarmState::ClearedUnacknowledged], "{ended:?}");
        assert!(ended[0].text.contains("below its warning limit again"), "{}", ended[0].text);
    }
}

#[test]
fn a_lasting_step_is_raised_once_and_stays() {
    let lasting =
        [(Cause::Kt, -20.0), (Cause::Friction, 45.0), (Cause::Stiffness, 30.0), (Cause::Inertia, 20.0)].into_iter();
    for ((cause, size_pct), seed) in lasting.flat_map(|fault| (0..25).map(move |seed| (fault, seed))) {
        let mut machine = Machine::learned(seed, Scatter::USUAL);
        machine.stay_healthy(40);
        let events = machine.events(100, shift(cause, size_pct));
        assert!(events.iter().all(|event| event.cause == cause), "{events:?}");
        assert!(states(&events).iter().all(|state| *state == AlarmState::ActiveUnacknowledged), "{events:?}");
        assert_eq!(events[0].event_no, 1);
    }
}

#[test]
fn an_alarm_at_its_limit_does_not_chatter() {
    for (cause, pct, times) in [
        (Cause::Friction, 15.0, 1.0),
        (Cause::Friction, 12.5, 3.0),
        (Cause::Kt, 5.0, 1.0),
        (Cause::Stiffness, 10.0, 3.0),
    ] {
        let natural = Scatter::USUAL;
        let mut machine = Machine::learned(9, Scatter { sd: natural.sd.map(|s| s * times), phi: 0.6, ..natural });
        let events = machine.events(10_000, shift(cause, pct));
        let is_raised = |e: &&AlarmEvent| e.cause == cause && e.state == AlarmState::ActiveUnacknowledged;
        let raised = events.iter().filter(is_raised).count();
        assert!(raised <= 10_000 / 200, "{cause} at {pct} %: raised {raised} times");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever jumps the clock makes, each occurrence of an alarm has its own identity, and its events count from 1.
    #[test]
    fn identities_are_unique_whatever_the_clock_does(seed in 0_u64..1000, jumps in prop::collection::vec(0_u8..4, 40)) {
        let mut machine = Machine::learned(seed, Scatter::USUAL);
        let mut seen = std::collections::BTreeMap::new();
        for jump in jumps {
            let mut observation = machine.throw(Vector3::zeros());
            if jump > 0 {
                observation.outcome = Some(Err(Rejection::NoMovement));
            }
            observation.started_at = now() + SignedDuration::from_secs(i64::from(jump % 2));
            let mut events = machine.observe(&observation).events;
            for _ in 0..12 {
                let mut fine = machine.throw(Vector3::zeros());
                fine.started_at = now();
                events.extend(machine.observe(&fine).events);
            }
            let ack = Command::Ack { cause: Cause::IncompleteThrow, by: by() };
            events.extend(act(&mut machine, &ack).unwrap_or_default());
            for event in events {
                let last = seen.entry((event.cause, event.raised_at)).or_insert(0);
                *last += 1;
                prop_assert_eq!(event.event_no, *last);
            }
        }
    }
}

#[test]
fn a_rebaseline_of_a_learning_machine_says_how_far_it_had_learned() {
    let mut machine = Machine::learned(940, Scatter::USUAL);
    let id = MachineId::new("north", "21B").unwrap();
    let rebaseline = Command::Rebaseline { by: by(), why: "new motor".into() };
    let confirmation = |machine: &Machine| rebaseline.confirmation(&id, machine.monitor.learning(&machine.settings));
    assert!(!confirmation(&machine).contains("already"), "{}", confirmation(&machine));
    act(&mut machine, &rebaseline).unwrap();
    machine.events(15, Vector3::zeros());
    let text = confirmation(&machine);
    assert!(text.contains("already learning") && text.contains("8 of 50 throws") && text.contains("7 of 50"), "{text}");
    act(&mut machine, &rebaseline).unwrap();
    assert_eq!(machine.monitor.learning(&machine.settings), Some([(0, 50); 2]));
}
