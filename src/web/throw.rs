//! `/machines/{site}/{machine}/throws/{boot_id}/{throw_no}`: one throw with its trace, the identified model and a
//! typical throw of the baseline; and the trace as CSV.

use std::{iter, sync::Arc};

use askama::Template;
use axum::{
    extract::{Path, State, rejection::PathRejection},
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};

use super::{
    guard,
    machine::{Row, row},
    overview::Web,
    page::{self, Failure},
    trend::{self, Curve, Picture},
};
use crate::{
    estimate::{self, Motor},
    store::{Reader, StoredThrow},
    throw::{MachineId, Name, Throw, ThrowRef, Trace, brief, utc},
    wire::Health,
};

/// Largest number of baselines read; the newest of each direction is among them.
const BASELINES: u32 = 8;

#[derive(Template)]
#[template(path = "throw.html", config = "src/web/askama.toml")]
struct Page {
    trouble: Vec<String>,
    machine: MachineId,
    boot_id: String,
    throw_no: u64,
    at: String,
    received_at: String,
    before: Option<String>,
    after: Option<String>,
    /// `None` while the throw is pending.
    judged: Option<Row>,
    coefficients: Option<[String; 3]>,
    /// Names and values of the ratios of the coefficients and of the motor's constants, as far as they are known.
    measured: Vec<(&'static str, String)>,
    temperature: Option<String>,
    supply: Option<String>,
    pictures: Vec<Picture>,
    /// Address and number of the typical throw.
    typical: Option<(String, u64)>,
    /// Address of the trace as CSV.
    csv: Option<String>,
    /// Reason why there is no trace.
    no_trace: Option<String>,
}

type Names = Result<Path<(Name, Name, String, String)>, PathRejection>;

/// Parses machine and throw from the parts of an address.
fn parse_names(names: Names) -> Result<(MachineId, ThrowRef), Failure> {
    let Path((site, machine, boot_id, throw_no)) = names?;
    let wrong = |_| Failure::bad_request("The address must end in the number of the throw.");
    Ok((MachineId { site, machine }, ThrowRef { boot_id, throw_no: throw_no.parse().map_err(wrong)? }))
}

/// Reads a throw and, once it is judged, its health.
async fn found(
    reader: &Reader,
    machine: &MachineId,
    throw: &ThrowRef,
) -> Result<(StoredThrow, Option<Health>), Failure> {
    let found = reader.throw_of(machine, throw).await?;
    found.ok_or_else(|| Failure::not_found(format!("{machine} has no such throw in this database.")))
}

pub(super) async fn page(State(web): State<Arc<Web>>, names: Names) -> Result<Response, Failure> {
    let (machine, throw) = parse_names(names)?;
    let trouble = web.trouble().await;
    let _permit = web.read_permit().await?;
    let reader = web.reader();
    let (stored, health) = found(reader, &machine, &throw).await?;
    let [before, after] = reader.neighbours_of(&machine, &throw).await?;
    let typical = typical(&web, &machine, &throw, health.as_ref()).await?;
    let config = web.view.config();
    let address = |throw: ThrowRef| page::throw_address(&machine, &throw);
    let (pictures, csv, no_trace) = match &stored.throw {
        Ok(throw) => {
            let typical = typical.as_ref().and_then(|typical| Some(&typical.throw.as_ref().ok()?.trace));
            let csv = format!("{}/trace.csv", page::throw_address(&machine, &stored.id));
            (pictures(throw, health.as_ref(), typical, config.machines.of(&machine)), Some(csv), None)
        }
        Err(unreadable) => (Vec::new(), None, Some(unreadable.to_string())),
    };
    let motor = reader.motor_of(stored.row).await?;
    let measured = stored.throw.as_ref().ok();
    Ok(page::html(&Page {
        trouble,
        boot_id: stored.id.boot_id.clone(),
        throw_no: stored.id.throw_no,
        at: utc(&stored.started_at),
        received_at: utc(&stored.received_at),
        before: before.map(address),
        after: after.map(address),
        judged: health.as_ref().map(row),
        coefficients: health.as_ref().and_then(coefficients),
        measured: health.as_ref().map(|health| constants(health, motor)).unwrap_or_default(),
        temperature: measured.and_then(|throw| throw.temperature_c).map(|celsius| measured_text(celsius, "°C")),
        supply: measured.and_then(|throw| throw.supply_v).map(|volts| measured_text(volts, "V")),
        pictures,
        typical: typical.map(|typical| (address(typical.id.clone()), typical.id.throw_no)),
        csv,
        no_trace,
        machine: stored.machine,
    }))
}

/// A measured value with its unit. An impossible value, as 1e300, is shortened: it would have 301 digits.
fn measured_text(value: f64, unit: &str) -> String {
    if value.abs() < 1e6 { format!("{value:.1} {unit}") } else { format!("{} {unit}", brief(value)) }
}

/// Reads a good throw of the same direction, made when the newest baseline was learned.
async fn typical(
    web: &Web,
    machine: &MachineId,
    throw: &ThrowRef,
    health: Option<&Health>,
) -> Result<Option<StoredThrow>, Failure> {
    let Some(direction) = health.and_then(|health| health.direction) else { return Ok(None) };
    let reader = web.reader();
    let baselines = reader.baselines_of(machine, BASELINES).await?;
    let Some(baseline) = baselines.iter().find(|baseline| baseline.direction == direction) else { return Ok(None) };
    let found = reader.typical_of(machine, direction, baseline.taken_at).await?;
    let Some(found) = found.filter(|found| found != throw) else { return Ok(None) };
    Ok(reader.throw_of(machine, &found).await?.map(|(stored, _)| stored))
}

/// The response with the trace as CSV, in the columns that `pointsd identify` and `pointsd import` read.
pub(super) async fn csv(State(web): State<Arc<Web>>, names: Names) -> Result<Response, Failure> {
    let (machine, throw) = parse_names(names)?;
    let _permit = web.read_permit().await?;
    let (stored, _) = found(web.reader(), &machine, &throw).await?;
    let throw = stored.throw.map_err(|unreadable| Failure::not_found(format!("There is no trace: {unreadable}.")))?;
    let trace = throw.trace.clone();
    // This takes too long for an async worker.
    let text = tokio::task::spawn_blocking(move || trace.to_csv()).await.map_err(|_| Failure::busy())?;
    if text.len() > guard::LARGEST {
        let message = format!(
            "The trace of {} samples is too large for a page. Write it to a file with: pointsd export {machine} --traces DIR",
            throw.trace.len()
        );
        return Err(Failure::new(StatusCode::PAYLOAD_TOO_LARGE, message));
    }
    let kind = HeaderValue::from_static("text/csv; charset=utf-8");
    Ok(([(header::CONTENT_TYPE, kind)], text).into_response())
}

/// The charts: current and position, both with the typical throw; current without the inrush; position and model; and
/// their difference.
fn pictures(
    throw: &Throw,
    health: Option<&Health>,
    typical: Option<&Trace>,
    settings: &estimate::Settings,
) -> Vec<Picture> {
    let trace = &throw.trace;
    let both = |title: &str, unit: &str, caption: String, of: &dyn Fn(&Trace) -> Vec<f64>| {
        let named = iter::once(("this throw", trace)).chain(typical.map(|trace| ("baseline", trace)));
        let curves = named.map(|(name, trace)| Curve { name, rate_hz: trace.sample_rate_hz(), values: of(trace) });
        trend::over_time(title, unit, curves, caption)
    };
    let whole = |title: &str, unit: &str, of: fn(&Trace) -> &[f64]| {
        both(title, unit, trend::caption(title, trace), &|trace| of(trace).to_vec())
    };
    let mut pictures = vec![whole("Motor current", "A", Trace::current_a)];
    let peak = trace.current_a().iter().fold(0.0_f64, |peak, current| peak.max(current.abs()));
    let running = health.and_then(|health| health.mean_current_a).filter(|mean| peak > 2.0 * mean);
    if let Some(mean) = running {
        let cut = |trace: &Trace| trace.current_a().iter().map(|it| it.clamp(-2.0 * mean, 2.0 * mean)).collect();
        let caption =
            format!("The running current: the inrush is cut off at twice the mean current, {:.1} A.", 2.0 * mean);
        pictures.push(both("Running current", "A", caption, &cut));
    }
    if !trace.has_position() {
        return pictures;
    }
    pictures.push(whole("Toe position from normal", "mm", Trace::position_mm));
    let identified = health.and_then(|health| health.coefficients.zip(health.duration_s));
    if let Some(model) = identified.map(|(of, duration_s)| modelled_mm(trace, of, duration_s, settings)) {
        let curve = |name, values| Curve { name, rate_hz: trace.sample_rate_hz(), values };
        let measured = &trace.position_mm()[..model.len()];
        let difference = measured.iter().zip(&model).map(|(measured, model)| measured - model).collect();
        let caption = "Measured position, and position of the model with the coefficients of this throw, driven by its \
                    current, while the motor runs.";
        let curves = [curve("measured", measured.to_vec()), curve("model", model)];
        pictures.push(trend::over_time("Position and model", "mm", curves, caption.to_owned()));
        let caption = "Measured minus modelled position.".to_owned();
        pictures.push(trend::over_time("Residual", "mm", [curve("", difference)], caption));
    }
    pictures
}

/// Least current of a running motor, as share of the peak current: far above the noise, far below the inrush.
const RUNNING_SHARE: f64 = 0.05;

/// The position of the model with these coefficients \[mm\]. The model is at rest until the motor starts, and is then
/// driven by the measured current for `duration_s`. It is integrated by the midpoint rule.
fn modelled_mm(trace: &Trace, [b0, a1, a0]: [f64; 3], duration_s: f64, settings: &estimate::Settings) -> Vec<f64> {
    let (current, position) = (trace.current_a(), trace.position_mm());
    let peak = current.iter().copied().fold(0.0_f64, |peak, it| if it.abs() > peak.abs() { it } else { peak });
    let start = current.iter().position(|it| it.abs() > RUNNING_SHARE * peak.abs()).unwrap_or(0);
    let (step_s, mm_per_rad) = (trace.sample_rate_hz().recip(), settings.lead_mm / std::f64::consts::TAU);
    let within =
        current.iter().enumerate().skip(start).take_while(|(at, _)| (at - start) as f64 * step_s <= duration_s);
    let end = within.last().map_or(start, |(at, _)| at + 1);
    let neutral_rad = settings.neutral_mm / mm_per_rad;
    let sign = if position[end.saturating_sub(1)] < position[0] { -1.0 } else { 1.0 };
    // The inrush has the sign of the driving current; a current of the other sign brakes.
    let drive = |current: f64| {
        let forward = current * peak.signum();
        if settings.motor == Motor::Series { forward * forward.abs() } else { forward }
    };
    let acceleration = |current: f64| {
        move |[angle, speed]: [f64; 2]| sign * b0 * drive(current) - a1 * speed - a0 * (angle - neutral_rad)
    };
    let mut state = [position[start] / mm_per_rad, 0.0];
    let mut model = vec![position[start]; start + 1];
    for [before, after] in current[start..end].array_windows() {
        state = estimate::midpoint(state, step_s, acceleration(*before), acceleration(0.5 * (before + after)));
        model.push(state[0] * mm_per_rad);
    }
    model
}

/// Each coefficient ± two standard deviations, both rounded to two digits of the deviation.
fn coefficients(health: &Health) -> Option<[String; 3]> {
    let (values, sd) = (health.coefficients?, health.sd?);
    Some([0, 1, 2].map(|at| rounded(values[at], 2.0 * sd[at])))
}

/// The ratios ± two standard deviations, and resistance, back-EMF constant and no-load speed.
fn constants(health: &Health, motor: [Option<f64>; 3]) -> Vec<(&'static str, String)> {
    let ratio = |value: Option<f64>, sd: Option<f64>| value.zip(sd).map(|(value, sd)| rounded(value, 2.0 * sd));
    let names = ["resistance (Ω)", "back-EMF constant (V s/rad)", "no-load speed (rad/s)"];
    let ratios = [
        ("friction per motor, a1/b0 (A s/rad)", ratio(health.a1_per_b0, health.a1_per_b0_sd)),
        ("stiffness per motor, a0/b0 (A/rad)", ratio(health.a0_per_b0, health.a0_per_b0_sd)),
    ];
    let motor = names.into_iter().zip(motor).map(|(name, value)| (name, value.map(three_digits)));
    ratios.into_iter().chain(motor).filter_map(|(name, value)| Some((name, value?))).collect()
}

/// A constant of the motor with three digits, as it scatters by about 1 % from throw to throw.
fn three_digits(value: f64) -> String {
    format!("{value:.0$}", decimals(value.abs(), 99.5))
}

/// A value ± `reach`, both rounded to two digits of `reach`.
fn rounded(value: f64, reach: f64) -> String {
    let decimals = decimals(reach, 9.95);
    format!("{value:.decimals$} ± {reach:.decimals$}").replace('-', "−")
}

/// Number of decimals, at most 9, with which `value` has two significant digits (`least` = 9.95), or three (99.5).
fn decimals(value: f64, least: f64) -> usize {
    let enough = |decimals: &u8| value * 10.0_f64.powi(i32::from(*decimals)) >= least;
    usize::from((0..9).find(enough).unwrap_or(9))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_of_the_motor_has_three_digits() {
        assert_eq!([0.8961, 4.139, 170.2, 1520.0].map(three_digits), ["0.896", "4.14", "170", "1520"]);
    }

    #[test]
    fn a_coefficient_has_the_digits_that_are_known() {
        assert_eq!(rounded(204.755, 1.9957), "204.8 ± 2.0");
        assert_eq!(rounded(-1.6769, 0.0151), "−1.677 ± 0.015");
        assert_eq!(rounded(204.755, 37.0), "205 ± 37");
        assert_eq!(rounded(1.0, 0.0), "1.000000000 ± 0.000000000");
    }
}
