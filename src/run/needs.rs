//! Which results and objects the last runs of all pipelines need. A pipeline whose file is gone needs nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::executor::decode;
use super::record::Record;
use super::store::Store;
use super::{last, published};
use crate::digest::Digest;

#[derive(Default)]
pub struct Needs {
    /// Keys.
    pub results: BTreeSet<Digest>,
    pub objects: BTreeSet<Digest>,
    /// Digests of the files that they were read from.
    pub files: BTreeSet<Digest>,
    /// Keys that last runs had and that have no result here, or none that is whole.
    pub missing: BTreeSet<Digest>,
    /// What goes with the pipelines: state files as folder and name.
    pub idle: Vec<(&'static str, String)>,
    /// Files of pipelines that are gone.
    pub gone: BTreeSet<PathBuf>,
}

impl Needs {
    pub fn of(store: &Store) -> Self {
        let mut needs = Self::default();
        for (name, run) in last::all(store) {
            if is_gone(&run.file) {
                needs.idle.push(("runs", name));
                needs.gone.insert(run.file);
                continue;
            }
            for last in run.nodes.values() {
                needs.add(store, &last.key);
            }
        }
        for (name, folder) in published::all(store) {
            if is_gone(&folder.pipeline) {
                needs.idle.push(("published", name));
                needs.gone.insert(folder.pipeline);
            } else {
                needs.objects.extend(folder.files.iter().filter(|f| !f.1).map(|f| f.0.digest));
            }
        }
        needs
    }

    /// A result and all that belongs to it.
    pub fn add(&mut self, store: &Store, key: &Digest) {
        if self.results.contains(key) {
            return;
        }
        match store.lookup(key) {
            Some(record) => self.keep(*key, &record, objects_of(store, &record)),
            None => _ = self.missing.insert(*key),
        }
    }

    /// The same of a record and its objects.
    pub fn keep(&mut self, key: Digest, record: &Record, objects: impl IntoIterator<Item = Digest>) {
        let files = record.lines.iter().filter(|(name, _)| name.starts_with("file."));
        self.files.extend(files.filter_map(|(_, digest)| Digest::parse(digest)));
        self.objects.extend(objects);
        self.results.insert(key);
    }
}

/// What a result consists of: the artifact, its notes, its blobs.
pub fn objects_of(store: &Store, record: &Record) -> Vec<Digest> {
    let mut out = vec![record.digest];
    out.extend(record.notes);
    // Others are large, and have none.
    if record.kind == "Files" || record.blob_bytes > 0 {
        let artifact = decode(store, &record.kind, &record.digest);
        out.extend(artifact.iter().flat_map(|a| a.blobs()).map(|b| b.digest));
    }
    out
}

/// Not where it only cannot be looked at.
pub fn is_gone(file: &Path) -> bool {
    fs::symlink_metadata(file).is_err_and(|e| e.kind() == io::ErrorKind::NotFound)
}

/// Sizes of objects with a file of their own, by digest.
pub fn large_objects(store: &Store) -> BTreeMap<Digest, (PathBuf, u64)> {
    let mut out = BTreeMap::new();
    for folder in fs::read_dir(store.state("objects", "")).into_iter().flatten().flatten() {
        let Some(two) = folder.file_name().into_string().ok().filter(|n| n.len() == 2) else { continue };
        if !folder.file_type().is_ok_and(|t| t.is_dir()) {
            continue;
        }
        for file in fs::read_dir(folder.path()).into_iter().flatten().flatten() {
            let digest = file.file_name().to_str().and_then(|rest| Digest::parse(&format!("{two}{rest}")));
            if let Some(digest) = digest
                && let Ok(meta) = file.metadata()
                && !meta.is_dir()
            {
                out.insert(digest, (file.path(), meta.len()));
            }
        }
    }
    out
}
