//! What the commands that run something share: where cache and outputs lie, which nodes are meant, Ctrl-C.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

use super::progress::Teller;
use super::{Exit, Globals, Stop, Target};
use crate::diag::Diagnostic;
use crate::digest::Digest;
use crate::graph::Graph;
use crate::run::folder::{Wait, is_read_only};
use crate::run::plan::{Identity, build_id};
use crate::run::store::Store;
use crate::run::{self, Options};

/// Cache folder and output folder of a pipeline file.
pub struct Place {
    pub cache: PathBuf,
    /// With the pipeline's name.
    pub out: PathBuf,
    /// The pipeline's.
    pub name: String,
    /// Canonical, where there is such a file.
    pub file: PathBuf,
}

impl Place {
    pub fn of(globals: &Globals, file: &Path) -> Self {
        let name = file.file_stem().map_or_else(|| "pipeline".into(), |s| s.to_string_lossy().into_owned());
        let file = std::fs::canonicalize(file).unwrap_or_else(|_| file.to_path_buf());
        let home = file.parent().unwrap_or(Path::new("."));
        let is_root = |p: &&Path| p.join(".lodge").exists() || p.join(".git").exists();
        let root = home.ancestors().find(is_root).unwrap_or(home);
        let cache = globals.cache.clone().unwrap_or_else(|| root.join(".lodge"));
        let beside = || match &globals.cache {
            Some(cache) => std::path::absolute(cache).ok().and_then(|c| Some(c.parent()?.join("out"))),
            None => None,
        };
        let out = globals.out.clone().or_else(beside).unwrap_or_else(|| root.join("out"));
        Self { cache, out: out.join(&name), name, file }
    }

    /// What a plan for null reruns is kept under.
    pub fn identity(&self, target: &Target, only: &[String]) -> Identity {
        Identity {
            file: self.file.clone(),
            sets: target.set.sets.clone(),
            only: only.to_vec(),
            out: std::path::absolute(&self.out).unwrap_or_else(|_| self.out.clone()),
            build: build_id(&crate::ops::ALL),
        }
    }
}

/// How to run, by the flags. Makes rayon's pool and listens for Ctrl-C, once.
pub fn options(globals: &Globals, place: &Place) -> Options {
    let jobs = jobs(globals);
    // The pool is made once per process; a second call changes nothing.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global();
    let mut options = Options::new(&place.cache);
    options.out = Some(place.out.clone());
    options.jobs = jobs;
    options.memory = globals.memory;
    options.fail_fast = globals.fail_fast;
    options.peaks = globals.events.is_some();
    options.sync = true;
    options.stop = stop_on_ctrl_c();
    options
}

pub fn jobs(globals: &Globals) -> usize {
    globals.jobs.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, |n| n.get()))
}

/// Ctrl-C once: stop soon, keep what is finished. Twice: at once.
pub fn stop_on_ctrl_c() -> Arc<AtomicBool> {
    static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();
    let stop = STOP.get_or_init(|| {
        let stop = Arc::new(AtomicBool::new(false));
        let flag = stop.clone();
        let heard = move || {
            if flag.swap(true, Ordering::SeqCst) {
                std::process::exit(Exit::Interrupted as i32);
            }
        };
        if let Err(error) = ctrlc::set_handler(heard) {
            tracing::debug!(%error, "Ctrl-C ends the program at once");
        }
        stop
    });
    stop.clone()
}

/// The nodes that names mean: one variant, or all of a node.
pub fn pick(graph: &Graph, names: &[String]) -> Result<Vec<usize>, Stop> {
    let mut out = Vec::new();
    let mut wrong = Vec::new();
    for name in names {
        match graph.find(name) {
            Ok(all) => out.extend(all),
            Err(error) => wrong.push(error),
        }
    }
    out.sort_unstable();
    out.dedup();
    if wrong.is_empty() { Ok(out) } else { Err(wrong.into()) }
}

/// The one node that a name means.
pub fn pick_one(graph: &Graph, name: &str) -> Result<usize, Stop> {
    let all = pick(graph, &[name.to_string()])?;
    match all[..] {
        [one] => Ok(one),
        _ => {
            let names: Vec<_> = all.iter().map(|&n| format!("`{}`", graph.nodes[n].name)).collect();
            let message = format!("`{name}` has {} variants", all.len());
            Err(Stop::usage(
                Diagnostic::error("many-variants", message).help(format!("name one of {}", names.join(", "))),
            ))
        }
    }
}

