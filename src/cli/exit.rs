//! Exit codes, after BSD `sysexits.h` where it has a word for the case.

use std::process::ExitCode;

/// How a command ended. The numbers are a promise to scripts and to systemd.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// It did what it was asked.
    Ok = 0,
    /// It ran, and the answer is no: the throw was refused, a limit was not held.
    Negative = 1,
    /// The command line is wrong (`EX_USAGE`).
    Usage = 64,
    /// The input's content is wrong (`EX_DATAERR`).
    Data = 65,
    /// The input cannot be opened (`EX_NOINPUT`).
    NoInput = 66,
    /// Something needed is not there: no daemon answers (`EX_UNAVAILABLE`).
    Unavailable = 69,
    /// A fault of the program: a task died (`EX_SOFTWARE`).
    Software = 70,
    /// An output cannot be created (`EX_CANTCREAT`).
    CannotCreate = 73,
    /// Reading or writing failed (`EX_IOERR`).
    Io = 74,
    /// The configuration is wrong (`EX_CONFIG`).
    Config = 78,
}

/// A command that failed: the code for programs, the error for people.
#[derive(Debug)]
pub struct Failure {
    /// The process's exit code.
    pub exit: Exit,
    /// What went wrong and what to do.
    pub error: anyhow::Error,
}

/// What a command returns.
pub type Outcome = Result<Exit, Failure>;

/// Gives an error its exit code.
pub trait ResultExt<T> {
    /// Turns the error into a [`Failure`] with this code.
    ///
    /// # Errors
    /// The failure, when `self` is an error.
    fn or_exit(self, exit: Exit) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> ResultExt<T> for Result<T, E> {
    fn or_exit(self, exit: Exit) -> Result<T, Failure> {
        self.map_err(|error| Failure { exit, error: error.into() })
    }
}

/// Prints a failure as one line on stderr and returns the process's exit code.
pub(super) fn finish(outcome: Outcome) -> ExitCode {
    let exit = outcome.unwrap_or_else(|failure| {
        eprintln!("error: {:#}", failure.error);
        failure.exit
    });
    ExitCode::from(exit as u8)
}

/// Parses the command line: usage errors exit with [`Exit::Usage`], `--help` and `--version` with [`Exit::Ok`].
pub(super) fn parse<C: clap::Parser>() -> Result<C, Exit> {
    C::try_parse().map_err(|error| {
        let exit = if error.use_stderr() { Exit::Usage } else { Exit::Ok };
        // Nothing is left to do when the terminal itself cannot be written to.
        let _ = error.print();
        exit
    })
}
