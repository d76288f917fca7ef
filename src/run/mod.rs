//! The engine: what a node's result depends on, whether it is in the cache, and who computes it when.
//!
//! [`run`] goes over the graph in passes. A pass looks up every node (`key`, `store`), hands the misses to an
//! [`executor`], and publishes what writers made (`publish`). An object that turns out missing or damaged leaves its
//! users undone; it is deleted, and another pass makes it again, until nothing is undone.

pub mod codec;
pub mod event;
pub mod executor;
pub mod key;
pub mod lock;
pub mod pack;
pub mod publish;
pub mod record;
pub mod snapshot;
pub mod stamp;
pub mod store;

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::diag::Diagnostic;
use crate::digest::Digest;
use crate::graph::Graph;
use event::{Event, Observer, Status};
use executor::{End, Executor, Input, InputFile, Local, Task};
use lock::{Claim, Guard};
use publish::Published;
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
    /// Read published files even where their stamps are as they were.
    pub verify: bool,
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
            verify: false,
            stop: Arc::default(),
        }
    }
}

/// How a run ended.
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
}

/// Runs the nodes `only` (all leaves where it is empty) and what they need.
pub fn run(graph: &Arc<Graph>, only: &[usize], options: &Options, observer: &mut Observer) -> Outcome {
    let started = Instant::now();
    let mut outcome = Outcome {
        seconds: 0.0,
        nodes: Vec::new(),
        files: Vec::new(),
        warnings: Vec::new(),
        errors: Vec::new(),
        interrupted: false,
        damaged: false,
    };
    match Store::open(&options.cache) {
        Ok(store) => {
            let store = Arc::new(store);
            let executor = Local::new(options.jobs, graph.clone(), store.clone(), options.stop.clone());
            Loop::new(graph, only, options, store, Box::new(executor), observer).run(&mut outcome);
        }
        Err(error) => {
            let message = format!("cannot use the cache `{}`: {error}", options.cache.display());
            outcome.errors.push(Diagnostic::error("cache", message));
            outcome.damaged = true;
        }
    }
    outcome.seconds = started.elapsed().as_secs_f64();
    observer(&Event::Done { ok: outcome.ok(), seconds: outcome.seconds });
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Not looked at, or at work.
    Open,
    Done,
    Failed,
    Skipped,
    /// Waits for the next pass: an input is lost.
    Deferred,
}

struct Slot {
    wanted: bool,
    state: State,
    /// Inputs that are not settled.
    waits: usize,
    /// Wanted nodes that take the result, once per edge.
    users: Vec<usize>,
    files: Option<Vec<InputFile>>,
    record: Option<Arc<Record>>,
    /// In this run, in whichever pass.
    ran: bool,
    seconds: f64,
    warnings: Vec<String>,
    error: Option<Box<Diagnostic>>,
    because: Option<String>,
}

/// A node at work.
struct Flight {
    key: Digest,
    _claim: Option<Guard>,
    bytes: u64,
    /// Nodes with the same key.
    twins: Vec<usize>,
}

struct Loop<'a, 'o> {
    graph: &'a Arc<Graph>,
    options: &'a Options,
    store: Arc<Store>,
    executor: Box<dyn Executor>,
    observer: &'a mut Observer<'o>,
    slots: Vec<Slot>,
    /// Nodes whose inputs are settled.
    fresh: BTreeSet<usize>,
    /// Nodes that must run, or whose files must be hashed, in graph order.
    misses: BTreeSet<usize>,
    /// By node.
    flights: BTreeMap<usize, Flight>,
    /// Edges that still want a result.
    wants: BTreeMap<Digest, usize>,
    budget: u64,
    warnings: Vec<String>,
}

