//! Zenoh accepts every shipped configuration, and its comments are true.

use super::site::{read, zenoh_table};

#[test]
fn every_shipped_zenoh_configuration_is_taken() {
    zenoh_table(&read("zenoh/cabinet.toml"));
    for file in ["zenoh/router.json5", "zenoh/client.json5"] {
        zenoh::Config::from_json5(&read(file)).unwrap_or_else(|error| panic!("deploy/{file}: {error}"));
    }
}
