//! Temperature, rain and dew: the monitor goes on learning the effect of the temperature, weather is no fault, and the
//! faults that weather can hide are stated.

use std::f64::consts::TAU;

use jiff::SignedDuration;
use nalgebra::Vector3;
use pointsd::{
    diagnose::{AlarmEvent, AlarmState, Cause, MachineMonitor, MachineState, Severity, Verdict},
    throw::Direction,
};

use crate::{
    climate::{Climate, PER_KELVIN},
    fleet::{Machine, Scatter, assert_nine_of_ten, in_parallel, normal, shift, sizes_held},
};

/// A baseline in winter, a change to summer over `over` throws (0: the machine is not used in spring), `held` throws in
/// summer, then the fault. Returns the verdicts after the onset of the fault, and the events before it.
fn summer(seed: u64, over: u64, held: u64, day_k: f64, fault: Vector3<f64>) -> (Vec<Verdict>, Vec<AlarmEvent>) {
    let climate = Climate { season_c: (-10.0, 29.0), change: (100, over), day_k };
    let mut machine = Machine::in_field(seed, Scatter::USUAL);
    let onset = 100 + over + held;
    let (mut before, mut after) = (Vec::new(), Vec::new());
    for throw in 0..onset + 24 {
        let (effect, celsius) = climate.effect(throw);
        let fault = if throw < onset { Vector3::zeros() } else { fault };
        let usual = machine.interval;
        if over == 0 && throw == 101 {
            machine.interval = SignedDuration::from_hours(90 * 24);
        }
        let verdict = machine.feed_at(effect + fault, celsius);
        machine.interval = usual;
        if throw < onset { before.extend(verdict.events) } else { after.push(verdict) }
    }
    (after, before)
}

#[test]
fn a_fault_in_summer_is_named_on_a_baseline_from_winter() {
    const LIVES: u64 = 20;
    for (cause, pct) in [(Cause::Friction, 30.0), (Cause::Kt, -10.0), (Cause::Stiffness, 20.0), (Cause::Inertia, 10.0)]
    {
        let mut named = 0;
        for seed in 0..LIVES {
            let day_k = [1.0, 2.0, 5.0][usize::try_from(seed % 3).unwrap()];
            let (after, before) = summer(40_000 + seed, 600, 60, day_k, shift(cause, pct));
            assert!(before.iter().all(|event| !event.cause.is_drift()), "{cause}, seed {seed}: {before:?}");
            let first = after.iter().flat_map(|verdict| &verdict.events).find(|event| event.cause.is_drift());
            named += usize::from(first.is_some_and(|event| event.cause == cause));
        }
        assert!(named >= 19, "{cause} named in {named} of {LIVES}");
    }
}

/// A baseline in winter, a lasting change of the friction, then summer. Returns the machine, the causes of the drift
/// alarms with the state of each event, and the last verdict.
fn winter_to_summer(seed: u64, pct: f64) -> (Machine, Vec<(Cause, AlarmState)>, Verdict) {
    let climate = Climate { season_c: (-10.0, 29.0), change: (150, 600), day_k: 2.0 };
    let mut machine = Machine::in_field(seed, Scatter::USUAL);
    let (mut events, mut last) = (Vec::new(), Verdict::default());
    for throw in 0..1_100 {
        let (effect, celsius) = climate.effect(throw);
        let fault = if throw < 100 { Vector3::zeros() } else { shift(Cause::Friction, pct) };
        last = machine.feed_at(effect + fault, celsius);
        let drifts = last.events.iter().filter(|event| event.cause.is_drift());
        events.extend(drifts.map(|event| (event.cause, event.state)));
    }
    (machine, events, last)
}

#[test]
fn a_fault_of_winter_lasts_through_the_summer() {
    for seed in 0..10 {
        let (_, events, last) = winter_to_summer(46_000 + seed, 25.0);
        assert_eq!(events, [(Cause::Friction, AlarmState::ActiveUnacknowledged)], "seed {seed}");
        assert_eq!((last.present.state, last.blind), (MachineState::Warning, None), "seed {seed}");
        let now = last.present.drifts[0].change_pct;
        assert!((now - 25.0).abs() < 7.5, "seed {seed}: {now} %");
    }
}

