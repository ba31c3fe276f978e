-- Twelve example queries for the database of pointsd. Run one with
--   pointsd sql "$(sed -n '/^-- 1\./,/^$/p' deploy/questions.sql)"
-- after you have replaced the site north and the machine m1 by yours: without it their answers are empty.
-- A test runs each of them and prints its duration.

-- 1. Which machines had the most alarms in the last 30 days?
SELECT site, machine, count(*) AS alarms, sum(severity = 'critical') AS critical, max(raised_at) AS last_raised
FROM alarm_history WHERE raised_at >= strftime('%Y-%m-%d', 'now', '-30 days')
GROUP BY site, machine ORDER BY critical DESC, alarms DESC LIMIT 20;

-- 2. How fast do the motor, friction and stiffness of a machine drift? [% per 100 throws, over its last 200 throws to
--    reverse; friction and stiffness per torque of the motor, which rough throws have too; b0 in the good ones]
WITH last AS (
    SELECT row_number() OVER (ORDER BY started_at_us DESC) AS n, b0,
           coalesce(a1_per_b0, a1 / b0) AS friction, coalesce(a0_per_b0, a0 / b0) AS stiffness FROM health_history
    WHERE site = 'north' AND machine = 'm1' AND direction = 'normal_to_reverse' AND quality IN ('good', 'rough')
    ORDER BY started_at_us DESC LIMIT 200),
mean AS (SELECT avg(n) AS n, avg(iif(b0 IS NULL, NULL, n)) AS n_good, avg(b0) AS b0, avg(friction) AS friction,
                avg(stiffness) AS stiffness, count(*) AS throws, count(b0) AS good FROM last)
SELECT mean.throws, mean.good,
       -1e4 / mean.b0 * sum((last.n - n_good) * last.b0)
           / sum(iif(last.b0 IS NULL, NULL, (last.n - n_good) * (last.n - n_good))) AS b0_per_100,
       -1e4 / mean.friction * sum((last.n - mean.n) * last.friction)
           / sum((last.n - mean.n) * (last.n - mean.n)) AS friction_per_100,
       -1e4 / mean.stiffness * sum((last.n - mean.n) * last.stiffness)
           / sum((last.n - mean.n) * (last.n - mean.n)) AS stiffness_per_100
FROM last, mean;

-- 3. What did the last maintenance of a machine change? [mean of 100 throws before and after; many rough throws have only
--    the ratios of the coefficients. It ends by a command, or at its time]
WITH visit AS (
    SELECT unixepoch(start.carried_out_at) * 1000000 AS from_us,
           unixepoch(coalesce(min(start.until, (
               SELECT min(carried_out_at) FROM operator_commands
               WHERE site = 'north' AND machine = 'm1' AND command = 'maintenance_end'
                 AND carried_out_at > start.carried_out_at)), start.until)) * 1000000 AS to_us
    FROM operator_commands AS start
    WHERE site = 'north' AND machine = 'm1' AND command = 'maintenance_start'
    ORDER BY carried_out_at DESC LIMIT 1),
usable AS NOT MATERIALIZED (
    SELECT *, coalesce(a1_per_b0, a1 / b0) AS friction, coalesce(a0_per_b0, a0 / b0) AS stiffness FROM health_history
    WHERE site = 'north' AND machine = 'm1' AND quality IN ('good', 'rough')),
near AS (
    SELECT * FROM (SELECT 'before' AS side, b0, a1, a0, friction, stiffness FROM usable
                   WHERE started_at_us < (SELECT from_us FROM visit) ORDER BY started_at_us DESC LIMIT 100)
    UNION ALL
    SELECT * FROM (SELECT 'after', b0, a1, a0, friction, stiffness FROM usable
                   WHERE started_at_us >= (SELECT to_us FROM visit) ORDER BY started_at_us LIMIT 100))
SELECT side, count(*) AS throws, count(b0) AS good, avg(b0) AS b0, avg(a1) AS a1, avg(a0) AS a0,
       avg(friction) AS a1_per_b0, avg(stiffness) AS a0_per_b0
FROM near GROUP BY side;

