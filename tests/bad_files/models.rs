//! read-cityjson.

use lodge::artifact::Buildings;
use lodge::diag::{Diagnostic, Findings, Result};
use lodge::ops::read_cityjson::ReadCityjson;
use serde_json::{Value, json};

use super::{counts, forged, gzip, read, rejects};

/// A triangle of ground for each id, of vertices 3k, 3k + 1, 3k + 2; each object on a line of its own, the first on 2.
fn objects(ids: &[&str]) -> String {
    let one = |(k, id): (usize, &&str)| {
        let [a, b, c] = [0, 1, 2].map(|v| 3 * k + v);
        format!(
            r#""{id}":{{"type":"Building","geometry":[{{"type":"MultiSurface","lod":"1","boundaries":[[[{a},{b},{c}]]]}}]}}"#
        )
    };
    ids.iter().enumerate().map(one).collect::<Vec<_>>().join(",\n")
}

fn vertices(n: usize) -> String {
    let all = (0..n).map(|k| format!("[{0},0,0],[{1},0,0],[{0},1000,0]", 2000 * k, 2000 * k + 1000));
    format!("[\n{}\n]", all.collect::<Vec<_>>().join(",\n"))
}

const TRANSFORM: &str = r#""transform":{"scale":[0.001,0.001,0.001],"translate":[0,0,0]}"#;

/// On lines: the head, an object each, the transform, `[`, the vertices of an object each.
fn model(ids: &[&str]) -> String {
    let (objects, vertices) = (objects(ids), vertices(ids.len()));
    format!(
        "{{\"type\":\"CityJSON\",\"version\":\"2.0\",\"CityObjects\":{{\n{objects}}},\n{TRANSFORM},\"vertices\":{vertices}}}\n"
    )
}

