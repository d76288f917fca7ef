//! The engine: what a node's result depends on, whether it is in the cache, and who computes it when.
//!
//! [`run`] goes over the graph in passes. A pass looks up every node (`key`, `store`), hands the misses to an
//! [`executor`], and publishes what writers made (`publish`). An object that turns out missing or damaged leaves its
//! users undone; it is deleted, and another pass makes it again, until nothing is undone.

pub mod codec;
pub mod compare;
pub mod event;
pub mod executor;
pub mod folder;
pub mod forecast;
pub mod gc;
pub mod history;
mod index;
pub mod key;
pub mod last;
pub mod lock;
mod needs;
pub mod pack;
mod pass;
pub mod peak;
pub mod plan;
pub mod publish;
pub mod published;
pub mod record;
mod rows;
mod slots;
pub mod snapshot;
pub mod stamp;
pub mod store;
pub mod verify;

use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Instant, SystemTime};

use crate::diag::Diagnostic;
use crate::digest::Digest;
use crate::graph::Graph;
use event::{Event, Observer, Status};
use executor::{InputFile, Local};
use folder::Wait;
use pass::Loop;
use published::Published;
use record::Record;
use store::Store;

/// How to run.
pub struct Options {
    /// The cache folder.
    pub cache: PathBuf,
    /// Where writers publish, the pipeline's name included; none: nowhere.
    pub out: Option<PathBuf>,
    /// Nodes at work at once.
    pub jobs: usize,
    /// Bytes that the estimates of running nodes may sum to; none: 80 % of what is free.
    pub memory: Option<u64>,
    /// Start nothing more after a failure.
    pub fail_fast: bool,
    /// Look how much memory each node takes, where nodes run one by one.
    pub peaks: bool,
    /// Wait at the end until what was computed is on the disk.
    pub sync: bool,
    /// Read published files even where their stamps are as they were.
    pub verify: bool,
    /// Under which a plan for null reruns is kept.
    pub plan: Option<plan::Identity>,
    /// What a person is told of nodes that are all cached: kept in the plan.
    pub table: fn(&[NodeOutcome]) -> String,
    /// Objects of the cache that were found damaged: what gave them runs again.
    pub lost: BTreeSet<Digest>,
    /// Set from outside to end the run.
    pub stop: Arc<AtomicBool>,
}

impl Options {
    pub fn new(cache: impl Into<PathBuf>) -> Self {
        Self {
            cache: cache.into(),
            out: None,
            jobs: 1,
            memory: None,
            fail_fast: false,
            peaks: false,
            sync: false,
            verify: false,
            plan: None,
            table: |_| String::new(),
            lost: BTreeSet::new(),
            stop: Arc::default(),
        }
    }
}

/// How a run ended.
#[derive(Default)]
pub struct Outcome {
    pub seconds: f64,
    /// What was asked for and what that needs, in graph order.
    pub nodes: Vec<NodeOutcome>,
    /// Every file that writers publish, as it is now.
    pub files: Vec<Published>,
    /// Of the run as a whole: damage repaired, a cache that cannot be written.
    pub warnings: Vec<String>,
    /// Why files could not be published.
    pub errors: Vec<Box<Diagnostic>>,
    pub interrupted: bool,
    /// The cache gave damaged objects again and again.
    pub damaged: bool,
}

pub struct NodeOutcome {
    /// Place in the graph.
    pub index: usize,
    pub name: String,
    pub op: String,
    pub status: Status,
    /// Of a node that ran or was cached.
    pub record: Option<Arc<Record>>,
    /// What the run took, now or when it was kept.
    pub seconds: f64,
    pub warnings: Vec<String>,
    pub error: Option<Box<Diagnostic>>,
    /// The failed node for which this one was skipped.
    pub because: Option<String>,
    /// What it read.
    pub files: Vec<InputFile>,
}

impl Outcome {
    pub fn ok(&self) -> bool {
        let done = |n: &NodeOutcome| matches!(n.status, Status::Ran | Status::Cached);
        self.nodes.iter().all(done) && self.errors.is_empty() && !self.interrupted && !self.damaged
    }

    /// What failed: nodes, then publishing.
    pub fn diagnostics(&self) -> Vec<Box<Diagnostic>> {
        self.nodes.iter().filter_map(|n| n.error.clone()).chain(self.errors.iter().cloned()).collect()
    }
}

/// Runs the nodes `only` (all leaves where it is empty) and what they need.
pub fn run(graph: &Arc<Graph>, only: &[usize], options: &Options, observer: &mut Observer) -> Outcome {
    let (started, began) = (Instant::now(), SystemTime::now());
    let mut outcome = Outcome::default();
    let mut opened = None;
    let nodes = needed(graph, only).iter().filter(|&&wanted| wanted).count();
    observer(&Event::Started { pipeline: graph.name.clone(), nodes });
    let tell = &mut |on| observer(&Event::Waiting { what: "cache".to_string(), on });
    match Store::open_after(&options.cache, &mut Wait { tell, stop: &options.stop }) {
        Ok(store) => {
            store.distrust(&options.lost);
            store.expect(last::load(&store, graph).into_values().map(|last| last.key));
            let store = Arc::new(store);
            let executor = Local::new(options, graph.clone(), store.clone());
            Loop::new(graph, only, options, store.clone(), Box::new(executor), observer).run(&mut outcome);
            if let Err(error) = last::note(&store, graph, &outcome) {
                tracing::debug!(%error, "cannot note the run");
            }
            if let Err(error) = history::note(&store, graph, options, &outcome, began) {
                tracing::debug!(%error, "cannot remember the run");
            }
            if let (true, Some(identity)) = (outcome.ok() && outcome.warnings.is_empty(), &options.plan)
                && let Err(error) = plan::compile(&store, identity, graph, &outcome, options)
            {
                tracing::debug!(%error, "cannot keep a plan");
            }
            if !outcome.interrupted {
                store.close();
            }
            opened = Some(store);
        }
        Err(error) if error.kind() == io::ErrorKind::Interrupted => outcome.interrupted = true,
        Err(error) => {
            let message = format!("cannot use the cache `{}`: {error}", options.cache.display());
            outcome.errors.push(Diagnostic::error("cache", message));
            outcome.damaged = true;
        }
    }
    outcome.seconds = started.elapsed().as_secs_f64();
    // Whoever interrupts does not wait for a disk: what is kept is written by the kernel, and checked when it is read.
    let wait = options.sync && !outcome.interrupted;
    if let Some(Err(error)) = opened.filter(|_| wait).map(|store| store.sync()) {
        let text = format!("results may be lost if the power fails now: {error}");
        observer(&Event::Warning { node: None, text: text.clone() });
        outcome.warnings.push(text);
    }
    observer(&Event::Done { ok: outcome.ok(), interrupted: outcome.interrupted, seconds: outcome.seconds });
    outcome
}

/// `only` and everything above it; all where it is empty.
pub fn needed(graph: &Graph, only: &[usize]) -> Vec<bool> {
    let mut wanted = vec![only.is_empty(); graph.nodes.len()];
    only.iter().for_each(|&n| wanted[n] = true);
    // Inputs come before users.
    for n in (0..graph.nodes.len()).rev() {
        if wanted[n] {
            graph.nodes[n].inputs.iter().flatten().for_each(|&i| wanted[i] = true);
        }
    }
    wanted
}
