//! Lines, city models and meshes from files with something broken in them: an error with its place, or a reject with its id and
//! the rest of the file; the same where files contradict each other. (Footprints:
//! `readers.rs`; whole pipelines, and bytes changed at random: `bad_input.rs`.)

mod lines;
mod meshes;
mod models;
mod said;
#[path = "../support/mod.rs"]
mod support;

use lodge::diag::{Findings, Result};
use lodge::op::Op;
use support::{gzip, read_files};

/// Runs a reader on one file in memory, with parameters as TOML.
fn read<O: Op>(params: &str, file: &str, bytes: impl Into<Vec<u8>>) -> (Result<O::Out>, Findings) {
    read_files::<O>(params, &[(file, bytes.into())])
}

/// Read, accepted, rejected and filtered, which must add up.
fn counts(f: &Findings) -> [u64; 4] {
    let all = ["read", "accepted", "rejected", "filtered"].map(|k| f.facts[k].as_u64().unwrap());
    assert_eq!(all[0], all[1] + all[2] + all[3]);
    assert_eq!(all[2], f.rejects.len() as u64);
    all
}

/// Id, place and cause of every reject, in order.
fn rejects(f: &Findings) -> Vec<[&str; 3]> {
    f.rejects.iter().map(|n| [n.id.as_str(), n.place.as_str(), n.cause.as_str()]).collect()
}

/// Packed without compression, one piece of the text replaced by another of the same length: JSON as good as before.
fn forged(text: &str, wrong: &str, by: &str) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::none());
    std::io::Write::write_all(&mut out, text.as_bytes()).unwrap();
    let mut out = out.finish().unwrap();
    let at = out.windows(wrong.len()).position(|w| w == wrong.as_bytes()).unwrap();
    out[at..at + by.len()].copy_from_slice(by.as_bytes());
    out
}
