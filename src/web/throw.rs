//! `/machines/{site}/{machine}/throws/{boot_id}/{throw_no}`: one throw, with its trace while that is kept.

use std::sync::Arc;

use askama::Template;
use axum::{
    extract::{Path, State, rejection::PathRejection},
    response::Response,
};

use super::{
    Web,
    machine::{Row, known_name, row},
    page::{self, Failure},
    trend::{self, Picture},
};
use crate::{
    store::{HealthRow, StoredThrow},
    throw::{MachineId, ThrowRef},
};

#[derive(Template)]
#[template(path = "throw.html", config = "src/web/askama.toml")]
struct Page {
    trouble: Vec<String>,
    machine: MachineId,
    boot_id: String,
    throw_no: u64,
    at: String,
    received_at: String,
    /// `None` while it waits to be judged.
    judged: Option<Row>,
    coefficients: Option<[String; 3]>,
    temperature: Option<String>,
    pictures: Vec<Picture>,
    /// Why there is no trace.
    no_trace: Option<String>,
}

pub(super) async fn page(
    State(web): State<Arc<Web>>,
    path: Result<Path<(String, String, String, String)>, PathRejection>,
) -> Result<Response, Failure> {
    let Path((site, machine, boot_id, throw_no)) = path?;
    let machine = known_name(&site, &machine)?;
    let wrong = |_| Failure::bad_request("The address must end in the number of the throw.");
    let throw_no = throw_no.parse().map_err(wrong)?;
    let trouble = web.trouble().await;
    let _turn = web.turn().await?;
    let found = web.view.reader().throw_of(&machine, &ThrowRef { boot_id, throw_no }).await?;
    let (stored, health) = found.ok_or_else(|| Failure::not_found(format!("{machine} has no such throw here.")))?;
    Ok(page::html(&shown(trouble, stored, health.as_ref())))
}

fn shown(trouble: Vec<String>, stored: StoredThrow, health: Option<&HealthRow>) -> Page {
    let (pictures, no_trace) = match &stored.throw {
        Ok(throw) => (trend::trace(&throw.trace).into(), None),
        Err(unreadable) => (Vec::new(), Some(unreadable.to_string())),
    };
    let temperature = stored.throw.as_ref().ok().and_then(|throw| throw.temperature_c);
    Page {
        trouble,
        machine: stored.machine,
        boot_id: stored.id.boot_id,
        throw_no: stored.id.throw_no,
        at: page::time(stored.started_at),
        received_at: page::time(stored.received_at),
        judged: health.map(row),
        coefficients: health.and_then(coefficients),
        temperature: temperature.map(|celsius| format!("{celsius:.1} °C")),
        pictures,
        no_trace,
    }
}

/// Each coefficient with two standard deviations, to the second digit of these.
fn coefficients(health: &HealthRow) -> Option<[String; 3]> {
    let (values, sd) = (health.coefficients?, health.sd?);
    Some([0, 1, 2].map(|at| rounded(values[at], 2.0 * sd[at])))
}

fn rounded(value: f64, reach: f64) -> String {
    let enough = |decimals: &u8| reach * 10.0_f64.powi(i32::from(*decimals)) >= 9.95;
    let decimals = usize::from((0..9).find(enough).unwrap_or(9));
    format!("{value:.decimals$} ± {reach:.decimals$}").replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coefficient_has_the_digits_that_are_known() {
        assert_eq!(rounded(204.755, 1.9957), "204.8 ± 2.0");
        assert_eq!(rounded(-1.6769, 0.0151), "−1.677 ± 0.015");
        assert_eq!(rounded(204.755, 37.0), "205 ± 37");
        assert_eq!(rounded(1.0, 0.0), "1.000000000 ± 0.000000000");
    }
}
