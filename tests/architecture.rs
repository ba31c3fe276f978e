//! Keeps the architecture: the pure core names no runtime, network, database, clock or process.

#![expect(clippy::unwrap_used, reason = "a test may stop on an error, in its helpers too")]

use std::{fs, path::Path};

/// The rooms of the core, each with the rooms of this crate that it may name.
const CORE: &[(&str, &[&str])] = &[
    ("throw", &[]),
    ("estimate", &["throw"]),
    ("diagnose", &["estimate", "throw"]),
    ("simulate", &["throw"]),
    ("evaluate", &["diagnose", "estimate", "report", "simulate", "throw"]),
    ("report", &[]),
    ("wire", &["diagnose", "estimate", "throw"]),
];

const ROOMS: &[&str] = &[
    "bus", "cli", "daemon", "diagnose", "estimate", "evaluate", "logger", "report", "simulate", "store", "throw",
    "web", "wire",
];

/// Rooms of the shell with the rooms of this crate that each may name.
const SHELL: &[(&str, &[&str])] = &[
    ("store", &["diagnose", "estimate", "throw", "wire"]),
    ("bus", &["diagnose", "throw", "wire"]),
    ("daemon", &["bus", "diagnose", "estimate", "store", "throw", "wire"]),
    ("web", &["daemon", "diagnose", "report", "store", "throw", "wire"]),
];

/// What the dashboard may not name, as it only reads: all that could write, publish or command.
const WRITING_WORDS: &[&str] = &["Store", "Daemon", "zenoh", "sqlx", "Command", "std::fs", "std::process"];

/// Words that only the shell may use.
const SHELL_WORDS: &[&str] = &[
    "tokio",
    "zenoh",
    "zenoh_ext",
    "sqlx",
    "std::fs",
    "std::net",
    "std::env",
    "std::process",
    "SystemTime",
    "Instant",
    "Timestamp::now",
    "rand::rng",
    "thread_rng",
    "from_os_rng",
];

fn names(code: &str, word: &str) -> bool {
    let boundary = |c: Option<char>| c.is_none_or(|c| !c.is_alphanumeric() && c != '_');
    code.match_indices(word)
        .any(|(at, _)| boundary(code[..at].chars().next_back()) && boundary(code[at + word.len()..].chars().next()))
}

/// The lines of `source` that are code and not under `#[cfg(test)]` at the end of the file.
fn code_lines(source: &str) -> impl Iterator<Item = (usize, &str)> {
    source
        .lines()
        .enumerate()
        .take_while(|(_, line)| line.trim() != "#[cfg(test)]")
        .map(|(at, line)| (at + 1, line.split("//").next().unwrap_or_default()))
}

fn visit(dir: &Path, check: &mut dyn FnMut(&Path, &str)) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            visit(&path, check);
        } else if path.extension().is_some_and(|ext| ext == "rs") && !path.ends_with("tests.rs") {
            check(&path, &fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn the_core_is_pure_and_its_arrows_point_one_way() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut offences = Vec::new();
    let mut files = 0;
    for (room, allowed) in CORE {
        visit(&source.join(room), &mut |path, text| {
            files += 1;
            for (line_no, line) in code_lines(text) {
                for word in SHELL_WORDS.iter().filter(|word| names(line, word)) {
                    offences.push(format!("{}:{line_no}: {room} names {word}", path.display()));
                }
                for other in ROOMS.iter().filter(|other| *other != room && !allowed.contains(other)) {
                    if line.contains(&format!("crate::{other}")) || line.contains(&format!("crate::{{{other}")) {
                        offences.push(format!("{}:{line_no}: {room} names the room {other}", path.display()));
                    }
                }
            }
        });
    }
    assert!(files >= CORE.len(), "only {files} files were read");
    assert!(offences.is_empty(), "{}", offences.join("\n"));
}

/// The rooms of this crate, other than its own, that a line of a room names and may not.
fn foreign<'a>(line: &'a str, room: &'a str, allowed: &'a [&str]) -> impl Iterator<Item = &'a &'a str> {
    let named =
        move |other: &&&str| line.contains(&format!("crate::{other}")) || line.contains(&format!("crate::{{{other}"));
    // Inside `use crate::{ … }` a room stands at the beginning of its line.
    let listed =
        move |other: &&&str| line.strip_prefix("    ").is_some_and(|line| line.starts_with(&format!("{other}::")));
    ROOMS
        .iter()
        .filter(move |other| **other != room && !allowed.contains(other))
        .filter(move |other| named(other) || listed(other))
}

#[test]
fn the_shell_has_layers_and_the_dashboard_only_reads() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut offences = Vec::new();
    for (room, allowed) in SHELL {
        visit(&source.join(room), &mut |path, text| {
            for (line_no, line) in code_lines(text) {
                for other in foreign(line, room, allowed) {
                    offences.push(format!("{}:{line_no}: {room} names the room {other}", path.display()));
                }
                for word in WRITING_WORDS.iter().filter(|word| *room == "web" && names(line, word)) {
                    offences.push(format!("{}:{line_no}: {room} names {word}", path.display()));
                }
            }
        });
    }
    assert!(offences.is_empty(), "{}", offences.join("\n"));
}

#[test]
fn the_check_can_fail() {
    assert!(names("use tokio::sync;", "tokio"));
    assert!(!names("// my_tokio", "tokio"));
    assert!(names("use zenoh::Session;", "zenoh"));
    assert_eq!(foreign("use crate::daemon::View;", "store", &["wire"]).count(), 1);
    assert_eq!(foreign("    daemon::View,", "store", &["wire"]).count(), 1);
    assert_eq!(foreign("    daemon::View,", "web", &["daemon"]).count(), 0);
    assert_eq!(code_lines("a\n#[cfg(test)]\nb").count(), 1);
}
