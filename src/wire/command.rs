//! Commands of operators (JSON, in the payload of a query on `points/v1/{site}/{machine}/command`) and their replies.

use serde::{Deserialize, Serialize};

use super::{
    Invalid,
    text::{not_an_object, without_byte_order_mark},
};
use crate::diagnose::Command;

/// Largest command \[bytes\]: enough for names and a reason.
const MAX_BYTES: usize = 8 * 1024;

/// Decodes a command.
///
/// # Errors
/// When the payload is empty, too large or not a command in JSON.
pub fn decode_command(payload: &[u8]) -> Result<Command, Invalid> {
    if !(1..=MAX_BYTES).contains(&payload.len()) {
        return Err(Invalid(format!("the command has {} bytes, must be 1 to {MAX_BYTES}", payload.len())));
    }
    let example = "{\"command\": \"ack\", \"cause\": \"friction\", \"by\": \"who\"}";
    serde_json::from_slice(without_byte_order_mark(payload)).map_err(|error| {
        let problem = not_an_object(payload).unwrap_or_else(|| error.to_string());
        Invalid(format!("not a command: {problem}; for example {example}"))
    })
}

/// The daemon's reply to a command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reply {
    /// Whether the command was applied.
    pub done: bool,
    /// One sentence: the effect of the command, or the reason for the refusal.
    pub text: String,
    /// Name of the replying daemon: `{site}/{id}` of its section `[monitor]`.
    #[serde(default)]
    pub monitor: String,
}

/// Identifies a daemon that applies the commands for a machine: the reply to a query without payload on the machine's
/// command key. A command with this session in its selector (`?session=…`) is applied by this daemon only.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CommandTarget {
    /// Name of the daemon: `{site}/{id}` of its section `[monitor]`.
    pub monitor: String,
    /// Identifier of its zenoh session: two daemons may have the same name, but not the same session.
    pub session: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_may_begin_with_a_byte_order_mark_and_is_an_object() {
        let command = "{\"command\": \"maintenance_end\", \"by\": \"a\"}";
        let marked = format!("\u{feff}{command}");
        assert!(matches!(decode_command(marked.as_bytes()), Ok(Command::MaintenanceEnd { .. })));
        let utf_16: Vec<u8> = marked.encode_utf16().flat_map(u16::to_le_bytes).collect();
        for wrong in [&utf_16[..], b"[1]", b"null", b"\"ack\""] {
            let error = decode_command(wrong).unwrap_err().to_string();
            assert!(error.contains("instead of {: JSON in UTF-8 is expected; for example"), "{error}");
        }
    }

    #[test]
    fn the_error_names_a_wrong_end() {
        let ending = |until: &str| {
            let command =
                serde_json::json!({"command": "shelve", "cause": "motor", "until": until, "by": "a", "why": "b"});
            decode_command(command.to_string().as_bytes())
        };
        let error = ending("tomorrow").unwrap_err().to_string();
        assert!(error.contains("`until` is not a time, as 2026-05-04T06:00:00Z"), "{error}");
        assert!(matches!(
            ending("2026-05-04T06:00:00Z"),
            Ok(Command::Shelve { cause: crate::diagnose::Cause::Kt, .. })
        ));
    }
}
