//! The library that fakes the clocks of a process.

use std::path::PathBuf;

/// Where Debian, Fedora and Arch put the library that fakes the clock.
const LIBRARIES: [&str; 4] = [
    "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib/aarch64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib64/faketime/libfaketimeMT.so.1",
    "/usr/lib/faketime/libfaketimeMT.so.1",
];

/// `None`, with a message, where it is not installed.
pub(crate) fn library() -> Option<PathBuf> {
    let library = LIBRARIES.iter().map(PathBuf::from).find(|path| path.exists());
    if library.is_none() {
        println!("skipped: libfaketime is not installed");
    }
    library
}
