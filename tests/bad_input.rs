//! Whole pipelines on input that is hardly a city, and readers on bytes that are hardly a file: a clear error or a
//! tileset, never a panic.

mod support;

use lodge::artifact::AnyArtifact;
use lodge::diag::{Findings, Result};
use lodge::op::{Bench, Source};
use lodge::ops::ALL;
use proptest::prelude::*;
use serde_json::{Value, json};
use std::sync::Arc;
use support::{Place, gzip, node, project};

// ------------------------------------------------------------------------------------------ from a file to a tileset

/// A square of 10 m or so at a lon, lat near 7, 43.
fn house(id: usize, x: f64, y: f64) -> Value {
    let (w, s) = (7.0 + x, 43.0 + y);
    let (e, n) = (w + 1e-4, s + 1e-4);
    json!({"type": "Feature", "id": format!("h{id}"), "properties": {"height": 5 + id % 7, "layer": "building"},
        "geometry": {"type": "Polygon", "coordinates": [[[w, s], [e, s], [e, n], [w, n], [w, s]]]}})
}

fn collection(features: &[Value]) -> String {
    json!({"type": "FeatureCollection", "features": features}).to_string()
}

/// A cube of 10 m for each place, in metres of EPSG:25831.
fn cubes(places: &[[i64; 2]]) -> String {
    let face = |k: usize, v: [usize; 4]| json!([v.map(|i| 8 * k + i)]);
    let objects: serde_json::Map<String, Value> = (0..places.len())
        .map(|k| {
            let faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
            let solid = json!({"type": "Solid", "lod": "2", "boundaries": [faces.map(|v| face(k, v))]});
            (format!("c{k}"), json!({"type": "Building", "geometry": [solid]}))
        })
        .collect();
    let corners = |&[x, y]: &[i64; 2]| {
        [0, 10].into_iter().flat_map(move |z| [[0, 0], [10, 0], [10, 10], [0, 10]].map(|[u, v]| [x + u, y + v, z]))
    };
    let vertices: Vec<[i64; 3]> = places.iter().flat_map(corners).collect();
    json!({"type": "CityJSON", "version": "2.0", "CityObjects": objects, "vertices": vertices,
        "transform": {"scale": [1, 1, 1], "translate": [500_000, 4_800_000, 0]},
        "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/25831"}})
    .to_string()
}

/// Exit code, the object printed, and the files.
fn run(pipeline: &str, file: &str, text: &str) -> (i32, Value, Place) {
    let place = Place::new();
    let path = place.write(file, text);
    let pipeline = project().join("pipelines").join(pipeline);
    let set = format!("buildings={path:?}");
    let done = place.lodge(&["--json", "run", pipeline.to_str().unwrap(), "--set", &set]);
    let printed = String::from_utf8_lossy(&done.stderr);
    assert!(!printed.contains("panicked"), "{pipeline:?}: {printed}");
    (done.status.code().unwrap(), serde_json::from_slice(&done.stdout).unwrap(), place)
}

/// The tileset's leaves hold so many ids, once each, and every tile has content.
fn assert_tileset(place: &Place, run: &Value, buildings: usize) {
    let folder = place.path("out").join(run["pipeline"].as_str().unwrap()).join("tileset");
    let read = |name: &str| -> Value { serde_json::from_slice(&std::fs::read(folder.join(name)).unwrap()).unwrap() };
    let tileset = read("tileset.json");
    let (mut tiles, mut ids) = (vec![&tileset["root"]], Vec::new());
    while let Some(tile) = tiles.pop() {
        let content = tile["content"]["uri"].as_str().expect("every tile has content");
        assert!(folder.join(content).is_file());
        let children = tile["children"].as_array().map_or(&[][..], |c| c);
        tiles.extend(children);
        if children.is_empty() {
            let list = read(&content.replace(".glb", ".ids.json"));
            ids.extend(list["ids"].as_array().unwrap().iter().map(|id| id.as_str().unwrap().to_string()));
        }
    }
    let all = ids.len();
    ids.sort();
    ids.dedup();
    assert_eq!((ids.len(), all), (buildings, buildings));
}

