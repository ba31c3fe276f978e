//! What holds for every request: reading only, asked for under a name of ours, answered in time, with headers that let
//! a browser do nothing else with it.

use std::{net::IpAddr, sync::Arc, time::Duration};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, Method, StatusCode, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use tokio::time;

use super::{Web, page::Failure, trouble};

/// Longest wait for an answer, less than a browser's patience and the daemon's limit for one query.
const LIMIT: Duration = Duration::from_secs(4);

/// Our own style, our own script, and the page itself to refresh from; nothing else, and in nobody's frame.
const POLICY: &str = "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

pub(super) async fn guard(State(web): State<Arc<Web>>, request: Request, next: Next) -> Response {
    let mut response = if let Some(refusal) = refusal(&request, &web.view.config().web.hosts) {
        // Who asks wrongly may be anybody, and is told nothing of the daemon.
        refusal.page(Vec::new())
    } else {
        let answer = time::timeout(LIMIT, next.run(request)).await;
        let mut response = answer.unwrap_or_else(|_| Failure::busy().into_response());
        match response.extensions_mut().remove::<Failure>() {
            Some(failure) => failure.page(trouble::of_daemon(&web.view)),
            None => response,
        }
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::CACHE_CONTROL, "no-store"),
        (header::REFERRER_POLICY, "no-referrer"),
        // One request a connection: none is kept for later by who may have gone.
        (header::CONNECTION, "close"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

fn refusal(request: &Request, names: &[String]) -> Option<Failure> {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        return Some(Failure::new(StatusCode::METHOD_NOT_ALLOWED, "The dashboard can only be read: ask with GET."));
    }
    match asked_host(request.headers()) {
        None => Some(Failure::new(
            StatusCode::BAD_REQUEST,
            "The request does not say whom it asks: it needs one header Host.",
        )),
        Some(host) if is_ours(host, names) => None,
        Some(_) => Some(Failure::new(
            StatusCode::MISDIRECTED_REQUEST,
            "This is not the host that was asked for. Use its IP address or localhost, or add the name to hosts in the section [web] of the configuration.",
        )),
    }
}

fn asked_host(headers: &HeaderMap) -> Option<&str> {
    let mut hosts = headers.get_all(header::HOST).iter();
    let host = hosts.next()?.to_str().ok()?;
    hosts.next().is_none().then_some(host)
}

/// A web page that makes its own name lead here (DNS rebinding) is told from us by that name.
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
    fn only_addresses_localhost_and_configured_names_are_ours() {
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
}
