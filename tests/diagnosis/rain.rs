//! Rain while a baseline is taken, and the first rain long after it, on machines that are healthy and on faulty ones.

use jiff::SignedDuration;
use pointsd::diagnose::Cause;

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
        if std::env::var("SAY").is_ok() {
            for event in &verdict.events {
                println!("      seed {seed} throw {throw}: {} {}", event.state.as_str(), event.text);
            }
        }
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
    let only = std::env::var("ROW").unwrap_or_default();
    for (label, spells) in ROWS.into_iter().filter(|(label, _)| label.contains(&only)) {
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
        println!("correlation {phi}, scatter {times}: rain noticed {noticed}, {alarms} alarms of {LIVES}; +60 % named {named}");
    }
}
