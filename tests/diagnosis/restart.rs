//! A restart after every throw changes no result: the state of the monitor is complete.

use nalgebra::Vector3;
use pointsd::diagnose::{AlarmEvent, Cause, Command, MachineMonitor, Missing, Settings};

use crate::fleet::{Machine, Scatter, shift};

/// A life of 300 throws: baseline, a friction ramp, an acknowledgement, a repair, a motor fault and a gap.
fn life(restart: bool) -> (Vec<AlarmEvent>, MachineMonitor) {
    let settings = Settings::default();
    let mut machine = Machine::new(11, Scatter::USUAL);
    let mut events = Vec::new();
    for throw in 0..300_u32 {
        let fault = match throw {
            110..170 => shift(Cause::Friction, f64::from(throw - 110)),
            220.. => shift(Cause::Kt, -20.0),
            _ => Vector3::zeros(),
        };
        let observation = machine.throw(fault);
        events.extend(machine.observe(&observation).events);
        let now = observation.started_at;
        events.extend(machine.monitor.tick(now, &settings));
        if throw == 150 {
            let ack = Command::Ack { cause: Cause::Friction, by: "A. Fitter".to_owned() };
            events.extend(machine.monitor.command(&ack, now, &settings).unwrap());
        }
        if throw == 230 {
            events.extend(machine.monitor.gap(Missing { throws: 3, ..Missing::default() }, now, &settings));
        }
        if restart {
            let saved = serde_json::to_string(&machine.monitor).unwrap();
            assert!(saved.len() < 24_000, "{} bytes after throw {throw}", saved.len());
            machine.monitor = serde_json::from_str(&saved).unwrap();
        }
    }
    (events, machine.monitor)
}

#[test]
fn a_restart_after_every_throw_gives_the_same_events() {
    let (through, end) = life(false);
    let (restarted, restarted_end) = life(true);
    assert_eq!(through, restarted);
    assert_eq!(end, restarted_end);
    for cause in [Cause::Friction, Cause::Kt, Cause::DataLoss] {
        assert!(through.iter().any(|event| event.cause == cause), "no {cause} event in the life");
    }
}
