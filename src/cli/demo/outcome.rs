//! The result of the demo: injected faults, raised alarms, and example queries.

use std::{path::Path, time::Duration};

use comfy_table::Table;
use jiff::Timestamp;

use super::super::output;
use crate::{
    diagnose::{Cause, Drifting},
    simulate::{Fault, Part, Shape},
    store::{Reader, Selector, StoreError},
    throw::MachineId,
    wire::Alarm,
};

/// Largest number of alarm events read: above the number that the demo can raise.
const EVENTS: u32 = 10_000;

/// The injected faults: one machine for each cause, and a healthy one.
pub(super) const MACHINES: [Option<Fault>; 5] = [
    Some(Fault { part: Part::Kt, shape: Shape::Step, size_pct: -20.0, from_throw: 120 }),
    Some(Fault { part: Part::Friction, shape: Shape::Ramp { throws: 40 }, size_pct: 45.0, from_throw: 110 }),
    Some(Fault { part: Part::Stiffness, shape: Shape::Step, size_pct: 30.0, from_throw: 130 }),
    Some(Fault { part: Part::Inertia, shape: Shape::Ramp { throws: 30 }, size_pct: 20.0, from_throw: 115 }),
    None,
];

/// A machine of the demo with its fault and its alarms.
pub(super) struct Row {
    machine: MachineId,
    injected: Option<Fault>,
    /// The first event of each alarm.
    alarms: Vec<Alarm>,
    drift: Option<Drifting>,
}

impl Row {
    /// Whether the alarms are right: a machine with a fault has drift alarms, and all name the injected cause; a
    /// healthy machine has no alarm.
    pub(super) fn is_right(&self) -> bool {
        match self.injected {
            None => self.alarms.is_empty(),
            Some(injected) => {
                let named = |alarm: &Alarm| alarm.cause.as_str() == injected.part.cause();
                let mut drifts = self.alarms.iter().filter(|alarm| alarm.cause.is_drift()).peekable();
                drifts.peek().is_some() && drifts.all(named)
            }
        }
    }

    fn cells(&self) -> [String; 6] {
        let first = self.alarms.iter().find(|alarm| alarm.cause.is_drift()).or(self.alarms.first());
        let injected = self.injected.map_or_else(
            || "nothing".to_owned(),
            |injected| format!("{} {:+.0} %", word(injected.part.cause()), injected.size_pct),
        );
        let reported = match self.alarms.as_slice() {
            [] => "nothing".to_owned(),
            alarms => alarms.iter().map(|alarm| alarm.cause.to_string()).collect::<Vec<_>>().join(", "),
        };
        let delay = self.injected.zip(first.and_then(|alarm| alarm.last_throw.as_ref())).map(|(injected, throw)| {
            // `throw_no` counts from 1 and `from_throw` from 0, so an alarm at the first throw with the fault gives 1.
            i64::try_from(throw.throw_no).unwrap_or(i64::MAX) - i64::try_from(injected.from_throw).unwrap_or(0)
        });
        let drift = self.drift.as_ref();
        [
            self.machine.machine.to_string(),
            injected,
            reported,
            drift.map(|now| output::size(now.change_pct, now.change_pct_sd)).unwrap_or_default(),
            delay.map(|delay| delay.to_string()).unwrap_or_default(),
            if self.is_right() { "right".to_owned() } else { "WRONG".to_owned() },
        ]
    }
}

fn word(cause: &str) -> String {
    cause.parse::<Cause>().map_or_else(|_| cause.to_owned(), |cause| cause.to_string())
}

/// Reads the alarms and the present drift of each machine from the database.
pub(super) async fn rows(reader: &Reader, machines: &[MachineId]) -> Result<Vec<Row>, StoreError> {
    let events = reader.alarm_history(&Selector::default(), Timestamp::UNIX_EPOCH, EVENTS).await?;
    let mut rows: Vec<Row> = machines
        .iter()
        .zip(MACHINES)
        .map(|(machine, injected)| Row { machine: machine.clone(), injected, alarms: Vec::new(), drift: None })
        .collect();
    for alarm in events {
        let Some(row) = rows.iter_mut().find(|row| row.machine == alarm.machine) else { continue };
        if row.alarms.iter().all(|first| first.alarm_id != alarm.alarm_id) {
            row.alarms.push(alarm);
        }
    }
    let mut latest = reader.latest_health(&Selector::default()).await?;
    latest.sort_by_key(|health| health.started_at);
    for health in latest {
        if let Some(row) = rows.iter_mut().find(|row| row.machine == health.machine) {
            row.drift = health.drift;
        }
    }
    Ok(rows)
}

pub(super) fn table(rows: &[Row]) -> Table {
    let mut table = output::table(["machine", "injected", "reported", "now (95 %)", "after\nthrows", ""]);
    table.add_rows(rows.iter().map(Row::cells));
    output::numbers(table, 3)
}

pub(super) fn sentence(rows: &[Row], took: Duration) -> String {
    let right = rows.iter().filter(|row| row.is_right()).count();
    format!("{right} of {} machines right, in {:.0} s.", rows.len(), took.as_secs_f64())
}

/// Example queries, to copy into a shell.
pub(super) fn queries(database: &Path) -> String {
    let database = database.display();
    format!(
        "\nThe database is {database}. Example queries:\n\
         pointsd sql --database {database} \\\n  \"SELECT machine, cause, severity, text FROM active_alarms\"\n\
         pointsd sql --database {database} \\\n  \"SELECT machine, direction, throw_no, b0_pct, a1_pct, a0_pct\n   \
         FROM health_history ORDER BY started_at DESC LIMIT 10\""
    )
}
