//! The page of the fleet. Each query reads a bounded number of rows.

macro_rules! all_machines {
    () => {
        "all-machines"
    };
}

/// Machine name of the alarms about all machines of a site.
pub(crate) const ALL_MACHINES: &str = all_machines!();

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

/// Open alarms with the size in their first event, the worst first, and the number of all that match `$condition`.
macro_rules! faults {
    ($condition:literal) => {
        concat!(
            "SELECT last.payload, first.payload ->> 'change_pct' AS raised_pct, first.payload ->> 'change_pct_sd' AS raised_pct_sd,
                 monitor.drifts, count(*) OVER () AS total
             FROM alarm JOIN machine USING (machine_row)
             JOIN alarm_event AS last ON last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no
             LEFT JOIN alarm_event AS first ON first.alarm_row = alarm.alarm_row AND first.event_no = 1
             LEFT JOIN monitor ON monitor.machine_row = alarm.machine_row
             WHERE alarm.state <> 'normal' AND ",
            $condition,
            " ORDER BY alarm.state NOT IN ('active_unacknowledged', 'active_acknowledged'), last.severity = 'critical' DESC,
                 raised_at_us DESC, alarm.alarm_row LIMIT ?3"
        )
    };
}

statements! {
    // The matching machines of state ?6, in the order of the words in ?10 (the worst first): the states, and "silent", as
    // the silent machines after the loss of a link would push machines with faults out of sight. The throws of a machine
    // are in its own order, as throws from its backlog arrive after newer ones. They are those of the worst drift's
    // direction, or else from normal to reverse if the machine has such throws.
    FLEET = concat!(
    "
    WITH chosen AS (
        SELECT machine_row, site, machine, state, drifts FROM ",
    matching!(),
    "
        WHERE ?6 IS NULL OR state = ?6
        ORDER BY instr(?10, CASE WHEN is_silent THEN 'silent' ELSE state END),
                 coalesce(abs(drifts ->> '$[0].change_pct'), 0) DESC, site, machine
        LIMIT ?7 OFFSET ?8)
    SELECT chosen.site, chosen.machine, chosen.state, chosen.drifts, throw.started_at_us, estimate.quality,
           coalesce(estimate.baseline_throws, learned.baseline_throws) AS baseline_throws,
           coalesce(estimate.baseline_needed, learned.baseline_needed) AS baseline_needed,
           (SELECT group_concat(alarm.cause) FROM alarm
             WHERE alarm.machine_row = chosen.machine_row AND alarm.state <> 'normal') AS causes,
           (SELECT group_concat(alarm.cause) FROM alarm
             WHERE alarm.machine_row = chosen.machine_row AND alarm.state = 'cleared_unacknowledged') AS causes_over,
           (SELECT json_group_array(json_array(b0_pct, a1_pct, a0_pct)) FROM
             (SELECT b0_pct, a1_pct, a0_pct FROM
               (SELECT throw_row, b0_pct, a1_pct, a0_pct FROM estimate AS near
                 WHERE near.machine_row = chosen.machine_row AND near.direction = coalesce(chosen.drifts ->> '$[0].direction',
                     (SELECT min(direction) FROM latest WHERE latest.machine_row = chosen.machine_row AND direction <> ''))
                 ORDER BY near.throw_row DESC LIMIT ?9) CROSS JOIN throw AS own USING (throw_row)
               ORDER BY own.boot_position DESC, own.throw_no DESC)) AS spark
    FROM chosen
    LEFT JOIN throw ON throw.throw_row = (SELECT own.throw_row FROM latest CROSS JOIN throw AS own USING (throw_row)
                                           WHERE latest.machine_row = chosen.machine_row
                                           ORDER BY latest.start_us DESC, own.throw_row DESC LIMIT 1)
    LEFT JOIN estimate ON estimate.throw_row = throw.throw_row
    LEFT JOIN latest AS near ON near.machine_row = chosen.machine_row AND near.direction = 'normal_to_reverse'
    LEFT JOIN estimate AS learned ON learned.throw_row = near.throw_row"
    );
    // Number of matching machines in each state, and of the silent machines among them.
    STATE_COUNTS = concat!("SELECT state, count(*), sum(is_silent) FROM ", matching!(), " GROUP BY state");
    SITES = "SELECT site FROM machine GROUP BY site ORDER BY site LIMIT ?1";
    // Open alarms about the condition of machines.
    FAULTS = faults!("alarm.cause NOT IN ('not_monitored', 'data_loss') AND NOT (site = ?1 AND machine = ?2)");
    MACHINE_FAULTS = faults!("site = ?1 AND machine = ?2");
    // The text distinguishes the kinds of data loss. Few machines lose data; a lost link makes thousands not monitored.
    COMMON = "
    SELECT alarm.cause, site, min(machine) AS machine, count(*) AS count, min(raised_at_us) AS first_us, max(raised_at_us) AS last_us,
           CASE alarm.cause WHEN 'data_loss' THEN (SELECT payload ->> 'text' FROM alarm_event AS last
               WHERE last.alarm_row = alarm.alarm_row AND last.event_no = alarm.last_event_no) END AS said,
           alarm.state
    FROM alarm JOIN machine USING (machine_row)
    WHERE alarm.state <> 'normal' AND alarm.cause IN ('not_monitored', 'data_loss') AND NOT (site = ?1 AND machine = ?2)
    GROUP BY alarm.cause, site, said, alarm.state ORDER BY count(*) DESC";
    OPEN_ALARMS_BY_KIND = "SELECT cause, severity, count(*) AS open, \
            sum(alarm.state IN ('active_unacknowledged', 'active_acknowledged')) AS active \
        FROM alarm JOIN alarm_event ON alarm_event.alarm_row = alarm.alarm_row AND event_no = last_event_no \
        WHERE alarm.state <> 'normal' GROUP BY cause, severity ORDER BY cause, severity";
    // The newest opening command of each machine in maintenance and of each shelved alarm. `state <> 'normal'` is the
    // condition of the index `alarm_open`. Maintenance hides a shelving: the state of the alarm is then `out_of_service`,
    // also if an earlier occurrence of the alarm was shelved and this one is not.
    WINDOWS = "
    SELECT site, machine, at_us, command, command.payload ->> 'cause' AS cause, command.payload ->> 'until' AS until,
           by_whom, why
    FROM (SELECT machine_row, 'maintenance_start' AS opened_by, NULL AS of_cause FROM monitor WHERE state = 'maintenance'
          UNION ALL SELECT machine_row, 'shelve', cause FROM alarm INDEXED BY alarm_open
          WHERE state <> 'normal' AND state = 'shelved') AS open
    JOIN machine USING (machine_row)
    JOIN command ON command_row = (SELECT max(command_row) FROM command AS own INDEXED BY command_of_machine
        WHERE own.machine_row = open.machine_row AND own.command = opened_by AND own.payload ->> 'cause' IS of_cause)
    WHERE (?1 IS NULL OR site = ?1) AND (?2 IS NULL OR machine = ?2)
    ORDER BY site, machine";
}
