//! Each case of the study's Table 1 as a life: after a healthy baseline the six tests raise exactly the alarm of the
//! cause.

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    diagnose::{Cause, MachineMonitor, Observation, Settings},
    estimate::{self, Identifier},
    simulate::{Conditions, Parameters, Sensors},
    throw::{Direction, Throw, ThrowRef},
};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

/// Throws of the baseline in each direction, and throws of each test.
const THROWS: (usize, usize) = (50, 8);

/// A machine and its monitor.
struct Life {
    random: ChaCha8Rng,
    identifier: Identifier,
    monitor: MachineMonitor,
    settings: Settings,
    throws: u64,
    raised: Vec<Cause>,
}

impl Life {
    fn new(settings: Settings) -> Self {
        Self {
            random: ChaCha8Rng::seed_from_u64(17),
            identifier: Identifier::default(),
            monitor: MachineMonitor::new("21B"),
            settings,
            throws: 0,
            raised: Vec::new(),
        }
    }

    fn throw(&mut self, machine: &Parameters) {
        let way = if self.throws.is_multiple_of(2) { Direction::NormalToReverse } else { Direction::ReverseToNormal };
        self.throws += 1;
        let sensors = Sensors::default();
        let motion = machine.simulate(way, &Conditions::default(), sensors.step_s()).unwrap();
        let throw = Throw {
            id: ThrowRef { boot_id: "a".to_owned(), throw_no: self.throws },
            started_at: Timestamp::UNIX_EPOCH + SignedDuration::from_hours(i64::try_from(self.throws).unwrap()),
            direction: Some(way),
            ..Throw::recorded(sensors.record(&motion, way, &mut self.random).unwrap().trace)
        };
        let found = self.identifier.identify(&throw, &estimate::Settings::default());
        let mut observation = Observation { direction_contradicted: None, ..Observation::of(&throw, &found) };
        if let (Ok(found), Some(Ok(estimate))) = (&found.outcome, &mut observation.outcome) {
            estimate.covariance = found.covariance;
        }
        for event in self.monitor.observe(&observation, &self.settings).events {
            if event.state.is_active() && !self.raised.contains(&event.cause) {
                self.raised.push(event.cause);
            }
        }
    }
}

/// Causes of the alarms of a life through tests 1 to 6; `change` sets the value of each test in the machine.
fn raised(settings: Settings, values: [f64; 6], change: fn(&mut Parameters, f64)) -> Vec<Cause> {
    let mut life = Life::new(settings);
    let machine = |value: f64| {
        let mut machine = Parameters::default();
        change(&mut machine, value);
        machine
    };
    for _ in 0..2 * THROWS.0 {
        life.throw(&machine(values[0]));
    }
    assert_eq!(life.raised, [], "the baseline is healthy");
    for value in values {
        for _ in 0..THROWS.1 {
            life.throw(&machine(value));
        }
    }
    // Every cause can make throws slow; the test checks the cause only.
    life.raised.retain(|cause| *cause != Cause::SlowThrow);
    life.raised
}

fn settings() -> Settings {
    Settings { baseline_throws: THROWS.0, ..Settings::default() }
}

#[test]
fn case_1_raises_the_motor_alone() {
    let values = [0.7983, 0.5, 0.6, 0.7, 0.9, 1.0];
    assert_eq!(raised(settings(), values, |machine, kt| machine.torque_constant = kt), [Cause::Kt]);
}

/// The friction of the study changes a1 by 2.5 % at most, below the default limit: the test uses a laboratory limit.
#[test]
fn case_2_raises_friction_alone_at_the_laboratorys_limit_and_nothing_at_the_default() {
    let values = [0.0, 0.001, 0.0025, 0.005, 0.01, 0.02];
    let change = |machine: &mut Parameters, mu: f64| machine.rails.slide_friction = mu;
    let laboratory = Settings { friction_limit_pct: 1.5, ..settings() };
    assert_eq!(raised(laboratory, values, change), [Cause::Friction]);
    assert_eq!(raised(settings(), values, change), []);
}

#[test]
fn case_3_raises_stiffness_alone() {
    let values = [1e-4, 0.1, 0.2, 0.3, 0.4, 0.5];
    assert_eq!(raised(settings(), values, |machine, k| machine.screw_stiffness_nm = k), [Cause::Stiffness]);
}

#[test]
fn case_4_raises_inertia_alone() {
    let values = [0.8e-4, 1e-4, 2e-4, 4e-4, 6e-4, 7.5e-4];
    assert_eq!(raised(settings(), values, |machine, j| machine.load_inertia_kg_m2 = j), [Cause::Inertia]);
}
