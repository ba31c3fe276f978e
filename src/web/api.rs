//! `/api/v1/…`: the data of the pages as JSON, read-only.
//!
//! | address | answers with |
//! |---|---|
//! | `/api/v1/status` | the daemon, as in `pointsd status --json` |
//! | `/api/v1/machines?site=…&state=…&cause=…&q=…&page=…` | `tally`; `machines`: up to 100 with state, present drifts, last throw; `next_page`: number of the next page, or null on the last page. Pages are counted from 0 |
//! | `/api/v1/machines/{site}/{machine}` | `state`, `drifts` (present), `caveats`, `alarms` (open), `throws` (the newest 100), `commands` |
//! | `/api/v1/alarms` | `faults`: open alarms about machines, up to 50; `fault_count`: number of all of them; `common`: numbers of the others by cause, site, text and state, each with the address `machines` of all machines of its site with its cause |
//!
//! An alarm has the fields of its last event: `change_pct` is its size at `event_at`. In `faults` it also has its size
//! when it was raised, `change_raised_pct` and `change_raised_pct_sd`, and its size after the last throw,
//! `change_now_pct` and `change_now_pct_sd`, which is null if the drift has ended.

use std::sync::Arc;

use axum::{
    extract::{Path, RawQuery, State, rejection::PathRejection},
    response::Response,
};
use serde_json::json;

use super::{
    fleet,
    overview::Web,
    page::{self, Failure},
};
use crate::{
    diagnose::{AlarmState, Present},
    store::{CommonAlarm, Fault, FleetQuery},
    throw::MachineId,
};

/// Largest number of throws in a response.
const THROWS: u32 = 100;
/// Largest number of operators' commands in a response.
const COMMANDS: u32 = 100;

/// Refuses all parameters: a parameter without an effect would look like a filter.
fn takes_none(query: Option<&str>) -> Result<(), Failure> {
    match query.filter(|query| !query.is_empty()) {
        None => Ok(()),
        Some(_) => Err(Failure::bad_request("This address has no parameters; /api/v1/machines has filters.")),
    }
}

pub(super) async fn status(State(web): State<Arc<Web>>, RawQuery(query): RawQuery) -> Result<Response, Failure> {
    takes_none(query.as_deref())?;
    let _permit = web.read_permit().await?;
    Ok(page::json(&json!(web.view.status.answer(&web.view.store).await)))
}

pub(super) async fn machines(State(web): State<Arc<Web>>, RawQuery(query): RawQuery) -> Result<Response, Failure> {
    let query = FleetQuery { spark: 0, ..fleet::filters(query.as_deref())? };
    let itself = web.view.config().monitor.as_machine();
    let _permit = web.read_permit().await?;
    let reader = web.reader();
    let tally = reader.tally(&query, &itself).await?;
    let matching = query.state.map_or_else(|| tally.total(), |state| tally.of(state));
    let machines = reader.fleet(&query, &itself).await?;
    let has_more = u64::from(query.offset) + (machines.len() as u64) < matching;
    let next_page = has_more.then(|| fleet::page_number(&query) + 1);
    Ok(page::json(&json!({"tally": tally.states, "machines": machines, "next_page": next_page})))
}

pub(super) async fn machine(
    State(web): State<Arc<Web>>,
    machine: Result<Path<MachineId>, PathRejection>,
    RawQuery(query): RawQuery,
) -> Result<Response, Failure> {
    let Path(machine) = machine?;
    takes_none(query.as_deref())?;
    let _permit = web.read_permit().await?;
    let reader = web.reader();
    if !reader.is_known(&machine).await? {
        return Err(Failure::not_found(format!("No throw of a machine {machine} is known.")));
    }
    let throws = reader.newest_throws_of(&machine, THROWS).await?;
    let Present { state, drifts, caveats } = reader.state_of(&machine).await?;
    Ok(page::json(&json!({
        "site": machine.site, "machine": machine.machine, "state": state, "drifts": drifts, "caveats": caveats,
        "alarms": reader.open_alarms(&(&machine).into()).await?,
        "throws": throws, "commands": reader.commands_of(&machine, COMMANDS).await?,
    })))
}

pub(super) async fn alarms(State(web): State<Arc<Web>>, RawQuery(query): RawQuery) -> Result<Response, Failure> {
    takes_none(query.as_deref())?;
    let overview = web.overview().await?;
    let faults: Vec<_> = overview.faults.alarms.iter().map(with_sizes).collect();
    Ok(page::json(&json!({
        "faults": faults, "fault_count": overview.faults.total, "common": overview.common.iter().map(with_list).collect::<Vec<_>>(),
    })))
}

/// A group of alarms, with the address of the list of all machines of its site with its cause.
fn with_list(group: &CommonAlarm) -> serde_json::Value {
    let mut json = json!(group);
    json["is_over"] = json!(group.state == AlarmState::ClearedUnacknowledged);
    json["machines"] = json!(format!("/api/v1/machines?site={}&cause={}", group.site, group.cause.as_str()));
    json
}

/// A fault with its sizes. The name of each field tells when the size was measured.
fn with_sizes(fault: &Fault) -> serde_json::Value {
    let now = fault.drifts.iter().find(|drift| drift.cause == fault.alarm.cause);
    let mut json = json!(fault);
    json["change_raised_pct"] = json!(fault.raised.map(|(pct, _)| pct));
    json["change_raised_pct_sd"] = json!(fault.raised.map(|(_, sd)| sd));
    json["change_now_pct"] = json!(now.map(|drift| drift.change_pct));
    json["change_now_pct_sd"] = json!(now.map(|drift| drift.change_pct_sd));
    json
}
