//! Where the work of a node is done. The loop hands out tasks and hears of their ends; a task is plain data, so that
//! another executor may send it elsewhere. The one here has J threads of its own.
//!
//! Operators split their work over rayon's global pool, which no node's closure ever enters: a worker that waits
//! inside a pool would pick up another whole node and finish that first.

use std::collections::BTreeMap;
use std::io;
use std::panic::{self, AssertUnwindSafe};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, Once};
use std::thread;
use std::time::{Duration, Instant};

use super::Options;
use super::key::Lines;
use super::peak::Peak;
use super::record::{self, Record};
use super::stamp::{self, Stamp};
use super::store::Store;
use crate::artifact::sections::{Decoder, Encoder};
use crate::artifact::{AnyArtifact, KINDS};
use crate::diag::{Diagnostic, Findings, Report};
use crate::digest::Digest;
use crate::graph::Graph;
use crate::op::{Ctx, Source};

/// One node to run, or the files of one to hash.
pub enum Task {
    Hash { node: usize, files: Vec<PathBuf> },
    Run(Box<Run>),
}

pub struct Run {
    /// Place in the graph, which holds operator, version and parameters.
    pub node: usize,
    pub key: Digest,
    /// What the key was made of.
    pub lines: Lines,
    /// By port.
    pub inputs: Vec<Vec<Input>>,
    pub files: Vec<InputFile>,
    /// Somebody will want the result soon.
    pub keep: bool,
}

pub struct Input {
    pub digest: Digest,
    pub kind: &'static str,
    /// Nobody else wants it.
    pub last: bool,
}

#[derive(Clone, Debug)]
pub struct InputFile {
    pub path: PathBuf,
    pub stamp: Stamp,
    pub digest: Digest,
}

/// How a task ended.
pub enum End {
    Hashed {
        node: usize,
        files: Result<Vec<InputFile>, Box<Diagnostic>>,
    },
    Ran {
        node: usize,
        record: Box<Record>,
        /// Of the process while it ran, where that is wanted and known.
        peak: Option<u64>,
    },
    Failed {
        node: usize,
        error: Box<Diagnostic>,
        seconds: f64,
        warnings: Vec<String>,
        peak: Option<u64>,
    },
    /// An input is missing in the cache, or damaged.
    Lost {
        node: usize,
    },
}

pub trait Executor {
    /// Tasks that may be at work at once.
    fn slots(&self) -> usize;
    fn submit(&mut self, task: Task);
    /// The next end, if one comes in time.
    fn next(&mut self, patience: Duration) -> Option<End>;
    /// Nobody wants this result any more.
    fn forget(&mut self, digest: &Digest);
}

/// Threads of this process.
pub struct Local {
    jobs: usize,
    tasks: Sender<Task>,
    ends: Receiver<End>,
    shared: Arc<Shared>,
}

struct Shared {
    graph: Arc<Graph>,
    store: Arc<Store>,
    stop: Arc<AtomicBool>,
    /// Whether peaks are wanted, and nodes run one by one.
    peaks: bool,
    /// Results that some node still wants.
    shelf: Mutex<BTreeMap<Digest, Arc<Slot>>>,
}

/// Held while an object is decoded, so that two nodes that want it do not both decode it.
#[derive(Default)]
struct Slot(Mutex<Option<Arc<dyn AnyArtifact>>>);

impl Local {
    pub fn new(options: &Options, graph: Arc<Graph>, store: Arc<Store>) -> Self {
        hear_panics();
        let jobs = options.jobs;
        let (tasks, todo) = mpsc::channel::<Task>();
        let (done, ends) = mpsc::channel();
        let todo = Arc::new(Mutex::new(todo));
        let shared = Arc::new(Shared {
            graph,
            store,
            stop: options.stop.clone(),
            peaks: options.peaks && jobs == 1,
            shelf: Mutex::default(),
        });
        for i in 0..jobs {
            let (todo, done, shared) = (todo.clone(), done.clone(), shared.clone());
            let work = move || {
                loop {
                    let task = todo.lock().unwrap().recv();
                    let Ok(task) = task else { return };
                    if done.send(shared.work(task)).is_err() {
                        return;
                    }
                }
            };
            thread::Builder::new().name(format!("node-{i}")).spawn(work).expect("a thread can be started");
        }
        Self { jobs, tasks, ends, shared }
    }
}

