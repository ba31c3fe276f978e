//! The results of a run, which `pointsd evaluate --json` prints.

use serde::Serialize;

use super::{
    coverage::Coverage,
    judge::Judgement,
    scenario::{Depth, Growth, Noise, Scenario, Situation},
};
use crate::diagnose::Cause;

/// Goal: least share of lives that are named right in a plain row.
const GOAL_RIGHT: f64 = 0.99;
/// Goal: largest median delay in a plain row with a step \[throws\]; the median of fewer lives is chance.
const GOAL_STEP_DELAY: f64 = 3.0;
const LEAST_LIVES: usize = 10;
/// Goal: largest factor between the measured rate of false alarms and the budget, in either sense.
const GOAL_BUDGET_FACTOR: f64 = 3.0;

/// All results of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Seed of the run.
    pub seed: u64,
    /// False alarms on healthy machines.
    pub healthy: Vec<Healthy>,
    /// The rows of the table, one for each fault.
    pub rows: Vec<Row>,
    /// Measured false alarms against their budget.
    pub budget: Vec<Budget>,
}

/// False alarms on the healthy machines of one fleet at one depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Healthy {
    /// Depth of the simulation.
    pub depth: Depth,
    /// Monitored throws, after the baseline.
    pub throws: usize,
    /// Alarms of the monitor about a part, a sensor, the supply or the operation.
    pub false_alarms: usize,
    /// Alarms of the monitor that a machine is not monitored, because its scatter hides a fault at the critical limit.
    pub not_monitored: usize,
    /// Alarms of the paper's rule.
    pub paper_false_alarms: usize,
    /// Alarms of the CUSUM.
    pub cusum_false_alarms: usize,
    /// Name of a fleet whose scatter or weather the diagnosis does not assume; `None` for the usual fleet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fleet: Option<&'static str>,
}

impl Healthy {
    /// Adds another life.
    pub(super) fn add(&mut self, life: Self) {
        self.throws += life.throws;
        self.false_alarms += life.false_alarms;
        self.not_monitored += life.not_monitored;
        self.paper_false_alarms += life.paper_false_alarms;
        self.cusum_false_alarms += life.cusum_false_alarms;
    }
}

/// Measured false alarms against their budget, at one serial correlation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Budget {
    /// Correlation of consecutive throws of a machine in the natural scatter.
    pub phi: f64,
    /// The configured budget: throws of a machine for each false alarm.
    pub throws_per_false_alarm: f64,
    /// Monitored throws.
    pub throws: usize,
    /// Alarms in these throws.
    pub false_alarms: usize,
    /// Ratio of the measured to the configured rate.
    pub ratio: f64,
}

/// Results of a row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Depth of the simulation.
    pub depth: Depth,
    /// The faulty parts.
    #[serde(skip)]
    pub(super) parts: Vec<Cause>,
    /// The faulty part; two are joined by `+`.
    pub cause: String,
    /// Growth of the fault.
    pub shape: Growth,
    /// Magnitude of the fault \[% of nominal\]; with two faults, of the first.
    pub size_pct: f64,
    /// Noise of the current sensor.
    pub noise: Noise,
    /// Whether the row is hard; otherwise it is plain.
    pub hard: bool,
    /// The conditions.
    #[serde(skip)]
    pub(super) situation: Situation,
    /// Name of the conditions.
    pub case: &'static str,
    /// Number of lives.
    pub trials: usize,
    /// Results of the monitor.
    #[serde(flatten)]
    pub monitor: Tally,
    /// Lives in which the monitor named a healthy part at critical severity at any time.
    pub wrong_critical: usize,
    /// Share of the monitor's 95 % intervals of the size that contain the true size; `None` without an interval.
    pub size_coverage: Option<f64>,
    /// Share of the monitor's forecasts that contain the true throws to the critical limit; `None` without a forecast.
    pub forecast_coverage: Option<f64>,
    /// Results of the paper's rule on the same throws.
    pub paper: Tally,
    /// Results of the CUSUM on the same throws.
    pub cusum: Tally,
}

/// Results of a rule on the lives of a row.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Tally {
    /// Lives named right; see the definitions in [`super`].
    pub right: usize,
    /// Lives named wrong.
    pub wrong: usize,
    /// Lives with an alarm without a name.
    pub ambiguous: usize,
    /// Lives without an alarm, or with only one of two causes named.
    pub missed: usize,
    /// Median throws from the onset of the fault to the right name; `None` if no life was named right.
    pub delay_median: Option<f64>,
    /// 95th percentile of the throws from the onset of the fault to the right name; `None` if no life was named right.
    pub delay_p95: Option<f64>,
}

/// The judged lives of a row.
#[derive(Debug, Clone, Default)]
pub(super) struct Lives {
    /// For each life, the judgements of the monitor, the paper's rule and the CUSUM.
    pub(super) judgements: Vec<[Judgement; 3]>,
    /// Lives in which the monitor named a healthy part at critical severity.
    pub(super) wrong_critical: usize,
    pub(super) coverage: Coverage,
}

