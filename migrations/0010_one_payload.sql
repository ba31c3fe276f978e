-- An alarm event is stored once, as JSON with all of its evidence, with the columns that identify it. Columns that repeat
-- the JSON of an alarm event or of a baseline are dropped. The views keep their columns.
--
-- The state of a machine and its present drifts are stored with its monitor, as the one source for SQL, pages and messages.
--
-- A program that writes the old columns must not use this database, and the user_version prevents this.
PRAGMA user_version = 10;

DROP VIEW active_alarms;
DROP VIEW alarm_history;
DROP VIEW alarm_events;
DROP VIEW machine_health;

-- The old JSON was the message, which has neither operators nor boot ids.
UPDATE alarm_event SET payload = json_patch(payload, json_object(
    'first_boot_id', first_boot_id, 'last_boot_id', last_boot_id, 'by', by_whom, 'why', why));

ALTER TABLE alarm_event DROP COLUMN change_pct;
ALTER TABLE alarm_event DROP COLUMN change_pct_sd;
ALTER TABLE alarm_event DROP COLUMN direction;
ALTER TABLE alarm_event DROP COLUMN runner_up_cause;
ALTER TABLE alarm_event DROP COLUMN runner_up_margin;
ALTER TABLE alarm_event DROP COLUMN b0_a1;
ALTER TABLE alarm_event DROP COLUMN b0_a0;
ALTER TABLE alarm_event DROP COLUMN a1_a0;
ALTER TABLE alarm_event DROP COLUMN first_boot_id;
ALTER TABLE alarm_event DROP COLUMN first_throw_no;
ALTER TABLE alarm_event DROP COLUMN last_boot_id;
ALTER TABLE alarm_event DROP COLUMN last_throw_no;
ALTER TABLE alarm_event DROP COLUMN limit_low;
ALTER TABLE alarm_event DROP COLUMN limit_mid;
ALTER TABLE alarm_event DROP COLUMN limit_high;
ALTER TABLE alarm_event DROP COLUMN text;
ALTER TABLE alarm_event DROP COLUMN by_whom;
ALTER TABLE alarm_event DROP COLUMN why;

ALTER TABLE baseline DROP COLUMN throws;
ALTER TABLE baseline DROP COLUMN b0;
ALTER TABLE baseline DROP COLUMN a1;
ALTER TABLE baseline DROP COLUMN a0;
ALTER TABLE baseline DROP COLUMN by_whom;
ALTER TABLE baseline DROP COLUMN why;
ALTER TABLE baseline RENAME COLUMN details TO payload; -- JSON

ALTER TABLE monitor ADD COLUMN state TEXT;   -- state of the machine; NULL: not written since this migration
ALTER TABLE monitor ADD COLUMN drifts TEXT;  -- JSON: its present drifts, the worst first; NULL: none
ALTER TABLE estimate ADD COLUMN state TEXT;  -- of the machine after this throw
ALTER TABLE estimate ADD COLUMN drift TEXT;  -- JSON: its worst drift after this throw; NULL: none

-- New features of the estimator.
ALTER TABLE estimate ADD COLUMN release_s REAL;             -- from the motor's start until the toe moves
ALTER TABLE estimate ADD COLUMN running_current_a REAL;     -- median of the second half of the motor's time
ALTER TABLE estimate ADD COLUMN energy_j REAL;
ALTER TABLE estimate ADD COLUMN quiet_current_a REAL;       -- offset of the current sensor
ALTER TABLE estimate ADD COLUMN start_position_mm REAL;
ALTER TABLE estimate ADD COLUMN resistance_ohm REAL;        -- of armature and leads
ALTER TABLE estimate ADD COLUMN back_emf_v_s_per_rad REAL;

