//! The real programs over loopback: daemon, logger, operators, foreign clients.
