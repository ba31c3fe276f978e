//! The SQL statements of the store. A test prepares each of them against the migrated schema. The statements of a
//! recovery are in `files::graft` and `files::salvage`.

macro_rules! statements {
    ($($name:ident = $sql:expr;)*) => {
        $(pub(super) const $name: &str = $sql;)*

        /// All statements, with their names.
        pub const ALL: &[(&str, &str)] = &[$((stringify!($name), $sql)),*];
    };
}

/// Columns and joins of a query of throws with their traces, for [`StoredThrow`](super::rows::StoredThrow).
macro_rules! throw_rows {
    () => {
        "throw_row, site, machine, boot_id, throw_no, started_at_us, received_at_us, direction, sample_rate_hz, samples, \
         temperature_c, supply_v, anti_alias_hz, current_codec, current_data, position_codec, position_data, crc32, \
         repeats_row IS NOT NULL AS repeats, boot_position IS NOT position AS moved FROM throw JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
         LEFT JOIN trace USING (throw_row)"
    };
}

/// Column with the change of the ratio of a coefficient to b0 from the last baseline before the throw \[%\], with the
/// formula of the view `health_history`. It is NULL if the throw has changes of the coefficients themselves. `$at`:
/// index of the coefficient in the centre of the baseline. `$throws`: number of throws in the baseline when the throw
/// was judged.
macro_rules! ratio_pct {
    ($coefficient:literal, $at:literal, $throws:literal) => {
        concat!(
            "CASE WHEN b0_pct IS NULL THEN 100.0 * (coalesce(estimate.",
            $coefficient,
            "_per_b0, estimate.",
            $coefficient,
            " / estimate.b0) * (SELECT payload ->> '$.center[0]' / payload ->> '$.center[",
            $at,
            "]' FROM ( \
             SELECT payload FROM baseline \
             WHERE baseline.machine_row = estimate.machine_row AND baseline.direction = estimate.direction \
             AND baseline.taken_at_us <= throw.started_at_us ORDER BY baseline.taken_at_us DESC LIMIT 1) \
             WHERE payload ->> 'throws' <= ",
            $throws,
            ") - 1) END AS ",
            $coefficient,
            "_per_b0_pct"
        )
    };
}

/// The columns of [`Health`](crate::wire::Health). The parameters are the columns that depend on the query; for
/// `$throws` see `ratio_pct`.
macro_rules! health {
    ($direction:literal, $state:literal, $drift:literal, $drifts:literal, $caveats:literal, $throws:literal) => {
        concat!(
            "site, machine, boot_id, throw_no, started_at_us, ",
            $direction,
            " AS direction, ",
            $state,
            " AS state, ",
            $drift,
            " AS drift, ",
            $drifts,
            " AS drifts, ",
            $caveats,
            " AS caveats, quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, \
             a1_per_b0, a1_per_b0_sd, a0_per_b0, a0_per_b0_sd, ",
            ratio_pct!("a1", "1", $throws),
            ", ",
            ratio_pct!("a0", "2", $throws),
            ", duration_s, peak_current_a, mean_current_a, baseline_throws, baseline_needed, throws_since_baseline "
        )
    };
}

/// A time in microseconds as RFC 3339 text, as in the views.
macro_rules! rfc3339 {
    ($column:literal) => {
        concat!(
            "strftime('%Y-%m-%dT%H:%M:%S', (",
            $column,
            " - (",
            $column,
            " % 1000000 + 1000000) % 1000000) / 1000000, \
             'unixepoch') || printf('.%06dZ', (",
            $column,
            " % 1000000 + 1000000) % 1000000)"
        )
    };
}

/// Query of one page of `pointsd export`: the first ?6 throws that started after time ?3 and row ?4, and before time
/// ?5. The first two columns are for paging; the others are exported. `$condition` selects the machines.
macro_rules! export {
    ($condition:expr) => {
        concat!(
            "SELECT throw_row, started_at_us, site, machine, boot_id, throw_no, ",
            rfc3339!("started_at_us"), " AS started_at, ",
            rfc3339!("received_at_us"), " AS received_at, \
             coalesce(estimate.direction, throw.direction, 'unknown') AS direction, sample_rate_hz, samples, temperature_c, \
             supply_v, anti_alias_hz, coalesce(quality, 'pending') AS quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, \
             b0_a1_cov, b0_a0_cov, a1_a0_cov, b0_pct, a1_pct, a0_pct, a1_per_b0, a1_per_b0_sd, a0_per_b0, a0_per_b0_sd, \
             fit_pct, duration_s, release_s, peak_current_a, mean_current_a, running_current_a, charge_as, energy_j, \
             travel_mm, start_position_mm, end_position_mm, estimate.state AS state, started_at_us \
             FROM throw JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
             LEFT JOIN estimate USING (throw_row) \
             WHERE ", $condition, " AND (started_at_us, throw_row) > (?3, ?4) AND started_at_us < ?5 \
             ORDER BY started_at_us, throw_row LIMIT ?6"
        )
    };
}

/// The columns of the health of throws, with the state after each throw.
macro_rules! throw_health {
    () => {
        health!(
            "coalesce(estimate.direction, throw.direction)",
            "estimate.state",
            "estimate.drift",
            "NULL",
            "NULL",
            "coalesce(estimate.baseline_before, estimate.baseline_throws)"
        )
    };
}

/// Columns and joins of a query of the health of throws.
macro_rules! history {
    () => {
        concat!(
            throw_health!(),
            "FROM estimate JOIN throw USING (throw_row) JOIN boot USING (boot_row) \
             JOIN machine ON machine.machine_row = throw.machine_row"
        )
    };
}

/// Columns and table of a query of boots, for [`Boot`](super::writer::cursor::Boot).
macro_rules! boots {
    () => {
        "machine_row, boot_row, position, highest_no, pruned_to_no, tail_open FROM boot"
    };
}

/// Condition for a gap that a backlog may still fill.
macro_rules! awaited {
    () => {
        "filled_at_us IS NULL AND written_off_at_us IS NULL"
    };
}

