//! `lodge run FILE [NODE..]`: runs what is needed, publishes what writers made.

use std::fmt::Write;
use std::sync::Arc;

use serde_json::{Value, json};

use super::engine::{self, Place};
use super::progress::Teller;
use super::{Exit, Globals, Outcome, Target, render};
use crate::run::event::Status;
use crate::run::{self, NodeOutcome, plan};

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    target: Target,
    /// Run only these nodes and what they need
    #[arg(value_name = "NODE")]
    nodes: Vec<String>,
    /// Read all inputs and published files, also where the file system says that they are unchanged
    #[arg(long)]
    verify: bool,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let place = Place::of(globals, &self.target.file);
        let identity = place.identity(&self.target, &self.nodes);
        if !self.verify
            && globals.events.is_none()
            && let Some(replay) = plan::replay(&place.cache, &identity)
            && tell_again(&place.name, &replay, globals).is_some()
        {
            return Ok(Exit::Done);
        }
        let graph = Arc::new(self.target.load()?);
        let only = engine::pick(&graph, &self.nodes)?;
        let mut options = engine::options(globals, &place);
        options.verify = self.verify;
        options.plan = Some(identity);
        options.table = cached;
        let mut teller = Teller::new(globals);
        let outcome = run::run(&graph, &only, &options, &mut |event| teller.hear(event));
        super::say_aside(&render::text(&outcome.diagnostics(), render::Style::for_stderr()));
        tell(&graph.name, &outcome, globals);
        let exit = exit(&outcome);
        // The process ends: of ten thousand nodes there is much to free, piece by piece.
        std::mem::forget((graph, outcome));
        Ok(exit)
    }
}

fn tell(pipeline: &str, outcome: &run::Outcome, globals: &Globals) {
    if globals.json {
        super::print(&to_json(pipeline, outcome));
    } else if !globals.quiet {
        super::say(&table(pipeline, outcome));
    }
}

/// Of a run that had nothing to do; none where the plan does not say any more.
fn tell_again(pipeline: &str, replay: &plan::Replay, globals: &Globals) -> Option<()> {
    if globals.json {
        super::print(&to_json(pipeline, &replay.outcome()?));
    } else if !globals.quiet {
        let rows = replay.table()?;
        let foot = foot(pipeline, &[(replay.nodes, Status::Cached)], [0, replay.files], replay.seconds());
        super::say(&(rows + &foot));
    }
    Some(())
}

pub fn exit(outcome: &run::Outcome) -> Exit {
    let mut exit = if outcome.ok() { Exit::Done } else { Exit::Failed };
    if outcome.damaged {
        exit = exit.and(Exit::Damaged);
    }
    if outcome.interrupted {
        exit = exit.and(Exit::Interrupted);
    }
    exit
}

/// The object of `run --json`.
pub fn to_json(pipeline: &str, outcome: &run::Outcome) -> Value {
    let files: Vec<_> = outcome
        .files
        .iter()
        .map(|f| json!({"path": f.path, "bytes": f.bytes, "digest": f.digest, "written": f.written}))
        .collect();
    let mut out = json!({
        "lodge": env!("CARGO_PKG_VERSION"),
        "pipeline": pipeline,
        "ok": outcome.ok(),
        "seconds": outcome.seconds,
        "nodes": outcome.nodes.iter().map(node_json).collect::<Vec<_>>(),
        "files": files,
        "warnings": outcome.warnings,
    });
    if !outcome.errors.is_empty() {
        out["diagnostics"] = json!(render::all_json(&outcome.errors));
    }
    out
}

fn node_json(node: &NodeOutcome) -> Value {
    let record = node.record.as_ref();
    let mut out = json!({
        "name": node.name,
        "op": node.op,
        "status": node.status.name(),
        "seconds": node.seconds,
        "digest": record.map(|r| r.digest),
        "bytes": record.map(|r| r.bytes + r.blob_bytes),
        "summary": record.map(|r| Value::Object(r.summary())),
        "warnings": node.warnings,
    });
    if let Some(error) = &node.error {
        out["error"] = json!(error.to_string());
    }
    if let Some(because) = &node.because {
        out["because"] = json!(because);
    }
    out
}

/// A row per node: name, what happened, time, size. And a line about all.
fn table(pipeline: &str, outcome: &run::Outcome) -> String {
    let count = |status| outcome.nodes.iter().filter(|n| n.status == status).count();
    let counts = [Status::Ran, Status::Cached, Status::Failed, Status::Skipped].map(|s| (count(s), s));
    let written = outcome.files.iter().filter(|f| f.written).count();
    rows(&outcome.nodes, |n| n.status) + &foot(pipeline, &counts, [written, outcome.files.len()], outcome.seconds)
}

/// Nodes that are cached, as a rerun will show them.
fn cached(nodes: &[NodeOutcome]) -> String {
    rows(nodes, |_| Status::Cached)
}

fn rows(nodes: &[NodeOutcome], status: fn(&NodeOutcome) -> Status) -> String {
    let width = nodes.iter().map(|n| n.name.chars().count()).max().unwrap_or(0);
    let mut out = String::new();
    for node in nodes {
        let name = &node.name;
        let bytes = node.record.as_ref().map_or(String::new(), |r| size(r.bytes + r.blob_bytes));
        let time = if node.status == Status::Skipped { String::new() } else { time(node.seconds) };
        let why = node.because.as_ref().map_or(String::new(), |b| format!("  because of `{b}`"));
        let start = out.len();
        let _ = write!(out, "{name:width$}  {:8}{time:>9}{bytes:>11}{why}", status(node).name());
        out.truncate(start + out[start..].trim_end().len());
        out.push('\n');
        for warning in &node.warnings {
            let _ = writeln!(out, "{:width$}  warning: {warning}", "");
        }
    }
    out
}

fn foot(pipeline: &str, counts: &[(usize, Status)], [written, files]: [usize; 2], seconds: f64) -> String {
    let parts: Vec<_> = counts.iter().filter(|p| p.0 > 0).map(|(n, s)| format!("{n} {}", s.name())).collect();
    let mut out = format!("{pipeline}: {}", parts.join(", "));
    if files > 0 {
        out += &format!("; {written} of {files} files written");
    }
    out + &format!("; {}\n", time(seconds))
}

pub fn time(seconds: f64) -> String {
    if seconds < 1.0 { format!("{:.1} ms", seconds * 1e3) } else { format!("{seconds:.2} s") }
}

pub fn size(bytes: u64) -> String {
    match bytes {
        0..1024 => format!("{bytes} B"),
        1024..1_048_576 => format!("{:.1} KiB", bytes as f64 / 1024.0),
        1_048_576..1_073_741_824 => format!("{:.1} MiB", bytes as f64 / 1_048_576.0),
        _ => format!("{:.2} GiB", bytes as f64 / 1_073_741_824.0),
    }
}
