//! Standard output. A reader that goes away, as in `pointsd status | head -1`, ends the command without an error.

use std::{
    fmt::Display,
    fs,
    io::{self, IsTerminal as _, Write as _},
    path::Path,
};

use anyhow::Context;
use comfy_table::{ContentArrangement, Table, presets};
use serde::Serialize;

use super::{Exit, Failure, ResultExt};
use crate::report::Sheet;

/// Width of a table in a pipe, and on a terminal that does not say its width \[columns\].
const WIDTH: u16 = 80;

/// Prints a text and ends its line. Control characters in it came from outside, as in the name of an operator, and could
/// command the terminal: they are shown as `\u{1b}`.
pub(super) fn line(text: impl Display) -> Result<(), Failure> {
    let text = harmless(&text.to_string());
    let mut out = io::stdout().lock();
    written(writeln!(out, "{text}").and_then(|()| out.flush()))
}

fn harmless(text: &str) -> String {
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

/// Prints a value as JSON for people.
pub(super) fn json(value: &impl Serialize) -> Result<(), Failure> {
    line(serde_json::to_string_pretty(value).context("cannot write JSON").or_exit(Exit::Software)?)
}

/// The failure of a write to standard output: silent success when the reader has gone.
pub(super) fn written<T>(result: io::Result<T>) -> Result<T, Failure> {
    result.map_err(|error| {
        let exit = if error.kind() == io::ErrorKind::BrokenPipe { Exit::Ok } else { Exit::Io };
        Failure { exit, error: anyhow::Error::new(error).context("cannot write to standard output") }
    })
}

/// A table without lines, for numbers in columns.
pub(super) fn plain_table<const N: usize>(header: [&str; N]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header);
    table
}

/// A table that fits the terminal.
pub(super) fn table<const N: usize>(header: [&str; N]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED).set_header(header);
    table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width());
    table
}

/// Columns of the terminal, else of `COLUMNS`, else 80.
pub(super) fn width() -> u16 {
    let asked = || std::env::var("COLUMNS").ok()?.parse().ok().filter(|columns| *columns >= 20);
    let terminal = io::stdout().is_terminal().then(|| Table::new().width()).flatten();
    terminal.or_else(asked).unwrap_or(WIDTH)
}

/// Writes figures as SVG files into a folder, which is made where it is not there.
pub(super) fn figures(folder: &Path, figures: impl IntoIterator<Item = (String, Sheet)>) -> Result<(), Failure> {
    let cannot = |path: &Path| format!("{} cannot be written", path.display());
    fs::create_dir_all(folder).with_context(|| cannot(folder)).or_exit(Exit::CannotCreate)?;
    for (name, sheet) in figures {
        let path = folder.join(format!("{name}.svg"));
        fs::write(&path, sheet.to_svg()).with_context(|| cannot(&path)).or_exit(Exit::CannotCreate)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::harmless;

    #[test]
    fn control_characters_do_not_reach_the_terminal() {
        assert_eq!(harmless("mia\u{1b}[2J\u{7}\r\n\t±\u{9b}31m"), "mia\\u{1b}[2J\\u{7}\\r\n\t±\\u{9b}31m");
    }
}
