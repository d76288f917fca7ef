//! What runs again after an edit of the real files, by the binary: no more than must, each announced by `plan` and explained
//! by `why`, with the parameter, file or input that differs, its old value and its new one.

mod support;

use serde_json::{Value, json};
use support::{Place, node};

const PIPELINE: &str = r#"
[params]
tops = "mean"

[node.read]
op = "read-geojson"
path = "in/*.geojson"
height = ["height"]
where.kind = ["house"]

[node.streets]
op = "read-lines"
path = "streets.geojson"

[node.rivers]
op = "read-lines"
path = "rivers.geojson"

[node.blocks]
op = "cluster"
in.footprints = "read"
in.barriers = ["streets"]

[node.hulls]
op = "merge-hulls"
in.footprints = "read"
in.dendrogram = "blocks"
height = "${tops}"
merge = "source"

[node.simple]
op = "simplify-polyline"
in.hulls = "hulls"
keep = 0.7

[node.out]
op = "write-geojson"
in.layer = "simple"
path = "plan.geojson"

[node.mesh]
op = "read-mesh"
path = "roof.obj"
"#;

/// L-shaped houses in a row, from number `from` on.
fn houses(from: usize, many: usize) -> String {
    let feature = |k: usize| {
        let x = 5.7 + 0.0003 * k as f64;
        let ring = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 0]]
            .map(|p: [i32; 2]| [x + 1e-4 * f64::from(p[0]), 53.8 + 1e-4 * f64::from(p[1])]);
        json!({"type": "Feature", "id": format!("h{k}"), "properties": {"height": 3 + k * k % 7, "kind": "house"},
            "geometry": {"type": "Polygon", "coordinates": [ring]}})
    };
    json!({"type": "FeatureCollection", "features": (from..from + many).map(feature).collect::<Vec<_>>()}).to_string()
}

fn line(y: f64) -> String {
    json!({"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {},
        "geometry": {"type": "LineString", "coordinates": [[5.69, y], [5.8, y]]}}]})
    .to_string()
}

fn town() -> Place {
    let place = Place::new();
    place.write("p.toml", PIPELINE);
    place.write("in/a.geojson", houses(0, 4));
    place.write("in/c.geojson", houses(20, 4));
    place.write("streets.geojson", line(53.9));
    place.write("rivers.geojson", line(53.95));
    place.write("roof.obj", "mtllib red.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n");
    place
}

fn edit(place: &Place, from: &str, to: &str) {
    let old = std::fs::read_to_string(place.path("p.toml")).unwrap();
    assert!(old.contains(from), "{from}");
    place.write("p.toml", old.replacen(from, to, 1));
}

fn with(nodes: &Value, status: &str) -> Vec<String> {
    let all = nodes["nodes"].as_array().unwrap().iter().filter(|n| n["status"] == status);
    all.map(|n| n["name"].as_str().unwrap().to_string()).collect()
}

/// Runs, and holds `plan` and `why`, before and after, against what happened. Which nodes ran.
fn run(place: &Place) -> Vec<String> {
    let plan = place.lodge_json(&["plan", "p.toml"]);
    let whys: Vec<Value> = with(&plan, "may-run").iter().map(|n| place.lodge_json(&["why", "p.toml", n])).collect();
    // Where no result is left, nothing is known of what a node was made of before.
    let known = place.lodge_json(&["cache", "stat"])["results"] != 0;
    let run = place.lodge_json(&["run", "p.toml"]);
    let ran = with(&run, "ran");
    for n in plan["nodes"].as_array().unwrap() {
        let (name, reason) = (n["name"].as_str().unwrap(), n["reason"].as_str().unwrap());
        let did = ran.contains(&name.to_string());
        match n["status"].as_str().unwrap() {
            "cached" => assert!(!did, "{name} ran, and the plan said that it is cached"),
            "run" => assert!(did && !reason.is_empty(), "{n}"),
            "may-run" => {
                let input = n["input"].as_str().expect("the input that decides");
                assert!(reason.starts_with(&format!("`{input}` runs first")), "{n}");
                let why = whys.iter().find(|w| w["name"] == name).unwrap();
                let last = why["because"].as_array().unwrap().last().expect("the node that surely runs");
                assert!(last["status"] == "run" && ran.contains(&last["name"].as_str().unwrap().to_string()), "{why}");
                assert!(last["reason"].as_str().is_some_and(|r| !r.is_empty()), "{why}");
            }
            other => panic!("{other}"),
        }
    }
    for name in &ran {
        let why = place.lodge_json(&["why", "p.toml", name]);
        let changes = why["changes"].as_array().unwrap();
        assert_eq!(!changes.is_empty(), known, "{name} ran: {why}");
        let before = node(&plan, name);
        assert!(before["status"] != "run" || before["changes"] == why["changes"], "{before} {why}");
        for change in changes {
            assert!(change["old"] != change["new"] && change["name"].is_string(), "{why}");
        }
    }
    ran
}

