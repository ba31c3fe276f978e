//! The findings on sensors, supply, toe drive and temperature.

use super::finding::Finding;
use super::trial::{Bench, Trial, without_dry_friction};
use crate::estimate::Settings;
use crate::simulate::{Parameters, Sensor, Sensors, Waveform};
use crate::throw::{Direction, OutOfRange};

/// Sampling rates of loggers \[Hz\].
const RATES_HZ: [f64; 9] = [25.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0, 20_000.0];
/// Cut-off of the anti-alias filter as part of the sampling rate.
const CUT_OFF_SHARE: f64 = 0.4;

/// Number of phases of the mains at which the motor starts.
const PHASES: u32 = 8;

/// Samples of both channels.
#[derive(Clone, Copy, PartialEq)]
enum Samples {
    Raw,
    RawDeclaredAsFiltered,
    Filtered,
}

/// Effect of the sampling rate: raw samples, raw samples declared as filtered, and filtered samples.
pub(super) fn sampling(bench: &mut Bench) -> Result<Vec<Finding>, OutOfRange> {
    let mut table = |name, title, about, samples: Samples| {
        let row = |&rate: &f64| {
            let cut_off_hz = CUT_OFF_SHARE * rate;
            let anti_alias_hz = (samples == Samples::Filtered).then_some(cut_off_hz);
            let declared_hz = (samples != Samples::Raw).then_some(cut_off_hz);
            let sensors = Sensors { anti_alias_hz, ..Sensors::perfect(rate) };
            bench.row(format!("{rate}"), &Trial { sensors, declared_hz, ..Trial::default() })
        };
        let rows = RATES_HZ.iter().map(row).collect::<Result<_, _>>()?;
        Ok(Finding { name, title, about, label: "rate [Hz]", rows })
    };
    Ok(vec![
        table(
            "sampling_raw",
            "Raw samples",
            "Error against the true coefficients, without noise; the larger of both directions.",
            Samples::Raw,
        )?,
        table(
            "sampling_undeclared",
            "Raw samples, wrongly declared as filtered",
            "The same traces, but the message declares an anti-alias filter that does not exist.",
            Samples::RawDeclaredAsFiltered,
        )?,
        table(
            "sampling_filtered",
            "The same anti-alias filter in both channels",
            "4th-order Butterworth at 0.4 of the rate, declared; error against the true coefficients, without noise.",
            Samples::Filtered,
        )?,
    ])
}

/// Effect of a supply from rectified mains.
pub(super) fn mains(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let supply = Waveform::RectifiedMains { mains_hz: 50.0 };
    let machine = Parameters { supply, ..without_dry_friction() };
    let mut rows = Vec::new();
    let raw = [20_000.0, 1000.0, 500.0, 100.0].map(|rate| (rate, false));
    let filtered = [500.0, 200.0, 100.0, 50.0].map(|rate| (rate, true));
    for (rate, filtered) in raw.into_iter().chain(filtered) {
        let declared_hz = filtered.then_some(CUT_OFF_SHARE * rate);
        let sensors = Sensors { anti_alias_hz: declared_hz, ..Sensors::perfect(rate) };
        let label = format!("{rate} {}", if filtered { "filtered" } else { "raw" });
        let trial = Trial { machine: machine.clone(), sensors, declared_hz, phases: PHASES, ..Trial::default() };
        rows.push(bench.row(label, &trial)?);
    }
    Ok(Finding {
        name: "mains",
        title: "Rectified mains: a ripple of 100 Hz on the current",
        about: "Error against the true coefficients, without noise; the largest of both directions and eight phases of the mains.",
        label: "rate [Hz]",
        rows,
    })
}

/// Effect of a soft toe drive and of dry friction on the slide chairs.
pub(super) fn drive(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let mut rows = Vec::new();
    for drive_stiffness_n_m in [1e8, 2e7, 1e7, 5e6] {
        for slide_friction in [0.0, 0.05, 0.15, 0.3] {
            let mut machine = Parameters { drive_stiffness_n_m, ..Parameters::default() };
            machine.rails.slide_friction = slide_friction;
            let label = format!("{drive_stiffness_n_m:.0e}, {slide_friction}");
            rows.push(bench.row(label, &Trial { machine, ..Trial::default() })?);
        }
    }
    Ok(Finding {
        name: "drive",
        title: "A soft toe drive, and dry friction on the slide chairs",
        about: "Error against the true coefficients, where dry friction counts as viscous friction of the same torque at running \
                speed; without noise, the larger of both directions.",
        label: "stiffness [N/m], mu",
        rows,
    })
}

