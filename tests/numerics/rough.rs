//! Throws whose start or course differs from the model: their grades, and whether their intervals hold.

use pointsd::estimate::{Estimate, Grade, Identifier, Settings};
use pointsd::simulate::{Parameters, RailModel, Rails, Sensors};
use pointsd::throw::{Direction, Throw, Trace};

use super::{
    identify::simulated,
    two_masses::{DRIVE_INERTIA, Drive, FRICTION, Recorded, STIFFNESS, TOE_INERTIA, TORQUE},
};

/// Whether both ratios are within 1.96 standard deviations of the truth, and these are small.
fn holds(estimate: &Estimate) -> bool {
    let truth = [FRICTION / TORQUE, STIFFNESS / TORQUE];
    let (ratios, sd) = (estimate.ratios(), estimate.ratios_sd());
    (0..2).all(|at| (ratios[at] - truth[at]).abs() < 1.96 * sd[at] && sd[at] < 0.02 * truth[at])
}

#[test]
fn an_unusable_start_leaves_the_ratios() {
    let cases = [
        ("lost motion", Drive { lost_mm: 0.5, ..Drive::default() }),
        ("play", Drive { play_mm: 0.2, ..Drive::default() }),
        ("much play", Drive { play_mm: 1.0, neutral_mm: 114.5, ..Drive::default() }),
        ("late brake", Drive { brake_nm: 50.0, brake_s: 0.03, ..Drive::default() }),
        ("locked brake", Drive { brake_nm: f64::INFINITY, brake_s: 0.01, ..Drive::default() }),
        ("long unlocking", Drive { brake_nm: f64::INFINITY, brake_s: 0.8, ..Drive::default() }),
        ("a clamp lock", Drive { brake_nm: f64::INFINITY, brake_s: 2.0, ..Drive::default() }),
        ("lag", Drive { lag_hz: 20.0, ..Drive::default() }),
        ("late position", Drive { skew_s: 0.005, ..Drive::default() }),
        ("very late position", Drive { skew_s: 0.04, ..Drive::default() }),
        ("early position", Drive { skew_s: -0.005, ..Drive::default() }),
        ("lost samples", Drive { recorded: Recorded::Lost(3), ..Drive::default() }),
        ("samples that were not measured", Drive { recorded: Recorded::Null(3), ..Drive::default() }),
        ("samples that were not measured, at the start", Drive { recorded: Recorded::Null(0), ..Drive::default() }),
    ];
    for (what, drive) in cases {
        for seed in 0..4 {
            let estimate = drive.identify(seed).outcome.unwrap_or_else(|reason| panic!("{what}: {reason}"));
            assert!(estimate.grade == Grade::Rough && estimate.ratios_only, "{what}: {estimate:?}");
            assert!(holds(&estimate), "{what}: {:?} ± {:?}", estimate.ratios(), estimate.ratios_sd());
        }
    }
}

/// Without samples before the start of the motor, the intervals are wider.
#[test]
fn a_recording_that_begins_in_the_inrush_leaves_the_ratios() {
    let drive = Drive { recorded: Recorded::Late(5), ..Drive::default() };
    for seed in 0..4 {
        let estimate = drive.identify(seed).outcome.unwrap();
        assert!(estimate.ratios_only && covers_ratios(&estimate, drive.truth()), "{estimate:?}");
    }
}

/// Rails that drive the motor leave hardly any charge. The residual by a load that varies is a larger share of it.
#[test]
fn rails_that_help_the_motor_leave_the_ratios() {
    let (brake_nm, brake_s, wander, neutral_mm) = (f64::INFINITY, 0.02, 0.03, 150.0);
    let drive = Drive { brake_nm, brake_s, wander, neutral_mm, ..Drive::default() };
    let (truth, mut missed) = (drive.truth(), 0);
    for seed in 0..20 {
        let estimate = drive.identify(seed).outcome.unwrap_or_else(|reason| panic!("{seed}: {reason}"));
        assert!(estimate.ratios_only, "{seed}: {estimate:?}");
        missed += usize::from(!covers_ratios(&estimate, truth));
    }
    assert!(missed <= 2, "{missed} of 20 intervals miss");
}

