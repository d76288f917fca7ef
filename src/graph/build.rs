//! The steps from `Spec` to `Graph`. Goes on after a mistake, so that one run shows all of them.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::schema::{Walker, required};
use super::variants::{Axis, combine, meet, name, own};
use super::wires::{Draft, connect, order, port_name};
use super::{Graph, Node, Snapshot, file_name, files};
use crate::diag::{Diagnostic, Diagnostics, did_you_mean};
use crate::op::{Entry, Registry};
use crate::spec::{Data, Key, Scope, Spec, Table, Val};

/// Keys of a node that are not its operator's parameters.
pub const OWN_WORDS: [&str; 7] = ["description", "in", "matrix", "on-error", "op", "snapshot", "variants"];

pub fn build(spec: Spec, registry: &Registry, wrong: &mut Diagnostics) -> Graph {
    // (1) operators, wires, order
    let mut drafts: Vec<Draft> = spec.nodes.iter().map(|(key, node)| draft(key, node, registry, wrong)).collect();
    if drafts.is_empty() && wrong.is_empty() {
        wrong.push(Diagnostic::error("no-nodes", format!("`{}` has no nodes", spec.texts[0].name)));
    }
    connect(&mut drafts, wrong);
    let order = order(&mut drafts, wrong);

    // (2) variants, inputs before users
    let mut schemas: BTreeMap<&str, Value> = BTreeMap::new();
    let mut instances: Vec<Vec<usize>> = vec![Vec::new(); drafts.len()];
    let (mut axes, mut names): (Vec<Vec<Axis>>, Vec<String>) = Default::default();
    let mut nodes: Vec<Option<Made>> = Vec::new();
    for me in order {
        let draft = &drafts[me];
        let mut mine = Vec::new();
        let scope = Scope { params: &spec.params, axes: &[], vague: false };
        let own = own(me, draft, &scope, &mut mine);
        let inputs = meet(draft, &instances, &axes, &names, &mut mine);
        let all = combine(draft, inputs, &own, |i| drafts[i].key.name.clone(), &mut mine);

        // (3) parameters of each variant
        for one in all {
            let visible: Vec<_> = one.axes.iter().map(|a| (a.name.clone(), a.value.clone())).collect();
            let scope = Scope { params: &spec.params, axes: &visible, vague: draft.vague };
            let given = parameters(draft.table, &one.axes, me, &scope, &mut mine);
            let title = name(&draft.key.name, &one.axes);
            if let Some(entry) = draft.entry {
                let schema = schemas.entry(entry.name).or_insert_with(entry.schema);
                nodes.push(make(draft, entry, schema, &given, &title, one.inputs, &mut mine));
            } else {
                words(draft.table, &mut mine);
                nodes.push(None);
            }
            instances[me].push(names.len());
            names.push(title);
            axes.push(one.axes);
        }
        wrong.extend(mine.into_iter().map(|d| if d.node.is_some() { d } else { d.node(&draft.key.name) }));
    }

    // (4) the whole
    same_names(&names, &drafts, &instances, wrong);
    let made: Vec<Made> = nodes.into_iter().flatten().collect();
    let published: Vec<_> = made.iter().filter_map(Made::published).collect();
    files::clashes(&published, wrong);
    unused_params(&spec, wrong);
    let nodes = made.into_iter().map(|m| m.node).collect();
    let Spec { name, file, texts, description, .. } = spec;
    Graph { name, file, texts, description, nodes }
}

