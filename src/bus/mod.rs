//! Zenoh sessions, publishers, subscribers and queries.
