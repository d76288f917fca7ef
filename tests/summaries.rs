//! What a summary says is what the manual says it does, both ways; and no feature vanishes from an account.

mod support;

use std::collections::{BTreeMap, BTreeSet};

use lodge::diag::Findings;
use lodge::ops::ALL;
use serde_json::{Map, Value};
use support::{HOUSES, Place, project};

/// The houses' pipeline, on input so odd as the shipped ones never see it, and what none of them runs.
const ODD: &str = r#"
extends = "houses.toml"

[node.plan]
max-rejected = 1.0

[node.houses]
op = "read-geojson"
path = "odd.geojson"
where.layer = "house"

[node.lines]
op = "read-lines"
path = "odd.geojson"
where.layer = ["road", "house"]

[node.statue]
op = "read-mesh"
path = "odd.obj"

[node.grid]
op = "voxelize"
in.mesh = "stones"
resolution = 48

[node.planes]
op = "vote-tile"
in.voxels = "grid"

[node.quads]
op = "bake-impostor"
in.mesh = "stones"
in.tiles = "planes"

[node.afar]
op = "write-glb"
in.model = "quads"
path = "afar.glb"
"#;

/// Every kind of sin once: see the keys that must appear.
fn odd_city() -> String {
    let ring = |v: &[u32]| serde_json::json!([v]);
    let cube = |k: u32, more: Value| {
        let f = |v: [u32; 4]| ring(&v.map(|i| i + 9 * k));
        let mut solid = serde_json::json!({"type": "Solid", "lod": "1.2", "boundaries": [[
            f([0, 3, 2, 1]), f([4, 5, 6, 7]), f([0, 1, 5, 4]), f([1, 2, 6, 5]), f([2, 3, 7, 6]), f([3, 0, 4, 7])]],
            "semantics": {"surfaces": [{"type": "GroundSurface"}, {"type": "RoofSurface", "slope": 0}, {"type": "WallSurface"}],
                "values": [[0, 1, 2, 2, 2, 2]]}});
        solid.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        solid
    };
    let none = || serde_json::json!({});
    let building =
        |geometry: Value| serde_json::json!({"type": "Building", "attributes": {"year": 1}, "geometry": geometry});
    let part = |k: u32, year: u32| serde_json::json!({"type": "BuildingPart", "parents": ["parts"], "attributes": {"year": year}, "geometry": [cube(k, none())]});
    let mut vertices: Vec<[u32; 3]> = Vec::new();
    for k in 0..7 {
        let x = 20_000 * k;
        let at = |[dx, dy, z]: [u32; 3]| [x + dx, dy, z];
        vertices.extend([[0, 0, 0], [9000, 0, 0], [9000, 9000, 0], [0, 9000, 0]].map(at));
        vertices.extend([[0, 0, 6000], [9000, 0, 6000], [9000, 9000, 6000], [0, 9000, 6000]].map(at));
        vertices.push(at([4000, 0, 0]));
    }
    let flat = |v: &[u32]| serde_json::json!({"type": "MultiSurface", "lod": "1.2", "boundaries": [ring(v)]});
    serde_json::json!({"type": "CityJSON", "version": "2.0", "vertices": vertices,
    "transform": {"scale": [0.001, 0.001, 0.001], "translate": [0, 0, 0]},
    "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/25831"},
    "CityObjects": {
        "road": {"type": "Road"},
        "painted": building(serde_json::json!([cube(0, serde_json::json!({"material": {"m": {"value": 0}}})),
            {"type": "MultiPoint", "lod": "0", "boundaries": [0]}, flat(&[0, 3, 2, 1])])),
        "parts": {"type": "Building", "attributes": {"year": 3}, "address": []}, "p": part(1, 3), "q": part(2, 4),
        "alone": {"type": "BuildingPart", "parents": ["gone"], "geometry": [cube(4, none())]},
        "empty": building(serde_json::json!([])),
        "hole outside": building(serde_json::json!([{"type": "MultiSurface", "lod": "1.2",
            "boundaries": [[[27, 30, 29, 28], [45, 46, 47]], ring(&[31, 32, 33, 34])],
            "semantics": {"surfaces": [{"type": "GroundSurface"}, {"type": "RoofSurface"}], "values": [0, 1]}}])),
        "no roof": building(serde_json::json!([flat(&[45, 48, 47, 46])])),
    }})
    .to_string()
}