#[test]
fn none_one_and_all_at_one_place_become_a_tileset_or_an_error() {
    for pipeline in ["city.toml", "city-barriers.toml"] {
        let (code, run_, _) = run(pipeline, "none.geojson", &collection(&[]));
        assert_eq!(code, 1, "{run_}");
        let error = node(&run_, "footprints")["error"].to_string();
        assert!(error.contains("no buildings in the input") || error.contains("no feature has"), "{error}");
        assert_eq!(node(&run_, "tileset")["status"], "skipped");

        for (name, houses) in [
            ("one", vec![house(0, 0.0, 0.0)]),
            ("two", vec![house(0, 0.0, 0.0), house(1, 0.01, 0.0)]),
            ("same place", (0..300).map(|i| house(i, 0.0, 0.0)).collect()),
            ("a line", (0..300).map(|i| house(i, 1e-4 * i as f64, 0.0)).collect()),
            ("one far away", (0..20).map(|i| house(i, if i == 7 { 0.9 } else { 0.0 }, 0.0)).collect()),
        ] {
            let mut features = houses.clone();
            if pipeline == "city-barriers.toml" {
                features.push(json!({"type": "Feature", "id": "r", "properties": {"layer": "road"},
                    "geometry": {"type": "LineString", "coordinates": [[7.0, 43.0], [7.0001, 43.0001]]}}));
            }
            let (code, run_, place) = run(pipeline, "houses.geojson", &collection(&features));
            assert_eq!(code, 0, "{pipeline}, {name}: {run_}");
            assert_tileset(&place, &run_, houses.len());
            assert_eq!(node(&run_, "footprints")["summary"]["accepted"], houses.len());
        }
    }
}

#[test]
fn a_city_model_of_one_or_of_many_at_one_place() {
    for (name, places) in [("one", vec![[0, 0]]), ("same place", vec![[5, 5]; 200]), ("two", vec![[0, 0], [900, 0]])] {
        let (code, run_, place) = run("city-cityjson.toml", "a.city.json", &cubes(&places));
        assert_eq!(code, 0, "{name}: {run_}");
        assert_tileset(&place, &run_, places.len());
    }
    let (code, run_, _) = run("city-cityjson.toml", "a.city.json", &cubes(&[]));
    assert_eq!(code, 1);
    let error = node(&run_, "city")["error"].to_string();
    assert!(error.contains("no buildings in the input: 0 read, 0 filtered, 0 rejected"), "{error}");
}

#[test]
fn the_rest_of_the_city_is_there() {
    // Barriers of which some are none: houses on both sides of the one that is.
    let mut features: Vec<Value> = (0..40).map(|i| house(i, 2e-4 * (i % 20) as f64, 5e-4 * (i / 20) as f64)).collect();
    let road = |id: &str, coordinates: &str| {
        let line = json!({"type": "Feature", "id": id, "properties": {"layer": "road"}, "geometry":
            {"type": "LineString", "coordinates": "here"}});
        line.to_string().replace("\"here\"", coordinates)
    };
    features.push(json!({"type": "Feature", "id": "t", "properties": {"layer": "road"}, "geometry":
        {"type": "Point", "coordinates": [7, 43]}}));
    let roads = [
        road("r", "[[6.9,43.0003],[7.1,43.0003]]"),
        road("nan", "[[7,43],[NaN,43]]"),
        road("far", "[[7,43],[1e300,43]]"),
        road("one", "[[7,43]]"),
        road("s", "[[6.9,43.0004],[7.1,43.0004]]"),
        road("u", "[[6.9,43.00045],[7.1,43.00045]]"),
    ];
    let text = collection(&features).replacen("\"features\":[", &format!("\"features\":[{},", roads.join(",")), 1);
    let (code, run_, place) = run("city-barriers.toml", "houses.geojson", &text);
    assert_eq!(code, 0, "{run_}");
    assert_tileset(&place, &run_, 40);
    let said = |name: &str, key: &str| node(&run_, name)["summary"][key].as_u64().unwrap();
    let counts = |name: &str| ["read", "accepted", "rejected", "filtered"].map(|key| said(name, key));
    assert_eq!((counts("barriers"), counts("footprints")), ([47, 3, 3, 41], [47, 40, 0, 7]));

    // A city model of which two houses stand nowhere.
    let text = cubes(&[[0, 0], [20, 0], [0, 30], [40, 40], [60, 0]]);
    let text = text.replacen("[20,0,0]", "[NaN,0,0]", 1).replacen("[40,40,10]", "[40,40,1e300]", 1);
    let (code, run_, place) = run("city-cityjson.toml", "a.city.json", &text);
    assert_eq!(code, 0, "{run_}");
    assert_tileset(&place, &run_, 3);
    let causes = json!({"a coordinate that is not finite": 1, "a vertex higher or lower than 10,000 m": 1});
    assert_eq!(node(&run_, "city")["summary"]["rejected_by_cause"], causes);
}