fn draft<'a>(key: &'a Key, node: &'a Val, registry: &Registry, wrong: &mut Diagnostics) -> Draft<'a> {
    let table = node.table().expect("spec keeps only tables");
    let entry = match table.get("op") {
        None => {
            let d = Diagnostic::error("missing-operator", format!("node `{}` has no `op`", key.name));
            // Another word with an operator's name, or nearly one.
            let names = || registry.0.iter().map(|e| e.name);
            let is_meant = |(_, v): &&(Key, Val)| v.text().is_some_and(|t| did_you_mean(t, names()).is_some());
            let mut words = table.iter().filter(|(k, _)| !OWN_WORDS.contains(&k.name.as_str()));
            wrong.push(match words.find(is_meant) {
                Some((other, _)) => d.at(other.span.clone()).value(&other.name).help("did you mean `op`?"),
                None => d.at(key.span.clone()).help("write `op = \"..\"`; `lodge ops` lists the operators"),
            });
            None
        }
        Some(Val { data: Data::Text(text), span, .. }) => {
            let entry = registry.get(text);
            if entry.is_none() {
                let d = Diagnostic::error("unknown-operator", format!("there is no operator `{text}`"));
                let d = d.at(span.clone()).value(text).node(&key.name);
                wrong.push(match did_you_mean(text, registry.shown().map(|e| e.name)) {
                    _ if text.contains("${") => d.help("`${name}` works in parameters only"),
                    near @ Some(_) => d.help_nearest(near),
                    None => d.help("`lodge ops` lists the operators"),
                });
            }
            entry
        }
        Some(other) => {
            wrong.push(wrong_type("op", "an operator's name", other).node(&key.name));
            None
        }
    };
    Draft { key, table, entry, wires: Vec::new(), vague: false }
}

fn wrong_type(name: &str, wanted: &str, v: &Val) -> Box<Diagnostic> {
    let sentence = format!("`{name}` must be {wanted}, got {}", v.found());
    let d = Diagnostic::error("wrong-type", sentence).at(v.span.clone()).value(v.written());
    match v.text() {
        Some(text) if text.contains("${") => d.help("`${name}` works in parameters only"),
        Some(text @ ("true" | "false")) if wanted.contains(text) => d.help(format!("write {text} without quotes")),
        _ => d,
    }
}

/// The node's plain parameters and its own axes, filled in.
fn parameters(table: &Table, axes: &[Axis], me: usize, scope: &Scope, wrong: &mut Diagnostics) -> Vec<(Key, Val)> {
    let plain = table.iter().filter(|(k, _)| !OWN_WORDS.contains(&k.name.as_str()));
    let mut out: Vec<_> = plain.map(|(k, v)| (k.clone(), scope.fill(v, wrong))).collect();
    for axis in axes.iter().filter(|a| a.owner == me) {
        out.retain(|(k, _)| k.name != axis.name);
        out.push((axis_key(table, &axis.name).unwrap_or_else(|| fallback_key(axis)), axis.value.clone()));
    }
    out
}

/// Where an axis is declared.
fn axis_key(table: &Table, name: &str) -> Option<Key> {
    let matrix = table.get("matrix").and_then(Val::table);
    let first = table.get("variants").and_then(Val::list).and_then(|l| l.first()).and_then(Val::table);
    matrix.iter().chain(&first).find_map(|t| t.entry(name)).map(|(k, _)| k.clone())
}

fn fallback_key(axis: &Axis) -> Key {
    Key { name: axis.name.clone(), span: axis.value.span.clone() }
}

/// A node with where its output is named.
struct Made {
    node: Node,
    output_span: crate::diag::Span,
}

impl Made {
    fn published(&self) -> Option<files::Published<'_>> {
        let (path, _) = self.node.output.as_ref()?;
        Some(files::Published { path, node: &self.node.name, base: &self.node.base, span: &self.output_span })
    }
}

