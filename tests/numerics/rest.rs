//! The current at rest: of a detection circuit, of electronics, of the sensor, or not recorded.

use pointsd::estimate::{Estimate, Grade, Identification, Identifier, Motor, Rejection, Settings};
use pointsd::simulate::{Conditions, Parameters, Sensor, Sensors};
use pointsd::throw::{Direction, Throw, Trace};
use rand::RngExt as _;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

/// A recorded throw.
struct Recorded {
    current: Vec<f64>,
    position: Vec<f64>,
    /// Sample at which the motor is switched on.
    on: usize,
    /// Sample at which the motor is switched off.
    off: usize,
}

impl Recorded {
    fn new(machine: &Parameters, sensors: &Sensors, direction: Direction, obstruction_mm: Option<f64>) -> Self {
        let conditions = Conditions { obstruction_mm, ..Conditions::default() };
        let motion = machine.simulate(direction, &conditions, sensors.step_s()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let trace = sensors.record(&motion, direction, &mut rng).unwrap().trace;
        let (current, position) = (trace.current_a().to_vec(), trace.position_mm().to_vec());
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index of the trace")]
        let sample = |time_s: f64| (1000.0 * time_s).round() as usize;
        let on = sample(sensors.before_s);
        Self { current, position, on, off: on + sample(motion.cut_off as f64 * motion.step_s) }
    }

    /// Adds a current before and after the movement.
    fn at_rest(mut self, before_a: f64, after_a: f64) -> Self {
        for (k, i) in self.current.iter_mut().enumerate() {
            *i += if k <= self.on { before_a } else { 0.0 } + if k > self.off { after_a } else { 0.0 };
        }
        self
    }

    fn identify(&self, settings: &Settings) -> Identification {
        let trace = Trace::new(1000.0, self.current.clone(), self.position.clone()).unwrap();
        let throw = Throw { supply_v: Some(110.0), ..Throw::recorded(trace) };
        Identifier::default().identify(&throw, settings)
    }
}

/// Asserts that the intervals of the ratios contain those of `whole`.
fn covers(estimate: &Estimate, whole: &Estimate, what: &str) {
    for at in 0..2 {
        let (is, was, sd) = (estimate.ratios()[at], whole.ratios()[at], estimate.ratios_sd()[at]);
        assert!((is - was).abs() < 1.96 * sd, "{what}: ratio {at} is {is} ± {sd}, was {was}");
    }
}

#[test]
fn a_detection_current_after_the_throw_is_no_motor_that_stalls() {
    let sensors = Sensors { after_s: 1.2, ..Sensors::default() };
    let settings = Settings::default();
    for (direction, after_a) in
        [(Direction::NormalToReverse, 0.1), (Direction::NormalToReverse, 0.25), (Direction::ReverseToNormal, 0.1)]
    {
        let plain = Recorded::new(&Parameters::default(), &sensors, direction, None).identify(&settings);
        let found =
            Recorded::new(&Parameters::default(), &sensors, direction, None).at_rest(0.0, after_a).identify(&settings);
        assert_eq!(found.quality(), "good", "{direction}, {after_a} A: {:?}", found.outcome);
        for (is, was) in [
            (found.features.mean_current_a, plain.features.mean_current_a),
            (found.features.running_current_a, plain.features.running_current_a),
            (found.features.charge_as, plain.features.charge_as),
        ] {
            assert!((is.unwrap() / was.unwrap() - 1.0).abs() < 0.02, "{direction}, {after_a} A: {is:?}, {was:?}");
        }
        for obstruction_mm in [3.0, 4.0, 6.0, 10.0, 60.0, 110.0] {
            let refused = Recorded::new(&Parameters::default(), &sensors, direction, Some(obstruction_mm))
                .at_rest(0.0, after_a)
                .identify(&settings)
                .outcome
                .unwrap_err();
            assert!(refused.is_incomplete(), "{direction}, {obstruction_mm} mm: {refused}");
        }
    }
}

/// After the end of the motor the rails push the toe back: elastically on a sound machine, and further if nothing holds it.
#[test]
fn a_toe_that_does_not_stay_at_its_end_is_open() {
    let sensors = Sensors { after_s: 0.6, ..Sensors::default() };
    for (direction, stroke_mm) in Direction::BOTH.into_iter().flat_map(|way| [(way, None), (way, Some(115.0))]) {
        let settings = Settings { stroke_mm, ..Settings::default() };
        let after = |back_mm: f64, rest_a: f64, noise_mm: f64, kept_s: f64| {
            let mut recorded = Recorded::new(&Parameters::default(), &sensors, direction, None).at_rest(0.0, rest_a);
            let mut rng = ChaCha8Rng::seed_from_u64(4);
            for (k, mm) in recorded.position.iter_mut().enumerate() {
                let back = k.saturating_sub(recorded.off) as f64 / 200.0;
                *mm -= direction.sign() * back_mm * back.min(1.0);
                *mm += noise_mm * rng.sample::<f64, _>(rand_distr::StandardNormal);
            }
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index of the trace")]
            let kept = recorded.off + (1000.0 * kept_s) as usize;
            recorded.position.truncate(kept);
            recorded.current.truncate(kept);
            recorded.identify(&settings).outcome
        };
        for rest_a in [0.0, 0.1] {
            let what = format!("{direction}, {stroke_mm:?}, {rest_a} A");
            for back_mm in [0.0, 2.0, 4.5] {
                let found = after(back_mm, rest_a, 0.0, 0.6);
                assert!(found.is_ok(), "{what}, {back_mm} mm: {found:?}");
            }
            for noise_mm in [0.0, 0.3] {
                let found = after(12.0, rest_a, noise_mm, 0.6).unwrap_err();
                if rest_a > 0.0 && stroke_mm.is_none() && matches!(found, Rejection::Obstructed { .. }) {
                    // The current at rest looks like that of a motor which drives the open toe.
                    continue;
                }
                let Rejection::Reopened { back_mm, position_mm } = found else { panic!("{what}: {found}") };
                let end_mm = if direction.sign() > 0.0 { 103.0 } else { 12.0 };
                assert!((back_mm - 12.0).abs() < 1.0 && (position_mm - end_mm).abs() < 1.0, "{what}: {found}");
            }
        }
        // The recording ends with the motor.
        let found = after(12.0, 0.0, 0.0, 0.02);
        assert!(found.is_ok(), "{direction}, {stroke_mm:?}: {found:?}");
    }
}

/// One throw cannot distinguish an offset of the sensor from a current that the machine draws at rest only.
#[test]
fn the_interval_covers_a_current_that_flows_at_rest_only() {
    let series = Settings { motor: Motor::Series, ..Settings::default() };
    for (machine, settings) in [(Parameters::default(), Settings::default()), (Parameters::series(), series)] {
        for direction in Direction::BOTH {
            for late in [0, 8] {
                let recorded = || {
                    let mut recorded = Recorded::new(&machine, &Sensors::default(), direction, None);
                    let first = recorded.position[0];
                    recorded.position.rotate_right(late);
                    recorded.position[..late].fill(first);
                    recorded
                };
                let plain = recorded().identify(&settings).outcome.unwrap();
                for rest_a in [-0.1, 0.02, 0.1] {
                    let what = format!("{:?}, {direction}, {late} ms, {rest_a} A", settings.motor);
                    let found = recorded().at_rest(rest_a, rest_a).identify(&settings).outcome.unwrap();
                    assert_eq!(found.ratios_only, late > 0, "{what}");
                    covers(&found, &plain, &what);
                    // Such a current is equal in every throw, so it does not hide a drift.
                    let [is, was] = [&found, &plain].map(|e| e.drift_covariance(24)[(1, 1)].sqrt() / e.a1);
                    assert!(is < 1.3 * was, "{what}: {is}, {was}");
                }
            }
        }
    }
}

#[test]
fn the_interval_covers_an_offset_that_is_not_recorded() {
    let settings = Settings { stroke_mm: Some(115.0), ..Settings::default() };
    for direction in Direction::BOTH {
        let whole = Recorded::new(&Parameters::default(), &Sensors::default(), direction, None);
        let whole = whole.identify(&Settings::default()).outcome.unwrap();
        for offset in [-0.15, 0.0, 0.15] {
            let current = Sensor { offset, ..Sensor::default() };
            let sensors = Sensors { before_s: 0.0, after_s: 0.0, current, ..Sensors::default() };
            let found = Recorded::new(&Parameters::default(), &sensors, direction, None).identify(&settings);
            let estimate = found.outcome.unwrap();
            assert_eq!(estimate.grade, Grade::Rough, "{direction}, {offset} A: {estimate:?}");
            covers(&estimate, &whole, &format!("{direction}, {offset} A"));
        }
    }
}

/// The offset is 8 % of the inrush, and from 3 kHz on the trace is decimated.
#[test]
fn an_offset_of_the_current_changes_no_estimate_at_any_rate() {
    let machine = Parameters::default();
    for (sample_rate_hz, direction) in
        [1000.0, 3000.0, 5000.0, 10_000.0].map(|hz| Direction::BOTH.map(|to| (hz, to))).as_flattened()
    {
        let sensors = Sensors { sample_rate_hz: *sample_rate_hz, ..Sensors::default() };
        let motion = machine.simulate(*direction, &Conditions::default(), sensors.step_s()).unwrap();
        let trace = sensors.record(&motion, *direction, &mut ChaCha8Rng::seed_from_u64(9)).unwrap().trace;
        let peak = trace.current_a().iter().fold(0.0_f64, |most, a| most.max(a.abs()));
        let with = |offset: f64| {
            let current = trace.current_a().iter().map(|a| a + offset * peak).collect();
            let trace = Trace::new(*sample_rate_hz, current, trace.position_mm().to_vec()).unwrap();
            let found = Identifier::default().identify(&Throw::recorded(trace), &Settings::default()).outcome.unwrap();
            [found.b0, found.a1, found.a0]
        };
        let plain = with(0.0);
        for offset in [-0.08, 0.08, 0.11] {
            let change =
                with(offset).iter().zip(plain).map(|(with, plain)| (with / plain - 1.0).abs()).fold(0.0, f64::max);
            assert!(change < 0.003, "{offset} at {sample_rate_hz} Hz, {direction}: {change}");
        }
    }
}

#[test]
fn a_noisy_current_names_its_setting() {
    let current = Sensor { noise: 0.1, ..Sensor::default() };
    let sensors = Sensors { current, ..Sensors::default() };
    let recorded = Recorded::new(&Parameters::default(), &sensors, Direction::NormalToReverse, None);
    let found = recorded.identify(&Settings::default());
    let detail = found.detail().unwrap();
    assert_eq!(found.quality(), "rough");
    assert!(detail.starts_with("the noise of the current is 0.") && detail.contains("configured 0.020 A"), "{detail}");
    assert!(detail.contains("set current_noise_a"), "{detail}");
    let found = recorded.identify(&Settings { current_noise_a: 0.1, ..Settings::default() });
    assert_eq!((found.quality(), found.detail()), ("good", None));
}

/// The noise is the reason, but the recording begins 6 ms after the motor too.
#[test]
fn a_missing_start_gives_no_delay_and_no_gain_whatever_the_noise() {
    for direction in Direction::BOTH {
        let mut recorded = Recorded::new(&Parameters::default(), &Sensors::default(), direction, None);
        let from = recorded.on + 6;
        recorded.current.drain(..from);
        recorded.position.drain(..from);
        for (current_noise_a, reason) in [(0.002, "the noise of the current"), (0.02, "the start of the motor is not")]
        {
            let found = recorded.identify(&Settings { current_noise_a, ..Settings::default() });
            assert!(found.detail().unwrap().starts_with(reason), "{direction}: {:?}", found.detail());
            assert!(found.outcome.unwrap().ratios_only, "{direction}");
            let features = found.features;
            assert_eq!((features.start_delay_s, features.start_gain), (None, None), "{direction}, {current_noise_a}");
        }
    }
}

/// Rails that help leave a running current that such noise hides, so that the motor seems to be off after its inrush.
#[test]
fn a_running_current_within_its_noise_does_not_end_the_throw() {
    let mut sensors = Sensors::default();
    (sensors.current.noise, sensors.position.noise) = (0.2, 0.2);
    let settings = Settings { current_noise_a: 0.2, position_noise_mm: 0.2, ..Settings::default() };
    let machine = Parameters::default();
    let motion = machine.simulate(Direction::ReverseToNormal, &Conditions::default(), sensors.step_s()).unwrap();
    for seed in 0..40 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let trace = sensors.record(&motion, Direction::ReverseToNormal, &mut rng).unwrap().trace;
        let found = Identifier::default().identify(&Throw::recorded(trace), &settings);
        assert_eq!(found.quality(), "good", "{seed}: {:?}", found.detail());
    }
}

