//! Files: named blobs, ready to be published.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{Artifact, Kind};
use crate::digest::Digest;

/// Bytes kept under their digest, outside the artifact itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Blob {
    pub digest: Digest,
    pub bytes: u64,
}

/// One file below the output folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct File {
    /// Below the output folder (so with the writer's own `path`); `/` between parts, without `..`.
    pub path: String,
    pub blob: Blob,
    /// Published after the files that it names (`tileset.json`).
    pub last: bool,
}

crate::json_field!(Vec<File>);

/// `name` below `path` as a person may write it: `tiles/`, `a//b`, `./x`.
pub fn below(path: &str, name: &str) -> String {
    let parts = path.split('/').chain(name.split('/')).filter(|p| !p.is_empty() && *p != ".");
    parts.collect::<Vec<_>>().join("/")
}

crate::columns! {
    /// Files sorted by path. Their bytes lie in the store as objects of their own.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct Files {
        pub files: Vec<File>,
    }
}

impl Artifact for Files {
    const KIND: &'static Kind = &Kind::of::<Self>("Files", "named files, ready to be published")
        .keys(&[("files", "number of files"), ("file_bytes", "their sizes together")]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut out = Map::new();
        out.insert("files".into(), json!(self.files.len()));
        out.insert("file_bytes".into(), json!(self.files.iter().map(|f| f.blob.bytes).sum::<u64>()));
        out
    }
    fn blobs(&self) -> Vec<super::Blob> {
        self.files.iter().map(|f| f.blob).collect()
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn paths_as_people_write_them() {
        assert_eq!(super::below("./tiles//a/", "tileset.json"), "tiles/a/tileset.json");
        assert_eq!(super::below("roof.glb", ""), "roof.glb");
    }
}
