//! `lodge export FILE NODE -o PATH`: a result in an open format, chosen by the extension. Runs what is missing.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::json;

use super::engine::{self, Place};
use super::{Globals, Outcome, Stop, Target};
use crate::artifact::{
    AnyArtifact, Artifact, Buildings, Dendrogram, Footprints, Hulls, Impostors, Landmarks, Lines, Mesh,
};
use crate::diag::{Diagnostic, Note, Result};
use crate::io::{cityjson, csv, geojson, gltf, svg, views};
use crate::run::executor::decode;
use crate::run::record::Record;
use crate::run::store::Store;

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    target: Target,
    /// Node, or one variant of it
    node: String,
    /// Where to; the extension chooses the format
    #[arg(short, long, value_name = "PATH")]
    output: PathBuf,
    /// Features that the node left out, as a table
    #[arg(long)]
    rejects: bool,
}

/// A way to write a kind.
struct Format {
    kind: &'static str,
    extension: &'static str,
    write: fn(&dyn AnyArtifact) -> Result<Vec<u8>>,
}

macro_rules! formats {
    ($($kind:ident $extension:literal $write:path,)*) => {
        /// Every open format, by kind.
        static FORMATS: &[Format] = &[$(Format {
            kind: $kind::KIND.name,
            extension: $extension,
            write: |any| $write(any.as_any().downcast_ref::<$kind>().expect("chosen by kind")),
        }),*];
    };
}

formats! {
    Buildings ".city.jsonl" cityjson::buildings,
    Dendrogram ".csv" csv::dendrogram,
    Footprints ".geojson" geojson::footprints,
    Footprints ".svg" svg::footprints,
    Hulls ".geojson" geojson::hulls,
    Hulls ".svg" svg::hulls,
    Impostors ".glb" gltf::impostors::glb,
    Impostors ".png" views::impostors,
    Landmarks ".csv" csv::landmarks,
    Lines ".geojson" geojson::lines,
    Lines ".svg" svg::lines,
    Mesh ".glb" gltf::mesh,
    Mesh ".png" views::sheet,
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let graph = Arc::new(self.target.load()?);
        let asked = engine::pick_one(&graph, &self.node)?;
        let kind = graph.nodes[asked].entry.output.name;
        let write = if self.rejects { None } else { Some(choose(kind, &self.output)?) };
        let place = Place::of(globals, &self.target.file);
        let mut passes = 0;
        loop {
            let outcome = engine::run_silently(&graph, &[asked], globals, &place);
            let exit = super::run::exit(&outcome);
            let done = outcome.nodes.iter().find(|n| n.index == asked).and_then(|n| n.record.clone());
            let Some(record) = done else { return Err(engine::failure(&outcome, exit)) };
            let store = engine::store(&place)?;
            let bytes = match write {
                Some(write) => decode(&store, &record.kind, &record.digest).map(|artifact| write(&*artifact)),
                None => rejects(&store, &record).map(|notes| Ok(csv::rejects(&notes))),
            };
            match bytes {
                Some(bytes) => {
                    let bytes = bytes?;
                    engine::write_file(&self.output, &bytes)?;
                    if globals.json {
                        let path = self.output.display().to_string();
                        super::print(&json!({"ok": true, "node": self.node, "path": path, "bytes": bytes.len()}));
                    }
                    return Ok(exit);
                }
                // The object is lost, and deleted now: a run makes it again.
                None if passes < 3 => passes += 1,
                None => {
                    let what = format!("the result of `{}` cannot be read from the cache", self.node);
                    return Err(Stop {
                        exit: super::Exit::Damaged,
                        diagnostics: vec![Diagnostic::error("cache", what)],
                    });
                }
            }
        }
    }
}

fn choose(kind: &str, path: &Path) -> Result<fn(&dyn AnyArtifact) -> Result<Vec<u8>>, Stop> {
    let name = path.file_name().map_or(String::new(), |n| n.to_string_lossy().to_lowercase());
    let fits = |f: &&Format| f.kind == kind && name.ends_with(f.extension);
    if let Some(format) = FORMATS.iter().find(fits) {
        return Ok(format.write);
    }
    let known: Vec<_> = FORMATS.iter().filter(|f| f.kind == kind).map(|f| format!("`{}`", f.extension)).collect();
    let error = Diagnostic::error("no-format", format!("{kind} cannot be exported as `{}`", path.display()));
    let help = match known.is_empty() {
        true => format!("there is no open format for {kind}; `lodge show` gives its summary"),
        false => format!("it can be exported as {}", known.join(", ")),
    };
    Err(Stop::usage(error.help(help)))
}

fn rejects(store: &Store, record: &Record) -> Option<Vec<Note>> {
    let Some(notes) = &record.notes else { return Some(Vec::new()) };
    let mut all: serde_json::Value = serde_json::from_slice(&store.get(notes)?).ok()?;
    serde_json::from_value(all["rejects"].take()).ok()
}
