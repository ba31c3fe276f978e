//! The findings on sensors, supply, toe drive, load and temperature.

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

/// Loads against the movement, simulated as dry friction of the screw \[N m\].
const LOADS_NM: [f64; 5] = [0.0, 0.2, 0.5, 1.0, 2.0];

/// Samples of both channels.
#[derive(Clone, Copy, PartialEq)]
enum Samples {
    Raw,
    RawDeclaredAsFiltered,
    Filtered,
}

/// The table of labelled cases, computed in their order.
fn table(
    bench: &mut Bench,
    [name, title, about, label]: [&'static str; 4],
    cases: impl IntoIterator<Item = (String, Trial)>,
) -> Result<Finding, OutOfRange> {
    let rows = cases.into_iter().map(|(label, trial)| bench.row(label, &trial)).collect::<Result<_, _>>()?;
    Ok(Finding { name, title, about, label, rows })
}

/// Effect of the sampling rate: raw samples, raw samples declared as filtered, and filtered samples.
pub(super) fn sampling(bench: &mut Bench) -> Result<Vec<Finding>, OutOfRange> {
    let mut at_rates = |name, title, about, samples: Samples| {
        let cases = RATES_HZ.map(|rate| {
            let cut_off_hz = CUT_OFF_SHARE * rate;
            let anti_alias_hz = (samples == Samples::Filtered).then_some(cut_off_hz);
            let declared_hz = (samples != Samples::Raw).then_some(cut_off_hz);
            let sensors = Sensors { anti_alias_hz, ..Sensors::perfect(rate) };
            (format!("{rate}"), Trial { sensors, declared_hz, ..Trial::default() })
        });
        table(bench, [name, title, about, "rate [Hz]"], cases)
    };
    Ok(vec![
        at_rates(
            "sampling_raw",
            "Raw samples",
            "Error against the true coefficients, without noise; the larger of both directions.",
            Samples::Raw,
        )?,
        at_rates(
            "sampling_undeclared",
            "Raw samples, wrongly declared as filtered",
            "The same traces, but the message declares an anti-alias filter that does not exist.",
            Samples::RawDeclaredAsFiltered,
        )?,
        at_rates(
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
    let raw = [20_000.0, 1000.0, 500.0, 100.0].map(|rate| (rate, false));
    let filtered = [500.0, 200.0, 100.0, 50.0].map(|rate| (rate, true));
    let cases = raw.into_iter().chain(filtered).map(|(rate, filtered)| {
        let machine = Parameters { supply, ..without_dry_friction() };
        let declared_hz = filtered.then_some(CUT_OFF_SHARE * rate);
        let sensors = Sensors { anti_alias_hz: declared_hz, ..Sensors::perfect(rate) };
        let label = format!("{rate} {}", if filtered { "filtered" } else { "raw" });
        (label, Trial { machine, sensors, declared_hz, phases: PHASES, ..Trial::default() })
    });
    let texts = [
        "mains",
        "Rectified mains: a ripple of 100 Hz on the current",
        "Error against the true coefficients, without noise; the largest of both directions and eight phases of the mains.",
        "rate [Hz]",
    ];
    table(bench, texts, cases)
}

/// Effect of a soft toe drive and of dry friction on the slide chairs.
pub(super) fn drive(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let drives = [1e8, 2e7, 1e7, 5e6].into_iter().flat_map(|drive| [0.0, 0.05, 0.15, 0.3].map(|mu| (drive, mu)));
    let cases = drives.map(|(drive_stiffness_n_m, slide_friction)| {
        let mut machine = Parameters { drive_stiffness_n_m, ..Parameters::default() };
        machine.rails.slide_friction = slide_friction;
        (format!("{drive_stiffness_n_m:.0e}, {slide_friction}"), Trial { machine, ..Trial::default() })
    });
    let texts = [
        "drive",
        "A soft toe drive, and dry friction on the slide chairs",
        "Error against the true coefficients, where dry friction counts as viscous friction of the same torque at running \
         speed; without noise, the larger of both directions.",
        "stiffness [N/m], mu",
    ];
    table(bench, texts, cases)
}

/// Effect of a constant load on the three coefficients.
pub(super) fn load(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let known = without_dry_friction().coefficients()?;
    let reference = Some(known.values());
    let mut cases = Vec::new();
    for screw_dry_nm in LOADS_NM {
        let machine = Parameters { screw_dry_nm, ..without_dry_friction() };
        let speed = machine.coefficients()?.running_speed_rad_s;
        let as_friction_pct = screw_dry_nm / speed / known.inertia_kg_m2 / known.a1 * 100.0;
        let label = format!("{screw_dry_nm}, {as_friction_pct:+.1} %");
        cases.push((label, Trial { machine, reference, ..Trial::default() }));
    }
    let texts = [
        "load",
        "A constant load torque looks like friction",
        "Change of the estimates from those without load, without noise; the larger of both directions.",
        "load [N m on the screw], in a1 at running speed",
    ];
    table(bench, texts, cases)
}

/// Effect of the noise of the sensors: compares the standard deviations that the estimator states with those observed
/// in `throws` throws.
pub(super) fn noise(bench: &mut Bench, throws: usize) -> Result<Finding, OutOfRange> {
    let noises = [(0.005, 0.02), (0.02, 0.02), (0.05, 0.02), (0.02, 0.1), (0.02, 0.2), (0.1, 0.1), (0.2, 0.2)];
    let cases = noises.map(|(current_noise_a, position_noise_mm)| {
        let mut sensors = Sensors::default();
        sensors.current.noise = current_noise_a;
        sensors.position.noise = position_noise_mm;
        let settings = Settings { current_noise_a, position_noise_mm, ..Settings::default() };
        let label = format!("{:.0}, {:.0}", current_noise_a * 1000.0, position_noise_mm * 1000.0);
        (label, Trial { sensors, settings, repeats: throws.div_ceil(2), ..Trial::default() })
    });
    let texts = [
        "noise",
        "Noise of the sensors, at 1 kHz",
        "Mean error ± observed standard deviation (standard deviation that the estimator states).",
        "current [mA], position [um]",
    ];
    table(bench, texts, cases)
}

/// Effect of an offset of the current sensor, with and without quiet samples before the start of the motor.
pub(super) fn offset(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let offsets = [0.2, 0.01, 0.0].into_iter().flat_map(|before_s| [-0.15, 0.05, 0.15].map(|a| (before_s, a)));
    let cases = offsets.map(|(before_s, offset)| {
        let perfect = Sensors::perfect(1000.0);
        let sensors = Sensors { before_s, current: Sensor { offset, ..perfect.current }, ..perfect };
        (format!("{offset:+.2} A, {:.0} ms", before_s * 1000.0), Trial { sensors, ..Trial::default() })
    });
    let texts = [
        "offset",
        "Offset of the current sensor",
        "Error against the true coefficients, without noise; the larger of both directions. Quiet samples before the motor's \
         start show the offset.",
        "offset, quiet samples",
    ];
    table(bench, texts, cases)
}

/// Effect of a wrong neutral position.
pub(super) fn neutral(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let mut cases = Vec::new();
    for neutral_mm in [0.0, 57.5, 115.0] {
        for believed_mm in [0.0, 57.5, 115.0] {
            for direction in Direction::BOTH {
                let machine = Parameters { neutral_mm, ..without_dry_friction() };
                let settings = Settings { neutral_mm: believed_mm, ..Settings::default() };
                let way = if direction == Direction::NormalToReverse { "N to R" } else { "R to N" };
                let trial = Trial { machine, settings, directions: vec![direction], ..Trial::default() };
                cases.push((format!("{neutral_mm}, {believed_mm}, {way}"), trial));
            }
        }
    }
    let texts = [
        "neutral",
        "Neutral position of the rails",
        "Error against the true coefficients, without noise.",
        "true [mm], configured [mm], direction",
    ];
    table(bench, texts, cases)
}

/// Effect of the resolution of the converters.
pub(super) fn converters(bench: &mut Bench, throws: usize) -> Result<Finding, OutOfRange> {
    let cases = [(10, 0.02), (12, 0.02), (12, 0.0), (16, 0.02), (16, 0.0)].map(|(bits, noise)| {
        let channel =
            |full_scale| Sensor { noise, full_scale: Some(full_scale), bits: Some(bits), ..Sensor::default() };
        let sensors = Sensors { current: channel(20.0), position: channel(150.0), ..Sensors::default() };
        let noisy = if noise > 0.0 { "20 mA, 20 um" } else { "none" };
        (format!("{bits}, {noisy}"), Trial { sensors, repeats: throws.div_ceil(2), ..Trial::default() })
    });
    let texts = [
        "converters",
        "Converters of 10 to 16 bit over ±20 A and ±150 mm",
        "Mean error ± observed standard deviation (standard deviation that the estimator states).",
        "bits, noise",
    ];
    table(bench, texts, cases)
}

/// Effect of temperature on a healthy machine.
pub(super) fn temperature(bench: &mut Bench) -> Result<Finding, OutOfRange> {
    let reference = Some(Parameters::default().coefficients()?.values());
    let cases = [-20.0, 0.0, 10.0, 20.0, 30.0, 50.0].map(|temperature_c| {
        let machine = Parameters::default();
        (format!("{temperature_c}"), Trial { machine, temperature_c, reference, ..Trial::default() })
    });
    let texts = [
        "temperature",
        "Temperature of a healthy machine",
        "Estimates against the true coefficients at 20 °C, without noise; the larger of both directions.",
        "temperature [°C]",
    ];
    table(bench, texts, cases)
}
