-- What the monitor of a machine cannot show at present, in sentences: a fault hidden by the temperature, a baseline with a
-- trend.
ALTER TABLE monitor ADD COLUMN caveats TEXT;  -- JSON: a list of sentences; NULL: none

-- One row for each caveat.
CREATE VIEW machine_caveats AS
SELECT machine.site, machine.machine, caveat.value AS caveat
FROM monitor JOIN machine USING (machine_row), json_each(monitor.caveats) AS caveat;
