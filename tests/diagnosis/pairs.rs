//! Two faults of one drive, at the same time or one after the other.

use pointsd::diagnose::{AlarmEvent, AlarmState, Cause};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::causes,
};

/// Throws after the second fault.
const AFTER: u32 = 160;

/// A fault: its cause, and the state of a machine with a share of it, 0 to 1.
#[derive(Clone, Copy)]
struct Fault {
    cause: Cause,
    state: fn(State, f64) -> State,
}

/// The torque alone, as with worn brushes.
const TORQUE: Fault = Fault { cause: Cause::Kt, state: |state, share| State { torque: 1.0 - 0.15 * share, ..state } };
/// Weak magnets change torque and back-EMF.
const MAGNETS: Fault = Fault {
    cause: Cause::Kt,
    state: |state, share| State { torque: 1.0 - 0.15 * share, back_emf: 1.0 - 0.15 * share, ..state },
};
const FRICTION: Fault =
    Fault { cause: Cause::Friction, state: |state, share| State { friction: 1.0 + 0.4 * share, ..state } };
const STIFFNESS: Fault =
    Fault { cause: Cause::Stiffness, state: |state, share| State { stiffness: 1.0 + 0.25 * share, ..state } };

/// Numbers of lives.
#[derive(Debug, Default)]
struct Judgement {
    lives: u32,
    /// At the end an active alarm names the first fault, as its cause or in its text.
    first: u32,
    /// At the end an active alarm names the second fault.
    second: u32,
    /// A text says that no cause explains the change, or that the sensors must be checked first.
    lost: u32,
    /// The first fault was named, and its alarm ended although the fault exists.
    dropped: u32,
    /// A healthy part has an alarm at the end.
    wrong: u32,
}

impl Judgement {
    fn add(&mut self, other: &Self) {
        self.lives += other.lives;
        self.first += other.first;
        self.second += other.second;
        self.lost += other.lost;
        self.dropped += other.dropped;
        self.wrong += other.wrong;
    }
}

/// A life in which the second fault begins `gap` throws after the first, and each fault grows over `ramp` throws.
fn live(seed: u64, [first, second]: [Fault; 2], gap: u32, ramp: u32) -> (Vec<AlarmEvent>, Drive) {
    let mut drive = Drive::after(120, seed, Voltage::alternating(seed));
    let share = |since: u32| if ramp == 0 { 1.0 } else { (f64::from(since + 1) / f64::from(ramp)).min(1.0) };
    let mut events = Vec::new();
    for throw in 0..gap + ramp + AFTER {
        let state = (first.state)(State::SOUND, share(throw));
        let state = if throw < gap { state } else { (second.state)(state, share(throw - gap)) };
        events.extend(drive.feed(state).events);
    }
    (events, drive)
}

fn judge(seeds: std::ops::Range<u64>, faults: [Fault; 2], gap: u32, ramp: u32) -> Judgement {
    let mut judgement = Judgement::default();
    for seed in seeds {
        let (events, drive) = live(seed, faults, gap, ramp);
        let is_active = |event: &&AlarmEvent| event.state.is_active();
        let open = drive.monitor.open_alarms();
        let says = |cause: Cause| {
            let is_named = |event: &AlarmEvent| {
                event.text.split("; runner-up").next().is_some_and(|text| text.contains(&cause.to_string()))
            };
            open.iter().copied().filter(is_active).any(|event| event.cause == cause || is_named(event))
        };
        let [first, second] = faults.map(|fault| fault.cause);
        let is_wrong =
            |event: &AlarmEvent| Cause::PHYSICAL.contains(&event.cause) && ![first, second].contains(&event.cause);
        let is_lost =
            |event: &AlarmEvent| event.text.contains("no cause explains") || event.text.contains("sensors first");
        judgement.lives += 1;
        judgement.first += u32::from(says(first));
        judgement.second += u32::from(says(second));
        judgement.lost += u32::from(events.iter().any(is_lost));
        judgement.dropped += u32::from(events.iter().any(|event| event.cause == first && !is_active(&event)));
        judgement.wrong += u32::from(open.iter().copied().filter(is_active).any(is_wrong));
    }
    judgement
}

/// Judges forty lives of a pair in both orders, half of them with a published voltage. `is_clear` says for which gap
/// and ramp the data can distinguish the two faults.
fn forty_lives(pair: [Fault; 2], is_clear: fn(gap: u32, ramp: u32) -> bool) {
    let number = |name: &str, usual: u64| std::env::var(name).map_or(usual, |value| value.parse().unwrap());
    let (from, lives) = (number("POINTSD_SEED", 5_000), number("POINTSD_LIVES", 40));
    let mut total = Judgement::default();
    for order in [pair, [pair[1], pair[0]]] {
        for (gap, ramp) in [(0, 0), (30, 0), (200, 0), (50, 100)] {
            let found = judge(from..from + lives, order, gap, ramp);
            println!("{} then {}, gap {gap}, ramp {ramp}: {found:?}", order[0].cause, order[1].cause);
            assert_eq!(found.lost, 0);
            if is_clear(gap, ramp) {
                total.add(&found);
            }
        }
    }
    println!("together: {total:?}");
    let Judgement { lives, first, second, dropped, wrong, .. } = total;
    assert!(50 * dropped <= lives && 50 * wrong <= lives, "{total:?}");
    assert!(100 * first >= 97 * lives && 100 * second >= 97 * lives, "{total:?}");
}

