//! Time of one throw: of each step and of the whole pipeline, each compared with a peer (another program or a simpler
//! way for the same work) in the same run.

#![expect(clippy::expect_used, reason = "a benchmark may stop on an error")]

mod estimator;
mod fleet;
#[path = "../support/json.rs"]
mod json;
mod message;
mod pipeline;
mod simulator;
mod table;

use std::path::Path;

use criterion::Criterion;
use table::Row;

/// Runs the benchmarks; without a filter also the whole pipeline, and then prints the table.
fn main() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("criterion");
    let mut criterion = Criterion::default().output_directory(&folder).configure_from_args();
    estimator::estimation(&mut criterion);
    message::decoding(&mut criterion);
    message::diagnosis(&mut criterion);
    message::storing(&mut criterion);
    simulator::simulator(&mut criterion);
    criterion.final_summary();
    if std::env::args().skip(1).any(|argument| argument != "--bench") {
        return;
    }
    let row = |what, peer| Row::of(&folder, what, peer);
    let group = "one throw of 4000 samples";
    let rows = [
        row(
            ("SRIV with its covariance, 4,000 samples", &format!("{group}/sriv with its covariance")),
            ("dsmc srivc without covariance", &format!("{group}/dsmc srivc, no covariance")),
        ),
        row(
            ("trace to estimate", &format!("{group}/the whole way from trace to estimate")),
            ("dsmc srivc without covariance", &format!("{group}/dsmc srivc, no covariance")),
        ),
        row(("decode a message, CBOR", "decode/cbor"), ("JSON", "decode/json")),
        row(("diagnosis", "judge/diagnosis"), ("identification", "judge/identification")),
        row(
            ("group of 64 throws: checked, compressed, committed", "store a group/compressed"),
            ("the samples as raw blobs in one table", "store a group/raw"),
        ),
        pipeline::compare(),
    ];
    table::print(&rows.into_iter().flatten().collect::<Vec<_>>());
}
