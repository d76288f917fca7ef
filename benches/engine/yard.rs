//! Pipelines of trivial nodes, and ninja's files for as many tasks: ten layers of N/10, a node takes the two above it,
//! the first layer reads two of N/10 files (as `gen.py` of the survey of runners made them).

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

const LAYERS: usize = 10;

/// A folder with a pipeline `p.toml` or a `build.ninja`.
pub struct Yard {
    pub home: PathBuf,
    _folder: tempfile::TempDir,
}

/// Which nodes publish a file.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Publish {
    All,
    /// Those of the last layer.
    Last,
}

impl Yard {
    fn new(nodes: usize) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let home = fs::canonicalize(folder.path()).expect("it is there");
        fs::create_dir(home.join("src")).expect("a folder of ours");
        // Else a cache in a folder above would be taken, and with it its outputs.
        fs::create_dir(home.join(".lodge")).expect("a folder of ours");
        for i in 0..width(nodes) {
            let text = format!("source {i} {}\n", "x".repeat(20));
            fs::write(home.join(format!("src/{i}")), text).expect("a folder of ours");
        }
        Self { home, _folder: folder }
    }

    pub fn lodge(nodes: usize, publish: Publish) -> Self {
        let yard = Self::new(nodes);
        let mut text = String::new();
        for (layer, i) in all(nodes) {
            let j = (i + 1) % width(nodes);
            write!(text, "[node.n{layer}-{i}]\nop = \"concat\"\n").expect("memory");
            match (layer, i == j) {
                (0, true) => writeln!(text, "path = [\"src/{i}\"]"),
                (0, false) => writeln!(text, "path = [\"src/{i}\", \"src/{j}\"]"),
                (_, true) => writeln!(text, "in.parts = \"n{}-{i}\"", layer - 1),
                (_, false) => writeln!(text, "in.parts = [\"n{0}-{i}\", \"n{0}-{j}\"]", layer - 1),
            }
            .expect("memory");
            if publish == Publish::All || layer == LAYERS - 1 {
                writeln!(text, "publish = \"{layer}_{i}\"").expect("memory");
            }
            text.push('\n');
        }
        fs::write(yard.home.join("p.toml"), text).expect("a folder of ours");
        yard
    }

    /// So many nodes that take nothing, each with so many thousand hashes to do.
    pub fn work(nodes: usize, thousands: usize) -> Self {
        let yard = Self::new(nodes);
        let node = |i| format!("[node.n{i}]\nop = \"concat\"\ntext = \"{i}\"\nwork = {thousands}\n\n");
        fs::write(yard.home.join("p.toml"), (0..nodes).map(node).collect::<String>()).expect("a folder of ours");
        yard
    }

    pub fn ninja(nodes: usize) -> Self {
        let yard = Self::new(nodes);
        let mut text = "rule cat\n  command = head -qc 32 $in > $out\n".to_string();
        for (layer, i) in all(nodes) {
            let j = (i + 1) % width(nodes);
            let name = |k: usize| if layer == 0 { format!("src/{k}") } else { format!("out/{}_{k}", layer - 1) };
            writeln!(text, "build out/{layer}_{i}: cat {} {}", name(i), name(j)).expect("memory");
        }
        fs::write(yard.home.join("build.ninja"), text).expect("a folder of ours");
        yard
    }

    /// Another comment at the end of the pipeline.
    pub fn edit(&self, number: usize) {
        let path = self.home.join("p.toml");
        let text = fs::read_to_string(&path).expect("written above");
        let body = text.split("# edit").next().expect("at least one part");
        fs::write(&path, format!("{body}# edit {number}\n")).expect("a folder of ours");
    }

    pub fn out(&self) -> PathBuf {
        self.home.join("out/p")
    }
}

fn width(nodes: usize) -> usize {
    nodes.div_ceil(LAYERS)
}

fn all(nodes: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..LAYERS).flat_map(move |layer| (0..width(nodes)).map(move |i| (layer, i)))
}

/// Where ninja is, if it is installed: `NINJA`, or on the path.
pub fn ninja() -> Option<PathBuf> {
    let named = std::env::var_os("NINJA").map(PathBuf::from);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let found = || std::env::split_paths(&path).map(|p| p.join("ninja")).find(|p| p.is_file());
    named.or_else(found).filter(|p| Path::new(p).is_file())
}
