//! A small file system in memory that can be filled, on computers where the tests may mount one.

use std::{
    fs, io,
    path::{Path, PathBuf},
    process::Command,
};

/// A file system in memory, of 12 MiB if no other size is given.
pub(crate) struct SmallDisk {
    folder: PathBuf,
    _place: tempfile::TempDir,
}

impl SmallDisk {
    /// `None`, with a message, if mounting is not allowed.
    pub(crate) fn mount() -> Option<Self> {
        Self::of_mib(12)
    }

    /// [`Self::mount`] with another size \[MiB\].
    pub(crate) fn of_mib(mib: u32) -> Option<Self> {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("disk");
        fs::create_dir(&folder).unwrap();
        let mount =
            Command::new("mount").args(["-t", "tmpfs", "-o", &format!("size={mib}m"), "tmpfs"]).arg(&folder).output();
        match mount {
            Ok(output) if output.status.success() => Some(Self { folder, _place: place }),
            other => {
                println!("skipped: the test may not mount a file system ({other:?})");
                None
            }
        }
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Uses all free space.
    pub(crate) fn fill(&self) {
        let mut size = 1 << 20;
        let mut filler = fs::File::options().create(true).append(true).open(self.folder.join("filler")).unwrap();
        while size >= 512 {
            if io::Write::write_all(&mut filler, &vec![1; size]).is_err() {
                size /= 2;
            }
        }
    }

    /// Frees the space of [`Self::fill`].
    pub(crate) fn free(&self) {
        fs::remove_file(self.folder.join("filler")).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.folder).status();
    }
}
