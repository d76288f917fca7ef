//! The readers on real data (`LODGE_DATA`), and on the bad input that they must survive.

mod support;

use std::path::PathBuf;
use std::sync::Arc;

use lodge::artifact::{Buildings, Footprints};
use lodge::diag::{Findings, Result};
use lodge::op::{Bench, Inputs, Op};
use lodge::ops::footprint::Footprint;
use lodge::ops::read_cityjson::ReadCityjson;
use lodge::ops::read_geojson::ReadGeojson;
use support::{gzip, read_files};

/// A file of the real data, if there is any.
fn data(path: &str) -> Option<(&str, Vec<u8>)> {
    let Some(folder) = std::env::var_os("LODGE_DATA") else {
        println!("skipped: LODGE_DATA is not set");
        return None;
    };
    Some((path, std::fs::read(PathBuf::from(folder).join(path)).unwrap()))
}

fn counts(f: &Findings) -> [u64; 4] {
    let [read, accepted, rejected, filtered] =
        ["read", "accepted", "rejected", "filtered"].map(|k| f.facts[k].as_u64().unwrap());
    assert_eq!(read, accepted + rejected + filtered);
    assert_eq!(rejected, f.rejects.len() as u64);
    [read, accepted, rejected, filtered]
}

#[test]
fn every_building_of_the_real_files() {
    for (file, params, expected) in [
        ("tokyo_setagaya", "", [127_212, 127_212, 0, 0]),
        ("tokyo_centre", "", [18_718, 18_718, 0, 0]),
        ("boston_z13_footprints", "", [19_316, 19_316, 0, 0]),
        ("liechtenstein_osm", "where.layer = 'building'", [0, 8_994, 0, 0]),
        ("monaco_osm", "where.layer = 'building'", [0, 1_207, 0, 0]),
        ("helsinki_osm", "where.layer = 'building'", [0, 446, 0, 0]),
        ("andorra_osm", "where.layer = 'building'", [0, 292, 0, 0]),
    ] {
        let path = format!("buildings/{file}.geojson.gz");
        let Some(file) = data(&path) else { return };
        let (out, findings) = read_files::<ReadGeojson>(params, &[file]);
        let out: Footprints = out.unwrap();
        let [read, accepted, rejected, filtered] = counts(&findings);
        println!("{path}: {read} {accepted} {rejected} {filtered} {:?}", findings.facts);
        assert_eq!((accepted, rejected), (expected[1], expected[2]), "{path}: {:?}", findings.rejects);
        assert_eq!(out.len() as u64, accepted);
        if expected[0] > 0 {
            assert_eq!(read, expected[0]);
        }
    }
}

#[test]
fn every_building_of_the_city_models() {
    for (file, buildings, parts, lods) in [
        ("3dbag_tile5908_99b.city.jsonl", 99, 100, &[("0", 99), ("1.2", 99), ("1.3", 99), ("2.2", 99)][..]),
        ("3dbag_tile901_52b.city.jsonl", 52, 52, &[("0", 52), ("1.2", 52), ("1.3", 52), ("2.2", 52)]),
        ("3dbag_multi_lod_10b.city.json", 10, 0, &[("1.2", 10), ("1.3", 10), ("2.2", 10)]),
        ("vienna_lod2.city.jsonl", 149, 443, &[("2", 149)]),
        ("delft_lod1_themes.city.json", 160, 0, &[("1", 160)]),
    ] {
        let path = format!("citylod/{file}");
        let Some(file) = data(&path) else { return };
        let (out, findings) = read_files::<ReadCityjson>("", &[file]);
        println!("{path}: {:?} {:?} {:?}", findings.facts, findings.warnings, findings.rejects);
        let out: Buildings = out.unwrap();
        let [_, accepted, rejected, _] = counts(&findings);
        assert_eq!((accepted, rejected), (buildings, 0), "{path}");
        assert_eq!(findings.facts["parts"], parts, "{path}");
        // What has no place here is counted: of the parts' attributes, and beside the surfaces.
        let left = |key: &str, name: &str| findings.facts.get(key).map_or(0, |all| all[name].as_u64().unwrap_or(0));
        let edges = left("left_members", "semantics.on_footprint_edge");
        assert_eq!(edges, if path.contains("3dbag_tile") { 6 * parts } else { 0 }, "{path}");
        let heights = left("left_part_attributes", "measuredHeight");
        assert_eq!(heights, if path.contains("vienna") { 102 } else { 0 }, "{path}");
        let mut found = std::collections::BTreeMap::<&str, u64>::new();
        out.lods.iter().for_each(|l| *found.entry(l).or_default() += 1);
        assert_eq!(found.into_iter().collect::<Vec<_>>(), lods, "{path}");
        // Every building stands on something.
        let bench = Bench::default();
        let flat = Footprint::default().run(&bench.ctx(), Inputs::take(vec![vec![Arc::new(out)]]));
        let findings = bench.report.finish();
        println!("  {:?} {:?}", findings.facts, findings.rejects);
        assert_eq!(flat.unwrap().len() as u64, buildings, "{path}");
    }
}

