//! A supply from rectified mains: the ripple of the current is as recorded on a real machine, and does not disturb the
//! estimator if the sampling rate resolves it.

use std::f64::consts::PI;

use pointsd::estimate::{Grade, Identifier, Rejection, Settings};
use pointsd::simulate::{Conditions, Parameters, STEP_S, Sensors, Waveform};
use pointsd::throw::Direction;

use super::identify::simulated_in;

fn on(supply: Waveform) -> Parameters {
    Parameters { supply, ..Parameters::default() }
}

const MAINS: Waveform = Waveform::RectifiedMains { mains_hz: 50.0 };

#[test]
fn the_current_ripples_by_one_ampere_at_twice_the_mains_frequency() {
    for direction in Direction::BOTH {
        let motion = on(MAINS).simulate(direction, &Conditions::default(), STEP_S).unwrap();
        let running = &motion.current_a[10_000..15_000];
        let mean = running.iter().sum::<f64>() / running.len() as f64;
        let above = running.iter().fold(f64::MIN, |most, a| most.max(*a)) - mean;
        let below = mean - running.iter().fold(f64::MAX, |least, a| least.min(*a));
        assert!((0.8..1.4).contains(&above) && (0.8..1.4).contains(&below), "{direction}: +{above}, -{below} A");
        let rises = running.windows(2).filter(|pair| pair[0] < mean && pair[1] >= mean).count();
        assert_eq!(rises, 100, "{direction}: in one second");
        let steady = on(Waveform::Constant).simulate(direction, &Conditions::default(), STEP_S).unwrap();
        let peak = |motion: &pointsd::simulate::Motion| motion.current_a.iter().fold(0.0_f64, |most, a| most.max(*a));
        assert!((peak(&motion) - peak(&steady)).abs() < 1.5, "{direction}: inrush of {} A", peak(&motion));
    }
}

#[test]
fn the_ripple_does_no_harm_where_it_is_sampled() {
    let identify = |machine: &Parameters, direction, sensors: &Sensors, supply_phase_rad| {
        let conditions = Conditions { supply_phase_rad, ..Conditions::default() };
        let throw = simulated_in(&conditions, machine, sensors, direction, 3);
        Identifier::default().identify(&throw, &Settings::default()).outcome.map(|found| [found.b0, found.a1, found.a0])
    };
    for (sample_rate_hz, filtered) in
        [(500.0, true), (1000.0, false), (1000.0, true), (5000.0, false), (20_000.0, false)]
    {
        let anti_alias_hz = filtered.then_some(0.4 * sample_rate_hz);
        let sensors = Sensors { anti_alias_hz, ..Sensors::perfect(sample_rate_hz) };
        for direction in Direction::BOTH {
            let steady = identify(&on(Waveform::Constant), direction, &sensors, 0.0).unwrap();
            for eighth in 0..8 {
                let ripple = identify(&on(MAINS), direction, &sensors, PI * f64::from(eighth) / 8.0).unwrap();
                for (with, without) in ripple.iter().zip(steady) {
                    let change = (with / without - 1.0).abs();
                    assert!(change < 0.01, "{sample_rate_hz} Hz, {direction}, phase {eighth}/8: {change}");
                }
            }
        }
    }
}

/// At 250 Hz the rise of the current is not resolved, so a throw shows only ratios. The ripple is not aliased to a
/// constant current.
#[test]
fn the_ripple_does_not_bias_the_ratios_at_250_hz() {
    let ratios = |supply: Waveform, rate_hz, direction, supply_phase_rad| {
        let conditions = Conditions { supply_phase_rad, ..Conditions::default() };
        let throw = simulated_in(&conditions, &on(supply), &Sensors::perfect(rate_hz), direction, 3);
        let found = Identifier::default().identify(&throw, &Settings::default()).outcome?;
        Ok::<_, Rejection>(([found.a1 / found.b0, found.a0 / found.b0], found.grade))
    };
    let mut rejected = 0;
    for direction in Direction::BOTH {
        let (steady, _) = ratios(Waveform::Constant, 1000.0, direction, 0.0).unwrap();
        for (mains_hz, eighth) in [16.7, 50.0, 60.0].into_iter().flat_map(|hz| (0..8).map(move |eighth| (hz, eighth))) {
            let supply = Waveform::RectifiedMains { mains_hz };
            let Ok((found, grade)) = ratios(supply, 250.0, direction, PI * f64::from(eighth) / 8.0) else {
                rejected += 1;
                continue;
            };
            assert_eq!(grade, Grade::Rough);
            for (found, steady) in found.into_iter().zip(steady) {
                let change = found / steady - 1.0;
                assert!(change.abs() < 0.02, "{mains_hz} Hz, {direction}, phase {eighth}/8: {change}");
            }
        }
    }
    assert!(rejected <= 4, "{rejected} of 48");
}
