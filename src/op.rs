//! The bridge between the towers: what an operator is (`Op`), what it may ask for (`Ctx`), what there is (`Registry`).

use std::io::{self, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::artifact::{AnyArtifact, Artifact, Blob, Kind};
use crate::diag::{Diagnostic, Report, Result};

/// An operator: its parameters are `Self`, its ports `In`, its result `Out`. Pure: same parameters, inputs and
/// files give the same bytes on any number of threads.
pub trait Op: Serialize + DeserializeOwned + JsonSchema + Default + Send + Sync + 'static {
    /// Kebab-case, as in `op = ".."`.
    const NAME: &'static str;
    /// Plus one whenever the same inputs give other bytes.
    const VERSION: u32;
    type In: Inputs;
    type Out: Artifact;
    /// Keys that a run adds to the result's summary ([`Report::fact`]) and what they mean, for the manual.
    const FACTS: &'static [(&'static str, &'static str)] = &[];
    /// For benches and tests: `check` takes it, the manual and the schema for editors do not show it.
    const HIDDEN: bool = false;

    /// Names of further files that a file names (a buffer, a picture), relative to its folder. They become sources
    /// behind it, and stand in the key. Asked again of each that is found.
    fn beside(_: &Source) -> Vec<String> {
        Vec::new()
    }

    /// What one parameter's schema cannot say ("exactly one of"), before anything runs.
    fn check(&self) -> Vec<Mistake> {
        Vec::new()
    }

    fn run(&self, ctx: &Ctx, input: Self::In) -> Result<Self::Out>;

    /// Bytes of memory that a run needs, from the encoded bytes of its inputs and files: what a process that runs
    /// this one node takes more than one that runs none. `tests/memory.rs` holds it within a factor of two.
    fn estimate(&self, input_bytes: u64) -> u64 {
        (4 << 20) + 4 * input_bytes
    }

    /// The same from the bytes of each port, for an operator that makes much of one input and little of another.
    fn estimate_of(&self, ports: &[u64], file_bytes: u64) -> u64 {
        self.estimate(ports.iter().sum::<u64>() + file_bytes)
    }
}

/// A mistake in a parameter that only the operator can see.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mistake {
    /// Kebab-case name; empty where the node as a whole is to blame.
    pub param: &'static str,
    pub message: String,
}

/// Where an operator's work meets the world: files to read, a place for blobs, reports, the wish to stop.
pub struct Ctx<'a> {
    /// The files that the parameters marked `x-file` name, in order, each with those [`Op::beside`] it that there are.
    pub sources: &'a [Source],
    pub report: &'a Report,
    pub blobs: &'a dyn Blobs,
    pub stop: &'a AtomicBool,
}

/// The wish to stop that never comes, for methods outside an operator.
pub static NEVER: AtomicBool = AtomicBool::new(false);

impl Ctx<'_> {
    /// Call in long loops: an error when the run was interrupted. A method without a `Ctx` looks at `stop` and ends
    /// with anything at all.
    pub fn check(&self) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) { Err(Self::interrupted()) } else { Ok(()) }
    }

    pub fn interrupted() -> Box<Diagnostic> {
        Diagnostic::error("interrupted", "interrupted")
    }
}

/// A file to read. Operators never see paths: on another machine there may be none.
pub struct Source {
    /// The file's name without its folder, for diagnostics and for what a format says by its name; of a file beside
    /// another the name that this one gives it.
    pub name: String,
    /// It lies beside the last one before it that does not.
    pub beside: bool,
    pub bytes: u64,
    pub open: Box<dyn Fn() -> io::Result<Box<dyn Read + Send>> + Send + Sync>,
}

impl Source {
    /// A source over a file, or over one beside another that calls it by `name`.
    pub fn of_file(path: &std::path::Path, name: Option<&str>) -> Self {
        let own = || path.file_name().map_or(String::new(), |n| n.to_string_lossy().into_owned());
        let path = path.to_path_buf();
        Self {
            name: name.map_or_else(own, str::to_string),
            beside: name.is_some(),
            bytes: path.metadata().map_or(0, |m| m.len()),
            open: Box::new(move || Ok(Box::new(std::fs::File::open(&path)?))),
        }
    }

    /// A source over bytes in memory.
    pub fn of_bytes(name: &str, bytes: Vec<u8>) -> Self {
        let bytes: Arc<[u8]> = bytes.into();
        Self {
            name: name.to_string(),
            beside: false,
            bytes: bytes.len() as u64,
            open: Box::new(move || Ok(Box::new(io::Cursor::new(bytes.clone())))),
        }
    }
}

/// Takes the blobs of a `Files` result, one at a time, so that no tileset has to fit in memory.
pub trait Blobs: Send + Sync {
    fn put(&self, bytes: &[u8]) -> io::Result<Blob>;
}

