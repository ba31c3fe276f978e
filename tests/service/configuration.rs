//! A wrong configuration: exit 78, with file, line and key, without any change of files.

use std::{
    fs,
    io::{BufRead as _, BufReader},
    net::TcpListener,
    os::unix::fs::PermissionsExt as _,
    process::Stdio,
    time::Duration,
};

use crate::rig::{PATIENCE, Rig, ends, pointsd, pointsim, send_signal, status_of, until};

#[test]
fn a_wrong_configuration_is_named_with_file_line_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("wrong.toml");
    for (text, says) in [
        ("[subscribe]\nkeys = \"points/v1/**\"\n", "2: subscribe.keys: "),
        ("[diagnosis]\n\nfriction_limit_pct = 0\n", "3: diagnosis.friction_limit_pct: "),
        ("[store]\npath = \"/no/such/folder/points.db\"\n", "2: store.path: "),
        ("[zenoh]\nmode = \"router\"\nlisten.endpoint = []\n", "3: zenoh.listen.endpoint: "),
        ("[machines]\nlead_mm = \"ten\"\n", "2: machines.lead_mm: "),
        ("[store\n", "1: "),
    ] {
        fs::write(&file, text).unwrap();
        for command in ["check", "run"] {
            let error = ends(78, pointsd(&[command, "--config"]).arg(&file));
            assert!(error.contains(&format!("{}:{says}", file.display())), "{command} on {text:?}: {error}");
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }
    for (file, says) in [("/no/such/file.toml", "cannot be read"), ("/dev/zero", "more than 4194304 bytes")] {
        let error = ends(78, &mut pointsd(&["check", "--config", file]));
        assert!(error.contains(says), "{error}");
    }
}

/// The daemon does not change the file, and systemd does not restart it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_file_of_another_program_is_a_wrong_configuration() {
    let rig = Rig::new();
    fs::write(rig.database(), []).unwrap();
    rig.change("CREATE TABLE users (name TEXT)").await;
    let refused = |reason: &str| {
        for command in ["check", "run"] {
            let error = ends(78, pointsd(&[command, "--config"]).arg(rig.write_config()));
            let place = format!("{}:3: store.path: ", rig.write_config().display());
            assert!(error.contains(reason) && error.contains(&place), "{command}: {error}");
        }
    };
    refused("the database of another program");
    let text = "site,machine\nnorth,21B\n";
    fs::write(rig.database(), text).unwrap();
    refused("is a text file");
    assert_eq!(fs::read_to_string(rig.database()).unwrap(), text);
}

#[test]
fn a_database_of_another_user_is_a_wrong_configuration() {
    let rig = Rig::new();
    rig.start().terminate();
    fs::set_permissions(rig.database(), fs::Permissions::from_mode(0o444)).unwrap();
    if fs::OpenOptions::new().write(true).open(rig.database()).is_ok() {
        println!("skipped: root may write to every file");
        return;
    }
    for (command, exit, says) in
        [("check", 78, "this user cannot write to"), ("run", 74, "its -wal and its -shm belong to")]
    {
        let error = ends(exit, pointsd(&[command, "--config"]).arg(rig.write_config()));
        assert!(error.contains(says), "{command}: {error}");
    }
}

#[test]
fn a_wrong_fleet_is_named_too() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("wrong.toml");
    fs::write(&file, "[fleet]\nmachines = 0\n").unwrap();
    let error = ends(78, pointsim(&["run", "--config"]).arg(&file));
    assert!(error.contains(":2: fleet.machines: "), "{error}");
}

