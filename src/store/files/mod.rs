//! The files of the database: the file at the configured path, or the file to which a link there points. A link into
//! another folder, as to a larger disk, is an administrator's and stays: its target counts as the configured path.
//!
//! A program that keeps reading an old state prevents the reuse of the write-ahead log, and its lock cannot be removed.
//! So when the log reaches its limit, the database moves: a compact copy is written, the copy gets the next free number
//! in its name, and a symbolic link at the configured path is switched to the copy atomically. The reader keeps the old
//! file, which has no name any more and is freed when the reader closes it. The name of a log contains the name of its
//! database file, so neither a crash nor the reader can combine a log with the wrong database.
//!
//! A numbered file is removed only if the link at the configured path points to another numbered file. Without the
//! link, for example after a backup was restored, the numbered file may be the only copy of a history: it is renamed
//! and kept.

pub(super) mod disk;
pub(super) mod graft;
pub(super) mod open;
pub(super) mod path;
pub(super) mod salvage;

use std::{
    fs::File,
    io,
    os::unix::fs::{MetadataExt, symlink},
    path::{Path, PathBuf},
};

use jiff::Timestamp;

use self::path::{beside, database_path, folder_of, target};
use super::error::StoreError;

/// Suffixes of the files of one database; the database itself is last.
const SUFFIXES: [&str; 3] = ["-wal", "-shm", ""];
/// Infix of the name of a broken database that was set aside.
const BROKEN: &str = "-broken-";
/// Suffix of the unfinished copy of a database that moves.
const COPY: &str = "-copy";
/// Infix of a complete copy, before its number.
const MOVED: &str = "-moved-";
/// Infix of a numbered file that was not in use at a start, before the time of that start.
const UNUSED: &str = "-unused-";
/// Suffix of the text file with the summary of the saved rows.
const SAVED: &str = "-saved.txt";

/// Suffix of the unfinished copy of the readable rows of a broken database.
const SALVAGE: &str = "-salvage";
/// Suffix after [`SALVAGE`] of a copy of the broken file with a new schema.
const GRAFTED: &str = "-grafted";
/// Suffix after [`SALVAGE`] of the empty database with the layout of a moved database.
const LAYOUT: &str = "-layout";

/// The configured path of the database.
#[derive(Debug, Clone)]
pub(super) struct DatabaseFiles {
    path: PathBuf,
}

/// Device and inode of the database file and of its log; `None` for a missing file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Identity {
    pub(super) database: Option<(u64, u64)>,
    pub(super) log: Option<(u64, u64)>,
}

