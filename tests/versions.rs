//! An operator whose bytes change says so in its VERSION: else old results in people's caches pass for new ones.
//!
//! `tests/versions.tsv` holds, of every stage of the shipped pipelines, and of one with the operators that they leave
//! out, the key (operator, version, parameters, contents of the inputs) and the digest of its result. One key, two
//! digests: the version was forgotten. Another key: every cache in the world is cold, and that must be meant. After a
//! change that was, `LODGE_UPDATE=1 cargo test --test versions` writes the file anew, but never over a forgotten version.
//!
//! The same files in another folder, as of another time, have the same keys: nothing of the place is in them.

mod support;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Arc;

use lodge::graph::Graph;
use lodge::run;
use lodge::run::forecast::{Fate, forecast};
use lodge::run::store::Store;
use support::HOUSES;

fn load(root: &Path, name: &str) -> Arc<Graph> {
    let graph = Graph::load(&root.join(format!("pipelines/{name}.toml")), &[], &lodge::ops::ALL);
    Arc::new(graph.unwrap_or_else(|e| panic!("{name}: {e:?}")))
}

/// The pipelines in a folder.
fn names(root: &Path) -> Vec<String> {
    let entries = fs::read_dir(root.join("pipelines")).unwrap();
    let toml = |name: &String| name.ends_with(".toml");
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).filter(toml).collect();
    names.sort();
    names.iter().map(|n| n.trim_end_matches(".toml").to_string()).collect()
}

/// Files only, with new times.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let (path, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if path.is_dir() {
            copy(&path, &to);
        } else {
            fs::write(to, fs::read(&path).unwrap()).unwrap();
        }
    }
}

#[test]
fn bytes_change_only_with_the_version() {
    let project = Path::new(env!("CARGO_MANIFEST_DIR"));
    let golden = project.join("tests/versions.tsv");
    let (here, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (root, moved) = (here.path(), elsewhere.path().join("a folder"));
    for folder in [root, &moved] {
        ["pipelines", "fixtures"].iter().for_each(|part| copy(&project.join(part), &folder.join(part)));
        // The operators that no shipped pipeline uses.
        fs::write(folder.join("pipelines/houses.toml"), HOUSES).unwrap();
        fs::copy(project.join("fixtures/town/houses.city.json"), folder.join("pipelines/houses.city.json")).unwrap();
    }
    let mut used = BTreeSet::new();
    let mut found = String::new();
    for name in names(root) {
        let graph = load(root, &name);
        let cache = tempfile::tempdir().unwrap();
        let outcome = run::run(&graph, &[], &run::Options::new(cache.path()), &mut |_| ());
        for node in &outcome.nodes {
            let of = &graph.nodes[node.index];
            let record = node.record.as_ref().unwrap_or_else(|| panic!("{name}: `{}`: {:?}", of.name, node.error));
            let what = format!("{name}\t{}\t{} {}", of.name, of.entry.name, of.entry.version);
            used.insert(of.entry.name);
            found += &format!("{what}\t{}\t{}\n", record.key, record.digest);
            let places = [root, cache.path(), elsewhere.path()].map(|p| p.display().to_string());
            for (line, value) in &record.lines {
                assert!(!places.iter().any(|p| value.contains(p)), "{what}: a path in the key: {line} = {value}");
            }
        }
        // What ran here is found from there.
        let moved = load(&moved, &name);
        for (there, here) in forecast(&moved, &[], &Store::look(cache.path()).unwrap()).iter().zip(&outcome.nodes) {
            let (node, key) = (&moved.nodes[there.index].name, here.record.as_ref().unwrap().key);
            assert_eq!(node, &here.name);
            assert!(
                matches!(&there.fate, Fate::Cached(r) if r.key == key),
                "{name}: `{node}` has another key elsewhere"
            );
        }
    }

    let unused: Vec<&str> = lodge::ops::ALL.shown().map(|e| e.name).filter(|n| !used.contains(n)).collect();
    assert!(unused.is_empty(), "no pipeline says what bytes these give, add them to HOUSES: {unused:?}");

    let old = std::fs::read_to_string(&golden).unwrap_or_default();
    let fields = |line: &str| line.split('\t').map(str::to_string).collect::<Vec<_>>();
    let known: BTreeMap<String, String> = old.lines().map(|l| (fields(l)[3].clone(), fields(l)[4].clone())).collect();
    let forgotten: Vec<String> = found
        .lines()
        .map(fields)
        .filter(|f| known.get(&f[3]).is_some_and(|digest| *digest != f[4]))
        .map(|f| format!("{}: `{}` ({}) gives other bytes from the same inputs", f[0], f[1], f[2]))
        .collect();
    assert!(forgotten.is_empty(), "raise VERSION:\n{}", forgotten.join("\n"));

    if std::env::var_os("LODGE_UPDATE").is_some() {
        std::fs::write(&golden, &found).unwrap();
        return;
    }
    let news: Vec<&str> = found.lines().filter(|l| !old.lines().any(|o| o == *l)).collect();
    let gone: Vec<&str> = old.lines().filter(|l| !found.lines().any(|f| f == *l)).collect();
    let as_meant = "if that was meant: LODGE_UPDATE=1 cargo test --test versions";
    assert!(news.is_empty() && gone.is_empty(), "{as_meant}\nnew:\n{}\ngone:\n{}", news.join("\n"), gone.join("\n"));
}
