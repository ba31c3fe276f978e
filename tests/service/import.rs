//! Import of recorded throws in JSON, as from a foreign logger, into the database without a daemon.

use std::{fs, io::Write as _, path::Path, process::Stdio};

use crate::{
    json::json_message,
    rig::{Rig, ends, pointsd, pointsim, run_with_closed_pipe, stub, throws},
};

/// Runs `pointsd import`; returns its exit code, stdout and stderr.
fn import(rig: &Rig, files: &[&Path], more: &[&str]) -> (Option<i32>, String, String) {
    import_as(rig, "north/21B", files, more)
}

fn import_as(rig: &Rig, machine: &str, files: &[&Path], more: &[&str]) -> (Option<i32>, String, String) {
    let mut command = pointsd(&["import", "--machine", machine, "--config"]);
    let output = command.arg(rig.write_config()).args(more).args(files).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// Runs `pointsd import`, which succeeds; returns its stdout and stderr.
#[track_caller]
fn imported(rig: &Rig, files: &[&Path], more: &[&str]) -> (String, String) {
    let (code, said, error) = import(rig, files, more);
    assert_eq!(code, Some(0), "{error}");
    (said.trim().to_owned(), error)
}

/// Runs `pointsd import`, which fails with this exit code and an error with these words.
#[track_caller]
fn refused(rig: &Rig, files: &[&Path], exit: i32, says: &str) {
    let (code, _, error) = import(rig, files, &[]);
    assert!(code == Some(exit) && error.contains(says), "{code:?}: {error}");
}

#[test]
fn a_closed_pipe_does_not_end_an_import() {
    let rig = Rig::new();
    let files: Vec<_> = (0..3).map(|number| rig.folder().join(format!("{number}.json"))).collect();
    for (file, throw) in files.iter().zip(throws("recorded", 3)) {
        fs::write(file, json_message(&throw)).unwrap();
    }
    let mut command = pointsd(&["import", "--json", "--machine", "north/21B", "--config"]);
    let output = run_with_closed_pipe(command.arg(rig.write_config()).args(&files));
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_eq!(rig.sql("SELECT throw_no FROM health_history").len(), 3);
}

/// As in `pointsd import --machine north/21B <(zcat throw.csv.gz)`: a pipe can be read only once.
#[test]
fn a_recording_from_a_pipe_is_that_of_its_file() {
    let rig = Rig::new();
    let file = rig.folder().join("throw.csv");
    ends(0, pointsim(&["throw", "--out"]).arg(&file));
    let mut command = pointsd(&["import", "--machine", "north/21B", "--config"]);
    command.arg(rig.write_config()).arg("/dev/stdin").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    child.stdin.take().unwrap().write_all(&fs::read(&file).unwrap()).unwrap();
    assert!(child.wait_with_output().unwrap().status.success());
    let (said, _) = imported(&rig, &[&file], &[]);
    assert_eq!(said, "0 throws imported (0 not evaluated), 1 known before, 0 alarm events");
}

#[test]
fn throws_in_json_go_through_the_whole_pipeline_once() {
    let rig = Rig::new();
    let made = throws("recorded", 5);
    let json = |number: usize| json_message(&made[number]);
    let (one, many) = (rig.folder().join("one.json"), rig.folder().join("many.ndjson"));
    fs::write(&one, json(0)).unwrap();
    // One throw in a line, with an empty line, and again the throw of the other file.
    fs::write(&many, [&json(1)[..], b"\n\n", &json(2), b"\r\n", &json(0), b"\n", &json(3), b"\n"].concat()).unwrap();

    let array = rig.folder().join("array.json");
    fs::write(&array, [b"[\n", &json(0)[..], b"]"].concat()).unwrap();
    refused(&rig, &[&array], 65, "a JSON array: write each throw");
    // Some editors begin a file with a byte order mark.
    fs::write(&one, [b"\xef\xbb\xbf", &json(0)[..]].concat()).unwrap();

    let (said, _) = imported(&rig, &[&one, &many], &[]);
    assert_eq!(said, "4 throws imported (0 not evaluated), 1 known before, 0 alarm events");
    let rows = rig.sql("SELECT throw_no, quality, started_at, b0 FROM health_history ORDER BY throw_no");
    assert_eq!(rows.len(), 4, "{rows:?}");
    for (row, throw) in rows.iter().zip(&made) {
        assert_eq!((&row["throw_no"], &row["quality"]), (&throw.id.throw_no.into(), &"good".into()));
        let at: jiff::Timestamp = row["started_at"].as_str().unwrap().parse().unwrap();
        assert_eq!(at, throw.started_at);
        assert!(row["b0"].as_f64().unwrap() > 0.0);
    }

    let mut piped = pointsd(&["import", "-", "--machine", "north/21B", "--config"]);
    let piped = piped.arg(rig.write_config()).stdin(fs::File::open(&many).unwrap()).output().unwrap();
    let said = String::from_utf8(piped.stdout).unwrap();
    assert_eq!(said.trim(), "0 throws imported (0 not evaluated), 4 known before, 0 alarm events");
    let said = imported(&rig, &[&many], &["--json"]).0;
    let known: Vec<serde_json::Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let is_known = |throw: &serde_json::Value| throw["known"] == true && throw["quality"].is_null();
    assert!(known.len() == 4 && known.iter().all(is_known), "known throws are not judged again: {said}");
    assert_eq!((&known[0]["machine"], &known[0]["throw_no"]), (&"21B".into(), &2.into()), "{said}");
    fs::write(&one, [json(4), json_message(&stub("recorded", 9))].join(&b'\n')).unwrap();
    let (said, _) = imported(&rig, &[&one], &["--json"]);
    let lines: Vec<serde_json::Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 2, "{said}");
    assert_eq!((&lines[0]["throw_no"], &lines[0]["quality"]), (&5.into(), &"good".into()));
    assert_ne!(lines[1]["quality"], "good");
}

