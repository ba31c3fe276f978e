//! Paths of the files of a database.

use std::{
    ffi::OsString,
    path::{Path, PathBuf},
};

use rustix::fs::{Access, access};

/// The folder of a file; the current folder for a name alone.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The path with `suffix` appended to its file name.
pub(crate) fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    PathBuf::from(name)
}

/// A file of the database that exists and that this user may not write.
pub(crate) fn unwritable(database: &Path) -> Option<PathBuf> {
    let closed = |file: &PathBuf| access(file, Access::READ_OK | Access::WRITE_OK).is_err();
    ["", "-wal", "-shm"].map(|suffix| beside(database, suffix)).into_iter().find(|file| file.exists() && closed(file))
}
