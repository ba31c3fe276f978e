//! Queries of the fleet page and the metrics: machines with the worst first, open alarms, windows.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::{FromRow, Row, sqlite::SqliteRow};

use super::{FromSql, Reader, Select, machine::CommandRow, machine_query};
use crate::{
    diagnose::{AlarmState, Cause, Drifting, MachineState},
    store::{
        error::StoreError,
        rows::{baseline, json, time, timestamp, word},
        statements as sql,
    },
    throw::{MachineId, Name, utc},
    wire::{Alarm, BaselineProgress},
};

/// Filters and page of a fleet query.
#[derive(Debug, Clone, Default)]
pub(crate) struct FleetQuery {
    /// A site; `None` for all.
    pub site: Option<Name>,
    /// A state; `None` for all.
    pub state: Option<MachineState>,
    /// The cause of an open alarm; `None` for all machines.
    pub cause: Option<Cause>,
    /// A part of `site/machine`; `None` for all.
    pub search: Option<String>,
    pub offset: u32,
    pub limit: u32,
    /// Throws of each machine for its small chart.
    pub spark: u32,
}

impl FleetQuery {
    /// Binds the five parameters of `matching!`, which are the first ones of `statement`. `itself`: the daemon.
    fn matching<'q, Row: FromSql>(&'q self, statement: &'static str, itself: &'q MachineId) -> Select<'q, Row> {
        sqlx::query_as(statement)
            .bind(self.site.as_ref().map(Name::as_str))
            .bind(self.cause.map(Cause::as_str))
            .bind(self.search.as_deref())
            .bind(itself.site.as_str())
            .bind(itself.machine.as_str())
    }
}

/// Numbers of machines in each state.
#[derive(Debug, Clone, Default)]
pub(crate) struct StateCounts {
    pub states: BTreeMap<MachineState, u64>,
    /// Number of machines that are not monitored and have no other open alarm.
    pub silent: u64,
}

impl StateCounts {
    /// Number of all machines.
    pub(crate) fn total(&self) -> u64 {
        self.states.values().sum()
    }

    pub(crate) fn of(&self, state: MachineState) -> u64 {
        self.states.get(&state).copied().unwrap_or(0)
    }
}

/// A machine in the list of the fleet page.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct FleetRow {
    #[serde(flatten)]
    pub machine: MachineId,
    pub state: MachineState,
    /// Active drifts with their present size, the worst first.
    pub drifts: Vec<Drifting>,
    /// Causes of all open alarms.
    pub causes: Vec<Cause>,
    /// Causes of the alarms that are over, but not acknowledged.
    pub causes_over: Vec<Cause>,
    /// Start of the last judged throw.
    pub started_at: Option<Timestamp>,
    /// Quality of the last judged throw.
    pub quality: Option<String>,
    /// Progress of the baseline of the last throw's direction (or of normal to reverse).
    pub baseline: Option<BaselineProgress>,
    /// Changes of b0, a1 and a0 \[%\] in the newest throws of one direction, oldest first: that of the worst drift, or
    /// else from normal to reverse if the machine has such throws.
    pub spark: Vec<[f64; 3]>,
}

/// An open alarm with the change when the alarm was raised, and the present drifts of the machine.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Fault {
    /// Last event of the alarm.
    #[serde(flatten)]
    pub alarm: Alarm,
    /// Change and its standard deviation when the alarm was raised \[%\].
    #[serde(skip)]
    pub raised: Option<(f64, f64)>,
    /// Active drifts of the machine now.
    pub drifts: Vec<Drifting>,
}

/// Open alarms: active and critical alarms first.
#[derive(Debug)]
pub(crate) struct Faults {
    pub alarms: Vec<Fault>,
    /// Number of alarms that this version cannot read; they are not in `alarms`.
    pub unreadable: usize,
    /// Number of all alarms, also beyond the limit of the query.
    pub total: u64,
}

/// Number of open alarms of one cause and severity.
#[derive(Debug, sqlx::FromRow)]
pub(crate) struct AlarmCount {
    pub(crate) cause: String,
    pub(crate) severity: String,
    pub(crate) open: i64,
    /// Number of these alarms that are neither over, nor shelved, nor in maintenance.
    pub(crate) active: i64,
}

