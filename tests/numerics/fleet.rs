//! Faults, sensors and fleets: a fault changes its coefficient by its size, and a seed reproduces all results.

use jiff::Timestamp;
use pointsd::estimate::{Identifier, Motor, Settings};
use pointsd::simulate::{
    Condition, Fault, FleetClimate, FleetFault, FleetScatter, FleetSettings, Incident, IncidentKind, Parameters, Part,
    RailModel, Sensor, Sensors, Shape, Stuck, Waveform,
};
use pointsd::throw::{Channel, Direction, Throw};

use super::identify::{assert_near, simulated};
use super::machine::{NO_SCATTER, lumped};

fn record(machine: &Parameters, sensors: &Sensors, direction: Direction) -> Throw {
    simulated(machine, sensors, direction, 3)
}

fn identify(throw: &Throw, settings: &Settings) -> [f64; 3] {
    Identifier::default().identify(throw, settings).outcome.unwrap().coefficients()
}

fn change_pct(is: [f64; 3], was: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|at| (is[at] / was[at] - 1.0) * 100.0)
}

#[test]
fn the_size_of_a_fault_is_what_the_estimate_shows() {
    let by_11th = 100.0 / 1.1 - 100.0;
    let faults = [
        // A weaker motor runs faster, so the dry friction of the machine counts as less viscous friction.
        (Part::Kt, -10.0, [-10.0, -1.9, 0.0]),
        (Part::Kt, 15.0, [15.0, 2.7, 0.0]),
        (Part::Friction, 25.0, [0.0, 25.0, 0.0]),
        (Part::Friction, -20.0, [0.0, -20.0, 0.0]),
        (Part::Stiffness, 15.0, [0.0, 0.0, 15.0]),
        (Part::Stiffness, -15.0, [0.0, 0.0, -15.0]),
        (Part::RailStiffness, 20.0, [0.0, 0.0, 20.0]),
        (Part::Inertia, 10.0, [by_11th; 3]),
        (Part::Inertia, -10.0, [100.0 / 0.9 - 100.0; 3]),
    ];
    let cases = [lumped(), Parameters::default()].map(|new| faults.map(|fault| (new.clone(), fault)));
    for (new, (part, size_pct, expected)) in cases.into_iter().flatten() {
        let estimate = |machine: &Parameters, direction| {
            identify(&record(machine, &Sensors::perfect(1000.0), direction), &Settings::default())
        };
        let mut condition = Condition::default();
        condition.change(part, size_pct);
        let worn = new.in_condition(&condition).unwrap();
        for direction in Direction::BOTH {
            let found = change_pct(estimate(&worn, direction), estimate(&new, direction));
            for (at, expected) in expected.iter().enumerate() {
                // On a beam the friction of the chairs increases with the travel and also changes the other
                // coefficients.
                let leak = match (part, new.rails.model) {
                    (Part::Friction, RailModel::Beam) => 0.25 * size_pct.abs(),
                    (Part::Friction, RailModel::Lumped) => 0.03 * size_pct.abs(),
                    _ => 0.0,
                };
                assert!(
                    (found[at] - expected).abs() < 0.5 + leak,
                    "{:?} rails, {part:?} {size_pct} %, {direction}: {found:?}, expected {expected} at {at}",
                    new.rails.model
                );
            }
        }
    }
}

#[test]
fn a_fault_develops_with_its_shape() {
    let fault = |shape| Fault { part: Part::Kt, shape, size_pct: -10.0, from_throw: 5 };
    let sizes = |shape| (0..20).map(|throw| fault(shape).size_at(throw, 3.0)).collect::<Vec<_>>();
    let step = sizes(Shape::Step);
    let near = |size: f64, expected: f64| (size - expected).abs() < 1e-12;
    assert!(step[..5].iter().all(|size| near(*size, 0.0)) && step[5..].iter().all(|size| near(*size, -10.0)));
    let ramp = sizes(Shape::Ramp { throws: 10 });
    assert!(near(ramp[5], -1.0) && near(ramp[9], -5.0) && near(ramp[14], -10.0) && near(ramp[19], -10.0));
    // A walk of 10 % after 9 throws makes steps of a third of this.
    assert!(near(sizes(Shape::RandomWalk { throws: 9 })[6], -10.0));
}

#[test]
fn series_motors_and_rectified_mains_keep_their_physics() {
    let without_dry = |machine: Parameters| Parameters { motor_dry_nm: 0.0, screw_dry_nm: 0.0, ..machine };
    let mains = Parameters { supply: Waveform::RectifiedMains { mains_hz: 50.0 }, ..Parameters::default() };
    for (name, machine, motor) in [
        ("mains", without_dry(mains), Motor::PermanentMagnet),
        ("series", without_dry(Parameters::series()), Motor::Series),
    ] {
        let known = machine.coefficients().unwrap();
        for direction in Direction::BOTH {
            let throw = record(&machine, &Sensors::perfect(1000.0), direction);
            let found = identify(&throw, &Settings { motor, ..Settings::default() });
            assert_near(found, &known, 0.01, &format!("{name}, {direction}"));
        }
    }
}