impl<'a, 'o> Loop<'a, 'o> {
    fn new(
        graph: &'a Arc<Graph>,
        only: &[usize],
        options: &'a Options,
        store: Arc<Store>,
        executor: Box<dyn Executor>,
        observer: &'a mut Observer<'o>,
    ) -> Self {
        let wanted = needed(graph, only);
        let slot = |(n, &wanted): (usize, &bool)| Slot {
            wanted,
            state: State::Open,
            waits: 0,
            users: Vec::new(),
            files: graph.nodes[n].files.is_empty().then(Vec::new),
            record: None,
            ran: false,
            seconds: 0.0,
            warnings: Vec::new(),
            error: None,
            because: None,
        };
        let mut slots: Vec<Slot> = wanted.iter().enumerate().map(slot).collect();
        for (n, node) in graph.nodes.iter().enumerate().filter(|&(n, _)| wanted[n]) {
            node.inputs.iter().flatten().for_each(|&i| slots[i].users.push(n));
        }
        Self {
            graph,
            options,
            store,
            executor,
            observer,
            slots,
            fresh: BTreeSet::new(),
            misses: BTreeSet::new(),
            flights: BTreeMap::new(),
            wants: BTreeMap::new(),
            budget: options.memory.unwrap_or_else(free_memory),
            warnings: Vec::new(),
        }
    }

    fn run(mut self, outcome: &mut Outcome) {
        let nodes = self.slots.iter().filter(|s| s.wanted).count();
        (self.observer)(&Event::Started { pipeline: self.graph.name.clone(), nodes });
        if self.store.is_read_only() {
            self.warn(format!("the cache `{}` cannot be written: results are not kept", self.store.root().display()));
        }
        // Each pass makes at least one lost object again.
        let mut passes = nodes + 2;
        loop {
            self.pass();
            if self.stopped() {
                outcome.interrupted = true;
                break;
            }
            let done = |s: &&Slot| s.wanted && s.state != State::Deferred;
            let mut undone = self.slots.iter().filter(done).count() < nodes;
            if let Some(out) = &self.options.out {
                let ready: Vec<(usize, Arc<Record>)> = (0..self.slots.len())
                    .filter(|&n| self.slots[n].state == State::Done && self.graph.nodes[n].output.is_some())
                    .filter_map(|n| Some((n, self.slots[n].record.clone()?)))
                    .collect();
                let found = publish::publish(self.graph, &ready, out, &self.store, self.options.verify, self.observer);
                outcome.files = found.files;
                outcome.errors = found.errors;
                undone |= !found.lost.is_empty();
                found.lost.iter().for_each(|key| self.store.drop_result(key));
            }
            for line in self.store.troubles() {
                self.warn(line);
            }
            if !undone {
                break;
            }
            passes -= 1;
            if passes == 0 {
                outcome.damaged = true;
                break;
            }
        }
        outcome.warnings = std::mem::take(&mut self.warnings);
        for (index, slot) in self.slots.into_iter().enumerate().filter(|(_, s)| s.wanted) {
            let status = match slot.state {
                State::Done if slot.ran => Status::Ran,
                State::Done => Status::Cached,
                State::Failed => Status::Failed,
                _ => Status::Skipped,
            };
            let interrupted = || "interrupted".to_string();
            outcome.nodes.push(NodeOutcome {
                index,
                status,
                record: slot.record,
                seconds: slot.seconds,
                warnings: slot.warnings,
                error: slot.error,
                because: slot.because.or_else(|| (status == Status::Skipped).then(interrupted)),
                files: slot.files.unwrap_or_default(),
            });
        }
    }

