//! Tilesets on disk against the rules that they must hold to.

mod chain;
mod check;
mod toy;

use std::sync::Arc;

use check::{Published, check, publish};
use lodge::artifact::{Shapes, TileTree};
use lodge::geom::frame::{Frame, Projection};
use lodge::op::{Bench, Op, cast};
use lodge::ops::write_glb::{self, WriteGlb};
use lodge::ops::write_tileset::{In, WriteTileset};
use serde_json::json;

fn write(tree: &TileTree, height_offset: f64) -> (Published, Vec<String>) {
    let bench = Bench::default();
    let op = WriteTileset { path: "tiles/".into(), height_offset };
    let files = op.run(&bench.ctx(), In { tree: Arc::new(tree.clone()) }).unwrap();
    (publish("tiles", &files, &bench.blobs), bench.report.finish().warnings)
}

/// Kept below `target/tmp/tilesets`, where `.ci/validate.sh` looks for them.
fn keep(name: &str, published: &Published) {
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("tilesets").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    for (path, bytes) in published {
        let path = folder.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
}

fn tokyo() -> Frame {
    Frame { crs: "OGC:CRS84".into(), projection: Projection::TransverseMercator { origin: [139.65, 35.65] } }
}

fn delft() -> Frame {
    Frame { crs: "EPSG:28992".into(), projection: Projection::Projected { origin: [85_000.0, 447_000.0] } }
}

#[test]
fn holds_to_the_rules() {
    for frame in [tokyo(), delft()] {
        let tree = toy::town(frame, [0, 0]);
        let (published, warnings) = write(&tree, 0.0);
        assert!(warnings.is_empty(), "{warnings:?}");
        let globe = tree.frame.globe().unwrap().unwrap();
        let seen = check(&published, &tree, &|p| globe.ecef(p));
        assert_eq!((seen.tiles, seen.leaves, seen.buildings), (7, 4, 256));
        assert!(seen.worst_position < 1e-3, "{seen:?}");
        keep(&format!("toy-{}", tree.frame.crs.replace(':', "-")), &published);
    }
}

#[test]
fn height_offset_lifts_on_the_globe() {
    let tree = toy::town(tokyo(), [40_000_000, 3_000_000]);
    let (published, _) = write(&tree, 36.7);
    let globe = tree.frame.globe().unwrap().unwrap();
    let seen = check(&published, &tree, &|[x, y, z]| globe.ecef([x, y, z + 36.7]));
    assert!(seen.worst_position < 1e-3, "{seen:?}");
}

#[test]
fn without_a_system_local_with_one_warning() {
    let tree = toy::town(Frame::local(), [0, 0]);
    let (published, warnings) = write(&tree, 2.0);
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    check(&published, &tree, &|[x, y, z]| [x, y, z + 2.0]);
    keep("toy-local", &published);
}

#[test]
fn national_heights_are_warned_of() {
    let frame = Frame { crs: "EPSG:7415".into(), ..delft() };
    assert_eq!(write(&toy::town(frame.clone(), [0, 0]), 0.0).1.len(), 1);
    assert_eq!(write(&toy::town(frame, [0, 0]), 43.0).1.len(), 0);
}

#[test]
fn the_same_bytes_and_few_changes() {
    let tree = toy::town(tokyo(), [0, 0]);
    let (a, _) = write(&tree, 0.0);
    assert_eq!(a, write(&tree, 0.0).0);
    // One building higher: its leaf and what stands above it.
    let mut edited = tree.clone();
    let f = edited.tile_features[4] as usize + 3;
    edited.top[f] += 1.0;
    let (b, _) = write(&edited, 0.0);
    let gone: Vec<&String> = a.keys().filter(|k| !b.contains_key(*k)).collect();
    assert_eq!(gone.len(), 2, "a leaf's content and its ids: {gone:?}");
    // A building less in the order before it moves ranges of the whole, not of other tiles.
    let moved = toy::town(tokyo(), [8_000_000, 0]);
    let c = write(&moved, 0.0).0;
    assert_ne!(a["tileset.json"], c["tileset.json"]);
}

#[test]
fn one_building() {
    let tree = toy::one(tokyo());
    let (published, _) = write(&tree, 0.0);
    let globe = tree.frame.globe().unwrap().unwrap();
    let seen = check(&published, &tree, &|p| globe.ecef(p));
    assert_eq!((seen.tiles, seen.triangles), (1, 10));
}

#[test]
fn walls_in_one_plane_share_an_edge() {
    let mut tree = toy::one(tokyo());
    tree.plans = Shapes::default();
    tree.plans.push_ring(&[[0, 0], [5000, 0], [10_000, 0], [10_000, 8000], [0, 8000]]);
    tree.plans.end_polygon();
    tree.plans.end_shape();
    let (published, _) = write(&tree, 0.0);
    let globe = tree.frame.globe().unwrap().unwrap();
    check(&published, &tree, &|p| globe.ecef(p));
    let glb = gltf::Glb::from_slice(published.iter().find(|(path, _)| path.ends_with(".glb")).unwrap().1).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&glb.json).unwrap();
    let walls = &json["meshes"][0]["primitives"][0];
    let count = |accessor: &serde_json::Value| json["accessors"][accessor.as_u64().unwrap() as usize]["count"].clone();
    assert_eq!((count(&walls["attributes"]["POSITION"]), count(&walls["indices"])), (json!(18), json!(30)));
}

