//! Faults of one direction, and offsets of the current sensor, on a drive that the model does not describe completely;
//! and a neutral position that is not the configured one.

use jiff::Timestamp;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, Drifting, MachineMonitor, Observation, SensorChannel, Settings},
    estimate::{self, Identifier},
    simulate::{Fault, FleetFault, FleetSettings, Parameters, Part, Shape},
    throw::Direction,
};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::channels,
};

/// A drive after a healthy time.
fn learned(seed: u64) -> Drive {
    Drive::after(120, seed, Voltage::alternating(seed))
}

/// Number of lives in which the friction alarm states its direction at the end, and in which at most one event updates
/// it.
fn directions(seeds: std::ops::Range<u64>) -> [u32; 2] {
    let (mut said, mut once) = (0, 0);
    for seed in seeds {
        let mut drive = learned(seed);
        let worn = Direction::BOTH[usize::from(seed % 4 < 2)];
        let mut events: Vec<AlarmEvent> = Vec::new();
        for _ in 0..160 {
            let friction = if drive.next() == worn { 1.4 } else { 1.0 };
            events.extend(drive.feed(State { friction, ..State::SOUND }).events);
        }
        let of_friction = || events.iter().filter(|event| event.cause == Cause::Friction);
        assert!(of_friction().all(|event| event.direction.is_none_or(|of| of == worn)), "seed {seed}: {events:#?}");
        said += u32::from(of_friction().next_back().is_some_and(|last| last.direction == Some(worn)));
        let updates = of_friction().filter(|event| event.text.contains("other direction"));
        once += u32::from(updates.count() <= 1);
        let open = drive.monitor.open_alarms();
        assert!(open.iter().any(|event| event.cause == Cause::Friction), "seed {seed}: {events:#?}");
        assert_eq!(drive.monitor.drifts()[0].direction, Some(worn), "seed {seed}");
    }
    [said, once]
}

#[test]
fn an_alarm_says_its_direction_once_it_is_known() {
    assert_eq!(directions(6_100..6_104), [4, 4]);
}

#[test]
#[ignore = "minutes"]
fn an_alarm_says_its_direction_once_it_is_known_in_forty_lives() {
    let from: u64 = std::env::var("POINTSD_SEED").map_or(7_100, |seed| seed.parse().unwrap());
    let found = directions(from..from + 40);
    println!("direction said, and once, in {found:?} of 40");
    assert!(found[0] >= 38 && found[1] == 40);
}

/// The events of 60 throws with an offset after healthy ones, and of 60 throws after its end.
fn offset(seed: u64, offset_a: f64) -> [Vec<AlarmEvent>; 2] {
    let mut drive = learned(seed);
    [State { current_offset_a: offset_a, ..State::SOUND }, State::SOUND].map(|state| drive.events(60, state))
}

fn offsets(seeds: std::ops::Range<u64>) {
    for (offset_a, is_named) in [(1.0, true), (-1.0, true), (3.0, true), (0.3, false), (-0.3, false)] {
        let (mut named, mut others, lives) = (0, 0, seeds.end - seeds.start);
        for seed in seeds.clone() {
            let [with, after] = offset(seed, offset_a);
            let of_sensor = |event: &AlarmEvent| event.channel == Some(SensorChannel::Current);
            named += u64::from(with.first().is_some_and(of_sensor) && with.len() == 1);
            others += u64::from(with.iter().chain(&after).any(|event| !of_sensor(event)));
            let over = [AlarmState::ClearedUnacknowledged];
            let states: Vec<AlarmState> = after.iter().map(|event| event.state).collect();
            assert!(states.is_empty() || with.len() == 1 && states == over, "{offset_a} A, seed {seed}: {after:#?}");
        }
        println!("offset {offset_a:+} A: named in {named}, other alarms in {others} of {lives}");
        assert!(named == if is_named { lives } else { 0 } && others == 0, "{offset_a} A: {named}, {others} of {lives}");
    }
}

#[test]
fn an_offset_of_the_current_is_an_alarm_of_its_sensor() {
    offsets(6_200..6_202);
}

#[test]
#[ignore = "minutes"]
fn an_offset_of_the_current_is_an_alarm_of_its_sensor_in_forty_lives() {
    let from: u64 = std::env::var("POINTSD_SEED").map_or(7_200, |seed| seed.parse().unwrap());
    offsets(from..from + 40);
}

/// The step is no scatter of the normal value that is learned meanwhile.
#[test]
fn an_offset_that_begins_while_its_normal_value_is_learned_is_found() {
    for (seed, healthy) in (6_320..).zip([26, 30, 40]) {
        let mut drive = Drive::new(seed, Voltage::Published);
        drive.stay_healthy(healthy, State::SOUND);
        let events = drive.events(80, State { current_offset_a: 1.0, ..State::SOUND });
        assert_eq!(channels(&events), [(Cause::Sensor, Some(SensorChannel::Current))], "after {healthy}: {events:#?}");
    }
}

