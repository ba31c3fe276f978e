-- The way of a throw: spooled as it came, then judged.
-- Times are integer microseconds since 1970-01-01 UTC (`_us`); views show them as RFC 3339 text.

CREATE TABLE machine (
    machine_row INTEGER PRIMARY KEY,
    site        TEXT NOT NULL,
    machine     TEXT NOT NULL,
    UNIQUE (site, machine)
) STRICT;

-- One start of a machine's logger. Every throw number from the first to highest_no is stored, or pruned
-- (pruned_to_no), or in a gap: so a repeated throw is told from a late one for ever.
CREATE TABLE boot (
    boot_row      INTEGER PRIMARY KEY,
    machine_row   INTEGER NOT NULL REFERENCES machine,
    boot_id       TEXT    NOT NULL,
    first_seen_us INTEGER NOT NULL,
    highest_no    INTEGER NOT NULL,
    pruned_to_no  INTEGER NOT NULL DEFAULT -1,
    UNIQUE (machine_row, boot_id)
) STRICT;

-- AUTOINCREMENT: a row number is never used again after pruning, so `throw_row` is the order of arrival for ever.
CREATE TABLE throw (
    throw_row      INTEGER PRIMARY KEY AUTOINCREMENT,
    machine_row    INTEGER NOT NULL REFERENCES machine,
    boot_row       INTEGER NOT NULL REFERENCES boot,
    throw_no       INTEGER NOT NULL,
    started_at_us  INTEGER NOT NULL,
    received_at_us INTEGER NOT NULL,
    direction      TEXT CHECK (direction IN ('normal_to_reverse', 'reverse_to_normal')), -- declared; NULL: unknown
    sample_rate_hz REAL    NOT NULL,
    samples        INTEGER NOT NULL,           -- of each channel
    temperature_c  REAL,
    supply_v       REAL,
    anti_alias_hz  REAL,
    content_crc32  INTEGER NOT NULL,           -- of the whole throw: tells a repeat from another throw under its number
    judged_at_us   INTEGER,                    -- NULL: waits to be judged
    UNIQUE (boot_row, throw_no)
) STRICT;

-- What waits is found without reading what is done.
CREATE INDEX throw_waiting ON throw (throw_row) WHERE judged_at_us IS NULL;
CREATE INDEX throw_by_time ON throw (machine_row, started_at_us);

-- The channels, apart from the rows that are queried every day; dropped first when space runs out.
CREATE TABLE trace (
    throw_row      INTEGER PRIMARY KEY REFERENCES throw ON DELETE CASCADE,
    current_codec  TEXT    NOT NULL,           -- pco-f32, pco-f64 or raw-f64 (little-endian)
    current_data   BLOB    NOT NULL,           -- throw.samples values, A
    position_codec TEXT    NOT NULL,
    position_data  BLOB    NOT NULL,           -- throw.samples values, mm from normal
    crc32          INTEGER NOT NULL            -- of both channels as little-endian f64, current first
) STRICT;

CREATE TABLE estimate (
    throw_row              INTEGER PRIMARY KEY REFERENCES throw ON DELETE CASCADE,
    machine_row            INTEGER NOT NULL REFERENCES machine,
    direction              TEXT CHECK (direction IN ('normal_to_reverse', 'reverse_to_normal')), -- as it moved
    direction_contradicted INTEGER NOT NULL,   -- 1: the logger declared the other one
    quality                TEXT    NOT NULL,   -- 'good', or the code of why it was not evaluated
    detail                 TEXT,               -- the same as a sentence
    b0                     REAL,               -- rad s^-2 A^-1
    a1                     REAL,               -- s^-1
    a0                     REAL,               -- s^-2
    b0_sd                  REAL,
    a1_sd                  REAL,
    a0_sd                  REAL,
    b0_a1_cov              REAL,
    b0_a0_cov              REAL,
    a1_a0_cov              REAL,
    b0_pct                 REAL,               -- change from the baseline, %
    a1_pct                 REAL,
    a0_pct                 REAL,
    fit_pct                REAL,
    iterations             INTEGER,
    start_s                REAL,               -- samples used, from the start of the trace
    end_s                  REAL,
    duration_s             REAL,
    peak_current_a         REAL,
    mean_current_a         REAL,
    charge_as              REAL,
    travel_mm              REAL,
    end_position_mm        REAL,
    baseline_throws        INTEGER,            -- in this direction's baseline so far
    baseline_needed        INTEGER,
    throws_since_baseline  INTEGER NOT NULL    -- good throws of this direction since its baseline was complete
) STRICT;

CREATE INDEX estimate_latest ON estimate (machine_row, direction, throw_row);
CREATE INDEX estimate_refused ON estimate (throw_row) WHERE quality <> 'good';

-- Throw numbers that never came. A late throw shrinks or splits its gap; a gap that was filled keeps its row.
CREATE TABLE gap (
    gap_row        INTEGER PRIMARY KEY,
    boot_row       INTEGER NOT NULL REFERENCES boot ON DELETE CASCADE,
    first_no       INTEGER NOT NULL,
    last_no        INTEGER NOT NULL,
    kind           TEXT    NOT NULL CHECK (kind IN ('missed', 'before_first_contact', 'not_stored')),
    detected_at_us INTEGER NOT NULL,
    filled_at_us   INTEGER,                    -- NULL: still missing
    recovered      INTEGER NOT NULL DEFAULT 0, -- throws of this gap that came late
    CHECK (first_no <= last_no)
) STRICT;

CREATE INDEX gap_open ON gap (boot_row, first_no) WHERE filled_at_us IS NULL;

-- Baselines are never overwritten: a rebaseline adds rows and says who and why.
CREATE TABLE baseline (
    baseline_row INTEGER PRIMARY KEY,
    machine_row  INTEGER NOT NULL REFERENCES machine,
    direction    TEXT    NOT NULL CHECK (direction IN ('normal_to_reverse', 'reverse_to_normal')),
    taken_at_us  INTEGER NOT NULL,
    throws       INTEGER NOT NULL,
    b0           REAL    NOT NULL,             -- robust centre
    a1           REAL    NOT NULL,
    a0           REAL    NOT NULL,
    details      TEXT    NOT NULL,             -- JSON: everything else that the diagnosis keeps of it
    by_whom      TEXT,                         -- NULL: taken by itself
    why          TEXT,
    UNIQUE (machine_row, direction, taken_at_us)
) STRICT;

-- The monitor of each machine as it was after its last judged throw: a restart goes on from here.
CREATE TABLE monitor (
    machine_row   INTEGER PRIMARY KEY REFERENCES machine,
    snapshot      TEXT    NOT NULL,            -- JSON
    updated_at_us INTEGER NOT NULL
) STRICT;
