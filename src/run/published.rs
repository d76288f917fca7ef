//! What lies in an output folder, and what a killed run may have put there: noted in the cache, a state a pipeline and
//! folder.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::codec::{Reader, Writer};
use super::stamp::{Stamp, boot};
use super::store::Store;
use crate::digest::Digest;
use crate::graph::Graph;

/// A published file, as it is after the run.
#[derive(Clone, Debug, Default)]
pub struct Published {
    /// Below the output folder.
    pub path: String,
    pub digest: Digest,
    pub bytes: u64,
    /// By this run.
    pub written: bool,
    pub stamp: Stamp,
    /// The node that made it.
    pub node: String,
}

const TAG: &str = "lodge published 3";

/// Not touched where nothing changed: plans depend on it.
pub fn note(store: &Store, name: &str, bytes: &[u8]) {
    if bytes != store.get_state("published", name)
        && let Err(error) = store.put_state("published", name, bytes)
    {
        tracing::debug!(%error, "cannot note what was published");
    }
}

pub fn state_name(graph: &Graph, out: &Path) -> String {
    let mut name = Writer::default();
    name.text(&graph.file.to_string_lossy());
    name.text(&absolute(out).to_string_lossy());
    Digest::of(&name.0).short(16)
}

fn absolute(path: &Path) -> PathBuf {
    fs::canonicalize(path).or_else(|_| std::path::absolute(path)).unwrap_or_else(|_| path.to_path_buf())
}

/// What the last runs published here, and what runs that were killed may have. A damaged state is none: then nothing
/// is removed, and everything read.
pub struct State {
    pub before: BTreeMap<String, Published>,
    pub planned: Vec<Published>,
}

impl State {
    pub fn read(store: &Store, name: &str) -> Self {
        let all = parse(&store.get_state("published", name)).map_or(Vec::new(), |(_, all)| all);
        let (planned, before): (Vec<_>, Vec<_>) = all.into_iter().partition(|(_, planned)| *planned);
        let before = before.into_iter().map(|(p, _)| (p.path.clone(), p)).collect();
        Self { before, planned: planned.into_iter().map(|(p, _)| p).collect() }
    }
}

/// The output folder and what lies there, true beside what a run was about to write.
fn parse(bytes: &[u8]) -> Option<(PathBuf, Vec<(Published, bool)>)> {
    let mut from = Reader::unseal(bytes, TAG)?;
    // A reboot may have lost what was written without waiting for the disk.
    let same_boot = from.text()? == boot();
    let out = PathBuf::from(from.text()?);
    let all = from.list(|f| {
        let (path, node) = (f.text()?.to_string(), f.text()?.to_string());
        let (digest, bytes, stamp) = (f.digest()?, f.u64()?, Stamp::read(f)?);
        let stamp = if same_boot { stamp } else { Stamp::default() };
        Some((Published { path, digest, bytes, written: false, stamp, node }, f.u32()? != 0))
    })?;
    Some((out, all))
}

pub fn is_whole(bytes: &[u8]) -> bool {
    parse(bytes).is_some()
}

/// All that this cache knows to be published, with the folder it lies in.
pub fn all(store: &Store) -> Vec<(PathBuf, Published)> {
    let mut names: Vec<_> = fs::read_dir(store.root().join("published")).into_iter().flatten().flatten().collect();
    names.sort_by_key(|e| e.file_name());
    let states = names.iter().filter_map(|e| parse(&store.get_state("published", e.file_name().to_str()?)));
    let published = |(p, planned): (Published, bool)| (!planned).then_some(p);
    states.flat_map(|(out, all)| all.into_iter().filter_map(published).map(move |p| (out.clone(), p))).collect()
}

pub fn write_state<'a>(
    folder: &Path,
    all: &BTreeMap<&str, &'a Published>,
    planned: impl Iterator<Item = &'a Published>,
) -> Vec<u8> {
    let planned: BTreeMap<(&str, &Digest), &Published> = planned.map(|p| ((&*p.path, &p.digest), p)).collect();
    let mut out = Writer::default();
    out.text(&boot());
    out.text(&absolute(folder).to_string_lossy());
    out.u32((all.len() + planned.len()) as u32);
    let files = all.values().map(|&p| (p, 0)).chain(planned.values().map(|&p| (p, 1)));
    for (file, planned) in files {
        out.text(&file.path);
        out.text(&file.node);
        out.digest(&file.digest);
        out.u64(file.bytes);
        file.stamp.write(&mut out);
        out.u32(planned);
    }
    out.sealed(TAG)
}
