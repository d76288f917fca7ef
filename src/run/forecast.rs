//! What a run would do, and why: the lines behind the key of now against those of the last run.

use std::collections::BTreeMap;

use super::key::{self, Change, Lines};
use super::last::{self, Last};
use super::needed;
use super::record::Record;
use super::stamp::{self, Stamps};
use super::store::Store;
use crate::digest::Digest;
use crate::graph::Graph;

/// What is known of a node without running anything.
pub struct Forecast {
    pub index: usize,
    pub fate: Fate,
    /// What differs from the last run; of a cached node, from what it was before.
    pub changes: Vec<Change>,
    /// There is an older key to compare with.
    pub known: bool,
}

pub enum Fate {
    Cached(Box<Record>),
    Runs,
    /// This input runs first, and its result decides.
    MayRun(usize),
    /// A file cannot be read.
    Fails(String),
}

/// In graph order: the nodes `only` (all where it is empty) and what they need.
pub fn forecast(graph: &Graph, only: &[usize], store: &Store) -> Vec<Forecast> {
    let wanted = needed(graph, only);
    let old = last::load(store, graph);
    let mut stamps = Stamps::load(store);
    let mut digests: Vec<Option<Digest>> = vec![None; graph.nodes.len()];
    let mut out = Vec::new();
    for (index, node) in graph.nodes.iter().enumerate().filter(|&(n, _)| wanted[n]) {
        let inputs: Vec<Vec<Option<Digest>>> =
            node.inputs.iter().map(|port| port.iter().map(|&i| digests[i]).collect()).collect();
        let files: Result<Vec<Digest>, String> = node
            .files
            .iter()
            .map(|path| match stamps.known(path) {
                Some(file) => Ok(file.digest),
                None => stamp::hash_input(path)
                    .map(|(_, digest)| digest)
                    .map_err(|e| format!("cannot read `{}`: {e}", path.display())),
            })
            .collect();
        let files = match files {
            Ok(files) => files,
            Err(error) => {
                out.push(Forecast { index, fate: Fate::Fails(error), changes: Vec::new(), known: false });
                continue;
            }
        };
        if let Some(&first) = node.inputs.iter().flatten().find(|&&i| digests[i].is_none()) {
            out.push(Forecast { index, fate: Fate::MayRun(first), changes: Vec::new(), known: false });
            continue;
        }
        let mut lines = Lines::new();
        key::walk(node, &inputs, &files, &mut lines);
        let key = key::key(node, &inputs, &files);
        let record = store.lookup(&key);
        let before = before(&old, &node.name, &key).and_then(|k| store.lookup(&k));
        let known = before.is_some();
        let changes = before.map_or(Vec::new(), |b| key::difference(&b.lines, &lines));
        let fate = match record {
            Some(record) => {
                digests[index] = Some(record.digest);
                Fate::Cached(Box::new(record))
            }
            None => Fate::Runs,
        };
        out.push(Forecast { index, fate, changes, known });
    }
    out
}

/// The last key that is not this one.
fn before(old: &BTreeMap<String, Last>, name: &str, key: &Digest) -> Option<Digest> {
    let last = old.get(name)?;
    if last.key == *key { last.before } else { Some(last.key) }
}

/// A change in the words of the pipeline file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reason {
    /// `parameter`, `input`, `file`, `operator`, `version`.
    pub what: &'static str,
    /// The parameter, port or file.
    pub name: String,
    /// Of an input: the node.
    pub node: Option<String>,
    pub old: Option<String>,
    pub new: Option<String>,
}

impl Reason {
    pub fn of(change: &Change, graph: &Graph, index: usize) -> Self {
        let node = &graph.nodes[index];
        let (old, new) = (change.old.clone(), change.new.clone());
        let plain =
            |what, name: &str| Self { what, name: name.to_string(), node: None, old: old.clone(), new: new.clone() };
        match &*change.name {
            "op" => plain("operator", "op"),
            "op-version" => plain("version", "operator version"),
            name => {
                if let Some(n) =
                    name.strip_prefix("file.").or(name.strip_prefix("beside.")).and_then(|n| n.parse::<usize>().ok())
                {
                    let path = node.files.get(n).map_or_else(|| name.to_string(), |p| p.display().to_string());
                    return plain("file", &path);
                }
                let Some(port) = name.strip_prefix("in.") else { return plain("parameter", name) };
                let (port_name, at) = port.split_once('.').unwrap_or((port, "0"));
                let place = node.entry.ports.iter().position(|p| p.name.replace('_', "-") == port_name);
                let many = place.is_some_and(|p| node.entry.ports[p].many);
                if many && !port.contains('.') {
                    return plain("inputs", port);
                }
                let from = place.and_then(|p| node.inputs.get(p)?.get(at.parse::<usize>().ok()?));
                Self { node: from.map(|&i| graph.nodes[i].name.clone()), ..plain("input", port) }
            }
        }
    }
}

impl std::fmt::Display for Reason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let digest = matches!(self.what, "file" | "input");
        let show = |v: &Option<String>| match v {
            Some(v) if digest && v.len() == 64 => v[..12].to_string(),
            Some(v) => v.clone(),
            None => "none".to_string(),
        };
        match (self.what, &self.node) {
            ("parameter", _) => write!(f, "`{}`", self.name)?,
            ("file", _) => write!(f, "contents of `{}`", self.name)?,
            ("input", Some(node)) => write!(f, "`in.{}`: result of `{node}`", self.name)?,
            ("input", None) => write!(f, "`in.{}`", self.name)?,
            ("inputs", _) => write!(f, "number of inputs of `in.{}`", self.name)?,
            _ => write!(f, "{}", self.name)?,
        }
        write!(f, ": {} -> {}", show(&self.old), show(&self.new))
    }
}
