//! The simulated point machine and fleets of them. Shares only the throw type with the monitor.
