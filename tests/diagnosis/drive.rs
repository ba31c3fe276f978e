//! A simulated drive with faulty sensors: one inertia, viscous and dry friction, a spring and an armature, in steps of
//! 50 us. It shares no code with the simulator, the estimator and the diagnosis.

use std::f64::consts::TAU;

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    diagnose::{AlarmEvent, MachineMonitor, Observation, Parameters, Settings, Verdict},
    estimate::{self, Identifier, Motor},
    throw::{Direction, Throw, ThrowRef, Trace},
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::fleet::normal;

/// Changes the throw that a logger sends.
pub(crate) type Logger = fn(Throw) -> Throw;

const STEP_S: f64 = 5e-5;
const STROKE_MM: f64 = 115.0;
/// Distance before the end of the stroke over which the torque of a lock grows \[mm\].
const LOCK_MM: f64 = 4.0;
const MM_PER_RADIAN: f64 = 10.0 / TAU;
/// Running current of a series-wound motor \[A\]. Its flux is 0.76 of that without saturation, relative to small currents.
const SATURATING_A: f64 = 7.0;

/// Factors on the parameters of the machine and on the gains of its sensors; 1 for the healthy state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    pub(crate) volts: f64,
    pub(crate) torque: f64,
    pub(crate) back_emf: f64,
    pub(crate) friction: f64,
    pub(crate) stiffness: f64,
    pub(crate) inertia: f64,
    pub(crate) ohms: f64,
    pub(crate) current_gain: f64,
    /// Constant error of the current sensor \[A\].
    pub(crate) current_offset_a: f64,
    pub(crate) position_gain: f64,
    /// Shift of the position sensor's zero \[mm\].
    pub(crate) position_offset_mm: f64,
    /// Rate of the logger's clock.
    pub(crate) clock: f64,
    pub(crate) stroke: f64,
    /// Noise of the position sensor \[mm\].
    pub(crate) position_noise_mm: f64,
    /// Release of the brake after the start of the motor \[s\].
    pub(crate) brake_s: f64,
    /// Play between toe and position sensor \[mm\].
    pub(crate) play_mm: f64,
    /// Delay of the position behind the current \[s\].
    pub(crate) late_s: f64,
    /// Torque at the end of the stroke that closes or locks the points, as part of the stall torque. It grows over the
    /// last [`LOCK_MM`].
    pub(crate) lock: f64,
}

impl State {
    pub(crate) const SOUND: Self = Self {
        volts: 1.0,
        torque: 1.0,
        back_emf: 1.0,
        friction: 1.0,
        stiffness: 1.0,
        inertia: 1.0,
        ohms: 1.0,
        current_gain: 1.0,
        current_offset_a: 0.0,
        position_gain: 1.0,
        position_offset_mm: 0.0,
        clock: 1.0,
        stroke: 1.0,
        position_noise_mm: 0.02,
        brake_s: 0.0,
        play_mm: 0.0,
        late_s: 0.0,
        lock: 0.0,
    };

    /// A brake that releases 20 ms late: it hides the scale of the coefficients, so that the throws give only their
    /// ratios.
    pub(crate) const OF_RATIOS: Self = Self { brake_s: 0.02, ..Self::SOUND };
}

/// Whether the logger publishes the supply voltage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Voltage {
    Published,
    Unknown,
}

impl Voltage {
    pub(crate) const BOTH: [Self; 2] = [Self::Published, Self::Unknown];

    /// Published by every second machine.
    pub(crate) fn alternating(seed: u64) -> Self {
        if seed.is_multiple_of(2) { Self::Published } else { Self::Unknown }
    }
}

/// A drive and its monitor.
pub(crate) struct Drive {
    rng: ChaCha8Rng,
    identifier: Identifier,
    pub(crate) monitor: MachineMonitor,
    /// At the screw: torque per ampere, back-EMF per speed, inertia, viscous and dry friction, spring.
    parameters: [f64; 6],
    /// Scatter of torque, friction, spring and voltage from throw to throw, in standard deviations.
    scatter: [f64; 4],
    throws: u64,
    pub(crate) voltage: Voltage,
    pub(crate) has_toe_sensor: bool,
    /// Whether the motor is series-wound, with iron that saturates.
    is_series: bool,
    /// The stroke in the configuration \[mm\].
    pub(crate) stroke_mm: Option<f64>,
    /// Time for which the motor runs on after the arrival of the toe \[s\].
    pub(crate) push_s: f64,
    /// Sampling rate of the logger \[Hz\].
    pub(crate) rate_hz: f64,
    pub(crate) logger: Logger,
}

