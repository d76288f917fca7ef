//! What the last run of a pipeline was made of: a key for each node, and the key that it had before. The lines behind
//! the keys lie with the results.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use super::Outcome;
use super::codec::{Reader, Writer};
use super::store::Store;
use crate::digest::Digest;
use crate::graph::Graph;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Last {
    pub key: Digest,
    /// The key before this one, if the node had another.
    pub before: Option<Digest>,
}

/// Of one pipeline.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LastRun {
    pub file: PathBuf,
    pub nodes: BTreeMap<String, Last>,
}

const TAG: &str = "lodge last run 2";

/// The state file of a pipeline file.
pub fn name(file: &Path) -> String {
    Digest::of(file.as_os_str().as_encoded_bytes()).short(16)
}

/// By node.
pub fn load(store: &Store, graph: &Graph) -> BTreeMap<String, Last> {
    let name = name(&graph.file);
    parse(&store.get_state("runs", &name), &name).map_or(BTreeMap::new(), |run| run.nodes)
}

/// The last run of every pipeline, with the name of its state.
pub fn all(store: &Store) -> Vec<(String, LastRun)> {
    let entries = fs::read_dir(store.state("runs", "")).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
    names.sort();
    names.into_iter().filter_map(|n| Some((n.clone(), parse(&store.get_state("runs", &n), &n)?))).collect()
}

/// The last run of this state's name, if it is whole.
pub fn parse(bytes: &[u8], name: &str) -> Option<LastRun> {
    let mut from = Reader::unseal(bytes, TAG)?;
    let file = PathBuf::from(OsStr::from_bytes(from.blob()?));
    let all = from.list(|f| Some((f.text()?.to_string(), Last { key: f.digest()?, before: f.option()? })))?;
    (self::name(&file) == name).then(|| LastRun { file, nodes: all.into_iter().collect() })
}

/// Nodes that this run did not finish keep what they had; nodes that are gone go.
pub fn note(store: &Store, graph: &Graph, outcome: &Outcome) -> io::Result<()> {
    let old = load(store, graph);
    let mut new = old.clone();
    for node in &outcome.nodes {
        let Some(record) = &node.record else { continue };
        let key = record.key;
        let last = match old.get(&node.name) {
            Some(last) if last.key == key => *last,
            Some(last) => Last { key, before: Some(last.key) },
            None => Last { key, before: None },
        };
        new.insert(node.name.clone(), last);
    }
    let known: BTreeSet<&str> = graph.nodes.iter().map(|n| &*n.name).collect();
    new.retain(|name, _| known.contains(&**name));
    if new == old {
        return Ok(());
    }
    put(store, &LastRun { file: graph.file.clone(), nodes: new })
}

pub fn put(store: &Store, run: &LastRun) -> io::Result<()> {
    let mut out = Writer::default();
    out.blob(run.file.as_os_str().as_bytes());
    out.u32(run.nodes.len() as u32);
    for (name, last) in &run.nodes {
        out.text(name);
        out.digest(&last.key);
        out.option(last.before.as_ref());
    }
    store.put_state("runs", &name(&run.file), &out.sealed(TAG))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_note_of_one_pipeline_is_not_that_of_another() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let last = Last { key: Digest::of(b"key"), before: None };
        let run = LastRun { file: "/a.toml".into(), nodes: [("read".to_string(), last)].into() };
        put(&store, &run).unwrap();
        let (a, b) = (name(Path::new("/a.toml")), name(Path::new("/b.toml")));
        assert_eq!(all(&store), [(a.clone(), run)]);
        fs::rename(store.state("runs", &a), store.state("runs", &b)).unwrap();
        assert_eq!(all(&store), []);
    }
}
