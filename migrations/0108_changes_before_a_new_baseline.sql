-- After the command `rebaseline` the last throw before it in each direction lost a1_per_b0_pct and a0_per_b0_pct in
-- health_history: the command sets its baseline_throws to 0, by which the view finds the baseline of the throw.

-- baseline_throws before a new baseline began; NULL if none began after the throw and before the next one of its direction.
ALTER TABLE estimate ADD COLUMN baseline_before INTEGER;

-- a1_per_b0_pct and a0_per_b0_pct: change of a ratio from the last baseline before the throw, with the effect of the
-- temperature. NULL while a new baseline is learned.
DROP VIEW health_history;
CREATE VIEW health_history AS
SELECT machine.site, machine.machine,
       strftime('%Y-%m-%dT%H:%M:%S', (throw.started_at_us - (throw.started_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (throw.started_at_us % 1000000 + 1000000) % 1000000) AS started_at,
       coalesce(estimate.direction, throw.direction, 'unknown') AS direction, throw.throw_no, estimate.quality,
       estimate.b0, estimate.a1, estimate.a0, estimate.b0_sd, estimate.a1_sd, estimate.a0_sd,
       estimate.b0_pct, estimate.a1_pct, estimate.a0_pct, estimate.fit_pct,
       estimate.duration_s, estimate.peak_current_a, estimate.mean_current_a, throw.temperature_c,
       boot.boot_id,
       estimate.a1_per_b0, estimate.a1_per_b0_sd, estimate.a0_per_b0, estimate.a0_per_b0_sd,
       throw.started_at_us,
       100.0 * (coalesce(estimate.a1_per_b0, estimate.a1 / estimate.b0) * (
           SELECT payload ->> '$.center[0]' / payload ->> '$.center[1]' FROM (
               SELECT payload FROM baseline
               WHERE baseline.machine_row = estimate.machine_row AND baseline.direction = estimate.direction
                 AND baseline.taken_at_us <= throw.started_at_us
               ORDER BY baseline.taken_at_us DESC LIMIT 1)
           WHERE payload ->> 'throws' <= coalesce(estimate.baseline_before, estimate.baseline_throws)) - 1) AS a1_per_b0_pct,
       100.0 * (coalesce(estimate.a0_per_b0, estimate.a0 / estimate.b0) * (
           SELECT payload ->> '$.center[0]' / payload ->> '$.center[2]' FROM (
               SELECT payload FROM baseline
               WHERE baseline.machine_row = estimate.machine_row AND baseline.direction = estimate.direction
                 AND baseline.taken_at_us <= throw.started_at_us
               ORDER BY baseline.taken_at_us DESC LIMIT 1)
           WHERE payload ->> 'throws' <= coalesce(estimate.baseline_before, estimate.baseline_throws)) - 1) AS a0_per_b0_pct
FROM estimate
JOIN throw USING (throw_row)
JOIN boot USING (boot_row)
JOIN machine ON machine.machine_row = throw.machine_row;
