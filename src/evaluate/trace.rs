//! A machine at trace depth: complete simulated throws, identified as the daemon does.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

use super::{
    observation::{observation, started_at},
    scenario::{Growth, Instrument, Noise, Situation},
    timeline::{LifeFault, Timeline},
};
use crate::{
    diagnose::Observation,
    estimate::{Identifier, Settings},
    simulate::{self, FleetFault, FleetSettings, Incident, IncidentKind, Sensors, SimulatedMachine},
    throw::Trace,
};

/// Stiffness of a soft toe drive \[N/m\]; with it, dry friction changes b0 and a0 too.
const SOFT_TOE_N_M: f64 = 5e6;
/// Sampling rate and cut-off of the filter in the rows with a slow logger \[Hz\].
const SLOW_HZ: (f64, f64) = (100.0, 40.0);

/// A simulated machine with its estimator.
#[derive(Debug)]
pub(super) struct TraceMachine {
    /// `None` if the simulator rejects the machine; then no throw has an estimate.
    machine: Option<SimulatedMachine>,
    identifier: Identifier,
    settings: Settings,
    /// Whether the supply voltage is published.
    volts: bool,
    /// The faulty instrument, the factor on its values, and the first throw with the fault; `None` without one.
    faulty: Option<(Instrument, f64, usize)>,
}

impl TraceMachine {
    /// The machine of `life` in a situation.
    pub(super) fn new(mut random: ChaCha8Rng, situation: Situation, noise: Noise, life: &Timeline) -> Self {
        let mut fleet = FleetSettings { machines: 1, sensors: sensors(situation, noise), ..FleetSettings::default() };
        if situation == Situation::SoftToe {
            fleet.machine.drive_stiffness_n_m = SOFT_TOE_N_M;
        }
        fleet.faults = life.faults.iter().filter_map(simulated).map(|fault| FleetFault { machine: 0, fault }).collect();
        let (mut volts, mut faulty) = (true, None);
        if let (Situation::Instrument { which, volts: published }, Some(fault)) = (situation, life.faults.first()) {
            (volts, faulty) = (published, Some((which, 1.0 + fault.size, fault.onset)));
            if which == Instrument::Supply {
                let kind = IncidentKind::WeakSupply { loss_pct: -100.0 * fault.size };
                fleet.incidents = vec![Incident { machine: 0, kind, from_throw: fault.onset as u64, throws: u64::MAX }];
            }
        }
        let settings = Settings { lead_mm: fleet.machine.lead_mm, ..Settings::default() };
        let machine = fleet.build(random.random()).ok().and_then(|mut machines| machines.pop());
        Self { machine, identifier: Identifier::default(), settings, volts, faulty }
    }

    /// The observation of throw `at`; without an estimate if the simulation fails.
    pub(super) fn observe(&mut self, at: usize) -> Observation {
        let simulated = self.machine.as_mut().and_then(|machine| machine.next_throw("evaluate", started_at(at)).ok());
        let Some(mut throw) = simulated else { return observation(at, None, None) };
        throw.trace = self.recorded(at, throw.trace);
        throw.supply_v = throw.supply_v.filter(|_| self.volts);
        let found = self.identifier.identify(&throw, &self.settings);
        Observation::of(&throw, &found)
    }

    /// The trace as the faulty instrument records it.
    fn recorded(&self, at: usize, trace: Trace) -> Trace {
        let Some((which, ratio, _)) = self.faulty.filter(|(.., onset)| at >= *onset) else { return trace };
        let [mut rate_hz, mut current, mut position] = [trace.sample_rate_hz(), 1.0, 1.0];
        match which {
            Instrument::Current => current = ratio,
            Instrument::Position => position = ratio,
            Instrument::Clock => rate_hz /= ratio,
            Instrument::Supply => return trace,
        }
        let times = |values: &[f64], gain: f64| values.iter().map(|value| gain * value).collect();
        Trace::new(rate_hz, times(trace.current_a(), current), times(trace.position_mm(), position)).unwrap_or(trace)
    }
}

fn sensors(situation: Situation, noise: Noise) -> Sensors {
    let mut sensors = Sensors::default();
    sensors.current.noise = match noise {
        Noise::Low => 0.005,
        Noise::Default => 0.02,
        Noise::High => 0.05,
    };
    if situation == Situation::Slow {
        sensors.sample_rate_hz = SLOW_HZ.0;
        sensors.anti_alias_hz = Some(SLOW_HZ.1);
    }
    sensors
}

/// The fault for the simulator; `None` if it is a fault of an instrument.
fn simulated(fault: &LifeFault) -> Option<simulate::Fault> {
    let part = fault.part.as_str().parse().ok()?;
    let shape = match fault.shape {
        Growth::Ramp => simulate::Shape::Ramp { throws: fault.shape.throws() as u64 },
        // The rows at trace depth have steps and ramps only.
        _ => simulate::Shape::Step,
    };
    Some(simulate::Fault { part, shape, size_pct: 100.0 * fault.size, from_throw: fault.onset as u64 })
}
