-- The start of the movement: what a late brake, play, lost motion and a delayed position change.
ALTER TABLE estimate ADD COLUMN start_delay_s REAL; -- delay of the movement behind the current, of either sign; NULL in throws judged before this migration
ALTER TABLE estimate ADD COLUMN start_gain REAL;    -- b0 of the start alone [rad s^-2 A^-1]; NULL in throws judged before this migration

DROP VIEW throw_features;
CREATE VIEW throw_features AS
SELECT machine.site, machine.machine,
       strftime('%Y-%m-%dT%H:%M:%S', (throw.started_at_us - (throw.started_at_us % 1000000 + 1000000) % 1000000) / 1000000, 'unixepoch') || printf('.%06dZ', (throw.started_at_us % 1000000 + 1000000) % 1000000) AS started_at,
       coalesce(estimate.direction, throw.direction, 'unknown') AS direction, throw.throw_no, boot.boot_id,
       estimate.quality, estimate.detail,
       estimate.duration_s, estimate.release_s, estimate.start_delay_s, estimate.start_gain,
       estimate.peak_current_a, estimate.running_current_a, estimate.mean_current_a, estimate.quiet_current_a,
       estimate.charge_as, estimate.energy_j,
       estimate.start_position_mm, estimate.end_position_mm, estimate.travel_mm,
       estimate.resistance_ohm, estimate.back_emf_v_s_per_rad, estimate.no_load_speed_rad_per_s,
       throw.temperature_c, throw.started_at_us
FROM estimate
JOIN throw USING (throw_row)
JOIN boot USING (boot_row)
JOIN machine ON machine.machine_row = throw.machine_row;
