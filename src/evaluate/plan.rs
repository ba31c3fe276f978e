//! A run as a list of independent lives, which any number of threads can simulate in any order.

use rand_chacha::ChaCha8Rng;

use super::{
    catalogue::catalogue,
    coverage::Coverage,
    cusum::Design,
    domain,
    healthy::FLEETS,
    judge::{Judgement, judge, names_wrongly},
    life::{Rules, Source, live},
    observation::observation,
    parameter::ParameterMachine,
    random::stream,
    report::{Budget, Healthy, Lives, Report, Row},
    scatter::Scatter,
    scenario::{Depth, Limits, Noise, Scenario, Situation},
    timeline::Timeline,
    trace::TraceMachine,
};
use crate::diagnose::{Cause, Estimated, MachineMonitor, Settings};

/// Numbers of lives and throws to simulate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Amount {
    /// Lives in each row at parameter depth.
    pub trials: usize,
    /// Lives in each row at trace depth.
    pub trace_trials: usize,
    /// Healthy throws at parameter depth, in total.
    pub healthy_throws: usize,
    /// Healthy throws at trace depth, in total.
    pub trace_healthy_throws: usize,
    /// Throws of each healthy fleet whose scatter or weather the diagnosis does not assume.
    pub fleet_throws: usize,
    /// Lives in the budget section, for each serial correlation.
    pub budget_lives: usize,
}

impl Amount {
    /// The amount at which the goals are checked.
    pub const FULL: Self = Self {
        trials: 500,
        trace_trials: 20,
        healthy_throws: 1_000_000,
        trace_healthy_throws: 5_000,
        fleet_throws: 200_000,
        budget_lives: 400,
    };
    /// A tenth of [`Self::FULL`]; a quarter of the lives in the budget section.
    pub const QUICK: Self = Self {
        trials: 50,
        trace_trials: 2,
        healthy_throws: 100_000,
        trace_healthy_throws: 500,
        fleet_throws: 20_000,
        budget_lives: 100,
    };
}

/// Monitored throws of a healthy life at parameter depth.
const HEALTHY_LIFE: usize = 10_000;
/// Monitored throws of a healthy life at trace depth, where a throw needs more computing time.
const HEALTHY_TRACE_LIFE: usize = 500;
/// Monitored throws of a life in a fleet: 200 days, in which the season changes the temperature by more than 20 K.
const FLEET_LIFE: usize = 4_000;

/// Serial correlations of the scatter in the budget section.
const BUDGET_PHI: [f64; 4] = [0.0, 0.2, 0.4, 0.6];
/// Throws of a machine for each false alarm that the budget section allows.
const BUDGET_THROWS: f64 = 5_000.0;
/// Monitored throws of a life in the budget section, if no alarm ends it.
const BUDGET_LIFE: usize = 5_000;
/// The smallest warning limit that the settings allow \[%\]: in effect no limit.
const NO_LIMIT_PCT: f64 = 0.001;

/// A life to simulate; `machine` is its number, which selects the random stream, and the others are indices.
#[derive(Debug, Clone, Copy)]
enum Task {
    /// A healthy machine; `fleet`: index in [`FLEETS`], `None` for the usual fleet.
    Healthy { depth: Depth, fleet: Option<usize>, machine: usize, throws: usize },
    /// A machine with the fault of a row.
    Row { row: usize, trial: usize },
    /// A healthy machine of the budget section.
    Budget { phi: usize, machine: usize },
}

/// Result of a life. [`Plan::report`] combines the results.
#[derive(Debug, Clone, Copy)]
pub struct Outcome(Kind);

#[derive(Debug, Clone, Copy)]
enum Kind {
    /// The false alarms.
    Healthy(Healthy),
    /// The judgements of the monitor, the paper's rule and the CUSUM; whether the monitor named a healthy part at
    /// critical severity; and the correctness of its sizes and forecasts.
    Row { row: usize, judgements: [Judgement; 3], wrong_critical: bool, coverage: Coverage },
    /// Monitored throws until the first drift alarm, or all.
    Budget { phi: usize, throws: usize, alarmed: bool },
}

/// The lives and settings of a run.
#[derive(Debug)]
pub struct Plan {
    seed: u64,
    settings: Settings,
    budget_settings: Settings,
    scenarios: Vec<Scenario>,
    limits: Limits,
    baseline: usize,
    designs: [Design; 3],
    tasks: Vec<Task>,
}