/// Operators without an engine around them: no files, blobs in memory.
#[derive(Default)]
pub struct Bench {
    pub sources: Vec<Source>,
    pub report: Report,
    pub blobs: MemoryBlobs,
    stop: AtomicBool,
}

impl Bench {
    /// One whose run was interrupted.
    pub fn interrupted() -> Self {
        Self { stop: AtomicBool::new(true), ..Self::default() }
    }

    pub fn ctx(&self) -> Ctx<'_> {
        Ctx { sources: &self.sources, report: &self.report, blobs: &self.blobs, stop: &self.stop }
    }
}

/// Blobs kept in memory, by digest.
#[derive(Default)]
pub struct MemoryBlobs(pub std::sync::Mutex<std::collections::BTreeMap<crate::digest::Digest, Vec<u8>>>);

impl Blobs for MemoryBlobs {
    fn put(&self, bytes: &[u8]) -> io::Result<Blob> {
        let digest = crate::digest::Digest::of(bytes);
        self.0.lock().unwrap().entry(digest).or_insert_with(|| bytes.to_vec());
        Ok(Blob { digest, bytes: bytes.len() as u64 })
    }
}

// ------------------------------------------------------------------------------------------------------- ports

/// One input of an operator.
#[derive(Clone, Copy, Debug)]
pub struct PortDecl {
    pub name: &'static str,
    pub doc: &'static str,
    pub kinds: &'static [&'static Kind],
    pub optional: bool,
    pub many: bool,
}

/// What a port may be declared as: `T`, `Option<T>`, `Vec<T>`, or a `one_of!` enum.
pub trait Port {
    type Held;
    const KINDS: &'static [&'static Kind];
    const OPTIONAL: bool = false;
    const MANY: bool = false;
    /// The graph has checked number and kinds: a mismatch is our own bug.
    fn take(got: Vec<Arc<dyn AnyArtifact>>) -> Self::Held;
}

impl<A: Artifact> Port for A {
    type Held = Arc<A>;
    const KINDS: &'static [&'static Kind] = &[A::KIND];
    fn take(got: Vec<Arc<dyn AnyArtifact>>) -> Arc<A> {
        cast(got.into_iter().next().expect("the graph connects required ports"))
    }
}

impl<A: Artifact> Port for Option<A> {
    type Held = Option<Arc<A>>;
    const KINDS: &'static [&'static Kind] = &[A::KIND];
    const OPTIONAL: bool = true;
    fn take(got: Vec<Arc<dyn AnyArtifact>>) -> Self::Held {
        got.into_iter().next().map(cast)
    }
}

impl<A: Artifact> Port for Vec<A> {
    type Held = Vec<Arc<A>>;
    const KINDS: &'static [&'static Kind] = &[A::KIND];
    const OPTIONAL: bool = true;
    const MANY: bool = true;
    fn take(got: Vec<Arc<dyn AnyArtifact>>) -> Self::Held {
        got.into_iter().map(cast).collect()
    }
}

/// The artifact behind a kind that the graph has checked.
pub fn cast<A: Artifact>(any: Arc<dyn AnyArtifact>) -> Arc<A> {
    any.into_any().downcast::<A>().unwrap_or_else(|_| panic!("the graph checks kinds: expected {}", A::KIND.name))
}

/// The struct that `inputs!` makes.
pub trait Inputs: Sized {
    const PORTS: &'static [PortDecl];
    fn take(got: Vec<Vec<Arc<dyn AnyArtifact>>>) -> Self;
}

