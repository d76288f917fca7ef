//! Pipeline files: TOML text to `Spec`, every key and value with its place; what they extend, and `--set`, merged.
//!
//! Knows the shape of a pipeline file (params, nodes), not what operators there are: that is `graph`.

mod bare;
mod interpolate;
mod sets;
mod text;
mod value;

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use bare::bare;
pub use interpolate::Scope;
pub use sets::Override;
pub use value::{Data, Key, Table, Val};

use crate::diag::{Diagnostic, Diagnostics, SourceFile, Span, did_you_mean};

/// A pipeline as it was written, merged from the file, what it extends and `--set`.
pub struct Spec {
    /// The file's name without its ending.
    pub name: String,
    /// Canonical.
    pub file: PathBuf,
    /// The file, then what it extends.
    pub texts: Vec<Arc<SourceFile>>,
    pub description: String,
    pub params: Table,
    /// Each is a table. What files below wrote first comes first.
    pub nodes: Table,
    /// Params that some node mentions, in the files or with `--set`: the others are unused.
    pub mentioned: BTreeSet<String>,
}

impl Spec {
    /// Reads a file with all that it extends. `None` where it cannot be made sense of at all; `wrong` says why.
    pub fn read(file: &Path, sets: &[String], wrong: &mut Diagnostics) -> Option<Self> {
        let mut chain = Chain { open: Vec::new(), texts: Vec::new() };
        let mut layer = chain.read(file, &file.display().to_string(), None, wrong)?;
        let overrides: Vec<_> = sets.iter().filter_map(|text| Override::read(text, wrong)).collect();
        let mut mentioned = BTreeSet::new();
        layer.nodes.iter().for_each(|(_, node)| interpolate::mentions(node, &mut mentioned));
        for one in overrides {
            layer.set(one, wrong);
        }
        layer.nodes.iter().for_each(|(_, node)| interpolate::mentions(node, &mut mentioned));
        layer.nodes.0.retain(|(key, node)| is_node(key, node, wrong));
        let canonical = chain.open.swap_remove(0);
        Some(Self {
            name: file.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default(),
            file: canonical,
            texts: chain.texts,
            description: layer.description,
            params: layer.params,
            nodes: layer.nodes,
            mentioned,
        })
    }

    /// Written in the file that is run, or by `--set`; not inherited.
    pub fn is_own(&self, span: &Span) -> bool {
        span.file.path.as_os_str().is_empty() || Arc::ptr_eq(&span.file, &self.texts[0])
    }
}

/// The folder that relative paths in a text start from.
pub fn folder_of(file: &SourceFile) -> PathBuf {
    match file.path.parent() {
        Some(folder) => folder.to_path_buf(),
        None => std::env::current_dir().unwrap_or_default(),
    }
}

/// Lower-case letters and digits, in parts joined by single `-`.
pub fn is_kebab(name: &str) -> bool {
    let fine = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit());
    name.split('-').all(fine)
}

/// One file with what it extends.
#[derive(Default)]
struct Layer {
    description: String,
    params: Table,
    nodes: Table,
}

/// The files that are being read, each extended by the one before it.
struct Chain {
    /// Canonical paths.
    open: Vec<PathBuf>,
    texts: Vec<Arc<SourceFile>>,
}

/// Files in a row, each extended by the one before it.
const MOST_FILES: usize = 100;
const TOP: [&str; 4] = ["description", "extends", "node", "params"];

