//! `lodge accept [FILE [NODE..]]`: pending snapshots become the snapshots.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Exit, Globals, Outcome, Set, Stop};
use crate::diag::Diagnostic;
use crate::graph::Graph;
use crate::run::snapshot::{self, Pending};

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    which: Which,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        self.which.each(globals, "accepted", Pending::accept)
    }
}

/// Which pending snapshots: all below the working folder, those of a pipeline, or those of some of its nodes.
#[derive(clap::Args)]
pub struct Which {
    /// Pipeline file; without one, all below the working folder
    file: Option<PathBuf>,
    /// Only these nodes
    #[arg(value_name = "NODE")]
    nodes: Vec<String>,
    #[command(flatten)]
    set: Set,
}

impl Which {
    /// Does something to each of them, and says so.
    pub fn each(&self, globals: &Globals, done: &str, act: fn(&Pending) -> std::io::Result<()>) -> Outcome {
        let all = self.pending()?;
        let (mut paths, mut wrong) = (Vec::new(), Vec::new());
        for one in &all {
            if let Err(e) = act(one) {
                wrong.push(unreadable(one, &e.to_string()));
                continue;
            }
            let path = one.path.with_extension("");
            if !globals.json && !globals.quiet {
                super::say(&format!("{done} {}\n", path.display()));
            }
            paths.push(path);
        }
        if !wrong.is_empty() {
            return super::pending::with_trouble(globals, json!({"ok": false, done: paths}), &wrong);
        }
        if globals.json {
            super::print(&json!({"ok": true, done: paths}));
        } else if all.is_empty() && !globals.quiet {
            super::say("nothing is pending\n");
        }
        Ok(Exit::Done)
    }

    /// Where they lie, by name.
    pub fn pending(&self) -> Result<Vec<Pending>, Stop> {
        let sets = &self.set.sets;
        let Some(file) = &self.file else {
            self.set.of_no_file()?;
            let mut out = Vec::new();
            for folder in folders(Path::new(".")) {
                out.extend(snapshot::pending(&folder));
            }
            return Ok(out);
        };
        if !file.is_file() {
            let error = Diagnostic::error("missing-file", format!("no pipeline file {}", file.display()));
            return Err(Stop::usage(error.value(file.display().to_string())));
        }
        let stem = file.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let mut of_file = snapshot::pending(&snapshot::folder(file));
        of_file.retain(|p| p.pipeline == stem);
        // Nodes that are only there without these settings are not meant.
        if !sets.is_empty() {
            let graph = Graph::load(file, sets, &crate::ops::ALL)?;
            of_file.retain(|p| graph.nodes.iter().any(|n| n.name == p.node));
        }
        let unknown = self.nodes.iter().filter(|n| !of_file.iter().any(|p| p.is_of(n)));
        let errors: Vec<_> = unknown
            .map(|n| Diagnostic::error("not-pending", format!("nothing is pending for node `{n}`")).value(n))
            .collect();
        if !errors.is_empty() {
            return Err(errors.into());
        }
        let wanted = |p: &Pending| self.nodes.is_empty() || self.nodes.iter().any(|n| p.is_of(n));
        Ok(of_file.into_iter().filter(wanted).collect())
    }
}

pub fn unreadable(one: &Pending, why: &str) -> Box<Diagnostic> {
    let d = Diagnostic::error("snapshot", format!("{}: {why}", one.path.display()));
    d.help("the others are done; `lodge reject` or you may remove this one")
}

/// Every folder `snapshots` below `root`, leaving out hidden ones, `target` and links.
fn folders(root: &Path) -> Vec<PathBuf> {
    let mut out = Vec::new();
    let mut entries: Vec<_> = std::fs::read_dir(root).into_iter().flatten().flatten().collect();
    entries.sort_by_key(|e| e.file_name());
    for entry in entries {
        let name = entry.file_name();
        let hidden = name.to_string_lossy().starts_with('.') || name == "target";
        if hidden || !entry.file_type().is_ok_and(|t| t.is_dir()) {
            continue;
        }
        if name == "snapshots" {
            out.push(entry.path());
        }
        out.extend(folders(&entry.path()));
    }
    out
}
