//! For every request: checks of method, host name and origin, and a time limit. For every response: security headers,
//! an entity tag, and compression.

use std::{io::Write as _, net::IpAddr, sync::Arc, time::Duration};

use axum::{
    Extension,
    body::{Body, to_bytes},
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, Method, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use flate2::{Compression, write::GzEncoder};
use hyper::body::Body as _;
use tokio::time;

use super::{connection::Progress, overview::Web, page::Failure, trouble};

/// Time limit of a page: below the timeout of the script on the page, and below the daemon's limit for one query.
pub(super) const LIMIT: Duration = Duration::from_secs(4);

/// Content security policy: style, script, forms and connections of this daemon only; not in frames.
const POLICY: &str = "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'self'; frame-ancestors 'none'";

/// Largest body that needs no permit \[bytes\]. Only the trace of a long throw is larger.
const SMALL: u64 = 1 << 20;
/// Smallest body that is compressed \[bytes\]; a smaller one fits into one packet.
const LEAST_COMPRESSED: usize = 1_024;
/// Mark of a line that changes every second. Such a line does not count for the entity tag of its page.
const VOLATILE: &str = "data-volatile";

pub(super) async fn guard(
    State(web): State<Arc<Web>>,
    Extension(progress): Extension<Progress>,
    request: Request,
    next: Next,
) -> Response {
    let wants_gzip = accepts_gzip(request.headers());
    let known = request.headers().get(header::IF_NONE_MATCH).cloned();
    let is_api = request.uri().path().starts_with("/api/");
    let failed = |failure: &Failure| if is_api { failure.json() } else { failure.page(trouble::of_daemon(&web.view)) };
    let config = web.view.config();
    let commands = config.web.token.is_some();
    let mut response = if let Some(refusal) = refusal(&request, &config.web.hosts, commands) {
        // The request may come from a foreign page, so the response has no data of the daemon.
        let mut response = if is_api { refusal.json() } else { refusal.page(Vec::new()) };
        if response.status() == StatusCode::METHOD_NOT_ALLOWED {
            let allowed = if commands { "GET, HEAD, POST" } else { "GET, HEAD" };
            response.headers_mut().insert(header::ALLOW, HeaderValue::from_static(allowed));
        }
        response
    } else {
        let is_post = *request.method() == Method::POST;
        if !is_post {
            progress.arrived();
        }
        let answer = next.run(request);
        let mut response = if is_post {
            // Without this time limit: the queue of commands has its own. If this request ended earlier, its command
            // could still be applied.
            answer.await
        } else {
            time::timeout(LIMIT, answer).await.unwrap_or_else(|_| Failure::busy().into_response())
        };
        match response.extensions_mut().remove::<Failure>() {
            Some(failure) => failed(&failure),
            None => response,
        }
    };
    if response.body().size_hint().lower() > SMALL {
        match web.large_permit() {
            Some(permit) => progress.hold(permit),
            None => response = failed(&Failure::busy()),
        }
    }
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "same-origin"),
        (header::VARY, "accept-encoding"),
        // One request for each connection: idle connections would use up the permits.
        (header::CONNECTION, "close"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    let response = tag_and_compress(response, known.as_ref(), wants_gzip).await;
    progress.answered();
    response
}

/// Adds the entity tag. Removes the body if the browser has the same page already; else compresses a large body.
async fn tag_and_compress(response: Response, known: Option<&HeaderValue>, wants_gzip: bool) -> Response {
    let (mut parts, body) = response.into_parts();
    // No limit, and no error: the handler has the whole body in memory.
    let Ok(bytes) = to_bytes(body, usize::MAX).await else { return StatusCode::INTERNAL_SERVER_ERROR.into_response() };
    if parts.status != StatusCode::OK || bytes.is_empty() {
        return Response::from_parts(parts, Body::from(bytes));
    }
    if let Ok(tag) = HeaderValue::from_str(&tag(&bytes)) {
        let is_known = known == Some(&tag);
        parts.headers.insert(header::ETAG, tag);
        if is_known {
            parts.status = StatusCode::NOT_MODIFIED;
            // The browser keeps all other headers of its copy.
            let kept = [header::ETAG, header::CONNECTION].map(|name| (parts.headers.remove(&name), name));
            parts.headers.clear();
            for (value, name) in kept {
                parts.headers.extend(value.map(|value| (name, value)));
            }
            return Response::from_parts(parts, Body::empty());
        }
    }
    if !wants_gzip || bytes.len() < LEAST_COMPRESSED {
        return Response::from_parts(parts, Body::from(bytes));
    }
    // Compression takes too long for an async worker.
    let page = bytes.clone();
    let compressed = tokio::task::spawn_blocking(move || {
        let mut encoder = GzEncoder::new(Vec::with_capacity(page.len() / 4), Compression::fast());
        encoder.write_all(&page).and_then(|()| encoder.finish())
    });
    match compressed.await {
        Ok(Ok(short)) => {
            parts.headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
            parts.headers.remove(header::CONTENT_LENGTH);
            Response::from_parts(parts, Body::from(short))
        }
        // Happens only when the runtime shuts down, as compression into memory does not fail.
        _ => Response::from_parts(parts, Body::from(bytes)),
    }
}

/// A weak entity tag: equal for pages that differ only in lines with [`VOLATILE`].
fn tag(bytes: &[u8]) -> String {
    let lasting = |line: &&[u8]| !line.windows(VOLATILE.len()).any(|part| part == VOLATILE.as_bytes());
    let mut hash = crc32fast::Hasher::new();
    let mut length = 0;
    for line in bytes.split(|byte| *byte == b'\n').filter(lasting) {
        hash.update(line);
        length += line.len();
    }
    format!("W/\"{:08x}-{length:x}\"", hash.finalize())
}

fn accepts_gzip(headers: &HeaderMap) -> bool {
    let accepted = headers.get(header::ACCEPT_ENCODING).and_then(|value| value.to_str().ok()).unwrap_or_default();
    accepted.split(',').map(str::trim).any(|coding| coding == "gzip" || coding == "*")
}

/// The reason to refuse a request; `None` if it is allowed. `names` are the configured host names; `commands` is true
/// if pages accept operators' commands.
fn refusal(request: &Request, names: &[String], commands: bool) -> Option<Failure> {
    let is_post = commands && *request.method() == Method::POST;
    if !is_post && !matches!(*request.method(), Method::GET | Method::HEAD) {
        let message = if commands {
            "The dashboard takes only GET, and POST for operators' commands."
        } else {
            "The dashboard can only be read, with GET. Operators' commands need web.token in the configuration."
        };
        return Some(Failure::new(StatusCode::METHOD_NOT_ALLOWED, message));
    }
    let Some(host) = asked_host(request.headers()) else {
        return Some(Failure::new(
            StatusCode::BAD_REQUEST,
            "The request needs exactly one header Host, with the name of this host.",
        ));
    };
    if !is_ours(host, names) {
        return Some(Failure::new(
            StatusCode::MISDIRECTED_REQUEST,
            "The request names another host. Use the IP address of this host or localhost, or add the name to hosts in the section [web] of the configuration.",
        ));
    }
    (is_post && !is_same_site(request.headers(), host)).then(|| {
        Failure::new(
            StatusCode::FORBIDDEN,
            "The command comes from a page of another site. Use the form on the machine's page.",
        )
    })
}

/// Whether a page of this daemon sent the request. Browsers send `Origin` with every POST.
fn is_same_site(headers: &HeaderMap, host: &str) -> bool {
    let text = |name: header::HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or_default());
    let site = text(header::HeaderName::from_static("sec-fetch-site")).is_none_or(|site| site == "same-origin");
    let origin = text(header::ORIGIN).is_some_and(|origin| {
        let origin = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        origin.is_some_and(|origin| origin.eq_ignore_ascii_case(host))
    });
    site && origin
}

