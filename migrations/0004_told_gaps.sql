-- Whether the monitor of its machine knows of a gap: a restart between the two must not keep an alarm from being raised.
ALTER TABLE gap ADD COLUMN told_at_us INTEGER; -- NULL: not yet

-- Until now the daemon kept that in its memory.
UPDATE gap SET told_at_us = detected_at_us;

CREATE INDEX gap_untold ON gap (gap_row)
 WHERE told_at_us IS NULL AND filled_at_us IS NULL AND kind <> 'before_first_contact';
