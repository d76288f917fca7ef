//! A stage's summary against its `.snap` file: `snapshots/<pipeline>__<node>.snap` beside the pipeline.
//!
//! The files are insta's (`file`), the text is ours (`text`). Numbers within the node's tolerance are the same text:
//! the old one stays, only the digest beside it is kept up to date. What differs or is new lies as `.snap.new`
//! beside its file until it is accepted or rejected, by us or by `cargo insta review`.

mod file;
mod text;

use std::io;
use std::path::{Path, PathBuf};

use serde_json::{Map, Value};

use crate::digest::Digest;
use crate::graph::{Graph, Node};
pub use file::Snap;
pub use text::stage_text;

/// How to compare.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rules {
    /// Digests, not texts.
    pub exact: bool,
    /// Nothing is written (in CI).
    pub read_only: bool,
}

/// What a comparison came to.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Equal, or within the tolerance.
    Same,
    /// There is no snapshot yet.
    New { text: String },
    /// Text and text; equal where only the digests were compared and differ.
    Differs { old: String, new: String },
    /// There is one, and it cannot be read.
    Unreadable { why: String },
}

/// What a snapshot shows of a node's result.
#[derive(Clone, Copy, Debug)]
pub struct Stage<'a> {
    pub kind: &'a str,
    pub digest: Digest,
    /// The artifact's frame as JSON, or null.
    pub frame: &'a Value,
    pub summary: &'a Map<String, Value>,
    pub warnings: &'a [String],
}

/// Compares the stage of `node` with its file. Beside the verdict, whether what it asks for could be written.
pub fn check(graph: &Graph, node: &Node, stage: &Stage, rules: Rules) -> (Verdict, io::Result<()>) {
    let new = snap(graph, node, stage);
    let path = path(graph, &node.name);
    let pending = pending_of(&path);
    let old = match read(&path) {
        Ok(Some(old)) => old,
        Ok(None) => {
            let written = write(&pending, &new, rules);
            return (Verdict::New { text: new.contents }, written);
        }
        Err(e) => return (Verdict::Unreadable { why: e.to_string() }, Ok(())),
    };
    let same = if rules.exact || node.snapshot.exact {
        old.info("digest") == new.info("digest")
    } else {
        text::same(&old.contents, &new.contents, node.snapshot.abs, node.snapshot.rel)
    };
    if !same {
        let written = write(&pending, &new, rules);
        return (Verdict::Differs { old: old.contents, new: new.contents }, written);
    }
    let kept = Snap { contents: old.contents.clone(), ..new };
    let mut written = if kept != old { write(&path, &kept, rules) } else { Ok(()) };
    if !rules.read_only && pending.exists() {
        written = written.and(std::fs::remove_file(&pending));
    }
    (Verdict::Same, written)
}

fn snap(graph: &Graph, node: &Node, stage: &Stage) -> Snap {
    let file = graph.file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let info = [
        ("node", node.name.clone()),
        ("op", node.entry.name.to_string()),
        ("version", node.entry.version.to_string()),
        ("digest", stage.digest.to_string()),
        ("absolute", node.snapshot.abs.to_string()),
        ("relative", node.snapshot.rel.to_string()),
    ];
    Snap {
        description: format!("{} by {}", stage.kind, node.entry.name),
        expression: format!("lodge show {file} {}", node.name),
        source: file,
        info: info.map(|(k, v)| (k.to_string(), v)).to_vec(),
        contents: stage_text(stage),
    }
}

/// Where the snapshot of a node (or variant) lies.
pub fn path(graph: &Graph, node: &str) -> PathBuf {
    folder(&graph.file).join(format!("{}__{}.snap", graph.name, file_name(node)))
}

/// Where the snapshots of a pipeline file lie.
pub fn folder(pipeline: &Path) -> PathBuf {
    pipeline.parent().unwrap_or(Path::new("")).join("snapshots")
}

/// `roof[columns=32,morph=0]` as part of a file name: `roof-columns-32-morph-0`. A value may hold what no file name
/// should (separators, quotes): `-` as well, and a piece of its hash at the end, so that no two share a name.
pub fn file_name(node: &str) -> String {
    let odd = |c: char| c.is_control() || matches!(c, '/' | '\\' | ':' | '*' | '?' | '"' | '<' | '>' | '|');
    let plain = |c: char| if matches!(c, '[' | '=' | ',') || odd(c) { '-' } else { c };
    let mut out: String = node.chars().filter(|&c| c != ']').map(plain).collect();
    if node.contains(odd) {
        out.push('-');
        out += &Digest::of(node.as_bytes()).short(8);
    }
    out
}

fn pending_of(path: &Path) -> PathBuf {
    path.with_extension("snap.new")
}

/// None where there is none. A pipe or a device would never end, and no page has so many megabytes.
fn read(path: &Path) -> io::Result<Option<Snap>> {
    let meta = match path.metadata() {
        Err(e) if e.kind() == io::ErrorKind::NotFound && path.symlink_metadata().is_err() => return Ok(None),
        meta => meta?,
    };
    if !meta.is_file() {
        return Err(io::Error::other("it is not a regular file"));
    }
    if meta.len() > MOST_BYTES {
        return Err(io::Error::other(format!("it is larger than {} MiB", MOST_BYTES >> 20)));
    }
    Ok(Some(Snap::parse(&std::fs::read_to_string(path)?)))
}

const MOST_BYTES: u64 = 64 << 20;

