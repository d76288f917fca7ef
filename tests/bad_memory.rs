//! Memory on files that claim more than they hold: the binary on each, one node at a time, against a ceiling. What it
//! held is its own mark (`peak_bytes` of its events, Linux only), so nothing is measured on other systems.
#![cfg(target_os = "linux")]

mod support;

use serde_json::{Value, json};
use support::meshopt::{attributes, parts, whole};
use support::scene::{Glb, scene};
use support::{Place, binary};

const MIB: u64 = 1 << 20;
/// More than what it holds while it reads one triangle: measured were some 100 KiB.
const LITTLE: u64 = 4 * MIB;

/// Exit code, what it said, and the most that the process held while each node ran; 0 where the kernel does not tell.
fn run(file: &str, bytes: &[u8], more: &str) -> (i32, String, Vec<u64>) {
    let place = Place::new();
    place.write(file, bytes);
    place.write("p.toml", format!("[node.read]\nop = \"read-mesh\"\npath = \"{file}\"\n{more}"));
    let mut command = binary();
    command.current_dir(place.dir.path()).env("LODGE_CACHE", place.path("cache"));
    command.args(["run", "p.toml", "-j", "1", "--events", "e.jsonl"]);
    let out = command.output().unwrap();
    let events = std::fs::read_to_string(place.path("e.jsonl")).unwrap();
    let all = events.lines().map(|l| serde_json::from_str::<Value>(l).unwrap());
    let peaks = all.filter(|e| e["event"] == "node-done" && e["status"] != "skipped");
    let peaks = peaks.map(|e| e["peak_bytes"].as_u64().unwrap_or(0)).collect();
    (out.status.code().unwrap(), String::from_utf8_lossy(&out.stderr).into_owned(), peaks)
}

