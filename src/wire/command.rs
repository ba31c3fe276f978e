//! Operators' commands (JSON, in the payload of a query on `points/v1/{site}/{machine}/command`) and the reply.

use serde::{Deserialize, Serialize};

use super::json;
use crate::diagnose::Command;

/// Largest command, in bytes: names and a reason, no more.
const MAX_BYTES: usize = 8 * 1024;

/// Why a payload is no command.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidCommand {
    /// There is nothing in it, or too much.
    #[error("the command has {bytes} bytes, must be 1 to {MAX_BYTES}")]
    Size {
        /// Its size.
        bytes: usize,
    },
    /// It is not a command in JSON.
    #[error("not a command: {problem}; for example {{\"command\": \"ack\", \"cause\": \"friction\", \"by\": \"who\"}}")]
    Json {
        /// What is wrong, with line and column.
        problem: String,
    },
}

/// Reads a command.
///
/// # Errors
/// When the payload is empty, too large or no command in JSON.
pub fn decode_command(payload: &[u8]) -> Result<Command, InvalidCommand> {
    if !(1..=MAX_BYTES).contains(&payload.len()) {
        return Err(InvalidCommand::Size { bytes: payload.len() });
    }
    serde_json::from_slice(payload).map_err(|error| InvalidCommand::Json { problem: error.to_string() })
}

/// What the daemon answers to a command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// Whether the command was carried out.
    pub done: bool,
    /// One sentence: what was done, or why not.
    pub text: String,
    /// The daemon that answers, as `{site}/{id}` of its section `[monitor]`.
    #[serde(default)]
    pub monitor: String,
}

/// A daemon that carries out the commands of a machine: the reply to a question without payload on the machine's
/// command key. A command that names the session in its selector (`?session=…`) is for that daemon alone.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Commander {
    /// Its name, as `{site}/{id}` of its section `[monitor]`.
    pub monitor: String,
    /// Its zenoh session, which tells two daemons of the same name apart.
    pub session: String,
}

impl Reply {
    /// The reply as JSON.
    #[must_use]
    pub fn to_json(&self) -> Vec<u8> {
        json(self)
    }
}
