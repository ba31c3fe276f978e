//! The alarms that do not come from a drift: throws that fail, get slow, cannot be evaluated, or never arrive.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::{
    Settings,
    alarm::{Actor, Board, Evidence},
    event::{AlarmEvent, Cause, Severity},
    text,
};
use crate::throw::{Direction, ThrowRef};

/// Slow throws in a row that raise the alarm: one slow throw is a passing thing.
const SLOW_IN_A_ROW: u32 = 3;
/// Longest time between two ticks that counts as silence \[s\]: more is a clock that jumped or a daemon that was down.
const LONGEST_TICK_S: f64 = 3600.0;

/// Longest time between two ticks that counts for what takes minutes \[s\]: after a start of the daemon, loggers are given
/// the whole delay to connect again.
const USUAL_TICK_S: f64 = 60.0;
/// Trouble of the daemon itself is over when it has not been there for so long \[s\]: a disk at its limit does not
/// toggle its alarm.
const CALM_S: f64 = 600.0;

/// Whether the logger shows that it is alive.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Logger {
    /// It never has: it may be one that does not show it.
    #[default]
    Unannounced,
    /// It does.
    There,
    /// It did.
    Gone {
        /// For so long \[s\].
        for_s: f64,
        /// Its being gone has raised an alarm.
        alarmed: bool,
    },
}

/// Counters behind the operational alarms.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Operation {
    incomplete: u32,
    complete: u32,
    slow: u32,
    very_slow: u32,
    fast_enough: u32,
    unevaluated: u32,
    since_gap: u32,
    lost: u64,
    silence_s: f64,
    ticked_at: Option<Timestamp>,
    #[serde(default)]
    logger: Logger,
    /// Since when the daemon has no trouble \[s\].
    #[serde(default)]
    calm_s: f64,
}

/// Where events happen: whose they are, and when.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) name: &'a str,
    pub(super) at: Timestamp,
    pub(super) throw: Option<&'a ThrowRef>,
    pub(super) settings: &'a Settings,
}

fn streak(count: &mut u32, holds: bool) {
    *count = if holds { count.saturating_add(1) } else { 0 };
}

impl Operation {
    /// A throw arrived: whether it was complete, and that the logger lives.
    pub(super) fn arrived(&mut self, incomplete: bool, board: &mut Board, scene: Scene) -> Vec<AlarmEvent> {
        let Scene { name, at, throw, settings } = scene;
        self.silence_s = 0.0;
        self.logger = match self.logger {
            // It speaks and does not show that it is alive: its silence alone tells that it is gone.
            Logger::Gone { alarmed: true, .. } => Logger::Unannounced,
            Logger::Gone { .. } => Logger::Gone { for_s: 0.0, alarmed: false },
            as_before => as_before,
        };
        streak(&mut self.incomplete, incomplete);
        streak(&mut self.complete, !incomplete);
        self.since_gap = self.since_gap.saturating_add(1);
        let mut events = Vec::new();
        if incomplete {
            let subject = text::subject(name, None);
            if self.incomplete == 1 {
                let said = format!(
                    "{subject}: a throw was not completed. Check for an obstruction between the rails, and detection."
                );
                events.extend(board.raise(Cause::IncompleteThrow, Evidence::plain(Severity::Warning, throw, said), at));
            } else {
                let said = format!(
                    "{subject}: {} throws in a row were not completed. Check for an obstruction between the rails, \
                     and detection.",
                    self.incomplete
                );
                let evidence = Evidence::plain(Severity::Critical, throw, said);
                events.extend(board.escalate(Cause::IncompleteThrow, evidence, at));
            }
        } else if self.complete >= settings.off_delay_throws {
            let said = format!("{}: {} throws in a row were completed.", text::subject(name, None), self.complete);
            events.extend(board.clear(Cause::IncompleteThrow, said, Actor::default(), at));
        }
        if self.since_gap >= settings.off_delay_throws {
            let said = format!("{}: no throw was lost in the last {}.", text::subject(name, None), self.since_gap);
            events.extend(board.clear(Cause::DataLoss, said, Actor::default(), at));
            self.lost = 0;
        }
        events
    }

