-- Statements whose work grew with the age of the database, or with a logger that restarts at each throw.

-- Each deleted boot searched all gaps: 300 boots beside 100,000 gaps took 9.7 s in one transaction.
CREATE INDEX gap_of_boot ON gap (boot_row, last_no);
-- Boots whose throws are all dropped.
CREATE INDEX boot_emptied ON boot (boot_row) WHERE pruned_to_no >= highest_no;
-- The commands of a machine, and the closed alarms, which are counted every second.
CREATE INDEX command_of_machine ON command (machine_row);
CREATE INDEX alarm_closed ON alarm (raised_at_us, state) WHERE state = 'normal';
-- No statement uses this index, and each throw changed it twice.
DROP INDEX throw_waiting;

-- The latest throw is the last one in the order of the machine: throws from a backlog are judged after later ones.
DROP TRIGGER estimate_added;
CREATE TRIGGER estimate_added AFTER INSERT ON estimate BEGIN
    INSERT INTO latest (machine_row, direction, throw_row, start_us)
        SELECT NEW.machine_row, coalesce(NEW.direction, ''), throw_row, started_at_us FROM throw WHERE throw_row = NEW.throw_row
        ON CONFLICT (machine_row, direction) DO UPDATE SET throw_row = excluded.throw_row, start_us = excluded.start_us
        WHERE (SELECT (own.boot_position, own.throw_no) > (last.boot_position, last.throw_no) FROM throw AS own, throw AS last
               WHERE own.throw_row = excluded.throw_row AND last.throw_row = latest.throw_row);
END;

-- An older version of the program, after a rollback, does not set this column.
UPDATE estimate SET rejected_start_us = (SELECT started_at_us FROM throw WHERE throw.throw_row = estimate.throw_row)
WHERE rejected_start_us IS NULL AND quality NOT IN ('good', 'rough', 'current_only');
CREATE TRIGGER estimate_rejected AFTER INSERT ON estimate
WHEN NEW.rejected_start_us IS NULL AND NEW.quality NOT IN ('good', 'rough', 'current_only') BEGIN
    UPDATE estimate SET rejected_start_us = (SELECT started_at_us FROM throw WHERE throw_row = NEW.throw_row)
    WHERE throw_row = NEW.throw_row;
END;