/// What `work` gives, unless Ctrl-C comes first: then it is left behind, and ends with the process.
pub fn unless_interrupted<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, Stop> {
    let stop = stop_on_ctrl_c();
    let (send, receive) = channel();
    // As much room as the main thread has.
    let thread = thread::Builder::new().stack_size(8 << 20).spawn(move || drop(send.send(work())));
    let thread = thread.expect("a thread can be made");
    loop {
        match receive.recv_timeout(Duration::from_millis(20)) {
            Ok(value) => return Ok(value),
            Err(RecvTimeoutError::Disconnected) => {
                std::panic::resume_unwind(thread.join().expect_err("it sends, or it panics"))
            }
            Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => return Err(interrupted()),
            Err(RecvTimeoutError::Timeout) => {}
        }
    }
}

fn interrupted() -> Stop {
    Stop { exit: Exit::Interrupted, diagnostics: vec![Diagnostic::error("interrupted", "interrupted")] }
}

/// The cache, opened. What cannot be used at all is exit 4.
pub fn store(place: &Place) -> Result<Store, Stop> {
    let wait = &mut Wait { tell: &mut tell_waiting, stop: &stop_on_ctrl_c() };
    Store::open_after(&place.cache, wait).map_err(|error| unusable(place, &error))
}

/// The same, when no run is at work in it; those that start wait.
pub fn store_alone(place: &Place) -> Result<Store, Stop> {
    let wait = &mut Wait { tell: &mut tell_waiting, stop: &stop_on_ctrl_c() };
    Store::open_alone(&place.cache, wait).map_err(|error| match is_read_only(&error) {
        true => {
            let message = format!("the cache `{}` cannot be written: {error}", place.cache.display());
            Diagnostic::error("cache", message).into()
        }
        false => unusable(place, &error),
    })
}

fn tell_waiting(on: i32) {
    let on = if on > 0 { format!("process {on}") } else { "another process".to_string() };
    super::say_aside(&format!("cache: waiting for {on}\n"));
}

/// The cache, for commands that only look: they make none.
pub fn look(place: &Place) -> Result<Store, Stop> {
    Store::look(&place.cache).map_err(|error| unusable(place, &error))
}

fn unusable(place: &Place, error: &std::io::Error) -> Stop {
    if error.kind() == std::io::ErrorKind::Interrupted {
        return interrupted();
    }
    let message = format!("cannot use the cache `{}`: {error}", place.cache.display());
    Stop { exit: Exit::Damaged, diagnostics: vec![Diagnostic::error("cache", message)] }
}

/// Runs what is missing of some nodes, for a command that wants their results; publishes nothing. `lost`: objects that it
/// found damaged.
pub fn run_silently(
    graph: &Arc<Graph>,
    only: &[usize],
    globals: &Globals,
    place: &Place,
    lost: &BTreeSet<Digest>,
) -> run::Outcome {
    let mut options = options(globals, place);
    options.out = None;
    options.lost = lost.clone();
    let mut teller = Teller::new(globals);
    run::run(graph, only, &options, &mut |event| teller.hear(event))
}

/// Why a run did not give what was wanted.
pub fn failure(outcome: &run::Outcome, exit: Exit) -> Stop {
    let mut diagnostics = outcome.diagnostics();
    if outcome.interrupted {
        diagnostics.push(Diagnostic::error("interrupted", "interrupted"));
    }
    Stop { exit, diagnostics }
}

/// Writes a file that the user named: whole, or not at all, also where Ctrl-C comes meanwhile.
pub fn write_file(path: &Path, bytes: Vec<u8>) -> Result<(), Stop> {
    let wrong = |e: std::io::Error| {
        let message = format!("cannot write `{}`: {e}", path.display());
        Stop { exit: Exit::Failed, diagnostics: vec![Diagnostic::error("cannot-write", message)] }
    };
    if path.exists() && !path.is_file() {
        let pipe = path.to_path_buf(); // or a device
        return unless_interrupted(move || std::fs::write(pipe, bytes))?.map_err(wrong);
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // Whoever leaves removes it, although another writes to it.
    let file = tempfile::Builder::new().permissions(open_to_all()).tempfile_in(folder).map_err(wrong)?;
    let mut writer = file.reopen().map_err(wrong)?;
    unless_interrupted(move || std::io::Write::write_all(&mut writer, &bytes))?.map_err(wrong)?;
    if stop_on_ctrl_c().load(Ordering::Relaxed) {
        return Err(interrupted());
    }
    file.persist(path).map(drop).map_err(|e| wrong(e.error))
}

/// As any new file: the umask takes off what should not be.
fn open_to_all() -> std::fs::Permissions {
    std::os::unix::fs::PermissionsExt::from_mode(0o666)
}
