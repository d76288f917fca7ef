//! What happens in a run, as it happens: for progress bars, `--events` and tests. The JSON Schema of the lines of
//! `--events` comes from these types (`lodge schema events`).

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Value, json};

use crate::digest::Digest;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[schemars(inline)]
pub enum Status {
    Ran,
    Cached,
    Failed,
    Skipped,
}

impl Status {
    pub const ALL: [Status; 4] = [Status::Ran, Status::Cached, Status::Failed, Status::Skipped];

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
#[derive(Clone, Debug, Serialize, JsonSchema)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// The first line.
    Started {
        pipeline: String,
        /// Nodes that are wanted.
        nodes: usize,
    },
    /// The operator begins. A cached node has no such line.
    NodeStarted { node: String, op: &'static str },
    /// What became of a node. After damage in the cache it may be told again, in another pass: the last one holds.
    NodeDone {
        node: String,
        status: Status,
        /// What the run took, now or when the result was kept.
        seconds: f64,
        /// Of the result, where there is one.
        #[schemars(with = "Option<String>")]
        digest: Option<Digest>,
        /// Of the result and the files that belong to it.
        bytes: u64,
        /// The most memory that the whole process held while the node ran. Null where it is not known: with `-j`
        /// above 1, for nodes that did not run, and on systems other than Linux.
        peak_bytes: Option<u64>,
    },
    /// Another process computes the node's result, publishes into the folder, or has the cache to itself (`cache gc`).
    Waiting {
        /// Node or folder, or `cache`.
        what: String,
        /// Its id, or 0 where that is not known.
        #[serde(rename = "process")]
        on: i32,
    },
    /// Of a node, or of the run as a whole.
    Warning {
        node: Option<String>,
        #[serde(rename = "message")]
        text: String,
    },
    /// A file was written into the output folder.
    Published { path: String, bytes: u64 },
    /// A file that is no longer made was removed from there.
    Removed { path: String },
    /// The last line.
    Done { ok: bool, interrupted: bool, seconds: f64 },
}

/// Hears of everything, in the order of happening, from one thread.
pub type Observer<'a> = dyn FnMut(&Event) + 'a;

impl Event {
    /// One line of `--events`, without the time.
    pub fn to_json(&self) -> Value {
        serde_json::to_value(self).expect("events are plain data")
    }
}

/// The JSON Schema (draft-07) of one line of `--events`.
pub fn schema() -> Value {
    let settings = schemars::generate::SchemaSettings::draft07().with(|s| s.inline_subschemas = true);
    let mut schema = settings.into_generator().into_root_schema_for::<Event>().to_value();
    schema["title"] = "a line of lodge --events".into();
    schema["description"] = "JSON objects, one a line, in the order of happening".into();
    for branch in schema["oneOf"].as_array_mut().into_iter().flatten() {
        branch["additionalProperties"] = false.into();
        let seconds = |what: &str| json!({"type": "number", "format": "double", "description": what});
        branch["properties"]["at"] = seconds("seconds since 1970-01-01 00:00 UTC");
        branch["properties"]["after"] = seconds("seconds since the command began");
        // What may be null is there all the same.
        let names = branch["properties"].as_object().expect("an object").keys().cloned().collect::<Vec<_>>();
        branch["required"] = json!(names);
    }
    schema
}