/// The open alarms at one site with a cause that often affects many machines at once (`not_monitored`, `data_loss`).
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct CommonAlarm {
    pub cause: Cause,
    pub site: String,
    /// One of the machines: the first by name.
    pub machine: String,
    /// Number of the alarms.
    pub count: u64,
    /// Time at which the first alarm was raised.
    pub first: Timestamp,
    /// Time at which the last alarm was raised.
    pub last: Timestamp,
    /// Text of the alarms, for `data_loss`, which has several kinds.
    pub text: Option<String>,
    /// State of the alarms.
    pub state: AlarmState,
}

/// An open window: a shelved alarm, or maintenance of a machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Window {
    /// The machine: `site` and `machine` in JSON.
    #[serde(flatten)]
    pub machine: MachineId,
    /// Cause of the shelved alarm; `None` for maintenance.
    pub cause: Option<Cause>,
    /// End of the window.
    pub until: Option<Timestamp>,
    /// Name of the operator.
    pub by: String,
    /// Reason given by the operator.
    pub why: Option<String>,
}

/// The states from the worst to the best: the order in lists.
pub(crate) const WORST_FIRST: [MachineState; 6] = [
    MachineState::Critical,
    MachineState::NotMonitored,
    MachineState::Warning,
    MachineState::Maintenance,
    MachineState::Learning,
    MachineState::Healthy,
];

impl Window {
    /// The window of a shelved alarm, or of an alarm of a machine in maintenance; `None` for an alarm in another state.
    pub fn of<'a>(alarm: &Alarm, windows: &'a [Self]) -> Option<&'a Self> {
        let cause = match alarm.state {
            AlarmState::Shelved => Some(alarm.cause),
            AlarmState::OutOfService => None,
            _ => return None,
        };
        windows.iter().find(|window| window.machine == alarm.machine && window.cause == cause)
    }

    /// A part of a sentence, such as "until 2026-11-21 19:30:12 UTC by A. Meyer: greased".
    pub fn sentence(&self) -> String {
        let until = self.until.map(|until| format!("until {} ", utc(&until)));
        let why = self.why.as_ref().map(|why| format!(": {why}")).unwrap_or_default();
        format!("{}by {}{why}", until.unwrap_or_default(), self.by)
    }
}

impl FromRow<'_, SqliteRow> for FleetRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        let causes = |column| -> sqlx::Result<Vec<Cause>> {
            let causes: Option<&str> = row.try_get(column)?;
            Ok(causes.into_iter().flat_map(|causes| causes.split(',')).filter_map(|it| it.parse().ok()).collect())
        };
        let spark: Option<Vec<[Option<f64>; 3]>> = json(row, "spark")?;
        let all = |[b0, a1, a0]: [Option<f64>; 3]| Some([b0?, a1?, a0?]);
        let spark = spark.unwrap_or_default().into_iter().rev().map(all).skip_while(Option::is_none);
        let spark: Vec<_> = spark.collect();
        // If most throws are rough, the few good ones among them would give a wrong picture of the machine.
        let is_shown = 2 * spark.iter().flatten().count() > spark.len();
        let spark = spark.into_iter().flatten().filter(|_| is_shown).collect();
        Ok(Self {
            machine: MachineId::from_row(row)?,
            state: word(row, "state")?.unwrap_or_default(),
            drifts: json(row, "drifts")?.unwrap_or_default(),
            causes: causes("causes")?,
            causes_over: causes("causes_over")?,
            started_at: row.try_get::<Option<i64>, _>("started_at_us")?.map(timestamp),
            quality: row.try_get("quality")?,
            baseline: baseline(row)?,
            spark,
        })
    }
}

struct FaultRow {
    /// `None` if this version cannot read it.
    fault: Option<Fault>,
    total: i64,
}

impl FromRow<'_, SqliteRow> for FaultRow {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        let size: Option<f64> = row.try_get("raised_pct")?;
        let (raised, drifts) = (size.zip(row.try_get("raised_pct_sd")?), json(row, "drifts")?.unwrap_or_default());
        let fault = json(row, "payload")?.map(|alarm| Fault { alarm, raised, drifts });
        Ok(Self { fault, total: row.try_get("total")? })
    }
}

impl From<Vec<FaultRow>> for Faults {
    fn from(rows: Vec<FaultRow>) -> Self {
        let (read, total) = (rows.len(), rows.first().map_or(0, |row| row.total.cast_unsigned()));
        let alarms: Vec<Fault> = rows.into_iter().filter_map(|row| row.fault).collect();
        Self { unreadable: read - alarms.len(), alarms, total }
    }
}

