//! Streams that are broken, or said to be what they are not.

use serde_json::{Value, json};

use super::support::meshopt::{EXT, KHR, Packed, attributes, packed, parts, sequence, triangles, whole};
use super::support::scene::scene;
use super::support::{Random, is_long};
use super::{error, pavilion, read, read_all};

const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];

/// Four places and these indices, of two bytes.
fn square(name: &'static str, mode: &str, count: usize, indices: &[u8]) -> Vec<u8> {
    let mut glb = Packed::new(name);
    let bytes: Vec<u8> = SQUARE.iter().flat_map(|v| v.to_le_bytes()).collect();
    glb.view("ATTRIBUTES", None, 4, 12, &attributes(name, &bytes, 12));
    glb.view(mode, None, count, 2, indices);
    glb.finish(json!({
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": count, "type": "SCALAR"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}], "nodes": [{"mesh": 0}]}))
}

fn sound(name: &'static str) -> Vec<u8> {
    square(name, "TRIANGLES", 6, &triangles(&[0, 1, 2, 0, 2, 3]))
}

#[test]
fn what_is_said_of_a_stream_must_fit() {
    for name in [EXT, KHR] {
        assert_eq!(read(&sound(name)).triangles.len(), 2);
        let (root, chunk) = parts(&sound(name));
        // What the first two views, and what is said of their streams, are changed to.
        let wrong = |change: &dyn Fn(&mut [Value], &mut [Value])| {
            let mut root = root.clone();
            let views = root["bufferViews"].as_array_mut().unwrap();
            let mut said: Vec<Value> = views.iter_mut().map(|v| v["extensions"][name].take()).collect();
            change(views, &mut said);
            views.iter_mut().zip(said).for_each(|(v, s)| v["extensions"] = json!({name: s}));
            error(&whole(&root, &chunk))
        };
        let at = |view: usize| format!("`a.glb`: nodes[0]: meshes[0].primitives[0]: buffer view {view}: {name}: ");
        let stream = |view: usize, key: &str, value: Value, what: &str| {
            let message = wrong(&|_, said| said[view][key] = value.clone());
            assert!(message.starts_with(&format!("{}{what}", at(view))), "{what}: {message}");
        };
        stream(0, "mode", "LINES".into(), "`LINES` is no mode: ATTRIBUTES, TRIANGLES and INDICES are");
        stream(0, "mode", 7.into(), "invalid type: integer `7`, expected a string");
        stream(0, "filter", "ZIP".into(), "`ZIP` is no filter of ATTRIBUTES");
        stream(1, "filter", "OCTAHEDRAL".into(), "`OCTAHEDRAL` is no filter of TRIANGLES");
        stream(0, "filter", "OCTAHEDRAL".into(), "a stride of 12 bytes, but that of ATTRIBUTES (OCTAHEDRAL) is 4 or 8");
        stream(0, "filter", "QUATERNION".into(), "a stride of 12 bytes, but that of ATTRIBUTES (QUATERNION) is 8");
        stream(0, "filter", "COLOR".into(), "a stride of 12 bytes, but that of ATTRIBUTES (COLOR) is 4 or 8");
        for stride in [0, 6, 260] {
            let what =
                format!("a stride of {stride} bytes, but that of ATTRIBUTES (NONE) is a multiple of 4 up to 256");
            stream(0, "byteStride", stride.into(), &what);
        }
        stream(1, "byteStride", 3.into(), "a stride of 3 bytes, but that of TRIANGLES (NONE) is 2 or 4");
        stream(1, "byteStride", 4.into(), "6 elements of 4 bytes are not the 12 bytes of the view");
        stream(1, "count", 5.into(), "5 indices are no triangles");
        stream(1, "count", 9.into(), "9 elements of 2 bytes are not the 12 bytes of the view");
        stream(0, "count", 0.into(), "0 elements of 12 bytes are not the 48 bytes of the view");
        stream(0, "count", json!(-1), "invalid value: integer `-1`");
        stream(0, "count", json!(4.5), "invalid type: floating point `4.5`");
        stream(0, "byteOffset", chunk.len().into(), "it goes beyond buffer 0");
        stream(0, "byteOffset", u64::MAX.into(), "it goes beyond buffer 0");
        stream(0, "byteLength", u64::MAX.into(), "it goes beyond buffer 0");
        stream(0, "byteLength", 0.into(), "0 bytes cannot hold 4 elements of 12 bytes");
        for (key, value) in [("mode", "INDICES"), ("mode", "TRIANGLES")] {
            stream(0, key, value.into(), "a stride of 12 bytes, but that of ");
        }
        stream(1, "mode", "INDICES".into(), "its packed bytes end early or are damaged (the file was damaged, or");
        stream(1, "byteLength", 3.into(), "its packed bytes end early or are damaged");

        let message = wrong(&|_, said| drop(said[0].as_object_mut().unwrap().remove("mode")));
        assert_eq!(message, format!("{}missing field `mode`", at(0)));
        let message = wrong(&|_, said| said[0] = json!(null));
        assert!(message.starts_with(&at(0)) && message.contains("invalid type: null"), "{message}");
        let message = wrong(&|_, said| said[0]["buffer"] = 7.into());
        assert!(message.ends_with("there is no buffer 7"), "{message}");
        let message = wrong(&|_, said| said[0]["buffer"] = 1.into());
        assert!(message.ends_with("buffer 1 has no data"), "{message}");
        let message = wrong(&|views, _| views[0]["byteLength"] = 47.into());
        assert_eq!(message, format!("{}4 elements of 12 bytes are not the 47 bytes of the view", at(0)));
        // Only of the first: its successor may unpack to rows of any width.
        let message = wrong(&|views, said| {
            views[0]["byteStride"] = 16.into();
            said[0]["buffer"] = if name == EXT { 0 } else { 7 }.into();
        });
        let told = if name == EXT { "a stride of 12 bytes, but 16 when unpacked" } else { "there is no buffer 7" };
        assert!(message.contains(told), "{message}");
        // The accessor wants more than there is.
        let mut more = root.clone();
        more["accessors"][0]["count"] = 5.into();
        assert!(error(&whole(&more, &chunk)).contains("accessor 0: 5 elements go beyond buffer view 0"));
    }
}

/// A few bytes that promise millions: told before any room is made.
#[test]
fn promises_without_end() {
    for name in [EXT, KHR] {
        let (root, mut chunk) = parts(&sound(name));
        let length = root["bufferViews"][0]["extensions"][name]["byteLength"].as_u64().unwrap();
        let of = |view: usize, count: u64, stride: u64, bytes: Option<u64>, chunk: &[u8]| {
            let mut root = root.clone();
            root["bufferViews"][view]["byteLength"] = count.saturating_mul(stride).into();
            let said = &mut root["bufferViews"][view]["extensions"][name];
            said["count"] = count.into();
            said["byteStride"] = stride.into();
            bytes.iter().for_each(|&b| said["byteLength"] = b.into());
            root["bufferViews"][0].as_object_mut().unwrap().remove("byteStride");
            error(&whole(&root, chunk))
        };
        let message = of(0, 1_000_000_000_000, 12, None, &chunk);
        assert!(
            message.contains(&format!("{length} bytes cannot hold 1000000000000 elements of 12 bytes")),
            "{message}"
        );
        let message = of(1, 999_999_999_999, 2, None, &chunk);
        assert!(message.contains("bytes cannot hold 999999999999 elements of 2 bytes"), "{message}");
        assert!(of(0, u64::MAX / 4, 4, None, &chunk).contains("bytes cannot hold 4611686018427387903 elements"));
        // With as many bytes as that takes, or said to take.
        let most = "with it more than the 1073741824 bytes that are unpacked of a file";
        assert!(of(0, 1_000_000_000_000, 12, Some(1 << 40), &chunk).contains(most));
        assert!(of(0, u64::MAX / 4, 4, Some(u64::MAX), &chunk).contains(most));
        chunk.resize((1 << 20) + (1 << 10), 0);
        let message = of(0, (1 << 28) + 256, 4, Some(chunk.len() as u64), &chunk);
        assert!(message.contains(most), "{message}");
        // Just as many as there may be, of bytes that hold none.
        let message = of(0, 1 << 18, 4, Some(1 << 20), &chunk);
        assert!(message.contains("its packed bytes end early or are damaged"), "{message}");
    }
}

#[test]
fn streams_cut_off_grown_and_of_other_versions() {
    for name in [EXT, KHR] {
        for (glb, views) in [(sound(name), 2), (packed(&pavilion(), name, true), 3), (packed(&scene(), name, false), 3)]
        {
            let (root, chunk) = parts(&glb);
            let all = root["bufferViews"].as_array().unwrap();
            for i in (0..all.len()).filter(|&i| all[i]["buffer"] == 1).take(views) {
                let said = &all[i]["extensions"][name];
                let number = |key: &str| said[key].as_u64().unwrap() as usize;
                let (at, length) = (number("byteOffset"), number("byteLength"));
                for n in 0..length {
                    let mut root = root.clone();
                    root["bufferViews"][i]["extensions"][name]["byteLength"] = n.into();
                    let message = error(&whole(&root, &chunk));
                    assert!(message.contains(&format!("buffer view {i}: {name}: ")), "{n} of {length}: {message}");
                }
                let mut changed = chunk.clone();
                changed.insert(at + length, 0);
                let mut grown = root.clone();
                grown["bufferViews"][i]["extensions"][name]["byteLength"] = (length + 1).into();
                assert!(error(&whole(&grown, &changed)).contains("end early or are damaged"));
                for (head, what) in [(chunk[at] | 15, "unsupported stream version"), (0, "its packed bytes end early")]
                {
                    let mut changed = chunk.clone();
                    changed[at] = head;
                    let message = error(&whole(&root, &changed));
                    assert!(message.contains(&format!("buffer view {i}: {name}: {what}")), "{message}");
                }
            }
        }
    }
}

/// Corners beyond the vertices are rejected one by one, as in any file; numbers wrap at two bytes, as the extension says.
#[test]
fn indices_beyond_the_vertices() {
    for (mode, stream) in [
        ("TRIANGLES", triangles(&[0, 1, 2, 0, 2, 9, 65_536, 1, 2])),
        ("INDICES", sequence(&[0, 1, 2, 0, 2, 9, 65_536, 1, 2])),
    ] {
        let (mesh, findings) = read_all(&[("a.glb", &square(EXT, mode, 9, &stream))]);
        assert_eq!(mesh.unwrap().triangles.len(), 2, "{mode}");
        assert_eq!(findings.facts["rejected_by_cause"], json!({"an index beyond the vertices": 1}));
        assert_eq!(findings.rejects[0].place, "a.glb:nodes[0], meshes[0].primitives[0], triangle 1");
    }
    // An edge of before the first triangle.
    let mut stream = triangles(&[0, 1, 2, 0, 2, 3]);
    stream[1] = 0x30;
    let message = error(&square(EXT, "TRIANGLES", 6, &stream));
    assert!(message.contains("2 rejected") && message.contains("an index beyond the vertices"), "{message}");
}

/// A direction of no length, which no filter makes.
#[test]
fn values_that_no_filter_made() {
    for (filter, stride) in [("OCTAHEDRAL", 4), ("OCTAHEDRAL", 8), ("COLOR", 4), ("COLOR", 8)] {
        let zeros = vec![0; 4 * stride];
        let (mut root, mut chunk) = parts(&sound(KHR));
        let stream = attributes(KHR, &zeros, stride);
        let (semantic, kind, component) = match (filter, stride) {
            ("COLOR", 4) => ("COLOR_0", "VEC4", 5121),
            ("COLOR", _) => ("COLOR_0", "VEC4", 5123),
            (_, 4) => ("NORMAL", "VEC3", 5120),
            _ => ("NORMAL", "VEC3", 5122),
        };
        let said = json!({"buffer": 0, "byteOffset": chunk.len(), "byteLength": stream.len(), "byteStride": stride,
            "count": 4, "mode": "ATTRIBUTES", "filter": filter});
        let view = json!({"buffer": 1, "byteLength": 4 * stride, "byteStride": stride, "extensions": {KHR: said}});
        root["bufferViews"].as_array_mut().unwrap().push(view);
        let accessor =
            json!({"bufferView": 2, "componentType": component, "count": 4, "type": kind, "normalized": true});
        root["accessors"].as_array_mut().unwrap().push(accessor);
        root["meshes"][0]["primitives"][0]["attributes"][semantic] = 2.into();
        chunk.extend(stream);
        let message = error(&whole(&root, &chunk));
        let wanted = format!("buffer view 2: {KHR}: values that {filter} cannot have made");
        assert!(message.contains(&wanted), "{filter}, {stride}: {message}");
    }
}

/// Streams and what is said of them, changed at random: a mesh or an error that says what is wrong.
#[test]
fn changed_streams_never_panic() {
    let mut random = Random::new("streams");
    let seeds: Vec<(&str, Vec<u8>)> = [EXT, KHR]
        .into_iter()
        .flat_map(|name| {
            let square = square(name, "INDICES", 6, &sequence(&[0, 1, 2, 0, 2, 3]));
            [
                (name, sound(name)),
                (name, square),
                (name, packed(&scene(), name, true)),
                (name, packed(&scene(), name, false)),
            ]
        })
        .collect();
    let cases = if is_long() { 400_000 } else { 4_000 };
    let (mut meshes, mut errors) = (0, 0);
    for _ in 0..cases {
        let (name, glb) = &seeds[random.below(seeds.len())];
        let (mut root, mut chunk) = parts(glb);
        let views: Vec<usize> = (0..root["bufferViews"].as_array().unwrap().len())
            .filter(|&i| root["bufferViews"][i]["buffer"] == 1)
            .collect();
        for _ in 0..=random.below(4) {
            let said = &mut root["bufferViews"][views[random.below(views.len())]]["extensions"][*name];
            let at = said["byteOffset"].as_u64().unwrap_or(0) as usize;
            let length = said["byteLength"].as_u64().unwrap_or(0) as usize;
            let numbers = [0, 1, 2, 3, 4, 5, 8, 12, 16, 24, 48, 255, 256, 65_536, 1 << 32, u64::MAX];
            let place = (at.saturating_add(random.below(length))).min(chunk.len() - 1);
            match random.below(12) {
                0 => said["count"] = numbers[random.below(numbers.len())].into(),
                1 => said["byteStride"] = numbers[random.below(numbers.len())].into(),
                2 => said["byteLength"] = (length as u64).wrapping_add(random.below(5) as u64).wrapping_sub(2).into(),
                3 => said["byteOffset"] = random.below(chunk.len() + 9).into(),
                4 => said["mode"] = ["ATTRIBUTES", "TRIANGLES", "INDICES"][random.below(3)].into(),
                5 => said["filter"] = ["OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"][random.below(4)].into(),
                6 => chunk[place] ^= 1 << random.below(8),
                7 => chunk[place] = 0xff,
                8 => drop(chunk.remove(place)),
                9 => chunk.insert(place, random.below(256) as u8),
                _ => chunk[place] = random.below(256) as u8,
            }
        }
        match read_all(&[("a.glb", &whole(&root, &chunk))]) {
            (Ok(mesh), _) => {
                meshes += 1;
                let n = mesh.positions.len();
                assert!(mesh.triangles.as_flattened().iter().all(|&c| (c as usize) < n));
                assert!(mesh.positions.as_flattened().iter().all(|v| v.abs() <= 1e30));
            }
            (Err(e), _) => {
                errors += 1;
                assert!(e.message.starts_with("`a.glb`: ") || e.code == "no-features", "{e}");
            }
        }
    }
    assert!(meshes > cases / 20 && errors > cases / 4, "{meshes} meshes, {errors} errors");
}
