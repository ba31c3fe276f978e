//! Commands that write files for other programs: export, report, manual pages, completions.

use std::{
    fs,
    io::Write as _,
    path::Path,
    process::{Command, Stdio},
};

use pointsd::throw::Throw;
use sqlx::{Connection as _, Executor as _, sqlite::SqliteLockingMode};

use crate::{
    http::{KEY, small_history},
    operators::daemon_with_alarm,
    rig::{Rig, ends, pointsd, pointsim, run_with_closed_pipe, stub, throws},
};

type Row = std::collections::HashMap<String, String>;

/// Runs `pointsd export`; returns its exit code, the columns and the rows.
fn export(database: &Path, arguments: &[&str]) -> (Option<i32>, Vec<String>, Vec<Row>) {
    let output = pointsd(&["export", "--database"]).arg(database).args(arguments).output().unwrap();
    let mut reader = csv::Reader::from_reader(output.stdout.as_slice());
    let columns = reader.headers().unwrap().iter().map(ToOwned::to_owned).collect();
    (output.status.code(), columns, reader.deserialize().map(Result::unwrap).collect())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_export_has_every_throw_with_its_estimate_and_its_trace() {
    let (rig, daemon, _) = small_history().await;
    let folder = rig.folder().join("traces");
    let (code, columns, rows) = export(&rig.database(), &["--traces", folder.to_str().unwrap()]);
    assert_eq!((code, rows.len()), (Some(0), 3), "{rows:?}");
    assert_eq!((columns[0].as_str(), columns.last().map(String::as_str)), ("site", Some("trace")));
    // Oldest first: the rejected throw started before the others.
    assert_eq!(rows.iter().map(|row| row["quality"] == "good").collect::<Vec<_>>(), [false, true, true]);
    assert!(rows[0]["b0"].is_empty() && !rows[0]["detail"].is_empty(), "{:?}", rows[0]);
    let history = rig.sql("SELECT * FROM health_history WHERE quality = 'good' ORDER BY throw_no");
    for ((row, throw), known) in rows[1..].iter().zip(throws("boot", 2)).zip(history) {
        for (name, value) in known.as_object().unwrap() {
            if let Some(number) = value.as_f64() {
                assert_eq!(row[name].parse().map(f64::to_bits), Ok(number.to_bits()), "{name}");
            }
        }
        let Throw { trace, started_at, .. } = throw;
        assert_eq!(row["started_at"].parse::<jiff::Timestamp>().unwrap(), started_at);
        let file = folder.join(&row["trace"]);
        let mut samples = csv::Reader::from_path(&file).unwrap();
        let samples: Vec<[f64; 3]> = samples.deserialize().map(Result::unwrap).collect();
        let both = trace.current_a().iter().zip(trace.position_mm()).map(|(current, position)| [*current, *position]);
        // CBOR carries 32-bit floats.
        let near = |one: f64, other: f64| (one - other).abs() <= 1e-6 * other.abs().max(1.0);
        assert_eq!(samples.len(), trace.len());
        for ([_, current, position], [sent_current, sent_position]) in samples.into_iter().zip(both) {
            assert!(near(current, sent_current) && near(position, sent_position), "{current} {position}");
        }
        // The trace leads to the same estimate.
        let again = pointsd(&["identify", "--json"]).arg(&file).output().unwrap();
        let again: serde_json::Value = serde_json::from_slice(&again.stdout).unwrap();
        let b0: f64 = row["b0"].parse().unwrap();
        assert!((again["b0"].as_f64().unwrap() / b0 - 1.0).abs() < 1e-6, "{again} {b0}");
    }
    for (arguments, count) in [
        (&["north/21B"][..], 3),
        (&["north/21B", "--since", "2026-05-04T10:05:00Z"], 2),
        (&["--until", "2026-05-04T10:10:00Z"], 1),
        (&["--since", "2026-05-04T10:10:00Z", "--until", "2026-05-04T10:10:00.000001Z"], 1),
    ] {
        let (code, columns, rows) = export(&rig.database(), arguments);
        assert_eq!((code, rows.len()), (Some(0), count), "{arguments:?}");
        assert!(!columns.contains(&"trace".to_owned()));
    }
    let (code, columns, rows) = export(&rig.database(), &["north/99"]);
    assert!(code == Some(1) && columns[0] == "site" && rows.is_empty(), "{code:?}");
    // A closed pipe ends the command without an error. The command notices it when its buffer is full, hence 81 copies.
    let many = "SELECT * FROM health_history CROSS JOIN (VALUES (1), (2), (3), (4), (5), (6), (7), (8), (9)) CROSS JOIN \
                (VALUES (1), (2), (3), (4), (5), (6), (7), (8), (9))";
    for arguments in [&["export"][..], &["sql", "--csv", many]] {
        let output = run_with_closed_pipe(pointsd(arguments).arg("--database").arg(rig.database()));
        assert!(output.status.success() && output.stderr.is_empty(), "{arguments:?}: {output:?}");
    }
    // Retention has deleted a trace.
    daemon.terminate();
    rig.change("DELETE FROM trace WHERE throw_row = (SELECT min(throw_row) FROM trace)").await;
    let (code, _, rows) = export(&rig.database(), &["--traces", folder.to_str().unwrap()]);
    assert_eq!((code, rows.iter().filter(|row| row["trace"].is_empty()).count()), (Some(0), 1));
}

/// Pages of the export: every throw once, also with equal start times.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_long_export_has_every_throw_once() {
    let (rig, daemon, _) = small_history().await;
    daemon.terminate();
    rig.change(
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 1700)
         INSERT INTO throw (machine_row, boot_row, throw_no, started_at_us, received_at_us, sample_rate_hz, samples, content_crc32)
         SELECT machine_row, boot_row, 1000 + i, i / 700, 0, 1000, 0, 0 FROM n, (SELECT * FROM boot LIMIT 1)",
    )
    .await;
    for arguments in [&[][..], &["north/21B"]] {
        let (_, _, rows) = export(&rig.database(), arguments);
        let numbers: std::collections::BTreeSet<_> =
            rows.iter().map(|row| (&row["boot_id"], &row["throw_no"])).collect();
        assert_eq!((rows.len(), numbers.len()), (1703, 1703));
        assert_eq!(rows.iter().filter(|row| row["quality"] == "pending").count(), 1700);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_report_is_one_file_with_everything_that_it_shows() {
    let (rig, _daemon) = daemon_with_alarm("a", "");
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE severity = 'critical'").await;
    let out = rig.folder().join("report.html");
    let report = |exit: i32, machine: &str, config: &Path| {
        ends(exit, pointsd(&["report", machine, "--out"]).arg(&out).arg("--config").arg(config))
    };
    report(66, "north/99", &rig.write_config());
    assert!(!out.exists());
    report(0, "north/machine-1", &rig.write_config());
    let page = fs::read_to_string(&out).unwrap();
    for part in [
        "<style>",
        "north/machine-1",
        ">friction (a1)</text>",
        ">Mean current</text>",
        "Alarm history",
        "Check the motor: magnets, brushes",
    ] {
        assert!(page.contains(part), "{part}: {page:.2000}");
    }
    for foreign in [" href=", " src=", "<script", "<form", "@import", "url("] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    // A reader of the database needs neither its folder nor the certificates of the daemon.
    let config = fs::read_to_string(rig.write_config()).unwrap();
    let certificate = "[zenoh.transport.link.tls]\nlisten_private_key = \"/no/such/file\"\n";
    let other = rig.folder().join("other.toml");
    fs::write(
        &other,
        format!("{config}{certificate}[monitor]\nsite = \"no name!\"\n").replace("[monitor]\nid", "[web]\nno"),
    )
    .unwrap();
    report(0, "north/machine-1", &other);
    fs::write(&other, config.replace("[store]", "[diagnosis]\nfriction_limit_pct = 0\n[store]")).unwrap();
    report(78, "north/machine-1", &other);
    ends(73, pointsd(&["backup", "/no/such/folder/copy.db", "--config"]).arg(&other));
}

#[test]
fn a_trace_goes_through_a_pipe() {
    let made = pointsim(&["throw", "--out", "-"]).output().unwrap();
    assert!(made.stdout.starts_with(b"time_s,current_a,position_mm\n"));
    assert!(String::from_utf8_lossy(&made.stderr).contains("true coefficients"));
    let mut identify = pointsd(&["identify", "-"]);
    let mut identify = identify.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    identify.stdin.take().unwrap().write_all(&made.stdout).unwrap();
    let found = identify.wait_with_output().unwrap();
    assert!(found.status.success() && String::from_utf8_lossy(&found.stdout).contains("95 % interval"), "{found:?}");
}

/// The files that a daemon uses may be readable for the daemon only.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_replay_does_not_need_the_files_of_the_daemon() {
    let (rig, daemon) = Rig::running();
    daemon.logger(KEY).await.send([stub("boot", 1)]).await;
    rig.judged(1).await;
    daemon.terminate();
    let private = "[webhook]\nurl = \"https://a/\"\nca_file = \"/no/such/file\"\n\
                   [zenoh.transport.link.tls]\nroot_ca_certificate = \"/no/such/file\"";
    let config = Rig::with(private).in_folder(rig.folder()).write_config();
    let database = rig.database();
    let replay = |into: &str| {
        let mut command = pointsd(&["replay", "--from"]);
        command.arg(&database).arg("--into").arg(rig.folder().join(into)).arg("--config");
        command
    };
    let said = ends(0, replay("private.db").arg(&config));
    assert!(said.contains("1 throw run again"), "{said}");
    fs::write(&config, "[store]\npath = \"/no/such/folder/points.db\"").unwrap();
    ends(0, replay("elsewhere.db").arg(&config));
    fs::write(&config, "[diagnosis]\nmodel_error = 7").unwrap();
    ends(78, replay("wrong.db").arg(&config));
}

