//! `/machines/{site}/{machine}/throws/{boot_id}/{throw_no}`: one throw with its trace, the identified model and a
//! typical throw of the baseline; and the trace as CSV.

use std::{iter, sync::Arc};

use askama::Template;
use axum::{
    extract::{Path, State, rejection::PathRejection},
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};

use super::{
    overview::Web,
    page::{self, Failure},
    state,
    trend::{self, Curve, Picture},
};
use crate::{
    estimate::{self, modelled_position_mm},
    store::{Reader, StoredThrow},
    throw::{MachineId, Name, Throw, ThrowRef, Trace, brief},
    wire::Health,
};

/// Largest trace as CSV \[bytes\]. Only a throw of some minutes has a larger one.
const LARGEST_CSV: usize = 16 << 20;
/// Largest number of baselines read; the newest of each direction is usually among them.
const BASELINES: u32 = 8;

#[derive(Template)]
#[template(path = "throw.html", config = "src/web/askama.toml")]
struct Page {
    trouble: Vec<String>,
    stored: StoredThrow,
    /// `None` while the throw is pending.
    health: Option<Health>,
    before: Option<ThrowRef>,
    after: Option<ThrowRef>,
    /// Names and values of the ratios of the coefficients and of the motor's constants, as far as they are known.
    measured: Vec<(&'static str, String)>,
    pictures: Vec<Picture>,
    /// A typical throw of the baseline.
    typical: Option<StoredThrow>,
}

impl Page {
    /// The address of a throw of this machine.
    fn address(&self, throw: &ThrowRef) -> String {
        page::throw_address(&self.stored.machine, throw)
    }

    /// Temperature and supply voltage, if they were measured. An impossible value, as 1e300, is shortened: it would have
    /// 301 digits.
    fn conditions(&self) -> Vec<(&'static str, String)> {
        let throw = self.stored.throw.as_ref().ok();
        let values = [
            ("temperature", "°C", throw.and_then(|throw| throw.temperature_c)),
            ("supply", "V", throw.and_then(|throw| throw.supply_v)),
        ];
        let text = |value: f64| if value.abs() < 1e6 { format!("{value:.1}") } else { brief(value) };
        values.into_iter().filter_map(|(name, unit, value)| Some((name, format!("{} {unit}", text(value?))))).collect()
    }

    /// Each coefficient ± two standard deviations, with its change from the baseline; empty without coefficients.
    fn coefficients(&self) -> Vec<(&'static str, String, String)> {
        let Some(health) = &self.health else { return Vec::new() };
        let (Some(values), Some(sd)) = (health.coefficients, health.sd) else { return Vec::new() };
        let change = |at: usize| {
            let change = health.change_pct.map(|change| format!("{} %", state::signed(change[at], 1)));
            change.unwrap_or_else(|| "not compared with a baseline".to_owned())
        };
        let names = ["b0, motor (rad/s² per A)", "a1, friction (1/s)", "a0, stiffness (1/s²)"];
        (0..3).map(|at| (names[at], rounded(values[at], 2.0 * sd[at]), change(at))).collect()
    }
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
    if let Some(found) = reader.throw_of(machine, throw).await? {
        return Ok(found);
    }
    let ThrowRef { boot_id, throw_no } = throw;
    Err(match reader.is_pruned(machine, throw).await? {
        Some(true) => Failure::new(
            StatusCode::GONE,
            format!(
                "Throw {throw_no} of {machine} is not in this database: to save space, retention has deleted the throws \
                 of boot {boot_id} up to it."
            ),
        ),
        Some(false) => Failure::not_found(format!("{machine} has no such throw in this database.")),
        None => Failure::not_found(format!(
            "{machine} has no such throw in this database: none was received, or retention has deleted all throws of \
             boot {boot_id}."
        )),
    })
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
    let pictures = stored.throw.as_ref().map_or_else(
        |_| Vec::new(),
        |throw| {
            let typical = typical.as_ref().and_then(|typical| Some(&typical.throw.as_ref().ok()?.trace));
            pictures(throw, health.as_ref(), typical, config.machines.of(&machine))
        },
    );
    let motor = reader.motor_of(stored.row).await?;
    let measured = health.as_ref().map(|health| constants(health, motor)).unwrap_or_default();
    Ok(page::html(&Page { trouble, stored, health, before, after, measured, pictures, typical }))
}

/// Reads a typical throw of the same direction, made when the newest baseline was learned.
async fn typical(
    web: &Web,
    machine: &MachineId,
    throw: &ThrowRef,
    health: Option<&Health>,
) -> Result<Option<StoredThrow>, Failure> {
    let Some(direction) = health.and_then(|health| health.direction) else { return Ok(None) };
    let reader = web.reader();
    let baselines = reader.baselines_of(machine, BASELINES).await?;
    let Some(baseline) = trend::newest(&baselines, direction) else { return Ok(None) };
    Ok(reader.typical_of(machine, direction, baseline.taken_at).await?.filter(|typical| typical.id != *throw))
}

/// The response with the trace as CSV, in the columns that `pointsd identify` and `pointsd import` read.
pub(super) async fn csv(State(web): State<Arc<Web>>, names: Names) -> Result<Response, Failure> {
    let (machine, throw) = parse_names(names)?;
    let _permit = web.read_permit().await?;
    let (stored, _) = found(web.reader(), &machine, &throw).await?;
    let throw = stored.throw.map_err(|unreadable| Failure::not_found(format!("There is no trace: {unreadable}.")))?;
    let trace = throw.trace.clone();
    // This takes too long for an async worker.
    let written = tokio::task::spawn_blocking(move || bounded(trace.csv_lines(), LARGEST_CSV));
    let text = written.await.map_err(|_| Failure::busy())?.ok_or_else(|| {
        let message = format!(
            "The trace of {} samples is too large for a page. Write it to a file with: pointsd export {machine} --traces DIR",
            throw.trace.len()
        );
        Failure::new(StatusCode::PAYLOAD_TOO_LARGE, message)
    })?;
    Ok(([(header::CONTENT_TYPE, "text/csv; charset=utf-8")], text).into_response())
}

/// The lines as one text; `None` if they have more than `largest` bytes. The lines after this size are not made.
fn bounded(lines: impl Iterator<Item = String>, largest: usize) -> Option<String> {
    let mut text = String::new();
    for line in lines {
        text.push_str(&line);
        if text.len() > largest {
            return None;
        }
    }
    Some(text)
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
    if let Some(model) = identified.map(|(of, duration_s)| modelled_position_mm(trace, of, duration_s, settings)) {
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
    fn a_text_ends_at_its_largest_size() {
        let mut made = 0;
        let lines = std::iter::repeat_with(|| {
            made += 1;
            "four".to_owned()
        });
        assert_eq!(bounded(lines, 10), None);
        assert_eq!(made, 3);
        assert_eq!(bounded(["ab".to_owned(), "cd".to_owned()].into_iter(), 4).as_deref(), Some("abcd"));
    }

    #[test]
    fn a_coefficient_has_the_digits_that_are_known() {
        assert_eq!(rounded(204.755, 1.9957), "204.8 ± 2.0");
        assert_eq!(rounded(-1.6769, 0.0151), "−1.677 ± 0.015");
        assert_eq!(rounded(204.755, 37.0), "205 ± 37");
        assert_eq!(rounded(1.0, 0.0), "1.000000000 ± 0.000000000");
    }
}
