//! What a run would do, and why: the lines behind the key of now against those of the last run.

use super::history::{self, Run};
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
    /// What differs from the last run; of a cached node, from what it was before; of one that may run what is known.
    pub changes: Vec<Change>,
    /// There is an older key to compare with.
    pub known: bool,
    /// It has run in this cache.
    pub ran: bool,
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
    let mut past = Past { store, pipeline: &graph.name, runs: None };
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
                out.push(Forecast { index, fate: Fate::Fails(error), changes: Vec::new(), known: false, ran: false });
                continue;
            }
        };
        let mut lines = Lines::new();
        key::walk(node, &inputs, &files, &mut lines);
        let key = key::key(node, &inputs, &files);
        let waits = node.inputs.iter().flatten().copied().find(|&i| digests[i].is_none());
        let fate = match waits {
            Some(input) => Fate::MayRun(input),
            None => store.lookup(&key).map_or(Fate::Runs, |record| Fate::Cached(Box::new(record))),
        };
        let last = old.get(&node.name);
        let (before, ran) = match (&fate, last) {
            (_, None) => (None, false),
            // Its result is gone, whatever made it run the last time.
            (Fate::Runs, Some(last)) if last.key == key => (Some(last.key), true),
            (_, Some(last)) => (before(last, &key), true),
        };
        let record = before.and_then(|k| store.lookup(&k));
        let lost = before == Some(key);
        let mut changes = record.as_ref().map_or(Vec::new(), |b| key::difference(&b.lines, &lines));
        // What is not known yet is no change, and so not one of their number.
        changes.retain(|c| c.new.as_deref() != Some("?"));
        if let Some(before) = before.filter(|_| changes.iter().any(|c| c.old.is_some() && series(c))) {
            past.name(&node.name, before, &mut changes);
        }
        if let Fate::Cached(record) = &fate {
            digests[index] = Some(record.digest);
        }
        out.push(Forecast { index, fate, changes, known: lost || record.is_some(), ran });
    }
    out
}

/// Keys of the results that a run of the pipeline would find.
pub fn cached(graph: &Graph, store: &Store) -> Vec<Digest> {
    let record = |f: Forecast| if let Fate::Cached(record) = f.fate { Some(record.key) } else { None };
    forecast(graph, &[], store).into_iter().filter_map(record).collect()
}

/// The last key that is not this one.
fn before(last: &Last, key: &Digest) -> Option<Digest> {
    if last.key == *key { last.before } else { Some(last.key) }
}

fn series(change: &Change) -> bool {
    change.name.starts_with("file.") || change.name.starts_with("in.")
}

/// The runs as they were, the newest first, read where somebody asks: which file or node a line stood for.
struct Past<'a> {
    store: &'a Store,
    pipeline: &'a str,
    runs: Option<Vec<Run>>,
}

impl Past<'_> {
    /// Fills in [`Change::was`] from the last run in which the node had that key.
    fn name(&mut self, node: &str, key: Digest, changes: &mut [Change]) {
        let runs = self.runs.get_or_insert_with(|| history::newest(self.store, self.pipeline));
        let with_key = |run: &&Run| run.nodes.iter().any(|n| n.name == node && n.key == Some(key));
        let Some(run) = runs.iter().find(with_key) else { return };
        let files = run.nodes.iter().find(|n| n.name == node).map_or(&[][..], |n| &n.files);
        for change in changes.iter_mut().filter(|c| c.old.is_some()) {
            change.was = match change.name.strip_prefix("file.") {
                // Of one that is still there the number is the new one.
                Some(n) if change.new.is_none() => n.parse::<usize>().ok().and_then(|n| files.get(n).cloned()),
                Some(_) => None,
                None => change.old.as_deref().and_then(Digest::parse).and_then(|d| run.made(d)),
            };
        }
    }
}

/// A change in the words of the pipeline file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reason {
    /// `parameter`, `input`, `inputs` (how many), `file`, `file-name`, `operator`, `version`.
    pub what: &'static str,
    /// The parameter, port or file.
    pub name: String,
    /// Of an input: the node.
    pub node: Option<String>,
    /// Of an input: the node that it was before, where that was another one.
    pub was: Option<String>,
    pub old: Option<String>,
    pub new: Option<String>,
}

impl Reason {
    pub fn of(change: &Change, graph: &Graph, index: usize) -> Self {
        let node = &graph.nodes[index];
        let (old, new) = (change.old.clone(), change.new.clone());
        let plain = |what, name: &str| Self {
            what,
            name: name.to_string(),
            node: None,
            was: None,
            old: old.clone(),
            new: new.clone(),
        };
        match &*change.name {
            "op" => plain("operator", "op"),
            "op-version" => plain("version", "operator version"),
            name => {
                if let Some((list @ ("file" | "beside"), n)) = name.split_once('.')
                    && let Ok(n) = n.parse::<usize>()
                {
                    // One that is gone has no number here any more.
                    let here = node.files.get(n).filter(|_| new.is_some()).map(|p| p.display().to_string());
                    let path = here.or(change.was.clone()).unwrap_or_else(|| format!("file {}", n + 1));
                    return plain(if list == "file" { "file" } else { "file-name" }, &path);
                }
                let Some(port) = name.strip_prefix("in.") else { return plain("parameter", name) };
                let (port_name, at) = port.split_once('.').unwrap_or((port, "0"));
                let place = node.entry.ports.iter().position(|p| p.name.replace('_', "-") == port_name);
                let many = place.is_some_and(|p| node.entry.ports[p].many);
                if many && !port.contains('.') {
                    return plain("inputs", port);
                }
                let from = place.and_then(|p| node.inputs.get(p)?.get(at.parse::<usize>().ok()?));
                let from = from.filter(|_| new.is_some()).map(|&i| graph.nodes[i].name.clone());
                let was = change.was.clone().filter(|was| Some(was) != from.as_ref());
                Self { node: from.or(was.clone()), was, ..plain("input", port) }
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
            ("file-name", _) => write!(f, "name of `{}`", self.name)?,
            ("input", Some(node)) => match &self.was {
                Some(was) if was != node => write!(f, "`in.{}`: result of `{node}` in place of `{was}`", self.name)?,
                _ => write!(f, "`in.{}`: result of `{node}`", self.name)?,
            },
            ("input", None) => write!(f, "`in.{}`", self.name)?,
            ("inputs", _) => write!(f, "number of inputs of `in.{}`", self.name)?,
            _ => write!(f, "{}", self.name)?,
        }
        write!(f, ": {} -> {}", show(&self.old), show(&self.new))
    }
}
