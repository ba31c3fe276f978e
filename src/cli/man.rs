//! `man`: the manual pages of a program, from the definitions of its command line.

use std::{fs, path::PathBuf};

use super::{Exit, Outcome, output};

/// Writes the manual pages of this program, one for each command, into a folder.
///
/// The Debian package has them: `man pointsd-export`.
///
/// Exit codes: 0 written; 73 the pages cannot be written.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd man ~/.local/share/man/man1")]
pub(super) struct Arguments {
    /// The folder; created if needed.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// Writes the pages. `program` is the definition of the whole command line.
pub(super) fn main(arguments: &Arguments, program: clap::Command) -> Outcome {
    let folder = &arguments.folder;
    let written = fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(program, folder));
    output::writable(folder, written)?;
    Ok(Exit::Ok)
}