/// Subquery of the messages in quarantine that may be throws of a gap: messages with a number in the gap, and messages
/// without a readable number that arrived after the throw before the gap. `$column`: an aggregate, or a column of the
/// newest message.
macro_rules! refused {
    ($column:literal) => {
        concat!(
            "(SELECT ",
            $column,
            " FROM quarantine INDEXED BY quarantine_by_key \
             WHERE key = 'points/v1/' || site || '/' || machine || '/throw' \
             AND (quarantine.boot_id = boot.boot_id AND quarantine.throw_no BETWEEN first_no AND last_no \
             OR quarantine.throw_no IS NULL AND quarantine.received_at_us >= coalesce((SELECT received_at_us FROM throw \
             WHERE throw.boot_row = gap.boot_row AND throw.throw_no < first_no ORDER BY throw.throw_no DESC LIMIT 1), 0)) \
             ORDER BY quarantine_row DESC LIMIT 1)"
        )
    };
}

/// Row of the machine with site ?1 and name ?2.
macro_rules! one_machine {
    () => {
        "(SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2)"
    };
}

/// The row numbers in the JSON list ?1.
macro_rules! chosen {
    () => {
        "(SELECT value FROM json_each(?1))"
    };
}

/// The columns of [`Statistics`](super::Statistics) that are fast enough for every second.
macro_rules! figures {
    () => {
        "coalesce(sum(traces), 0) AS traces, coalesce(sum(throws), 0) AS throws, \
         (SELECT count(*) FROM alarm WHERE state = 'normal') AS closed_alarms, (SELECT count(*) FROM outbox) AS outbox, \
         (SELECT (page_count - freelist_count) * page_size FROM pragma_page_count, pragma_freelist_count, pragma_page_size) \
         AS data_bytes, (SELECT freelist_count * page_size FROM pragma_freelist_count, pragma_page_size) AS free_bytes, \
         (SELECT json_group_object(name, value) FROM counter) AS counters"
    };
}

/// Adds or replaces monitors. `$rows`: `VALUES`, or a query of the columns.
macro_rules! set_monitor {
    ($rows:literal) => {
        concat!(
            "INSERT INTO monitor (machine_row, updated_at_us, snapshot, state, drifts, caveats) ",
            $rows,
            " ON CONFLICT (machine_row) DO UPDATE SET snapshot = excluded.snapshot, updated_at_us = excluded.updated_at_us, \
             state = excluded.state, drifts = excluded.drifts, caveats = excluded.caveats"
        )
    };
}

macro_rules! all_machines {
    () => {
        "all-machines"
    };
}

/// Machine name of the alarms about all machines of a site.
pub(crate) const ALL_MACHINES: &str = all_machines!();

/// Whether a row is no machine of the fleet now: an operator retired the machine, which has no monitor until its next
/// throw is judged; or the row is an earlier name of the daemon, with alarms and without a throw. Needs a LEFT JOIN of the
/// row with `monitor`.
macro_rules! is_absent {
    () => {
        "(monitor.machine_row IS NULL AND (EXISTS (SELECT 1 FROM command \
          WHERE command.machine_row = machine.machine_row AND command.command = 'retire') \
          OR NOT EXISTS (SELECT 1 FROM throw WHERE throw.machine_row = machine.machine_row)))"
    };
}
pub(super) use is_absent;

/// Machines that match the filters ?1 site, ?2 cause and ?3 text, without the daemon itself (?4/?5) and
/// [`ALL_MACHINES`]. A machine is silent if it is not monitored and has no open alarm about its condition.
macro_rules! matching {
    () => {
        concat!(
            "(SELECT machine.machine_row, site, machine, coalesce(monitor.state, 'learning') AS state, monitor.drifts,
                 CASE WHEN monitor.state = 'not_monitored' THEN NOT EXISTS (SELECT 1 FROM alarm
                     WHERE alarm.machine_row = machine.machine_row AND alarm.state <> 'normal'
                       AND alarm.cause NOT IN ('not_monitored', 'data_loss')) ELSE 0 END AS is_silent
          FROM machine LEFT JOIN monitor INDEXED BY monitor_state ON monitor.machine_row = machine.machine_row
          WHERE (?1 IS NULL OR site = ?1)
            AND (?2 IS NULL OR EXISTS (SELECT 1 FROM alarm
                 WHERE alarm.machine_row = machine.machine_row AND alarm.state <> 'normal' AND alarm.cause = ?2))
            AND (?3 IS NULL OR instr(lower(site || '/' || machine), lower(?3)) > 0)
            AND machine <> '",
            all_machines!(),
            "' AND NOT (site = ?4 AND machine = ?5) AND NOT ",
            is_absent!(),
            ")"
        )
    };
}

