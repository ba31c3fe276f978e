//! Every statement that the store runs, so that one test can prepare them all against the real schema.

macro_rules! statements {
    ($($name:ident = $sql:literal;)*) => {
        $(pub(super) const $name: &str = $sql;)*

        /// All statements, with their names.
        pub const ALL: &[(&str, &str)] = &[$((stringify!($name), $sql)),*];
    };
}

statements! {
    // Opening and closing.
    FOREIGN_TABLE = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite@_%' ESCAPE '@' \
        AND name <> '_sqlx_migrations' AND NOT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'trace') LIMIT 1";
    CLEAN = "SELECT clean FROM shutdown";
    SET_CLEAN = "UPDATE shutdown SET clean = ?1 WHERE clean <> ?1";
    COUNT = "INSERT INTO counter (name, value) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET value = value + ?2";
    COUNTERS = "SELECT name, value FROM counter ORDER BY name";

    // Spooling.
    MACHINE = "SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2";
    ADD_MACHINE = "INSERT INTO machine (site, machine) VALUES (?1, ?2) RETURNING machine_row";
    BOOT = "SELECT boot_row, highest_no, pruned_to_no FROM boot WHERE machine_row = ?1 AND boot_id = ?2";
    ADD_BOOT = "INSERT INTO boot (machine_row, boot_id, first_seen_us, highest_no) VALUES (?1, ?2, ?3, ?4) RETURNING boot_row";
    COUNTS_FROM_ZERO = "SELECT EXISTS (SELECT 1 FROM boot JOIN throw USING (boot_row) WHERE boot.machine_row = ?1 AND throw_no = 0)";
    SET_HIGHEST = "UPDATE boot SET highest_no = ?2 WHERE boot_row = ?1 AND highest_no < ?2";
    STORED = "SELECT throw_row, content_crc32, received_at_us FROM throw WHERE boot_row = ?1 AND throw_no = ?2";
    ADD_THROW = "INSERT INTO throw (machine_row, boot_row, throw_no, started_at_us, received_at_us, direction, sample_rate_hz, \
        samples, temperature_c, supply_v, anti_alias_hz, content_crc32) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12) RETURNING throw_row";
    ADD_TRACE = "INSERT INTO trace (throw_row, current_codec, current_data, position_codec, position_data, crc32) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6)";

    // Gaps.
    GAP_AT = "SELECT gap_row, first_no, last_no FROM gap \
        WHERE boot_row = ?1 AND first_no <= ?2 AND last_no >= ?2 AND filled_at_us IS NULL";
    ADD_GAP = "INSERT INTO gap (boot_row, first_no, last_no, kind, detected_at_us) VALUES (?1, ?2, ?3, ?4, ?5)";
    SPLIT_GAP = "INSERT INTO gap (boot_row, first_no, last_no, kind, detected_at_us, told_at_us) \
        SELECT boot_row, ?2, last_no, kind, detected_at_us, told_at_us FROM gap WHERE gap_row = ?1";
    SHRINK_GAP = "UPDATE gap SET first_no = ?2, last_no = ?3, recovered = recovered + 1 WHERE gap_row = ?1";
    FILL_GAP = "UPDATE gap SET filled_at_us = ?2, recovered = recovered + 1 WHERE gap_row = ?1";

    // Judging.
    WAITING = "SELECT throw_row, site, machine, boot_id, throw_no, started_at_us, received_at_us, direction, sample_rate_hz, \
        samples, temperature_c, supply_v, anti_alias_hz, current_codec, current_data, position_codec, position_data, crc32 \
        FROM throw JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        LEFT JOIN trace USING (throw_row) \
        WHERE judged_at_us IS NULL AND throw_row > ?1 ORDER BY throw_row LIMIT ?2";
    THROWS = "SELECT throw_row, site, machine, boot_id, throw_no, started_at_us, received_at_us, direction, sample_rate_hz, \
        samples, temperature_c, supply_v, anti_alias_hz, current_codec, current_data, position_codec, position_data, crc32 \
        FROM throw JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        LEFT JOIN trace USING (throw_row) \
        WHERE throw_row > ?1 ORDER BY throw_row LIMIT ?2";
    JUDGED = "UPDATE throw SET judged_at_us = ?2 WHERE throw_row = ?1 AND judged_at_us IS NULL RETURNING machine_row";
    JUDGED_AT = "SELECT judged_at_us FROM throw WHERE throw_row = ?1";
    SINCE_BASELINE = "SELECT throws_since_baseline FROM estimate \
        WHERE machine_row = ?1 AND direction = ?2 AND throw_row < ?3 ORDER BY throw_row DESC LIMIT 1";
    ADD_ESTIMATE = "INSERT INTO estimate (throw_row, machine_row, direction, direction_contradicted, quality, detail, b0, a1, a0, \
        b0_sd, a1_sd, a0_sd, b0_a1_cov, b0_a0_cov, a1_a0_cov, b0_pct, a1_pct, a0_pct, fit_pct, iterations, start_s, end_s, \
        duration_s, peak_current_a, mean_current_a, charge_as, travel_mm, end_position_mm, baseline_throws, \
        baseline_needed, throws_since_baseline) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19, ?20, ?21, ?22, ?23, ?24, \
        ?25, ?26, ?27, ?28, ?29, ?30, ?31)";
    ADD_BASELINE = "INSERT INTO baseline (machine_row, direction, taken_at_us, throws, b0, a1, a0, details, by_whom, why) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10) ON CONFLICT DO NOTHING";
    SET_MONITOR = "INSERT INTO monitor (machine_row, snapshot, updated_at_us) VALUES (?1, ?2, ?3) \
        ON CONFLICT (machine_row) DO UPDATE SET snapshot = excluded.snapshot, updated_at_us = excluded.updated_at_us";
    MONITORS = "SELECT site, machine, snapshot FROM monitor JOIN machine USING (machine_row) ORDER BY site, machine";
    MACHINES = "SELECT site, machine FROM machine ORDER BY site, machine";

    // Alarms.
    ADD_ALARM = "INSERT INTO alarm (alarm_id, machine_row, cause, raised_at_us, last_event_no, state) \
        VALUES (?1, ?2, ?3, ?4, ?5, ?6) ON CONFLICT (alarm_id) DO NOTHING";
    ADD_ALARM_EVENT = "INSERT INTO alarm_event (alarm_row, event_no, event_at_us, severity, state, change_pct, change_pct_sd, \
        direction, runner_up_cause, runner_up_margin, b0_a1, b0_a0, a1_a0, first_boot_id, first_throw_no, last_boot_id, \
        last_throw_no, limit_low, limit_mid, limit_high, text, by_whom, why, payload) \
        SELECT alarm_row, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19, ?20, ?21, ?22, ?23, ?24 \
        FROM alarm WHERE alarm_id = ?1 ON CONFLICT DO NOTHING";
    SET_ALARM = "UPDATE alarm SET last_event_no = ?2, state = ?3 WHERE alarm_id = ?1 AND last_event_no <= ?2";
    OPEN_ALARMS = "SELECT site, machine, alarm_id, event_no, payload \
        FROM alarm JOIN machine USING (machine_row) \
        JOIN alarm_event ON alarm_event.alarm_row = alarm.alarm_row AND event_no = last_event_no \
        WHERE alarm.state <> 'normal' AND (?1 IS NULL OR site = ?1) AND (?2 IS NULL OR machine = ?2) \
        ORDER BY raised_at_us, alarm.alarm_row";
    ALARM_HISTORY = "SELECT site, machine, alarm_id, event_no, payload \
        FROM alarm_event JOIN alarm USING (alarm_row) JOIN machine USING (machine_row) \
        WHERE event_at_us >= ?3 AND (?1 IS NULL OR site = ?1) AND (?2 IS NULL OR machine = ?2) \
        ORDER BY event_at_us DESC, alarm_row DESC, event_no DESC LIMIT ?4";

    // The outbox.
    ADD_MESSAGE = "INSERT INTO outbox (key, payload, created_at_us) VALUES (?1, ?2, ?3)";
    MESSAGES = "SELECT outbox_row, key, payload FROM outbox WHERE outbox_row > ?1 ORDER BY outbox_row LIMIT ?2";
    SENT = "DELETE FROM outbox WHERE outbox_row = ?1";

    // Quarantine.
    ADD_QUARANTINE = "INSERT INTO quarantine (received_at_us, key, reason, payload_bytes, payload_start) VALUES (?1, ?2, ?3, ?4, ?5)";
    TRIM_QUARANTINE = "DELETE FROM quarantine WHERE quarantine_row <= (SELECT max(quarantine_row) FROM quarantine) - ?1";
    QUARANTINE = "SELECT received_at_us, key, reason, payload_bytes, payload_start FROM quarantine ORDER BY quarantine_row DESC LIMIT ?1";
    ADD_COMMAND = "INSERT INTO command (machine_row, at_us, command, by_whom, why, payload) VALUES (?1, ?2, ?3, ?4, ?5, ?6)";
    TRIM_COMMANDS = "DELETE FROM command WHERE command_row <= (SELECT max(command_row) FROM command) - ?1";

    // Health.
    // The newest rows are at the end of the table.
    NEWEST_HEALTH = "SELECT site, machine, boot_id, throw_no, started_at_us, coalesce(estimate.direction, throw.direction) AS direction, \
        quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, peak_current_a, mean_current_a, \
        baseline_throws, baseline_needed, throws_since_baseline \
        FROM estimate JOIN throw USING (throw_row) JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        ORDER BY throw_row DESC LIMIT ?1";
    // Those of some machines, or since a time, are chosen in an index alone before their wide rows are read.
    HEALTH_SINCE = "SELECT site, machine, boot_id, throw_no, started_at_us, coalesce(estimate.direction, throw.direction) AS direction, \
        quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, peak_current_a, mean_current_a, \
        baseline_throws, baseline_needed, throws_since_baseline \
        FROM estimate JOIN throw USING (throw_row) JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        WHERE throw_row IN (SELECT throw_row FROM throw \
        WHERE machine_row IN (SELECT machine_row FROM machine WHERE (?2 IS NULL OR site = ?2) AND (?3 IS NULL OR machine = ?3)) \
        AND started_at_us >= ?4 ORDER BY throw_row DESC LIMIT ?1) ORDER BY throw_row DESC";
    LATEST_HEALTH = "SELECT site, machine, boot_id, throw_no, started_at_us, way.direction AS direction, \
        quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, peak_current_a, mean_current_a, \
        baseline_throws, baseline_needed, throws_since_baseline \
        FROM machine CROSS JOIN (SELECT 'normal_to_reverse' AS direction UNION ALL SELECT 'reverse_to_normal' UNION ALL SELECT NULL) AS way \
        JOIN estimate ON estimate.throw_row = (SELECT max(latest.throw_row) FROM estimate AS latest \
        WHERE latest.machine_row = machine.machine_row AND latest.direction IS way.direction) \
        JOIN throw USING (throw_row) JOIN boot USING (boot_row) \
        WHERE (?1 IS NULL OR site = ?1) AND (?2 IS NULL OR machine = ?2) ORDER BY site, machine, direction";
    GAPS = "SELECT gap_row, site, machine, boot_id, first_no, last_no, kind, detected_at_us \
        FROM gap JOIN boot USING (boot_row) JOIN machine USING (machine_row) \
        WHERE filled_at_us IS NULL ORDER BY gap_row LIMIT ?1";
    UNTOLD_GAPS = "SELECT gap_row, site, machine, boot_id, first_no, last_no, kind, detected_at_us \
        FROM gap JOIN boot USING (boot_row) JOIN machine USING (machine_row) \
        WHERE told_at_us IS NULL AND filled_at_us IS NULL AND kind <> 'before_first_contact' ORDER BY gap_row LIMIT ?1";
    TELL_GAP = "UPDATE gap SET told_at_us = ?2 WHERE gap_row = ?1";

    // The dashboard. Each reads a bounded number of rows, however long the history.
    FLEET_HEALTH = "SELECT site, machine, boot_id, throw_no, started_at_us, way.direction AS direction, \
        quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, peak_current_a, mean_current_a, \
        baseline_throws, baseline_needed, throws_since_baseline \
        FROM (SELECT machine_row, site, machine, coalesce((SELECT max(last.severity = 'critical') + 1 \
        FROM alarm JOIN alarm_event AS last ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no \
        WHERE alarm.machine_row = machine.machine_row AND alarm.state <> 'normal'), 0) AS worst \
        FROM machine ORDER BY worst DESC, site, machine LIMIT ?1) AS shown \
        CROSS JOIN (SELECT 'normal_to_reverse' AS direction UNION ALL SELECT 'reverse_to_normal' UNION ALL SELECT NULL) AS way \
        JOIN estimate ON estimate.throw_row = (SELECT max(latest.throw_row) FROM estimate AS latest \
        WHERE latest.machine_row = shown.machine_row AND latest.direction IS way.direction) \
        JOIN throw USING (throw_row) JOIN boot USING (boot_row) ORDER BY worst DESC, site, machine, way.direction";
    MACHINE_COUNT = "SELECT count(*) FROM machine";
    FLEET_ALARMS = "SELECT site, machine, alarm_id, event_no, payload \
        FROM (SELECT machine_row, coalesce((SELECT max(last.severity = 'critical') + 1 \
        FROM alarm JOIN alarm_event AS last ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no \
        WHERE alarm.machine_row = machine.machine_row AND alarm.state <> 'normal'), 0) AS worst \
        FROM machine ORDER BY worst DESC, site, machine LIMIT ?1) AS shown \
        JOIN alarm ON alarm.machine_row = shown.machine_row JOIN machine ON machine.machine_row = shown.machine_row \
        JOIN alarm_event ON alarm_event.alarm_row = alarm.alarm_row AND event_no = last_event_no \
        WHERE alarm.state <> 'normal' ORDER BY severity = 'critical' DESC, raised_at_us DESC, alarm.alarm_row DESC";
    OPEN_ALARMS_BY_KIND = "SELECT cause, severity, count(*) FROM active_alarms GROUP BY cause, severity ORDER BY cause, severity";
    WAY_NEWEST = "SELECT site, machine, boot_id, throw_no, started_at_us, coalesce(estimate.direction, throw.direction) AS direction, \
        quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, peak_current_a, mean_current_a, \
        baseline_throws, baseline_needed, throws_since_baseline \
        FROM estimate JOIN throw USING (throw_row) JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        WHERE estimate.machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) \
        AND estimate.direction = ?3 ORDER BY estimate.throw_row DESC LIMIT ?4";
    WAY_SPREAD = "WITH RECURSIVE span AS (SELECT \
        (SELECT min(throw_row) FROM estimate WHERE machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) AND direction = ?3) AS low, \
        (SELECT max(throw_row) FROM estimate WHERE machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) AND direction = ?3) AS high), \
        spot(at) AS (SELECT 0 UNION ALL SELECT at + 1 FROM spot WHERE at < ?4 - 1) \
        SELECT DISTINCT site, machine, boot_id, throw_no, started_at_us, coalesce(estimate.direction, throw.direction) AS direction, \
        quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, peak_current_a, mean_current_a, \
        baseline_throws, baseline_needed, throws_since_baseline \
        FROM spot CROSS JOIN span JOIN estimate ON estimate.throw_row = (SELECT min(near.throw_row) FROM estimate AS near \
        WHERE near.machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) AND near.direction = ?3 \
        AND near.throw_row >= low + (high - low) * at / max(?4 - 1, 1)) \
        JOIN throw USING (throw_row) JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        ORDER BY estimate.throw_row DESC";
    MACHINE_NEWEST = "SELECT site, machine, boot_id, throw_no, started_at_us, coalesce(estimate.direction, throw.direction) AS direction, \
        quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, peak_current_a, mean_current_a, \
        baseline_throws, baseline_needed, throws_since_baseline \
        FROM estimate JOIN throw USING (throw_row) JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        WHERE estimate.throw_row IN (SELECT * FROM (SELECT throw_row FROM estimate \
        WHERE machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) AND direction = 'normal_to_reverse' ORDER BY throw_row DESC LIMIT ?3) \
        UNION ALL SELECT * FROM (SELECT throw_row FROM estimate \
        WHERE machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) AND direction = 'reverse_to_normal' ORDER BY throw_row DESC LIMIT ?3) \
        UNION ALL SELECT * FROM (SELECT throw_row FROM estimate \
        WHERE machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) AND direction IS NULL ORDER BY throw_row DESC LIMIT ?3)) \
        ORDER BY estimate.throw_row DESC LIMIT ?3";
    MACHINE_ALARM_EVENTS = "SELECT payload, by_whom, why FROM alarm_event WHERE alarm_row IN (SELECT alarm_row FROM alarm \
        WHERE machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) ORDER BY raised_at_us DESC LIMIT ?3) \
        ORDER BY event_at_us DESC, alarm_row DESC, event_no DESC LIMIT ?3";
    THROW_AT = "SELECT throw_row, site, machine, boot_id, throw_no, started_at_us, received_at_us, direction, sample_rate_hz, \
        samples, temperature_c, supply_v, anti_alias_hz, current_codec, current_data, position_codec, position_data, crc32 \
        FROM throw JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        LEFT JOIN trace USING (throw_row) WHERE throw.throw_row = (SELECT throw_row FROM throw JOIN boot USING (boot_row) \
        WHERE boot.machine_row = (SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2) AND boot_id = ?3 AND throw_no = ?4)";
    HEALTH_AT = "SELECT site, machine, boot_id, throw_no, started_at_us, coalesce(estimate.direction, throw.direction) AS direction, \
        quality, detail, b0, a1, a0, b0_sd, a1_sd, a0_sd, b0_pct, a1_pct, a0_pct, fit_pct, duration_s, peak_current_a, mean_current_a, \
        baseline_throws, baseline_needed, throws_since_baseline \
        FROM estimate JOIN throw USING (throw_row) JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
        WHERE estimate.throw_row = ?1";

    // Retention.
    LAST_HEARD = "SELECT received_at_us FROM throw ORDER BY throw_row DESC LIMIT 1";
    OLDEST_TRACES = "SELECT throw_row FROM trace JOIN throw USING (throw_row) WHERE judged_at_us IS NOT NULL ORDER BY throw_row LIMIT ?1";
    AGED_TRACES = "SELECT throw_row FROM trace JOIN throw USING (throw_row) \
        WHERE judged_at_us IS NOT NULL AND received_at_us < ?2 ORDER BY throw_row LIMIT ?1";
    DROP_TRACE = "DELETE FROM trace WHERE throw_row = ?1";
    OLDEST_THROWS = "SELECT throw_row FROM throw WHERE judged_at_us IS NOT NULL ORDER BY throw_row LIMIT ?1";
    MARK_PRUNED = "UPDATE boot SET pruned_to_no = max(pruned_to_no, (SELECT throw_no FROM throw WHERE throw_row = ?1)) \
        WHERE boot_row = (SELECT boot_row FROM throw WHERE throw_row = ?1)";
    DROP_OLD_GAPS = "DELETE FROM gap WHERE boot_row = (SELECT boot_row FROM throw WHERE throw_row = ?1) \
        AND last_no < (SELECT throw_no FROM throw WHERE throw_row = ?1)";
    DROP_EMPTY_BOOTS = "DELETE FROM boot WHERE boot_row IN (SELECT boot_row FROM boot AS old ORDER BY boot_row LIMIT 1000) \
        AND NOT EXISTS (SELECT 1 FROM throw WHERE throw.boot_row = boot.boot_row) \
        AND boot_row < (SELECT max(boot_row) FROM boot AS newer WHERE newer.machine_row = boot.machine_row)";
    OLDEST_TRACE_TIME = "SELECT received_at_us FROM trace JOIN throw USING (throw_row) WHERE judged_at_us IS NOT NULL \
        ORDER BY throw_row LIMIT 1";
    OLDEST_MESSAGES = "SELECT outbox_row FROM outbox ORDER BY outbox_row LIMIT ?1";
    DROP_THROW = "DELETE FROM throw WHERE throw_row = ?1";
    DROP_ALARM = "DELETE FROM alarm WHERE alarm_row = ?1";
    OLDEST_ALARMS = "SELECT alarm_row FROM alarm WHERE state = 'normal' ORDER BY raised_at_us LIMIT ?1";
    CLOSED_ALARMS = "SELECT count(*) FROM alarm WHERE state = 'normal'";
    // Rows are dense, so that the distance from the oldest that may go counts them without reading them.
    TRACE_SPAN = "SELECT coalesce((SELECT max(throw_row) FROM trace) - (SELECT throw_row FROM trace JOIN throw USING (throw_row) \
        WHERE judged_at_us IS NOT NULL ORDER BY throw_row LIMIT 1) + 1, 0)";
    THROW_SPAN = "SELECT coalesce((SELECT max(throw_row) FROM throw) - (SELECT throw_row FROM throw \
        WHERE judged_at_us IS NOT NULL ORDER BY throw_row LIMIT 1) + 1, 0)";
    WAITING_COUNT = "SELECT count(*) FROM throw WHERE judged_at_us IS NULL";
    OUTBOX_COUNT = "SELECT count(*) FROM outbox";
    QUARANTINE_COUNT = "SELECT count(*) FROM quarantine";
    OPEN_GAP_COUNT = "SELECT CAST(total(last_no - first_no + 1) AS INTEGER) FROM gap WHERE filled_at_us IS NULL AND kind <> 'before_first_contact'";
    OPEN_ALARM_COUNT = "SELECT count(*) FROM alarm WHERE state <> 'normal'";
}
