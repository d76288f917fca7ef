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

#[test]
fn byte_order_mark_and_crlf() {
    let place = Place::new(&[
        ("p.toml", &format!("\u{feff}#:schema x.json\r\n{}", PLAIN.replace('\n', "\r\n"))),
        ("a.geojson", ""),
    ]);
    assert_eq!(names(&place.good(&[])), ["read", "tree", "hulls", "out"]);
}

#[test]
fn set_overrides_params_and_parameters() {
    let place = plain();
    let keep = |sets: &[&str]| place.good(sets).nodes[2].params["keep"].clone();
    assert_eq!(keep(&["keep=0.25"]), 0.25);
    assert_eq!(keep(&["keep=1"]), 1.0);
    assert_eq!(keep(&["node.hulls.keep=0.75"]), 0.75); // and the param `keep` does not count as unused
    let graph = place.good(&["node.tree.distance=centroid", "node.tree.min-distance=2"]);
    assert_eq!(graph.nodes[1].params, serde_json::json!({"distance": "centroid", "min-distance": 2.0}));
    let graph = place.good(&["node.read.where.class=7", "node.read.crs=4326", "node.read.height=h"]);
    assert_eq!(graph.nodes[0].params["where"]["class"], "7");
    assert_eq!(graph.nodes[0].params["crs"], "4326");
    assert_eq!(graph.nodes[0].params["height"], "h");
    assert_eq!(names(&place.good(&["node.out=false"])), ["read", "tree", "hulls"]);
    assert!(!place.good(&["node.out.snapshot=false"]).nodes[3].snapshot.on);
}

#[test]
fn an_inherited_param_may_stay_unused_but_not_a_set_one() {
    let place = extended("");
    place.good(&[]);
    assert!(place.load(&["spare=2"]).unwrap_err().contains("unused-param: no node uses param `spare`"));
}

#[test]
fn a_param_of_text_stays_text() {
    let place = Place::new(&[
        ("p.toml", "[params]\nf = \"a\"\n[node.r]\nop = \"read-lines\"\npath = \"${f}\"\n"),
        ("a", ""),
        ("2024", ""),
    ]);
    let path = place.path("2024");
    assert_eq!(place.good(&[&format!("f={}", path.display())]).nodes[0].files, [path]);
    let wrong = place.load(&["f=2024"]).unwrap_err(); // text, relative to the working directory
    assert!(wrong.contains("cannot read") && wrong.contains("2024: there is no such file"), "{wrong}");
}

#[test]
fn paths_start_where_their_first_character_was_written() {
    let base = "[params]\ndir = \"sub\"\nname = \"c\"\n[node.read]\nop = \"read-geojson\"\npath = \"${dir}/${name}.geojson\"\n";
    let place = Place::new(&[
        ("t/base.toml", base),
        ("t/sub/c.geojson", ""),
        ("t/sub/d.geojson", ""),
        ("other/c.geojson", ""),
        ("p.toml", "extends = \"t/base.toml\"\n"),
    ]);
    let read = |text: &str, sets: &[&str]| {
        std::fs::write(place.path("p.toml"), text).unwrap();
        place.load(sets).map(|g| g.nodes[0].files[0].canonicalize().unwrap())
    };
    let canonical = |p: &str| Ok(place.path(p).canonicalize().unwrap());
    assert_eq!(read("extends = \"t/base.toml\"\n", &[]), canonical("t/sub/c.geojson"));
    assert_eq!(read("extends = \"t/base.toml\"\nparams.dir = \"other\"\n", &[]), canonical("other/c.geojson"));
    assert_eq!(read("extends = \"t/base.toml\"\nparams.name = \"d\"\n", &[]), canonical("t/sub/d.geojson"));
    let set = format!("dir={}", place.path("other").display());
    assert_eq!(read("extends = \"t/base.toml\"\n", &[&set]), canonical("other/c.geojson"));
    assert!(read("extends = \"t/base.toml\"\n", &["dir=sub"]).unwrap_err().contains("cannot read sub/c.geojson"));
}

