//! `pointsd sql` and `pointsd backup` on the database of an open store.

use std::{path::Path, process::Command};

use pointsd::store::Found;

use crate::given::{fresh, judged, open, spooled};

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

    let copy = folder.path().join("copy.db");
    let [vacuum, second, hidden] =
        ["VACUUM", "SELECT 1; vacuum", "/**/VACUUM/**/"].map(|start| format!("{start} INTO '{}'", copy.display()));
    for refused in ["DELETE FROM throw", "SELECT wrong FROM nothing", "not SQL", &vacuum, &second, &hidden] {
        let (code, _, error) = pointsd(&["sql", refused], store.path());
        assert_eq!(code, Some(65), "{refused}: {error}");
        assert!(!copy.exists(), "{refused}");
    }
    assert_eq!(pointsd(&["sql", "SELECT 'vacuum' AS vacuum"], store.path()).0, Some(0));
    assert_eq!(store.statistics().await.unwrap().throws, 2);
    let (code, _, error) = pointsd(&["sql", "SELECT 1"], &folder.path().join("nowhere.db"));
    assert_eq!(code, Some(66));
    assert!(error.contains("nowhere.db"), "{error}");
    let empty = folder.path().join("empty.db");
    std::fs::write(&empty, "").unwrap();
    let (code, _, error) = pointsd(&["sql", "SELECT 1"], &empty);
    assert!(code == Some(66) && error.contains("is empty"), "{error}");
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
    // The copy is checked when it is first opened, as the source was in use.
    let opened = open(restored.path()).await;
    assert_eq!(opened.report.found, Found::WithoutLog);
    assert_eq!(opened.store.statistics().await.unwrap().pending, 40);
}
