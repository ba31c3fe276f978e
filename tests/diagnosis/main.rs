//! The diagnosis: causes, alarms, restarts, the scored table.
