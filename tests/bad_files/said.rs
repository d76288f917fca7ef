//! What collections say twice, in another way, or against each other; and what stands among features but is none.

use lodge::artifact::Buildings;
use lodge::diag::{Findings, Result};
use lodge::op::Op;
use lodge::ops::read_cityjson::ReadCityjson;
use lodge::ops::read_geojson::ReadGeojson;
use lodge::ops::read_lines::ReadLines;

use super::{counts, read, read_files, rejects};

/// A square of 100 m at `[x, y]` in metres, or of a thousandth of a degree.
fn square(id: &str, [x, y]: [f64; 2]) -> String {
    let d = if x > 180.0 { 100.0 } else { 0.001 };
    let ring = format!("[{x},{y}],[{},{y}],[{},{}],[{x},{y}]", x + d, x + d, y + d);
    format!(
        r#"{{"type":"Feature","properties":{{"id":"{id}"}},"geometry":{{"type":"Polygon","coordinates":[[{ring}]]}}}}"#
    )
}

const DUTCH: [f64; 2] = [85_000.0, 447_000.0];
const LONLAT: [f64; 2] = [4.35, 52.0];
const RD: &str = r#""crs":{"type":"name","properties":{"name":"urn:ogc:def:crs:EPSG::28992"}},"#;
const UTM: &str = r#""crs":{"type":"name","properties":{"name":"EPSG:25832"}},"#;
const WGS84: &str = r#""crs":{"type":"name","properties":{"name":"urn:ogc:def:crs:OGC:1.3:CRS84"}},"#;

/// The first feature is on line 2.
fn collection(crs: &str, features: &[String]) -> String {
    format!("{{\"type\":\"FeatureCollection\",{crs}\"features\":[\n{}\n]}}\n", features.join(",\n"))
}

fn both(params: &str, files: &[(&str, &str)]) -> [Result<usize, String>; 2] {
    let files: Vec<_> = files.iter().map(|(name, text)| (*name, text.as_bytes().to_vec())).collect();
    fn of<O: Op>(params: &str, files: &[(&str, Vec<u8>)], len: impl Fn(O::Out) -> usize) -> Result<usize, String> {
        read_files::<O>(params, files).0.map(len).map_err(|e| e.message)
    }
    [of::<ReadGeojson>(params, &files, |o| o.len()), of::<ReadLines>(params, &files, |o| o.len())]
}

#[test]
fn features_in_two_lists() {
    let ones: Vec<String> = (0..5000).map(|k| square(&format!("a{k}"), [7.0 + 1e-4 * k as f64, 43.0])).collect();
    let twos: Vec<String> = (0..5000).map(|k| square(&format!("b{k}"), [7.0 + 1e-4 * k as f64, 44.0])).collect();
    let text = |second: &str| {
        let one = collection("", &ones);
        one.replace("\n]}", &format!("\n],\"name\":\"x\",\n\"features\":{second},\"features\":[ ],\"bbox\":[1]}}"))
    };
    let good = text(&format!("[{}]", twos.join(",\n")));
    assert_eq!(both("", &[("a.geojson", &good)]), [Ok(10_000), Ok(10_000)]);
    for second in ["{}", "null", "5"] {
        let message = "a.geojson:5003: not GeoJSON: its second `features` is not a list".to_string();
        assert_eq!(both("", &[("a.geojson", &text(second))]), [Err(message.clone()), Err(message)]);
    }
}

