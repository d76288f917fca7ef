//! read-mesh: files that are built here, wrong in one thing each. (Bytes changed at random: `bad_input.rs`; the formats'
//! own rules: `ops/read_mesh.rs`.)

use lodge::artifact::Mesh;
use lodge::diag::{Findings, Result};
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::read_mesh::ReadMesh;
use serde_json::{Value, json};

use super::{counts, gzip};

/// Reads the first; the others lie beside it.
fn read_all(params: &str, files: &[(&str, &[u8])]) -> (Result<Mesh>, Findings) {
    let mut bench = Bench::default();
    for (i, (name, bytes)) in files.iter().enumerate() {
        bench.sources.push(Source { beside: i > 0, ..Source::of_bytes(name, bytes.to_vec()) });
    }
    let op: ReadMesh = toml::from_str(params).unwrap();
    let out = op.run(&bench.ctx(), Inputs::take(Vec::new()));
    let findings = bench.report.finish();
    if let Ok(mesh) = &out {
        let [_, accepted, ..] = counts(&findings);
        assert_eq!(accepted, mesh.triangles.len() as u64);
    }
    (out, findings)
}

fn read(name: &str, bytes: impl AsRef<[u8]>) -> (Result<Mesh>, Findings) {
    read_all("max-rejected = 1.0", &[(name, bytes.as_ref())])
}

#[track_caller]
fn refused(name: &str, bytes: impl AsRef<[u8]>) -> String {
    let e = read(name, bytes).0.map(|m| m.triangles.len()).unwrap_err();
    assert!(e.message.starts_with(&format!("`{name}`")) || e.code == "no-features", "{e}");
    e.to_string()
}

