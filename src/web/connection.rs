//! HTTP connections with limits on their number, their requests (one each), their bytes and their time. At the largest
//! number, the connection that has waited longest for its request is closed, so that slow clients do not block others.

use std::{collections::VecDeque, pin::pin, sync::Arc, time::Duration};

use axum::{Router, extract::DefaultBodyLimit};
use hyper::{
    Request,
    body::Incoming,
    server::conn::http1,
    service::{Service as _, service_fn},
};
use hyper_util::{rt::TokioIo, service::TowerToHyperService};
use tokio::{
    net::{TcpListener, TcpStream},
    sync::{OwnedSemaphorePermit, Semaphore, oneshot, watch},
    time::{self, Instant},
};

/// Largest number of connections; further ones wait in the queue of the operating system. Each uses a few buffers and
/// the memory of at most one page.
const CONNECTIONS: usize = 64;
/// Largest head, and largest body, of a request \[bytes\]; those of a browser have one or two thousand.
const READ_BYTES: usize = 16 << 10;
/// Time limit from the start of a connection to its complete request.
const REQUEST_LIMIT: Duration = Duration::from_secs(5);
/// The same limit while other connections wait: a browser sends its request at once.
const GRACE: Duration = Duration::from_millis(250);
/// Time limit from a complete request to its response: longer than the 20 s that an operator's command may take.
const HANDLER_LIMIT: Duration = Duration::from_secs(25);
/// Time limit for the transmission of a response: 200 kB at 20 kB/s.
const RESPONSE_LIMIT: Duration = Duration::from_secs(10);
/// Pause after a failed accept, for example without free descriptors.
const PAUSE: Duration = Duration::from_millis(500);

/// Sets the time limit for the next step of a connection. It is an extension of each request, for its handler.
#[derive(Debug, Clone)]
pub(super) struct Progress(watch::Sender<Duration>);

impl Progress {
    /// The request is complete. Only the handler of a request can know this.
    pub(super) fn arrived(&self) {
        self.0.send_replace(HANDLER_LIMIT);
    }

    /// The response is complete.
    pub(super) fn answered(&self) {
        self.0.send_replace(RESPONSE_LIMIT);
    }
}

/// Serves connections until the future is dropped.
pub(super) async fn serve(listener: TcpListener, router: Router) {
    let router = router.layer(DefaultBodyLimit::max(READ_BYTES));
    let permits = Arc::new(Semaphore::new(CONNECTIONS));
    // Connections without a complete request, the oldest first. Dropping the sender closes the connection.
    let mut asking: VecDeque<(Instant, oneshot::Sender<()>)> = VecDeque::new();
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::debug!(%error, "a connection to the dashboard failed");
                time::sleep(PAUSE).await;
                continue;
            }
        };
        let permit = permit(&permits, &mut asking).await;
        let (connection, evicted) = oneshot::channel();
        asking.push_back((Instant::now(), connection));
        tokio::spawn(serve_connection(stream, router.clone(), evicted, permit));
    }
}

/// Waits for a permit for a new connection. If there is none, connections without a complete request are closed after
/// [`GRACE`], the oldest first.
async fn permit(
    permits: &Arc<Semaphore>,
    asking: &mut VecDeque<(Instant, oneshot::Sender<()>)>,
) -> Option<OwnedSemaphorePermit> {
    loop {
        asking.retain(|(_, connection)| !connection.is_closed());
        let oldest = asking.front().map(|(since, _)| *since + GRACE);
        tokio::select! {
            biased;
            // The acquisition cannot fail, as the semaphore is never closed.
            permit = Arc::clone(permits).acquire_owned() => return permit.ok(),
            () = time::sleep_until(oldest.unwrap_or_else(Instant::now)), if oldest.is_some() => drop(asking.pop_front()),
        }
    }
}

/// Serves a connection until its end, a time limit, or its eviction.
async fn serve_connection(
    stream: TcpStream,
    router: Router,
    evicted: oneshot::Receiver<()>,
    _permit: Option<OwnedSemaphorePermit>,
) {
    let (progress, mut limit) = watch::channel(REQUEST_LIMIT);
    let progress = Progress(progress);
    let router = TowerToHyperService::new(router);
    let service = service_fn(|mut request: Request<Incoming>| {
        request.extensions_mut().insert(progress.clone());
        router.call(request)
    });
    let connection = http1::Builder::new().max_buf_size(READ_BYTES).serve_connection(TokioIo::new(stream), service);
    let (mut connection, mut deadline) = (pin!(connection), pin!(time::sleep(REQUEST_LIMIT)));
    let mut evicted = Some(evicted);
    loop {
        tokio::select! {
            _ = &mut connection => return,
            () = &mut deadline => return,
            () = eviction(&mut evicted) => return,
            // A connection with a complete request is not evicted any more.
            Ok(()) = limit.changed() => {
                evicted = None;
                deadline.as_mut().reset(Instant::now() + *limit.borrow_and_update());
            }
        }
    }
}

/// Waits until this connection must close for another one.
async fn eviction(evicted: &mut Option<oneshot::Receiver<()>>) {
    match evicted {
        Some(evicted) => drop(evicted.await),
        None => std::future::pending().await,
    }
}
