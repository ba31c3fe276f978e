//! `pointsd sql`: queries the database with the SQLite version of the daemon.

use std::io::{self, BufWriter, StdoutLock, Write};

use clap::Args;
use comfy_table::Table;
use serde_json::json;

use super::{
    Exit, Outcome, ResultExt,
    database::{Location, unreadable},
    output,
    runtime::block_on,
    terminal::harmless,
};
use crate::{
    store::{ResultWriter, StoreError, Value, run_query},
    throw::rounded,
};

/// Queries the database in SQL, read-only, also while the daemon runs. Without a query it lists the views and their
/// columns.
#[derive(Debug, Args)]
#[command(after_help = "Views: health_history, machine_health, alarm_history, active_alarms, alarm_events, \
    data_gaps, throws_not_evaluated, operator_commands; `pointsd sql` lists all of them with their columns.\n\n\
    Examples:\n  \
    pointsd sql\n  \
    pointsd sql 'SELECT * FROM machine_health'\n  \
    pointsd sql --csv \"SELECT started_at, b0 FROM health_history WHERE machine = '21B'\" > b0.csv\n\n\
    Exit codes: 0 answered, 64 --json or --csv cannot print the answer, 65 invalid SQL, more than one statement, or SQL that writes to the database, or the file is no database of pointsd, 66 there is no database, or it has no tables yet, or it cannot be opened, 74 reading or writing failed, 78 the configuration is invalid.")]
pub(super) struct Arguments {
    /// The query; `.tables` lists the views.
    // A query may start with a comment (`--`).
    #[arg(value_name = "SQL", default_value = ".tables", hide_default_value = true, allow_hyphen_values = true)]
    query: String,
    /// Print a JSON array with one object for each row.
    #[arg(long, conflicts_with = "csv")]
    json: bool,
    /// Print CSV with a header.
    #[arg(long)]
    csv: bool,
    #[command(flatten)]
    location: Location,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let path = arguments.location.find()?;
    let mut writer: Box<dyn ResultWriter> = match (arguments.json, arguments.csv) {
        (true, _) => Box::new(Json { out: BufWriter::new(io::stdout().lock()), names: Vec::new(), rows: 0 }),
        (_, true) => Box::new(Csv(csv::Writer::from_writer(io::stdout().lock()))),
        _ => Box::new(Plain(None)),
    };
    let query = if arguments.query.trim() == ".tables" { VIEWS } else { &arguments.query };
    match block_on(async { Ok(run_query(&path, query, writer.as_mut()).await) })? {
        Ok(()) => Ok(Exit::Ok),
        // The reader closed the pipe.
        Err(StoreError::Output(error)) if error.kind() == io::ErrorKind::BrokenPipe => Ok(Exit::Ok),
        Err(StoreError::Output(error)) if error.kind() == io::ErrorKind::InvalidInput => {
            Err(error).or_exit(Exit::Usage)
        }
        Err(error) => Err(unreadable(error)),
    }
}

/// Lists every view with its columns.
const VIEWS: &str = "SELECT schema.name AS view, group_concat(info.name, ', ') AS columns
                     FROM sqlite_schema AS schema, pragma_table_info(schema.name) AS info
                     WHERE schema.type = 'view' GROUP BY schema.name ORDER BY schema.name";

/// Least width of a column in a wrapped table \[characters\]: a narrower column would break times and numbers.
const LEAST_WIDTH: usize = 20;

/// Prints the answer as a table when it is complete, at most as wide as the terminal.
struct Plain(Option<Table>);

impl ResultWriter for Plain {
    fn columns(&mut self, names: &[String]) -> io::Result<()> {
        self.0 = Some(output::plain_table(names));
        Ok(())
    }

    fn row(&mut self, values: Vec<Value>) -> io::Result<()> {
        if let Some(table) = &mut self.0 {
            table.add_row(values.iter().map(short));
        }
        Ok(())
    }

    fn end(&mut self) -> io::Result<()> {
        let Some(table) = self.0.take() else { return Ok(()) };
        writeln!(io::stdout(), "{}", harmless(&output::fitted(table, LEAST_WIDTH)))
    }
}

/// An answer that the format cannot express.
fn refusal(problem: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, problem)
}

/// Prints the answer as CSV, row by row.
struct Csv(csv::Writer<StdoutLock<'static>>);

impl ResultWriter for Csv {
    fn columns(&mut self, names: &[String]) -> io::Result<()> {
        self.0.write_record(names).map_err(output::io_error)
    }

    fn row(&mut self, values: Vec<Value>) -> io::Result<()> {
        self.0.write_record(values.iter().map(text)).map_err(output::io_error)
    }

    fn end(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// Prints the answer as a JSON array, row by row.
struct Json {
    out: BufWriter<StdoutLock<'static>>,
    names: Vec<String>,
    rows: u64,
}

impl ResultWriter for Json {
    fn columns(&mut self, names: &[String]) -> io::Result<()> {
        // An object has one value for each name.
        if let Some((_, name)) = names.iter().enumerate().find(|(at, name)| names[..*at].contains(name)) {
            return Err(refusal(&format!("two columns are named {name}: rename one with AS")));
        }
        names.clone_into(&mut self.names);
        write!(self.out, "[")
    }

    fn row(&mut self, values: Vec<Value>) -> io::Result<()> {
        let is_infinite = |value: &Value| matches!(value, Value::Real(number) if number.is_infinite());
        if let Some(at) = values.iter().position(is_infinite) {
            self.end()?;
            return Err(refusal(&format!("JSON has no infinity, which the column {} contains", self.names[at])));
        }
        let object: serde_json::Map<_, _> = self.names.iter().cloned().zip(values.into_iter().map(plain)).collect();
        let comma = if self.rows == 0 { "" } else { "," };
        self.rows += 1;
        write!(self.out, "{comma}\n{}", serde_json::Value::Object(object))
    }

    fn end(&mut self) -> io::Result<()> {
        writeln!(self.out, "{}]", if self.rows == 0 { "" } else { "\n" })?;
        self.out.flush()
    }
}

fn plain(value: Value) -> serde_json::Value {
    match value {
        Value::Null => serde_json::Value::Null,
        Value::Integer(number) => json!(number),
        Value::Real(number) => json!(number),
        Value::Text(text) => json!(text),
        Value::Blob(bytes) => json!(hexadecimal(&bytes)),
    }
}

/// The text of a value for people: real numbers have six significant digits.
fn short(value: &Value) -> String {
    match value {
        Value::Real(number) => rounded(*number).to_string(),
        _ => text(value),
    }
}

/// The text of a value in full precision, as in CSV.
pub(super) fn text(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::Integer(number) => number.to_string(),
        Value::Real(number) => number.to_string(),
        Value::Text(text) => text.clone(),
        Value::Blob(bytes) => hexadecimal(bytes),
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    let digits = bytes.iter().flat_map(|byte| [byte >> 4, byte & 0xf]);
    digits.filter_map(|digit| char::from_digit(digit.into(), 16)).collect()
}
