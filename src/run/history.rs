//! The runs of a pipeline as they were: when, how long, what became of each node, under which key, with which result.
//! One small file a run, `history/<pipeline>-<number>` in the cache, checked by its own checksum, which holds its name. The
//! last [`KEEP`] of a name stay, and no more than [`MOST`] bytes. A rerun that had nothing to do leaves none.

use std::fs;
use std::io;
use std::time::{SystemTime, UNIX_EPOCH};

use super::codec::{Reader, Writer};
use super::event::Status;
use super::store::Store;
use super::{NodeOutcome, Options, Outcome};
use crate::digest::Digest;
use crate::graph::Graph;

/// Runs that are kept of pipelines of one name.
pub const KEEP: usize = 50;
/// Bytes that they may take together.
pub const MOST: u64 = 16 << 20;

const TAG: &str = "lodge run 1";
const FOLDER: &str = "history";

/// A run that has ended.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Run {
    /// `town-12`.
    pub name: String,
    pub pipeline: String,
    pub file: String,
    /// `--set`, as given.
    pub sets: Vec<String>,
    /// Seconds since 1970.
    pub at: f64,
    pub seconds: f64,
    pub ok: bool,
    pub interrupted: bool,
    /// Published files, and how many of them were written.
    pub files: u32,
    pub written: u32,
    pub nodes: Vec<Node>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    pub name: String,
    pub op: String,
    pub status: Status,
    pub seconds: f64,
    /// Of a node with a result, its key and the result.
    pub key: Option<Digest>,
    pub digest: Option<Digest>,
    pub bytes: u64,
    /// What it read.
    pub files: Vec<String>,
    /// Of a failed node the error, of a skipped one the node to blame.
    pub because: String,
}

impl Node {
    fn of(node: &NodeOutcome) -> Self {
        let record = node.record.as_ref();
        let error = node.error.as_ref().map(|e| e.message.clone());
        Self {
            name: node.name.clone(),
            op: node.op.clone(),
            status: node.status,
            seconds: node.seconds,
            key: record.map(|r| r.key),
            digest: record.map(|r| r.digest),
            bytes: record.map_or(0, |r| r.bytes + r.blob_bytes),
            files: node.files.iter().map(|f| f.path.to_string_lossy().into_owned()).collect(),
            because: error.or_else(|| node.because.clone()).unwrap_or_default(),
        }
    }
}

impl Run {
    pub fn count(&self, status: Status) -> usize {
        self.nodes.iter().filter(|n| n.status == status).count()
    }

    /// The node that made a result.
    pub fn made(&self, digest: Digest) -> Option<String> {
        Some(self.nodes.iter().find(|n| n.digest == Some(digest))?.name.clone())
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut out = Writer::default();
        out.text(&self.name);
        out.text(&self.pipeline);
        out.text(&self.file);
        out.u32(self.sets.len() as u32);
        self.sets.iter().for_each(|s| out.text(s));
        out.f64(self.at);
        out.f64(self.seconds);
        out.0.extend([u8::from(self.ok), u8::from(self.interrupted)]);
        out.u32(self.files);
        out.u32(self.written);
        out.u32(self.nodes.len() as u32);
        for node in &self.nodes {
            out.text(&node.name);
            out.text(&node.op);
            out.text(node.status.name());
            out.f64(node.seconds);
            out.option(node.key.as_ref());
            out.option(node.digest.as_ref());
            out.u64(node.bytes);
            out.u32(node.files.len() as u32);
            node.files.iter().for_each(|f| out.text(f));
            out.text(&node.because);
        }
        out.sealed(TAG)
    }

    /// The run, if it is whole and the one of this name.
    fn of_bytes(bytes: &[u8], name: &str) -> Option<Self> {
        let mut from = Reader::unseal(bytes, TAG)?;
        let text = |f: &mut Reader| f.text().map(str::to_string);
        let run = Self {
            name: text(&mut from)?,
            pipeline: text(&mut from)?,
            file: text(&mut from)?,
            sets: from.list(text)?,
            at: from.f64()?,
            seconds: from.f64()?,
            ok: from.u8()? != 0,
            interrupted: from.u8()? != 0,
            files: from.u32()?,
            written: from.u32()?,
            nodes: from.list(|f| {
                Some(Node {
                    name: text(f)?,
                    op: text(f)?,
                    status: f.text().and_then(|s| Status::ALL.into_iter().find(|a| a.name() == s))?,
                    seconds: f.f64()?,
                    key: f.option()?,
                    digest: f.option()?,
                    bytes: f.u64()?,
                    files: f.list(text)?,
                    because: text(f)?,
                })
            })?,
        };
        (run.name == name).then_some(run)
    }

    /// Whether the same nodes had the same keys and results.
    fn same(&self, other: &Self) -> bool {
        let of = |run: &Self| run.nodes.iter().map(|n| (n.name.clone(), n.key, n.digest)).collect::<Vec<_>>();
        self.file == other.file && of(self) == of(other)
    }
}

/// Whether a run may be called so.
pub fn is_name(name: &str) -> bool {
    parts(name).is_some()
}