impl Chain {
    /// `name` is the path as the user would write it, `from` the `extends` that asks for it.
    fn read(&mut self, path: &Path, name: &str, from: Option<&Val>, wrong: &mut Diagnostics) -> Option<Layer> {
        let at = |d: Box<Diagnostic>| match from {
            Some(from) => d.at(from.span.clone()).value(from.written()),
            None => d.value(name),
        };
        let (canonical, bytes) = match path.canonicalize().and_then(|p| Ok((p, text::read(path)?))) {
            Ok(both) => both,
            Err(e) => {
                wrong
                    .push(at(Diagnostic::error("missing-file", format!("cannot read pipeline `{name}`: {}", why(&e)))));
                return None;
            }
        };
        if self.open.len() == MOST_FILES {
            let sentence = format!("more than {MOST_FILES} files extend one another");
            wrong.push(at(Diagnostic::error("extends-cycle", sentence)));
            return None;
        }
        if let Some(first) = self.open.iter().position(|open| *open == canonical) {
            let names: Vec<_> = self.texts[first..].iter().map(|t| format!("`{}`", t.name)).collect();
            let sentence = format!("{} extends itself: {} -> {}", names[0], names.join(" -> "), names[0]);
            wrong.push(at(Diagnostic::error("extends-cycle", sentence)));
            return None;
        }
        let path = std::path::absolute(path).unwrap_or(canonical.clone());
        let text = match String::from_utf8(bytes) {
            Ok(text) => text,
            Err(e) => {
                let good = e.utf8_error().valid_up_to();
                let wide = text::wide_text(e.as_bytes());
                let d = Diagnostic::error("bad-text", "the file is not UTF-8");
                let d = if wide.is_some() { d.help("it is UTF-16: save it as UTF-8") } else { d };
                let text = wide.unwrap_or_else(|| String::from_utf8_lossy(e.as_bytes()).into_owned());
                let file = Arc::new(SourceFile { name: name.into(), path, text });
                wrong.push(d.at(Span { file, range: good..good + 1 }));
                return None;
            }
        };
        if let Some(what) = text::other_format(&text, &path) {
            let d = Diagnostic::error("bad-text", format!("`{name}` is no pipeline file: it begins as {what} does"));
            wrong.push(at(d));
            return None;
        }
        let file = Arc::new(SourceFile { name: name.into(), path, text });
        self.open.push(canonical);
        self.texts.push(file.clone());
        let mut table = text::parse(&file, wrong)?;
        for (key, _) in table.iter().filter(|(k, _)| !TOP.contains(&k.name.as_str())) {
            let d = Diagnostic::error("unknown-key", format!("`{}` is no key of a pipeline file", key.name));
            wrong.push(d.at(key.span.clone()).value(&key.name).help_nearest(did_you_mean(&key.name, TOP)));
        }
        let base = match table.remove("extends").map(|(_, v)| v) {
            None => Some(Layer::default()),
            Some(v) if v.text() == Some("") => {
                let d = Diagnostic::error("missing-file", "`extends` is empty");
                wrong.push(d.at(v.span.clone()).value(v.written()));
                None
            }
            Some(v) if v.text().is_some() => {
                let to = v.text().unwrap_or_default().to_string();
                let name = Path::new(name).parent().unwrap_or(Path::new("")).join(&to);
                self.read(&folder_of(&file).join(&to), &name.display().to_string(), Some(&v), wrong)
            }
            Some(v) => {
                wrong.push(wrong_shape("extends", "the path of another pipeline file", &v));
                None
            }
        };
        match base {
            Some(mut layer) => {
                layer.add(table, wrong);
                Some(layer)
            }
            None => {
                let mut mistakes = Vec::new();
                Layer::default().add(table, &mut mistakes);
                wrong.extend(mistakes.into_iter().filter(|d| d.code != "unknown-node"));
                None
            }
        }
    }
}

impl Layer {
    /// Puts a file's own tables above what it extends.
    fn add(&mut self, mut own: Table, wrong: &mut Diagnostics) {
        match own.remove("description").map(|(_, v)| v) {
            None => {}
            Some(Val { data: Data::Text(text), .. }) => self.description = text,
            Some(v) => wrong.push(wrong_shape("description", "a text", &v)),
        }
        match own.remove("params").map(|(_, v)| v) {
            None => {}
            Some(Val { data: Data::Table(mut params), .. }) => {
                params.0.iter_mut().for_each(|(key, value)| check_param(key, value, wrong));
                self.params.merge(params);
            }
            Some(v) => wrong.push(wrong_shape("params", "a table", &v)),
        }
        match own.remove("node").map(|(_, v)| v) {
            None => {}
            // One that was meant as a node, under `[node]` itself.
            Some(Val { data: Data::Table(nodes), .. }) if nodes.get("op").is_some_and(|v| v.text().is_some()) => {
                let (key, op) = nodes.entry("op").expect("just seen");
                let d = Diagnostic::error("missing-name", "a node needs a name").at(key.span.clone());
                wrong.push(d.value(op.written()).help("write `[node.its-name]` above it"));
            }
            Some(Val { data: Data::Table(nodes), .. }) => {
                // Names of one file differ: only those that files below wrote are looked for.
                let known: BTreeSet<String> = self.nodes.iter().map(|(k, _)| k.name.clone()).collect();
                for (key, node) in nodes.0 {
                    if known.contains(&key.name) || matches!(node.data, Data::Bool(false)) {
                        self.add_node(key, node, wrong);
                    } else {
                        self.nodes.0.push((key, node));
                    }
                }
            }
            Some(v) => wrong.push(wrong_shape("node", "a table of nodes, each under `[node.its-name]`", &v)),
        }
    }

    fn add_node(&mut self, key: Key, mut node: Val, wrong: &mut Diagnostics) {
        if matches!(node.data, Data::Bool(false)) {
            if self.nodes.remove(&key.name).is_none() {
                let sentence = format!("there is no node `{}` to remove", key.name);
                let names = self.nodes.iter().map(|(k, _)| k.name.as_str());
                let nearest = did_you_mean(&key.name, names);
                wrong.push(
                    Diagnostic::error("unknown-node", sentence).at(key.span).value(key.name).help_nearest(nearest),
                );
            }
            return;
        }
        let Some((old_key, old)) = self.nodes.0.iter_mut().find(|(k, _)| k.name == key.name) else {
            self.nodes.0.push((key, node));
            return;
        };
        match (&mut old.data, &mut node.data) {
            (Data::Table(below), Data::Table(above)) if same_operator(below, above) => {
                for name in axes(above) {
                    below.remove(&name);
                }
                let listed = if above.get("variants").is_some() { axes(above) } else { Vec::new() };
                if let Some(Val { data: Data::Table(matrix), .. }) = below.get_mut("matrix") {
                    matrix.0.retain(|(k, _)| above.get(&k.name).is_none() && !listed.contains(&k.name));
                }
                *old_key = key;
                below.merge(std::mem::take(above));
            }
            _ => (*old_key, *old) = (key, node),
        }
    }