#[test]
fn the_same_filter_in_both_channels_cancels() {
    let machine = Parameters { motor_dry_nm: 0.0, screw_dry_nm: 0.0, ..Parameters::default() };
    let known = machine.coefficients().unwrap();
    for (sample_rate_hz, limit) in [(500.0, 0.01), (200.0, 0.012), (100.0, 0.02)] {
        let anti_alias_hz = Some(0.4 * sample_rate_hz);
        let sensors = Sensors { anti_alias_hz, ..Sensors::perfect(sample_rate_hz) };
        let throw = record(&machine, &sensors, Direction::NormalToReverse);
        let found = identify(&throw, &Settings::default());
        assert_near(found, &known, limit, &format!("{sample_rate_hz} Hz"));
    }
}

#[test]
fn sensors_change_the_trace_as_configured() {
    let machine = lumped();
    let direction = Direction::ReverseToNormal;
    let perfect = record(&machine, &Sensors::perfect(1000.0), direction).trace;
    assert!((perfect.position_mm()[0] - 115.0).abs() < 1e-9 && perfect.position_mm()[perfect.len() - 1].abs() < 0.6);
    assert!(perfect.current_a().iter().fold(0.0_f64, |most, a| most.max(*a)) > 12.0, "driving current is positive");

    let with = |change: fn(&mut Sensors)| {
        let mut sensors = Sensors::perfect(1000.0);
        change(&mut sensors);
        record(&machine, &sensors, direction).trace
    };
    let signed = with(|sensors| sensors.signed_current = true);
    assert!(signed.current_a().iter().zip(perfect.current_a()).all(|(a, b)| (a + b).abs() < 1e-12));
    let offset =
        with(|sensors| sensors.current = Sensor { noise: 0.0, offset: -0.15, gain_pct: 2.0, ..Sensor::default() });
    assert!(offset.current_a().iter().zip(perfect.current_a()).all(|(a, b)| (a - (1.02 * b - 0.15)).abs() < 1e-9));
    let coarse = with(|sensors| {
        sensors.current = Sensor { noise: 0.0, full_scale: Some(10.0), bits: Some(12), ..Sensor::default() };
    });
    let step = 20.0 / 4096.0;
    assert!(coarse.current_a().iter().all(|a| a.abs() <= 10.0 && ((a / step).round() * step - a).abs() < 1e-12));
    assert!(coarse.current_a().iter().any(|a| *a > 9.99), "the inrush is clipped");
    let dropped = with(|sensors| sensors.dropped_pct = 5.0);
    assert!(((perfect.len() - dropped.len()) as f64 / perfect.len() as f64 - 0.05).abs() < 0.015);
    let jittered = with(|sensors| sensors.jitter_s = 1e-4);
    let largest =
        jittered.position_mm().iter().zip(perfect.position_mm()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!((1e-3..0.05).contains(&largest), "{largest} mm at 27 mm/s and 0.1 ms");
    let stuck = with(|sensors| sensors.stuck = Some(Stuck { channel: Channel::Position, from_s: 1.0 }));
    assert!(stuck.position_mm()[1201..].iter().all(|mm| mm.to_bits() == stuck.position_mm()[1200].to_bits()));

    for sample_rate_hz in [25.0, 100.0, 333.0, 20_000.0] {
        let trace = record(&machine, &Sensors::perfect(sample_rate_hz), direction).trace;
        let duration = trace.len() as f64 / sample_rate_hz;
        assert!(
            (duration - perfect.len() as f64 / 1000.0).abs() < 2.0 / sample_rate_hz + 0.002,
            "{sample_rate_hz} Hz: {duration} s"
        );
    }
}

#[test]
fn machines_do_not_depend_on_the_size_of_their_fleet() {
    let fleet = |machines| {
        let settings = FleetSettings { machines, machine: lumped(), ..FleetSettings::default() };
        settings.build(11).unwrap()
    };
    let (mut small, mut large) = (fleet(2), fleet(6));
    for _ in 0..3 {
        let [first, second] = std::array::from_fn(|at| large[at].next_throw("a", Timestamp::UNIX_EPOCH).unwrap());
        assert_eq!(small[1].next_throw("a", Timestamp::UNIX_EPOCH).unwrap(), second);
        assert_ne!(first.trace, second.trace);
    }
}

#[test]
fn throws_scatter_as_much_and_as_correlated_as_set() {
    let scatter = FleetScatter { correlation: 0.6, ..FleetScatter::default() };
    let settings = FleetSettings { machines: 1, machine: lumped(), scatter, ..FleetSettings::default() };
    let mut machine = settings.build(5).unwrap().remove(0);
    let (b0, a1): (Vec<f64>, Vec<f64>) = (0..600)
        .map(|_| machine.next_machine().unwrap().0.coefficients().unwrap())
        .map(|known| (known.b0.ln(), known.a1.ln()))
        .unzip();
    let moments = |x: &[f64]| {
        let mean = x.iter().sum::<f64>() / x.len() as f64;
        let product = |lag: usize| x.iter().zip(&x[lag..]).map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>();
        ((product(0) / x.len() as f64).sqrt() * 100.0, product(1) / product(0))
    };
    for (name, values, sd_pct) in [("b0", b0, 0.5), ("a1", a1, 3.0)] {
        let (sd, correlation) = moments(&values);
        // 600 throws with a correlation of 0.6 are equivalent to 150 independent ones.
        assert!((sd / sd_pct - 1.0).abs() < 0.2, "{name}: {sd} %");
        assert!((correlation - 0.6).abs() < 0.12, "{name}: {correlation}");
    }
}

#[test]
fn faults_and_incidents_happen_when_they_are_set() {
    let mut settings =
        FleetSettings { machines: 2, machine: lumped(), scatter: NO_SCATTER, ..FleetSettings::default() };
    let fault = Fault { part: Part::Stiffness, shape: Shape::Step, size_pct: 30.0, from_throw: 3 };
    settings.faults.push(FleetFault { machine: 1, fault });
    let incident = |kind, from_throw| Incident { machine: 0, kind, from_throw, throws: 1 };
    settings.incidents = vec![
        incident(IncidentKind::Obstruction { at_mm: 60.0 }, 0),
        incident(IncidentKind::WeakSupply { loss_pct: 30.0 }, 1),
        incident(IncidentKind::StuckSensor(Stuck { channel: Channel::Current, from_s: 0.5 }), 2),
    ];
    let mut machines = settings.build(2).unwrap();
    let throws: Vec<_> = (0..4).map(|_| machines[0].next_throw("a", Timestamp::UNIX_EPOCH).unwrap()).collect();
    let end = |at: usize| throws[at].trace.position_mm()[throws[at].trace.len() - 1];
    let length = |at: usize| throws[at].trace.len() as f64;
    assert!((end(0) - 60.0).abs() < 5.0, "obstructed at {} mm", end(0));
    assert!(length(1) > 1.3 * length(3), "weak supply: {} samples, else {}", length(1), length(3));
    assert!(throws[2].trace.current_a()[1000..1500].windows(2).all(|pair| pair[0].to_bits() == pair[1].to_bits()));
    let a0: Vec<f64> = (0..6).map(|_| machines[1].next_machine().unwrap().0.coefficients().unwrap().a0).collect();
    assert!((a0[2] / a0[0] - 1.0).abs() < 1e-9 && (a0[3] / a0[0] - 1.3).abs() < 1e-9, "{a0:?}");
}

#[test]
fn cold_grease_and_strong_magnets_show_in_winter() {
    let climate = FleetClimate { mean_c: 10.0, yearly_swing_k: 15.0, daily_swing_k: 5.0, throws_per_day: 40.0 };
    let quarter = 365.25 / 4.0 * 40.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a throw number of this test")]
    let at = |quarters: f64| climate.at((quarters * quarter) as u64);
    assert!((at(1.0) - 25.0).abs() < 5.1 && (at(3.0) + 5.0).abs() < 5.1, "{} and {}", at(1.0), at(3.0));
    let machine = Parameters::default();
    let (winter, summer) =
        (machine.at_temperature(-5.0).coefficients().unwrap(), machine.at_temperature(25.0).coefficients().unwrap());
    assert!((winter.b0 / summer.b0 - 1.045).abs() < 0.003, "{} and {}", winter.b0, summer.b0);
    assert!(winter.a1 / summer.a1 > 1.15);
}

#[test]
fn settings_are_checked_and_read_from_toml_without_unknown_keys() {
    let text = "machines = 3\n[machine]\nstroke_mm = 150\n[[faults]]\nmachine = 1\n\
                fault = { part = \"friction\", shape = { ramp = { throws = 100 } }, size_pct = 25, from_throw = 60 }\n";
    let settings: FleetSettings = toml::from_str(text).unwrap();
    assert!(settings.check().is_ok());
    assert!(settings.machine.stroke_mm > 149.0 && settings.faults[0].fault.shape == Shape::Ramp { throws: 100 });
    assert!(toml::from_str::<FleetSettings>("machine = { strok_mm = 1.0 }").is_err());
    let settings: FleetSettings = toml::from_str(&text.replace("machine = 1\n", "machine = 5\n")).unwrap();
    let error = settings.build(1).expect_err("a machine outside the fleet");
    assert!(error.to_string().contains("must be"), "{error}");
    let hot = FleetClimate { mean_c: 50.0, daily_swing_k: 40.0, ..FleetClimate::default() };
    let error = FleetSettings { climate: hot, ..FleetSettings::default() }.check().unwrap_err();
    assert_eq!(error.to_string(), "climate.mean_c is 50, must be -20 to 40 °C with these swings");
    let wild = FleetClimate { daily_swing_k: 40.0, yearly_swing_k: 40.0, ..FleetClimate::default() };
    let error = FleetSettings { climate: wild, ..FleetSettings::default() }.check().unwrap_err();
    assert_eq!(error.to_string(), "climate.daily_swing_k is 40, must be at most 70 K together with yearly_swing_k");
}
