//! A TCP relay that can be cut. While it is cut it holds all data back, as a link that loses every packet.

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    sync::watch,
};

/// Client end of the relay.
pub(crate) struct Cable {
    /// Endpoint for clients.
    pub(crate) endpoint: String,
    connected: watch::Sender<bool>,
}

impl Cable {
    /// A relay to a zenoh endpoint, connected at first.
    pub(crate) async fn to(endpoint: &str) -> Self {
        let far = endpoint.trim_start_matches("tcp/").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let (connected, state) = watch::channel(true);
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                tokio::spawn(pass(near, far.clone(), state.clone()));
            }
        });
        Self { endpoint, connected }
    }

    pub(crate) fn cut(&self) {
        self.connected.send_replace(false);
    }

    pub(crate) fn mend(&self) {
        self.connected.send_replace(true);
    }
}

async fn pass(near: TcpStream, far: String, mut state: watch::Receiver<bool>) {
    if state.wait_for(|connected| *connected).await.is_err() {
        return;
    }
    // The server may be restarting: the relay closes the link, and the client tries again.
    let Ok(far) = TcpStream::connect(far).await else { return };
    let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
    tokio::join!(one_way(near_in, far_out, state.clone()), one_way(far_in, near_out, state));
}

/// Copies until an end closes or the relay is dropped. Data that were read during a cut arrive after it: TCP repeats
/// lost packets.
async fn one_way(
    mut from: tokio::net::tcp::OwnedReadHalf,
    mut to: tokio::net::tcp::OwnedWriteHalf,
    mut state: watch::Receiver<bool>,
) {
    let mut buffer = vec![0; 1 << 16];
    loop {
        let count = from.read(&mut buffer).await.unwrap_or(0);
        // A cut also holds back the close of an end.
        let is_dropped = state.wait_for(|connected| *connected).await.is_err();
        if is_dropped || count == 0 || to.write_all(&buffer[..count]).await.is_err() {
            return;
        }
    }
}