impl Executor for Local {
    fn slots(&self) -> usize {
        self.jobs
    }
    fn submit(&mut self, task: Task) {
        self.tasks.send(task).expect("node threads live as long as the executor");
    }
    fn next(&mut self, patience: Duration) -> Option<End> {
        self.ends.recv_timeout(patience).ok()
    }
    fn forget(&mut self, digest: &Digest) {
        self.shared.shelf.lock().unwrap().remove(digest);
    }
}

impl Shared {
    fn work(&self, task: Task) -> End {
        match task {
            Task::Hash { node, files } => {
                let hashed = files.into_iter().map(|path| match stamp::hash_input(&path) {
                    Ok((stamp, digest)) => Ok(InputFile { path, stamp: stamp.on(self.store.grain()), digest }),
                    Err(error) => Err(cannot_read(&path, &error)),
                });
                End::Hashed { node, files: hashed.collect() }
            }
            Task::Run(run) => {
                let node = &self.graph.nodes[run.node];
                let _span = tracing::info_span!("node", name = %node.name, op = node.entry.name).entered();
                let watch = self.peaks.then(Peak::start);
                let mut end = self.run(*run);
                if let End::Ran { peak, .. } | End::Failed { peak, .. } = &mut end {
                    *peak = watch.and_then(Peak::end);
                }
                if let End::Ran { record, .. } = &end {
                    tracing::info!(seconds = record.seconds, bytes = record.bytes, digest = %record.digest, "ran");
                }
                end
            }
        }
    }

    fn run(&self, task: Run) -> End {
        let started = Instant::now();
        let node = &self.graph.nodes[task.node];
        let id = task.node;

        // (1) Inputs, from memory or from the cache.
        let mut inputs = Vec::with_capacity(task.inputs.len());
        for port in &task.inputs {
            let got: Option<Vec<_>> = port.iter().map(|input| self.fetch(input)).collect();
            let Some(got) = got else { return End::Lost { node: id } };
            inputs.push(got);
        }

        // (2) The operator.
        let report = Report::default();
        let sources: Vec<Source> = task.files.iter().zip(&node.beside).map(source).collect();
        let ctx = Ctx { sources: &sources, report: &report, blobs: &*self.store, stop: &self.stop };
        let result = catch(|| node.op.run(&ctx, inputs)).unwrap_or_else(Err);
        drop(sources);
        let findings = report.finish();
        let fail = |error: Box<Diagnostic>, findings: Findings| End::Failed {
            node: id,
            error,
            seconds: started.elapsed().as_secs_f64(),
            warnings: findings.warnings,
            peak: None,
        };

        // (3) What was read must be what was hashed.
        if let Some(changed) = task.files.iter().find(|f| !unchanged(f)) {
            let message = format!("`{}` changed while it was read", changed.path.display());
            return fail(Diagnostic::error("input-changed", message), findings);
        }
        let artifact = match result {
            Ok(artifact) => artifact,
            Err(error) => return fail(error, findings),
        };

        // (4) The result, kept.
        match self.keep(&task, &*artifact, &findings, started) {
            Ok(record) => {
                if task.keep {
                    let slot = Arc::new(Slot(Mutex::new(Some(artifact))));
                    self.shelf.lock().unwrap().insert(record.digest, slot);
                }
                End::Ran { node: id, record: Box::new(record), peak: None }
            }
            Err(error) => {
                let message = format!("cannot keep the result in `{}`: {error}", self.store.root().display());
                fail(Diagnostic::error("cannot-store", message), findings)
            }
        }
    }

    fn keep(
        &self,
        task: &Run,
        artifact: &dyn AnyArtifact,
        findings: &Findings,
        started: Instant,
    ) -> io::Result<Record> {
        let mut encoder = Encoder::new(artifact.kind().name);
        artifact.encode(&mut encoder);
        let object = self.store.put(&encoder.pieces())?;
        let notes = if findings.rejects.is_empty() && findings.repairs.is_empty() {
            None
        } else {
            let notes = serde_json::json!({"rejects": findings.rejects, "repairs": findings.repairs});
            Some(self.store.put(&[notes.to_string().into_bytes().into()])?.digest)
        };
        let summary = record::summary(artifact.summary(), findings);
        let record = Record {
            key: task.key,
            kind: artifact.kind().name.to_string(),
            digest: object.digest,
            bytes: object.bytes,
            blob_bytes: artifact.blobs().iter().map(|b| b.bytes).sum(),
            seconds: started.elapsed().as_secs_f64(),
            warnings: findings.warnings.clone(),
            rejects: findings.rejects.len() as u32,
            repairs: findings.repairs.len() as u32,
            notes,
            frame: artifact.frame().map_or(String::new(), |f| serde_json::to_string(f).expect("frames are plain data")),
            summary: serde_json::Value::Object(summary).to_string(),
            lines: task.lines.clone(),
        };
        self.store.put_result(&record)?;
        Ok(record)
    }

