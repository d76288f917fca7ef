//! `lodge check FILE..`: every mistake of the files, without reading data.

use std::collections::BTreeSet;

use serde_json::json;

use super::{Exit, Globals, Outcome, Set, render};
use crate::diag::Diagnostic;
use crate::graph::Graph;

#[derive(clap::Args)]
pub struct Args {
    /// Pipeline files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<std::path::PathBuf>,
    #[command(flatten)]
    set: Set,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let mut wrong = Vec::new();
        let mut rows = Vec::new();
        let mut seen = BTreeSet::new(); // several files may extend the same one
        for file in &self.files {
            match Graph::load(file, &self.set.sets, &crate::ops::ALL) {
                Ok(graph) => rows.push((file, graph.nodes.len())),
                Err(mistakes) => {
                    let said = |d: &Diagnostic| {
                        let place = d.span.as_ref().map(|s| (s.file.path.clone(), s.range.start, s.range.end));
                        (place, d.node.clone(), d.message.clone())
                    };
                    wrong.extend(mistakes.into_iter().filter(|d| seen.insert(said(d))))
                }
            }
        }
        if globals.json {
            let files: Vec<_> = rows.iter().map(|(file, nodes)| json!({"file": file, "nodes": nodes})).collect();
            super::print(&json!({"ok": wrong.is_empty(), "files": files, "diagnostics": render::all_json(&wrong)}));
        } else {
            super::say_aside(&render::text(&wrong, render::Style::for_stderr()));
            if !globals.quiet {
                for (file, nodes) in rows {
                    super::say(&format!("{}: {nodes} node{}, no mistake found\n", file.display(), plural(nodes)));
                }
            }
        }
        Ok(if wrong.is_empty() { Exit::Done } else { Exit::Usage })
    }
}

fn plural(n: usize) -> &'static str {
    if n == 1 { "" } else { "s" }
}
