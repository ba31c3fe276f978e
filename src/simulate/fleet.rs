//! A simulated fleet: differences between machines, and weather and wear from throw to throw. The same seed gives the
//! same throws, and the throws of a machine do not depend on the size of the fleet.

use std::f64::consts::{PI, TAU};

use jiff::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use serde::{Deserialize, Serialize};

use crate::throw::{
    Direction, OutOfRange,
    Range::{Above, If, Within},
    Throw, ThrowRef, settings,
};

use super::fault::{Condition, Fault, Part, Shape};
use super::machine::Parameters;
use super::motion::{Conditions, TEMPERATURES_C};
use super::sensors::{Sensors, Stuck, normal};

settings! {
    /// Settings of a simulated fleet.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct FleetSettings {
        /// Number of machines.
        pub machines: usize = 5, Within(1.0, 10_000.0, "machines");
        /// Nominal parameters of the machines, from which each machine differs by the spread.
        pub machine: Parameters = Parameters::default();
        /// Sensors and loggers of the machines.
        pub sensors: Sensors = Sensors::default();
        /// Differences between machines.
        pub spread: Spread = Spread::default();
        /// Differences between the throws of one machine.
        pub scatter: FleetScatter = FleetScatter::default();
        /// Temperature of the machines over their throws.
        pub climate: FleetClimate = FleetClimate::default();
        /// Faults, each of one machine. Several faults of the same machine add up.
        pub faults: Vec<FleetFault> = Vec::new();
        /// Incidents, each in some throws of one machine.
        pub incidents: Vec<Incident> = Vec::new();
    }
}

settings! {
    /// Natural spread between machines of one type: standard deviations \[%\].
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct Spread {
        /// Spread of KT and KV, by magnets and windings.
        pub kt_pct: f64 = 3.0, Within(0.0, 30.0, "%");
        /// Spread of viscous and dry friction.
        pub friction_pct: f64 = 10.0, Within(0.0, 30.0, "%");
        /// Spread of the rails' stiffness.
        pub stiffness_pct: f64 = 5.0, Within(0.0, 30.0, "%");
        /// Spread of the total inertia at the screw.
        pub inertia_pct: f64 = 2.0, Within(0.0, 30.0, "%");
    }
}

settings! {
    /// Natural scatter from throw to throw: standard deviations \[%\] of first-order autoregressive processes.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct FleetScatter {
        /// Scatter of the torque per ampere.
        pub kt_pct: f64 = 0.5, Within(0.0, 30.0, "%");
        /// Scatter of all friction, by moisture, dirt and grease.
        pub friction_pct: f64 = 3.0, Within(0.0, 30.0, "%");
        /// Scatter of the rails' stiffness.
        pub stiffness_pct: f64 = 1.0, Within(0.0, 30.0, "%");
        /// Scatter of the supply voltage.
        pub supply_pct: f64 = 1.0, Within(0.0, 30.0, "%");
        /// Correlation of one throw with the next, 0 to 0.99.
        pub correlation: f64 = 0.5, Within(0.0, 0.99, "");
    }
}

settings! {
    /// Temperature over the throws of a machine.
    #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    pub struct FleetClimate {
        /// Mean temperature \[°C\].
        pub mean_c: f64 = 20.0, Within(-50.0, 60.0, "°C");
        /// Half the difference between day and night \[K\].
        pub daily_swing_k: f64 = 0.0, Within(0.0, 40.0, "K");
        /// Half the difference between summer and winter \[K\].
        pub yearly_swing_k: f64 = 0.0, Within(0.0, 40.0, "K");
        /// Number of throws in a day.
        pub throws_per_day: f64 = 40.0, Above(0.0);
    }
}

impl FleetClimate {
    fn check(&self) -> Result<(), OutOfRange> {
        self.check_ranges()?;
        let swing_k = self.daily_swing_k + self.yearly_swing_k;
        let [coldest_c, hottest_c] = TEMPERATURES_C;
        If(2.0 * swing_k <= hottest_c - coldest_c, "at most 70 K together with yearly_swing_k")
            .check("daily_swing_k", self.daily_swing_k)?;
        Within(coldest_c + swing_k, hottest_c - swing_k, "°C with these swings").check("mean_c", self.mean_c)
    }

    /// Temperature at a throw \[°C\]; throw 0 is on a spring morning, at the mean.
    pub fn at(&self, throw_index: u64) -> f64 {
        let days = throw_index as f64 / self.throws_per_day;
        self.mean_c + self.daily_swing_k * (TAU * days).sin() + self.yearly_swing_k * (TAU * days / 365.25).sin()
    }
}

