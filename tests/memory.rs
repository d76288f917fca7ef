//! What an operator says that it needs of memory (`Op::estimate`), against the most that was alive while it ran: towns
//! large enough that the fixed parts do not matter, one thread, one node at a time, its inputs from the cache. A binary
//! of one test: the allocator counts the whole process. With LODGE_DATA also on pieces of real cities.

#![allow(unsafe_code, reason = "an allocator that counts")]

mod support;

use std::alloc::{GlobalAlloc, Layout, System};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use lodge::cli::render::{self, Style};
use lodge::graph::Graph;
use lodge::ops::ALL;
use lodge::run::event::Status;
use lodge::run::{self, Options};
use serde_json::Value;
use support::{HOUSES, Place, project};

/// The system's allocator, counted.
struct Counting;

static ALIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn grown(by: usize) {
    let now = ALIVE.fetch_add(by, Relaxed) + by;
    PEAK.fetch_max(now, Relaxed);
}

// SAFETY: an allocator is unsafe by its trait. This one only counts: every call goes to `System` with its arguments as
// they came, and gives what that gave.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        ALIVE.fetch_sub(layout.size(), Relaxed);
        unsafe { System.dealloc(at, layout) }
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // Large blocks grow where they are: they are not alive twice.
        grown(size.saturating_sub(layout.size()));
        ALIVE.fetch_sub(layout.size().saturating_sub(size), Relaxed);
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// --------------------------------------------------------------------------------------------------- a larger town

/// The features of a GeoJSON file of the fixture, again and again, so many towns east and north, ids told apart.
fn many(file: &str, towns: [usize; 2]) -> String {
    let text = std::fs::read_to_string(project().join("fixtures/town").join(file)).unwrap();
    let whole: Value = serde_json::from_str(&text).unwrap();
    let mut lines = Vec::new();
    for (i, j) in (0..towns[0]).flat_map(|i| (0..towns[1]).map(move |j| (i, j))) {
        for feature in whole["features"].as_array().unwrap() {
            let mut feature = feature.clone();
            feature["id"] = format!("{}-{i}-{j}", feature["id"].as_str().unwrap()).into();
            moved(&mut feature["geometry"]["coordinates"], [0.025 * i as f64, 0.015 * j as f64]);
            lines.push(feature.to_string());
        }
    }
    format!("{{\"type\":\"FeatureCollection\",\"features\":[\n{}\n]}}\n", lines.join(",\n"))
}

/// Degrees, to seven places as in the fixture.
fn moved(coordinates: &mut Value, by: [f64; 2]) {
    match coordinates.as_array_mut().unwrap() {
        position if position[0].is_number() => {
            for (x, by) in position.iter_mut().zip(by) {
                *x = (((x.as_f64().unwrap() + by) * 1e7).round() / 1e7).into();
            }
        }
        all => all.iter_mut().for_each(|c| moved(c, by)),
    }
}

/// The houses with roofs of the fixture, so many rows of so many copies.
fn houses(copies: [usize; 2]) -> String {
    let text = std::fs::read_to_string(project().join("fixtures/town/houses.city.json")).unwrap();
    let mut model: Value = serde_json::from_str(&text).unwrap();
    let objects = model["CityObjects"].take();
    let vertices = model["vertices"].take();
    let vertices = vertices.as_array().unwrap();
    let (mut all, mut points) = (serde_json::Map::new(), Vec::new());
    for (k, (i, j)) in (0..copies[0]).flat_map(|i| (0..copies[1]).map(move |j| (i, j))).enumerate() {
        for (id, object) in objects.as_object().unwrap() {
            let mut object = object.clone();
            for key in ["parents", "children"] {
                for id in object[key].as_array_mut().into_iter().flatten() {
                    *id = format!("{}-{k}", id.as_str().unwrap()).into();
                }
            }
            for geometry in object["geometry"].as_array_mut().into_iter().flatten() {
                raised(&mut geometry["boundaries"], (k * vertices.len()) as u64);
            }
            object.as_object_mut().unwrap().retain(|_, v| !v.is_null());
            all.insert(format!("{id}-{k}"), object);
        }
        for v in vertices {
            let at = |n: usize, by: usize| v[n].as_i64().unwrap() + by as i64;
            points.push(serde_json::json!([at(0, 100_000 * i), at(1, 60_000 * j), at(2, 0)]));
        }
    }
    model["CityObjects"] = all.into();
    model["vertices"] = points.into();
    model.to_string()
}

