//! A configuration file with the position of every key, for errors with file, line and key.

use std::{
    fs,
    io::Read as _,
    ops::Range,
    path::{Path, PathBuf},
};

use serde::de::DeserializeOwned;
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use crate::throw::OutOfRange;

/// Largest configuration file \[bytes\]; a larger file cannot be a configuration.
const MAX_BYTES: u64 = 4 << 20;

/// An error in a configuration. `Display` is one line: file, line, key, problem.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigError {
    /// The file.
    pub file: PathBuf,
    /// The line, from 1; `None` for the file as a whole.
    pub line: Option<usize>,
    /// The key, as `store.path` or `machine[2].lead_mm`.
    pub key: Option<String>,
    /// The problem, and the allowed values.
    pub problem: String,
}

impl std::error::Error for ConfigError {}

impl std::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let line = self.line.map(|line| format!(":{line}")).unwrap_or_default();
        let key = self.key.as_ref().map(|key| format!(": {key}")).unwrap_or_default();
        write!(f, "{}{line}{key}: {}", self.file.display(), self.problem)
    }
}

/// Position of a key and its value in the text \[bytes\].
struct Place {
    /// The key with its sections, as `machine[2].lead_mm`.
    path: String,
    key: Range<usize>,
    value: Range<usize>,
}

/// The text of a configuration file with the positions of its keys.
pub struct Document {
    file: PathBuf,
    text: String,
    places: Vec<Place>,
}

impl Document {
    /// Reads a file; an empty document without one, for the built-in defaults.
    ///
    /// # Errors
    /// When the file cannot be read, or is not text or not TOML.
    pub fn read_or_empty(file: Option<&Path>) -> Result<Self, ConfigError> {
        file.map_or_else(|| Self::parse("built-in defaults".as_ref(), String::new()), Self::read)
    }

    /// Reads a file.
    ///
    /// # Errors
    /// When the file cannot be read, or is not text or not TOML.
    pub fn read(file: &Path) -> Result<Self, ConfigError> {
        let failed = |problem: String| ConfigError { file: file.to_owned(), line: None, key: None, problem };
        let mut text = String::new();
        fs::File::open(file)
            .and_then(|file| file.take(MAX_BYTES + 1).read_to_string(&mut text))
            .map_err(|error| failed(format!("cannot be read: {error}")))?;
        if text.len() as u64 > MAX_BYTES {
            return Err(failed(format!("has more than {MAX_BYTES} bytes, and is no configuration")));
        }
        Self::parse(file, text)
    }

    /// Parses a text as the content of `file`.
    ///
    /// # Errors
    /// When the text is not TOML.
    pub fn parse(file: &Path, text: String) -> Result<Self, ConfigError> {
        let mut document = Self { file: file.to_owned(), text, places: Vec::new() };
        let mut places = Vec::new();
        match DeTable::parse(&document.text) {
            Ok(table) => collect(&DeValue::Table(table.into_inner()), "", &mut places),
            Err(error) => return Err(document.from_toml(&error)),
        }
        document.places = places;
        Ok(document)
    }

    /// Deserializes the whole text.
    ///
    /// # Errors
    /// The first key that is unknown, missing or of the wrong type.
    pub fn deserialize<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        toml::from_str(&self.text).map_err(|error| self.from_toml(&error))
    }

    /// An error about a key, with its line; for a key that is not in the text, with the line of its section.
    pub(crate) fn error_at(&self, key: &str, problem: impl Into<String>) -> ConfigError {
        let mut path = key;
        let place = loop {
            if let Some(place) = self.places.iter().find(|place| place.path == path) {
                break Some(place);
            }
            match path.rfind(['.', '[']) {
                Some(end) => path = &path[..end],
                None => break None,
            }
        };
        ConfigError {
            file: self.file.clone(),
            line: place.map(|place| self.line(place.key.start)),
            key: Some(key.to_owned()),
            problem: problem.into(),
        }
    }

    /// The result of a check of ranges in a section; its error becomes an error about the key, with its line.
    pub(crate) fn in_section(&self, section: &str, checked: Result<(), OutOfRange>) -> Result<(), ConfigError> {
        checked.map_err(|error| self.error_at(&format!("{section}.{}", error.key), error.problem()))
    }

    /// The error of the parser, with its line and key in this document.
    #[expect(clippy::wrong_self_convention, reason = "converts the error, not the document")]
    fn from_toml(&self, error: &toml::de::Error) -> ConfigError {
        let start = error.span().map(|span| span.start);
        // The innermost key whose name or value includes the position of the error.
        let holds = |place: &&Place, at: usize| place.key.contains(&at) || place.value.contains(&at);
        let key = start
            .and_then(|at| self.places.iter().filter(|place| holds(place, at)).max_by_key(|place| place.path.len()));
        let mut problem = plain(&error.message().lines().collect::<Vec<_>>().join(", "));
        if problem.is_empty() {
            "not valid TOML".clone_into(&mut problem);
        }
        if problem == "duplicate key"
            && let Some(name) = error.span().and_then(|span| self.text.get(span))
        {
            problem = format!("duplicate key {name}");
        }
        // The parser takes `north` without quotes for the beginning of `nan`, `inf` or `false`.
        if ["invalid float", "invalid boolean", "invalid literal", "string values must be quoted"]
            .iter()
            .any(|of_text| problem.contains(of_text))
        {
            problem.push_str("; a text is written in quotes, as \"north\"");
        }
        if problem.starts_with("invalid type: map") && key.is_some_and(|place| place.path.ends_with(']')) {
            problem.push_str("; a section has one bracket on each side, as [machines], unless it is one of a list");
        }
        if problem.contains("socket address") {
            problem.push_str("; write an address with its port, as \"127.0.0.1:7480\"");
        }
        ConfigError {
            file: self.file.clone(),
            line: start.map(|at| self.line(at)),
            key: key.map(|place| place.path.clone()),
            problem,
        }
    }

    /// The line of a byte of the text, from 1.
    fn line(&self, at: usize) -> usize {
        1 + self.text.bytes().take(at).filter(|byte| *byte == b'\n').count()
    }
}