/// Winter and summer within 23 days: the learned effect of the temperature lags behind, so a small drift is suspected
/// before the fault begins.
#[test]
fn a_fault_is_not_learned_as_an_effect_of_the_temperature() {
    const FAULT: u64 = 360;
    let climate = Climate { season_c: (-10.0, 30.0), change: (0, 460), day_k: 4.0 };
    let is_named = |verdict: &Verdict| verdict.present.drifts.iter().any(|drift| drift.cause == Cause::Friction);
    let held = in_parallel(60, |seed| {
        let mut machine = Machine::in_field(48_000 + seed, Scatter::USUAL);
        let mut weather_k = 0.0;
        let mut verdicts = Vec::new();
        for throw in 0..660 {
            weather_k = 0.9 * weather_k + 0.44 * normal(&mut machine.rng);
            let celsius = climate.celsius(throw) + weather_k;
            let fault = if throw < FAULT { Vector3::zeros() } else { shift(Cause::Friction, 40.0) };
            let verdict = machine.feed_at(Vector3::from(PER_KELVIN) * (celsius - 10.0) + fault, celsius);
            if throw >= FAULT {
                verdicts.push(verdict);
            }
        }
        let unnamed = verdicts.iter().skip(24).position(|verdict| !is_named(verdict));
        assert_eq!(unnamed, None, "seed {seed}");
        sizes_held(Cause::Friction, 40.0, verdicts.into_iter())
    });
    assert_nine_of_ten(&held.concat(), 15_000, "friction +40 %");
}

/// Friction rises while the spring comes, on machines whose grease follows an exponential. The rise must not be learned
/// as an effect of the temperature.
#[test]
fn a_fault_that_grows_with_the_season_is_named_and_its_size_holds() {
    /// Throws of the baseline, of the season and of the ramp.
    const BASELINE: u32 = 120;
    const SEASON: u32 = 600;
    const RAMP: u32 = 240;
    const TOP_PCT: f64 = 45.0;
    let lives = in_parallel(40, |seed| {
        let mut machine = Machine::in_field(53_000 + seed, Scatter::USUAL);
        let onset = BASELINE + SEASON / 10 + 9 * u32::try_from(seed).unwrap();
        let (mut weather_k, mut named_at_pct, mut held) = (0.0, None, Vec::new());
        for throw in 0..BASELINE + SEASON + 100 {
            weather_k = 0.98 * weather_k + 0.3 * normal(&mut machine.rng);
            let spring = (f64::from(throw.saturating_sub(BASELINE)) / f64::from(SEASON)).min(1.0);
            let day = (f64::from(throw) / 14.0 * TAU).sin();
            let celsius = -8.0 + 36.0 * spring + [2.0, 5.0][usize::try_from(seed % 2).unwrap()] * day + weather_k;
            let grease = 0.6 + 0.4 * (-0.025 * (celsius - 10.0)).exp();
            let fault_pct = TOP_PCT * (f64::from(throw.saturating_sub(onset)) / f64::from(RAMP)).min(1.0);
            let change = shift(Cause::Friction, 100.0 * (grease - 1.0)) + shift(Cause::Friction, fault_pct);
            let verdict = machine.feed_at(change, celsius);
            let now = verdict.present.drifts.iter().find(|drift| drift.cause == Cause::Friction);
            if fault_pct == 0.0 {
                assert!(now.is_none(), "seed {seed}, throw {throw}: {now:?}");
            } else if let Some(now) = now {
                named_at_pct.get_or_insert(fault_pct);
                held.push((now.change_pct - fault_pct).abs() <= 1.96 * now.change_pct_sd);
            } else {
                assert_eq!(named_at_pct, None, "seed {seed}, throw {throw}: over");
            }
        }
        (named_at_pct, held)
    });
    let (named, held): (Vec<_>, Vec<_>) = lives.into_iter().unzip();
    let early = named.iter().flatten().filter(|pct| **pct <= 1.5 * 15.0).count();
    println!("named in {} of 40, {early} before 1.5 times the limit", named.iter().flatten().count());
    assert!(early >= 32 && named.iter().flatten().count() >= 39, "{named:?}");
    assert_nine_of_ten(&held.concat(), 8_000, "friction that grows with the season");
}

