//! The interval of the present size, and the forecast, on machines of whose scatter a part lasts.

use pointsd::diagnose::{AlarmState, Cause, Settings};

use crate::{fleet::shift, outdoors::Outdoors};

/// Size in percent of a fault to `top` percent, by the part of its duration that has passed.
type Shape = fn(f64) -> f64;
const SHAPES: [(&str, Shape, bool); 3] = [
    ("straight", |part| part.min(1.0), true),
    ("accelerating", |part| part.min(1.0).powi(2), true),
    ("stairs", |part| ((3.0 * part).floor().min(2.0) + 1.0) / 3.0, false),
];
const FAULTS: [(Cause, f64); 4] =
    [(Cause::Friction, 60.0), (Cause::Kt, -20.0), (Cause::Stiffness, 40.0), (Cause::Inertia, 20.0)];

#[derive(Debug, Default, Clone, Copy)]
struct Held {
    said: u32,
    held: u32,
    forecasts: u32,
    reached: u32,
}

/// Checks the sizes of raises, escalations and every tenth throw, and the forecasts.
fn life(seed: u64, slow: f64, (cause, top): (Cause, f64), throws: u32, shape: Shape, goes_on: bool, score: &mut Held) {
    let settings = Settings::default();
    let mut machine = Outdoors::new(seed);
    machine.slow = slow;
    if slow > 0.0 {
        machine.phi = 0.2;
    }
    for _ in 0..130 + seed % 200 {
        machine.throw(shift(cause, 0.0));
    }
    let size = |throw: u32| top * shape(f64::from(throw) / f64::from(throws));
    let critical = settings.critical_factor * settings.limit_pct(cause).unwrap();
    let critical_at = (1..=throws).find(|throw| size(*throw).abs() >= critical).unwrap();
    for throw in 1..=throws + 60 {
        let verdict = machine.throw(shift(cause, size(throw)));
        let mut sizes: Vec<(f64, f64)> = Vec::new();
        let active = verdict.events.iter().filter(|e| e.cause == cause && e.state == AlarmState::ActiveUnacknowledged);
        sizes.extend(active.map(|event| (event.change_pct.unwrap(), event.change_pct_sd.unwrap())));
        let now = verdict.drifts.iter().find(|drifting| drifting.cause == cause);
        sizes.extend(now.filter(|_| throw % 10 == 0).map(|now| (now.change_pct, now.change_pct_sd)));
        for (change, sd) in sizes {
            score.said += 1;
            score.held += u32::from((change - size(throw)).abs() <= 1.96 * sd);
        }
        let ahead = now.and_then(|now| now.limit_in_throws).filter(|_| goes_on && throw < critical_at);
        if let Some(ahead) = ahead {
            score.forecasts += 1;
            let left = f64::from(critical_at - throw);
            score.reached += u32::from(ahead.low <= left && left <= ahead.high);
        }
    }
}

#[test]
#[ignore = "prints a table, in some minutes"]
fn table_of_lasting_scatter() {
    let seed: u64 = std::env::var("POINTSD_SEED").map_or(3_000, |text| text.parse().unwrap());
    let lives: u64 = std::env::var("POINTSD_LIVES").map_or(5, |text| text.parse().unwrap());
    for slow in [0.0, 0.4] {
        let mut all = Held::default();
        for (label, shape, goes_on) in SHAPES {
            for throws in [60, 150, 400] {
                let mut score = Held::default();
                for fault in FAULTS {
                    for life_at in 0..lives {
                        life(seed + life_at, slow, fault, throws, shape, goes_on, &mut score);
                    }
                }
                println!("slow {slow}: {label} {throws}: {score:?}");
                all.said += score.said;
                all.held += score.held;
                all.forecasts += score.forecasts;
                all.reached += score.reached;
            }
        }
        let share = |part: u32, of: u32| 100.0 * f64::from(part) / f64::from(of);
        println!(
            "slow {slow}: sizes held {:.1} % of {}, forecasts {:.1} % of {}",
            share(all.held, all.said),
            all.said,
            share(all.reached, all.forecasts),
            all.forecasts
        );
    }
}