// ---------------------------------------------------------------------------------------------- bytes that are hardly

type Any = Arc<dyn AnyArtifact>;

fn operator(name: &str, params: Value, source: Option<Source>, inputs: &[(&str, &Any)]) -> (Result<Any>, Findings) {
    let entry = ALL.get(name).unwrap();
    let mut bench = Bench::default();
    bench.sources.extend(source);
    let of = |port: &str| inputs.iter().filter(|(p, _)| *p == port).map(|(_, a)| (*a).clone()).collect();
    let op = (entry.build)(params).unwrap();
    let out = op.run(&bench.ctx(), entry.ports.iter().map(|p| of(p.name)).collect());
    (out, bench.report.finish())
}

/// Reads; where that succeeds the account is complete.
fn read(name: &str, file: &str, bytes: &[u8]) -> Option<Any> {
    let params = json!({"path": file, "max-rejected": 1.0});
    let (out, f) = operator(name, params, Some(Source::of_bytes(file, bytes.to_vec())), &[]);
    let out = out.ok()?;
    let of = |k: &str| f.facts[k].as_u64().unwrap();
    assert_eq!(of("read"), of("accepted") + of("rejected") + of("filtered"));
    assert_eq!(of("rejected"), f.rejects.len() as u64);
    Some(out)
}

/// From footprints to a tileset; every step succeeds.
fn tileset(footprints: &Any, buildings: Option<&Any>) {
    let plan = ("footprints", footprints);
    let step = |name: &str, params: Value, inputs: &[(&str, &Any)]| {
        operator(name, params, None, inputs).0.unwrap_or_else(|e| panic!("{name}: {e}"))
    };
    let tree = step("cluster", json!({}), &[plan]);
    let gaps = step("cluster", json!({"distance": "footprint"}), &[plan]);
    let hulls = step("merge-hulls", json!({"height": "median"}), &[plan, ("dendrogram", &tree)]);
    step("merge-hulls", json!({"merge": "source"}), &[plan, ("dendrogram", &gaps)]);
    step("simplify-footprints", json!({"max-edges": 4}), &[plan]);
    let cut = step("cut", json!({"clusters": 2}), &[("hulls", &hulls), ("dendrogram", &tree)]);
    step("extrude", json!({}), &[("hulls", &cut), plan]);
    let landmarks = step("landmarks", json!({}), &[plan, ("dendrogram", &tree)]);
    let mut inputs = vec![plan, ("dendrogram", &tree), ("hulls", &hulls), ("landmarks", &landmarks)];
    inputs.extend(buildings.map(|b| ("buildings", b)));
    let tiles = step("tile", json!({"max-triangles": 40}), &inputs);
    step("write-tileset", json!({"path": "t"}), &[("tree", &tiles)]);
}

/// One change to a text: a byte replaced, taken out, or put in; a piece doubled; or all from there on cut off.
#[derive(Clone, Debug)]
enum Change {
    Replace(u8),
    Remove(usize),
    Insert(u8),
    Double(usize),
    Cut,
}

/// Bytes that mean something to a parser, more often than others.
fn byte() -> impl Strategy<Value = u8> {
    prop_oneof![prop::sample::select(b"0123456789.-+eE[]{}\",:nul \n\xff\0".to_vec()), any::<u8>()]
}

