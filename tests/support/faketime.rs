//! A daemon with a wrong clock: libfaketime changes the clocks of its process.

use std::{fs, path::PathBuf};

use crate::rig::Rig;

/// Paths of the library in Debian, Fedora and Arch.
const LIBRARIES: [&str; 4] = [
    "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib/aarch64-linux-gnu/faketime/libfaketimeMT.so.1",
    "/usr/lib64/faketime/libfaketimeMT.so.1",
    "/usr/lib/faketime/libfaketimeMT.so.1",
];

/// Makes the daemon of `rig` add the text of the returned file, such as `-30d`, to its clocks. `None`, with a message,
/// if the library is not installed.
pub(crate) fn clock_of(rig: &mut Rig) -> Option<PathBuf> {
    let Some(library) = LIBRARIES.iter().map(PathBuf::from).find(|path| path.exists()) else {
        println!("skipped: libfaketime is not installed");
        return None;
    };
    let clock = rig.folder().join("clock");
    rig.set("LD_PRELOAD", library);
    rig.set("FAKETIME_TIMESTAMP_FILE", &clock);
    rig.set("FAKETIME_NO_CACHE", "1");
    fs::write(&clock, "+0").unwrap();
    Some(clock)
}