    /// Looks at every node that has not failed and runs the misses.
    fn pass(&mut self) {
        self.fresh.clear();
        self.misses.clear();
        self.wants.clear();
        for n in 0..self.slots.len() {
            let slot = &mut self.slots[n];
            if !slot.wanted {
                continue;
            }
            slot.waits = self.graph.nodes[n].inputs.iter().map(Vec::len).sum();
            if slot.state != State::Failed {
                slot.state = State::Open;
                slot.because = None;
            }
            if slot.waits == 0 {
                self.fresh.insert(n);
            }
        }
        loop {
            while let Some(n) = self.fresh.pop_first() {
                self.look(n);
            }
            let blocked = self.start_some();
            if !self.fresh.is_empty() {
                continue;
            }
            if self.stopped() {
                return self.land();
            }
            if self.flights.is_empty() && self.misses.is_empty() {
                return;
            }
            let patience = if blocked { Duration::from_millis(3) } else { Duration::from_millis(50) };
            if let Some(end) = self.executor.next(patience) {
                self.ended(end);
            }
        }
    }

    /// After a stop: what is at work may still finish, for a moment.
    fn land(&mut self) {
        let until = Instant::now() + Duration::from_millis(600);
        while !self.flights.is_empty() && Instant::now() < until {
            if let Some(end) = self.executor.next(Duration::from_millis(10)) {
                self.ended(end);
            }
        }
        // Their threads may go on until the process ends; their claims stay as long.
        std::mem::take(&mut self.flights).into_values().for_each(std::mem::forget);
    }

    /// A node whose inputs are settled: a hit, a miss, or not to be run at all.
    fn look(&mut self, n: usize) {
        let slot = &self.slots[n];
        if slot.state == State::Failed {
            return self.settle(n);
        }
        let graph = self.graph.clone();
        let inputs = || graph.nodes[n].inputs.iter().flatten().map(|&i| &self.slots[i]);
        if let Some(bad) = inputs().position(|s| matches!(s.state, State::Failed | State::Skipped)) {
            let index = *graph.nodes[n].inputs.iter().flatten().nth(bad).expect("found above");
            let because = self.slots[index].because.clone().unwrap_or_else(|| graph.nodes[index].name.clone());
            return self.skip(n, because);
        }
        if inputs().any(|s| s.state == State::Deferred) {
            self.slots[n].state = State::Deferred;
            return self.settle(n);
        }
        if self.slots[n].files.is_none() || !self.hit(n) {
            self.misses.insert(n);
        }
    }

    /// Settles a node whose result is in the cache.
    fn hit(&mut self, n: usize) -> bool {
        let Some(record) = self.store.lookup(&self.key(n)) else { return false };
        self.done(n, Arc::new(record), false);
        true
    }

    fn inputs(&self, n: usize) -> Vec<Vec<Option<Digest>>> {
        let digest = |&i: &usize| self.slots[i].record.as_ref().map(|r| r.digest);
        self.graph.nodes[n].inputs.iter().map(|port| port.iter().map(digest).collect()).collect()
    }

    fn file_digests(&self, n: usize) -> Vec<Digest> {
        self.slots[n].files.iter().flatten().map(|f| f.digest).collect()
    }

    fn key(&self, n: usize) -> Digest {
        key::key(&self.graph.nodes[n], &self.inputs(n), &self.file_digests(n))
    }

    /// Hands out what fits. Whether something waits for another process or for memory.
    fn start_some(&mut self) -> bool {
        let mut blocked = false;
        if self.options.fail_fast
            && let Some(failed) = self.slots.iter().position(|s| s.state == State::Failed)
        {
            let name = self.graph.nodes[failed].name.clone();
            for n in std::mem::take(&mut self.misses) {
                self.skip(n, name.clone());
            }
        }
        for n in self.misses.clone() {
            if self.flights.len() >= self.executor.slots() || self.stopped() {
                break;
            }
            if self.slots[n].files.is_none() {
                let flight = Flight { key: Digest::default(), _claim: None, bytes: 0, twins: Vec::new() };
                self.misses.remove(&n);
                self.flights.insert(n, flight);
                self.executor.submit(Task::Hash { node: n, files: self.graph.nodes[n].files.clone() });
                continue;
            }
            let key = self.key(n);
            if let Some(flight) = self.flights.values_mut().find(|f| f.key == key) {
                flight.twins.push(n);
                self.misses.remove(&n);
                continue;
            }
            let bytes = self.estimate(n);
            let used: u64 = self.flights.values().map(|f| f.bytes).sum();
            if used > 0 && used.saturating_add(bytes) > self.budget {
                continue;
            }
            let claim = match self.store.claim(&key) {
                Some(Claim::Busy(process)) => {
                    blocked = true;
                    self.waiting(n, process);
                    continue;
                }
                Some(Claim::Got(guard)) => Some(guard),
                None => None,
            };
            self.misses.remove(&n);
            // Another process, or a twin, may just have finished it.
            if let Err(error) = self.store.refresh() {
                tracing::debug!(%error, "cannot list the cache");
            }
            if self.hit(n) {
                continue;
            }
            if bytes > self.budget {
                let name = &self.graph.nodes[n].name;
                self.warn(format!("`{name}` may need {} MiB, more than the budget: it runs alone", bytes >> 20));
            }
            self.start(n, key, claim, bytes);
        }
        blocked
    }

