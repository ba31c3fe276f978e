//! The command line of `pointsd`.

use clap::{Parser, Subcommand};

use super::{Outcome, evaluate, exit, identify};

/// Condition monitoring of railway point machines: which part is wearing out, from the physics of every throw.
#[derive(Debug, Parser)]
#[command(name = "pointsd", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Evaluate(evaluate::Arguments),
    Identify(identify::Arguments),
}

pub(super) fn main() -> Outcome {
    let arguments = match exit::parse::<Arguments>() {
        Ok(arguments) => arguments,
        Err(exit) => return Ok(exit),
    };
    match arguments.command {
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Identify(arguments) => identify::run(&arguments),
    }
}
