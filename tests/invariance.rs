//! The same city gives the same bytes: on any number of threads, from any folder, with its features in any order;
//! and the same answers when it is turned or moved. A small edit changes few files.

mod support;

use std::io::{Read, Write};

use serde_json::Value;
use support::{Place, node, project, real_data};

/// A city's text, one feature a line, as its features.
fn features(text: &str) -> Vec<Value> {
    let lines = text.lines().map(|l| l.trim().trim_end_matches(','));
    lines
        .filter(|l| l.starts_with(r#"{"type":"Feature","#))
        .map(|l| {
            serde_json::from_str(l.strip_suffix("]}").filter(|s| serde_json::from_str::<Value>(s).is_ok()).unwrap_or(l))
                .unwrap()
        })
        .collect()
}

fn collection(features: &[Value]) -> String {
    let lines: Vec<String> = features.iter().map(Value::to_string).collect();
    format!("{{\"type\":\"FeatureCollection\",\"features\":[\n{}\n]}}\n", lines.join(",\n"))
}

fn town() -> Vec<Value> {
    features(&std::fs::read_to_string(project().join("fixtures/town/buildings.geojson")).unwrap())
}

/// The general pipeline on `buildings`, in a place of its own.
fn run_city(place: &Place, buildings: &str, more: &[&str]) -> Value {
    let pipeline = project().join("pipelines/city.toml");
    let set = format!("buildings={buildings:?}");
    let mut args = vec!["run", pipeline.to_str().unwrap(), "--set", &set];
    args.extend(more);
    place.lodge_json(&args)
}

#[test]
fn threads_folders_and_the_order_of_features_change_no_byte() {
    let town = town();
    let first = Place::new();
    let path = first.write("town.geojson", collection(&town));
    run_city(&first, path.to_str().unwrap(), &["-j", "1"]);
    let published = first.published();
    assert!(published.len() > 4, "{published:?}");

    for threads in ["2", "8"] {
        let other = Place::new();
        let path = other.write("elsewhere/deeper/town.geojson", collection(&town));
        run_city(&other, path.to_str().unwrap(), &["-j", threads]);
        assert_eq!(other.published(), published, "-j {threads}");
    }

    // Another order: by a multiplier that visits every line once. Equal ids keep their order: the second one of two
    // is rejected, whichever comes first.
    let mut seen = std::collections::BTreeSet::new();
    let unique: Vec<Value> = town.into_iter().filter(|f| seen.insert(f["id"].to_string())).collect();
    let n = unique.len();
    let step = (n / 3..).find(|s| gcd(*s, n) == 1).unwrap();
    let shuffled: Vec<Value> = (0..n).map(|i| unique[i * step % n].clone()).collect();
    let (straight, mixed) = (Place::new(), Place::new());
    let a = straight.write("town.geojson", collection(&unique));
    let b = mixed.write("town.geojson", collection(&shuffled));
    run_city(&straight, a.to_str().unwrap(), &[]);
    run_city(&mixed, b.to_str().unwrap(), &[]);
    assert_eq!(mixed.published(), straight.published());
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The town in whole millimetres of a projected system, each point through `change`.
fn projected(change: impl Fn([i64; 2]) -> [i64; 2]) -> String {
    let town = town();
    let origin = first_point(&town[0]["geometry"]["coordinates"]);
    // Any plane will do: degrees times a constant, on the millimetre grid.
    let place = |p: &Value| {
        let mm = |k: usize| ((p[k].as_f64().unwrap() - origin[k]) * 80_000_000.0).round() as i64;
        change([mm(0), mm(1)])
    };
    fn deep(v: &Value, place: &dyn Fn(&Value) -> [i64; 2]) -> Value {
        match v.as_array() {
            Some(a) if a.first().is_some_and(Value::is_number) => {
                let [x, y] = place(v);
                serde_json::json!([x as f64 / 1000.0, y as f64 / 1000.0])
            }
            Some(a) => a.iter().map(|v| deep(v, place)).collect(),
            None => v.clone(),
        }
    }
    let moved: Vec<Value> = town
        .into_iter()
        .map(|mut f| {
            let coordinates = deep(&f["geometry"]["coordinates"], &place);
            f["geometry"]["coordinates"] = coordinates;
            f
        })
        .collect();
    collection(&moved)
}

fn first_point(mut at: &Value) -> [f64; 2] {
    while at[0].is_array() {
        at = &at[0];
    }
    [at[0].as_f64().unwrap(), at[1].as_f64().unwrap()]
}

#[test]
fn turned_and_moved_the_answers_stay() {
    let km = 1_000_000;
    let base = projected(|[x, y]| [x + 100 * km, y + 400 * km]);
    let moved = projected(|[x, y]| [x + 600 * km, y + 900 * km]);
    let turned = projected(|[x, y]| [-y + 100 * km, x + 400 * km]);
    let look = |text: &str| {
        let place = Place::new();
        let path = place.write("town.geojson", text);
        let crs = ["--set", r#"node.footprints.crs="EPSG:28992""#];
        let run = run_city(&place, path.to_str().unwrap(), &crs);
        let pipeline = project().join("pipelines/city.toml");
        let set = format!("buildings={path:?}");
        let csv = place.path("tree.csv");
        let mut args = vec!["export", pipeline.to_str().unwrap(), "blocks", "-o", csv.to_str().unwrap(), "--set", &set];
        args.extend(crs);
        let done = place.lodge(&args);
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        (run, std::fs::read_to_string(csv).unwrap(), place)
    };
    let (a, tree, place_a) = look(&base);
    let (b, tree_b, place_b) = look(&moved);
    let (c, tree_c, _) = look(&turned);
    assert_eq!(tree, tree_b, "the dendrogram of the moved town");
    assert_eq!(tree, tree_c, "the dendrogram of the turned town");
    for key in ["hulls", "edges", "root_edges", "area_m2_sum", "negative_space_m2_sum"] {
        let of = |run: &Value| node(run, "hulls")["summary"][key].as_f64().unwrap();
        assert_eq!(of(&a), of(&b), "{key}, moved");
        let relative = (of(&a) - of(&c)).abs() / of(&a).abs().max(1.0);
        assert!(relative < 1e-9, "{key}, turned: {} and {}", of(&a), of(&c));
    }
    let summary = |run: &Value, key: &str| {
        let mut value = node(run, "tiles")["summary"][key].clone();
        // `closed` is a share of sampled street points, and the sampling grid does not turn with the town.
        for level in value.as_array_mut().into_iter().flatten() {
            level.as_object_mut().unwrap().remove("closed");
        }
        value
    };
    for key in ["tiles", "features", "root_error_m", "levels"] {
        assert_eq!(node(&a, "tiles")["summary"][key], node(&b, "tiles")["summary"][key], "{key}, moved");
        assert_eq!(summary(&a, key), summary(&c, key), "{key}, turned");
    }
    // Moved by whole kilometres only the place on the globe differs: as many files, as many tiles.
    assert_eq!(place_a.published().len(), place_b.published().len());
}

#[test]
fn a_small_edit_of_a_real_city_changes_few_files() {
    let Some(data) = real_data() else { return };
    let mut text = String::new();
    let file = std::fs::File::open(data.join("buildings/tokyo_setagaya.geojson.gz")).unwrap();
    flate2::read::GzDecoder::new(file).read_to_string(&mut text).unwrap();
    let all = features(&text);
    assert_eq!(all.len(), 127_212);

    let contents = |features: &[Value]| {
        let place = Place::new();
        let path = place.path("city.geojson.gz");
        let mut out = flate2::write::GzEncoder::new(std::fs::File::create(&path).unwrap(), flate2::Compression::fast());
        out.write_all(collection(features).as_bytes()).unwrap();
        out.finish().unwrap();
        let run = run_city(&place, path.to_str().unwrap(), &[]);
        let depth = node(&run, "tiles")["summary"]["levels"].as_array().unwrap().len();
        let glbs: std::collections::BTreeSet<String> =
            place.published().into_keys().filter(|f| f.ends_with(".glb")).collect();
        (glbs, depth)
    };
    let (before, levels) = contents(&all);
    for row in [1_000, 63_606, 120_000] {
        let mut higher = all.clone();
        let height = higher[row]["properties"]["height"].as_f64().unwrap();
        higher[row]["properties"]["height"] = (height + 3.0).into();
        let changed = contents(&higher).0.difference(&before).count();
        println!("row {row}, one building 3 m higher: {changed} of {} contents changed, {levels} levels", before.len());
        assert!(changed >= 1 && changed <= 2 * levels, "{changed} changed");

        let mut fewer = all.clone();
        fewer.remove(row);
        let changed = contents(&fewer).0.difference(&before).count();
        // The contract bounds an addition. A removal may flip a merge near the root: it is counted and shown.
        println!("row {row}, one building removed: {changed} of {}", before.len());
        assert!(changed >= 1);

        let mut more = all.clone();
        let mut new = more[row].clone();
        new["properties"]["id"] = "a new one".into();
        for ring in new["geometry"]["coordinates"].as_array_mut().unwrap() {
            for p in ring.as_array_mut().unwrap() {
                p[0] = (p[0].as_f64().unwrap() + 0.000_15).into();
            }
        }
        more.push(new);
        let changed = contents(&more).0.difference(&before).count();
        println!("row {row}, one building added: {changed} of {}", before.len());
        assert!(changed as f64 <= 0.05 * before.len() as f64, "{changed} changed");
    }
}
