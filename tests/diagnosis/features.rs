//! Throws without coefficients: their features are monitored.

use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector3;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, MachineMonitor, MachineState, Observation, Settings, Severity},
    estimate::{Features, Rejection},
    throw::{Direction, Throw, ThrowRef},
};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::{
    drive::{Drive, State, Voltage, with_trace},
    fleet::{Machine, Scatter, causes, in_parallel, normal},
};

/// A machine with a current sensor only, whose logger publishes no voltage, after a healthy time without an event.
fn current_only(seed: u64) -> Drive {
    let mut drive = Drive::new(55_000 + seed, Voltage::Unknown);
    drive.has_toe_sensor = false;
    drive.stay_healthy(100, State::SOUND);
    assert_eq!(drive.monitor.state(), MachineState::Healthy);
    drive
}

/// One throw in five of each direction has a damaged current, and the others show the fault.
#[test]
fn damaged_throws_among_good_ones_hide_no_change_of_the_features() {
    for seed in 0..4 {
        let mut drive = current_only(seed);
        drive.logger = |throw| {
            if throw.id.throw_no % 10 > 1 {
                return throw;
            }
            with_trace(throw, |rate_hz, mut current, position| {
                let half = current.len() / 2;
                current[half..half + 80].fill(f64::NAN);
                (rate_hz, current, position)
            })
        };
        drive.stay_healthy(40, State::SOUND);
        assert_eq!(drive.monitor.state(), MachineState::Healthy);
        let events = drive.events(30, State { friction: 1.8, ..State::SOUND });
        assert!(!events.is_empty() && events.iter().all(|event| event.cause == Cause::Unattributed), "{events:?}");
    }
}

#[test]
fn a_machine_with_a_current_sensor_only_is_monitored_by_its_features() {
    let faults = [
        ("dry slide chairs", State { friction: 1.8, ..State::SOUND }, true),
        ("very dry slide chairs", State { friction: 2.5, ..State::SOUND }, true),
        ("a weak supply", State { volts: 0.7, ..State::SOUND }, true),
        ("less friction", State { friction: 0.95, ..State::SOUND }, false),
    ];
    for (name, state, is_found) in faults {
        let mut found = 0;
        for seed in 0..4 {
            let mut drive = current_only(seed);
            let events = drive.events(24, state);
            assert!(events.iter().all(|event| event.cause == Cause::Unattributed), "{name}: {events:?}");
            found += u32::from(!events.is_empty());
            for event in &events {
                println!("{name}: {}", event.text);
            }
            let healthy = drive.events(40, State::SOUND);
            assert_eq!(healthy.len(), usize::from(!events.is_empty()), "{name} mended: {healthy:?}");
            assert_eq!(drive.monitor.state(), MachineState::Healthy, "{name} mended");
        }
        assert_eq!(found, if is_found { 4 } else { 0 }, "{name}");
    }
}

/// A logger that exchanges the names of the directions after a repair. Without a position only the currents and times
/// of the throws show it. Faults and obstructions are still found.
#[test]
fn exchanged_names_of_directions_are_no_wear() {
    for (seed, rate_hz) in (0..4).flat_map(|seed| [(seed, 1000.0), (seed, 25.0)]) {
        let mut drive = Drive::new(55_000 + seed, Voltage::Unknown);
        (drive.has_toe_sensor, drive.rate_hz) = (false, rate_hz);
        drive.stay_healthy(100, State::SOUND);
        let exchange = |throw: Throw| Throw { direction: throw.direction.map(Direction::other), ..throw };
        drive.logger = exchange;
        assert_eq!(drive.events(60, State::SOUND), [], "{seed}, {rate_hz} Hz");
        let is_stated = |drive: &Drive| drive.monitor.caveats().iter().any(|caveat| caveat.contains("exchanged"));
        assert!(is_stated(&drive), "{seed}, {rate_hz} Hz: {:?}", drive.monitor.caveats());
        let stalled = |throw: &mut Observation| {
            throw.features.duration_s = throw.features.duration_s.map(|duration_s| 2.5 * duration_s);
        };
        assert_eq!(
            causes(&drive.events_with(1, State::SOUND, stalled)),
            [Cause::IncompleteThrow],
            "{seed}, {rate_hz} Hz"
        );
        drive.events(20, State::SOUND);
        let events = drive.events(24, State { friction: 1.8, ..State::SOUND });
        assert!(!events.is_empty() && events.iter().all(|event| event.cause == Cause::Unattributed), "{events:?}");
        drive.events(40, State::SOUND);
        drive.logger = |throw| throw;
        drive.stay_healthy(20, State::SOUND);
        assert!(!is_stated(&drive));
    }
}

