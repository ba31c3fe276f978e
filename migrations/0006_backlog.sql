-- What is missing of each machine and may still be in the backlog of its logger.

-- The order of the starts of a logger. A start that is first received live follows all others at a distance; one that the
-- backlog shows between two others is placed right after the one before it. A position never changes.
ALTER TABLE boot ADD COLUMN position INTEGER NOT NULL DEFAULT 0;
ALTER TABLE boot ADD COLUMN tail_open INTEGER NOT NULL DEFAULT 0; -- 1: throws after highest_no may be in the backlog
UPDATE boot SET position = boot_row * 1048576;
CREATE UNIQUE INDEX boot_order ON boot (machine_row, position);
CREATE INDEX boot_tail ON boot (machine_row) WHERE tail_open = 1;

-- Whether throw numbers start at 0: asked at each start of a logger, however many there were.
ALTER TABLE machine ADD COLUMN counts_from_zero INTEGER NOT NULL DEFAULT 0;
UPDATE machine SET counts_from_zero = 1
 WHERE EXISTS (SELECT 1 FROM boot JOIN throw USING (boot_row) WHERE boot.machine_row = machine.machine_row AND throw_no = 0);
-- 0: the backlog has not been read from its beginning yet.
ALTER TABLE machine ADD COLUMN backlog_read INTEGER NOT NULL DEFAULT 0;
UPDATE machine SET backlog_read = 1;

-- A missing number is awaited until the backlog turns out not to have it.
ALTER TABLE gap ADD COLUMN written_off_at_us INTEGER; -- NULL: may be in the backlog
UPDATE gap SET written_off_at_us = detected_at_us;
CREATE INDEX gap_awaited ON gap (boot_row, first_no) WHERE filled_at_us IS NULL AND written_off_at_us IS NULL;

-- Machines of which something is awaited, with the cursor: the last throw up to which everything is stored or written off.
-- A machine without a row here has its cursor at the newest throw.
CREATE TABLE backlog (
    machine_row     INTEGER PRIMARY KEY REFERENCES machine,
    cursor_boot_row INTEGER,                   -- NULL: nothing of the machine is known to be complete
    cursor_position INTEGER NOT NULL,          -- boot.position of the same, or less than all
    cursor_no       INTEGER NOT NULL,
    since_us        INTEGER NOT NULL           -- when the first awaited throw was found missing: later throws wait from then on
) STRICT;

-- Judging takes the throws of each machine in their order.
ALTER TABLE throw ADD COLUMN boot_position INTEGER NOT NULL DEFAULT 0; -- boot.position
UPDATE throw SET boot_position = (SELECT position FROM boot WHERE boot.boot_row = throw.boot_row) WHERE judged_at_us IS NULL;
CREATE INDEX throw_pending ON throw (machine_row, boot_position, throw_no) WHERE judged_at_us IS NULL;
