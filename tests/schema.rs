//! `schemas/pipeline.schema.json`, which editors read, agrees with `lodge check`: it takes every shipped pipeline and refuses
//! the mistakes of the corpus that a schema can see.

mod support;
mod toys;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use lodge::diag::Diagnostic;
use lodge::graph::Graph;
use serde_json::Value;
use support::schema::mistakes;

fn against(schema: &Value, file: &Value) -> Vec<String> {
    let mut out = Vec::new();
    mistakes(schema, file, "", &mut out);
    out
}

/// As a language server sees it: a date is a text, and what is no finite number is nothing.
fn as_json(value: &toml::Value) -> Value {
    match value {
        toml::Value::String(s) => s.as_str().into(),
        toml::Value::Integer(n) => (*n).into(),
        toml::Value::Float(f) => (*f).into(),
        toml::Value::Boolean(b) => (*b).into(),
        toml::Value::Datetime(d) => d.to_string().into(),
        toml::Value::Array(all) => all.iter().map(as_json).collect(),
        toml::Value::Table(all) => all.iter().map(|(k, v)| (k.clone(), as_json(v))).collect(),
    }
}

fn parsed(text: &str) -> Option<Value> {
    Some(as_json(&toml::Value::Table(text.trim_start_matches('\u{feff}').parse().ok()?)))
}

fn files(folder: &str) -> Vec<PathBuf> {
    let all = std::fs::read_dir(support::project().join(folder)).unwrap().map(|f| f.unwrap().path());
    let mut all: Vec<_> = all.filter(|p| p.is_file() && p.extension().is_some_and(|e| e == "toml")).collect();
    all.sort();
    all
}

#[test]
fn every_shipped_pipeline_fits() {
    let kept = std::fs::read_to_string(support::project().join("schemas/pipeline.schema.json")).unwrap();
    let schema = serde_json::from_str(&kept).unwrap();
    let all = files("pipelines");
    assert!(all.len() >= 5);
    for file in &all {
        let text = std::fs::read_to_string(file).unwrap();
        assert_eq!(against(&schema, &parsed(&text).unwrap()), [""; 0], "{}", file.display());
        assert!(text.starts_with("#:schema ../schemas/pipeline.schema.json\n"), "{}", file.display());
    }
    // README's as well.
    let readme = std::fs::read_to_string(support::project().join("README.md")).unwrap();
    let shown = readme.split("```toml\n").nth(1).unwrap().split("```").next().unwrap();
    assert_eq!(against(&schema, &parsed(shown).unwrap()), [""; 0]);
}

/// Whether a schema can see a mistake of this kind, and why not.
const VISIBLE: [(&str, Result<(), &str>); 40] = [
    ("bad-name", Ok(())),
    ("bad-number", Ok(())),
    ("bad-output", Ok(())),
    ("empty-matrix", Ok(())),
    ("equal-values", Ok(())),
    ("missing-name", Ok(())),
    ("not-allowed", Ok(())),
    ("out-of-range", Ok(())),
    ("unknown-key", Ok(())),
    ("unknown-operator", Ok(())),
    ("unknown-parameter", Ok(())),
    ("unknown-port", Ok(())),
    ("wrong-length", Ok(())),
    ("wrong-type", Ok(())),
    ("bad-parameters", Err("the operator's own check of several parameters")),
    ("bad-reference", Err("inside a text")),
    ("bad-set", Err("not in the file")),
    ("bad-text", Err("no text at all")),
    ("cycle", Err("nodes by name")),
    ("extends-cycle", Err("other files")),
    ("given-twice", Err("keys in two places")),
    ("missing-file", Err("files")),
    ("missing-operator", Err("may be in the file that this one extends")),
    ("missing-parameter", Err("may be in the file that this one extends")),
    ("missing-port", Err("may be in the file that this one extends")),
    ("no-nodes", Err("may be in the file that this one extends")),
    ("param-and-axis", Err("keys in two places")),
    ("param-in-param", Err("inside a text")),
    ("same-axis", Err("nodes by name")),
    ("same-input", Err("a name and a variant of it")),
    ("same-name", Err("names of files")),
    ("same-output", Err("names of files")),
    ("syntax", Err("no TOML: the editor's own parser sees it")),
    ("too-deep", Err("depth")),
    ("too-many-variants", Err("a product")),
    ("uneven-variants", Err("entries of one list against each other")),
    ("unknown-node", Err("nodes by name")),
    ("unknown-param", Err("params by name")),
    ("unused-param", Err("params by name")),
    ("wrong-kind", Err("nodes by name")),
];

