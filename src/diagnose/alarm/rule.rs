//! The rule that owns an alarm. Several rules raise the same alarm; its owner ends it when the fault has ended.

use serde::{Deserialize, Serialize};

use crate::diagnose::Cause;

/// The rule that owns an active alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Rule {
    /// The usual rule of the cause. For a drift: the rule of the means of coefficients over windows of throws. For a
    /// machine that is not monitored: throws that cannot be evaluated.
    #[default]
    Usual,
    /// Changed features of throws without coefficients.
    Features,
    /// A changed acceleration at the start of the movement.
    Start,
    /// A changed current at the end of the stroke.
    End,
    /// A changed travel of the toe.
    Travel,
    /// A motor that runs on after the arrival of the toe.
    RunOn,
    /// A motor that turns less or more for a throw, without a toe position.
    Stroke,
    /// Departures of single throws.
    Intermittent,
    /// Dates of throws that a correct clock cannot give.
    Dates,
    /// Gauges that show a faulty sensor.
    Gauges,
    /// An offset of a sensor.
    #[serde(rename = "rest")]
    Offset,
    /// A changed resistance of the motor and its line to the supply.
    Circuit,
    /// No throw arrives, or the logger is gone.
    Silence,
    /// Throws that are evaluated, and do not show every fault.
    Blind,
    /// Two loggers that publish as one machine, so that no throw is evaluated.
    TwoLoggers,
}

impl Rule {
    /// Whether the rule cannot name the faulty part: its alarm ends when another rule names one.
    pub(crate) const fn knows_no_part(self) -> bool {
        matches!(self, Self::Features | Self::Start | Self::End | Self::Travel | Self::RunOn | Self::Stroke)
    }

    /// Whether a fault of this part, or a changed supply, explains the fault of a rule that cannot name the part. The
    /// current at the end of the stroke is compared without the change that friction, motor and supply explain.
    pub(crate) fn is_explained_by(self, cause: Cause) -> bool {
        match self {
            Self::End => matches!(cause, Cause::Stiffness),
            Self::Travel | Self::RunOn | Self::Stroke => false,
            _ => cause.is_part() || matches!(cause, Cause::Supply),
        }
    }

    /// Whether this rule and `other`, which both name no part, see different faults. The usual rule, that of the
    /// features and that of the start see a changed movement.
    pub(crate) fn sees_other_faults_than(self, other: Self) -> bool {
        let is_own =
            |rule: Self| matches!(rule, Self::End | Self::Travel | Self::RunOn | Self::Stroke | Self::Intermittent);
        self != other && (is_own(self) || is_own(other))
    }

    /// Whether the usual rule of the cause takes over the alarm: the fault was without a named part, or intermittent.
    pub(crate) const fn gives_way(self) -> bool {
        self.knows_no_part() || matches!(self, Self::Intermittent)
    }
}