/// One variant: parameters checked by the schema, then by serde, then by the operator itself.
fn make(
    draft: &Draft,
    entry: &'static Entry,
    schema: &Value,
    given: &[(Key, Val)],
    title: &str,
    inputs: Vec<Vec<usize>>,
    wrong: &mut Diagnostics,
) -> Option<Made> {
    let before = wrong.len();
    let none = Map::new();
    let properties = schema["properties"].as_object().unwrap_or(&none);
    let file_params = marked(properties, "x-file");
    let mut found = files::Found::default();
    let mut params = Map::new();
    let mut meant: Vec<String> = Vec::new();
    for (key, value) in given {
        let Some(property) = properties.get(&key.name) else {
            let d = unknown_parameter(entry, properties, key);
            meant.push(d.suggestion.clone().unwrap_or_default());
            wrong.push(d);
            continue;
        };
        let so_far = wrong.len();
        let json = Walker { root: schema, operator: entry.name, wrong }.check(property, value, &key.name);
        if wrong.len() == so_far && file_params.contains(&key.name) && !value.is_bad() {
            files::inputs(&key.name, value, entry.beside, &mut found, wrong);
        }
        params.insert(key.name.clone(), json);
    }
    let is_given = |name: &str| given.iter().any(|(k, _)| k.name == name);
    let is_meant = |name: &str| meant.iter().any(|m| m.contains(&format!("mean `{name}`")));
    for name in required(schema).into_iter().filter(|n| !is_given(n) && !is_meant(n)) {
        let d = Diagnostic::error("missing-parameter", format!("`{}` needs `{name}`", entry.name));
        let d = d.at(draft.key.span.clone()).value(&name);
        wrong.push(match properties[&name]["description"].as_str().and_then(|t| t.lines().next()) {
            Some(doc) => d.help(format!("{name}: {doc}")),
            None => d,
        });
    }
    let span_of = |name: &str| given.iter().find(|(k, _)| k.name == name).map(|(_, v)| v.span.clone());
    let mut output = None;
    if let Some(name) = marked(properties, "x-output").into_iter().next() {
        let folder = properties[&name]["x-output"] == "folder";
        // Of one that is missing but required, its absence is already told.
        let default = properties[&name].get("default").filter(|_| !required(schema).contains(&name));
        let value = params.get(&name).or(default).cloned();
        match value.as_ref().and_then(Value::as_str).map(files::output) {
            Some(Ok(path)) => {
                params.insert(name.clone(), path.clone().into());
                output = Some((path, folder, span_of(&name).unwrap_or(draft.key.span.clone())));
            }
            Some(Err(why)) => {
                let d = Diagnostic::error("bad-output", format!("`{name}` {why}"));
                wrong.push(
                    d.at(span_of(&name).unwrap_or(draft.key.span.clone())).value(value.unwrap_or_default().to_string()),
                );
            }
            None => {}
        }
    }
    let words = words(draft.table, wrong);
    if wrong.len() > before || given.iter().any(|(_, v)| v.is_bad()) {
        return None;
    }
    let op = match (entry.build)(Value::Object(params)) {
        Ok(op) => op,
        Err(e) => {
            wrong.push(Diagnostic::error("bad-parameters", e.to_string()).at(draft.key.span.clone()));
            return None;
        }
    };
    for mistake in op.check() {
        let name = mistake.param.replace('_', "-");
        let d = Diagnostic::error("bad-parameters", mistake.message);
        let d = match given.iter().find(|(k, _)| k.name == name) {
            Some((_, v)) => d.at(v.span.clone()).value(v.written()),
            None => d.at(draft.key.span.clone()),
        };
        wrong.push(d);
    }
    let output_span = output.as_ref().map_or(draft.key.span.clone(), |o| o.2.clone());
    let node = Node {
        name: title.to_string(),
        base: draft.key.name.clone(),
        entry,
        params: op.params(),
        op,
        inputs,
        files: found.files,
        beside: found.beside,
        file_params,
        globs: found.globs,
        output: output.map(|(path, folder, _)| (path, folder)),
        fail_on_reject: words.fail_on_reject,
        snapshot: words.snapshot,
        description: words.description,
        span: draft.key.span.clone(),
    };
    Some(Made { node, output_span })
}

/// Names of the parameters that a schema marks with a word.
fn marked(properties: &Map<String, Value>, word: &str) -> Vec<String> {
    properties.iter().filter(|(_, p)| !p[word].is_null() && p[word] != false).map(|(k, _)| k.clone()).collect()
}

