//! `lodge plan FILE [NODE..]`: what a run would do, node by node, and why.

use serde_json::{Value, json};

use super::engine::{self, Place};
use super::{Exit, Globals, Outcome, Target};
use crate::graph::Graph;
use crate::run::forecast::{Fate, Forecast, Reason, forecast};

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    target: Target,
    /// Only these nodes and what they need
    #[arg(value_name = "NODE")]
    nodes: Vec<String>,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let graph = self.target.load()?;
        let only = engine::pick(&graph, &self.nodes)?;
        let store = engine::look(&Place::of(globals, &self.target.file))?;
        let all = forecast(&graph, &only, &store);
        if globals.json {
            let nodes: Vec<_> = all.iter().map(|f| to_json(&graph, f)).collect();
            super::print(&json!({"pipeline": graph.name, "nodes": nodes}));
            return Ok(Exit::Done);
        }
        let width = all.iter().map(|f| graph.nodes[f.index].name.chars().count()).max().unwrap_or(0);
        let mut out = String::new();
        for f in &all {
            let line = format!("{:width$}  {:8} {}", graph.nodes[f.index].name, word(&f.fate), sentence(&graph, f));
            out += line.trim_end();
            out.push('\n');
        }
        super::say(&out);
        Ok(Exit::Done)
    }
}

/// `cached`, `run` or `may-run`.
pub fn word(fate: &Fate) -> &'static str {
    match fate {
        Fate::Cached(_) => "cached",
        Fate::Runs | Fate::Fails(_) => "run",
        Fate::MayRun(_) => "may-run",
    }
}

/// Why, in one line; empty for a cached node.
pub fn sentence(graph: &Graph, f: &Forecast) -> String {
    match &f.fate {
        Fate::Cached(_) => String::new(),
        Fate::Fails(error) => format!("and fails: {error}"),
        Fate::MayRun(input) => {
            let first = format!("`{}` runs first, and its result decides", graph.nodes[*input].name);
            [vec![first], reasons(graph, f)].concat().join("; ")
        }
        Fate::Runs if !f.ran => "never ran in this cache".to_string(),
        Fate::Runs if !f.known => "what it was made of the last time is no longer in the cache".to_string(),
        Fate::Runs if f.changes.is_empty() => "its result is no longer in the cache".to_string(),
        Fate::Runs => reasons(graph, f).join("; "),
    }
}

fn reasons(graph: &Graph, f: &Forecast) -> Vec<String> {
    f.changes.iter().map(|c| Reason::of(c, graph, f.index).to_string()).collect()
}

pub fn to_json(graph: &Graph, f: &Forecast) -> Value {
    let mut out = json!({
        "name": graph.nodes[f.index].name,
        "op": graph.nodes[f.index].entry.name,
        "status": word(&f.fate),
        "reason": sentence(graph, f),
        "changes": changes_json(graph, f),
    });
    if let Fate::MayRun(input) = &f.fate {
        out["input"] = json!(graph.nodes[*input].name);
    }
    out
}

pub fn changes_json(graph: &Graph, f: &Forecast) -> Vec<Value> {
    f.changes.iter().map(|c| reason_json(&Reason::of(c, graph, f.index))).collect()
}

pub fn reason_json(r: &Reason) -> Value {
    // Values as they would stand in JSON, where they are parameters.
    let value = |v: Option<String>| {
        v.map(|v| serde_json::from_str(&v).ok().filter(|_| r.what == "parameter").unwrap_or(json!(v)))
    };
    let mut out = json!({"what": r.what, "name": r.name, "node": r.node, "old": value(r.old.clone()), "new": value(r.new.clone())});
    if let Some(was) = &r.was {
        out["was"] = json!(was);
    }
    out
}
