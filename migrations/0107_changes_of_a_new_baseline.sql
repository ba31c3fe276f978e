-- After the command `rebaseline` machine_health had the changes from the old baseline until the next throw in each direction,
-- beside the state `learning`. The command sets baseline_throws of the latest throws to 0; their own changes stay in
-- health_history.

-- b0_pct, a1_pct, a0_pct: NULL until the first throw after a new baseline began, as a1_per_b0_pct and a0_per_b0_pct are.
DROP VIEW machine_health;
CREATE VIEW machine_health AS
SELECT machine.site, machine.machine, latest.direction, coalesce(monitor.state, 'learning') AS state,
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
WHERE latest.direction <> '';
