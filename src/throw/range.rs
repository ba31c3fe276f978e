//! A number outside its range, in a configuration or in a machine's parameters.

/// A number outside its range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} is {value}, must be {must}")]
pub struct OutOfRange {
    /// The key, as in configuration files: `lead_mm`, or with its section `machine.lead_mm`.
    pub key: String,
    /// Value that was given.
    pub value: f64,
    /// Allowed range with its unit: "0.5 to 500 mm".
    pub must: String,
}

impl OutOfRange {
    /// Checks each number against its condition; NaN and infinite values fail always.
    ///
    /// # Errors
    /// The first number for which `good` does not hold.
    pub fn require(values: &[(&str, f64)], must: &str, good: impl Fn(f64) -> bool) -> Result<(), Self> {
        match values.iter().find(|(_, value)| !value.is_finite() || !good(*value)) {
            Some(&(key, value)) => Err(Self { key: key.to_owned(), value, must: must.to_owned() }),
            None => Ok(()),
        }
    }

    /// Checks `(key, value, lowest, highest, unit)` of each number; the unit may be empty.
    ///
    /// # Errors
    /// The first number outside its range.
    pub fn check<'a>(ranges: impl IntoIterator<Item = (&'a str, f64, f64, f64, &'a str)>) -> Result<(), Self> {
        for (key, value, low, high, unit) in ranges {
            if !(low..=high).contains(&value) {
                let must = format!("{low} to {high} {unit}").trim_end().to_owned();
                return Err(Self { key: key.to_owned(), value, must });
            }
        }
        Ok(())
    }

    /// Prefixes the field with a section of the configuration: `lead_mm` becomes `machine.lead_mm`.
    #[must_use]
    pub fn within(self, section: &str) -> Self {
        Self { key: format!("{section}.{}", self.key), ..self }
    }

    /// The complaint without its key, for a message that names the key by itself.
    #[must_use]
    pub fn problem(&self) -> String {
        format!("is {}, must be {}", self.value, self.must)
    }
}
