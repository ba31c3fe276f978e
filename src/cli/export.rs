//! `pointsd export`: throws with their estimates as CSV, and their traces.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use anyhow::anyhow;
use indicatif::ProgressBar;
use jiff::Timestamp;

use super::{
    Exit, Failure, Outcome, argument,
    database::{Location, unreadable},
    output,
    runtime::block_on,
    sql::text,
};
use crate::{
    store::{Export, Exported},
    throw::MachineId,
};

/// Exports throws with their estimates as CSV to standard output, oldest first, also while the daemon runs.
///
/// Each throw is one line, also if it is rejected or pending (`quality`). Times are RFC 3339 in UTC; an unknown value
/// is an empty cell. With --traces the samples of each throw are written to a file of their own, which `pointsd
/// identify` and `pointsd import` can read. The last column, `trace`, has the name of the file in DIR; it is empty if
/// the trace was deleted to save space. If you write the lines to `throws.csv` in DIR or in its parent, `pointsd
/// import` takes time, direction, boot and number from there.
///
/// Exit codes: 0 exported; 1 no stored throw matches; 65 the file is no database of pointsd, or of another version; 66
/// there is no database, or it cannot be opened; 73 a file cannot be created; 74 reading or writing failed; 78 the
/// configuration is invalid.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  pointsd export > throws.csv\n  \
    pointsd export north/21B --since 2026-05-01 --until 2026-06-01 --traces traces > throws.csv")]
pub(super) struct Arguments {
    /// Export only this machine.
    #[arg(value_name = "SITE/MACHINE", value_parser = argument::machine)]
    machine: Option<MachineId>,
    /// Export throws that started at this time or later: a date, or a time as 2026-05-04T06:00:00Z.
    #[arg(long, value_name = "TIME", value_parser = argument::moment)]
    since: Option<Timestamp>,
    /// Export throws that started before this time.
    #[arg(long, value_name = "TIME", value_parser = argument::moment)]
    until: Option<Timestamp>,
    /// Write the trace of each throw to DIR/SITE/MACHINE/START-ROW.csv; ROW is its row in the database, not its
    /// `throw_no`.
    #[arg(long, value_name = "DIR")]
    traces: Option<PathBuf>,
    #[command(flatten)]
    location: Location,
}

pub(super) fn main(arguments: &Arguments) -> Outcome {
    let path = arguments.location.find()?;
    block_on(async {
        let Arguments { machine, since, until, .. } = arguments;
        let mut export = Export::open(&path, machine.clone(), *since, *until).await.map_err(unreadable)?;
        let mut out = csv::Writer::from_writer(io::stdout().lock());
        let mut columns = export.columns().await.map_err(unreadable)?;
        if arguments.traces.is_some() {
            columns.push("trace".to_owned());
        }
        written(out.write_record(&columns))?;
        // The count is hidden if standard error is not a terminal.
        let count = ProgressBar::no_length();
        loop {
            let page = export.page().await.map_err(unreadable)?;
            if page.is_empty() {
                break;
            }
            for throw in page {
                let mut cells: Vec<String> = throw.values.iter().map(text).collect();
                if let Some(folder) = &arguments.traces {
                    cells.push(write_trace(&mut export, &throw, folder).await?);
                }
                written(out.write_record(&cells))?;
                count.inc(1);
            }
        }
        count.finish_and_clear();
        output::written(out.flush())?;
        if count.position() == 0 {
            return Err(Failure::new(Exit::Negative, anyhow!("no stored throw matches")));
        }
        Ok(Exit::Ok)
    })
}

fn written(result: csv::Result<()>) -> Result<(), Failure> {
    output::written(result.map_err(output::io_error))
}

/// Writes the trace of a throw; returns its file in `folder`, or an empty text if the trace is not stored.
async fn write_trace(export: &mut Export, throw: &Exported, folder: &Path) -> Result<String, Failure> {
    let stored = export.stored(throw).await.map_err(unreadable)?;
    let Some(stored) = stored else { return Ok(String::new()) };
    // Names of sites and machines are safe in a path, but a boot id may be any text. The row number makes the name
    // unique.
    let (machine, start) = (&stored.machine, stored.started_at.strftime("%Y%m%dT%H%M%SZ"));
    let name = format!("{}/{}/{start}-{}.csv", machine.site, machine.machine, stored.row.0);
    let Ok(measured) = stored.throw else { return Ok(String::new()) };
    let file = folder.join(&name);
    let write = || -> io::Result<()> {
        file.parent().map_or(Ok(()), fs::create_dir_all)?;
        let mut file = io::BufWriter::new(fs::File::create(&file)?);
        measured.trace.csv_lines().try_for_each(|line| file.write_all(line.as_bytes()))?;
        let file = file.into_inner()?;
        // `pointsd import` may take the time of the throw from the file. An error is ignored, as not every file system
        // keeps times.
        let _ = file.set_modified(stored.started_at.into());
        Ok(())
    };
    output::writable(&file, write())?;
    Ok(name)
}
