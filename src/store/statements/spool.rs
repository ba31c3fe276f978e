//! Storing of received throws: machines, boots, gaps, the backlogs of the loggers, and messages that are no throws.

/// Columns and table of a query of boots, for [`Boot`](crate::store::writer::cursor::Boot).
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

statements! {
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
    LATEST_START = "SELECT started_at_us FROM throw WHERE boot_row = ?1 ORDER BY throw_no DESC LIMIT 1";
    STORED = "SELECT throw_row, content_crc32, received_at_us FROM throw WHERE boot_row = ?1 AND throw_no = ?2";
    // Statements with one row of `?`: see the module `batch`.
    // Throws that are later than all stored ones of their boot and do not move the cursor of their machine. The next number
    // moves a cursor at the end of its boot. A gap before the throw keeps the cursor there. A boot whose highest number is 0
    // may be new, and then has no throw before the gap.
    NEXT_THROWS = concat!("WITH new (at, site, machine, boot_id, throw_no) AS (VALUES (?, ?, ?, ?, ?)) \
        SELECT json_group_array(json_array(at, machine_row, boot_row, position, highest_no)) \
        FROM new CROSS JOIN machine USING (site, machine) CROSS JOIN boot USING (machine_row, boot_id) \
        WHERE highest_no BETWEEN 1 AND throw_no - 2 OR highest_no = throw_no - 1 \
        AND NOT EXISTS (SELECT 1 FROM backlog WHERE backlog.machine_row = machine.machine_row \
        AND cursor_boot_row = boot.boot_row \
        AND NOT EXISTS (SELECT 1 FROM gap WHERE gap.boot_row = boot.boot_row AND ", awaited!(), "))");
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
    // With one row of `?`: see the module `batch`.
    ADD_GAPS = "INSERT INTO gap (boot_row, first_no, last_no, kind, detected_at_us) \
        SELECT * FROM (VALUES (?, ?, ?, ?, ?)) WHERE column1 IS NOT NULL";
    SPLIT_GAP = "INSERT INTO gap (boot_row, first_no, last_no, kind, detected_at_us, told_at_us, written_off_at_us) \
        SELECT boot_row, ?2, last_no, kind, detected_at_us, told_at_us, written_off_at_us FROM gap WHERE gap_row = ?1";
    SHRINK_GAP = "UPDATE gap SET first_no = ?2, last_no = ?3, recovered = recovered + 1 WHERE gap_row = ?1";
    FILL_GAP = "UPDATE gap SET filled_at_us = ?2, recovered = recovered + 1 WHERE gap_row = ?1";

    // The backlog.
    // With one row of `?`: see the module `batch`.
    OPEN_BACKLOGS = "INSERT INTO backlog (machine_row, cursor_boot_row, cursor_position, cursor_no, since_us) \
        SELECT * FROM (VALUES (?, ?, ?, ?, ?)) WHERE column1 IS NOT NULL ON CONFLICT DO NOTHING";
    BACKLOG = "SELECT cursor_boot_row AS boot_row, cursor_position AS position, cursor_no AS throw_no FROM backlog \
        WHERE machine_row = ?1";
    MOVE_CURSOR = "UPDATE backlog SET cursor_boot_row = ?2, cursor_position = ?3, cursor_no = ?4, since_us = ?5 WHERE machine_row = ?1";
    RENEW_BACKLOGS = "UPDATE backlog SET since_us = ?1";
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

    // Quarantine.
    ADD_QUARANTINE = "INSERT INTO quarantine (received_at_us, key, reason, payload_bytes, payload_start, boot_id, throw_no) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)";
    IS_QUARANTINED = "SELECT EXISTS (SELECT 1 FROM quarantine WHERE received_at_us = ?1 AND key = ?2 AND payload_bytes = ?3)";
    // The oldest messages of the keys with the most: a flood from one machine removes its own messages only. As all
    // messages are sorted for this, it also removes a 64th of the bound, and then has nothing to do for some time.
    TRIM_QUARANTINE = "DELETE FROM quarantine WHERE quarantine_row IN (SELECT quarantine_row FROM ( \
        SELECT quarantine_row, row_number() OVER (PARTITION BY key ORDER BY quarantine_row DESC) AS newest \
        FROM quarantine INDEXED BY quarantine_by_key WHERE (SELECT count(*) FROM quarantine) > ?1) \
        ORDER BY newest DESC, quarantine_row LIMIT (SELECT count(*) FROM quarantine) - ?1 + ?1 / 64)";
    // The last reason of each key, those with the most messages first. A key is left out if its machine sent a throw, or was
    // retired, after its last message. Without the CAST the key has no type, and SQLite builds no index on it. The bound
    // keeps the time of the query below 60 ms, also with 20,000 machines.
    LAST_REFUSED = "WITH refused AS (SELECT key, reason, max(received_at_us) AS at_us, count(*) AS messages FROM ( \
        SELECT key, reason, received_at_us FROM quarantine ORDER BY quarantine_row DESC LIMIT 10000) GROUP BY key), \
        named AS MATERIALIZED (SELECT CAST('points/v1/' || site || '/' || machine || '/throw' AS TEXT) AS key, machine_row \
        FROM machine) \
        SELECT key, reason, at_us FROM refused LEFT JOIN named USING (key) \
        WHERE at_us > coalesce((SELECT received_at_us FROM throw INDEXED BY throw_of_machine \
        WHERE throw.machine_row = named.machine_row ORDER BY throw_row DESC LIMIT 1), 0) \
        AND at_us > coalesce((SELECT command.at_us FROM command INDEXED BY command_of_machine \
        WHERE command.machine_row = named.machine_row AND command = 'retire' ORDER BY command_row DESC LIMIT 1), 0) \
        ORDER BY messages DESC, at_us DESC";
}
