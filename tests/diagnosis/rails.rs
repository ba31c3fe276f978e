//! A simulated drive that pulls a rail which bends: three masses with Coulomb friction under each, behind an elastic
//! toe drive. The far masses stick until the rail has bent, so the friction grows along the stroke. It shares no code
//! with the simulator, the estimator and the diagnosis.

use std::f64::consts::TAU;

use jiff::{SignedDuration, Timestamp};
use pointsd::{
    diagnose::{AlarmState, Cause, MachineMonitor, Observation, Settings, Verdict},
    estimate::{self, Identifier},
    throw::{Direction, Throw, ThrowRef, Trace},
};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::fleet::{assert_nine_of_ten, in_parallel, normal, sizes_held};

const STEP_S: f64 = 4e-5;
const INTERVAL_S: f64 = 1e-3;
const VOLTS: f64 = 110.0;
/// Time constant of the armature \[s\].
const ARMATURE_S: f64 = 0.003;

/// A type of machine.
#[derive(Debug, Clone, Copy)]
struct Make {
    stall_a: f64,
    lead_mm: f64,
    stroke_mm: f64,
    /// Duration of a throw \[s\].
    duration_s: f64,
    /// Running current as part of the stall current.
    load: f64,
    /// Travel of the toe after which the middle mass moves \[mm\].
    bends_mm: f64,
    /// Distance by which the friction of the slide chairs winds up the toe drive \[mm\].
    wound_mm: f64,
}

const MAKES: [Make; 3] = [
    Make { stall_a: 14.0, lead_mm: 10.0, stroke_mm: 115.0, duration_s: 4.5, load: 0.18, bends_mm: 6.0, wound_mm: 0.02 },
    Make { stall_a: 14.0, lead_mm: 8.0, stroke_mm: 100.0, duration_s: 3.5, load: 0.2, bends_mm: 10.0, wound_mm: 0.5 },
    Make { stall_a: 22.0, lead_mm: 15.0, stroke_mm: 140.0, duration_s: 5.0, load: 0.16, bends_mm: 4.0, wound_mm: 0.8 },
];

/// Factors on the torque of the motor, and on the whole friction; the slide chairs cause the change of the friction.
#[derive(Debug, Clone, Copy)]
struct State {
    torque: f64,
    friction: f64,
}

const SOUND: State = State { torque: 1.0, friction: 1.0 };

struct Machine {
    make: Make,
    rng: ChaCha8Rng,
    /// Scatter of torque, friction and spring from throw to throw, in standard deviations.
    scatter: [f64; 3],
    identifier: Identifier,
    monitor: MachineMonitor,
    throws: u64,
}

impl Machine {
    /// Gives throws to the monitor; returns the parts that had an alarm.
    fn named(&mut self, states: impl IntoIterator<Item = State>) -> Vec<Cause> {
        let mut named = Vec::new();
        for state in states {
            let events = self.feed(state).events;
            let raised = events.iter().filter(|event| event.state == AlarmState::ActiveUnacknowledged);
            named.extend(raised.map(|event| event.cause).filter(|cause| Cause::PHYSICAL.contains(cause)));
        }
        named.sort_unstable();
        named.dedup();
        named
    }

    /// Gives one throw to the monitor.
    fn feed(&mut self, state: State) -> Verdict {
        let throw = self.throw(state);
        let settings = estimate::Settings { lead_mm: self.make.lead_mm, ..estimate::Settings::default() };
        let found = self.identifier.identify(&throw, &settings);
        self.monitor.observe(&Observation::of(&throw, &found), &Settings::default())
    }

    fn throw(&mut self, state: State) -> Throw {
        for value in &mut self.scatter {
            *value = 0.5 * *value + 0.75_f64.sqrt() * normal(&mut self.rng);
        }
        let direction = Direction::BOTH[usize::from(self.throws % 2 == 1)];
        self.throws += 1;
        let (current, way) = self.movement(state, direction);
        let phase = self.rng.random::<f64>() * INTERVAL_S;
        let (mut recorded_a, mut recorded_mm, mut at) = (Vec::new(), Vec::new(), -0.2 + phase);
        while at < current.len() as f64 * STEP_S {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index within the throw")]
            let k = (at.max(0.0) / STEP_S) as usize;
            let mm = if direction == Direction::NormalToReverse { way[k] } else { self.make.stroke_mm - way[k] };
            recorded_a.push(current[k] + 0.02 * normal(&mut self.rng));
            recorded_mm.push(mm + 0.02 * normal(&mut self.rng));
            at += INTERVAL_S;
        }
        Throw {
            id: ThrowRef { boot_id: "a".to_owned(), throw_no: self.throws },
            started_at: Timestamp::UNIX_EPOCH + SignedDuration::from_mins(72 * self.throws.cast_signed()),
            direction: Some(direction),
            ..Throw::recorded(Trace::new(INTERVAL_S.recip(), recorded_a, recorded_mm).unwrap())
        }
    }

