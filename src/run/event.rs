//! What happens in a run, as it happens: for progress bars, `--events` and tests.

use serde_json::{Value, json};

use crate::digest::Digest;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    Ran,
    Cached,
    Failed,
    Skipped,
}

impl Status {
    pub fn name(self) -> &'static str {
        match self {
            Status::Ran => "ran",
            Status::Cached => "cached",
            Status::Failed => "failed",
            Status::Skipped => "skipped",
        }
    }
}

/// One happening. Nodes go by name.
#[derive(Clone, Debug)]
pub enum Event {
    Started {
        pipeline: String,
        nodes: usize,
    },
    NodeStarted {
        node: String,
        op: &'static str,
    },
    NodeDone {
        node: String,
        status: Status,
        seconds: f64,
        digest: Option<Digest>,
        bytes: u64,
    },
    /// Another process computes the node's result, or publishes into the folder.
    Waiting {
        what: String,
        on: i32,
    },
    Warning {
        node: Option<String>,
        text: String,
    },
    Published {
        path: String,
        bytes: u64,
    },
    Removed {
        path: String,
    },
    Done {
        ok: bool,
        seconds: f64,
    },
}

/// Hears of everything, in the order of happening, from one thread.
pub type Observer<'a> = dyn FnMut(&Event) + 'a;

impl Event {
    /// One line of `--events`, without the time.
    pub fn to_json(&self) -> Value {
        match self {
            Event::Started { pipeline, nodes } => json!({"event": "started", "pipeline": pipeline, "nodes": nodes}),
            Event::NodeStarted { node, op } => json!({"event": "node-started", "node": node, "op": op}),
            Event::NodeDone { node, status, seconds, digest, bytes } => json!({"event": "node-done", "node": node,
                "status": status.name(), "seconds": seconds, "digest": digest, "bytes": bytes}),
            Event::Waiting { what, on } => json!({"event": "waiting", "what": what, "process": on}),
            Event::Warning { node, text } => json!({"event": "warning", "node": node, "message": text}),
            Event::Published { path, bytes } => json!({"event": "published", "path": path, "bytes": bytes}),
            Event::Removed { path } => json!({"event": "removed", "path": path}),
            Event::Done { ok, seconds } => json!({"event": "done", "ok": ok, "seconds": seconds}),
        }
    }
}
