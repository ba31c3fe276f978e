//! Health of one throw: a row of the history, and the message (JSON) on `points/v1/{site}/{machine}/health`.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use crate::{
    diagnose::{Drifting, MachineState},
    estimate::Grade,
    throw::{Direction, MachineId, ThrowRef},
};

/// Health of one throw. `None` is a value that the throw does not have; it is null in JSON.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Always [`Health::SCHEMA`].
    pub schema: String,
    /// The machine: `site` and `machine` in JSON.
    #[serde(flatten)]
    pub machine: MachineId,
    /// The throw: `boot_id` and `throw_no` in JSON.
    #[serde(flatten)]
    pub throw: ThrowRef,
    /// Wall time of the first sample.
    pub started_at: Timestamp,
    /// Direction of the throw; `None` is `unknown` in JSON.
    #[serde(with = "direction")]
    pub direction: Option<Direction>,
    /// Quality of the estimate (`good`, `rough`, `current_only`), or the code of the reason for its rejection.
    pub quality: String,
    /// `b0` = KT / J \[rad s⁻² A⁻¹\], `a1` = Kf / J \[s⁻¹\], `a0` = Kspr / J \[s⁻²\].
    #[serde(flatten, with = "coefficients")]
    pub coefficients: Option<[f64; 3]>,
    /// Standard deviations of the coefficients: `b0_sd`, `a1_sd`, `a0_sd`.
    #[serde(flatten, with = "sd")]
    pub sd: Option<[f64; 3]>,
    /// Changes of the coefficients from the baseline \[%\]: `b0_pct`, `a1_pct`, `a0_pct`.
    #[serde(flatten, with = "change_pct")]
    pub change_pct: Option<[f64; 3]>,
    /// Fit of the model `R²_T` \[%\].
    pub fit_pct: Option<f64>,
    /// a1/b0 = Kf / KT \[A s rad⁻¹\]. A "rough" throw has it too, as its estimate does not need the start of the throw.
    pub a1_per_b0: Option<f64>,
    /// Standard deviation of `a1_per_b0`.
    pub a1_per_b0_sd: Option<f64>,
    /// a0/b0 = Kspr / KT \[A rad⁻¹\].
    pub a0_per_b0: Option<f64>,
    /// Standard deviation of `a0_per_b0`.
    pub a0_per_b0_sd: Option<f64>,
    /// Change of `a1_per_b0` from the baseline \[%\], not corrected for temperature; `None` if `change_pct` is known.
    pub a1_per_b0_pct: Option<f64>,
    /// Change of `a0_per_b0` from the baseline \[%\]; see `a1_per_b0_pct`.
    pub a0_per_b0_pct: Option<f64>,
    /// Duration of the movement \[s\].
    pub duration_s: Option<f64>,
    /// Largest magnitude of the current \[A\].
    pub peak_current_a: Option<f64>,
    /// Mean magnitude of the current while the motor ran \[A\].
    pub mean_current_a: Option<f64>,
    /// State of the machine after this throw, or now in the reply to a query for the present health; `None` for throws
    /// that an earlier version judged.
    pub state: Option<MachineState>,
    /// The worst active drift at the time of `state`.
    pub drift: Option<Drifting>,
    /// All active drifts at the time of `state`, the worst first; absent if there are none, and in history.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub drifts: Vec<Drifting>,
    /// Sentences about what the monitor cannot show at present; absent if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub caveats: Vec<String>,
    /// Why the throw is rejected or rough, as a sentence. Not published.
    #[serde(skip)]
    pub detail: Option<String>,
    /// Progress of the baseline of this direction. Not published.
    #[serde(skip)]
    pub baseline: Option<BaselineProgress>,
    /// Number of evaluated throws of this direction since the baseline was complete. Not published.
    #[serde(skip)]
    pub throws_since_baseline: u64,
}

/// Number of throws in a baseline; an array in JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(into = "(u64, u64)")]
pub struct BaselineProgress {
    /// Number of throws.
    pub so_far: u64,
    /// Number that the complete baseline has.
    pub needed: u64,
}

impl From<BaselineProgress> for (u64, u64) {
    fn from(BaselineProgress { so_far, needed }: BaselineProgress) -> Self {
        (so_far, needed)
    }
}

impl BaselineProgress {
    /// Whether the baseline has a throw.
    pub fn has_begun(self) -> bool {
        self.so_far > 0
    }

    /// Whether the baseline has all its throws.
    pub fn is_complete(self) -> bool {
        self.so_far >= self.needed
    }
}

impl Health {
    /// Name and version of the message.
    pub const SCHEMA: &str = "points.health/1";