    /// Current \[A\] and way of the toe \[mm\] from the start of the motor on.
    fn movement(&self, state: State, direction: Direction) -> (Vec<f64>, Vec<f64>) {
        let Make { stall_a, lead_mm, stroke_mm, duration_s, load, bends_mm, wound_mm } = self.make;
        let mm = lead_mm / TAU;
        let (travel, ohms) = (stroke_mm / mm, VOLTS / stall_a);
        let speed = travel / duration_s;
        let constant = VOLTS * (1.0 - load) / speed;
        let stall = constant * stall_a;
        // A third of the load is viscous, a half dry, and a sixth a spring.
        let sds: [f64; 3] = [0.005, 0.03, 0.01];
        let scatter: [f64; 3] = std::array::from_fn(|at| (sds[at] * self.scatter[at]).exp());
        let viscous = load * stall / 3.0 / speed * scatter[1];
        let dry = 0.45 * load * stall * scatter[1];
        let chairs = load * stall * (0.05 + 0.83 * (state.friction - 1.0)) * scatter[1];
        let spring = load * stall / 3.0 / travel * scatter[2];
        let unstressed = if direction == Direction::NormalToReverse { 0.0 } else { travel };
        let inertia = 0.04 * constant * constant / ohms;
        let masses = [0.015, 0.009, 0.006].map(|part| part * inertia);
        let friction = [0.45, 0.35, 0.2].map(|part| part * chairs);
        // The rail bends and the drive winds up by these distances under four tenths of the stall torque.
        let rail = [0.35 * 0.7, 0.2 * 0.35 / 2.0].map(|part| 0.15 * part * stall / (bends_mm / mm));
        let toe = 0.15 * stall / (wound_mm / mm);
        let damping = 0.6 * (toe * masses[0]).sqrt();
        let (mut amperes, mut drive_speed, mut drive, mut on, mut rest) = (0.0_f64, 0.0_f64, 0.0, true, 0);
        let ([mut speeds, mut ways], mut current, mut way) = ([[0.0_f64; 3]; 2], Vec::new(), Vec::new());
        while rest < 6000 {
            current.push(amperes);
            way.push(ways[0] * mm);
            if on {
                amperes += STEP_S / (ARMATURE_S * ohms) * (VOLTS - ohms * amperes - constant * drive_speed);
            } else {
                (amperes, rest) = (amperes * (1.0 - STEP_S / 1e-3), rest + 1);
            }
            let push = toe * (drive - ways[0]) + damping * (drive_speed - speeds[0]);
            let torque = constant * state.torque * scatter[0] * amperes;
            drive_speed += STEP_S / inertia * (torque - viscous * drive_speed - push);
            drive_speed -= (STEP_S / inertia * dry).min(drive_speed.abs()).copysign(drive_speed);
            drive += STEP_S * drive_speed;
            let links = [(0.7, rail[0], 1), (0.35, rail[1], 2)].map(|(part, stiffness, at)| {
                let damping = 0.4 * (stiffness * masses[at]).sqrt();
                stiffness * (part * ways[0] - ways[at]) + damping * (part * speeds[0] - speeds[at])
            });
            let own = push - spring * (ways[0] - unstressed) - 0.7 * links[0] - 0.35 * links[1];
            for (at, force) in [own, links[0], links[1]].into_iter().enumerate() {
                speeds[at] += STEP_S / masses[at] * force;
                // Coulomb's law: the friction stops the mass, and holds it.
                let lost = STEP_S / masses[at] * friction[at];
                speeds[at] -= lost.min(speeds[at].abs()).copysign(speeds[at]);
                ways[at] += STEP_S * speeds[at];
            }
            on &= ways[0] < 0.997 * travel;
            if !on {
                (drive_speed, speeds) = (0.99 * drive_speed, speeds.map(|speed| 0.99 * speed));
            }
        }
        (current, way)
    }
}

