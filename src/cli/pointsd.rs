//! The command line of `pointsd`.

use clap::{Parser, Subcommand};

use super::{Outcome, backup, evaluate, exit, identify, sql};

/// Condition monitoring of railway point machines: which part is wearing out, from the physics of every throw.
#[derive(Debug, Parser)]
#[command(name = "pointsd", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Backup(backup::Arguments),
    Evaluate(evaluate::Arguments),
    Identify(identify::Arguments),
    Sql(sql::Arguments),
}

pub(super) fn main() -> Outcome {
    let arguments = match exit::parse::<Arguments>() {
        Ok(arguments) => arguments,
        Err(exit) => return Ok(exit),
    };
    match arguments.command {
        Command::Backup(arguments) => backup::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Identify(arguments) => identify::run(&arguments),
        Command::Sql(arguments) => sql::run(&arguments),
    }
}
