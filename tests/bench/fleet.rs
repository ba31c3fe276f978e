//! Throws of a simulated machine, as loggers send them.

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    simulate::{Fleet, FleetSettings},
    throw::{MachineId, Throw, ThrowRef, Trace},
};

/// Throws of one machine, with all traces as long as the shortest, so that other programs can read them as one array.
pub(crate) fn throws(count: u64) -> Vec<Throw> {
    let settings = FleetSettings { machines: 1, ..FleetSettings::default() };
    let mut machine = Fleet::new(&settings, 5).expect("valid settings").into_machines().remove(0);
    let simulated: Vec<_> = (0..count).map(|_| machine.next_throw().expect("a valid machine")).collect();
    let samples = simulated.iter().map(|throw| throw.trace.len()).min().expect("a throw");
    (1..)
        .zip(simulated)
        .map(|(throw_no, simulated)| {
            let trace = simulated.trace;
            let [current, position] =
                [trace.current_a(), trace.position_mm()].map(|channel| channel[..samples].to_vec());
            Throw {
                id: ThrowRef { boot_id: "boot".to_owned(), throw_no },
                started_at: Timestamp::UNIX_EPOCH + SignedDuration::from_mins(10 * throw_no.cast_signed()),
                direction: Some(simulated.direction),
                trace: Trace::new(trace.sample_rate_hz(), current, position).expect("a valid trace"),
                temperature_c: Some(simulated.temperature_c),
                supply_v: Some(simulated.supply_v),
                anti_alias_hz: simulated.anti_alias_hz,
            }
        })
        .collect()
}

pub(crate) fn machine(number: u32) -> MachineId {
    MachineId::new("north", &number.to_string()).expect("a valid name")
}
