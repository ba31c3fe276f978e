//! The systemd units, checked by systemd-analyze.

use std::{
    fs,
    process::{Command, Output},
};

use super::site::{deploy, read, replaced};

const UNITS: &[(&str, &str)] =
    &[("pointsd", env!("CARGO_BIN_EXE_pointsd")), ("pointsim", env!("CARGO_BIN_EXE_pointsim"))];

/// Runs `systemd-analyze`; `None`, with a message, if it is not installed.
fn analyze(arguments: &[&str]) -> Option<Output> {
    match Command::new("systemd-analyze").args(arguments).output() {
        Ok(output) => Some(output),
        Err(error) => {
            eprintln!("skipped: systemd-analyze is not installed ({error})");
            None
        }
    }
}

#[test]
fn the_exposure_of_each_unit_is_at_most_1_0() {
    for (name, _) in UNITS {
        let unit = deploy(&format!("systemd/{name}.service"));
        let Some(output) =
            analyze(&["security", "--offline=true", "--threshold=10", "--no-pager", unit.to_str().unwrap()])
        else {
            return;
        };
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stdout));
    }
}

#[test]
fn systemd_finds_no_fault_in_the_units() {
    let folder = tempfile::tempdir().unwrap();
    for (name, program) in UNITS {
        // The program is not installed on the test computer.
        let text = replaced(&read(&format!("systemd/{name}.service")), &format!("/usr/bin/{name}"), program);
        let unit = folder.path().join(format!("{name}.service"));
        fs::write(&unit, text).unwrap();
        let Some(output) = analyze(&["verify", "--man=no", unit.to_str().unwrap()]) else { return };
        let complaints = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && complaints.is_empty(), "{name}: {complaints}");
    }
}
