-- machine_health: if a sensor died after throws of known directions, its rejected throws were missing, so the view showed
-- only the last good ones. Now a throw of unknown direction is left out after a later throw of a known direction, as in
-- the messages Health and in `pointsd status`.
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
   OR NOT EXISTS (SELECT 1 FROM latest AS later
                  WHERE later.machine_row = latest.machine_row AND later.direction <> '' AND later.start_us > latest.start_us);
