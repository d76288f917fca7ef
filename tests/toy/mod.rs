//! Operators that do next to nothing, and pipelines of them: the engine can be tested without a building in sight.
#![allow(dead_code)]

use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use lodge::artifact::files::File;
use lodge::artifact::{Files, Landmarks};
use lodge::diag::{Diagnostic, Note, Result, SourceFile, Span};
use lodge::graph::{Graph, Node, Snapshot};
use lodge::op::{Ctx, Entry, Op};
use lodge::run::event::Status;
use lodge::run::plan::Identity;
use lodge::run::{self, Options, Outcome};
use rayon::prelude::*;
use serde_json::{Value, json};

pub fn numbers(height: Vec<f64>) -> Landmarks {
    let none = Vec::new;
    Landmarks { order: none(), first: none(), size: none(), cluster_height: Vec::new(), height, maxima: Vec::new() }
}

pub mod read {
    use super::*;
    lodge::params! {
        /// Numbers of a text file, rounded down.
        pub struct ToyRead {
            #[schemars(extend("x-file" = true))]
            pub path: String = String::new(),
            pub slow_ms: u64 = 0,
        }
    }
    lodge::inputs! {}
    impl Op for ToyRead {
        const NAME: &'static str = "toy-read";
        const VERSION: u32 = 1;
        type In = In;
        type Out = Landmarks;
        fn run(&self, ctx: &Ctx, _: In) -> Result<Landmarks> {
            let mut text = String::new();
            let io = |e: std::io::Error| Diagnostic::error("cannot-read", e.to_string());
            for source in ctx.sources {
                (source.open)().map_err(io)?.read_to_string(&mut text).map_err(io)?;
            }
            std::thread::sleep(Duration::from_millis(self.slow_ms));
            let mut out = Vec::new();
            for (row, word) in text.split_whitespace().enumerate() {
                match word.parse::<f64>() {
                    Ok(v) => out.push(v.floor()),
                    Err(_) => ctx.report.reject(Note {
                        row: row as u64,
                        id: word.to_string(),
                        place: String::new(),
                        cause: "not a number".to_string(),
                    }),
                }
            }
            ctx.report.fact("read", text.split_whitespace().count());
            Ok(numbers(out))
        }
    }
}

pub mod add {
    use super::*;
    lodge::params! {
        /// The inputs' numbers one after the other, each plus `add`.
        pub struct ToyAdd {
            pub add: f64 = 0.0,
            /// `error`, `panic`, `panic-inside`.
            pub fail: String = String::new(),
            pub warn: String = String::new(),
            pub slow_ms: u64 = 0,
            /// Numbers to add at the end.
            pub more: u64 = 0,
        }
    }
    lodge::inputs! {
        /// Numbers.
        values: Vec<Landmarks>,
    }
    impl Op for ToyAdd {
        const NAME: &'static str = "toy-add";
        const VERSION: u32 = 1;
        type In = In;
        type Out = Landmarks;
        fn run(&self, ctx: &Ctx, input: In) -> Result<Landmarks> {
            let mut left = self.slow_ms;
            while left > 0 {
                ctx.check()?;
                std::thread::sleep(Duration::from_millis(left.min(5)));
                left = left.saturating_sub(5);
            }
            match &*self.fail {
                "error" => return Err(Diagnostic::error("toy", "told to fail")),
                "panic" => panic!("told to panic"),
                "panic-inside" => (0..100).into_par_iter().for_each(|i| assert!(i != 50, "told to panic inside")),
                _ => {}
            }
            if !self.warn.is_empty() {
                ctx.report.warn(&*self.warn);
            }
            let mut out: Vec<f64> = input.values.iter().flat_map(|v| &v.height).map(|v| v + self.add).collect();
            out.extend((0..self.more).map(|i| i as f64));
            Ok(numbers(out.par_iter().map(|v| v * 1.0).collect()))
        }
    }
}

pub mod write {
    use super::*;
    lodge::params! {
        /// Text files: one for each number, and an index that is published last.
        pub struct ToyWrite {
            #[schemars(extend("x-output" = "folder", "x-required" = true))]
            pub path: String = String::new(),
            /// Bytes that each file is padded to.
            pub pad: u64 = 0,
        }
    }
    lodge::inputs! {
        /// Numbers.
        values: Landmarks,
    }
    impl Op for ToyWrite {
        const NAME: &'static str = "toy-write";
        const VERSION: u32 = 1;
        type In = In;
        type Out = Files;
        fn run(&self, ctx: &Ctx, input: In) -> Result<Files> {
            let pad = self.pad as usize;
            let put = |name: String, text: String, last: bool| {
                let blob =
                    ctx.blobs.put(text.as_bytes()).map_err(|e| Diagnostic::error("cannot-write", e.to_string()))?;
                Ok(File { path: format!("{}/{name}", self.path), blob, last })
            };
            let files: Result<Vec<File>> = input
                .values
                .height
                .par_iter()
                .enumerate()
                .map(|(i, v)| put(format!("n/{i}.txt"), super::padded(v.to_string(), pad), false))
                .collect();
            let mut files = files?;
            files.push(put("index.txt".to_string(), format!("{:?}", input.values.height), true)?);
            files.sort_by(|a, b| a.path.cmp(&b.path));
            Ok(Files { files })
        }
    }
}

