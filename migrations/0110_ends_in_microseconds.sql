-- `until` had as many digits of the second as the command gave, and every other time of the views has six. Times are text
-- and compared as text: '…12Z' came after '…12.500000Z'.
DROP VIEW operator_commands;
CREATE VIEW operator_commands AS
SELECT machine.site, machine.machine,
       strftime('%Y-%m-%dT%H:%M:%S', (command.at_us - (command.at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (command.at_us % 1000000 + 1000000) % 1000000) AS carried_out_at,
       command.command, command.payload ->> 'cause' AS cause,
       -- The payload has UTC as '2026-05-04T06:00:00Z', or with one to nine digits after a point.
       substr(command.payload ->> 'until', 1, 19) || '.'
           || substr(rtrim(substr(command.payload ->> 'until', 21), 'Z') || '000000', 1, 6) || 'Z' AS until,
       command.by_whom, command.why
FROM command
JOIN machine USING (machine_row);