/// Pipeline and number.
fn parts(name: &str) -> Option<(&str, u64)> {
    let (pipeline, number) = name.rsplit_once('-')?;
    let n = number.parse::<u64>().ok().filter(|n| n.to_string() == number && *n < 1 << 50)?;
    Some((pipeline, n))
}

/// Whether the bytes are the run of this name.
pub fn is_whole(name: &str, bytes: &[u8]) -> bool {
    Run::of_bytes(bytes, name).is_some()
}

/// Names of all runs that there are, those of one pipeline in order.
pub fn names(store: &Store) -> Vec<String> {
    let mut all: Vec<(String, u64)> = list(store).into_iter().map(|(pipeline, n, _)| (pipeline, n)).collect();
    all.sort();
    all.into_iter().map(|(pipeline, n)| format!("{pipeline}-{n}")).collect()
}

/// None where there is no such run, or it is damaged.
pub fn load(store: &Store, name: &str) -> Option<Run> {
    Run::of_bytes(&store.get_state(FOLDER, name), name)
}

/// All runs of pipelines of one name, the newest first; damaged ones are left out.
pub fn newest(store: &Store, pipeline: &str) -> Vec<Run> {
    let of = names(store).into_iter().rev().filter(|name| parts(name).is_some_and(|(p, _)| p == pipeline));
    of.filter_map(|name| load(store, &name)).collect()
}

/// Pipeline, number and bytes of every file that is called as a run is.
fn list(store: &Store) -> Vec<(String, u64, u64)> {
    let entries = fs::read_dir(store.state(FOLDER, "")).into_iter().flatten().flatten();
    let run = |entry: fs::DirEntry| {
        let name = entry.file_name().into_string().ok()?;
        let (pipeline, n) = parts(&name)?;
        let meta = entry.metadata().ok().filter(fs::Metadata::is_file)?;
        Some((pipeline.to_string(), n, meta.len()))
    };
    entries.filter_map(run).collect()
}

/// Keeps a run that did something; makes room for it.
pub fn note(store: &Store, graph: &Graph, options: &Options, outcome: &Outcome, began: SystemTime) -> io::Result<()> {
    if store.is_read_only() {
        return Ok(());
    }
    let began = began.duration_since(UNIX_EPOCH).unwrap_or_default();
    let mut run = Run {
        name: String::new(),
        pipeline: graph.name.clone(),
        file: graph.file.to_string_lossy().into_owned(),
        sets: options.plan.as_ref().map_or(Vec::new(), |p| p.sets.clone()),
        at: began.as_secs_f64(),
        seconds: UNIX_EPOCH.elapsed().unwrap_or_default().saturating_sub(began).as_secs_f64(),
        ok: outcome.ok(),
        interrupted: outcome.interrupted,
        files: outcome.files.len() as u32,
        written: outcome.files.iter().filter(|f| f.written).count() as u32,
        nodes: outcome.nodes.iter().map(Node::of).collect(),
    };
    let mut mine: Vec<(u64, u64)> = list(store).into_iter().filter(|f| f.0 == graph.name).map(|f| (f.1, f.2)).collect();
    mine.sort_unstable();
    let name = |n: u64| format!("{}-{n}", graph.name);
    let idle = run.ok && run.written == 0 && run.count(Status::Cached) == run.nodes.len();
    let last = mine.last().map_or(0, |m| m.0);
    if idle && load(store, &name(last)).is_some_and(|before| before.same(&run)) {
        return Ok(());
    }

    // Of two runs that end at once each takes a number of its own.
    let mut n = last + 1;
    let bytes = loop {
        run.name = name(n);
        let bytes = run.to_bytes();
        if store.put_new_state(FOLDER, &run.name, &bytes)? {
            break bytes.len() as u64;
        }
        n += 1;
        if n > last + 1000 {
            return Err(io::Error::other("no number is free"));
        }
    };
    let mut kept = 1;
    let mut sum = bytes;
    for &(old, bytes) in mine.iter().rev() {
        kept += 1;
        sum += bytes;
        if kept > KEEP || sum > MOST {
            let _ = fs::remove_file(store.state(FOLDER, &name(old)));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_and_never_under_another_name() {
        let node = Node {
            name: "a".into(),
            op: "cut".into(),
            status: Status::Failed,
            seconds: 0.5,
            key: None,
            digest: Some(Digest::of(b"x")),
            bytes: 3,
            files: vec!["ä".into()],
            because: "so".into(),
        };
        let run = Run { name: "p-1".into(), sets: vec!["a=1".into()], at: 1.5, nodes: vec![node], ..Run::default() };
        let bytes = run.to_bytes();
        assert_eq!(Run::of_bytes(&bytes, "p-1"), Some(run));
        assert_eq!(Run::of_bytes(&bytes, "p-2"), None);
        for i in 0..bytes.len() {
            let mut bad = bytes.clone();
            bad[i] ^= 1;
            assert_eq!(Run::of_bytes(&bad, "p-1"), None);
            assert_eq!(Run::of_bytes(&bytes[..i], "p-1"), None);
        }
    }
}