fn raised(boundaries: &mut Value, by: u64) {
    match boundaries {
        Value::Array(all) => all.iter_mut().for_each(|b| raised(b, by)),
        number => *number = (number.as_u64().unwrap() + by).into(),
    }
}

// ------------------------------------------------------------------------------------------------------ the measure

/// What one run of one node took.
struct Seen {
    node: String,
    op: &'static str,
    /// Bytes of its inputs and files.
    input: u64,
    estimate: u64,
    peak: u64,
}

/// An estimate is at least half of the peak, however small that is, and at most twice the peak or twice this: below it
/// stand the estimates' fixed parts, which are for inputs that make much of little.
const LARGE: u64 = 8 << 20;

/// Every node of a pipeline by itself, in order: the others' results come from the cache.
fn measure(file: &Path, sets: &[String], place: &Place) -> Vec<Seen> {
    let graph =
        Arc::new(Graph::load(file, sets, &ALL).unwrap_or_else(|e| panic!("{}", render::text(&e, Style::Plain))));
    let mut options = Options::new(place.path("cache"));
    options.out = Some(place.path("out"));
    let mut bytes: Vec<u64> = Vec::new();
    let mut all = Vec::new();
    for (n, node) in graph.nodes.iter().enumerate() {
        let before = ALIVE.load(Relaxed);
        PEAK.store(before, Relaxed);
        let outcome = run::run(&graph, &[n], &options, &mut |_| {});
        let peak = PEAK.load(Relaxed) - before;
        assert!(outcome.ok(), "{}: {:?}", node.name, outcome.diagnostics());
        let done = outcome.nodes.iter().find(|o| o.index == n).unwrap();
        assert_eq!(done.status, Status::Ran, "{}", node.name);
        let record = done.record.as_ref().unwrap();
        bytes.push(record.bytes + record.blob_bytes);
        let ports: Vec<u64> = node.inputs.iter().map(|port| port.iter().map(|&i| bytes[i]).sum()).collect();
        let files: u64 = done.files.iter().map(|f| f.stamp.size).sum();
        let estimate = node.op.estimate_of(&ports, files);
        let input = ports.iter().sum::<u64>() + files;
        all.push(Seen { node: node.name.clone(), op: node.entry.name, input, estimate, peak: peak as u64 });
    }
    all
}

const SEQUENCE: &str = r#"
[node.city]
op = "read-cityjson"
path = "out/model.city.jsonl"

[node.packed]
op = "read-geojson"
path = "buildings.geojson.gz"

[node.rectangles]
op = "simplify-footprints"
in.footprints = "packed"
max-edges = 4

[node.lines]
op = "read-lines"
path = "buildings.geojson"

[node.packed-lines]
op = "read-lines"
path = "buildings.geojson.gz"
"#;

/// A mesh becomes a few textured planes.
const IMPOSTOR: &str = r#"
[params]
mesh = "ring.obj"
resolution = 128

[node.mesh]
op = "read-mesh"
path = "${mesh}"

[node.voxels]
op = "voxelize"
in.mesh = "mesh"
resolution = "${resolution}"

[node.planes]
op = "vote-tile"
in.voxels = "voxels"

[node.quads]
op = "bake-impostor"
in.mesh = "mesh"
in.tiles = "planes"

[node.glb]
op = "write-glb"
in.model = "quads"
path = "quads.glb"
"#;

/// A ring with waves on it, closed, in squares of two triangles.
fn ring([around, along]: [usize; 2]) -> String {
    let mut text = String::new();
    for (i, j) in (0..around).flat_map(|i| (0..along).map(move |j| (i, j))) {
        let [u, v] = [i as f64 / around as f64, j as f64 / along as f64].map(|t| t * std::f64::consts::TAU);
        let thick = 0.4 + 0.05 * libm::sin(5.0 * u) * libm::cos(3.0 * v);
        let wide = 1.0 + thick * libm::cos(v);
        writeln!(text, "v {:.6} {:.6} {:.6}", wide * libm::cos(u), wide * libm::sin(u), thick * libm::sin(v)).unwrap();
    }
    for (i, j) in (0..around).flat_map(|i| (0..along).map(move |j| (i, j))) {
        let at = |i: usize, j: usize| i % around * along + j % along + 1;
        writeln!(text, "f {} {} {} {}", at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)).unwrap();
    }
    text
}

