//! The command line of `pointsd`.

use clap::{CommandFactory as _, Parser, Subcommand};

use super::{
    COMMON_CODES, Outcome, alarms, backup, check, commands, completions, demo, evaluate, export, identify, import, man,
    replay, report, run, sql, status,
};

/// Condition monitoring of railway point machines: identifies every throw and names the part that is wearing out.
#[derive(Debug, Parser)]
#[command(name = "pointsd", version, after_help = COMMON_CODES)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Arguments),
    Run(run::Arguments),
    Check(check::Arguments),
    Status(status::Arguments),
    Alarms(alarms::Arguments),
    #[command(flatten)]
    Operator(commands::Operator),
    Identify(identify::Arguments),
    Import(import::Arguments),
    Replay(replay::Arguments),
    Sql(sql::Arguments),
    Export(export::Arguments),
    Report(report::Arguments),
    Backup(backup::Arguments),
    Evaluate(evaluate::Arguments),
    Completions(completions::Arguments),
    Man(man::Arguments),
}

pub(super) fn main(arguments: Arguments) -> Outcome {
    match arguments.command {
        Command::Demo(arguments) => demo::main(&arguments),
        Command::Run(arguments) => run::main(&arguments),
        Command::Check(arguments) => check::main(&arguments),
        Command::Status(arguments) => status::main(&arguments),
        Command::Alarms(arguments) => alarms::main(&arguments),
        Command::Operator(arguments) => commands::main(arguments),
        Command::Identify(arguments) => identify::main(&arguments),
        Command::Import(arguments) => import::main(&arguments),
        Command::Replay(arguments) => replay::main(&arguments),
        Command::Sql(arguments) => sql::main(&arguments),
        Command::Export(arguments) => export::main(&arguments),
        Command::Report(arguments) => report::main(&arguments),
        Command::Backup(arguments) => backup::main(&arguments),
        Command::Evaluate(arguments) => evaluate::main(&arguments),
        Command::Completions(arguments) => completions::main(&arguments, Arguments::command()),
        Command::Man(arguments) => man::main(&arguments, Arguments::command()),
    }
}
