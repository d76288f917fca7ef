//! read-lines.

use lodge::artifact::Lines;
use lodge::diag::{Findings, Result};
use lodge::ops::read_lines::ReadLines;
use serde_json::json;

use super::{counts, forged, gzip, read, rejects};

/// A feature on a line of its own.
fn feature(id: &str, kind: &str, coordinates: &str) -> String {
    format!(
        r#"{{"type":"Feature","properties":{{"id":"{id}"}},"geometry":{{"type":"{kind}","coordinates":{coordinates}}}}}"#
    )
}

/// A street of some 80 m near 7, 43.
fn street(k: usize) -> String {
    let x = 7.0 + 0.001 * k as f64;
    feature(&format!("s{k}"), "LineString", &format!("[[{x},43],[{},43.0001]]", x + 0.001))
}

/// The first feature is on line 2.
fn collection(features: &[String]) -> String {
    format!("{{\"type\":\"FeatureCollection\",\"features\":[\n{}\n]}}\n", features.join(",\n"))
}

fn streets(n: usize) -> Vec<String> {
    (0..n).map(street).collect()
}

fn lines(text: &str) -> (Result<Lines>, Findings) {
    read::<ReadLines>("", "a.geojson", text)
}

fn ids(lines: &Lines) -> Vec<&str> {
    lines.ids.iter().collect()
}

#[test]
fn lines_of_a_file_cut_off() {
    let text = collection(&streets(3000));
    let packed = gzip(&text);
    for cut in [1, 5, packed.len() / 2, packed.len() - 4] {
        let e = read::<ReadLines>("", "a.geojson.gz", &packed[..cut]).0.unwrap_err();
        let wanted = if cut == 1 { "bad-json" } else { "bad-gzip" };
        assert_eq!((e.code, e.message.contains("a.geojson.gz")), (wanted, true), "{cut}: {e}");
    }
    let mut damaged = packed.clone();
    let middle = damaged.len() / 2;
    damaged[middle..middle + 64].fill(0);
    // What comes out of damaged data is nonsense before it is known to be damaged.
    let e = read::<ReadLines>("", "a.geojson.gz", damaged).0.unwrap_err();
    assert!(["bad-json", "bad-gzip"].contains(&e.code) && e.message.contains("a.geojson.gz"), "{e}");
    // One digit is another: only the checksum at the end knows.
    let e = read::<ReadLines>("", "a.geojson.gz", forged(&text, "43.0001", "43.0007")).0.unwrap_err();
    assert!(e.message.starts_with("`a.geojson.gz` holds damaged compressed data"), "{e}");
    assert_eq!(read::<ReadLines>("", "a.geojson.gz", packed).0.unwrap().len(), 3000);

    let text = collection(&streets(3));
    let e = lines(&text[..text.len() - 20]).0.unwrap_err();
    assert_eq!(e.message, "a.geojson:4: broken JSON: the text ends too early");
}

#[test]
fn lines_of_broken_json() {
    let text = collection(&streets(5));
    for (wrong, by, place) in [
        ("\"s2\"", "\"s2", "a.geojson:4: broken JSON: "),
        ("[7.001,43]", "[7.001 43]", "a.geojson:3: broken JSON: "),
        ("[7.004,43]", "[7.004,43}", "a.geojson:6: broken JSON: "),
        ("\n]}", "\n]", "a.geojson:7: broken JSON: the text ends too early"),
        ("{\"id\":\"s4\"}", "{\"id\":s4}", "a.geojson:6: broken JSON: "),
    ] {
        assert!(text.contains(wrong), "{wrong}");
        let e = lines(&text.replace(wrong, by)).0.unwrap_err();
        assert!(e.code == "bad-json" && e.message.starts_with(place), "{by}: {e}");
    }
    let e = lines("{\"type\":\"Topology\",\"objects\":{}}").0.unwrap_err();
    assert_eq!(e.message, "a.geojson:1: not GeoJSON: its type is `Topology`");
}

