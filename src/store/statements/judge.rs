//! Judging: pending throws, estimates, monitors, alarm events, operators' commands, and messages to publish.

/// Messages in quarantine that may be throws of a row of `due`. `$select`: the columns; `$which`: `numbered` for messages
/// with a number in the gap, `unread` for messages without a readable number that arrived after the throw before the gap.
macro_rules! refused {
    ($select:literal, numbered) => {
        concat!(
            "SELECT ",
            $select,
            " FROM quarantine INDEXED BY quarantine_by_throw WHERE quarantine.key = due.key \
             AND throw_no BETWEEN first_no AND last_no AND quarantine.boot_id = due.boot_id"
        )
    };
    ($select:literal, unread) => {
        concat!(
            "SELECT ",
            $select,
            " FROM quarantine INDEXED BY quarantine_by_throw WHERE quarantine.key = due.key \
             AND throw_no IS NULL AND received_at_us >= after_us"
        )
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

statements! {
    // Takes machines with pending throws in turn, after a given machine, and from each its first throws that
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
    // By the latest time of a throw and those before it, as the clock may have been set back between two of them.
    JUDGED_ORDER = "SELECT throw_row FROM throw NOT INDEXED ORDER BY judged_at_us IS NULL, \
        max(judged_at_us) OVER (PARTITION BY machine_row ORDER BY boot_position, throw_no), \
        machine_row, boot_position, throw_no";
    THROWS = concat!("SELECT ", throw_rows!(), " \
        WHERE throw_row > ?1 ORDER BY throw_row LIMIT ?2");
    MACHINE_OF = "SELECT machine_row FROM throw WHERE throw_row = ?1";
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
    // A gap that a backlog may still fill is left out while the judge waits for it: while its backlog was opened or
    // last became smaller between ?2 and ?3. Of the messages without a number at most 1,000 are counted, so that the
    // time of the query does not grow with the quarantine.
    UNREPORTED_GAPS = concat!("WITH due AS MATERIALIZED (SELECT gap_row, site, machine, boot_id, first_no, last_no, \
        'points/v1/' || site || '/' || machine || '/throw' AS key, \
        coalesce((SELECT received_at_us FROM throw WHERE throw.boot_row = gap.boot_row AND throw.throw_no < first_no \
        ORDER BY throw.throw_no DESC LIMIT 1), 0) AS after_us \
        FROM gap JOIN boot USING (boot_row) JOIN machine USING (machine_row) LEFT JOIN backlog USING (machine_row) \
        WHERE told_at_us IS NULL AND filled_at_us IS NULL AND kind <> 'before_first_contact' \
        AND (written_off_at_us IS NOT NULL OR since_us IS NULL OR since_us NOT BETWEEN ?2 AND ?3) ORDER BY gap_row LIMIT ?1 + 0) \
        SELECT gap_row, site, machine, first_no, last_no, min(last_no - first_no + 1, (", refused!("count(DISTINCT throw_no)", numbered), ") + \
        (SELECT count(*) FROM (", refused!("1", unread), " LIMIT 1000))) AS refused, \
        (SELECT reason FROM (SELECT * FROM (", refused!("quarantine_row, reason", numbered), " ORDER BY quarantine_row DESC LIMIT 1) \
        UNION ALL SELECT * FROM (", refused!("quarantine_row, reason", unread), " ORDER BY received_at_us DESC LIMIT 1)) \
        ORDER BY quarantine_row DESC LIMIT 1) AS reason FROM due ORDER BY gap_row");
    REPORT_GAP = "UPDATE gap SET told_at_us = ?2, refused = ?3 WHERE gap_row = ?1";

    // Alarms.
    ADD_ALARM = "INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6) ON CONFLICT (alarm_id) DO NOTHING";
    ADD_ALARM_EVENT = "INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, payload, known_at_us) \
        SELECT alarm_row, ?2, ?3, ?4, ?5, ?6, ?7 FROM alarm WHERE alarm_id = ?1 ON CONFLICT DO NOTHING";
    // An alarm may be raised and cleared for ever: only its first event and its last events stay.
    TRIM_ALARM_EVENTS = "DELETE FROM alarm_event WHERE alarm_row = (SELECT alarm_row FROM alarm WHERE alarm_id = ?1) \
        AND event_no BETWEEN 2 AND ?2 - ?3";
    SET_ALARM = "UPDATE alarm SET last_event_no = ?2, state = ?3 WHERE alarm_id = ?1 AND last_event_no <= ?2";

    // Commands of operators.
    ADD_COMMAND = "INSERT INTO command (machine_row, at_us, command, by_whom, why, payload) \
        SELECT ?1, ?2, ?3, ?4, ?5, ?6 \
        WHERE NOT EXISTS (SELECT 1 FROM command WHERE machine_row = ?1 AND at_us = ?2 AND payload = ?6)";
    TRIM_COMMANDS = "DELETE FROM command WHERE command_row <= (SELECT max(command_row) FROM command) - ?1";
    // After a rebaseline the latest throws of a machine show that its new baselines have no throws yet. The changes
    // from the old baselines stay in the history.
    RESTART_BASELINES = "UPDATE estimate SET baseline_before = coalesce(baseline_before, baseline_throws), \
        baseline_throws = 0, throws_since_baseline = 0 \
        WHERE baseline_throws IS NOT NULL AND throw_row IN (SELECT throw_row FROM latest WHERE machine_row = ?1)";
    // A retired machine keeps its history, and is not listed any more. Its gaps are not reported, and its missing throws
    // are not awaited any longer.
    RETIRE = "DELETE FROM monitor WHERE machine_row = ?1; DELETE FROM latest WHERE machine_row = ?1; \
        UPDATE gap SET told_at_us = coalesce(told_at_us, ?2), written_off_at_us = coalesce(written_off_at_us, ?2) \
        WHERE filled_at_us IS NULL AND boot_row IN (SELECT boot_row FROM boot WHERE machine_row = ?1); \
        UPDATE boot SET tail_open = 0 WHERE machine_row = ?1; DELETE FROM backlog WHERE machine_row = ?1";

    // The outbox.
    ADD_MESSAGE = "INSERT INTO outbox (key, payload, created_at_us) VALUES (?1, ?2, ?3)";
    MESSAGES = "SELECT outbox_row, key, payload FROM outbox WHERE outbox_row > ?1 ORDER BY outbox_row LIMIT ?2";

    // The webhook. Without one, notifications of an earlier start are removed.
    SET_WEBHOOK = "UPDATE webhook SET is_on = ?1; DELETE FROM notification WHERE NOT ?1";
    NOTIFICATIONS = "SELECT notification_row, payload FROM notification WHERE notification_row > ?1 \
        ORDER BY notification_row LIMIT ?2";
    NOTIFIED = "DELETE FROM notification WHERE notification_row <= ?1";
}