impl Plan {
    /// Plans a run, and tunes the CUSUM for it.
    pub fn new(seed: u64, amount: Amount, settings: Settings) -> Self {
        let limits = limits(&settings);
        let baseline = settings.baseline_throws;
        let throws = settings.false_alarms_per_throw().recip();
        let scenarios = catalogue(limits);
        let designs =
            [Noise::Low, Noise::Default, Noise::High].map(|noise| Design::tuned(seed, noise, limits, baseline, throws));
        let tasks = tasks(amount, &scenarios);
        let budget_settings = budget_settings(&settings);
        Self { seed, settings, budget_settings, scenarios, limits, baseline, designs, tasks }
    }

    /// Number of lives in the plan.
    pub fn lives(&self) -> usize {
        self.tasks.len()
    }

    /// Simulates life number `life`. The outcome depends only on the plan and this number.
    ///
    /// # Panics
    /// When `life` is not below [`Plan::lives`].
    pub fn live(&self, life: usize) -> Outcome {
        Outcome(match self.tasks[life] {
            Task::Healthy { depth, fleet, machine, throws } => {
                Kind::Healthy(self.healthy(depth, fleet, machine, throws))
            }
            Task::Row { row, trial } => self.row(row, trial),
            Task::Budget { phi, machine } => self.budget(phi, machine),
        })
    }

    /// Makes the report; `outcomes`: those of all lives, in the order of their numbers.
    pub fn report(&self, outcomes: &[Outcome]) -> Report {
        let mut healthy: Vec<Healthy> = Vec::new();
        let mut lives = vec![Lives::default(); self.scenarios.len()];
        let mut budget = BUDGET_PHI.map(|phi| Budget::new(phi, BUDGET_THROWS));
        for Outcome(kind) in outcomes {
            match *kind {
                Kind::Healthy(life) => {
                    match healthy.iter_mut().find(|known| (known.depth, known.fleet) == (life.depth, life.fleet)) {
                        Some(known) => known.add(life),
                        None => healthy.push(life),
                    }
                }
                Kind::Row { row, judgements, wrong_critical, coverage } => {
                    lives[row].judgements.push(judgements);
                    lives[row].coverage.merge(coverage);
                    lives[row].wrong_critical += usize::from(wrong_critical);
                }
                Kind::Budget { phi, throws, alarmed } => budget[phi].add(throws, alarmed),
            }
        }
        healthy.sort_by_key(|healthy| (healthy.fleet.is_some(), healthy.depth as u8));
        let lived = self.scenarios.iter().zip(&lives).filter(|(_, lives)| !lives.judgements.is_empty());
        let rows = lived.map(|(scenario, lives)| Row::new(scenario, lives)).collect();
        let budget = budget.into_iter().filter(|budget| budget.throws > 0).collect();
        Report { seed: self.seed, healthy, rows, budget }
    }

    /// Simulates a healthy life of `throws` monitored throws; every alarm in it is false.
    fn healthy(&self, depth: Depth, fleet: Option<usize>, machine: usize, throws: usize) -> Healthy {
        let random = |domain, row| stream(self.seed, domain, row, machine);
        let (rules, length) = (self.rules(Situation::Plain, Noise::Default), 2 * self.baseline + throws);
        let fleet = fleet.map(|at| (at, FLEETS[at]));
        let calls = if let Some((at, fleet)) = fleet {
            let life = fleet.life(length, &mut random(domain::WEATHER, at));
            live(drawn(random(domain::FLEET, at), Noise::Default, fleet.scatter, &life), &life, rules)
        } else {
            let (life, random) = (Timeline::healthy(length), random(domain::HEALTHY, depth as usize));
            live(source(depth, Situation::Plain, Noise::Default, random, &life), &life, rules)
        };
        Healthy {
            depth,
            throws,
            false_alarms: calls.raised,
            not_monitored: calls.not_monitored,
            paper_false_alarms: calls.paper.len(),
            cusum_false_alarms: calls.cusum.len(),
            fleet: fleet.map(|(_, fleet)| fleet.label),
        }
    }

    fn row(&self, row: usize, trial: usize) -> Kind {
        let scenario = &self.scenarios[row];
        let mut random = stream(self.seed, domain::TIMELINE, row, trial);
        let life = Timeline::of(scenario, trial, 2 * self.baseline, &mut random);
        let random = stream(self.seed, domain::ROW, row, trial);
        let source = source(scenario.depth, scenario.situation, scenario.noise, random, &life);
        let calls = live(source, &life, self.rules(scenario.situation, scenario.noise));
        let rules = [(&calls.monitor, calls.trend), (&calls.paper, None), (&calls.cusum, None)];
        let judgements = rules.map(|(calls, trend)| judge(calls, trend, &life));
        let wrong_critical = names_wrongly(&calls.monitor, &life);
        Kind::Row { row, judgements, wrong_critical, coverage: calls.coverage }
    }