#[test]
fn lines_whose_coordinates_are_none() {
    let mut all = streets(10);
    for x in ["NaN", "-Infinity", "1e300", "1e999", "181", "null", "\"7\"", "[7]"] {
        let id = x.replace('"', "'");
        all.push(feature(&id, "LineString", &format!("[[7,43],[{x},43],[7.001,43]]")));
    }
    all.push(feature("one number", "LineString", "[[7,43],[7]]"));
    all.push(feature("two ways", "MultiLineString", "[[[7,43],[7.001,43]],[7,43]]"));
    all.push(street(10));
    let (out, f) = read::<ReadLines>("max-rejected = 0.8", "a.geojson", collection(&all));
    assert_eq!(ids(&out.unwrap()), (0..11).map(|k| format!("s{k}")).collect::<Vec<_>>());
    assert_eq!(counts(&f), [21, 11, 10, 0]);
    let outside = "a coordinate outside lon -180 to 180, lat -90 to 90";
    let (infinite, no_number) = ("a coordinate that is not finite", "coordinates that are not numbers");
    assert_eq!(
        rejects(&f),
        [
            ["NaN", "a.geojson:12", infinite],
            ["-Infinity", "a.geojson:13", infinite],
            ["1e300", "a.geojson:14", outside],
            ["1e999", "a.geojson:15", infinite],
            ["181", "a.geojson:16", outside],
            ["null", "a.geojson:17", no_number],
            ["'7'", "a.geojson:18", no_number],
            ["[7]", "a.geojson:19", "coordinates nested in two ways"],
            ["one number", "a.geojson:20", "a position of one number"],
            ["two ways", "a.geojson:21", "coordinates nested in two ways"],
        ]
    );
    // As many as half of them may be broken, unless told otherwise; nobody needs lines.
    assert_eq!(lines(&collection(&all[7..])).0.unwrap_err().code, "too-many-rejects");
    // In metres.
    let far = [street(0), feature("far", "LineString", "[[0,0],[1e300,1]]")];
    let metres = collection(&far).replace("[[7,43],[7.001,43.0001]]", "[[90000,440000],[90009,440000]]");
    let (out, f) = read::<ReadLines>("crs = 'EPSG:28992'", "a.geojson", metres);
    assert_eq!((out.unwrap().len(), rejects(&f)), (1, vec![["far", "a.geojson:3", "a coordinate beyond 100,000 km"]]));
}

#[test]
fn lines_without_length() {
    let all = [
        street(0),
        feature("one point", "LineString", "[[7,43]]"),
        feature("one place", "LineString", "[[7,43],[7,43],[7.0000000001,43]]"),
        feature("none", "LineString", "[]"),
        feature("no parts", "MultiLineString", "[[],[]]"),
        feature("short parts", "MultiLineString", "[[[7,43]],[[7,43],[7,43]]]"),
        feature("a short part", "MultiLineString", "[[[7,43]],[[7,43],[7.001,43]],[[7,43],[7,43.001]]]"),
        street(1),
    ];
    let (out, f) = read::<ReadLines>("max-rejected = 0.8", "a.geojson", collection(&all));
    assert_eq!(ids(&out.unwrap()), ["s0", "a short part/0", "a short part/1", "s1"]);
    assert_eq!(counts(&f), [8, 3, 5, 0]);
    let short = "a line without length";
    let empty = "an empty geometry";
    assert_eq!(
        rejects(&f),
        [
            ["one point", "a.geojson:3", short],
            ["one place", "a.geojson:4", short],
            ["none", "a.geojson:5", empty],
            ["no parts", "a.geojson:6", empty],
            ["short parts", "a.geojson:7", short],
        ]
    );
    assert_eq!(f.facts["repaired_by_cause"], json!({ "a part without length was dropped": 1 }));
    assert_eq!((f.repairs[0].id.as_str(), f.repairs[0].place.as_str()), ("a short part", "a.geojson:8"));
}

#[test]
fn lines_among_all_types_of_geometry() {
    let all = [
        street(0),
        feature("p", "Point", "[7,43]"),
        feature("m", "MultiPoint", "[[7,43],[8,43]]"),
        feature("ring", "Polygon", "[[[7,43],[7.001,43],[7.001,43.001],[7,43]]]"),
        feature(
            "rings",
            "MultiPolygon",
            "[[[[7,43],[7.001,43],[7,43.001],[7,43]]],[[[7,44],[7.001,44],[7,44.001],[7,44]]]]",
        ),
        feature("lines", "MultiLineString", "[[[7,43],[7.1,43]],[[7,43],[7,43.1]]]"),
        r#"{"type":"Feature","properties":{"id":"c"},"geometry":{"type":"GeometryCollection","geometries":[]}}"#.into(),
        r#"{"type":"Feature","properties":{"id":"n"},"geometry":null}"#.into(),
        feature("x", "Circle", "[7,43]"),
        // Its type is that of a line, its coordinates those of a polygon.
        feature("y", "LineString", "[[[7,43],[7.001,43],[7.001,43.001],[7,43]]]"),
    ];
    let (out, f) = lines(&collection(&all));
    assert_eq!(ids(&out.unwrap()), ["s0", "ring", "rings/0", "rings/1", "lines/0", "lines/1"]);
    assert_eq!(counts(&f), [10, 4, 2, 4]);
    assert_eq!(
        f.facts["filtered_by_type"],
        json!({ "Circle": 1, "GeometryCollection": 1, "MultiPoint": 1, "Point": 1 })
    );
    let nested = "coordinates nested otherwise than the geometry's type says";
    assert_eq!(rejects(&f), [["n", "a.geojson:9", "no geometry"], ["y", "a.geojson:11", nested]]);
}