#[test]
fn the_no_load_speed_needs_no_supply_voltage_and_does_not_change_with_dry_friction() {
    let machine = Parameters::default();
    let expected = machine.supply_v / (machine.back_emf_constant * machine.gear_ratio);
    let mut dry = machine.clone();
    dry.rails.slide_friction = 0.1;
    for machine in [machine, dry] {
        let Recorded { current, position, .. } =
            Recorded::new(&machine, &Sensors::default(), Direction::NormalToReverse, None);
        let throw = Throw::recorded(Trace::new(1000.0, current, position).unwrap());
        let features = Identifier::default().identify(&throw, &Settings::default()).features;
        assert_eq!((features.supply_v, features.resistance_ohm), (None, None));
        let speed = features.no_load_speed_rad_per_s.unwrap();
        assert!((speed / expected - 1.0).abs() < 0.005, "{speed} rad/s, {expected} expected");
    }
}

#[test]
fn the_energy_is_known_for_every_motor_with_a_supply_voltage() {
    for (machine, motor) in [(Parameters::default(), Motor::PermanentMagnet), (Parameters::series(), Motor::Series)] {
        let recorded = Recorded::new(&machine, &Sensors::default(), Direction::NormalToReverse, None);
        let features = recorded.identify(&Settings { motor, ..Settings::default() }).features;
        let expected = features.charge_as.unwrap() * 110.0;
        assert!((features.energy_j.unwrap() - expected).abs() < 1e-9 * expected, "{motor:?}: {features:?}");
    }
}