-- 4. How did the friction of a machine follow the temperature in the last year? [by 5 K; a1 itself, as the effect of the
--    temperature is taken out of a1_pct]
SELECT 5 * cast(round(temperature_c / 5) AS INTEGER) AS about_c, count(*) AS throws, avg(a1) AS a1,
       avg(coalesce(a1_per_b0, a1 / b0)) AS a1_per_b0
FROM health_history WHERE site = 'north' AND machine = 'm1' AND quality IN ('good', 'rough') AND temperature_c IS NOT NULL
  AND started_at_us >= (unixepoch('now') - 365 * 86400) * 1000000
GROUP BY about_c ORDER BY about_c;

-- 5. Why were throws rejected, and on how many machines?
SELECT quality, count(*) AS throws, count(DISTINCT site || '/' || machine) AS machines, max(started_at) AS last
FROM throws_not_evaluated GROUP BY quality ORDER BY throws DESC;

-- 6. How many alarms were raised a day? [ISA-18.2: an operator handles about 150 a day]
SELECT date(event_at) AS day, count(*) AS raised, sum(severity = 'critical') AS critical, count(DISTINCT site || '/' || machine) AS machines
FROM alarm_events WHERE event_no = 1 GROUP BY day ORDER BY day DESC LIMIT 30;

-- 7. How long did alarms wait for somebody who acknowledged them? [h]
SELECT cause, count(*) AS alarms, count(acknowledged_at) AS acknowledged,
       24 * avg(julianday(acknowledged_at) - julianday(raised_at)) AS mean_hours,
       24 * max(julianday(acknowledged_at) - julianday(raised_at)) AS longest_hours
FROM alarm_history GROUP BY cause ORDER BY alarms DESC;

-- 8. Which alarms stand (open for a week) or chatter (raised three times within a day)?
SELECT 'standing' AS kind, site, machine, cause, raised_at, NULL AS times FROM active_alarms
WHERE julianday('now') - julianday(raised_at) > 7 AND state NOT LIKE 'cleared%'
UNION ALL
SELECT 'chattering', site, machine, cause, max(raised_at), count(*) FROM alarm_history
GROUP BY site, machine, cause, date(raised_at) HAVING count(*) >= 3
ORDER BY kind, raised_at DESC LIMIT 50;

-- 9. Which baselines are old, or were taken from few throws?
SELECT site, machine, direction, max(taken_at) AS taken_at, throws,
       cast(julianday('now') - julianday(max(taken_at)) AS INTEGER) AS days
FROM baselines GROUP BY site, machine, direction HAVING days > 365 OR throws < 50 ORDER BY days DESC LIMIT 50;

-- 10. On which machines do the two directions disagree? [last throw, % points of friction; of a rough throw per torque of
--     the motor]
SELECT one.site, one.machine, coalesce(one.a1_pct, one.a1_per_b0_pct) AS to_reverse,
       coalesce(other.a1_pct, other.a1_per_b0_pct) AS to_normal,
       abs(coalesce(one.a1_pct, one.a1_per_b0_pct) - coalesce(other.a1_pct, other.a1_per_b0_pct)) AS apart
FROM machine_health AS one JOIN machine_health AS other
  ON other.site = one.site AND other.machine = one.machine AND other.direction = 'reverse_to_normal'
WHERE one.direction = 'normal_to_reverse' AND apart > 10 ORDER BY apart DESC LIMIT 50;

-- 11. Which throws of a machine can be exported with their traces? [`pointsd export --traces DIR`; README: the codec of traces]
SELECT boot_id, throw_no, started_at, quality FROM health_history
WHERE site = 'north' AND machine = 'm1' ORDER BY started_at_us DESC LIMIT 20;

-- 12. What did the last twenty throws before an alarm look like? [rough throws have only the ratios]
SELECT started_at, direction, quality, b0_pct, a1_pct, a0_pct, a1_per_b0_pct, a0_per_b0_pct, duration_s, mean_current_a
FROM health_history WHERE site = 'north' AND machine = 'm1'
  AND started_at_us < (SELECT (unixepoch(max(raised_at)) + 1) * 1000000 FROM alarm_history WHERE site = 'north' AND machine = 'm1')
ORDER BY started_at_us DESC LIMIT 20;