/// The zero of a Hall sensor follows its temperature, which changes within a day and from season to season.
#[test]
fn the_zero_of_a_hall_sensor_may_drift() {
    for seed in 6_300..6_303 {
        let mut drive = Drive::new(seed, Voltage::Published);
        for throw in 0..400 {
            let [day, season] = [20.0, 600.0].map(|period| (f64::from(throw) * std::f64::consts::TAU / period).sin());
            let state = State { current_offset_a: 0.1 * day + 0.2 * season, ..State::SOUND };
            assert_eq!(drive.feed(state).events, [], "seed {seed}, throw {throw}");
        }
        assert_eq!(drive.monitor.caveats(), Vec::<String>::new());
    }
}

#[test]
fn a_current_at_rest_since_the_first_throw_is_a_caveat_and_no_alarm() {
    let mut drive = Drive::new(6_310, Voltage::Published);
    let state = State { current_offset_a: 1.0, ..State::SOUND };
    drive.stay_healthy(120, state);
    let caveats = drive.monitor.caveats();
    assert!(caveats.len() == 1 && caveats[0].contains("+1.0 A"), "{caveats:?}");
}

/// Simulates a machine whose rails are unstressed at `neutral_mm`, with a fault of a part after 110 throws, and
/// identifies the throws with `configured_mm`. Returns the causes of its alarms, its drifts and caveats after 150
/// throws, and the largest deviation of a1 of its last healthy throws from the baseline, as a share of a1.
fn unstressed_at(
    [neutral_mm, configured_mm]: [f64; 2],
    part: Part,
    size_pct: f64,
) -> (Vec<Cause>, Vec<Drifting>, Vec<String>, f64) {
    let machine = Parameters { neutral_mm, ..Parameters::default() };
    let fault = Fault { part, size_pct, from_throw: 110, shape: Shape::Step };
    let faults = vec![FleetFault { machine: 0, fault }];
    let fleet = FleetSettings { machines: 1, machine, faults, ..FleetSettings::default() };
    let mut machine = fleet.build(4_242).unwrap().remove(0);
    let settings = estimate::Settings { neutral_mm: configured_mm, ..estimate::Settings::default() };
    let (mut identifier, mut monitor) = (Identifier::default(), MachineMonitor::new("21B"));
    let (mut causes, mut present, mut off): (Vec<Cause>, _, f64) = (Vec::new(), None, 0.0);
    for throw_no in 0..150 {
        let throw = machine.next_throw("a", Timestamp::UNIX_EPOCH).unwrap();
        let observation = Observation::of(&throw, &identifier.identify(&throw, &settings));
        let verdict = monitor.observe(&observation, &Settings::default());
        causes.extend(verdict.events.iter().map(|event| event.cause));
        if let Some(estimate) = observation.estimate().filter(|_| (100..110).contains(&throw_no)) {
            let [_, a1, _] = estimate.coefficients;
            let baseline = monitor.baseline(observation.direction.unwrap()).unwrap();
            off = off.max((a1 / baseline.center[1] - 1.0).abs());
        }
        present = Some(verdict.present);
    }
    causes.dedup();
    let present = present.unwrap();
    (causes, present.drifts, present.caveats, off)
}

/// The neutral position in the caveats \[mm\].
fn said_mm(caveats: &[String]) -> f64 {
    let said = caveats.iter().find_map(|caveat| caveat.split("unstressed at about ").nth(1));
    said.unwrap().split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn a_neutral_position_that_is_not_configured_changes_neither_cause_nor_size() {
    for neutral_mm in [30.0, 57.5, 75.0] {
        for (part, cause, pct) in [
            (Part::Friction, Cause::Friction, 40.0),
            (Part::RailStiffness, Cause::Stiffness, 30.0),
            (Part::Kt, Cause::Kt, -15.0),
        ] {
            let (causes, drifts, caveats, off) = unstressed_at([neutral_mm, 0.0], part, pct);
            assert_eq!(causes, [cause], "{cause}, unstressed at {neutral_mm} mm: {drifts:?}");
            let Drifting { change_pct, change_pct_sd, direction, .. } = drifts[0];
            assert!(
                direction.is_none() && (change_pct - pct).abs() < 3.0 * change_pct_sd,
                "unstressed at {neutral_mm} mm: {drifts:?}"
            );
            assert!((said_mm(&caveats) - neutral_mm).abs() < 5.0, "{caveats:?}");
            assert!(off < 0.5, "the baseline is not that of the stored a1: {off}");
        }
        let (.., caveats, _) = unstressed_at([neutral_mm; 2], Part::Friction, 40.0);
        assert!(!caveats.iter().any(|caveat| caveat.contains("unstressed")), "{caveats:?}");
    }

    // a1 of one direction is negative.
    let (_, drifts, caveats, _) = unstressed_at([115.0, 0.0], Part::Friction, 40.0);
    let friction = drifts.iter().find(|drift| drift.cause == Cause::Friction).unwrap();
    assert!((friction.change_pct - 40.0).abs() < 3.0 * friction.change_pct_sd, "{drifts:?}");
    assert!((said_mm(&caveats) - 115.0).abs() < 5.0, "{caveats:?}");
}
