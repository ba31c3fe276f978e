-- What people query. These columns are a promise: columns may be added at the end, never renamed or removed.
-- Times are RFC 3339 UTC text with microseconds, which strftime and julianday understand. The remainder is taken
-- twice so that times before 1970 come out right too.

CREATE VIEW health_history AS
SELECT machine.site, machine.machine,
       strftime('%Y-%m-%dT%H:%M:%S', (throw.started_at_us - (throw.started_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (throw.started_at_us % 1000000 + 1000000) % 1000000) AS started_at,
       coalesce(estimate.direction, throw.direction, 'unknown') AS direction, throw.throw_no, estimate.quality,
       estimate.b0, estimate.a1, estimate.a0, estimate.b0_sd, estimate.a1_sd, estimate.a0_sd,
       estimate.b0_pct, estimate.a1_pct, estimate.a0_pct, estimate.fit_pct,
       estimate.duration_s, estimate.peak_current_a, estimate.mean_current_a, throw.temperature_c,
       boot.boot_id
FROM estimate
JOIN throw USING (throw_row)
JOIN boot USING (boot_row)
JOIN machine ON machine.machine_row = throw.machine_row;

CREATE VIEW alarm_history AS
SELECT alarm.alarm_id, machine.site, machine.machine, alarm.cause, last.severity, alarm.state,
       strftime('%Y-%m-%dT%H:%M:%S', (alarm.raised_at_us - (alarm.raised_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (alarm.raised_at_us % 1000000 + 1000000) % 1000000) AS raised_at,
       strftime('%Y-%m-%dT%H:%M:%S', (last.event_at_us - (last.event_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (last.event_at_us % 1000000 + 1000000) % 1000000) AS event_at,
       last.event_no, last.direction, last.change_pct, last.change_pct_sd, last.text,
       (SELECT strftime('%Y-%m-%dT%H:%M:%S', (event.event_at_us - (event.event_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (event.event_at_us % 1000000 + 1000000) % 1000000) FROM alarm_event AS event
         WHERE event.alarm_row = alarm.alarm_row AND event.state = 'active_acknowledged' AND event.by_whom IS NOT NULL
         ORDER BY event.event_no LIMIT 1) AS acknowledged_at,
       (SELECT event.by_whom FROM alarm_event AS event
         WHERE event.alarm_row = alarm.alarm_row AND event.state = 'active_acknowledged' AND event.by_whom IS NOT NULL
         ORDER BY event.event_no LIMIT 1) AS acknowledged_by
FROM alarm
JOIN machine USING (machine_row)
JOIN alarm_event AS last ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no;

CREATE VIEW active_alarms AS
SELECT * FROM alarm_history WHERE state <> 'normal';

CREATE VIEW alarm_events AS
SELECT alarm.alarm_id, event.event_no, machine.site, machine.machine, alarm.cause, event.severity, event.state,
       strftime('%Y-%m-%dT%H:%M:%S', (alarm.raised_at_us - (alarm.raised_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (alarm.raised_at_us % 1000000 + 1000000) % 1000000) AS raised_at,
       strftime('%Y-%m-%dT%H:%M:%S', (event.event_at_us - (event.event_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (event.event_at_us % 1000000 + 1000000) % 1000000) AS event_at,
       event.change_pct, event.change_pct_sd, event.direction, event.runner_up_cause, event.runner_up_margin,
       event.b0_a1, event.b0_a0, event.a1_a0, event.first_boot_id, event.first_throw_no, event.last_boot_id,
       event.last_throw_no, event.limit_low, event.limit_mid, event.limit_high, event.text, event.by_whom, event.why
FROM alarm_event AS event
JOIN alarm USING (alarm_row)
JOIN machine USING (machine_row);

-- One row a machine and direction: the latest throw, and how the machine stands.
CREATE VIEW machine_health AS
SELECT machine.site, machine.machine, way.direction,
       coalesce((SELECT CASE max(last.severity = 'critical') WHEN 1 THEN 'critical' WHEN 0 THEN 'warning' END
                   FROM alarm JOIN alarm_event AS last
                     ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no
                  WHERE alarm.machine_row = machine.machine_row AND alarm.state <> 'normal'),
                CASE WHEN estimate.throws_since_baseline = 0 THEN 'learning' ELSE 'normal' END) AS state,
       strftime('%Y-%m-%dT%H:%M:%S', (throw.started_at_us - (throw.started_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (throw.started_at_us % 1000000 + 1000000) % 1000000) AS started_at,
       throw.throw_no, estimate.quality, estimate.b0, estimate.a1, estimate.a0,
       estimate.b0_sd, estimate.a1_sd, estimate.a0_sd, estimate.b0_pct, estimate.a1_pct, estimate.a0_pct,
       estimate.fit_pct, estimate.duration_s, estimate.peak_current_a, estimate.mean_current_a, throw.temperature_c,
       estimate.baseline_throws, estimate.baseline_needed, estimate.throws_since_baseline
FROM machine
CROSS JOIN (SELECT 'normal_to_reverse' AS direction UNION ALL SELECT 'reverse_to_normal') AS way
JOIN estimate ON estimate.throw_row = (SELECT max(latest.throw_row) FROM estimate AS latest
                                        WHERE latest.machine_row = machine.machine_row
                                          AND latest.direction = way.direction)
JOIN throw USING (throw_row);

CREATE VIEW data_gaps AS
SELECT machine.site, machine.machine, boot.boot_id, gap.first_no AS first_throw_no, gap.last_no AS last_throw_no,
       CASE WHEN gap.filled_at_us IS NULL THEN gap.last_no - gap.first_no + 1 ELSE 0 END AS missing_throws,
       gap.recovered AS recovered_throws, gap.kind,
       strftime('%Y-%m-%dT%H:%M:%S', (gap.detected_at_us - (gap.detected_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (gap.detected_at_us % 1000000 + 1000000) % 1000000) AS detected_at,
       strftime('%Y-%m-%dT%H:%M:%S', (gap.filled_at_us - (gap.filled_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (gap.filled_at_us % 1000000 + 1000000) % 1000000) AS filled_at
FROM gap
JOIN boot USING (boot_row)
JOIN machine USING (machine_row);

CREATE VIEW throws_not_evaluated AS
SELECT machine.site, machine.machine,
       strftime('%Y-%m-%dT%H:%M:%S', (throw.started_at_us - (throw.started_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (throw.started_at_us % 1000000 + 1000000) % 1000000) AS started_at,
       coalesce(estimate.direction, throw.direction, 'unknown') AS direction, throw.throw_no,
       estimate.quality, estimate.detail, boot.boot_id,
       strftime('%Y-%m-%dT%H:%M:%S', (throw.received_at_us - (throw.received_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (throw.received_at_us % 1000000 + 1000000) % 1000000) AS received_at
FROM estimate
JOIN throw USING (throw_row)
JOIN boot USING (boot_row)
JOIN machine ON machine.machine_row = throw.machine_row
WHERE estimate.quality <> 'good';
