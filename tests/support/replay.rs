//! The disk after a power cut, reconstructed from the log of the shim.
//!
//! Model: synced data are on the disk. A write or truncation without a sync is on the disk completely, partly (any of
//! its sectors of 512 bytes) or not at all. Name changes (a file is created, removed, renamed or linked) happen in
//! order, as in a journalling file system: after a cut the first of them exist, at least up to the last sync of the
//! folder and up to the creation of each synced file.

#![allow(dead_code, reason = "shared by test targets, each of which needs some of it")]

use std::{collections::BTreeMap, fs, os::unix::fs::symlink, path::Path};

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SECTOR: usize = 512;

pub(crate) struct Record {
    kind: u8,
    path: String,
    offset: u64,
    data: Vec<u8>,
}

impl Record {
    /// Whether the database was moved to another file.
    pub(crate) fn is_move(&self) -> bool {
        self.kind == b'L'
    }

    /// Whether the record is an acknowledgement to a client.
    pub(crate) fn is_acknowledgement(&self) -> bool {
        self.kind == b'A'
    }

    fn is_of_wal(&self) -> bool {
        self.path.ends_with("-wal")
    }
}

/// The log with `synchronous = NORMAL`: SQLite then syncs the write-ahead log after its header and before a checkpoint,
/// but not at each commit.
pub(crate) fn without_commit_syncs(records: Vec<Record>) -> Vec<Record> {
    const HEADER: usize = 32;
    let files: Vec<usize> = (0..records.len()).filter(|&at| !records[at].is_acknowledgement()).collect();
    let mut is_dropped: Vec<bool> = vec![false; records.len()];
    for around in files.windows(3) {
        let [before, sync, after] = [0, 1, 2].map(|at| &records[around[at]]);
        let is_commit = sync.kind == b'S' && sync.is_of_wal() && before.is_of_wal() && after.is_of_wal();
        is_dropped[around[1]] = is_commit && before.data.len() != HEADER;
    }
    records.into_iter().zip(is_dropped).filter(|(_, dropped)| !dropped).map(|(record, _)| record).collect()
}

/// Reads the log of the shim up to its end or an incomplete record.
pub(crate) fn read_log(path: &Path) -> Vec<Record> {
    let bytes = fs::read(path).unwrap();
    let mut rest = &bytes[..];
    let mut records = Vec::new();
    while let Some((head, after)) = rest.split_first_chunk::<17>() {
        let word = |at: usize| u32::from_ne_bytes(head[at..at + 4].try_into().unwrap()) as usize;
        let (path_bytes, data_bytes) = (word(1), word(5));
        if after.len() < path_bytes + data_bytes {
            break;
        }
        records.push(Record {
            kind: head[0],
            path: String::from_utf8(after[..path_bytes].to_vec()).unwrap(),
            offset: u64::from_ne_bytes(head[9..].try_into().unwrap()),
            data: after[path_bytes..path_bytes + data_bytes].to_vec(),
        });
        rest = &after[path_bytes + data_bytes..];
    }
    records
}

#[derive(Clone)]
enum Change {
    Write(usize, Vec<u8>),
    Truncate(usize),
}

impl Change {
    fn apply(&self, content: &mut Vec<u8>) {
        match self {
            Self::Write(at, data) => write_at(content, *at, data),
            Self::Truncate(size) => content.resize(*size, 0),
        }
    }

    /// Applies random sectors of a write, and no truncation.
    fn apply_torn(&self, content: &mut Vec<u8>, rng: &mut impl Rng) {
        match self {
            Self::Write(at, data) => {
                for (sector, data) in data.chunks(SECTOR).enumerate() {
                    if rng.random_bool(0.5) {
                        write_at(content, at + sector * SECTOR, data);
                    }
                }
            }
            Self::Truncate(_) => {}
        }
    }
}

fn write_at(content: &mut Vec<u8>, at: usize, data: &[u8]) {
    content.resize(content.len().max(at + data.len()), 0);
    content[at..at + data.len()].copy_from_slice(data);
}

#[derive(Default)]
struct Content {
    synced: Vec<u8>,
    pending: Vec<Change>,
    /// Number of name changes up to the creation of this file.
    created: usize,
}

#[derive(Clone)]
enum NameChange {
    Create(String, usize),
    Unlink(String),
    Rename(String, String),
    Symlink(String, String),
}

/// Content of the disk and of the page cache after part of the log.
#[derive(Default)]
pub(crate) struct Disk {
    contents: Vec<Content>,
    /// The names from the view of the process.
    live: BTreeMap<String, usize>,
    name_changes: Vec<NameChange>,
    name_changes_synced: usize,
    /// The acknowledgements so far, one in a line.
    pub(crate) acknowledged: String,
}

