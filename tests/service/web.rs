//! The pages of the dashboard of the real daemon, their rejections, and the commands of operators from a page.

use std::{
    net::TcpListener,
    process::Stdio,
    thread,
    time::{Duration, Instant},
};

use pointsd::{
    simulate::{Fault, Part, Shape},
    throw::{Throw, Trace},
};

use crate::{
    faketime,
    http::{Answer, KEY, WEB, address, ask, check_nesting, exchange, get, history_in, small_history, until_page},
    rig::{PATIENCE, Program, Rig, faulty_throws, pointsd, stub, throws},
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_pages_show_fleet_machine_and_throw_and_nothing_else_can_be_done() {
    let (_rig, _daemon, address) = small_history().await;
    let fleet = get(&address, "/");
    assert_eq!(fleet.status, 200, "{fleet:?}");
    assert!(
        fleet.body.contains("<html lang=\"en\">") && fleet.body.contains("href=\"/machines/north/21B\""),
        "{}",
        fleet.body
    );
    assert!(fleet.body.contains("baseline 1 of 50") && fleet.body.contains(" learning</span>"), "{}", fleet.body);
    let machine = get(&address, "/machines/north/21B");
    let throw = get(&address, "/machines/north/21B/throws/boot/2");
    for picture in ["Motor current", "Running current", "Toe position from normal", "Position and model", "Residual"] {
        assert!(throw.body.contains(&format!(">{picture}</text>")), "{picture}: {}", throw.body);
    }
    assert!(throw.body.contains("href=\"/machines/north/21B/throws/boot/1\" rel=\"prev\""), "{}", throw.body);
    let csv = get(&address, "/machines/north/21B/throws/boot/2/trace.csv");
    assert!(csv.status == 200 && csv.body.starts_with("time_s,current_a,position_mm\n0.0000000,"), "{csv:.200?}");
    for span in ["100", "1000", "all"] {
        assert_eq!(get(&address, &format!("/machines/north/21B?span={span}")).status, 200);
    }
    for page in [&fleet, &machine, &throw] {
        check_nesting(&page.body);
        let policy = page.header("content-security-policy").unwrap();
        assert!(policy.starts_with("default-src 'none';") && !policy.contains("unsafe"), "{policy}");
        assert_eq!(page.header("x-content-type-options"), Some("nosniff"));
        assert_eq!(page.header("cache-control"), Some("no-store"));
        assert_eq!(page.header("referrer-policy"), Some("same-origin"));
        assert_eq!(page.header("set-cookie"), None);
        assert!(
            !page.body.contains(" style=") && !page.body.contains("onclick"),
            "the policy forbids inline style and script"
        );
    }
    for asset in ["/style.css", "/refresh.js", "/charts.js"] {
        let asset = get(&address, asset);
        assert_eq!((asset.status, asset.header("cache-control")), (200, Some("no-cache")));
    }
    // The chart library comes from the daemon, with its licence, and browsers keep it.
    let library = get(&address, "/uPlot-1.6.32.js");
    assert!(library.body.starts_with("/*\nThe MIT License") && library.body.contains("(v1.6.32)"), "{library:.300?}");
    for asset in ["/uPlot-1.6.32.js", "/uPlot-1.6.32.css"] {
        assert!(machine.body.contains(&format!("\"{asset}\"")) && throw.body.contains(&format!("\"{asset}\"")));
        assert!(get(&address, asset).header("cache-control").unwrap().contains("immutable"), "{asset}");
    }

    for method in ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"] {
        let refused = ask(&address, method, "/", &address);
        assert_eq!((refused.status, refused.header("allow")), (405, Some("GET, HEAD")), "{method}");
        assert!(refused.body.contains("can only be read"), "{method}: {}", refused.body);
    }
    let head = ask(&address, "HEAD", "/", &address);
    assert_eq!((head.status, head.body.as_str()), (200, ""));
    for (path, status, says) in [
        ("/nowhere", 404, "There is no such page"),
        ("/machines/north/99", 404, "No throw of a machine north/99 is known"),
        ("/machines/no%20rth/99", 404, "There is no such machine"),
        ("/machines/north/21B/throws/boot/3", 404, "has no such throw"),
        ("/machines/north/21B/throws/boot/18446744073709551615", 404, "has no such throw"),
        ("/machines/north/21B/throws/boot/three", 400, "the number of the throw"),
        ("/machines/north/21B?span=7", 400, "span=1000"),
        ("/machines/north/%FF", 400, "not valid"),
        ("/machines/../../etc/passwd", 404, "There is no such page"),
        ("/machines/north/..%2F..%2Fetc", 404, "There is no such machine"),
        ("/?state=good", 400, "state must be one of learning, healthy"),
        ("/?cause=magnet", 400, "cause must be one of kt, friction"),
        ("/?x=1", 400, "and a page"),
        ("/api/v1/machines/north/99", 404, "No throw of a machine north/99 is known"),
        ("/api/v1/machines/no%20rth/99", 404, "There is no such machine"),
        ("/api/v1/nowhere", 404, "There is no such page"),
        ("/api/v1/machines?x=1", 400, "and a page"),
        ("/api/v1/alarms?cause=kt", 400, "has no parameters"),
        ("/api/v1/status?x", 400, "has no parameters"),
        ("/api/v1/machines/north/21B?limit=1", 400, "has no parameters"),
    ] {
        let answer = get(&address, path);
        assert_eq!(answer.status, status, "{path}: {answer:?}");
        assert!(answer.body.contains(says), "{path}: {}", answer.body);
        if path.starts_with("/api/") {
            let error: serde_json::Value = serde_json::from_str(&answer.body).unwrap();
            assert!(error["error"].as_str().unwrap().contains(says), "{path}: {error}");
            assert_eq!(answer.header("content-type"), Some("application/json"), "{path}");
        } else {
            check_nesting(&answer.body);
        }
        assert!(answer.header("content-security-policy").is_some(), "{path}");
    }
}