/// Commands that only read a database, such as an old backup, do not migrate it.
#[tokio::test]
async fn a_database_of_another_version_is_refused_with_the_reason() {
    let rig = Rig::new();
    fs::write(rig.database(), []).unwrap();
    rig.change(include_str!("../storage/released.sql")).await;
    let refused = |arguments: &[&str], exit: i32, says: &str| {
        let error = ends(exit, pointsd(arguments).arg("--config").arg(rig.write_config()));
        assert!(error.contains(says), "{arguments:?}: {error}");
    };
    for command in [&["export"][..], &["report", "north/machine-1", "--out", "-"], &["replay"]] {
        refused(command, 65, "of an older version of pointsd: make a copy");
    }
    rig.change("PRAGMA user_version = 9999").await;
    for command in [&["export"][..], &["report", "north/machine-1", "--out", "-"]] {
        refused(command, 65, "by a newer version of pointsd");
    }
    refused(&["check"], 78, "by a newer version of pointsd");
    refused(&["run"], 74, "by a newer version of pointsd");
}

/// SQLite creates such a file for a first PRAGMA, for example.
#[tokio::test]
async fn a_database_without_tables_is_as_good_as_none() {
    let rig = Rig::new();
    fs::write(rig.database(), []).unwrap();
    rig.change("PRAGMA user_version = 0; CREATE TABLE a (b); DROP TABLE a").await;
    let error = ends(66, pointsd(&["sql", "SELECT 1", "--database"]).arg(rig.database()));
    assert!(error.contains("no database at ") && error.contains("the file has no tables yet"), "{error}");
    ends(0, pointsd(&["check", "--config"]).arg(rig.write_config()));
}

