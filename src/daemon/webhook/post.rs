//! The HTTP request to the receiver of the webhook.

use std::{pin::pin, sync::Arc, time::Duration};

use http_body_util::Full;
use hyper::{Method, Request, StatusCode, Uri, body::Bytes, client::conn::http1, header, header::HeaderValue};
use hyper_util::rt::TokioIo;
use tokio::{
    io::{AsyncRead, AsyncWrite},
    net::TcpStream,
    time::timeout,
};
use tokio_rustls::{
    TlsConnector,
    rustls::{ClientConfig, RootCertStore, crypto::ring, pki_types::ServerName},
};

use super::super::config::Webhook;

/// Time limit of a request, from the look-up of the host name to the status of the response.
const LIMIT: Duration = Duration::from_secs(10);

/// The reason why a message was not accepted.
#[derive(Debug, thiserror::Error)]
pub(super) enum PostError {
    /// The receiver cannot use this message; it may accept others.
    #[error("the receiver refuses the message with status {0}")]
    Refused(StatusCode),
    /// The receiver answered with another status: a later attempt may succeed.
    #[error("the receiver answers with status {0}{hint}", hint = redirect_hint(*.0))]
    Status(StatusCode),
    /// No answer within [`LIMIT`].
    #[error("the receiver does not answer within {} s", LIMIT.as_secs())]
    Timeout,
    /// The connection failed.
    #[error(transparent)]
    Connection(#[from] std::io::Error),
    /// The receiver does not speak HTTP/1.1, or closes the connection.
    #[error(transparent)]
    Http(#[from] hyper::Error),
}

const fn redirect_hint(status: StatusCode) -> &'static str {
    if status.as_u16() / 100 == 3 { "; redirects are not followed: set webhook.url to the final address" } else { "" }
}

/// Address and credentials of the receiver.
pub(super) struct WebhookServer {
    uri: Uri,
    host: String,
    port: u16,
    authorization: Option<HeaderValue>,
    /// `None` for `http`.
    tls: Option<(TlsConnector, ServerName<'static>)>,
}

impl WebhookServer {
    /// The receiver of a checked configuration; `None` without an address.
    ///
    /// # Errors
    /// A sentence, when the certificate authorities cannot be used.
    pub(super) fn new(settings: &Webhook) -> Result<Option<Self>, String> {
        let Some(uri) = settings.uri() else { return Ok(None) };
        // An IPv6 address has brackets only within a URL.
        let host = uri.host().unwrap_or_default().trim_matches(['[', ']']).to_owned();
        let is_tls = uri.scheme_str() == Some("https");
        let port = uri.port_u16().unwrap_or(if is_tls { 443 } else { 80 });
        let tls = if is_tls {
            let name = ServerName::try_from(host.clone()).map_err(|error| error.to_string())?;
            Some((connector(settings)?, name))
        } else {
            None
        };
        let authorization = settings.authorization.as_ref().and_then(|token| {
            let mut value = HeaderValue::from_str(token.secret()).ok()?;
            value.set_sensitive(true);
            Some(value)
        });
        Ok(Some(Self { uri, host, port, authorization, tls }))
    }

    /// Sends a JSON message; `Ok` if the receiver accepted it.
    pub(super) async fn post(&self, body: Bytes) -> Result<(), PostError> {
        timeout(LIMIT, self.connect_and_post(body)).await.unwrap_or(Err(PostError::Timeout))
    }

    async fn connect_and_post(&self, body: Bytes) -> Result<(), PostError> {
        let stream = TcpStream::connect((self.host.as_str(), self.port)).await?;
        match &self.tls {
            Some((tls, name)) => self.post_on(tls.connect(name.clone(), stream).await?, body).await,
            None => self.post_on(stream, body).await,
        }
    }

    async fn post_on<Stream>(&self, stream: Stream, body: Bytes) -> Result<(), PostError>
    where
        Stream: AsyncRead + AsyncWrite + Unpin,
    {
        let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
        let mut request = Request::new(Full::new(body));
        *request.method_mut() = Method::POST;
        // The request line of HTTP/1.1 has only the path; the host is a header.
        *request.uri_mut() = self.uri.path_and_query().map(|path| Uri::from(path.clone())).unwrap_or_default();
        let authority = self.uri.authority().and_then(|it| HeaderValue::from_str(it.as_str()).ok());
        let agent = HeaderValue::from_static(concat!("pointsd/", env!("CARGO_PKG_VERSION")));
        for (name, value) in [
            (header::HOST, authority),
            (header::USER_AGENT, Some(agent)),
            (header::CONTENT_TYPE, Some(HeaderValue::from_static("application/json"))),
            (header::CONNECTION, Some(HeaderValue::from_static("close"))),
            (header::AUTHORIZATION, self.authorization.clone()),
        ] {
            request.headers_mut().extend(value.map(|value| (name, value)));
        }
        let (mut response, mut connection) = (pin!(sender.send_request(request)), pin!(connection));
        // The connection makes progress only while it is polled. It may end with the response.
        let response = tokio::select! {
            response = &mut response => response,
            _ = &mut connection => response.await,
        };
        let status = response?.status();
        match status {
            status if status.is_success() => Ok(()),
            StatusCode::BAD_REQUEST | StatusCode::PAYLOAD_TOO_LARGE | StatusCode::UNPROCESSABLE_ENTITY => {
                Err(PostError::Refused(status))
            }
            status => Err(PostError::Status(status)),
        }
    }
}

fn connector(settings: &Webhook) -> Result<TlsConnector, String> {
    let mut roots = RootCertStore::empty();
    match settings.authorities()? {
        Some(certificates) => {
            for certificate in certificates {
                roots.add(certificate).map_err(|error| format!("webhook.ca_file: {error}"))?;
            }
        }
        None => roots.extend(webpki_roots::TLS_SERVER_ROOTS.iter().cloned()),
    }
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| error.to_string())?;
    Ok(TlsConnector::from(Arc::new(config.with_root_certificates(roots).with_no_client_auth())))
}
