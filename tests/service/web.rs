//! The dashboard of the real daemon over HTTP: its pages, its rejections, and slow, frequent and malicious clients,
//! which must not slow down the daemon.

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
    thread,
    time::{Duration, Instant},
};

use pointsd::{
    throw::ThrowRef,
    wire::{Encoding, encode_throw},
};
use sqlx::{Connection, SqliteConnection, sqlite::SqliteConnectOptions};

use crate::{
    faketime,
    rig::{Daemon, PATIENCE, Rig, matched, pointsd, stub, throws},
};

const KEY: &str = "points/v1/north/21B/throw";
const WEB: &str = "[web]\nlisten = \"127.0.0.1:0\"\n";
/// A boot id that a browser would run as a script if it were not escaped.
const HOSTILE: &str = "<script>alert(1)</script>\"'&";

/// A response.
#[derive(Debug)]
pub(crate) struct Answer {
    status: u16,
    head: String,
    pub(crate) body: String,
}

impl Answer {
    fn header(&self, name: &str) -> Option<&str> {
        self.head.lines().find_map(|line| {
            let (key, value) = line.split_once(':')?;
            key.eq_ignore_ascii_case(name).then(|| value.trim())
        })
    }
}

/// `127.0.0.1:PORT` of the daemon's dashboard.
pub(crate) fn address(daemon: &Daemon) -> String {
    daemon.until_log("the dashboard is at");
    let line = daemon.log().into_iter().find(|line| line.contains("the dashboard is at")).unwrap();
    line.split("http://").nth(1).unwrap().trim_end_matches('/').to_owned()
}

/// Sends these bytes and returns the response up to its end.
pub(crate) fn exchange(address: &str, request: &str) -> String {
    String::from_utf8(exchange_bytes(address, request.as_bytes())).unwrap()
}

pub(crate) fn exchange_bytes(address: &str, request: &[u8]) -> Vec<u8> {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(request).unwrap();
    let mut answer = Vec::new();
    // The response of a cut connection ends early.
    let _ = stream.read_to_end(&mut answer);
    answer
}

fn ask(address: &str, method: &str, path: &str, host: &str) -> Answer {
    let text = exchange(address, &format!("{method} {path} HTTP/1.1\r\nHost: {host}\r\n\r\n"));
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{method} {path}: {text:?}"));
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    Answer { status, head: head.to_owned(), body: body.to_owned() }
}

pub(crate) fn get(address: &str, path: &str) -> Answer {
    ask(address, "GET", path, address)
}

/// Checks that all elements are closed, in order.
fn check_nesting(html: &str) {
    const VOID: [&str; 4] = ["meta", "link", "!doctype", "input"];
    let mut open = Vec::new();
    for tag in html.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').unwrap_or_else(|| panic!("a < that begins no element: {tag:.60}"));
        let name = tag.split([' ', '\n', '/']).next().unwrap();
        match tag.strip_prefix('/') {
            Some(closed) => assert_eq!(open.pop(), Some(closed), "in {html}"),
            None if VOID.contains(&name) || tag.ends_with('/') => {}
            None => open.push(name),
        }
    }
    assert!(open.is_empty(), "{open:?} stay open");
}

/// A daemon with throws of one machine: two good ones, and a rejected one with a hostile boot id.
pub(crate) async fn small_history() -> (Rig, Daemon, String) {
    history_in(Rig::with(WEB)).await
}

