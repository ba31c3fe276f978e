//! Keys and payloads on zenoh: pure encoding and decoding.
//!
//! Decoding returns a value or an error for any bytes. It does not panic, its recursion has a fixed limit, and it
//! allocates at most a small multiple of the size of the payload.

mod alarm;
mod backlog;
mod command;
mod health;
mod key;
mod query;
mod text;
mod throw;

/// Number of bytes kept of a message that is no valid throw, from its start: enough to recognise format and sender.
pub const QUARANTINED_BYTES: usize = 1024;

pub use alarm::{Alarm, alarm_id, kind_of, without_subject};
pub use backlog::{BacklogQuery, MAX_PAGE};
pub use command::{CommandTarget, Reply, decode_command};
pub use health::{BaselineProgress, Health, is_rejection};
pub use key::{
    EVERY_MONITOR_ALIVE, EVERY_MONITOR_STATUS, Kind, Scope, machine_key, machine_patterns, monitor_alive_key,
    monitor_status_key, parse_key, parse_monitor_key,
};
pub use query::{HistoryQuery, MAX_HISTORY, check_parameters};
pub use text::{Invalid, json, json_bytes, without_byte_order_mark};
pub use throw::{Encoding, decode_throw, encode_throw, is_boot_id, throw_id};