/// The parts named in each of three lives of each make, after a step to `state`.
fn lives(state: State) -> Vec<Vec<Cause>> {
    lives_of(&[state; 48])
}

/// The parts named in each of three lives of each make, in throws with these states after a sound baseline.
fn lives_of(states: &[State]) -> Vec<Vec<Cause>> {
    lives_with(|make| make, states)
}

/// Like [`lives_of`], for changed makes.
fn lives_with(change: fn(Make) -> Make, states: &[State]) -> Vec<Vec<Cause>> {
    in_parallel(9, |seed| machine(seed, change).named(states.iter().copied()))
}

/// A machine after a sound baseline.
fn machine(seed: u64, change: fn(Make) -> Make) -> Machine {
    let mut rng = ChaCha8Rng::seed_from_u64(8_300 + seed);
    let scatter = [(); 3].map(|()| normal(&mut rng));
    let make = change(MAKES[usize::try_from(seed % 3).unwrap()]);
    let (identifier, monitor) = (Identifier::default(), MachineMonitor::new("21B"));
    let mut machine = Machine { make, rng, scatter, identifier, monitor, throws: 0 };
    assert_eq!(machine.named([SOUND; 110]), [], "{make:?}");
    machine
}

/// Friction that grows along the stroke looks like a stiffer spring, and the changed ratios like a weaker motor. But
/// the motor starts as before.
#[test]
fn dry_slide_chairs_of_a_rail_that_bends_are_friction() {
    for friction in [1.4, 1.8, 2.5] {
        let named = lives(State { friction, ..SOUND });
        assert!(named.iter().all(|named| *named == [Cause::Friction]), "{friction}: {named:?}");
    }
}

/// Friction that bends the rails over a quarter of the stroke looks like a stiffer spring beside it.
#[test]
fn very_dry_slide_chairs_are_friction_without_a_stiffer_spring() {
    let named = lives_with(|make| Make { bends_mm: 25.0, ..make }, &[State { friction: 3.0, ..SOUND }; 48]);
    assert!(named.iter().all(|named| *named == [Cause::Friction]), "{named:?}");
}

/// Dry chairs wind up a soft toe drive. The toe then starts late, and the start takes part of the torque, as if the
/// motor had lost it.
#[test]
fn dry_slide_chairs_behind_a_soft_drive_are_friction() {
    for friction in [2.0, 3.0] {
        let states = [State { friction, ..SOUND }; 48];
        let named = lives_with(|make| Make { wound_mm: 4.0, ..make }, &states);
        assert!(named.iter().all(|named| *named == [Cause::Friction]), "{friction}: {named:?}");
    }
}

/// While the friction rises, the last throws differ from those of the window as if the motor had begun to lose torque.
#[test]
fn slide_chairs_that_become_dry_slowly_are_friction() {
    let rising = (1..=120).map(|throw| State { friction: 1.0 + 0.8 * (f64::from(throw) / 60.0).min(1.0), ..SOUND });
    let named = lives_of(&rising.collect::<Vec<_>>());
    assert!(named.iter().all(|named| *named == [Cause::Friction]), "{named:?}");
}

#[test]
fn a_lost_torque_of_a_drive_with_a_rail_that_bends_is_named_motor() {
    let named = lives(State { torque: 0.85, ..SOUND });
    assert!(named.iter().all(|named| *named == [Cause::Kt]), "{named:?}");
}

/// Without its torque the motor turns more slowly, at a lower speed dry friction counts for more, and the spring slows
/// the motor more towards the end of the stroke. The size of the lost torque contains none of these.
#[test]
fn the_size_of_a_large_loss_of_torque_is_not_larger_by_the_lower_speed() {
    for torque in [0.6, 0.5] {
        let of_lives = in_parallel(9, |seed| {
            let mut machine = machine(seed, |make| make);
            let lost = State { torque, ..SOUND };
            sizes_held(Cause::Kt, 100.0 * (torque - 1.0), (0..48).map(|_| machine.feed(lost)))
        });
        assert_nine_of_ten(&of_lives.concat(), 250, &format!("torque {torque}"));
    }
}