#[test]
fn a_lasting_change_below_its_limit_does_not_end_the_learning_of_the_temperature() {
    let (mut alarmed, mut blind) = (0, 0);
    for seed in 0..7 {
        let (mut machine, events, last) = winter_to_summer(47_000 + seed, 7.5);
        if last.blind.is_some() {
            assert_eq!(last.present.state, MachineState::NotMonitored, "seed {seed}");
            blind += 1;
            continue;
        }
        alarmed += u32::from(!events.is_empty());
        assert_eq!(last.present.state, MachineState::Healthy, "seed {seed}");
        let summer = Vector3::from(PER_KELVIN) * 19.0;
        let fault = summer + shift(Cause::Friction, 40.0);
        let named: Vec<Cause> =
            (0..24).flat_map(|_| machine.feed_at(fault, 29.0).events).map(|event| event.cause).collect();
        assert_eq!(named.first(), Some(&Cause::Friction), "seed {seed}: {named:?}");
    }
    // Half of the limit and much scatter can be above the limit for a while.
    assert!(alarmed <= 1 && blind <= 1, "{alarmed} of 7 lives had an alarm, {blind} stay blind");
}

/// The effect of the temperature on a machine has one slope, whose uncertainty is not one of thousands of throws. A
/// monitor that multiplied it with its limit for chance would be blind on all of these machines, 5 K above their
/// baseline.
#[test]
fn a_warm_week_after_the_baseline_hides_no_fault() {
    const LIVES: u64 = 20;
    let climate = Climate { season_c: (5.0, 10.0), change: (100, 60), day_k: 3.0 };
    let blind = |seed: &u64| {
        let mut machine = Machine::in_field(49_000 + seed, Scatter::USUAL);
        (0..260).any(|throw| {
            let (effect, celsius) = climate.effect(throw);
            let verdict = machine.feed_at(effect, celsius);
            assert!(verdict.events.iter().all(|event| !event.cause.is_drift()), "seed {seed}: {:?}", verdict.events);
            verdict.blind.is_some()
        })
    };
    let blind = (0..LIVES).filter(blind).count();
    assert!(blind <= 1, "{blind} of {LIVES} machines were blind");
}

#[test]
fn faults_hidden_by_an_unknown_effect_of_the_temperature_are_stated() {
    for seed in 0..10 {
        // Thirty throws after a spring without throws the effect of the temperature is not learned yet.
        let (after, before) = summer(41_000 + seed, 0, 30, 2.0, shift(Cause::Friction, 30.0));
        let blind = after[0].blind.unwrap();
        let at = blind.temperature.unwrap();
        assert!(blind.below_pct > 5.0 && (at.temperature_c - at.baseline_c - 39.0).abs() < 6.0, "{blind:?}");
        assert_eq!(after[0].present.state, MachineState::NotMonitored);
        let said = before.iter().find(|event| event.cause == Cause::NotMonitored).unwrap();
        assert!(said.text.contains("cannot be distinguished from the effect of the temperature"), "{}", said.text);
        let (after, _) = summer(41_000 + seed, 600, 200, 2.0, Vector3::zeros());
        assert_eq!(after[23].blind, None);
    }
}

#[test]
fn a_failed_temperature_sensor_hides_nothing() {
    for failed in [-242.0, -273.0, 850.0, 1e6, f64::NAN] {
        let mut machine = Machine::in_field(42_000, Scatter::USUAL);
        for at in 0..140 {
            assert_eq!(machine.feed_at(Vector3::zeros(), 12.0 + f64::from(at % 20)).events, []);
        }
        let events: Vec<_> = (0..20).flat_map(|_| machine.feed_at(shift(Cause::Kt, -15.0), failed).events).collect();
        let drift: Vec<Cause> = events.iter().map(|event| event.cause).filter(|cause| cause.is_drift()).collect();
        assert_eq!(drift.first(), Some(&Cause::Kt), "{failed} °C");
        let sensor = events.iter().find(|event| event.cause == Cause::Sensor);
        assert_eq!(sensor.map(|event| event.severity), Some(Severity::Warning), "{failed} °C");
    }
}