/// What the process holds while it reads one triangle.
fn idle() -> u64 {
    run("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "").2[0]
}

fn triangle() -> Glb {
    let mut glb = Glb::default();
    glb.floats(&[&[0.0, 0.0, 0.0], &[1.0, 0.0, 0.0], &[0.0, 1.0, 0.0]], None);
    glb
}

fn drawn(glb: Glb) -> Vec<u8> {
    glb.finish(json!({"nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}))
}

/// The zeros of a block take a byte: a stream of this length says that it holds as many elements of 16 bytes.
fn packed(count: u64) -> Vec<u8> {
    let stream = attributes("EXT_meshopt_compression", &[0; 16 * 4096], 16);
    let (mut root, _) = parts(&drawn(triangle()));
    root["bufferViews"][0] = json!({"buffer": 1, "byteOffset": 0, "byteLength": 16 * count, "byteStride": 16,
        "extensions": {"EXT_meshopt_compression": {"buffer": 0, "byteLength": stream.len(), "byteStride": 16,
            "count": count, "mode": "ATTRIBUTES"}}});
    root["buffers"] = json!([{"byteLength": stream.len()}, {"byteLength": 16 * count}]);
    root["accessors"][0]["count"] = count.min(1 << 25).into();
    root["extensionsRequired"] = json!(["EXT_meshopt_compression"]);
    whole(&root, &stream)
}

/// A claim of so much, in a file of some hundred bytes: refused before any room is made for it.
#[test]
fn claims_are_no_room() {
    let ply = "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let mut long = triangle();
    long.accessors[0]["count"] = (1u64 << 31).into();
    let mut less = triangle();
    less.accessors[0]["count"] = (1u64 << 26).into();
    let mut none = triangle();
    none.accessors[0] = json!({"componentType": 5126, "count": 1 << 26, "type": "VEC3"});
    let whole_glb = drawn(triangle());
    let (root, chunk) = parts(&whole_glb);
    let mut early = root.clone();
    early["buffers"][0]["byteLength"] = (1u64 << 40).into();
    let sparse =
        json!({"count": 1 << 25, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}});
    let mut few = root.clone();
    few["accessors"][0]["sparse"] = sparse;
    few["accessors"][0]["count"] = (1 << 26).into();
    let least = idle();
    for (name, file, bytes, said) in [
        ("a PLY of 10^12 vertices", "a.ply", ply.as_bytes().to_vec(), "the header promises 1000000000000 of `vertex`"),
        ("an accessor of 2^31", "a.glb", drawn(long), "more than the 67108864 corners that are read"),
        ("an accessor of 2^26", "a.glb", drawn(less), "go beyond buffer view 0"),
        ("zeros without data", "a.glb", drawn(none), "elements without data"),
        ("a buffer that ends early", "a.glb", whole(&early, &chunk), "ends early"),
        ("a GLB that ends early", "a.glb", whole_glb[..whole_glb.len() - 8].to_vec(), "the file ends early"),
        ("sparse values beyond", "a.glb", whole(&few, &chunk), "go beyond buffer view 0"),
        ("a stream of 10^12", "a.glb", packed(1_000_000_000_000), "cannot hold 1000000000000 elements"),
        ("a stream of 2^14 in less", "a.glb", packed(1 << 14), "end early or are damaged"),
    ] {
        let (exit, told, peaks) = run(file, &bytes, "");
        assert_eq!((exit, told.contains(said)), (1, true), "{name}: {told}");
        assert!(peaks[0] < least + LITTLE, "{name}: {} MiB above {} MiB", peaks[0] / MIB, least / MIB);
    }
}

/// A million equal triangles, of which sixteen are kept: 8.0 bytes for each byte of the file, itself among them.
#[test]
fn an_obj_of_a_million_equal_triangles() {
    let text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\n") + &"f 1 2 3\n".repeat(1_000_000);
    let (exit, told, peaks) = run("a.obj", text.as_bytes(), "");
    assert_eq!(exit, 0, "{told}");
    let own = peaks[0].saturating_sub(idle());
    assert!(own < 10 * text.len() as u64, "{} MiB for {} MiB", own / MIB, text.len() as u64 / MIB);
}

/// No line of nodes meets the bar: what is held is the empty grid's, 552 MiB, less than twice what the operator says.
#[test]
fn a_bar_of_100000_to_1_on_the_finest_grid() {
    let corner = |i: usize| format!("v {} {} {}\n", [0, 100_000][i & 1], i >> 1 & 1, i >> 2 & 1);
    let faces = "f 1 5 7 3\nf 2 4 8 6\nf 1 2 6 5\nf 3 7 8 4\nf 1 3 4 2\nf 5 6 8 7\n";
    let text = (0..8).map(corner).collect::<String>() + faces;
    let voxels = "[node.voxels]\nop = \"voxelize\"\nin.mesh = \"read\"\nresolution = 1024\n";
    let (exit, told, peaks) = run("a.obj", text.as_bytes(), voxels);
    assert!(exit == 0, "{told}");
    let own = peaks[1].saturating_sub(peaks[0]);
    assert!(own < 2 * 1028 * 1028 * 1028 / 3, "{} MiB", own / MIB);
}

/// A picture whose header says 60,000 x 60,000: 14 GB of texels.
#[test]
fn a_picture_that_says_it_is_wide() {
    let (mut root, mut chunk) = parts(&scene());
    let mut picture = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut part = |kind: &[u8], body: &[u8]| {
        picture.extend((body.len() as u32).to_be_bytes());
        let text = [kind, body].concat();
        let mut crc = flate2::Crc::new();
        crc.update(&text);
        picture.extend(text);
        picture.extend(crc.sum().to_be_bytes());
    };
    part(b"IHDR", &[&60_000u32.to_be_bytes()[..], &60_000u32.to_be_bytes(), &[8, 6, 0, 0, 0]].concat());
    part(b"IDAT", b"\x78\x9c\x03\x00\x00\x00\x00\x01");
    part(b"IEND", b"");
    chunk.resize(chunk.len().next_multiple_of(4), 0);
    root["bufferViews"][0] = json!({"buffer": 0, "byteOffset": chunk.len(), "byteLength": picture.len()});
    chunk.extend(picture);
    root["buffers"][0]["byteLength"] = chunk.len().into();
    let more = "[node.voxels]\nop = \"voxelize\"\nin.mesh = \"read\"\nresolution = 16\n[node.planes]\nop = \"vote-tile\"\nin.voxels = \"voxels\"\n[node.impostor]\nop = \"bake-impostor\"\nin.mesh = \"read\"\nin.tiles = \"planes\"\n";
    let (exit, told, peaks) = run("a.glb", &whole(&root, &chunk), more);
    assert!(exit == 1 && told.contains("image 0 has 3600000000 texels"), "{exit}: {told}");
    // What bakes has as much as what votes before, the dictionaries among it: 11 MiB.
    let least = idle();
    let room = 16 * MIB;
    assert!(peaks.len() == 4 && peaks.iter().all(|&p| p < least + room), "{peaks:?} above {least}");
}
