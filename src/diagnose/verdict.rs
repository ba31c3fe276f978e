//! What all recent throws of a machine say together, and which alarm events follow.

use jiff::Timestamp;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{
    AlarmEvent, Cause, MachineMonitor, Settings, Severity,
    alarm::{Actor, Evidence},
    cause::{DECISIVE, Finding, Naming, Rival},
    condition::{Claim, Reading, Step},
    drift::Window,
    explain::{Explanation, direction_of, percent, relevance, single},
    scatter::Scatter,
    text,
    trend::{LimitForecast, forecast},
};
use crate::throw::{Direction, ThrowRef};

/// The causes that come from a drift, in the order of the monitor's conditions.
const DRIFTS: [Cause; 5] = [Cause::Kt, Cause::Friction, Cause::Stiffness, Cause::Inertia, Cause::Unattributed];

/// A lead from which an alarm with one name waits no longer: odds of 150 to 1.
const SAFE: f64 = 10.0;
/// Throws by which an alarm waits longer while its name could still be another: the next ones settle it.
const DOUBTED_PATIENCE: u32 = 2;
/// Throws by which an alarm without a single name waits longer: the first throws after a step are few, and what they
/// leave open the next ones usually settle.
const UNNAMED_PATIENCE: u32 = 6;
/// The same when two explanations are too close to call: a longest window tells most of them apart.
const TOO_CLOSE_PATIENCE: u32 = 24;

/// By how much warning limits are wider on a provisional baseline: it has not seen the machine's weather yet.
const PROVISIONAL_WIDENING: f64 = 1.5;

/// When a drift was first suspected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Onset {
    first: ThrowRef,
    order: u64,
}

/// What the last throws say.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drift {
    /// T of the strongest window over its limit.
    excess: f64,
    /// Whether a baseline behind it is still being learned.
    provisional: bool,
    /// Named, when detected.
    finding: Option<Finding>,
    /// Its name has an active alarm.
    is_alarmed: bool,
    /// Present level of each direction.
    levels: [Option<Window>; 2],
    /// Side of the latest throw, and the level of its last few throws.
    latest: (usize, Option<Window>),
}

impl Drift {
    pub(super) fn new(
        strongest: Option<(Window, &Scatter)>,
        provisional: bool,
        levels: [Option<Window>; 2],
        latest: (usize, Option<Window>),
        open: &[Cause],
        settings: &Settings,
    ) -> Self {
        let excess = strongest.map_or(0.0, |(window, _)| window.excess);
        let finding = strongest
            .filter(|_| excess > 1.0)
            .map(|(window, scatter)| Finding::of(&window, &scatter.of_one_throw(), open, settings));
        let is_alarmed = finding.as_ref().is_some_and(|finding| open.contains(&finding.cause()));
        Self { excess, provisional, finding, is_alarmed, levels, latest }
    }

    /// Whether a drift is detected and above its limit, whatever its name.
    pub(super) fn matters(&self) -> bool {
        let limit = if self.provisional { PROVISIONAL_WIDENING } else { 1.0 };
        self.finding.as_ref().is_some_and(|finding| finding.relevance > limit)
    }

    /// What the throw says about `cause`.
    #[expect(clippy::option_option, reason = "no alarm is not an alarm in both directions")]
    fn reading(&self, cause: Cause, alarmed: Option<Option<Direction>>, settings: &Settings) -> Reading {
        let named = self.finding.as_ref().filter(|finding| finding.cause() == cause);
        let undoubted = named.filter(|finding| cause == Cause::Unattributed || finding.lead >= DECISIVE);
        let other = self.finding.as_ref().is_some_and(|finding| {
            matches!(finding.naming, Naming::One(_)) && !finding.includes(cause) && finding.relevance > 1.0
        });
        let levels = self.levels.iter().flatten();
        let (size, bound) = levels.map(|window| extent(cause, window, settings)).fold((0.0, 0.0), max_of_each);
        let (side, last_few) = &self.latest;
        let concerned = alarmed.flatten().is_none_or(|direction| Direction::BOTH[*side] == direction);
        let latest = last_few.as_ref().filter(|_| concerned && alarmed.is_some());
        let latest = latest.map(|window| extent(cause, window, settings).0);
        let deadband = 1.0 - settings.deadband_pct / 100.0;
        let claim = match named {
            Some(_) if self.matters() => Claim::Named,
            // No name has settled, whatever the throws in between were taken for.
            _ if cause == Cause::Unattributed && self.matters() && !self.is_alarmed => Claim::Counts,
            _ => Claim::None,
        };
        Reading {
            claim,
            undoubted: undoubted.map_or(0.0, |finding| finding.relevance),
            patience: named.map_or(0, |finding| match (finding.naming, finding.rival) {
                (Naming::One(_), _) if finding.lead >= SAFE => 0,
                (Naming::One(_), _) => DOUBTED_PATIENCE,
                (Naming::Either(..), _) | (_, Some(Rival::Alone(_))) => TOO_CLOSE_PATIENCE,
                (Naming::Both(..) | Naming::Neither, _) => UNNAMED_PATIENCE,
            }),
            plain_health: bound < 0.5,
            below: self.finding.is_none() || size < deadband,
            other_name: other,
            latest,
        }
    }

