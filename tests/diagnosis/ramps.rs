//! The stated size, direction and time to the critical limit of a drift are true.

use nalgebra::Vector3;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, Settings},
    throw::Direction,
};

use crate::{
    drive::{Drive, State, Voltage},
    fleet::{Machine, Scatter, in_parallel, shift},
};

const LIVES: u64 = 4;
/// Throws for which a machine is followed after its ramp has ended.
const AFTER_THE_END: u32 = 100;

/// Size in percent, at `throw`, of a ramp to `top` percent over `throws` throws: straight with a `power` of 1,
/// accelerating with 2.
fn ramp(top: f64, throws: u32, power: i32, throw: u32) -> f64 {
    top * (f64::from(throw) / f64::from(throws)).min(1.0).powi(power)
}

/// A healthy machine with a complete baseline.
fn known(seed: u64) -> Machine {
    Machine::after(130, seed, Scatter::USUAL)
}

/// Sizes and forecasts of ramps, and how many of them held.
#[derive(Debug, Default)]
struct Followed {
    said: u32,
    held: u32,
    forecasts: u32,
    reached: u32,
    ramps: u32,
    /// Ramps with a forecast.
    forecast: u32,
}

impl Followed {
    /// Adds a life with a drift of `size` percent over `throws` throws.
    fn follow(&mut self, cause: Cause, seed: u64, throws: u32, size: impl Fn(u32) -> f64) {
        let settings = Settings::default();
        let mut machine = known(seed);
        let critical = settings.critical_factor * settings.limit_pct(cause).unwrap();
        let critical_at = (1..=throws).find(|throw| size(*throw).abs() >= critical).unwrap();
        let mut given = false;
        for throw in 1..=throws + AFTER_THE_END {
            let verdict = machine.feed(shift(cause, size(throw)));
            let active = |event: &&AlarmEvent| event.state == AlarmState::ActiveUnacknowledged;
            let raised = verdict.events.iter().filter(active).find(|event| event.cause == cause);
            let raised = raised.map(|event| (event.change_pct.unwrap(), event.change_pct_sd.unwrap()));
            let now = verdict.present.drifts.iter().find(|drifting| drifting.cause == cause);
            let tenth = now.filter(|_| throw % 10 == 0).map(|now| (now.change_pct, now.change_pct_sd));
            for (change, sd) in raised.into_iter().chain(tenth) {
                self.said += 1;
                self.held += u32::from((change - size(throw)).abs() <= 1.96 * sd);
            }
            let ahead = now.and_then(|now| now.limit_in_throws).filter(|_| throw < critical_at);
            if let Some(ahead) = ahead {
                given = true;
                self.forecasts += 1;
                let left = f64::from(critical_at - throw);
                self.reached += u32::from(ahead.low <= left && left <= ahead.high);
            }
        }
        self.ramps += 1;
        self.forecast += u32::from(given);
    }

    /// Checks the shares of the sizes and forecasts that held, and of the ramps with a forecast.
    fn check(&self) {
        let share = |part: u32, of: u32| 100.0 * f64::from(part) / f64::from(of);
        let (held, within) = (share(self.held, self.said), share(self.reached, self.forecasts));
        println!("size {held:.1} % of {}, forecasts {within:.1} % of {}", self.said, self.forecasts);
        assert!((90.0..=98.5).contains(&held), "the interval contained {held:.1} % of {} sizes", self.said);
        assert!((90.0..=99.0).contains(&within), "forecasts held {within:.1} % of {}", self.forecasts);
        assert!(share(self.forecast, self.ramps) >= 80.0, "a forecast in {} of {} ramps", self.forecast, self.ramps);
    }
}

const PARTS: [(Cause, f64); 4] =
    [(Cause::Friction, 60.0), (Cause::Kt, -20.0), (Cause::Stiffness, 40.0), (Cause::Inertia, 20.0)];

#[test]
fn the_size_now_and_the_forecast_hold_on_ramps_of_every_shape() {
    let mut followed = Followed::default();
    for (cause, top) in PARTS {
        for (throws, power, seed) in [60, 150, 400].into_iter().flat_map(|throws| {
            [1, 2].into_iter().flat_map(move |power| (0..LIVES).map(move |seed| (throws, power, seed)))
        }) {
            followed.follow(cause, 50_000 + seed, throws, |throw| ramp(top, throws, power, throw));
        }
    }
    followed.check();
}

