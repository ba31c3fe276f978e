-- The size of each machine in the database, updated by triggers: retention deletes from the largest machine first, so a
-- machine with very many throws does not displace the history of others.
ALTER TABLE machine ADD COLUMN throws       INTEGER NOT NULL DEFAULT 0; -- stored
ALTER TABLE machine ADD COLUMN traces       INTEGER NOT NULL DEFAULT 0; -- stored
ALTER TABLE machine ADD COLUMN stored_bytes INTEGER NOT NULL DEFAULT 0; -- bytes of its traces, and 800 for the other rows of each throw
ALTER TABLE machine ADD COLUMN traces_from  INTEGER NOT NULL DEFAULT 0; -- its traces before this throw_row were deleted

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
