//! What `deploy/` ships: units, certificates, and the zenoh configurations under attack, over TLS on loopback.

mod access;
mod central;
mod shipped;
mod site;
mod units;
