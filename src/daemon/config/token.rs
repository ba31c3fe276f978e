//! The type of a secret in the configuration.

use serde::{Deserialize, Serialize};
use subtle::ConstantTimeEq as _;

/// A secret, which does not appear in log lines and error texts.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token(String);

impl Token {
    /// The secret as text.
    pub fn secret(&self) -> &str {
        &self.0
    }

    /// Whether `text` is the secret. The comparison takes the same time for all texts of the same length.
    pub fn is(&self, text: &str) -> bool {
        self.0.as_bytes().ct_eq(text.as_bytes()).into()
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
}
