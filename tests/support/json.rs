//! A throw message in JSON, as a logger in any language writes it.

use pointsd::throw::{Direction, Throw};

pub(crate) fn json_message(throw: &Throw) -> Vec<u8> {
    // `json!` writes NaN as null.
    let message = serde_json::json!({
        "schema": "points.throw/1",
        "boot_id": throw.id.boot_id,
        "throw_no": throw.id.throw_no,
        "started_at": throw.started_at,
        "direction": throw.direction.map_or("unknown", Direction::as_str),
        "sample_rate_hz": throw.trace.sample_rate_hz(),
        "current_a": throw.trace.current_a(),
        "position_mm": throw.trace.position_mm(),
        "temperature_c": throw.temperature_c,
        "supply_v": throw.supply_v,
        "anti_alias_hz": throw.anti_alias_hz,
    });
    message.to_string().into_bytes()
}
