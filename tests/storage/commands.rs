//! `pointsd sql` and `pointsd backup` on the database of an open store.

use std::{path::Path, process::Command};

use pointsd::store::Found;

use crate::given::{change, fresh, judged, open, spooled};

fn pointsd(arguments: &[&str], database: &Path) -> (Option<i32>, String, String) {
    let output =
        Command::new(env!("CARGO_BIN_EXE_pointsd")).args(arguments).arg("--database").arg(database).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[tokio::test]
async fn sql_answers_in_three_forms_and_never_writes() {
    let (folder, store) = fresh().await;
    for throw_no in 1..=2 {
        judged(&store, "21B", "b1", throw_no).await;
    }
    let question = "SELECT throw_no, b0 + 0.25 AS b0, NULL AS none, quality, x'00ff' AS bytes FROM health_history";
    let (code, json, _) = pointsd(&["sql", "--json", question], store.path());
    let rows: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(code, Some(0));
    assert_eq!(
        rows,
        serde_json::json!([
            {"throw_no": 1, "b0": 203.25, "none": null, "quality": "good", "bytes": "00ff"},
            {"throw_no": 2, "b0": 203.25, "none": null, "quality": "good", "bytes": "00ff"},
        ])
    );
    let (_, csv, _) = pointsd(&["sql", "--csv", question], store.path());
    assert_eq!(csv, "throw_no,b0,none,quality,bytes\n1,203.25,,good,00ff\n2,203.25,,good,00ff\n");
    let (_, table, _) = pointsd(&["sql", question], store.path());
    assert!(table.contains("throw_no") && table.contains("203.25"), "{table}");
    let (_, table, _) = pointsd(&["sql", "SELECT char(27) || '[2J' AS text"], store.path());
    assert!(table.contains("\\u{1b}[2J") && !table.contains('\u{1b}'), "{table:?}");
    let (_, empty, _) = pointsd(&["sql", "--json", "SELECT * FROM active_alarms"], store.path());
    assert_eq!(serde_json::from_str::<serde_json::Value>(&empty).unwrap(), serde_json::json!([]));
    for (format, question, says) in [
        ("--json", "SELECT 1 AS a, 2 AS a", "two columns are named a: rename one with AS"),
        ("--json", "SELECT 1 AS a, 9e999 AS b", "JSON has no infinity, which the column b contains"),
    ] {
        let (code, _, error) = pointsd(&["sql", format, question], store.path());
        assert_eq!((code, error.trim_end()), (Some(64), &*format!("error: {says}")), "{question}");
    }

    let copy = folder.path().join("copy.db");
    let attach = format!("ATTACH '{}' AS copy", copy.display());
    let [vacuum, second, hidden] =
        ["VACUUM", "SELECT 1; vacuum", "/**/VACUUM/**/"].map(|start| format!("{start} INTO '{}'", copy.display()));
    for (refused, says) in [
        ("DELETE FROM throw", "it writes to the database"),
        ("PRAGMA main.journal_mode = DELETE", "it writes to the database"),
        (&attach, &format!("unable to open database: {}; this command only reads", copy.display())),
        ("SELECT wrong FROM nowhere", "no such table: nowhere"),
        ("", "the query is empty"),
        ("-- SELECT 1", "the query is empty"),
        ("not SQL", "near \"not\": syntax error"),
        (&vacuum, "VACUUM writes a file"),
        (&second, "VACUUM writes a file"),
        (&hidden, "VACUUM writes a file"),
    ] {
        let (code, _, error) = pointsd(&["sql", refused], store.path());
        assert_eq!(code, Some(65), "{refused}: {error}");
        assert!(error.starts_with(&format!("error: the SQL statement is wrong: {says}")), "{refused}: {error}");
        assert!(!copy.exists(), "{refused}");
    }
    for several in ["SELECT 1; SELECT 2", "SELECT 1 WHERE 0; SELECT 2 WHERE 0"] {
        let (code, _, error) = pointsd(&["sql", several], store.path());
        let says = "error: only the first statement was answered: write one statement at a time\n";
        assert_eq!((code, &*error), (Some(65), says), "{several}");
    }
    for single in ["SELECT 'vacuum' AS vacuum", "SELECT 1;", "SELECT 1; -- done"] {
        let (code, _, error) = pointsd(&["sql", single], store.path());
        assert_eq!((code, &*error), (Some(0), ""), "{single}");
    }
    assert_eq!(store.statistics().await.unwrap().throws, 2);
    let (code, _, error) = pointsd(&["sql", "SELECT 1"], &folder.path().join("nowhere.db"));
    assert_eq!(code, Some(66));
    assert!(error.contains("nowhere.db"), "{error}");
    let empty = folder.path().join("empty.db");
    std::fs::write(&empty, "").unwrap();
    let (code, _, error) = pointsd(&["sql", "SELECT 1"], &empty);
    assert!(code == Some(66) && error.contains("is empty"), "{error}");
}

/// Every command that reads a database refuses another file with the same text and exit code.
#[tokio::test]
async fn a_file_that_is_no_database_of_pointsd_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let [text, bytes, songs] = ["text.db", "bytes.db", "songs.db"].map(|name| folder.path().join(name));
    std::fs::write(&text, "a letter").unwrap();
    std::fs::write(&bytes, [0xa7; 9000]).unwrap();
    // Its migrations may be those of the same library.
    change(&songs, ["CREATE TABLE songs (title TEXT)", "CREATE TABLE _sqlx_migrations (version INTEGER, success)"])
        .await;
    change(&songs, ["INSERT INTO _sqlx_migrations VALUES (1, 1)"]).await;
    let (copy, page) = (folder.path().join("copy.db"), folder.path().join("page.html"));
    let [copy, page] = [&copy, &page].map(|path| path.to_str().unwrap());
    let config = folder.path().join("pointsd.toml");
    for (file, says) in
        [(text, "is not a database"), (bytes, "is not a database"), (songs, "is the database of another program")]
    {
        let says = format!("error: {} {says}: name another file\n", file.display());
        for command in [&["sql", "SELECT 1"][..], &["export"], &["backup", copy], &["report", "a/b", "--out", page]] {
            let (code, _, error) = pointsd(command, &file);
            assert_eq!((code, &error), (Some(65), &says), "{command:?}");
        }
        std::fs::write(&config, format!("[store]\npath = {:?}\n", file.display().to_string())).unwrap();
        let replay = Command::new(env!("CARGO_BIN_EXE_pointsd")).args(["replay", "--config"]).arg(&config).output();
        let replay = replay.unwrap();
        assert_eq!((replay.status.code(), &*String::from_utf8_lossy(&replay.stderr)), (Some(65), &*says), "replay");
    }
}

