//! Zenoh accepts every shipped configuration, and the container recipe copies files that exist.

use super::site::{read, zenoh_table};

#[test]
fn every_shipped_zenoh_configuration_is_valid() {
    zenoh_table(&read("zenoh/cabinet.toml"));
    for file in ["zenoh/router.json5", "zenoh/client.json5"] {
        zenoh::Config::from_json5(&read(file)).unwrap_or_else(|error| panic!("deploy/{file}: {error}"));
    }
}

/// No container engine is needed for this test: it checks the files that the recipe copies.
#[test]
fn the_container_recipe_copies_files_that_exist() {
    let recipe = read("Containerfile");
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let copied =
        recipe.lines().filter_map(|line| line.strip_prefix("COPY ")).filter(|line| !line.starts_with("--from"));
    let sources = copied.flat_map(|line| line.rsplit_once(' ').unwrap().0.split(' '));
    let missing: Vec<&str> = sources.clone().filter(|source| !root.join(source).exists()).collect();
    assert!(sources.count() >= 5 && missing.is_empty(), "{missing:?}");
    let config = recipe.split('"').find(|word| word.starts_with("/etc/")).unwrap();
    assert!(
        recipe.contains(&format!("COPY deploy/pointsd.toml {config}")),
        "the command reads the copied configuration"
    );
}
