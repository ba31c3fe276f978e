//! One process at a time judges what is in a database: two would each keep monitors that the other does not see.

use std::{
    fs::{File, TryLockError},
    path::{Path, PathBuf},
};

/// Why the database is not ours.
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
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => Err(LockError::Taken { database: database.to_owned() }),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }
}
