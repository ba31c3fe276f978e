-- The views of alarms show the channel of an alarm about a sensor: current, position, clock or temperature. It is in the JSON
-- of the event; NULL for other causes. The column is the last one, so that the columns before it keep their places.
DROP VIEW active_alarms;
DROP VIEW alarm_history;
DROP VIEW alarm_events;

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
         ORDER BY event.event_no LIMIT 1) AS acknowledged_by,
       last.payload ->> 'channel' AS channel
FROM alarm
JOIN machine USING (machine_row)
JOIN alarm_event AS last ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no;

-- The values of the last event, and the present values (`…_now`).
CREATE VIEW active_alarms AS
SELECT alarm_id, alarm_history.site, alarm_history.machine, cause, severity, alarm_history.state, raised_at, event_at,
       event_no, direction, change_pct, change_pct_sd, text, acknowledged_at, acknowledged_by,
       drift.value ->> 'change_pct' AS change_now_pct, drift.value ->> 'change_pct_sd' AS change_now_pct_sd,
       drift.value ->> 'direction' AS direction_now,
       drift.value -> 'limit_in_throws' ->> 'mid' AS limit_in_throws_now,
       drift.value -> 'limit_in_throws' ->> 'low' AS limit_in_throws_now_low,
       drift.value -> 'limit_in_throws' ->> 'high' AS limit_in_throws_now_high,
       channel
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
       event.payload ->> 'text' AS text, event.payload ->> 'by' AS by_whom, event.payload ->> 'why' AS why,
       event.payload ->> 'channel' AS channel
FROM alarm_event AS event
JOIN alarm USING (alarm_row)
JOIN machine USING (machine_row);