    /// How much longer a completed throw took than the baseline's \[%\]. `explained`: a drift alarm is active, and
    /// names what makes the machine slow; then only a critical slowness has an alarm of its own.
    pub(super) fn took(
        &mut self,
        longer_pct: f64,
        direction: Direction,
        explained: bool,
        board: &mut Board,
        scene: Scene,
    ) -> Vec<AlarmEvent> {
        let Scene { name, at, throw, settings } = scene;
        streak(&mut self.slow, longer_pct > settings.slow_throw_pct);
        streak(&mut self.very_slow, longer_pct > settings.slow_throw_critical_pct);
        streak(&mut self.fast_enough, longer_pct < settings.slow_throw_pct * (1.0 - settings.deadband_pct / 100.0));
        let evidence = |severity| {
            let said = format!(
                "{}: throws take {longer_pct:.0} % longer than the baseline's. Check the supply voltage and \
                 connections, then the drive for binding.",
                text::subject(name, Some(direction))
            );
            let plain = Evidence::plain(severity, throw, said);
            Evidence { change_pct: Some(longer_pct), direction: Some(direction), ..plain }
        };
        let event = if self.very_slow >= SLOW_IN_A_ROW {
            match board.severity(Cause::SlowThrow) {
                None => board.raise(Cause::SlowThrow, evidence(Severity::Critical), at),
                Some(_) => board.escalate(Cause::SlowThrow, evidence(Severity::Critical), at),
            }
        } else if self.slow >= SLOW_IN_A_ROW && !explained {
            board.raise(Cause::SlowThrow, evidence(Severity::Warning), at)
        } else if self.fast_enough >= settings.off_delay_throws {
            let said = format!("{}: throws are as fast as the baseline's again.", text::subject(name, None));
            board.clear(Cause::SlowThrow, said, Actor::default(), at)
        } else {
            None
        };
        event.into_iter().collect()
    }

    /// Whether a throw could be evaluated.
    pub(super) fn evaluated(&mut self, evaluated: bool, board: &mut Board, scene: Scene) -> Vec<AlarmEvent> {
        let Scene { name, at, throw, settings } = scene;
        streak(&mut self.unevaluated, !evaluated);
        let subject = text::subject(name, None);
        let event = if evaluated {
            board.clear(
                Cause::NotMonitored,
                format!("{subject}: a throw could be evaluated again."),
                Actor::default(),
                at,
            )
        } else if self.unevaluated >= settings.not_monitored_throws {
            let said = format!(
                "{subject}: the last {} throws could not be evaluated, so the machine is not monitored. Look at the \
                 reasons of the throws not evaluated, and check the sensors.",
                self.unevaluated
            );
            board.raise(Cause::NotMonitored, Evidence::plain(Severity::Warning, throw, said), at)
        } else {
            None
        };
        event.into_iter().collect()
    }