/// The value of the header `Host`; `None` unless there is exactly one.
fn asked_host(headers: &HeaderMap) -> Option<&str> {
    let mut hosts = headers.get_all(header::HOST).iter();
    let host = hosts.next()?.to_str().ok()?;
    hosts.next().is_none().then_some(host)
}

/// Whether `host` names this daemon. This protects against DNS rebinding, in which a browser sends the name of a
/// foreign site.
fn is_ours(host: &str, names: &[String]) -> bool {
    let bare = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, _)) => address,
        None => host.split_once(':').map_or(host, |(name, _)| name),
    };
    bare.parse::<IpAddr>().is_ok()
        || bare.eq_ignore_ascii_case("localhost")
        || names.iter().any(|name| name.eq_ignore_ascii_case(bare))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ip_addresses_localhost_and_configured_names_are_accepted() {
        let names = ["cabinet.north".to_owned()];
        for ours in [
            "127.0.0.1",
            "127.0.0.1:7480",
            "[::1]:7480",
            "[::1]",
            "localhost:1",
            "LocalHost",
            "10.1.2.3",
            "Cabinet.North:80",
        ] {
            assert!(is_ours(ours, &names), "{ours}");
        }
        for other in [
            "",
            "evil.example",
            "127.0.0.1.evil.example",
            "localhost.evil.example:7480",
            "cabinet",
            "[evil]",
            "@127.0.0.1",
        ] {
            assert!(!is_ours(other, &names), "{other}");
        }
    }

    #[test]
    fn only_our_own_pages_send_commands() {
        let same = |origin: Option<&str>, site: Option<&str>| {
            let mut headers = HeaderMap::new();
            for (name, value) in [("origin", origin), ("sec-fetch-site", site)] {
                if let Some(value) = value {
                    headers.insert(header::HeaderName::from_static(name), HeaderValue::from_str(value).unwrap());
                }
            }
            is_same_site(&headers, "127.0.0.1:7480")
        };
        assert!(same(Some("http://127.0.0.1:7480"), Some("same-origin")));
        assert!(same(Some("http://127.0.0.1:7480"), None));
        for (origin, site) in [
            (None, None),
            (None, Some("same-origin")),
            (Some("null"), None),
            (Some("http://127.0.0.1:7481"), None),
            (Some("http://evil.example"), Some("same-origin")),
            (Some("http://127.0.0.1:7480"), Some("cross-site")),
            (Some("http://127.0.0.1:7480"), Some("same-site")),
        ] {
            assert!(!same(origin, site), "{origin:?} {site:?}");
        }
    }

    /// 20,000 machines with long names and several drifts have some 50 MB of metrics.
    #[tokio::test]
    async fn a_large_response_is_sent_whole() {
        let metrics = Response::new(Body::from(vec![b'x'; 50 << 20]));
        let response = tag_and_compress(metrics, None, false).await;
        assert_eq!(response.status(), StatusCode::OK);
        assert_eq!(to_bytes(response.into_body(), usize::MAX).await.unwrap().len(), 50 << 20);
    }

    #[test]
    fn a_page_that_differs_in_its_clock_alone_is_the_same_page() {
        let page = |now: &str, state: &str| tag(format!("<p>{state}</p>\n<p data-volatile>{now}</p>\n").as_bytes());
        assert_eq!(page("10:00", "good"), page("10:05", "good"));
        assert_ne!(page("10:00", "good"), page("10:00", "bad"));
    }
}
