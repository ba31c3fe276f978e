//! The files of `deploy/`: units, certificates, and the zenoh configurations under attack, over TLS on loopback.

#[cfg(test)]
mod access;
#[cfg(test)]
mod central;
#[cfg(test)]
mod daemon;
#[cfg(test)]
mod documents;
#[cfg(test)]
mod shipped;
#[cfg(test)]
mod site;
#[cfg(test)]
mod units;
