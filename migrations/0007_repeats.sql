-- Repetitions by a logger: the same recording with new numbers, or other throws with used numbers.

ALTER TABLE throw ADD COLUMN trace_hash INTEGER;  -- CRC-32 of the current and of the position; NULL: stored by an earlier version
ALTER TABLE throw ADD COLUMN repeats_row INTEGER; -- the throw_row of a throw of the machine with the same trace; NULL: none
CREATE INDEX throw_by_trace ON throw (machine_row, trace_hash, content_crc32) WHERE trace_hash IS NOT NULL;
