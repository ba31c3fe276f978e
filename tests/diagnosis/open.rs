//! Points that open again after the throw, and throws that are reversed midway.

use pointsd::{
    diagnose::{AlarmState, Cause, MachineState, SensorChannel, Severity},
    throw::{Direction, Throw},
};

use crate::{
    drive::{Drive, Logger, State, Voltage, with_trace},
    fleet::channels,
    operational::{ended, raised, summary},
};

/// Distance by which the toe comes back, and the time that it needs \[s\].
const BACK_MM: f64 = 12.0;
const BACK_S: f64 = 0.1;
/// Current above which the motor is on \[A\]; less than 1 A where the spring helps.
const ON_A: f64 = 0.2;

/// Last sample with the motor on.
fn off(current: &[f64]) -> usize {
    current.iter().rposition(|amperes| amperes.abs() > ON_A).unwrap()
}

/// The rails push the toe back after the motor is off.
fn opens(throw: Throw) -> Throw {
    let sign = throw.direction.unwrap().sign();
    with_trace(throw, |rate_hz, current, mut position| {
        let off = off(&current);
        for (k, mm) in position[off..].iter_mut().enumerate() {
            *mm -= sign * BACK_MM * (k as f64 / rate_hz / BACK_S).min(1.0);
        }
        (rate_hz, current, position)
    })
}

/// The toe moves back from where [`opens`] left it.
fn closes(throw: Throw) -> Throw {
    let is_reverse = throw.direction == Some(Direction::NormalToReverse);
    with_trace(throw, |rate_hz, current, position| {
        let open = if is_reverse { BACK_MM } else { position[0] - BACK_MM };
        let moved = |mm: f64| if is_reverse { mm.max(open) } else { mm.min(open) };
        (rate_hz, current, position.into_iter().map(moved).collect())
    })
}

/// After half of the movement the motor drives the toe back, a little beyond its start.
fn reversed(throw: Throw) -> Throw {
    let beyond_mm = 0.4 * throw.direction.unwrap().sign();
    let part = move |k: usize, half: usize| (k.saturating_sub(half) as f64 / half as f64).min(1.0);
    with_trace(throw, |rate_hz, current, position| {
        let half = off(&current) / 2;
        let len = 2 * half + current.len() - off(&current);
        let back = |k: usize| if k > half { (2 * half).saturating_sub(k) } else { k };
        let driven = |k: usize| if k > half { -current[back(k)] } else { current[k] };
        let moved = |k: usize| position[back(k)] - beyond_mm * part(k, half);
        (rate_hz, (0..len).map(driven).collect(), (0..len).map(moved).collect())
    })
}

/// The range of the logger is 60 % of the inrush.
fn clipped(throw: Throw) -> Throw {
    with_trace(throw, |rate_hz, current, position| {
        let limit = 0.6 * current.iter().fold(0.0, |largest: f64, amperes| largest.max(amperes.abs()));
        (rate_hz, current.into_iter().map(|amperes| amperes.clamp(-limit, limit)).collect(), position)
    })
}

/// A sound drive whose motor stops as the toe arrives, so that a short throw looks like one that was cut off.
fn drive(seed: u64, stroke_mm: Option<f64>) -> Drive {
    let mut drive = Drive::new(seed, Voltage::Published);
    drive.stroke_mm = stroke_mm;
    drive.stay_healthy(60, State::SOUND);
    drive
}

#[test]
fn points_that_open_again_are_critical_at_the_first_throw_and_no_fault_of_a_sensor() {
    for stroke_mm in [None, Some(115.0)] {
        for first in 0..2 {
            let mut drive = drive(81, stroke_mm);
            drive.stay_healthy(first, State::SOUND);
            let from = drive.next();
            drive.logger = opens;
            let events = drive.events(1, State::SOUND);
            let named: Vec<_> = events.iter().map(|event| (event.cause, event.severity)).collect();
            assert_eq!(named, [(Cause::IncompleteThrow, Severity::Critical)], "{from}, {stroke_mm:?}: {events:?}");
            // Noise moves the positions by less than half a millimetre.
            let (back, open) = (BACK_MM - 0.5, if from == Direction::NormalToReverse { 102.5 } else { BACK_MM - 0.5 });
            for (part, least) in [("the toe came back by ", back), ("stands open at ", open)] {
                let text = &events[0].text;
                let number = text.split(part).nth(1).and_then(|rest| rest.split(' ').next()?.parse::<f64>().ok());
                assert!(number.is_some_and(|mm| (least..least + 1.0).contains(&mm)), "{from}, {stroke_mm:?}: {text}");
            }
            for _ in 0..8 {
                for logger in [closes as Logger, opens] {
                    drive.logger = logger;
                    let events = drive.events(1, State::SOUND);
                    assert_eq!(events, [], "{from}, {stroke_mm:?}");
                }
            }
        }
    }
}

