//! The command line of `pointsim`.

use clap::{Parser, Subcommand};

use super::{Outcome, exit};

/// The simulated point machine: publishes throws, writes traces, repeats the study's tests.
#[derive(Debug, Parser)]
#[command(name = "pointsim", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Simulates one throw and writes its trace as CSV.
    Throw(super::throw::Arguments),
}

pub(super) fn main() -> Outcome {
    let arguments = match exit::parse::<Arguments>() {
        Ok(arguments) => arguments,
        Err(exit) => return Ok(exit),
    };
    match arguments.command {
        Command::Throw(arguments) => super::throw::main(&arguments),
    }
}