/// Wear that feeds itself grows as an exponential: more than half of it in the last quarter of the throws.
#[test]
fn the_size_now_and_the_forecast_hold_for_wear_that_feeds_itself() {
    let mut followed = Followed::default();
    for (cause, top) in PARTS {
        for (throws, seed) in [150, 400].into_iter().flat_map(|throws| (0..LIVES).map(move |seed| (throws, seed))) {
            let growth = |throw: u32| (3.0 * f64::from(throw) / f64::from(throws)).min(3.0).exp_m1() / 3.0_f64.exp_m1();
            followed.follow(cause, 50_100 + seed, throws, |throw| 1.3 * top * growth(throw));
        }
    }
    followed.check();
}

/// Half of the friction of these drives is dry. A viscous model shows dry friction larger when the drive is slower.
#[test]
fn the_size_of_a_friction_of_a_multiple_of_nominal_holds() {
    for (factor, throws) in [(2.5, 1), (2.5, 60), (4.0, 1), (4.0, 60)] {
        let lives = in_parallel(4, |seed| {
            let mut drive = Drive::after(120, 50_300 + seed, Voltage::alternating(seed));
            let (mut said, mut held) = (0_u32, 0_u32);
            for throw in 1..=140 {
                let size = ramp(100.0 * (factor - 1.0), throws, 1, throw);
                let verdict = drive.feed(State { friction: 1.0 + size / 100.0, ..State::SOUND });
                let now = verdict.present.drifts.iter().filter(|now| now.cause == Cause::Friction);
                for now in now {
                    said += 1;
                    held += u32::from((now.change_pct - size).abs() <= 1.96 * now.change_pct_sd);
                }
            }
            (said, held)
        });
        let (said, held) = lives.iter().fold((0, 0), |sum, life| (sum.0 + life.0, sum.1 + life.1));
        println!("friction times {factor} over {throws} throws: {held} of {said}");
        assert!(said > 450, "friction times {factor} over {throws} throws: {said} sizes in 560 throws");
        assert!(
            10 * held >= 9 * said,
            "friction times {factor} over {throws} throws: the interval contained {held} of {said}"
        );
    }
}

#[test]
fn a_direction_is_named_when_both_have_six_throws_and_not_before() {
    let (mut right, mut lives) = (0, 0);
    for (cause, pct) in [(Cause::Friction, 35.0), (Cause::Kt, -12.0), (Cause::Stiffness, 22.0), (Cause::Inertia, 12.0)]
    {
        for (seed, sides) in (0..30).zip([[true, true], [true, false], [false, true]].into_iter().cycle()) {
            let mut machine = known(51_000 + seed);
            for throw in 0..40 {
                let fault = if sides[machine.side()] { shift(cause, pct) } else { Vector3::zeros() };
                let verdict = machine.feed(fault);
                let Some(now) = verdict.present.drifts.iter().find(|now| now.cause == cause) else { continue };
                let truth = match sides {
                    [true, true] => None,
                    [first, _] => Some(Direction::BOTH[usize::from(!first)]),
                };
                if throw < 8 {
                    assert_eq!(now.direction, None, "{cause}, seed {seed}: named after {throw} throws");
                } else if throw >= 14 {
                    lives += 1;
                    right += u32::from(now.direction == truth);
                }
            }
        }
    }
    let share = 100.0 * f64::from(right) / f64::from(lives);
    println!("direction right in {share:.1} % of {lives} throws");
    assert!(share >= 95.0, "right in {share:.1} % of {lives}");
}