/// A position of 12 bits over 300 mm, whose steps hide the noise, does not change until the machine has unlocked.
#[test]
fn a_toe_that_waits_for_the_unlocking_is_not_a_stuck_sensor() {
    for unlocking_s in [0.0, 0.15, 0.2, 0.3] {
        let drive =
            Drive { brake_nm: f64::INFINITY, brake_s: unlocking_s, step_mm: 300.0 / 4096.0, ..Drive::default() };
        for seed in 0..6 {
            let estimate = drive.identify(seed).outcome.unwrap_or_else(|reason| panic!("{unlocking_s} s: {reason}"));
            let [friction, stiffness] = estimate.ratios();
            let errors = [friction * TORQUE / FRICTION - 1.0, stiffness * TORQUE / STIFFNESS - 1.0];
            assert!(errors.iter().all(|error| error.abs() < 0.03), "{unlocking_s} s: {errors:?}");
            for stuck_s in [0.04, 0.1, 0.5] {
                let stuck = Drive { stuck_s: unlocking_s + stuck_s, ..drive }.identify(seed);
                assert!(["stuck", "position_jump"].contains(&stuck.quality()), "{unlocking_s} s: {:?}", stuck.outcome);
            }
        }
    }
}

/// The recording may begin at a crest of the hum, whose other half-waves are no start of the motor.
#[test]
fn strong_hum_is_no_start_of_the_motor() {
    let mut accepted = 0;
    for (seed, first) in (0..40).map(|first| (first % 4, first)) {
        let trace = Drive { hum_a: 0.6, ..Drive::default() }.record(seed as u64);
        let peak = trace.current_a().iter().fold(0.0_f64, |most, a| most.max(*a));
        assert!(0.6 / peak > 0.03, "{peak} A");
        let [current, position] = [trace.current_a(), trace.position_mm()].map(|all| all[first..].to_vec());
        let throw = Throw::recorded(Trace::new(trace.sample_rate_hz(), current, position).unwrap());
        let Ok(estimate) = Identifier::default().identify(&throw, &Settings::default()).outcome else { continue };
        let [friction, stiffness] = estimate.ratios();
        let errors = [friction * TORQUE / FRICTION - 1.0, stiffness * TORQUE / STIFFNESS - 1.0];
        assert!(errors.iter().all(|error| error.abs() < 0.05), "from sample {first}: {errors:?}, {estimate:?}");
        accepted += 1;
    }
    assert!(accepted >= 30, "{accepted} of 40");
}

#[test]
fn mains_hum_and_a_plain_drive_are_good() {
    for hum_a in [0.0, 0.07, 0.28] {
        for seed in 0..4 {
            let estimate = Drive { hum_a, ..Drive::default() }.identify(seed).outcome.unwrap();
            let inertia = DRIVE_INERTIA + TOE_INERTIA;
            assert!(estimate.grade == Grade::Good && holds(&estimate), "{hum_a} A: {estimate:?}");
            assert!((estimate.b0 * inertia / TORQUE - 1.0).abs() < 0.02, "{hum_a} A: {estimate:?}");
        }
    }
}

/// Whether the estimate has no scale, or b0, a1 and a0 are within 1.96 standard deviations of the truth.
fn covers(estimate: &Estimate, truth: [f64; 3]) -> bool {
    let (found, sd) = (estimate.coefficients(), estimate.sd());
    estimate.ratios_only || (0..3).all(|at| (found[at] - truth[at]).abs() < 1.96 * sd[at])
}

/// Whether both ratios are within 1.96 standard deviations of the truth.
fn covers_ratios(estimate: &Estimate, truth: [f64; 3]) -> bool {
    let (ratios, sd) = (estimate.ratios(), estimate.ratios_sd());
    (0..2).all(|at| (ratios[at] - truth[at + 1] / truth[0]).abs() < 1.96 * sd[at])
}

#[test]
fn the_error_by_a_brake_is_in_the_interval_or_the_throw_is_rough() {
    let (mut missed, plain) = (0, Drive::default().truth());
    for brake_nm in [4.0, 8.0, 16.0, 30.0, f64::INFINITY] {
        for brake_s in [0.001, 0.003, 0.007, 0.01, 0.02, 0.04] {
            for seed in 0..3 {
                let estimate = Drive { brake_nm, brake_s, ..Drive::default() }.identify(seed).outcome.unwrap();
                assert!(holds(&estimate), "{brake_nm} N m, {brake_s} s: {estimate:?}");
                missed += usize::from(!covers(&estimate, plain));
            }
        }
    }
    assert!(missed <= 4, "{missed} of 90 intervals miss");
    // The scatter between throws is as small as that of the sensors' noise.
    let plain = Drive::default().identify(1).outcome.unwrap();
    assert!(plain.covariance[(0, 0)].sqrt() < 0.01 * plain.b0 && plain.sd()[0] < 0.4 * plain.b0, "{plain:?}");
}