#[test]
fn a_current_that_is_no_measurement_has_no_features() {
    let recorded = || Recorded::new(&Parameters::default(), &Sensors::default(), Direction::NormalToReverse, None);
    let damages: [(&str, Damage); 2] = [
        ("implausible_value", |current| current[2000] = 188_776.0),
        ("stuck", |current| current[1000..3500].fill(1.0)),
    ];
    for (quality, damage) in damages {
        let mut recorded = recorded();
        damage(&mut recorded.current);
        let found = recorded.identify(&Settings::default());
        assert_eq!(found.quality(), quality, "{:?}", found.outcome);
        let features = found.features;
        assert_eq!(
            (features.peak_current_a, features.running_current_a, features.charge_as),
            (None, None, None),
            "{quality}"
        );
        // Without the start of the motor the travel is unknown too.
        assert_eq!(features.travel_mm.is_some(), quality == "stuck", "{quality}");
    }
}

#[test]
fn a_wrong_sampling_rate_gives_no_constants_of_the_motor_and_is_stated_as_sent() {
    let Recorded { current, position, .. } =
        Recorded::new(&Parameters::default(), &Sensors::default(), Direction::NormalToReverse, None);
    let identify = |rate_hz: f64, position: &[f64]| {
        let throw = Throw::recorded(Trace::new(rate_hz, current.clone(), position.to_vec()).unwrap());
        Identifier::default().identify(&throw, &Settings::default())
    };
    let found = identify(100.0, &position);
    assert_eq!(found.quality(), "too_slow", "{:?}", found.outcome);
    assert_eq!((found.features.duration_s, found.features.no_load_speed_rad_per_s), (None, None));
    // At 2,000 Hz the estimator takes every second sample.
    let long: Vec<f64> = [&current[..2000], &vec![1.5; 620_000], &current[4000..]].concat();
    let throw = Throw::recorded(Trace::new(2000.0, long.clone(), vec![f64::NAN; long.len()]).unwrap());
    let detail = Identifier::default().identify(&throw, &Settings::default()).detail().unwrap();
    assert!(detail.ends_with("check sample_rate_hz, 2000 Hz"), "{detail}");
}

