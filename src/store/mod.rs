//! The SQLite database: raw throws, estimates, alarms, the outbox.
