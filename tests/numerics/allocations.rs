//! Memory of the estimator: after a first throw of the same length no throw allocates.

use allocation_counter::measure;
use pointsd::{
    estimate::{Identifier, Settings},
    simulate::FleetSettings,
    throw::Throw,
};

#[test]
fn a_warm_estimator_does_not_allocate() {
    let (mut identifier, settings) = (Identifier::default(), Settings::default());
    let machines = FleetSettings { machines: 3, ..FleetSettings::default() };
    let throws =
        machines.build(11).unwrap().into_iter().flat_map(|mut machine| {
            (0..4).map(move |_| machine.next_throw("boot", jiff::Timestamp::UNIX_EPOCH).unwrap())
        });
    let throws: Vec<Throw> = throws.collect();
    let longest = throws.iter().max_by_key(|throw| throw.trace.len()).unwrap();
    let cold = measure(|| assert!(identifier.identify(longest, &settings).outcome.is_ok()));
    assert!(cold.count_total > 0, "the allocations are not counted");
    for throw in &throws {
        let counted = measure(|| drop(identifier.identify(throw, &settings)));
        assert_eq!(counted.count_total, 0, "{counted:?}");
    }
}
