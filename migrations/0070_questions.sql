-- Indexes for questions about the whole fleet. With a million throws such questions took about two seconds without them.

-- `started_at` of the views is this expression; the index serves `WHERE started_at >= …` and `ORDER BY started_at DESC LIMIT …`
-- without reading every throw. It takes 40 bytes for each throw.
CREATE INDEX throw_by_start_text ON throw (
    strftime('%Y-%m-%dT%H:%M:%S', (started_at_us - (started_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (started_at_us % 1000000 + 1000000) % 1000000)
);

-- The condition of the view throws_not_evaluated: SQLite uses a partial index only for the same condition.
DROP INDEX estimate_refused;
CREATE INDEX estimate_refused ON estimate (throw_row) WHERE quality NOT IN ('good', 'rough', 'current_only');
