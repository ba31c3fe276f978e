//! Checks the architecture: the core is pure, the rooms form layers, and imports between files have no cycle.

#![expect(clippy::unwrap_used, reason = "a test may stop on an error, in its helpers too")]

mod documents;
mod paths;

use std::path::Path;

use paths::{Name, Sources, Target};
use petgraph::{algo::tarjan_scc, graphmap::DiGraphMap};

/// Each room of the core, with the other rooms that it may use.
const CORE: &[(&str, &[&str])] = &[
    ("throw", &[]),
    ("estimate", &["throw"]),
    ("diagnose", &["estimate", "throw"]),
    ("simulate", &["throw"]),
    ("evaluate", &["diagnose", "estimate", "report", "simulate", "throw"]),
    ("report", &[]),
    ("wire", &["diagnose", "estimate", "throw"]),
];

/// Each room of the shell, with the other rooms that it may use.
const SHELL: &[(&str, &[&str])] = &[
    ("store", &["diagnose", "estimate", "throw", "wire"]),
    ("bus", &["diagnose", "throw", "wire"]),
    ("logger", &["bus", "daemon", "simulate", "throw", "wire"]),
    ("daemon", &["bus", "diagnose", "estimate", "store", "throw", "wire"]),
    ("web", &["daemon", "diagnose", "estimate", "report", "store", "throw", "wire"]),
    (
        "cli",
        &[
            "bus", "daemon", "diagnose", "estimate", "evaluate", "logger", "report", "simulate", "store", "throw",
            "web", "wire",
        ],
    ),
];

/// Paths for the shell only: runtimes, the network, files, databases, processes, clocks and random sources.
const IMPURE: &[&str] = &[
    "axum",
    "jiff::Timestamp::now",
    "jiff::Zoned::now",
    "rand::rng",
    "rustix",
    "sqlx",
    "std::env",
    "std::fs",
    "std::net",
    "std::process",
    "std::time::Instant",
    "std::time::SystemTime",
    "tokio",
    "tokio_util",
    "zenoh",
];

/// Paths that the dashboard may not use, because they could write or publish. Commands go through the daemon's view.
const WRITES: &[&str] = &["crate::daemon::Daemon", "crate::store::Store", "sqlx", "std::fs", "std::process", "zenoh"];

/// The whole path of a target.
fn path_of(target: &Target) -> String {
    match target {
        Target::Item(module, item) => format!("crate::{}::{item}", module.join("::")),
        Target::Module(module) => format!("crate::{}", module.join("::")),
        Target::Foreign(path) => path.join("::"),
    }
}

/// Whether `target` is `forbidden` or below it. A type of this crate is identified by its room and its name only.
fn is_below(target: &Target, forbidden: &str) -> bool {
    let path = match target {
        Target::Item(module, item) if !module.is_empty() => format!("crate::{}::{item}", module[0]),
        _ => path_of(target),
    };
    path == forbidden || path.strip_prefix(forbidden).is_some_and(|rest| rest.starts_with("::"))
}

/// The forbidden paths in the files of `room`, and paths to rooms that are not `allowed`.
fn offences(sources: &Sources, room: &str, allowed: &[&str], forbidden: &[&str]) -> Vec<String> {
    let mut offences = Vec::new();
    for (module, file) in sources.files.iter().filter(|(module, _)| module.first().is_some_and(|first| first == room)) {
        for target in sources.targets(module) {
            let other = match &target {
                Target::Item(module, _) | Target::Module(module) => module.first().map(String::as_str),
                Target::Foreign(_) => None,
            };
            let is_foreign_room = other.is_some_and(|other| other != room && !allowed.contains(&other));
            if is_foreign_room || forbidden.iter().any(|word| is_below(&target, word)) {
                offences.push(format!("{}: {room} names {}", file.path.display(), path_of(&target)));
            }
        }
    }
    offences
}

/// Cycles of imports between files.
fn cycles(sources: &Sources) -> Vec<String> {
    let mut imports = DiGraphMap::<&Name, ()>::new();
    for module in sources.files.keys() {
        for target in sources.targets(module) {
            if let Target::Item(other, _) = target
                && other != *module
            {
                let other = sources.files.get_key_value(&other).unwrap().0;
                imports.add_edge(module, other, ());
            }
        }
    }
    let cycles = tarjan_scc(&imports).into_iter().filter(|cycle| cycle.len() > 1);
    let path = |module: &Name| sources.files[module].path.display().to_string();
    cycles
        .map(|cycle| {
            let mut edges: Vec<String> = imports
                .all_edges()
                .filter(|(from, to, ())| cycle.contains(from) && cycle.contains(to))
                .map(|(from, to, ())| format!("  {} -> {}", path(from), path(to)))
                .collect();
            edges.sort();
            format!("{} files import each other:\n{}", cycle.len(), edges.join("\n"))
        })
        .collect()
}