#[test]
fn files_of_two_systems() {
    let dutch = collection(RD, &[square("d", DUTCH)]);
    let unsaid = collection("", &[square("u", LONLAT)]);
    let none = collection(r#""crs":null,"#, &[square("n", DUTCH)]);
    let said = collection(WGS84, &[square("w", LONLAT)]);
    let empty = collection("", &[]);
    let more = collection("", &[square("v", LONLAT)]);
    let refused = |files: &[(&str, &str)], message: &str| {
        assert_eq!(both("", files), [Err(message.to_string()), Err(message.to_string())]);
    };
    let lonlat = "`a` is in `EPSG:28992` but `b` names none, which means lon/lat";
    refused(&[("a", &dutch), ("b", &unsaid)], lonlat);
    refused(&[("b", &unsaid), ("a", &dutch)], lonlat);
    refused(&[("a", &dutch), ("b", &none)], "`a` is in `EPSG:28992` but `b` says that it has none");
    refused(&[("a", &said), ("b", &none)], "`a` is in `OGC:CRS84` but `b` says that it has none");
    // The parameter stands above all; what means the same, or holds nothing, may stay.
    let bare = collection("", &[square("b", DUTCH)]);
    for (params, files, n) in [
        ("crs = 'EPSG:28992'", [&dutch, &bare], 2),
        ("crs = 'EPSG:28992'", [&dutch, &none], 2),
        ("", [&said, &unsaid], 2),
        ("", [&more, &unsaid], 2),
        ("", [&dutch, &empty], 1),
    ] {
        assert_eq!(both(params, &[("a", files[0]), ("b", files[1])]), [Ok(n), Ok(n)], "{params}");
    }
}

#[test]
fn two_systems_in_one_file() {
    let dutch = collection(RD, &[square("d", DUTCH)]);
    for (other, message) in [
        (collection(UTM, &[square("u", DUTCH)]), "`a:1` is in `EPSG:28992` but `a:4` in `EPSG:25832`"),
        (collection("", &[square("u", LONLAT)]), "`a:1` is in `EPSG:28992` but `a:4` names none, which means lon/lat"),
    ] {
        let both = both("", &[("a", &format!("{dutch}{other}"))]);
        assert_eq!(both, [Err(message.to_string()), Err(message.to_string())]);
    }
    let twice =
        collection(UTM, &[square("d", DUTCH)]).replace("\n]}", &format!("\n],\n{}}}", RD.trim_end_matches(',')));
    let message = "`a:1` is in `EPSG:25832` but `a:4` in `EPSG:28992`".to_string();
    assert_eq!(both("", &[("a", &twice)]), [Err(message.clone()), Err(message)]);
    let same = format!("{dutch}{}", collection(RD, &[square("e", DUTCH)]));
    assert_eq!(both("", &[("a", &same)]), [Ok(2), Ok(2)]);
}

#[test]
fn systems_said_in_another_form() {
    for form in [r#""EPSG:28992""#, r#""urn:ogc:def:crs:EPSG::28992""#] {
        let (out, f) = read::<ReadGeojson>("", "a", collection(&format!("\"crs\":{form},"), &[square("d", DUTCH)]));
        assert_eq!((out.unwrap().frame.crs.as_str(), f.warnings.len()), ("EPSG:28992", 0));
    }
    for form in [r#"{"type":"link","properties":{"href":"x","type":"proj4"}}"#, "5", "[]", "{}", "true"] {
        let text = collection(&format!("\"crs\":{form},"), &[square("d", LONLAT)]);
        let (out, f) = read::<ReadGeojson>("", "a", text.as_str());
        assert_eq!(out.unwrap().frame.crs, "OGC:CRS84");
        assert_eq!(
            f.warnings,
            ["`a`: a `crs` that is neither a name nor null is not read; say it by `crs = \"EPSG:..\"`"],
            "{form}"
        );
        assert_eq!(read::<ReadGeojson>("crs = 'EPSG:4326'", "a", text).1.warnings.len(), 0);
    }
}

#[test]
fn what_is_no_feature_among_features() {
    let bogus =
        ["null", "5", "[]", "[[1]]", "{}", "\"x\"", "true", r#"{"type":"Bogus","id":"x"}"#, r#"{"features":[{}]}"#];
    let mut all = vec![square("a", LONLAT)];
    all.extend(bogus.map(str::to_string));
    all.push(square("z", LONLAT));
    let text = collection("", &all);
    let judge = |f: &Findings| {
        assert_eq!(counts(f), [11, 2, 9, 0]);
        for (k, [id, place, cause]) in rejects(f).into_iter().enumerate() {
            assert_eq!((id, place, cause), (&*(k + 1).to_string(), &*format!("a:{}", k + 3), "not a feature"));
        }
    };
    let (out, f) = read::<ReadGeojson>("max-rejected = 0.9\nwhere.id = ['a', 'z']", "a", text.as_str());
    assert_eq!(out.unwrap().ids.iter().collect::<Vec<_>>(), ["a", "z"]);
    judge(&f);
    let (out, f) = read::<ReadLines>("max-rejected = 0.9", "a", text.as_str());
    assert_eq!(out.unwrap().len(), 2);
    judge(&f);
    let e = read::<ReadGeojson>("", "a", text.replace("\ntrue,", "\ntruth,")).0.unwrap_err();
    assert!(e.code == "bad-json" && e.message.starts_with("a:9: broken JSON: "), "{e}");
}

/// A city model of one line, its building at `x` metres.
fn model(id: &str, crs: &str, objects: &str) -> String {
    let crs = if crs.is_empty() { String::new() } else { format!(r#""metadata":{{"referenceSystem":"{crs}"}},"#) };
    let geometry = r#"[{"type":"MultiSurface","lod":"1","boundaries":[[[0,1,2]]]}]"#;
    format!(
        "{{\"type\":\"CityJSON\",\"version\":\"2.0\",{crs}\"transform\":{{\"scale\":[1,1,1],\"translate\":[0,0,0]}},\
         \"CityObjects\":{{\"{id}\":{{\"type\":\"Building\",\"geometry\":{geometry}}}{objects}}},\
         \"vertices\":[[85000,447000,0],[85010,447000,0],[85000,447010,0]]}}\n"
    )
}

fn cities(files: &[(&str, String)]) -> (Result<Buildings>, Findings) {
    let files: Vec<_> = files.iter().map(|(name, text)| (*name, text.clone().into_bytes())).collect();
    read_files::<ReadCityjson>("max-rejected = 0.9", &files)
}

#[test]
fn city_models_of_two_systems() {
    let [a, b, c] = [("a", "EPSG:28992"), ("b", "EPSG:25832"), ("c", "")].map(|(id, crs)| model(id, crs, ""));
    let e = cities(&[("x", format!("{a}{b}"))]).0.unwrap_err();
    assert_eq!(e.message, "`x:1` is in `EPSG:28992` but `x:2` in `EPSG:25832`");
    // A second header without a system goes on in the first one's; another file is told.
    let (out, f) = cities(&[("x", format!("{a}{c}"))]);
    assert_eq!((out.unwrap().frame.crs.as_str(), f.warnings.len()), ("EPSG:28992", 0));
    let (out, f) = cities(&[("x", a), ("y", c)]);
    assert_eq!(out.unwrap().len(), 2);
    assert_eq!(f.warnings, ["`y` names no system: taken to be in `EPSG:28992`, as `x` is"]);
}

#[test]
fn what_is_no_city_object_among_them() {
    let more = r#","n":null,"l":[1],"g":{"type":"Building","geometry":[null]},"b":{"type":"Bridge"}"#;
    let (out, f) = cities(&[("x", model("a", "", more))]);
    assert_eq!(out.unwrap().ids.iter().collect::<Vec<_>>(), ["a"]);
    assert_eq!(counts(&f), [5, 1, 3, 1]);
    let none = "not a city object";
    assert_eq!(rejects(&f), [["n", "x:1", none], ["l", "x:1", none], ["g", "x:1", "a geometry that is not an object"]]);
}
