//! The results of a run, as the JSON of `pointsd evaluate --json` has them.

use serde::{Serialize, Serializer};

use super::{
    judge::Judgement,
    scenario::{Depth, Noise, Scenario, Shape},
};

/// Least share of lives named right that a plain row must reach.
pub const GOAL_RIGHT: f64 = 0.99;
/// Largest median delay of a plain step, in throws.
pub const GOAL_STEP_DELAY: f64 = 3.0;
/// By how much the measured rate of false alarms may differ from the budget, as a factor.
pub const GOAL_BUDGET_FACTOR: f64 = 3.0;

/// Everything that a run found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// The run's seed.
    pub seed: u64,
    /// False alarms on healthy machines.
    pub healthy: Vec<Healthy>,
    /// The table.
    pub rows: Vec<Row>,
    /// The budget of false alarms against what was measured.
    pub budget: Vec<Budget>,
}

/// False alarms on healthy machines at one depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Healthy {
    /// Depth of the simulation.
    pub depth: Depth,
    /// Throws with a baseline behind them.
    pub throws: usize,
    /// Alarms of any kind.
    pub false_alarms: usize,
    /// Alarms of the paper's bare rule.
    pub paper_false_alarms: usize,
    /// Alarms of the CUSUM.
    pub cusum_false_alarms: usize,
}

/// The budget of false alarms against what was measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Budget {
    /// Serial correlation of the natural scatter between successive throws of a machine.
    pub phi: f64,
    /// Throws of a machine for each false alarm that the configured budget allows.
    pub throws_per_false_alarm: f64,
    /// Throws watched.
    pub throws: usize,
    /// Alarms raised in them.
    pub false_alarms: usize,
    /// Measured rate over the configured one.
    pub ratio: f64,
}

/// Results of a row of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Depth of the simulation.
    pub depth: Depth,
    /// The part at fault; two joined by `+`.
    pub cause: String,
    /// Development of the fault.
    pub shape: Shape,
    /// Size of the fault \[% of nominal\], in either sign; with two faults, the size of the first.
    pub size_pct: f64,
    /// Noise of the current sensor.
    pub noise: Noise,
    /// Whether the row is one of the hard ones.
    pub hard: bool,
    /// The conditions, in words.
    pub case: &'static str,
    /// Lives.
    pub trials: usize,
    /// The monitor's score.
    #[serde(flatten)]
    pub monitor: Tally,
    /// Lives in which the monitor named a sound part at critical severity, at any time.
    pub wrong_critical: usize,
    /// The paper's bare rule on the same throws.
    #[serde(serialize_with = "without_names")]
    pub paper: Tally,
    /// The CUSUM on the same throws.
    #[serde(serialize_with = "without_names")]
    pub cusum: Tally,
}

/// Results of a rule on the lives of a row.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Tally {
    /// Named right.
    pub right: usize,
    /// Named wrong, or alarmed before there was a fault, or by chance where the baseline has learned it.
    pub wrong: usize,
    /// Alarmed without a name.
    pub ambiguous: usize,
    /// Lives without any name, or with only one of two causes named.
    pub missed: usize,
    /// Median throws from the onset of the fault to the right name.
    pub delay_median: Option<f64>,
    /// 95th percentile of the same.
    pub delay_p95: Option<f64>,
}

impl Healthy {
    /// Results before any throw.
    pub(super) fn none(depth: Depth) -> Self {
        Self { depth, throws: 0, false_alarms: 0, paper_false_alarms: 0, cusum_false_alarms: 0 }
    }
}

impl Tally {
    /// Counts the judgements of a row's lives.
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
        tally.delay_median = quantile(&delays, 0.5);
        tally.delay_p95 = quantile(&delays, 0.95);
        tally
    }
}

/// The smallest of the sorted values that at least this share of them does not exceed.
fn quantile(sorted: &[usize], share: f64) -> Option<f64> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count, at least 1")]
    let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).map(|&delay| delay as f64)
}