/// The changes that `plan` names for a node, as `what name node old new`; of files the ends of their paths.
fn planned(place: &Place, name: &str) -> Vec<String> {
    let plan = place.lodge_json(&["plan", "p.toml"]);
    let why = place.lodge_json(&["why", "p.toml", name]);
    assert_eq!(node(&plan, name)["changes"], why["changes"]);
    said(&why)
}

fn said(why: &Value) -> Vec<String> {
    let word = |v: &Value| match v {
        Value::String(s) if s.len() == 64 && s.bytes().all(|b| b.is_ascii_hexdigit()) => "#".to_string(),
        Value::String(s) if s.contains('/') => s.rsplit('/').next().unwrap().to_string(),
        Value::String(s) => s.clone(),
        other => other.to_string(),
    };
    let one = |c: &Value| ["what", "name", "node", "old", "new"].map(|k| word(&c[k])).join(" ");
    why["changes"].as_array().unwrap().iter().map(one).collect()
}

const ALL: [&str; 8] = ["read", "streets", "rivers", "blocks", "hulls", "simple", "out", "mesh"];

#[test]
fn nothing_runs_for_what_means_nothing() {
    let place = town();
    assert_eq!(run(&place).len(), ALL.len());
    assert_eq!(run(&place), [""; 0]);
    let good = PIPELINE.to_string();
    // The same nodes in another order, the keys of each in another order.
    let (params, nodes) = good.split_once("\n\n").unwrap();
    let turned = |block: &str| {
        let mut lines: Vec<&str> = block.lines().collect();
        lines[1..].reverse();
        lines.join("\n")
    };
    let reversed: Vec<String> = nodes.trim().rsplit("\n\n").map(turned).collect();
    for (what, text) in [
        ("comments", good.replace('\n', " # a word\n").replace("[params] # a word", "# more\n[params]")),
        ("white space", good.replace(" = ", "   =\t").replace("\n[", "\n\n\n   [")),
        ("line ends", format!("\u{feff}{}", good.replace('\n', "\r\n"))),
        ("order", format!("{params}\n\n{}", reversed.join("\n\n"))),
        ("other forms", good.replace("[\"house\"]", "[ 'h\\u006fuse', ]").replace('\'', "\"").replace("0.7", "7e-1")),
        (
            "defaults",
            good.replace("height = [\"height\"]", "height = [\"height\"]\ndefault-height = 3\nmax-rejected = 0.50"),
        ),
        (
            "own words",
            good.replace("keep = 0.7", "keep = 0.7\ndescription = \"d\"\nsnapshot = false\non-error = \"report\""),
        ),
        ("no params", good.replace("[params]\ntops = \"mean\"\n", "").replace("${tops}", "mean")),
    ] {
        assert_ne!(text, good, "{what}");
        place.write("p.toml", &text);
        assert_eq!(run(&place), [""; 0], "{what}");
    }
    place.write("p.toml", &good);
    // Touched: the same bytes at another time, under another inode, from another folder.
    place.write("in/a.geojson", houses(0, 4));
    std::fs::copy(place.path("streets.geojson"), place.path("s")).unwrap();
    std::fs::rename(place.path("s"), place.path("streets.geojson")).unwrap();
    assert_eq!(run(&place), [""; 0]);
    std::fs::rename(place.path("in"), place.path("moved")).unwrap();
    edit(&place, "in/*.geojson", "./moved/?.geojson");
    assert_eq!(run(&place), [""; 0]);
}

