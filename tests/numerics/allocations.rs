//! Memory of the estimator: after a first throw of the same length no throw allocates.

use allocation_counter::measure;
use pointsd::{
    estimate::{Identifier, Settings},
    simulate::{Fleet, FleetSettings},
    throw::{Throw, ThrowRef},
};

#[test]
fn a_warm_estimator_does_not_allocate() {
    let (mut identifier, settings) = (Identifier::default(), Settings::default());
    let machines = FleetSettings { machines: 3, ..FleetSettings::default() };
    let throws = Fleet::new(&machines, 11).unwrap().into_machines().into_iter().flat_map(|mut machine| {
        std::iter::repeat_with(move || {
            let simulated = machine.next_throw().unwrap();
            Throw {
                id: ThrowRef { boot_id: "boot".to_owned(), throw_no: 1 },
                started_at: jiff::Timestamp::UNIX_EPOCH,
                direction: Some(simulated.direction),
                trace: simulated.trace,
                temperature_c: Some(simulated.temperature_c),
                supply_v: Some(simulated.supply_v),
                anti_alias_hz: simulated.anti_alias_hz,
            }
        })
        .take(4)
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
