//! Rain while a baseline is taken, and the first rain long after it, on machines that are healthy and on faulty ones.

use jiff::SignedDuration;
use pointsd::diagnose::{Cause, MachineMonitor};

use crate::outdoors::{Outdoors, Rain};

/// Spells of a life: their first throws and lengths, by the number of the life.
type Spells = fn(u64) -> Vec<(u64, u64)>;

/// Rain in a baseline of a hundred throws.
const ROWS: [(&str, Spells); 12] = [
    ("none", |_| vec![]),
    ("from the first throw, 10 to 30", |life| vec![(0, 10 + life % 21)]),
    ("first 24, the first usable baseline", |_| vec![(0, 24)]),
    ("every second 10 of 40, wet first", |_| vec![(0, 10), (20, 10)]),
    ("every second 10 of 40, dry first", |_| vec![(10, 10), (30, 10)]),
    ("every second 13 of 40, wet first", |_| vec![(0, 13), (26, 13)]),
    ("throws 6 to 24", |life| vec![(6, 14 + life % 9)]),
    ("before 100", |life| vec![(90 - life % 21, 10 + life % 21)]),
    ("around 100", |life| vec![(95 - life % 11, 10 + life % 21)]),
    ("begin and end", |life| vec![(0, 10 + life % 21), (95 - life % 16, 20)]),
    ("all 100", |_| vec![(0, 102)]),
    ("first at 300", |life| vec![(300, 10 + life % 21)]),
];

/// What became of a life.
#[derive(Debug, Default, Clone, Copy)]
struct Outcome {
    /// Throw of the first alarm about a part in 400 healthy throws.
    alarmed: Option<u64>,
    notice: bool,
    /// Throws from the fault to the first alarm with its name, if it came first.
    named: Option<u64>,
    wrong: bool,
}

const HEALTHY: u64 = 400;
const FAULTY: u64 = 40;

fn life(seed: u64, minutes: i64, rain: &Rain, fault_at: u64, fault: f64) -> Outcome {
    let mut machine = Outdoors::new(seed);
    machine.interval = SignedDuration::from_mins(minutes);
    let mut outcome = Outcome::default();
    for throw in 0..fault_at {
        let verdict = machine.throw(machine.of_friction(rain.at(throw)));
        let alarm = verdict.events.iter().find(|event| event.cause.is_drift());
        outcome.alarmed = outcome.alarmed.or(alarm.map(|_| throw));
        outcome.notice |= verdict.caveats.iter().any(|caveat| caveat.contains("wet"));
    }
    for throw in 0..FAULTY {
        let change = rain.at(fault_at + throw) + fault.ln_1p();
        let verdict = machine.throw(machine.of_friction(change));
        let Some(alarm) = verdict.events.iter().find(|event| event.cause.is_drift() && event.event_no == 1) else {
            continue;
        };
        if alarm.cause == Cause::Friction {
            outcome.named = Some(throw);
        } else {
            outcome.wrong = true;
        }
        break;
    }
    outcome
}

fn first_seed() -> u64 {
    std::env::var("POINTSD_SEED").map_or(1_000, |text| text.parse().unwrap())
}

#[test]
#[ignore = "prints a table, in some minutes"]
fn table_of_rain_in_baselines() {
    const LIVES: u64 = 40;
    for (label, spells) in ROWS {
        for loss_pct in [10.0, 20.0, 30.0] {
            let outcomes: Vec<Outcome> = (0..LIVES)
                .map(|at| {
                    let rain = Rain { spells: spells(at), loss_pct, drying: at % 5 };
                    life(first_seed() + at, 70, &rain, HEALTHY, 0.3)
                })
                .collect();
            let count = |of: fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| of(outcome)).count();
            println!(
                "{label:36} -{loss_pct:2} %: alarmed {:2}, noticed {:2}; +30 % named {:2}, wrong {:2}",
                count(|o| o.alarmed.is_some()),
                count(|o| o.notice),
                count(|o| o.named.is_some()),
                count(|o| o.wrong)
            );
        }
    }
}

/// Machines that wander have no wet spells.
#[test]
#[ignore = "prints a table, in some minutes"]
fn table_of_wandering_machines_without_rain() {
    const LIVES: u64 = 100;
    for (phi, times) in [(0.3, 1.0), (0.6, 2.0), (0.8, 1.0), (0.8, 3.0), (0.9, 1.0), (0.9, 3.0)] {
        let (mut noticed, mut alarms, mut named) = (0, 0, 0);
        for at in 0..LIVES {
            let mut machine = Outdoors::new(first_seed() + at);
            (machine.phi, machine.sd) = (phi, times * machine.sd);
            let mut said = false;
            for _ in 0..600 {
                let verdict = machine.throw(machine.of_friction(0.0));
                said |= verdict.caveats.iter().any(|caveat| caveat.contains("wet"));
                alarms += verdict.events.iter().filter(|e| e.cause.is_drift() && e.event_no == 1).count();
            }
            noticed += u32::from(said);
            let mut events = (0..40).flat_map(|_| machine.throw(machine.of_friction(0.6_f64.ln_1p())).events);
            named += u32::from(events.any(|event| event.cause == Cause::Friction));
        }
        println!(
            "correlation {phi}, scatter {times}: rain noticed {noticed}, {alarms} alarms of {LIVES}; +60 % named {named}"
        );
    }
}

