//! Scores the diagnosis on simulated fleets.
