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

/// The target of a link; `None` for another file.
pub(crate) fn target(link: &Path) -> Option<PathBuf> {
    Some(folder_of(link).join(std::fs::read_link(link).ok()?))
}

/// The path of a database in the folder that has its files: an administrator's links into other folders are followed.
pub(crate) fn database_path(configured: &Path) -> PathBuf {
    let mut path = configured.to_owned();
    // Linux also follows at most 40 links.
    for _ in 0..40 {
        let Some(next) = target(&path).filter(|next| folder_of(next) != folder_of(&path)) else { break };
        path = next;
    }
    path
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
    let database = database_path(database);
    ["", "-wal", "-shm"].map(|suffix| beside(&database, suffix)).into_iter().find(|file| file.exists() && closed(file))
}
