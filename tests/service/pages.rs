//! Size and time of each page with a large history, up to 20,000 machines and a million throws.

use std::{
    fs,
    time::{Duration, Instant},
};

use pointsd::throw::Trace;

use crate::{
    http::{self, WEB, address, check_nesting, exchange, exchange_bytes, get, small_history},
    json::json_message,
    questions::large,
    rig::{Rig, ends, pointsd, size, throws},
};

/// Limit of a page or view, far above the 100 ms that it takes in a release build on a computer without other work.
const LIMIT: Duration = Duration::from_secs(2);
/// Requests for each page, the first after the changes to the database.
const TIMES: usize = 5;

/// Turns alarms and machines of `large` into complete ones: messages that the pages can read, states with drifts.
const COMPLETE: [&str; 2] = [
    "UPDATE alarm_event SET payload = (SELECT json_object('schema', 'points.alarm/1', 'alarm_id', alarm_id, 'event_no', 1,
            'site', site, 'machine', machine, 'cause', cause, 'severity', 'critical', 'state', alarm.state,
            'raised_at', '2026-05-04T10:00:00Z', 'event_at', '2026-05-04T10:00:00Z', 'text', 'friction up',
            'change_pct', 20.0, 'change_pct_sd', 1.0)
     FROM alarm JOIN machine USING (machine_row) WHERE alarm.alarm_row = alarm_event.alarm_row)",
    "INSERT INTO monitor (machine_row, snapshot, updated_at_us, state, drifts)
     SELECT machine_row, '{}', 0, CASE WHEN is_open THEN 'critical' ELSE 'healthy' END, CASE WHEN is_open THEN
         '[{\"cause\":\"friction\",\"change_pct\":22.4,\"change_pct_sd\":0.5,\"direction\":null,\"limit_in_throws\":null}]' END
     FROM (SELECT machine_row, EXISTS (SELECT 1 FROM alarm WHERE alarm.machine_row = machine.machine_row
                                       AND alarm.state <> 'normal') AS is_open
           FROM machine WHERE site = 'north' AND machine <> '21B')",
];

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
#[ignore = "takes a minute; prints a table"]
async fn times_of_pages_and_views() {
    let (machines, rows) = (size("POINTSD_MACHINES", 20_000), size("POINTSD_ROWS", 1_000_000));
    let rig = Rig::with("[web]\nlisten = \"127.0.0.1:0\"\n[subscribe]\nmax_machines = 100000\n")
        .store("ballast_mib = 0\nmax_size_mib = 100000\nmax_throws = 100000000\nmax_alarms = 10000000\n");
    large(&rig, machines, rows).await;
    let began = Instant::now();
    let daemon = rig.start();
    let start = began.elapsed();
    let logger = daemon.logger("points/v1/north/21B/throw").await;
    logger.send(throws("boot", 2)).await;
    rig.until_sql("SELECT 1 AS n FROM health_history WHERE machine = '21B' AND throw_no = 2").await;
    for statement in COMPLETE {
        rig.change(statement).await;
    }
    let address = address(&daemon);
    println!("{machines} machines, {rows} throws, ready {:.0} ms after the start\n", milliseconds(start));
    println!("| page | bytes, compressed | first, ms | median of {TIMES}, ms |\n|---|---|---|---|");
    let mut slow = Vec::new();
    for page in [
        "/",
        "/?page=150",
        "/?state=critical",
        "/?cause=friction&q=7",
        "/machines/north/m1",
        "/machines/north/m1?span=1000",
        "/machines/north/m1?span=all",
        "/machines/north/21B/throws/boot/2",
        "/machines/north/21B/throws/boot/2/trace.csv",
        "/api/v1/status",
        "/api/v1/machines",
        "/api/v1/machines/north/m1",
        "/api/v1/alarms",
        "/metrics",
        "/healthz",
    ] {
        let request = format!("GET {page} HTTP/1.1\r\nHost: {address}\r\nAccept-Encoding: gzip\r\n\r\n");
        let mut times = Vec::new();
        let mut bytes = 0;
        for _ in 0..TIMES {
            let began = Instant::now();
            let answer = exchange_bytes(&address, request.as_bytes());
            times.push(began.elapsed());
            assert!(answer.starts_with(b"HTTP/1.1 200"), "{page}: {}", String::from_utf8_lossy(&answer));
            bytes = answer.len();
            // The daemon reads data again that are older than a second.
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
        let first = times[0];
        times.sort();
        println!("| `{page}` | {bytes} | {:.1} | {:.1} |", milliseconds(first), milliseconds(times[TIMES / 2]));
        slow.extend((times[TIMES / 2] > LIMIT).then(|| page.to_owned()));
    }
    println!("\n| view | one machine, ms | newest 100 rows, ms |\n|---|---|---|");
    let ask = |question: &str| {
        let began = Instant::now();
        rig.sql(question);
        began.elapsed()
    };
    let of_program = ask("SELECT 1");
    for (view, time) in [
        ("health_history", "started_at"),
        ("machine_health", "started_at"),
        ("active_alarms", "raised_at"),
        ("alarm_history", "raised_at"),
        ("alarm_events", "event_at"),
        ("throw_features", "started_at"),
        ("throws_not_evaluated", "started_at"),
        ("operator_commands", "carried_out_at"),
        ("baselines", "taken_at"),
    ] {
        let one =
            ask(&format!("SELECT * FROM {view} WHERE site = 'north' AND machine = 'm1'")).saturating_sub(of_program);
        let newest = ask(&format!("SELECT * FROM {view} ORDER BY {time} DESC LIMIT 100")).saturating_sub(of_program);
        println!("| `{view}` | {:.0} | {:.0} |", milliseconds(one), milliseconds(newest));
        slow.extend((one.max(newest) > LIMIT).then(|| view.to_owned()));
    }
    assert!(slow.is_empty(), "{slow:?}");
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// 150,000 throws of one machine, 3,000 machines, 600 alarms: the pages stay small.
#[expect(clippy::too_many_lines, reason = "one history, every page of it")]
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_big_history_gives_bounded_pages() {
    let (rig, daemon, address) = small_history().await;
    let fresh = get(&address, "/machines/north/21B?span=all").body.len();
    daemon.terminate();
    rig.change(
        "WITH RECURSIVE n(i) AS (SELECT 1000 UNION ALL SELECT i + 1 FROM n WHERE i < 151000)
         INSERT INTO throw (throw_row, machine_row, boot_row, throw_no, started_at_us, received_at_us, direction,
                            sample_rate_hz, samples, content_crc32, judged_at_us)
         SELECT i, machine_row, boot_row, i, started_at_us + 60000000 * i, received_at_us, direction, sample_rate_hz,
                samples, content_crc32, judged_at_us
         FROM n, (SELECT * FROM throw WHERE throw_row = 1);
         WITH RECURSIVE n(i) AS (SELECT 1000 UNION ALL SELECT i + 1 FROM n WHERE i < 151000)
         INSERT INTO estimate (throw_row, machine_row, direction, direction_contradicted, quality, b0, a1, a0, b0_sd,
                               a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, throws_since_baseline)
         SELECT i, machine_row, CASE i % 2 WHEN 0 THEN 'normal_to_reverse' ELSE 'reverse_to_normal' END, 0, 'good', b0,
                a1, a0, b0_sd, a1_sd, a0_sd, i % 7, i % 11, -(i % 5), fit_pct, i
         FROM n, (SELECT * FROM estimate WHERE throw_row = 1);
         WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 3000)
         INSERT INTO machine (site, machine) SELECT 'south', 'M' || i FROM n;
         INSERT INTO boot (machine_row, boot_id, first_seen_us, highest_no)
         SELECT machine_row, 'b', 0, 1 FROM machine WHERE site = 'south';
         INSERT INTO throw (throw_row, machine_row, boot_row, throw_no, started_at_us, received_at_us, sample_rate_hz,
                            samples, content_crc32, judged_at_us)
         SELECT 200000 + machine_row, machine_row, boot_row, 1, 0, 0, 1000, 0, 0, 1
         FROM machine JOIN boot USING (machine_row) WHERE site = 'south';
         INSERT INTO estimate (throw_row, machine_row, direction, direction_contradicted, quality, throws_since_baseline)
         SELECT 200000 + machine_row, machine_row, 'normal_to_reverse', 0, 'good', 1 FROM machine WHERE site = 'south'",
    )
    .await;
    let daemon = rig.start();
    let address = http::address(&daemon);
    // After the start: the daemon derives the state of each machine whose monitor it loads, and ends the alarms of
    // machines without a monitor.
    rig.change(
        "INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state)
         SELECT machine, machine_row, 'kt', machine_row, 1, 'active_unacknowledged'
         FROM machine WHERE site = 'south' AND machine_row % 5 = 0;
         INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state)
         SELECT machine || '-lost', machine_row, 'not_monitored', machine_row, 1, 'active_unacknowledged'
         FROM machine WHERE site = 'south' AND machine_row % 6 = 1;
         INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, payload)
         SELECT alarm_row, 1, 0, 'critical', state, json_object('schema', 'points.alarm/1', 'alarm_id', alarm_id,
                'event_no', 1, 'site', site, 'machine', machine, 'cause', cause, 'severity', 'critical', 'state', state,
                'raised_at', '2026-05-04T10:00:00Z', 'event_at', '2026-05-04T10:00:00Z', 'text', 'weak')
         FROM alarm JOIN machine USING (machine_row);
         INSERT INTO monitor (machine_row, snapshot, updated_at_us, state, drifts)
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
    let silent = "SELECT machine FROM active_alarms GROUP BY site, machine HAVING min(cause) = 'not_monitored'
                  AND max(cause) = 'not_monitored'";
    assert_eq!(rig.sql(silent).len(), 400);
    assert!(fleet.contains("1 to 100 of 3,001"), "{fleet:.3000}");
    assert!(get(&address, "/?state=not_monitored").body.contains("1 to 100 of 400"));
    let lost = rig.number("SELECT count(*) FROM active_alarms WHERE cause = 'not_monitored'");
    assert!(fleet.contains(&format!("{lost} machines not monitored, raised from")), "{fleet:.3000}");
    assert!(fleet.contains(&format!("By site: south {lost}")), "{fleet:.3000}");
    assert!(fleet.contains("now −22 % ± 1") && fleet.contains("motor <strong>−22 % ± 1</strong>"), "{fleet:.3000}");
    let last = get(&address, "/?page=30").body;
    assert!(
        last.contains("3,001 to 3,001 of 3,001") && last.matches("<th scope=\"row\">").count() == 1,
        "{last:.3000}"
    );
    // Machines with faults lose their loggers too: the tally still says that there are faults.
    rig.change("UPDATE monitor SET state = 'not_monitored' WHERE machine_row % 30 = 0 AND state = 'critical'").await;
    let faults = get(&address, "/?q=M").body;
    assert!(faults.contains(">500 (100 with other alarms) <span class=\"badge not_monitored\">"), "{faults:.3000}");
    // The machines whose only alarm is that they are not monitored come after those with faults.
    rig.change("UPDATE monitor SET state = 'warning' WHERE machine_row % 30 = 2").await;
    let states = (0..12).flat_map(|page| {
        let text = get(&address, &format!("/api/v1/machines?site=south&page={page}")).body;
        let list: serde_json::Value = serde_json::from_str(&text).unwrap();
        list["machines"].as_array().unwrap().iter().map(|row| row["state"].clone()).collect::<Vec<_>>()
    });
    let mut states: Vec<_> = states.collect();
    states.dedup();
    assert_eq!(states, ["critical", "not_monitored", "warning", "not_monitored", "healthy"]);
    let tag = get(&address, "/").header("etag").unwrap().to_owned();
    let again = exchange(&address, &format!("GET / HTTP/1.1\r\nHost: {address}\r\nIf-None-Match: {tag}\r\n\r\n"));
    assert!(again.starts_with("HTTP/1.1 304") && again.len() < 300, "{again}");
    let beyond =
        rig.sql("SELECT machine FROM active_alarms ORDER BY site DESC, machine DESC LIMIT 1")[0]["machine"].clone();
    let beyond = get(&address, &format!("/machines/south/{}", beyond.as_str().unwrap())).body;
    assert!(beyond.contains(", critical · pointsd</title>"), "{beyond:.3000}");
    // The drawn throws are from the whole history, so the axis reaches from May to August.
    let all = get(&address, "/machines/north/21B?span=all").body;
    assert!(all.contains("drawn are 250 throws normal to reverse and 250 back"), "{all:.3000}");
    for moment in ["Jun", "Jul", "Aug", "2026", "UTC"] {
        assert!(all.matches(&format!(">{moment}</text>")).count() >= 4, "{moment} in {all}");
    }
    check_nesting(&all);
}