impl DatabaseFiles {
    pub(super) fn new(path: &Path) -> Self {
        Self { path: database_path(path) }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The database file, with links resolved. After a move it may be missing behind its link, and then still has a log.
    fn file(&self) -> PathBuf {
        std::fs::canonicalize(&self.path).ok().or_else(|| target(&self.path)).unwrap_or_else(|| self.path.clone())
    }

    /// Size of a file of the database \[bytes\]; 0 if it is missing.
    fn size(&self, suffix: &str) -> u64 {
        std::fs::metadata(beside(&self.file(), suffix)).map_or(0, |file| file.len())
    }

    /// Whether there is no database yet, or an empty file.
    pub(super) fn is_fresh(&self) -> bool {
        self.size("") == 0
    }

    /// Size of the write-ahead log \[bytes\].
    pub(super) fn log_bytes(&self) -> u64 {
        self.size("-wal")
    }

    /// Identity of the database file and log at the configured path.
    pub(super) fn identity(&self) -> Identity {
        let file = self.file();
        let of = |path: &Path| std::fs::metadata(path).ok().map(|file| (file.dev(), file.ino()));
        Identity { database: of(&file), log: of(&beside(&file, "-wal")) }
    }

    /// Renames the files that are at the path of the database and that this program did not write. Returns the new path
    /// of the database among them; `None` if there is none.
    pub(super) fn rename_foreign_files(&self) -> Result<Option<PathBuf>, StoreError> {
        let file = self.file();
        let inode = |path: &Path| std::fs::metadata(path).ok().map(|file| file.ino());
        let database = inode(&file);
        // Files that exist at the same time have different inodes, so the names differ.
        let first = database.or_else(|| inode(&beside(&file, "-wal"))).unwrap_or(0);
        let to = beside(&self.path, &format!("-replaced-{first}"));
        self.rename_to(&to)?;
        Ok(database.map(|_| to))
    }

    fn rename_to(&self, to: &Path) -> Result<(), StoreError> {
        rename_all(&self.file(), to)?;
        if self.path.is_symlink() { remove_one(&self.path) } else { Ok(()) }
    }

    /// Upper bound of the size of a copy \[bytes\].
    pub(super) fn copy_bytes(&self) -> u64 {
        self.size("") + self.size("-wal")
    }

    /// Path of the copy of a database that moves.
    pub(super) fn copy_path(&self) -> PathBuf {
        beside(&self.path, COPY)
    }

    /// Path of the copy of the readable rows of a broken database.
    fn salvage_path(&self) -> PathBuf {
        beside(&self.path, SALVAGE)
    }

    /// Removes the unfinished files of a move or a recovery that failed or was interrupted.
    pub(super) fn remove_unfinished(&self) -> Result<(), StoreError> {
        let salvage = self.salvage_path();
        let unfinished = [self.copy_path(), beside(&salvage, GRAFTED), beside(&salvage, LAYOUT), salvage];
        unfinished.iter().try_for_each(|file| remove(file))
    }

    /// Switches the configured path to a complete copy, and removes the names of the old file. Returns the new path.
    pub(super) fn switch(&self, copy: &Path) -> Result<PathBuf, StoreError> {
        let old = self.file();
        let old_had_own_name = self.path.is_symlink();
        let error = |action| StoreError::file(action, copy);
        File::open(copy).and_then(|file| file.sync_all()).map_err(error("sync"))?;
        let link = beside(&self.path, "-link");
        remove_one(&link)?;
        let numbered = |number: u32| beside(&self.path, &format!("{MOVED}{number}"));
        let mut number = 1;
        while numbered(number).exists() {
            number += 1;
        }
        let moved = numbered(number);
        symlink(moved.file_name().unwrap_or_default(), &link).map_err(error("link to"))?;
        rename(copy, &moved)?;
        std::fs::rename(&link, &self.path).map_err(error("switch to")).inspect_err(|_| {
            // Otherwise each failed move would leave a copy of the database. A second error is ignored.
            let _ = [&moved, &link].map(|file| remove_one(file));
        })?;
        self.sync_folder().map_err(error("sync the folder of"))?;
        // At the first move the old file had the configured name, which the link has now.
        let names = if old_had_own_name { &SUFFIXES[..] } else { &SUFFIXES[..2] };
        names.iter().try_for_each(|suffix| remove_one(&beside(&old, suffix)))?;
        Ok(moved)
    }

    /// Removes unfinished copies. If the configured path is a link to a numbered file, also removes the other numbered
    /// files, which remain from earlier moves; otherwise renames the numbered files and keeps them.
    pub(super) fn clear_leftovers(&self, now: Timestamp) -> Result<(), StoreError> {
        if !self.path.exists() {
            return Ok(());
        }
        self.remove_unfinished()?;
        let is_in_use = |moved: &PathBuf| std::fs::canonicalize(moved).is_ok_and(|file| file == self.file());
        let (in_use, others): (Vec<_>, Vec<_>) =
            self.files_with(MOVED, &SUFFIXES[..2]).into_iter().partition(is_in_use);
        for moved in others {
            if !in_use.is_empty() {
                remove(&moved)?;
                continue;
            }
            let to = self.free_name(UNUSED, now);
            rename_all(&moved, &to)?;
            tracing::warn!(
                from = %moved.display(), to = %to.display(),
                "a database that is not in use was set aside: it may be that before a backup was restored"
            );
        }
        Ok(())
    }

    /// A free name for a file to set aside, with this infix.
    fn free_name(&self, infix: &str, now: Timestamp) -> PathBuf {
        let stamp = now.strftime("%Y%m%dT%H%M%SZ");
        let mut to = beside(&self.path, &format!("{infix}{stamp}"));
        while to.exists() {
            to = beside(&to, "-again");
        }
        to
    }

    /// Renames a log whose database is missing.
    pub(super) fn set_log_aside(&self, now: Timestamp) -> Result<PathBuf, StoreError> {
        // With the suffix `-wal`, SQLite would take it for the log of a database of that name.
        let to = beside(&self.free_name(BROKEN, now), "-log");
        rename(&beside(&self.file(), "-wal"), &to)?;
        Ok(to)
    }

    /// Renames the database with its log.
    pub(super) fn set_aside(&self, now: Timestamp) -> Result<PathBuf, StoreError> {
        let to = self.free_name(BROKEN, now);
        self.rename_to(&to).map(|()| to)
    }

    /// Gives a complete and closed copy the configured path.
    pub(super) fn adopt(&self, copy: &Path) -> Result<(), StoreError> {
        rename(copy, &self.path)?;
        self.sync_folder().map_err(StoreError::file("sync the folder of", &self.path))
    }

    /// Writes a summary of the saved rows next to a database that was set aside, for people and for the alarm.
    pub(super) fn describe_set_aside(file: &Path, text: &str) -> Result<(), StoreError> {
        let path = beside(file, SAVED);
        std::fs::write(&path, text).map_err(StoreError::file("write", &path))
    }

    /// The summary of the saved rows of a database that was set aside.
    pub(super) fn saved_from(file: &Path) -> Option<String> {
        std::fs::read_to_string(beside(file, SAVED)).ok()
    }

    /// The newest database, or log without a database, that was set aside and still exists.
    pub(super) fn set_aside_before(&self) -> Option<PathBuf> {
        self.files_with(BROKEN, &["-wal", "-shm", SAVED]).into_iter().max()
    }

    /// The newest database that was set aside and whose rows were not all copied. `None` if a new database exists.
    pub(super) fn unfinished(&self) -> Option<PathBuf> {
        if !self.is_fresh() {
            return None;
        }
        let databases = self.files_with(BROKEN, &["-wal", "-shm", SAVED, "-log"]);
        databases.into_iter().filter(|file| !beside(file, SAVED).exists()).max()
    }

    /// The files whose names are that of the database, `infix` and more, except files with the suffixes `without`.
    fn files_with(&self, infix: &str, without: &[&str]) -> Vec<PathBuf> {
        let mark = beside(&self.path, infix);
        let mark = mark.file_name().unwrap_or_default().as_encoded_bytes();
        let is_wanted =
            |name: &[u8]| name.starts_with(mark) && !without.iter().any(|suffix| name.ends_with(suffix.as_bytes()));
        let files = std::fs::read_dir(folder_of(&self.path)).into_iter().flatten().filter_map(Result::ok);
        files.filter(|file| is_wanted(file.file_name().as_encoded_bytes())).map(|file| file.path()).collect()
    }

    pub(super) fn sync_folder(&self) -> io::Result<()> {
        File::open(folder_of(&self.path))?.sync_all()
    }
}

/// Renames a database with its log, as far as they exist.
fn rename_all(from: &Path, to: &Path) -> Result<(), StoreError> {
    SUFFIXES.iter().try_for_each(|suffix| rename(&beside(from, suffix), &beside(to, suffix)))
}

/// Renames a file if it exists.
fn rename(from: &Path, to: &Path) -> Result<(), StoreError> {
    unless_missing(std::fs::rename(from, to)).map_err(StoreError::file("rename", from))
}

/// Removes a database with its log, as far as they exist.
fn remove(file: &Path) -> Result<(), StoreError> {
    SUFFIXES.iter().try_for_each(|suffix| remove_one(&beside(file, suffix)))
}

fn remove_one(path: &Path) -> Result<(), StoreError> {
    unless_missing(std::fs::remove_file(path)).map_err(StoreError::file("remove", path))
}

fn unless_missing(done: io::Result<()>) -> io::Result<()> {
    done.or_else(|error| if error.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(error) })
}
