//! The lock of a database: only one process may use it, as each process has its own monitors in memory.

use std::{
    fs::{File, Metadata, TryLockError},
    io::{self, ErrorKind},
    os::{
        linux::net::SocketAddrExt,
        unix::{
            ffi::OsStrExt,
            fs::MetadataExt,
            net::{SocketAddr, UnixListener},
        },
    },
    path::{Path, PathBuf},
};

use crate::{
    daemon::error::StartError,
    store::{beside, folder_of},
};

/// The lock of a database. It is held until it is dropped, which removes the lock files, or until the process ends in
/// any way.
///
/// A database can have several paths: `store.path` may be a symbolic link, which an administrator made, or the store
/// when it moved the database (see `store::files`). Each path from the configured one to the file is locked, so that
/// any two processes have at least one locked path in common. The file itself is locked too, as hard links, for example
/// of a backup by `cp -al`, are paths that nothing connects.
#[derive(Debug)]
pub(crate) struct DatabaseLock {
    _paths: Vec<PathLock>,
    /// The lock of the file; `None` if it does not exist yet.
    _file: Option<UnixListener>,
}

/// The lock of one path of a database.
#[derive(Debug)]
struct PathLock {
    file: File,
    path: PathBuf,
    /// A second lock by an abstract socket name, which, unlike the lock file, cannot be removed.
    _name: UnixListener,
}

impl DatabaseLock {
    /// Takes the lock of a database.
    pub(crate) fn take(database: &Path) -> Result<Self, StartError> {
        let paths =
            paths(database).map_err(|source| StartError::LockFile { path: beside(database, ".lock"), source })?;
        let locks: Result<_, _> = paths.iter().map(|path| PathLock::take(path)).collect();
        let file = std::fs::metadata(database).ok();
        let file = file.map(|file| bind(&format!("file-{:x}-{:x}", file.dev(), file.ino()), database)).transpose();
        Ok(Self { _paths: locks?, _file: file? })
    }
}

impl PathLock {
    fn take(database: &Path) -> Result<Self, StartError> {
        let path = beside(database, ".lock");
        let failed = |source| StartError::LockFile { path: path.clone(), source };
        let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(failed)?;
        match file.try_lock() {
            // Another process ended between opening and locking, and removed the file.
            Ok(()) if !is_at(&file, &path) => Self::take(database),
            Ok(()) => bind(&name_of(database), database).map(|name| Self { file, path, _name: name }),
            Err(TryLockError::WouldBlock) => Err(StartError::Locked { database: database.to_owned() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }
}

impl Drop for PathLock {
    fn drop(&mut self) {
        if is_at(&self.file, &self.path) {
            // An error is ignored: a lock file that stays locks nothing.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Whether `path` still leads to this open file.
fn is_at(file: &File, path: &Path) -> bool {
    let identity = |metadata: Metadata| (metadata.dev(), metadata.ino());
    let open = file.metadata().map(identity).ok();
    open.is_some() && open == std::fs::metadata(path).map(identity).ok()
}

/// The paths of a database: the configured path, and the target of each symbolic link from there to the file, which may
/// not exist yet. Links in the folders of these paths are resolved.
fn paths(database: &Path) -> io::Result<Vec<PathBuf>> {
    let (mut paths, mut next) = (Vec::new(), database.to_owned());
    loop {
        let folder = std::fs::canonicalize(folder_of(&next))?;
        let path = folder.join(next.file_name().unwrap_or_default());
        // The links form a circle, which SQLite cannot open either.
        if paths.contains(&path) {
            return Ok(paths);
        }
        let target = std::fs::read_link(&path);
        paths.push(path);
        match target {
            Ok(target) => next = folder.join(target),
            Err(_) => return Ok(paths),
        }
    }
}

/// Takes a name in the abstract socket namespace of Linux.
fn bind(name: &str, database: &Path) -> Result<UnixListener, StartError> {
    let address = SocketAddr::from_abstract_name(format!("pointsd-{name}"));
    address.and_then(|address| UnixListener::bind_addr(&address)).map_err(|source| match source.kind() {
        ErrorKind::AddrInUse => StartError::Locked { database: database.to_owned() },
        _ => StartError::LockFile { path: beside(database, ".lock"), source },
    })
}

/// The name of a path for [`bind`]. The path may be too long for a socket name, so the name has two checksums of it.
fn name_of(path: &Path) -> String {
    let bytes = path.as_os_str().as_bytes();
    let reversed: Vec<u8> = bytes.iter().rev().copied().collect();
    format!("{:08x}{:08x}-{}", crc32fast::hash(bytes), crc32fast::hash(&reversed), bytes.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_removed_lock_file_lets_no_second_process_in() {
        let folder = tempfile::tempdir().unwrap();
        let database = folder.path().join("points.db");
        let first = DatabaseLock::take(&database).unwrap();
        assert!(matches!(DatabaseLock::take(&database), Err(StartError::Locked { .. })));
        std::fs::remove_file(folder.path().join("points.db.lock")).unwrap();
        assert!(matches!(DatabaseLock::take(&database), Err(StartError::Locked { .. })));
        drop(first);
        drop(DatabaseLock::take(&database).unwrap());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "a lock file is left over");
    }

    #[test]
    fn every_path_to_a_database_has_its_lock() {
        let (data, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (database, link) = (data.path().join("points.db"), other.path().join("link.db"));
        std::os::unix::fs::symlink(&database, &link).unwrap();
        let is_taken = |path: &Path| matches!(DatabaseLock::take(path), Err(StartError::Locked { .. }));
        let through_link = DatabaseLock::take(&link).unwrap();
        assert!(is_taken(&database));
        drop(through_link);
        let direct = DatabaseLock::take(&database).unwrap();
        assert!(is_taken(&link));
        // The store moves the database to another file, as it does if a reader does not end.
        std::os::unix::fs::symlink("points.db-1", &database).unwrap();
        assert!(is_taken(&link) && is_taken(&database));
        drop(direct);
        DatabaseLock::take(&link).unwrap();
    }

    #[test]
    fn a_hard_link_is_the_same_database() {
        let (data, copy) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (database, link) = (data.path().join("points.db"), copy.path().join("points.db"));
        std::fs::write(&database, "").unwrap();
        std::fs::hard_link(&database, &link).unwrap();
        let first = DatabaseLock::take(&database).unwrap();
        assert!(matches!(DatabaseLock::take(&link), Err(StartError::Locked { .. })));
        drop(first);
        DatabaseLock::take(&link).unwrap();
    }
}
