//! Common parts of the pages: responses, failures, and the format of numbers and times.

use askama::Template;
use axum::{
    extract::{path::ErrorKind, rejection::PathRejection},
    http::{StatusCode, header},
    response::{Html, IntoResponse, Response},
};
use percent_encoding::{NON_ALPHANUMERIC, utf8_percent_encode};
use serde::Serialize;

use crate::{
    store::{StoreError, Window},
    throw::{MachineId, ThrowRef},
    wire,
};

pub(super) const STYLE: &str = include_str!("pages/style.css");

/// A failure of a request. As a response it has no body: `guard` adds a page or JSON.
#[derive(Debug, Clone)]
pub(super) struct Failure {
    pub(super) status: StatusCode,
    pub(super) message: String,
}

#[derive(Template)]
#[template(path = "failure.html", config = "src/web/askama.toml")]
struct FailurePage<'a> {
    trouble: Vec<String>,
    title: &'a str,
    message: &'a str,
}

impl Failure {
    pub(super) fn new(status: StatusCode, message: impl Into<String>) -> Self {
        Self { status, message: message.into() }
    }

    pub(super) fn not_found(message: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, message)
    }

    pub(super) fn bad_request(message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, message)
    }

    pub(super) fn busy() -> Self {
        let message = "The daemon is busy, or its database does not answer. Try again in a moment; \
                    pointsd status shows the state of the daemon.";
        Self::new(StatusCode::SERVICE_UNAVAILABLE, message)
    }

    /// The response of the JSON interface.
    pub(super) fn json(&self) -> Response {
        (self.status, json(&serde_json::json!({ "error": self.message }))).into_response()
    }

    /// The response as a page, with the problems in `trouble` as banner.
    pub(super) fn page(&self, trouble: Vec<String>) -> Response {
        let title = self.status.canonical_reason().unwrap_or("Failure");
        (self.status, html(&FailurePage { trouble, title, message: &self.message })).into_response()
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        tracing::debug!(%error, "a page could not be read");
        Self::new(StatusCode::SERVICE_UNAVAILABLE, format!("The database cannot be read: {error}."))
    }
}

impl From<PathRejection> for Failure {
    fn from(rejection: PathRejection) -> Self {
        match rejection {
            PathRejection::FailedToDeserializePathParams(error)
                if !matches!(error.kind(), ErrorKind::InvalidUtf8InPathParam { .. }) =>
            {
                Self::not_found("There is no such machine: a name has 1 to 64 characters of A-Z a-z 0-9 _ -")
            }
            _ => Self::bad_request("This address is not valid."),
        }
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        let mut response = self.status.into_response();
        response.extensions_mut().insert(self);
        response
    }
}

pub(super) fn html(page: &impl Template) -> Response {
    Html(rendered(page)).into_response()
}

pub(super) fn rendered(page: &impl Template) -> String {
    // No error can happen: the template is checked at compile time, and the page is written to memory.
    page.render().unwrap_or_else(|error| format!("the page cannot be written: {error}\n"))
}

pub(super) fn json(value: &serde_json::Value) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], wire::json(value)).into_response()
}

/// A file of the program. The header `cache` tells browsers how long to keep it.
pub(super) fn asset(kind: &'static str, cache: &'static str, content: &'static str) -> Response {
    ([(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, cache)], content).into_response()
}

/// JSON for a `<script>` block of a page. A text in the JSON cannot end the block, as `<` is escaped.
pub(super) fn data(value: &impl Serialize) -> String {
    wire::json(value).replace('<', "\\u003c")
}

pub(super) fn throw_address(machine: &MachineId, throw: &ThrowRef) -> String {
    format!("/machines/{}/{}/throws/{}", machine.site, machine.machine, throw_path(throw))
}

/// The last part of the address of a throw, after `/machines/{site}/{machine}/throws/`.
pub(super) fn throw_path(throw: &ThrowRef) -> String {
    format!("{}/{}", utf8_percent_encode(&throw.boot_id, NON_ALPHANUMERIC), throw.throw_no)
}

/// A maintenance, as "in maintenance until … by …: …".
pub(super) fn window(window: &Window) -> String {
    format!("in maintenance {}", window.sentence())
}

/// A duration \[s\] as "3 d 4 h", "4 h 5 min", "5 min" or "6 s".
pub(super) fn duration(seconds: u64) -> String {
    let (days, hours, minutes) = (seconds / 86_400, seconds / 3_600 % 24, seconds / 60 % 60);
    match (days, hours, minutes) {
        (0, 0, 0) => format!("{seconds} s"),
        (0, 0, _) => format!("{minutes} min"),
        (0, ..) => format!("{hours} h {minutes} min"),
        _ => format!("{days} d {hours} h"),
    }
}

/// A number with separators, as "1,234,567".
pub(super) fn count(number: u64) -> String {
    indicatif::HumanCount(number).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        assert_eq!([0, 999, 1_000, 1_234_567].map(count), ["0", "999", "1,000", "1,234,567"]);
        assert_eq!([59, 60, 7_500, 270_000].map(duration), ["59 s", "1 min", "2 h 5 min", "3 d 3 h"]);
    }
}