/// One logger sends degrees Fahrenheit from throw 120 on, until it is corrected. The readings of another logger are
/// right after three wrong ones.
#[test]
fn a_temperature_that_jumps_is_not_used_unless_the_first_ones_were_wrong() {
    use pointsd::diagnose::AlarmState::{ActiveUnacknowledged, ClearedUnacknowledged};

    let mut machine = Machine::in_field(43_000, Scatter::USUAL);
    let mut sensor = Vec::new();
    let is_raised = |throw: u64| (throw >= 120).then_some(ActiveUnacknowledged);
    for throw in 0_u64..400 {
        let celsius = 8.0 + 6.0 * (throw as f64 / 20.0 * std::f64::consts::TAU).sin();
        let sent = if (120..300).contains(&throw) { 32.0 + 1.8 * celsius } else { celsius };
        let shift = Vector3::from(PER_KELVIN) * (celsius - 8.0);
        let verdict = machine.feed_at(shift, sent);
        assert!(verdict.events.iter().all(|event| !event.cause.is_drift()), "throw {throw}: {:?}", verdict.events);
        sensor.extend(verdict.events.into_iter().filter(|event| event.cause == Cause::Sensor).map(|event| event.state));
        assert_eq!(sensor.first().copied(), is_raised(throw.saturating_sub(2)), "throw {throw}");
    }
    assert_eq!(sensor, [ActiveUnacknowledged, ClearedUnacknowledged]);

    machine.monitor = MachineMonitor::new("21B");
    let mut last = None;
    for throw in 0..20 {
        let celsius = if throw < 3 { 60.0 } else { 10.0 };
        let verdict = machine.feed_at(Vector3::zeros(), celsius);
        last = verdict.events.last().map(|event| event.state).or(last);
    }
    assert_eq!(last, Some(ClearedUnacknowledged));
}

/// The raised alarms of a machine without a published temperature, each with its throw after the baseline. `shift_at`
/// gives the changes of the logarithms.
fn alarms(seed: u64, throws: u64, shift_at: impl Fn(u64) -> Vector3<f64>) -> Vec<(u64, Cause)> {
    let mut machine = Machine::in_field(seed, Scatter::USUAL);
    machine.stay_healthy(130);
    let mut raised = Vec::new();
    for throw in 0..throws {
        let events = machine.feed(shift_at(throw)).events;
        raised.extend(events.into_iter().filter(|event| event.event_no == 1).map(|event| (throw, event.cause)));
    }
    raised
}

#[test]
fn rain_raises_no_alarm_and_a_lasting_fall_of_friction_does() {
    for seed in 0..20 {
        // A day and a half of rain after each dry week, deeper each time.
        let rain = |throw: u64| {
            let pct = -16.0 - throw as f64 / 85.0;
            if throw % 170 < 30 { shift(Cause::Friction, pct) } else { Vector3::zeros() }
        };
        assert_eq!(alarms(44_000 + seed, 850, rain), [], "seed {seed}");
        // A fall of more than 25 % cannot be rain. This fall is smaller by more than the scatter of a short window.
        let lasting = alarms(44_100 + seed, 120, |_| shift(Cause::Friction, -19.0));
        assert!(matches!(lasting[..], [(60..90, Cause::Friction)]), "seed {seed}: {lasting:?}");
        let large = alarms(44_200 + seed, 20, |_| shift(Cause::Friction, -45.0));
        assert!(matches!(large[..], [(0..12, Cause::Friction)]), "seed {seed}: {large:?}");
    }
}

#[test]
fn a_warm_season_raises_no_alarm_and_a_fault_in_it_does() {
    for seed in 0..20 {
        // 30 K in 100 days.
        let warmth = |throw: u64| Vector3::from(PER_KELVIN) * 30.0 * (throw as f64 / 2_000.0).min(1.0);
        assert_eq!(alarms(45_000 + seed, 2_500, warmth), [], "seed {seed}");
        let fault = |throw: u64| warmth(throw) + if throw < 1_000 { Vector3::zeros() } else { shift(Cause::Kt, -15.0) };
        let found = alarms(45_100 + seed, 1_060, fault);
        assert!(matches!(found[..], [(1_000.., Cause::Kt | Cause::Unattributed), ..]), "seed {seed}: {found:?}");
        // Wear that raises the friction faster than the warmth lowers it.
        let wear = alarms(45_200 + seed, 400, |throw| warmth(throw) + shift(Cause::Friction, 0.15 * throw as f64));
        assert_eq!(wear.first().map(|(_, cause)| *cause), Some(Cause::Friction), "seed {seed}: {wear:?}");
    }
}

