//! glTF packed by EXT_meshopt_compression and KHR_meshopt_compression: what was packed here without loss gives the mesh that
//! it was packed from; filters give it within their rounding; broken streams, an error with their place. What gltfpack
//! packs of real meshes: `gltfpack.rs`.

mod bad;
mod filters;
mod gltfpack;
#[path = "../support/mod.rs"]
mod support;

use lodge::artifact::Mesh;
use lodge::diag::{Findings, Result};
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::read_mesh::ReadMesh;
use serde_json::{Value, json};
use support::meshopt::{EXT, KHR, packed, parts, whole};
use support::project;
use support::scene::{Glb, scene};

/// Reads the first; the others lie beside it.
fn read_all(files: &[(&str, &[u8])]) -> (Result<Mesh>, Findings) {
    let mut bench = Bench::default();
    for (i, (name, bytes)) in files.iter().enumerate() {
        bench.sources.push(Source { beside: i > 0, ..Source::of_bytes(name, bytes.to_vec()) });
    }
    let op: ReadMesh = toml::from_str("max-rejected = 1.0").unwrap();
    let out = op.run(&bench.ctx(), Inputs::take(Vec::new()));
    (out, bench.report.finish())
}

#[track_caller]
fn read(bytes: &[u8]) -> Mesh {
    read_all(&[("a.glb", bytes)]).0.unwrap_or_else(|e| panic!("{e}"))
}

fn error(bytes: &[u8]) -> String {
    read_all(&[("a.glb", bytes)]).0.map(|m| m.triangles.len()).unwrap_err().to_string()
}

/// Every triangle with its least corner first: packed lists of triangles may begin with another.
fn turned(mut mesh: Mesh) -> Mesh {
    for t in &mut mesh.triangles {
        let least = (0..3).min_by_key(|&k| t[k]).unwrap();
        t.rotate_left(least);
    }
    mesh
}

fn pavilion() -> Vec<u8> {
    std::fs::read(project().join("fixtures/pavilion/pavilion.glb")).unwrap()
}

/// Streams of one mode in a file.
fn modes(glb: &[u8], mode: &str) -> usize {
    let streams = |v: &Value| [EXT, KHR].iter().any(|n| v["extensions"][n]["mode"] == mode);
    parts(glb).0["bufferViews"].as_array().unwrap().iter().filter(|v| streams(v)).count()
}

#[test]
fn what_was_packed_is_what_comes_out() {
    for (what, plain) in [("scene", scene()), ("pavilion", pavilion())] {
        let wanted = read(&plain);
        for name in [EXT, KHR] {
            let sequences = packed(&plain, name, false);
            assert!(modes(&sequences, "INDICES") > 2 && modes(&sequences, "TRIANGLES") == 0);
            assert!(read(&sequences) == wanted, "{what}, {name}, sequences");
            let lists = packed(&plain, name, true);
            assert!(modes(&lists, "TRIANGLES") > 0 && modes(&lists, "ATTRIBUTES") > 4);
            assert!(turned(read(&lists)) == turned(wanted.clone()), "{what}, {name}, lists");
            // Packed again, by others.
            assert!(read_all(&[("a.glb.gz", &support::gzip(&lists))]).0.unwrap() == read(&lists));
        }
    }
    let small = packed(&pavilion(), KHR, true).len();
    assert!(small < pavilion().len() * 9 / 10, "{small} of {}", pavilion().len());
}

/// Wide indices, and blocks of many elements.
#[test]
fn more_vertices_than_two_bytes_count() {
    let n = 70_000u32;
    let mut glb = Glb::default();
    let corner = |i: u32| [(i % 300) as f32, (i / 300) as f32, (i % 7) as f32];
    let rows: Vec<[f32; 3]> = (0..n).map(corner).collect();
    let at = glb.floats(&rows.iter().map(|r| &r[..]).collect::<Vec<_>>(), None);
    let corners: Vec<u32> = (0..n - 301).flat_map(|i| [i, i + 1, i + 300]).collect();
    let view = glb.view(&corners.iter().flat_map(|c| c.to_le_bytes()).collect::<Vec<_>>(), None);
    glb.accessors.push(json!({"bufferView": view, "componentType": 5125, "count": corners.len(), "type": "SCALAR"}));
    let primitive = json!({"attributes": {"POSITION": at}, "indices": glb.accessors.len() - 1});
    let plain = glb.finish(json!({"meshes": [{"primitives": [primitive]}], "nodes": [{"mesh": 0}]}));
    let wanted = turned(read(&plain));
    assert_eq!(wanted.triangles.len() * 3, corners.len());
    for (name, lists) in [(EXT, true), (KHR, true), (EXT, false), (KHR, false)] {
        assert!(turned(read(&packed(&plain, name, lists))) == wanted, "{name}, {lists}");
    }
}

