//! Every test that a page of `deploy/` names exists.

use std::{collections::HashSet, fs, path::Path};

/// Least number of words in a name that counts as a test: the shortest test on the pages has three. Names of other
/// programs and of SQL states have fewer.
const LEAST_WORDS: usize = 3;

/// Adds the names that the sources below `folder` define: functions only, or every word.
fn add_names(folder: &Path, only_functions: bool, names: &mut HashSet<String>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            add_names(&path, only_functions, names);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = fs::read_to_string(&path).unwrap();
            let words: Vec<&str> = text.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
            let defined = words.windows(2).filter(|pair| !only_functions || pair[0] == "fn").map(|pair| pair[1]);
            names.extend(defined.map(str::to_owned));
        }
    }
}

/// The names in backticks of a page that may be tests; metrics have the prefix `pointsd_`.
fn cited(page: &str) -> impl Iterator<Item = &str> {
    let is_name = |it: &&str| it.chars().all(|c| c == '_' || c.is_ascii_lowercase() || c.is_ascii_digit());
    let code = page.split('`').skip(1).step_by(2).filter(is_name);
    code.filter(|it| it.split('_').count() >= LEAST_WORDS && !it.starts_with("pointsd_"))
}

#[test]
fn the_tests_that_the_pages_cite_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut names = HashSet::new();
    add_names(&root.join("tests"), true, &mut names);
    // Settings, fields and columns are words of the program.
    add_names(&root.join("src"), false, &mut names);
    let pages = ["THREATS.md", "LIMITS.md", "MESSAGES.md", "INSTALL.md", "RECORDINGS.md", "REGION.md"];
    let pages = pages.map(|page| (page, fs::read_to_string(root.join("deploy").join(page)).unwrap()));
    let unknown: Vec<String> = pages
        .iter()
        .flat_map(|(page, text)| {
            cited(text).filter(|name| !names.contains(*name)).map(move |it| format!("{page}: {it}"))
        })
        .collect();
    assert!(unknown.is_empty(), "{}", unknown.join("\n"));
    assert!(cited(&pages[0].1).count() > 50, "the page of threats cites its tests");
}

#[test]
fn a_renamed_test_is_found() {
    let page =
        "no throw (`a_throw_is_lost`), `rest`, `pointsd_throws_total`, or `anti alias`; (`one_two`, `keys_take_turns`)";
    assert_eq!(cited(page).collect::<Vec<_>>(), ["a_throw_is_lost", "keys_take_turns"]);
}