/// The ports of an operator, as a struct `In`. Each has a doc comment: it is the manual.
#[macro_export]
macro_rules! inputs {
    ($($(#[doc = $doc:literal])+ $name:ident: $port:ty),* $(,)?) => {
        pub struct In { $($(#[doc = $doc])+ pub $name: <$port as $crate::op::Port>::Held),* }
        impl $crate::op::Inputs for In {
            const PORTS: &'static [$crate::op::PortDecl] = &[$($crate::op::PortDecl {
                name: stringify!($name),
                doc: concat!($($doc),+),
                kinds: <$port as $crate::op::Port>::KINDS,
                optional: <$port as $crate::op::Port>::OPTIONAL,
                many: <$port as $crate::op::Port>::MANY,
            }),*];
            #[allow(unused_mut, unused_variables)]
            fn take(got: Vec<Vec<std::sync::Arc<dyn $crate::artifact::AnyArtifact>>>) -> Self {
                let mut got = got.into_iter();
                Self { $($name: <$port as $crate::op::Port>::take(got.next().unwrap_or_default())),* }
            }
        }
    };
}

/// A port that takes any of several kinds: `one_of! { pub enum Layer { Footprints, Hulls } }`.
#[macro_export]
macro_rules! one_of {
    ($(#[$meta:meta])* pub enum $name:ident { $($kind:ident),+ $(,)? }) => {
        $(#[$meta])*
        pub enum $name { $($kind(std::sync::Arc<$kind>)),+ }
        impl $crate::op::Port for $name {
            type Held = $name;
            const KINDS: &'static [&'static $crate::artifact::Kind] =
                &[$(<$kind as $crate::artifact::Artifact>::KIND),+];
            fn take(got: Vec<std::sync::Arc<dyn $crate::artifact::AnyArtifact>>) -> $name {
                let any = got.into_iter().next().expect("the graph connects required ports");
                $(if any.kind() == <$kind as $crate::artifact::Artifact>::KIND {
                    return $name::$kind($crate::op::cast(any));
                })+
                panic!("the graph checks kinds")
            }
        }
    };
}

/// Parameters with their defaults written once, beside the field (the syntax of RFC 3681).
/// `#[schemars(range(..))]` bounds them, `extend("x-unit" = "m")` names the unit, `extend("x-required" = true)`
/// makes one obligatory, `extend("x-file" = true)` names input files, `extend("x-output" = "file")` (or
/// `"folder"`) a published path.
#[macro_export]
macro_rules! params {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$fmeta:meta])* pub $field:ident: $ty:ty = $default:expr),* $(,)? }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        #[serde(rename_all = "kebab-case", deny_unknown_fields, default)]
        pub struct $name { $($(#[$fmeta])* pub $field: $ty),* }
        impl Default for $name {
            fn default() -> Self { Self { $($field: $default),* } }
        }
    };
}

// ---------------------------------------------------------------------------------------------------- registry

/// An operator without its types, as the engine sees it.
pub trait AnyOp: Send + Sync {
    /// Every parameter, defaults filled in.
    fn params(&self) -> Value;
    fn check(&self) -> Vec<Mistake>;
    fn run(&self, ctx: &Ctx, inputs: Vec<Vec<Arc<dyn AnyArtifact>>>) -> Result<Arc<dyn AnyArtifact>>;
    fn estimate_of(&self, ports: &[u64], file_bytes: u64) -> u64;
}

impl<O: Op> AnyOp for O {
    fn params(&self) -> Value {
        serde_json::to_value(self).expect("parameters are plain data")
    }
    fn check(&self) -> Vec<Mistake> {
        Op::check(self)
    }
    fn run(&self, ctx: &Ctx, inputs: Vec<Vec<Arc<dyn AnyArtifact>>>) -> Result<Arc<dyn AnyArtifact>> {
        ctx.check()?;
        let out = Op::run(self, ctx, O::In::take(inputs))?;
        // What was made of a part of the work goes nowhere.
        ctx.check()?;
        Ok(Arc::new(out))
    }
    fn estimate_of(&self, ports: &[u64], file_bytes: u64) -> u64 {
        Op::estimate_of(self, ports, file_bytes)
    }
}

/// One line of the registry.
pub struct Entry {
    pub name: &'static str,
    pub version: u32,
    /// Port names are Rust's (`snake_case`); in pipeline files `_` is `-`.
    pub ports: &'static [PortDecl],
    pub output: &'static Kind,
    /// Keys that it adds to the summary of its result.
    pub facts: &'static [(&'static str, &'static str)],
    /// Shown nowhere.
    pub hidden: bool,
    pub schema: fn() -> Value,
    pub beside: fn(&Source) -> Vec<String>,
    /// From parameters that hold to the schema.
    pub build: fn(Value) -> Result<Box<dyn AnyOp>, serde_json::Error>,
}

impl Entry {
    pub const fn of<O: Op>() -> Self {
        Self {
            name: O::NAME,
            version: O::VERSION,
            ports: O::In::PORTS,
            output: O::Out::KIND,
            facts: O::FACTS,
            hidden: O::HIDDEN,
            schema: || {
                let settings = schemars::generate::SchemaSettings::draft07().with(|s| s.inline_subschemas = true);
                settings.into_generator().into_root_schema_for::<O>().to_value()
            },
            beside: O::beside,
            build: |params| Ok(Box::new(serde_json::from_value::<O>(params)?)),
        }
    }
}

/// All operators, sorted by name.
pub struct Registry(pub &'static [Entry]);

impl Registry {
    pub fn get(&self, name: &str) -> Option<&'static Entry> {
        self.0.iter().find(|e| e.name == name)
    }

    /// Those that people should know of.
    pub fn shown(&self) -> impl Iterator<Item = &'static Entry> + Clone {
        self.0.iter().filter(|e| !e.hidden)
    }
}
