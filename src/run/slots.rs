//! What the loop knows of each node.

use std::sync::Arc;

use super::event::Status;
use super::executor::InputFile;
use super::lock::Guard;
use super::record::Record;
use super::{NodeOutcome, needed};
use crate::diag::Diagnostic;
use crate::digest::Digest;
use crate::graph::Graph;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Not looked at, or at work.
    Open,
    Done,
    Failed,
    Skipped,
    /// Waits for the next pass: an input is lost.
    Deferred,
}

pub struct Slot {
    pub wanted: bool,
    pub state: State,
    /// Inputs that are not settled.
    pub waits: usize,
    /// Wanted nodes that take the result, once per edge.
    pub users: Vec<usize>,
    pub files: Option<Vec<InputFile>>,
    pub key: Option<Digest>,
    /// Process that is waited for.
    pub waiting: Option<i32>,
    pub record: Option<Arc<Record>>,
    /// In this run, in whichever pass.
    pub ran: bool,
    pub seconds: f64,
    pub peak: Option<u64>,
    pub warnings: Vec<String>,
    pub error: Option<Box<Diagnostic>>,
    pub because: Option<String>,
}

/// A node at work.
pub struct Flight {
    pub key: Digest,
    pub _claim: Option<Guard>,
    pub bytes: u64,
    /// Nodes with the same key.
    pub twins: Vec<usize>,
}

impl Slot {
    pub fn all(graph: &Graph, only: &[usize]) -> Vec<Self> {
        let wanted = needed(graph, only);
        let mut slots: Vec<Self> =
            wanted.iter().zip(&graph.nodes).map(|(&wanted, node)| Self::new(wanted, node)).collect();
        for (n, node) in graph.nodes.iter().enumerate().filter(|&(n, _)| wanted[n]) {
            node.inputs.iter().flatten().for_each(|&i| slots[i].users.push(n));
        }
        slots
    }

    fn new(wanted: bool, node: &crate::graph::Node) -> Self {
        Self {
            wanted,
            state: State::Open,
            waits: 0,
            users: Vec::new(),
            files: node.files.is_empty().then(Vec::new),
            key: None,
            waiting: None,
            record: None,
            ran: false,
            seconds: 0.0,
            peak: None,
            warnings: Vec::new(),
            error: None,
            because: None,
        }
    }

    /// As before the first pass, but for what stays so: failures, and that it ran.
    pub fn reset(&mut self, inputs: usize) {
        self.waits = inputs;
        self.key = None;
        self.record = None;
        if self.state != State::Failed {
            self.state = State::Open;
            self.because = None;
        }
    }

    pub fn outcome(self, index: usize, graph: &Graph) -> NodeOutcome {
        let status = match self.state {
            State::Done if self.ran => Status::Ran,
            State::Done => Status::Cached,
            State::Failed => Status::Failed,
            _ => Status::Skipped,
        };
        let interrupted = || "interrupted".to_string();
        NodeOutcome {
            index,
            name: graph.nodes[index].name.clone(),
            op: graph.nodes[index].entry.name.to_string(),
            status,
            record: self.record,
            seconds: self.seconds,
            warnings: self.warnings,
            error: self.error,
            because: self.because.or_else(|| (status == Status::Skipped).then(interrupted)),
            files: self.files.unwrap_or_default(),
        }
    }
}

/// 80 % of the memory that is free.
pub fn free_memory() -> u64 {
    free_of(&std::fs::read_to_string("/proc/meminfo").unwrap_or_default())
}

fn free_of(meminfo: &str) -> u64 {
    let line = meminfo.lines().find_map(|l| l.strip_prefix("MemAvailable:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kib.map_or(2 << 30, |kib| kib * 1024 / 5 * 4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_fifths_of_what_is_free() {
        let text = "MemTotal:       16384000 kB\nMemFree:          500000 kB\nMemAvailable:    8000000 kB\n";
        assert_eq!(free_of(text), 6_400_000 * 1024);
        assert_eq!(free_of(""), 2 << 30);
        // Of this machine: but for what others take and give meanwhile.
        let Ok(now) = std::fs::read_to_string("/proc/meminfo") else { return println!("skipped: no /proc/meminfo") };
        let words: Vec<&str> = now.split_whitespace().collect();
        let kib: u64 = words[words.iter().position(|w| *w == "MemAvailable:").unwrap() + 1].parse().unwrap();
        let (found, right) = (free_memory() as f64, kib as f64 * 1024.0 * 0.8);
        assert!((found / right - 1.0).abs() < 0.2, "{found} {right}");
    }
}