/// Faults and wear while the baseline fills are no rain.
#[test]
#[ignore = "prints a table, in some minutes"]
fn table_of_faults_in_first_throws() {
    for (pct, from) in [(25.0, 30), (40.0, 30), (25.0, 40), (40.0, 40), (25.0, 60), (40.0, 60), (70.0, 25)] {
        let (mut named, mut noticed) = (0, 0);
        for at in 0..40 {
            let mut machine = Outdoors::new(first_seed() + at);
            let mut said = false;
            let mut first = None;
            for throw in 0..from + 60 {
                let fault = if throw < from { 0.0 } else { f64::ln_1p(pct / 100.0) };
                let verdict = machine.throw(machine.of_friction(fault));
                said |= verdict.caveats.iter().any(|caveat| caveat.contains("wet"));
                let alarm = verdict.events.iter().find(|event| event.cause.is_drift());
                first = first.or(alarm.map(|event| event.cause));
            }
            named += u32::from(first == Some(Cause::Friction));
            noticed += u32::from(said);
        }
        println!("friction +{pct} % from throw {from} on: named in {named} of 40, rain noticed in {noticed}");
    }
    for per_throw in [0.15, 0.25, 0.5, 1.0] {
        // The friction at which wear from the first throw on is reported or alarmed \[%\].
        let mut noticed = 0;
        let mut at: Vec<f64> = (0..40)
            .map(|life| {
                let mut machine = Outdoors::new(first_seed() + life);
                let up = |throw: u64| per_throw * throw as f64;
                let mut said = false;
                let found = (0..300).find(|throw| {
                    let verdict = machine.throw(machine.of_friction(f64::ln_1p(up(*throw) / 100.0)));
                    said |= verdict.caveats.iter().any(|caveat| caveat.contains("wet"));
                    verdict.events.iter().any(|event| event.cause == Cause::Friction) || verdict.has_trend
                });
                noticed += u32::from(said);
                up(found.unwrap_or(300))
            })
            .collect();
        at.sort_by(f64::total_cmp);
        println!(
            "friction +{per_throw} % a throw: seen at {:.1} % in the median, {:.1} % in 38 of 40; rain {noticed}",
            at[20], at[37]
        );
    }
}

#[test]
fn a_baseline_that_begins_or_ends_in_rain_alarms_nobody_and_hides_no_fault() {
    const LIVES: u64 = 6;
    let (mut alarmed, mut named, mut noticed, mut lives) = (0, 0, 0, 0);
    for (label, spells) in ROWS.into_iter().filter(|(label, _)| *label != "none" && *label != "all 100") {
        for at in 0..LIVES {
            let rain =
                Rain { spells: spells(7 * at), loss_pct: [20.0, 28.0][usize::from(at % 2 == 1)], drying: at % 5 };
            let outcome = life(600_000 + at, 70, &rain, 180, 0.3);
            alarmed += u32::from(outcome.alarmed.is_some());
            named += u32::from(outcome.named.is_some());
            noticed += u32::from(outcome.notice && label.contains("first"));
            lives += 1;
        }
    }
    println!("{alarmed} of {lives} alarmed, +30 % named in {named}; rain said in {noticed}");
    assert!(alarmed <= 4 && named + 5 >= lives && noticed >= 15, "{alarmed} alarmed, {named} named, {noticed} said");
}

/// Rain through the whole baseline: a machine alone says so in its alarm, and five of a site have none.
#[test]
fn the_alarm_after_a_baseline_in_the_wet_says_what_to_do_and_a_site_knows_the_weather() {
    let rain = Rain { spells: vec![(0, 110)], loss_pct: 20.0, drying: 2 };
    let mut said = 0;
    for seed in 0..8 {
        let mut machine = Outdoors::new(610_000 + seed);
        for throw in 0..150 {
            let events = machine.throw(machine.of_friction(rain.at(throw))).events;
            for event in events.iter().filter(|event| event.cause.is_drift()) {
                assert!(event.text.contains("dry rails look the same"), "{}", event.text);
                said += 1;
            }
        }
    }
    assert!(said > 0, "without an alarm the test cannot fail");
    for seed in 0..3 {
        let mut machines: Vec<Outdoors> = (0..5).map(|at| Outdoors::new(620_000 + 10 * seed + at)).collect();
        for throw in 0..200 {
            for at in 0..machines.len() {
                let others = machines.iter().enumerate().filter(|(other, _)| *other != at);
                let common = MachineMonitor::common(others.map(|(_, other)| &other.monitor), machines[at].now());
                let machine = &mut machines[at];
                let events = machine.throw_beside(machine.of_friction(rain.at(throw)), &common).events;
                assert!(events.iter().all(|event| !event.cause.is_drift()), "seed {seed}, machine {at}: {events:?}");
            }
        }
    }
}

/// The first rain long after the baseline, and again: no alarm, and nobody is told to teach it to the machine.
#[test]
fn the_first_rain_after_the_baseline_asks_for_no_new_baseline() {
    let (mut alarms, mut wrong) = (0, 0);
    for seed in 0..20 {
        let mut machine = Outdoors::new(630_000 + seed);
        let rain = Rain { spells: vec![(200, 15), (300, 15), (400, 30)], loss_pct: 20.0, drying: seed % 5 };
        for throw in 0..480 {
            for event in machine.throw(machine.of_friction(rain.at(throw))).events {
                alarms += u32::from(event.event_no == 1);
                wrong += u32::from(event.text.contains("rebaseline"));
            }
        }
    }
    println!("{alarms} alarms in 20 lives with rain, {wrong} with the advice to take a new baseline");
    assert!(alarms <= 1 && wrong == 0, "{alarms} alarms, {wrong} with the advice");
}
