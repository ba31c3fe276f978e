-- machine_health: a machine whose throws all have an unknown direction, as with a dead sensor, was missing.
DROP VIEW machine_health;
CREATE VIEW machine_health AS
SELECT machine.site, machine.machine, coalesce(nullif(latest.direction, ''), 'unknown') AS direction, coalesce(monitor.state, 'learning') AS state,
       strftime('%Y-%m-%dT%H:%M:%S', (latest.start_us - (latest.start_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (latest.start_us % 1000000 + 1000000) % 1000000) AS started_at,
       throw.throw_no, estimate.quality, estimate.b0, estimate.a1, estimate.a0,
       estimate.b0_sd, estimate.a1_sd, estimate.a0_sd,
       iif(estimate.baseline_throws = 0, NULL, estimate.b0_pct) AS b0_pct,
       iif(estimate.baseline_throws = 0, NULL, estimate.a1_pct) AS a1_pct,
       iif(estimate.baseline_throws = 0, NULL, estimate.a0_pct) AS a0_pct,
       estimate.fit_pct, estimate.duration_s, estimate.peak_current_a, estimate.mean_current_a, throw.temperature_c,
       estimate.baseline_throws, estimate.baseline_needed, estimate.throws_since_baseline,
       monitor.drifts ->> '$[0].cause' AS cause_now,
       monitor.drifts ->> '$[0].change_pct' AS change_now_pct, monitor.drifts ->> '$[0].change_pct_sd' AS change_now_pct_sd,
       monitor.drifts ->> '$[0].direction' AS direction_now,
       monitor.drifts ->> '$[0].limit_in_throws.mid' AS limit_in_throws_now,
       monitor.drifts ->> '$[0].limit_in_throws.low' AS limit_in_throws_now_low,
       monitor.drifts ->> '$[0].limit_in_throws.high' AS limit_in_throws_now_high,
       coalesce(estimate.a1_per_b0, estimate.a1 / estimate.b0) AS a1_per_b0,
       coalesce(estimate.a0_per_b0, estimate.a0 / estimate.b0) AS a0_per_b0,
       100.0 * (coalesce(estimate.a1_per_b0, estimate.a1 / estimate.b0) * (
           SELECT payload ->> '$.center[0]' / payload ->> '$.center[1]' FROM (
               SELECT payload FROM baseline
               WHERE baseline.machine_row = estimate.machine_row AND baseline.direction = estimate.direction
                 AND baseline.taken_at_us <= latest.start_us
               ORDER BY baseline.taken_at_us DESC LIMIT 1)
           WHERE payload ->> 'throws' <= estimate.baseline_throws) - 1) AS a1_per_b0_pct,
       100.0 * (coalesce(estimate.a0_per_b0, estimate.a0 / estimate.b0) * (
           SELECT payload ->> '$.center[0]' / payload ->> '$.center[2]' FROM (
               SELECT payload FROM baseline
               WHERE baseline.machine_row = estimate.machine_row AND baseline.direction = estimate.direction
                 AND baseline.taken_at_us <= latest.start_us
               ORDER BY baseline.taken_at_us DESC LIMIT 1)
           WHERE payload ->> 'throws' <= estimate.baseline_throws) - 1) AS a0_per_b0_pct
FROM latest
JOIN machine ON machine.machine_row = latest.machine_row
JOIN estimate ON estimate.throw_row = latest.throw_row
JOIN throw ON throw.throw_row = latest.throw_row
LEFT JOIN monitor ON monitor.machine_row = latest.machine_row
WHERE latest.direction <> ''
   OR NOT EXISTS (SELECT 1 FROM latest AS known WHERE known.machine_row = latest.machine_row AND known.direction <> '');

-- The operator and the time of the acknowledgement of an alarm that was shelved, in maintenance or over at that time were
-- missing, or those of the next command. An event that has them has `acknowledged_by`; in events of earlier versions it is
-- the operator of a command without a reason.
DROP VIEW alarm_history;
CREATE VIEW alarm_history AS
SELECT alarm.alarm_id, machine.site, machine.machine, alarm.cause, last.severity, alarm.state,
       strftime('%Y-%m-%dT%H:%M:%S', (alarm.raised_at_us - (alarm.raised_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (alarm.raised_at_us % 1000000 + 1000000) % 1000000) AS raised_at,
       strftime('%Y-%m-%dT%H:%M:%S', (last.event_at_us - (last.event_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (last.event_at_us % 1000000 + 1000000) % 1000000) AS event_at,
       last.event_no, last.payload ->> 'direction' AS direction, last.payload ->> 'change_pct' AS change_pct,
       last.payload ->> 'change_pct_sd' AS change_pct_sd, last.payload ->> 'text' AS text,
       strftime('%Y-%m-%dT%H:%M:%S', (acknowledgement.event_at_us - (acknowledgement.event_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (acknowledgement.event_at_us % 1000000 + 1000000) % 1000000) AS acknowledged_at,
       coalesce(acknowledgement.payload ->> 'acknowledged_by', acknowledgement.payload ->> 'by') AS acknowledged_by,
       last.payload ->> 'channel' AS channel
FROM alarm
JOIN machine USING (machine_row)
JOIN alarm_event AS last ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no
LEFT JOIN alarm_event AS acknowledgement ON acknowledgement.alarm_row = alarm.alarm_row AND acknowledgement.event_no = (
    SELECT min(event.event_no) FROM alarm_event AS event
    WHERE event.alarm_row = alarm.alarm_row
      AND (event.payload ->> 'acknowledged_by' IS NOT NULL
           OR event.state IN ('active_acknowledged', 'normal') AND event.payload ->> 'by' IS NOT NULL
              AND event.payload ->> 'why' IS NULL));
