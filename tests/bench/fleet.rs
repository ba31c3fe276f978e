//! Throws of a simulated machine, as loggers send them.

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    simulate::FleetSettings,
    throw::{MachineId, Throw, Trace},
};

/// Throws of one machine with traces of equal length, so that other programs can read them as one array. Shorter traces
/// are lengthened at rest; longer ones are not cut, because a trace that ends with the movement is rejected.
pub(crate) fn throws(count: u64) -> Vec<Throw> {
    let settings = FleetSettings { machines: 1, ..FleetSettings::default() };
    let mut machine = settings.build(5).expect("valid settings").remove(0);
    let at = |throw_no: u64| Timestamp::UNIX_EPOCH + SignedDuration::from_mins(10 * throw_no.cast_signed());
    let mut throws: Vec<_> =
        (1..=count).map(|throw_no| machine.next_throw("boot", at(throw_no)).expect("a valid machine")).collect();
    let samples = throws.iter().map(|throw| throw.trace.len()).max().expect("a throw");
    for Throw { trace, .. } in &mut throws {
        let [current, position] = [trace.current_a(), trace.position_mm()].map(|channel| lengthened(channel, samples));
        *trace = Trace::new(trace.sample_rate_hz(), current, position).expect("a valid trace");
    }
    throws
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