/// A fault of one machine of a fleet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetFault {
    /// Index of the machine, from 0.
    pub machine: usize,
    /// The fault that develops.
    pub fault: Fault,
}

/// An incident in one or more consecutive throws of one machine.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Incident {
    /// Index of the machine, from 0.
    pub machine: usize,
    /// The incident.
    pub kind: IncidentKind,
    /// The first throw with the incident, counted from 0.
    pub from_throw: u64,
    /// Number of throws with the incident.
    pub throws: u64,
}

/// A disturbance of a throw or of its recording.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum IncidentKind {
    /// An obstacle between rail and stock rail.
    Obstruction {
        /// Distance of the obstruction from the normal position \[mm\].
        at_mm: f64,
    },
    /// A supply voltage that is too low.
    WeakSupply {
        /// Missing part of the voltage \[%\].
        loss_pct: f64,
    },
    /// A sensor that repeats its last value.
    StuckSensor(Stuck),
}

/// A machine of a fleet, with its own random number generator.
#[derive(Debug, Clone)]
pub struct SimulatedMachine {
    parameters: Parameters,
    sensors: Sensors,
    climate: FleetClimate,
    scatter: FleetScatter,
    /// The faults, each with the sum of the steps of its random walk so far.
    faults: Vec<(Fault, f64)>,
    incidents: Vec<Incident>,
    /// Deviations of torque per ampere, friction, stiffness and supply voltage in the next throw \[standard deviations\].
    deviations: [f64; 4],
    throw_index: u64,
    rng: ChaCha12Rng,
}

impl SimulatedMachine {
    /// Simulates the next throw, as its logger publishes it.
    ///
    /// # Errors
    /// When faults or scatter have taken a parameter out of its range.
    pub fn next_throw(&mut self, boot_id: &str, started_at: Timestamp) -> Result<Throw, OutOfRange> {
        let throw_index = self.throw_index;
        let (machine, mut conditions) = self.next_machine()?;
        let direction =
            if throw_index.is_multiple_of(2) { Direction::NormalToReverse } else { Direction::ReverseToNormal };
        let mut sensors = self.sensors.clone();
        for incident in self.incidents.iter().filter(|incident| incident.includes(throw_index)) {
            match incident.kind {
                IncidentKind::Obstruction { at_mm } => conditions.obstruction_mm = Some(at_mm),
                IncidentKind::WeakSupply { loss_pct } => conditions.supply_ratio *= 1.0 - loss_pct / 100.0,
                IncidentKind::StuckSensor(stuck) => sensors.stuck = Some(stuck),
            }
        }
        let motion = machine.simulate(direction, &conditions, sensors.step_s())?;
        Ok(Throw {
            id: ThrowRef { boot_id: boot_id.to_owned(), throw_no: throw_index + 1 },
            started_at,
            direction: Some(direction),
            trace: sensors.record(&motion, direction, &mut self.rng)?.trace,
            temperature_c: Some(conditions.temperature_c),
            supply_v: Some(machine.supply_v * conditions.supply_ratio),
            anti_alias_hz: sensors.anti_alias_hz,
        })
    }

    /// The machine and the conditions of the next throw, with faults and scatter, and without incidents.
    ///
    /// # Errors
    /// When faults or scatter have taken a parameter out of its range.
    pub fn next_machine(&mut self) -> Result<(Parameters, Conditions), OutOfRange> {
        let throw_index = self.throw_index;
        self.throw_index += 1;
        let condition = self.wear(throw_index);
        let [kt, friction, stiffness, supply_ratio] = self.scatter();
        let mut machine = self.parameters.in_condition(&condition)?;
        machine.torque_constant *= kt;
        machine.scale_friction(friction);
        machine.rails.bending_stiffness_n_m2 *= stiffness;
        let supply_phase_rad = self.rng.random::<f64>() * PI;
        let temperature_c = self.climate.at(throw_index);
        Ok((machine, Conditions { temperature_c, supply_ratio, supply_phase_rad, ..Conditions::default() }))
    }

    /// Takes the random numbers of the further throws from another seed.
    pub fn reseed(&mut self, seed: u64) {
        self.rng = generator(seed, self.rng.get_stream());
    }

    /// Condition of the parts in a throw; advances the random walks.
    fn wear(&mut self, throw_index: u64) -> Condition {
        let mut condition = Condition::default();
        for (fault, walk) in &mut self.faults {
            if matches!(fault.shape, Shape::RandomWalk { .. }) && throw_index >= fault.from_throw {
                *walk += normal(&mut self.rng);
            }
            condition.change(fault.part, fault.size_at(throw_index, *walk));
        }
        condition
    }

