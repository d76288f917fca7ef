//! `lodge cache stat` and `lodge cache verify`.

use std::path::PathBuf;

use serde_json::json;

use super::engine::{self, Place};
use super::run::size;
use super::{Exit, Globals, Outcome, Stop};
use crate::diag::Diagnostic;
use crate::run::verify;

#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Size of the cache
    Stat(At),
    /// Read everything in the cache and all published files; repair or evict what is damaged
    Verify(At),
}

#[derive(clap::Args)]
struct At {
    /// A pipeline file or folder of the project [default: the working folder]
    file: Option<PathBuf>,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        match self.what {
            What::Stat(at) => stat(&at.place(globals), globals),
            What::Verify(at) => check(&at.place(globals), globals),
        }
    }
}

impl At {
    fn place(&self, globals: &Globals) -> Place {
        let here = self.file.clone().unwrap_or_else(|| PathBuf::from("."));
        // A folder stands for a pipeline in it.
        Place::of(globals, &if here.is_dir() { here.canonicalize().unwrap_or(here).join("any.toml") } else { here })
    }
}

fn stat(place: &Place, globals: &Globals) -> Outcome {
    let found = verify::stat(&place.cache);
    if globals.json {
        super::print(&json!({"cache": place.cache, "objects": found.objects, "object_bytes": found.object_bytes,
            "packs": found.packs, "pack_bytes": found.pack_bytes, "packed_objects": found.packed_objects,
            "results": found.results,
            "other_bytes": found.other_bytes, "bytes": found.bytes()}));
        return Ok(Exit::Done);
    }
    super::say(&format!(
        "{}\n  {} results\n  {} large objects, {}\n  {} packs of results and {} objects, {}\n  other, {}\n  together {}\n",
        place.cache.display(),
        found.results,
        found.objects,
        size(found.object_bytes),
        found.packs,
        found.packed_objects,
        size(found.pack_bytes),
        size(found.other_bytes),
        size(found.bytes())
    ));
    Ok(Exit::Done)
}

fn check(place: &Place, globals: &Globals) -> Outcome {
    let jobs = engine::jobs(globals);
    let _ = rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global();
    if !place.cache.exists() {
        let message = format!("there is no cache at `{}`", place.cache.display());
        return Err(Stop::usage(Diagnostic::error("no-cache", message)));
    }
    let found = verify::verify(&engine::store(place)?);
    let exit = if found.unrepaired.is_empty() { Exit::Done } else { Exit::Damaged };
    if globals.json {
        super::print(&json!({"ok": exit == Exit::Done, "cache": place.cache, "checked": found.checked,
            "checked_bytes": found.bytes, "repaired": found.repaired, "evicted": found.evicted,
            "foreign": found.foreign, "changed": found.changed, "unrepaired": found.unrepaired}));
        return Ok(exit);
    }
    let mut out = String::new();
    let lists = [
        ("repaired", &found.repaired),
        ("evicted", &found.evicted),
        ("changed since it was published", &found.changed),
        ("foreign, left alone", &found.foreign),
        ("damaged, and cannot be repaired", &found.unrepaired),
    ];
    for (word, all) in lists {
        all.iter().for_each(|line| out += &format!("{word}: {line}\n"));
    }
    let (checked, bytes) = (found.checked, size(found.bytes));
    let verdict = if found.is_clean() { "nothing damaged" } else { "see above" };
    super::say(&format!("{out}{checked} files and records, {bytes}: {verdict}\n"));
    Ok(exit)
}
