//! The running monitor: pipeline, supervision, configuration.
