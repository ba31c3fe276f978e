//! `pointsd identify` on recordings of users: an error is one sentence that names the reason and the place.

use std::fmt::Write as _;
use std::process::{Command, Output, Stdio};

use pointsd::simulate::{Parameters, Sensors};
use pointsd::throw::Direction;

use super::identify::simulated;

const HEADER: &str = "time_s,current_a,position_mm\n";

fn csv() -> String {
    let trace = simulated(&Parameters::default(), &Sensors::default(), Direction::NormalToReverse, 1).trace;
    let mut text = HEADER.to_owned();
    for (k, (current, position)) in trace.current_a().iter().zip(trace.position_mm()).enumerate() {
        writeln!(text, "{:.6},{current},{position}", k as f64 * 1e-3).unwrap();
    }
    text
}

fn without_position() -> String {
    csv().lines().map(|line| line.rsplit_once(',').unwrap().0.to_owned() + "\n").collect()
}

fn identify(text: &str) -> Output {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("throw.csv");
    std::fs::write(&file, text).unwrap();
    pointsd(&["identify", file.to_str().unwrap(), "--json"])
}

fn pointsd(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pointsd")).args(arguments).output().unwrap()
}

/// The reason of a rejection goes to standard error. If this cannot be written, the exit code has the result.
#[test]
fn a_rejected_recording_has_its_exit_code_without_standard_error() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("throw.csv");
    std::fs::write(&file, csv().lines().take(100).collect::<Vec<_>>().join("\n")).unwrap();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut identify = Command::new(env!("CARGO_BIN_EXE_pointsd"));
    let status = identify.arg("identify").arg(&file).stdout(Stdio::null()).stderr(full).status().unwrap();
    assert_eq!(status.code(), Some(1));
}

#[test]
fn a_healthy_recording_is_accepted_in_every_common_csv_format() {
    let plain = csv();
    let reordered = plain.lines().map(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        format!("{},note,{},{}", cells[2], cells[0], cells[1])
    });
    let reordered = reordered.collect::<Vec<_>>().join("\r\n");
    for text in [plain.clone(), format!("\u{feff}{plain}"), plain.replace('\n', "\r\n"), reordered] {
        let output = identify(&text);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["accepted"], true);
        assert_eq!(report["direction"], "normal_to_reverse");
        assert!((report["b0"].as_f64().unwrap() / 203.0 - 1.0).abs() < 0.03, "{report}");
        assert_eq!(report["covariance"].as_array().unwrap().len(), 3);
    }
}

/// No model is fitted without a toe position, so there is no fit and not one of 0 %.
#[test]
fn an_estimate_from_the_current_alone_has_no_fit() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("throw.csv");
    std::fs::write(&file, without_position()).unwrap();
    let output = pointsd(&["identify", file.to_str().unwrap(), "--json", "--supply-v=110", "--stroke-mm=115"]);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&report["accepted"], &report["quality"]), (&true.into(), &"current_only".into()), "{report}");
    assert!(report["fit_pct"].is_null() && report["iterations"].is_null(), "{report}");
}

/// The user of a file knows options and columns, but not the fields of a message.
#[test]
fn a_reason_names_options_and_columns() {
    let milliseconds: String = csv().lines().fold(HEADER.to_owned(), |text, line| match line.split_once(',') {
        Some((time, rest)) if time != "time_s" => text + &format!("{:.9},{rest}\n", time.parse::<f64>().unwrap() / 1e3),
        _ => text,
    });
    // The file has milliseconds in place of seconds.
    let slow: String = without_position().lines().fold(String::new(), |text, line| match line.split_once(',') {
        Some((time, current)) if time != "time_s" => {
            text + &format!("{:.3},{current}\n", time.parse::<f64>().unwrap() * 1e3)
        }
        _ => text + line + "\n",
    });
    for (text, says) in [
        (without_position(), "need --supply-v and --stroke-mm"),
        (milliseconds, "the column time_s is wrong"),
        (slow, "needs 30 s at most: check the column time_s, 1 Hz"),
    ] {
        let output = identify(&text);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && said.contains(says), "{said}");
    }
}

