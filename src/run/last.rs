//! What the last run of a pipeline was made of: a key for each node, and the key that it had before. The lines behind
//! the keys lie with the results.

use std::collections::{BTreeMap, BTreeSet};
use std::io;

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

const TAG: &str = "lodge last run 1";

fn name(graph: &Graph) -> String {
    Digest::of(graph.file.as_os_str().as_encoded_bytes()).short(16)
}

/// By node.
pub fn load(store: &Store, graph: &Graph) -> BTreeMap<String, Last> {
    parse(&store.get_state("runs", &name(graph))).unwrap_or_default()
}

fn parse(bytes: &[u8]) -> Option<BTreeMap<String, Last>> {
    let mut from = Reader::unseal(bytes, TAG)?;
    let all = from.list(|f| Some((f.text()?.to_string(), Last { key: f.digest()?, before: f.option()? })))?;
    Some(all.into_iter().collect())
}

pub fn is_whole(bytes: &[u8]) -> bool {
    parse(bytes).is_some()
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
    let mut out = Writer::default();
    out.u32(new.len() as u32);
    for (name, last) in &new {
        out.text(name);
        out.digest(&last.key);
        out.option(last.before.as_ref());
    }
    store.put_state("runs", &self::name(graph), &out.sealed(TAG))
}
