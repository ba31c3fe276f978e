//! libfaketime, which changes the clocks of a process.

use std::path::PathBuf;

/// Paths of the library in Debian, Fedora and Arch.
const LIBRARIES: [&str; 4] = [
    "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib/aarch64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib64/faketime/libfaketimeMT.so.1",
    "/usr/lib/faketime/libfaketimeMT.so.1",
];

/// `None`, with a message, if it is not installed.
pub(crate) fn library() -> Option<PathBuf> {
    let library = LIBRARIES.iter().map(PathBuf::from).find(|path| path.exists());
    if library.is_none() {
        println!("skipped: libfaketime is not installed");
    }
    library
}