fn change() -> impl Strategy<Value = Change> {
    prop_oneof![
        8 => byte().prop_map(Change::Replace),
        3 => (1..40usize).prop_map(Change::Remove),
        3 => byte().prop_map(Change::Insert),
        2 => (1..200usize).prop_map(Change::Double),
        1 => Just(Change::Cut),
    ]
}

fn changes() -> impl Strategy<Value = Vec<(prop::sample::Index, Change)>> {
    prop::collection::vec((any::<prop::sample::Index>(), change()), 1..6)
}

fn changed(text: &[u8], changes: &[(prop::sample::Index, Change)]) -> Vec<u8> {
    let mut out = text.to_vec();
    for (at, change) in changes {
        if out.is_empty() {
            break;
        }
        let at = at.index(out.len());
        let end = |n: usize| (at + n).min(out.len());
        match change {
            Change::Replace(b) => out[at] = *b,
            Change::Remove(n) => drop(out.drain(at..end(*n))),
            Change::Insert(b) => out.insert(at, *b),
            Change::Double(n) => {
                let piece = out[at..end(*n)].to_vec();
                out.splice(at..at, piece);
            }
            Change::Cut => out.truncate(at),
        }
    }
    out
}

/// A few houses of each kind: with a courtyard, of two parts, without a height, clockwise.
fn small_geojson() -> Vec<u8> {
    let mut all: Vec<Value> = (0..3).map(|i| house(i, 2e-4 * i as f64, 0.0)).collect();
    all.push(json!({"type": "Feature", "id": 9, "properties": {"levels": "2", "height": null, "layer": "building"},
        "geometry": {"type": "MultiPolygon", "coordinates": [
            [[[7, 43.001], [7.001, 43.001], [7.001, 43.002], [7, 43.002], [7, 43.001]],
             [[7.0004, 43.0014], [7.0004, 43.0016], [7.0006, 43.0016], [7.0004, 43.0014]]],
            [[[7.002, 43.001], [7.002, 43.002], [7.003, 43.001], [7.002, 43.001]]]]}}));
    all.push(json!({"type": "Feature", "properties": {"layer": "road"}, "geometry":
        {"type": "LineString", "coordinates": [[7, 43], [7.1, 43.1]]}}));
    collection(&all).replace("},{", "},\n{").into_bytes()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_geojson_never_panics(changes in changes(), packed in any::<bool>()) {
        let bytes = changed(&small_geojson(), &changes);
        let bytes = if packed { gzip(&bytes) } else { bytes };
        if let Some(footprints) = read("read-geojson", "a.geojson", &bytes) {
            tileset(&footprints, None);
        }
        read("read-lines", "a.geojson", &bytes);
    }

    #[test]
    fn changed_city_models_never_panic(changes in changes(), sequence in any::<bool>()) {
        let text = cubes(&[[0, 0], [20, 0], [0, 30]]).replace("},", "},\n");
        let text = if sequence {
            let feature = text.replace("\"CityJSON\"", "\"CityJSONFeature\",\"id\":\"c0\"");
            format!("{}\n{feature}", cubes(&[]))
        } else {
            text
        };
        let bytes = changed(text.as_bytes(), &changes);
        if let Some(buildings) = read("read-cityjson", "a.city.json", &bytes) {
            let (flat, _) = operator("footprint", json!({"max-rejected": 1.0}), None, &[("buildings", &buildings)]);
            if let Ok(footprints) = flat {
                tileset(&footprints, Some(&buildings));
            }
            let written = operator("write-cityjson", json!({"path": "b.city.json"}), None, &[("buildings", &buildings)]).0;
            // Levels of detail may have changed to none that can be written.
            prop_assert!(written.map_or_else(|e| e.code == "no-features", |_| true));
        }
    }

    #[test]
    fn changed_gzip_never_panics(changes in changes()) {
        let bytes = changed(&gzip(small_geojson()), &changes);
        for name in ["read-geojson", "read-lines", "read-cityjson"] {
            read(name, "a.gz", &bytes);
        }
    }
}