fn le(all: &[f32]) -> Vec<u8> {
    all.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// A GLB of a text and a chunk.
fn glb(root: &Value, chunk: &[u8]) -> Vec<u8> {
    pack(root.to_string().as_bytes(), chunk)
}

fn pack(text: &[u8], chunk: &[u8]) -> Vec<u8> {
    let mut text = text.to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend(((28 + text.len() + chunk.len()) as u32).to_le_bytes());
    for (kind, body) in [(b"JSON", &text[..]), (b"BIN\0", chunk)] {
        out.extend((body.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(body);
    }
    out
}

/// A square of four positions, then six indices of two bytes; node, mesh, buffer.
fn square() -> (Value, Vec<u8>) {
    let mut chunk = le(&[0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 1., 0.]);
    chunk.extend([0u16, 1, 2, 0, 2, 3].into_iter().flat_map(u16::to_le_bytes));
    let root = json!({
        "asset": {"version": "2.0"}, "buffers": [{"byteLength": 60}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}], "nodes": [{"mesh": 0}],
    });
    (root, chunk)
}

/// The square with something changed.
fn with(change: impl Fn(&mut Value)) -> Vec<u8> {
    let (mut root, chunk) = square();
    change(&mut root);
    glb(&root, &chunk)
}

/// The same as text, its buffer in this address.
fn gltf(uri: &str) -> Vec<u8> {
    let (mut root, _) = square();
    root["buffers"][0]["uri"] = uri.into();
    root.to_string().into_bytes()
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::new();
    for piece in bytes.chunks(3) {
        let word = piece.iter().fold(0u32, |w, &b| w << 8 | u32::from(b)) << (8 * (3 - piece.len()));
        for i in 0..4 {
            let letter = LETTERS[(word >> (18 - 6 * i) & 63) as usize] as char;
            out.push(if i <= piece.len() { letter } else { '=' });
        }
    }
    out
}

// -------------------------------------------------------------------------------------------------------- the shell

#[test]
fn a_glb_whose_shell_is_broken() {
    let (root, chunk) = square();
    let sound = glb(&root, &chunk);
    assert_eq!(read("a.glb", &sound).0.unwrap().triangles.len(), 2);
    let patched = |at: usize, value: u32| {
        let mut out = sound.clone();
        out[at..at + 4].copy_from_slice(&value.to_le_bytes());
        refused("a.glb", out)
    };
    let text = u32::from_le_bytes(sound[12..16].try_into().unwrap());
    assert!(
        patched(0, 0x4654_4c47).contains("this is no mesh, or it ends early (known are glTF, GLB, OBJ, PLY and STL")
    );
    assert!(patched(4, 1).contains("GLB of version 1, only 2 is read"));
    // The whole's length, the text's, the chunk's: too short, too long.
    for length in [0, 12, 19] {
        assert!(patched(8, length).contains(if length == 19 { "ends early" } else { "a GLB without its text" }));
    }
    assert!(patched(8, u32::MAX).contains("ends early"));
    assert!(patched(12, u32::MAX).contains("ends early"));
    assert!(patched(12, text - 4).contains("ends early"));
    assert!(patched(12, text + 4).contains("ends early"));
    let chunk_at = 20 + text as usize;
    assert!(patched(chunk_at, 1 << 30).contains("ends early"));
    let short = patched(chunk_at, 44);
    assert!(short.contains("ends early"), "{short}");
    assert!(patched(16, 7).contains("a GLB without its text"));
    assert!(patched(chunk_at + 4, 7).contains("buffer 0 has no data"));
    assert!(refused("a.glb", pack(b"[1, 2]", &[])).contains("no glTF"));
    let deep = "[".repeat(1 << 20);
    assert!(refused("a.glb", pack(format!("{{\"asset\": {{\"extras\": {deep}").as_bytes(), &[])).contains("no glTF"));
    assert!(refused("a.gltf", br#"{"asset": {"version": "1.0"}, "meshes": {"a": {}}}"#).contains("no glTF"));
    assert!(refused("a.gltf", br#"{"asset": {"version": "1.0"}}"#).contains("glTF of version `1.0`, only 2 is read"));
    assert!(refused("a.gltf", b"{}").contains("glTF of version ``"));
    for cut in 0..sound.len() {
        refused("a.glb", &sound[..cut]);
    }
}

#[test]
fn gzip_cut_off_or_endless() {
    let sound = gzip(with(|_| {}));
    assert_eq!(read("a.glb.gz", &sound).0.unwrap().triangles.len(), 2);
    for cut in [3, 10, sound.len() / 2, sound.len() - 1] {
        let e = refused("a.glb.gz", &sound[..cut]);
        assert!(e.contains("`a.glb.gz` ends in the middle of its compressed data"), "{cut}: {e}");
    }
    let mut damaged = sound.clone();
    damaged[sound.len() / 2] ^= 0x55;
    read("a.glb.gz", damaged).0.map(|_| ()).unwrap_err();
}

// ------------------------------------------------------------------------------------------------ places and counts

#[test]
fn numbers_that_lead_nowhere_have_their_place() {
    for (change, said) in [
        (
            ("accessors", 0, "count", json!(1u64 << 40)),
            "nodes[0]: meshes[0].primitives[0]: accessor 0: 1099511627776 elements are more than",
        ),
        (
            ("accessors", 1, "count", json!(7)),
            "nodes[0]: meshes[0].primitives[0]: accessor 1: 7 elements go beyond buffer view 1",
        ),
        (("accessors", 1, "bufferView", json!(9)), "meshes[0].primitives[0]: there is no buffer view 9"),
        (("accessors", 0, "componentType", json!(5124)), "accessor 0: 5124 is no component type"),
        (("accessors", 0, "type", json!("VEC9")), "accessor 0: `VEC9` is no type"),
        (("accessors", 0, "type", json!("VEC2")), "meshes[0].primitives[0]: accessor 0: positions of 2 numbers"),
        (("bufferViews", 0, "buffer", json!(3)), "meshes[0].primitives[0]: there is no buffer 3"),
        (("bufferViews", 1, "byteOffset", json!(55)), "buffer view 1 goes beyond its buffer"),
        (("nodes", 0, "mesh", json!(1)), "nodes[0]: there is no mesh 1"),
        (("nodes", 0, "children", json!([5])), "there is no node 5"),
        (("nodes", 0, "children", json!([0])), "no triangles in the input"),
        (("nodes", 0, "matrix", json!([1, 2])), "no glTF: invalid length 2"),
        (("accessors", 0, "count", json!(-1)), "no glTF: invalid value: integer `-1`"),
        (("accessors", 0, "count", json!("4")), "no glTF: invalid type: string"),
    ] {
        let (list, i, key, value) = change;
        let message = refused("a.glb", with(|r| r[list][i][key] = value.clone()));
        assert!(message.contains(said), "{said}: {message}");
    }
    let message =
        refused("a.glb", with(|r| r["meshes"][0]["primitives"][0]["attributes"] = json!({"POSITION": 0, "NORMAL": 1})));
    assert!(message.contains("primitives[0]: accessor 1: normals of 1 numbers"), "{message}");
    let fewer = with(|r| {
        r["accessors"][1]["count"] = 3.into();
        r["accessors"][1]["type"] = "SCALAR".into();
        r["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = 1.into();
    });
    assert!(refused("a.glb", fewer).contains("accessor 1: colours of 3 vertices, but there are 4"));
}

#[test]
fn triangles_that_are_none_are_counted_where_they_are() {
    let (root, mut chunk) = square();
    chunk[52..54].copy_from_slice(&u16::MAX.to_le_bytes());
    let (mesh, f) = read("a.glb", glb(&root, &chunk));
    assert_eq!((mesh.unwrap().triangles.len(), counts(&f)), (1, [2, 1, 1, 0]));
    let note = &f.rejects[0];
    assert_eq!(
        [&note.id, &note.place, &note.cause],
        ["triangle 0", "a.glb:nodes[0], meshes[0].primitives[0], triangle 0", "an index beyond the vertices"]
    );
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let (root, mut chunk) = square();
        chunk[12..16].copy_from_slice(&value.to_le_bytes());
        let (mesh, f) = read("a.glb", glb(&root, &chunk));
        assert_eq!((mesh.unwrap().positions.len(), counts(&f)), (3, [2, 1, 1, 0]));
        assert_eq!(f.rejects[0].cause, "a corner that is no finite number");
    }
    // All of them: an error that says how many and gives one.
    let large = with(|r| r["nodes"][0]["scale"] = json!([1e30, 1e30, 1e30]));
    let huge = with(|r| r["nodes"][0]["scale"] = json!([1e300, 1e300, 1e300]));
    let nowhere =
        with(|r| r["nodes"] = json!([{"children": [1], "scale": [1e200, 1, 1]}, {"mesh": 0, "scale": [1e200, 1, 1]}]));
    assert!(refused("a.glb", huge).contains("2 rejected; the first: `triangle 0`"));
    assert_eq!(read("a.glb", large).0.unwrap().triangles.len(), 2);
    let message = refused("a.glb", nowhere);
    assert!(message.contains("2 read, 0 filtered, 2 rejected; the first: `triangle 0`"), "{message}");
    assert!(refused("a.glb", with(|r| r["nodes"][0]["scale"] = json!("x"))).contains("invalid type: string"));
    let inf = with(|_| {});
    let at = inf.windows(8).position(|w| w == b"\"mesh\":0").unwrap();
    let mut inf = inf;
    inf[at..at + 8].copy_from_slice(b"\"mesh\":\t");
    assert!(refused("a.glb", inf).contains("no glTF"));
    // Flat ones are triangles.
    let flat = with(|r| r["nodes"][0]["scale"] = json!([0, 0, 0]));
    assert_eq!(read("a.glb", flat).0.unwrap().triangles.len(), 2);
}

#[test]
fn a_million_rejects_are_counted_but_not_all_listed() {
    let mut text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    text += &"f 1 2 9\n".repeat(300_000);
    let mut bench = Bench::default();
    bench.sources.push(Source::of_bytes("a.obj", text.into_bytes()));
    let op: ReadMesh = toml::from_str("max-rejected = 1.0").unwrap();
    assert_eq!(op.run(&bench.ctx(), Inputs::take(Vec::new())).unwrap().triangles.len(), 1);
    let f = bench.report.finish();
    assert_eq!(f.facts["rejected"], 300_000);
    assert_eq!(f.facts["rejected_by_cause"], json!({"an index beyond the vertices": 300_000}));
    assert_eq!((f.rejects.len(), &*f.rejects[0].place), (10_000, "a.obj:5"));
}

// ------------------------------------------------------------------------------------------------------- what is odd

#[test]
fn empty_scenes_say_so() {
    for (change, read, filtered) in [
        (json!([]), 0, 0),
        (json!([{"primitives": []}]), 0, 0),
        (json!([{"primitives": [{"attributes": {}}]}]), 1, 1),
        (
            json!([{"primitives": [{"attributes": {"POSITION": 0}, "mode": 0}, {"attributes": {"POSITION": 0}, "mode": 1}]}]),
            2,
            2,
        ),
    ] {
        let bytes = with(|r| {
            r["meshes"] = change.clone();
            if change.as_array().unwrap().is_empty() {
                r["nodes"] = json!([{}]);
            }
        });
        let message = refused("a.glb", bytes);
        assert_eq!(message, format!("no triangles in the input: {read} read, {filtered} filtered, 0 rejected"));
    }
    let none = with(|r| r["accessors"][1]["count"] = 0.into());
    assert_eq!(refused("a.glb", none), "no triangles in the input: 0 read, 0 filtered, 0 rejected");
}

#[test]
fn nodes_in_circles_and_skins_of_nothing() {
    let circle = with(|r| {
        r["nodes"] = json!([{"mesh": 0, "children": [1]}, {"children": [2]}, {"children": [1]}]);
    });
    assert!(refused("a.glb", circle).contains("node 1 has two parents"));
    let closed = with(|r| {
        r["nodes"] = json!([{"mesh": 0}, {"children": [2]}, {"children": [1]}]);
        r["scenes"] = json!([{"nodes": [0, 1]}]);
    });
    assert!(refused("a.glb", closed).contains("node 1 is in the scene twice"));
    // A long chain is no circle.
    let chain = with(|r| {
        let mut all: Vec<Value> = (1..100_000).map(|i| json!({"children": [i]})).collect();
        all.push(json!({"mesh": 0}));
        r["nodes"] = all.into();
    });
    assert_eq!(read("a.glb", chain).0.unwrap().triangles.len(), 2);
    let skin = |skin: Value| {
        with(|r| {
            r["nodes"][0]["skin"] = 0.into();
            r["skins"] = json!([skin]);
        })
    };
    assert!(refused("a.glb", skin(json!({"joints": [7]}))).contains("nodes[0]: joint 7 is not in the scene"));
    let wrong = skin(json!({"joints": [0], "inverseBindMatrices": 0}));
    assert!(refused("a.glb", wrong).contains("nodes[0]: accessor 0: bind matrices of 3 numbers"));
    // Without weights a skin bends nothing.
    assert_eq!(read("a.glb", skin(json!({"joints": [0]}))).0.unwrap().triangles.len(), 2);
    // A hundred thousand nodes with one long skin: joints are placed once.
    let many = with(|r| {
        r["nodes"] = (0..20_000).map(|_| json!({"mesh": 0, "skin": 0})).collect();
        r["skins"] = json!([{"joints": (0..20_000).collect::<Vec<_>>()}]);
    });
    // All at one place: more than sixteen times is no more to see.
    let (out, f) = read("a.glb", many);
    assert_eq!((out.unwrap().triangles.len(), counts(&f)), (32, [40_000, 32, 0, 39_968]));
    assert_eq!(f.facts["filtered_by_type"], json!({"triangles that are there 16 times already": 39_968}));
}

#[test]
fn morphs_are_told() {
    let targets = |mesh: Value, node: Value| {
        let (out, f) = read(
            "a.glb",
            with(|r| {
                r["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": 0}]);
                r["meshes"][0]["weights"] = mesh.clone();
                r["nodes"][0]["weights"] = node.clone();
            }),
        );
        out.unwrap();
        f.warnings.iter().any(|w| w.contains("morph targets are not heeded"))
    };
    assert!(!targets(json!([0.0]), json!([])));
    assert!(targets(json!([0.5]), json!([])));
    assert!(targets(json!([0.0]), json!([0.5])));
    assert!(!targets(json!([0.5]), json!([0.0])));
}

#[test]
fn sparse_numbers() {
    let sparse = |value: Value| read("a.glb", with(|r| r["accessors"][0]["sparse"] = value.clone())).0;
    let part = |count: u64, view: usize| json!({"count": count, "indices": {"bufferView": view, "byteOffset": 12 - 12 * view.min(1), "componentType": 5123}, "values": {"bufferView": 0}});
    // Indices 0, 1, 2 get the values of 0, 1, 2.
    assert_eq!(sparse(part(3, 1)).unwrap().triangles.len(), 2);
    for (value, said) in [
        (part(5, 1), "more sparse values than elements"),
        (part(4, 0), "accessor 0: sparse index"),
        (part(3, 8), "there is no buffer view 8"),
        (part(1 << 50, 1), "more sparse values than elements"),
        (json!({"count": 1}), "missing field `indices`"),
    ] {
        let e = sparse(value).unwrap_err().to_string();
        assert!(e.contains(said), "{said}: {e}");
    }
    // Without a view all else is 0; there is no reason for millions.
    let zeros =
        |count: u64| with(|r| r["accessors"][0] = json!({"componentType": 5126, "count": count, "type": "VEC3"}));
    assert_eq!(read("a.glb", zeros(4)).0.unwrap().positions, [[0.0; 3]; 4]);
    assert!(refused("a.glb", zeros(60_000_000)).contains("accessor 0: 60000000 elements without data"));
}

#[test]
fn parts_that_share_without_end() {
    // One accessor of a million zeros, drawn by ten thousand primitives, or by ten thousand nodes, or copies of copies.
    let long = json!({"componentType": 5126, "count": 1_000_000, "type": "VEC3"});
    let primitives = with(|r| {
        r["accessors"][0] = long.clone();
        let one = r["meshes"][0]["primitives"][0].clone();
        r["meshes"][0]["primitives"] = vec![one; 10_000].into();
    });
    assert_eq!(read("a.glb", primitives).1.facts["read"], 20_000);
    let sparse = with(|r| {
        r["accessors"][0] = long.clone();
        let part = json!({"bufferView": 1, "componentType": 5123});
        r["accessors"][0]["sparse"] = json!({"count": 1, "indices": part, "values": {"bufferView": 0}});
        let one = r["meshes"][0]["primitives"][0].clone();
        r["meshes"][0]["primitives"] = vec![one; 10_000].into();
    });
    let message = refused("a.glb", sparse);
    assert!(message.contains("].primitives[89]: accessor 0: too many parts share sparse numbers"), "{message}");
    let bare = |nodes: usize| {
        with(move |r| {
            r["accessors"][0] = json!({"componentType": 5126, "count": 1_000_000, "type": "VEC3"});
            r["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("indices");
            r["nodes"] = vec![json!({"mesh": 0}); nodes].into();
        })
    };
    assert!(refused("a.glb", bare(100)).contains("nodes[67]: up to here it draws more than the 67108864 corners"));
    let copies = with(|r| {
        r["accessors"].as_array_mut().unwrap().push(json!({"componentType": 5126, "count": 1_000_000, "type": "VEC3"}));
        let copies = json!({"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2}}});
        r["nodes"] = vec![json!({"mesh": 0, "extensions": copies}); 100].into();
    });
    assert!(refused("a.glb", copies).contains("nodes[11]: up to here it draws more than the 67108864 corners"));
    // Many parts of one long list of vertices are usual: only what each needs is read.
    let mut chunk: Vec<u8> = (0..300_000u32).flat_map(|i| le(&[(i % 700) as f32, (i / 700) as f32, 0.0])).collect();
    let vertices = chunk.len();
    chunk.extend((0..3000u32).flat_map(|i| [90 * i, 90 * i + 1, 90 * i + 2]).flat_map(u32::to_le_bytes));
    let root = json!({
        "asset": {"version": "2.0"}, "buffers": [{"byteLength": chunk.len()}],
        "bufferViews": [{"buffer": 0, "byteLength": vertices}, {"buffer": 0, "byteOffset": vertices, "byteLength": 36_000}],
        "accessors": std::iter::once(json!({"bufferView": 0, "componentType": 5126, "count": 300_000, "type": "VEC3"}))
            .chain((0..3000).map(|i| json!({"bufferView": 1, "byteOffset": 12 * i, "componentType": 5125, "count": 3, "type": "SCALAR"})))
            .collect::<Vec<_>>(),
        "meshes": [{"primitives": (1..=3000).map(|i| json!({"attributes": {"POSITION": 0}, "indices": i})).collect::<Vec<_>>()}],
        "nodes": [{"mesh": 0}],
    });
    let mesh = read("a.glb", glb(&root, &chunk)).0.unwrap();
    assert_eq!((mesh.triangles.len(), mesh.positions.len()), (3000, 9000));
    assert_eq!(
        mesh.positions[mesh.triangles[2999][2] as usize],
        [f64::from(269_912u32 % 700), 0.0, f64::from(269_912 / 700)]
    );
}

// ------------------------------------------------------------------------------------------------------ files beside

#[test]
fn buffers_in_addresses() {
    let (_, chunk) = square();
    let data = |head: &str, body: &str| gltf(&format!("data:{head},{body}"));
    let sound = base64(&chunk);
    for head in ["application/octet-stream;base64", "application/gltf-buffer;base64", ";base64"] {
        assert_eq!(read("a.gltf", data(head, &sound)).0.unwrap().triangles.len(), 2, "{head}");
    }
    let percent: String = chunk.iter().map(|b| format!("%{b:02x}")).collect();
    assert_eq!(read("a.gltf", data("application/octet-stream", &percent)).0.unwrap().triangles.len(), 2);
    for (body, said) in [
        (sound.replacen('A', "!", 1), "data in its text is no base64"),
        (sound[..40].to_string(), "buffer 0 ends early: 30 bytes of 60"),
        (String::new(), "buffer 0 ends early: 0 bytes of 60"),
    ] {
        let message = refused("a.gltf", data(";base64", &body));
        assert!(message.contains("nodes[0]: meshes[0].primitives[0]: ") && message.contains(said), "{said}: {message}");
    }
    assert!(refused("a.gltf", gltf("data:")).contains("buffer 0 ends early: 0 bytes of 60"));
    let far = refused("a.gltf", gltf("https://example.org/a.bin"));
    assert!(far.contains("`https://example.org/a.bin`, which it names, is elsewhere (put it beside the file"), "{far}");
}

#[test]
fn nothing_outside_the_folder_is_read() {
    let (_, chunk) = square();
    for uri in [
        "../a.bin",
        "in/../../a.bin",
        "%2e%2e/a.bin",
        "..%2fa.bin",
        "/etc/passwd",
        "..\\a.bin",
        "C:\\a.bin",
        "./../a.bin",
    ] {
        let bytes = gltf(&uri.replace('\\', "\\\\").replace("\\\\", "\\"));
        assert!(ReadMesh::beside(&Source::of_bytes("a.gltf", bytes.clone())).is_empty(), "{uri}");
        // Not even if somebody laid it there.
        let name = String::from_utf8(uri.replace("%2e", ".").replace("%2f", "/").into_bytes()).unwrap();
        let e = read_all("", &[("a.gltf", &bytes), (&name, &chunk)]).0.unwrap_err().to_string();
        assert!(e.contains("which it names, lies outside the file's folder"), "{uri}: {e}");
    }
    for (uri, name) in [("in/../a.bin", "in/../a.bin"), ("in/a%20b.bin", "in/a b.bin"), ("./a.bin", "./a.bin")] {
        let bytes = gltf(uri);
        assert_eq!(ReadMesh::beside(&Source::of_bytes("a.gltf", bytes.clone())), [name]);
        assert_eq!(read_all("", &[("a.gltf", &bytes), (name, &chunk)]).0.unwrap().triangles.len(), 2);
    }
    // Libraries and pictures: told, and the rest is read.
    let obj = b"mtllib ../a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n";
    assert!(ReadMesh::beside(&Source::of_bytes("a.obj", obj.to_vec())).is_empty());
    let (out, f) = read("a.obj", obj);
    assert_eq!(out.unwrap().triangles.len(), 1);
    assert!(f.warnings[0].contains("`../a.mtl` lies outside the file's folder"), "{:?}", f.warnings);
}

const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

/// The square with a picture in this address.
fn painted(image: Value) -> Vec<u8> {
    with(|r| {
        r["meshes"][0]["primitives"][0]["material"] = 0.into();
        r["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
        r["textures"] = json!([{"source": 0}]);
        r["images"] = json!([image]);
    })
}

#[test]
fn pictures_that_are_none() {
    for (bytes, said) in [
        (&b"\xabKTX 20\xbb\r\n\x1a\n"[..], "image 0 is KTX2: convert it to PNG, JPEG or WebP"),
        (b"DDS ....", "image 0 is DDS: convert it"),
        (b"BM......", "image 0 is BMP: convert it"),
        (b"<html>not found</html>", "image 0 is no picture that is known: PNG, JPEG and WebP are read"),
        (b"", "image 0 is no picture that is known"),
    ] {
        let uri = format!("data:image/png;base64,{}", base64(bytes));
        let message = refused("a.glb", painted(json!({"uri": uri})));
        assert!(message.contains(said), "{said}: {message}");
    }
    let (out, f) = read("a.glb", painted(json!({"uri": "gone.png"})));
    assert_eq!(out.unwrap().triangles.len(), 2);
    assert!(
        f.warnings[0].contains("`gone.png`, which it names, is not there; what it covers has its material's colour")
    );
    assert!(refused("a.glb", painted(json!({}))).contains("image 0 () has no data"));
    assert!(refused("a.glb", painted(json!({"bufferView": 7}))).contains("there is no buffer view 7"));
    let texture = |t: Value| {
        let (mut root, chunk) = square();
        root["meshes"][0]["primitives"][0]["material"] = 0.into();
        root["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
        root["textures"] = json!([t]);
        read("a.glb", glb(&root, &chunk))
    };
    let message = texture(json!({"extensions": {"KHR_texture_basisu": {"source": 0}}})).0.unwrap_err().to_string();
    assert!(message.contains("KTX2 (KHR_texture_basisu), which is not read (write it again with PNG"), "{message}");
    let (out, f) = texture(json!({"extensions": {"EXT_texture_avif": {"source": 0}}}));
    assert_eq!(out.unwrap().triangles.len(), 2);
    assert!(
        f.warnings[0].contains("texture 0 is only told by `EXT_texture_avif`, which is not read"),
        "{:?}",
        f.warnings
    );
    assert!(texture(json!({"source": 5})).0.unwrap_err().message.contains("there is no image 5"));
    // OBJ: told.
    let obj = b"mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n";
    let mtl = b"newmtl m\nmap_Kd a.png\n";
    for (beside, said) in
        [(None, "is not there"), (Some(&b"GIF89a"[..]), "is no picture that is known"), (Some(b"BM.."), "is BMP")]
    {
        let mut files: Vec<(&str, &[u8])> = vec![("a.obj", obj), ("a.mtl", mtl)];
        files.extend(beside.map(|bytes| ("a.png", bytes)));
        let (out, f) = read_all("", &files);
        assert_eq!(out.unwrap().triangles.len(), 1);
        assert!(
            f.warnings.len() == 1 && f.warnings[0].contains(&format!("the picture `a.png` {said}")),
            "{:?}",
            f.warnings
        );
    }
    let all: [(&str, &[u8]); 3] = [("a.obj", obj), ("a.mtl", mtl), ("a.png", PNG)];
    assert!(read_all("", &all).1.warnings.is_empty());
}

// --------------------------------------------------------------------------------------------------- OBJ, PLY and STL

const CORNERS: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

#[test]
fn faces_of_obj_that_are_none() {
    let face = |face: &str| read("a.obj", format!("{CORNERS}{face}\nf 1 2 3\n"));
    for of in [
        "f 0 1 2",
        "f 1 2 5",
        "f -5 1 2",
        "f 1/1 2/1 3/1",
        "f 1//1 2//1 3//1",
        "f 4294967297 1 2",
        "f -9223372036854775808 1 2",
    ] {
        let (out, f) = face(of);
        assert_eq!((out.unwrap().triangles.len(), counts(&f)), (1, [2, 1, 1, 0]), "{of}");
        assert_eq!([&*f.rejects[0].place, &*f.rejects[0].cause], ["a.obj:5", "an index beyond the vertices"], "{of}");
    }
    for of in ["f", "f 1", "f 1 2"] {
        assert_eq!(face(of).1.rejects[0].cause, "fewer than three corners");
    }
    for of in ["f 1 2 x", "f 1.5 2 3", "f 1 2 99999999999999999999", "f /1 2 3"] {
        let message = refused("a.obj", format!("{CORNERS}{of}\n"));
        assert!(message.contains("line 5: `") && message.contains("is no corner of a face"), "{of}: {message}");
    }
    // Of four corners one is not: the triangles that have it.
    let (out, f) = face("f 1 2 3 9");
    assert_eq!((out.unwrap().triangles.len(), counts(&f)), (2, [3, 2, 1, 0]));
    assert!(refused("a.obj", "v 1 2 3e999999 nan\nv inf 0 0\n").contains("no triangles"));
}

#[test]
fn faces_of_a_million_corners() {
    let n = 1_000_000;
    let mut text = String::new();
    for i in 0..n {
        let a = f64::from(i) * std::f64::consts::TAU / f64::from(n);
        text += &format!("v {} {} 0\n", libm::cos(a), libm::sin(a));
    }
    text += "f";
    (1..=n).for_each(|i| text += &format!(" {i}"));
    assert_eq!(read("a.obj", &text).0.unwrap().triangles.len(), 999_998);
    // As many as are cut by ears, zigzag: bounded time all the same.
    let mut text = String::new();
    for i in 0..60_000 {
        text += &format!("v {} {} 0\n", i, if i % 2 == 0 { 0 } else { 1000 + i % 7 });
    }
    text += "v 60000 -5 0\nv 0 -5 0\nf";
    (1..=60_002).for_each(|i| text += &format!(" {i}"));
    let at = std::time::Instant::now();
    assert_eq!(read("a.obj", &text).0.unwrap().triangles.len(), 60_000);
    println!("60,002 corners: {:?}", at.elapsed());
    // One corner of everything.
    let mut text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\n");
    (0..200_000).for_each(|i| text += &format!("vt {i} 0\n"));
    (1..=200_000).for_each(|i| text += &format!("f 1/{i} 2/1 3/1\n"));
    let at = std::time::Instant::now();
    let mesh = read("a.obj", format!("mtllib a.mtl\nusemtl m\n{text}")).0.unwrap();
    assert_eq!((mesh.triangles.len(), mesh.positions.len()), (200_000, 200_002));
    println!("200,000 corners at one place: {:?}", at.elapsed());
}

fn ply(format: &str, vertices: &str, faces: &str, more: &str) -> Vec<u8> {
    format!(
        "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n{more}\
         element face {faces}\nproperty list int int vertex_indices\nend_header\n"
    )
    .into_bytes()
}

#[test]
fn plys_that_claim_too_much() {
    const LITTLE: &str = "binary_little_endian";
    let with = |head: Vec<u8>, body: &[u8]| refused("a.ply", [&head[..], body].concat());
    for (format, vertices, faces) in
        [(LITTLE, "1000000000000", "1"), ("ascii", "1000000000000", "1"), (LITTLE, "1", "18446744073709551615")]
    {
        let message = with(ply(format, vertices, faces, ""), &[0; 40]);
        assert!(message.contains("the header promises ") || message.contains("is no number"), "{message}");
    }
    assert!(
        with(ply("ascii", "18446744073709551616", "1", ""), b"").contains("line 3: `18446744073709551616` is no count")
    );
    assert!(with(ply("ascii", "-4", "1", ""), b"").contains("line 3: `-4` is no count"));
    assert!(with(ply("ascii", "1", "1", "property real w\n"), b"").contains("line 7: `real` is no type of PLY"));
    assert!(
        with(ply("ascii", "1", "1", "property list float128 int w\n"), b"").contains("line 7: `float128` is no type")
    );
    assert!(
        with(ply("ascii", "1", "1", "property list int w\n"), b"")
            .contains("line 7: a property needs a type and a name")
    );
    assert!(with(ply("ebcdic", "1", "1", ""), b"").contains("line 2: `ebcdic` is no format of PLY"));
    assert!(
        with(b"ply\nformat ascii 1.0\nproperty int x\nend_header\n".to_vec(), b"")
            .contains("line 3: a property of no element")
    );
    assert!(
        with(b"ply\nformat ascii 1.0\nelement vertex 3\n".to_vec(), b"").contains("the header has no `end_header`")
    );
    let flat =
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nend_header\n0 0\n".to_vec();
    assert!(with(flat, b"").contains("vertices need `x`, `y` and `z`"));
    // Lists of a thousand million.
    let list = |n: i32| [&le(&[0.0; 9])[..], &n.to_le_bytes(), &[0; 12]].concat();
    for n in [1_000_000_000, -1, 4] {
        let message = with(ply(LITTLE, "3", "1", ""), &list(n));
        let said =
            if n == 4 { "the file ends in row 0 of `face`".into() } else { format!("row 0 of `face`: a list of {n}") };
        assert!(message.contains(&said), "{message}");
    }
    assert!(
        with(ply("ascii", "3", "1", ""), b"0 0 0 1 0 0 0 1 0\n1000000000 0 1 2\n")
            .contains("row 0 of `face`: a list of 1000000000")
    );
    assert!(
        with(ply("ascii", "1", "1", ""), b"0 0 zero\n3 0 0 0\n").contains("row 0 of `vertex`: `zero` is no number")
    );
    // Indices that are none, in lists of any type of number.
    let mut bytes = ply(LITTLE, "3", "2", "");
    let at = bytes.windows(7).position(|w| w == b"int int").unwrap();
    bytes.splice(at..at + 7, *b"uchar float");
    bytes.extend(le(&[0., 0., 0., 1., 0., 0., 0., 1., 0.]));
    bytes.extend([3]);
    bytes.extend(le(&[0.0, 1.0, 2.0]));
    bytes.extend([3]);
    bytes.extend(le(&[0.0, f32::NAN, 1e30]));
    let (out, f) = read("a.ply", bytes);
    assert_eq!((out.unwrap().triangles.len(), counts(&f)), (1, [2, 1, 1, 0]));
    assert_eq!(f.rejects[0].place, "a.ply:face 1");
}

#[test]
fn stls_whose_count_lies() {
    let stl = |count: u32, facets: usize| {
        let mut out = b"solid, but binary".to_vec();
        out.resize(80, 0);
        out.extend(count.to_le_bytes());
        for _ in 0..facets {
            out.extend(le(&[0., 0., 1., 0., 0., 0., 1., 0., 0., 0., 1., 0.]));
            out.extend([0; 2]);
        }
        out
    };
    assert_eq!(read("a.stl", stl(2, 2)).0.unwrap().triangles.len(), 2);
    assert_eq!(refused("a.stl", stl(0, 0)), "no triangles in the input: 0 read, 0 filtered, 0 rejected");
    for (count, facets) in [(3, 2), (1, 2), (0, 2), (u32::MAX, 2), (1, 0)] {
        let message = refused("a.stl", stl(count, facets));
        let said = format!("`a.stl`: its header promises {count} triangles, but there is room for {facets}");
        assert!(message.starts_with(&said), "{message}");
    }
    let message = refused("a.stl", &stl(1, 1)[..60]);
    assert!(message.contains("a binary STL has 84 bytes before its triangles, this has 60"), "{message}");
    // As text.
    let facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    assert_eq!(read("a.stl", format!("solid a\n{facet}endsolid a\n")).0.unwrap().triangles.len(), 1);
    for (text, said) in [
        ("solid a\nendsolid a\n".to_string(), "no triangles in the input"),
        (format!("solid a\n{facet}"), "the file ends before its `endsolid`"),
        (
            format!("solid a\n{}endsolid\n", facet.replace("vertex 1 0 0\n", "")),
            "line 7: a facet that has not three corners",
        ),
        (
            format!("solid a\n{}endsolid\n", facet.replace("1 0 0", "1 0")),
            "line 5: a vertex of fewer than three numbers",
        ),
        (format!("solid a\n{}endsolid\n", facet.replace("1 0 0", "1 O 0")), "line 5: `O` is no number"),
        (format!("solid a\n{}endsolid\n", facet.replace("endloop", "")), ""),
        (format!("solid a\n{facet}solitude\n"), "line 9: `solitude` is no word of STL"),
    ] {
        match said {
            "" => assert_eq!(read("a.stl", text).0.unwrap().triangles.len(), 1),
            said => assert!(refused("a.stl", &text).contains(said), "{said}: {}", refused("a.stl", &text)),
        }
    }
}