#[test]
fn a_cold_season_raises_no_alarm_but_is_stated_and_a_critical_rise_is_one() {
    // 30 K in 100 days, at twenty and at two throws a day.
    for (minutes, throws) in [(72, 2_000), (720, 200)] {
        for seed in 0..10 {
            let mut machine = Machine::in_field(48_000 + seed, Scatter::USUAL);
            machine.interval = SignedDuration::from_mins(minutes);
            machine.events(130, Vector3::zeros());
            let cold = |throw: u64| Vector3::from(PER_KELVIN) * -30.0 * (throw as f64 / throws as f64).min(1.0);
            let mut stated = false;
            for throw in 0..throws + 100 {
                let verdict = machine.feed(cold(throw));
                assert_eq!(verdict.events, [], "seed {seed}, throw {throw}");
                stated |= verdict.present.caveats.iter().any(|caveat| caveat.contains("Publish temperature_c"));
            }
            assert!(stated, "seed {seed}");
            let worn = cold(throws) + shift(Cause::Friction, 35.0);
            let first = machine.events(40, worn).into_iter().find(|event| event.cause.is_drift());
            assert!(first.as_ref().is_some_and(|event| event.cause == Cause::Friction), "seed {seed}: {first:?}");
        }
    }
}

/// Rain while the baseline fills must not increase the scatter of the baseline, so that later wear shows.
#[test]
fn rain_in_the_baseline_does_not_hide_later_wear() {
    // Change of the friction \[%\]; throws in which the rails dry; distance of a second wet spell in throws.
    for (pct, drying, second) in [(-20.0, 0, None), (-12.0, 0, None), (-20.0, 8, None), (-18.0, 3, Some(24))] {
        let (mut named, mut lives) = (0, 0);
        for seed in 0..40_u64 {
            let start = 8 + 2 * (seed % 25);
            let length = if second.is_some() { 10 } else { 15 + seed % 13 };
            let wetness = |throw: u64| {
                let of = |start: u64| match throw.checked_sub(start) {
                    Some(since) if since < length => 1.0,
                    Some(since) => (1.0 - (since - length + 1) as f64 / (f64::from(drying) + 1.0)).max(0.0),
                    None => 0.0,
                };
                of(start) + second.map_or(0.0, |later| of(start + later))
            };
            let mut machine = Machine::in_field(49_000 + seed, Scatter::USUAL);
            for throw in 0..160 {
                let rain = shift(Cause::Friction, pct) * wetness(throw);
                machine.feed(rain);
            }
            let worn = shift(Cause::Friction, 30.0);
            let found = machine.events(24, worn).into_iter().find(|event| event.cause.is_drift());
            named += u32::from(found.is_some_and(|event| event.cause == Cause::Friction));
            lives += 1;
        }
        println!("rain {pct} %, drying {drying}, second {second:?}: friction named in {named} of {lives}");
        assert!(named >= 38, "{named} of {lives}");
    }
}

/// If a baseline begins in rain, dry rails later look like a fault. An alarm soon after the baseline says so, and an
/// alarm long after it does not.
#[test]
fn a_rise_of_friction_soon_after_the_baseline_may_be_dry_rails() {
    // Throws and change of the friction \[%\], one after the other.
    for (life, is_said) in [([(400, 0.0), (24, 40.0)], false), ([(24, -25.0), (56, 0.0)], true)] {
        let mut texts = Vec::new();
        for seed in 0..10 {
            let mut machine = Machine::in_field(51_000 + seed, Scatter::USUAL);
            for (throws, pct) in life {
                let events = machine.events(throws, shift(Cause::Friction, pct));
                let is_raised = |event: &AlarmEvent| event.cause == Cause::Friction && event.event_no == 1;
                texts.extend(events.into_iter().filter(is_raised).map(|event| event.text));
            }
        }
        assert!(texts.len() >= 8, "{texts:?}");
        assert!(texts.iter().all(|text| text.contains("dry rails look the same") == is_said), "{texts:?}");
    }
}

/// Change of the friction in a throw: the first throw of a day is stiff by about `pct` percent, the second by a third
/// of it. Sets the time since the last throw too: a night before the first throw, else half an hour.
fn morning(machine: &mut Machine, throw: u64, per_day: i32, pct: f64) -> Vector3<f64> {
    let usual = SignedDuration::from_mins(30);
    let of_day = throw % u64::from(per_day.unsigned_abs());
    machine.interval = if of_day == 0 { SignedDuration::from_hours(24) - usual * (per_day - 1) } else { usual };
    let part = [1.0, 0.3].get(usize::try_from(of_day).unwrap()).copied().unwrap_or_default();
    shift(Cause::Friction, pct) * part * (1.0 + 0.3 * normal(&mut machine.rng)).max(0.0)
}

