//! Alarms about silence and lost data: of the logger, its throws, the daemon itself and other daemons.

use super::{Logger, Operation, is_silence, not_monitored, unix_s};
use crate::{
    diagnose::{
        Away, Cause, Irregularity, Missing, Settings, Severity,
        alarm::{Rule, Step},
        text,
    },
    throw::without_digits,
};

/// Longest time between two ticks that counts as silence \[s\]; a longer one is a jump of the clock or a restart.
const LONGEST_TICK_S: f64 = 3600.0;
/// Longest time between two ticks that counts for delays of minutes \[s\]. After a start of the daemon, loggers thus
/// have the whole delay to connect again.
const USUAL_TICK_S: f64 = 60.0;
/// Time without failures of the daemon after which its alarm clears \[s\]: a disk at its limit must not let it flap.
const CALM_S: f64 = 600.0;

impl Operation {
    /// Advances the time. Silence is the sum of the times between ticks, so that a jump of the clock is not silence. It
    /// raises an alarm only on a machine with an earlier throw.
    pub(crate) fn on_tick(&mut self, in_service: bool, has_thrown: bool, step: &mut Step) {
        let Step { name, at, settings, .. } = *step;
        let passed = self.ticked_at.replace(at).map_or(0.0, |before| at.duration_since(before).as_secs_f64());
        // These times can be in the future only if the clock was set back.
        self.gap_at_s = self.gap_at_s.min(unix_s(at));
        if let Logger::Gone { since: Some(since), .. } = &mut self.logger {
            *since = at.min(*since);
        }
        self.calm_s += passed.clamp(0.0, USUAL_TICK_S);
        if !in_service {
            return;
        }
        self.silence_s += passed.clamp(0.0, LONGEST_TICK_S);
        if !has_thrown {
            return;
        }
        if let Logger::Gone { for_s, .. } = &mut self.logger {
            // A longer time is that of a restart of the daemon, after which the loggers connect again.
            *for_s += if passed <= USUAL_TICK_S { passed.max(0.0) } else { 0.0 };
            if *for_s >= 60.0 * settings.logger_gone_minutes {
                return not_monitored(Rule::Silence, None, text::logger_gone(name, *for_s / 60.0), step);
            }
        }
        if self.is_silent(settings) {
            not_monitored(Rule::Silence, None, text::silent(name, self.silence_s / 3600.0), step);
        }
    }

    fn is_silent(&self, settings: &Settings) -> bool {
        self.silence_s >= 3600.0 * settings.not_monitored_hours
    }

    /// Applies the liveliness of the logger, `there`: whether its token exists. No alarm without an earlier token.
    pub(crate) fn on_liveliness(&mut self, there: bool, step: &mut Step) {
        let before = self.logger;
        self.logger = match before {
            _ if there => Logger::There,
            Logger::There => Logger::Gone { for_s: 0.0, since: Some(step.at) },
            absent => absent,
        };
        let is_back = there && before != Logger::There;
        let enough = step.settings.not_monitored_throws;
        let monitored = self.unevaluated_in_a_row.longest().max(self.blind_in_a_row.longest()) < enough
            && !self.is_silent(step.settings);
        if is_back && monitored && is_silence(step) {
            step.clear(Cause::NotMonitored, |name| text::machine(name, text::LOGGER_BACK));
        }
    }

    /// Whether the logger has declared a token, even if the token is gone now.
    pub(crate) fn is_announced(&self) -> bool {
        self.logger != Logger::Unannounced
    }

    /// Whether throws are missing since the last end of the alarm about them.
    pub(crate) fn has_gap(&self) -> bool {
        self.missing > 0
    }

    /// Applies a failure of the daemon to store data; `None` without one.
    pub(crate) fn on_daemon_trouble(&mut self, trouble: Option<(Severity, &str)>, step: &mut Step) {
        if let Some((severity, text)) = trouble {
            self.calm_s = 0.0;
            raise_or_remark(severity, text.to_owned(), step);
        } else if self.calm_s >= CALM_S {
            step.clear(Cause::DataLoss, |_| text::DAEMON_CALM.to_owned());
        }
    }

    /// Applies a gap. The alarm states the sum of the gaps since its raise.
    pub(crate) fn on_gap(&mut self, missing: Missing, step: &mut Step) {
        if missing.throws == 0 {
            return;
        }
        (self.since_gap, self.gap_at_s) = (0, unix_s(step.at));
        let before = self.missing;
        self.missing = before.saturating_add(missing.throws);
        self.refused = self.refused.saturating_add(missing.refused);
        let all = Missing { throws: self.missing, refused: self.refused, ..missing };
        let text = text::gap(step.name, &all, step.at);
        if !step.alarms.is_active(Cause::DataLoss) {
            step.raise(step.warning(Cause::DataLoss, text));
        } else if before == 0 || before.ilog2() != self.missing.ilog2() {
            // A flapping link must not make an event of each gap: the sum is reported at each power of two.
            step.remark(Cause::DataLoss, text);
        }
    }

    pub(crate) fn on_irregularity(&mut self, irregularity: Irregularity, step: &mut Step) {
        self.since_gap = 0;
        let text = match irregularity {
            Irregularity::RepeatedTrace => text::machine(step.name, text::REPEATED_TRACE),
            Irregularity::RepeatedNumber => text::machine(step.name, text::REPEATED_NUMBER),
            Irregularity::Invalid { count, reason } => text::invalid(step.name, count, reason),
        };
        raise_or_remark(Severity::Warning, text, step);
    }
}

/// Raises or escalates the alarm about lost data. A changed text of an active alarm is a new event, unless only its
/// numbers differ or the last event is younger than ten minutes: a disk at its limit must not make many events.
fn raise_or_remark(severity: Severity, text: String, step: &mut Step) {
    let before = step.alarms.active().find(|event| event.cause == Cause::DataLoss);
    let is_new = before.is_some_and(|event| {
        let quiet_s = step.at.duration_since(event.event_at).as_secs_f64().abs();
        quiet_s >= CALM_S && without_digits(&event.text) != without_digits(&text)
    });
    if !step.alarms.raise_or_escalate(step.event(Cause::DataLoss, severity, text.clone())) && is_new {
        step.remark(Cause::DataLoss, text);
    }
}

/// Applies a change of the watched daemons. A further unreachable one needs a new acknowledgement.
pub(crate) fn on_peers(away: &Away, step: &mut Step) {
    let cause = Cause::NotMonitored;
    if away.daemons.is_empty() {
        return step.clear(cause, |_| text::PEERS_BACK.to_owned());
    }
    let text = text::peers_away(away);
    let is_named = |before: &str| away.daemons.iter().all(|(name, _)| before.contains(&format!(" {name} since ")));
    if step.alarms.find_active(cause).is_some_and(|alarm| is_named(&alarm.last.text)) {
        step.remark(cause, text);
    } else {
        step.alarms.raise_anew(Rule::Usual, step.event(cause, Severity::Critical, text));
    }
}