/// Effect of the noise of the sensors: compares the standard deviations that the estimator states with those observed
/// in `throws` throws.
pub(super) fn noise(bench: &mut Bench, throws: usize) -> Result<Finding, OutOfRange> {
    let mut rows = Vec::new();
    for (current_a, position_mm) in
        [(0.005, 0.02), (0.02, 0.02), (0.05, 0.02), (0.02, 0.1), (0.02, 0.2), (0.1, 0.1), (0.2, 0.2)]
    {
        let mut sensors = Sensors::default();
        sensors.current.noise = current_a;
        sensors.position.noise = position_mm;
        let settings = Settings { current_noise_a: current_a, position_noise_mm: position_mm, ..Settings::default() };
        let label = format!("{:.0}, {:.0}", current_a * 1000.0, position_mm * 1000.0);
        rows.push(bench.row(label, &Trial { sensors, settings, repeats: throws.div_ceil(2), ..Trial::default() })?);
    }
    Ok(Finding {
        name: "noise",
        title: "Noise of the sensors, at 1 kHz",
        about: "Mean error ± observed standard deviation (standard deviation that the estimator states).",
        label: "current [mA], position [um]",
        rows,
    })
}

/// Effect of an offset of the current sensor, with and without quiet samples before the start of the motor.
pub(super) fn offset(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let mut rows = Vec::new();
    for before_s in [0.2, 0.01, 0.0] {
        for offset in [-0.15, 0.05, 0.15] {
            let perfect = Sensors::perfect(1000.0);
            let sensors = Sensors { before_s, current: Sensor { offset, ..perfect.current }, ..perfect };
            let label = format!("{offset:+.2} A, {:.0} ms", before_s * 1000.0);
            rows.push(bench.row(label, &Trial { sensors, ..Trial::default() })?);
        }
    }
    Ok(Finding {
        name: "offset",
        title: "Offset of the current sensor",
        about: "Error against the true coefficients, without noise; the larger of both directions. Quiet samples before the motor's \
                start show the offset.",
        label: "offset, quiet samples",
        rows,
    })
}

/// Effect of a wrong neutral position.
pub(super) fn neutral(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let mut rows = Vec::new();
    for neutral_mm in [0.0, 57.5, 115.0] {
        for believed_mm in [0.0, 57.5, 115.0] {
            for direction in Direction::BOTH {
                let machine = Parameters { neutral_mm, ..without_dry_friction() };
                let settings = Settings { neutral_mm: believed_mm, ..Settings::default() };
                let way = if direction == Direction::NormalToReverse { "N to R" } else { "R to N" };
                let label = format!("{neutral_mm}, {believed_mm}, {way}");
                let directions = vec![direction];
                rows.push(bench.row(label, &Trial { machine, settings, directions, ..Trial::default() })?);
            }
        }
    }
    Ok(Finding {
        name: "neutral",
        title: "Neutral position of the rails",
        about: "Error against the true coefficients, without noise.",
        label: "true [mm], configured [mm], direction",
        rows,
    })
}

/// Effect of the resolution of the converters.
pub(super) fn converters(bench: &mut Bench, throws: usize) -> Result<Finding, OutOfRange> {
    let mut rows = Vec::new();
    for (bits, noise) in [(10, 0.02), (12, 0.02), (12, 0.0), (16, 0.02), (16, 0.0)] {
        let channel =
            |full_scale| Sensor { noise, full_scale: Some(full_scale), bits: Some(bits), ..Sensor::default() };
        let sensors = Sensors { current: channel(20.0), position: channel(150.0), ..Sensors::default() };
        let noisy = if noise > 0.0 { "20 mA, 20 um" } else { "none" };
        let label = format!("{bits}, {noisy}");
        rows.push(bench.row(label, &Trial { sensors, repeats: throws.div_ceil(2), ..Trial::default() })?);
    }
    Ok(Finding {
        name: "converters",
        title: "Converters of 10 to 16 bit over ±20 A and ±150 mm",
        about: "Mean error ± observed standard deviation (standard deviation that the estimator states).",
        label: "bits, noise",
        rows,
    })
}

/// Effect of temperature on a healthy machine.
pub(super) fn temperature(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let reference = Some(Parameters::default().coefficients()?.values());
    let rows = [-20.0, 0.0, 10.0, 20.0, 30.0, 50.0]
        .map(|temperature_c| {
            let machine = Parameters::default();
            bench.row(format!("{temperature_c}"), &Trial { machine, temperature_c, reference, ..Trial::default() })
        })
        .into_iter()
        .collect::<Result<_, _>>()?;
    Ok(Finding {
        name: "temperature",
        title: "Temperature of a healthy machine",
        about: "Estimates against the true coefficients at 20 °C, without noise; the larger of both directions.",
        label: "temperature [°C]",
        rows,
    })
}
