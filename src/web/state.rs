//! The state of a machine on a page: word, colour and sign.

use crate::{
    diagnose::{Cause, Drifting, MachineState, Severity},
    throw::counted,
    wire::Alarm,
};

/// A state of a machine, as a page shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Badge(pub(super) MachineState);

impl Badge {
    /// The badge of an alarm, from its cause and severity.
    pub(super) fn of(alarm: &Alarm) -> Self {
        Self(match (alarm.cause, alarm.severity) {
            (Cause::NotMonitored, _) => MachineState::NotMonitored,
            (_, Severity::Critical) => MachineState::Critical,
            (_, Severity::Warning) => MachineState::Warning,
        })
    }

    /// The word as in SQL, but with spaces.
    pub(super) fn word(self) -> String {
        self.0.as_str().replace('_', " ")
    }

    /// The word as in SQL, for the style sheet and for addresses.
    pub(super) fn class(self) -> &'static str {
        self.0.as_str()
    }

    /// A sign whose shape differs from all others, for readers who do not see the colour.
    pub(super) const fn sign(self) -> &'static str {
        match self.0 {
            MachineState::Critical => "◆",
            MachineState::NotMonitored => "?",
            MachineState::Warning => "▲",
            MachineState::Maintenance => "✕",
            MachineState::Learning => "○",
            MachineState::Healthy => "●",
        }
    }
}

/// A change \[%\] with two standard deviations, as "+57 % ± 3" or "−20.1 % ± 0.4". The deviation is never shown as 0.
pub(crate) fn size(change_pct: f64, sd: f64) -> String {
    let decimals = usize::from(2.0 * sd < 0.95);
    format!("{} % ± {:.decimals$}", signed(change_pct, decimals), (2.0 * sd).max(0.1))
}

/// A signed number with a typographic minus sign, never "−0".
pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = format!("{value:+.decimals$}");
    if text.chars().all(|c| !c.is_ascii_digit() || c == '0') {
        text.replace('-', "+")
    } else {
        text.replace('-', "−")
    }
}

/// The forecast of a drift, as "critical in about 40 throws (30 to 60)"; `None` without one.
pub(crate) fn forecast(drift: &Drifting) -> Option<String> {
    let limit = drift.limit_in_throws?;
    let throws = counted(format_args!("{:.0}", limit.mid), "throw");
    Some(format!("critical in about {throws} ({:.0} to {:.0})", limit.low, limit.high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::WORST_FIRST;

    #[test]
    fn every_state_differs_in_word_sign_and_class() {
        for (at, one) in WORST_FIRST.map(Badge).into_iter().enumerate() {
            for other in &WORST_FIRST.map(Badge)[at + 1..] {
                assert!(one.word() != other.word() && one.sign() != other.sign() && one.class() != other.class());
            }
        }
    }

    #[test]
    fn a_number_has_a_true_sign() {
        assert_eq!([signed(-0.04, 1), signed(3.26, 1), signed(-3.26, 1)], ["+0.0", "+3.3", "−3.3"]);
        assert_eq!(size(57.2, 1.4), "+57 % ± 3");
        assert_eq!(size(-20.12, 0.2), "−20.1 % ± 0.4");
        assert_eq!(size(-20.12, 0.01), "−20.1 % ± 0.1");
    }
}