/// A comparator's tally: an alarm without a name names nothing, so it counts as missed.
fn without_names<S: Serializer>(tally: &Tally, serializer: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct Comparator {
        right: usize,
        wrong: usize,
        missed: usize,
        delay_median: Option<f64>,
    }
    let missed = tally.missed + tally.ambiguous;
    let (right, wrong, delay_median) = (tally.right, tally.wrong, tally.delay_median);
    Comparator { right, wrong, missed, delay_median }.serialize(serializer)
}

impl Row {
    /// The row of a scenario whose lives were judged.
    pub(super) fn new(scenario: &Scenario, trials: usize, wrong_critical: usize, tallies: [Tally; 3]) -> Self {
        let [monitor, paper, cusum] = tallies;
        let cause: Vec<&str> = scenario.faults.iter().map(|(part, _)| part.as_str()).collect();
        Self {
            depth: scenario.depth,
            cause: cause.join("+"),
            shape: scenario.shape,
            // Free of the last binary digits of the multiplication by a limit.
            size_pct: (scenario.faults[0].1 * 1e4).round() / 1e2,
            noise: scenario.noise,
            hard: scenario.hard,
            case: scenario.situation.label(),
            trials,
            monitor,
            wrong_critical,
            paper,
            cusum,
        }
    }

    /// Goals that this row does not meet, in words; empty when it meets all.
    #[must_use]
    pub fn shortfalls(&self) -> Vec<String> {
        let mut shortfalls = Vec::new();
        let right = self.monitor.right as f64;
        if !self.hard && right < GOAL_RIGHT * self.trials as f64 {
            shortfalls.push(format!("{} of {} named right", self.monitor.right, self.trials));
        }
        let late = self.monitor.delay_median.filter(|delay| *delay > GOAL_STEP_DELAY);
        if let Some(delay) = late.filter(|_| !self.hard && self.shape == Shape::Step) {
            shortfalls.push(format!("median delay {delay} throws"));
        }
        if self.wrong_critical > 0 && self.cause.contains('+') {
            shortfalls.push(format!("a sound part named at critical severity in {} lives", self.wrong_critical));
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
    /// A budget of one alarm in `throws_per_false_alarm` throws, nothing measured yet.
    pub(super) fn new(phi: f64, throws_per_false_alarm: f64) -> Self {
        Self { phi, throws_per_false_alarm, throws: 0, false_alarms: 0, ratio: 0.0 }
    }

    /// Adds a life that was watched for `throws`, up to its first alarm when it `alarmed`.
    pub(super) fn add(&mut self, throws: usize, alarmed: bool) {
        self.throws += throws;
        self.false_alarms += usize::from(alarmed);
        self.ratio = self.false_alarms as f64 / (self.throws as f64 / self.throws_per_false_alarm);
    }

    /// Whether the measured rate is within the goal's factor of the configured one.
    #[must_use]
    pub fn holds(&self) -> bool {
        (1.0 / GOAL_BUDGET_FACTOR..=GOAL_BUDGET_FACTOR).contains(&self.ratio)
    }
}

impl Report {
    /// Every goal that the run did not meet, one sentence each.
    #[must_use]
    pub fn shortfalls(&self) -> Vec<String> {
        let healthy = self.healthy.iter().filter(|healthy| healthy.false_alarms > 0);
        let healthy = healthy.map(|h| format!("{} false alarms in {} healthy throws", h.false_alarms, h.throws));
        let rows = self.rows.iter().flat_map(|row| {
            let name = format!(
                "{} {} {} % ({}, {} noise)",
                row.cause,
                row.shape.as_str(),
                row.size_pct,
                row.case,
                row.noise.as_str()
            );
            row.shortfalls().into_iter().map(move |shortfall| format!("{name}: {shortfall}"))
        });
        let budget = self.budget.iter().filter(|budget| !budget.holds());
        let budget = budget.map(|b| format!("false alarms at phi {} are {:.2} times their budget", b.phi, b.ratio));
        healthy.chain(rows).chain(budget).collect()
    }
}
