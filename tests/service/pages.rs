//! Time of each page and view with 20,000 machines and a million throws.

use std::time::{Duration, Instant};

use pointsd::wire::{Encoding, encode_throw};

use crate::{
    questions::large,
    rig::{Rig, matched, pointsd, throws},
    web::{address, exchange_bytes},
};

/// Limit of a page or view. The README gives 100 ms for a release build on a computer without other work.
const LIMIT: Duration = Duration::from_secs(2);
/// Requests for each page, the first after the changes to the database.
const TIMES: usize = 5;

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |value| value.parse().unwrap())
}

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
    let (machines, rows) = (number("POINTSD_MACHINES", 20_000), number("POINTSD_ROWS", 1_000_000));
    let rig = Rig::with("[web]\nlisten = \"127.0.0.1:0\"\n[subscribe]\nmax_machines = 100000\n");
    large(&rig, machines, rows).await;
    let daemon = rig.start();
    let session = daemon.client().await;
    let publisher = matched(&session, "points/v1/north/21B/throw").await;
    for throw in throws("boot", 2) {
        publisher.put(encode_throw(Encoding::Cbor, &throw)).await.unwrap();
    }
    rig.until_sql("SELECT 1 AS n FROM health_history WHERE machine = '21B' AND throw_no = 2").await;
    for statement in COMPLETE {
        rig.change(statement).await;
    }
    let address = address(&daemon);
    println!("{machines} machines, {rows} throws\n");
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
            // Older data than a second are read again.
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
        let first = times[0];
        times.sort();
        println!("| `{page}` | {bytes} | {:.1} | {:.1} |", milliseconds(first), milliseconds(times[TIMES / 2]));
        slow.extend((times[TIMES / 2] > LIMIT).then(|| page.to_owned()));
    }
    println!("\n| view | one machine, ms | newest 100 rows, ms |\n|---|---|---|");
    let database = rig.database().display().to_string();
    let ask = |question: &str| {
        let began = Instant::now();
        let output = pointsd(&["sql", "--csv", "--database", &database, question]).output().unwrap();
        assert!(output.status.success(), "{question}: {}", String::from_utf8_lossy(&output.stderr));
        began.elapsed()
    };
    let start = ask("SELECT 1");
    for (view, time) in [
        ("health_history", "started_at"),
        ("machine_health", "started_at"),
        ("active_alarms", "raised_at"),
        ("alarm_history", "raised_at"),
        ("alarm_events", "event_at"),
        ("throws_not_evaluated", "started_at"),
        ("operator_commands", "carried_out_at"),
        ("baselines", "taken_at"),
    ] {
        let one = ask(&format!("SELECT * FROM {view} WHERE site = 'north' AND machine = 'm1'")).saturating_sub(start);
        let newest = ask(&format!("SELECT * FROM {view} ORDER BY {time} DESC LIMIT 100")).saturating_sub(start);
        println!("| `{view}` | {:.0} | {:.0} |", milliseconds(one), milliseconds(newest));
        slow.extend((one.max(newest) > LIMIT).then(|| view.to_owned()));
    }
    assert!(slow.is_empty(), "{slow:?}");
    assert!(daemon.terminate().success());
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}
