//! Numbers and times in sentences.

use std::fmt::Display;

use jiff::Timestamp;

/// The text of a number for a sentence. A very large or very small number gets an exponent: 1e300 has 301 digits.
pub fn brief(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-6..1e9).contains(&magnitude) { value.to_string() } else { format!("{value:e}") }
}

/// The number with six significant digits. A measured value in a sentence needs no more, and a 32-bit float has no more.
pub(crate) fn rounded(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// A number of things: "1 throw", "2 throws". The noun is singular if the text of the number is "1", so a number that
/// `format_args!` rounds to 1 is singular too.
pub(crate) fn counted(number: impl Display, thing: &str) -> String {
    let number = number.to_string();
    let plural = if number == "1" { "" } else { "s" };
    format!("{number} {thing}{plural}")
}

/// The text without its digits, to compare sentences that differ only in their numbers.
pub(crate) fn without_digits(text: &str) -> String {
    text.replace(|character: char| character.is_ascii_digit(), "")
}

/// The text of a time for a sentence: "2026-11-21 19:30:12 UTC".
pub fn utc(at: &Timestamp) -> String {
    at.strftime("%Y-%m-%d %H:%M:%S UTC").to_string()
}
