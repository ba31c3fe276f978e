//! HTTP connections with limits: their number, one request each, bytes of the request, and time. At the limit, the
//! connection that has waited longest for its request is closed, so that slow clients do not block others.

use std::{
    collections::VecDeque,
    io,
    net::SocketAddr,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    task::{Context, Poll},
    time::Duration,
};

use axum::{
    extract::connect_info::Connected,
    serve::{IncomingStream, Listener},
};
use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream},
    sync::{OwnedSemaphorePermit, Semaphore, oneshot},
    time::{self, Instant, Sleep},
};

/// Largest number of connections; more wait in the queue of the operating system. Each uses a few buffers and at most
/// one page.
const CONNECTIONS: usize = 64;
/// Largest request \[bytes\]; a browser sends one or two thousand.
const READ_BYTES: usize = 16 << 10;
/// Time limit of a request.
const ASKING: Duration = Duration::from_secs(5);
/// Time limit for the request while other connections wait: a browser sends its request at once.
const GRACE: Duration = Duration::from_millis(250);
/// Time limit from a complete request to the first byte of its response: longer than the 20 s of an operator's command.
const WORKING: Duration = Duration::from_secs(25);
/// Time limit of a response from its first byte: 200 kB at 20 kB/s.
const ANSWERING: Duration = Duration::from_secs(10);
/// Pause after a failed accept, for example without free descriptors.
const PAUSE: Duration = Duration::from_millis(500);

/// A listener that accepts a limited number of connections.
pub(super) struct Bounded {
    listener: TcpListener,
    places: Arc<Semaphore>,
    /// Connections without a complete request, the oldest first. A dropped sender ends its connection.
    asking: VecDeque<(Instant, oneshot::Sender<()>)>,
}

impl Bounded {
    pub(super) fn new(listener: TcpListener) -> Self {
        Self { listener, places: Arc::new(Semaphore::new(CONNECTIONS)), asking: VecDeque::new() }
    }

    /// Waits for a place. The connection that has waited longest for its request loses its place after [`GRACE`].
    async fn place(&mut self) -> Option<OwnedSemaphorePermit> {
        loop {
            self.asking.retain(|(_, asking)| !asking.is_closed());
            let oldest = self.asking.front().map(|(since, _)| *since + GRACE);
            tokio::select! {
                biased;
                // Cannot fail, as the semaphore is never closed.
                place = Arc::clone(&self.places).acquire_owned() => return place.ok(),
                () = time::sleep_until(oldest.unwrap_or_else(Instant::now)), if oldest.is_some() => {
                    self.asking.pop_front();
                }
            }
        }
    }
}

impl Listener for Bounded {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        loop {
            match self.listener.accept().await {
                Ok((stream, from)) => {
                    let place = self.place().await;
                    let (asking, evicted) = oneshot::channel();
                    self.asking.push_back((Instant::now(), asking));
                    let deadline = Box::pin(time::sleep(ASKING));
                    let evicted = Some(evicted);
                    let arrived = Arrived::default();
                    return (
                        Connection {
                            stream,
                            deadline,
                            evicted,
                            arrived,
                            read_bytes: 0,
                            answering: false,
                            _place: place,
                        },
                        from,
                    );
                }
                Err(error) => {
                    tracing::debug!(%error, "a connection to the dashboard failed");
                    time::sleep(PAUSE).await;
                }
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// Mark of a connection whose request is complete. Set by the handler, which alone knows the end of the request.
#[derive(Debug, Clone, Default)]
pub(super) struct Arrived(Arc<AtomicBool>);

impl Arrived {
    pub(super) fn set(&self) {
        self.0.store(true, Relaxed);
    }
}

impl Connected<IncomingStream<'_, Bounded>> for Arrived {
    fn connect_info(stream: IncomingStream<'_, Bounded>) -> Self {
        stream.io().arrived.clone()
    }
}

/// A connection that fails at its deadline, or after too many bytes from the client.
pub(super) struct Connection {
    stream: TcpStream,
    deadline: Pin<Box<Sleep>>,
    /// Resolves when another connection needs the place; `None` after the request has arrived.
    evicted: Option<oneshot::Receiver<()>>,
    arrived: Arrived,
    read_bytes: usize,
    answering: bool,
    _place: Option<OwnedSemaphorePermit>,
}

impl Connection {
    fn in_time(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        // A complete request waits for its response and keeps its place.
        if self.arrived.0.swap(false, Relaxed) {
            self.evicted = None;
            self.deadline.as_mut().reset(Instant::now() + WORKING);
        }
        let is_evicted = self.evicted.as_mut().is_some_and(|evicted| Pin::new(evicted).poll(context).is_ready());
        if is_evicted || self.deadline.as_mut().poll(context).is_ready() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        Ok(())
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        self.in_time(context)?;
        let before = buffer.filled().len();
        let polled = Pin::new(&mut self.stream).poll_read(context, buffer);
        self.read_bytes += buffer.filled().len() - before;
        if self.read_bytes > READ_BYTES {
            return Poll::Ready(Err(io::ErrorKind::InvalidData.into()));
        }
        polled
    }
}

impl AsyncWrite for Connection {
    fn poll_write(mut self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        if !self.answering {
            (self.answering, self.evicted) = (true, None);
            self.deadline.as_mut().reset(Instant::now() + ANSWERING);
        }
        self.in_time(context)?;
        Pin::new(&mut self.stream).poll_write(context, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
