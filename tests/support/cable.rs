//! A TCP relay that can be cut, as a link that loses every packet, or broken, as one whose ends notice.

#![allow(dead_code, reason = "shared by test targets, each of which needs some of it")]

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    sync::watch,
};

/// State of the relay.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Link {
    Whole,
    /// It holds all data back.
    Cut,
    /// It closes every connection and accepts no new one.
    Broken,
}

/// Client end of the relay.
pub(crate) struct Cable {
    /// Endpoint for clients.
    pub(crate) endpoint: String,
    link: watch::Sender<Link>,
}

impl Cable {
    /// A relay to a zenoh endpoint, connected at first.
    pub(crate) async fn to(endpoint: &str) -> Self {
        let (protocol, far) = endpoint.split_once('/').unwrap();
        let far = far.to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("{protocol}/{}", listener.local_addr().unwrap());
        let (link, state) = watch::channel(Link::Whole);
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let (far, state, mut broken) = (far.clone(), state.clone(), state.clone());
                tokio::spawn(async move {
                    tokio::select! {
                        () = pass(near, far, state) => {}
                        _ = broken.wait_for(|link| *link == Link::Broken) => {}
                    }
                });
            }
        });
        Self { endpoint, link }
    }

    pub(crate) fn cut(&self) {
        self.link.send_replace(Link::Cut);
    }

    pub(crate) fn break_off(&self) {
        self.link.send_replace(Link::Broken);
    }

    pub(crate) fn mend(&self) {
        self.link.send_replace(Link::Whole);
    }
}

async fn pass(near: TcpStream, far: String, mut state: watch::Receiver<Link>) {
    if state.wait_for(|link| *link == Link::Whole).await.is_err() {
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
    mut state: watch::Receiver<Link>,
) {
    let mut buffer = vec![0; 1 << 16];
    loop {
        let count = from.read(&mut buffer).await.unwrap_or(0);
        // A cut also holds back the close of an end.
        let is_dropped = state.wait_for(|link| *link == Link::Whole).await.is_err();
        if is_dropped || count == 0 || to.write_all(&buffer[..count]).await.is_err() {
            return;
        }
    }
}
