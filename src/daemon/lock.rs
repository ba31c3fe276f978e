//! One process at a time uses a database: two would each keep monitors that the other does not see.

use std::{
    fs::{File, TryLockError},
    io::{self, ErrorKind},
    os::{
        linux::net::SocketAddrExt,
        unix::{
            ffi::OsStrExt,
            net::{SocketAddr, UnixListener},
        },
    },
    path::{Path, PathBuf},
};

/// Why the lock of a database could not be taken.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process has it.
    #[error("another pointsd works on {}: stop it first, or name another database in store.path", database.display())]
    Taken {
        /// The database.
        database: PathBuf,
    },
    /// The lock file cannot be used.
    #[error("cannot use the lock file {} beside the database: may this user write to its folder?", path.display())]
    File {
        /// The lock file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// The right to work on a database, until it is dropped or the process ends, however it ends.
#[derive(Debug)]
pub struct DatabaseLock {
    _file: File,
    /// A lock file can be removed, and a second process would make another one. This name has no file.
    _name: UnixListener,
}

impl DatabaseLock {
    /// Takes the lock of a database.
    ///
    /// # Errors
    /// When another process has it, or its file cannot be created.
    pub fn take(database: &Path) -> Result<Self, LockError> {
        let mut path = database.as_os_str().to_owned();
        path.push(".lock");
        let path = PathBuf::from(path);
        let failed = |source| LockError::File { path: path.clone(), source };
        let file = File::options().create(true).truncate(false).write(true).open(&path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => match UnixListener::bind_addr(&name_of(database).map_err(failed)?) {
                Ok(name) => Ok(Self { _file: file, _name: name }),
                Err(error) if error.kind() == ErrorKind::AddrInUse => {
                    Err(LockError::Taken { database: database.to_owned() })
                }
                Err(source) => Err(failed(source)),
            },
            Err(TryLockError::WouldBlock) => Err(LockError::Taken { database: database.to_owned() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }
}

/// A name in Linux's abstract namespace, the same for every path that leads to the database's folder.
fn name_of(database: &Path) -> io::Result<SocketAddr> {
    let folder = database.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let path = std::fs::canonicalize(folder)?.join(database.file_name().unwrap_or_default());
    // A path may be longer than such a name: its checksums tell paths apart well enough.
    let (bytes, reversed) = (path.as_os_str().as_bytes(), path.as_os_str().as_bytes().iter().rev().copied());
    let checksums = (crc32fast::hash(bytes), crc32fast::hash(&reversed.collect::<Vec<_>>()));
    SocketAddr::from_abstract_name(format!("pointsd-{:08x}{:08x}-{}", checksums.0, checksums.1, bytes.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_removed_lock_file_lets_no_second_process_in() {
        let folder = tempfile::tempdir().unwrap();
        let database = folder.path().join("points.db");
        let first = DatabaseLock::take(&database).unwrap();
        assert!(matches!(DatabaseLock::take(&database), Err(LockError::Taken { .. })));
        std::fs::remove_file(folder.path().join("points.db.lock")).unwrap();
        assert!(matches!(DatabaseLock::take(&database), Err(LockError::Taken { .. })));
        drop(first);
        DatabaseLock::take(&database).unwrap();
    }
}
