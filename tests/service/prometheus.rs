//! Prometheus reads the metrics and evaluates the shipped alert rules. Skipped, with a message, without Debian's
//! package `prometheus`.

use std::{
    collections::BTreeSet,
    fs,
    io::Write,
    process::{Command, Stdio},
};

use crate::{
    http::{KEY, WEB, address, exchange, get},
    operators::daemon_with_alarm,
    rig::{PATIENCE, Program, free_address, has, stub, until},
};

const DEPLOY: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/grafana");

/// Words in a text that begin with `pointsd_`: names of metrics.
fn names(text: &str) -> BTreeSet<String> {
    let is_part = |it: char| it.is_ascii_alphanumeric() || it == '_';
    let words = text.split(|it| !is_part(it)).filter(|word| word.starts_with("pointsd_"));
    words.map(ToOwned::to_owned).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn promtool_accepts_the_metrics_and_dashboards_and_rules_name_existing_ones() {
    let (rig, daemon) = daemon_with_alarm("a", WEB);
    // Some families have samples only after a rejected throw, or with a forecast.
    let logger = daemon.logger(KEY).await;
    logger.send([&stub("boot", 1)]).await;
    daemon.until_status("rejected throw", |status| status["judged"] == 51).await;
    rig.change(
        "UPDATE monitor SET drifts = json_set(drifts, '$[0].limit_in_throws', json('{\"low\":1,\"mid\":2,\"high\":3}'))
         WHERE state = 'critical'",
    )
    .await;
    let metrics = get(&address(&daemon), "/metrics").body;
    let known: BTreeSet<&str> =
        metrics.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next()).collect();
    assert!(
        metrics.contains("\npointsd_machine_drift_percent{site=\"north\",machine=\"machine-1\",cause=\"kt\"} -"),
        "{metrics}"
    );
    assert!(metrics.contains("\npointsd_dropped_total{kind=\"notifications\"} 0\n"), "{metrics}");
    for file in fs::read_dir(DEPLOY).unwrap() {
        let path = file.unwrap().path();
        let used = names(&fs::read_to_string(&path).unwrap());
        assert!(!used.is_empty(), "{}", path.display());
        let unknown: Vec<&String> = used.iter().filter(|name| !known.contains(name.as_str())).collect();
        assert!(unknown.is_empty(), "{}: {unknown:?}", path.display());
    }
    daemon.terminate();
    if has("promtool") {
        let mut check = Command::new("promtool");
        let check = check.args(["check", "metrics"]).stdin(Stdio::piped()).stderr(Stdio::piped());
        let mut child = check.spawn().unwrap();
        child.stdin.take().unwrap().write_all(metrics.as_bytes()).unwrap();
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.is_empty(), "{said}\n{metrics}");
        let rules =
            Command::new("promtool").args(["check", "rules", &format!("{DEPLOY}/alerts.yml")]).output().unwrap();
        assert!(rules.status.success(), "{rules:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_real_prometheus_scrapes_the_daemon_and_fires_the_rule_of_a_critical_alarm() {
    if !has("prometheus") {
        return;
    }
    let (rig, daemon) = daemon_with_alarm("a", WEB);
    rig.until_sql("SELECT 1 AS n FROM active_alarms WHERE severity = 'critical'").await;
    let config = rig.folder().join("prometheus.yml");
    let text = format!(
        "global: {{scrape_interval: 1s, evaluation_interval: 1s}}\nrule_files: [{DEPLOY}/alerts.yml]\n\
         scrape_configs: [{{job_name: pointsd, static_configs: [{{targets: ['{}']}}]}}]\n",
        address(&daemon)
    );
    fs::write(&config, text).unwrap();
    let place = free_address().to_string();
    let prometheus = Command::new("prometheus")
        .arg(format!("--config.file={}", config.display()))
        .arg(format!("--storage.tsdb.path={}", rig.folder().join("tsdb").display()))
        .arg(format!("--web.listen-address={place}"))
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let _prometheus = Program(prometheus);
    let fired = until(PATIENCE, async || {
        let rules = Command::new("promtool").args(["query", "instant", &format!("http://{place}"), "ALERTS"]).output();
        let text = String::from_utf8(rules.unwrap().stdout).unwrap();
        let is_fired = text.contains("alertname=\"PointMachineCritical\"") && text.contains("alertstate=\"firing\"");
        if is_fired { Ok(text) } else { Err(text) }
    })
    .await;
    let rules = format!("GET /api/v1/rules HTTP/1.1\r\nHost: {place}\r\nConnection: close\r\n\r\n");
    let rules = exchange(&place, &rules);
    assert!(fired.contains("cause=\"kt\"") && !fired.contains("PointsdDown"), "{fired}");
    assert!(rules.contains("\"health\":\"ok\"") && !rules.contains("\"health\":\"err\""), "{rules}");
}
