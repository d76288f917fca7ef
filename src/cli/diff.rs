//! `lodge diff RUN RUN`: which nodes' results differ between two runs, what made them (parameters, inputs, files), and in
//! which numbers of their summaries it shows.

use serde_json::{Value, json};

use super::engine::{self, Place};
use super::plan::reason_json;
use super::run::size;
use super::{Exit, Globals, Outcome, Stop, runs};
use crate::diag::{Diagnostic, did_you_mean};
use crate::run::compare::{Pair, compare};
use crate::run::history::{self, Node, Run};
use crate::run::key::Change;
use crate::run::store::Store;

#[derive(clap::Args)]
pub struct Args {
    /// The older run, as `lodge runs` names it
    old: String,
    /// The newer one
    new: String,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        // The cache of the project around the working folder.
        let here = std::env::current_dir().unwrap_or_default().join("any.toml");
        let place = Place::of(globals, &here);
        let store = engine::look(&place)?;
        let old = load(&store, &place, &self.old);
        let new = load(&store, &place, &self.new);
        let (old, new) = match (old, new) {
            (Ok(old), Ok(new)) => (old, new),
            (Err(mut a), Err(b)) => {
                if self.old != self.new {
                    a.diagnostics.extend(b.diagnostics);
                }
                return Err(Stop { exit: a.exit.and(b.exit), ..a });
            }
            (Err(stop), _) | (_, Err(stop)) => return Err(stop),
        };
        let pairs = compare(&store, &old, &new);
        if globals.json {
            let nodes: Vec<Value> = pairs.iter().map(to_json).collect();
            super::print(&json!({"old": runs::to_json(&old), "new": runs::to_json(&new), "nodes": nodes}));
        } else {
            super::say(&text(&pairs, [&old, &new]));
        }
        Ok(Exit::Done)
    }
}

fn load(store: &Store, place: &Place, name: &str) -> Result<Run, Stop> {
    let names = history::names(store);
    if !names.iter().any(|n| n == name) {
        let message = format!("there is no run `{name}` in the cache `{}`", place.cache.display());
        let error = Diagnostic::error("unknown-run", message).value(name);
        return Err(Stop::usage(match did_you_mean(name, names.iter().map(|n| &**n)) {
            Some(near) => error.help(format!("did you mean `{near}`?")),
            None if names.is_empty() => error.help("it holds none; `--cache` names another"),
            None => error.help("`lodge runs FILE` lists them"),
        }));
    }
    history::load(store, name).ok_or_else(|| {
        let message = format!("the record of run `{name}` is damaged, and cannot be made again");
        let error = Diagnostic::error("damaged-run", message).value(name).help("`lodge cache verify` removes it");
        Stop { exit: Exit::Damaged, diagnostics: vec![error] }
    })
}

fn text(pairs: &[Pair], [old, new]: [&Run; 2]) -> String {
    let mut out = String::new();
    if old.sets != new.sets {
        let show = |run: &Run| if run.sets.is_empty() { "none".to_string() } else { run.sets.join(" ") };
        out += &format!("--set: {} -> {}\n", show(old), show(new));
    }
    for pair in pairs.iter().filter(|p| p.what() != "same") {
        out += &format!("{}: {}\n", pair.name(), sentence(pair));
        match &pair.changes {
            Some(changes) => changes.iter().for_each(|c| out += &format!("  {c}\n")),
            None => out += "  what made it is no longer in the cache\n",
        }
        let numbers = pair.summary.as_deref().unwrap_or_default();
        for change in numbers.iter().take(MOST_NUMBERS) {
            let show = |v: &Option<String>| v.clone().unwrap_or("none".into());
            out += &format!("    {}: {} -> {}\n", change.name, show(&change.old), show(&change.new));
        }
        if numbers.len() > MOST_NUMBERS {
            out += &format!("    .. and {} more: `--json` has them all\n", numbers.len() - MOST_NUMBERS);
        }
    }
    let words =
        ["result", "key", "status", "new", "gone", "same"].map(|w| (pairs.iter().filter(|p| p.what() == w).count(), w));
    let word = |&(n, w): &(usize, &str)| match w {
        "result" => format!("{n} with another result"),
        "key" => format!("{n} made otherwise with the same result"),
        "status" => format!("{n} with a result in one run only"),
        _ => format!("{n} {w}"),
    };
    let parts: Vec<String> = words.iter().filter(|p| p.0 > 0).map(word).collect();
    out + &format!("{} -> {}: {}\n", old.name, new.name, parts.join(", "))
}

/// Lines of a node's summary that a person reads.
const MOST_NUMBERS: usize = 12;

fn sentence(pair: &Pair) -> String {
    let state = |n: &Node| match (n.digest, &*n.because) {
        (Some(digest), _) => format!("{}, {}", digest.short(6), size(n.bytes)),
        (None, "") => n.status.name().to_string(),
        (None, because) => format!("{} ({because})", n.status.name()),
    };
    match (pair.old, pair.new) {
        (Some(old), Some(_)) if pair.what() == "key" => format!("made otherwise, the same result ({})", state(old)),
        (Some(old), Some(new)) => {
            let same_key = pair.what() == "result" && old.key == new.key;
            let note = if same_key { ", from the same key" } else { "" };
            format!("{} -> {}{note}", state(old), state(new))
        }
        (Some(old), None) => format!("gone ({})", state(old)),
        (None, Some(new)) => format!("new ({})", state(new)),
        (None, None) => String::new(),
    }
}

fn to_json(pair: &Pair) -> Value {
    let node = |n: &Node| {
        json!({"op": n.op, "status": n.status.name(), "seconds": n.seconds, "key": n.key, "digest": n.digest,
            "bytes": n.bytes, "because": Some(&n.because).filter(|b| !b.is_empty())})
    };
    let changes = pair.changes.as_ref().map(|all| all.iter().map(reason_json).collect::<Vec<_>>());
    let number = |v: &Option<String>| v.as_deref().map(|v| serde_json::from_str::<Value>(v).unwrap_or(json!(v)));
    let summary = pair.summary.as_ref().map(|all| {
        let one = |c: &Change| json!({"name": c.name, "old": number(&c.old), "new": number(&c.new)});
        all.iter().map(one).collect::<Vec<_>>()
    });
    json!({"name": pair.name(), "what": pair.what(), "old": pair.old.map(node), "new": pair.new.map(node),
        "changes": changes, "summary": summary})
}
