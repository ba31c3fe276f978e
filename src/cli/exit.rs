//! Exit codes, after BSD `sysexits.h` where it has a word for the case.

use std::{io::Write as _, process::ExitCode};

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

/// Prints a failure as one line on stderr and returns the process's exit code. A failure with [`Exit::Ok`] is silent:
/// the reader of standard output has gone.
pub(super) fn finish(outcome: Outcome) -> ExitCode {
    let exit = outcome.unwrap_or_else(|failure| {
        if failure.exit != Exit::Ok {
            // Nothing is left to do when stderr itself cannot be written to.
            let _ = writeln!(std::io::stderr(), "error: {}", sentence(&failure.error));
        }
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

/// The error with its causes in one line: no cause twice, and without places in the source code of libraries.
fn sentence(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    let is_place = |word: &str| word.contains(".rs:");
    let mut words: Vec<&str> = Vec::new();
    for word in text.split_whitespace() {
        if !is_place(word) {
            words.push(word);
        } else if words.last() == Some(&"at") {
            words.pop();
        }
    }
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_one_sentence_that_says_nothing_twice() {
        let error = anyhow::anyhow!("no such column: b9 at /root/.cargo/registry/x-1.0/src/orchestrator.rs:12. (x)")
            .context("reading the database failed: no such column: b9 at /root/.cargo/registry/x-1.0/src/orchestrator.rs:12. (x)")
            .context("the question\n  cannot be answered");
        assert_eq!(
            sentence(&error),
            "the question cannot be answered: reading the database failed: no such column: b9 (x)"
        );
    }
}