/// The level of the baseline comes from its own throws, also if the chart shows only later throws.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_lines_of_the_baseline_are_those_of_its_throws() {
    let rig = Rig::with(&format!("{WEB}[diagnosis]\nbaseline_throws = 12\n"));
    let mut made = throws("boot", 230);
    for throw in &mut made[24..] {
        let current = throw.trace.current_a().iter().map(|amperes| 1.5 * amperes).collect();
        throw.trace = Trace::new(throw.trace.sample_rate_hz(), current, throw.trace.position_mm().to_vec()).unwrap();
    }
    let file = rig.folder().join("many.ndjson");
    let lines: Vec<_> = made.iter().map(json_message).collect();
    fs::write(&file, lines.join(&b'\n')).unwrap();
    ends(0, pointsd(&["import", "--machine", "north/21B", "--config"]).arg(rig.write_config()).arg(&file));
    let daemon = rig.start();
    let address = address(&daemon);
    let levels = || -> Vec<f64> {
        let page = get(&address, "/machines/north/21B").body;
        let charts = page.split("<script type=\"application/json\">").skip(1);
        let charts =
            charts.filter_map(|rest| serde_json::from_str::<serde_json::Value>(rest.split("</script>").next()?).ok());
        let chart = charts.into_iter().find(|chart| chart["title"] == "Mean current").unwrap();
        chart["levels"].as_array().unwrap().iter().map(|level| level[0].as_f64().unwrap()).collect()
    };
    let of_baseline = rig.sql(
        "SELECT min(mean_current_a) AS low, max(mean_current_a) AS high FROM health_history WHERE throw_no <= 24 \
         GROUP BY direction",
    );
    let [low, high] = ["low", "high"].map(|end| of_baseline.iter().map(move |row| row[end].as_f64().unwrap()));
    let (low, high) = (low.fold(f64::INFINITY, f64::min), high.fold(0.0, f64::max));
    let found = levels();
    assert!(found.len() == 2 && found.iter().all(|level| (low..=high).contains(level)), "{found:?}, {low} to {high}");
    let page = || get(&address, "/machines/north/21B").body;
    assert_eq!(page().matches("<td>complete</td>").count(), 2);
    // A baseline with a trend.
    rig.change("UPDATE baseline SET payload = json_set(payload, '$.complete', json('false'))").await;
    assert_eq!(page().matches("<td>provisional</td>").count(), 2);
    // The discarded baseline is no level.
    daemon.says(0, &["rebaseline", "north/21B", "--why", "test", "--by", "A"]);
    assert_eq!(levels(), Vec::<f64>::new());
}