fn odd_geojson() -> String {
    let feature = |layer: &str, id: &str, kind: &str, coordinates: &str| {
        format!(
            r#"{{"type":"Feature","id":"{id}","properties":{{"layer":"{layer}"}},"geometry":{{"type":"{kind}","coordinates":{coordinates}}}}}"#
        )
    };
    let all = [
        feature("house", "a", "Polygon", "[[[7,43],[7.001,43],[7.001,43],[7.001,43.001],[7,43]]]"),
        feature("house", "b", "Polygon", "[[[7,43],[7.001,43],[7,43]]]"),
        feature("house", "c", "Polygon", "[[[7.1,43],[7.101,43],[7.101,43.001],[7.1,43]]]"),
        feature("house", "d", "Point", "[7,43]"),
        feature("road", "e", "MultiLineString", "[[[7,43],[7.1,43]],[[7,43],[7,43]]]"),
        feature("road", "g", "LineString", "[[7,43],[7,43]]"),
        feature("tree", "f", "Point", "[7,43]"),
    ];
    format!("{{\"type\":\"FeatureCollection\",\"features\":[\n{}\n]}}", all.join(",\n"))
}

/// A painted face, a line, and a face of corners that are not.
const ODD_OBJ: &str = "mtllib odd.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\nf 1 2 9\nl 1 2\n";

/// Operator and summary of every node of a run.
fn summaries(place: &Place, pipeline: &str) -> Vec<(String, String, Map<String, Value>)> {
    let run = place.lodge_json(&["run", pipeline]);
    let text = |v: &Value| v.as_str().unwrap().to_string();
    let one = |n: &Value| (text(&n["name"]), text(&n["op"]), n["summary"].as_object().unwrap().clone());
    run["nodes"].as_array().unwrap().iter().map(one).collect()
}

#[test]
fn every_key_is_in_the_manual_and_every_key_of_the_manual_is_said() {
    let place = Place::new();
    place.write("houses.city.json", odd_city());
    place.write("houses.toml", HOUSES);
    place.write("odd.geojson", odd_geojson());
    place.write("odd.obj", ODD_OBJ);
    place.write("odd.mtl", "newmtl a\nmap_Kd odd.png\n");
    place.write("odd.png", b"\x89PNG\r\n\x1a\n");
    let mut pipelines = vec![place.write("odd.toml", ODD)];
    let shipped = std::fs::read_dir(project().join("pipelines")).unwrap().map(|e| e.unwrap().path());
    pipelines.extend(shipped.filter(|p| p.extension().is_some_and(|e| e == "toml")));
    pipelines.sort();

    // Keys said by operators, and by kinds of results.
    let (mut said, mut kinds) = (BTreeMap::<&str, BTreeSet<String>>::new(), BTreeMap::<&str, BTreeSet<String>>::new());
    for pipeline in &pipelines {
        for (name, op, summary) in summaries(&place, pipeline.to_str().unwrap()) {
            let entry = ALL.get(&op).unwrap();
            let documented = |key: &str| {
                let all = entry.output.keys.iter().chain(entry.facts).chain(Findings::KEYS);
                all.into_iter().any(|(k, _)| is(k, key))
            };
            for key in summary.keys() {
                assert!(documented(key), "{}: {name} ({op}) says `{key}`, its manual does not", pipeline.display());
                said.entry(entry.name).or_default().insert(key.clone());
                kinds.entry(entry.output.name).or_default().insert(key.clone());
            }
            if let Some(read) = summary.get("read") {
                let of = |k: &str| summary[k].as_u64().unwrap();
                assert_eq!(read.as_u64().unwrap(), of("accepted") + of("rejected") + of("filtered"), "{name} ({op})");
            }
        }
    }
    for entry in ALL.shown() {
        let own = said.get(entry.name).unwrap_or_else(|| panic!("`{}` was not run", entry.name));
        for (key, _) in entry.facts {
            assert!(own.contains(*key), "{} documents `{key}` but never said it", entry.name);
        }
        for (key, _) in entry.output.keys {
            let found = kinds[entry.output.name].iter().any(|k| is(key, k));
            assert!(found, "{} documents `{key}`, but no operator said it", entry.output.name);
        }
    }
}

/// Whether a documented key means this one: `<part>_triangles` is any with that end.
fn is(documented: &str, key: &str) -> bool {
    match documented.split_once('>') {
        Some((_, end)) => key.ends_with(end),
        None => documented == key,
    }
}

/// Pages name what their operators write: a key of the registry is in the page's text.
#[test]
fn every_fact_is_on_its_operators_page() {
    for entry in ALL.0 {
        let name = entry.name.replace('-', "_");
        let file = project().join(format!("src/ops/{name}.rs"));
        let file = if file.exists() { file } else { project().join(format!("src/ops/{name}/mod.rs")) };
        let text = std::fs::read_to_string(file).unwrap();
        let page: String = text.lines().take_while(|l| l.starts_with("//!")).collect();
        for (key, _) in entry.facts {
            assert!(page.contains(key), "the page of {} does not name `{key}`", entry.name);
        }
    }
}
