//! The queries of `deploy/questions.sql` on a large database: each returns rows within the time limit.

use std::time::{Duration, Instant};

use crate::rig::{Rig, size};

/// Number of throws in the database; set by `POINTSD_ROWS=1000000`.
const ROWS: usize = 50_000;
/// Number of machines of these throws.
const MACHINES: usize = 500;
/// Time limit of a query, far above the milliseconds that it takes: it includes the start of the program, in a debug
/// build on a loaded computer.
const LIMIT: Duration = Duration::from_secs(2);

fn questions() -> Vec<String> {
    let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/deploy/questions.sql")).unwrap();
    let blocks = text.split("\n\n").filter(|block| block.trim_start_matches('\n').starts_with("-- "));
    blocks.filter(|block| block.contains("SELECT")).map(ToOwned::to_owned).collect()
}

/// Fills a database with this number of machines and throws, with alarms, rejected throws, baselines and commands.
pub(crate) async fn large(rig: &Rig, machines: usize, rows: usize) {
    rig.start().terminate();
    for statement in [
        format!(
            "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {machines})
             INSERT INTO machine (machine_row, site, machine) SELECT 10 + i, 'north', 'm' || i FROM n"
        ),
        "INSERT INTO boot (boot_row, machine_row, boot_id, first_seen_us, highest_no)
         SELECT machine_row, machine_row, 'boot', 0, 1000000 FROM machine WHERE site = 'north'"
            .to_owned(),
        format!(
            "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {rows})
             INSERT INTO throw (throw_row, machine_row, boot_row, throw_no, started_at_us, received_at_us, direction,
                                sample_rate_hz, samples, temperature_c, content_crc32, judged_at_us)
             SELECT i, 11 + i % {machines}, 11 + i % {machines}, i,
                    (unixepoch('now') - ({rows} - i) * 31536000 / {rows}) * 1000000, 0,
                    CASE i / {machines} % 2 WHEN 0 THEN 'normal_to_reverse' ELSE 'reverse_to_normal' END,
                    1000, 0, i % 40 - 10, 0, 1 FROM n"
        ),
        "INSERT INTO estimate (throw_row, machine_row, direction, direction_contradicted, quality, b0, a1, a0, b0_sd, a1_sd,
                               a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, mean_current_a, throws_since_baseline, rejected_start_us)
         SELECT throw_row, machine_row, direction, 0, CASE throw_row % 47 WHEN 0 THEN 'no_movement' ELSE 'good' END,
                200 + throw_row % 7, 5, 2, 1, 1, 1, throw_row % 7 - 3, machine_row % 40 - 20 + (direction = 'normal_to_reverse') * 15,
                throw_row % 5, 99.9, 3.5, 4.2, 100, CASE throw_row % 47 WHEN 0 THEN started_at_us END FROM throw"
            .to_owned(),
        // Open alarms for the last million throws only: their number does not grow with the history.
        format!(
            "INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state)
             SELECT 'a' || throw_row, machine_row, 'friction', started_at_us, 1,
                    CASE WHEN throw_row % 3 = 0 AND throw_row > {rows} - 1000000 THEN 'active_unacknowledged' ELSE 'normal' END
             FROM throw WHERE throw_row % 97 = 0 OR machine_row = 11 AND throw_row % 9 = 0"
        ),
        "INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, payload)
         SELECT alarm_row, 1, raised_at_us, 'critical', state, json_object('text', 'a sentence') FROM alarm"
            .to_owned(),
        "INSERT INTO baseline (machine_row, direction, taken_at_us, payload)
         SELECT machine_row, 'normal_to_reverse', 0, json_object('throws', 50, 'complete', json('true')) FROM machine"
            .to_owned(),
        "INSERT INTO command (machine_row, at_us, command, by_whom, payload)
         SELECT machine_row, (unixepoch('now') - 15768000) * 1000000, 'maintenance_start', 'tester',
                json_object('until', strftime('%Y-%m-%dT%H:%M:%SZ', unixepoch('now') - 15764400, 'unixepoch')) FROM machine"
            .to_owned(),
    ] {
        rig.change(statement).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn twelve_questions_are_answered_in_time() {
    let rows = size("POINTSD_ROWS", ROWS);
    let rig = Rig::new();
    large(&rig, MACHINES, rows).await;
    let questions = questions();
    assert_eq!(questions.len(), 12);
    let ask = |question: &str| {
        let began = Instant::now();
        let rows = rig.sql(question);
        (began.elapsed(), rows)
    };
    let (start, _) = ask("SELECT 1");
    for (question, index) in [
        ("SELECT count(*) FROM health_history WHERE started_at >= date('now', '-1 day')", "throw_by_start_text"),
        ("SELECT * FROM health_history ORDER BY started_at DESC LIMIT 100", "throw_by_start_text"),
        (
            "SELECT * FROM throws_not_evaluated ORDER BY started_at DESC LIMIT 100",
            "SCAN estimate USING INDEX estimate_rejected_by_text",
        ),
        ("SELECT * FROM throws_not_evaluated WHERE site = 'north' AND machine = 'm1'", "estimate_refused"),
        ("SELECT * FROM alarm_events WHERE site = 'north' AND machine = 'm1'", "alarm_of_machine"),
    ] {
        let (_, plan) = ask(&format!("EXPLAIN QUERY PLAN {question}"));
        assert!(plan.iter().any(|step| step["detail"].as_str().unwrap().contains(index)), "{question}: {plan:?}");
    }
    for (at, question) in questions.iter().enumerate() {
        let (took, answer) = ask(question);
        let (_, plan) = ask(&format!("EXPLAIN QUERY PLAN {}", question[question.find('\n').unwrap()..].trim()));
        let plan: Vec<&str> = plan.iter().map(|step| step["detail"].as_str().unwrap()).collect();
        println!(
            "{}. {} rows in {} ms, of {} ms for the program: {}",
            at + 1,
            answer.len(),
            took.as_millis(),
            start.as_millis(),
            plan.join("; ")
        );
        let is_traces = question.contains("can be exported");
        assert!(!answer.is_empty() || is_traces, "question {} has no answer: {question}", at + 1);
        assert!(took < LIMIT, "question {} took {took:?}", at + 1);
        let reads_all = |step: &&str| step.starts_with("SCAN estimate") && !step.contains("estimate_refused");
        assert!(!plan.iter().any(|step| reads_all(step) && rows > ROWS), "{}. {plan:?}", at + 1);
    }
}
