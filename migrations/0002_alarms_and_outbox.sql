-- Alarms with every event of their life, and what is still to be published.

CREATE TABLE alarm (
    alarm_row     INTEGER PRIMARY KEY,
    alarm_id      TEXT    NOT NULL UNIQUE,     -- site.machine.cause.raised_at_us
    machine_row   INTEGER NOT NULL REFERENCES machine,
    cause         TEXT    NOT NULL,
    raised_at_us  INTEGER NOT NULL,
    last_event_no INTEGER NOT NULL,
    state         TEXT    NOT NULL             -- of the last event
) STRICT;

CREATE INDEX alarm_open ON alarm (machine_row) WHERE state <> 'normal';
CREATE INDEX alarm_by_time ON alarm (raised_at_us);

CREATE TABLE alarm_event (
    alarm_row        INTEGER NOT NULL REFERENCES alarm ON DELETE CASCADE,
    event_no         INTEGER NOT NULL,
    event_at_us      INTEGER NOT NULL,
    severity         TEXT    NOT NULL,
    state            TEXT    NOT NULL,
    change_pct       REAL,
    change_pct_sd    REAL,
    direction        TEXT,
    runner_up_cause  TEXT,
    runner_up_margin REAL,                     -- difference of misfits, chi-square units
    b0_a1            REAL,                     -- correlations of the inertia estimates
    b0_a0            REAL,
    a1_a0            REAL,
    first_boot_id    TEXT,
    first_throw_no   INTEGER,
    last_boot_id     TEXT,
    last_throw_no    INTEGER,
    limit_low        REAL,                     -- throws until the next limit
    limit_mid        REAL,
    limit_high       REAL,
    text             TEXT    NOT NULL,
    by_whom          TEXT,
    why              TEXT,
    payload          TEXT    NOT NULL,         -- the message as published, JSON
    PRIMARY KEY (alarm_row, event_no)
) STRICT, WITHOUT ROWID;

CREATE INDEX alarm_event_by_time ON alarm_event (event_at_us);

-- Committed with its event, deleted when zenoh took it: published at least once, in the order of the rows.
CREATE TABLE outbox (
    outbox_row    INTEGER PRIMARY KEY AUTOINCREMENT,
    key           TEXT    NOT NULL,
    payload       BLOB    NOT NULL,
    created_at_us INTEGER NOT NULL
) STRICT;

-- Messages that are no throw, and throws that contradict a stored one: the beginning of each, with the reason.
CREATE TABLE quarantine (
    quarantine_row INTEGER PRIMARY KEY AUTOINCREMENT,
    received_at_us INTEGER NOT NULL,
    key            TEXT    NOT NULL,
    reason         TEXT    NOT NULL,
    payload_bytes  INTEGER NOT NULL,           -- of the whole message
    payload_start  BLOB    NOT NULL
) STRICT;

-- Totals that outlive the rows they count.
CREATE TABLE counter (
    name  TEXT    PRIMARY KEY,
    value INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- One row: whether the last stop was a clean one.
CREATE TABLE shutdown (
    only_row INTEGER PRIMARY KEY CHECK (only_row = 1),
    clean    INTEGER NOT NULL
) STRICT;

INSERT INTO shutdown (only_row, clean) VALUES (1, 1);
