//! Throws with the current of another machine, and what a machine draws at rest: lives of a drive with a lock and a load.

use pointsd::diagnose::{AlarmEvent, AlarmState, Cause, MachineState, SensorChannel, Settings, Verdict};

use crate::drive::{Drive, State};

/// A drive after `throws` healthy ones in this state, without an event.
fn settled(seed: u64, state: State, throws: usize) -> Drive {
    let mut drive = Drive::new(seed, false);
    for throw in 0..throws {
        let verdict = drive.feed(state, &Settings::default());
        assert_eq!(verdict.events, [], "seed {seed}, throw {throw}");
        assert_eq!(verdict.doubt, None, "seed {seed}, throw {throw}");
    }
    drive
}

fn feed_with(drive: &mut Drive, other: &mut Drive, state: State) -> Verdict {
    let observation = drive.observe_with(state, Some(other));
    drive.monitor.observe(&observation, &Settings::default())
}

fn rejects(verdict: &Verdict) -> bool {
    verdict.doubt.as_ref().is_some_and(|doubt| doubt.rejects)
}

fn said(events: &[AlarmEvent]) -> Vec<(Cause, Option<SensorChannel>, AlarmState)> {
    events.iter().map(|event| (event.cause, event.channel, event.state)).collect()
}

const RAISED: (Cause, Option<SensorChannel>, AlarmState) =
    (Cause::Sensor, Some(SensorChannel::Current), AlarmState::ActiveUnacknowledged);
const CLEARED: (Cause, Option<SensorChannel>, AlarmState) =
    (Cause::Sensor, Some(SensorChannel::Current), AlarmState::ClearedUnacknowledged);

#[test]
fn the_current_of_another_machine_is_rejected_and_many_such_throws_are_an_alarm() {
    let settings = Settings::default();
    for lock_rad in [0.0, 5.0] {
        let state = State { lock_rad, ..State::SOUND };
        let mut doubted = 0;
        for seed in 0..6 {
            let mut drive = settled(61_000 + seed, state, 60);
            let mut other = Drive::new(62_000 + seed, false);
            // Two such throws are rejected or rough, and change nothing.
            for _ in 0..2 {
                let verdict = feed_with(&mut drive, &mut other, state);
                assert_eq!(verdict.events, [], "seed {seed}");
                doubted += u32::from(verdict.doubt.is_some());
                let after: Vec<_> = (0..12).flat_map(|_| drive.feed(state, &settings).events).collect();
                assert_eq!(after, [], "seed {seed}");
            }
            let many: Vec<_> = (0..24).flat_map(|_| feed_with(&mut drive, &mut other, state).events).collect();
            assert!(!many.is_empty(), "seed {seed}: 24 throws with the current of another machine are silent");
        }
        println!("lock {lock_rad} rad: {doubted} of 12 doubted");
        assert!(doubted >= 8, "lock {lock_rad} rad: {doubted} of 12");
    }
}

#[test]
fn a_changed_lock_is_an_alarm_and_the_machine_stays_monitored() {
    let settings = Settings::default();
    let usual = State { lock_rad: 5.0, ..State::SOUND };
    let mut drive = settled(63_000, usual, 70);
    let changed = State { lock_rad: 8.0, friction: 1.6, ..usual };
    let verdicts: Vec<_> = (0..20).map(|_| drive.feed(changed, &settings)).collect();
    let rejected: Vec<usize> = (0..20).filter(|throw| rejects(&verdicts[*throw])).collect();
    assert!(rejected.len() == 2 && rejected[1] < 4, "{rejected:?}");
    let events: Vec<_> = verdicts.into_iter().flat_map(|verdict| verdict.events).collect();
    assert_eq!(said(&events)[0], RAISED, "{events:?}");
    assert!(events.iter().any(|event| event.cause == Cause::Friction), "the friction shows too: {events:?}");
    let ended: Vec<_> = (0..60).flat_map(|_| drive.feed(usual, &settings).events).collect();
    assert!(said(&ended).contains(&CLEARED), "{ended:?}");
}