#[test]
fn the_error_by_a_brake_is_in_the_interval_without_a_position_too() {
    let (mut missed, plain) = (0, Drive::default().truth());
    for (brake_nm, brake_s) in [(0.0, 0.0), (8.0, 0.01), (8.0, 0.03), (16.0, 0.01), (16.0, 0.03), (30.0, 0.01)] {
        for seed in 0..4 {
            let trace = Drive { brake_nm, brake_s, ..Drive::default() }.record(seed);
            let nothing = vec![f64::NAN; trace.len()];
            let trace = Trace::new(trace.sample_rate_hz(), trace.current_a().to_vec(), nothing).unwrap();
            let direction = Some(Direction::NormalToReverse);
            let throw = Throw { supply_v: Some(110.0), direction, ..Throw::recorded(trace) };
            let settings = Settings { stroke_mm: Some(114.5), ..Settings::default() };
            let estimate = Identifier::default().identify(&throw, &settings).outcome.unwrap();
            assert_eq!(estimate.grade, Grade::CurrentOnly);
            missed += usize::from(!covers(&estimate, plain) || !covers_ratios(&estimate, plain));
            let ratios = estimate.ratios();
            println!(
                "{brake_nm} N m, {brake_s} s: b0 {:+.3}, ratios {:+.3} {:+.3}",
                estimate.b0 / plain[0] - 1.0,
                ratios[0] * plain[0] / plain[1] - 1.0,
                ratios[1] * plain[0] / plain[2] - 1.0
            );
            // The scatter between throws is small.
            assert!(estimate.covariance[(0, 0)].sqrt() < 0.01 * estimate.b0, "{estimate:?}");
        }
    }
    assert!(missed <= 1, "{missed} of 24 intervals miss");
}

/// The table of conditions in `deploy/LIMITS.md`; `POINTSD_THROWS` sets the throws in each row, 100 by default.
#[test]
#[ignore = "a table of some minutes"]
fn table_of_conditions() {
    let throws: u32 = std::env::var("POINTSD_THROWS").map_or(100, |text| text.parse().unwrap());
    let plain = Drive::default();
    let brake = |brake_nm, brake_s| Drive { brake_nm, brake_s, ..plain };
    let rows = [
        ("none of these", plain),
        ("brake 16 N m, 10 ms", brake(16.0, 0.01)),
        ("brake 16 N m, 20 ms", brake(16.0, 0.02)),
        ("brake 16 N m, 30 ms", brake(16.0, 0.03)),
        ("brake locked, 5 ms", brake(f64::INFINITY, 0.005)),
        ("brake locked, 10 ms", brake(f64::INFINITY, 0.01)),
        ("lost motion 0.05 mm", Drive { lost_mm: 0.05, ..plain }),
        ("lost motion 0.2 mm", Drive { lost_mm: 0.2, ..plain }),
        ("lost motion 1 mm", Drive { lost_mm: 1.0, ..plain }),
        ("play 0.05 mm", Drive { play_mm: 0.05, ..plain }),
        ("play 0.1 mm", Drive { play_mm: 0.1, ..plain }),
        ("play 0.5 mm", Drive { play_mm: 0.5, ..plain }),
        ("load varies by 1 %", Drive { wander: 0.01, ..plain }),
        ("load varies by 3 %", Drive { wander: 0.03, ..plain }),
        ("load varies by 10 %", Drive { wander: 0.1, ..plain }),
        ("load varies by 2 % within 0.5 s", Drive { wander: 0.02, wander_s: 0.5, ..plain }),
        ("load varies by 6 % within 0.5 s", Drive { wander: 0.06, wander_s: 0.5, ..plain }),
        ("position lag 20 Hz", Drive { lag_hz: 20.0, ..plain }),
        ("position 1 ms late", Drive { skew_s: 0.001, ..plain }),
        ("position 5 ms late", Drive { skew_s: 0.005, ..plain }),
        ("new position every 20 ms", Drive { position_every: 20, ..plain }),
        ("new position every 100 ms", Drive { position_every: 100, ..plain }),
        ("hum 50 mA", Drive { hum_a: 0.07, ..plain }),
        ("hum 200 mA", Drive { hum_a: 0.28, ..plain }),
        ("current noise 0.1 A", Drive { noise_a: 0.1, ..plain }),
        ("timing jitter 0.3 ms", Drive { jitter_s: 3e-4, ..plain }),
        ("five samples lost in the inrush", Drive { recorded: Recorded::Lost(3), ..plain }),
        ("current-controlled, 2 A", Drive { controlled_a: Some(2.0), ..plain }),
        ("current-controlled, 1 A, slide chairs of 0.1", Drive { controlled_a: Some(1.0), mu: 0.1, ..plain }),
        ("current-controlled, 2 A, slide chairs of 0.25", Drive { controlled_a: Some(2.0), mu: 0.25, ..plain }),
        ("slide chairs of 0.02", Drive { mu: 0.02, ..plain }),
        ("slide chairs of 0.05", Drive { mu: 0.05, ..plain }),
        ("slide chairs of 0.1", Drive { mu: 0.1, ..plain }),
        ("slide chairs of 0.15", Drive { mu: 0.15, ..plain }),
        ("slide chairs of 0.25", Drive { mu: 0.25, ..plain }),
        ("soft toe drive", Drive { soft: true, ..plain }),
        ("soft toe drive, slide chairs of 0.02", Drive { mu: 0.02, soft: true, ..plain }),
        ("soft toe drive, slide chairs of 0.05", Drive { mu: 0.05, soft: true, ..plain }),
        ("soft toe drive, slide chairs of 0.1", Drive { mu: 0.1, soft: true, ..plain }),
        ("soft toe drive, slide chairs of 0.15", Drive { mu: 0.15, soft: true, ..plain }),
        ("soft toe drive, slide chairs of 0.25", Drive { mu: 0.25, soft: true, ..plain }),
    ];
    println!("| condition | good | rough | rejected | correct 95 % intervals: of the coefficients | of the ratios |");
    println!("|---|---|---|---|---|---|");
    for (name, drive) in rows {
        let found: Vec<Estimate> = (0..throws).filter_map(|seed| drive.identify(seed.into()).outcome.ok()).collect();
        let good = found.iter().filter(|e| e.grade == Grade::Good).count();
        let scaled: Vec<&Estimate> = found.iter().filter(|e| !e.ratios_only).collect();
        let share =
            |hold: usize, of: usize| (100 * hold).checked_div(of).map_or("-".to_owned(), |pct| format!("{pct} %"));
        let truth = drive.truth();
        println!(
            "| {name} | {good} | {} | {} | {} | {} |",
            found.len() - good,
            throws as usize - found.len(),
            share(scaled.iter().filter(|e| covers(e, truth)).count(), scaled.len()),
            share(found.iter().filter(|e| covers_ratios(e, truth)).count(), found.len())
        );
    }
}

