//! Received texts on the terminal: their control characters are escaped.

use std::{
    fmt::Display,
    io::{self, Write as _},
};

/// Prints a line on standard error, with its control characters escaped.
pub(super) fn complain(text: impl Display) {
    // An error of this write cannot be reported anywhere.
    let _ = writeln!(io::stderr(), "{}", harmless(&text.to_string()));
}

/// The text with its control characters escaped, except line feeds and tabs.
pub(super) fn harmless(text: &str) -> String {
    let mut harmless = String::with_capacity(text.len());
    for character in text.chars() {
        if character.is_control() && !matches!(character, '\n' | '\t') {
            harmless.extend(character.escape_default());
        } else {
            harmless.push(character);
        }
    }
    harmless
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_do_not_reach_the_terminal() {
        assert_eq!(harmless("mia\u{1b}[2J\u{7}\r\n\t±\u{9b}31m"), "mia\\u{1b}[2J\\u{7}\\r\n\t±\\u{9b}31m");
    }
}
