//! The health message (JSON): the estimate of one throw, as `points/v1/{site}/{machine}/health` carries it.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// The `quality` of a throw that was evaluated.
pub const GOOD: &str = "good";

/// One throw's health. Numbers are null where the throw does not tell them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Always [`Health::SCHEMA`].
    pub schema: String,
    /// The site.
    pub site: String,
    /// The machine.
    pub machine: String,
    /// The logger's boot.
    pub boot_id: String,
    /// The throw's number within the boot.
    pub throw_no: u64,
    /// Wall time of the first sample.
    pub started_at: Timestamp,
    /// `normal_to_reverse`, `reverse_to_normal` or `unknown`.
    pub direction: String,
    /// [`GOOD`], or the stable word of the reason why the throw was not evaluated.
    pub quality: String,
    /// KT / J \[rad s⁻² A⁻¹\].
    pub b0: Option<f64>,
    /// Kf / J \[s⁻¹\].
    pub a1: Option<f64>,
    /// Kspr / J \[s⁻²\].
    pub a0: Option<f64>,
    /// Standard deviation of b0, in its unit.
    pub b0_sd: Option<f64>,
    /// Standard deviation of a1, in its unit.
    pub a1_sd: Option<f64>,
    /// Standard deviation of a0, in its unit.
    pub a0_sd: Option<f64>,
    /// Change of b0 from the baseline \[%\].
    pub b0_pct: Option<f64>,
    /// Change of a1 from the baseline \[%\].
    pub a1_pct: Option<f64>,
    /// Change of a0 from the baseline \[%\].
    pub a0_pct: Option<f64>,
    /// Fit of the model \[%\].
    pub fit_pct: Option<f64>,
    /// Duration of the movement \[s\].
    pub duration_s: Option<f64>,
    /// Largest magnitude of the current \[A\].
    pub peak_current_a: Option<f64>,
    /// Mean magnitude of the current while the motor ran \[A\].
    pub mean_current_a: Option<f64>,
}

impl Health {
    /// The version of the message.
    pub const SCHEMA: &str = "points.health/1";

    /// The message as JSON.
    #[must_use]
    pub fn to_json(&self) -> Vec<u8> {
        // Texts and numbers into memory: nothing in it can fail.
        serde_json::to_vec(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_has_exactly_the_promised_fields() {
        let text = r#"{"schema": "points.health/1", "site": "north", "machine": "21B", "boot_id": "b", "throw_no": 7,
            "started_at": "2026-05-04T10:11:12Z", "direction": "unknown", "quality": "no_movement",
            "b0": null, "a1": null, "a0": null, "b0_sd": null, "a1_sd": null, "a0_sd": null,
            "b0_pct": null, "a1_pct": null, "a0_pct": null, "fit_pct": null,
            "duration_s": null, "peak_current_a": 0.5, "mean_current_a": null}"#;
        let promised: serde_json::Value = serde_json::from_str(text).unwrap();
        let health: Health = serde_json::from_str(text).unwrap();
        let written: serde_json::Value = serde_json::from_slice(&health.to_json()).unwrap();
        assert_eq!(written, promised);
    }
}
