//! What lies in an output folder, and what a killed run may have put there: noted in the cache, a state a pipeline and
//! folder.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

use super::codec::{Reader, Writer};
use super::stamp::{Stamp, boot};
use super::store::Store;
use crate::digest::Digest;
use crate::graph::Graph;

/// A published file, as it is after the run.
#[derive(Clone, Debug, Default)]
pub struct Published {
    /// Below the output folder.
    pub path: String,
    pub digest: Digest,
    pub bytes: u64,
    /// By this run.
    pub written: bool,
    pub stamp: Stamp,
    /// The node that made it.
    pub node: String,
}

const TAG: &str = "lodge published 4";

/// Not touched where nothing changed: plans depend on it.
pub fn note(store: &Store, name: &str, bytes: &[u8]) {
    if bytes != store.get_state("published", name)
        && let Err(error) = store.put_state("published", name, bytes)
    {
        tracing::debug!(%error, "cannot note what was published");
    }
}

pub fn state_name(graph: &Graph, out: &Path) -> String {
    name_of(&graph.file.to_string_lossy(), &absolute(out).to_string_lossy())
}

fn name_of(file: &str, out: &str) -> String {
    let mut name = Writer::default();
    name.text(file);
    name.text(out);
    Digest::of(&name.0).short(16)
}

/// Without links, as far as there are folders.
fn absolute(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let real = |at: &Path| Some(fs::canonicalize(at).ok()?.join(path.strip_prefix(at).ok()?));
    // Joining nothing would add a slash.
    path.ancestors().find_map(real).map_or(path.clone(), |p| p.components().collect())
}

/// What the last runs published here, and what runs that were killed may have. A damaged state is none: then nothing
/// is removed, and everything read.
pub struct State {
    pub before: BTreeMap<String, Published>,
    pub planned: Vec<Published>,
}

impl State {
    pub fn read(store: &Store, name: &str) -> Self {
        let all = parse(&store.get_state("published", name), name).map_or(Vec::new(), |state| state.files);
        let (planned, before): (Vec<_>, Vec<_>) = all.into_iter().partition(|(_, planned)| *planned);
        let before = before.into_iter().map(|(p, _)| (p.path.clone(), p)).collect();
        Self { before, planned: planned.into_iter().map(|(p, _)| p).collect() }
    }
}

/// A pipeline's file, an output folder of it, and what lies there.
pub struct Folder {
    pub pipeline: PathBuf,
    pub out: PathBuf,
    /// True beside what a run was about to write.
    pub files: Vec<(Published, bool)>,
}

/// Relative, and never upwards.
pub fn is_below(path: &str) -> bool {
    let path = Path::new(path);
    path.components().next().is_some() && path.components().all(|c| matches!(c, Component::Normal(_)))
}

/// The state of this name, if it is whole, and tells of nothing outside its folder.
pub fn parse(bytes: &[u8], name: &str) -> Option<Folder> {
    let mut from = Reader::unseal(bytes, TAG)?;
    // A reboot may have lost what was written without waiting for the disk.
    let same_boot = from.text()? == boot();
    let (pipeline, out) = (from.text()?, from.text()?);
    if name_of(pipeline, out) != name {
        return None;
    }
    let files = from.list(|f| {
        let (path, node) = (f.text()?.to_string(), f.text()?.to_string());
        let (digest, bytes, stamp) = (f.digest()?, f.u64()?, Stamp::read(f)?);
        let stamp = if same_boot { stamp } else { Stamp::default() };
        is_below(&path).then_some(())?;
        Some((Published { path, digest, bytes, written: false, stamp, node }, f.u32()? != 0))
    })?;
    Some(Folder { pipeline: pipeline.into(), out: out.into(), files })
}

/// Every output folder that this cache knows, with the name of its state.
pub fn all(store: &Store) -> Vec<(String, Folder)> {
    let entries = fs::read_dir(store.state("published", "")).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
    names.sort();
    names.into_iter().filter_map(|n| Some((n.clone(), parse(&store.get_state("published", &n), &n)?))).collect()
}

pub fn write_state<'a>(
    graph: &Graph,
    folder: &Path,
    all: &BTreeMap<&str, &'a Published>,
    planned: impl Iterator<Item = &'a Published>,
) -> Vec<u8> {
    let planned: BTreeMap<(&str, &Digest), &Published> = planned.map(|p| ((&*p.path, &p.digest), p)).collect();
    let mut out = Writer::default();
    out.text(&boot());
    out.text(&graph.file.to_string_lossy());
    out.text(&absolute(folder).to_string_lossy());
    out.u32((all.len() + planned.len()) as u32);
    let files = all.values().map(|&p| (p, 0)).chain(planned.values().map(|&p| (p, 1)));
    for (file, planned) in files {
        out.text(&file.path);
        out.text(&file.node);
        out.digest(&file.digest);
        out.u64(file.bytes);
        file.stamp.write(&mut out);
        out.u32(planned);
    }
    out.sealed(TAG)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_state_of_one_folder_is_not_that_of_another() {
        let graph = Graph {
            name: "p".into(),
            file: "/p.toml".into(),
            texts: Vec::new(),
            description: String::new(),
            nodes: Vec::new(),
        };
        let file = Published { path: "a".into(), digest: Digest::of(b"a"), ..Published::default() };
        // A folder that is not there yet is called as it will be.
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink(folder.path(), folder.path().join("link")).unwrap();
        let out = folder.path().join("link/out");
        let name = state_name(&graph, &out);
        fs::create_dir(&out).unwrap();
        assert_eq!(state_name(&graph, &out), name);
        let bytes = write_state(&graph, &out, &[("a", &file)].into(), std::iter::empty());
        assert_eq!(parse(&bytes, &name).unwrap().files.len(), 1);
        assert!(parse(&bytes, &state_name(&graph, folder.path())).is_none());

        // Before the machine was started again the file was as noted; now it has to be read.
        let stamp = Stamp::of_folder(folder.path()).unwrap();
        for (since, known) in [(boot(), true), ("another time".to_string(), false)] {
            let mut note = Writer::default();
            [&since, "/p.toml", &absolute(&out).to_string_lossy()].iter().for_each(|text| note.text(text));
            note.u32(1);
            ["a", "node"].iter().for_each(|text| note.text(text));
            note.digest(&file.digest);
            note.u64(1);
            stamp.write(&mut note);
            note.u32(0);
            let found = parse(&note.sealed(TAG), &name).unwrap().files;
            assert_eq!(found[0].0.stamp.same(&stamp), known, "{since}");
        }
    }
}
