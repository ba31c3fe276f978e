//! Machines whose motor works hard: the load takes a fifth of the voltage, so friction and a bad contact change the
//! speed.

use pointsd::{
    diagnose::{AlarmEvent, Cause},
    throw::{Direction, ThrowRef},
};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::{assert_nine_of_ten, in_parallel, sizes_held},
};

/// A loaded motor without a fault. Half of the friction is dry.
const LOADED: State = State { friction: 12.0, ..State::SOUND };
/// The same with a late brake, so that the throws give only the ratios of the coefficients.
const OF_RATIOS: State = State { brake_s: State::OF_RATIOS.brake_s, ..LOADED };

/// A loaded drive after a healthy time without an event.
fn learned(seed: u64, voltage: Voltage, state: State) -> Drive {
    Drive::after_in(state, 100, 96_000 + seed, voltage)
}

/// Cause, throw and text of each event.
fn texts(events: &[AlarmEvent]) -> Vec<(Cause, Option<&ThrowRef>, &str)> {
    events.iter().map(|event| (event.cause, event.last_throw.as_ref(), event.text.as_str())).collect()
}

/// Checks that nine of ten 95 % intervals of `cause` contain its true size, in the throws after a step to `state`.
fn assert_size(cause: Cause, before: State, state: State, truth_pct: f64) {
    let of_lives = in_parallel(6, |seed| {
        let mut drive = learned(seed, Voltage::alternating(seed), before);
        sizes_held(cause, truth_pct, (0..40).map(|_| drive.feed(state)))
    });
    assert_nine_of_ten(&of_lives.concat(), 150, &format!("{cause} {truth_pct} %"));
}

/// Friction slows the motor, and the viscous model shows dry friction larger at a lower speed.
#[test]
fn the_size_of_friction_is_that_of_its_force_and_not_of_its_effect_on_the_speed() {
    for before in [LOADED, OF_RATIOS] {
        for (factor, truth_pct) in [(1.3, 30.0), (1.6, 60.0)] {
            assert_size(Cause::Friction, before, State { friction: factor * before.friction, ..before }, truth_pct);
        }
    }
}

/// Dry friction takes a constant part of the torque of the inrush, so b0 falls by a larger share than the torque. So does
/// b0/a0, as the motor turns more slowly towards the end of the stroke.
#[test]
fn the_size_of_a_motor_fault_is_that_of_its_torque_and_not_of_what_friction_leaves() {
    for before in [LOADED, OF_RATIOS] {
        for factor in [0.88, 0.8] {
            let weaker = State { torque: factor, back_emf: factor, ..before };
            assert_size(Cause::Kt, before, weaker, 100.0 * (factor - 1.0));
        }
    }
}

/// A bad contact slows the motor, which changes the coefficients too. Without a supply voltage the inrush shows it.
#[test]
fn a_bad_contact_of_a_loaded_motor_is_named_and_no_part() {
    for before in [LOADED, OF_RATIOS] {
        let of_lives = in_parallel(6, |seed| {
            let mut drive = learned(20 + seed, Voltage::alternating(seed), before);
            drive.events(80, State { ohms: 2.0, ..before })
        });
        for events in of_lives {
            let is_of_part = |cause: Cause| Cause::PHYSICAL.contains(&cause) || cause == Cause::Sensor;
            assert!(events.iter().all(|event| !is_of_part(event.cause)), "{:#?}", texts(&events));
            assert!(events.iter().any(|event| event.cause == Cause::Supply), "{:#?}", texts(&events));
        }
    }
}

/// Dry friction along the stroke looks like stiffness, on some machines in one direction only.
#[test]
fn friction_that_looks_like_stiffness_in_one_direction_has_no_second_alarm() {
    let of_lives = in_parallel(6, |seed| {
        let mut drive = learned(40 + seed, Voltage::alternating(seed), OF_RATIOS);
        let mut events = Vec::new();
        for _ in 0..160 {
            let stiffness = if drive.next() == Direction::ReverseToNormal { 1.12 } else { 0.95 };
            events.extend(drive.feed(State { friction: 1.6 * OF_RATIOS.friction, stiffness, ..OF_RATIOS }).events);
        }
        events
    });
    for events in of_lives {
        assert!(events.iter().any(|event| event.cause == Cause::Friction), "{:#?}", texts(&events));
        assert!(events.iter().all(|event| event.cause != Cause::Stiffness), "{:#?}", texts(&events));
    }
}

/// For a while the windows contain throws from before and after the repair. Together these look like no single part.
#[test]
fn a_repair_raises_no_alarm_about_the_throws_before_it() {
    let of_lives = in_parallel(12, |seed| {
        let mut drive = learned(60 + seed, Voltage::alternating(seed), OF_RATIOS);
        for _ in 0..80 {
            let stiffness = if drive.next() == Direction::ReverseToNormal { 1.2 } else { 1.0 };
            drive.feed(State { friction: 1.6 * OF_RATIOS.friction, stiffness, ..OF_RATIOS });
        }
        drive.events(40, OF_RATIOS)
    });
    for events in of_lives {
        assert!(events.iter().all(|event| !event.state.is_active()), "{:#?}", texts(&events));
    }
}
