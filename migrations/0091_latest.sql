-- The latest judged throw of each machine and direction, updated with each estimate. With 20,000 machines and a million
-- throws, the newest rows of machine_health took 173 ms to find without this table.
--
-- Retention deletes the oldest throws of a machine, so a row here is deleted only with the last throw of its direction.
CREATE TABLE latest (
    machine_row   INTEGER NOT NULL REFERENCES machine,
    direction     TEXT    NOT NULL,            -- as it moved; '' for unknown
    throw_row     INTEGER NOT NULL UNIQUE REFERENCES throw ON DELETE CASCADE,
    start_us      INTEGER NOT NULL,            -- its started_at_us
    PRIMARY KEY (machine_row, direction)
) STRICT, WITHOUT ROWID;

INSERT INTO latest (machine_row, direction, throw_row, start_us)
SELECT newest.machine_row, newest.direction, throw_row, started_at_us
FROM (SELECT machine_row, coalesce(direction, '') AS direction, max(throw_row) AS throw_row FROM estimate
      GROUP BY machine_row, estimate.direction) AS newest
JOIN throw USING (throw_row);

-- `started_at` of the view is this expression.
CREATE INDEX latest_by_start ON latest (
    strftime('%Y-%m-%dT%H:%M:%S', (start_us - (start_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (start_us % 1000000 + 1000000) % 1000000)
);

CREATE TRIGGER estimate_added AFTER INSERT ON estimate BEGIN
    INSERT INTO latest (machine_row, direction, throw_row, start_us)
        SELECT NEW.machine_row, coalesce(NEW.direction, ''), throw_row, started_at_us FROM throw WHERE throw_row = NEW.throw_row
        ON CONFLICT (machine_row, direction) DO UPDATE SET throw_row = excluded.throw_row, start_us = excluded.start_us
        WHERE excluded.throw_row > latest.throw_row;
END;

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
       monitor.drifts ->> '$[0].limit_in_throws.high' AS limit_in_throws_now_high
FROM latest
JOIN machine ON machine.machine_row = latest.machine_row
JOIN estimate ON estimate.throw_row = latest.throw_row
JOIN throw ON throw.throw_row = latest.throw_row
LEFT JOIN monitor ON monitor.machine_row = latest.machine_row
WHERE latest.direction <> '';