/// A misspelt key would choose the database of this folder.
#[test]
fn a_configuration_that_does_not_name_the_database_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("pointsd.toml");
    for (text, says) in [
        (Some("[store]\npfad = \"/var/lib/pointsd/points.db\"\n"), "pointsd.toml:2: store.pfad: unknown field"),
        (None, "pointsd.toml: cannot be read"),
    ] {
        let _ = std::fs::remove_file(&config);
        text.map_or(Ok(()), |text| std::fs::write(&config, text)).unwrap();
        let command =
            Command::new(env!("CARGO_BIN_EXE_pointsd")).args(["sql", "--config"]).arg(&config).output().unwrap();
        let error = String::from_utf8(command.stderr).unwrap();
        assert!(command.status.code() == Some(78) && error.contains(says), "{error}");
    }
}

#[tokio::test]
async fn a_backup_is_complete_opens_and_never_overwrites() {
    let (_folder, store) = fresh().await;
    for throw_no in 1..=40 {
        spooled(&store, "21B", "b1", throw_no).await;
    }
    let restored = tempfile::tempdir().unwrap();
    let copy = restored.path().join("points.db");
    let (code, said, error) = pointsd(&["backup", copy.to_str().unwrap()], store.path());
    assert_eq!(code, Some(0), "{error}");
    assert!(said.contains("checked") && error.is_empty(), "{said} {error}");
    let (code, ..) = pointsd(&["backup", copy.to_str().unwrap()], store.path());
    assert_eq!(code, Some(73), "a second backup replaced the first");
    // The database was in use, so its copy is not marked as cleanly stopped, and its first opening checks it.
    let opened = open(restored.path()).await;
    assert_eq!(opened.report.found, Found::WithoutLog);
    assert_eq!(opened.store.statistics().await.unwrap().pending, 40);
}
