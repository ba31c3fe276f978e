//! HTTP connections with limits on their number, their requests (one each), their bytes and their time. At the largest
//! number, a new connection closes the connection that has waited longest for its client (for the request, or for the
//! client to read the response), so that slow clients do not block others.

use std::{
    collections::VecDeque,
    pin::pin,
    sync::{Arc, OnceLock},
    time::Duration,
};

use axum::{Router, extract::DefaultBodyLimit};
use futures_util::future::OptionFuture;
use hyper::{
    Request,
    body::Incoming,
    server::conn::http1,
    service::{Service as _, service_fn},
};
use hyper_util::{rt::TokioIo, service::TowerToHyperService};
use parking_lot::Mutex;
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
/// Time limit for the request, and for the response, while other connections wait: a browser sends and reads at once.
const GRACE: Duration = Duration::from_millis(250);
/// Time limit from a complete request to its response: longer than the 20 s that an operator's command may take.
const HANDLER_LIMIT: Duration = Duration::from_secs(25);
/// Time limit for the transmission of a response: 200 kB at 20 kB/s.
const RESPONSE_LIMIT: Duration = Duration::from_secs(10);
/// Pause after a failed accept, for example without free descriptors.
const PAUSE: Duration = Duration::from_millis(500);

/// A step of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Request,
    Handler,
    Response,
}

impl Step {
    fn limit(self) -> Duration {
        match self {
            Self::Request => REQUEST_LIMIT,
            Self::Handler => HANDLER_LIMIT,
            Self::Response => RESPONSE_LIMIT,
        }
    }

    /// Whether the connection waits for its client, and so may be closed for another one.
    fn is_evictable(self) -> bool {
        self != Self::Handler
    }
}

/// Sets the next step of a connection. It is an extension of each request, for its handler.
#[derive(Debug, Clone)]
pub(super) struct Progress {
    step: watch::Sender<Step>,
    /// The permit for a large response.
    large: Arc<OnceLock<OwnedSemaphorePermit>>,
}

impl Progress {
    /// The request is complete. Only the handler of a request can know this.
    pub(super) fn arrived(&self) {
        self.step.send_replace(Step::Handler);
    }

    /// The response is complete.
    pub(super) fn answered(&self) {
        self.step.send_replace(Step::Response);
    }

    /// Keeps a permit until the connection ends, as its response is in memory until then.
    pub(super) fn hold(&self, permit: OwnedSemaphorePermit) {
        // A connection has one request.
        let _ = self.large.set(permit);
    }
}

/// A connection that waits for its client, since a time. Dropping the sender closes it.
type Waiter = (Instant, oneshot::Sender<()>);

/// Connections that wait for their clients, in the order of time.
#[derive(Debug, Clone, Default)]
struct Waiting(Arc<Mutex<VecDeque<Waiter>>>);

impl Waiting {
    /// Adds a connection. The receiver ends when the connection must close for another one.
    fn add(&self) -> oneshot::Receiver<()> {
        let (connection, evicted) = oneshot::channel();
        self.0.lock().push_back((Instant::now(), connection));
        evicted
    }

    /// Since when the oldest connection waits.
    fn oldest(&self) -> Option<Instant> {
        let mut waiting = self.0.lock();
        waiting.retain(|(_, connection)| !connection.is_closed());
        waiting.front().map(|(since, _)| *since)
    }

    /// Waits for a permit for a new connection. If there is none, the connection that has waited longest is closed, if it
    /// waits for longer than [`GRACE`]; if its permit is not free after [`GRACE`], the next one is closed.
    async fn permit(&self, permits: &Arc<Semaphore>) -> Option<OwnedSemaphorePermit> {
        let mut not_before = Instant::now();
        loop {
            // Without such a connection look again later, as a handler may end.
            let due = not_before.max(self.oldest().unwrap_or_else(Instant::now) + GRACE);
            tokio::select! {
                biased;
                // The acquisition cannot fail, as the semaphore is never closed.
                permit = Arc::clone(permits).acquire_owned() => return permit.ok(),
                () = time::sleep_until(due) => {}
            }
            if self.oldest().is_some_and(|since| since.elapsed() >= GRACE) {
                drop(self.0.lock().pop_front());
                not_before = Instant::now() + GRACE;
            }
        }
    }
}