#[test]
fn globs_in_byte_order_without_hidden_files() {
    let place = Place::new(&[
        ("p.toml", "[node.r]\nop = \"read-lines\"\npath = [\"d[1]/*.json\", \"z\"]\n"),
        ("d[1]/b.json", ""),
        ("d[1]/B.json", ""),
        ("d[1]/a.json", ""),
        ("d[1]/.h.json", ""),
        ("d[1]/e/f.json", ""),
        ("z", ""),
    ]);
    // The folder's own brackets are part of the pattern here, and match no `d[1]`.
    assert!(place.load(&[]).unwrap_err().contains("no file matches"));
    std::fs::rename(place.path("d[1]"), place.path("d1")).unwrap();
    let graph = place.good(&[]);
    let found: Vec<_> =
        graph.nodes[0].files.iter().map(|f| f.strip_prefix(place.0.path()).unwrap().to_str().unwrap()).collect();
    assert_eq!(found, ["d1/B.json", "d1/a.json", "d1/b.json", "z"]);
    assert_eq!(graph.nodes[0].globs.len(), 1);
    assert_eq!(lodge::graph::expand(&graph.nodes[0].globs[0]).unwrap(), graph.nodes[0].files[..3]);
}

#[cfg(unix)]
#[test]
fn what_a_glob_finds_and_cannot_be_read_is_told() {
    let place = Place::new(&[("p.toml", "[node.r]\nop = \"read-lines\"\npath = \"*.json\"\n"), ("a.json", "")]);
    std::fs::create_dir(place.path("folder.json")).unwrap();
    assert_eq!(place.good(&[]).nodes[0].files.len(), 1);
    std::os::unix::fs::symlink("nowhere", place.path("b.json")).unwrap();
    let wrong = place.load(&[]).unwrap_err();
    assert!(wrong.contains("b.json") && wrong.contains("there is no such file"), "{wrong}");
}

const BASE: &str = r#"
[params]
spare = 1
keep = 0.5
[node.read]
op = "read-geojson"
path = "a.geojson"
where.class = "house"
[node.tree]
op = "cluster"
in.footprints = "read"
[node.hulls]
op = "merge-hulls"
in.footprints = "read"
in.dendrogram = "tree"
matrix.keep = [0.1, 0.2]
floor = 4
"#;

fn extended(text: &str) -> Place {
    let text = format!("extends = \"base.toml\"\n{text}");
    Place::new(&[
        ("p.toml", &text),
        ("base.toml", &BASE.replace("keep = 0.5\n", "")),
        ("a.geojson", ""),
        ("b.geojson", ""),
    ])
}

#[test]
fn extends_merges_tables_and_replaces_the_rest() {
    let graph = extended("[node.read]\nwhere.kind = [\"x\"]\n").good(&[]);
    assert_eq!(graph.nodes[0].params["where"], serde_json::json!({"class": "house", "kind": ["x"]}));
    assert_eq!(graph.texts.len(), 2);
    assert_eq!(names(&graph), ["read", "tree", "hulls[keep=0.1]", "hulls[keep=0.2]"]);
    let graph = extended("[node.hulls]\nkeep = 0.7\n").good(&[]);
    assert_eq!(names(&graph), ["read", "tree", "hulls"]);
    let graph = extended("[node.hulls]\nmatrix.floor = [5, 6]\nmatrix.keep = [0.3]\n").good(&[]);
    assert_eq!(names(&graph)[2..], ["hulls[floor=5,keep=0.3]", "hulls[floor=6,keep=0.3]"]);
    let graph = extended("[node.hulls]\nvariants = [{ keep = 0.3, floor = 7 }]\n").good(&[]);
    assert_eq!(names(&graph)[2..], ["hulls[floor=7,keep=0.3]"]);
    let graph = extended("[node.hulls]\nop = \"cluster\"\nin.footprints = \"read\"\n").good(&[]);
    assert_eq!(names(&graph), ["read", "tree", "hulls"]);
    let graph =
        extended("[node.more]\nop = \"cut\"\nin.hulls = \"hulls\"\nclusters = 3\n").good(&["node.hulls.keep=1"]);
    assert_eq!(names(&graph), ["read", "tree", "hulls", "more"]);
    let graph = extended("node.hulls = false\n").good(&[]);
    assert_eq!(names(&graph), ["read", "tree"]);
}