    /// Health of a throw whose estimate was rejected. `quality` is the code of the reason, `detail` the reason as a
    /// sentence. Features, state and baseline are `None`.
    pub fn rejected(
        machine: MachineId,
        throw: ThrowRef,
        started_at: Timestamp,
        quality: &str,
        detail: Option<String>,
    ) -> Self {
        Self {
            schema: Self::SCHEMA.to_owned(),
            machine,
            throw,
            started_at,
            direction: None,
            quality: quality.to_owned(),
            coefficients: None,
            sd: None,
            change_pct: None,
            fit_pct: None,
            a1_per_b0: None,
            a1_per_b0_sd: None,
            a0_per_b0: None,
            a0_per_b0_sd: None,
            a1_per_b0_pct: None,
            a0_per_b0_pct: None,
            duration_s: None,
            peak_current_a: None,
            mean_current_a: None,
            state: None,
            drift: None,
            drifts: Vec::new(),
            caveats: Vec::new(),
            detail,
            baseline: None,
            throws_since_baseline: 0,
        }
    }

    /// Whether the throw has an estimate.
    pub fn is_evaluated(&self) -> bool {
        self.a1_per_b0.is_some() || self.coefficients.is_some()
    }

    /// The grade of the estimate; `None` if it was rejected.
    pub fn grade(&self) -> Option<Grade> {
        self.quality.parse().ok()
    }

    /// Whether the estimate was rejected.
    pub fn is_rejected(&self) -> bool {
        is_rejection(&self.quality)
    }
}

/// Whether a quality is the code of a rejection, and not a grade. `current_only` is a grade: such a throw may have no
/// estimate, but its features are monitored.
pub fn is_rejection(quality: &str) -> bool {
    quality.parse::<Grade>().is_err()
}

/// JSON of a direction: `None` is `unknown`.
mod direction {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    use crate::{throw::Direction, wire::throw::UNKNOWN_DIRECTION};

    #[expect(clippy::ref_option, clippy::trivially_copy_pass_by_ref, reason = "serde gives a reference to the field")]
    pub(super) fn serialize<S: Serializer>(direction: &Option<Direction>, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(direction.map_or(UNKNOWN_DIRECTION, Direction::as_str))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Direction>, D::Error> {
        match String::deserialize(from)?.as_str() {
            UNKNOWN_DIRECTION => Ok(None),
            word => word.parse().map(Some).map_err(|_| D::Error::custom("not a direction")),
        }
    }
}

/// JSON of one number for each coefficient: all three are present, or all are null.
macro_rules! three {
    ($name:ident, $b0:literal, $a1:literal, $a0:literal) => {
        mod $name {
            use serde::{Deserialize, Deserializer, Serialize, Serializer};

            #[derive(Serialize, Deserialize)]
            struct Json {
                #[serde(rename = $b0)]
                b0: Option<f64>,
                #[serde(rename = $a1)]
                a1: Option<f64>,
                #[serde(rename = $a0)]
                a0: Option<f64>,
            }

            #[expect(clippy::ref_option, reason = "serde gives a reference to the field")]
            pub(super) fn serialize<S: Serializer>(three: &Option<[f64; 3]>, to: S) -> Result<S::Ok, S::Error> {
                let [b0, a1, a0] = [0, 1, 2].map(|at| three.map(|three| three[at]));
                Json { b0, a1, a0 }.serialize(to)
            }

            pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<[f64; 3]>, D::Error> {
                let Json { b0, a1, a0 } = Json::deserialize(from)?;
                Ok(b0.zip(a1).zip(a0).map(|((b0, a1), a0)| [b0, a1, a0]))
            }
        }
    };
}

three!(coefficients, "b0", "a1", "a0");
three!(sd, "b0_sd", "a1_sd", "a0_sd");
three!(change_pct, "b0_pct", "a1_pct", "a0_pct");

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::json_bytes;

    #[test]
    fn the_message_has_exactly_the_fields_of_the_contract() {
        let text = r#"{"schema": "points.health/1", "site": "north", "machine": "21B", "boot_id": "b", "throw_no": 7,
            "started_at": "2026-05-04T10:11:12Z", "direction": "unknown", "quality": "no_movement",
            "b0": null, "a1": null, "a0": null, "b0_sd": null, "a1_sd": null, "a0_sd": null,
            "b0_pct": 0.5, "a1_pct": -1.5, "a0_pct": 2.0, "fit_pct": null,
            "a1_per_b0": 0.03, "a1_per_b0_sd": 0.0001, "a0_per_b0": null, "a0_per_b0_sd": null,
            "a1_per_b0_pct": 3.5, "a0_per_b0_pct": null, "duration_s": null, "peak_current_a": 0.5, "mean_current_a": null, "state": "warning",
            "drift": {"cause": "kt", "change_pct": -7.0, "change_pct_sd": 0.5, "direction": null, "limit_in_throws": null},
            "drifts": [{"cause": "kt", "change_pct": -7.0, "change_pct_sd": 0.5, "direction": null, "limit_in_throws": null}]}"#;
        let promised: serde_json::Value = serde_json::from_str(text).unwrap();
        let health: Health = serde_json::from_str(text).unwrap();
        assert_eq!(health.change_pct, Some([0.5, -1.5, 2.0]));
        let written: serde_json::Value = serde_json::from_slice(&json_bytes(&health)).unwrap();
        assert_eq!(written, promised);
    }
}
