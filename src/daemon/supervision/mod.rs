//! Supervision: the tasks and their heartbeats, the watchdog of systemd, the lock of the database, the presence
//! of loggers and daemons, and the status.

pub(super) mod heartbeat;
pub(super) mod lock;
pub(super) mod peers;
pub(super) mod presence;
pub(super) mod status;
pub(super) mod tasks;
pub(super) mod watchdog;
