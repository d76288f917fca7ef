//! CityJSON that is written is CityJSON: it reads back as what it was, parents and children agree, indices exist. The
//! files stay in `target/tmp/cityjson`, where `.ci/validate.sh` holds them against the schemas.

mod support;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use lodge::artifact::{AnyArtifact, Buildings, Files};
use lodge::op::{Bench, Source, cast};
use lodge::ops::ALL;
use serde_json::{Value, json};

type Any = Arc<dyn AnyArtifact>;

/// Runs an operator; with its files where it writes some.
fn run(name: &str, params: Value, source: Option<Source>, inputs: &[(&str, &Any)]) -> (Any, Vec<Vec<u8>>) {
    let entry = ALL.get(name).unwrap();
    let mut bench = Bench::default();
    bench.sources.extend(source);
    let of = |port: &str| inputs.iter().filter(|(p, _)| *p == port).map(|(_, a)| (*a).clone()).collect();
    let op = (entry.build)(params).unwrap();
    let out = op.run(&bench.ctx(), entry.ports.iter().map(|p| of(p.name)).collect()).unwrap();
    let files = out.as_any().downcast_ref::<Files>().map_or(Vec::new(), |f| f.files.clone());
    let blobs = bench.blobs.0.lock().unwrap();
    let bytes = files.iter().map(|f| blobs[&f.blob.digest].clone()).collect();
    (out, bytes)
}

fn read(name: &str, bytes: Vec<u8>) -> Any {
    run("read-cityjson", json!({ "path": name }), Some(Source::of_bytes(name, bytes)), &[]).0
}

/// Keeps a file for the validators.
fn keep(name: &str, bytes: &[u8]) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("cityjson");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join(name), bytes).unwrap();
}

/// The levels of detail of the schema of CityJSON 2.0.
const LEVELS: [&str; 20] = [
    "0", "1", "2", "3", "0.0", "0.1", "0.2", "0.3", "1.0", "1.1", "1.2", "1.3", "2.0", "2.1", "2.2", "2.3", "3.0",
    "3.1", "3.2", "3.3",
];

/// What the schemas cannot say: both ends of every family, no vertex beyond the last or twice, no attribute of an
/// extension that nobody declares.
fn assert_consistent(name: &str, model: &Value) {
    let vertices: BTreeSet<String> = model["vertices"].as_array().unwrap().iter().map(Value::to_string).collect();
    assert_eq!(vertices.len(), model["vertices"].as_array().unwrap().len(), "{name}");
    let objects = model["CityObjects"].as_object().unwrap();
    let list = |o: &Value, key: &str| -> Vec<String> {
        o[key].as_array().into_iter().flatten().map(|v| v.as_str().unwrap().to_string()).collect()
    };
    for (id, object) in objects {
        assert!(object["attributes"].as_object().is_none_or(|a| a.keys().all(|k| !k.starts_with('+'))), "{name}: {id}");
        for (key, back) in [("children", "parents"), ("parents", "children")] {
            for other in list(object, key) {
                let there = objects.get(&other).unwrap_or_else(|| panic!("{name}: {id} has no {key} {other}"));
                assert!(list(there, back).contains(id), "{name}: {other} does not know {id}");
            }
        }
        for geometry in object["geometry"].as_array().into_iter().flatten() {
            assert!(LEVELS.contains(&geometry["lod"].as_str().unwrap()), "{name}: {id}: {}", geometry["lod"]);
            let mut open = vec![&geometry["boundaries"]];
            while let Some(v) = open.pop() {
                match v {
                    Value::Array(all) => open.extend(all),
                    v => assert!(v.as_u64().unwrap() < model["vertices"].as_array().unwrap().len() as u64, "{name}"),
                }
            }
        }
    }
}

/// Everything of each building, by id.
fn rows(all: &Buildings) -> BTreeMap<String, String> {
    let row = |i: usize| {
        let geometries = all.geometries_of(i).map(|g| {
            let surfaces: Vec<_> = all
                .surfaces
                .polygons_of(g)
                .map(|p| {
                    let rings: Vec<_> = all.surfaces.rings_of(p).map(|r| all.surfaces.ring(r)).collect();
                    (all.semantics[p], rings)
                })
                .collect();
            (all.lods.get(g), surfaces)
        });
        let columns = &all.attributes.select(&[i as u32]).columns;
        // Those of extensions lose their sign.
        let mut attributes: Vec<_> =
            columns.iter().filter(|c| c.present[0]).map(|c| (c.name.trim_start_matches('+'), &c.values)).collect();
        attributes.sort_by_key(|a| a.0);
        format!("{:?} {attributes:?}", geometries.collect::<Vec<_>>())
    };
    (0..all.len()).map(|i| (all.ids.get(i).to_string(), row(i))).collect()
}