#[test]
fn throws_out_of_order_are_warned_about_and_those_of_another_machine_refused() {
    let rig = Rig::new();
    let json: Vec<_> = throws("recorded", 4).iter().map(json_message).collect();
    let file = rig.folder().join("many.jsonl");
    fs::write(&file, [&json[1][..], &json[0], &json[2]].join(&b'\n')).unwrap();
    let (said, error) = imported(&rig, &[&file], &[]);
    assert!(said.starts_with("3 throws imported"), "{said}");
    assert!(error.starts_with("warning: ") && error.contains("judged as the newest"), "{error}");
    assert_eq!(error.matches("warning").count(), 1, "{error}");

    let named = |names: &str| [b"{", names.as_bytes(), &json[3][1..]].concat();
    fs::write(&file, named(r#""site":"north","machine":"21C","#)).unwrap();
    refused(&rig, &[&file], 65, "a throw of north/21C, and --machine is north/21B");
    fs::write(&file, named(r#""site":"north","machine":"\u001b[2Jx","#)).unwrap();
    refused(&rig, &[&file], 65, "a throw of north/\\u{1b}[2Jx, and");
    // One of these fields alone, or the right names, are no reason to refuse.
    fs::write(&file, named(r#""machine":"S700K","#)).unwrap();
    imported(&rig, &[&file], &[]);
    fs::write(&file, named(r#""site":"north","machine":"21B","#)).unwrap();
    imported(&rig, &[&file], &[]);
}

/// Runs `pointsd import` without `--machine`; returns its exit code and its error.
fn import_named(rig: &Rig, files: &[&Path]) -> (Option<i32>, String) {
    let output = pointsd(&["import", "--config"]).arg(rig.write_config()).args(files).output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn throws_that_name_their_machines_need_no_option() {
    let rig = Rig::new();
    let json: Vec<_> = throws("recorded", 3).iter().map(json_message).collect();
    let named = |at: usize, machine: &str| {
        let names = format!("{{\"site\":\"north\",\"machine\":\"{machine}\",");
        [names.as_bytes(), &json[at][1..]].concat()
    };
    let file = rig.folder().join("many.jsonl");
    fs::write(&file, [&named(0, "21B")[..], &named(1, "21C"), &named(2, "21B")].join(&b'\n')).unwrap();
    let (code, error) = import_named(&rig, &[&file]);
    assert!(code == Some(0) && error.is_empty(), "{error}");
    let machines = |rig: &Rig| rig.sql("SELECT machine, throw_no FROM health_history ORDER BY throw_no");
    let imported = machines(&rig);
    let names: Vec<_> = imported.iter().map(|row| row["machine"].as_str().unwrap()).collect();
    assert_eq!(names, ["21B", "21C", "21B"]);

    // The list of an export has the names of its traces.
    let traces = rig.folder().join("traces");
    let export = ends(0, pointsd(&["export", "--database"]).arg(rig.database()).arg("--traces").arg(&traces));
    fs::write(rig.folder().join("throws.csv"), export).unwrap();
    let folders = ["21B", "21C"].map(|machine| traces.join("north").join(machine));
    let mut files: Vec<_> = folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap()).collect();
    let files: Vec<_> = files.drain(..).map(|file| file.unwrap().path()).collect();
    let other = Rig::new();
    let (code, error) = import_named(&other, &files.iter().map(AsRef::as_ref).collect::<Vec<&Path>>());
    assert_eq!(code, Some(0), "{error}");
    assert_eq!(machines(&other), imported);

    fs::write(&file, &json[0]).unwrap();
    let (code, error) = import_named(&rig, &[&file]);
    assert!(code == Some(64) && error.contains("many.jsonl: this throw does not name its machine: give"), "{error}");
    fs::write(&file, named(0, "all-machines")).unwrap();
    let (code, error) = import_named(&rig, &[&file]);
    assert!(code == Some(65) && error.contains("the common alarms of a site"), "{error}");
}

#[test]
fn no_database_is_made_for_a_missing_or_invalid_file() {
    let rig = Rig::new();
    let [good, bad, missing] = ["good.json", "bad.csv", "missing.csv"].map(|name| rig.folder().join(name));
    fs::write(&good, json_message(&throws("recorded", 1)[0])).unwrap();
    fs::write(&bad, "a letter").unwrap();
    for (files, exit) in [(&[&bad][..], 65), (&[&missing], 66), (&[&good, &missing], 66)] {
        let files: Vec<&Path> = files.iter().map(|file| file.as_path()).collect();
        let (code, _, error) = import(&rig, &files, &[]);
        assert_eq!(code, Some(exit), "{error}");
        let made: Vec<_> = fs::read_dir(rig.folder()).unwrap().map(|file| file.unwrap().file_name()).collect();
        assert!(made.iter().all(|name| !name.to_string_lossy().contains(".db")), "{files:?}: {made:?}");
    }
}

/// These names are those of the daemon itself and of the common alarms of a site.
#[test]
fn no_throws_are_imported_under_a_reserved_name() {
    let rig = Rig::with("[monitor]\nsite = \"north\"\nid = \"21B\"");
    let file = rig.folder().join("one.json");
    fs::write(&file, json_message(&stub("recorded", 1))).unwrap();
    refused(&rig, &[&file], 64, "the name of pointsd itself");
    let (code, _, error) = import_as(&rig, "north/all-machines", &[&file], &[]);
    assert!(code == Some(64) && error.contains("the common alarms of a site"), "{error}");
}

#[test]
fn a_csv_file_that_was_copied_or_has_a_new_time_is_imported_once() {
    let rig = Rig::new();
    let current = |k| if (20..=150).contains(&k) { 2.0 } else { 0.0 };
    let rows = (0..200).map(|k| format!("{:.3},{}\n", f64::from(k) * 0.04, current(k)));
    let (file, copy) = (rig.folder().join("throw.csv"), rig.folder().join("copy.csv"));
    fs::write(&file, format!("time_s,current_a\n{}", rows.collect::<String>())).unwrap();
    fs::copy(&file, &copy).unwrap();
    let (said, _) = imported(&rig, &[&file, &copy], &["--started-at", "2026-01-01T00:00:00Z"]);
    assert_eq!(said, "1 throw imported (0 not evaluated), 1 known before, 0 alarm events");
    let (said, _) = imported(&rig, &[&copy], &[]);
    assert_eq!(said, "0 throws imported (0 not evaluated), 1 known before, 0 alarm events");
    assert_eq!(rig.sql("SELECT throw_no FROM health_history").len(), 1);
    // An exported trace without positions can be imported.
    let text = fs::read_to_string(&file).unwrap();
    let text = text.replace("current_a", "current_a,position_mm").replace(",0\n", ",0,\n").replace(",2\n", ",3,\n");
    fs::write(&copy, text).unwrap();
    let (said, error) = imported(&rig, &[&copy], &[]);
    assert!(said.starts_with("1 throw imported (0 not evaluated)") && error.is_empty(), "{said}{error}");
    // The last imported throw becomes the present state of the machine, also if it is older: a warning says so.
    fs::write(&copy, fs::read_to_string(&file).unwrap() + "8.0,0\n").unwrap();
    let (said, error) = imported(&rig, &[&copy], &["--started-at", "2025-01-01T00:00:00Z"]);
    assert!(said.starts_with("1 throw imported"), "{said}{error}");
    assert!(error.starts_with("warning: ") && error.contains("before the last one of north/21B"), "{error}");
}

/// The traces have no boot, number and direction of their throw: these come from the list of throws next to their
/// folder.
#[test]
fn exported_traces_are_imported_as_the_same_throws() {
    let rig = Rig::new();
    let file = rig.folder().join("many.jsonl");
    let lines: Vec<_> = throws("recorded", 3).iter().map(json_message).collect();
    fs::write(&file, lines.join(&b'\n')).unwrap();
    imported(&rig, &[&file], &[]);
    let traces = rig.folder().join("traces");
    let list = rig.folder().join("throws.csv");
    let export = ends(0, pointsd(&["export", "--database"]).arg(rig.database()).arg("--traces").arg(&traces));
    fs::write(&list, export).unwrap();
    let mut files: Vec<_> = fs::read_dir(traces.join("north/21B")).unwrap().map(|file| file.unwrap().path()).collect();
    files.sort();
    let files: Vec<&Path> = files.iter().map(AsRef::as_ref).collect();
    assert_eq!(files.len(), 3);
    let history = |rig: &Rig| rig.sql("SELECT * FROM health_history ORDER BY started_at");
    let (said, _) = imported(&rig, &files, &[]);
    assert_eq!(said, "0 throws imported (0 not evaluated), 3 known before, 0 alarm events");

    let other = Rig::new();
    imported(&other, &files, &[]);
    assert_eq!(history(&other).len(), 3);
    let columns = ["started_at", "direction", "throw_no", "quality", "temperature_c"];
    for (row, original) in history(&other).iter().zip(history(&rig)) {
        for column in columns {
            assert_eq!(row[column], original[column], "{column}");
        }
        let [b0, original] = [row, &original].map(|row| row["b0"].as_f64().unwrap());
        assert!((b0 / original - 1.0).abs() < 1e-6, "{b0} {original}");
    }
    let rates = |rig: &Rig| rig.sql("SELECT sample_rate_hz, samples FROM throw ORDER BY throw_row");
    assert_eq!(rates(&other), rates(&rig), "exact, not from the times of the samples");
    let boots = other.sql("SELECT DISTINCT boot_id FROM boot");
    assert_eq!(boots, [serde_json::json!({"boot_id": "recorded"})]);

    // A spreadsheet changed a line, or the separators. Without the list the throws would have other times and numbers.
    let text = fs::read_to_string(&list).unwrap();
    for changed in [text.replacen(",recorded,2,", ",recorded,two,", 1), text.replace(',', ";")] {
        fs::write(&list, changed).unwrap();
        refused(&Rig::new(), &files, 65, "throws.csv: restore it, or give --started-at");
    }
    fs::write(&list, text.replacen("north,21B,recorded,2,", "north,22,recorded,2,", 1)).unwrap();
    refused(&Rig::new(), &files, 65, "a throw of north/22, and --machine is north/21B");
    fs::write(&list, "throw,trace\n1,of another program\n").unwrap();
    imported(&Rig::new(), &files, &[]);

    // Without the list the files still have the times of their throws.
    fs::remove_file(list).unwrap();
    let third = Rig::new();
    imported(&third, &files, &[]);
    for (row, original) in history(&third).iter().zip(history(&rig)) {
        assert_eq!(row["started_at"], original["started_at"]);
    }
}

#[test]
fn a_wrong_line_is_named_and_the_files_before_it_are_kept() {
    let rig = Rig::new();
    let made = throws("recorded", 2);
    let (good, bad) = (rig.folder().join("good.json"), rig.folder().join("bad.jsonl"));
    fs::write(&good, json_message(&made[0])).unwrap();
    let second = json_message(&made[1]);
    fs::write(&bad, [&second[..], b"\n{\"schema\": 7}\n"].concat()).unwrap();
    let (code, said, error) = import(&rig, &[&good, &bad], &[]);
    assert_eq!(code, Some(65), "{error}");
    assert!(error.starts_with("error: ") && error.contains("bad.jsonl, line 2: "), "{error}");
    assert_eq!(error.lines().count(), 1, "{error}");
    assert!(said.starts_with("1 throw imported"), "{said}");

    refused(&rig, &[Path::new("/no/such/throws.json")], 66, "/no/such/throws.json");
}

#[test]
fn an_import_beside_the_running_daemon_is_refused() {
    let (rig, _daemon) = Rig::running();
    let file = rig.folder().join("one.json");
    fs::write(&file, json_message(&throws("recorded", 1)[0])).unwrap();
    refused(&rig, &[&file], 69, "another pointsd works on");
}