/// Throws that show nothing say nothing about the fault.
#[test]
fn a_machine_with_an_alarm_of_its_features_and_empty_traces_is_not_monitored() {
    let mut drive = current_only(1);
    assert_eq!(causes(&drive.events(24, State { friction: 1.8, ..State::SOUND }))[0], Cause::Unattributed);
    let empty = |throw: &mut Observation| (throw.features, throw.outcome) = (Features::default(), None);
    assert_eq!(causes(&drive.events_with(30, State::SOUND, empty)), [Cause::NotMonitored]);
}

/// A logger that lost its battery dates its throws to 1970. This changes neither currents nor durations.
#[test]
fn an_alarm_about_dates_hides_no_change_of_the_features() {
    let mut drive = current_only(3);
    let settings = Settings::default();
    let (last, received_at) = (drive.throw(State::SOUND), "2026-03-01T12:00:00Z".parse().unwrap());
    for _ in 0..3 {
        drive.monitor.date(&last.throw, Timestamp::UNIX_EPOCH, Some(received_at), false, &settings);
    }
    assert_eq!(causes(&drive.monitor.take_events()), [Cause::Sensor]);
    let events = drive.events(24, State { friction: 1.8, ..State::SOUND });
    assert_eq!(causes(&events)[0], Cause::Unattributed, "{events:?}");
    assert!(events.iter().all(|event| event.state.is_active()), "{events:?}");
}

/// Rain and grease lower the current for days. A fall that passes within three days, or 60 throws, raises no alarm; a
/// longer one does, and so does a rise of the same size at once.
#[test]
fn a_fall_of_the_load_waits_as_rain_may_cause_it() {
    let settings = Settings::default();
    for seed in 0..12 {
        let mut rng = ChaCha8Rng::seed_from_u64(59_900 + seed);
        let mut next = healthy_features(Scatter { sd: [0.008, 0.02, 0.02], phi: 0.5, tail: None }, &mut rng);
        let mut monitor = MachineMonitor::new("21B");
        let mut events = |throws: usize, current: f64| -> Vec<AlarmEvent> {
            let throw = |_| {
                let mut observation = next();
                observation.temperature_c = Some(10.0);
                let features = &mut observation.features;
                for value in [&mut features.running_current_a, &mut features.charge_as] {
                    *value = value.map(|value| current * value);
                }
                monitor.observe(&observation, &settings).events
            };
            (0..throws).flat_map(throw).collect()
        };
        assert_eq!(events(120, 1.0), []);
        assert_eq!(events(50, 0.8), [], "seed {seed}: wet for two days and a half");
        assert_eq!(events(60, 1.0), [], "seed {seed}: dry");
        assert_eq!(events(58, 0.8), [], "seed {seed}: the first days of a lasting fall");
        let later = events(60, 0.8);
        assert_eq!(causes(&later), [Cause::Unattributed], "seed {seed}: {later:?}");
        assert!(later[0].text.contains("rain and lubrication do this"), "{}", later[0].text);
        events(120, 1.0);
        assert!(!events(24, 1.25).is_empty(), "seed {seed}: a rise");
    }
}

/// The running current is near the limit, and scatters around it.
#[test]
fn an_alarm_of_features_stays_as_long_as_they_are_changed() {
    let (mut raised, mut ended) = (0, 0);
    for seed in 10..14 {
        for torque in [0.86, 0.85] {
            let mut drive = current_only(seed);
            let weak = State { torque, ..State::SOUND };
            let events = drive.events(300, weak);
            raised += events.iter().filter(|event| event.state == AlarmState::ActiveUnacknowledged).count();
            ended += events.iter().filter(|event| event.state == AlarmState::ClearedUnacknowledged).count();
            assert!(events.len() < 2, "seed {seed}, {torque}: {events:#?}");
        }
    }
    assert!(raised >= 6 && ended == 0, "{raised}, {ended}");
}

