//! The database: migrations, views, failures of disk and power.