#[test]
fn a_rate_computed_from_times_may_be_a_little_low() {
    let sensors = Sensors { sample_rate_hz: 200.0, ..Sensors::default() };
    let machine = Parameters::default();
    let motion = machine.simulate(Direction::NormalToReverse, &Conditions::default(), sensors.step_s()).unwrap();
    let trace = sensors.record(&motion, Direction::NormalToReverse, &mut ChaCha8Rng::seed_from_u64(9)).unwrap().trace;
    for rate_hz in [200.0, 199.999_999] {
        let trace = Trace::new(rate_hz, trace.current_a().to_vec(), trace.position_mm().to_vec()).unwrap();
        let features = Identifier::default().identify(&Throw::recorded(trace), &Settings::default()).features;
        assert!(features.no_load_speed_rad_per_s.is_some(), "{rate_hz} Hz");
    }
}

type Damage = fn(&mut [f64]);

#[test]
fn a_broken_position_gives_no_resistance_and_no_back_emf() {
    let recorded = || Recorded::new(&Parameters::default(), &Sensors::default(), Direction::NormalToReverse, None);
    let features = recorded().identify(&Settings::default()).features;
    assert!(features.resistance_ohm.is_some() && features.back_emf_v_s_per_rad.is_some(), "{features:?}");
    let damages: [(&str, Damage); 3] = [
        ("stuck", |position| position[2000..].fill(50.0)),
        ("not_finite", |position| position[1000..1500].fill(f64::NAN)),
        ("noisy", |position| position.iter_mut().enumerate().for_each(|(k, x)| *x += 4.0 * (k as f64 * 2.0).sin())),
    ];
    for (quality, damage) in damages {
        let mut recorded = recorded();
        damage(&mut recorded.position);
        let found = recorded.identify(&Settings::default());
        assert!([quality, "position_jump"].contains(&found.quality()), "{quality}: {:?}", found.outcome);
        let features = found.features;
        assert_eq!((features.resistance_ohm, features.back_emf_v_s_per_rad), (None, None), "{quality}");
        assert!(features.energy_j.is_some(), "{quality}");
    }
}