/// The alarm is raised at the first change that matters, and the change grows on.
#[test]
fn a_change_of_the_features_that_grows_is_reported_again() {
    let mut drive = current_only(1);
    let mut events = Vec::new();
    for throw in 0..60 {
        let friction = 1.0 + 0.03 * f64::from(throw);
        events.extend(drive.feed(State { friction, ..State::SOUND }).events);
    }
    assert!((2..=8).contains(&events.len()), "{events:?}");
    let is_one_alarm = |event: &AlarmEvent| {
        (event.cause, event.state) == (Cause::Unattributed, AlarmState::ActiveUnacknowledged)
            && event.raised_at == events[0].raised_at
    };
    assert!(events.iter().all(is_one_alarm), "{events:?}");
    let severities = [&events[0], &events[events.len() - 1]].map(|event| event.severity);
    assert_eq!(severities, [Severity::Warning, Severity::Critical], "{events:?}");
    let largest = |event: &AlarmEvent| {
        let sizes = event.text.split(" +").skip(1).filter_map(|rest| rest.split(' ').next()?.parse::<f64>().ok());
        sizes.fold(0.0, f64::max)
    };
    assert!(largest(&events[events.len() - 1]) > 1.5 * largest(&events[0]), "{events:?}");
}

/// The season changes the temperature by 22 K up and down, and the running current by 0.6 % per K. The machines throw
/// once a day, or every four days. A fault is a step.
#[test]
fn the_season_of_a_machine_without_coefficients_is_no_fault_and_a_step_is_one() {
    const NEVER: u32 = u32::MAX;
    let settings = Settings::default();
    let usual = Scatter { sd: [0.008, 0.02, 0.02], phi: 0.5, tail: None };
    // A machine with a throw every four days learns its scatter for a year, so the scatter contains the season. A
    // temperature that is published only from the 40th throw on shows no season.
    for (published_from, days, fault) in [(0, 1, 1.45), (NEVER, 1, 1.45), (40, 1, 1.45), (NEVER, 4, 2.2)] {
        let is_published = published_from == 0;
        for seed in 0..12 {
            let mut rng = ChaCha8Rng::seed_from_u64(59_500 + seed);
            let mut next = healthy_features(usual, &mut rng);
            let mut monitor = MachineMonitor::new("21B");
            let begin = Timestamp::UNIX_EPOCH;
            let mut caveats = 0;
            let mut life = |throw: u32, fault: f64| {
                let day = days * throw;
                // Each machine begins its life in another month.
                let year = std::f64::consts::TAU * (f64::from(day) / 365.0 + seed as f64 / 12.0);
                let celsius = 10.0 + 22.0 * year.sin();
                let current = fault * (-0.006 * (celsius - 10.0)).exp();
                let mut observation = next();
                observation.started_at = begin + SignedDuration::from_hours(24 * i64::from(day));
                observation.temperature_c = (throw >= published_from).then_some(celsius);
                let features = &mut observation.features;
                for value in [&mut features.running_current_a, &mut features.charge_as] {
                    *value = value.map(|value| current * value);
                }
                let events = monitor.observe(&observation, &settings).events;
                caveats += u32::from(monitor.caveats().iter().any(|caveat| caveat.contains("the season looks")));
                events
            };
            let healthy: Vec<AlarmEvent> = (0..500).flat_map(|throw| life(throw, 1.0)).collect();
            assert_eq!(healthy, [], "{published_from}, {days}, seed {seed}");
            let faulty: Vec<AlarmEvent> = (500..540).flat_map(|throw| life(throw, fault)).collect();
            assert!(!faulty.is_empty(), "{published_from}, {days}, seed {seed}");
            assert_eq!(faulty.iter().find(|event| event.state != AlarmState::ActiveUnacknowledged), None, "it lasts");
            assert!(is_published || days > 1 || seed % 6 == 0 || caveats > 0, "seed {seed}: the slow change is stated");
        }
    }
}