fn sources() -> Sources {
    Sources::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"))
}

#[test]
fn the_core_is_pure_and_its_arrows_point_one_way() {
    let sources = sources();
    let offences: Vec<String> =
        CORE.iter().flat_map(|(room, allowed)| offences(&sources, room, allowed, IMPURE)).collect();
    assert!(offences.is_empty(), "{}", offences.join("\n"));
}

#[test]
fn the_shell_has_layers_and_the_dashboard_writes_nothing_itself() {
    let sources = sources();
    let forbidden = |room: &str| if room == "web" { WRITES } else { &[] };
    let offences: Vec<String> =
        SHELL.iter().flat_map(|(room, allowed)| offences(&sources, room, allowed, forbidden(room))).collect();
    assert!(offences.is_empty(), "{}", offences.join("\n"));
}

#[test]
fn every_room_has_its_layer() {
    let sources = sources();
    let rooms = sources.files.keys().filter_map(|module| module.first());
    for room in rooms {
        assert!(CORE.iter().chain(SHELL).any(|(known, _)| known == room), "{room} is in neither list");
    }
}

#[test]
fn no_file_imports_a_file_that_imports_it_back() {
    let cycles = cycles(&sources());
    assert!(cycles.is_empty(), "{}", cycles.join("\n"));
}

/// A small crate with these files: (path, text).
fn crate_of(files: &[(&str, &str)]) -> Sources {
    let mut sources = Sources::default();
    for (place, text) in files {
        sources.add(Path::new(place), text);
    }
    sources
}

#[test]
fn the_checks_see_every_way_to_import() {
    let impure = [
        "use tokio::sync;",
        "use std::{collections::HashMap, fs};",
        "use std::{\n    collections::HashMap,\n    time::{\n        Duration,\n        Instant,\n    },\n};",
        "use jiff::Timestamp; fn now() -> Timestamp { Timestamp::now() }",
        "use jiff::Timestamp as Moment; fn now() { let now = Moment::now(); }",
        "fn read() { let _ = std::fs::read(\"x\"); }",
        "fn log() { println!(\"{:?}\", std::env::args()); }",
        "use crate::{\n    throw::Throw,\n    store::Store,\n};",
        "fn open() { crate::store::Store::open(); }",
        "use super::store;",
    ];
    for text in impure {
        let sources = crate_of(&[
            ("lib.rs", ""),
            ("estimate/mod.rs", text),
            ("store/mod.rs", "pub struct Store;"),
            ("throw/mod.rs", "pub struct Throw;"),
        ]);
        assert_eq!(offences(&sources, "estimate", &["throw"], IMPURE).len(), 1, "{text}");
    }
    let pure = crate_of(&[
        ("lib.rs", ""),
        ("estimate/mod.rs", "use std::time::Duration; #[cfg(test)] mod tests { use std::fs; }"),
    ]);
    assert!(offences(&pure, "estimate", &[], IMPURE).is_empty());
}

#[test]
fn the_check_sees_cycles() {
    // Through a re-export, and through a third file.
    let cycle = crate_of(&[
        ("lib.rs", ""),
        ("room/mod.rs", "mod one; mod two; mod three; pub use one::One; pub use three::Three;"),
        ("room/one.rs", "use super::two::Two; pub struct One(Two);"),
        ("room/two.rs", "use crate::room::Three; pub struct Two(Three);"),
        ("room/three.rs", "pub struct Three; fn back() { super::one::One::new(); }"),
    ]);
    assert_eq!(cycles(&cycle).len(), 1);
    // An item of mod.rs that a child uses, while mod.rs uses the child.
    let parent = crate_of(&[
        ("lib.rs", ""),
        ("room/mod.rs", "mod child; use child::Child; pub struct Parent(Child);"),
        ("room/child.rs", "use super::Parent; pub struct Child; impl From<Parent> for Child {}"),
    ]);
    assert_eq!(cycles(&parent).len(), 1);
    let tree = crate_of(&[
        ("lib.rs", ""),
        ("room/mod.rs", "mod one; mod two; pub use one::One; pub use two::Two;"),
        ("room/one.rs", "use super::Two; pub struct One(Two);"),
        ("room/two.rs", "pub struct Two;"),
    ]);
    assert!(cycles(&tree).is_empty());
}
