//! Features of throws whose start differs from the model.

use pointsd::estimate::{Identifier, Settings};
use pointsd::throw::Throw;

use super::two_masses::{DRIVE_INERTIA, Drive, TOE_INERTIA, TORQUE};

/// The motor turns while the toe stands still: the resistance is measured where the toe moves.
#[test]
fn play_lost_motion_and_a_late_position_do_not_change_the_resistance() {
    let plain = Drive::default();
    for (what, drive) in [
        ("plain", plain),
        ("play", Drive { play_mm: 0.2, ..plain }),
        ("much play", Drive { play_mm: 1.0, ..plain }),
        ("lost motion", Drive { lost_mm: 0.5, ..plain }),
        ("late position", Drive { skew_s: 0.005, ..plain }),
        ("lag", Drive { lag_hz: 20.0, ..plain }),
        ("locked brake", Drive { brake_nm: f64::INFINITY, brake_s: 0.02, ..plain }),
        ("unlocking", Drive { brake_nm: f64::INFINITY, brake_s: 0.3, ..plain }),
    ] {
        for seed in 0..4 {
            let throw = Throw { supply_v: Some(110.0), ..Throw::recorded(drive.record(seed)) };
            let features = Identifier::default().identify(&throw, &Settings::default()).features;
            let (ohm, back_emf) = (features.resistance_ohm.unwrap(), features.back_emf_v_s_per_rad.unwrap());
            assert!((ohm / 4.0 - 1.0).abs() < 0.06, "{what}: {ohm}");
            assert!((back_emf / TORQUE - 1.0).abs() < 0.005, "{what}: {back_emf}");
        }
    }
}

/// Delay \[ms\] and acceleration per ampere of the start of a drive: means over some throws.
fn start(drive: Drive) -> (f64, f64) {
    let throws = 6;
    let of = |seed| drive.identify(seed).features;
    let mean = |value: &dyn Fn(u64) -> f64| (0..throws).map(value).sum::<f64>() / throws as f64;
    (mean(&|seed| 1e3 * of(seed).start_delay_s.unwrap()), mean(&|seed| of(seed).start_gain.unwrap()))
}

#[test]
fn delay_and_acceleration_of_the_start_show_brake_play_and_lag_and_no_friction() {
    let plain = Drive::default();
    let (delay_ms, gain) = start(plain);
    assert!((gain * (DRIVE_INERTIA + TOE_INERTIA) / TORQUE - 1.0).abs() < 0.02, "{gain}");
    // Range of the change of the delay [ms], and of the ratio of the accelerations.
    let cases = [
        ("late position", Drive { skew_s: 0.005, ..plain }, 4.8..5.2, 0.95..1.05),
        ("early position", Drive { skew_s: -0.005, ..plain }, -5.2..-4.8, 0.95..1.05),
        ("lag of 8 ms", Drive { lag_hz: 20.0, ..plain }, 5.0..9.0, 0.8..1.05),
        ("play", Drive { play_mm: 0.1, ..plain }, 1.5..5.0, 0.9..1.05),
        ("lost motion", Drive { lost_mm: 0.5, ..plain }, 10.0..25.0, 0.8..1.1),
        ("locked brake", Drive { brake_nm: f64::INFINITY, brake_s: 0.02, ..plain }, 3.0..20.0, 0.1..0.9),
        ("dragging brake", Drive { brake_nm: 16.0, brake_s: 0.03, ..plain }, -9.0..9.0, 0.3..0.85),
        ("slide chairs", Drive { mu: 0.25, ..plain }, -1.0..3.0, 0.85..1.05),
    ];
    for (what, drive, delay, ratio) in cases {
        let (later_ms, other) = start(drive);
        println!("{what}: {:+.2} ms, {:.3}", later_ms - delay_ms, other / gain);
        assert!(
            delay.contains(&(later_ms - delay_ms)) && ratio.contains(&(other / gain)),
            "{what}: {later_ms} {other}"
        );
    }
}
