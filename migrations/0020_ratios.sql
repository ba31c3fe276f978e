-- If the start of a throw is not usable, only the ratios of b0, a1 and a0 can be identified: b0, a1 and a0 are NULL, and
-- quality is 'rough'. Such throws are evaluated.
ALTER TABLE estimate ADD COLUMN a1_per_b0    REAL;   -- Kf / KT [A s rad^-1]
ALTER TABLE estimate ADD COLUMN a1_per_b0_sd REAL;   -- its standard deviation
ALTER TABLE estimate ADD COLUMN a0_per_b0    REAL;   -- Kspr / KT [A rad^-1]
ALTER TABLE estimate ADD COLUMN a0_per_b0_sd REAL;   -- its standard deviation

DROP VIEW health_history;
CREATE VIEW health_history AS
SELECT machine.site, machine.machine,
       strftime('%Y-%m-%dT%H:%M:%S', (throw.started_at_us - (throw.started_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (throw.started_at_us % 1000000 + 1000000) % 1000000) AS started_at,
       coalesce(estimate.direction, throw.direction, 'unknown') AS direction, throw.throw_no, estimate.quality,
       estimate.b0, estimate.a1, estimate.a0, estimate.b0_sd, estimate.a1_sd, estimate.a0_sd,
       estimate.b0_pct, estimate.a1_pct, estimate.a0_pct, estimate.fit_pct,
       estimate.duration_s, estimate.peak_current_a, estimate.mean_current_a, throw.temperature_c,
       boot.boot_id,
       estimate.a1_per_b0, estimate.a1_per_b0_sd, estimate.a0_per_b0, estimate.a0_per_b0_sd
FROM estimate
JOIN throw USING (throw_row)
JOIN boot USING (boot_row)
JOIN machine ON machine.machine_row = throw.machine_row;

DROP VIEW throws_not_evaluated;
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
WHERE estimate.quality NOT IN ('good', 'rough', 'current_only');