/// The numbers are those of a small stroke in millimetres, so this is only a warning.
#[test]
fn a_position_in_centimetres_is_warned_about() {
    let centimetres = csv().lines().skip(1).fold(HEADER.to_owned(), |text, line| {
        let (rest, position) = line.rsplit_once(',').unwrap();
        text + &format!("{rest},{}\n", position.parse::<f64>().unwrap() / 10.0)
    });
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("throw.csv");
    for (text, option, warns) in
        [(&centimetres, None, true), (&centimetres, Some("--stroke-mm=11.5"), false), (&csv(), None, false)]
    {
        std::fs::write(&file, text).unwrap();
        let output = pointsd(&[&["identify", file.to_str().unwrap()][..], option.as_slice()].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert_eq!(said.contains("moved only 11.5 mm: if the position is in centimetres"), warns, "{said}");
    }
}

/// A position that is late by 8 ms.
#[test]
fn a_rough_recording_has_its_reason() {
    let trace = simulated(&Parameters::default(), &Sensors::default(), Direction::NormalToReverse, 1).trace;
    let position = trace.position_mm();
    let mut text = HEADER.to_owned();
    for (k, current) in trace.current_a().iter().enumerate() {
        writeln!(text, "{:.6},{current},{}", k as f64 * 1e-3, position[k.saturating_sub(8)]).unwrap();
    }
    let report: serde_json::Value = serde_json::from_slice(&identify(&text).stdout).unwrap();
    assert_eq!((&report["accepted"], &report["quality"]), (&true.into(), &"rough".into()), "{report}");
    let reason = report["reason"].as_str().unwrap();
    assert!(reason.contains("departs from the model"), "{reason}");
}

#[test]
fn a_file_that_is_no_recording_is_refused_with_the_line() {
    let plain = csv();
    let lines: Vec<&str> = plain.lines().collect();
    let still: String = lines
        .iter()
        .skip(1)
        .fold(HEADER.to_owned(), |text, line| text + &line.split(',').take(2).collect::<Vec<_>>().join(",") + ",3\n");
    let with_line = |at: usize, line: &str| {
        let mut lines = lines.clone();
        lines[at] = line;
        lines.join("\n")
    };
    let gap = [&lines[..1000], &lines[1100..]].concat().join("\n");
    for (text, exit, words) in [
        (still, 1, vec!["the toe did not move"]),
        (with_line(57, "0.056,strong,0"), 65, vec!["line 58", "current_a", "strong"]),
        (with_line(57, "0.056,1.0"), 65, vec!["line 58", "position_mm", "no value"]),
        (with_line(57, "0.001,1.0,0"), 65, vec!["line 58", "time does not increase"]),
        (plain.replace("current_a", "amps"), 65, vec!["line 1", "current_a is missing"]),
        (plain.replace(',', ";"), 65, vec!["line 1", "semicolons"]),
        (plain.replace(',', "\t"), 65, vec!["line 1", "tabs"]),
        (plain.replace("position_mm", "current_a"), 65, vec!["line 1: several columns are named current_a"]),
        (with_line(57, "0.056,1.0,0,5"), 65, vec!["line 58", "4 values for the 3 columns", "point"]),
        (lines[..4].join("\n"), 1, vec!["throw.csv"]),
        (lines[..3000].join("\n"), 1, vec!["still moving", "--stroke-mm"]),
        (lines[..2].join("\n"), 65, vec!["too few"]),
        (gap, 65, vec!["line 1001", "gap"]),
        (String::new(), 65, vec!["line 1"]),
    ] {
        let output = identify(&text);
        let sentence = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(exit), "{words:?}: {sentence}");
        assert_eq!(sentence.trim().lines().count(), 1, "{sentence}");
        for word in words {
            assert!(sentence.contains(word), "{word:?} is not in: {sentence}");
        }
    }
    let absent = pointsd(&["identify", "/nowhere.csv"]);
    assert_eq!(absent.status.code(), Some(66), "{absent:?}");
    let endless = pointsd(&["identify", "/dev/zero"]);
    assert_eq!(endless.status.code(), Some(66), "{endless:?}");
    assert!(String::from_utf8_lossy(&endless.stderr).contains("more than 512 MiB"), "{endless:?}");
    let wrong = pointsd(&["identify", "/nowhere.csv", "--lead-mm", "0"]);
    assert_eq!(wrong.status.code(), Some(64), "{wrong:?}");
}

#[test]
fn an_option_out_of_its_range_is_refused_by_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("throw.csv");
    std::fs::write(&file, csv()).unwrap();
    for (option, says) in [
        ("--supply-v=-5", "error: --supply-v is -5, must be 5 to 1000 V\n"),
        (
            "--anti-alias-hz=-5",
            "error: --anti-alias-hz is -5, must be above 0 and up to 500 Hz, half of the sampling rate\n",
        ),
        ("--stroke-mm=0", "error: --stroke-mm is 0, must be "),
    ] {
        let output = pointsd(&["identify", file.to_str().unwrap(), option]);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(64) && error.starts_with(says), "{option}: {error}");
    }
}
