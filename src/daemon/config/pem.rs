//! Certificates and private keys in PEM files.

use std::path::Path;

use tokio_rustls::rustls::{
    RootCertStore,
    crypto::ring,
    pki_types::{
        CertificateDer, PrivateKeyDer,
        pem::{Error, PemObject as _},
    },
};

/// The certificates in a file, at least one; a sentence if the file has none or a damaged one.
pub(super) fn certificates(file: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let read: Result<Vec<_>, _> = CertificateDer::pem_file_iter(file).and_then(Iterator::collect);
    let certificates = read.map_err(|error| unusable(file, "is not PEM", error))?;
    if certificates.is_empty() {
        return Err(format!("{} has no certificate in PEM", file.display()));
    }
    let mut store = RootCertStore::empty();
    for certificate in &certificates {
        store.add(certificate.clone()).map_err(|error| format!("{} has a bad certificate: {error}", file.display()))?;
    }
    Ok(certificates)
}

/// Checks that a file has a private key; a sentence if it has none or a damaged one.
pub(super) fn check_private_key(file: &Path) -> Result<(), String> {
    let key = PrivateKeyDer::from_pem_file(file).map_err(|error| unusable(file, "has no private key in PEM", error))?;
    let loaded = ring::default_provider().key_provider.load_private_key(key);
    loaded.map(drop).map_err(|error| format!("{} has a bad private key: {error}", file.display()))
}

fn unusable(file: &Path, problem: &str, error: Error) -> String {
    match error {
        Error::Io(error) => format!("{} cannot be read: {error}", file.display()),
        error => format!("{} {problem}: {error}", file.display()),
    }
}