#[test]
fn an_equal_result_stops_the_wave_and_another_one_goes_as_far_as_it_differs() {
    let place = town();
    run(&place);
    // Other bytes, the same houses: the reader, and nobody else.
    place.write("in/a.geojson", houses(0, 4) + "\n\n");
    assert_eq!(run(&place), ["read"]);
    place.write("streets.geojson", line(53.9) + " ");
    assert_eq!(run(&place), ["streets"]);
    // A street that crosses nothing: another result, the same blocks.
    place.write("streets.geojson", line(53.91));
    assert_eq!(run(&place), ["streets", "blocks"]);
    // A parameter whose result is the same: exactly that node.
    edit(&place, "height = [\"height\"]", "height = [\"height\"]\ndefault-height = 4");
    assert_eq!(run(&place), ["read"]);
    // One whose result differs: that node and those whose inputs changed.
    assert_eq!(run(&place), [""; 0]);
    edit(&place, "keep = 0.7", "keep = 0.3");
    let ran = run(&place);
    assert!(ran == ["simple", "out"] || ran == ["simple"], "{ran:?}");
    edit(&place, "path = \"plan.geojson\"", "path = \"other.geojson\"");
    assert_eq!(run(&place), ["out"]);
    place.write("in/a.geojson", houses(0, 3));
    assert_eq!(run(&place), ["read", "blocks", "hulls", "simple", "out"]);
}

#[test]
fn every_kind_of_change_is_named() {
    let place = town();
    let new = place.lodge_json(&["plan", "p.toml"]);
    assert_eq!(node(&new, "read")["reason"], "never ran in this cache");
    run(&place);

    // Parameters: within a table, a list, one that was a default, one by a param.
    edit(&place, "where.kind = [\"house\"]", "where.kind = [\"house\", \"hut\"]");
    assert_eq!(planned(&place, "read"), ["parameter where.kind null [\"house\"] [\"house\",\"hut\"]"]);
    assert_eq!(run(&place), ["read"]);
    edit(&place, "where.kind = ", "where.use = \"home\"\nwhere.kind = ");
    assert_eq!(planned(&place, "read"), ["parameter where.use null null home"]);
    edit(&place, "where.use = \"home\"\n", "");
    edit(&place, "height = [\"height\"]", "height = [\"height\", \"h\"]");
    assert_eq!(planned(&place, "read"), ["parameter height null [\"height\"] [\"height\",\"h\"]"]);
    run(&place);
    edit(&place, "height = [", "default-height = 4\nheight = [");
    assert_eq!(planned(&place, "read"), ["parameter default-height null 3 4"]);
    run(&place);
    edit(&place, "tops = \"mean\"", "tops = \"median\"");
    assert_eq!(planned(&place, "hulls"), ["parameter height null mean median"]);
    let why = place.lodge_json(&["why", "p.toml", "simple"]);
    assert_eq!((&why["status"], &why["because"][0]["name"]), (&json!("may-run"), &json!("hulls")));
    // It may run for a reason of its own as well.
    edit(&place, "keep = 0.7", "keep = 0.6");
    assert_eq!(planned(&place, "simple"), ["parameter keep null 0.7 0.6"]);
    assert_eq!(run(&place), ["hulls", "simple", "out"]);

    // The result of an input; and, of a cached node, why it last ran.
    let why = place.lodge_json(&["why", "p.toml", "out"]);
    assert_eq!((&why["status"], said(&why)), (&json!("cached"), vec!["input layer simple # #".to_string()]));
    assert_eq!(
        said(&place.lodge_json(&["why", "p.toml", "simple"])),
        ["parameter keep null 0.7 0.6", "input hulls hulls # #"]
    );

    // Files: another content, one more in between, one less.
    place.write("in/c.geojson", houses(20, 3));
    assert_eq!(planned(&place, "read"), ["file c.geojson null # #"]);
    run(&place);
    place.write("in/b.geojson", houses(10, 2));
    assert_eq!(planned(&place, "read"), ["file b.geojson null null #"]);
    run(&place);
    std::fs::remove_file(place.path("in/a.geojson")).unwrap();
    assert_eq!(planned(&place, "read"), ["file a.geojson null # null"]);
    run(&place);
    // One beside another: missing, there, changed.
    place.write("red.mtl", "newmtl red\nKd 1 0 0\n");
    assert_eq!(planned(&place, "mesh"), ["file red.mtl null null #"]);
    assert_eq!(run(&place), ["mesh"]);
    place.write("red.mtl", "newmtl red\nKd 0 0 1\n");
    assert_eq!(planned(&place, "mesh"), ["file red.mtl null # #"]);
    assert_eq!(run(&place), ["mesh"]);

    // Ports: one more input, one less, another node in its place.
    edit(&place, "[\"streets\"]", "[\"rivers\", \"streets\"]");
    assert_eq!(planned(&place, "blocks"), ["inputs barriers null 1 2", "input barriers.0 rivers null #"]);
    run(&place);
    edit(&place, "[\"rivers\", \"streets\"]", "[\"rivers\"]");
    assert_eq!(planned(&place, "blocks"), ["inputs barriers null 2 1", "input barriers.1 streets # null"]);
    run(&place);
    edit(&place, "in.layer = \"simple\"", "in.layer = \"hulls\"");
    let why = place.lodge_json(&["why", "p.toml", "out"]);
    assert_eq!((said(&why), &why["changes"][0]["was"]), (vec!["input layer hulls # #".to_string()], &json!("simple")));
    let text = String::from_utf8(place.lodge(&["why", "p.toml", "out"]).stdout).unwrap();
    assert!(text.contains("  `in.layer`: result of `hulls` in place of `simple`: "), "{text}");
    run(&place);

    // Another operator under the same name.
    edit(
        &place,
        "op = \"simplify-polyline\"\nin.hulls = \"hulls\"\nkeep = 0.6",
        "op = \"extrude\"\nin.hulls = \"hulls\"\nin.footprints = \"read\"",
    );
    assert_eq!(planned(&place, "simple")[0], "operator op null simplify-polyline extrude");
    assert_eq!(run(&place), ["simple"]);

    // A cache that lost its results, and one that is gone.
    std::fs::remove_dir_all(place.path("cache/packs")).unwrap();
    let plan = place.lodge_json(&["plan", "p.toml"]);
    assert_eq!(node(&plan, "read")["reason"], "its result is no longer in the cache");
    edit(&place, "default-height = 4", "default-height = 5");
    let plan = place.lodge_json(&["plan", "p.toml"]);
    assert_eq!(node(&plan, "read")["reason"], "what it was made of the last time is no longer in the cache");
    assert!(run(&place).contains(&"read".to_string()));
    std::fs::remove_dir_all(place.path("cache")).unwrap();
    let plan = place.lodge_json(&["plan", "p.toml"]);
    assert_eq!(node(&plan, "hulls")["reason"], "`read` runs first, and its result decides");
    assert_eq!(node(&plan, "read")["reason"], "never ran in this cache");
    assert_eq!(run(&place).len(), ALL.len());
}