/// As a file, as a sequence, and with the blocks of three districts.
fn holds(name: &str, bytes: Vec<u8>) {
    let city = read(name, bytes);
    let first: Arc<Buildings> = cast(city.clone());
    let buildings = ("buildings", &city);
    let stem = name.split('.').next().unwrap();
    for kind in ["city.json", "city.jsonl"] {
        let file = format!("{stem}.{kind}");
        let (_, written) = run("write-cityjson", json!({ "path": file }), None, &[buildings]);
        keep(&file, &written[0]);
        for line in String::from_utf8_lossy(&written[0]).lines().filter(|_| kind == "city.jsonl") {
            let model: Value = serde_json::from_str(line).unwrap();
            assert_consistent(&file, &model);
        }
        if kind == "city.json" {
            assert_consistent(&file, &serde_json::from_slice(&written[0]).unwrap());
        }
        let again: Arc<Buildings> = cast(read(&file, written.into_iter().next().unwrap()));
        assert_eq!(again.frame, first.frame, "{file}");
        // An object's members have no order: compared by id.
        assert!(rows(&again) == rows(&first), "{file}: differs");
    }
    let plan = run("footprint", json!({}), None, &[buildings]).0;
    let footprints = ("footprints", &plan);
    let tree = run("cluster", json!({}), None, &[footprints]).0;
    let dendrogram = ("dendrogram", &tree);
    let hulls = run("merge-hulls", json!({}), None, &[footprints, dendrogram]).0;
    let cut = run("cut", json!({ "clusters": 3 }), None, &[("hulls", &hulls), dendrogram]).0;
    let mesh = run("extrude", json!({}), None, &[("hulls", &cut), footprints]).0;
    let file = format!("{stem}-districts.city.json");
    let inputs = [buildings, ("mesh", &mesh), footprints, dendrogram];
    let (_, written) = run("write-cityjson", json!({ "path": file, "lod": "1.0" }), None, &inputs);
    keep(&file, &written[0]);
    let model: Value = serde_json::from_slice(&written[0]).unwrap();
    assert_consistent(&file, &model);
    // Every building is in one district: a group's child, or a single one with a block of its own.
    let mut left: BTreeSet<&str> =
        plan.as_any().downcast_ref::<lodge::artifact::Footprints>().unwrap().ids.iter().collect();
    for (id, object) in model["CityObjects"].as_object().unwrap() {
        let children = object["children"].as_array().map_or(&[][..], |c| c);
        if object["type"] == "CityObjectGroup" {
            assert!(children.iter().all(|c| left.remove(c.as_str().unwrap())), "{file}: {id}");
        } else if object["geometry"].as_array().into_iter().flatten().any(|g| g["lod"] == "1.0") {
            assert!(left.remove(&**id), "{file}: {id}");
        }
    }
    assert!(left.is_empty(), "{file}: {left:?} are in no district");
}

#[test]
fn the_houses_of_the_town() {
    let path = support::project().join("fixtures/town/houses.city.json");
    holds("houses.city.json", std::fs::read(path).unwrap());
}

#[test]
fn real_city_models() {
    let Some(data) = support::real_data() else { return };
    let folder: PathBuf = data.join("citylod");
    for name in [
        "3dbag_multi_lod_10b.city.json",
        "3dbag_tile5908_99b.city.jsonl",
        "3dbag_tile901_52b.city.jsonl",
        "delft_lod1_themes.city.json",
        "vienna_lod2.city.jsonl",
    ] {
        holds(name, std::fs::read(folder.join(name)).unwrap());
    }
}

#[test]
fn levels_are_those_of_the_schema() {
    for lod in LEVELS {
        assert!(lodge::io::cityjson::is_level(lod), "{lod}");
    }
    for lod in ["", "4", "1.4", "0.5", "1.", ".1", "2.20", "10", "-1", "LoD2", " 1", "1 ", "1,2"] {
        assert!(!lodge::io::cityjson::is_level(lod), "{lod}");
    }
    let Some(data) = support::real_data() else { return };
    let text = std::fs::read_to_string(data.join("peer/cityjson/cityjson.min.schema.json")).unwrap();
    let mut open = vec![serde_json::from_str::<Value>(&text).unwrap()];
    let mut rules = BTreeSet::new();
    while let Some(value) = open.pop() {
        rules.extend(value.get("lod").map(|rule| rule["enum"].to_string()));
        match value {
            Value::Array(all) => open.extend(all),
            Value::Object(all) => open.extend(all.into_iter().map(|(_, v)| v)),
            _ => {}
        }
    }
    assert_eq!(rules.into_iter().collect::<Vec<_>>(), [json!(LEVELS).to_string()]);
}

/// A city of a tetrahedron a level for each building, at levels as a file may have them.
fn city_of(levels: &[(&str, &[Value])]) -> Any {
    let solid = |lod: &Value| {
        let mut one = json!({ "type": "Solid", "boundaries": [[[[0, 2, 1]], [[0, 1, 3]], [[1, 2, 3]], [[2, 0, 3]]]] });
        if !lod.is_null() {
            one["lod"] = lod.clone();
        }
        one
    };
    let objects: serde_json::Map<String, Value> = levels
        .iter()
        .map(|(id, lods)| {
            let geometry: Vec<Value> = lods.iter().map(solid).collect();
            (id.to_string(), json!({ "type": "Building", "attributes": { "year": 1 }, "geometry": geometry }))
        })
        .collect();
    let model = json!({ "type": "CityJSON", "version": "1.1", "CityObjects": objects,
        "transform": { "scale": [0.001, 0.001, 0.001], "translate": [0, 0, 0] },
        "vertices": [[0, 0, 0], [9000, 0, 0], [0, 9000, 0], [3000, 3000, 6000]] });
    read("odd.city.json", model.to_string().into_bytes())
}

