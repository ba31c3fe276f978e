//! `pointsd report`: the page of a machine as one HTML file.

use std::path::{Path, PathBuf};

use anyhow::Context as _;

use super::{
    Exit, Outcome, ResultExt, argument,
    database::{Location, unreadable},
    output,
    runtime::block_on,
};
use crate::{
    daemon::config::{Document, diagnosis},
    diagnose,
    store::Reader,
    throw::MachineId,
    web::{self, Span},
};

/// Writes the page of a machine as one HTML file, for a work order or a mail: state, open alarms, charts, alarm
/// history, last throws.
///
/// The file contains everything that it shows, and no links. The daemon may run. The limits in the charts are those of
/// the configuration.
///
/// Exit codes: 0 written; 64 --out names another format than HTML; 65 the file is no database of pointsd, or of another
/// version; 66 there is no database, it cannot be opened, or it has no throw of this machine; 73 the file cannot be
/// written; 74 reading or writing failed; 78 the configuration is invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd report north/21B --out 21B.html --config /etc/pointsd/pointsd.toml")]
pub(super) struct Arguments {
    /// The machine.
    #[arg(value_name = "SITE/MACHINE", value_parser = argument::machine)]
    machine: MachineId,
    /// The HTML file, or - for standard output.
    #[arg(long, value_name = "FILE.html")]
    out: PathBuf,
    /// Throws of each direction in the charts.
    #[arg(long, default_value = "1000", value_parser = ["100", "1000", "all"])]
    span: String,
    #[command(flatten)]
    location: Location,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    output::of_format(&arguments.out, ["html", "htm"])?;
    let path = arguments.location.find()?;
    let diagnosis = match arguments.location.config() {
        Some(file) => Document::read(file).and_then(|document| diagnosis(&document)).or_exit(Exit::Config)?,
        None => diagnose::Settings::default(),
    };
    let machine = &arguments.machine;
    let span = Span::from_word(&arguments.span).unwrap_or(Span::All);
    let page = block_on(async {
        let reader = Reader::open_outside(&path).await.map_err(unreadable)?;
        web::report(&reader, machine, span, &diagnosis).await.map_err(unreadable)
    })?;
    let unknown = || format!("{} has no throw of {machine}; `pointsd status` lists the machines", path.display());
    let page = page.with_context(unknown).or_exit(Exit::NoInput)?;
    if arguments.out == Path::new("-") {
        output::line(page)?;
        return Ok(Exit::Ok);
    }
    output::file(&arguments.out, page)?;
    output::line(format_args!("{machine} written to {}", arguments.out.display()))?;
    Ok(Exit::Ok)
}
