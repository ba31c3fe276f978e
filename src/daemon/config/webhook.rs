//! The `[webhook]` section: alarm events to a server of the operator.

use std::path::PathBuf;

use hyper::{Uri, header::HeaderValue, http::uri::Authority};
use serde::{Deserialize, Serialize};
use tokio_rustls::rustls::pki_types::CertificateDer;

use super::{ConfigError, Document, Token, pem};
use crate::{
    diagnose::{Cause, Severity},
    throw::{Range::Within, settings},
    wire::Alarm,
};

settings! {
    /// The `[webhook]` section: alarm events to a server of the operator.
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct Webhook {
        /// Address of the receiver, `http://…` or `https://…`; without it nothing is sent.
        pub url: Option<String> = None;
        /// Least severity of an alarm that is sent.
        pub severity: Severity = Severity::Warning;
        /// Causes of the alarms that are sent; empty for all.
        pub causes: Vec<Cause> = Vec::new();
        /// Largest number of messages in a period, 1 to 1,000. Further events are sent as one summary at the end of the
        /// period.
        pub max_messages: u32 = 10, Within(1.0, 1_000.0, "messages");
        /// Length of the period \[s\], 1 to 86,400.
        pub period_s: f64 = 60.0, Within(1.0, 86_400.0, "s");
        /// Value of the header `Authorization`, up to 1,024 characters.
        pub authorization: Option<Token> = None;
        /// File with the certificate authorities for the receiver (PEM); without it those of Mozilla are used.
        pub ca_file: Option<PathBuf> = None;
    }
}

/// Longest `Authorization` header \[bytes\].
const AUTHORIZATION: usize = 1_024;

impl Webhook {
    /// Whether severity and cause of an alarm pass the filters.
    pub(crate) fn wants(&self, alarm: &Alarm) -> bool {
        alarm.severity >= self.severity && (self.causes.is_empty() || self.causes.contains(&alarm.cause))
    }

    /// The address of the receiver; `None` without one.
    pub(crate) fn uri(&self) -> Option<Uri> {
        self.url.as_ref()?.parse().ok()
    }

    /// The certificate authorities in `ca_file`.
    pub(crate) fn authorities(&self) -> Result<Option<Vec<CertificateDer<'static>>>, String> {
        self.ca_file.as_deref().map(pem::certificates).transpose()
    }

    /// Checks the section.
    pub(super) fn check(&self, document: &Document) -> Result<(), ConfigError> {
        let invalid = |key: &str, problem: String| Err(document.error_at(&format!("webhook.{key}"), problem));
        if let Some(url) = &self.url {
            let uri = self.uri().unwrap_or_default();
            let is_http = matches!(uri.scheme_str(), Some("http" | "https"));
            // The address appears in the log, so it must not have a password.
            let has_user = uri.authority().is_some_and(|authority: &Authority| authority.as_str().contains('@'));
            if !is_http || has_user || uri.host().is_none_or(str::is_empty) {
                let problem = format!("{url:?} is not http://HOST/PATH or https://HOST/PATH without a user name");
                return invalid("url", problem);
            }
            let has_port = uri.authority().is_some_and(|authority| authority.as_str() != authority.host());
            if has_port && uri.port_u16().is_none_or(|port| port == 0) {
                return invalid("url", format!("{url:?}: the port must be 1 to 65535"));
            }
        }
        document.in_section("webhook", self.check_ranges())?;
        if let Some(token) = &self.authorization
            && (token.secret().len() > AUTHORIZATION || HeaderValue::from_str(token.secret()).is_err())
        {
            return invalid("authorization", format!("must be up to {AUTHORIZATION} printable ASCII characters"));
        }
        self.authorities().map(drop).or_else(|problem| invalid("ca_file", problem))
    }
}