    fn start(&mut self, n: usize, key: Digest, claim: Option<Guard>, bytes: u64) {
        let node = &self.graph.nodes[n];
        let (op, name) = (node.entry.name, node.name.clone());
        let mut lines = key::Lines::new();
        key::walk(node, &self.inputs(n), &self.file_digests(n), &mut lines);
        let mine = |d: &Digest| {
            let same = |&&i: &&usize| self.slots[i].record.as_ref().is_some_and(|r| r.digest == *d);
            node.inputs.iter().flatten().filter(same).count()
        };
        let input = |&i: &usize| {
            let digest = self.slots[i].record.as_ref().expect("inputs are done").digest;
            let last = self.wants.get(&digest).is_none_or(|&all| all <= mine(&digest));
            Input { digest, kind: self.graph.nodes[i].entry.output.name, last }
        };
        let inputs: Vec<Vec<Input>> = node.inputs.iter().map(|port| port.iter().map(input).collect()).collect();
        // One object that comes in twice is not taken off the shelf the first time.
        let mut inputs = inputs;
        let mut seen = BTreeSet::new();
        for input in inputs.iter_mut().flatten().rev() {
            input.last &= seen.insert(input.digest);
        }
        let run = executor::Run {
            node: n,
            key,
            lines,
            inputs,
            files: self.slots[n].files.clone().unwrap_or_default(),
            keep: !self.slots[n].users.is_empty(),
        };
        self.flights.insert(n, Flight { key, _claim: claim, bytes, twins: Vec::new() });
        (self.observer)(&Event::NodeStarted { node: name, op });
        self.executor.submit(Task::Run(Box::new(run)));
    }

    fn estimate(&self, n: usize) -> u64 {
        let node = &self.graph.nodes[n];
        let record = |&i: &usize| self.slots[i].record.as_ref().map_or(0, |r| r.bytes + r.blob_bytes);
        let inputs: u64 = node.inputs.iter().flatten().map(record).sum();
        let files: u64 = self.slots[n].files.iter().flatten().map(|f| f.stamp.size).sum();
        node.op.estimate(inputs + files)
    }

    fn ended(&mut self, end: End) {
        match end {
            End::Hashed { node, files } => {
                self.flights.remove(&node);
                match files {
                    Ok(files) => {
                        self.slots[node].files = Some(files);
                        self.fresh.insert(node);
                    }
                    Err(error) => self.failed(node, error),
                }
            }
            End::Ran { node, record } => {
                let Some(flight) = self.flights.remove(&node) else { return };
                let record = Arc::new(*record);
                self.done(node, record.clone(), true);
                flight.twins.iter().for_each(|&twin| self.done(twin, record.clone(), false));
            }
            End::Failed { node, error, seconds, warnings } => {
                let Some(flight) = self.flights.remove(&node) else { return };
                for n in [node].into_iter().chain(flight.twins) {
                    self.slots[n].seconds = seconds;
                    self.slots[n].warnings = warnings.clone();
                    self.failed(n, error.clone());
                }
            }
            End::Lost { node } => {
                let Some(flight) = self.flights.remove(&node) else { return };
                for n in [node].into_iter().chain(flight.twins) {
                    self.slots[n].state = State::Deferred;
                    self.settle(n);
                }
            }
        }
    }