/// A throw that begins with an open toe is excused only if it closes the points.
#[test]
fn a_throw_back_from_an_open_toe_that_does_not_arrive_is_incomplete() {
    let mut drive = drive(82, Some(115.0));
    drive.logger = opens;
    assert_eq!(drive.events(1, State::SOUND).len(), 1);
    drive.logger = |throw| {
        with_trace(closes(throw), |rate_hz, current, position| {
            (rate_hz, current, position.into_iter().map(|mm| mm.max(20.0)).collect())
        })
    };
    let throw = drive.throw(State::SOUND);
    drive.observe(&throw);
    drive.logger = |throw| throw;
    // The alarm ends after 12 complete throws, and the short one was none.
    assert_eq!(drive.events(11, State::SOUND), []);
    assert_eq!(drive.events(1, State::SOUND).len(), 1);
}

/// The throw back from an obstruction is as short as the obstructed one, and closes the points.
#[test]
fn a_throw_back_from_an_obstruction_is_no_second_incomplete_throw() {
    for stroke_mm in [None, Some(115.0)] {
        let mut drive = drive(84, stroke_mm);
        let half = State { stroke: 0.52, ..State::SOUND };
        for _ in 0..5 {
            drive.push_s = 1.0;
            let events = drive.events(1, half);
            let named: Vec<_> = events.iter().map(|event| (event.cause, event.severity)).collect();
            assert_eq!(named, [(Cause::IncompleteThrow, Severity::Warning)], "{stroke_mm:?}: {events:?}");
            drive.push_s = 0.0;
            assert_eq!(drive.events(1, half), [], "{stroke_mm:?}");
            assert_eq!(summary(&drive.events(12, State::SOUND)), [ended(Cause::IncompleteThrow)], "{stroke_mm:?}");
        }
    }
}

#[test]
fn a_throw_that_is_reversed_midway_is_named_so_and_no_fault_of_a_sensor() {
    let mut drive = drive(83, Some(115.0));
    for rate_hz in [1000.0, 250.0, 100.0, 1000.0] {
        (drive.rate_hz, drive.logger) = (rate_hz, reversed);
        let throw = drive.throw(State::SOUND);
        let events = drive.observe(&throw).events;
        assert_eq!(summary(&events), [raised(Cause::IncompleteThrow)], "{rate_hz} Hz: {:?}", throw.outcome);
        let text = &events[0].text;
        assert!(text.contains("returned to its start") && text.contains("reversed midway"), "{text}");
        assert!(!text.contains("sensor"), "{text}");
        (drive.rate_hz, drive.logger) = (1000.0, |throw| throw);
        assert_eq!(summary(&drive.events(13, State::SOUND)), [ended(Cause::IncompleteThrow)]);
    }
}

#[test]
fn a_logger_with_a_small_range_is_told_so() {
    let mut drive = drive(84, None);
    drive.logger = clipped;
    let events = drive.events(6, State::SOUND);
    assert_eq!(channels(&events), [(Cause::Sensor, Some(SensorChannel::Current))], "{events:?}");
    let text = &events[0].text;
    assert!(text.contains("clipped") && text.contains("the measuring range of the logger"), "{text}");
    assert!(!text.contains("cable"), "{text}");
}

/// A trip stops the motor half-way, before it pushes for long. The next throw closes the points from there.
#[test]
fn a_single_throw_that_ends_half_way_needs_no_configured_stroke() {
    for (seed, voltage) in [(0, Voltage::Published), (1, Voltage::Unknown)] {
        let mut drive = Drive::after(80, 79_700 + seed, voltage);
        let events = drive.events(1, State { stroke: 0.5, ..State::SOUND });
        let [event] = &events[..] else { panic!("{events:#?}") };
        assert_eq!((event.cause, event.severity), (Cause::IncompleteThrow, Severity::Warning), "{}", event.text);
        assert_eq!(drive.monitor.state(), MachineState::Warning);
        let ended: Vec<_> = drive.events(20, State::SOUND).iter().map(|event| (event.cause, event.state)).collect();
        assert_eq!(ended, [(Cause::IncompleteThrow, AlarmState::ClearedUnacknowledged)]);
        assert_eq!(drive.events(1, State { position_gain: 0.7, ..State::SOUND }), [], "the throw is as long as usual");
    }
}
