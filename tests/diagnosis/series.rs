//! Machines with a series-wound motor.

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    diagnose::{Cause, MachineMonitor, Observation, Settings},
    estimate::{self, Identifier, Motor},
    simulate::{self, FleetSettings, Incident, IncidentKind},
    throw::Throw,
};

use crate::drive::{Drive, State};

/// The causes of the alarms of a series-wound machine that performs `throws`, except those about its duration.
fn causes_of_series(throws: impl Iterator<Item = Throw>) -> Vec<Cause> {
    let settings = estimate::Settings { motor: Motor::Series, ..estimate::Settings::default() };
    let mut identifier = Identifier::default();
    let mut monitor = MachineMonitor::new("21B");
    let mut causes = Vec::new();
    for (throw, at) in throws.zip(1..) {
        let throw = Throw { started_at: Timestamp::UNIX_EPOCH + SignedDuration::from_mins(72 * at), ..throw };
        let found = Observation::of(&throw, &identifier.identify(&throw, &settings));
        causes.extend(monitor.observe(&found, &Settings::default()).events.into_iter().map(|event| event.cause));
    }
    causes.retain(|cause| *cause != Cause::SlowThrow);
    causes
}

/// Voltage, speed and inrush of a series motor change together as those of one with magnets.
#[test]
fn a_lower_supply_voltage_of_a_series_motor_is_named() {
    let weak =
        |machine| Incident { machine, kind: IncidentKind::WeakSupply { loss_pct: 18.0 }, from_throw: 80, throws: 60 };
    let incidents = vec![weak(0), weak(1), weak(2)];
    let machine = simulate::Parameters::series();
    let fleet = FleetSettings { machines: 4, machine, incidents, ..FleetSettings::default() };
    for (at, mut machine) in fleet.build(78).unwrap().into_iter().enumerate() {
        let causes = causes_of_series((0..120).map(|_| machine.next_throw("a", Timestamp::UNIX_EPOCH).unwrap()));
        assert_eq!(causes, if at < 3 { vec![Cause::Supply] } else { vec![] }, "machine {at}");
    }
}

/// The resistance of a series motor scatters by a tenth from throw to throw. Twice the resistance lowers the inrush by a
/// fifth only.
#[test]
fn a_bad_contact_of_a_series_motor_is_named() {
    let machines = |resistance: f64| {
        let mut machine = simulate::Parameters::series();
        machine.resistance_ohm *= resistance;
        let fleet = FleetSettings { machines: 4, machine, ..FleetSettings::default() };
        fleet.build(78).unwrap()
    };
    for (at, (mut sound, mut bad)) in machines(1.0).into_iter().zip(machines(2.0)).enumerate() {
        let bad_from = if at < 3 { 80 } else { usize::MAX };
        // Both machines perform every throw, so that they keep the same weather and scatter.
        let throws = (0..140).map(|throw| {
            let [sound, bad] = [&mut sound, &mut bad].map(|it| it.next_throw("a", Timestamp::UNIX_EPOCH).unwrap());
            if throw < bad_from { sound } else { bad }
        });
        let causes = causes_of_series(throws);
        assert_eq!(causes, if at < 3 { vec![Cause::Supply] } else { vec![] }, "machine {at}");
    }
}

/// More friction draws more current, which saturates the iron. The torque then grows less than in the model, as if the
/// motor had become weaker too.
#[test]
fn friction_of_a_series_motor_that_saturates_is_named() {
    for seed in 1..=4 {
        let mut drive = Drive::series(seed);
        drive.stay_healthy(120, State::SOUND);
        let events = drive.events(60, State { friction: 1.6, ..State::SOUND });
        let named = events.iter().find(|event| event.cause == Cause::Friction).unwrap();
        assert!(named.text.contains("torque that was lost at the same time would look the same"), "{}", named.text);
        let [drift] = drive.monitor.drifts()[..] else { panic!("{seed}: {:?}", drive.monitor.drifts()) };
        assert_eq!(drift.cause, Cause::Friction, "{seed}: {drift:?}");
        assert!((drift.change_pct - 60.0).abs() < 1.96 * drift.change_pct_sd, "{seed}: {drift:?}");
    }
}
