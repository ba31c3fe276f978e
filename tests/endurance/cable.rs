//! A cable that can be cut: passes TCP on, or holds everything back, as a link does whose packets are lost.

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    sync::watch,
};

/// The near end of a cable.
pub(crate) struct Cable {
    /// Where to connect instead of the far end.
    pub(crate) endpoint: String,
    whole: watch::Sender<bool>,
}

impl Cable {
    /// A cable to a zenoh endpoint, whole at first.
    pub(crate) async fn to(endpoint: &str) -> Self {
        let far = endpoint.trim_start_matches("tcp/").to_owned();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        let (whole, state) = watch::channel(true);
        tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                tokio::spawn(pass(near, far.clone(), state.clone()));
            }
        });
        Self { endpoint, whole }
    }

    pub(crate) fn cut(&self) {
        self.whole.send_replace(false);
    }

    pub(crate) fn mend(&self) {
        self.whole.send_replace(true);
    }
}

async fn pass(near: TcpStream, far: String, mut state: watch::Receiver<bool>) {
    if state.wait_for(|whole| *whole).await.is_err() {
        return;
    }
    // Whoever listens there may be restarting; the near end is closed then, and tries again.
    let Ok(far) = TcpStream::connect(far).await else { return };
    let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
    tokio::join!(one_way(near_in, far_out, state.clone()), one_way(far_in, near_out, state));
}

/// Until one end closes or the cable is gone. What was read while the cable is cut arrives when it is mended: TCP sends
/// it again.
async fn one_way(
    mut from: tokio::net::tcp::OwnedReadHalf,
    mut to: tokio::net::tcp::OwnedWriteHalf,
    mut state: watch::Receiver<bool>,
) {
    let mut buffer = vec![0; 1 << 16];
    loop {
        let count = from.read(&mut buffer).await.unwrap_or(0);
        // The news that an end has closed does not pass a cut cable either.
        let gone = state.wait_for(|whole| *whole).await.is_err();
        if gone || count == 0 || to.write_all(&buffer[..count]).await.is_err() {
            return;
        }
    }
}
