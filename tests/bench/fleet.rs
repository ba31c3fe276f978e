//! Throws of a simulated machine, as loggers send them.

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    simulate::{Fleet, FleetSettings},
    throw::{MachineId, Throw, Trace},
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
            let at = Timestamp::UNIX_EPOCH + SignedDuration::from_mins(10 * throw_no);
            let mut throw = simulated.into_throw("boot", at);
            let [current, position] =
                [throw.trace.current_a(), throw.trace.position_mm()].map(|channel| channel[..samples].to_vec());
            throw.trace = Trace::new(throw.trace.sample_rate_hz(), current, position).expect("a valid trace");
            throw
        })
        .collect()
}

pub(crate) fn machine(number: u32) -> MachineId {
    MachineId::new("north", &number.to_string()).expect("a valid name")
}
