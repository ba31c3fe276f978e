//! `completions`: the script with which a shell completes a command line.

use std::io::{self, Write as _};

use super::{Exit, Outcome, output};

/// Prints the script with which a shell completes the commands and options of this program.
///
/// The Debian package has the scripts for bash, fish and zsh.
///
/// Exit codes: 0 printed; 64 unknown shell.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  pointsd completions bash > ~/.local/share/bash-completion/completions/pointsd")]
pub(super) struct Arguments {
    /// The shell.
    shell: clap_complete::Shell,
}

/// Prints the script. `program` is the definition of the whole command line.
pub(super) fn main(arguments: &Arguments, mut program: clap::Command) -> Outcome {
    let name = program.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut program, name, &mut script);
    output::written(io::stdout().write_all(&script))?;
    Ok(Exit::Ok)
}
