//! An operator whose bytes change says so in its VERSION: else old results in people's caches pass for new ones.
//!
//! `tests/versions.tsv` holds, of every stage of the shipped pipelines, the key (operator, version, parameters, contents of
//! the inputs) and the digest of its result. One key, two digests: the version was forgotten. After a change that
//! was meant, `LODGE_UPDATE=1 cargo test --test versions` writes the file anew, but never over a forgotten version.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use lodge::graph::Graph;
use lodge::run;

#[test]
fn bytes_change_only_with_the_version() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let golden = root.join("tests/versions.tsv");
    let mut found = String::new();
    for name in ["city", "city-barriers", "city-cityjson", "impostor", "town"] {
        let graph = Graph::load(&root.join(format!("pipelines/{name}.toml")), &[], &lodge::ops::ALL);
        let graph = Arc::new(graph.unwrap_or_else(|e| panic!("{name}: {e:?}")));
        let cache = tempfile::tempdir().unwrap();
        let outcome = run::run(&graph, &[], &run::Options::new(cache.path()), &mut |_| ());
        for node in &outcome.nodes {
            let of = &graph.nodes[node.index];
            let record = node.record.as_ref().unwrap_or_else(|| panic!("{name}: `{}`: {:?}", of.name, node.error));
            let what = format!("{name}\t{}\t{} {}", of.name, of.entry.name, of.entry.version);
            found += &format!("{what}\t{}\t{}\n", record.key, record.digest);
        }
    }

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
