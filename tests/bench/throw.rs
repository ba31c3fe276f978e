//! How long one throw takes: identification beside its peer, and simulation beside its reference.

fn main() {}