/// The viscous model does not fit Coulomb friction. The intervals cover this, with a stiff and with a soft toe drive.
#[test]
fn the_intervals_cover_coulomb_friction() {
    let cases = [
        (0.05, false, None),
        (0.15, false, None),
        (0.25, false, None),
        (0.5, false, None),
        (0.7, false, None),
        (0.1, true, None),
        (0.25, true, None),
        (0.1, false, Some(2.0)),
        (0.25, false, Some(4.0)),
    ];
    let both = [(0.0, 0.0), (0.02, 0.0), (0.0, 114.5)];
    for ((mu, soft, controlled_a), (brake_s, neutral_mm)) in
        cases.into_iter().flat_map(|case| both.map(|other| (case, other)))
    {
        // A locked brake leaves the ratios only. The rails help the drive on the way to their neutral position.
        let brake_nm = if brake_s > 0.0 { f64::INFINITY } else { 0.0 };
        let drive = Drive { brake_nm, brake_s, controlled_a, mu, soft, neutral_mm, ..Drive::default() };
        let truth = drive.truth();
        for seed in 0..3 {
            let estimate = drive.identify(seed).outcome.unwrap();
            let what = format!("{mu}, soft {soft}, {controlled_a:?}: {:?} for {truth:?}", estimate.coefficients());
            assert!(covers(&estimate, truth) && covers_ratios(&estimate, truth), "{what} ± {:?}", estimate.sd());
        }
    }
}

/// The load varies within 10 ms to half a second: in some cases so little that the throw is good, in others so much
/// that only its ratios are known.
#[test]
fn the_intervals_of_ratios_cover_a_load_that_varies() {
    let mut counts = [[0; 2]; 2];
    for (wander, wander_s) in
        [(0.03, 0.01), (0.03, 0.05), (0.06, 0.05), (0.1, 0.05), (0.03, 0.2), (0.02, 0.5), (0.03, 0.5), (0.06, 0.5)]
    {
        let drive = Drive { wander, wander_s, ..Drive::default() };
        let truth = drive.truth();
        for seed in 0..20 {
            let Ok(estimate) = drive.identify(seed).outcome else { continue };
            let [held, of] = &mut counts[usize::from(estimate.ratios_only)];
            *of += 1;
            *held += usize::from(covers_ratios(&estimate, truth));
        }
    }
    println!("{counts:?} intervals hold of good and rough throws");
    assert!(counts.iter().all(|[held, of]| *of >= 30 && 100 * held >= 92 * of), "{counts:?}");
}