    /// Lets time pass. Silence is the sum of the time between ticks, so a clock that jumps is no silence.
    pub(super) fn tick(&mut self, counts: bool, board: &mut Board, scene: Scene) -> Vec<AlarmEvent> {
        let Scene { name, at, settings, .. } = scene;
        let passed = self.ticked_at.replace(at).map_or(0.0, |before| at.duration_since(before).as_secs_f64());
        self.calm_s += passed.clamp(0.0, USUAL_TICK_S);
        if !counts {
            return Vec::new();
        }
        self.silence_s += passed.clamp(0.0, LONGEST_TICK_S);
        let subject = text::subject(name, None);
        let raise = |board: &mut Board, said| {
            board.raise(Cause::NotMonitored, Evidence::plain(Severity::Warning, None, said), at)
        };
        if let Logger::Gone { for_s, alarmed } = &mut self.logger {
            *for_s += passed.clamp(0.0, USUAL_TICK_S);
            if *for_s >= 60.0 * settings.logger_gone_minutes {
                let said = format!(
                    "{subject}: its logger has been gone for {:.0} minutes, so the machine is not monitored. Check the \
                     logger's supply and the network.",
                    *for_s / 60.0
                );
                let event = raise(board, said);
                *alarmed |= event.is_some();
                return event.into_iter().collect();
            }
        }
        if !self.is_silent(settings) {
            return Vec::new();
        }
        let said = format!(
            "{subject}: no throw arrived for {:.0} hours, so the machine is not monitored. Check the logger and the \
             network; if the machine was not used, acknowledge.",
            self.silence_s / 3600.0
        );
        raise(board, said).into_iter().collect()
    }

    fn is_silent(&self, settings: &Settings) -> bool {
        self.silence_s >= 3600.0 * settings.not_monitored_hours
    }

    /// Whether the logger shows at this moment that it is alive. One that never did is not missed.
    pub(super) fn logger(&mut self, there: bool, board: &mut Board, scene: Scene) -> Option<AlarmEvent> {
        let before = self.logger;
        self.logger = match before {
            _ if there => Logger::There,
            Logger::There => Logger::Gone { for_s: 0.0, alarmed: false },
            absent => absent,
        };
        let alarmed = matches!(before, Logger::Gone { alarmed: true, .. });
        let monitored = self.unevaluated < scene.settings.not_monitored_throws && !self.is_silent(scene.settings);
        if !(there && alarmed && monitored) {
            return None;
        }
        let said = format!("{}: its logger is there again.", text::subject(scene.name, None));
        board.clear(Cause::NotMonitored, said, Actor::default(), scene.at)
    }

    /// Whether the logger has ever shown that it is alive.
    pub(super) fn is_announced(&self) -> bool {
        self.logger != Logger::Unannounced
    }

    /// What keeps the daemon itself from keeping data; `None` when nothing does.
    pub(super) fn trouble(
        &mut self,
        trouble: Option<(Severity, &str)>,
        board: &mut Board,
        scene: Scene,
    ) -> Option<AlarmEvent> {
        let Some((severity, said)) = trouble else {
            if self.calm_s < CALM_S {
                return None;
            }
            let said = "pointsd keeps everything again.".to_owned();
            return board.clear(Cause::DataLoss, said, Actor::default(), scene.at);
        };
        self.calm_s = 0.0;
        let evidence = || Evidence::plain(severity, None, said.to_owned());
        match board.severity(Cause::DataLoss) {
            None => board.raise(Cause::DataLoss, evidence(), scene.at),
            Some(before) if severity > before => board.escalate(Cause::DataLoss, evidence(), scene.at),
            Some(_) => None,
        }
    }

    /// Throws were lost on their way.
    pub(super) fn gap(&mut self, lost: u64, board: &mut Board, scene: Scene) -> Vec<AlarmEvent> {
        if lost == 0 {
            return Vec::new();
        }
        self.since_gap = 0;
        self.lost = self.lost.saturating_add(lost);
        let said = format!(
            "{}: {} never arrived. Check the link to the logger; what happened in between is not known.",
            text::subject(scene.name, None),
            if lost == 1 { "1 throw".to_owned() } else { format!("{lost} throws") }
        );
        let evidence = Evidence::plain(Severity::Warning, scene.throw, said);
        board.raise(Cause::DataLoss, evidence, scene.at).into_iter().collect()
    }

    /// The machine was out of service: what happened meanwhile says nothing.
    pub(super) fn reset(&mut self) {
        *self = Self {
            ticked_at: self.ticked_at,
            since_gap: self.since_gap,
            lost: self.lost,
            logger: self.logger,
            ..Self::default()
        };
    }
}
