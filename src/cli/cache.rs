//! `lodge cache stat`, `lodge cache verify` and `lodge cache gc`.

use std::path::PathBuf;
use std::time::Duration;

use serde_json::json;

use super::engine::{self, Place};
use super::run::size;
use super::{Exit, Globals, Outcome, Set, Stop};
use crate::diag::Diagnostic;
use crate::graph::Graph;
use crate::run::{forecast, gc, verify};

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
    /// Remove what no pipeline's last run needs, nor FILE with --set
    Gc(Gc),
}

#[derive(clap::Args)]
struct At {
    /// A pipeline file or folder of the project [default: the working folder]
    file: Option<PathBuf>,
    #[command(flatten)]
    set: Set,
}

#[derive(clap::Args)]
struct Gc {
    #[command(flatten)]
    at: At,
    /// Keep other results, too, if they are younger: 12h, 30d
    #[arg(long, value_name = "AGE", value_parser = age)]
    max_age: Option<Duration>,
    /// Keep other results, too, the newest, until the cache has this size: 20G
    #[arg(long, value_name = "BYTES", value_parser = super::bytes)]
    max_size: Option<u64>,
    /// Only tell what would go
    #[arg(long)]
    dry_run: bool,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        match self.what {
            What::Stat(at) => at.graph().and_then(|_| stat(&at.place(globals), globals)),
            What::Verify(at) => at.graph().and_then(|_| check(&at.place(globals), globals)),
            What::Gc(gc) => gc.run(globals),
        }
    }
}

impl At {
    fn place(&self, globals: &Globals) -> Place {
        let here = self.file.clone().unwrap_or_else(|| PathBuf::from("."));
        // A folder stands for a pipeline in it.
        Place::of(globals, &if here.is_dir() { here.canonicalize().unwrap_or(here).join("any.toml") } else { here })
    }

    /// The pipeline as it is with other settings; none without any: then FILE, broken or not, only says where the cache is.
    fn graph(&self) -> Result<Option<Graph>, Stop> {
        match &self.file {
            Some(file) if !file.is_dir() => {
                let graph = || Graph::load(file, &self.set.sets, &crate::ops::ALL);
                Ok(if self.set.sets.is_empty() { None } else { Some(graph()?) })
            }
            _ => self.set.of_no_file().map(|()| None),
        }
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

fn exists(place: &Place) -> Result<(), Stop> {
    let message = || format!("there is no cache at `{}`", place.cache.display());
    if place.cache.exists() { Ok(()) } else { Err(Stop::usage(Diagnostic::error("no-cache", message()))) }
}

impl Gc {
    fn run(self, globals: &Globals) -> Outcome {
        let (place, graph) = (self.at.place(globals), self.at.graph()?);
        exists(&place)?;
        let store = if self.dry_run { engine::look(&place)? } else { engine::store_alone(&place)? };
        let keys = graph.map_or(Vec::new(), |graph| forecast::cached(&graph, &store));
        let wish = gc::Wish { keys, age: self.max_age, size: self.max_size };
        let swept = gc::gc(&store, &wish, self.dry_run, &engine::stop_on_ctrl_c()).map_err(|error| {
            let message = format!("cannot clear the cache `{}`: {error}", place.cache.display());
            Stop { exit: Exit::Failed, diagnostics: vec![Diagnostic::error("cannot-clear", message)] }
        })?;
        let exit = if swept.interrupted { Exit::Interrupted } else { Exit::Done };
        if globals.json {
            super::print(&json!({"ok": exit == Exit::Done, "cache": place.cache, "dry_run": self.dry_run,
                "removed_results": swept.results, "removed_objects": swept.objects, "removed_plans": swept.plans,
                "removed_stamps": swept.stamps,
                "gone": swept.gone, "bytes_before": swept.before, "bytes": swept.after, "needed_bytes": swept.needed}));
            return Ok(exit);
        }
        let would = if self.dry_run { "would remove" } else { "removed" };
        let mut out: String =
            swept.gone.iter().map(|f| format!("{} is gone: its last run needs nothing\n", f.display())).collect();
        out += &format!(
            "{would} {} results and {} objects: {} -> {}, of which the last runs need {}\n",
            swept.results,
            swept.objects,
            size(swept.before),
            size(swept.after),
            size(swept.needed)
        );
        super::say(&out);
        Ok(exit)
    }
}

/// `90s`, `15m`, `12h`, `30d`, `8w`.
fn age(text: &str) -> Result<Duration, String> {
    let expected = || "expected an age, as 12h or 30d".to_string();
    let unit = match text.chars().last() {
        Some('s') => 1,
        Some('m') => 60,
        Some('h') => 3600,
        Some('d') => 86_400,
        Some('w') => 7 * 86_400,
        _ => return Err(expected()),
    };
    let number: f64 = text[..text.len() - 1].parse().map_err(|_| expected())?;
    let seconds = number * f64::from(unit);
    if (0.0..1e10).contains(&seconds) { Ok(Duration::from_secs_f64(seconds)) } else { Err(expected()) }
}

fn check(place: &Place, globals: &Globals) -> Outcome {
    let jobs = engine::jobs(globals);
    let _ = rayon::ThreadPoolBuilder::new().num_threads(jobs).build_global();
    exists(place)?;
    let store = engine::store(place)?;
    let found = engine::unless_interrupted(move || verify::verify(&store))?;
    let exit = if found.unrepaired.is_empty() { Exit::Done } else { Exit::Damaged };
    if globals.json {
        super::print(&json!({"ok": exit == Exit::Done, "cache": place.cache, "checked": found.checked,
            "checked_bytes": found.bytes, "repaired": found.repaired, "evicted": found.evicted,
            "missing": found.missing, "foreign": found.foreign, "changed": found.changed, "unrepaired": found.unrepaired}));
        return Ok(exit);
    }
    let mut out = String::new();
    let lists = [
        ("repaired", &found.repaired),
        ("evicted", &found.evicted),
        ("missing, and computed again when wanted", &found.missing),
        ("changed or gone since it was published", &found.changed),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_have_units() {
        assert_eq!(age("90s"), Ok(Duration::from_secs(90)));
        assert_eq!(age("1.5h"), Ok(Duration::from_secs(5400)));
        assert_eq!(age("30d"), Ok(Duration::from_secs(30 * 86_400)));
        for bad in ["", "d", "3", "-1d", "nand", "1e99w", "3y", "30 d", "3ä"] {
            assert!(age(bad).is_err(), "{bad}");
        }
    }
}