#[test]
fn extends_in_a_row_and_in_a_ring() {
    let files = [
        ("p.toml", "extends = \"x/a.toml\"\ndescription = \"p\"\n"),
        ("x/a.toml", "extends = \"../b.toml\"\nnode.r.path = \"in-x\"\n"),
        ("b.toml", "description = \"b\"\n[node.r]\nop = \"read-lines\"\npath = \"nowhere\"\n"),
        ("x/in-x", ""),
    ];
    let place = Place::new(&files);
    let graph = place.good(&[]);
    assert_eq!((graph.description.as_str(), graph.nodes[0].files.len()), ("p", 1));
    assert_eq!(graph.file, place.path("p.toml").canonicalize().unwrap());
    std::fs::write(place.path("b.toml"), "extends = \"./x/../p.toml\"\n").unwrap();
    assert!(place.load(&[]).unwrap_err().contains("extends itself"));
}

fn variants(tail: &str) -> Result<Graph, String> {
    let base = BASE.replace("[params]\nspare = 1\nkeep = 0.5\n", "").replace("floor = 4\n", "");
    Place::new(&[("p.toml", &(base + tail)), ("a.geojson", "")]).load(&[])
}

#[test]
fn axes_go_on_to_consumers_and_meet() {
    let graph = variants(
        r#"
[node.a]
op = "cut"
in.hulls = "hulls"
matrix.clusters = [3, 2.0]
[node.b]
op = "cut"
in.hulls = "hulls"
clusters = 1
[node.c]
op = "cut"
in.hulls = "a"
in.base-hulls = "b"
max-error = 1
[node.d]
op = "cut"
in.hulls = "a"
in.base-hulls = "b[keep=0.2]"
max-error = 1
[node.all]
op = "write-tiles"
in.hulls = ["c", "b[keep=0.1]"]
path = "t/"
[node.each]
op = "write-geojson"
in.layer = "c"
path = "c-${keep}-${clusters}.geojson"
"#,
    )
    .unwrap();
    let of = |base: &str| graph.nodes.iter().filter(|n| n.base == base).collect::<Vec<_>>();
    let named = |base: &str| of(base).iter().map(|n| n.name.clone()).collect::<Vec<_>>();
    assert_eq!(
        named("a"),
        ["a[clusters=3,keep=0.1]", "a[clusters=2,keep=0.1]", "a[clusters=3,keep=0.2]", "a[clusters=2,keep=0.2]"]
    );
    assert_eq!(named("b"), ["b[keep=0.1]", "b[keep=0.2]"]);
    assert_eq!(named("c").len(), 4); // keep is shared, not 8
    for c in of("c") {
        let keep = |port: usize| graph.nodes[c.inputs[port][0]].name.split("keep=").nth(1).unwrap().to_string();
        assert_eq!(keep(0), keep(1));
    }
    assert_eq!(named("d").len(), 4); // a named variant passes no axes on
    let all = of("all");
    assert_eq!((all.len(), all[0].inputs[0].len()), (1, 5));
    assert_eq!(all[0].output, Some(("t".into(), true)));
    assert_eq!(all[0].params["path"], "t");
    assert_eq!(of("each")[1].output, Some(("c-0.1-2.geojson".into(), false)));
    assert_eq!(of("each")[1].file_name(), "each-clusters-2-keep-0.1");
    assert_eq!(graph.find("b").unwrap().len(), 2);
    assert_eq!(graph.find("b[keep=0.2]").unwrap().len(), 1);
    assert_eq!(graph.find("each[keep=0.1]").unwrap_err().code, "unknown-node");
    for (i, node) in graph.nodes.iter().enumerate() {
        assert!(node.inputs.iter().flatten().all(|&j| j < i));
    }
}

