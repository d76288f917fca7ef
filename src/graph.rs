//! Spec and registry to `Graph`: operators found, parameters typed, kinds checked, variants expanded, order fixed.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;

use crate::diag::{Diagnostic, SourceFile, Span};
use crate::op::{AnyOp, Entry, Registry};

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
    /// Reads and checks a pipeline. `sets` are the texts of `--set`. On failure every mistake that was found.
    pub fn load(file: &Path, sets: &[String], registry: &Registry) -> Result<Graph, Vec<Box<Diagnostic>>> {
        let _ = (file, sets, registry);
        Err(vec![Diagnostic::error("not-yet", "reading pipelines comes with the next commit")])
    }
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
    /// Names of the parameters marked `x-file` (kebab-case).
    pub file_params: Vec<String>,
    /// Folders and patterns of globs among them: a new file that matches changes the graph.
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