/// The message of the parser without the names of Rust's types.
fn plain(message: &str) -> String {
    let mut plain = message.replace("expected path string", "expected a text in quotes").replace(
        "map, expected a sequence",
        "section, expected a list; a section of a list has two brackets, as [[machine]]",
    );
    for (of_type, words) in [("u", "a whole number from 0"), ("i", "a whole number"), ("f", "a number")] {
        for bits in ["8", "16", "32", "64", "size"] {
            plain = plain.replace(&format!("expected {of_type}{bits}"), &format!("expected {words}"));
        }
    }
    let Some((before, rest)) = plain.split_once("expected struct ") else { return plain };
    let rest = rest.trim_start_matches(|letter: char| letter.is_alphanumeric() || letter == '_');
    format!("{before}expected a table of keys with values{rest}")
}

/// Adds the positions of all keys and list items below `path`.
fn collect(value: &DeValue<'_>, path: &str, places: &mut Vec<Place>) {
    let mut add = |path: String, key: Range<usize>, value: &Spanned<DeValue<'_>>| {
        collect(value.get_ref(), &path, places);
        places.push(Place { path, key, value: value.span() });
    };
    match value {
        DeValue::Table(table) => table.iter().for_each(|(key, value)| {
            let dot = if path.is_empty() { "" } else { "." };
            add(format!("{path}{dot}{}", key.get_ref()), key.span(), value);
        }),
        DeValue::Array(items) => items.iter().enumerate().for_each(|(index, item)| {
            add(format!("{path}[{index}]"), item.span(), item);
        }),
        _ => {}
    }
}

/// The keys in a text, with their sections.
#[cfg(test)]
pub(crate) fn keys(text: &str) -> Vec<String> {
    let document = Document::parse("keys".as_ref(), text.to_owned()).unwrap();
    document.places.into_iter().map(|place| place.path).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Example {
        #[expect(dead_code, reason = "only its reading is tested")]
        store: Store,
    }

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Store {
        #[expect(dead_code, reason = "only its reading is tested")]
        size: u32,
    }

    fn error_of(text: &str) -> String {
        let document = Document::parse(Path::new("x.toml"), text.to_owned());
        document.and_then(|document| document.deserialize::<Example>()).unwrap_err().to_string()
    }

    #[test]
    fn every_error_names_file_line_and_key() {
        assert!(error_of("[store]\nsize = 1\nsise = 2\n").starts_with("x.toml:3: store.sise: unknown field `sise`"));
        assert!(error_of("[store]\n\nsize = \"1\"\n").starts_with("x.toml:3: store.size: invalid type"));
        assert!(error_of("[store]\n").starts_with("x.toml:1: store: missing field `size`"));
        assert!(error_of("\nstore = {\n").starts_with("x.toml:"));
        assert_eq!(error_of("[store]\nsize = 1\nsize = 2\n"), "x.toml:3: duplicate key size");
        assert!(error_of("[store]\nsize = \"1\"\n").ends_with("expected a whole number from 0"));
        assert!(error_of("store = 1\n").ends_with("expected a table of keys with values"));
    }

    #[test]
    fn a_key_that_is_not_there_is_reported_at_its_section() {
        let text = "a = 1\n[[machine]]\nx = 1\n[[machine]]\ny = 2\n";
        let document = Document::parse(Path::new("x.toml"), text.to_owned()).unwrap();
        assert_eq!(document.error_at("machine[1].y", "bad").to_string(), "x.toml:5: machine[1].y: bad");
        assert_eq!(document.error_at("machine[1].z", "bad").to_string(), "x.toml:4: machine[1].z: bad");
    }
}