#[test]
fn every_conformance_case() {
    let Some(folder) = std::env::var_os("LODGE_DATA") else {
        println!("skipped: LODGE_DATA is not set");
        return;
    };
    let folder = PathBuf::from(folder).join("peer/cityjson/conformance_v2_0");
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    assert_eq!(files.len(), 34);
    for path in files {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let (out, findings) =
            read_files::<ReadCityjson>("max-rejected = 1.0", &[(&name, std::fs::read(&path).unwrap())]);
        let said = match out {
            Ok(out) => format!("{} buildings, {:?}", out.len(), out.lods.iter().collect::<Vec<_>>()),
            Err(e) => e.to_string(),
        };
        println!("{name}: {said} {:?}", findings.facts);
        if findings.facts.contains_key("read") {
            counts(&findings);
        }
    }
}

// ---------------------------------------------------------------------------------------------------- bad input

/// A feature with these properties and this geometry, on a line of its own.
fn feature(properties: &str, kind: &str, coordinates: &str) -> String {
    format!(
        r#"{{"type":"Feature","properties":{{{properties}}},"geometry":{{"type":"{kind}","coordinates":{coordinates}}}}}"#
    )
}

/// A house of about 8 by 11 m at a lon, lat near 7, 43.
fn house(id: &str, k: usize) -> String {
    let (x, y) = (7.0 + 0.001 * k as f64, 43.0);
    let ring = format!("[[[{x},{y}],[{},{y}],[{},{}],[{x},{}],[{x},{y}]]]", x + 1e-4, x + 1e-4, y + 1e-4, y + 1e-4);
    feature(&format!(r#""id":"{id}","height":9"#), "Polygon", &ring)
}

fn collection(features: &[String]) -> Vec<u8> {
    format!("{{\"type\":\"FeatureCollection\",\"features\":[\n{}\n]}}\n", features.join(",\n")).into_bytes()
}

fn geojson(features: &[String]) -> (Result<Footprints>, Findings) {
    read_files::<ReadGeojson>("", &[("a.geojson", collection(features))])
}

#[test]
fn a_file_cut_off() {
    let whole = gzip(collection(&(0..2000).map(|k| house(&k.to_string(), k % 50)).collect::<Vec<_>>()));
    for cut in [5, whole.len() / 2, whole.len() - 4] {
        let e = read_files::<ReadGeojson>("", &[("a.geojson.gz", whole[..cut].to_vec())]).0.unwrap_err();
        assert_eq!(e.message, "`a.geojson.gz` ends in the middle of its compressed data");
        let e = read_files::<ReadCityjson>("", &[("a.geojson.gz", whole[..cut].to_vec())]).0.unwrap_err();
        assert_eq!(e.code, "bad-gzip");
    }
    let text = collection(&[house("a", 0), house("b", 1)]);
    let e = read_files::<ReadGeojson>("", &[("a.geojson", text[..text.len() - 20].to_vec())]).0.unwrap_err();
    assert_eq!(e.message, "a.geojson:3: broken JSON: the text ends too early");
}

#[test]
fn broken_json_has_its_line() {
    let text = String::from_utf8(collection(&[house("a", 0), house("b", 1), house("c", 2)])).unwrap();
    let e = read_files::<ReadGeojson>("", &[("a.geojson", text.replace("\"b\"", "\"b").into_bytes())]).0.unwrap_err();
    assert!(e.message.starts_with("a.geojson:3: broken JSON: "), "{e}");
}

#[test]
fn coordinates_that_are_none() {
    let ring = |x: &str| format!("[[[{x},43],[7.001,43],[7.001,43.001],[{x},43]]]");
    let odd = ["NaN", "1e300", "-Infinity", "181", "null", "\"7\""];
    let mut all: Vec<String> =
        odd.iter().map(|x| feature(&format!(r#""id":"at {}""#, x.replace('"', "")), "Polygon", &ring(x))).collect();
    all.extend((0..20).map(|k| house(&format!("h{k}"), k)));
    let (out, f) = geojson(&all);
    assert_eq!(out.unwrap().len(), 20);
    assert_eq!(counts(&f), [26, 20, 6, 0]);
    let causes: Vec<_> = f.rejects.iter().map(|n| (n.id.as_str(), n.place.as_str(), n.cause.as_str())).collect();
    let outside = "a coordinate outside lon -180 to 180, lat -90 to 90";
    assert_eq!(
        causes,
        [
            ("at NaN", "a.geojson:2", "a coordinate that is not finite"),
            ("at 1e300", "a.geojson:3", outside),
            ("at -Infinity", "a.geojson:4", "a coordinate that is not finite"),
            ("at 181", "a.geojson:5", outside),
            ("at null", "a.geojson:6", "coordinates that are not numbers"),
            ("at 7", "a.geojson:7", "coordinates that are not numbers"),
        ]
    );
    // Projected: what no system reaches.
    let metres = feature(r#""id":"a""#, "Polygon", "[[[90000,440000],[90009,440000],[90000,440009],[90000,440000]]]");
    let all = [metres, feature(r#""id":"b""#, "Polygon", &ring("1e300"))];
    let (out, f) = read_files::<ReadGeojson>("crs = 'EPSG:28992'", &[("a.geojson", collection(&all))]);
    assert_eq!((out.unwrap().len(), f.rejects[0].cause.as_str()), (1, "a coordinate beyond 100,000 km"));
}

#[test]
fn polygons_that_are_none() {
    let all = [
        house("a", 0),
        house("b", 1),
        house("c", 2),
        feature(r#""id":"two points""#, "Polygon", "[[[7,43],[7.001,43],[7,43]]]"),
        feature(r#""id":"one place""#, "Polygon", "[[[7,43],[7,43],[7,43],[7,43]]]"),
        feature(r#""id":"nothing""#, "Polygon", "[]"),
        r#"{"type":"Feature","properties":{"id":"null"},"geometry":null}"#.to_string(),
        house("a", 3),
        feature(
            r#""id":"hole outside""#,
            "Polygon",
            "[[[7,43],[7.001,43],[7.001,43.001],[7,43]],[[8,43],[8.001,43],[8.001,43.001],[8,43]]]",
        ),
        feature(r#""id":"below","height":-2"#, "Polygon", "[[[7,43],[7.001,43],[7.001,43.001],[7,43]]]"),
    ];
    let (out, f) = read_files::<ReadGeojson>("max-rejected = 0.8", &[("a.geojson", collection(&all))]);
    let out = out.unwrap();
    assert_eq!(out.ids.iter().collect::<Vec<_>>(), ["a", "b", "c", "hole outside"]);
    assert_eq!(counts(&f), [10, 4, 6, 0]);
    let by_cause = serde_json::json!({
        "fewer than three corners": 2, "an empty geometry": 1, "no geometry": 1,
        "an id that an earlier feature has": 1, "a height of 0 or less": 1,
    });
    assert_eq!(f.facts["rejected_by_cause"], by_cause);
    assert_eq!(f.facts["repaired_by_cause"], serde_json::json!({ "a hole outside its shell was dropped": 1 }));
    // By default half may go, not more.
    assert_eq!(
        read_files::<ReadGeojson>("", &[("a.geojson", collection(&all))]).0.unwrap_err().code,
        "too-many-rejects"
    );
}

#[test]
fn none_one_and_all_at_one_place() {
    assert_eq!(geojson(&[]).0.unwrap_err().message, "no buildings in the input: 0 read, 0 filtered, 0 rejected");
    assert_eq!(geojson(&[house("a", 0)]).0.unwrap().len(), 1);
    let (out, f) = geojson(&(0..100).map(|k| house(&k.to_string(), 7)).collect::<Vec<_>>());
    assert_eq!((out.unwrap().len(), counts(&f)), (100, [100, 100, 0, 0]));
}

#[test]
fn mixed_geometry_types() {
    let all = [
        house("a", 0),
        feature("", "Point", "[7,43]"),
        feature("", "LineString", "[[7,43],[8,43]]"),
        feature("", "Point", "[7,44]"),
        r#"{"type":"Feature","properties":{},"geometry":{"type":"GeometryCollection","geometries":[]}}"#.to_string(),
        feature(
            r#""id":"m""#,
            "MultiPolygon",
            "[[[[7,43],[7.0001,43],[7,43.0001],[7,43]]],[[[7.001,43],[7.0011,43],[7.001,43.0001],[7.001,43]]]]",
        ),
    ];
    let (out, f) = geojson(&all);
    let out = out.unwrap();
    assert_eq!((out.len(), out.polygons.polygons_of(1).len(), counts(&f)), (2, 2, [6, 2, 0, 4]));
    let by_type = serde_json::json!({ "GeometryCollection": 1, "LineString": 1, "Point": 2 });
    assert_eq!(f.facts["filtered_by_type"], by_type);
}

#[test]
fn a_height_column_of_texts() {
    let all: Vec<String> = ["12.5", "8 m", "tall", "", "-3", "NaN"]
        .iter()
        .enumerate()
        .map(|(k, h)| house(&k.to_string(), k).replace(":9", &format!(":\"{h}\"")))
        .collect();
    let (out, f) = geojson(&all);
    assert_eq!(out.unwrap().top, [12.5, 8.0, 3.0, 3.0, 3.0]);
    assert_eq!(counts(&f), [6, 5, 1, 0]);
    assert_eq!((&f.facts["unreadable_heights"], &f.facts["defaulted_heights"]), (&3.into(), &3.into()));
}

#[test]
fn ids_over_several_files() {
    let a = ("a.geojson", collection(&[house("1", 0), house("x", 1).replace(r#""id":"x","#, "")]));
    let b = ("b.geojson", collection(&[house("1", 2), house("x", 3).replace(r#""id":"x","#, "")]));
    let (out, f) = read_files::<ReadGeojson>("", &[a, b]);
    // The row of the second is 1, an id that the first feature has: rows run on, names win by order.
    assert_eq!(out.unwrap().ids.iter().collect::<Vec<_>>(), ["1", "3"]);
    let places: Vec<_> = f.rejects.iter().map(|n| n.place.as_str()).collect();
    assert_eq!(places, ["a.geojson:3", "b.geojson:2"]);
}

#[test]
fn a_city_model_without_a_transform() {
    let text = br#"{"type":"CityJSON","version":"2.0","CityObjects":{},"vertices":[]}"#.to_vec();
    let e = read_files::<ReadCityjson>("", &[("a.city.json", text)]).0.unwrap_err();
    assert_eq!(e.message, "a.city.json:1: this CityJSON has no `transform`");
    let e =
        read_files::<ReadCityjson>("", &[("a.city.json", b"{\"type\":\"CityJSON\",\n\"vertices\":[[1,2]]}".to_vec())])
            .0;
    assert_eq!(e.unwrap_err().message, "a.city.json:2: broken JSON: expected a vertex of three numbers");
}

#[test]
fn no_cut_and_no_flipped_byte_panics() {
    let text = collection(&[house("a", 0), feature("", "LineString", "[[7,43],[8,43]]"), house("b", 1)]);
    let cube = br#"{"type":"CityJSON","version":"2.0","transform":{"scale":[0.01,0.01,0.01],"translate":[0,0,0]},
        "CityObjects":{"a":{"type":"Building","geometry":[{"type":"MultiSurface","lod":"1","boundaries":[[[0,1,2]]],
        "semantics":{"surfaces":[{"type":"GroundSurface"}],"values":[0]}}]}},"vertices":[[0,0,0],[100,0,0],[0,100,0]]}"#;
    for at in 0..text.len() {
        for byte in [b' ', b'"', b'[', b'9', b'}', 0xff] {
            let mut t = text.clone();
            t[at] = byte;
            let _ = read_files::<ReadGeojson>("", &[("a", t)]);
        }
        let _ = read_files::<ReadGeojson>("", &[("a", text[..at].to_vec())]);
    }
    for at in 0..cube.len() {
        for byte in [b' ', b'"', b'[', b'9', b'}', 0xff] {
            let mut t = cube.to_vec();
            t[at] = byte;
            let _ = read_files::<ReadCityjson>("", &[("a", t)]);
        }
        assert!(read_files::<ReadCityjson>("", &[("a", cube[..at].to_vec())]).0.is_err());
    }
    assert_eq!(read_files::<ReadCityjson>("", &[("a", cube.to_vec())]).0.unwrap().len(), 1);
}

#[test]
fn layers_survive_being_written() {
    let Some(file) = data("buildings/monaco_osm.geojson.gz") else { return };
    let (out, _) = read_files::<ReadGeojson>("where.layer = 'building'", &[file]);
    let out = out.unwrap();
    let bytes = lodge::io::geojson::footprints(&out).unwrap();
    let (again, f) = read_files::<ReadGeojson>("", &[("monaco.geojson", bytes)]);
    let again = again.unwrap();
    assert_eq!(counts(&f), [1207, 1207, 0, 0]);
    assert_eq!(again.frame, out.frame);
    let far = again
        .polygons
        .points
        .iter()
        .zip(&out.polygons.points)
        .map(|(a, b)| (a[0] - b[0]).abs().max((a[1] - b[1]).abs()));
    assert!(far.max().unwrap() <= 1);
    let differ = again.top.iter().zip(&out.top).filter(|(a, b)| (*a - *b).abs() > 1e-6).count();
    assert_eq!((again.base.len(), differ), (out.base.len(), 0));
}
