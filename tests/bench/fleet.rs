//! Throws of a simulated machine, as loggers send them.

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    simulate::{Fleet, FleetSettings},
    throw::{MachineId, Throw, Trace},
};

/// Throws of one machine with traces of equal length, so that other programs can read them as one array. Shorter traces
/// are lengthened at rest; longer ones are not cut, because a trace that ends with the movement is rejected.
pub(crate) fn throws(count: u64) -> Vec<Throw> {
    let settings = FleetSettings { machines: 1, ..FleetSettings::default() };
    let mut machine = Fleet::new(&settings, 5).expect("valid settings").into_machines().remove(0);
    let simulated: Vec<_> = (0..count).map(|_| machine.next_throw().expect("a valid machine")).collect();
    let samples = simulated.iter().map(|throw| throw.trace.len()).max().expect("a throw");
    (1..)
        .zip(simulated)
        .map(|(throw_no, simulated)| {
            let at = Timestamp::UNIX_EPOCH + SignedDuration::from_mins(10 * throw_no);
            let mut throw = simulated.into_throw("boot", at);
            let [current, position] =
                [throw.trace.current_a(), throw.trace.position_mm()].map(|channel| lengthened(channel, samples));
            throw.trace = Trace::new(throw.trace.sample_rate_hz(), current, position).expect("a valid trace");
            throw
        })
        .collect()
}

/// `channel` lengthened to `samples`: its last samples, which are at rest, are repeated.
fn lengthened(channel: &[f64], samples: usize) -> Vec<f64> {
    /// Samples at rest after the movement in every simulated trace.
    const REST: usize = 20;
    let rest = &channel[channel.len() - REST..];
    channel.iter().chain(rest.iter().cycle()).copied().take(samples).collect()
}

pub(crate) fn machine(number: u32) -> MachineId {
    MachineId::new("north", &number.to_string()).expect("a valid name")
}
