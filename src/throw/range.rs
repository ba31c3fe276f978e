//! Range checks of numbers in configurations and in parameters of simulated machines.

use super::text::brief;

/// A number that is outside its allowed range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} is {}, must be {must}", brief(*.value))]
pub struct OutOfRange {
    /// The key, as in configuration files: `lead_mm`, or with its section `machine.lead_mm`.
    pub key: String,
    /// The value.
    pub value: f64,
    /// Text of the allowed range with its unit, as in "0.5 to 500 mm".
    pub must: String,
}

/// The allowed values of a number. NaN and infinite values are never allowed.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Range {
    /// Every finite number.
    Finite,
    /// Values above this one.
    Above(f64),
    /// This value or more.
    AtLeast(f64),
    /// From the first to the second value, with their unit, which may be empty.
    Within(f64, f64, &'static str),
    /// Allowed if the condition is true, which depends on other numbers as well; and its text after "must be".
    If(bool, &'static str),
}

impl Range {
    /// Checks `value`; `key` is the name of the number in the error.
    pub(crate) fn check(self, key: &str, value: f64) -> Result<(), OutOfRange> {
        let is_inside = match self {
            Self::Finite => true,
            Self::Above(low) => value > low,
            Self::AtLeast(low) => value >= low,
            Self::Within(low, high, _) => (low..=high).contains(&value),
            Self::If(holds, _) => holds,
        };
        if is_inside && value.is_finite() {
            return Ok(());
        }
        let must = match self {
            Self::Finite => "a finite number".to_owned(),
            Self::Above(low) => format!("above {low}"),
            Self::AtLeast(low) => format!("{low} or more"),
            Self::Within(low, high, unit) => format!("{low} to {high} {unit}").trim_end().to_owned(),
            Self::If(_, must) => must.to_owned(),
        };
        Err(OutOfRange { key: key.to_owned(), value, must })
    }
}

impl OutOfRange {
    /// Puts the section of the configuration in front of the key: `lead_mm` becomes `machine.lead_mm`.
    #[must_use]
    pub fn within(self, section: &str) -> Self {
        Self { key: format!("{section}.{}", self.key), ..self }
    }

    /// The error text without the key, for a message that names the key elsewhere.
    pub fn problem(&self) -> String {
        format!("is {}, must be {}", brief(self.value), self.must)
    }
}
