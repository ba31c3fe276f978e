-- A gap of refused messages, as of a logger that writes a wrong field, looked like one of a bad link.

-- Boot and number of the throw in the message; both NULL if they cannot be read.
ALTER TABLE quarantine ADD COLUMN boot_id TEXT;
ALTER TABLE quarantine ADD COLUMN throw_no INTEGER;
CREATE INDEX quarantine_by_key ON quarantine (key);

-- Throws of the gap whose messages were in quarantine when the gap was reported.
ALTER TABLE gap ADD COLUMN refused INTEGER NOT NULL DEFAULT 0;

DROP VIEW quarantined_messages;
CREATE VIEW quarantined_messages AS
SELECT strftime('%Y-%m-%dT%H:%M:%S', received_at_us / 1000000, 'unixepoch') || printf('.%06dZ', received_at_us % 1000000) AS received_at,
       key, reason, payload_bytes, boot_id, throw_no
FROM quarantine;

-- The numbers from first_throw_no to last_throw_no are still missing. recovered_throws arrived later, and are in this
-- range no more.
DROP VIEW data_gaps;
CREATE VIEW data_gaps AS
SELECT machine.site, machine.machine, boot.boot_id, gap.first_no AS first_throw_no, gap.last_no AS last_throw_no,
       CASE WHEN gap.filled_at_us IS NULL THEN min(gap.last_no - gap.first_no + 1, 1099511627776) ELSE 0 END AS missing_throws,
       gap.recovered AS recovered_throws, gap.kind,
       strftime('%Y-%m-%dT%H:%M:%S', (gap.detected_at_us - (gap.detected_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (gap.detected_at_us % 1000000 + 1000000) % 1000000) AS detected_at,
       strftime('%Y-%m-%dT%H:%M:%S', (gap.filled_at_us - (gap.filled_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (gap.filled_at_us % 1000000 + 1000000) % 1000000) AS filled_at,
       CASE WHEN gap.filled_at_us IS NULL THEN min(gap.refused, gap.last_no - gap.first_no + 1) ELSE 0 END AS refused_throws
FROM gap
JOIN boot USING (boot_row)
JOIN machine USING (machine_row)
-- Gaps that the backlog cannot fill, that were filled, or that the machine was judged without.
WHERE gap.written_off_at_us IS NOT NULL OR gap.filled_at_us IS NOT NULL OR gap.told_at_us IS NOT NULL;