    /// The direction in which `cause` shows; `None` for both.
    fn direction(&self, cause: Cause, settings: &Settings) -> Option<Direction> {
        let size = |at: usize| self.levels[at].as_ref().map(|window| extent(cause, window, settings).0);
        match (size(0), size(1)) {
            (Some(_), None) => Some(Direction::NormalToReverse),
            (None, Some(_)) => Some(Direction::ReverseToNormal),
            (Some(normal), Some(reverse)) if reverse < 0.5 * normal => Some(Direction::NormalToReverse),
            (Some(normal), Some(reverse)) if normal < 0.5 * reverse => Some(Direction::ReverseToNormal),
            _ => None,
        }
    }
}

/// Size of `cause` in a window over its warning limit; and the same with two standard deviations added.
fn extent(cause: Cause, window: &Window, settings: &Settings) -> (f64, f64) {
    let of = |cause: Cause| {
        let e = single(cause, &window.mean, &window.covariance, settings);
        let bound = e.size.abs() + 2.0 * e.size_sd;
        (relevance(cause, e.size, settings), relevance(cause, bound, settings))
    };
    if cause == Cause::Unattributed {
        Cause::PHYSICAL.into_iter().map(of).fold((0.0, 0.0), max_of_each)
    } else {
        of(cause)
    }
}

fn max_of_each(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0.max(b.0), a.1.max(b.1))
}

impl MachineMonitor {
    /// The alarm events that follow from what the last throws say.
    pub(super) fn judge(
        &mut self,
        drift: &Drift,
        id: &ThrowRef,
        at: Timestamp,
        settings: &Settings,
    ) -> Vec<AlarmEvent> {
        self.follow_onset(drift, id);
        let mut events = Vec::new();
        for (index, cause) in DRIFTS.into_iter().enumerate() {
            let active = self.board.severity(cause);
            let reading = drift.reading(cause, self.board.direction(cause), settings);
            match self.conditions[index].step(reading, active, settings) {
                Step::Stay => {}
                Step::Raise(severity) => {
                    let evidence = self.evidence(cause, severity, drift, id, settings);
                    events.extend(evidence.and_then(|evidence| self.board.raise(cause, evidence, at)));
                }
                Step::Escalate => {
                    let evidence = self.evidence(cause, Severity::Critical, drift, id, settings);
                    events.extend(evidence.and_then(|evidence| self.board.escalate(cause, evidence, at)));
                }
                Step::Clear { at_once } => {
                    let said = text::cleared(&text::subject(&self.name, None), cause, at_once);
                    events.extend(self.board.clear(cause, said, Actor::default(), at));
                }
                Step::ProposeRebaseline => {
                    let said = text::maybe_repaired(&text::subject(&self.name, None), cause);
                    events.extend(self.board.remark(cause, said, at));
                }
                Step::Withdraw => {
                    let name = drift.finding.as_ref().map_or(Cause::Unattributed, Finding::cause);
                    let said = text::withdrawn(&text::subject(&self.name, None), cause, name);
                    events.extend(self.board.clear(cause, said, Actor::default(), at));
                }
            }
        }
        events
    }

    /// A drift is suspected from half of its limit on, and forgotten below a quarter.
    fn follow_onset(&mut self, drift: &Drift, id: &ThrowRef) {
        if drift.excess > 0.5 && self.onset.is_none() {
            self.onset = Some(Onset { first: id.clone(), order: self.order });
        } else if drift.excess < 0.25 {
            self.onset = None;
        }
    }

    fn evidence(
        &self,
        cause: Cause,
        severity: Severity,
        drift: &Drift,
        id: &ThrowRef,
        settings: &Settings,
    ) -> Option<Evidence> {
        let finding = drift.finding.as_ref()?;
        let main = finding.main();
        let direction = drift.direction(cause, settings);
        let limit_in_throws = match (severity, &finding.naming) {
            (Severity::Warning, Naming::One(main)) => self.forecast(main, direction, settings),
            _ => None,
        };
        let throws = self.onset.as_ref().map_or(1, |onset| self.order - onset.order + 1);
        let subject = text::subject(&self.name, direction);
        Some(Evidence {
            severity,
            change_pct: main.map(|main| percent(main.size)),
            change_pct_sd: main.map(text::sd_pct),
            direction,
            runner_up: finding.runner_up,
            correlation: Some(finding.correlation),
            first_throw: self.onset.as_ref().map(|onset| onset.first.clone()),
            last_throw: Some(id.clone()),
            limit_in_throws,
            text: text::drift(&subject, finding, throws, limit_in_throws.as_ref()),
        })
    }

    /// When a drift reaches its critical limit: from the last throws, else from the whole history.
    fn forecast(&self, main: &Explanation, direction: Option<Direction>, settings: &Settings) -> Option<LimitForecast> {
        let d = direction_of(main.cause)?;
        let weights: Vector3<f64> = d / d.dot(&d);
        let critical_pct = settings.critical_factor * settings.limit_pct(main.cause)?;
        let limit = (main.size.signum() * critical_pct / 100.0).ln_1p();
        if !limit.is_finite() {
            return None;
        }
        let tail = self.tracks.recent(direction);
        let mut series: Vec<f64> = tail.iter().map(|recent| weights.dot(&recent.residual())).collect();
        series.reverse();
        let spacing = if direction.is_some() { 2.0 } else { 1.0 };
        forecast(&series, spacing, limit).or_else(|| {
            let (spacing, series) = self.history.along(&weights);
            forecast(&series, spacing, limit)
        })
    }
}
