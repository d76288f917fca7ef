//! What the commands that run something share: where cache and outputs lie, which nodes are meant, Ctrl-C.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use super::{Exit, Globals, Stop};
use crate::diag::Diagnostic;
use crate::graph::Graph;
use crate::run::Options;

/// Cache folder and output folder of a pipeline file.
pub struct Place {
    pub cache: PathBuf,
    /// With the pipeline's name.
    pub out: PathBuf,
}

impl Place {
    pub fn of(globals: &Globals, file: &Path) -> Self {
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
        let name = file.file_stem().map_or_else(|| "pipeline".into(), |s| s.to_os_string());
        Self { cache, out: out.join(name) }
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
    options.stop = stop_on_ctrl_c();
    options
}

pub fn jobs(globals: &Globals) -> usize {
    globals.jobs.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, |n| n.get()))
}

/// Ctrl-C once: stop soon, keep what is finished. Twice: at once.
fn stop_on_ctrl_c() -> Arc<AtomicBool> {
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
        let before = out.len();
        out.extend((0..graph.nodes.len()).filter(|&n| graph.nodes[n].name == *name || graph.nodes[n].base == *name));
        if out.len() == before {
            let all = graph.nodes.iter().flat_map(|n| [&*n.name, &*n.base]);
            let near = all.map(|n| (strsim::damerau_levenshtein(n, name), n)).min();
            let mut error = Diagnostic::error("unknown-node", format!("`{}` has no node `{name}`", graph.name));
            if let Some((distance, near)) = near
                && distance <= 1 + name.len() / 3
            {
                error = error.help(format!("did you mean `{near}`?"));
            }
            wrong.push(error.value(name));
        }
    }
    out.sort_unstable();
    out.dedup();
    if wrong.is_empty() { Ok(out) } else { Err(wrong.into()) }
}

/// The one node that a name means.
#[allow(dead_code)] // for `show`, `why` and `export`, which follow
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