async fn history_in(rig: Rig) -> (Rig, Daemon, String) {
    let daemon = rig.start();
    let session = daemon.client().await;
    let publisher = matched(&session, KEY).await;
    for throw in throws("boot", 2).iter().chain([&stub(HOSTILE, 1)]) {
        publisher.put(encode_throw(Encoding::Cbor, throw)).await.unwrap();
    }
    rig.judged(3).await;
    let address = address(&daemon);
    (rig, daemon, address)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_pages_show_fleet_machine_and_throw_and_nothing_else_can_be_done() {
    let (_rig, daemon, address) = small_history().await;
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
    for asset in ["/style.css", "/refresh.js"] {
        assert_eq!(get(&address, asset).status, 200);
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
        ("/?state=good", 400, "site, state, cause and q"),
        ("/?x=1", 400, "and a page"),
        ("/api/v1/machines/north/99", 404, "No throw of a machine north/99 is known"),
    ] {
        let answer = get(&address, path);
        assert_eq!(answer.status, status, "{path}: {answer:?}");
        assert!(answer.body.contains(says), "{path}: {}", answer.body);
        check_nesting(&answer.body);
        assert!(answer.header("content-security-policy").is_some(), "{path}");
    }
    assert!(daemon.terminate().success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_page_tells_what_is_wrong_with_the_daemon() {
    let rig = Rig::with(WEB);
    std::fs::write(rig.database(), vec![7_u8; 100_000]).unwrap();
    let (rig, daemon, address) = history_in(rig).await;
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE machine = 'pointsd' AND cause = 'data_loss'").await;
    // No logger has a liveliness token, so the pages must say so.
    let silence = "No logger is connected";
    let own_alarm = "Alarm of the daemon itself: pointsd loses data: its database was broken and was set aside";
    let fresh = "/machines/north/21B?span=all";
    let deadline = Instant::now() + PATIENCE;
    while !get(&address, fresh).body.contains(own_alarm) {
        assert!(Instant::now() < deadline, "{}", get(&address, fresh).body);
        thread::sleep(Duration::from_millis(50));
    }
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
    assert!(daemon.terminate().success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hostile_names_and_reasons_are_text_and_lead_where_they_say() {
    let (rig, daemon, _) = small_history().await;
    assert!(daemon.terminate().success());
    rig.change("UPDATE estimate SET detail = '<img src=x onerror=alert(2)>' WHERE quality <> 'good'").await;
    let daemon = rig.start();
    let address = address(&daemon);
    let machine = get(&address, "/machines/north/21B");
    let at = machine.body.find("/throws/%3Cscript").unwrap_or_else(|| panic!("no link: {}", machine.body));
    let link = format!("/machines/north/21B{}", machine.body[at..].split('"').next().unwrap());
    let throw = get(&address, &link);
    assert_eq!(throw.status, 200, "{link}: {throw:?}");
    assert!(throw.body.contains("alert(1)") && throw.body.contains("alert(2)"), "{}", throw.body);
    for page in [get(&address, "/"), machine, throw] {
        assert!(!page.body.contains("<script>") && !page.body.contains("<img"), "{}", page.body);
        check_nesting(&page.body);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_page_that_makes_its_name_lead_here_gets_nothing() {
    let rig = Rig::with(&format!("{WEB}hosts = [\"cabinet.north\"]\n"));
    let daemon = rig.start();
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
    let open = exchange(
        &address,
        &format!("GET /metrics HTTP/1.1\r\nHost: {address}\r\nAccept: application/openmetrics-text\r\n\r\n"),
    );
    assert!(
        open.to_lowercase().contains("content-type: application/openmetrics-text") && open.ends_with("# EOF\n"),
        "{open}"
    );
    // Without this header the older text format, with the same samples.
    let answer = get(&address, "/metrics");
    assert!(answer.header("content-type").unwrap().starts_with("text/plain; version=0.0.4"), "{answer:?}");
    let samples = |text: &str| text.lines().filter(|line| line.starts_with("pointsd_")).count();
    assert_eq!(samples(&open), samples(&answer.body));
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

/// Another process locks the database while minutes pass on the daemon's clock.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_loop_that_hangs_shows_in_healthz_and_on_the_pages() {
    let Some(library) = faketime::library() else { return };
    let mut rig = Rig::with(WEB);
    let clock = rig.folder().join("clock");
    std::fs::write(&clock, "+0").unwrap();
    rig.set("LD_PRELOAD", library);
    rig.set("FAKETIME_TIMESTAMP_FILE", &clock);
    rig.set("FAKETIME_NO_CACHE", "1");
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
    until(200, "every loop of the daemon beats\n", &mut |_| {});
    let mut other =
        SqliteConnection::connect_with(&SqliteConnectOptions::new().filename(rig.database())).await.unwrap();
    sqlx::query("BEGIN IMMEDIATE").execute(&mut other).await.unwrap();
    // A running write may still succeed; then the next one waits for another minute.
    let mut seconds = 0;
    let mut a_minute_passes = |health: &Answer| {
        if health.status == 200 {
            seconds += 60;
            std::fs::write(&clock, format!("+{seconds}")).unwrap();
        }
    };
    // The other loops beat again at once. Before the page is read the write may fail, and the next one starts.
    let is_told = (0..3).any(|_| {
        until(503, "these loops of the daemon hang: write\n", &mut a_minute_passes);
        get(&address, "/").body.contains("Parts of the daemon hang (write)")
    });
    assert!(is_told, "no page shows it");
    sqlx::query("ROLLBACK").execute(&mut other).await.unwrap();
    until(200, "every loop of the daemon beats\n", &mut |_| {});
    assert!(daemon.terminate().success());
}

#[test]
fn without_its_section_there_is_no_dashboard_and_a_taken_port_is_said() {
    let rig = Rig::new();
    let daemon = rig.start();
    assert!(!daemon.log().iter().any(|line| line.contains("dashboard")), "{:?}", daemon.log());
    drop(daemon);
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let failed = Rig::with(&format!("[web]\nlisten = \"127.0.0.1:{port}\"\n")).try_start().err().unwrap();
    assert_eq!(failed.status.code(), Some(69), "{failed:?}");
    let says = format!("the dashboard cannot listen on 127.0.0.1:{port} (web.listen): Address already in use");
    assert!(failed.log.iter().any(|line| line.contains(&says)), "{failed:?}");
}

/// 150,000 throws of one machine, 3,000 machines, 600 alarms: the pages stay small.
#[expect(clippy::too_many_lines, reason = "one history, every page of it")]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_big_history_gives_bounded_pages() {
    let (rig, daemon, address) = small_history().await;
    let fresh = get(&address, "/machines/north/21B?span=all").body.len();
    assert!(daemon.terminate().success());
    rig.change(
        "WITH RECURSIVE n(i) AS (SELECT 1000 UNION ALL SELECT i + 1 FROM n WHERE i < 151000)
         INSERT INTO throw (throw_row, machine_row, boot_row, throw_no, started_at_us, received_at_us, direction,
                            sample_rate_hz, samples, content_crc32, judged_at_us)
         SELECT i, machine_row, boot_row, i, started_at_us + 60000000 * i, received_at_us, direction, sample_rate_hz,
                samples, content_crc32, judged_at_us
         FROM n, (SELECT * FROM throw WHERE throw_row = 1)",
    )
    .await;
    rig.change(
        "WITH RECURSIVE n(i) AS (SELECT 1000 UNION ALL SELECT i + 1 FROM n WHERE i < 151000)
         INSERT INTO estimate (throw_row, machine_row, direction, direction_contradicted, quality, b0, a1, a0, b0_sd,
                               a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, throws_since_baseline)
         SELECT i, machine_row, CASE i % 2 WHEN 0 THEN 'normal_to_reverse' ELSE 'reverse_to_normal' END, 0, 'good', b0,
                a1, a0, b0_sd, a1_sd, a0_sd, i % 7, i % 11, -(i % 5), fit_pct, i
         FROM n, (SELECT * FROM estimate WHERE throw_row = 1)",
    )
    .await;
    rig.change(
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 3000)
         INSERT INTO machine (site, machine) SELECT 'south', 'M' || i FROM n",
    )
    .await;
    rig.change(
        "INSERT INTO boot (machine_row, boot_id, first_seen_us, highest_no)
         SELECT machine_row, 'b', 0, 1 FROM machine WHERE site = 'south'",
    )
    .await;
    rig.change(
        "INSERT INTO throw (throw_row, machine_row, boot_row, throw_no, started_at_us, received_at_us, sample_rate_hz,
                            samples, content_crc32, judged_at_us)
         SELECT 200000 + machine_row, machine_row, boot_row, 1, 0, 0, 1000, 0, 0, 1
         FROM machine JOIN boot USING (machine_row) WHERE site = 'south'",
    )
    .await;
    rig.change(
        "INSERT INTO estimate (throw_row, machine_row, direction, direction_contradicted, quality, throws_since_baseline)
         SELECT 200000 + machine_row, machine_row, 'normal_to_reverse', 0, 'good', 1 FROM machine WHERE site = 'south'",
    )
    .await;
    rig.change(
        "INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state)
         SELECT machine, machine_row, 'kt', machine_row, 1, 'active_unacknowledged'
         FROM machine WHERE site = 'south' AND machine_row % 5 = 0",
    )
    .await;
    rig.change(
        "INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state)
         SELECT machine || '-lost', machine_row, 'not_monitored', machine_row, 1, 'active_unacknowledged'
         FROM machine WHERE site = 'south' AND machine_row % 6 = 1",
    )
    .await;
    rig.change(
        "INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, payload)
         SELECT alarm_row, 1, 0, 'critical', state, json_object('schema', 'points.alarm/1', 'alarm_id', alarm_id,
                'event_no', 1, 'site', site, 'machine', machine, 'cause', cause, 'severity', 'critical', 'state', state,
                'raised_at', '2026-05-04T10:00:00Z', 'event_at', '2026-05-04T10:00:00Z', 'text', 'weak')
         FROM alarm JOIN machine USING (machine_row)",
    )
    .await;
    let daemon = rig.start();
    let address = self::address(&daemon);
    // After the start, as the daemon derives the state of machines with a loaded monitor.
    rig.change(
        "INSERT INTO monitor (machine_row, snapshot, updated_at_us, state, drifts)
         SELECT machine_row, (SELECT snapshot FROM monitor LIMIT 1), 0,
                CASE WHEN machine_row % 5 = 0 THEN 'critical' WHEN machine_row % 6 = 1 THEN 'not_monitored' ELSE 'healthy' END,
                CASE WHEN machine_row % 5 = 0 THEN
                    '[{\"cause\":\"kt\",\"change_pct\":-22.4,\"change_pct_sd\":0.5,\"direction\":null,\"limit_in_throws\":null}]' END
         FROM machine WHERE site = 'south'",
    )
    .await;
    let mut said = Vec::new();
    for (path, most) in [
        ("/", 150_000),
        ("/?state=critical&page=3", 150_000),
        ("/?q=M29", 150_000),
        ("/api/v1/machines?site=south", 150_000),
        ("/machines/north/21B?span=100", 400_000),
        ("/machines/north/21B?span=1000", 400_000),
        ("/machines/north/21B?span=all", 400_000),
        ("/metrics", 20_000),
    ] {
        let began = Instant::now();
        let answer = get(&address, path);
        said.push(format!("{path}: {} bytes, {:.1} ms", answer.body.len(), began.elapsed().as_secs_f64() * 1e3));
        assert_eq!(answer.status, 200, "{path}: {}", answer.body);
        assert!(answer.body.len() < most, "{path}: {} bytes", answer.body.len());
    }
    println!("with 150,000 throws more (before: {fresh} bytes): {}", said.join("; "));
    let fleet = get(&address, "/").body;
    // 600 machines have a critical alarm: the tally counts all of them, and they are first in the list.
    assert!(
        fleet.contains("3,001 machines</a>") && fleet.contains(">600 <span class=\"badge critical\">"),
        "{fleet:.3000}"
    );
    assert_eq!(fleet.matches("<tr><td><span class=\"badge critical\">").count(), 100);
    assert!(fleet.contains("550 more alarms about machines"), "{fleet:.3000}");
    assert!(fleet.contains("1 to 100 of 3,001"), "{fleet:.3000}");
    let lost = rig.sql("SELECT count(*) AS n FROM active_alarms WHERE cause = 'not_monitored'")[0]["n"].clone();
    assert!(fleet.contains(&format!("{lost} machines not monitored, raised from")), "{fleet:.3000}");
    assert!(fleet.contains(&format!("By site: south {lost}")), "{fleet:.3000}");
    assert!(fleet.contains("now −22 % ± 1") && fleet.contains("motor <strong>−22 % ± 1</strong>"), "{fleet:.3000}");
    let last = get(&address, "/?page=30").body;
    assert!(
        last.contains("3,001 to 3,001 of 3,001") && last.matches("<th scope=\"row\">").count() == 1,
        "{last:.3000}"
    );
    let tag = get(&address, "/").header("etag").unwrap().to_owned();
    let again = exchange(&address, &format!("GET / HTTP/1.1\r\nHost: {address}\r\nIf-None-Match: {tag}\r\n\r\n"));
    assert!(again.starts_with("HTTP/1.1 304") && again.len() < 300, "{again}");
    let beyond =
        rig.sql("SELECT machine FROM active_alarms ORDER BY site DESC, machine DESC LIMIT 1")[0]["machine"].clone();
    let beyond = get(&address, &format!("/machines/south/{}", beyond.as_str().unwrap())).body;
    assert!(beyond.contains(", critical · pointsd</title>"), "{beyond:.3000}");
    // The points are from the whole history: the axis is from May to August.
    let all = get(&address, "/machines/north/21B?span=all").body;
    assert!(all.contains("drawn are 250 throws normal to reverse and 250 back"), "{all:.3000}");
    for moment in ["Jun", "Jul", "Aug", "2026", "UTC"] {
        assert!(all.matches(&format!(">{moment}</text>")).count() >= 4, "{moment} in {all}");
    }
    check_nesting(&all);
    assert!(daemon.terminate().success());
}

/// Resident memory of a process \[KiB\].
fn resident_kib(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.split_whitespace().next().unwrap().parse().unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_hundred_readers_at_once_do_not_hold_up_the_throws() {
    const CLIENTS: usize = 200;
    let (rig, daemon, address) = small_history().await;
    let before = resident_kib(daemon.id());
    let session = daemon.client().await;
    let publisher = matched(&session, KEY).await;
    let paths = ["/", "/machines/north/21B?span=all", "/machines/north/21B/throws/boot/2", "/metrics"];
    let readers: Vec<_> = (0..CLIENTS)
        .map(|client| {
            let address = address.clone();
            thread::spawn(move || [0, 1, 2].map(|turn| get(&address, paths[(client + turn) % paths.len()]).status))
        })
        .collect();
    let made = throws("during", 40);
    for throw in &made {
        publisher.put(encode_throw(Encoding::Cbor, throw)).await.unwrap();
    }
    rig.judged(3 + made.len()).await;
    let mut busy = 0;
    for reader in readers {
        for status in reader.join().unwrap() {
            assert!(status == 200 || status == 503, "{status}");
            busy += usize::from(status == 503);
        }
    }
    let grown = resident_kib(daemon.id()).saturating_sub(before);
    println!("{CLIENTS} readers, {busy} of {} answers were busy; memory {before} KiB + {grown} KiB", 3 * CLIENTS);
    // 64 connections, each with a page and its buffers, and the throws.
    assert!(grown < 64 << 10, "{grown} KiB more");
    assert!(daemon.terminate().success());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_asks_slowly_or_without_end_is_cut_and_the_daemon_goes_on() {
    let (rig, daemon, address) = small_history().await;
    // More connections than the limit, each with an incomplete request.
    let mut slow: Vec<TcpStream> = (0..100)
        .map(|_| {
            let mut stream = TcpStream::connect(&address).unwrap();
            stream.write_all(b"GET / HTTP/1.1\r\nHost: ").unwrap();
            stream
        })
        .collect();
    let session = daemon.client().await;
    let publisher = matched(&session, KEY).await;
    publisher.put(encode_throw(Encoding::Cbor, &throws("after", 1)[0])).await.unwrap();
    assert_eq!(rig.judged(4).await.last().unwrap().throw, ThrowRef { boot_id: "after".to_owned(), throw_no: 1 });
    // They make way at once, not when their time is over, and go on being replaced by others.
    for path in ["/healthz", "/"] {
        let begin = Instant::now();
        slow.push(TcpStream::connect(&address).unwrap());
        assert_eq!(get(&address, path).status, 200);
        assert!(begin.elapsed() < Duration::from_secs(2), "{path} took {:?}", begin.elapsed());
    }
    for stream in &mut slow {
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        // All of them are closed: by an end, a reset, or an error response.
        let gone = stream.read_to_end(&mut Vec::new());
        assert!(
            gone.as_ref().err().is_none_or(|error| error.kind() == std::io::ErrorKind::ConnectionReset),
            "{gone:?}"
        );
    }
    // An endless request is cut before it fills the memory.
    let mut endless = TcpStream::connect(&address).unwrap();
    endless.set_write_timeout(Some(PATIENCE)).unwrap();
    endless.write_all(b"GET / HTTP/1.1\r\n").unwrap();
    let cut = (0..100_000)
        .find(|_| endless.write_all(b"X-Filler: aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa\r\n").is_err());
    assert!(cut.is_some(), "5 MB of headers were accepted");
    assert_eq!(get(&address, "/healthz").status, 200);
    assert!(daemon.terminate().success());
}

/// Forwards requests to the dashboard, but only the first `pages` for the page of the fleet. Returns its address, and
/// the number of requests for that page.
fn relay(dashboard: &str, pages: usize) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (place, dashboard) = (listener.local_addr().unwrap().to_string(), dashboard.to_owned());
    let asked = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&asked);
    thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let mut request = Vec::new();
            let mut buffer = [0; 4096];
            while !request.ends_with(b"\r\n\r\n") {
                match stream.read(&mut buffer) {
                    Ok(read) if read > 0 => request.extend(&buffer[..read]),
                    // The browser opened a connection in advance.
                    _ => break,
                }
            }
            if request.starts_with(b"GET / ") && counted.fetch_add(1, Relaxed) >= pages || request.is_empty() {
                continue;
            }
            // The browser may have closed the connection.
            let _ = stream.write_all(&exchange_bytes(&dashboard, &request));
        }
    });
    (place, asked)
}

/// A real browser shows the pages and runs our script under our policy: it reloads the page, and shows a message when
/// the daemon does not answer.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_real_browser_shows_the_pages_and_keeps_them_fresh() {
    if Command::new("chromium").arg("--version").stdout(Stdio::null()).status().is_err() {
        println!("skipped: chromium is not installed");
        return;
    }
    let (rig, daemon, address) = small_history().await;
    let profile = rig.folder().join("browser");
    let browse = |address: &str, path: &str, time_ms: u32| {
        let mut command = Command::new("chromium");
        command.args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--enable-logging=stderr"]);
        command.args([format!("--user-data-dir={}", profile.display()), format!("--virtual-time-budget={time_ms}")]);
        let output = command.args(["--dump-dom", &format!("http://{address}{path}")]).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!said.contains("Content Security Policy") && !said.contains("Uncaught"), "{said}");
        String::from_utf8(output.stdout).unwrap()
    };
    let machine = browse(&address, "/machines/north/21B", 2_000);
    // The hostile boot id is a text node, not an element.
    assert!(machine.contains("throws/%3Cscript%3E") && !machine.contains("<script>alert"), "{machine}");

    let (place, asked) = relay(&address, usize::MAX);
    let fresh = browse(&place, "/", 12_000);
    assert!(asked.load(Relaxed) >= 2, "{asked:?} requests in twelve seconds of the browser's time");
    assert!(fresh.contains("role=\"status\" hidden") && fresh.contains("baseline 1 of 50"), "{fresh}");
    let (place, _) = relay(&address, 1);
    let old = browse(&place, "/", 12_000);
    assert!(old.contains("No answer since") && old.contains("baseline 1 of 50"), "{old}");
    assert!(daemon.terminate().success());
}