#[test]
fn levels_that_cityjson_has_no_name_for() {
    let all = |text: &[&str]| text.iter().map(|&t| Value::from(t)).collect::<Vec<_>>();
    let city = city_of(&[
        ("all good", &all(&["1", "2.2"])),
        ("half", &all(&["1", "2.5", "LoD2"])),
        ("none", &all(&["2.5"])),
        ("number", &[json!(2.1), json!(4)]),
        ("unsaid", &[Value::Null]),
    ]);
    for file in ["odd.city.json", "odd.city.jsonl"] {
        let bench = Bench::default();
        let op = (ALL.get("write-cityjson").unwrap().build)(json!({ "path": file })).unwrap();
        let out = op.run(&bench.ctx(), vec![vec![city.clone()], vec![], vec![], vec![]]).unwrap();
        let blob = out.as_any().downcast_ref::<Files>().unwrap().files[0].blob;
        let bytes = bench.blobs.0.lock().unwrap()[&blob.digest].clone();
        keep(file, &bytes);
        let mut found = BTreeMap::new();
        for line in String::from_utf8(bytes).unwrap().lines() {
            let model: Value = serde_json::from_str(line).unwrap();
            assert_consistent(file, &model);
            for (id, object) in model["CityObjects"].as_object().unwrap() {
                assert_eq!(object["attributes"]["year"], 1);
                let lods =
                    object["geometry"].as_array().unwrap().iter().map(|g| g["lod"].as_str().unwrap().to_string());
                found.insert(id.clone(), lods.collect::<Vec<_>>());
            }
        }
        assert_eq!(json!(found), json!({ "all good": ["1", "2.2"], "half": ["1"], "number": ["2.1"] }));
        let said = bench.report.finish();
        let ids = |notes: &[lodge::diag::Note]| notes.iter().map(|n| n.id.clone()).collect::<Vec<_>>();
        assert_eq!(
            (ids(&said.rejects), ids(&said.repairs)),
            (all_ids(&["none", "unsaid"]), all_ids(&["half", "number"]))
        );
        let lost = r#""" (1), "2.5" (2), "4" (1), "LoD2" (1)"#;
        let warning = format!("geometries of levels that CityJSON 2.0 has no name for are left out: {lost}");
        assert_eq!(said.warnings, [warning]);
    }
    // With a block of its own, or in a cluster, a building without another geometry stays.
    let city = city_of(&[("a", &all(&["2.5"])), ("b", &all(&["9"]))]);
    let buildings = ("buildings", &city);
    let plan = run("footprint", json!({}), None, &[buildings]).0;
    let footprints = ("footprints", &plan);
    let tree = run("cluster", json!({}), None, &[footprints]).0;
    let dendrogram = ("dendrogram", &tree);
    let hulls = run("merge-hulls", json!({}), None, &[footprints, dendrogram]).0;
    for (clusters, wanted) in
        [(2, json!({ "a": ["1.0"], "b": ["1.0"] })), (1, json!({ "a": [], "b": [], "cluster-2": ["1.0"] }))]
    {
        let cut = run("cut", json!({ "clusters": clusters }), None, &[("hulls", &hulls), dendrogram]).0;
        let mesh = run("extrude", json!({}), None, &[("hulls", &cut), footprints]).0;
        let inputs = [buildings, ("mesh", &mesh), footprints, dendrogram];
        let (_, written) = run("write-cityjson", json!({ "path": "odd-blocks.city.json" }), None, &inputs);
        keep("odd-blocks.city.json", &written[0]);
        let model: Value = serde_json::from_slice(&written[0]).unwrap();
        assert_consistent("odd-blocks.city.json", &model);
        let lods = |o: &Value| -> Vec<Value> {
            o["geometry"].as_array().into_iter().flatten().map(|g| g["lod"].clone()).collect()
        };
        let found: BTreeMap<_, _> =
            model["CityObjects"].as_object().unwrap().iter().map(|(id, o)| (id, lods(o))).collect();
        assert_eq!(json!(found), wanted);
    }
    // Without either, nothing is left.
    let op = (ALL.get("write-cityjson").unwrap().build)(json!({ "path": "odd.city.json" })).unwrap();
    let e = op.run(&Bench::default().ctx(), vec![vec![city.clone()], vec![], vec![], vec![]]).err().unwrap();
    assert_eq!(e.message, "no building has a level of detail that CityJSON 2.0 has a name for");
}

fn all_ids(ids: &[&str]) -> Vec<String> {
    ids.iter().map(ToString::to_string).collect()
}