    /// Factors of torque per ampere, friction, stiffness and supply voltage in the next throw.
    fn scatter(&mut self) -> [f64; 4] {
        let sizes =
            [self.scatter.kt_pct, self.scatter.friction_pct, self.scatter.stiffness_pct, self.scatter.supply_pct];
        let correlation = self.scatter.correlation;
        std::array::from_fn(|at| {
            let deviation = &mut self.deviations[at];
            let factor = (sizes[at] / 100.0 * *deviation).exp();
            *deviation = correlation * *deviation + (1.0 - correlation.powi(2)).sqrt() * normal(&mut self.rng);
            factor
        })
    }
}

impl Incident {
    fn includes(&self, throw_index: u64) -> bool {
        throw_index.checked_sub(self.from_throw).is_some_and(|since| since < self.throws)
    }
}

impl FleetSettings {
    /// The machines of a fleet with these settings. The same seed gives the same machines and the same throws;
    /// the directions of a machine alternate, starting with normal to reverse.
    ///
    /// # Errors
    /// When a setting is out of its range, or a fault or incident names a machine outside the fleet.
    pub fn build(&self, seed: u64) -> Result<Vec<SimulatedMachine>, OutOfRange> {
        self.check()?;
        (0..self.machines).map(|number| self.machine(number, seed)).collect()
    }

    /// Checks that every setting is in its range.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        self.check_ranges()?;
        self.machine.check().map_err(|error| error.within("machine"))?;
        self.sensors.check().map_err(|error| error.within("sensors"))?;
        self.spread.check_ranges().map_err(|error| error.within("spread"))?;
        self.scatter.check_ranges().map_err(|error| error.within("scatter"))?;
        self.climate.check().map_err(|error| error.within("climate"))?;
        for FleetFault { machine, fault } in &self.faults {
            self.check_machine("faults.machine", *machine)?;
            Within(-90.0, 2000.0, "%").check("faults.fault.size_pct", fault.size_pct)?;
        }
        self.incidents.iter().try_for_each(|incident| self.check_incident(incident))
    }

    fn check_incident(&self, incident: &Incident) -> Result<(), OutOfRange> {
        self.check_machine("incidents.machine", incident.machine)?;
        match incident.kind {
            IncidentKind::Obstruction { at_mm } => {
                Within(0.0, self.machine.stroke_mm, "mm").check("incidents.kind.obstruction.at_mm", at_mm)
            }
            IncidentKind::WeakSupply { loss_pct } => {
                Within(0.0, 100.0, "%").check("incidents.kind.weak_supply.loss_pct", loss_pct)
            }
            IncidentKind::StuckSensor(stuck) => {
                stuck.check().map_err(|error| error.within("incidents.kind.stuck_sensor"))
            }
        }
    }

    fn check_machine(&self, name: &'static str, machine: usize) -> Result<(), OutOfRange> {
        If(machine < self.machines, "the number of a machine, counted from 0").check(name, machine as f64)
    }

    /// The machine with this number, which differs from the nominal parameters by the spread.
    fn machine(&self, number: usize, seed: u64) -> Result<SimulatedMachine, OutOfRange> {
        let mut rng = generator(seed, number as u64);
        let mut ratio = |pct: f64| (pct / 100.0 * normal(&mut rng)).exp();
        let (kt, friction) = (ratio(self.spread.kt_pct), ratio(self.spread.friction_pct));
        let (stiffness, inertia) = (ratio(self.spread.stiffness_pct), ratio(self.spread.inertia_pct));
        let mut as_built = Condition::default();
        as_built.change(Part::Inertia, (inertia - 1.0) * 100.0);
        let mut parameters = self.machine.in_condition(&as_built)?;
        parameters.torque_constant *= kt;
        parameters.back_emf_constant *= kt;
        parameters.scale_friction(friction);
        parameters.rails.bending_stiffness_n_m2 *= stiffness;
        let deviations = std::array::from_fn(|_| normal(&mut rng));
        Ok(SimulatedMachine {
            parameters,
            sensors: self.sensors.clone(),
            climate: self.climate,
            scatter: self.scatter,
            faults: self.faults.iter().filter(|on| on.machine == number).map(|on| (on.fault, 0.0)).collect(),
            incidents: self.incidents.iter().filter(|on| on.machine == number).copied().collect(),
            deviations,
            throw_index: 0,
            rng,
        })
    }
}

/// The random number generator of the machine with this number.
fn generator(seed: u64, number: u64) -> ChaCha12Rng {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    rng.set_stream(number);
    rng
}
