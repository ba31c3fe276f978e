-- Missing throws that may still be in the backlog of the logger.

-- The order of the starts of a logger. A start that is first received live gets a position far after all others; a start
-- that the backlog shows between two others gets the position after the first of them. A position never changes.
ALTER TABLE boot ADD COLUMN position INTEGER NOT NULL DEFAULT 0;
ALTER TABLE boot ADD COLUMN tail_open INTEGER NOT NULL DEFAULT 0; -- 1: throws after highest_no may be in the backlog
UPDATE boot SET position = boot_row * 1048576;
CREATE UNIQUE INDEX boot_order ON boot (machine_row, position);
CREATE INDEX boot_tail ON boot (machine_row) WHERE tail_open = 1;

-- Whether throw numbers start at 0, read at each start of a logger.
ALTER TABLE machine ADD COLUMN counts_from_zero INTEGER NOT NULL DEFAULT 0;
UPDATE machine SET counts_from_zero = 1
 WHERE EXISTS (SELECT 1 FROM boot JOIN throw USING (boot_row) WHERE boot.machine_row = machine.machine_row AND throw_no = 0);
-- 0: the beginning of the backlog was not read yet.
ALTER TABLE machine ADD COLUMN backlog_read INTEGER NOT NULL DEFAULT 0;
UPDATE machine SET backlog_read = 1;

-- A missing number is open until it is known that the backlog does not have it.
ALTER TABLE gap ADD COLUMN written_off_at_us INTEGER; -- NULL: may be in the backlog
UPDATE gap SET written_off_at_us = detected_at_us;
CREATE INDEX gap_awaited ON gap (boot_row, first_no) WHERE filled_at_us IS NULL AND written_off_at_us IS NULL;

-- Machines with missing throws that may be in the backlog, with the cursor: the last throw before which every throw is
-- stored or written off. A machine without a row has its cursor at the newest throw.
CREATE TABLE backlog (
    machine_row     INTEGER PRIMARY KEY REFERENCES machine,
    cursor_boot_row INTEGER,                   -- NULL: the cursor is before the first throw
    cursor_position INTEGER NOT NULL,          -- boot.position of this start, or less than all positions
    cursor_no       INTEGER NOT NULL,
    since_us        INTEGER NOT NULL           -- when the first missing throw was detected: start of the wait of later throws
) STRICT;

-- The throws of each machine are judged in their order.
ALTER TABLE throw ADD COLUMN boot_position INTEGER NOT NULL DEFAULT 0; -- boot.position
UPDATE throw SET boot_position = (SELECT position FROM boot WHERE boot.boot_row = throw.boot_row) WHERE judged_at_us IS NULL;
CREATE INDEX throw_pending ON throw (machine_row, boot_position, throw_no) WHERE judged_at_us IS NULL;