/// A header, then a line for each.
fn sequence(ids: &[&str]) -> String {
    let one = |id: &&str| {
        let (objects, vertices) = (objects(&[id]), vertices(1).replace('\n', ""));
        format!(r#"{{"type":"CityJSONFeature","id":"{id}","CityObjects":{{{objects}}},"vertices":{vertices}}}"#)
    };
    let head = format!(r#"{{"type":"CityJSON","version":"2.0",{TRANSFORM},"CityObjects":{{}},"vertices":[]}}"#);
    let lines: Vec<String> = [head].into_iter().chain(ids.iter().map(one)).collect();
    lines.join("\n") + "\n"
}

fn city(text: &str) -> (Result<Buildings>, Findings) {
    read::<ReadCityjson>("max-rejected = 0.9", "a.city.json", text)
}

fn refused(text: &str) -> Box<Diagnostic> {
    city(text).0.unwrap_err()
}

#[test]
fn a_city_model_cut_off() {
    let names: Vec<String> = (0..2000).map(|k| format!("house {k}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    for text in [model(&names), sequence(&names)] {
        let packed = gzip(&text);
        for cut in [5, packed.len() / 2, packed.len() - 4] {
            let e = read::<ReadCityjson>("", "a.city.json.gz", &packed[..cut]).0.unwrap_err();
            assert_eq!(e.message, "`a.city.json.gz` ends in the middle of its compressed data", "{cut}");
        }
        let e = read::<ReadCityjson>("", "a.city.json.gz", forged(&text, "1000,0,0", "1007,0,0")).0.unwrap_err();
        assert!(e.message.starts_with("`a.city.json.gz` holds damaged compressed data"), "{e}");
        assert_eq!(read::<ReadCityjson>("", "a.city.json.gz", packed).0.unwrap().len(), 2000);
    }
    let text = model(&["a", "b", "c"]);
    let at = text.find("\"c\"").unwrap() + 9;
    assert_eq!(refused(&text[..at]).message, "a.city.json:4: broken JSON: the text ends too early");
}

#[test]
fn a_city_model_of_broken_json() {
    let text = model(&["a", "b", "c"]);
    for (wrong, by, line) in [
        ("\"b\"", "\"b", 3),
        ("[[[6,7,8]]]", "[[[6,7,8]]", 4),
        ("[2000,0,0]", "[2000,0 0]", 7),
        ("[4000,0,0]", "[4000,0]", 8),
        ("[4000,0,0]", "[4000,0,0,0]", 8),
        ("[4000,0,0]", "[4000,0,null]", 8),
        ("[4000,0,0]", "[4000,0,\"0\"]", 8),
        ("[4000,0,0]", "4000", 8),
    ] {
        assert!(text.contains(wrong), "{wrong}");
        let e = refused(&text.replacen(wrong, by, 1));
        let place = format!("a.city.json:{line}: broken JSON: ");
        assert!(e.code == "bad-json" && e.message.starts_with(&place), "{by}: {e}");
    }
}

#[test]
fn a_sequence_broken_in_a_middle_line() {
    let text = sequence(&["a", "b", "c", "d"]);
    for (by, message) in [
        ("\"c", "a.city.json:4: broken JSON: "),
        ("}\"c\"", "a.city.json:4: broken JSON: "),
        ("nul", "a.city.json:4: broken JSON: "),
    ] {
        let e = refused(&text.replacen("\"c\"", by, 1));
        assert!(e.code == "bad-json" && e.message.starts_with(message), "{by}: {e}");
    }
    let third = text.lines().nth(3).unwrap();
    // Half a line; a line of another kind; a header in the middle without a transform.
    let e = refused(&text.replace(third, &third[..third.len() / 2]));
    assert!(e.code == "bad-json" && e.message.starts_with("a.city.json:"), "{e}");
    let e = refused(&text.replace(third, r#"{"type":"Feature","id":"c"}"#));
    assert_eq!(e.message, "a.city.json:4: not CityJSON: its type is `Feature`");
    let e = refused(&text.replace(third, r#"{"type":"CityJSON","CityObjects":{},"vertices":[]}"#));
    assert_eq!(e.message, "a.city.json:4: this CityJSON has no `transform`");
    // What can be read but not used costs its own feature.
    let nothing = r#"{"type":"CityJSONFeature","id":"c","CityObjects":{},"vertices":[]}"#;
    let (out, f) = city(&text.replace(third, nothing));
    assert_eq!((out.unwrap().ids.iter().collect::<Vec<_>>(), counts(&f)), (vec!["a", "b", "d"], [3, 3, 0, 0]));
    let (out, f) = city(&text.replace(third, &third.replace("[[[0,1,2]]]", "[[[0,1,3]]]")));
    assert_eq!((out.unwrap().ids.iter().collect::<Vec<_>>(), counts(&f)), (vec!["a", "b", "d"], [4, 3, 1, 0]));
    assert_eq!(rejects(&f), [["c", "a.city.json:4", "a vertex that does not exist"]]);
}

#[test]
fn vertices_that_are_none() {
    let (infinite, far) = ("a coordinate that is not finite", "a coordinate beyond 100,000 km");
    let high = "a vertex higher or lower than 10,000 m";
    for (vertex, cause) in [
        ("[NaN,0,0]", infinite),
        ("[2000,0,NaN]", infinite),
        ("[2000,-Infinity,0]", infinite),
        ("[1e999,0,0]", infinite),
        ("[1e300,0,0]", far),
        ("[2000,-1e300,0]", far),
        ("[2000,0,1e300]", high),
        ("[2000,0,-1e8]", high),
    ] {
        for (text, line) in [(model(&["a", "b", "c"]), 3), (sequence(&["a", "b", "c"]), 3)] {
            let broken = if text.contains("Feature") {
                replaced_in_line(&text, 2, "[0,0,0]", vertex)
            } else {
                text.replacen("[2000,0,0]", vertex, 1)
            };
            assert_ne!(broken, text);
            let (out, f) = city(&broken);
            let out = out.unwrap_or_else(|e| panic!("{vertex}: {e}"));
            assert_eq!(out.ids.iter().collect::<Vec<_>>(), ["a", "c"], "{vertex}");
            assert_eq!(counts(&f), [3, 2, 1, 0], "{vertex}");
            assert_eq!(rejects(&f), [["b", &format!("a.city.json:{line}"), cause]], "{vertex}");
        }
    }
    // A vertex that nobody uses hurts nobody.
    let text = model(&["a", "b", "c"]).replace("\n]}", ",[NaN,1e300,0]\n]}");
    let (out, f) = city(&text);
    assert_eq!((out.unwrap().len(), counts(&f)), (3, [3, 3, 0, 0]));
}

fn replaced_in_line(text: &str, line: usize, wrong: &str, by: &str) -> String {
    let line = text.lines().nth(line).unwrap();
    text.replacen(line, &line.replacen(wrong, by, 1), 1)
}

#[test]
fn vertices_out_of_range() {
    let text = model(&["a", "b", "c"]);
    let (missing, none) = ("a vertex that does not exist", "boundaries that are not lists of vertices");
    for (index, cause) in [
        ("9", missing),
        ("4294967294", missing),
        ("4294967296", none),
        ("-1", none),
        ("1.5", none),
        ("1e300", none),
        ("NaN", none),
        ("null", none),
    ] {
        let (out, f) = city(&text.replacen("[[[3,4,5]]]", &format!("[[[3,{index},5]]]"), 1));
        assert_eq!(out.unwrap().ids.iter().collect::<Vec<_>>(), ["a", "c"], "{index}");
        assert_eq!((counts(&f), rejects(&f)), ([3, 2, 1, 0], vec![["b", "a.city.json:3", cause]]), "{index}");
    }
    // None at all.
    let none: String = text.replace(&vertices(3), "[]");
    let e = refused(&none);
    assert_eq!(
        e.message,
        "no buildings in the input: 3 read, 0 filtered, 3 rejected; the first: `a` (a.city.json:2): a vertex that does not exist"
    );
}

#[test]
fn transforms_that_are_none() {
    for text in [model(&["a", "b"]), sequence(&["a", "b"])] {
        for by in [
            r#""transform":{"scale":[0.001,0.001,NaN],"translate":[0,0,0]}"#,
            r#""transform":{"scale":[0.001,0.001,1e999],"translate":[0,0,0]}"#,
            r#""transform":{"scale":[0.001,0.001],"translate":[0,0,0]}"#,
            r#""transform":{"scale":[0.001,0.001,"x"],"translate":[0,0,0]}"#,
            r#""transform":{"scale":0.001,"translate":[0,0,0]}"#,
            r#""transform":{"scale":[0.001,0.001,0.001]}"#,
            r#""transform":{}"#,
            r#""transform":[1,1,1]"#,
            r#""transform":null"#,
        ] {
            let e = refused(&text.replace(TRANSFORM, by));
            assert!(
                e.message.ends_with("its `transform` must have `scale` and `translate`, three finite numbers each"),
                "{by}: {e}"
            );
            assert!(e.code == "bad-transform" && e.message.starts_with("a.city.json:1: "), "{by}: {e}");
        }
        assert_eq!(refused(&text.replace(TRANSFORM, r#""other":0"#)).code, "no-transform");
        // Finite, and yet nowhere: every building says so.
        for (number, cause) in [("1e300", "a coordinate beyond 100,000 km"), ("0", "no surface of three corners")] {
            let by = format!(r#""transform":{{"scale":[{number},0.001,0.001],"translate":[{number},0,0]}}"#);
            let (out, f) = city(&text.replace(TRANSFORM, &by));
            assert!(out.unwrap_err().message.ends_with(&format!(": {cause}")));
            assert_eq!(counts(&f), [2, 0, 2, 0], "{number}");
        }
    }
}

#[test]
fn what_is_no_building_among_buildings() {
    let mut model: Value = serde_json::from_str(&model(&["a", "b", "c", "d", "e"])).unwrap();
    model["CityObjects"]["b"]["geometry"][0]["type"] = "MultiLineString".into();
    model["CityObjects"]["c"]["geometry"][0]["type"] = "Solid".into();
    model["CityObjects"]["d"]["type"] = "Bridge".into();
    let (out, f) = city(&model.to_string());
    assert_eq!(out.unwrap().ids.iter().collect::<Vec<_>>(), ["a", "e"]);
    assert_eq!(counts(&f), [5, 2, 1, 2]);
    assert_eq!(f.facts["filtered_by_type"], json!({ "Bridge": 1, "MultiLineString": 1 }));
    assert_eq!(rejects(&f), [["c", "a.city.json:1", "boundaries nested otherwise than their type says"]]);
}