/// Of a kind that a schema sees, but not these: file, words of the message, why. Each is met, and never refused.
const BUT: [(&str, &str, &str); 9] = [
    ("dates", "port `dendrogram`", "a date is a text to a schema"),
    ("dates", "`keep`", "the value stands in a param"),
    ("date", "got the date", "a date is a text to a schema"),
    ("param-with-wrong-value", "", "the value stands in a param"),
    ("references", "list", "the value stands in a param"),
    ("matrix-of-references", "", "the value stands in a param"),
    ("references", "got the text \"0.50\"", "a text with `${` may become anything"),
    ("references", "got \"0.5}\"", "a text with `${` may become anything"),
    ("extends-wrong-value", "min-distence", "which operator it is stands in the file that this one extends"),
];

/// What is to be seen and is not: file, words of the message, why. Neither more nor fewer than these.
const MISSED: [(&str, &str, &str); 4] = [
    ("extends-wrong-value", "`keep` must be at most 1", "the node's operator stands in the file that this one extends"),
    ("inside-an-unknown-operator", "port `barriers` must be", "ports are those of the operator, and there is none"),
    (
        "matrix",
        "`matrix.pairs` has 1 twice",
        "1 and 1.0, which are equal in drafts from 6 on, and to many tools are not",
    ),
    ("references", "`where.${keep}[0]` must be a text", "a table with a `${` in one of its keys"),
];

/// Whether a mistake is to be seen; of one that [`BUT`] leaves out, its place there.
fn visible(file: &str, d: &Diagnostic) -> Result<bool, usize> {
    let kind =
        VISIBLE.iter().find(|(code, _)| *code == d.code).unwrap_or_else(|| panic!("`{}` is not in the table", d.code));
    match BUT.iter().position(|(name, part, _)| *name == file && words(d).contains(part)) {
        Some(at) if kind.1.is_ok() => Err(at),
        _ => Ok(kind.1.is_ok()),
    }
}

fn words(d: &Diagnostic) -> String {
    format!("{} {}", d.message, d.value.as_deref().unwrap_or_default())
}

/// The text with this mistake alone: the lines of all others go.
fn alone(file: &Path, text: &str, all: &[Box<Diagnostic>], one: &Diagnostic) -> Option<String> {
    let line_of = |d: &Diagnostic| {
        let span = d.span.as_ref().filter(|s| s.file.path.file_name() == file.file_name())?;
        Some(text.as_bytes()[..span.range.start].iter().filter(|b| **b == b'\n').count())
    };
    let mine = line_of(one)?;
    let others: BTreeSet<usize> = all.iter().filter_map(|d| line_of(d)).filter(|l| *l != mine).collect();
    let kept = text.split_inclusive('\n').enumerate().filter(|(i, line)| !others.contains(i) || line.starts_with('['));
    Some(kept.map(|(_, line)| line).collect())
}

