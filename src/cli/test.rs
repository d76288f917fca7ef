//! `lodge test FILE..`: runs, and compares each stage with its snapshot.

use std::path::PathBuf;
use std::sync::Arc;

use serde_json::{Value, json};

use super::engine::{self, Place};
use super::pending::{difference, indented};
use super::progress::Teller;
use super::{Exit, Globals, Outcome, Set, Target, render};
use crate::diag::{Diagnostic, Diagnostics};
use crate::graph::Graph;
use crate::run::record::Record;
use crate::run::snapshot::{self, Rules, Stage, Verdict};
use crate::run::{self};

#[derive(clap::Args)]
pub struct Args {
    /// Pipeline files
    #[arg(value_name = "FILE", required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    set: Set,
    /// Compare digests: every byte of every stage
    #[arg(long)]
    exact: bool,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let rules = Rules { exact: self.exact, read_only: in_ci() };
        let mut graphs = Vec::new();
        let mut mistakes = Vec::new();
        for file in self.files {
            let target = Target { file, set: self.set.clone() };
            match target.load() {
                Ok(graph) => graphs.push((target.file, Arc::new(graph))),
                Err(stop) => mistakes.extend(stop.diagnostics),
            }
        }
        if !mistakes.is_empty() {
            return Err(mistakes.into());
        }
        let mut teller = Teller::new(globals);
        let mut exit = Exit::Done;
        let (mut told, mut all_wrong) = (Vec::new(), Vec::new());
        for (file, graph) in graphs {
            let place = Place::of(globals, &file);
            let mut options = engine::options(globals, &place);
            options.out = None;
            let outcome = run::run(&graph, &[], &options, &mut |event| teller.hear(event));
            exit = exit.and(super::run::exit(&outcome));
            let errors: Vec<_> = outcome.nodes.iter().filter_map(|n| n.error.clone()).collect();
            let errors = [errors, outcome.errors.clone()].concat();
            super::say_aside(&render::text(&errors, render::Style::for_stderr()));

            let (mut stages, mut wrong) = (Vec::new(), Vec::new());
            for node in &outcome.nodes {
                if let Some(record) = node.record.as_ref().filter(|_| graph.nodes[node.index].snapshot.on) {
                    stages.push((node.index, compare(&graph, node.index, record, rules, &mut wrong)));
                }
            }
            if wrong.iter().any(|d| d.code == "cannot-write") {
                exit = exit.and(Exit::Failed);
            }
            // With `--set` other variants than the file's may be there: that tells nothing about the files of these.
            let orphans = if self.set.sets.is_empty() { snapshot::orphans(&graph) } else { Vec::new() };
            let ok = stages.iter().all(|(_, verdict)| *verdict == Verdict::Same);
            // In CI nobody reads of a file that is in the way.
            let fails = !ok || rules.read_only && !orphans.is_empty();
            exit = if fails { exit.and(Exit::Differs) } else { exit };
            if globals.json {
                told.push(to_json(&graph, &stages, &orphans));
                all_wrong.extend(wrong);
                continue;
            }
            super::say_aside(&render::text(&wrong, render::Style::for_stderr()));
            if !globals.quiet || fails {
                super::say(&to_text(&graph, &stages, &orphans, rules));
            }
        }
        if globals.json {
            let mut told = json!({"ok": exit == Exit::Done, "pipelines": told});
            if !all_wrong.is_empty() {
                told["diagnostics"] = render::all_json(&all_wrong);
            }
            super::print(&told);
        }
        Ok(exit)
    }
}

/// As insta sees it: `CI` is set, and not to nothing, `0` or `false`.
fn in_ci() -> bool {
    std::env::var("CI").is_ok_and(|v| !["", "0", "false"].contains(&v.as_str()))
}

/// What cannot be read or written is `wrong`, and stops none of the others.
fn compare(graph: &Graph, node: usize, record: &Record, rules: Rules, wrong: &mut Diagnostics) -> Verdict {
    let frame = serde_json::from_str(&record.frame).unwrap_or(Value::Null);
    let summary = record.summary();
    let stage = Stage {
        kind: &record.kind,
        digest: record.digest,
        frame: &frame,
        summary: &summary,
        warnings: &record.warnings,
    };
    let node = &graph.nodes[node];
    let (verdict, written) = snapshot::check(graph, node, &stage, rules);
    let path = snapshot::path(graph, &node.name);
    if let Verdict::Unreadable { why } = &verdict {
        let error = Diagnostic::error("snapshot", format!("{}: {why}", path.display())).node(&node.name);
        wrong.push(error.help("put it back, or remove it: then the stage is new"));
    }
    if let Err(error) = written {
        let message = format!("cannot write beside {}: {error}", path.display());
        wrong.push(Diagnostic::error("cannot-write", message).node(&node.name));
    }
    verdict
}

/// A line for each stage that is not as it was, with the difference; then how many there are.
fn to_text(graph: &Graph, stages: &[(usize, Verdict)], orphans: &[PathBuf], rules: Rules) -> String {
    let mut out = String::new();
    let [mut new, mut differ, mut unreadable] = [0, 0, 0];
    for (node, verdict) in stages {
        let name = &graph.nodes[*node].name;
        match verdict {
            Verdict::Same => {}
            Verdict::New { text } => {
                new += 1;
                out += &format!("new: {name}\n{}\n", indented(text));
            }
            Verdict::Differs { old, new } => {
                differ += 1;
                out += &format!("differs: {name}\n{}\n", indented(&difference(old, new)));
            }
            // Said already, with its file.
            Verdict::Unreadable { .. } => unreadable += 1,
        }
    }
    for path in orphans {
        out += &format!("no such stage any more: {} (delete it)\n", path.display());
    }
    out +=
        &format!("{}: {} stages, {} as they were", graph.name, stages.len(), stages.len() - new - differ - unreadable);
    for (count, what) in [(differ, "differ"), (new, "new"), (unreadable, "cannot be read")] {
        if count > 0 {
            out += &format!(", {count} {what}");
        }
    }
    if new + differ > 0 && !rules.read_only {
        out += "; `lodge accept` takes what is new, `lodge reject` leaves what was";
    }
    out + "\n"
}

fn to_json(graph: &Graph, stages: &[(usize, Verdict)], orphans: &[PathBuf]) -> Value {
    let stage = |(node, verdict): &(usize, Verdict)| {
        let name = &graph.nodes[*node].name;
        let told = match verdict {
            Verdict::Same => "same",
            Verdict::New { .. } => "new",
            Verdict::Differs { .. } => "differs",
            Verdict::Unreadable { .. } => "unreadable",
        };
        let mut out = json!({"name": name, "verdict": told, "snapshot": snapshot::path(graph, name)});
        if let Verdict::Differs { old, new } = verdict {
            out["diff"] = json!(difference(old, new));
        }
        out
    };
    json!({
        "pipeline": graph.name,
        "stages": stages.iter().map(stage).collect::<Vec<_>>(),
        "orphans": orphans,
    })
}