CREATE VIEW alarm_history AS
SELECT alarm.alarm_id, machine.site, machine.machine, alarm.cause, last.severity, alarm.state,
       strftime('%Y-%m-%dT%H:%M:%S', (alarm.raised_at_us - (alarm.raised_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (alarm.raised_at_us % 1000000 + 1000000) % 1000000) AS raised_at,
       strftime('%Y-%m-%dT%H:%M:%S', (last.event_at_us - (last.event_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (last.event_at_us % 1000000 + 1000000) % 1000000) AS event_at,
       last.event_no, last.payload ->> 'direction' AS direction, last.payload ->> 'change_pct' AS change_pct,
       last.payload ->> 'change_pct_sd' AS change_pct_sd, last.payload ->> 'text' AS text,
       (SELECT strftime('%Y-%m-%dT%H:%M:%S', (event.event_at_us - (event.event_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (event.event_at_us % 1000000 + 1000000) % 1000000) FROM alarm_event AS event
         WHERE event.alarm_row = alarm.alarm_row AND event.state = 'active_acknowledged' AND event.payload ->> 'by' IS NOT NULL
         ORDER BY event.event_no LIMIT 1) AS acknowledged_at,
       (SELECT event.payload ->> 'by' FROM alarm_event AS event
         WHERE event.alarm_row = alarm.alarm_row AND event.state = 'active_acknowledged' AND event.payload ->> 'by' IS NOT NULL
         ORDER BY event.event_no LIMIT 1) AS acknowledged_by
FROM alarm
JOIN machine USING (machine_row)
JOIN alarm_event AS last ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no;

-- The values of the last event, and the present values (`…_now`).
CREATE VIEW active_alarms AS
SELECT alarm_history.*,
       drift.value ->> 'change_pct' AS change_now_pct, drift.value ->> 'change_pct_sd' AS change_now_pct_sd,
       drift.value ->> 'direction' AS direction_now,
       drift.value -> 'limit_in_throws' ->> 'mid' AS limit_in_throws_now,
       drift.value -> 'limit_in_throws' ->> 'low' AS limit_in_throws_now_low,
       drift.value -> 'limit_in_throws' ->> 'high' AS limit_in_throws_now_high
FROM alarm_history
JOIN machine ON machine.site = alarm_history.site AND machine.machine = alarm_history.machine
LEFT JOIN monitor USING (machine_row)
LEFT JOIN json_each(monitor.drifts) AS drift ON drift.value ->> 'cause' = alarm_history.cause
WHERE alarm_history.state <> 'normal';

CREATE VIEW alarm_events AS
SELECT alarm.alarm_id, event.event_no, machine.site, machine.machine, alarm.cause, event.severity, event.state,
       strftime('%Y-%m-%dT%H:%M:%S', (alarm.raised_at_us - (alarm.raised_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (alarm.raised_at_us % 1000000 + 1000000) % 1000000) AS raised_at,
       strftime('%Y-%m-%dT%H:%M:%S', (event.event_at_us - (event.event_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (event.event_at_us % 1000000 + 1000000) % 1000000) AS event_at,
       event.payload ->> 'change_pct' AS change_pct, event.payload ->> 'change_pct_sd' AS change_pct_sd,
       event.payload ->> 'direction' AS direction,
       event.payload -> 'runner_up' ->> 'cause' AS runner_up_cause,
       event.payload -> 'runner_up' ->> 'margin' AS runner_up_margin,
       event.payload -> 'correlation' ->> 'b0_a1' AS b0_a1, event.payload -> 'correlation' ->> 'b0_a0' AS b0_a0,
       event.payload -> 'correlation' ->> 'a1_a0' AS a1_a0,
       event.payload ->> 'first_boot_id' AS first_boot_id, event.payload ->> 'first_throw_no' AS first_throw_no,
       event.payload ->> 'last_boot_id' AS last_boot_id, event.payload ->> 'last_throw_no' AS last_throw_no,
       event.payload -> 'limit_in_throws' ->> 'low' AS limit_low,
       event.payload -> 'limit_in_throws' ->> 'mid' AS limit_mid,
       event.payload -> 'limit_in_throws' ->> 'high' AS limit_high,
       event.payload ->> 'text' AS text, event.payload ->> 'by' AS by_whom, event.payload ->> 'why' AS why
FROM alarm_event AS event
JOIN alarm USING (alarm_row)
JOIN machine USING (machine_row);

-- One row for each machine and direction: the latest throw, and the present state and worst drift of the machine.
CREATE VIEW machine_health AS
SELECT machine.site, machine.machine, way.direction, coalesce(monitor.state, 'learning') AS state,
       strftime('%Y-%m-%dT%H:%M:%S', (throw.started_at_us - (throw.started_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (throw.started_at_us % 1000000 + 1000000) % 1000000) AS started_at,
       throw.throw_no, estimate.quality, estimate.b0, estimate.a1, estimate.a0,
       estimate.b0_sd, estimate.a1_sd, estimate.a0_sd, estimate.b0_pct, estimate.a1_pct, estimate.a0_pct,
       estimate.fit_pct, estimate.duration_s, estimate.peak_current_a, estimate.mean_current_a, throw.temperature_c,
       estimate.baseline_throws, estimate.baseline_needed, estimate.throws_since_baseline,
       monitor.drifts ->> '$[0].cause' AS cause_now,
       monitor.drifts ->> '$[0].change_pct' AS change_now_pct, monitor.drifts ->> '$[0].change_pct_sd' AS change_now_pct_sd,
       monitor.drifts ->> '$[0].direction' AS direction_now,
       monitor.drifts ->> '$[0].limit_in_throws.mid' AS limit_in_throws_now,
       monitor.drifts ->> '$[0].limit_in_throws.low' AS limit_in_throws_now_low,
       monitor.drifts ->> '$[0].limit_in_throws.high' AS limit_in_throws_now_high
FROM machine
CROSS JOIN (SELECT 'normal_to_reverse' AS direction UNION ALL SELECT 'reverse_to_normal') AS way
JOIN estimate ON estimate.throw_row = (SELECT max(latest.throw_row) FROM estimate AS latest
                                        WHERE latest.machine_row = machine.machine_row
                                          AND latest.direction = way.direction)
JOIN throw USING (throw_row)
LEFT JOIN monitor ON monitor.machine_row = machine.machine_row;
