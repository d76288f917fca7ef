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
