//! The loop: passes over the graph, ready nodes to the executor, until nothing is undone.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::event::{Event, Observer, Status};
use super::executor::{self, End, Executor, Input, Task};
use super::lock::{Claim, Guard};
use super::record::Record;
use super::slots::{Flight, Slot, State, free_memory};
use super::stamp::Stamps;
use super::store::Store;
use super::{Options, Outcome, key, publish};
use crate::diag::Diagnostic;
use crate::digest::Digest;
use crate::graph::Graph;

pub struct Loop<'a, 'o> {
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
    /// Of input files, as read before.
    stamps: Stamps,
    warnings: Vec<String>,
}

impl<'a, 'o> Loop<'a, 'o> {
    pub fn new(
        graph: &'a Arc<Graph>,
        only: &[usize],
        options: &'a Options,
        store: Arc<Store>,
        executor: Box<dyn Executor>,
        observer: &'a mut Observer<'o>,
    ) -> Self {
        Self {
            graph,
            options,
            executor,
            observer,
            slots: Slot::all(graph, only),
            fresh: BTreeSet::new(),
            misses: BTreeSet::new(),
            flights: BTreeMap::new(),
            wants: BTreeMap::new(),
            budget: options.memory.unwrap_or_else(free_memory),
            stamps: if options.verify { Stamps::default() } else { Stamps::load(&store) },
            store,
            warnings: Vec::new(),
        }
    }

    pub fn run(mut self, outcome: &mut Outcome) {
        let nodes = self.slots.iter().filter(|s| s.wanted).count();
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
                let found = publish::publish(self.graph, &ready, out, &self.store, self.options, self.observer);
                outcome.files = found.files;
                outcome.errors = found.errors;
                outcome.interrupted = found.interrupted;
                undone |= !found.lost.is_empty();
                found.lost.iter().for_each(|key| self.store.drop_result(key));
            }
            if !undone || outcome.interrupted {
                break;
            }
            passes -= 1;
            if passes == 0 {
                outcome.damaged = true;
                break;
            }
        }
        if let Some(line) = self.store.trouble() {
            self.warn(line);
        }
        self.stamps.save(&self.store);
        outcome.warnings = std::mem::take(&mut self.warnings);
        let slots = self.slots.into_iter().enumerate().filter(|(_, s)| s.wanted);
        outcome.nodes = slots.map(|(n, slot)| slot.outcome(n, self.graph)).collect();
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
            slot.reset(self.graph.nodes[n].inputs.iter().map(Vec::len).sum());
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

    /// After a stop: what is at work may still finish, for a moment. The run is to end within a second, also on a machine
    /// that has much else to do.
    fn land(&mut self) {
        let until = Instant::now() + Duration::from_millis(400);
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
        if self.slots[n].files.is_none() {
            self.slots[n].files = graph.nodes[n].files.iter().map(|path| self.stamps.known(path)).collect();
        }
        if self.slots[n].files.is_none() || !self.hit(n) {
            self.misses.insert(n);
        }
    }

    /// Settles a node whose result is in the cache.
    fn hit(&mut self, n: usize) -> bool {
        let key = self.key(n);
        let Some(record) = self.store.lookup(&key) else { return false };
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

    fn key(&mut self, n: usize) -> Digest {
        if let Some(key) = self.slots[n].key {
            return key;
        }
        let key = key::key(&self.graph.nodes[n], &self.inputs(n), &self.file_digests(n));
        self.slots[n].key = Some(key);
        key
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
        let mut next = self.misses.first().copied();
        while let Some(n) = next {
            next = self.misses.range(n + 1..).next().copied();
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
        let ports: Vec<u64> = node.inputs.iter().map(|port| port.iter().map(record).sum()).collect();
        let files: u64 = self.slots[n].files.iter().flatten().map(|f| f.stamp.size).sum();
        node.op.estimate_of(&ports, files)
    }

    fn ended(&mut self, end: End) {
        match end {
            End::Hashed { node, files } => {
                self.flights.remove(&node);
                match files {
                    Ok(files) => {
                        files.iter().for_each(|file| self.stamps.add(file));
                        self.slots[node].files = Some(files);
                        self.fresh.insert(node);
                    }
                    Err(error) => self.failed(node, error),
                }
            }
            End::Ran { node, record, peak } => {
                let Some(flight) = self.flights.remove(&node) else { return };
                self.slots[node].peak = peak;
                let record = Arc::new(*record);
                self.done(node, record.clone(), true);
                flight.twins.iter().for_each(|&twin| self.done(twin, record.clone(), false));
            }
            End::Failed { node, error, seconds, warnings, peak } => {
                let Some(flight) = self.flights.remove(&node) else { return };
                // It gave up because it was told to: no failure of its own.
                if self.stopped() && error.code == "interrupted" {
                    return;
                }
                self.slots[node].peak = peak;
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
        let (node, seconds, peak_bytes) = (node.name.clone(), record.seconds, slot.peak);
        let done = Event::NodeDone { node: node.clone(), status, seconds, digest, bytes, peak_bytes };
        (self.observer)(&done);
        for text in &record.warnings {
            (self.observer)(&Event::Warning { node: Some(node.clone()), text: text.clone() });
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
        let (node, status, seconds, peak_bytes) = (node.name.clone(), Status::Failed, slot.seconds, slot.peak);
        (self.observer)(&Event::NodeDone { node, status, seconds, digest: None, bytes: 0, peak_bytes });
        self.settle(n);
    }

    fn skip(&mut self, n: usize, because: String) {
        let slot = &mut self.slots[n];
        slot.state = State::Skipped;
        slot.because = Some(because);
        let node = self.graph.nodes[n].name.clone();
        let (status, digest, peak_bytes) = (Status::Skipped, None, None);
        (self.observer)(&Event::NodeDone { node, status, seconds: 0.0, digest, bytes: 0, peak_bytes });
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
        if self.slots[n].waiting.replace(on) != Some(on) {
            let what = self.graph.nodes[n].name.clone();
            (self.observer)(&Event::Waiting { what, on });
        }
    }

    fn warn(&mut self, text: String) {
        (self.observer)(&Event::Warning { node: None, text: text.clone() });
        self.warnings.push(text);
    }

    fn stopped(&self) -> bool {
        self.options.stop.load(Ordering::Relaxed)
    }
}