#[test]
fn throws_that_are_rejected_one_after_the_other_show_by_their_features_that_the_machine_changed() {
    for (factor, cause) in [(1.2, Cause::Unattributed), (1.0, Cause::NotMonitored)] {
        let mut machine = Machine::in_field(56_000, Scatter::USUAL);
        machine.stay_healthy(130);
        let mut named = Vec::new();
        for _ in 0..20 {
            let throw = machine.throw(Vector3::zeros());
            let duration_s = throw.features.duration_s.map(|duration_s| factor * duration_s);
            let rejected = Observation { outcome: None, features: Features { duration_s, ..throw.features }, ..throw };
            named.extend(machine.observe(&rejected).events.into_iter().map(|event| event.cause));
        }
        assert_eq!(named.first(), Some(&cause), "{named:?}");
        let ended = machine.events(20, Vector3::zeros());
        assert!(!ended.is_empty() && machine.monitor.state() == MachineState::Healthy, "{ended:?}");
    }
}

/// A new baseline needs a large change to see a drift, so throws with coefficients say nothing about the features.
#[test]
fn an_alarm_of_features_stays_while_they_are_changed_in_throws_with_coefficients_too() {
    let mut machine = Machine::in_field(56_500, Scatter::USUAL);
    machine.stay_healthy(130);
    let mut events = |is_slow: bool, has_estimate: bool| {
        let mut named = Vec::new();
        for _ in 0..30 {
            let mut throw = machine.throw(Vector3::zeros());
            throw.features.duration_s = throw.features.duration_s.map(|own| if is_slow { 1.2 * own } else { own });
            throw.outcome = throw.outcome.filter(|_| has_estimate);
            named.extend(machine.observe(&throw).events.into_iter().map(|event| (event.cause, event.state)));
        }
        named
    };
    let changed = (Cause::Unattributed, AlarmState::ActiveUnacknowledged);
    assert!(events(true, false).contains(&changed));
    let ended = (Cause::Unattributed, AlarmState::ClearedUnacknowledged);
    assert!(!events(true, true).contains(&ended));
    assert!(events(false, true).contains(&ended));
}

/// The throws of one direction are rejected, as with a wrong `neutral_mm`, until a fault makes them acceptable.
#[test]
fn throws_after_a_row_of_rejections_are_not_learned_unchecked() {
    let mut machine = Machine::in_field(57_000, Scatter::USUAL);
    let mut events = Vec::new();
    for at in 0..200 {
        let mut throw = machine.throw(Vector3::zeros());
        let is_there = throw.direction == Some(Direction::NormalToReverse);
        let fault = if at >= 90 && is_there { 1.7 } else { 1.0 };
        if at < 90 && is_there {
            throw.outcome = None;
        }
        throw.features.running_current_a = Some(0.335 * fault * (0.02 * normal(&mut machine.rng)).exp());
        let verdict = machine.observe(&throw);
        events.extend(verdict.events.into_iter().map(|event| (event.cause, event.state)));
    }
    assert!(events.contains(&(Cause::Unattributed, AlarmState::ActiveUnacknowledged)), "{events:?}");
    assert!(!events.contains(&(Cause::Unattributed, AlarmState::ClearedUnacknowledged)), "{events:?}");
    assert_eq!(machine.monitor.baseline(Direction::NormalToReverse), None, "the fault is the baseline");
}

/// A weak supply can make the throws unusable for the model. Then the supply must be named.
#[test]
fn a_weak_supply_of_rejected_throws_is_named() {
    let mut machine = Machine::in_field(57_100, Scatter::USUAL);
    let mut feed = |is_weak: bool| {
        let mut throw = machine.throw(Vector3::zeros());
        let volts = if is_weak { 80.0 } else { 110.0 };
        throw.features.supply_v = Some(volts * (0.01 * normal(&mut machine.rng)).exp());
        if is_weak {
            throw.outcome = None;
            throw.features.duration_s = throw.features.duration_s.map(|duration_s| 1.3 * duration_s);
        }
        machine.observe(&throw).events
    };
    for _ in 0..120 {
        assert_eq!(feed(false), []);
    }
    let weak: Vec<_> = (0..12).flat_map(|_| feed(true)).collect();
    assert!(weak.iter().any(|event| event.cause == Cause::Supply), "{weak:?}");
    let mended: Vec<_> = (0..40).flat_map(|_| feed(false)).collect();
    let ended = |event: &&AlarmEvent| event.state == AlarmState::ClearedUnacknowledged;
    assert!(mended.iter().filter(ended).any(|event| event.cause == Cause::Supply), "{mended:?}");
}

