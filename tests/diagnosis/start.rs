//! A changed start of the movement of a machine that then runs as before: a late brake, play, a late position.

use pointsd::diagnose::{AlarmEvent, AlarmState, Cause};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::normal,
};

fn is_about_the_start(event: &AlarmEvent) -> bool {
    event.cause == Cause::Unattributed && event.text.contains("the start of the movement has changed")
}

/// A drive after a healthy time without an event.
fn learned(seed: u64) -> Drive {
    Drive::after(100, 59_000 + seed, Voltage::Unknown)
}

#[test]
fn a_late_brake_play_or_a_late_position_has_an_alarm_that_names_them() {
    let sound = State::SOUND;
    let faults = [
        State { brake_s: 0.01, ..sound },
        State { brake_s: 0.02, ..sound },
        State { brake_s: 0.03, ..sound },
        State { play_mm: 0.1, ..sound },
        State { play_mm: 1.0, ..sound },
        State { late_s: 0.005, ..sound },
    ];
    for (at, fault) in faults.into_iter().enumerate() {
        for ramp in [1, 60] {
            let mut drive = learned(at as u64);
            let events: Vec<_> = (1..=100)
                .flat_map(|throw| {
                    let part = f64::from(throw.min(ramp)) / f64::from(ramp);
                    let [brake_s, late_s] = [fault.brake_s, fault.late_s].map(|time_s| part * time_s);
                    drive.feed(State { brake_s, late_s, play_mm: part * fault.play_mm, ..sound }).events
                })
                .collect();
            let open = drive.monitor.open_alarms();
            println!("{:?}", open.iter().map(|event| &event.text).collect::<Vec<_>>());
            assert!(!open.is_empty(), "{fault:?}, ramp {ramp}: no alarm");
            let raised = open.len();
            let names = |event: &AlarmEvent| event.text.contains("brake") && event.text.contains("play");
            assert!(events.iter().all(names), "{fault:?}, ramp {ramp}: {events:?}");
            let mended = drive.events(100, sound);
            let ended = mended.iter().filter(|event| event.state == AlarmState::ClearedUnacknowledged).count();
            assert_eq!(ended, raised, "{fault:?}, ramp {ramp}: {mended:?}");
        }
    }
}

#[test]
fn a_fault_of_a_running_part_is_no_changed_start() {
    let sound = State::SOUND;
    let faults = [
        State { friction: 1.8, ..sound },
        State { torque: 0.75, back_emf: 0.75, ..sound },
        State { torque: 0.75, ..sound },
        State { stiffness: 1.6, ..sound },
        State { inertia: 1.2, ..sound },
        State { volts: 0.75, ..sound },
        State { current_gain: 1.2, ..sound },
        State { position_gain: 0.85, stroke: 1.0, ..sound },
    ];
    for (at, fault) in faults.into_iter().enumerate() {
        let mut drive = learned(20 + at as u64);
        let events = drive.events(60, fault);
        assert!(!events.iter().any(is_about_the_start), "{fault:?}: {events:?}");
    }
}

/// With a winding that is 50 K warmer, or a bad contact, the inrush is lower and the toe moves later.
#[test]
fn a_lower_inrush_is_no_changed_start() {
    let late = State::OF_RATIOS;
    for (ohms, seed) in [(1.2, 33_000), (1.2, 33_001), (1.3, 33_000), (1.3, 33_001)] {
        let mut drive = Drive::after_in(late, 140, seed, Voltage::Unknown);
        drive.stay_healthy(80, State { ohms, ..late });
    }
}

/// Noise of 0.5 mm scatters the measured delay by 5 to 15 ms, and changes its mean.
#[test]
fn a_noisy_position_sensor_is_no_changed_start() {
    for (seed, position_noise_mm) in (40..46).zip([0.3, 0.4, 0.5].into_iter().cycle()) {
        let mut drive = learned(seed);
        let noisy = State { position_noise_mm, ..State::SOUND };
        let events = drive.events(60, noisy);
        assert_eq!(events, [], "{position_noise_mm} mm, seed {seed}");
    }
}

/// The brake of a healthy machine is late by a time that scatters, and its friction follows the weather.
#[test]
fn a_start_that_always_scatters_is_normal() {
    for seed in 0..3 {
        let (mut drive, mut rng) = (Drive::new(59_500 + seed, Voltage::Unknown), ChaCha8Rng::seed_from_u64(seed));
        for throw in 0..300 {
            let brake_s = 0.006 * (0.2 * normal(&mut rng)).exp();
            let friction = 1.0 + 0.05 * (f64::from(throw) / 30.0).sin();
            let verdict = drive.feed(State { friction, brake_s, ..State::SOUND });
            assert!(!verdict.events.iter().any(is_about_the_start), "seed {seed}, throw {throw}: {:?}", verdict.events);
        }
    }
}

/// The brake is late, and later a part has a fault. When the part is named, it explains the start too.
#[test]
fn the_alarm_about_the_start_ends_when_a_part_is_named() {
    for (seed, fault, cause) in [
        (40, State { friction: 2.2, ..State::SOUND }, Cause::Friction),
        (41, State { torque: 0.7, back_emf: 0.7, ..State::SOUND }, Cause::Kt),
    ] {
        let mut drive = learned(seed);
        let before = drive.events(40, State::OF_RATIOS);
        assert!(before.len() == 1 && is_about_the_start(&before[0]), "{before:?}");
        let (mut drifts, mut events) = (Vec::new(), Vec::new());
        for _ in 0..60 {
            let verdict = drive.feed(State { brake_s: 0.02, ..fault });
            events.extend(verdict.events);
            drifts = verdict.present.drifts;
        }
        let withdrawn = events.iter().find(|event| event.cause == Cause::Unattributed).unwrap();
        assert_eq!(withdrawn.state, AlarmState::ClearedUnacknowledged, "{events:?}");
        assert!(withdrawn.text.contains(&format!("{cause} explains the change")), "{}", withdrawn.text);
        assert_eq!(drifts.first().map(|drifting| drifting.cause), Some(cause), "{events:?}");
    }
}