statements! {
    // Opening and closing.
    FOREIGN_TABLE = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite@_%' ESCAPE '@' \
        AND name <> '_sqlx_migrations' AND NOT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'trace') LIMIT 1";
    CLEAN = "SELECT clean FROM shutdown";
    SET_CLEAN = "UPDATE shutdown SET clean = ?1 WHERE clean <> ?1";
    SCHEMA = "SELECT type, name, tbl_name, rootpage, sql FROM sqlite_schema WHERE rootpage > 0 ORDER BY rowid";
    COUNT = "INSERT INTO counter (name, value) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET value = value + ?2";

    // Spooling.
    MACHINE = "SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2";
    ADD_MACHINE = "INSERT INTO machine (site, machine) VALUES (?1, ?2) RETURNING machine_row";
    BOOT = concat!("SELECT ", boots!(), " WHERE machine_row = ?1 AND boot_id = ?2");
    BOOT_OF_ROW = concat!("SELECT ", boots!(), " WHERE boot_row = ?1");
    LAST_BOOT = concat!("SELECT ", boots!(), " WHERE machine_row = ?1 ORDER BY position DESC LIMIT 1");
    NEXT_BOOT = concat!("SELECT ", boots!(), " WHERE machine_row = ?1 AND position > ?2 ORDER BY position LIMIT 1");
    BOOT_BEFORE = concat!("SELECT ", boots!(), " WHERE machine_row = ?1 AND position < ?2 ORDER BY position DESC LIMIT 1");
    BOOT_ID = "SELECT boot_id FROM boot WHERE boot_row = ?1";
    ADD_BOOT = "INSERT INTO boot (machine_row, boot_id, first_seen_us, highest_no, position, tail_open) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6) RETURNING boot_row";
    OPEN_TAIL = "UPDATE boot SET tail_open = 1 WHERE boot_row = ?1";
    COUNTS_FROM_ZERO = "SELECT counts_from_zero FROM machine WHERE machine_row = ?1";
    SET_COUNTS_FROM_ZERO = "UPDATE machine SET counts_from_zero = 1 WHERE machine_row = ?1";
    STORED = "SELECT throw_row, content_crc32, received_at_us FROM throw WHERE boot_row = ?1 AND throw_no = ?2";
    // Statements with one row of `?`: see the module `batch`.
    // The throws that are the next one of a known boot, of machines without missing throws.
    NEXT_THROWS = "WITH new (at, site, machine, boot_id, throw_no) AS (VALUES (?, ?, ?, ?, ?)) \
        SELECT json_group_array(json_array(at, machine_row, boot_row, position)) \
        FROM new CROSS JOIN machine USING (site, machine) CROSS JOIN boot USING (machine_row, boot_id) \
        WHERE highest_no = throw_no - 1 \
        AND NOT EXISTS (SELECT 1 FROM backlog WHERE backlog.machine_row = machine.machine_row)";
    ADD_NEW_MACHINES = "INSERT OR IGNORE INTO machine (site, machine) \
        SELECT * FROM (VALUES (?, ?)) WHERE column1 IS NOT NULL";
    // The first boots of machines without a boot. Their first throw has the number 1, so no throw is missing.
    ADD_FIRST_BOOTS = "WITH new (site, machine, boot_id, first_seen_us, position) AS (VALUES (?, ?, ?, ?, ?)) \
        INSERT INTO boot (machine_row, boot_id, first_seen_us, highest_no, position, tail_open) \
        SELECT machine_row, boot_id, first_seen_us, 0, position, 0 FROM new CROSS JOIN machine USING (site, machine) \
        WHERE NOT EXISTS (SELECT 1 FROM boot WHERE boot.machine_row = machine.machine_row) GROUP BY machine_row";
    ADD_THROWS = "WITH new (machine_row, boot_row, boot_position, throw_no, started_at_us, received_at_us, direction, \
        sample_rate_hz, samples, temperature_c, supply_v, anti_alias_hz, content_crc32, trace_hash) \
        AS (VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)) \
        INSERT INTO throw (machine_row, boot_row, boot_position, throw_no, started_at_us, received_at_us, direction, \
        sample_rate_hz, samples, temperature_c, supply_v, anti_alias_hz, content_crc32, trace_hash, repeats_row) \
        SELECT new.*, (SELECT throw_row FROM throw AS own INDEXED BY throw_by_trace \
        WHERE own.machine_row = new.machine_row AND own.trace_hash = new.trace_hash LIMIT 1) \
        FROM new WHERE new.machine_row IS NOT NULL";
    // Also sets the highest numbers of the boots of these throws.
    ADD_TRACES = "INSERT INTO trace (throw_row, current_codec, current_data, position_codec, position_data, crc32) \
        SELECT * FROM (VALUES (?, ?, ?, ?, ?, ?)) WHERE column1 IS NOT NULL; \
        UPDATE boot SET highest_no = (SELECT max(throw_no) FROM throw WHERE throw.boot_row = boot.boot_row) \
        WHERE boot_row IN (SELECT boot_row FROM throw WHERE throw_row > last_insert_rowid() - changes()) \
        AND highest_no < (SELECT max(throw_no) FROM throw WHERE throw.boot_row = boot.boot_row)";
    SAME_CONTENT = "SELECT throw_row FROM throw INDEXED BY throw_by_trace \
        WHERE machine_row = ?1 AND trace_hash = ?2 AND content_crc32 = ?3 AND boot_row = ?4 LIMIT 1";

    // Gaps.
    GAP_AT = "SELECT gap_row, first_no, last_no FROM gap \
        WHERE boot_row = ?1 AND first_no <= ?2 AND filled_at_us IS NULL ORDER BY first_no DESC LIMIT 1";
    ADD_GAP = "INSERT INTO gap (boot_row, first_no, last_no, kind, detected_at_us) VALUES (?1, ?2, ?3, ?4, ?5)";
    SPLIT_GAP = "INSERT INTO gap (boot_row, first_no, last_no, kind, detected_at_us, told_at_us, written_off_at_us) \
        SELECT boot_row, ?2, last_no, kind, detected_at_us, told_at_us, written_off_at_us FROM gap WHERE gap_row = ?1";
    SHRINK_GAP = "UPDATE gap SET first_no = ?2, last_no = ?3, recovered = recovered + 1 WHERE gap_row = ?1";
    FILL_GAP = "UPDATE gap SET filled_at_us = ?2, recovered = recovered + 1 WHERE gap_row = ?1";

    // The backlog.
    OPEN_BACKLOG = "INSERT INTO backlog (machine_row, cursor_boot_row, cursor_position, cursor_no, since_us) \
        VALUES (?1, ?2, ?3, ?4, ?5) ON CONFLICT DO NOTHING";
    BACKLOG = "SELECT cursor_boot_row AS boot_row, cursor_position AS position, cursor_no AS throw_no FROM backlog \
        WHERE machine_row = ?1";
    MOVE_CURSOR = "UPDATE backlog SET cursor_boot_row = ?2, cursor_position = ?3, cursor_no = ?4, since_us = ?5 WHERE machine_row = ?1";
    CLOSE_BACKLOG = "DELETE FROM backlog WHERE machine_row = ?1";
    FIRST_AWAITED = concat!("SELECT first_no, last_no FROM gap WHERE boot_row = ?1 AND ", awaited!(), " ORDER BY first_no LIMIT 1");
    WRITE_OFF_BEFORE = concat!("UPDATE gap SET written_off_at_us = ?3 WHERE boot_row = ?1 AND first_no < ?2 AND ", awaited!());
    WRITE_OFF_BOOTS = concat!("UPDATE gap SET written_off_at_us = ?4 WHERE ", awaited!(), " \
        AND boot_row IN (SELECT boot_row FROM boot WHERE machine_row = ?1 AND position >= ?2 AND position < ?3)");
    CLOSE_TAILS = "UPDATE boot SET tail_open = 0 WHERE machine_row = ?1 AND tail_open = 1 AND position >= ?2 AND position < ?3";
    NEWEST_SAMPLES = "SELECT samples FROM throw WHERE boot_row = ?1 ORDER BY throw_no DESC LIMIT 1";
    MACHINE_BACKLOG = "SELECT machine_row, backlog_read FROM machine WHERE site = ?1 AND machine = ?2";
    SET_BACKLOG_READ = "UPDATE machine SET backlog_read = 1 WHERE machine_row = ?1 AND backlog_read = 0";
    BACKLOGS = "SELECT site, machine FROM backlog JOIN machine USING (machine_row) ORDER BY since_us LIMIT ?1";
    AWAITED_COUNT = concat!("SELECT CAST(total(last_no - first_no + 1) AS INTEGER) FROM gap WHERE ", awaited!());

    // Judging. Takes machines with pending throws in turn, after a given machine, and from each its first throws that
    // can be judged, so that neither a long queue nor an open backlog of one machine delays the others. `LIMIT ?2 + 0`:
    // SQLite prepares a statement again at each call if its LIMIT is a parameter alone.
    TO_JUDGE = "WITH RECURSIVE waiting (machine_row) AS (\
        SELECT min(machine_row) FROM throw INDEXED BY throw_pending WHERE judged_at_us IS NULL \
        AND machine_row > coalesce((SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?5), 0) \
        UNION ALL SELECT (SELECT min(throw.machine_row) FROM throw INDEXED BY throw_pending \
        WHERE judged_at_us IS NULL AND throw.machine_row > waiting.machine_row) \
        FROM waiting WHERE waiting.machine_row IS NOT NULL), \
        bound (machine_row, position, no) AS (SELECT waiting.machine_row, \
        CASE WHEN since_us BETWEEN ?3 AND ?4 THEN cursor_position ELSE 9223372036854775807 END, coalesce(cursor_no, 0) \
        FROM waiting LEFT JOIN backlog USING (machine_row) WHERE waiting.machine_row IS NOT NULL), \
        ready AS (SELECT machine_row, position, no FROM bound WHERE EXISTS (SELECT 1 FROM throw AS own INDEXED BY throw_pending \
        WHERE own.machine_row = bound.machine_row AND judged_at_us IS NULL AND (boot_position, throw_no) <= (position, no)) LIMIT ?2 + 0), \
        chosen AS (SELECT own.throw_row, own.machine_row, \
        row_number() OVER (PARTITION BY own.machine_row ORDER BY own.boot_position, own.throw_no) AS turn \
        FROM ready JOIN throw AS own ON own.throw_row IN (SELECT throw_row FROM throw AS next INDEXED BY throw_pending \
        WHERE next.machine_row = ready.machine_row AND judged_at_us IS NULL AND (boot_position, throw_no) <= (position, no) \
        ORDER BY boot_position, throw_no LIMIT ?2 + 0)) \
        SELECT json_group_array(json_array(throw_row, site, machine, boot_id, throw_no, received_at_us, repeats_row IS NOT NULL, \
        boot_position IS NOT boot.position) \
        ORDER BY throw.machine_row, boot_position, throw_no) \
        FROM throw JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        WHERE throw_row IN (SELECT throw_row FROM chosen ORDER BY turn, machine_row LIMIT ?2 + 0)";
    STORED_THROW = concat!("SELECT ", throw_rows!(), " WHERE throw_row = ?1");
    THROWS = concat!("SELECT ", throw_rows!(), " \
        WHERE throw_row > ?1 ORDER BY throw_row LIMIT ?2");
    MACHINE_OF = "SELECT machine_row FROM throw WHERE throw_row = ?1";
    JUDGED_AT = "SELECT judged_at_us FROM throw WHERE throw_row = ?1";
    // Statements with one row of `?`: see the module `batch`.
    PENDING_AMONG = "SELECT count(*) FROM throw WHERE throw_row IN (VALUES (?)) AND judged_at_us IS NULL";
    SET_JUDGED = "WITH new (throw_row, at_us) AS (VALUES (?, ?)) \
        UPDATE throw SET judged_at_us = new.at_us FROM new WHERE throw.throw_row = new.throw_row";
    ADD_ESTIMATES = "WITH new AS (VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)) \
        INSERT INTO estimate (throw_row, direction, direction_contradicted, quality, detail, b0, a1, a0, \
        b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, b0_a1_cov, b0_a0_cov, a1_a0_cov, fit_pct, \
        a1_per_b0, a1_per_b0_sd, a0_per_b0, a0_per_b0_sd, iterations, start_s, end_s, \
        duration_s, peak_current_a, mean_current_a, charge_as, travel_mm, end_position_mm, release_s, running_current_a, \
        energy_j, quiet_current_a, start_position_mm, resistance_ohm, back_emf_v_s_per_rad, no_load_speed_rad_per_s, \
        start_delay_s, start_gain, \
        baseline_throws, baseline_needed, throws_since_baseline, state, drift, machine_row) \
        SELECT new.*, throw.machine_row FROM new CROSS JOIN throw ON throw.throw_row = new.column1";
    SET_MONITORS_OF = set_monitor!("SELECT throw.machine_row, column2, column3, column4, column5, column6 \
        FROM (VALUES (?, ?, ?, ?, ?, ?)) AS new CROSS JOIN throw ON throw.throw_row = column1 WHERE TRUE");
    ADD_BASELINE = "INSERT INTO baseline (machine_row, direction, taken_at_us, payload) VALUES (?1, ?2, ?3, ?4) \
        ON CONFLICT DO UPDATE SET payload = excluded.payload";
    SET_MONITOR = set_monitor!("VALUES (?1, ?2, ?3, ?4, ?5, ?6)");
    MONITORS = "SELECT site, machine, snapshot, state FROM machine CROSS JOIN monitor USING (machine_row) \
        WHERE (site, machine) > (?1, ?2) ORDER BY site, machine LIMIT ?3";
    MACHINES = concat!("SELECT site, machine FROM machine \
        LEFT JOIN monitor INDEXED BY monitor_state ON monitor.machine_row = machine.machine_row \
        WHERE NOT ", is_absent!(), " ORDER BY site, machine");

    // Alarms.
    ADD_ALARM = "INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6) ON CONFLICT (alarm_id) DO NOTHING";
    ADD_ALARM_EVENT = "INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, payload, known_at_us) \
        SELECT alarm_row, ?2, ?3, ?4, ?5, ?6, ?7 FROM alarm WHERE alarm_id = ?1 ON CONFLICT DO NOTHING";
    // An alarm may be raised and cleared for ever: only its first event and its last events stay.
    TRIM_ALARM_EVENTS = "DELETE FROM alarm_event WHERE alarm_row = (SELECT alarm_row FROM alarm WHERE alarm_id = ?1) \
        AND event_no BETWEEN 2 AND ?2 - ?3";
    SET_ALARM = "UPDATE alarm SET last_event_no = ?2, state = ?3 WHERE alarm_id = ?1 AND last_event_no <= ?2";
    // `+site`: with an index on the site SQLite would prepare the statement again for each pattern. INDEXED BY: without
    // statistics SQLite would read all alarms in the order of time, to avoid sorting the few open ones.
    OPEN_ALARMS = "SELECT payload \
        FROM alarm INDEXED BY alarm_open JOIN machine USING (machine_row) \
        JOIN alarm_event ON alarm_event.alarm_row = alarm.alarm_row AND event_no = last_event_no \
        WHERE alarm.state <> 'normal' AND +site GLOB ?1 AND +machine GLOB ?2 \
        ORDER BY raised_at_us, alarm.alarm_row";
    ALARM_HISTORY = "SELECT payload \
        FROM alarm_event JOIN alarm USING (alarm_row) JOIN machine USING (machine_row) \
        WHERE coalesce(known_at_us, event_at_us) >= ?3 AND +site GLOB ?1 AND +machine GLOB ?2 \
        ORDER BY coalesce(known_at_us, event_at_us) DESC, alarm_row DESC, event_no DESC LIMIT ?4";
    // CROSS JOIN makes SQLite search the few alarms of the machine, instead of all events in the order of time.
    ALARM_HISTORY_OF_MACHINE = "SELECT payload FROM machine \
        CROSS JOIN alarm INDEXED BY alarm_of_machine USING (machine_row) CROSS JOIN alarm_event USING (alarm_row) \
        WHERE +site GLOB ?1 AND machine = ?2 AND coalesce(known_at_us, event_at_us) >= ?3 \
        ORDER BY coalesce(known_at_us, event_at_us) DESC, alarm_row DESC, event_no DESC LIMIT ?4";

    // The outbox.
    ADD_MESSAGE = "INSERT INTO outbox (key, payload, created_at_us) VALUES (?1, ?2, ?3)";
    MESSAGES = "SELECT outbox_row, key, payload FROM outbox WHERE outbox_row > ?1 ORDER BY outbox_row LIMIT ?2";
    DROP_MESSAGES = concat!("DELETE FROM outbox WHERE outbox_row IN ", chosen!());

    // The webhook. Without one, notifications of an earlier start are removed.
    SET_WEBHOOK = "UPDATE webhook SET is_on = ?1; DELETE FROM notification WHERE NOT ?1";
    NOTIFICATIONS = "SELECT notification_row, payload FROM notification ORDER BY notification_row LIMIT ?1";
    NOTIFIED = "DELETE FROM notification WHERE notification_row <= ?1";

    // Quarantine.
    ADD_QUARANTINE = "INSERT INTO quarantine (received_at_us, key, reason, payload_bytes, payload_start, boot_id, throw_no) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)";
    IS_QUARANTINED = "SELECT EXISTS (SELECT 1 FROM quarantine WHERE received_at_us = ?1 AND key = ?2 AND payload_bytes = ?3)";
    TRIM_QUARANTINE = "DELETE FROM quarantine WHERE quarantine_row <= (SELECT max(quarantine_row) FROM quarantine) - ?1";
    ADD_COMMAND = "INSERT INTO command (machine_row, at_us, command, by_whom, why, payload) \
        SELECT ?1, ?2, ?3, ?4, ?5, ?6 \
        WHERE NOT EXISTS (SELECT 1 FROM command WHERE machine_row = ?1 AND at_us = ?2 AND payload = ?6)";
    TRIM_COMMANDS = "DELETE FROM command WHERE command_row <= (SELECT max(command_row) FROM command) - ?1";

    // Health.
    // The newest rows are at the end of the table.
    NEWEST_HEALTH = concat!("SELECT ", history!(), " \
        ORDER BY throw_row DESC LIMIT ?1");
    // An index selects the rows of some machines, or since a time, before the wide rows are read.
    HEALTH_SINCE = concat!("SELECT ", history!(), " \
        WHERE throw_row IN (SELECT throw_row FROM throw \
        WHERE machine_row IN (SELECT machine_row FROM machine WHERE +site GLOB ?2 AND +machine GLOB ?3) \
        AND started_at_us >= ?4 AND throw_row NOT IN (SELECT throw_row FROM throw AS own INDEXED BY throw_pending WHERE judged_at_us IS NULL) \
        ORDER BY throw_row DESC LIMIT ?1) ORDER BY throw_row DESC");
    // A throw of unknown direction (as with an unreadable trace) is left out after a later throw of a known direction.
    LATEST_HEALTH = concat!("SELECT ", health!("nullif(latest.direction, '')", "monitor.state", "monitor.drifts -> 0", "monitor.drifts", "monitor.caveats", "estimate.baseline_throws"), "FROM machine JOIN latest USING (machine_row) \
        JOIN throw USING (throw_row) JOIN estimate USING (throw_row) JOIN boot USING (boot_row) \
        LEFT JOIN monitor ON monitor.machine_row = machine.machine_row \
        WHERE +site GLOB ?1 AND +machine GLOB ?2 AND (latest.direction <> '' OR NOT EXISTS (SELECT 1 FROM latest AS later \
        WHERE later.machine_row = latest.machine_row AND later.direction <> '' AND later.start_us > latest.start_us)) \
        ORDER BY site, machine, latest.direction");
    // A gap that a backlog may still fill is left out while the judge waits for it: while its backlog was opened or
    // last became smaller between ?2 and ?3.
    UNREPORTED_GAPS = concat!("SELECT gap_row, site, machine, first_no, last_no, ",
        "min(", refused!("count(DISTINCT coalesce(quarantine.throw_no, -quarantine_row))"), ", last_no - first_no + 1) AS refused, ", refused!("reason"), " AS reason \
        FROM gap JOIN boot USING (boot_row) JOIN machine USING (machine_row) LEFT JOIN backlog USING (machine_row) \
        WHERE told_at_us IS NULL AND filled_at_us IS NULL AND kind <> 'before_first_contact' \
        AND (written_off_at_us IS NOT NULL OR since_us IS NULL OR since_us NOT BETWEEN ?2 AND ?3) ORDER BY gap_row LIMIT ?1");
    REPORT_GAP = "UPDATE gap SET told_at_us = ?2, refused = ?3 WHERE gap_row = ?1";

    // The dashboard. Each query reads a bounded number of rows.
    OPEN_ALARMS_BY_KIND = "SELECT cause, severity, count(*) AS open, \
            sum(alarm.state IN ('active_unacknowledged', 'active_acknowledged')) AS active \
        FROM alarm JOIN alarm_event ON alarm_event.alarm_row = alarm.alarm_row AND event_no = last_event_no \
        WHERE alarm.state <> 'normal' GROUP BY cause, severity ORDER BY cause, severity";
    DIRECTION_NEWEST = concat!("SELECT ", history!(), " \
        WHERE estimate.machine_row = ", one_machine!(), " \
        AND estimate.direction = ?3 ORDER BY estimate.throw_row DESC LIMIT ?4");
    // Searched in the index of start times: the throws of a baseline may be far behind the newest throw.
    DIRECTION_UNTIL = concat!("SELECT ", history!(), " \
        WHERE estimate.throw_row IN (SELECT throw_row FROM throw WHERE machine_row = ", one_machine!(), " \
        AND started_at_us <= ?5 ORDER BY started_at_us DESC LIMIT 4 * ?4) \
        AND estimate.direction = ?3 ORDER BY estimate.throw_row DESC LIMIT ?4");
    DIRECTION_SPREAD = concat!("WITH RECURSIVE span AS (SELECT \
        (SELECT min(throw_row) FROM estimate WHERE machine_row = ", one_machine!(), " AND direction = ?3) AS low, \
        (SELECT max(throw_row) FROM estimate WHERE machine_row = ", one_machine!(), " AND direction = ?3) AS high), \
        spot(at) AS (SELECT 0 UNION ALL SELECT at + 1 FROM spot WHERE at < ?4 - 1) \
        SELECT DISTINCT ", throw_health!(), "FROM spot CROSS JOIN span JOIN estimate ON estimate.throw_row = (SELECT min(near.throw_row) FROM estimate AS near \
        WHERE near.machine_row = ", one_machine!(), " AND near.direction = ?3 \
        AND near.throw_row >= low + (high - low) * at / max(?4 - 1, 1)) \
        JOIN throw USING (throw_row) JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        ORDER BY estimate.throw_row DESC");
    MACHINE_NEWEST = concat!("SELECT ", history!(), " \
        WHERE estimate.throw_row IN (SELECT * FROM (SELECT throw_row FROM estimate \
        WHERE machine_row = ", one_machine!(), " AND direction = 'normal_to_reverse' ORDER BY throw_row DESC LIMIT ?3) \
        UNION ALL SELECT * FROM (SELECT throw_row FROM estimate \
        WHERE machine_row = ", one_machine!(), " AND direction = 'reverse_to_normal' ORDER BY throw_row DESC LIMIT ?3) \
        UNION ALL SELECT * FROM (SELECT throw_row FROM estimate \
        WHERE machine_row = ", one_machine!(), " AND direction IS NULL ORDER BY throw_row DESC LIMIT ?3)) \
        ORDER BY estimate.throw_row DESC LIMIT ?3");
    MACHINE_ALARM_EVENTS = concat!("SELECT payload FROM alarm_event WHERE alarm_row IN (SELECT alarm_row FROM alarm \
        WHERE machine_row = ", one_machine!(), " ORDER BY raised_at_us DESC LIMIT ?3) \
        ORDER BY event_at_us DESC, alarm_row DESC, event_no DESC LIMIT ?3");
    THROW_AT = concat!("SELECT ", throw_rows!(), " WHERE throw.throw_row = (SELECT throw_row FROM throw JOIN boot USING (boot_row) \
        WHERE boot.machine_row = ", one_machine!(), " AND boot_id = ?3 AND throw_no = ?4)");
    PRUNED_TO = concat!("SELECT pruned_to_no FROM boot WHERE machine_row = ", one_machine!(), " AND boot_id = ?3");
    // The previous and the next throw of a machine, in the order of their start. Without CROSS JOIN SQLite would read
    // all throws of the machine to find one.
    THROW_NEIGHBOURS = "WITH this AS (SELECT throw_row, throw.machine_row, started_at_us FROM machine JOIN boot USING (machine_row) \
        CROSS JOIN throw ON throw.boot_row = boot.boot_row \
        WHERE site = ?1 AND machine = ?2 AND boot_id = ?3 AND throw_no = ?4) \
        SELECT boot_id, throw_no, (throw.started_at_us, throw.throw_row) > (this.started_at_us, this.throw_row) AS is_later \
        FROM this JOIN throw ON throw.throw_row IN ( \
        (SELECT near.throw_row FROM throw AS near WHERE near.machine_row = this.machine_row \
        AND (near.started_at_us, near.throw_row) < (this.started_at_us, this.throw_row) \
        ORDER BY near.started_at_us DESC, near.throw_row DESC LIMIT 1), \
        (SELECT near.throw_row FROM throw AS near WHERE near.machine_row = this.machine_row \
        AND (near.started_at_us, near.throw_row) > (this.started_at_us, this.throw_row) \
        ORDER BY near.started_at_us, near.throw_row LIMIT 1)) \
        JOIN boot USING (boot_row)";
    MOTOR_AT = "SELECT resistance_ohm, back_emf_v_s_per_rad, no_load_speed_rad_per_s FROM estimate WHERE throw_row = ?1";
    HEALTH_AT = concat!("SELECT ", history!(), " \
        WHERE estimate.throw_row = ?1");

    // The fleet page.
    // The matching machines of state ?6, without silent ones if ?7, in the order of states in ?11 (the worst first).
    FLEET = concat!(
    "
    WITH chosen AS (
        SELECT machine_row, site, machine, state, drifts FROM ",
    matching!(),
    "
        WHERE (?6 IS NULL OR state = ?6) AND NOT (?7 AND is_silent)
        ORDER BY instr(?11, state),
                 coalesce(abs(drifts ->> '$[0].change_pct'), 0) DESC, site, machine
        LIMIT ?8 OFFSET ?9)
    SELECT chosen.site, chosen.machine, chosen.state, chosen.drifts, throw.started_at_us, estimate.quality,
           coalesce(estimate.baseline_throws, learned.baseline_throws) AS baseline_throws,
           coalesce(estimate.baseline_needed, learned.baseline_needed) AS baseline_needed,
           (SELECT group_concat(alarm.cause) FROM alarm
             WHERE alarm.machine_row = chosen.machine_row AND alarm.state <> 'normal') AS causes,
           (SELECT group_concat(alarm.cause) FROM alarm
             WHERE alarm.machine_row = chosen.machine_row AND alarm.state = 'cleared_unacknowledged') AS causes_over,
           (SELECT json_group_array(json_array(b0_pct, a1_pct, a0_pct)) FROM
             (SELECT b0_pct, a1_pct, a0_pct FROM estimate AS near
               WHERE near.machine_row = chosen.machine_row AND near.direction = 'normal_to_reverse'
               ORDER BY near.throw_row DESC LIMIT ?10)) AS spark
    FROM chosen
    LEFT JOIN throw ON throw.throw_row = (SELECT throw_row FROM latest WHERE latest.machine_row = chosen.machine_row
                                           ORDER BY throw_row DESC LIMIT 1)
    LEFT JOIN estimate ON estimate.throw_row = throw.throw_row
    LEFT JOIN latest AS near ON near.machine_row = chosen.machine_row AND near.direction = 'normal_to_reverse'
    LEFT JOIN estimate AS learned ON learned.throw_row = near.throw_row"
    );

    // Number of matching machines in each state, and of the silent machines among them.
    STATE_COUNTS = concat!("SELECT state, count(*), sum(is_silent) FROM ", matching!(), " GROUP BY state");

    SITES = "SELECT site FROM machine GROUP BY site ORDER BY site LIMIT ?1";

    // Open alarms about the condition of machines, the worst first.
    FAULTS = "
    SELECT last.payload, first.payload ->> 'change_pct' AS raised_pct, first.payload ->> 'change_pct_sd' AS raised_pct_sd,
           monitor.drifts
    FROM alarm JOIN machine USING (machine_row)
    JOIN alarm_event AS last ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no
    LEFT JOIN alarm_event AS first ON first.alarm_row = alarm.alarm_row AND first.event_no = 1
    LEFT JOIN monitor ON monitor.machine_row = alarm.machine_row
    WHERE alarm.state <> 'normal' AND alarm.cause NOT IN ('not_monitored', 'data_loss') AND NOT (site = ?1 AND machine = ?2)
    ORDER BY alarm.state NOT IN ('active_unacknowledged', 'active_acknowledged'), last.severity = 'critical' DESC,
             raised_at_us DESC, alarm.alarm_row LIMIT ?3";

    FAULT_COUNT = "
    SELECT count(*) FROM alarm JOIN machine USING (machine_row)
    WHERE alarm.state <> 'normal' AND cause NOT IN ('not_monitored', 'data_loss') AND NOT (site = ?1 AND machine = ?2)";

    // The text distinguishes the kinds of data loss. Few machines lose data; a lost link makes thousands not monitored.
    COMMON = "
    SELECT alarm.cause, site, min(machine) AS machine, count(*) AS count, min(raised_at_us) AS first_us, max(raised_at_us) AS last_us,
           CASE alarm.cause WHEN 'data_loss' THEN (SELECT payload ->> 'text' FROM alarm_event AS last
               WHERE last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no) END AS said,
           alarm.state = 'cleared_unacknowledged' AS is_over
    FROM alarm JOIN machine USING (machine_row)
    WHERE alarm.state <> 'normal' AND alarm.cause IN ('not_monitored', 'data_loss') AND NOT (site = ?1 AND machine = ?2)
    GROUP BY alarm.cause, site, said, is_over ORDER BY count(*) DESC";

    // The newest opening command of each machine in maintenance and of each shelved alarm.
    WINDOWS = "
    SELECT site, machine, at_us, command, command.payload ->> 'cause' AS cause, command.payload ->> 'until' AS until,
           by_whom, why
    FROM (SELECT machine_row, 'maintenance_start' AS opened_by, NULL AS of_cause FROM monitor WHERE state = 'maintenance'
          UNION ALL SELECT machine_row, 'shelve', cause FROM alarm INDEXED BY alarm_open
          WHERE state <> 'normal' AND state IN ('shelved', 'out_of_service')) AS open
    JOIN machine USING (machine_row)
    JOIN command ON command_row = (SELECT max(command_row) FROM command AS own INDEXED BY command_of_machine
        WHERE own.machine_row = open.machine_row AND own.command = opened_by AND own.payload ->> 'cause' IS of_cause)
    WHERE (?1 IS NULL OR site = ?1) AND (?2 IS NULL OR machine = ?2)
    ORDER BY site, machine";

    COMMANDS = "
    SELECT at_us, command, payload ->> 'cause' AS cause, payload ->> 'until' AS until, by_whom, why
    FROM command JOIN machine USING (machine_row) WHERE site = ?1 AND machine = ?2 ORDER BY command_row DESC LIMIT ?3";

    BASELINES = "
    SELECT payload FROM baseline JOIN machine USING (machine_row)
    WHERE site = ?1 AND machine = ?2 ORDER BY taken_at_us DESC LIMIT ?3";

    STATE = "
    SELECT state, drifts, caveats FROM monitor JOIN machine USING (machine_row) WHERE site = ?1 AND machine = ?2";

    // The newest good throw of a direction with a trace, up to a time, among the 300 throws before it.
    TYPICAL = "
    SELECT boot_id, throw_no FROM (
        SELECT throw_row, boot_row, throw_no, started_at_us FROM throw JOIN machine USING (machine_row)
        WHERE site = ?1 AND machine = ?2 AND started_at_us <= ?4 ORDER BY started_at_us DESC LIMIT 300)
    JOIN estimate USING (throw_row) JOIN trace USING (throw_row) JOIN boot USING (boot_row)
    WHERE estimate.direction = ?3 AND quality = 'good' ORDER BY started_at_us DESC LIMIT 1";

    // Export.
    EXPORT = export!("TRUE");
    EXPORT_MACHINE = export!(concat!("throw.machine_row = ", one_machine!()));

    // After a rebaseline the latest throws of a machine show that its new baselines have no throws yet. The changes
    // from the old baselines stay in the history.
    RESTART_BASELINES = "UPDATE estimate SET baseline_before = coalesce(baseline_before, baseline_throws), \
        baseline_throws = 0, throws_since_baseline = 0 \
        WHERE baseline_throws IS NOT NULL AND throw_row IN (SELECT throw_row FROM latest WHERE machine_row = ?1)";

    // A retired machine keeps its history, and is not listed any more. Its gaps are not reported.
    RETIRE = "DELETE FROM monitor WHERE machine_row = ?1; DELETE FROM latest WHERE machine_row = ?1; \
        UPDATE gap SET told_at_us = ?2 WHERE told_at_us IS NULL AND boot_row IN (SELECT boot_row FROM boot WHERE machine_row = ?1)";

    // Retention.
    LAST_RECEIVED = "SELECT received_at_us FROM throw ORDER BY throw_row DESC LIMIT 1";
    MOST_TRACES = "SELECT traces AS size, machine_row, traces AS rows FROM machine WHERE traces > 0 \
        ORDER BY size DESC LIMIT ?1";
    MOST_TRACE_BYTES = "SELECT stored_bytes AS size, machine_row, traces AS rows FROM machine WHERE traces > 0 \
        ORDER BY size DESC LIMIT ?1";
    MOST_THROWS = "SELECT throws AS size, machine_row, throws AS rows FROM machine WHERE throws > 0 \
        ORDER BY size DESC LIMIT ?1";
    MOST_THROW_BYTES = "SELECT stored_bytes AS size, machine_row, throws AS rows FROM machine WHERE throws > 0 \
        ORDER BY size DESC LIMIT ?1";
    // Reads only the oldest 4,096 rows: a machine that sends too many throws has mostly pending ones.
    OLDEST_TRACES = "SELECT throw_row FROM (SELECT throw_row, judged_at_us FROM throw JOIN trace USING (throw_row) \
        WHERE machine_row = ?2 AND throw_row >= (SELECT traces_from FROM machine WHERE machine_row = ?2) \
        ORDER BY throw_row LIMIT 4096) WHERE judged_at_us IS NOT NULL LIMIT ?1";
    // Rows are in the order of reception. A time before 2020 (a clock that was not set yet) or after the present time
    // ?4 is not usable: such a trace is as old as the next one with a usable time. No trace after the first young one
    // is aged.
    AGED_TRACES = "SELECT throw_row FROM (SELECT throw_row, judged_at_us FROM trace JOIN throw USING (throw_row) \
        WHERE throw_row <= (SELECT max(throw_row) FROM trace JOIN throw USING (throw_row) \
            WHERE received_at_us >= ?3 AND received_at_us < ?2 AND throw_row < coalesce( \
                (SELECT throw_row FROM trace JOIN throw USING (throw_row) WHERE received_at_us BETWEEN ?2 AND ?4 \
                ORDER BY throw_row LIMIT 1), 9223372036854775807)) \
        ORDER BY throw_row LIMIT 4096) WHERE judged_at_us IS NOT NULL LIMIT ?1";
    DROP_TRACE = "DELETE FROM trace WHERE throw_row = ?1";
    DROP_TRACES = concat!("DELETE FROM trace WHERE throw_row IN ", chosen!());
    TRACES_FROM = concat!("UPDATE machine SET traces_from = last + 1 FROM \
        (SELECT machine_row, max(throw_row) AS last FROM throw WHERE throw_row IN ", chosen!(), " GROUP BY machine_row) AS dropped \
        WHERE machine.machine_row = dropped.machine_row");
    OLDEST_THROWS = "SELECT throw_row FROM (SELECT throw_row, judged_at_us FROM throw WHERE machine_row = ?2 \
        ORDER BY throw_row LIMIT 4096) WHERE judged_at_us IS NOT NULL LIMIT ?1";
    OLDEST_PENDING = "SELECT throw_row FROM throw WHERE machine_row = ?2 AND judged_at_us IS NULL \
        ORDER BY boot_position, throw_no LIMIT ?1";
    MARK_PRUNED = concat!("UPDATE boot SET pruned_to_no = max(pruned_to_no, last_no) FROM \
        (SELECT boot_row, max(throw_no) AS last_no FROM throw WHERE throw_row IN ", chosen!(), " GROUP BY boot_row) AS dropped \
        WHERE boot.boot_row = dropped.boot_row");
    DROP_OLD_GAPS = concat!("DELETE FROM gap WHERE boot_row IN (SELECT boot_row FROM throw WHERE throw_row IN ", chosen!(), ") \
        AND last_no < (SELECT pruned_to_no FROM boot WHERE boot.boot_row = gap.boot_row)");
    DROP_THROWS = concat!("DELETE FROM throw WHERE throw_row IN ", chosen!());
    DROP_EMPTY_BOOTS = "DELETE FROM boot WHERE boot_row IN (SELECT boot_row FROM boot AS old INDEXED BY boot_emptied \
        WHERE pruned_to_no >= highest_no AND NOT EXISTS (SELECT 1 FROM throw WHERE throw.boot_row = old.boot_row) \
        AND position < (SELECT max(position) FROM boot AS newer WHERE newer.machine_row = old.machine_row) \
        AND NOT EXISTS (SELECT 1 FROM backlog WHERE cursor_boot_row = old.boot_row AND backlog.machine_row = old.machine_row) LIMIT 1000)";
    OLDEST_MESSAGES = "SELECT outbox_row FROM outbox ORDER BY outbox_row LIMIT ?1";
    DROP_ALARMS = concat!("DELETE FROM alarm WHERE alarm_row IN ", chosen!());
    OLDEST_ALARMS = "SELECT alarm_row FROM alarm WHERE state = 'normal' ORDER BY raised_at_us LIMIT ?1";
    FIGURES = concat!("SELECT ", figures!(), " FROM machine");
    STATISTICS = concat!("SELECT ", figures!(), ", \
        (SELECT count(*) FROM throw WHERE judged_at_us IS NULL) AS pending, \
        (SELECT count(*) FROM notification) AS notifications, \
        (SELECT count(*) FROM quarantine) AS quarantined, \
        (SELECT CAST(total(min(last_no - first_no + 1, 1099511627776)) AS INTEGER) FROM gap \
        WHERE filled_at_us IS NULL AND kind <> 'before_first_contact') AS missing_throws, \
        (SELECT count(*) FROM alarm WHERE state <> 'normal') AS open_alarms FROM machine");
}
