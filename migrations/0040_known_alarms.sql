-- Alarms "since" a time are selected by the time at which the daemon raised them, as the clock of a logger may be wrong.
ALTER TABLE alarm_event ADD COLUMN known_at_us INTEGER; -- the later of event_at_us and the daemon's time; NULL: an earlier version wrote it
DROP INDEX alarm_event_by_time;
CREATE INDEX alarm_event_by_time ON alarm_event (coalesce(known_at_us, event_at_us));
