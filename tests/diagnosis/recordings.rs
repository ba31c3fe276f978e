//! Sound machines whose loggers change the recordings, or whose recordings show less than before.

use pointsd::{
    diagnose::{AlarmEvent, Cause, MachineState, SensorChannel},
    throw::{Direction, Throw},
};

use crate::drive::{Drive, Logger, State, Voltage, with_positions, with_trace};

/// The machine is sound in all of these throws.
#[test]
fn a_logger_that_changes_its_recordings_accuses_neither_a_part_nor_the_points() {
    let mirrored: Logger = |throw| with_positions(throw, |mm| 115.0 - mm);
    let in_khz: Logger = |throw| with_trace(throw, |rate, current, position| (rate / 1000.0, current, position));
    let stuck: Logger = |throw| {
        with_trace(throw, |rate, current, mut position| {
            let third = position.len() / 3;
            let value = position[third];
            position[third..].fill(value);
            (rate, current, position)
        })
    };
    let cut: Logger = |throw| {
        with_trace(throw, |rate, mut current, mut position| {
            let half = current.len() / 2;
            current.truncate(half);
            position.truncate(half);
            (rate, current, position)
        })
    };
    let without_position: Logger = |throw| with_positions(throw, |_| f64::NAN);
    let position = Some(SensorChannel::Position);
    let cases = [
        ("mirrored", mirrored, Some(position), "unlike before"),
        ("in kHz", in_khz, Some(Some(SensorChannel::Clock)), "sample_rate_hz"),
        ("stuck", stuck, Some(position), "stuck"),
        ("cut off", cut, None, "end_missing"),
        ("without a position", without_position, Some(position), "no longer sends a toe position"),
    ];
    for (name, logger, channel, words) in cases {
        let mut drive = Drive::with_stroke(120, 75, Voltage::Published);
        drive.logger = logger;
        let events = drive.events(24, State::SOUND);
        let is_about_recordings = |event: &AlarmEvent| matches!(event.cause, Cause::Sensor | Cause::NotMonitored);
        assert!(events.iter().all(is_about_recordings), "{name}: {events:#?}");
        assert!(events.iter().any(|event| event.text.contains(words)), "{name}: {events:#?}");
        let named = events.iter().find(|event| event.cause == Cause::Sensor).map(|event| event.channel);
        assert_eq!(named, channel, "{name}: {events:#?}");
        drive.logger = |throw| throw;
        let mended = drive.events(40, State::SOUND);
        assert!(mended.iter().all(is_about_recordings), "{name}: {mended:#?}");
        assert_eq!(drive.monitor.state(), MachineState::Healthy, "{name}: {mended:#?}");
    }
}

/// The same logger for the whole life of a sound machine.
#[test]
fn a_logger_with_imperfect_recordings_has_no_alarm() {
    // Samples of the inrush that were not measured.
    let with_nulls: Logger = |throw| {
        with_trace(throw, |rate, mut current, mut position| {
            for channel in [&mut current, &mut position] {
                channel[208..213].fill(f64::NAN);
            }
            (rate, current, position)
        })
    };
    let late: Logger =
        |throw| with_trace(throw, |rate, current, position| (rate, current[205..].to_vec(), position[205..].to_vec()));
    for (name, logger) in
        [("nulls", with_nulls), ("late", late), ("averages", averaged::<20>), ("slow", averaged::<50>)]
    {
        for seed in 0..2 {
            let mut drive = Drive::new(81 + seed, Voltage::alternating(seed));
            drive.logger = logger;
            let events = drive.events(120, State::SOUND);
            assert_eq!(events, [], "{name}");
            let fault = State { friction: 1.5, ..State::SOUND };
            let events = drive.events(40, fault);
            // The features may show the change first, without a name.
            let is_expected = |event: &AlarmEvent| [Cause::Friction, Cause::Unattributed].contains(&event.cause);
            assert!(events.iter().all(is_expected), "{name}: {events:#?}");
            let active = drive.monitor.open_alarms().into_iter().filter(|alarm| alarm.state.is_active());
            assert_eq!(active.map(|alarm| alarm.cause).collect::<Vec<_>>(), [Cause::Friction], "{name}: {events:#?}");
        }
    }
}

/// The throw of a logger with a converter of 12 bits that sends the mean of the last samples.
fn averaged<const COUNT: usize>(throw: Throw) -> Throw {
    let mean = |values: Vec<f64>, range: f64| -> Vec<f64> {
        let step = range / 4096.0;
        let values: Vec<f64> = values.into_iter().map(|value| (value / step).round() * step).collect();
        let last = |k: usize| &values[(k + 1).saturating_sub(COUNT)..=k];
        (0..values.len()).map(|k| last(k).iter().sum::<f64>() / last(k).len() as f64).collect()
    };
    with_trace(throw, |rate, current, position| (rate, mean(current, 150.0), mean(position, 310.0)))
}

/// The movement shows the direction, so the throws are evaluated as before.
#[test]
fn a_logger_that_swaps_the_names_of_the_directions_accuses_nothing() {
    let mut drive = Drive::new(76, Voltage::Published);
    let swapped: Logger = |throw| {
        let other = |direction: Direction| Direction::BOTH.into_iter().find(|other| *other != direction);
        Throw { direction: throw.direction.and_then(other), ..throw }
    };
    let plain = drive.logger;
    for (logger, throws) in [(plain, 120), (swapped, 1), (plain, 10), (swapped, 60)] {
        drive.logger = logger;
        let events = drive.events(throws, State::SOUND);
        assert_eq!(events, []);
        assert_eq!(drive.monitor.state(), MachineState::Healthy);
    }
    let is_stated = |caveat: &String| caveat.contains("another direction than the position shows");
    assert!(drive.monitor.caveats().iter().any(is_stated), "{:?}", drive.monitor.caveats());
    // A fault is named as before.
    let weak = State { torque: 0.85, back_emf: 0.85, ..State::SOUND };
    let events = drive.events(30, weak);
    assert_eq!(events.first().map(|event| event.cause), Some(Cause::Kt), "{events:?}");
}

#[test]
fn a_machine_that_never_reaches_the_configured_stroke_has_a_caveat() {
    let mut drive = Drive::with_stroke(0, 72, Voltage::Published);
    let short = State { stroke: 0.91, ..State::SOUND };
    let events = drive.events(60, short);
    assert_eq!(events, []);
    let caveats = drive.monitor.caveats();
    assert!(
        matches!(&caveats[..], [one] if one.contains("mm of a stroke of 115.0 mm, without an obstruction")),
        "{caveats:?}"
    );
    assert_eq!(drive.monitor.state(), MachineState::Healthy);
}

/// The coefficients of a machine without a toe sensor come from the current and the published voltage.
#[test]
fn lost_coefficients_of_a_machine_without_a_toe_sensor_are_a_caveat() {
    let mut drive = Drive::new(73, Voltage::Published);
    (drive.stroke_mm, drive.has_toe_sensor) = (Some(115.0), false);
    let events = drive.events(120, State::SOUND);
    assert_eq!((events, drive.monitor.caveats()), (vec![], vec![]));
    // The logger no longer publishes the voltage.
    drive.voltage = Voltage::Unknown;
    for throws in 1..=20 {
        assert_eq!(drive.feed(State::SOUND).events, []);
        let is_said = drive.monitor.caveats().iter().any(|caveat| caveat.contains("give no coefficients"));
        assert_eq!(is_said, throws == 20, "after {throws} throws");
    }
    drive.voltage = Voltage::Published;
    drive.feed(State::SOUND);
    assert_eq!(drive.monitor.caveats(), Vec::<String>::new());
}
