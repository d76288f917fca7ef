//! What a pipeline file means: params, `extends`, `--set`, variants, order.

mod toys;

use std::path::PathBuf;

use lodge::graph::Graph;

/// A folder with files, and pipelines in it.
struct Place(tempfile::TempDir);

impl Place {
    fn new(files: &[(&str, &str)]) -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        for (name, text) in files {
            let path = place.path(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn load(&self, sets: &[&str]) -> Result<Graph, String> {
        let sets: Vec<_> = sets.iter().map(ToString::to_string).collect();
        Graph::load(&self.path("p.toml"), &sets, &toys::TOYS)
            .map_err(|all| all.iter().map(|d| format!("{}: {d}\n", d.code)).collect())
    }

    fn good(&self, sets: &[&str]) -> Graph {
        self.load(sets).unwrap_or_else(|e| panic!("{e}"))
    }
}

fn names(graph: &Graph) -> Vec<&str> {
    graph.nodes.iter().map(|n| n.name.as_str()).collect()
}

const PLAIN: &str = r#"
description = "A town"
[params]
keep = 0.5
[node.out]
op = "write-geojson"
in.layer = "hulls"
[node.hulls]
op = "merge-hulls"
in.footprints = "read"
in.dendrogram = "tree"
keep = "${keep}"
[node.tree]
op = "cluster"
in.footprints = "read"
[node.read]
op = "read-geojson"
path = "a.geojson"
"#;

fn plain() -> Place {
    Place::new(&[("p.toml", PLAIN), ("a.geojson", ""), ("b.geojson", ""), ("sub/c.geojson", "")])
}

#[test]
fn a_plain_graph() {
    let place = plain();
    let graph = place.good(&[]);
    assert_eq!((graph.name.as_str(), graph.description.as_str()), ("p", "A town"));
    assert_eq!(names(&graph), ["read", "tree", "hulls", "out"]);
    let hulls = &graph.nodes[2];
    assert_eq!(hulls.inputs, [vec![0], vec![1]]);
    assert_eq!(hulls.params["keep"], 0.5);
    assert_eq!(hulls.params["pairs"], 10_000);
    assert_eq!(graph.nodes[0].files, [place.path("a.geojson")]);
    assert_eq!(graph.nodes[0].file_params, ["path"]);
    assert_eq!(graph.nodes[3].output, Some(("layer.geojson".into(), false)));
    assert_eq!(graph.nodes[1].inputs, [vec![0], vec![]]);
}
