-- What each machine takes of the database, kept up to date by triggers: when something has to go, the machine that takes
-- the most loses its own history first, and one that floods cannot push out the others'.
ALTER TABLE machine ADD COLUMN throws       INTEGER NOT NULL DEFAULT 0; -- stored
ALTER TABLE machine ADD COLUMN traces       INTEGER NOT NULL DEFAULT 0; -- stored
ALTER TABLE machine ADD COLUMN stored_bytes INTEGER NOT NULL DEFAULT 0; -- its traces, and 800 for each throw's other rows
ALTER TABLE machine ADD COLUMN traces_from  INTEGER NOT NULL DEFAULT 0; -- throw_row before which its traces were dropped

-- The rows of one machine in the order of arrival.
CREATE INDEX throw_of_machine ON throw (machine_row);

UPDATE machine SET (throws, traces, stored_bytes) =
    (SELECT count(*), count(trace.throw_row),
            800 * count(*) + coalesce(sum(length(trace.current_data) + coalesce(length(trace.position_data), 0)), 0)
       FROM throw LEFT JOIN trace USING (throw_row) WHERE throw.machine_row = machine.machine_row);

CREATE TRIGGER throw_added AFTER INSERT ON throw BEGIN
    UPDATE machine SET throws = throws + 1, stored_bytes = stored_bytes + 800 WHERE machine_row = NEW.machine_row;
END;
CREATE TRIGGER throw_dropped BEFORE DELETE ON throw BEGIN
    DELETE FROM trace WHERE throw_row = OLD.throw_row;
    UPDATE machine SET throws = throws - 1, stored_bytes = stored_bytes - 800 WHERE machine_row = OLD.machine_row;
END;
CREATE TRIGGER trace_added AFTER INSERT ON trace BEGIN
    UPDATE machine SET traces = traces + 1,
           stored_bytes = stored_bytes + length(NEW.current_data) + coalesce(length(NEW.position_data), 0)
     WHERE machine_row = (SELECT machine_row FROM throw WHERE throw_row = NEW.throw_row);
END;
CREATE TRIGGER trace_dropped AFTER DELETE ON trace BEGIN
    UPDATE machine SET traces = traces - 1,
           stored_bytes = stored_bytes - length(OLD.current_data) - coalesce(length(OLD.position_data), 0)
     WHERE machine_row = (SELECT machine_row FROM throw WHERE throw_row = OLD.throw_row);
END;