#[test]
fn a_second_daemon_on_the_same_database_is_refused() {
    let (rig, daemon) = Rig::running();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("second.toml");
    let text = format!("store.path = {:?}\nzenoh.listen.endpoints = [\"tcp/127.0.0.1:0\"]\n", rig.database());
    fs::write(&file, text).unwrap();
    let error = ends(69, pointsd(&["run", "--config"]).arg(&file));
    assert!(error.contains("another pointsd works on"), "{error}");

    // A port that another daemon uses.
    let text = format!(
        "store.path = {:?}\nzenoh.listen.endpoints = [{:?}]\n",
        folder.path().join("other.db"),
        daemon.endpoint
    );
    fs::write(&file, text).unwrap();
    ends(69, pointsd(&["run", "--config"]).arg(&file));
}

#[test]
fn a_start_that_fails_leaves_the_database_clean() {
    let rig = Rig::new().same_port();
    let daemon = rig.start();
    let port = daemon.endpoint.trim_start_matches("tcp/").to_owned();
    daemon.terminate();
    let taken = TcpListener::bind(port).unwrap();
    let failed = rig.try_start().err().unwrap();
    assert_eq!(failed.status.code(), Some(69), "{failed:?}");
    drop(taken);
    let daemon = rig.start();
    daemon.until_log("the database was closed cleanly");
}

/// Another program locks the database, so that the start waits for it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_signal_during_the_start_stops_the_daemon() {
    let rig = Rig::new();
    rig.start().terminate();
    let mut other = rig.locked("BEGIN EXCLUSIVE").await;
    let (daemon, _) = rig.launch();
    let catches_sigterm = || u64::from_str_radix(&status_of(daemon.id(), "SigCgt"), 16).unwrap() >> 14 & 1 == 1;
    until(PATIENCE, async || if catches_sigterm() { Ok(()) } else { Err(format!("{:?}", daemon.log())) }).await;
    daemon.terminate();
    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
}

/// The logger also says what the daemons that it found serve.
#[test]
fn a_logger_that_no_daemon_serves_says_so() {
    let (rig, daemon) = Rig::running_with("[subscribe]\nkey = \"points/v1/north/**\"\n");
    let file = rig.folder().join("pointsim.toml");
    fs::write(&file, "[logger]\nsite = \"mars\"\n").unwrap();
    let mut command = pointsim(&["run", "--connect", &daemon.endpoint, "--config"]);
    let mut logger = command.arg(&file).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(logger.stderr.take().unwrap()).lines().map_while(Result::ok);
    let warning = lines.find(|line| line.contains("no daemon serves this site")).unwrap_or_default();
    assert!(
        warning.contains("mars") && warning.contains("the daemons that answer serve other machines ("),
        "{warning}"
    );
    logger.kill().unwrap();
    logger.wait().unwrap();
}

/// A daemon or a logger waits for its router. It says so, and can be stopped.
#[test]
fn a_client_without_its_router_says_so_and_can_be_stopped() {
    let away = Rig::new().same_port();
    let router = away.start().endpoint.clone();
    let rig = Rig::new().behind(&router);
    let (mut daemon, ready) = rig.launch();
    daemon.until_log(&format!("no router answers at [\"{router}\"]"));
    daemon.signal("-TERM");
    assert!(daemon.wait(Duration::from_secs(5)).success(), "{:?}", daemon.log());
    assert!(ready.recv().is_err());

    let mut logger = pointsim(&["run", "--connect", &router]).stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(logger.stderr.take().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains("no router answers at"), "{line}");
    let caught = u64::from_str_radix(&status_of(logger.id(), "SigCgt"), 16).unwrap();
    assert_eq!(caught & 1, 0, "SIGHUP has its default action: the logger ends with its terminal");
    send_signal("-INT", logger.id());
    assert!(logger.wait().unwrap().success());

    // The daemon is ready as soon as its router is back. A SIGHUP during the start has its effect after it.
    let (daemon, ready) = rig.launch();
    daemon.until_log("no router answers at");
    daemon.signal("-HUP");
    let _router = away.start();
    ready.recv_timeout(PATIENCE).unwrap();
    daemon.until_log("configuration reloaded");
    daemon.terminate();
}