/// Two runs side by side name the numbers that are others.
#[test]
fn a_diff_of_runs_names_files_inputs_and_numbers() {
    let place = town();
    run(&place);
    place.write("in/b.geojson", houses(10, 2));
    run(&place);
    let diff = place.lodge_json(&["diff", "p-1", "p-2"]);
    let read = node(&diff, "read");
    assert_eq!(said(read), ["file b.geojson null null #"]);
    let numbers = read["summary"].as_array().unwrap();
    let accepted = numbers.iter().find(|n| n["name"] == "accepted").unwrap();
    assert_eq!((&accepted["old"], &accepted["new"]), (&json!(8), &json!(10)), "{read}");
    assert_eq!(node(&diff, "mesh")["summary"], json!([]));
    let text = String::from_utf8(place.lodge(&["diff", "p-1", "p-2"]).stdout).unwrap();
    assert!(text.contains("\n    accepted: 8 -> 10\n"), "{text}");
    std::fs::remove_file(place.path("in/b.geojson")).unwrap();
    edit(&place, "[\"streets\"]", "[\"rivers\", \"streets\"]");
    run(&place);
    let diff = place.lodge_json(&["diff", "p-2", "p-3"]);
    assert_eq!(said(node(&diff, "read")), ["file b.geojson null # null"]);
    assert!(said(node(&diff, "blocks")).contains(&"input barriers.0 rivers null #".to_string()), "{diff}");
}
