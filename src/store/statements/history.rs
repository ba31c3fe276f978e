//! Throws, health and alarms of some machines, for queries on zenoh, the pages of a machine and a throw, and the export.

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
             travel_mm, start_position_mm, end_position_mm, quiet_current_a, resistance_ohm, back_emf_v_s_per_rad, \
             no_load_speed_rad_per_s, start_delay_s, start_gain, iterations, start_s, end_s, estimate.state AS state, \
             started_at_us \
             FROM throw JOIN boot USING (boot_row) JOIN machine ON machine.machine_row = throw.machine_row \
             LEFT JOIN estimate USING (throw_row) \
             WHERE ", $condition, " AND (started_at_us, throw_row) > (?3, ?4) AND started_at_us < ?5 \
             ORDER BY started_at_us, throw_row LIMIT ?6"
        )
    };
}

statements! {
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
    // Chosen as in MACHINE_NEWEST, below.
    DIRECTION_NEWEST = concat!("SELECT ", history!(), " \
        WHERE estimate.throw_row IN (SELECT throw_row FROM (SELECT throw_row, boot_row, throw_no \
        FROM estimate AS own CROSS JOIN throw USING (throw_row) \
        WHERE own.machine_row = ", one_machine!(), " AND own.direction = ?3 ORDER BY own.throw_row DESC LIMIT 4 * ?4) \
        ORDER BY max(throw_row) OVER (PARTITION BY boot_row) DESC, throw_no DESC LIMIT ?4) \
        ORDER BY estimate.throw_row DESC");
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
    // The newest throws, chosen among four times as many. Throws from a backlog arrive after newer ones of their boot, so
    // the throws of a boot are in the order of their numbers. The boots are in the order in which their last throws
    // arrived: a logger continues its boot after an import of recordings, which are another boot.
    MACHINE_NEWEST = concat!("SELECT ", history!(), " \
        WHERE estimate.throw_row IN (SELECT throw_row FROM (SELECT throw_row, boot_row, throw_no \
        FROM throw INDEXED BY throw_of_machine CROSS JOIN estimate USING (throw_row) \
        WHERE throw.machine_row = ", one_machine!(), " ORDER BY throw_row DESC LIMIT 4 * ?3) \
        ORDER BY max(throw_row) OVER (PARTITION BY boot_row) DESC, throw_no DESC LIMIT ?3) \
        ORDER BY max(estimate.throw_row) OVER (PARTITION BY throw.boot_row) DESC, throw_no DESC");
    MACHINE_ALARM_EVENTS = concat!("SELECT payload FROM alarm_event WHERE alarm_row IN (SELECT alarm_row FROM alarm \
        WHERE machine_row = ", one_machine!(), " ORDER BY raised_at_us DESC LIMIT ?3) \
        ORDER BY event_at_us DESC, alarm_row DESC, event_no DESC LIMIT ?3");
    THROW_AT = concat!("SELECT ", throw_rows!(), " WHERE throw.throw_row = (SELECT throw_row FROM throw JOIN boot USING (boot_row) \
        WHERE boot.machine_row = ", one_machine!(), " AND boot_id = ?3 AND throw_no = ?4)");
    IS_PRUNED = concat!("SELECT ?4 <= pruned_to_no FROM boot WHERE machine_row = ", one_machine!(), " AND boot_id = ?3");
    HEALTH_AT = concat!("SELECT ", history!(), " \
        WHERE estimate.throw_row = ?1");
    MOTOR_AT = "SELECT resistance_ohm, back_emf_v_s_per_rad, no_load_speed_rad_per_s FROM estimate WHERE throw_row = ?1";
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
    // The newest good throw of a direction with a trace, up to a time, among the 300 throws before it; without a good one,
    // as of a machine without a toe sensor, the newest accepted one.
    TYPICAL = concat!("SELECT ", throw_rows!(), " WHERE throw.throw_row = (SELECT throw_row FROM ( \
        SELECT throw_row, started_at_us FROM throw WHERE machine_row = ", one_machine!(), " \
        AND started_at_us <= ?4 ORDER BY started_at_us DESC LIMIT 300) \
        JOIN estimate USING (throw_row) JOIN trace USING (throw_row) \
        WHERE estimate.direction = ?3 AND quality IN ('good', 'rough', 'current_only') \
        ORDER BY quality = 'good' DESC, started_at_us DESC LIMIT 1)");
    // Whether a machine has a throw, an alarm or a monitor.
    IS_KNOWN = concat!("SELECT EXISTS (SELECT 1 FROM throw WHERE machine_row = ", one_machine!(), ") \
        OR EXISTS (SELECT 1 FROM alarm WHERE machine_row = ", one_machine!(), ") \
        OR EXISTS (SELECT 1 FROM monitor WHERE machine_row = ", one_machine!(), ")");
    COMMANDS = "
    SELECT at_us, command, payload ->> 'cause' AS cause, payload ->> 'until' AS until, by_whom, why
    FROM command JOIN machine USING (machine_row) WHERE site = ?1 AND machine = ?2 ORDER BY command_row DESC LIMIT ?3";
    BASELINES = "
    SELECT payload FROM baseline JOIN machine USING (machine_row)
    WHERE site = ?1 AND machine = ?2 ORDER BY taken_at_us DESC LIMIT ?3";
    STATE = "
    SELECT state, drifts, caveats FROM monitor JOIN machine USING (machine_row) WHERE site = ?1 AND machine = ?2";

    // Export.
    EXPORT = export!("TRUE");
    EXPORT_MACHINE = export!(concat!("throw.machine_row = ", one_machine!()));
}
