//! Output of the commands. If the reader of standard output closes the pipe, as in `pointsd status | head -1`, the
//! command ends without an error.

use std::{
    fmt::Display,
    fs,
    io::{self, IsTerminal as _, Write as _},
    path::Path,
};

use anyhow::{Context, anyhow};
use comfy_table::{Cell, CellAlignment, ContentArrangement, Row, Table, presets};
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;

use super::{Exit, Failure, Outcome, ResultExt, terminal::harmless};
use crate::{report::Sheet, web};

/// Width of the output in a pipe, or on a terminal of unknown width \[columns\].
const WIDTH: u16 = 80;

/// Prints a line. Control characters are escaped, as `\u{1b}`: a received text, such as the name of an operator, could
/// contain commands for the terminal.
pub(super) fn line(text: impl Display) -> Result<(), Failure> {
    let text = harmless(&text.to_string());
    let mut out = io::stdout().lock();
    written(writeln!(out, "{text}").and_then(|()| out.flush()))
}

/// Moves the cursor home and clears the terminal.
pub(super) fn clear() -> Result<(), Failure> {
    written(write!(io::stdout(), "\x1b[H\x1b[2J"))
}

/// Prints a value as indented JSON.
pub(super) fn json(value: &impl Serialize) -> Result<(), Failure> {
    line(serde_json::to_string_pretty(value).context("cannot write JSON").or_exit(Exit::Software)?)
}

/// Prints the result of a command `as_json`, or as text.
pub(super) fn result(as_json: bool, value: &impl Serialize, text: impl FnOnce() -> String) -> Result<(), Failure> {
    if as_json { json(value) } else { line(text()) }
}

/// The exit code of a command after its output. A reader that closes the pipe, as in `pointsd alarms --check | head
/// -1`, does not change the result of the check.
pub(super) fn after(printed: Result<(), Failure>, result: Exit) -> Outcome {
    match printed {
        Err(Failure::ClosedPipe) => Ok(result),
        printed => printed.map(|()| result),
    }
}

/// The result of a write to standard output.
pub(super) fn written<T>(result: io::Result<T>) -> Result<T, Failure> {
    result.map_err(|error| {
        if error.kind() == io::ErrorKind::BrokenPipe {
            return Failure::ClosedPipe;
        }
        Failure::new(Exit::Io, anyhow::Error::new(error).context("cannot write to standard output"))
    })
}

/// The I/O error inside an error of the CSV writer, so that its kind is known.
pub(super) fn io_error(error: csv::Error) -> io::Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => io::Error::other(format!("{other:?}")),
    }
}

/// A change with its 95 % interval \[%\], as on the pages, but with an ASCII minus sign as in all output of the
/// commands.
pub(super) fn size(change_pct: f64, change_pct_sd: f64) -> String {
    web::size(change_pct, change_pct_sd).replace('−', "-")
}

/// A change \[%\] of one throw, as on the pages, but with an ASCII minus sign.
pub(super) fn signed(change_pct: f64) -> String {
    web::signed(change_pct, 1).replace('−', "-")
}

/// A table without borders.
pub(super) fn plain_table(header: impl Into<Row>) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header);
    table
}

/// The table as text. If it is wider than the terminal, its cells are wrapped, if this leaves `least` characters for
/// each column. Otherwise each cell is printed on a line of its own, with the name of its column.
pub(super) fn fitted(table: Table, least: usize) -> String {
    let width = io::stdout().is_terminal().then(|| usize::from(width()));
    fitted_to(width, table, least)
}

/// As [`fitted`], for a terminal of this width \[columns\], or `None` for a pipe.
fn fitted_to(width: Option<usize>, mut table: Table, least: usize) -> String {
    table.set_content_arrangement(ContentArrangement::Disabled);
    let whole = table.to_string();
    let Some(width) = width else { return whole };
    if whole.lines().all(|line| line.trim_end().chars().count() <= width) {
        return whole;
    }
    if table.column_count() * least <= width {
        let width = u16::try_from(width).unwrap_or(u16::MAX);
        return table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width).to_string();
    }
    let names: Vec<String> = table.header().into_iter().flat_map(Row::cell_iter).map(Cell::content).collect();
    let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    let record = |row: &Row| {
        let cells = names.iter().zip(row.cell_iter());
        let lines: Vec<String> = cells.map(|(name, cell)| format!("{name:>longest$} = {}", cell.content())).collect();
        lines.join("\n")
    };
    table.row_iter().map(record).collect::<Vec<_>>().join("\n\n")
}

