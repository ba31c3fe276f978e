//! Numbers and times in sentences.

use std::fmt::Display;

use jiff::Timestamp;

/// A number for a sentence: a large or tiny one has an exponent, as 1e300 has 301 digits.
pub fn brief(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-6..1e9).contains(&magnitude) { value.to_string() } else { format!("{value:e}") }
}

/// A number of things: "1 throw", "2 throws". The text of the number decides, so it may be rounded by `format_args!`.
pub(crate) fn counted(number: impl Display, thing: &str) -> String {
    let number = number.to_string();
    let plural = if number == "1" { "" } else { "s" };
    format!("{number} {thing}{plural}")
}

/// The text without its numbers, to compare sentences.
pub(crate) fn without_digits(text: &str) -> String {
    text.replace(|character: char| character.is_ascii_digit(), "")
}

/// A time for a sentence: "2026-11-21 19:30:12 UTC".
pub fn utc(at: &Timestamp) -> String {
    at.strftime("%Y-%m-%d %H:%M:%S UTC").to_string()
}