impl Tally {
    /// Counts the judgements of the lives of a row.
    pub(super) fn of(judgements: impl Iterator<Item = Judgement>) -> Self {
        let mut tally = Self::default();
        let mut delays = Vec::new();
        for judgement in judgements {
            match judgement {
                Judgement::Right(delay) => {
                    tally.right += 1;
                    delays.push(delay);
                }
                Judgement::Wrong => tally.wrong += 1,
                Judgement::Ambiguous => tally.ambiguous += 1,
                Judgement::Missed => tally.missed += 1,
            }
        }
        delays.sort_unstable();
        [tally.delay_median, tally.delay_p95] =
            [0.5, 0.95].map(|share| quantile(&delays, share).map(|delay| delay as f64));
        tally
    }
}

/// Quantile of sorted values: the smallest value such that at least this share of the values is not larger.
pub(crate) fn quantile<T: Copy>(sorted: &[T], share: f64) -> Option<T> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count, at least 1")]
    let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied()
}

impl Row {
    /// The row of a scenario, from its judged lives.
    pub(super) fn new(scenario: &Scenario, lives: &Lives) -> Self {
        let [monitor, paper, cusum] = [0, 1, 2].map(|rule| Tally::of(lives.judgements.iter().map(|three| three[rule])));
        // An alarm of a comparator without a name counts as missed.
        let named = |tally: Tally| Tally { ambiguous: 0, missed: tally.missed + tally.ambiguous, ..tally };
        let parts: Vec<Cause> = scenario.faults.iter().map(|(part, _)| *part).collect();
        Self {
            depth: scenario.depth,
            cause: parts.iter().map(|part| part.as_str()).collect::<Vec<_>>().join("+"),
            parts,
            shape: scenario.shape,
            // Rounded, as the fraction is not exact in binary.
            size_pct: (scenario.faults[0].1 * 1e4).round() / 1e2,
            noise: scenario.noise,
            hard: scenario.hard,
            situation: scenario.situation,
            case: scenario.situation.label(),
            trials: lives.judgements.len(),
            monitor,
            wrong_critical: lives.wrong_critical,
            size_coverage: lives.coverage.sizes.value(),
            forecast_coverage: lives.coverage.forecasts.value(),
            paper: named(paper),
            cusum: named(cusum),
        }
    }

    /// The goals that this row does not meet, as sentences.
    pub fn shortfalls(&self) -> Vec<String> {
        let mut shortfalls = Vec::new();
        let right = self.monitor.right as f64;
        if !self.hard && right < GOAL_RIGHT * self.trials as f64 {
            shortfalls.push(format!("{} of {} named right", self.monitor.right, self.trials));
        }
        let late = self.monitor.delay_median.filter(|delay| *delay > GOAL_STEP_DELAY && self.trials >= LEAST_LIVES);
        if let Some(delay) = late.filter(|_| !self.hard && self.shape == Growth::Step) {
            shortfalls.push(format!("median delay {delay} throws"));
        }
        if self.wrong_critical > 0 && self.parts.len() > 1 {
            shortfalls.push(format!("a healthy part named at critical severity in {} lives", self.wrong_critical));
        }
        for (name, comparator) in [("the paper's rule", &self.paper), ("CUSUM", &self.cusum)] {
            if comparator.right > self.monitor.right {
                shortfalls.push(format!("{name} named {} right, pointsd {}", comparator.right, self.monitor.right));
            }
        }
        shortfalls
    }
}

impl Budget {
    /// A budget of one alarm in `throws_per_false_alarm` throws, without measurements.
    pub(super) fn new(phi: f64, throws_per_false_alarm: f64) -> Self {
        Self { phi, throws_per_false_alarm, throws: 0, false_alarms: 0, ratio: 0.0 }
    }

    /// Adds a life of `throws` monitored throws, which ended with an alarm if `alarmed`.
    pub(super) fn add(&mut self, throws: usize, alarmed: bool) {
        self.throws += throws;
        self.false_alarms += usize::from(alarmed);
        self.ratio = self.false_alarms as f64 / (self.throws as f64 / self.throws_per_false_alarm);
    }

    fn holds(&self) -> bool {
        (1.0 / GOAL_BUDGET_FACTOR..=GOAL_BUDGET_FACTOR).contains(&self.ratio)
    }
}

impl Report {
    /// The goals that the run did not meet, as sentences.
    pub fn shortfalls(&self) -> Vec<String> {
        let usual = self.healthy.iter().filter(|healthy| healthy.fleet.is_none());
        let alarms = usual.map(|healthy| (healthy.false_alarms + healthy.not_monitored, healthy.throws));
        let healthy = alarms
            .filter(|(alarms, _)| *alarms > 0)
            .map(|(alarms, throws)| format!("{alarms} false alarms in {throws} healthy throws"));
        let rows = self.rows.iter().flat_map(|row| {
            let name = format!(
                "{} {} {} % ({}, {} noise)",
                row.cause,
                row.shape.as_ref(),
                row.size_pct,
                row.case,
                row.noise.as_ref()
            );
            row.shortfalls().into_iter().map(move |shortfall| format!("{name}: {shortfall}"))
        });
        let budget = self.budget.iter().filter(|budget| !budget.holds());
        let budget = budget.map(|b| format!("false alarms at phi {} are {:.2} times their budget", b.phi, b.ratio));
        healthy.chain(rows).chain(budget).collect()
    }
}