impl FromRow<'_, SqliteRow> for CommonAlarm {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        Ok(Self {
            cause: word(row, "cause")?.unwrap_or(Cause::NotMonitored),
            site: row.try_get("site")?,
            machine: row.try_get("machine")?,
            count: row.try_get::<i64, _>("count")?.cast_unsigned(),
            first: time(row, "first_us")?,
            last: time(row, "last_us")?,
            text: row.try_get("said")?,
            state: word(row, "state")?.unwrap_or(AlarmState::ActiveUnacknowledged),
        })
    }
}

impl FromRow<'_, SqliteRow> for Window {
    fn from_row(row: &SqliteRow) -> sqlx::Result<Self> {
        let CommandRow { cause, until, by, why, .. } = CommandRow::from_row(row)?;
        Ok(Self { machine: MachineId::from_row(row)?, cause, until, by, why })
    }
}

impl Reader {
    /// A page of the fleet, without the daemon itself.
    pub(crate) async fn fleet(&self, query: &FleetQuery, itself: &MachineId) -> Result<Vec<FleetRow>, StoreError> {
        let statement = query
            .matching(sql::FLEET, itself)
            .bind(query.state.map(MachineState::as_str))
            .bind(query.limit)
            .bind(query.offset)
            .bind(query.spark)
            .bind(WORST_FIRST.map(MachineState::as_str).join(" ").replace("maintenance", "silent maintenance"));
        self.external(statement).await
    }

    /// Number of machines in each state; the filter of the state is ignored.
    pub(crate) async fn tally(&self, query: &FleetQuery, itself: &MachineId) -> Result<StateCounts, StoreError> {
        let rows: Vec<(String, i64, i64)> = self.external(query.matching(sql::STATE_COUNTS, itself)).await?;
        let mut counts = StateCounts::default();
        for (state, count, silent) in rows {
            *counts.states.entry(state.parse().unwrap_or_default()).or_default() += count.cast_unsigned();
            counts.silent += silent.cast_unsigned();
        }
        Ok(counts)
    }

    /// All machines in the order of names, without retired ones.
    pub(crate) async fn machines(&self) -> Result<Vec<MachineId>, StoreError> {
        self.external(sqlx::query_as(sql::MACHINES)).await
    }

    /// The first `limit` sites by name.
    pub(crate) async fn sites(&self, limit: u32) -> Result<Vec<String>, StoreError> {
        let rows: Vec<(String,)> = self.external(sqlx::query_as(sql::SITES).bind(limit)).await?;
        Ok(rows.into_iter().map(|(site,)| site).collect())
    }

    /// Up to `limit` open alarms about the condition of machines.
    pub(crate) async fn faults(&self, limit: u32, itself: &MachineId) -> Result<Faults, StoreError> {
        let rows: Vec<FaultRow> = self.external(machine_query(sql::FAULTS, itself).bind(limit)).await?;
        Ok(rows.into())
    }

    /// Up to `limit` open alarms of a machine, of any cause.
    pub(crate) async fn faults_of(&self, machine: &MachineId, limit: u32) -> Result<Faults, StoreError> {
        let rows: Vec<FaultRow> = self.external(machine_query(sql::MACHINE_FAULTS, machine).bind(limit)).await?;
        Ok(rows.into())
    }

    /// The open alarms with the causes `not_monitored` and `data_loss`, without those of the daemon `itself`. They are
    /// grouped by cause, site, text (`data_loss` only) and state.
    pub(crate) async fn common_alarms(&self, itself: &MachineId) -> Result<Vec<CommonAlarm>, StoreError> {
        self.external(machine_query(sql::COMMON, itself)).await
    }

    /// Number of open alarms for each cause and severity.
    pub(crate) async fn open_alarms_by_kind(&self) -> Result<Vec<AlarmCount>, StoreError> {
        self.external(sqlx::query_as(sql::OPEN_ALARMS_BY_KIND)).await
    }

    /// The open windows of one machine or of all.
    pub(crate) async fn windows(&self, machine: Option<&MachineId>) -> Result<Vec<Window>, StoreError> {
        let statement = sqlx::query_as(sql::WINDOWS)
            .bind(machine.map(|machine| machine.site.as_str()))
            .bind(machine.map(|machine| machine.machine.as_str()));
        self.external(statement).await
    }
}