    /// Simulates a healthy life until its first drift alarm. The warning limits are near 0, so only the false-alarm
    /// budget prevents alarms.
    fn budget(&self, phi: usize, machine: usize) -> Kind {
        let random = stream(self.seed, domain::BUDGET, phi, machine);
        let scatter = Scatter { phi: BUDGET_PHI[phi], ..Scatter::USUAL };
        let life = Timeline::healthy(2 * self.baseline + BUDGET_LIFE);
        let mut source = drawn(random, Noise::Default, scatter, &life);
        let mut monitor = MachineMonitor::new("evaluated");
        for at in 0..life.throws {
            // With such limits any scatter raises `not_monitored`, so only drift alarms count.
            let events = monitor.observe(&source(at), &self.budget_settings).events;
            let alarmed = events.iter().any(|event| event.cause.is_drift());
            if alarmed {
                let throws = (at + 1).saturating_sub(2 * self.baseline);
                return Kind::Budget { phi, throws, alarmed };
            }
        }
        Kind::Budget { phi, throws: BUDGET_LIFE, alarmed: false }
    }

    fn rules(&self, situation: Situation, noise: Noise) -> Rules<'_> {
        let short = situation == Situation::ShortBaseline;
        let baseline = if short { self.settings.baseline_usable_throws } else { self.baseline };
        Rules { settings: &self.settings, limits: self.limits, baseline, cusum: self.designs[noise as usize] }
    }
}

/// The throws of a life.
fn source(depth: Depth, situation: Situation, noise: Noise, random: ChaCha8Rng, life: &Timeline) -> Source<'_> {
    match depth {
        Depth::Parameter => drawn(random, noise, Scatter::USUAL, life),
        Depth::Trace => {
            let mut machine = TraceMachine::new(random, situation, noise, life);
            Box::new(move |at| machine.observe(at))
        }
    }
}

/// The throws of a life at parameter depth.
fn drawn(random: ChaCha8Rng, noise: Noise, scatter: Scatter, life: &Timeline) -> Source<'_> {
    let mut machine = ParameterMachine::new(random, noise, scatter);
    Box::new(move |at| {
        let (coefficients, covariance) = machine.throw(at % 2, life.displacement(at));
        observation(at, Some(Estimated::new(coefficients, covariance)), life.temperature_c(at))
    })
}

/// All lives of a run, the long ones at trace depth first, so that the threads end at about the same time.
fn tasks(amount: Amount, scenarios: &[Scenario]) -> Vec<Task> {
    let lives = |total: usize, each: usize| {
        (0..total.div_ceil(each)).map(move |machine| (machine, each.min(total - machine * each)))
    };
    let healthy = |depth, fleet, total, each| {
        lives(total, each).map(move |(machine, throws)| Task::Healthy { depth, fleet, machine, throws })
    };
    let fleets =
        (0..FLEETS.len()).flat_map(|fleet| healthy(Depth::Parameter, Some(fleet), amount.fleet_throws, FLEET_LIFE));
    let rows = |wanted: Depth, trials: usize| {
        let rows = scenarios.iter().enumerate().filter(move |(_, scenario)| scenario.depth == wanted);
        rows.flat_map(move |(row, _)| (0..trials).map(move |trial| Task::Row { row, trial }))
    };
    let budget = (0..BUDGET_PHI.len()).flat_map(|phi| (0..amount.budget_lives).map(move |machine| (phi, machine)));
    healthy(Depth::Trace, None, amount.trace_healthy_throws, HEALTHY_TRACE_LIFE)
        .chain(rows(Depth::Trace, amount.trace_trials))
        .chain(healthy(Depth::Parameter, None, amount.healthy_throws, HEALTHY_LIFE))
        .chain(fleets)
        .chain(rows(Depth::Parameter, amount.trials))
        .chain(budget.map(|(phi, machine)| Task::Budget { phi, machine }))
        .collect()
}

/// The warning limits as fractions, in the order of [`Cause::PHYSICAL`].
fn limits(settings: &Settings) -> Limits {
    Cause::PHYSICAL.map(|part| settings.limit_pct(part).unwrap_or_default() / 100.0)
}

/// Settings of the budget section: a budget that allows several false alarms in a run, and in effect no warning limits.
fn budget_settings(settings: &Settings) -> Settings {
    let days = BUDGET_THROWS / settings.throws_per_day;
    Settings {
        false_alarm_years: days / 365.25,
        kt_limit_pct: NO_LIMIT_PCT,
        friction_limit_pct: NO_LIMIT_PCT,
        stiffness_limit_pct: NO_LIMIT_PCT,
        inertia_limit_pct: NO_LIMIT_PCT,
        ..settings.clone()
    }
}
