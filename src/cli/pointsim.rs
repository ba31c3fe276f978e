//! The command line of `pointsim`.

use clap::{CommandFactory as _, Parser, Subcommand};

use super::{Outcome, exit};

/// Simulated point machines: publishes throws, writes traces, repeats the tests of the study.
#[derive(Debug, Parser)]
#[command(name = "pointsim", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(super::simulate_run::Arguments),
    Load(super::load::Arguments),
    /// Simulates one throw and writes its trace as CSV.
    Throw(super::throw::Arguments),
    /// Repeats the study's 4 cases x 6 tests; prints and plots the results.
    Table1(super::table1::Arguments),
    /// Shows the limits of the method: sampling, noise, soft drive, load, closed loop; as tables and charts.
    Limits(super::limits::Arguments),
    Completions(super::completions::Arguments),
    Man(super::man::Arguments),
}

pub(super) fn main() -> Outcome {
    let arguments = match exit::parse::<Arguments>() {
        Ok(arguments) => arguments,
        Err(exit) => return Ok(exit),
    };
    match arguments.command {
        Command::Run(arguments) => super::simulate_run::main(&arguments),
        Command::Load(arguments) => super::load::main(&arguments),
        Command::Throw(arguments) => super::throw::main(&arguments),
        Command::Table1(arguments) => super::table1::main(&arguments),
        Command::Limits(arguments) => super::limits::main(&arguments),
        Command::Completions(arguments) => super::completions::main(&arguments, Arguments::command()),
        Command::Man(arguments) => super::man::main(&arguments, Arguments::command()),
    }
}
