-- Views of the baselines and of the quarantined messages; indexes for the newest throws of the fleet and for its state.

CREATE INDEX throw_by_start ON throw (started_at_us);
-- The state of every machine without its monitor, which has some kilobytes.
CREATE INDEX monitor_state ON monitor (machine_row, state, drifts);

CREATE VIEW baselines AS
SELECT machine.site, machine.machine, baseline.direction,
       strftime('%Y-%m-%dT%H:%M:%S', (baseline.taken_at_us - (baseline.taken_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (baseline.taken_at_us % 1000000 + 1000000) % 1000000) AS taken_at,
       baseline.payload ->> 'throws' AS throws, baseline.payload ->> 'complete' AS complete,
       baseline.payload ->> '$.center[0]' AS b0, baseline.payload ->> '$.center[1]' AS a1,
       baseline.payload ->> '$.center[2]' AS a0
FROM baseline
JOIN machine USING (machine_row);

CREATE VIEW quarantined_messages AS
SELECT strftime('%Y-%m-%dT%H:%M:%S', received_at_us / 1000000, 'unixepoch') || printf('.%06dZ', received_at_us % 1000000) AS received_at,
       key, reason, payload_bytes
FROM quarantine;
