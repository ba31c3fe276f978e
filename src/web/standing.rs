//! How a machine stands, in one word that has a colour and a sign of its own.

use crate::{
    diagnose::{Cause, Severity},
    store::HealthRow,
    wire::Alarm,
};

/// From worst to best.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Standing {
    Critical,
    NotMonitored,
    Warning,
    Filling,
    Good,
}

impl Standing {
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Critical => "critical",
            Self::NotMonitored => "not monitored",
            Self::Warning => "warning",
            Self::Filling => "baseline filling",
            Self::Good => "good",
        }
    }

    /// A sign that differs in shape, for who does not see the colour.
    pub(super) const fn sign(self) -> &'static str {
        match self {
            Self::Critical => "◆",
            Self::NotMonitored => "?",
            Self::Warning => "▲",
            Self::Filling => "○",
            Self::Good => "●",
        }
    }

    /// Its name in the style sheet.
    pub(super) const fn class(self) -> &'static str {
        match self {
            Self::Critical => "critical",
            Self::NotMonitored => "unmonitored",
            Self::Warning => "warning",
            Self::Filling => "filling",
            Self::Good => "good",
        }
    }

    /// Of an open alarm.
    pub(super) fn of_alarm(alarm: &Alarm) -> Self {
        match (alarm.cause, alarm.severity) {
            (Cause::NotMonitored, _) => Self::NotMonitored,
            (_, Severity::Critical) => Self::Critical,
            (_, Severity::Warning) => Self::Warning,
        }
    }

    /// Of one direction: the worst of its machine's alarms, which both directions feed, as in the view
    /// `machine_health`; else how far its baseline is.
    pub(super) fn of_direction<'a>(latest: Option<&HealthRow>, alarms: impl IntoIterator<Item = &'a Alarm>) -> Self {
        match (alarms.into_iter().map(Self::of_alarm).min(), latest) {
            (Some(worst), _) => worst,
            (None, Some(latest)) if latest.throws_since_baseline > 0 => Self::Good,
            (None, _) => Self::Filling,
        }
    }
}

/// "12 of 50".
pub(super) fn progress(latest: Option<&HealthRow>) -> Option<String> {
    let (so_far, needed) = latest?.baseline?;
    (so_far < needed).then(|| format!("{so_far} of {needed}"))
}

/// "+3.2 ± 0.8", with a true minus: the change of each coefficient from its baseline and two standard deviations \[%\].
pub(super) fn changes(row: &HealthRow) -> Option<[String; 3]> {
    let (change, reach) = (row.change_pct?, reach_pct(row)?);
    // No "-0.0".
    let rounded = change.map(|change| (change * 10.0).round() / 10.0 + 0.0);
    Some([0, 1, 2].map(|at| format!("{:+.1} ± {:.1}", rounded[at], reach[at]).replace('-', "−")))
}

/// Two standard deviations of each coefficient \[% of it\].
pub(super) fn reach_pct(row: &HealthRow) -> Option<[f64; 3]> {
    let (values, sd) = (row.coefficients?, row.sd?);
    Some([0, 1, 2].map(|at| 200.0 * sd[at] / values[at].abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use Standing::{Critical, Filling, Good, NotMonitored, Warning};

    #[test]
    fn every_standing_differs_in_word_sign_and_class() {
        let all = [Critical, NotMonitored, Warning, Filling, Good];
        for (at, one) in all.iter().enumerate() {
            for other in &all[at + 1..] {
                assert!(one < other, "the worst comes first");
                assert!(one.word() != other.word() && one.sign() != other.sign() && one.class() != other.class());
            }
        }
    }
}
