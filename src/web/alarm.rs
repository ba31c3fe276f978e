//! An open alarm on a page: its size when raised and now, acknowledgement or shelving, text, and a link to its throw.

use super::{page, state};
use crate::{
    diagnose::AlarmState,
    store::{Fault, Window},
    throw::utc,
    wire::Alarm,
};

/// An open alarm as a page shows it.
pub(super) struct AlarmLine {
    pub(super) alarm: Alarm,
    pub(super) state: String,
    /// Size when raised, as "+28 % ± 4"; `None` for a cause without a size.
    pub(super) raised: Option<String>,
    /// Present size; `None` if the drift has ended.
    pub(super) now: Option<String>,
    pub(super) forecast: Option<String>,
    /// Address of the last throw that contributed to the alarm.
    pub(super) throw: Option<String>,
    /// Time at which the text of the alarm was written.
    pub(super) text_at: String,
}

impl AlarmLine {
    /// The lines of open alarms. `windows` are open shelvings and maintenance.
    pub(super) fn all(faults: &[Fault], windows: &[Window]) -> Vec<Self> {
        faults.iter().map(|fault| Self::new(fault, windows)).collect()
    }

    fn new(Fault { alarm, raised, drifts }: &Fault, windows: &[Window]) -> Self {
        let drift = drifts.iter().find(|drift| drift.cause == alarm.cause);
        // Events of earlier versions do not have `acknowledged_by`, only the operator of the last command.
        let by = alarm.acknowledged_by.as_ref().or(alarm.by.as_ref());
        let by = by.map(|by| format!(" by {by}")).unwrap_or_default();
        let state = match (alarm.state, Window::of(alarm, windows)) {
            (AlarmState::Shelved, Some(window)) => format!("shelved {}", window.sentence()),
            (AlarmState::OutOfService, Some(window)) => page::window(window),
            (AlarmState::ActiveAcknowledged, _) => format!("acknowledged{by}"),
            (state, _) => state.words().to_owned(),
        };
        let throw = alarm.last_throw.as_ref().filter(|throw| !throw.boot_id.is_empty());
        Self {
            alarm: alarm.clone(),
            state,
            text_at: utc(&alarm.text_at.unwrap_or(alarm.event_at)),
            raised: raised.map(|(size, sd)| state::size(size, sd)),
            now: drift.map(|drift| state::size(drift.change_pct, drift.change_pct_sd)),
            forecast: drift.and_then(state::forecast),
            throw: throw.map(|throw| page::throw_address(&alarm.machine, throw)),
        }
    }
}
