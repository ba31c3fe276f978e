-- What operators had done, with who and why: not every command is an event of an alarm (a new baseline, a maintenance
-- window of a healthy machine).
CREATE TABLE command (
    command_row INTEGER PRIMARY KEY AUTOINCREMENT,
    machine_row INTEGER NOT NULL REFERENCES machine,
    at_us       INTEGER NOT NULL,
    command     TEXT    NOT NULL,              -- the word of it, as 'ack'
    by_whom     TEXT    NOT NULL,
    why         TEXT,
    payload     TEXT    NOT NULL               -- all of it, JSON
) STRICT;

CREATE VIEW operator_commands AS
SELECT machine.site, machine.machine,
       strftime('%Y-%m-%dT%H:%M:%S', (command.at_us - (command.at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (command.at_us % 1000000 + 1000000) % 1000000) AS carried_out_at,
       command.command, command.payload ->> 'cause' AS cause, command.payload ->> 'until' AS until,
       command.by_whom, command.why
FROM command
JOIN machine USING (machine_row);