fn write(path: &Path, snap: &Snap, rules: Rules) -> io::Result<()> {
    if rules.read_only {
        return Ok(());
    }
    let folder = path.parent().expect("a snapshot lies in a folder");
    std::fs::create_dir_all(folder)?;
    // Whole or not at all, and in place of a link, not through it.
    let open_to_all = std::os::unix::fs::PermissionsExt::from_mode(0o666);
    let mut file = tempfile::Builder::new().prefix(".lodge-").permissions(open_to_all).tempfile_in(folder)?;
    io::Write::write_all(&mut file, snap.to_text().as_bytes())?;
    file.persist(path).map(drop).map_err(|e| e.error)
}

/// Files of the pipeline that belong to none of its nodes and variants, pending ones too: what one that was removed,
/// renamed or set to `snapshot = false` left behind. A file that tells of another pipeline (`a__b.toml` beside
/// `a.toml`) is not meant.
pub fn orphans(graph: &Graph) -> Vec<PathBuf> {
    let known: Vec<PathBuf> = graph.nodes.iter().filter(|n| n.snapshot.on).map(|n| path(graph, &n.name)).collect();
    let file = graph.file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let prefix = format!("{}__", graph.name);
    let is_orphan = |path: &PathBuf| {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let Some(stem) = name.strip_suffix(".new").unwrap_or(&name).strip_suffix(".snap") else { return false };
        stem.starts_with(&prefix)
            && !known.contains(&path.with_file_name(format!("{stem}.snap")))
            && read(path).ok().flatten().is_none_or(|s| s.source.is_empty() || s.source == file)
    };
    let mut out = entries(&folder(&graph.file));
    out.retain(is_orphan);
    out.sort();
    out
}

/// A `.snap.new` that waits for a word.
#[derive(Clone, Debug, PartialEq)]
pub struct Pending {
    pub path: PathBuf,
    /// `town`.
    pub pipeline: String,
    /// With its variant.
    pub node: String,
    /// Why it cannot be read. The others of its folder can.
    pub trouble: Option<String>,
}

impl Pending {
    /// The node of that name, or any variant of it.
    pub fn is_of(&self, node: &str) -> bool {
        self.node == node || self.node.split('[').next() == Some(node)
    }

    /// What it would replace.
    pub fn old(&self) -> io::Result<Option<Snap>> {
        read(&self.path.with_extension(""))
    }

    /// What waits.
    pub fn proposed(&self) -> io::Result<Snap> {
        read(&self.path)?.ok_or_else(|| io::ErrorKind::NotFound.into())
    }

    /// It becomes the snapshot.
    pub fn accept(&self) -> io::Result<()> {
        if let Some(trouble) = &self.trouble {
            return Err(io::Error::other(trouble.clone()));
        }
        std::fs::rename(&self.path, self.path.with_extension(""))
    }

    pub fn reject(&self) -> io::Result<()> {
        std::fs::remove_file(&self.path)
    }
}

/// What waits in a `snapshots` folder, by name.
pub fn pending(folder: &Path) -> Vec<Pending> {
    let mut out = Vec::new();
    for path in entries(folder) {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let Some((pipeline, node)) = name.strip_suffix(".snap.new").and_then(|n| n.split_once("__")) else { continue };
        let is_link = path.symlink_metadata().is_ok_and(|m| m.is_symlink());
        let snap = if is_link { Err(io::Error::other("it is a link")) } else { read(&path) };
        let told = snap.as_ref().ok().and_then(|s| s.as_ref()?.info("node").map(str::to_string));
        let trouble = snap.err().map(|e| e.to_string());
        let node = told.unwrap_or_else(|| node.to_string());
        out.push(Pending { pipeline: pipeline.to_string(), node, path, trouble });
    }
    out.sort_by(|a, b| a.path.cmp(&b.path));
    out
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(folder).map(|all| all.flatten().map(|e| e.path()).collect()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_have_plain_file_names() {
        assert_eq!(file_name("roof[columns=32,morph=0.5]"), "roof-columns-32-morph-0.5");
        assert_eq!(
            pending_of(Path::new("a/town__cut-max-error-0.5.snap")),
            Path::new("a/town__cut-max-error-0.5.snap.new")
        );
    }

    #[test]
    fn pending_files_are_found_accepted_and_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let snap =
            |node: &str| Snap { info: vec![("node".into(), node.into())], contents: "Hulls".into(), ..Snap::default() };
        for (name, node) in [("t__cut-n-1", "cut[n=1]"), ("t__cut-n-2", "cut[n=2]"), ("t__cutter", "cutter")] {
            std::fs::write(folder.path().join(name).with_extension("snap.new"), snap(node).to_text()).unwrap();
        }
        let all = pending(folder.path());
        let of_cut: Vec<&Pending> = all.iter().filter(|p| p.is_of("cut")).collect();
        assert_eq!(of_cut.iter().map(|p| &p.node[..]).collect::<Vec<_>>(), ["cut[n=1]", "cut[n=2]"]);
        assert!(all.iter().all(|p| p.pipeline == "t"));
        of_cut[0].accept().unwrap();
        of_cut[1].reject().unwrap();
        assert_eq!(pending(folder.path()).len(), 1);
        assert_eq!(read(&folder.path().join("t__cut-n-1.snap")).unwrap(), Some(snap("cut[n=1]")));
        assert_eq!(pending(Path::new("/nowhere")), []);
    }
}
