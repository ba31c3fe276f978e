//! Memory of a monitor: it bounds the number of machines of a daemon.

use allocation_counter::measure;
use nalgebra::Vector3;
use pointsd::{
    diagnose::{MachineMonitor, Observation, Settings},
    estimate::Features,
};

use crate::fleet::{Machine, Scatter, normal};

/// Throws that fill all histories of a monitor, also the blocks of the history since the baseline; and the largest memory
/// of the monitor then \[bytes\].
const FULL: (u32, u64) = (650, 7_200);
/// Throws of a machine whose two baselines lack a few of their 50 throws, and the largest memory of its monitor \[bytes\].
/// All machines of a new fleet learn at the same time.
const LEARNING: (u32, u64) = (90, 11_000);

/// A throw with every feature and a temperature.
fn throw(machine: &mut Machine) -> Observation {
    let observation = machine.throw(Vector3::zeros());
    let mut near = |centre: f64| Some(centre * (1.0 + 0.004 * normal(&mut machine.rng)));
    let features = Features {
        travel_mm: near(120.0),
        back_emf_v_s_per_rad: near(0.8),
        resistance_ohm: near(4.0),
        duration_s: near(4.3),
        supply_v: near(110.0),
        peak_current_a: near(13.0),
        running_current_a: near(1.2),
        end_rise_a: near(0.2),
        charge_as: near(3.1),
        no_load_speed_rad_per_s: near(17.0),
        ..observation.features
    };
    Observation { features, temperature_c: near(12.0), ..observation }
}

/// Memory of the monitor that `make` returns, with all that it owns \[bytes\].
fn memory(make: impl FnOnce() -> MachineMonitor) -> u64 {
    let mut monitor = None;
    let counted = measure(|| monitor = Some(Box::new(make())));
    assert!(monitor.is_some_and(|monitor| monitor.drifts().is_empty()), "an alarm needs more memory");
    counted.bytes_current.unsigned_abs()
}

/// The memory of the monitor of a machine with this number of throws, before and after a restart \[bytes\].
fn memory_after(throws: u32) -> [u64; 2] {
    let (settings, mut machine) = (Settings::default(), Machine::new(3, Scatter::USUAL));
    let throws: Vec<Observation> = (0..throws).map(|_| throw(&mut machine)).collect();
    let fed = || {
        let mut monitor = MachineMonitor::new("north/21B");
        for throw in &throws {
            monitor.observe(throw, &settings);
        }
        monitor
    };
    let snapshot = serde_json::to_string(&fed()).unwrap();
    let restored = || MachineMonitor::from_snapshot(&snapshot).unwrap();
    let taken = [memory(fed), memory(restored)];
    println!("{taken:?} bytes, {} of them itself; snapshot {}", size_of::<MachineMonitor>(), snapshot.len());
    taken
}

#[test]
fn a_full_and_a_learning_monitor_take_little_memory_before_and_after_a_restart() {
    for (throws, limit) in [FULL, LEARNING] {
        let taken = memory_after(throws);
        assert!(taken.iter().all(|bytes| *bytes <= limit), "after {throws} throws: {taken:?} bytes");
    }
}