fn unknown_parameter(entry: &Entry, properties: &Map<String, Value>, key: &Key) -> Box<Diagnostic> {
    let d = Diagnostic::error("unknown-parameter", format!("`{}` has no parameter `{}`", entry.name, key.name));
    let d = d.at(key.span.clone()).value(&key.name);
    let names = properties.keys().map(String::as_str);
    if let Some(port) = entry.ports.iter().map(port_name).find(|p| *p == key.name) {
        return d.help(format!("`{port}` is a port: write `in.{port} = \"..\"`"));
    }
    if let "input" | "inputs" = &*key.name {
        return d.help("inputs are named as `in.port = \"node\"`");
    }
    match did_you_mean(&key.name, names.clone().chain(OWN_WORDS)) {
        near @ Some(_) => d.help_nearest(near),
        None if properties.is_empty() => d.help("it has no parameters"),
        None => {
            d.help(format!("its parameters are {}", names.map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ")))
        }
    }
}

/// The node's own words beside `op`, `in`, `matrix` and `variants`.
#[derive(Default)]
struct Words {
    description: String,
    fail_on_reject: bool,
    snapshot: Snapshot,
}

fn words(table: &Table, wrong: &mut Diagnostics) -> Words {
    let mut out = Words::default();
    match table.get("description") {
        None => {}
        Some(Val { data: Data::Text(text), .. }) => out.description = text.clone(),
        Some(v) => wrong.push(wrong_type("description", "a text", v)),
    }
    match table.get("on-error").map(|v| (v, v.text())) {
        None | Some((_, Some("report"))) => {}
        Some((_, Some("fail"))) => out.fail_on_reject = true,
        Some((v, text)) => {
            let sentence = format!("`on-error` must be \"fail\" or \"report\", got {}", v.written());
            let d = Diagnostic::error("not-allowed", sentence).at(v.span.clone()).value(v.written());
            wrong.push(d.help_nearest(text.and_then(|t| did_you_mean(t, ["fail", "report"]))));
        }
    }
    match table.get("snapshot").map(|v| (v, v.data.to_json())) {
        None => {}
        Some((_, Value::Bool(on))) => out.snapshot.on = on,
        Some((Val { data: Data::Table(keys), .. }, _)) => tolerances(keys, &mut out.snapshot, wrong),
        Some((v, _)) => wrong.push(wrong_type("snapshot", "true, false or a table of tolerances", v)),
    }
    out
}

fn tolerances(keys: &Table, out: &mut Snapshot, wrong: &mut Diagnostics) {
    for (key, v) in keys.iter() {
        let json = v.data.to_json();
        match (key.name.as_str(), json.as_f64(), &json) {
            (name @ ("abs" | "rel"), Some(n), _) => {
                if n < 0.0 {
                    let sentence = format!("`snapshot.{name}` must be at least 0, got {}", v.written());
                    wrong.push(Diagnostic::error("out-of-range", sentence).at(v.span.clone()).value(v.written()));
                }
                *(if name == "abs" { &mut out.abs } else { &mut out.rel }) = n;
            }
            ("exact", _, Value::Bool(exact)) => out.exact = *exact,
            (name @ ("abs" | "rel"), ..) => wrong.push(wrong_type(&format!("snapshot.{name}"), "a number", v)),
            ("exact", ..) => wrong.push(wrong_type("snapshot.exact", "true or false", v)),
            (name, ..) => {
                let d = Diagnostic::error("unknown-key", format!("`snapshot` has no `{name}`")).at(key.span.clone());
                wrong.push(match did_you_mean(name, ["abs", "rel", "exact"]) {
                    near @ Some(_) => d.value(name).help_nearest(near),
                    None => d.value(name).help("it takes `abs`, `rel` and `exact`"),
                });
            }
        }
    }
}

/// Two nodes whose names give one file name would share a snapshot.
fn same_names(names: &[String], drafts: &[Draft], instances: &[Vec<usize>], wrong: &mut Diagnostics) {
    let mut taken: BTreeMap<String, &str> = BTreeMap::new();
    for (draft, all) in drafts.iter().zip(instances) {
        for name in all.iter().map(|&i| names[i].as_str()) {
            if let Some(other) = taken.insert(file_name(name).to_lowercase(), name) {
                let [one, two] = [file_name(other), file_name(name)];
                let sentence = match one == two {
                    true => format!("`{other}` and `{name}` are too alike: both are `{one}` in file names"),
                    false => format!("`{other}` and `{name}` are too alike: `{one}` and `{two}` differ only in case"),
                };
                wrong.push(Diagnostic::error("same-name", sentence).at(draft.key.span.clone()).value(name));
            }
        }
    }
}

fn unused_params(spec: &Spec, wrong: &mut Diagnostics) {
    for (key, _) in spec.params.iter().filter(|(k, _)| spec.is_own(&k.span) && !spec.mentioned.contains(&k.name)) {
        let d = Diagnostic::error("unused-param", format!("no node uses param `{}`", key.name));
        wrong.push(
            d.at(key.span.clone())
                .value(&key.name)
                .help(format!("write `${{{}}}` where it is wanted, or remove it", key.name)),
        );
    }
}