/// KHR_mesh_quantization: numbers of one and two bytes, with signs or without, normalized or not, in rows that are padded.
#[test]
fn small_numbers_in_padded_rows() {
    let places = [[-128i32, 127, 0], [255, 3, 65_535], [-32_768, 32_767, 100], [7, -7, 77]];
    for (kind, size, most) in [(5120, 1, 127.0), (5121, 1, 255.0), (5122, 2, 32_767.0), (5123, 2, 65_535.0)] {
        for (normalized, pad) in [(false, 0), (false, 1), (true, 1), (true, 5)] {
            // Numbers as they come to lie in the kind.
            let fits = |v: i32| match kind {
                5120 => f64::from(v as i8),
                5121 => f64::from(v as u8),
                5122 => f64::from(v as i16),
                _ => f64::from(v as u16),
            };
            let stride = 3 * size + pad * size;
            let mut rows = Vec::new();
            for row in places {
                row.iter().for_each(|v| rows.extend(&v.to_le_bytes()[..size]));
                rows.resize(rows.len() + stride - 3 * size, 0xee);
            }
            let mut glb = Glb::default();
            let view = glb.view(&rows, None);
            glb.accessors.push(json!({"bufferView": view, "componentType": kind, "normalized": normalized,
                "count": 4, "type": "VEC3"}));
            let indices = glb.indices(&[0, 1, 2, 1, 2, 3]);
            let primitive = json!({"attributes": {"POSITION": 0}, "indices": indices});
            let (mut root, chunk) = parts(&glb.finish(json!({
                "extensionsRequired": ["KHR_mesh_quantization"],
                "meshes": [{"primitives": [primitive]}], "nodes": [{"mesh": 0}]})));
            root["bufferViews"][0]["byteStride"] = stride.into();
            let plain = whole(&root, &chunk);
            let of = |v: i32| if normalized { (fits(v) / most).max(-1.0) } else { fits(v) };
            let wanted: Vec<[f64; 3]> = places.map(|[x, y, z]| [of(x), 0.0 - of(z), of(y)]).to_vec();
            let what = format!("{kind}, normalized {normalized}, {stride} bytes");
            assert_eq!(read(&plain).positions, wanted, "{what}");
            if (3 * size + pad * size) % 4 == 0 {
                for name in [EXT, KHR] {
                    assert_eq!(read(&packed(&plain, name, true)).positions, wanted, "{what}, {name}");
                }
            }
        }
    }
}

/// A view may have a plain copy in another buffer, which is taken where it is whole. Else the stream is unpacked.
#[test]
fn fallback_buffers() {
    let plain = pavilion();
    let wanted = read(&plain);
    let (mut root, chunk) = parts(&packed(&plain, EXT, false));
    // Where the plain bytes were: each packed view's come after those before it, at multiples of four.
    let (old, bytes) = parts(&plain);
    let mut copy = Vec::new();
    for (view, was) in root["bufferViews"].as_array().unwrap().iter().zip(old["bufferViews"].as_array().unwrap()) {
        if view["buffer"] == 1 {
            let number = |key: &str| was[key].as_u64().unwrap_or(0) as usize;
            assert_eq!(view["byteOffset"], copy.len());
            copy.extend(&bytes[number("byteOffset")..][..number("byteLength")]);
            copy.resize(copy.len().next_multiple_of(4), 0);
        }
    }
    assert_eq!(root["buffers"][1], json!({"byteLength": copy.len(), "extensions": {EXT: {"fallback": true}}}));
    root.as_object_mut().unwrap().remove("extensionsRequired");
    let with = |uri: Value, chunk: &[u8]| {
        let mut root = root.clone();
        root["buffers"][1]["uri"] = uri;
        whole(&root, chunk)
    };
    let sound = with("copy.bin".into(), &chunk);
    assert_eq!(ReadMesh::beside(&Source::of_bytes("a.glb", sound.clone())), ["copy.bin"]);
    // Whole, absent, cut short, elsewhere, no data at all, not even marked.
    assert!(read_all(&[("a.glb", &sound), ("copy.bin", &copy)]).0.unwrap() == wanted);
    for beside in [&[][..], &[("copy.bin", &copy[..copy.len() - 1])], &[("copy.bin", &[])]] {
        let (mesh, findings) = read_all(&[&[("a.glb", &sound[..])], beside].concat());
        assert!(mesh.unwrap() == wanted && findings.warnings.is_empty());
    }
    for uri in ["https://example.org/copy.bin", "../copy.bin", "data:;base64,AAAA", "data:;base64,?"] {
        assert!(read(&with(uri.into(), &chunk)) == wanted, "{uri}");
    }
    let mut unmarked = root.clone();
    unmarked["buffers"][1] = json!({"byteLength": copy.len()});
    assert!(read(&whole(&unmarked, &chunk)) == wanted);

    // The copy is what counts, whatever became of the streams.
    let mut broken = chunk.clone();
    for said in root["bufferViews"].as_array().unwrap().iter().map(|v| &v["extensions"][EXT]) {
        let number = |key: &str| said[key].as_u64().unwrap_or(0) as usize;
        broken[number("byteOffset")..][..number("byteLength")].fill(0xff);
    }
    let broken = with("copy.bin".into(), &broken);
    assert!(read_all(&[("a.glb", &broken), ("copy.bin", &copy)]).0.unwrap() == wanted);
    let told = read_all(&[("a.glb", &broken)]).0.unwrap_err().to_string();
    assert!(told.contains("its packed bytes end early or are damaged"), "{told}");

    // As text, both beside.
    let mut text = root.clone();
    text["buffers"][0]["uri"] = "streams.bin".into();
    let text = text.to_string().into_bytes();
    let mesh = read_all(&[("a.gltf", &text), ("streams.bin", &chunk)]).0.unwrap();
    assert!(mesh == wanted);
    let told = read_all(&[("a.gltf", &text)]).0.unwrap_err().to_string();
    assert!(told.contains("`streams.bin`, which it names, is not there"), "{told}");
}
