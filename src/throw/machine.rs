//! Names of sites and machines. They are parts of zenoh key expressions, so few characters are allowed.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

/// A site or machine name: 1 to 64 characters of `A-Z a-z 0-9 _ -`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct Name(String);

/// A text that is not a site or machine name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not a site or machine name: use 1 to {max} characters of A-Z a-z 0-9 _ -", max = Name::MAX_LEN)]
pub struct InvalidName {
    /// The text, cut after [`Name::MAX_LEN`] + 1 characters.
    pub text: String,
}

impl Name {
    /// Longest name, in characters (all of them one byte).
    pub const MAX_LEN: usize = 64;

    /// The name of a literal of the program; panics for a text that is not a name.
    #[expect(clippy::expect_used, reason = "called only with literals, and tests run these calls")]
    pub(crate) fn fixed(text: &str) -> Self {
        text.parse().expect("a valid name")
    }

    /// The text of the name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for Name {
    type Err = InvalidName;

    fn from_str(text: &str) -> Result<Self, InvalidName> {
        let fits = (1..=Self::MAX_LEN).contains(&text.len());
        let allowed = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-';
        if fits && text.bytes().all(allowed) {
            Ok(Self(text.to_owned()))
        } else {
            Err(InvalidName { text: text.chars().take(Self::MAX_LEN + 1).collect() })
        }
    }
}

impl TryFrom<String> for Name {
    type Error = InvalidName;

    fn try_from(text: String) -> Result<Self, InvalidName> {
        text.parse()
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Identity of a point machine: its site and its name at the site. Displays as `site/machine`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct MachineId {
    /// The site, for example a station or a cabinet.
    pub site: Name,
    /// The machine's name at that site.
    pub machine: Name,
}

impl MachineId {
    /// The machine with these two names.
    ///
    /// # Errors
    /// When either text is not a valid [`Name`].
    pub fn new(site: &str, machine: &str) -> Result<Self, InvalidName> {
        Ok(Self { site: site.parse()?, machine: machine.parse()? })
    }
}

impl fmt::Display for MachineId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.site, self.machine)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_hold_their_alphabet_and_length() {
        for good in ["a", "21B", "north_4-x", &"x".repeat(64)] {
            assert_eq!(good.parse::<Name>().unwrap().as_str(), good);
        }
        for bad in ["", "a/b", "a*", "é", "a b", "@v1", &"x".repeat(65)] {
            assert!(bad.parse::<Name>().is_err(), "{bad:?} was taken");
        }
    }
}