/// Serves connections until the future is dropped.
pub(super) async fn serve(listener: TcpListener, router: Router) {
    let router = router.layer(DefaultBodyLimit::max(READ_BYTES));
    let permits = Arc::new(Semaphore::new(CONNECTIONS));
    let waiting = Waiting::default();
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::debug!(%error, "a connection to the dashboard failed");
                time::sleep(PAUSE).await;
                continue;
            }
        };
        let permit = waiting.permit(&permits).await;
        tokio::spawn(serve_connection(stream, router.clone(), waiting.clone(), permit));
    }
}

/// Serves a connection until its end, a time limit, or its eviction.
async fn serve_connection(stream: TcpStream, router: Router, waiting: Waiting, _permit: Option<OwnedSemaphorePermit>) {
    let (step, mut next_step) = watch::channel(Step::Request);
    let progress = Progress { step, large: Arc::default() };
    let router = TowerToHyperService::new(router);
    let service = service_fn(|mut request: Request<Incoming>| {
        request.extensions_mut().insert(progress.clone());
        router.call(request)
    });
    let connection = http1::Builder::new().max_buf_size(READ_BYTES).serve_connection(TokioIo::new(stream), service);
    let (mut connection, mut deadline) = (pin!(connection), pin!(time::sleep(Step::Request.limit())));
    let mut evicted = Some(waiting.add());
    loop {
        tokio::select! {
            _ = &mut connection => return,
            () = &mut deadline => return,
            Some(_) = OptionFuture::from(evicted.as_mut()) => return,
            Ok(()) = next_step.changed() => {
                let step = *next_step.borrow_and_update();
                evicted = step.is_evictable().then(|| waiting.add());
                deadline.as_mut().reset(Instant::now() + step.limit());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use axum::{Extension, routing::get};
    use tokio::{
        io::{AsyncReadExt as _, AsyncWriteExt as _},
        task::JoinSet,
    };

    use super::*;

    /// More than the buffers of a connection hold.
    static LARGE: [u8; 16 << 20] = [0; 16 << 20];

    #[tokio::test]
    async fn a_new_connection_closes_one_other() {
        let (permits, waiting) = (Arc::new(Semaphore::new(CONNECTIONS)), Waiting::default());
        let mut connections = JoinSet::new();
        for _ in 0..CONNECTIONS {
            let (permit, evicted) = (Arc::clone(&permits).try_acquire_owned().unwrap(), waiting.add());
            connections.spawn(async move {
                let _ = evicted.await;
                drop(permit);
            });
        }
        time::sleep(2 * GRACE).await;
        let _new = waiting.permit(&permits).await.unwrap();
        time::sleep(GRACE).await;
        let closed = std::iter::from_fn(|| connections.try_join_next()).count();
        assert_eq!(closed, 1);
    }

    #[tokio::test]
    async fn clients_that_do_not_read_their_responses_make_way() {
        let answer = |body: &'static [u8]| {
            get(async move |Extension(progress): Extension<Progress>| {
                progress.arrived();
                progress.answered();
                body
            })
        };
        let router = Router::new().route("/large", answer(&LARGE)).route("/small", answer(b"small"));
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let server = tokio::spawn(serve(listener, router));
        let request = async |path: &str| {
            let mut stream = TcpStream::connect(address).await.unwrap();
            let request = format!("GET {path} HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n");
            stream.write_all(request.as_bytes()).await.unwrap();
            // The response has begun.
            stream.read_u8().await.unwrap();
            stream
        };
        let mut slow = Vec::new();
        for _ in 0..CONNECTIONS {
            slow.push(request("/large").await);
        }
        let begin = Instant::now();
        let mut rest = String::new();
        request("/small").await.read_to_string(&mut rest).await.unwrap();
        assert!(rest.ends_with("small"), "{rest}");
        assert!(begin.elapsed() < RESPONSE_LIMIT / 2, "{:?}", begin.elapsed());
        server.abort();
    }
}
