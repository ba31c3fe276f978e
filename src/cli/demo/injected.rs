//! The injected faults of the demo.

use crate::simulate::Part;

/// An injected fault; a step if it has no ramp.
#[derive(Debug, Clone, Copy)]
pub(super) struct Injected {
    pub(super) part: Part,
    pub(super) size_pct: f64,
    pub(super) from_throw: u64,
    pub(super) ramp_throws: Option<u64>,
}

/// One machine for each cause, and a healthy one.
pub(super) const MACHINES: [Option<Injected>; 5] = [
    Some(Injected { part: Part::Kt, size_pct: -20.0, from_throw: 120, ramp_throws: None }),
    Some(Injected { part: Part::Friction, size_pct: 45.0, from_throw: 110, ramp_throws: Some(40) }),
    Some(Injected { part: Part::Stiffness, size_pct: 30.0, from_throw: 130, ramp_throws: None }),
    Some(Injected { part: Part::Inertia, size_pct: 20.0, from_throw: 115, ramp_throws: Some(30) }),
    None,
];
