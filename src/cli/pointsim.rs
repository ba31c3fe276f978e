//! The command line of `pointsim`.

use clap::{CommandFactory as _, Parser, Subcommand};

use super::{COMMON_CODES, Outcome, completions, limits, load, man, simulate_run, table1, throw};

/// Simulated point machines: publishes throws, writes traces, repeats the tests of the study.
#[derive(Debug, Parser)]
#[command(name = "pointsim", version, after_help = COMMON_CODES)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Run(simulate_run::Arguments),
    Load(load::Arguments),
    /// Simulates one throw and writes its trace as CSV.
    Throw(throw::Arguments),
    /// Repeats the study's 4 cases x 6 tests; prints and plots the results.
    Table1(table1::Arguments),
    /// Shows the limits of the method: sampling, noise, soft drive, load, closed loop; as tables and charts.
    Limits(limits::Arguments),
    #[command(
        after_help = "Example:\n  pointsim completions bash > ~/.local/share/bash-completion/completions/pointsim"
    )]
    Completions(completions::Arguments),
    #[command(after_help = "Example:\n  pointsim man ~/.local/share/man/man1")]
    Man(man::Arguments),
}

pub(super) fn main(arguments: Arguments) -> Outcome {
    match arguments.command {
        Command::Run(arguments) => simulate_run::main(&arguments),
        Command::Load(arguments) => load::main(&arguments),
        Command::Throw(arguments) => throw::main(&arguments),
        Command::Table1(arguments) => table1::main(&arguments),
        Command::Limits(arguments) => limits::main(&arguments),
        Command::Completions(arguments) => completions::main(&arguments, Arguments::command()),
        Command::Man(arguments) => man::main(&arguments, Arguments::command()),
    }
}
