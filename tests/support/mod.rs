//! What the tests of whole runs share: the binary in a folder of its own, and the files that it published.
#![allow(dead_code, reason = "each test file uses its part")]

pub mod meshopt;
pub mod scene;
pub mod schema;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output};
use std::time::{Duration, Instant};

use lodge::diag::{Findings, Result};
use lodge::op::{Bench, Inputs, Op, Source};
use serde_json::Value;

/// The project's folder.
pub fn project() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The binary, with nothing of the caller's environment that changes what it does: in CI, `test` writes no snapshots.
pub fn binary() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lodge"));
    command.env_remove("CI").env_remove("LODGE_CACHE").env_remove("NO_COLOR");
    command
}

/// Real data, or none after a printed line.
pub fn real_data() -> Option<PathBuf> {
    match std::env::var_os("LODGE_DATA") {
        Some(dir) => Some(std::path::absolute(dir).unwrap()),
        None => {
            println!("skipped: LODGE_DATA is not set");
            None
        }
    }
}

/// Runs a reader on files in memory, with parameters as TOML.
pub fn read_files<O: Op>(params: &str, files: &[(&str, Vec<u8>)]) -> (Result<O::Out>, Findings) {
    let mut bench = Bench::default();
    bench.sources = files.iter().map(|(name, bytes)| Source::of_bytes(name, bytes.clone())).collect();
    let op: O = toml::from_str(params).unwrap();
    let out = op.run(&bench.ctx(), O::In::take(Vec::new()));
    (out, bench.report.finish())
}

pub fn gzip(bytes: impl AsRef<[u8]>) -> Vec<u8> {
    let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut out, bytes.as_ref()).unwrap();
    out.finish().unwrap()
}

/// A folder with a cache and outputs of its own.
pub struct Place {
    pub dir: tempfile::TempDir,
}

impl Place {
    pub fn new() -> Self {
        Self { dir: tempfile::tempdir().unwrap() }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// Runs the binary here; the cache is `cache/`, outputs go to `out/`.
    pub fn lodge<S: AsRef<std::ffi::OsStr>>(&self, args: &[S]) -> Output {
        binary()
            .current_dir(self.dir.path())
            .env("LODGE_CACHE", self.path("cache"))
            .arg("--out")
            .arg(self.path("out"))
            .args(args)
            .output()
            .unwrap()
    }

    /// The same, which must succeed, with `--json`: the object that it prints.
    pub fn lodge_json(&self, args: &[&str]) -> Value {
        let mut all = vec!["--json"];
        all.extend(args);
        let done = self.lodge(&all);
        assert!(
            done.status.success(),
            "lodge {args:?}: {}\n{}{}",
            done.status,
            String::from_utf8_lossy(&done.stdout),
            String::from_utf8_lossy(&done.stderr)
        );
        serde_json::from_slice(&done.stdout).expect("one JSON object on standard output")
    }

    /// Every file below `out/`, with the digest of its bytes.
    pub fn published(&self) -> BTreeMap<String, String> {
        let mut all = BTreeMap::new();
        let root = self.path("out");
        walk(&root, &root, &mut all);
        all
    }
}

fn walk(root: &Path, dir: &Path, all: &mut BTreeMap<String, String>) {
    let Ok(entries) = std::fs::read_dir(dir) else { return };
    for entry in entries {
        let path = entry.unwrap().path();
        if path.is_dir() {
            walk(root, &path, all);
        } else {
            let name = path.strip_prefix(root).unwrap().to_str().unwrap().to_string();
            // What lodge keeps for itself beside its outputs is not an output.
            if !name.split('/').any(|part| part.starts_with('.')) {
                all.insert(name, lodge::digest::Digest::of(&std::fs::read(&path).unwrap()).to_string());
            }
        }
    }
}

/// Node by name in what `run --json` printed.
pub fn node<'a>(run: &'a Value, name: &str) -> &'a Value {
    run["nodes"].as_array().unwrap().iter().find(|n| n["name"] == name).unwrap_or_else(|| panic!("no node {name}"))
}

/// A pipeline over `houses.city.json`: readers and operators that the town's own has not.
pub const HOUSES: &str = r#"
[node.city]
op = "read-cityjson"
path = "houses.city.json"

[node.plan]
op = "footprint"
in.buildings = "city"

[node.simple-plan]
op = "simplify-footprints"
in.footprints = "plan"
max-edges = 4

[node.tree]
op = "cluster"
in.footprints = "plan"
distance = "footprint"

[node.rings]
op = "merge-hulls"
in.footprints = "plan"
in.dendrogram = "tree"
merge = "source"

[node.simple-rings]
op = "simplify-polyline"
in.hulls = "rings"

[node.level]
op = "cut"
in.hulls = "rings"
in.dendrogram = "tree"
clusters = 2000

[node.stones]
op = "extrude"
in.hulls = "level"
in.footprints = "plan"

[node.landmarks]
op = "landmarks"
in.footprints = "plan"
in.dendrogram = "tree"

[node.tiles]
op = "tile"
in.footprints = "plan"
in.dendrogram = "tree"
in.hulls = "rings"
in.landmarks = "landmarks"
in.buildings = "city"

[node.tileset]
op = "write-tileset"
in.tree = "tiles"
path = "tileset"

[node.model]
op = "write-cityjson"
in.buildings = "city"
in.mesh = "stones"
in.footprints = "plan"
in.dendrogram = "tree"
path = "model.city.json"

[node.sequence]
op = "write-cityjson"
in.buildings = "city"
path = "model.city.jsonl"

[node.glb]
op = "write-glb"
in.model = "stones"
path = "stones.glb"

[node.map]
op = "write-geojson"
in.layer = "plan"
path = "plan.geojson"

[node.map-of-rings]
op = "write-geojson"
in.layer = "rings"
path = "rings.geojson"
"#;

/// Ctrl-C once: exit code, and how long that took.
pub fn interrupt(child: &mut Child) -> (Option<i32>, Duration) {
    let struck = Instant::now();
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    while child.try_wait().unwrap().is_none() {
        if struck.elapsed() > Duration::from_secs(20) {
            child.kill().unwrap();
            panic!("it does not end");
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    (child.wait().unwrap().code(), struck.elapsed())
}

/// Whether LODGE_LONG asks for the long forms.
pub fn is_long() -> bool {
    std::env::var("LODGE_LONG").is_ok_and(|v| !["", "0"].contains(&v.as_str()))
}

/// The same numbers every time (splitmix64).
pub struct Random(pub u64);

impl Random {
    pub fn new(what: &str) -> Self {
        let seed = std::env::var("LODGE_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
        println!("{what}: seed {seed}");
        Self(seed)
    }

    pub fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n.max(1) as u64) as usize
    }
}
