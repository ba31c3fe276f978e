//! The dashboard and the metrics over HTTP, for reading only.
//!
//! | address | answers with |
//! |---|---|
//! | `/` | the fleet, worst machine first, with the open alarms and the daemon's own state |
//! | `/machines/{site}/{machine}?span=100\|1000\|all` | its trends, alarms and last throws |
//! | `/machines/{site}/{machine}/throws/{boot_id}/{throw_no}` | one throw and its trace |
//! | `/metrics` | `OpenMetrics` text |
//! | `/healthz` | 200 while every loop of the daemon beats, else 503 with the reason |
//!
//! The daemon comes first, whoever asks: connections, their bytes and their life are bounded (`connection`), so are
//! the time of a request (`guard`) and the rows it reads; one request at a time reads the database, on the
//! connections for questions from outside, so that the judge has its own; and what every page shows is read at most
//! once a second (`overview`). Every page begins with what keeps it from telling the truth (`trouble`). The room sees
//! the daemon through a [`View`], which cannot write.

mod connection;
mod fleet;
mod guard;
mod machine;
mod metrics;
mod overview;
mod page;
mod standing;
mod throw;
mod trend;
mod trouble;

use std::{net::SocketAddr, sync::Arc};

use axum::{Router, extract::State, http::StatusCode, middleware, response::Response, routing::get};
use tokio::{
    net::TcpListener,
    sync::{Semaphore, SemaphorePermit},
};

use crate::{daemon::View, store::StoreError};
use connection::Bounded;
use overview::Cache;
use page::{Failure, asset};

/// Requests that read the database at the same time: the other connections for questions are left to those on zenoh.
const READING: usize = 1;

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

    /// What a browser on this computer is told.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }
}

/// What every request needs.
struct Web {
    view: View,
    cache: Cache,
    reading: Semaphore,
}

impl Web {
    /// The right to read the database, held while reading and drawing.
    async fn turn(&self) -> Result<SemaphorePermit<'_>, StoreError> {
        self.reading.acquire().await.map_err(|_| StoreError::Closed)
    }
}

/// Serves until it is dropped.
pub async fn serve(place: Place, view: View) {
    if !place.address.ip().is_loopback() {
        tracing::warn!(address = %place.address, "the dashboard can be read by everybody who reaches this address");
    }
    tracing::info!("the dashboard is at {}", place.url());
    let web = Arc::new(Web { view, cache: Cache::default(), reading: Semaphore::new(READING) });
    if let Err(error) = axum::serve(Bounded::new(place.listener), router(web)).await {
        tracing::error!(%error, "the dashboard has ended");
    }
}

fn router(web: Arc<Web>) -> Router {
    Router::new()
        .route("/", get(fleet::page))
        .route("/machines/{site}/{machine}", get(machine::page))
        .route("/machines/{site}/{machine}/throws/{boot_id}/{throw_no}", get(throw::page))
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