/// Many loggers read the toe sensor less often than the current.
#[test]
fn a_slow_position_is_as_good_as_a_fast_one_and_its_intervals_hold() {
    let truth = Drive::default().truth();
    let (mut usable, mut held, mut throws) = (0, 0, 0);
    for position_every in [3, 5, 10, 20, 33, 50, 100] {
        for (neutral_mm, step_mm) in [(0.0, 0.0), (114.5, 0.0), (0.0, 0.05)] {
            let drive = Drive { neutral_mm, step_mm, position_every, ..Drive::default() };
            for seed in 0..4 {
                throws += 1;
                let estimate = match drive.identify(seed).outcome {
                    Ok(estimate) => estimate,
                    Err(reason) => {
                        println!("{position_every} samples, {neutral_mm} mm: {reason}");
                        continue;
                    }
                };
                let [friction, _] = estimate.ratios();
                let error = friction * truth[0] / truth[1] - 1.0;
                assert!(error.abs() < 0.03, "{position_every} samples: the friction is wrong by {error}");
                usable += 1;
                held += usize::from(covers(&estimate, truth) && covers_ratios(&estimate, truth));
            }
        }
    }
    println!("{usable} of {throws} throws are usable, the intervals of {held} hold");
    assert!(20 * usable >= 19 * throws && 10 * held >= 9 * usable);
}

#[test]
fn dry_slide_chairs_are_friction_whatever_the_grade() {
    for model in [RailModel::Beam, RailModel::Lumped] {
        for drive_stiffness_n_m in [1e8, 5e6] {
            let mut before = 0.0;
            for slide_friction in [0.02, 0.1, 0.3, 0.5, 0.7] {
                let rails = Rails { model, slide_friction, ..Rails::default() };
                let machine = Parameters { rails, drive_stiffness_n_m, ..Parameters::default() };
                let throw = simulated(&machine, &Sensors::default(), Direction::NormalToReverse, 3);
                let estimate = Identifier::default().identify(&throw, &Settings::default()).outcome.unwrap();
                let known = machine.coefficients().unwrap();
                let [friction, stiffness] = estimate.ratios();
                assert!((friction / (known.a1 / known.b0) - 1.0).abs() < 0.02, "{model:?}, {slide_friction}");
                assert!((stiffness / (known.a0 / known.b0) - 1.0).abs() < 0.08, "{model:?}, {slide_friction}");
                assert!(friction > 1.02 * before, "{model:?}, {slide_friction}");
                before = friction;
            }
        }
    }
}

/// Very dry chairs make the same error of the ratios in every throw, so the mean of 24 throws has this error too.
#[test]
fn the_stated_uncertainty_of_the_mean_of_rough_throws_covers_its_error() {
    for (model, slide_friction, direction) in [
        (RailModel::Beam, 0.5, Direction::NormalToReverse),
        (RailModel::Beam, 0.7, Direction::NormalToReverse),
        (RailModel::Beam, 0.7, Direction::ReverseToNormal),
    ] {
        let rails = Rails { model, slide_friction, ..Rails::default() };
        let machine = Parameters { rails, ..Parameters::default() };
        let known = machine.coefficients().unwrap();
        let (mut mean, mut variance) = (0.0, 0.0);
        for seed in 0..24 {
            let throw = simulated(&machine, &Sensors::default(), direction, 300 + seed);
            let estimate = Identifier::default().identify(&throw, &Settings::default()).outcome.unwrap();
            assert!(estimate.ratios_only, "{slide_friction}: {estimate:?}");
            let [_, stiffness] = estimate.ratios();
            let drift = estimate.drift_covariance(24);
            let log = |i: usize, j: usize| drift[(i, j)] / (estimate.coefficients()[i] * estimate.coefficients()[j]);
            mean += (stiffness / (known.a0 / known.b0)).ln() / 24.0;
            variance += (log(2, 2) - 2.0 * log(0, 2) + log(0, 0)) / (24.0 * 24.0);
        }
        let sd = variance.sqrt();
        println!("{slide_friction}, {direction}: {:.1} % ± {:.1} %", 100.0 * mean, 100.0 * sd);
        assert!(mean.abs() < 2.5 * sd, "{slide_friction}, {direction}: {mean} ± {sd}");
    }
}