/// Rust and dew of a night make the first throws of a day stiff, in the baseline and later.
#[test]
fn a_stiff_first_throw_of_each_day_is_no_fault_and_hides_none() {
    for (per_day, pct) in [(2, 50.0), (6, 30.0), (11, 30.0), (20, 50.0)] {
        for seed in 0..10 {
            let mut machine = Machine::in_field(80_000 + seed, Scatter::USUAL);
            for throw in 0..800 {
                let change = morning(&mut machine, throw, per_day, pct);
                let events = machine.feed(change).events;
                assert_eq!(events, [], "{per_day} a day, {pct} %, seed {seed}");
            }
            let worn = (800..840).flat_map(|throw| {
                let change = morning(&mut machine, throw, per_day, pct) + shift(Cause::Friction, 30.0);
                machine.feed(change).events
            });
            let causes: Vec<Cause> = worn.map(|event| event.cause).collect();
            assert_eq!(causes.first(), Some(&Cause::Friction), "{per_day} a day, {pct} %, seed {seed}");
        }
    }
}

/// Grease whose friction grows exponentially in the cold, on machines that publish the temperature.
#[test]
#[ignore = "prints a table, in some minutes"]
fn table_of_grease() {
    const LIVES: u64 = 20;
    const THROWS: u64 = 14_600;
    for (part, per_kelvin, lag_h) in
        [(0.3, 0.03, 0.0), (0.3, 0.03, 3.0), (0.5, 0.04, 0.0), (0.5, 0.04, 3.0), (0.7, 0.05, 0.0), (0.7, 0.05, 3.0)]
    {
        let (mut raised, mut named) = (std::collections::BTreeMap::<&str, u32>::new(), 0);
        for seed in 0..LIVES {
            let mut machine = Machine::in_field(81_000 + seed, Scatter::USUAL);
            let (mut front, mut inside) = (0.0, 0.0);
            for throw in 0..THROWS + 24 {
                // Twenty throws a day for two years, which begin in another month for each machine.
                let days = throw as f64 / 20.0;
                let [year, day] = [days / 365.0 + seed as f64 / LIVES as f64, days].map(|turns| turns * TAU);
                front = 0.985 * front + 0.86 * normal(&mut machine.rng);
                let celsius = 10.0 - 15.0 * year.cos() + 5.0 * day.sin() + front;
                let keep = if lag_h > 0.0 { (-1.2_f64 / lag_h).exp() } else { 0.0 };
                inside = keep * inside + (1.0 - keep) * celsius;
                let friction = 1.0 - part + part * (-per_kelvin * (inside - 10.0)).exp();
                let fault = if throw < THROWS { 0.0 } else { -12.0 };
                let change = shift(Cause::Friction, 100.0 * (friction - 1.0)) + shift(Cause::Kt, fault);
                let events = machine.feed_at(change, celsius).events;
                let is_new = |event: &&AlarmEvent| event.event_no == 1;
                if throw < THROWS {
                    events
                        .iter()
                        .filter(is_new)
                        .for_each(|event| *raised.entry(event.cause.as_str()).or_default() += 1);
                } else {
                    named += u32::from(events.iter().filter(is_new).any(|event| event.cause == Cause::Kt));
                }
            }
        }
        println!(
            "{part} viscous, {per_kelvin} per K, {lag_h} h behind: {raised:?} in {} throws; motor named in {named} of {LIVES}",
            LIVES * THROWS
        );
    }
}

/// Stated over true scatter of the friction in baselines with serial correlation but without rain. A monitor that left
/// out the throws of supposed rain from each baseline would state too little scatter, and raise false alarms.
#[test]
#[ignore = "prints a table, in some minutes"]
fn table_of_spells_in_wandering_baselines() {
    for (phi, scale, tail) in
        [(0.0, 1.0, None), (0.5, 3.0, None), (0.8, 1.0, None), (0.8, 3.0, None), (0.9, 3.0, None), (0.8, 3.0, Some(3))]
    {
        let scatter = Scatter { sd: Scatter::USUAL.sd.map(|sd| scale * sd), phi, tail };
        let mut ratios = Vec::new();
        for seed in 0..400 {
            let machine = Machine::after(110, 60_000 + seed, scatter);
            let Some(record) = machine.monitor.baseline(Direction::BOTH[0]).filter(|record| record.complete) else {
                continue;
            };
            ratios.push(record.log_covariance[1][1].sqrt() / scatter.sd[1]);
        }
        ratios.sort_by(f64::total_cmp);
        let at = |percent: usize| ratios[percent * (ratios.len() - 1) / 100];
        println!("| {phi} | {scale} | {tail:?} | {} | {:.3} {:.3} {:.3} |", ratios.len(), at(1), at(5), at(50));
    }
}