impl Drive {
    pub(crate) fn new(seed: u64, voltage: Voltage) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut like = |value: f64| value * (0.05 * normal(&mut rng)).exp();
        let parameters = [like(6.4), 6.4, like(0.031), like(0.10), like(1.5), like(0.05)];
        let scatter = [(); 4].map(|()| normal(&mut rng));
        let monitor = MachineMonitor::new("21B");
        Self {
            rng,
            identifier: Identifier::default(),
            monitor,
            parameters,
            scatter,
            throws: 0,
            voltage,
            has_toe_sensor: true,
            is_series: false,
            stroke_mm: None,
            push_s: 0.0,
            rate_hz: 1000.0,
            logger: |throw| throw,
        }
    }

    /// A drive with a series-wound motor, whose running current is a quarter of the stall current and saturates the iron
    /// by half.
    pub(crate) fn series(seed: u64) -> Self {
        let mut drive = Self { is_series: true, ..Self::new(seed, Voltage::Unknown) };
        // Inertia, friction and spring.
        drive.parameters[2..].iter_mut().for_each(|parameter| *parameter *= 8.0);
        drive.monitor.configured(Parameters::of(&drive.settings()), Timestamp::UNIX_EPOCH);
        drive
    }

    fn settings(&self) -> estimate::Settings {
        let motor = if self.is_series { Motor::Series } else { Motor::PermanentMagnet };
        estimate::Settings { stroke_mm: self.stroke_mm, motor, ..estimate::Settings::default() }
    }

    /// A drive with a configured stroke, whose motor runs on for 35 ms after the arrival, after this number of sound
    /// throws without an event.
    #[track_caller]
    pub(crate) fn with_stroke(throws: usize, seed: u64, voltage: Voltage) -> Self {
        let mut drive = Self::new(seed, voltage);
        (drive.stroke_mm, drive.push_s) = (Some(STROKE_MM), 0.035);
        drive.stay_healthy(throws, State::SOUND);
        drive
    }

    /// A drive after this number of sound throws, none of which had an event.
    #[track_caller]
    pub(crate) fn after(throws: usize, seed: u64, voltage: Voltage) -> Self {
        Self::after_in(State::SOUND, throws, seed, voltage)
    }

    /// A drive after this number of throws of `state`, none of which had an event.
    #[track_caller]
    pub(crate) fn after_in(state: State, throws: usize, seed: u64, voltage: Voltage) -> Self {
        let mut drive = Self::new(seed, voltage);
        drive.stay_healthy(throws, state);
        drive
    }

    /// Gives throws of `state` to the monitor; none may have an event.
    #[track_caller]
    pub(crate) fn stay_healthy(&mut self, throws: usize, state: State) {
        assert_eq!(self.events(throws, state), []);
    }

    /// The direction of the next throw.
    pub(crate) fn next(&self) -> Direction {
        Direction::BOTH[usize::from(self.throws % 2 == 1)]
    }

    pub(crate) fn feed(&mut self, state: State) -> Verdict {
        let observation = self.throw(state);
        self.observe(&observation)
    }

    /// Gives a throw to the monitor.
    pub(crate) fn observe(&mut self, throw: &Observation) -> Verdict {
        self.monitor.observe(throw, &Settings::default())
    }

    /// The events of the next throws.
    pub(crate) fn events(&mut self, throws: usize, state: State) -> Vec<AlarmEvent> {
        self.events_with(throws, state, |_| {})
    }

    /// The events of the next throws, each changed before the monitor gets it.
    pub(crate) fn events_with(
        &mut self,
        throws: usize,
        state: State,
        change: impl Fn(&mut Observation),
    ) -> Vec<AlarmEvent> {
        self.events_in(&Direction::BOTH, throws, state, change)
    }

    /// The events of the next throws. Those of these directions have the `state`, and are changed before the monitor gets
    /// them; the others are sound.
    pub(crate) fn events_in(
        &mut self,
        directions: &[Direction],
        throws: usize,
        state: State,
        change: impl Fn(&mut Observation),
    ) -> Vec<AlarmEvent> {
        let next = |_| {
            let is_own = directions.contains(&self.next());
            let mut throw = self.throw(if is_own { state } else { State::SOUND });
            if is_own {
                change(&mut throw);
            }
            self.observe(&throw).events
        };
        (0..throws).flat_map(next).collect()
    }

    /// The next throw.
    pub(crate) fn throw(&mut self, state: State) -> Observation {
        for value in &mut self.scatter {
            *value = 0.5 * *value + 0.75_f64.sqrt() * normal(&mut self.rng);
        }
        let direction = self.next();
        self.throws += 1;
        let (mut trace, volts) = self.record(state, direction);
        if !self.has_toe_sensor {
            let rate_hz = trace.sample_rate_hz();
            let current = trace.current_a().to_vec();
            let nothing = vec![f64::NAN; current.len()];
            trace = Trace::new(rate_hz, current, nothing).unwrap();
        }
        let throw = Throw {
            id: ThrowRef { boot_id: "a".to_owned(), throw_no: self.throws },
            started_at: Timestamp::UNIX_EPOCH + SignedDuration::from_mins(72 * self.throws.cast_signed()),
            direction: Some(direction),
            supply_v: (self.voltage == Voltage::Published).then_some(volts),
            ..Throw::recorded(trace)
        };
        let throw = (self.logger)(throw);
        let found = self.identifier.identify(&throw, &self.settings());
        Observation::of(&throw, &found)
    }

    /// The trace and the supply voltage of a throw.
    fn record(&mut self, state: State, direction: Direction) -> (Trace, f64) {
        let [torque, back_emf, inertia, viscous, dry, spring] = self.parameters;
        let scattered = |at: usize, sd: f64| (sd * self.scatter[at]).exp();
        let torque = torque * state.torque * scattered(0, 0.005);
        let back_emf = back_emf * state.back_emf;
        let friction = state.friction * scattered(1, 0.03);
        let (viscous, dry) = (viscous * friction, dry * friction);
        let spring = spring * state.stiffness * scattered(2, 0.01);
        let volts = 110.0 * state.volts * scattered(3, 0.01);
        let (ohms, inertia) = (4.0 * state.ohms, inertia * state.inertia);
        let travel = STROKE_MM * state.stroke / MM_PER_RADIAN;
        let rest = if direction == Direction::NormalToReverse { 0.0 } else { travel };
        // Flux as a part of that at the running current.
        let is_series = self.is_series;
        let flux = |amperes: f64| if is_series { (amperes / SATURATING_A).tanh() / 1.0_f64.tanh() } else { 1.0 };
        let lock = state.lock * torque * flux(volts / ohms) * volts / ohms;
        let (mut amperes, mut speed, mut angle) = (0.0_f64, 0.0_f64, 0.0_f64);
        let (mut on, mut since_off, mut pushed_s) = (true, 0.0, 0.0);
        let (mut current, mut toe) = (Vec::new(), Vec::new());
        while since_off < 0.2 {
            current.push(amperes);
            toe.push(angle);
            let time = current.len() as f64 * STEP_S;
            if on {
                amperes += STEP_S / 0.02 * (volts - ohms * amperes - back_emf * flux(amperes) * speed);
            } else {
                amperes *= 1.0 - STEP_S / 1e-3;
                since_off += STEP_S;
            }
            let locked = (1.0 + (angle - travel) * MM_PER_RADIAN / LOCK_MM).max(0.0) * lock;
            let drive = torque * flux(amperes) * amperes - viscous * speed - spring * (angle - rest) - locked;
            let has_arrived = angle >= travel;
            let held = has_arrived || time < state.brake_s || (speed == 0.0 && drive <= dry);
            if on && !held {
                speed = (speed + STEP_S / inertia * (drive - dry)).max(0.0);
                angle += STEP_S * speed;
            } else if !on || has_arrived {
                speed = 0.0;
            }
            pushed_s += if has_arrived { STEP_S } else { 0.0 };
            on &= angle < travel || pushed_s < self.push_s;
        }
        let phase = self.rng.random::<f64>() / self.rate_hz;
        let (mut recorded_a, mut recorded_mm) = (Vec::new(), Vec::new());
        let mut at = -0.2 + phase;
        while at < current.len() as f64 * STEP_S {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index within the throw")]
            let [k, seen] = [at, at - state.late_s].map(|at| (at.max(0.0) / STEP_S) as usize);
            let (amperes, way) = (current[k], (toe[seen] * MM_PER_RADIAN - state.play_mm).max(0.0));
            let mm = if rest == 0.0 { way } else { STROKE_MM * state.stroke - way };
            let measured = state.current_gain * direction.sign() * amperes + state.current_offset_a;
            recorded_a.push(measured + 0.02 * normal(&mut self.rng));
            let measured_mm = state.position_gain * mm + state.position_offset_mm;
            recorded_mm.push(measured_mm + state.position_noise_mm * normal(&mut self.rng));
            at += 1.0 / (self.rate_hz * state.clock);
        }
        (Trace::new(self.rate_hz, recorded_a, recorded_mm).unwrap(), volts)
    }
}

/// The throw with changed positions.
pub(crate) fn with_positions(throw: Throw, change: impl Fn(f64) -> f64) -> Throw {
    with_trace(throw, |rate_hz, current, position| (rate_hz, current, position.into_iter().map(change).collect()))
}

/// The throw with another rate, current and position.
pub(crate) fn with_trace(
    throw: Throw,
    change: impl FnOnce(f64, Vec<f64>, Vec<f64>) -> (f64, Vec<f64>, Vec<f64>),
) -> Throw {
    let rate_hz = throw.trace.sample_rate_hz();
    let (current, position) = (throw.trace.current_a().to_vec(), throw.trace.position_mm().to_vec());
    let (rate_hz, current, position) = change(rate_hz, current, position);
    Throw { trace: Trace::new(rate_hz, current, position).unwrap(), ..throw }
}
