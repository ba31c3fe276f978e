//! The dashboard and the metrics over HTTP.
//!
//! | address | answers with |
//! |---|---|
//! | `/?site=…&state=…&cause=…&q=…&page=…` | the fleet, a line a machine, worst first, with the open alarms and the daemon itself |
//! | `/machines/{site}/{machine}?span=100\|1000\|all` | its state, drifts, trends, alarms and last throws |
//! | `POST /machines/{site}/{machine}/command` | an operator's command, where `web.token` is set |
//! | `/machines/{site}/{machine}/throws/{boot_id}/{throw_no}` | one throw and its trace; `/trace.csv` below it is the trace |
//! | `/api/v1/…` | the same as JSON (`api`) |
//! | `/metrics` | `OpenMetrics` text |
//! | `/healthz` | 200 while every task of the daemon beats, else 503 with the reason |
//!
//! The daemon comes first, whatever the readers do: connections, their bytes and their life are bounded (`connection`), so
//! are the time of a request (`guard`) and the rows that it reads. One request at a time reads the database, on the
//! connections for questions from outside, so that the judge has its own. The parts that every page shows are read at most
//! once a second (`overview`). Every page begins with the trouble that keeps it from telling the truth (`trouble`).

mod alarm;
mod api;
mod command;
mod connection;
mod fleet;
mod guard;
mod machine;
mod metrics;
mod overview;
mod page;
mod state;
mod throw;
mod trend;
mod trouble;

use std::{net::SocketAddr, sync::Arc};

use axum::{
    Router,
    extract::State,
    http::StatusCode,
    middleware,
    response::Response,
    routing::{get, post},
};
use tokio::net::TcpListener;

use crate::daemon::View;
use connection::Bounded;
use overview::Web;
use page::{Failure, asset};

const STYLE: &str = include_str!("pages/style.css");
const REFRESH: &str = include_str!("pages/refresh.js");

/// Why the dashboard cannot be offered.
#[derive(Debug, thiserror::Error)]
#[error("the dashboard cannot listen on {address} (web.listen): {source}")]
pub struct BindError {
    address: SocketAddr,
    source: std::io::Error,
}

/// The place where the dashboard listens.
#[derive(Debug)]
pub struct Place {
    listener: TcpListener,
    address: SocketAddr,
}

impl Place {
    /// Takes the address.
    ///
    /// # Errors
    /// When it is taken, or is no address of this computer.
    pub async fn bind(address: SocketAddr) -> Result<Self, BindError> {
        let failed = |source| BindError { address, source };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address })
    }

    /// The address for a browser on this computer.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }
}

/// Serves until it is dropped.
pub async fn serve(place: Place, view: View) {
    if !place.address.ip().is_loopback() {
        tracing::warn!(address = %place.address, "the dashboard can be read by everybody who reaches this address");
    }
    tracing::info!("the dashboard is at {}", place.url());
    let web = Arc::new(Web::new(view));
    if let Err(error) = axum::serve(Bounded::new(place.listener), router(web)).await {
        tracing::error!(%error, "the dashboard has ended");
    }
}

fn router(web: Arc<Web>) -> Router {
    Router::new()
        .route("/", get(fleet::page))
        .route("/machines/{site}/{machine}", get(machine::page))
        .route("/machines/{site}/{machine}/command", post(command::post))
        .route("/machines/{site}/{machine}/throws/{boot_id}/{throw_no}", get(throw::page))
        .route("/machines/{site}/{machine}/throws/{boot_id}/{throw_no}/trace.csv", get(throw::csv))
        .route("/api/v1/status", get(api::status))
        .route("/api/v1/machines", get(api::machines))
        .route("/api/v1/machines/{site}/{machine}", get(api::machine))
        .route("/api/v1/alarms", get(api::alarms))
        .route("/metrics", get(metrics::page))
        .route("/healthz", get(healthz))
        .route("/style.css", get(|| async { asset("text/css; charset=utf-8", STYLE) }))
        .route("/refresh.js", get(|| async { asset("text/javascript; charset=utf-8", REFRESH) }))
        .fallback(|| async { Failure::not_found("There is no such page.") })
        .layer(middleware::from_fn_with_state(Arc::clone(&web), guard::guard))
        .with_state(web)
}

async fn healthz(State(web): State<Arc<Web>>) -> Response {
    health(&web.view.report().silent)
}

/// The answer when these loops do not beat.
fn health(silent: &[String]) -> Response {
    if silent.is_empty() {
        return page::text(StatusCode::OK, "every loop of the daemon beats\n".to_owned());
    }
    page::text(StatusCode::SERVICE_UNAVAILABLE, format!("these loops of the daemon hang: {}\n", silent.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loop_that_hangs_is_no_health() {
        assert_eq!(health(&[]).status(), StatusCode::OK);
        assert_eq!(health(&["write".to_owned()]).status(), StatusCode::SERVICE_UNAVAILABLE);
    }
}