#[test]
#[ignore = "minutes"]
fn a_worn_magnet_and_friction_keep_their_names() {
    forty_lives([MAGNETS, FRICTION], |_, _| true);
}

/// At the same time they look like dry friction at the far end of the rails in one life of a dozen.
#[test]
#[ignore = "minutes"]
fn friction_and_stiffness_one_after_the_other_keep_their_names() {
    forty_lives([FRICTION, STIFFNESS], |gap, _| gap > 0);
}

#[test]
#[ignore = "minutes"]
fn a_worn_magnet_and_stiffness_keep_their_names() {
    forty_lives([MAGNETS, STIFFNESS], |_, _| true);
}

/// At the same time they look like dry friction.
#[test]
#[ignore = "minutes"]
fn a_lost_torque_and_friction_one_after_the_other_keep_their_names() {
    forty_lives([TORQUE, FRICTION], |gap, ramp| gap > 0 && ramp == 0);
}

/// Dry friction at the far end of the rails looks like a stiffer spring, but it has risen already.
#[test]
fn a_stiffness_that_rises_after_or_before_the_friction_keeps_its_alarm() {
    for (pair, gap) in [([FRICTION, STIFFNESS], 30), ([STIFFNESS, FRICTION], 200)] {
        let found = judge(5_006..5_007, pair, gap, 0);
        let Judgement { first, second, lost, dropped, wrong, .. } = found;
        assert_eq!([first, second, lost, dropped, wrong], [1, 1, 0, 0, 0], "{found:?}");
    }
}

#[test]
fn two_faults_keep_their_names() {
    // After 200 throws, which are ten days, the season may explain the risen friction, but not the change of the motor.
    let pairs =
        [([MAGNETS, FRICTION], 0), ([MAGNETS, FRICTION], 40), ([FRICTION, MAGNETS], 40), ([FRICTION, MAGNETS], 200)];
    for (pair, gap) in pairs {
        let found = judge(5_600..5_602, pair, gap, 0);
        let Judgement { lives, first, second, lost, dropped, wrong } = found;
        assert!(first == lives && second == lives && [lost, dropped, wrong] == [0; 3], "{found:?}");
    }
}

/// The ratios of both faults together are nearly those of a motor that lost a quarter.
#[test]
fn friction_and_stiffness_one_after_the_other_are_no_motor_fault_on_a_machine_of_ratios() {
    let before = State::OF_RATIOS;
    let both = State { friction: 1.4, stiffness: 1.3, ..before };
    let [dry, stiff] = [State { friction: 1.4, ..before }, State { stiffness: 1.3, ..before }];
    for (seed, first) in [(0, dry), (1, dry), (0, stiff), (1, stiff)] {
        let mut drive = Drive::after_in(before, 140, 97_000 + seed, Voltage::Published);
        drive.events(60, first);
        let events = drive.events(100, both);
        let [AlarmEvent { cause, change_pct: Some(pct), change_pct_sd: Some(sd), .. }] = &events[..] else {
            panic!("{first:?}: {events:#?}");
        };
        let (second, size) = if first.friction > 1.0 { (Cause::Stiffness, 30.0) } else { (Cause::Friction, 40.0) };
        assert!(*cause == second && (pct - size).abs() < 2.0 * sd, "{events:#?}");
        let mut open = causes(drive.monitor.open_alarms());
        open.sort_unstable();
        assert_eq!(open, [Cause::Friction, Cause::Stiffness]);
    }
}

/// In the ratios a weak magnet and a stiff rail together look nearly like a weaker magnet. The back-EMF shows how weak
/// the magnet is.
#[test]
fn magnets_and_stiffness_one_after_the_other_keep_their_names_on_a_machine_of_ratios() {
    let before = State::OF_RATIOS;
    let both = State { torque: 0.85, back_emf: 0.85, stiffness: 1.3, ..before };
    let [weak, stiff] = [State { stiffness: 1.0, ..both }, State { torque: 1.0, back_emf: 1.0, ..both }];
    for (seed, first) in [(0, weak), (1, weak), (0, stiff), (1, stiff)] {
        let mut drive = Drive::after_in(before, 140, 98_000 + seed, Voltage::Published);
        drive.events(60, first);
        let events = drive.events(160, both);
        let is_part = |event: &&AlarmEvent| Cause::PHYSICAL.contains(&event.cause);
        let is_ended = |event: &AlarmEvent| event.state == AlarmState::ClearedUnacknowledged;
        assert!(!events.iter().filter(is_part).any(is_ended), "{first:?}: {events:#?}");
        let (second, size) = if first.stiffness > 1.0 { (Cause::Kt, -15.0) } else { (Cause::Stiffness, 30.0) };
        let raised =
            events.iter().find(|event| event.cause == second).unwrap_or_else(|| panic!("{first:?}: {events:#?}"));
        let (pct, sd) = raised.change_pct.zip(raised.change_pct_sd).unwrap();
        assert!((pct - size).abs() < 2.5 * sd, "{raised:?}");
        let open = causes(drive.monitor.open_alarms().into_iter().filter(is_part));
        assert!(open.len() == 2 && open.contains(&Cause::Kt) && open.contains(&Cause::Stiffness), "{open:?}");
    }
}