#[test]
fn a_machine_whose_every_throw_is_rough_is_monitored_by_its_ratios() {
    let late = State::OF_RATIOS;
    let faults = [
        (State { friction: 2.5, ..late }, Some(Cause::Friction)),
        (State { torque: 0.75, back_emf: 0.75, ..late }, Some(Cause::Kt)),
        (State { friction: 0.95, ..late }, None),
    ];
    for (state, cause) in faults {
        for seed in 0..4 {
            let mut drive = Drive::after_in(late, 100, 58_000 + seed, Voltage::Unknown);
            assert_eq!(drive.monitor.state(), MachineState::Healthy, "{cause:?}");
            assert_eq!(drive.monitor.caveats().len(), 1, "{cause:?}: {:?}", drive.monitor.caveats());
            let events = drive.events(24, state);
            let causes = causes(&events);
            let is_right = |found: &Cause| Some(*found) == cause || *found == Cause::Unattributed && cause.is_some();
            assert!(causes.iter().all(is_right) && causes.is_empty() == cause.is_none(), "{cause:?}: {events:?}");
        }
    }
}

/// Without a toe position, the running time of the motor alone shows that the points may not have closed: a motor that
/// runs until its time-out, or stops early.
#[test]
fn a_motor_that_runs_unusually_long_or_short_raises_an_alarm_at_once() {
    let settings = Settings::default();
    let scatter = Scatter { sd: [0.008, 0.025, 0.025], phi: 0.5, tail: None };
    for (part, every) in [(2.0, 3), (4.0, 3), (0.1, 4), (0.35, 6), (4.0, 1)] {
        for seed in 0..6 {
            let mut rng = ChaCha8Rng::seed_from_u64(59_500 + seed);
            let mut next = healthy_features(scatter, &mut rng);
            let mut monitor = MachineMonitor::new("21B");
            for _ in 0..60 {
                assert_eq!(monitor.observe(&next(), &settings).events, []);
            }
            let mut events = Vec::new();
            for throw in 0..60 {
                let mut observation = next();
                if throw % every == 0 {
                    let features = &mut observation.features;
                    for value in [&mut features.duration_s, &mut features.charge_as] {
                        *value = value.map(|value| part * value);
                    }
                }
                events.extend(monitor.observe(&observation, &settings).events);
            }
            let what = format!("{part} in 1 of {every}, seed {seed}: {events:?}");
            assert!(events.iter().all(|event| event.cause == Cause::IncompleteThrow), "{what}");
            assert!(events[0].text.contains("the motor ran for") && events[0].severity == Severity::Warning, "{what}");
            let is_critical = events.iter().any(|event| event.severity == Severity::Critical);
            assert_eq!(is_critical, every == 1, "{what}");
            assert!(events.iter().all(|event| event.state.is_active()), "{what}");
        }
    }
}

/// A recording that ends before the motor shows a least running time only.
#[test]
fn a_recording_that_ends_before_the_motor_shows_a_stall_and_no_early_stop() {
    let scatter = Scatter { sd: [0.008, 0.025, 0.025], phi: 0.5, tail: None };
    for (part, expected) in [(2.0, vec![Cause::IncompleteThrow]), (0.9, vec![]), (0.3, vec![])] {
        let mut rng = ChaCha8Rng::seed_from_u64(59_900);
        let mut next = healthy_features(scatter, &mut rng);
        let mut monitor = MachineMonitor::new("21B");
        let mut events = Vec::new();
        for throw in 0..80 {
            let mut observation = next();
            if throw % 8 == 7 && throw > 60 {
                let features = &mut observation.features;
                let whole = features.duration_s.take().zip(features.charge_as.take());
                (features.driven_s, features.driven_as) = whole.map(|all| (part * all.0, part * all.1)).unzip();
            }
            events.extend(monitor.observe(&observation, &Settings::default()).events);
        }
        assert_eq!(causes(&events), expected, "{part}: {events:?}");
    }
}