/// Of a real city, whose blocks have many corners.
const REAL: &str = r#"
[node.source]
op = "merge-hulls"
in.footprints = "footprints"
in.dendrogram = "blocks"
merge = "source"

[node.smooth]
op = "simplify-polyline"
in.hulls = "source"

[node.lines]
op = "read-lines"
path = "${buildings}"
"#;

#[test]
fn estimates_are_within_a_factor_of_two() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().unwrap();
    let place = Place::new();
    let towns = [5, 4];
    let set = |name: &str, path: PathBuf| format!("{name}={path:?}");
    let buildings = many("buildings.geojson", towns);
    place.write("buildings.geojson.gz", support::gzip(&buildings));
    let sets = [
        set("buildings", place.write("buildings.geojson", buildings)),
        set("streets", place.write("streets.geojson", many("streets.geojson", towns))),
    ];
    place.write("houses.city.json", houses([25, 40]));
    let mut all = measure(&project().join("pipelines/town.toml"), &sets, &place);
    all.extend(measure(&place.write("others.toml", HOUSES), &[], &place));
    all.extend(measure(&place.write("sequence.toml", SEQUENCE), &[], &place));

    let impostor = place.write("impostor.toml", IMPOSTOR);
    place.write("ring.obj", ring([400, 200]));
    all.extend(measure(&impostor, &[], &place));
    all.extend(measure(&impostor, &["resolution=192".into()], &Place::new()));

    if let Some(data) = support::real_data() {
        for (file, resolution) in [
            ("stanford_bunny.ply.gz", 128),
            ("machine_counter.stl", 128),
            ("toy_car/ToyCar.gltf", 128),
            ("lamborghini_huracan.glb", 128),
        ] {
            let sets = [set("mesh", data.join("meshes").join(file)), format!("resolution={resolution}")];
            all.extend(measure(&impostor, &sets, &Place::new()));
        }
        let city = format!("extends = {:?}\n{REAL}", project().join("pipelines/city.toml"));
        for (name, file) in [
            ("city.toml", "buildings/tokyo_centre.geojson.gz"),
            ("city-barriers.toml", "buildings/liechtenstein_osm.geojson.gz"),
            ("city-cityjson.toml", "citylod/vienna_lod2.city.jsonl"),
            ("city-cityjson.toml", "citylod/delft_lod1_themes.city.json"),
            ("city-cityjson.toml", "citylod/3dbag_tile5908_99b.city.jsonl"),
        ] {
            let place = Place::new();
            let more = place.write("more.toml", &city);
            let path = if name == "city.toml" { more } else { project().join("pipelines").join(name) };
            all.extend(measure(&path, &[set("buildings", data.join(file))], &place));
        }
    }

    let mb = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let (mut wrong, mut table) = (String::new(), String::new());
    for Seen { node, op, input, estimate, peak } in &all {
        let line = format!(
            "{node:24} {op:20} {:6.1} MB of {:6.1}, estimated {:6.1}: {:.2}",
            mb(*peak),
            mb(*input),
            mb(*estimate),
            *estimate as f64 / *peak as f64
        );
        writeln!(table, "{line}").unwrap();
        if estimate * 2 < *peak || *estimate > 2 * LARGE.max(*peak) {
            writeln!(wrong, "{line}").unwrap();
        }
    }
    println!("{table}");
    assert!(wrong.is_empty(), "\n{wrong}");
    // Every operator is large enough here to be judged.
    let judged: BTreeSet<&str> = all.iter().filter(|s| s.peak > LARGE).map(|s| s.op).collect();
    let small: Vec<&str> = ALL.shown().map(|e| e.name).filter(|name| !judged.contains(name)).collect();
    assert!(small.is_empty(), "{small:?}");
}