/// A table with borders, at most as wide as the terminal.
pub(super) fn table<const N: usize>(header: [&str; N]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_FULL_CONDENSED).set_header(header);
    table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width());
    table
}

/// The table with its columns from index `first` on aligned to the right, for numbers.
pub(super) fn numbers(mut table: Table, first: usize) -> Table {
    table.column_iter_mut().skip(first).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    table
}

/// A progress bar with this template, drawn at once; hidden if standard error is not a terminal.
pub(super) fn progress(length: u64, template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(length).with_style(style);
    bar.tick();
    bar
}

/// Width of the terminal \[columns\]; without a terminal the variable `COLUMNS`, or else 80.
pub(super) fn width() -> u16 {
    let asked = || std::env::var("COLUMNS").ok()?.parse().ok().filter(|columns| *columns >= 20);
    let terminal = io::stdout().is_terminal().then(|| Table::new().width()).flatten();
    terminal.or_else(asked).unwrap_or(WIDTH)
}

/// Refuses an output file whose extension names a format that the command does not write.
pub(super) fn of_format(path: &Path, formats: [&str; 2]) -> Result<(), Failure> {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let Some(other) = extension.filter(|extension| !formats.contains(&extension.as_str())) else { return Ok(()) };
    let [one, another] = formats;
    Err(anyhow!("--out {}: cannot write {other}, only {one} or {another}", path.display())).or_exit(Exit::Usage)
}

/// Creates an output file before the long work of a command, so that an error shows at once. An existing file keeps its
/// content.
pub(super) fn creatable(path: &Path) -> Result<(), Failure> {
    let created = fs::OpenOptions::new().append(true).create(true).open(path);
    writable(path, created.map(drop))
}

/// Writes a file.
pub(super) fn file(path: &Path, content: impl AsRef<[u8]>) -> Result<(), Failure> {
    writable(path, fs::write(path, content))
}

/// Adds exit code and path to the result of creating a file or folder.
pub(super) fn writable<T>(path: &Path, result: io::Result<T>) -> Result<T, Failure> {
    result.with_context(|| format!("{} cannot be written", path.display())).or_exit(Exit::CannotCreate)
}

/// Creates the folder of the figures of a long run, before the run.
pub(super) fn create_folder(folder: Option<&Path>) -> Result<(), Failure> {
    folder.map_or(Ok(()), |folder| writable(folder, fs::create_dir_all(folder)))
}

/// Writes figures as SVG files into a folder, which exists.
pub(super) fn figures(folder: &Path, figures: impl IntoIterator<Item = (String, Sheet)>) -> Result<(), Failure> {
    figures.into_iter().try_for_each(|(name, sheet)| file(&folder.join(format!("{name}.svg")), sheet.to_svg()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_pipe_keeps_the_result_of_a_check() {
        let failed = |kind: io::ErrorKind| written::<()>(Err(kind.into()));
        assert_eq!(after(Ok(()), Exit::Negative).unwrap(), Exit::Negative);
        assert_eq!(after(failed(io::ErrorKind::BrokenPipe), Exit::Negative).unwrap(), Exit::Negative);
        let failure = after(failed(io::ErrorKind::StorageFull), Exit::Negative).unwrap_err();
        assert!(matches!(failure, Failure::Error { exit: Exit::Io, .. }), "{failure:?}");
    }

    #[test]
    fn a_file_of_another_format_is_refused() {
        let check = |name: &str| match of_format(Path::new(name), ["svg", "html"]) {
            Err(Failure::Error { error, .. }) => Err(error.to_string()),
            _ => Ok(()),
        };
        assert!(["a.svg", "a.HTML", "a", "-", "/dev/stdout"].iter().all(|name| check(name).is_ok()));
        assert_eq!(check("b/a.png").unwrap_err(), "--out b/a.png: cannot write png, only svg or html");
    }

    #[test]
    fn a_row_that_does_not_fit_is_one_line_for_each_column() {
        let mut table = plain_table(["machine", "b0"]);
        table.add_row(["north/21B", "50.25"]).add_row(["north/21A", ""]);
        let whole = fitted_to(None, table.clone(), 20);
        assert!(whole.contains("north/21B  50.25"), "{whole}");
        assert_eq!(fitted_to(Some(40), table.clone(), 20), whole);
        assert_eq!(
            fitted_to(Some(12), table.clone(), 20),
            "machine = north/21B\n     b0 = 50.25\n\nmachine = north/21A\n     b0 = "
        );
        let wrapped = fitted_to(Some(12), table, 6);
        assert!(wrapped.lines().all(|line| line.chars().count() <= 12) && !wrapped.contains('='), "{wrapped}");
    }
}