#[tokio::test]
async fn a_lock_of_another_program_is_named() {
    let (rig, daemon) = Rig::running();
    daemon.terminate();
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(rig.database());
    let mut other =
        sqlx::SqliteConnection::connect_with(&options.locking_mode(SqliteLockingMode::Exclusive)).await.unwrap();
    other.execute("BEGIN EXCLUSIVE").await.unwrap();
    let error = ends(66, pointsd(&["sql", "SELECT 1", "--database"]).arg(rig.database()));
    assert!(error.contains("another program holds its lock") && !error.contains("owns"), "{error}");
}

#[test]
fn a_help_that_cannot_be_written_is_an_error() {
    let full = || fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    for (arguments, exit) in [(&["--help"][..], 74), (&["sql", "--help"], 74), (&["--version"], 74), (&["--what"], 64)]
    {
        let output = pointsd(arguments).stdout(full()).output().unwrap();
        assert_eq!(output.status.code(), Some(exit), "{arguments:?}");
    }
}

/// The value is larger than the memory of the process. Neither the statement nor the file is wrong.
#[tokio::test]
async fn a_query_that_runs_out_of_memory_is_a_failed_read() {
    let rig = Rig::new();
    fs::write(rig.database(), []).unwrap();
    rig.change(include_str!("../storage/released.sql")).await;
    let mut sql = Command::new("sh");
    sql.env("MALLOC_ARENA_MAX", "2").args(["-c", "ulimit -v 800000; exec \"$@\"", "sh"]);
    sql.arg(pointsd(&[]).get_program()).args(["sql", "SELECT length(CAST(zeroblob(900000000) AS TEXT))", "--database"]);
    let error = ends(74, sql.arg(rig.database()));
    assert!(error.contains("out of memory"), "{error}");
}