    fn fetch(&self, input: &Input) -> Option<Arc<dyn AnyArtifact>> {
        let slot = {
            let mut shelf = self.shelf.lock().unwrap();
            match input.last {
                true => shelf.remove(&input.digest).unwrap_or_default(),
                false => shelf.entry(input.digest).or_default().clone(),
            }
        };
        let mut held = slot.0.lock().unwrap();
        if held.is_none() {
            *held = Some(decode(&self.store, input.kind, &input.digest)?);
        }
        if input.last { held.take() } else { held.clone() }
    }
}

/// An artifact from its object; none if that is missing or damaged.
pub fn decode(store: &Store, kind: &str, digest: &Digest) -> Option<Arc<dyn AnyArtifact>> {
    let kind = KINDS.iter().find(|k| k.name == kind)?;
    let streamed = store.get_through(digest, &mut |head, len, rest| {
        (kind.decode)(&mut Decoder::over(head, len, rest, kind.name).ok()?).ok()
    });
    // Whatever stood in the way, this meets it again, and says it.
    streamed.or_else(|| (kind.decode)(&mut Decoder::new(&store.get(digest)?, kind.name).ok()?).ok())
}

fn source((file, beside): (&InputFile, &Option<String>)) -> Source {
    Source { bytes: file.stamp.size, ..Source::of_file(&file.path, beside.as_deref()) }
}

/// By its stamp; and where the stamp was too young to tell, by its bytes.
fn unchanged(file: &InputFile) -> bool {
    let Ok(now) = Stamp::of_input(&file.path) else { return false };
    now.same(&file.stamp)
        && (file.stamp.settled(stamp::is_remote(&file.path))
            || stamp::hash_input(&file.path).is_ok_and(|(_, digest)| digest == file.digest))
}

pub fn cannot_read(path: &std::path::Path, error: &io::Error) -> Box<Diagnostic> {
    Diagnostic::error("cannot-read", format!("cannot read `{}`: {error}", path.display()))
}

// ------------------------------------------------------------------------------------------------------- panics

/// Texts and places of panics in operators, until [`catch`] fetches them.
static PANICS: Mutex<Vec<(String, String)>> = Mutex::new(Vec::new());
static AT_WORK: AtomicUsize = AtomicUsize::new(0);

/// Runs `work`; a panic becomes an error that says where it came from.
fn catch<T>(work: impl FnOnce() -> T) -> Result<T, Box<Diagnostic>> {
    AT_WORK.fetch_add(1, Ordering::SeqCst);
    let result = panic::catch_unwind(AssertUnwindSafe(work));
    AT_WORK.fetch_sub(1, Ordering::SeqCst);
    result.map_err(|payload| {
        let text = text_of(&*payload);
        let mut panics = PANICS.lock().unwrap();
        let place = panics.iter().rposition(|(t, _)| *t == text).map(|i| panics.remove(i).1);
        let place = place.map_or(String::new(), |p| format!(" at {p}"));
        Diagnostic::error("panic", format!("the operator panicked{place}: {text}")).help("this is a bug in lodge")
    })
}

/// Keeps quiet about panics that [`catch`] will report, on node threads and rayon's.
fn hear_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            let ours = thread::current().name().is_some_and(|n| n.starts_with("node-"))
                || rayon::current_thread_index().is_some();
            if !ours || AT_WORK.load(Ordering::SeqCst) == 0 {
                return usual(info);
            }
            let place = info.location().map_or(String::new(), ToString::to_string);
            PANICS.lock().unwrap().push((text_of(info.payload()), place));
        }));
    });
}

fn text_of(payload: &(dyn std::any::Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "without a text".to_string())
}
