//! HTTP connections with limits: their number, one request each, bytes of the request, and time. At the limit, the
//! connection that has waited longest for its request is closed, so that slow clients do not block others.

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

/// Largest number of connections; more wait in the queue of the operating system. Each uses a few buffers and at most
/// one page.
const CONNECTIONS: usize = 64;
/// Largest head and largest body of a request \[bytes\]; a browser sends one or two thousand.
const READ_BYTES: usize = 16 << 10;
/// Time limit of a request.
const ASKING: Duration = Duration::from_secs(5);
/// Time limit for the request while other connections wait: a browser sends its request at once.
const GRACE: Duration = Duration::from_millis(250);
/// Time limit from a complete request to its response: longer than the 20 s of an operator's command.
const WORKING: Duration = Duration::from_secs(25);
/// Time limit for the transmission of a response: 200 kB at 20 kB/s.
const ANSWERING: Duration = Duration::from_secs(10);
/// Pause after a failed accept, for example without free descriptors.
const PAUSE: Duration = Duration::from_millis(500);

/// Progress of the request of a connection, an extension of the request: each step has a time limit of its own.
#[derive(Debug, Clone)]
pub(super) struct Progress(watch::Sender<Duration>);

impl Progress {
    /// The request is complete. Called by the handler, which alone knows the end of the request.
    pub(super) fn arrived(&self) {
        self.0.send_replace(WORKING);
    }

    /// The response is complete.
    pub(super) fn answered(&self) {
        self.0.send_replace(ANSWERING);
    }
}

/// Serves connections until the future is dropped.
pub(super) async fn serve(listener: TcpListener, router: Router) {
    let router = router.layer(DefaultBodyLimit::max(READ_BYTES));
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    // Connections without a complete request, the oldest first. A dropped sender ends its connection.
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
        let place = place(&places, &mut asking).await;
        let (connection, evicted) = oneshot::channel();
        asking.push_back((Instant::now(), connection));
        tokio::spawn(converse(stream, router.clone(), evicted, place));
    }
}

/// Waits for a place. The connection that has waited longest for its request loses its place after [`GRACE`].
async fn place(
    places: &Arc<Semaphore>,
    asking: &mut VecDeque<(Instant, oneshot::Sender<()>)>,
) -> Option<OwnedSemaphorePermit> {
    loop {
        asking.retain(|(_, connection)| !connection.is_closed());
        let oldest = asking.front().map(|(since, _)| *since + GRACE);
        tokio::select! {
            biased;
            // Cannot fail, as the semaphore is never closed.
            place = Arc::clone(places).acquire_owned() => return place.ok(),
            () = time::sleep_until(oldest.unwrap_or_else(Instant::now)), if oldest.is_some() => drop(asking.pop_front()),
        }
    }
}

/// Serves a connection until its end, a time limit, or the loss of its place to another connection.
async fn converse(
    stream: TcpStream,
    router: Router,
    evicted: oneshot::Receiver<()>,
    _place: Option<OwnedSemaphorePermit>,
) {
    let (progress, mut limit) = watch::channel(ASKING);
    let progress = Progress(progress);
    let router = TowerToHyperService::new(router);
    let service = service_fn(|mut request: Request<Incoming>| {
        request.extensions_mut().insert(progress.clone());
        router.call(request)
    });
    let connection = http1::Builder::new().max_buf_size(READ_BYTES).serve_connection(TokioIo::new(stream), service);
    let (mut connection, mut deadline) = (pin!(connection), pin!(time::sleep(ASKING)));
    let mut evicted = Some(evicted);
    loop {
        tokio::select! {
            _ = &mut connection => return,
            () = &mut deadline => return,
            () = lost(&mut evicted) => return,
            // A complete request keeps its place.
            Ok(()) = limit.changed() => {
                evicted = None;
                deadline.as_mut().reset(Instant::now() + *limit.borrow_and_update());
            }
        }
    }
}

/// Waits until another connection needs the place.
async fn lost(evicted: &mut Option<oneshot::Receiver<()>>) {
    match evicted {
        Some(evicted) => drop(evicted.await),
        None => std::future::pending().await,
    }
}