/// With a toe sensor, the throws of a three-phase motor show whether the points closed, and the loss of the sensor.
#[test]
fn a_three_phase_motor_with_a_toe_sensor_has_a_position() {
    let settings = Settings::default();
    let mut rng = ChaCha8Rng::seed_from_u64(59_800);
    let mut next = healthy_features(Scatter { sd: [0.008, 0.025, 0.025], phi: 0.5, tail: None }, &mut rng);
    let mut monitor = MachineMonitor::new("21B");
    let mut observe = |throws: usize, longer: f64, travel_mm: Option<f64>| {
        let mut events = Vec::new();
        for _ in 0..throws {
            let mut observation = next();
            let features = &mut observation.features;
            features.duration_s = features.duration_s.map(|duration_s| longer * duration_s);
            features.travel_mm = travel_mm;
            features.run_on_s = travel_mm.map(|_| 0.1);
            events.extend(monitor.observe(&observation, &settings).events);
        }
        events
    };
    assert_eq!(observe(60, 1.0, Some(115.0)), []);
    let slow = observe(10, 2.0, Some(115.0));
    assert!(!slow.is_empty() && slow.iter().all(|event| event.cause == Cause::Unattributed), "{slow:#?}");
    assert!(!slow[0].text.contains("runs on"), "{slow:#?}");
    observe(60, 1.0, Some(115.0));
    let lost = observe(10, 1.0, None);
    assert_eq!(causes(&lost), [Cause::Sensor], "{lost:#?}");
}

#[test]
fn a_logger_that_names_one_direction_for_all_throws_is_stated() {
    let mut rng = ChaCha8Rng::seed_from_u64(59_700);
    let mut next = healthy_features(Scatter { sd: [0.008, 0.025, 0.025], phi: 0.5, tail: None }, &mut rng);
    let mut monitor = MachineMonitor::new("21B");
    let mut stated = |throws: usize, direction: Option<Direction>| {
        for _ in 0..throws {
            let observation = next();
            let direction = direction.or(observation.direction);
            monitor.observe(&Observation { direction, ..observation }, &Settings::default());
        }
        monitor.caveats().iter().any(|caveat| caveat.contains("for all of the last 13 throws"))
    };
    assert!(!stated(40, None));
    assert!(stated(13, Some(Direction::NormalToReverse)));
    assert!(!stated(2, None));
}

/// Observations of a machine without a toe sensor, with random features. `scatter` is that of the logarithms of
/// duration, running current and charge.
fn healthy_features(scatter: Scatter, rng: &mut ChaCha8Rng) -> impl FnMut() -> Observation {
    let mut state = Vector3::zeros();
    let mut throw = 0_u64;
    move || {
        state = scatter.next(state, || normal(rng));
        throw += 1;
        let of = |at: usize, usual: f64| Some(usual * state[at].exp());
        let started_at = Timestamp::UNIX_EPOCH + SignedDuration::from_mins(72 * throw.cast_signed());
        Observation {
            direction: Some(Direction::BOTH[usize::from(throw.is_multiple_of(2))]),
            outcome: Some(Err(Rejection::NoPosition { sent: "", why: String::new() })),
            features: Features {
                duration_s: of(0, 4.3),
                running_current_a: of(1, 0.9),
                charge_as: of(2, 4.6),
                ..Features::default()
            },
            ..Observation::without_trace(ThrowRef { boot_id: "a".to_owned(), throw_no: throw }, started_at)
        }
    }
}

