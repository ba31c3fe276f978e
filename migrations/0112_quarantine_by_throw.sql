-- The query of the gaps to report read the whole quarantine of a machine for each of its gaps. Now it finds the messages
-- of a gap by their numbers, and those without a number by their time. Earlier versions name the old index, so it stays.
CREATE INDEX quarantine_by_throw ON quarantine (key, throw_no, received_at_us);