#[test]
fn two_axes_of_one_name_do_not_meet() {
    let wrong = variants(
        "[node.h2]\nop = \"merge-hulls\"\nin.footprints = \"read\"\nin.dendrogram = \"tree\"\nmatrix.keep = [1]\n[node.c]\nop = \"cut\"\nin.hulls = \"hulls\"\nin.base-hulls = \"h2\"\nclusters = 1\n",
    );
    assert!(wrong.unwrap_err().contains("two axes `keep` meet here, one of `hulls` and one of `h2`"));
}

#[test]
fn a_ports_empty_list_takes_an_inherited_input_away() {
    let place = Place::new(&[
        ("p.toml", "extends = \"b.toml\"\nnode.t.in.barriers = []\n"),
        (
            "b.toml",
            "[node.l]\nop = \"read-lines\"\npath = \"a\"\n[node.r]\nop = \"read-geojson\"\npath = \"a\"\n[node.t]\nop = \"cluster\"\nin.footprints = \"r\"\nin.barriers = \"l\"\n",
        ),
        ("a", ""),
    ]);
    assert_eq!(place.good(&[]).nodes[2].inputs, [vec![1], vec![]]);
}

#[test]
fn values_keep_their_type() {
    let place = Place::new(&[
        (
            "p.toml",
            "[params]\nn = 3\nlist = [\"a\", \"b\"]\nfile = \"a\"\nlit = \"x$${y}\"\n[node.r]\nop = \"read-geojson\"\npath = [\"${file}\"]\nheight = \"${list}\"\ndefault-height = \"${n}\"\nwhere = { k = \"${n}-${lit}-$${n}\" }\non-error = \"fail\"\nsnapshot = { abs = 1, exact = true }\n",
        ),
        ("a", ""),
    ]);
    let node = &place.good(&[]).nodes[0];
    assert_eq!(node.params["height"], serde_json::json!(["a", "b"]));
    assert_eq!(node.params["default-height"], 3.0);
    assert_eq!(node.params["where"]["k"], "3-x${y}-${n}");
    assert!(node.fail_on_reject && node.snapshot.exact && node.snapshot.abs == 1.0);
}

#[test]
fn ten_thousand_nodes_are_read_in_a_moment() {
    let mut text = String::from("[node.r]\nop = \"read-geojson\"\npath = \"a\"\n");
    for i in 0..10_000 {
        text += &format!("[node.t{i}]\nop = \"cluster\"\nin.footprints = \"r\"\nmin-distance = {i}\n");
    }
    let place = Place::new(&[("p.toml", &text), ("a", "")]);
    let start = std::time::Instant::now();
    assert_eq!(place.good(&[]).nodes.len(), 10_001);
    assert!(start.elapsed().as_secs_f64() < 20.0, "{:?}", start.elapsed());
}

