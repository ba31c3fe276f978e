//! The table at the end: times from the benchmarks, each beside its peer.

use std::{fs, path::Path};

/// Mean time of a part of pointsd, and of its peer: another program or a simpler way for the same work. \[s\]
pub(crate) struct Row {
    pub(crate) what: &'static str,
    pub(crate) time_s: f64,
    pub(crate) peer: &'static str,
    pub(crate) peer_s: f64,
}

impl Row {
    /// A row from two benchmarks, each with its title and its path below `folder`; `None` if one was not run.
    pub(crate) fn of(
        folder: &Path,
        (what, benchmark): (&'static str, &str),
        (peer, peer_benchmark): (&'static str, &str),
    ) -> Option<Self> {
        Some(Self { what, time_s: mean_s(folder, benchmark)?, peer, peer_s: mean_s(folder, peer_benchmark)? })
    }
}

/// Mean time of a benchmark, as criterion has stored it \[s\].
fn mean_s(folder: &Path, benchmark: &str) -> Option<f64> {
    let text = fs::read(folder.join(benchmark).join("new/estimates.json")).ok()?;
    let estimates: serde_json::Value = serde_json::from_slice(&text).ok()?;
    Some(estimates["mean"]["point_estimate"].as_f64()? * 1e-9)
}

pub(crate) fn print(rows: &[Row]) {
    println!("| pointsd | us | peer | us | peer / pointsd |\n|---|---:|---|---:|---:|");
    for Row { what, time_s, peer, peer_s } in rows {
        println!("| {what} | {:.0} | {peer} | {:.0} | {:.1} |", 1e6 * time_s, 1e6 * peer_s, peer_s / time_s);
    }
}
