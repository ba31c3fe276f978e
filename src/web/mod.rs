//! The dashboard and the metrics over HTTP.
//!
//! | address | response |
//! |---|---|
//! | `/?site=…&state=…&cause=…&q=…&page=…` | the fleet: open alarms, machines (worst first), the daemon |
//! | `/machines/{site}/{machine}?span=100\|1000\|all` | one machine: state, drifts, trends, alarms, last throws |
//! | `POST /machines/{site}/{machine}/command` | an operator's command, if `web.token` is set |
//! | `/machines/{site}/{machine}/throws/{boot_id}/{throw_no}` | one throw and its trace; `/trace.csv` below it is the trace |
//! | `/api/v1/…` | the same as JSON (`api`) |
//! | `/metrics` | counters and states in the text format of Prometheus |
//! | `/healthz` | 200 while all heartbeats of the daemon's loops are fresh, else 503 with the reason |
//!
//! Clients cannot slow the daemon down. Number, bytes and duration of connections are bounded (`connection`), and so
//! are the time of a request (`guard`) and the rows that it reads. Only one request at a time reads the database, on a
//! connection that the judge does not use. Data that every page needs are read at most once a second (`overview`).
//! Every page starts with the problems that make it incomplete or old (`trouble`).

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

use std::{io, net::SocketAddr, sync::Arc};

use axum::{
    Router,
    extract::State,
    http::StatusCode,
    middleware,
    routing::{get, post},
};
use tokio::net::TcpListener;

use crate::daemon::View;
use overview::Web;
use page::{Failure, STYLE, asset};

pub use machine::{Span, report};
pub(crate) use state::{forecast, signed, size};

const REFRESH: &str = include_str!("pages/refresh.js");
const CHARTS: &str = include_str!("pages/charts.js");
/// The chart library, preceded by its licence.
const UPLOT: &str =
    concat!("/*\n", include_str!("pages/uplot/LICENSE"), "*/\n", include_str!("pages/uplot/uPlot.iife.min.js"));
const UPLOT_STYLE: &str = include_str!("pages/uplot/uPlot.min.css");
const SCRIPT_TYPE: &str = "text/javascript; charset=utf-8";
const STYLE_TYPE: &str = "text/css; charset=utf-8";
/// Cache header of a file that another version of the program may change: browsers ask each time whether their copy is
/// still the same.
const REVALIDATE: &str = "no-cache";
/// Cache header of a file with its version in its address: browsers keep it for a year.
const IMMUTABLE: &str = "public, max-age=31536000, immutable";

/// The listening socket of the dashboard.
#[derive(Debug)]
pub struct Listening {
    listener: TcpListener,
    address: SocketAddr,
}

impl Listening {
    /// Listens on an address.
    ///
    /// # Errors
    /// When the address is in use, or does not belong to this computer.
    pub async fn bind(address: SocketAddr) -> io::Result<Self> {
        let failed = |error: io::Error| {
            io::Error::new(error.kind(), format!("the dashboard cannot listen on {address} (web.listen): {error}"))
        };
        let listener = TcpListener::bind(address).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address })
    }

    /// The address for a browser.
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }
}

/// Serves requests until the future is dropped.
pub async fn serve(listening: Listening, view: View) {
    if !listening.address.ip().is_loopback() {
        tracing::warn!(address = %listening.address, "the dashboard is readable for every computer that reaches this address");
    }
    tracing::info!("the dashboard is at {}", listening.url());
    connection::serve(listening.listener, router(Arc::new(Web::new(view)))).await;
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
        .route("/style.css", get(|| async { asset(STYLE_TYPE, REVALIDATE, STYLE) }))
        .route("/refresh.js", get(|| async { asset(SCRIPT_TYPE, REVALIDATE, REFRESH) }))
        .route("/charts.js", get(|| async { asset(SCRIPT_TYPE, REVALIDATE, CHARTS) }))
        .route("/uPlot-1.6.32.js", get(|| async { asset(SCRIPT_TYPE, IMMUTABLE, UPLOT) }))
        .route("/uPlot-1.6.32.css", get(|| async { asset(STYLE_TYPE, IMMUTABLE, UPLOT_STYLE) }))
        .fallback(|| async { Failure::not_found("There is no such page.") })
        .layer(middleware::from_fn_with_state(Arc::clone(&web), guard::guard))
        .with_state(web)
}

/// The response 200 while every loop of the daemon has a fresh heartbeat, else 503.
async fn healthz(State(web): State<Arc<Web>>) -> (StatusCode, String) {
    let silent = web.view.report().silent;
    if silent.is_empty() {
        return (StatusCode::OK, "every loop of the daemon is running\n".to_owned());
    }
    (StatusCode::SERVICE_UNAVAILABLE, format!("these loops of the daemon hang: {}\n", silent.join(", ")))
}
