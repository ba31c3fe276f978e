//! Builds the shim and runs the worker below it.

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::OnceLock,
};

/// The shim as a shared library; `None`, with a message, where there is no C compiler.
pub(super) fn library() -> Option<&'static Path> {
    static LIBRARY: OnceLock<Option<PathBuf>> = OnceLock::new();
    let build = || {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/storage/power/shim.c");
        let library = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("shim-{}.so", std::process::id()));
        let mut compiler = Command::new("cc");
        compiler.args(["-shared", "-fPIC", "-O1", "-o"]).arg(&library).arg(source).arg("-ldl");
        match compiler.status() {
            Ok(status) if status.success() => Some(library),
            other => {
                println!("skipped: no C compiler for the shim ({other:?})");
                None
            }
        }
    };
    LIBRARY.get_or_init(build).as_deref()
}

/// Runs the worker on a database in `folder`, with these environment variables.
pub(super) fn run_worker(library: &Path, folder: &Path, variables: &[(&str, &str)]) -> Output {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "power::worker::run", "--nocapture"])
        .env("LD_PRELOAD", library)
        .env("SHIM_MATCH", folder.join("points.db"))
        .env(super::worker::FOLDER, folder)
        .envs(variables.iter().copied())
        .output()
        .unwrap()
}