#[test]
fn the_schema_refuses_what_it_can_see() {
    let schema: Value = serde_json::from_str(&lodge::cli::schema::text(&toys::TOYS)).unwrap();
    let (mut seen, mut missed, mut kinds) = (0, Vec::new(), BTreeMap::new());
    // Of what need not be seen: places in `BUT` that were met, and those whose mistake is seen all the same.
    let (mut met, mut needless) = (BTreeSet::new(), BTreeSet::new());
    let mut apart = Vec::new();
    for file in files("tests/diagnostics") {
        let name = file.file_stem().unwrap().to_str().unwrap();
        let Ok(text) = std::fs::read_to_string(&file) else { continue };
        if text.contains("# set: ") {
            continue; // not in the file
        }
        let all = Graph::load(&file, &[], &toys::TOYS).unwrap_err();
        for d in &all {
            let Some(json) = alone(&file, &text, &all, d).and_then(|text| parsed(&text)) else {
                apart.extend((visible(name, d) == Ok(true)).then(|| (name.to_string(), words(d))));
                continue;
            };
            let refused = !against(&schema, &json).is_empty();
            match visible(name, d) {
                Ok(true) => {
                    seen += 1;
                    *kinds.entry(d.code).or_insert(0) += 1;
                    missed.extend((!refused).then(|| (name.to_string(), words(d))));
                }
                Ok(false) => {}
                Err(at) => {
                    met.insert(at);
                    needless.extend(refused.then_some(at));
                }
            }
        }
    }
    println!("{seen} mistakes that a schema can see, {} missed: {missed:#?}\n{kinds:?}", missed.len());
    println!("not to be had alone: {apart:#?}");
    assert!(seen > 110, "{seen}");
    assert!(missed.len() * 20 <= seen, "{} of {seen} missed: {missed:#?}", missed.len());
    let is = |m: &(String, String), known: &(&str, &str, &str)| m.0 == known.0 && m.1.contains(known.1);
    let more: Vec<_> = missed.iter().filter(|m| !MISSED.iter().any(|k| is(m, k))).collect();
    assert!(more.is_empty(), "missed, and not in the list: {more:#?}");
    let fewer: Vec<_> = MISSED.iter().filter(|k| !missed.iter().any(|m| is(m, k))).collect();
    assert!(fewer.is_empty(), "in the list, and seen: {fewer:#?}");
    let unmet: Vec<_> =
        (0..BUT.len()).filter(|at| !met.contains(at) || needless.contains(at)).map(|at| BUT[at]).collect();
    assert!(unmet.is_empty(), "left out without need: {unmet:#?}");
    let known: BTreeSet<&str> = kinds.into_keys().collect();
    let never: Vec<_> = VISIBLE.iter().filter(|(code, why)| why.is_ok() && !known.contains(code)).collect();
    assert!(never.is_empty(), "{never:?}");
}

/// Good files are not refused: else the test above would prove nothing.
#[test]
fn every_form_that_is_good_fits() {
    let schema: Value = serde_json::from_str(&lodge::cli::schema::text(&toys::TOYS)).unwrap();
    for text in [
        "[node.read]\nop = \"read-geojson\"\npath = [\"a\", \"b\"]\nheight = 3\nwhere = { a = \"x\", b = [\"y\"] }\norigin = [1, 2.5]\n",
        "[params]\nkeep = 0.5\n[node.h]\nop = \"merge-hulls\"\nin.footprints = \"read\"\nkeep = \"${keep}\"\nfloor = \"${f}\"\nmerge = \"${m}\"\n",
        "[node.h]\nop = \"merge-hulls\"\nmatrix.keep = [0.5, \"${keep}\"]\nmatrix.floor = \"${floors}\"\nsnapshot = false\non-error = \"fail\"\n",
        "[node.h]\nop = \"merge-hulls\"\nvariants = [{ keep = 0.5, floor = 4 }, { keep = 1, floor = 5.0 }]\nsnapshot = { abs = 0.1, exact = true }\n",
        "extends = \"a.toml\"\n[node.h]\nkeep = 0.5\nmatrix.keep = [1]\nin.barriers = []\n[node]\nx = false\n",
        "[node.t]\nop = \"cluster\"\nin = { footprints = \"read\", barriers = [\"a\", \"b[x=1]\"] }\n[node.c]\nop = \"cut\"\nin.base-hulls = []\n",
    ] {
        assert_eq!(against(&schema, &parsed(text).unwrap()), [""; 0], "{text}");
    }
}
