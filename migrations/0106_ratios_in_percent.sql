-- A machine with rough throws, which have only the ratios of the coefficients, had no change in percent in any view.

-- a1_per_b0_pct and a0_per_b0_pct: change of a ratio from the last baseline before the throw, with the effect of the
-- temperature. NULL while a new baseline is learned. The columns before them are as they were.
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
           WHERE payload ->> 'throws' <= estimate.baseline_throws) - 1) AS a1_per_b0_pct,
       100.0 * (coalesce(estimate.a0_per_b0, estimate.a0 / estimate.b0) * (
           SELECT payload ->> '$.center[0]' / payload ->> '$.center[2]' FROM (
               SELECT payload FROM baseline
               WHERE baseline.machine_row = estimate.machine_row AND baseline.direction = estimate.direction
                 AND baseline.taken_at_us <= throw.started_at_us
               ORDER BY baseline.taken_at_us DESC LIMIT 1)
           WHERE payload ->> 'throws' <= estimate.baseline_throws) - 1) AS a0_per_b0_pct
FROM estimate
JOIN throw USING (throw_row)
JOIN boot USING (boot_row)
JOIN machine ON machine.machine_row = throw.machine_row;

DROP VIEW machine_health;
CREATE VIEW machine_health AS
SELECT machine.site, machine.machine, latest.direction, coalesce(monitor.state, 'learning') AS state,
       strftime('%Y-%m-%dT%H:%M:%S', (latest.start_us - (latest.start_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (latest.start_us % 1000000 + 1000000) % 1000000) AS started_at,
       throw.throw_no, estimate.quality, estimate.b0, estimate.a1, estimate.a0,
       estimate.b0_sd, estimate.a1_sd, estimate.a0_sd, estimate.b0_pct, estimate.a1_pct, estimate.a0_pct,
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
WHERE latest.direction <> '';

-- With the temperature of the baseline, and how its coefficients change with it.
DROP VIEW baselines;
CREATE VIEW baselines AS
SELECT machine.site, machine.machine, baseline.direction,
       strftime('%Y-%m-%dT%H:%M:%S', (baseline.taken_at_us - (baseline.taken_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (baseline.taken_at_us % 1000000 + 1000000) % 1000000) AS taken_at,
       baseline.payload ->> 'throws' AS throws, baseline.payload ->> 'complete' AS complete,
       baseline.payload ->> '$.center[0]' AS b0, baseline.payload ->> '$.center[1]' AS a1,
       baseline.payload ->> '$.center[2]' AS a0,
       baseline.payload ->> 'ratios_only' AS ratios_only, baseline.payload ->> 'reference_c' AS temperature_c,
       baseline.payload ->> 'temperature_source' AS temperature_source,
       baseline.payload ->> '$.temperature_pct_per_k[0]' AS b0_pct_per_k,
       baseline.payload ->> '$.temperature_pct_per_k[1]' AS a1_pct_per_k,
       baseline.payload ->> '$.temperature_pct_per_k[2]' AS a0_pct_per_k
FROM baseline
JOIN machine USING (machine_row);