#[test]
fn depth_is_no_danger() {
    let tree = toy::chain(tokyo(), 5_000);
    let (published, _) = write(&tree, 0.0);
    let text = &published["tileset.json"];
    assert_eq!(text.iter().filter(|&&b| b == b'{').count(), text.iter().filter(|&&b| b == b'}').count());
    assert_eq!(String::from_utf8_lossy(text).matches("boundingVolume").count(), tree.len());
    let shallow = toy::chain(tokyo(), 20);
    let globe = shallow.frame.globe().unwrap().unwrap();
    check(&write(&shallow, 0.0).0, &shallow, &|p| globe.ecef(p));
}

/// A tree through the writer and back; `name` keeps it for the validators.
fn holds(name: &str, tree: &TileTree) -> (Published, check::Seen) {
    let start = std::time::Instant::now();
    let (published, warnings) = write(tree, 0.0);
    let seconds = start.elapsed().as_secs_f64();
    assert!(warnings.len() <= 1, "{warnings:?}");
    let globe = tree.frame.globe().unwrap();
    // Without a system the tileset is local.
    let seen = check(&published, tree, &|p| globe.as_ref().map_or(p, |g| g.ecef(p)));
    let bytes: usize = published.values().map(Vec::len).sum();
    println!("{name}: written in {seconds:.3} s, {bytes} bytes, {seen:?}, {warnings:?}");
    keep(name, &published);
    (published, seen)
}

#[test]
fn the_town() {
    let bytes = std::fs::read("fixtures/town/buildings.geojson").unwrap();
    let tree = chain::tiles(&chain::geojson("buildings.geojson", bytes, json!({})), None);
    let (published, seen) = holds("town", &tree);
    assert!(seen.most_triangles <= 20_000 && seen.most_bytes <= 4 << 20, "{seen:?}");

    // Nothing of it depends on the number of threads.
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(pool.install(|| write(&tree, 0.0).0) == published);
    }
}

fn data() -> Option<String> {
    let data = std::env::var("LODGE_DATA").ok();
    if data.is_none() {
        println!("skipped: LODGE_DATA is not set");
    }
    data
}

