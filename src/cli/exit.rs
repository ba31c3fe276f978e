//! Exit codes of the commands, from BSD `sysexits.h` where it has a code with this meaning.

use std::process::ExitCode;

use super::terminal;

/// Exit code of a command. Scripts and systemd depend on the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Exit {
    /// Success.
    Ok = 0,
    /// The command ran, with a negative result: throw rejected, goal not met, command refused.
    Negative = 1,
    /// The command line is wrong (`EX_USAGE`).
    Usage = 64,
    /// The content of the input is invalid (`EX_DATAERR`).
    Data = 65,
    /// The input cannot be opened (`EX_NOINPUT`).
    NoInput = 66,
    /// A service is not available, for example because no daemon answers (`EX_UNAVAILABLE`).
    Unavailable = 69,
    /// An internal error, for example because a task ended unexpectedly (`EX_SOFTWARE`).
    Software = 70,
    /// An output cannot be created (`EX_CANTCREAT`).
    CannotCreate = 73,
    /// Reading or writing failed (`EX_IOERR`).
    Io = 74,
    /// The configuration is invalid (`EX_CONFIG`).
    Config = 78,
}

/// The exit codes that every command has beside those in its own help.
pub(super) const COMMON_CODES: &str = "Exit codes of every command, beside those in its help: 64 the command line is wrong; \
    70 an internal error; 74 standard output cannot be written.";

/// The premature end of a command.
#[derive(Debug)]
pub(super) enum Failure {
    /// The reader of standard output closed the pipe. This is no error, and not printed.
    ClosedPipe,
    /// The command failed.
    Error {
        /// Exit code of the process.
        exit: Exit,
        /// The error: what happened, and what to do.
        error: anyhow::Error,
    },
}

impl Failure {
    /// A failure with its exit code.
    pub(super) fn new(exit: Exit, error: impl Into<anyhow::Error>) -> Self {
        Self::Error { exit, error: error.into() }
    }
}

/// Result of a command.
pub(super) type Outcome = Result<Exit, Failure>;

/// Adds an exit code to an error.
pub(super) trait ResultExt<T> {
    /// Turns an error into a [`Failure`] with the code `exit`.
    fn or_exit(self, exit: Exit) -> Result<T, Failure>;
}

impl<T, E: Into<anyhow::Error>> ResultExt<T> for Result<T, E> {
    fn or_exit(self, exit: Exit) -> Result<T, Failure> {
        self.map_err(|error| Failure::new(exit, error))
    }
}

/// Prints an error as one line on stderr, and returns the exit code of the process.
pub(super) fn finish(outcome: Outcome) -> ExitCode {
    let exit = match outcome {
        Ok(exit) => exit,
        Err(Failure::ClosedPipe) => Exit::Ok,
        Err(Failure::Error { exit, error }) => {
            terminal::complain(format_args!("error: {}", sentence(&error)));
            exit
        }
    };
    ExitCode::from(exit as u8)
}

/// Parses the command line: usage errors exit with [`Exit::Usage`], `--help` and `--version` with [`Exit::Ok`].
pub(super) fn parse<C: clap::Parser>() -> Result<C, Exit> {
    C::try_parse().map_err(|error| {
        let is_usage = error.use_stderr();
        match error.print() {
            _ if is_usage => Exit::Usage,
            Err(unwritten) if unwritten.kind() != std::io::ErrorKind::BrokenPipe => Exit::Io,
            _ => Exit::Ok,
        }
    })
}

/// The error with its causes in one line, without repeated causes and without source locations of libraries.
fn sentence(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text = format!("{text}: {cause}");
        }
    }
    let is_location = |word: &str| word.contains(".rs:");
    let mut words: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        if !is_location(word) {
            words.push(word.to_owned());
            continue;
        }
        words.pop_if(|word| word == "at");
        if let Some(last) = words.last_mut().filter(|_| word.ends_with(')')) {
            last.push(')');
        }
    }
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bracket_around_a_source_location_is_closed() {
        let error =
            anyhow::anyhow!("no answer (zenoh: cannot connect. Timeout! at /root/zenoh/src/orchestrator.rs:89.)");
        assert_eq!(sentence(&error), "no answer (zenoh: cannot connect. Timeout!)");
    }

    #[test]
    fn an_error_is_one_sentence_without_repetition() {
        let error = anyhow::anyhow!("no such column: b9 at /root/.cargo/registry/x-1.0/src/orchestrator.rs:12. (x)")
            .context("reading the database failed: no such column: b9 at /root/.cargo/registry/x-1.0/src/orchestrator.rs:12. (x)")
            .context("the question\n  cannot be answered");
        assert_eq!(
            sentence(&error),
            "the question cannot be answered: reading the database failed: no such column: b9 (x)"
        );
    }
}
