//! `lodge why FILE NODE`: the fields, files and inputs whose change makes a node run.

use serde_json::json;

use super::engine::{self, Place};
use super::plan::{changes_json, sentence, word};
use super::{Exit, Globals, Outcome, Target};
use crate::graph::Graph;
use crate::run::forecast::{Fate, Forecast, Reason, forecast};

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    target: Target,
    /// Node, or one variant of it
    node: String,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let graph = self.target.load()?;
        let asked = engine::pick(&graph, std::slice::from_ref(&self.node))?;
        let store = engine::look(&Place::of(globals, &self.target.file))?;
        let all = forecast(&graph, &asked, &store);
        let find = |n: usize| all.iter().find(|f| f.index == n);
        let mut objects = Vec::new();
        for f in asked.iter().filter_map(|&n| find(n)) {
            let chain = chain(f, &find);
            if !globals.json {
                super::say(&text(&graph, f, &chain));
                continue;
            }
            let because: Vec<_> = chain
                .iter()
                .map(|f| {
                    json!({"name": graph.nodes[f.index].name, "status": word(&f.fate),
                    "reason": sentence(&graph, f), "changes": changes_json(&graph, f)})
                })
                .collect();
            objects.push(json!({"name": graph.nodes[f.index].name, "status": word(&f.fate),
                "reason": sentence(&graph, f), "changes": changes_json(&graph, f), "because": because}));
        }
        if globals.json {
            match <[_; 1]>::try_from(objects) {
                Ok([one]) => super::print(&one),
                Err(many) => super::print(&json!({"name": self.node, "variants": many})),
            }
        }
        Ok(Exit::Done)
    }
}

/// From a node that may run up to the one that surely does.
fn chain<'a>(f: &'a Forecast, find: &impl Fn(usize) -> Option<&'a Forecast>) -> Vec<&'a Forecast> {
    let mut out = Vec::new();
    let mut at = f;
    while let Fate::MayRun(input) = at.fate {
        let Some(next) = find(input) else { break };
        out.push(next);
        at = next;
    }
    out
}

fn text(graph: &Graph, f: &Forecast, chain: &[&Forecast]) -> String {
    let name = &graph.nodes[f.index].name;
    let mut out = match &f.fate {
        Fate::Cached(_) if !f.known => format!("`{name}` is cached; it ran because it was new\n"),
        Fate::Cached(_) => format!("`{name}` is cached; it last ran because of\n{}", changes(graph, f)),
        Fate::Runs if f.known && !f.changes.is_empty() => format!("`{name}` runs because of\n{}", changes(graph, f)),
        Fate::MayRun(_) => format!("`{name}` may run: {}\n", sentence(graph, f)),
        _ => format!("`{name}` runs: {}\n", sentence(graph, f)),
    };
    for f in chain {
        let name = &graph.nodes[f.index].name;
        out +=
            &format!("`{name}` {}: {}\n", if word(&f.fate) == "run" { "runs" } else { "may run" }, sentence(graph, f));
    }
    out
}

fn changes(graph: &Graph, f: &Forecast) -> String {
    f.changes.iter().map(|c| format!("  {}\n", Reason::of(c, graph, f.index))).collect()
}
