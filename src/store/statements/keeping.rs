//! The start and end of the daemon, retention, and the statistics of the database.

/// The row numbers in the JSON list ?1.
macro_rules! chosen {
    () => {
        "(SELECT value FROM json_each(?1))"
    };
}

/// The columns of [`Statistics`](crate::store::Statistics) that are fast enough for every second.
macro_rules! figures {
    () => {
        "coalesce(sum(traces), 0) AS traces, coalesce(sum(throws), 0) AS throws, \
         (SELECT count(*) FROM alarm WHERE state = 'normal') AS closed_alarms, (SELECT count(*) FROM outbox) AS outbox, \
         (SELECT (page_count - freelist_count) * page_size FROM pragma_page_count, pragma_freelist_count, pragma_page_size) \
         AS data_bytes, (SELECT freelist_count * page_size FROM pragma_freelist_count, pragma_page_size) AS free_bytes, \
         (SELECT json_group_object(name, value) FROM counter) AS counters"
    };
}

statements! {
    // Opening and closing.
    FOREIGN_TABLE = "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite@_%' ESCAPE '@' \
        AND name <> '_sqlx_migrations' AND NOT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = 'trace') LIMIT 1";
    CLEAN = "SELECT clean FROM shutdown";
    FILE_BYTES = "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size";
    SET_CLEAN = "UPDATE shutdown SET clean = ?1 WHERE clean <> ?1";

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
    // is aged. Reads one row, as it runs every second, or the oldest 4,096 if that one is not young.
    AGED_TRACES = "WITH oldest AS MATERIALIZED (SELECT throw_row, received_at_us, judged_at_us \
        FROM trace JOIN throw USING (throw_row) ORDER BY throw_row \
        LIMIT CASE WHEN (SELECT received_at_us BETWEEN ?2 AND ?4 FROM trace JOIN throw USING (throw_row) \
        ORDER BY throw_row LIMIT 1) THEN 0 ELSE 4096 END) \
        SELECT throw_row FROM oldest WHERE judged_at_us IS NOT NULL AND throw_row <= (SELECT max(throw_row) FROM oldest \
            WHERE received_at_us >= ?3 AND received_at_us < ?2 AND throw_row < coalesce( \
                (SELECT min(throw_row) FROM oldest WHERE received_at_us BETWEEN ?2 AND ?4), 9223372036854775807)) LIMIT ?1";
    DROP_TRACES = concat!("DELETE FROM trace WHERE throw_row IN ", chosen!());
    // The traces of pending throws before the dropped ones stay, and are dropped later.
    TRACES_FROM = concat!("UPDATE machine SET traces_from = min(last + 1, coalesce((SELECT min(throw_row) \
        FROM throw INDEXED BY throw_pending WHERE throw.machine_row = machine.machine_row AND judged_at_us IS NULL), last + 1)) FROM \
        (SELECT machine_row, max(throw_row) AS last FROM throw WHERE throw_row IN ", chosen!(), " GROUP BY machine_row) AS dropped \
        WHERE machine.machine_row = dropped.machine_row");
    OLDEST_THROWS = "SELECT throw_row FROM (SELECT throw_row, judged_at_us FROM throw WHERE machine_row = ?2 \
        ORDER BY throw_row LIMIT 4096) WHERE judged_at_us IS NOT NULL LIMIT ?1";
    OLDEST_PENDING = "SELECT throw_row FROM throw WHERE machine_row = ?2 AND judged_at_us IS NULL \
        ORDER BY boot_position, throw_no LIMIT ?1";
    MARK_PRUNED = concat!("UPDATE boot SET pruned_to_no = max(pruned_to_no, last_no) FROM \
        (SELECT boot_row, max(throw_no) AS last_no FROM throw WHERE throw_row IN ", chosen!(), " GROUP BY boot_row) AS dropped \
        WHERE boot.boot_row = dropped.boot_row");
    // Only gaps before all throws that are left: throws of a later gap may still arrive, and would count as deleted.
    DROP_OLD_GAPS = concat!("DELETE FROM gap WHERE boot_row IN (SELECT boot_row FROM throw WHERE throw_row IN ", chosen!(), ") \
        AND last_no < (SELECT throw_no FROM throw WHERE throw.boot_row = gap.boot_row AND throw_row NOT IN ", chosen!(), " \
        ORDER BY throw_no LIMIT 1)");
    DROP_THROWS = concat!("DELETE FROM throw WHERE throw_row IN ", chosen!());
    DROP_EMPTY_BOOTS = "DELETE FROM boot WHERE boot_row IN (SELECT boot_row FROM boot AS old INDEXED BY boot_emptied \
        WHERE pruned_to_no >= highest_no AND NOT EXISTS (SELECT 1 FROM throw WHERE throw.boot_row = old.boot_row) \
        AND position < (SELECT max(position) FROM boot AS newer WHERE newer.machine_row = old.machine_row) \
        AND NOT EXISTS (SELECT 1 FROM backlog WHERE cursor_boot_row = old.boot_row AND backlog.machine_row = old.machine_row) LIMIT 1000)";
    OLDEST_MESSAGES = "SELECT outbox_row FROM outbox ORDER BY outbox_row LIMIT ?1";
    DROP_MESSAGES = concat!("DELETE FROM outbox WHERE outbox_row IN ", chosen!());
    OLDEST_ALARMS = "SELECT alarm_row FROM alarm WHERE state = 'normal' ORDER BY raised_at_us LIMIT ?1";
    DROP_ALARMS = concat!("DELETE FROM alarm WHERE alarm_row IN ", chosen!());
    FIGURES = concat!("SELECT ", figures!(), " FROM machine");
    STATISTICS = concat!("SELECT ", figures!(), ", \
        (SELECT count(*) FROM throw WHERE judged_at_us IS NULL) AS pending, \
        (SELECT count(*) FROM notification) AS notifications, \
        (SELECT count(*) FROM quarantine) AS quarantined, \
        (SELECT CAST(total(min(last_no - first_no + 1, 1099511627776)) AS INTEGER) FROM gap \
        WHERE filled_at_us IS NULL AND kind <> 'before_first_contact' \
        AND (written_off_at_us IS NOT NULL OR told_at_us IS NOT NULL)) AS missing_throws FROM machine");
}