/// The throws of a machine without a toe sensor are never good.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_throw_is_drawn_with_one_of_the_baseline_of_any_quality() {
    let (rig, daemon) = Rig::running_with(&format!("[diagnosis]\nbaseline_throws = 12\n{WEB}"));
    let address = address(&daemon);
    until_page(&address, "/", "No machine has sent a throw yet").await;
    daemon.logger(KEY).await.send(throws("boot", 30)).await;
    rig.judged(30).await;
    for quality in ["good", "rough", "current_only"] {
        rig.change(&format!("UPDATE estimate SET quality = '{quality}'")).await;
        let page = get(&address, "/machines/north/21B/throws/boot/30").body;
        assert!(page.contains("The curve “baseline” is <a"), "{quality}: {page}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_critical_alarm_stands_above_warnings_about_lost_data() {
    let (rig, daemon) = Rig::running_with(&format!("[diagnosis]\nbaseline_throws = 12\n{WEB}"));
    let fault = Fault { part: Part::Kt, shape: Shape::Step, size_pct: -20.0, from_throw: 30 };
    let weak = daemon.logger(KEY).await;
    weak.send(faulty_throws(fault, "boot", 36)).await;
    let confused = daemon.logger("points/v1/north/22A/throw").await;
    let other = Trace::new(100.0, vec![0.1; 20], vec![0.0; 20]).unwrap();
    confused.send([stub("boot", 1), Throw { trace: other, ..stub("boot", 1) }]).await;
    rig.judged(38).await;
    let address = address(&daemon);
    until_page(&address, "/", "with data loss").await;
    let page = get(&address, "/").body;
    let at = |what: &str| page.find(what).unwrap_or_else(|| panic!("{what}: {page}"));
    assert!(at("north/21B</a>: <strong>motor</strong>") < at("1 machine with data loss"), "{page}");
    check_nesting(&page);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_trace_that_is_too_large_for_a_page_names_the_command_that_writes_it() {
    const SAMPLES: usize = 600_000;
    let (rig, daemon) = Rig::running_with(WEB);
    let values = vec![0.123_456_7; SAMPLES];
    let throw = Throw { trace: Trace::new(20_000.0, values.clone(), values).unwrap(), ..stub("boot", 1) };
    let logger = daemon.logger(KEY).await;
    logger.send([&throw]).await;
    rig.judged(1).await;
    let answer = get(&address(&daemon), "/machines/north/21B/throws/boot/1/trace.csv");
    assert_eq!(answer.status, 413, "{answer:?}");
    assert!(answer.body.contains("pointsd export north/21B --traces DIR"), "{answer:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_page_shows_the_problems_of_the_daemon() {
    let rig = Rig::with(WEB);
    std::fs::write(rig.database(), vec![7_u8; 100_000]).unwrap();
    let (rig, _daemon, address) = history_in(rig).await;
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE machine = 'pointsd' AND cause = 'data_loss'").await;
    // No logger has a liveliness token, so the pages must say so.
    let silence = "No logger has a liveliness token";
    let own_alarm = "Alarm of the daemon itself: pointsd loses data: its database was broken and was set aside";
    let fresh = "/machines/north/21B?span=all";
    until_page(&address, fresh, own_alarm).await;
    for path in ["/", "/machines/north/21B", "/machines/north/21B/throws/boot/2", "/machines/fleet/pointsd"] {
        let page = get(&address, path);
        let banner = page.body.split("<main>").next().unwrap();
        assert!(page.status == 200 && banner.contains(silence) && banner.contains(own_alarm), "{path}: {page:?}");
    }
    // The page of the daemon itself has neither directions nor throws.
    let itself = get(&address, "/machines/fleet/pointsd").body;
    assert!(!itself.contains("of the baseline") && !itself.contains("Last throws"), "{itself}");
    check_nesting(&itself);
    // An error page shows the problems that are known without the database.
    let failure = get(&address, "/machines/north/99");
    assert!(failure.status == 404 && failure.body.contains(silence), "{failure:?}");
    let stranger = ask(&address, "GET", "/", "rebound.example");
    assert!(stranger.status == 421 && !stranger.body.contains(silence), "{stranger:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hostile_names_and_reasons_are_shown_as_text_and_their_links_work() {
    let (rig, daemon, _) = small_history().await;
    daemon.terminate();
    rig.change("UPDATE estimate SET detail = '<img src=x onerror=alert(2)>' WHERE quality <> 'good'").await;
    let daemon = rig.start();
    let address = address(&daemon);
    let machine = get(&address, "/machines/north/21B");
    let at = machine.body.find("/throws/%3Cscript").unwrap_or_else(|| panic!("no link: {}", machine.body));
    let link = format!("/machines/north/21B{}", machine.body[at..].split('"').next().unwrap());
    let throw = get(&address, &link);
    assert_eq!(throw.status, 200, "{link}: {throw:?}");
    assert!(throw.body.contains("alert(1)") && throw.body.contains("alert(2)"), "{}", throw.body);
    let drawn = machine.body.split("id=\"drawn\">").nth(1).unwrap().split("</script>").next().unwrap();
    let drawn: Vec<(f64, String)> = serde_json::from_str(drawn).unwrap();
    assert!(drawn.iter().all(|(_, path)| link.ends_with(path) || path.starts_with("boot/")), "{drawn:?}");
    for page in [get(&address, "/"), machine, throw] {
        assert!(!page.body.contains("<script>") && !page.body.contains("<img"), "{}", page.body);
        check_nesting(&page.body);
    }
}

/// A foreign page can point its own host name at the daemon (DNS rebinding).
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_with_a_foreign_host_name_gets_nothing() {
    let (_rig, daemon) = Rig::running_with(&format!("{WEB}hosts = [\"cabinet.north\"]\n"));
    let address = address(&daemon);
    for ours in [address.as_str(), "localhost", "[::1]:80", "cabinet.north:7480"] {
        assert_eq!(ask(&address, "GET", "/", ours).status, 200, "{ours}");
    }
    for other in ["rebound.example", "127.0.0.1.rebound.example", ""] {
        let refused = ask(&address, "GET", "/metrics", other);
        assert_eq!(refused.status, 421, "{other}");
        assert!(!refused.body.contains("pointsd_throws"), "{}", refused.body);
    }
    for none in ["GET / HTTP/1.1\r\n\r\n", "GET / HTTP/1.1\r\nHost: a\r\nHost: 127.0.0.1\r\n\r\n"] {
        assert!(exchange(&address, none).starts_with("HTTP/1.1 400"), "{none}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_metrics_count_what_the_daemon_did() {
    let (_rig, daemon, address) = small_history().await;
    daemon.until_status("three judged throws", |status| status["judged"] == 3).await;
    let answer = get(&address, "/metrics");
    assert!(answer.header("content-type").unwrap().starts_with("text/plain; version=0.0.4"), "{answer:?}");
    let value = |name: &str| answer.body.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
    for (name, expected) in [
        ("pointsd_throws_received_total", "3"),
        ("pointsd_throws_stored_total", "3"),
        ("pointsd_throws_judged_total", "3"),
        ("pointsd_messages_lost_total", "0"),
        ("pointsd_throws_waiting", "0"),
        ("pointsd_loggers", "0"),
        ("pointsd_machines", "1"),
        ("pointsd_disk_state{state=\"ok\"}", "1"),
        ("pointsd_disk_state{state=\"full\"}", "0"),
        ("pointsd_loop_alive{loop=\"write\"}", "1"),
        ("pointsd_alarms_open{cause=\"kt\",severity=\"critical\"}", "0"),
    ] {
        assert_eq!(value(name), Some(expected), "{name} in {}", answer.body);
    }
    let refused: Vec<&str> =
        answer.body.lines().filter(|line| line.starts_with("pointsd_throws_not_evaluated_total{")).collect();
    assert_eq!(refused.len(), 1, "{refused:?}");
    assert!(refused[0].ends_with("\"} 1"), "{refused:?}");
    assert!(value("pointsd_database_bytes").unwrap().parse::<u64>().unwrap() > 4096);
    assert!(answer.body.contains("pointsd_build_info{version=\""), "{}", answer.body);
    assert_eq!(value("pointsd_machine_state{site=\"north\",machine=\"21B\",state=\"learning\"}"), Some("1"));
    assert!(!answer.body.contains("script"), "no label is free text");
    assert_eq!(get(&address, "/healthz").status, 200);
}

/// The link of an alarm outlives its throw, which retention deletes, later with all throws of its boot.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_throw_that_retention_has_deleted_is_not_taken_for_one_that_never_was() {
    let (rig, _daemon, address) = small_history().await;
    rig.change("DELETE FROM throw WHERE throw_no = 1; UPDATE boot SET pruned_to_no = 1 WHERE boot_id = 'boot'").await;
    for end in ["", "/trace.csv"] {
        let answer = get(&address, &format!("/machines/north/21B/throws/boot/1{end}"));
        assert_eq!(answer.status, 410, "{answer:?}");
        assert!(answer.body.contains("retention has deleted the throws of boot boot up to it"), "{answer:?}");
    }
    let never = get(&address, "/machines/north/21B/throws/boot/3");
    assert!(never.status == 404 && !never.body.contains("etention"), "{never:?}");
    let unknown = get(&address, "/machines/north/21B/throws/old/1");
    assert!(
        unknown.status == 404 && unknown.body.contains("or retention has deleted all throws of boot old"),
        "{unknown:?}"
    );
}

/// Another process locks the database while minutes pass on the daemon's clock.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_loop_that_hangs_shows_in_healthz_and_on_the_pages() {
    let mut rig = Rig::with(WEB);
    let Some(clock) = faketime::clock_of(&mut rig) else { return };
    let daemon = rig.start();
    let address = address(&daemon);
    let until = |status: u16, says: &str, meanwhile: &mut dyn FnMut(&Answer)| {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let health = get(&address, "/healthz");
            if health.status == status && health.body == says {
                return;
            }
            assert!(Instant::now() < deadline, "no {status} {says:?}: {health:?}; {:?}", daemon.log());
            meanwhile(&health);
            thread::sleep(Duration::from_millis(20));
        }
    };
    until(200, "every loop of the daemon is running\n", &mut |_| {});
    let mut other = rig.locked("BEGIN IMMEDIATE").await;
    // A running write may still succeed; then the next one waits for another minute.
    let mut seconds = 0;
    let mut a_minute_passes = |health: &Answer| {
        if health.status == 200 {
            seconds += 60;
            std::fs::write(&clock, format!("+{seconds}")).unwrap();
        }
    };
    // The other loops beat again at once. Three attempts, because the write may fail before the page is read.
    let is_shown = (0..3).any(|_| {
        until(503, "these loops of the daemon hang: write\n", &mut a_minute_passes);
        get(&address, "/").body.contains("HANGING: write")
    });
    assert!(is_shown, "no page shows the loop that hangs");
    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
    until(200, "every loop of the daemon is running\n", &mut |_| {});
}

#[test]
fn without_its_section_there_is_no_dashboard_and_a_taken_port_is_an_error() {
    let (_rig, daemon) = Rig::running();
    assert!(!daemon.log().iter().any(|line| line.contains("dashboard")), "{:?}", daemon.log());
    drop(daemon);
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let failed = Rig::with(&format!("[web]\nlisten = \"127.0.0.1:{port}\"\n")).try_start().err().unwrap();
    assert_eq!(failed.status.code(), Some(69), "{failed:?}");
    let says = format!("the dashboard cannot listen on 127.0.0.1:{port} (web.listen): Address already in use");
    assert!(failed.log.iter().any(|line| line.contains(&says)), "{failed:?}");
}

/// Posts a form to the page of the machine.
fn post(address: &str, headers: &str, form: &str) -> Answer {
    let request = format!(
        "POST /machines/north/21B/command HTTP/1.1\r\nHost: {address}\r\nContent-Length: {}\r\n{headers}\r\n{form}",
        form.len()
    );
    Answer::to(address, &request)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn operators_act_from_the_page_with_the_token_and_from_nowhere_else() {
    let (rig, daemon, address) = history_in(Rig::with(&format!("{WEB}token = \"correct horse battery\"\n"))).await;
    assert!(get(&address, "/machines/north/21B").body.contains("<form class=\"act\" method=\"post\""));
    let refused = ask(&address, "PUT", "/", &address);
    assert_eq!((refused.status, refused.header("allow")), (405, Some("GET, HEAD, POST")));
    let form = |token: &str| format!("command=maintenance&hours=3&why=%3Cscript%3E&by=A.+Meyer&token={token}");
    let (good, origin) = (form("correct+horse+battery"), format!("Origin: http://{address}\r\n"));
    for (headers, form, status, says) in [
        (origin.clone(), form("wrong"), 403, "the token is wrong"),
        (origin.clone(), form(""), 403, "the token is wrong"),
        (String::new(), good.clone(), 403, "page of another site"),
        ("Origin: http://evil.example\r\n".to_owned(), good.clone(), 403, "page of another site"),
        (format!("{origin}Sec-Fetch-Site: cross-site\r\n"), good.clone(), 403, "page of another site"),
        (origin.clone(), good.replace("hours=3", "hours=9999"), 409, "Nothing was done"),
        (origin.clone(), good.replace("%3Cscript%3E", "a%1Bb"), 409, "no control characters"),
        (origin.clone(), good.replace("maintenance", "reboot"), 400, "no command"),
    ] {
        let refused = post(&address, &headers, &form);
        assert!(refused.status == status && refused.body.contains(says), "{headers}{form}: {refused:?}");
    }
    assert!(rig.sql("SELECT * FROM operator_commands").is_empty());
    // A refused form is shown again with the typed values, except the token.
    for (typed, why) in [
        (form("wrong"), "&#60;script&#62;"),
        (good.replace("why=%3Cscript%3E", "why="), ""),
        (good.replace("hours=3", "hours=9999"), "&#60;script&#62;"),
    ] {
        let again = post(&address, &origin, &typed).body;
        check_nesting(&again);
        for part in [
            "<p class=\"trouble\" role=\"alert\">",
            "<option value=\"maintenance\" selected>",
            &format!("name=\"why\" maxlength=\"200\" value=\"{why}\""),
            "value=\"A. Meyer\"",
            if typed.contains("9999") { "value=\"9999\"" } else { "value=\"3\"" },
        ] {
            assert!(again.contains(part), "{typed}: {part}: {again}");
        }
        assert!(!again.contains("value=\"wrong") && !again.contains("correct horse"), "{again}");
    }
    let done = post(&address, &format!("{origin}Sec-Fetch-Site: same-origin\r\n"), &good);
    assert_eq!((done.status, done.header("location")), (303, Some("/machines/north/21B#commands")), "{done:?}");

    // Every page shows the maintenance, with its end, operator and reason.
    let machine = get(&address, "/machines/north/21B").body;
    let fleet = get(&address, "/?state=maintenance").body;
    for page in [&machine, &fleet] {
        assert!(page.contains("in maintenance until ") && page.contains("by A. Meyer: &#60;script&#62;"), "{page}");
        assert!(page.contains("<span class=\"badge maintenance\">") && !page.contains("<script>"), "{page}");
    }
    let (_, status) = daemon.operate(&["status"]);
    assert!(status.contains("1 machine: 1 maintenance") && status.contains("by A. Meyer: <script>"), "{status}");
    assert_eq!(rig.sql("SELECT DISTINCT state FROM machine_health")[0]["state"], "maintenance");
    let api: serde_json::Value = serde_json::from_str(&get(&address, "/api/v1/machines").body).unwrap();
    assert_eq!(
        (&api["tally"]["maintenance"], &api["machines"][0]["state"], api.get("next_page")),
        (&1.into(), &"maintenance".into(), Some(&serde_json::Value::Null)),
        "{api}"
    );
    let status: serde_json::Value = serde_json::from_str(&get(&address, "/api/v1/status").body).unwrap();
    assert_eq!((&status["windows"][0]["by"], &status["windows"][0]["machine"]), (&"A. Meyer".into(), &"21B".into()));
    let end = good.replace("command=maintenance", "command=maintenance_end");
    assert_eq!(post(&address, &origin, &end).status, 303);
    assert!(get(&address, "/machines/north/21B").body.contains(", learning · pointsd</title>"));
}

/// Another program locks the database for longer than a page may take.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_command_from_a_page_waits_until_it_is_applied() {
    let (rig, _daemon, address) = history_in(Rig::with(&format!("{WEB}token = \"correct horse battery\"\n"))).await;
    let mut other = rig.locked("BEGIN IMMEDIATE").await;
    let origin = format!("Origin: http://{address}\r\n");
    let form = "command=rebaseline&why=greased&by=A.+Meyer&token=correct+horse+battery";
    let answer = thread::spawn(move || post(&address, &origin, form));
    // A page may take 4 s, and a request 5 s.
    tokio::time::sleep(Duration::from_secs(6)).await;
    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
    let done = answer.join().unwrap();
    assert_eq!(done.status, 303, "{done:?}");
    assert_eq!(rig.sql("SELECT * FROM operator_commands").len(), 1);
}

/// Another program locks the database for longer than a command may take. One of two commands may be half applied then;
/// the other is dropped.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_command_that_timed_out_is_not_applied_later() {
    let (rig, daemon, address) = history_in(Rig::with(&format!("{WEB}token = \"correct horse battery\"\n"))).await;
    let send = |why: &str| {
        let form = format!("command=rebaseline&why={why}&by=A.+Meyer&token=correct+horse+battery");
        let address = address.clone();
        thread::spawn(move || post(&address, &format!("Origin: http://{address}\r\n"), &form))
    };
    let mut other = rig.locked("BEGIN IMMEDIATE").await;
    for late in ["first", "second"].map(send) {
        let answer = late.join().unwrap();
        assert!(answer.body.contains("the daemon is busy: check whether"), "{answer:?}");
    }
    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
    daemon.until_log("operator's command dropped");
    assert_eq!(send("third").join().unwrap().status, 303);
    let applied = rig.sql("SELECT why FROM operator_commands");
    let applied: Vec<&str> = applied.iter().map(|row| row["why"].as_str().unwrap()).collect();
    assert!(applied.contains(&"third") && applied.len() <= 2, "{applied:?}");
}

#[tokio::test]
async fn the_demo_names_its_dashboard() {
    let folder = tempfile::tempdir().unwrap();
    let demo = pointsd(&["demo", "--folder"]).arg(folder.path()).stdout(Stdio::piped()).spawn().unwrap();
    let mut demo = Program(demo);
    let mut output = std::io::BufReader::new(demo.0.stdout.take().unwrap());
    let mut line = String::new();
    while !line.starts_with("In a browser: ") {
        line.clear();
        assert_ne!(
            std::io::BufRead::read_line(&mut output, &mut line).unwrap(),
            0,
            "the output ended without the address"
        );
    }
    let address = line.trim().strip_prefix("In a browser: http://").unwrap().trim_end_matches('/');
    until_page(address, "/", "baseline").await;
}

/// Such a throw stays the newest by its date for years, and would press all others in the charts into a line.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_throw_dated_years_ahead_is_not_the_last_one_of_its_direction() {
    let (rig, daemon) = Rig::running_with(WEB);
    let mut all = throws("boot", 5);
    all[2].started_at = "2096-05-04T10:00:00Z".parse().unwrap();
    let logger = daemon.logger(KEY).await;
    logger.send(all).await;
    rig.judged(5).await;
    let page = get(&address(&daemon), "/machines/north/21B").body;
    assert!(page.contains("3 of 50 throws"), "{page}");
    assert!(page.contains("drawn are 2 throws normal to reverse and 2 back. 1 throw dated before 2001"), "{page}");
}

/// Alarms of the daemon itself carry its name, which stays in the database when the daemon gets another name.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_earlier_name_of_the_daemon_is_no_machine() {
    let (rig, daemon) = Rig::running_with(WEB);
    let logger = daemon.logger(KEY).await;
    logger.send(throws("boot", 1)).await;
    rig.judged(1).await;
    rig.change("INSERT INTO machine (site, machine) VALUES ('fleet', 'earlier')").await;
    let answer: serde_json::Value = serde_json::from_str(&get(&address(&daemon), "/api/v1/machines").body).unwrap();
    let names: Vec<_> = answer["machines"].as_array().unwrap().iter().map(|machine| &machine["machine"]).collect();
    assert_eq!(names, ["21B"]);
}