    fn done(&mut self, n: usize, record: Arc<Record>, ran: bool) {
        let node = &self.graph.nodes[n];
        let slot = &mut self.slots[n];
        slot.ran |= ran;
        slot.seconds = record.seconds;
        slot.warnings = record.warnings.clone();
        if node.fail_on_reject && record.rejects > 0 {
            let s = if record.rejects == 1 { " was" } else { "s were" };
            let message = format!("{} feature{s} rejected, and `on-error` is \"fail\"", record.rejects);
            let help = format!("`lodge export .. {} --rejects -o rejects.csv` lists them", node.name);
            return self.failed(n, Diagnostic::error("rejects", message).help(help));
        }
        slot.state = State::Done;
        let status = if slot.ran { Status::Ran } else { Status::Cached };
        let (digest, bytes) = (Some(record.digest), record.bytes + record.blob_bytes);
        if !slot.users.is_empty() {
            *self.wants.entry(record.digest).or_default() += slot.users.len();
        }
        slot.record = Some(record.clone());
        (self.observer)(&Event::NodeDone { node: node.name.clone(), status, seconds: record.seconds, digest, bytes });
        for text in &record.warnings {
            (self.observer)(&Event::Warning { node: Some(node.name.clone()), text: text.clone() });
        }
        self.settle(n);
    }

    fn failed(&mut self, n: usize, error: Box<Diagnostic>) {
        let node = &self.graph.nodes[n];
        let slot = &mut self.slots[n];
        slot.state = State::Failed;
        let mut error = error.node(&node.name);
        if error.span.is_none() {
            error = error.at(node.span.clone());
        }
        slot.error = Some(error);
        let (node, seconds) = (node.name.clone(), slot.seconds);
        (self.observer)(&Event::NodeDone { node, status: Status::Failed, seconds, digest: None, bytes: 0 });
        self.settle(n);
    }

    fn skip(&mut self, n: usize, because: String) {
        let slot = &mut self.slots[n];
        slot.state = State::Skipped;
        slot.because = Some(because);
        let node = self.graph.nodes[n].name.clone();
        (self.observer)(&Event::NodeDone { node, status: Status::Skipped, seconds: 0.0, digest: None, bytes: 0 });
        self.settle(n);
    }

    /// The node's fate in this pass is known: its users may go on, and it wants no inputs any more.
    fn settle(&mut self, n: usize) {
        for u in self.slots[n].users.clone() {
            self.slots[u].waits -= 1;
            if self.slots[u].waits == 0 {
                self.fresh.insert(u);
            }
        }
        for &i in self.graph.nodes[n].inputs.iter().flatten() {
            let Some(digest) = self.slots[i].record.as_ref().map(|r| r.digest) else { continue };
            let Some(wants) = self.wants.get_mut(&digest) else { continue };
            *wants -= 1;
            if *wants == 0 {
                self.wants.remove(&digest);
                self.executor.forget(&digest);
            }
        }
    }

    fn waiting(&mut self, n: usize, on: i32) {
        let what = self.graph.nodes[n].name.clone();
        (self.observer)(&Event::Waiting { what, on });
    }

    fn warn(&mut self, text: String) {
        (self.observer)(&Event::Warning { node: None, text: text.clone() });
        self.warnings.push(text);
    }

    fn stopped(&self) -> bool {
        self.options.stop.load(Ordering::Relaxed)
    }
}

/// 80 % of the memory that is free.
fn free_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let line = text.lines().find_map(|l| l.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kib.map_or(2 << 30, |kib| kib * 1024 / 5 * 4)
}
