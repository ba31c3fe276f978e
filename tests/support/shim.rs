//! Builds the libraries that the tests preload into a process. One of them is the shim, which logs the writes to the
//! database files, or makes them fail.

use std::{
    path::{Path, PathBuf},
    process::Command,
    sync::OnceLock,
};

/// The shim as a shared library; `None`, with a message, without a C compiler.
pub(crate) fn library() -> Option<&'static Path> {
    static LIBRARY: OnceLock<Option<PathBuf>> = OnceLock::new();
    LIBRARY.get_or_init(|| built("tests/support/shim.c")).as_deref()
}

/// A C file of this package as a shared library; `None`, with a message, without a C compiler.
pub(crate) fn built(source: &str) -> Option<PathBuf> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join(source);
    let name = source.file_stem()?.to_str()?;
    let library = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}.so", std::process::id()));
    let mut compiler = Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-O1", "-o"]).arg(&library).arg(&source).args(["-ldl", "-lpthread"]);
    match compiler.status() {
        Ok(status) if status.success() => Some(library),
        other => {
            println!("skipped: no C compiler for {} ({other:?})", source.display());
            None
        }
    }
}
