//! Two runs of a pipeline side by side: what became of each node, what made its result another one, and in which numbers of
//! its summary that shows.

use std::collections::BTreeMap;

use serde_json::Value;

use super::forecast::Reason;
use super::history::{Node, Run};
use super::key::{self, Change, Lines};
use super::record::Record;
use super::store::Store;
use crate::digest::Digest;

/// A node of two runs.
pub struct Pair<'a> {
    pub old: Option<&'a Node>,
    pub new: Option<&'a Node>,
    /// What differs between the keys; none where the cache does not know any more.
    pub changes: Option<Vec<Reason>>,
    /// What differs between the summaries of two results; none where the cache does not know any more.
    pub summary: Option<Vec<Change>>,
}

impl Pair<'_> {
    pub fn name(&self) -> &str {
        self.new.or(self.old).map_or("", |n| &n.name)
    }

    /// `new`, `gone`, `status` (one of the two has no result), `result`, `key` (another key, the same result), `same`.
    pub fn what(&self) -> &'static str {
        let (Some(old), Some(new)) = (self.old, self.new) else {
            return if self.old.is_none() { "new" } else { "gone" };
        };
        match (old.digest, new.digest) {
            (Some(a), Some(b)) if a != b => "result",
            (Some(_), Some(_)) if old.key != new.key => "key",
            (Some(_), Some(_)) => "same",
            (None, None) if (old.status, &old.because) == (new.status, &new.because) => "same",
            _ => "status",
        }
    }
}

/// Every node of either run, in the order of the new one, then what only the old one has.
pub fn compare<'a>(store: &Store, old: &'a Run, new: &'a Run) -> Vec<Pair<'a>> {
    let by_name = |run: &'a Run| run.nodes.iter().map(|n| (&*n.name, n)).collect::<BTreeMap<_, _>>();
    let (before, now) = (by_name(old), by_name(new));
    let both = new.nodes.iter().map(|n| (before.get(&*n.name).copied(), Some(n)));
    let gone = old.nodes.iter().filter(|n| !now.contains_key(&*n.name)).map(|n| (Some(n), None));
    let pair = |(a, b): (Option<&'a Node>, Option<&'a Node>)| {
        let mut pair = Pair { old: a, new: b, changes: Some(Vec::new()), summary: Some(Vec::new()) };
        if let (Some(x), Some(y)) = (a.and_then(|n| n.key), b.and_then(|n| n.key))
            && x != y
        {
            let records = store.lookup(&x).zip(store.lookup(&y));
            let reasons = |(x, y): &(Record, Record)| {
                key::difference(&x.lines, &y.lines).iter().map(|c| reason(c, [old, new], [a, b])).collect()
            };
            pair.changes = records.as_ref().map(reasons);
            pair.summary = records.map(|(x, y)| key::difference(&numbers(&x), &numbers(&y)));
        }
        pair
    };
    both.chain(gone).map(pair).collect()
}

/// A change in words, without the graph: an input is the node whose result it was.
fn reason(change: &Change, [old_run, new_run]: [&Run; 2], nodes: [Option<&Node>; 2]) -> Reason {
    let (old, new) = (change.old.clone(), change.new.clone());
    let of = |what, name: &str, node| {
        let name = name.to_string();
        Reason { what, name, node, was: None, old: old.clone(), new: new.clone() }
    };
    let name = &*change.name;
    if let Some((list @ ("file" | "beside"), n)) = name.split_once('.') {
        let node = nodes[usize::from(new.is_some())];
        let path = n.parse::<usize>().ok().and_then(|n| node?.files.get(n));
        return of(if list == "file" { "file" } else { "file-name" }, path.map_or(name, |p| p), None);
    }
    let Some(port) = name.strip_prefix("in.") else {
        return match name {
            "op" => of("operator", "op", None),
            "op-version" => of("version", "operator version", None),
            _ => of("parameter", name, None),
        };
    };
    let digest = |value: &Option<String>| value.as_deref().and_then(Digest::parse);
    match (digest(&new), digest(&old)) {
        (None, None) => of("inputs", port, None),
        (now, before) => {
            let is = now.and_then(|d| new_run.made(d));
            let was = before.and_then(|d| old_run.made(d)).filter(|was| Some(was) != is.as_ref());
            Reason { was: was.clone(), ..of("input", port, is.or(was)) }
        }
    }
}

/// The lines of a summary: `edges`, `levels[2].error`.
fn numbers(record: &Record) -> Lines {
    fn walk(name: String, value: &Value, out: &mut Lines) {
        match value {
            Value::Object(all) => all.iter().for_each(|(key, v)| {
                let name = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                walk(name, v, out);
            }),
            Value::Array(all) => all.iter().enumerate().for_each(|(i, v)| walk(format!("{name}[{i}]"), v, out)),
            other => out.push((name, other.to_string())),
        }
    }
    let mut out = Lines::new();
    record.summary().iter().for_each(|(key, value)| walk(key.clone(), value, &mut out));
    out
}
