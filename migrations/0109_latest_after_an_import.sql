-- After `pointsd import` a logger continues under its old boot, which stands before that of the recordings: its throws did
-- not become the latest of the machine, and machine_health, health and status showed a recording until the logger's next
-- start. A throw that arrives later and began later is the latest too. One from a backlog began earlier.
DROP TRIGGER estimate_added;
CREATE TRIGGER estimate_added AFTER INSERT ON estimate BEGIN
    INSERT INTO latest (machine_row, direction, throw_row, start_us)
        SELECT NEW.machine_row, coalesce(NEW.direction, ''), throw_row, started_at_us FROM throw WHERE throw_row = NEW.throw_row
        ON CONFLICT (machine_row, direction) DO UPDATE SET throw_row = excluded.throw_row, start_us = excluded.start_us
        WHERE (SELECT (own.boot_position, own.throw_no) > (last.boot_position, last.throw_no)
                      OR own.throw_row > last.throw_row AND own.started_at_us > last.started_at_us
               FROM throw AS own, throw AS last
               WHERE own.throw_row = excluded.throw_row AND last.throw_row = latest.throw_row);
END;
