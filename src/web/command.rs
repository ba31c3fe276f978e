//! `POST /machines/{site}/{machine}/command`: a command from the form on the page of a machine.

use std::{collections::HashMap, sync::Arc};

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, State, rejection::PathRejection},
    http::StatusCode,
    response::{IntoResponse, Redirect, Response},
};
use jiff::{SignedDuration, Timestamp};
use tokio::time::{self, Instant};

use super::{
    connection::Progress,
    guard::LIMIT,
    machine::{self, Form},
    overview::Web,
    page::Failure,
};
use crate::{daemon::clock, diagnose::Command, store::seldom, throw::MachineId};

pub(super) async fn post(
    State(web): State<Arc<Web>>,
    Extension(progress): Extension<Progress>,
    machine: Result<Path<MachineId>, PathRejection>,
    body: Bytes,
) -> Result<Response, Failure> {
    progress.arrived();
    let Path(machine) = machine?;
    let fields: HashMap<String, String> = form_urlencoded::parse(&body).into_owned().collect();
    let Err(refused) = apply(&web, &machine, &fields).await else {
        let place = format!("/machines/{}/{}#commands", machine.site, machine.machine);
        return Ok(Redirect::to(&place).into_response());
    };
    // The response is the page again, with the typed values in the form. If it cannot be made, the response is the
    // refusal.
    let form = Form { refused: Some(refused.message.clone()), fields };
    let page = time::timeout(LIMIT, machine::show(&web, &machine, None, form)).await;
    let Ok(Ok(page)) = page else { return Err(refused) };
    Ok((refused.status, page).into_response())
}

/// Applies the command in the fields of the form.
async fn apply(web: &Web, machine: &MachineId, fields: &HashMap<String, String>) -> Result<(), Failure> {
    let config = web.view.config();
    let token = fields.get("token").map(String::as_str).unwrap_or_default();
    if !config.web.token.as_ref().is_some_and(|secret| secret.is(token)) {
        seldom!(warn, %machine, "command refused: wrong token");
        return Err(Failure::new(
            StatusCode::FORBIDDEN,
            "Nothing was done: the token is wrong. It must be web.token of the configuration.",
        ));
    }
    let command = command(fields, clock::now()).map_err(Failure::bad_request)?;
    let reply = web.view.commands.apply(machine.clone(), command, Instant::now()).await;
    let reply = reply.map_err(|problem| Failure::new(StatusCode::SERVICE_UNAVAILABLE, format!("{problem}.")))?;
    if !reply.done {
        return Err(Failure::new(StatusCode::CONFLICT, format!("Nothing was done: {}.", reply.text)));
    }
    web.discard_overview().await;
    Ok(())
}

/// The command in the fields of the form, or a sentence about the wrong field.
fn command(fields: &HashMap<String, String>, now: Timestamp) -> Result<Command, String> {
    let text = |name: &str| fields.get(name).map(|text| text.trim().to_owned()).unwrap_or_default();
    let by = text("by");
    if by.is_empty() {
        return Err("Your name is missing.".to_owned());
    }
    let cause = || text("cause").parse().map_err(|_| "The form does not name the alarm.".to_owned());
    let until = || {
        // The monitor checks the configured limit.
        let hours = text("hours").parse::<u32>().ok().filter(|hours| *hours > 0);
        let hours = hours.ok_or("The number of hours must be a whole number from 1.")?;
        clock::end_of_window(now, SignedDuration::from_hours(hours.into())).map_err(|error| error.to_string())
    };
    let why = || Some(text("why")).filter(|why| !why.is_empty()).ok_or("The reason is missing.".to_owned());
    Ok(match text("command").as_str() {
        "ack" => Command::Ack { cause: cause()?, by },
        "shelve" => Command::Shelve { cause: cause()?, until: until()?, by, why: why()? },
        "unshelve" => Command::Unshelve { cause: cause()?, by },
        "maintenance" => Command::MaintenanceStart { until: until()?, by, why: why()? },
        "maintenance_end" => Command::MaintenanceEnd { by },
        "rebaseline" => Command::Rebaseline { by, why: why()? },
        _ => return Err("The form names no command.".to_owned()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::Cause;

    fn made(form: &str) -> Result<Command, String> {
        command(&form_urlencoded::parse(form.as_bytes()).into_owned().collect(), Timestamp::UNIX_EPOCH)
    }

    #[test]
    fn a_form_makes_one_command_or_an_error_that_names_the_missing_field() {
        let by = "A. Meyer".to_owned();
        assert_eq!(
            made("command=ack&cause=kt&by=A.+Meyer").unwrap(),
            Command::Ack { cause: Cause::Kt, by: by.clone() }
        );
        let until = Timestamp::from_second(8 * 3600).unwrap();
        let shelve = Command::Shelve { cause: Cause::Friction, until, by, why: "greased".to_owned() };
        assert_eq!(made("command=shelve&cause=friction&by=A.+Meyer&hours=8&why=greased").unwrap(), shelve);
        for (form, expected) in [
            ("command=ack&cause=kt", "name is missing"),
            ("command=ack&cause=magnet&by=x", "name the alarm"),
            ("command=shelve&cause=kt&by=x&why=y&hours=0", "number of hours"),
            ("command=shelve&cause=kt&by=x&why=y&hours=99999999999", "number of hours"),
            ("command=maintenance&by=x&hours=8&why=+", "reason is missing"),
            ("command=reboot&by=x", "no command"),
        ] {
            assert!(made(form).unwrap_err().contains(expected), "{form}");
        }
    }
}