#[test]
fn real_footprints() {
    let Some(data) = data() else { return };
    for name in [
        "tokyo_centre",
        "boston_z13_footprints",
        "liechtenstein_osm",
        "monaco_osm",
        "helsinki_osm",
        "andorra_osm",
        "tokyo_setagaya",
    ] {
        let file = format!("{name}.geojson.gz");
        let bytes = std::fs::read(format!("{data}/buildings/{file}")).unwrap();
        let filter = if name.ends_with("_osm") { json!({ "layer": "building" }) } else { json!({}) };
        let tree = chain::tiles(&chain::geojson(&file, bytes, filter), None);
        let (_, seen) = holds(name, &tree);
        assert!(seen.most_triangles <= 20_000 && seen.most_bytes <= 4 << 20, "{seen:?}");
    }
}

#[test]
fn real_buildings() {
    let Some(data) = data() else { return };
    for file in [
        "3dbag_multi_lod_10b.city.json",
        "3dbag_tile5908_99b.city.jsonl",
        "3dbag_tile901_52b.city.jsonl",
        "delft_lod1_themes.city.json",
        "vienna_lod2.city.jsonl",
    ] {
        let bytes = std::fs::read(format!("{data}/citylod/{file}")).unwrap();
        let (buildings, footprints) = chain::cityjson(file, bytes);
        let tree = chain::tiles(&footprints, Some(&buildings));
        let (_, seen) = holds(file.split('.').next().unwrap(), &tree);
        assert!(seen.most_triangles <= 20_000 && seen.most_bytes <= 4 << 20, "{seen:?}");
    }
}

/// Models of a city's cuts: clusters and single buildings, by number, and by triangles with towers left alone.
fn models(name: &str, footprints: &chain::Any) {
    let plan = ("footprints", footprints);
    let blocks = chain::run("cluster", json!({}), None, &[plan]);
    let tree = ("dendrogram", &blocks);
    let hulls = chain::run("merge-hulls", json!({ "height": "median" }), None, &[plan, tree]);
    let n = footprints.summary()["footprints"].as_u64().unwrap();
    for (cut, params) in [("few", json!({ "clusters": n.div_ceil(20) })), ("least", json!({ "max-triangles": 8 * n }))]
    {
        let cut_hulls = chain::run("cut", params, None, &[("hulls", &hulls), tree]);
        let mesh = chain::run("extrude", json!({}), None, &[("hulls", &cut_hulls), plan]);
        let bench = Bench::default();
        let op = WriteGlb { path: format!("models/{name}-{cut}.glb"), ..WriteGlb::default() };
        let files = op.run(&bench.ctx(), write_glb::In { model: write_glb::Model::Mesh(cast(mesh)) }).unwrap();
        let published = publish("models", &files, &bench.blobs);
        let glb = gltf::Glb::from_slice(published.values().next().unwrap()).unwrap();
        gltf::Gltf::from_slice(published.values().next().unwrap()).unwrap();
        assert!(glb.bin.is_some_and(|b| !b.is_empty()), "{name} {cut}");
        keep(&format!("model-{name}-{cut}"), &published);
    }
}

#[test]
fn models_of_cuts() {
    let bytes = std::fs::read("fixtures/town/buildings.geojson").unwrap();
    models("town", &chain::geojson("buildings.geojson", bytes, json!({})));
    let Some(data) = data() else { return };
    for name in ["tokyo_centre", "liechtenstein_osm", "monaco_osm"] {
        let file = format!("{name}.geojson.gz");
        let bytes = std::fs::read(format!("{data}/buildings/{file}")).unwrap();
        let filter = if name.ends_with("_osm") { json!({ "layer": "building" }) } else { json!({}) };
        models(name, &chain::geojson(&file, bytes, filter));
    }
    for file in ["3dbag_tile901_52b.city.jsonl", "delft_lod1_themes.city.json", "vienna_lod2.city.jsonl"] {
        let bytes = std::fs::read(format!("{data}/citylod/{file}")).unwrap();
        models(file.split('.').next().unwrap(), &chain::cityjson(file, bytes).1);
    }
}