/// Posts a form to the page of the machine.
fn post(address: &str, headers: &str, form: &str) -> Answer {
    let request = format!(
        "POST /machines/north/21B/command HTTP/1.1\r\nHost: {address}\r\nContent-Length: {}\r\n{headers}\r\n{form}",
        form.len()
    );
    let text = exchange(address, &request);
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{form}: {text:?}"));
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    Answer { status, head: head.to_owned(), body: body.to_owned() }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn operators_act_from_the_page_with_the_token_and_from_nowhere_else() {
    let (rig, daemon, address) = history_in(Rig::with(&format!("{WEB}token = \"correct horse battery\"\n"))).await;
    assert!(get(&address, "/machines/north/21B").body.contains("<form class=\"act\" method=\"post\""));
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
    assert!(status.contains("1 machines: 1 maintenance") && status.contains("by A. Meyer: <script>"), "{status}");
    assert_eq!(rig.sql("SELECT DISTINCT state FROM machine_health")[0]["state"], "maintenance");
    let api: serde_json::Value = serde_json::from_str(&get(&address, "/api/v1/machines").body).unwrap();
    assert_eq!(
        (&api["tally"]["maintenance"], &api["machines"][0]["state"]),
        (&1.into(), &"maintenance".into()),
        "{api}"
    );
    let end = good.replace("command=maintenance", "command=maintenance_end");
    assert_eq!(post(&address, &origin, &end).status, 303);
    assert!(get(&address, "/machines/north/21B").body.contains(", learning · pointsd</title>"));
    assert!(daemon.terminate().success());
}

#[test]
fn the_demo_names_its_dashboard() {
    let folder = tempfile::tempdir().unwrap();
    let mut demo = pointsd(&["demo", "--folder"]).arg(folder.path()).stdout(Stdio::piped()).spawn().unwrap();
    let mut output = std::io::BufReader::new(demo.stdout.take().unwrap());
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
    let deadline = Instant::now() + PATIENCE;
    while !get(address, "/").body.contains("baseline") {
        assert!(Instant::now() < deadline, "no throw is shown");
        thread::sleep(Duration::from_millis(50));
    }
    demo.kill().unwrap();
    demo.wait().unwrap();
}
