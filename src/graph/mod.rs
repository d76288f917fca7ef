//! Spec and registry to `Graph`: operators found, parameters typed, kinds checked, variants expanded, order fixed.

mod build;
mod files;
mod schema;
mod variants;
mod wires;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;

use crate::diag::{Diagnostic, Diagnostics, SourceFile, Span, did_you_mean};
use crate::op::{AnyOp, Entry, Registry};
use crate::spec::Spec;

pub use crate::spec::bare;
pub use files::expand;
pub use schema::{required, wanted};
pub use wires::{kinds, port_name};

/// A checked pipeline: every mistake that can be known without reading data is behind us.
pub struct Graph {
    /// The pipeline file's name without its ending: `town`.
    pub name: String,
    /// Canonical path of the pipeline file.
    pub file: PathBuf,
    /// Every text that was read for it (the file, what it `extends`), in that order.
    pub texts: Vec<Arc<SourceFile>>,
    pub description: String,
    /// Inputs before users; file order among equals; variants of a node side by side.
    pub nodes: Vec<Node>,
}

impl Graph {
    /// Reads and checks a pipeline. `sets` are the texts of `--set`. On failure every mistake that was found, in the
    /// order of the file.
    pub fn load(file: &Path, sets: &[String], registry: &Registry) -> Result<Graph, Diagnostics> {
        let mut wrong = Vec::new();
        let spec = Spec::read(file, sets, &mut wrong);
        let graph = spec.map(|spec| build::build(spec, registry, &mut wrong));
        match graph {
            Some(graph) if wrong.is_empty() => Ok(graph),
            _ => {
                let mut seen = BTreeSet::new();
                wrong.retain(|d| seen.insert((d.span.as_ref().map(place), d.node.clone(), d.message.clone())));
                wrong.sort_by_key(|d| d.span.as_ref().map(place));
                Err(wrong)
            }
        }
    }

    /// The nodes that a name means: a variant, or all variants of a bare name.
    pub fn find(&self, name: &str) -> crate::diag::Result<Vec<usize>> {
        let all = (0..self.nodes.len()).filter(|&i| self.nodes[i].name == name || self.nodes[i].base == name);
        let all: Vec<_> = all.collect();
        if !all.is_empty() {
            return Ok(all);
        }
        let names = self.nodes.iter().flat_map(|n| [n.base.as_str(), n.name.as_str()]);
        let d = Diagnostic::error("unknown-node", format!("`{}` has no node `{name}`", self.name)).value(name);
        Err(d.help_nearest(did_you_mean(name, names)))
    }
}

impl std::fmt::Debug for Graph {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Graph").field("name", &self.name).field("nodes", &self.nodes).finish_non_exhaustive()
    }
}

impl std::fmt::Debug for Node {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} = {}({}) of {:?}", self.name, self.entry.name, self.params, self.inputs)
    }
}

/// Sorts by file (those of `--set` first), then by place.
fn place(span: &Span) -> (PathBuf, String, usize, usize) {
    let file = &span.file;
    let of_set = if file.path.as_os_str().is_empty() { file.text.clone() } else { String::new() };
    (file.path.clone(), of_set, span.range.start, span.range.end)
}

/// One node, or one variant of it.
pub struct Node {
    /// With the variant: `roof[columns=32]`.
    pub name: String,
    /// The name in the file: `roof`.
    pub base: String,
    pub entry: &'static Entry,
    pub op: Box<dyn AnyOp>,
    /// Every parameter with its default, as [`AnyOp::params`] gives them. What stands in the key, with `x-file`
    /// parameters replaced by the contents' digests.
    pub params: Value,
    /// For each port of `entry.ports` the nodes it takes, as indices into `Graph::nodes`.
    pub inputs: Vec<Vec<usize>>,
    /// Files that the node reads, in order (globs expanded in byte order).
    pub files: Vec<PathBuf>,
    /// Of each its name where it lies beside another, as that one gives it ([`Op::beside`](crate::op::Op::beside)).
    pub beside: Vec<Option<String>>,
    /// Names of the parameters marked `x-file` (kebab-case).
    pub file_params: Vec<String>,
    /// Patterns of globs among them, absolute, and files that were named but not found: a new file that matches
    /// changes the graph ([`expand`]).
    pub globs: Vec<PathBuf>,
    /// Where a writer publishes: the path below the output folder, and whether it is a folder.
    pub output: Option<(String, bool)>,
    /// `on-error = "fail"`: a rejected feature fails the node. Judged from the stored findings; not in the key.
    pub fail_on_reject: bool,
    pub snapshot: Snapshot,
    pub description: String,
    /// `[node.NAME]` in the file.
    pub span: Span,
}

impl Node {
    /// The name as part of a file's name: `roof-columns-32-morph-0`.
    pub fn file_name(&self) -> String {
        file_name(&self.name)
    }
}

/// `[`, `=`, `,` and what no file's name may hold become `-`, `]` goes.
fn file_name(name: &str) -> String {
    let safe = |c: char| if c.is_control() || "[=,/\\:*?\"<>|".contains(c) { '-' } else { c };
    name.chars().filter(|&c| c != ']').map(safe).collect()
}

/// `snapshot = false`, or its tolerances. Not in the key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Snapshot {
    pub on: bool,
    pub abs: f64,
    pub rel: f64,
    pub exact: bool,
}

impl Default for Snapshot {
    fn default() -> Self {
        Self { on: true, abs: 1e-6, rel: 1e-9, exact: false }
    }
}