/// The names of the commands in `--help`.
fn commands(help: &str) -> Vec<String> {
    let listed =
        help.lines().skip_while(|line| !line.starts_with("Commands:")).skip(1).take_while(|line| !line.is_empty());
    // The further lines of a description are indented more.
    let names = listed.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    names.map(|line| line.split_whitespace().next().unwrap().to_owned()).filter(|name| name != "help").collect()
}

#[test]
fn every_command_has_a_manual_page_an_example_exit_codes_and_completions() {
    let folder = tempfile::tempdir().unwrap();
    for (name, program) in [("pointsd", pointsd as fn(&[&str]) -> Command), ("pointsim", pointsim)] {
        let text = |arguments: &[&str]| String::from_utf8(program(arguments).output().unwrap().stdout).unwrap();
        let commands = commands(&text(&["--help"]));
        assert!(commands.len() >= 7, "{commands:?}");
        assert!(program(&["man"]).arg(folder.path()).status().unwrap().success());
        let scripts = ["bash", "fish", "zsh"].map(|shell| text(&["completions", shell]));
        for command in &commands {
            let page = fs::read_to_string(folder.path().join(format!("{name}-{command}.1"))).unwrap();
            assert!(page.contains(&format!(".TH {name}-{command} 1")), "{command}: {page:.300}");
            let help = text(&[command, "--help"]);
            assert!(help.contains(&format!("{name} {command}")) && help.contains("Example"), "{command}: {help}");
            let (_, example) = help.split_once("Example").unwrap();
            assert!(example.contains(&format!("{name} {command}")), "{command}: {help}");
            assert!(help.contains("Exit codes: 0"), "{command}: {help}");
            assert!(scripts.iter().all(|script| script.contains(command)), "{command}");
        }
        let pages = fs::read_dir(folder.path())
            .unwrap()
            .filter(|page| page.as_ref().unwrap().file_name().to_str().unwrap().starts_with(&format!("{name}-")));
        assert_eq!(pages.count(), commands.len());
        assert!(folder.path().join(format!("{name}.1")).exists());
        let script = folder.path().join("script");
        fs::write(&script, &scripts[0]).unwrap();
        assert!(Command::new("bash").arg("-n").arg(&script).status().unwrap().success());
        fs::remove_file(&script).unwrap();
    }
}