#[test]
fn healthy_machines_without_a_toe_sensor_stay_within_the_budget() {
    // 1 in 146,000 throws is the default budget of a machine.
    let settings = Settings::default();
    let usual = Scatter { sd: [0.008, 0.025, 0.025], phi: 0.5, tail: None };
    for (name, scatter) in [
        ("as measured on repeats", Scatter { sd: [0.0045, 0.008, 0.008], phi: 0.3, tail: None }),
        ("usual weather", usual),
        ("heavy tails", Scatter { tail: Some(3), ..usual }),
        ("strong correlation", Scatter { phi: 0.8, ..usual }),
    ] {
        let (mut alarms, mut throws) = (0, 0);
        for seed in 0..50 {
            let mut rng = ChaCha8Rng::seed_from_u64(59_000 + seed);
            let mut next = healthy_features(scatter, &mut rng);
            let mut monitor = MachineMonitor::new("21B");
            for _ in 0..2000 {
                throws += 1;
                let events = monitor.observe(&next(), &settings).events;
                alarms += events.iter().filter(|event| event.state == AlarmState::ActiveUnacknowledged).count();
            }
        }
        println!("{name}: {alarms} alarms in {throws} throws");
        assert!(alarms <= 2, "{name}: {alarms} alarms in {throws} throws");
    }
}

/// Alarms that `lives` healthy machines without a toe sensor raise in `life` complete simulated throws each.
fn raised_by_currents(voltage: Voltage, rate_hz: f64, lives: u64, life: usize) -> Vec<String> {
    let live = |seed| {
        let mut drive = Drive::new(610_000 + seed, voltage);
        (drive.has_toe_sensor, drive.rate_hz, drive.stroke_mm) = (false, rate_hz, Some(115.0));
        let raised = drive.events(life, State::SOUND).into_iter().filter(|event| event.event_no == 1);
        raised.map(|event| format!("machine {seed}: {}", event.text)).collect()
    };
    in_parallel::<Vec<String>>(lives, live).concat()
}

/// At 25 Hz the inrush has one sample or none. In one direction the spring drives the machine, so the current passes
/// through zero.
#[test]
fn slow_recordings_show_the_start_of_the_motor() {
    let mut durations = [Vec::new(), Vec::new()];
    let throws = 20;
    for seed in 0..10 {
        let mut drive = Drive::new(620_000 + seed, Voltage::Unknown);
        (drive.has_toe_sensor, drive.rate_hz) = (false, 25.0);
        let of_machine: Vec<Observation> = (0..throws).map(|_| drive.throw(State::SOUND)).collect();
        for (at, durations) in durations.iter_mut().enumerate() {
            let mut own: Vec<f64> =
                of_machine.iter().skip(at).step_by(2).filter_map(|throw| throw.features.duration_s).collect();
            own.sort_by(f64::total_cmp);
            let median = own[own.len() / 2];
            durations.extend(own.into_iter().map(|duration_s| duration_s / median));
        }
    }
    for (direction, durations) in Direction::BOTH.iter().zip(&durations) {
        let near = durations.iter().filter(|ratio| (**ratio - 1.0).abs() < 0.08).count();
        println!("{direction:?}: {} of 100 throws with a duration, {near} near that of the machine", durations.len());
        assert!(durations.len() >= 90 && near >= 85, "{direction:?}: {}, {near}", durations.len());
    }
}

/// 100,000 simulated throws a row, for which the default budget allows 0.7 false alarms. `POINTSD_LIVES` sets the
/// number of machines with 1,000 throws each, 100 by default.
#[test]
#[ignore = "simulates 400,000 throws, in some minutes"]
fn currents_of_healthy_machines_stay_within_the_budget() {
    let lives = std::env::var("POINTSD_LIVES").map_or(100, |text| text.parse().unwrap());
    let (mut alarms, mut throws) = (0, 0);
    for (voltage, rate_hz) in
        [(Voltage::Published, 1000.0), (Voltage::Unknown, 1000.0), (Voltage::Published, 25.0), (Voltage::Unknown, 25.0)]
    {
        let raised = raised_by_currents(voltage, rate_hz, lives, 1000);
        println!("supply_v {voltage:?}, {rate_hz} Hz: {} alarms in {} throws: {raised:#?}", raised.len(), lives * 1000);
        alarms += raised.len();
        throws += lives * 1000;
    }
    let budget = throws as f64 * Settings::default().false_alarms_per_throw();
    assert!(alarms as f64 <= budget, "{alarms} alarms, {budget:.1} in the budget");
}
