//! Loggers whose rate does not resolve the rise of the current. Down to 250 Hz the throws give the ratios of the
//! coefficients, below only features.

use pointsd::{
    diagnose::{Cause, Estimated, MachineState},
    throw::Throw,
};

use crate::{
    drive::{Drive, Logger, State, Voltage, with_trace},
    fleet::causes,
};

/// Each `FACTOR`-th sample of a throw; the first one differs from throw to throw.
fn slower<const FACTOR: usize>(throw: Throw) -> Throw {
    let first = usize::try_from(7 * throw.id.throw_no).unwrap() % FACTOR;
    let of = |values: Vec<f64>| values.into_iter().skip(first).step_by(FACTOR).collect();
    with_trace(throw, |rate, current, position| (rate / FACTOR as f64, of(current), of(position)))
}

/// ln(a1/b0) and ln(a0/b0) of a throw with their standard deviations.
fn ratios(drive: &mut Drive, state: State) -> Option<[(f64, f64); 2]> {
    let Estimated { coefficients: estimate, covariance, .. } = *drive.throw(state).estimate()?;
    let relative = |i: usize, j: usize| covariance[(i, j)] / (estimate[i] * estimate[j]);
    let ratio = |i: usize| {
        let sd = (relative(0, 0) + relative(i, i) - 2.0 * relative(0, i)).sqrt();
        ((estimate[i] / estimate[0]).ln(), sd)
    };
    Some([ratio(1), ratio(2)])
}

#[test]
fn the_ratios_at_250_hz_are_those_at_1_khz() {
    let faulty = State { friction: 1.4, torque: 0.9, stiffness: 1.2, ..State::SOUND };
    let (mut compared, mut missing) = (0, 0);
    for seed in 6_600..6_606 {
        let (mut fast, mut slow) = (Drive::new(seed, Voltage::Unknown), Drive::new(seed, Voltage::Unknown));
        slow.logger = slower::<4>;
        for state in [State::SOUND, faulty].into_iter().cycle().take(20) {
            let Some([fast, slow]) = ratios(&mut fast, state).zip(ratios(&mut slow, state)).map(<[_; 2]>::from) else {
                missing += 1;
                continue;
            };
            for ((fast, _), (slow, sd)) in fast.into_iter().zip(slow) {
                compared += 1;
                assert!((slow - fast).abs() < 0.02 && (slow - fast).abs() < 1.96 * sd, "{seed}: {slow} ± {sd}, {fast}");
            }
        }
    }
    assert!(compared > 200 && missing < 8, "{compared}, {missing}");
}

#[test]
fn a_machine_at_250_hz_is_monitored_by_its_ratios() {
    let faults = [
        (State { friction: 1.4, ..State::SOUND }, "friction"),
        (State { stiffness: 1.25, ..State::SOUND }, "stiffness"),
        (State { torque: 0.8, back_emf: 0.8, ..State::SOUND }, "motor"),
    ];
    for (seed, (state, name)) in (6_700..6_709).zip(faults.into_iter().cycle()) {
        let mut drive = Drive::new(seed, Voltage::Published);
        drive.logger = slower::<4>;
        assert_eq!(drive.events(200, State::SOUND), [], "seed {seed}");
        assert_eq!(drive.monitor.state(), MachineState::Healthy);
        let events = drive.events(40, state);
        assert!(!events.is_empty() && events.iter().all(|event| event.text.contains(name)), "{name}: {events:#?}");
    }
}

#[test]
fn a_machine_at_100_hz_is_monitored_by_its_features() {
    for seed in 6_800..6_803 {
        let mut drive = Drive::new(seed, Voltage::Unknown);
        drive.logger = slower::<10>;
        assert_eq!(drive.events(200, State::SOUND), [], "seed {seed}");
        assert_eq!(drive.monitor.state(), MachineState::Healthy);
        let caveats = drive.monitor.caveats();
        assert!(caveats.len() == 1 && caveats[0].contains("only duration, running current"), "{caveats:?}");
        let events = drive.events(40, State { friction: 1.8, ..State::SOUND });
        let causes = causes(&events);
        assert!(causes.contains(&Cause::Unattributed) && !causes.contains(&Cause::NotMonitored), "{events:#?}");
    }
}

/// 40,000 throws: minutes.
#[test]
#[ignore = "minutes"]
fn healthy_machines_at_250_and_100_hz_raise_no_alarm_in_forty_lives_each() {
    let loggers: [(_, Logger); 2] = [(6_900..6_940, slower::<4>), (6_940..6_980, slower::<10>)];
    for (seed, logger) in loggers.into_iter().flat_map(|(seeds, logger)| seeds.map(move |seed| (seed, logger))) {
        let mut drive = Drive::new(seed, Voltage::alternating(seed));
        drive.logger = logger;
        assert_eq!(drive.events(500, State::SOUND), [], "seed {seed}");
    }
}