/// What `extends`, params, axes and ports do to one another.
#[test]
fn awkward_meetings() {
    // A base of a base, each in a folder of its own; its param's path is the base's, an override's the overrider's.
    let files = [
        ("p.toml", "extends = \"x/mid.toml\"\n"),
        ("x/mid.toml", "extends = \"../y/base.toml\"\n[params]\nname = \"b\"\n"),
        (
            "y/base.toml",
            "[params]\ndir = \".\"\nname = \"a\"\n[node.r]\nop = \"read-lines\"\npath = \"${dir}/${name}\"\n",
        ),
        ("y/a", ""),
        ("y/b", ""),
        ("x/b", ""),
    ];
    let place = Place::new(&files);
    let read = |text: &str, sets: &[&str]| {
        std::fs::write(place.path("p.toml"), text).unwrap();
        place.load(sets).map(|g| g.nodes[0].files[0].canonicalize().unwrap())
    };
    let is = |name: &str| Ok(place.path(name).canonicalize().unwrap());
    assert_eq!(read("extends = \"x/mid.toml\"\n", &[]), is("y/b"));
    assert_eq!(read("extends = \"x/mid.toml\"\nparams.dir = \"x\"\n", &[]), is("x/b"));
    assert_eq!(read("extends = \"x/mid.toml\"\nparams.name = \"a\"\n", &[]), is("y/a"));
    // A key that the base has not is added; a param that it has not must be used.
    assert!(read("extends = \"x/mid.toml\"\nnode.r.pth = 1\n", &[]).unwrap_err().contains("did you mean `path`?"));
    assert!(read("extends = \"x/mid.toml\"\nparams.nme = \"a\"\n", &[]).unwrap_err().contains("unused-param"));
    assert!(read("extends = \"x/mid.toml\"\n", &["nme=a"]).unwrap_err().contains("did you mean `name`?"));
    assert!(read("extends = \"x/mid.toml\"\n", &["node.q.path=a"]).unwrap_err().contains("there is no node `q`"));

    // A node that is removed while another takes it.
    let wrong = extended("node.tree = false\n").load(&[]).unwrap_err();
    assert!(wrong.contains("there is no node `tree`"), "{wrong}");
    // `--set` of an axis, whole and away.
    let graph = extended("").good(&["node.hulls.matrix.keep=[0.3, 0.4, 0.5]"]);
    assert_eq!(names(&graph)[2..], ["hulls[keep=0.3]", "hulls[keep=0.4]", "hulls[keep=0.5]"]);
    assert!(extended("").load(&["node.hulls.matrix.keep=[]"]).unwrap_err().contains("empty-matrix"));

    // An axis keeps its type in a consumer's parameter, and in a text it is one.
    let graph = variants(
        "[node.c]\nop = \"cut\"\nin.hulls = \"hulls\"\nmax-error = \"${keep}\"\n[node.w]\nop = \"write-geojson\"\nin.layer = \"c\"\npath = \"k${keep}/${keep}.json\"\n",
    )
    .unwrap();
    let of = |base: &str| graph.nodes.iter().filter(|n| n.base == base).collect::<Vec<_>>();
    assert_eq!(of("c").iter().map(|n| &n.params["max-error"]).collect::<Vec<_>>(), [0.1, 0.2]);
    assert_eq!(of("w")[1].output, Some(("k0.2/0.2.json".into(), false)));
    // Without it in the path two variants publish one file; no axis of that name reaches what a many-port gathers.
    let one = "[node.w]\nop = \"write-geojson\"\nin.layer = \"hulls\"\npath = \"w.json\"\n";
    assert!(variants(one).unwrap_err().contains("put `${keep}` in the path"));
    let many = "[node.w]\nop = \"write-tiles\"\nin.hulls = [\"hulls\"]\npath = \"${keep}\"\n";
    assert!(variants(many).unwrap_err().contains("names no param and no axis that reaches this node"));
    // Entries of `variants` meet those of another node by the axes that they share, and only by these.
    let graph = variants(
        "[node.a]\nop = \"cut\"\nin.hulls = \"hulls[keep=0.1]\"\nvariants = [{ clusters = 1 }, { clusters = 2 }]\n\
         [node.b]\nop = \"cut\"\nin.hulls = \"a\"\nin.base-hulls = \"hulls\"\nmax-error = 1\n",
    )
    .unwrap();
    let of_b: Vec<_> = graph.nodes.iter().filter(|n| n.base == "b").map(|n| n.name.as_str()).collect();
    assert_eq!(
        of_b,
        ["b[clusters=1,keep=0.1]", "b[clusters=1,keep=0.2]", "b[clusters=2,keep=0.1]", "b[clusters=2,keep=0.2]"]
    );
    // A many-port has all in the order of its list, a variant before the others of its node.
    let text = "[node.w]\nop = \"write-tiles\"\nin.hulls = [\"hulls[keep=0.2]\", \"c\", \"hulls[keep=0.1]\"]\npath = \"w\"\n[node.c]\nop = \"cut\"\nin.hulls = \"hulls\"\nmatrix.clusters = [1, 2]\n";
    let graph = variants(text).unwrap();
    let w = graph.nodes.iter().find(|n| n.base == "w").unwrap();
    let taken: Vec<_> = w.inputs[0].iter().map(|&i| graph.nodes[i].name.as_str()).collect();
    let cs = ["c[clusters=1,keep=0.1]", "c[clusters=2,keep=0.1]", "c[clusters=1,keep=0.2]", "c[clusters=2,keep=0.2]"];
    assert_eq!(taken, [&["hulls[keep=0.2]"][..], &cs, &["hulls[keep=0.1]"]].concat());
}