fn padded(mut text: String, bytes: usize) -> String {
    text.extend(std::iter::repeat_n(' ', bytes.saturating_sub(text.len())));
    text
}

pub static TOYS: [Entry; 3] =
    [Entry::of::<add::ToyAdd>(), Entry::of::<read::ToyRead>(), Entry::of::<write::ToyWrite>()];

/// A folder with data, a cache and outputs, and a pipeline that is made in code.
pub struct Yard {
    pub home: PathBuf,
    pub nodes: Vec<(String, &'static str, Value, Vec<usize>)>,
    pub fail_on_reject: bool,
}

impl Yard {
    pub fn new(home: &Path) -> Self {
        Self { home: home.to_path_buf(), nodes: Vec::new(), fail_on_reject: false }
    }

    pub fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.home.join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    pub fn node(&mut self, name: &str, op: &'static str, params: Value, inputs: &[usize]) -> usize {
        self.nodes.push((name.to_string(), op, params, inputs.to_vec()));
        self.nodes.len() - 1
    }

    /// read -> (left, right) -> both -> out
    pub fn diamond(home: &Path) -> Self {
        let mut yard = Self::new(home);
        yard.file("data.txt", "1 2 3.5");
        let read = yard.node("read", "toy-read", json!({"path": "data.txt"}), &[]);
        let left = yard.node("left", "toy-add", json!({"add": 1}), &[read]);
        let right = yard.node("right", "toy-add", json!({"add": 10, "more": 40}), &[read]);
        let both = yard.node("both", "toy-add", json!({}), &[left, right]);
        yard.node("out", "toy-write", json!({"path": "files", "pad": 100}), &[both]);
        yard
    }

    pub fn set(&mut self, node: &str, param: &str, value: Value) {
        self.nodes.iter_mut().find(|n| n.0 == node).unwrap().2[param] = value;
    }

    pub fn graph(&self) -> Arc<Graph> {
        let file =
            Arc::new(SourceFile { name: "toy.toml".into(), path: self.home.join("toy.toml"), text: String::new() });
        let node = |(name, op, params, inputs): &(String, &'static str, Value, Vec<usize>)| {
            let entry = TOYS.iter().find(|e| e.name == *op).unwrap();
            let op = (entry.build)(params.clone()).unwrap();
            let path = params["path"].as_str().unwrap_or_default();
            let is = |name| entry.name == name;
            Node {
                name: name.clone(),
                base: name.clone(),
                entry,
                params: op.params(),
                op,
                inputs: if is("toy-read") { vec![] } else { vec![inputs.clone()] },
                files: if is("toy-read") { vec![self.home.join(path)] } else { vec![] },
                beside: if is("toy-read") { vec![None] } else { vec![] },
                file_params: if is("toy-read") { vec!["path".into()] } else { vec![] },
                globs: vec![],
                output: is("toy-write").then(|| (path.to_string(), true)),
                fail_on_reject: self.fail_on_reject,
                snapshot: Snapshot::default(),
                description: String::new(),
                span: Span { file: file.clone(), range: 0..0 },
            }
        };
        Arc::new(Graph {
            name: "toy".into(),
            file: self.home.join("toy.toml"),
            texts: vec![],
            description: String::new(),
            nodes: self.nodes.iter().map(node).collect(),
        })
    }

    pub fn options(&self) -> Options {
        let mut options = Options::new(self.home.join(".lodge"));
        options.out = Some(self.out());
        options.jobs = 2;
        options.plan = Some(self.identity());
        options.table = |nodes| format!("{} nodes", nodes.len());
        options
    }

    pub fn identity(&self) -> Identity {
        let none = Vec::new;
        Identity { file: "toy".into(), sets: none(), only: none(), out: self.out(), build: "toy".into() }
    }

    pub fn out(&self) -> PathBuf {
        self.home.join("out/toy")
    }

    pub fn run(&self) -> Outcome {
        self.run_with(&self.options())
    }

    pub fn run_with(&self, options: &Options) -> Outcome {
        run::run(&self.graph(), &[], options, &mut |_| {})
    }

    /// Names of the nodes with this fate, after a run.
    pub fn names(&self, outcome: &Outcome, status: Status) -> Vec<String> {
        let nodes = outcome.nodes.iter().filter(|n| n.status == status);
        nodes.map(|n| self.nodes[n.index].0.clone()).collect()
    }

    /// Runs and tells which nodes ran; everything must be well.
    pub fn ran(&self) -> Vec<String> {
        let outcome = self.run();
        assert!(outcome.ok(), "{:?} {:?}", outcome.errors, outcome.nodes.iter().map(|n| &n.error).collect::<Vec<_>>());
        self.names(&outcome, Status::Ran)
    }
}

/// Every file below a folder: path and contents.
pub fn tree(folder: &Path) -> Vec<(String, Vec<u8>)> {
    fn walk(at: &Path, top: &Path, out: &mut Vec<(String, Vec<u8>)>) {
        for entry in std::fs::read_dir(at).into_iter().flatten().flatten() {
            let path = entry.path();
            if entry.file_type().unwrap().is_dir() {
                walk(&path, top, out);
            } else {
                let name = path.strip_prefix(top).unwrap().to_string_lossy().into_owned();
                out.push((name, std::fs::read(&path).unwrap_or_default()));
            }
        }
    }
    let mut out = Vec::new();
    walk(folder, folder, &mut out);
    out.sort();
    out
}