#[test]
fn a_three_phase_motor_has_features_only_and_an_obstruction_is_found() {
    let settings = Settings { motor: Motor::ThreePhase, ..Settings::default() };
    let recorded = |obstruction_mm| {
        Recorded::new(&Parameters::default(), &Sensors::default(), Direction::NormalToReverse, obstruction_mm)
            .identify(&settings)
    };
    let found = recorded(None);
    assert_eq!(found.quality(), "current_only");
    let detail = found.detail().unwrap();
    assert!(detail.starts_with("the motor is configured as three-phase"), "{detail}");
    let features = found.features;
    assert!(features.travel_mm.is_some() && features.duration_s.is_some() && features.running_current_a.is_some());
    assert_eq!(features.resistance_ohm, None);
    assert_eq!(recorded(Some(60.0)).quality(), "obstructed");
}

/// Points that are moved by hand have no time from the start of a motor.
#[test]
fn a_movement_without_a_current_has_no_duration() {
    let mut recorded = Recorded::new(&Parameters::default(), &Sensors::default(), Direction::NormalToReverse, None);
    let rest = recorded.current[..200].to_vec();
    for (k, current) in recorded.current.iter_mut().enumerate() {
        *current = rest[k % rest.len()];
    }
    let found = recorded.identify(&Settings::default());
    assert_eq!(found.quality(), "no_current", "{:?}", found.outcome);
    assert_eq!((found.features.duration_s, found.features.running_current_a), (None, None));
}
