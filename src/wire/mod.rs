//! Keys and payloads on zenoh.