impl Disk {
    fn apply(&mut self, record: &Record) {
        match record.kind {
            b'A' => self.acknowledged += std::str::from_utf8(&record.data).unwrap(),
            b'D' => self.name_changes_synced = self.name_changes.len(),
            b'W' => self.change(record, Change::Write(at(record), record.data.clone())),
            b'T' => self.change(record, Change::Truncate(at(record))),
            b'S' => self.sync(record),
            b'U' => {
                self.live.remove(&record.path);
                self.name_changes.push(NameChange::Unlink(record.path.clone()));
            }
            b'R' => {
                let to = String::from_utf8(record.data.clone()).unwrap();
                if let Some(file) = self.live.remove(&record.path) {
                    self.live.insert(to.clone(), file);
                } else {
                    self.live.remove(&to);
                }
                self.name_changes.push(NameChange::Rename(record.path.clone(), to));
            }
            b'L' => {
                let target = String::from_utf8(record.data.clone()).unwrap();
                self.name_changes.push(NameChange::Symlink(target, record.path.clone()));
            }
            other => panic!("unknown kind of record: {other}"),
        }
    }

    fn file(&mut self, path: &str) -> usize {
        if let Some(&file) = self.live.get(path) {
            return file;
        }
        let file = self.contents.len();
        self.name_changes.push(NameChange::Create(path.to_owned(), file));
        self.contents.push(Content { created: self.name_changes.len(), ..Content::default() });
        self.live.insert(path.to_owned(), file);
        file
    }

    fn change(&mut self, record: &Record, change: Change) {
        let file = self.file(&record.path);
        self.contents[file].pending.push(change);
    }

    fn sync(&mut self, record: &Record) {
        let file = self.file(&record.path);
        let content = &mut self.contents[file];
        for change in content.pending.drain(..) {
            change.apply(&mut content.synced);
        }
        self.name_changes_synced = self.name_changes_synced.max(content.created);
    }

    /// Writes a possible state of the disk after a cut into `folder`; the log has paths below `original`.
    fn after_cut(&self, original: &Path, folder: &Path, rng: &mut impl Rng) {
        let last = rng.random_range(self.name_changes_synced..=self.name_changes.len());
        let place = |path: &str| folder.join(Path::new(path).strip_prefix(original).unwrap());
        let severity = rng.random_range(0..3);
        for change in &self.name_changes[..last] {
            match change {
                NameChange::Create(path, file) => {
                    fs::write(place(path), self.contents[*file].torn(severity, rng)).unwrap();
                }
                NameChange::Unlink(path) => {
                    let _ = fs::remove_file(place(path));
                }
                NameChange::Rename(from, to) => fs::rename(place(from), place(to)).unwrap(),
                NameChange::Symlink(target, path) => symlink(target, place(path)).unwrap(),
            }
        }
    }
}

impl Content {
    /// Content after a cut. Severity 0: synced data only; 1: all changes, the last one partly; 2: any of the changes.
    fn torn(&self, severity: u32, rng: &mut impl Rng) -> Vec<u8> {
        let mut content = self.synced.clone();
        for (index, change) in self.pending.iter().enumerate() {
            match severity {
                0 => {}
                1 if index + 1 == self.pending.len() => change.apply_torn(&mut content, rng),
                1 => change.apply(&mut content),
                _ => match rng.random_range(0..3) {
                    0 => {}
                    1 => change.apply_torn(&mut content, rng),
                    _ => change.apply(&mut content),
                },
            }
        }
        content
    }
}

fn at(record: &Record) -> usize {
    usize::try_from(record.offset).unwrap()
}

/// Cuts the power at `cuts` random points of the log of a run whose files were in `original`. `check` gets the disk at
/// each cut, and a folder with its files.
pub(crate) async fn cut_at_random(
    records: &[Record],
    original: &Path,
    cuts: usize,
    seed: u64,
    mut check: impl AsyncFnMut(&Disk, &Path),
) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut points: Vec<usize> = (0..cuts).map(|_| rng.random_range(0..=records.len())).collect();
    points.sort_unstable();
    let mut disk = Disk::default();
    let mut applied = 0;
    for point in points {
        records[applied..point].iter().for_each(|record| disk.apply(record));
        applied = point;
        let folder = tempfile::tempdir().unwrap();
        disk.after_cut(original, folder.path(), &mut rng);
        check(&disk, folder.path()).await;
    }
}