    fn set(&mut self, one: Override, wrong: &mut Diagnostics) {
        let first = &one.path[0];
        if first.name == "node" {
            let name = &one.path[1];
            if self.nodes.get(&name.name).is_none() {
                let nearest = did_you_mean(&name.name, self.nodes.iter().map(|(k, _)| k.name.as_str()));
                let d = Diagnostic::error("unknown-node", format!("there is no node `{}`", name.name));
                wrong.push(d.at(name.span.clone()).value(&name.name).help_nearest(nearest));
                return;
            }
            let is_text = matches!(one.value.data, Data::Either(..)) && one.path.len() == 2;
            let mut one = one;
            if let (true, Data::Either(inner, _)) = (is_text, &one.value.data) {
                one.value.data = (**inner).clone(); // `node.x=false`
            }
            for (key, node) in one.into_table(1).0 {
                self.add_node(key, node, wrong);
            }
            return;
        }
        let mut value = one.value;
        match (self.params.get(&first.name), &value.data) {
            (None, _) => {
                let nearest = did_you_mean(&first.name, self.params.iter().map(|(k, _)| k.name.as_str()));
                let d = Diagnostic::error("unknown-param", format!("the pipeline has no param `{}`", first.name));
                wrong.push(d.at(first.span.clone()).value(&first.name).help_nearest(nearest));
                return;
            }
            (Some(Val { data: Data::Text(_), .. }), Data::Either(_, text)) => value.data = Data::Text(text.clone()),
            _ => {}
        }
        check_param(first, &mut value, wrong);
        self.params.merge(Table(vec![(first.clone(), value)]));
    }
}

fn same_operator(below: &Table, above: &Table) -> bool {
    match (below.get("op"), above.get("op")) {
        (Some(b), Some(a)) => b.text() == a.text(),
        _ => true,
    }
}

/// Names of the keys of `matrix` and of the first entry of `variants`.
fn axes(node: &Table) -> Vec<String> {
    let matrix = node.get("matrix").and_then(Val::table);
    let variants = node.get("variants").and_then(Val::list).and_then(|l| l.first()).and_then(Val::table);
    matrix.iter().chain(&variants).flat_map(|t| t.iter().map(|(k, _)| k.name.clone())).collect()
}

/// A name in kebab-case; no references to other params.
fn check_param(key: &Key, value: &mut Val, wrong: &mut Diagnostics) {
    if !is_kebab(&key.name) {
        wrong.push(bad_name("param", key));
    }
    interpolate::literal(value, &mut |span, text| {
        let sentence = format!("param `{}` uses `${{`: params do not use params", key.name);
        wrong.push(Diagnostic::error("param-in-param", sentence).at(span).value(text).help("`$${` is a literal `${`"));
    });
}

fn is_node(key: &Key, node: &Val, wrong: &mut Diagnostics) -> bool {
    if !is_kebab(&key.name) {
        wrong.push(bad_name("node", key));
    }
    let fine = node.table().is_some();
    if !fine && !node.is_bad() {
        let sentence = format!("`node.{}` must be a table with an `op`, got {}", key.name, node.found());
        wrong.push(Diagnostic::error("wrong-type", sentence).at(node.span.clone()).value(node.written()));
    }
    fine
}

fn bad_name(what: &str, key: &Key) -> Box<Diagnostic> {
    let words = key.name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
    let better = words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("-");
    let d = Diagnostic::error("bad-name", format!("{what} `{}` must be in kebab-case", key.name));
    let d = d.at(key.span.clone()).value(&key.name);
    if better.is_empty() || !key.name.is_ascii() { d } else { d.help(format!("write `{better}`")) }
}

fn wrong_shape(name: &str, wanted: &str, v: &Val) -> Box<Diagnostic> {
    let sentence = format!("`{name}` must be {wanted}, got {}", v.found());
    Diagnostic::error("wrong-type", sentence).at(v.span.clone()).value(v.written())
}

/// An operating system's reason in our words.
pub fn why(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::NotFound => "there is no such file".into(),
        io::ErrorKind::IsADirectory => "it is a folder".into(),
        io::ErrorKind::PermissionDenied => "permission denied".into(),
        io::ErrorKind::Other => error.to_string(), // our own words
        io::ErrorKind::NotADirectory => "a part of its path is no folder".into(),
        io::ErrorKind::InvalidFilename => "the name is too long".into(),
        _ => error.to_string().to_lowercase(),
    }
}