#[test]
fn a_fault_of_a_machine_with_a_lock_is_no_throw_of_another_machine() {
    let settings = Settings::default();
    let usual = State { lock_rad: 5.0, ..State::SOUND };
    for state in [
        State { friction: 2.0, ..usual },
        State { torque: 0.8, back_emf: 0.8, ..usual },
        State { stiffness: 1.5, ..usual },
        State { inertia: 1.3, ..usual },
        State { volts: 0.65, ..usual },
        State { position_noise_mm: 0.2, ..usual },
    ] {
        let mut drive = settled(64_000, usual, 60);
        for throw in 0..20 {
            let verdict = drive.feed(state, &settings);
            assert!(!rejects(&verdict), "{state:?}, throw {throw}: {:?}", verdict.doubt);
        }
        // The same in every fifth throw only.
        let mut drive = settled(65_000, usual, 60);
        for throw in 0..20 {
            let verdict = drive.feed(if throw % 5 == 0 { state } else { usual }, &settings);
            assert!(!rejects(&verdict), "{state:?}, throw {throw}: {:?}", verdict.doubt);
        }
    }
}

#[test]
fn a_standing_current_is_part_of_the_machine_and_only_its_change_is_news() {
    let settings = Settings::default();
    for has_toe_sensor in [true, false] {
        for (standing_a, rest_noise_a) in [(0.3, 0.0), (1.0, 0.0), (0.0, 0.4), (-0.4, 0.1)] {
            let usual = State { standing_a, rest_noise_a, ..State::SOUND };
            let mut drive = Drive::new(66_000, false);
            drive.has_toe_sensor = has_toe_sensor;
            let mut estimates = 0;
            for throw in 0..60 {
                let observation = drive.observe(usual);
                estimates += u32::from(observation.estimate.is_some());
                let verdict = drive.monitor.observe(&observation, &settings);
                assert_eq!(verdict.events, [], "{standing_a} A, {rest_noise_a} A, throw {throw}");
            }
            assert_eq!(estimates, if has_toe_sensor { 60 } else { 0 }, "{standing_a} A, {rest_noise_a} A");
            let more = State { standing_a: standing_a + 0.6, ..usual };
            let events: Vec<_> = (0..12).flat_map(|_| drive.feed(more, &settings).events).collect();
            assert_eq!(said(&events), [RAISED], "{standing_a} A: {events:?}");
            let text = &events[0].text;
            assert!(
                text.contains("offset of the current sensor") && text.contains("load draws current at rest"),
                "{text}"
            );
            let ended: Vec<_> = (0..20).flat_map(|_| drive.feed(usual, &settings).events).collect();
            assert_eq!(said(&ended), [CLEARED], "{standing_a} A: {ended:?}");
            assert_eq!(drive.monitor.state(), MachineState::Healthy);
        }
    }
}

#[test]
fn a_part_of_a_throw_changes_no_feature_of_a_machine_without_a_toe_sensor() {
    let settings = Settings::default();
    for seed in 0..4 {
        let mut drive = Drive::new(67_000 + seed, false);
        drive.has_toe_sensor = false;
        for throw in 0..60 {
            assert_eq!(drive.feed(State::SOUND, &settings).events, [], "seed {seed}, throw {throw}");
        }
        for cut_s in [0.22, 0.3, 0.5, 1.2] {
            let observation = drive.observe(State { late_s: cut_s, ..State::SOUND });
            let verdict = drive.monitor.observe(&observation, &settings);
            let told = !observation.features_only || rejects(&verdict);
            assert!(told, "seed {seed}: the first {cut_s} s are missing: {:?}", observation.features);
            assert_eq!(verdict.events, [], "seed {seed}");
        }
        // A recorder that always starts too late leaves the machine without monitoring, which is said.
        let late = State { late_s: 0.4, ..State::SOUND };
        let events: Vec<_> = (0..30).flat_map(|_| drive.feed(late, &settings).events).collect();
        assert!(events.iter().all(|event| event.cause == Cause::NotMonitored) && !events.is_empty(), "{events:?}");
    }
}
