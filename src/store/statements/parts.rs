//! Parts that several statements share.

/// The statements of a module, and `ALL` with their names.
macro_rules! statements {
    ($($name:ident = $sql:expr;)*) => {
        $(pub(in crate::store) const $name: &str = $sql;)*

        pub(super) const ALL: &[(&str, &str)] = &[$((stringify!($name), $sql)),*];
    };
}

/// Columns and joins of a query of throws with their traces, for [`StoredThrow`](crate::store::rows::StoredThrow).
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

/// Row of the machine with site ?1 and name ?2.
macro_rules! one_machine {
    () => {
        "(SELECT machine_row FROM machine WHERE site = ?1 AND machine = ?2)"
    };
}

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
pub(in crate::store) use is_absent;
