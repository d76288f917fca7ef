//! `lodge export FILE NODE -o PATH`: a result in an open format, chosen by the extension. Runs what is missing.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::json;

use super::engine::{self, Place};
use super::{Globals, Outcome, Stop, Target};
use crate::artifact::{
    AnyArtifact, Artifact, Buildings, Dendrogram, Footprints, Hulls, Impostors, Landmarks, Lines, Mesh, PlaneTiles,
    Voxels,
};
use crate::diag::{Diagnostic, Note, Result};
use crate::io::gltf::Written;
use crate::io::picture::Level;
use crate::io::{cityjson, csv, geojson, gltf, mesh, plane_tiles, svg, views, voxels};
use crate::run::executor::decode;
use crate::run::record::Record;
use crate::run::store::Store;

#[derive(clap::Args)]
#[command(after_help = known_formats())]
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
    write: Write,
}

type Write = fn(&dyn AnyArtifact) -> Result<Written>;

macro_rules! formats {
    ($($kind:ident $extension:literal $write:path,)*) => {
        /// Every open format, by kind.
        static FORMATS: &[Format] = &[$(Format {
            kind: $kind::KIND.name,
            extension: $extension,
            write: |any| $write(any.as_any().downcast_ref::<$kind>().expect("chosen by kind")).map(Written::from),
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
    Impostors ".glb" impostor_glb,
    Impostors ".png" impostor_sheet,
    Landmarks ".csv" csv::landmarks,
    Lines ".geojson" geojson::lines,
    Lines ".svg" svg::lines,
    Mesh ".glb" gltf::mesh,
    Mesh ".obj" mesh::write::obj,
    Mesh ".ply" mesh::write::ply,
    Mesh ".png" mesh_sheet,
    PlaneTiles ".glb" plane_tiles::glb,
    PlaneTiles ".json" plane_tiles::json,
    PlaneTiles ".png" tile_sheet,
    Voxels ".json" voxels::json,
    Voxels ".npy" voxels::npy,
}

fn impostor_glb(of: &Impostors) -> Result<Vec<u8>> {
    gltf::impostors::glb(of, gltf::impostors::Packing::Png)
}

fn impostor_sheet(of: &Impostors) -> Result<Vec<u8>> {
    views::impostors(of).and_then(packed)
}

fn mesh_sheet(of: &Mesh) -> Result<Vec<u8>> {
    views::sheet(of).and_then(packed)
}

fn tile_sheet(of: &PlaneTiles) -> Result<Vec<u8>> {
    plane_tiles::sheet(of).and_then(packed)
}

/// Pictures that people keep are packed as well as one can.
fn packed(png: Vec<u8>) -> Result<Vec<u8>> {
    let small =
        Level::decode(&png).map_err(|why| Diagnostic::error("bad-picture", format!("the picture {why}")))?.small_png();
    Ok(if small.len() < png.len() { small } else { png })
}

/// A line for each kind, for `--help`.
fn known_formats() -> String {
    let mut out = String::from("Formats, by the kind of the node's result (`lodge ops` names it):\n");
    for group in FORMATS.chunk_by(|a, b| a.kind == b.kind) {
        let all: Vec<&str> = group.iter().map(|f| f.extension).collect();
        out += &format!("  {:12}{}\n", group[0].kind, all.join(", "));
    }
    out
}

impl Args {
    pub fn run(self, globals: &Globals) -> Outcome {
        let graph = Arc::new(self.target.load()?);
        let asked = engine::pick_one(&graph, &self.node)?;
        let kind = graph.nodes[asked].entry.output.name;
        let write = if self.rejects { None } else { Some(choose(kind, &self.output)?) };
        let place = Place::of(globals, &self.target.file);
        let mut passes = 0;
        let mut lost = BTreeSet::new();
        loop {
            let outcome = engine::run_silently(&graph, &[asked], globals, &place, &lost);
            let exit = super::run::exit(&outcome);
            let done = outcome.nodes.iter().find(|n| n.index == asked).and_then(|n| n.record.clone());
            let Some(record) = done else { return Err(engine::failure(&outcome, exit)) };
            let store = Arc::new(engine::store(&place)?);
            let (from, of) = (store.clone(), record.clone());
            let written = engine::unless_interrupted(move || match write {
                Some(write) => decode(&from, &of.kind, &of.digest).map(|artifact| write(&*artifact)),
                None => rejects(&from, &of).map(|notes| Ok(csv::rejects(&notes).into())),
            });
            let written = written.inspect_err(|_| store.close())?;
            match written {
                Some(written) => {
                    let Written { bytes, told } = written?;
                    told.iter().for_each(|sentence| super::warn(sentence));
                    let size = bytes.len();
                    engine::write_file(&self.output, bytes)?;
                    if globals.json {
                        let path = self.output.display().to_string();
                        super::print(&json!({"ok": true, "node": self.node, "path": path, "bytes": size}));
                    }
                    return Ok(exit);
                }
                // The object is lost: a run makes it again.
                None if passes < 3 => {
                    passes += 1;
                    lost.extend([record.digest].into_iter().chain(record.notes));
                    store.trouble().iter().for_each(|line| super::warn(line));
                }
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

fn choose(kind: &str, path: &Path) -> Result<Write, Stop> {
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
