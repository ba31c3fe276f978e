-- Throws that may still be in the backlog of the logger are not a gap yet. A jump of the throw number can make gaps with a
-- sum beyond 64 bits, so each counts as 2^40 at most.
DROP VIEW data_gaps;

CREATE VIEW data_gaps AS
SELECT machine.site, machine.machine, boot.boot_id, gap.first_no AS first_throw_no, gap.last_no AS last_throw_no,
       CASE WHEN gap.filled_at_us IS NULL THEN min(gap.last_no - gap.first_no + 1, 1099511627776) ELSE 0 END AS missing_throws,
       gap.recovered AS recovered_throws, gap.kind,
       strftime('%Y-%m-%dT%H:%M:%S', (gap.detected_at_us - (gap.detected_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (gap.detected_at_us % 1000000 + 1000000) % 1000000) AS detected_at,
       strftime('%Y-%m-%dT%H:%M:%S', (gap.filled_at_us - (gap.filled_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (gap.filled_at_us % 1000000 + 1000000) % 1000000) AS filled_at
FROM gap
JOIN boot USING (boot_row)
JOIN machine USING (machine_row)
-- Gaps that the backlog cannot fill, that were filled, or that the machine was judged without.
WHERE gap.written_off_at_us IS NOT NULL OR gap.filled_at_us IS NOT NULL OR gap.told_at_us IS NOT NULL;