#[test]
fn the_size_of_a_step_holds_from_its_first_alarm_on() {
    /// Throws after the first alarm.
    const FOLLOWED: usize = 100;
    let (mut said, mut held) = ([0_u32; FOLLOWED + 1], [0_u32; FOLLOWED + 1]);
    let parts = [
        (Cause::Friction, [30.0, 45.0, 90.0]),
        (Cause::Kt, [-10.0, -15.0, -25.0]),
        (Cause::Stiffness, [20.0, 30.0, 50.0]),
        (Cause::Inertia, [10.0, 15.0, 25.0]),
    ];
    let lives = parts.iter().flat_map(|(cause, sizes)| {
        let sides = [[true, true], [true, false], [false, true]];
        let seeds = 52_000..52_000 + 2 * LIVES;
        sizes.iter().flat_map(move |size| {
            seeds.clone().flat_map(move |seed| sides.map(move |sides| (*cause, *size, seed, sides)))
        })
    });
    for (cause, size, seed, sides) in lives {
        let mut machine = known(seed);
        if seed % 2 == 1 {
            machine.feed(Vector3::zeros());
        }
        let mut alarmed = None;
        for throw in 0..120 {
            let fault = if sides[machine.side()] { shift(cause, size) } else { Vector3::zeros() };
            let verdict = machine.feed(fault);
            let active = |event: &&AlarmEvent| event.cause == cause && event.state == AlarmState::ActiveUnacknowledged;
            // Place 0 is for events, place n for the n-th throw after the first event.
            let event = verdict.events.iter().find(active).map(|event| {
                alarmed.get_or_insert(throw);
                (0, event.change_pct.unwrap(), event.change_pct_sd.unwrap())
            });
            let now =
                verdict.present.drifts.iter().find(|now| now.cause == cause && alarmed.is_some_and(|at| at < throw));
            let now = now.map(|now| (throw - alarmed.unwrap(), now.change_pct, now.change_pct_sd));
            for (place, change, sd) in event.into_iter().chain(now).filter(|(place, ..)| *place <= FOLLOWED) {
                said[place] += 1;
                held[place] += u32::from((change - size).abs() <= 1.96 * sd);
            }
        }
    }
    let shares: Vec<f64> =
        said.iter().zip(&held).map(|(said, held)| 100.0 * f64::from(*held) / f64::from(*said)).collect();
    println!("within the interval, at events and after 1 to {FOLLOWED} throws: {shares:.0?} % of {said:?}");
    assert!(said.iter().all(|said| *said >= 280), "too few alarms: {said:?}");
    assert!(shares.iter().all(|share| *share >= 90.0), "{shares:.1?}");
}

#[test]
fn wear_from_the_first_throw_on_is_reported_before_it_matters_and_later_named() {
    let (mut before, mut named, mut wrong, mut named_at) = (0, 0, 0, Vec::new());
    let lives = 40;
    for seed in 0..lives {
        let mut machine = Machine::in_field(53_000 + seed, Scatter::USUAL);
        let (mut reported, mut alarmed) = (None, None);
        for throw in 1..=400_u32 {
            let size = 0.25 * f64::from(throw);
            let verdict = machine.feed(shift(Cause::Friction, size));
            let said = verdict.present.caveats.iter().any(|caveat| caveat.contains("trend"));
            reported = reported.or((said || !verdict.events.is_empty()).then_some(size));
            wrong += verdict.events.iter().filter(|event| event.cause != Cause::Friction).count();
            let named = verdict.events.iter().any(|event| event.cause == Cause::Friction);
            alarmed = alarmed.or(named.then_some(size));
        }
        before += u32::from(reported.is_some_and(|size| size <= 15.0));
        named += u32::from(alarmed.is_some());
        named_at.extend(alarmed);
    }
    named_at.sort_by(f64::total_cmp);
    println!("reported before 15 %: {before} of {lives}; named: {named}, at {named_at:.0?}; other events {wrong}");
    assert!(before >= 38 && named == 40 && wrong <= 2);
}

#[test]
fn a_healthy_machine_completes_its_baseline_whatever_its_scatter() {
    for (phi, most) in [(0.5, 2), (0.9, 6)] {
        let (mut trends, mut ever, mut events, lives) = (0, 0, 0, 100);
        for seed in 0..lives {
            let mut machine = Machine::in_field(54_000 + seed, Scatter { phi, ..Scatter::USUAL });
            let (mut said, mut says) = (false, false);
            for _ in 0..130 {
                let verdict = machine.feed(Vector3::zeros());
                says = verdict.has_trend;
                said |= says;
                events += verdict.events.iter().filter(|event| event.cause.is_drift()).count();
            }
            ever += u32::from(said);
            trends += u32::from(says);
        }
        println!("phi {phi}: {trends} trends at the end, {ever} ever, of {lives}; {events} events");
        assert!(trends <= 3 && ever <= most && events == 0);
    }
}

/// With strong serial correlation the limits are high, but a large step exceeds them.
#[test]
fn a_machine_whose_throws_wander_shows_a_large_step() {
    const LIVES: u64 = 40;
    for (cause, size) in [(Cause::Kt, -20.0), (Cause::Friction, 150.0), (Cause::Stiffness, 40.0)] {
        let named = (0..LIVES).filter(|seed| {
            let mut machine = Machine::after(130, 54_000 + seed, Scatter { phi: 0.9, ..Scatter::USUAL });
            (0..48).any(|_| {
                let events = machine.feed(shift(cause, size)).events;
                events.iter().any(|event| event.cause == cause && event.state == AlarmState::ActiveUnacknowledged)
            })
        });
        let named = named.count();
        println!("{cause:?} {size} %: named in {named} of {LIVES} lives");
        assert!(named >= 38, "{cause:?} {size} %: {named} of {LIVES}");
    }
}
