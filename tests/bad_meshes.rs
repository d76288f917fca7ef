//! From a mesh to an impostor's GLB on meshes that are hardly any, and `read-mesh` on bytes that are hardly a file: a
//! clear error or a right result, in bounded time, never a panic.

mod support;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

use lodge::artifact::{AnyArtifact, Impostors, Mesh, PlaneTiles};
use lodge::diag::{Findings, Result};
use lodge::io::views;
use lodge::op::{Bench, Source};
use lodge::ops::ALL;
use proptest::prelude::*;
use proptest::sample::Index;
use serde_json::{Value, json};

use support::meshopt::{self, packed};
use support::scene::{Glb, picture, scene};
use support::{Place, gzip, node};

type Any = Arc<dyn AnyArtifact>;

fn operator(name: &str, params: Value, files: &[(&str, &[u8])], inputs: &[(&str, &Any)]) -> (Result<Any>, Findings) {
    let entry = ALL.get(name).unwrap();
    let mut bench = Bench::default();
    for (i, (name, bytes)) in files.iter().enumerate() {
        bench.sources.push(Source { beside: i > 0, ..Source::of_bytes(name, bytes.to_vec()) });
    }
    let of = |port: &str| inputs.iter().filter(|(p, _)| *p == port).map(|(_, a)| (*a).clone()).collect();
    let op = (entry.build)(params).unwrap();
    let out = op.run(&bench.ctx(), entry.ports.iter().map(|p| of(p.name)).collect());
    (out, bench.report.finish())
}

/// Reads the first file, beside which the others lie; where that succeeds the account is complete.
fn read(files: &[(&str, &[u8])]) -> Result<Any> {
    let (out, f) = operator("read-mesh", json!({"path": files[0].0, "max-rejected": 1.0}), files, &[]);
    if out.is_ok() {
        let [read, accepted, rejected, filtered] =
            ["read", "accepted", "rejected", "filtered"].map(|k| f.facts[k].as_u64().unwrap());
        assert_eq!(read, accepted + rejected + filtered);
        assert_eq!(f.rejects.len() as u64, rejected.min(10_000));
    }
    out
}

/// From a mesh to its GLB; an error says whose it is.
fn impostor(mesh: &Any, resolution: u32, fill: &str) -> Result<Arc<Impostors>, String> {
    let step = |name: &str, params: Value, inputs: &[(&str, &Any)]| {
        operator(name, params, &[], inputs).0.map_err(|e| format!("{name}: {e}"))
    };
    let voxels = step("voxelize", json!({"resolution": resolution, "fill": fill}), &[("mesh", mesh)])?;
    let tiles = step("vote-tile", json!({}), &[("voxels", &voxels)])?;
    let quads = step("bake-impostor", json!({}), &[("mesh", mesh), ("tiles", &tiles)])?;
    step("write-glb", json!({"path": "a.glb"}), &[("model", &quads)])?;
    Ok(lodge::op::cast(quads))
}

// ------------------------------------------------------------------------------------------------ hardly a mesh

fn obj(vertices: &[[f64; 3]], faces: &[&[usize]]) -> String {
    let mut out = String::new();
    vertices.iter().for_each(|[x, y, z]| out += &format!("v {x:e} {y:e} {z:e}\n"));
    let face = |f: &[usize]| f.iter().map(|i| format!(" {}", i + 1)).collect::<String>();
    faces.iter().for_each(|f| out += &format!("f{}\n", face(f)));
    out
}

const SQUARE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
const BOX: [&[usize]; 6] = [&[0, 4, 6, 2], &[1, 3, 7, 5], &[0, 1, 5, 4], &[2, 6, 7, 3], &[0, 2, 3, 1], &[4, 5, 7, 6]];

/// A box of this size, one corner there.
fn brick(size: [f64; 3], at: [f64; 3]) -> String {
    let corner = |i: usize| [0, 1, 2].map(|k| at[k] + if i >> k & 1 == 1 { size[k] } else { 0.0 });
    obj(&(0..8).map(corner).collect::<Vec<_>>(), &BOX)
}

#[test]
fn meshes_that_are_hardly_any() {
    let one = obj(&SQUARE[..3], &[&[0, 1, 2]]);
    let plate = obj(&SQUARE, &[&[0, 1, 2, 3]]);
    let tilted: Vec<[f64; 3]> = (0..8)
        .map(|i| {
            let t = if i & 1 == 1 { 1e5 } else { 0.0 };
            [t * 0.6, t * 0.64 + f64::from(i >> 1 & 1), t * 0.48 + f64::from(i >> 2 & 1)]
        })
        .collect();
    let turned = |of: &&[usize]| of.iter().rev().copied().collect::<Vec<_>>();
    let inside_out: Vec<Vec<usize>> = BOX.iter().map(turned).collect();
    let inside_out = brick([1.0; 3], [0.0; 3]).lines().take(8).map(|l| format!("{l}\n")).collect::<String>()
        + &obj(&[], &inside_out.iter().map(|f| &f[..]).collect::<Vec<_>>());
    let no_tiles = Err("bake-impostor: there are no tiles to draw on (fewer `min-votes`");
    // Quads, at most twice as many, silhouette and share of the surface at least; or what is said.
    for (name, text, resolution, expected) in [
        ("nothing", String::from("v 0 0 0\n"), 16, Err("no triangles in the input: 0 read, 0 filtered, 0 rejected")),
        ("one triangle", one.clone(), 2, no_tiles),
        // Two planes, tilted; slivers of one close the slanted edge of the other.
        ("one triangle", one, 32, Ok((2, 0.6, 0.98))),
        // Their ends lie more than half a cell off it: of those the outermost pixels, 0.8 %, are cut off.
        ("a plate", plate, 32, Ok((1, 0.69, 0.99))),
        ("a point", obj(&[[1.0, 2.0, 3.0]; 3], &[&[0, 1, 2]]), 64, no_tiles),
        ("a line", obj(&[[0.0; 3], [1.0; 3], [2.0; 3]], &[&[0, 1, 2]]), 64, no_tiles),
        ("a bar", brick([1e5, 1.0, 1.0], [0.0; 3]), 64, no_tiles),
        ("a bar far away", brick([1e5, 1.0, 1.0], [1e9; 3]), 64, no_tiles),
        ("a tilted bar", obj(&tilted, &BOX), 64, no_tiles),
        ("a box inside out", inside_out, 16, Ok((6, 0.99, 0.99))),
        ("a box of 10^30 m", brick([1e30; 3], [0.0; 3]), 16, Ok((6, 0.99, 0.99))),
        ("a box of 10^-30 m", brick([1e-30; 3], [0.0; 3]), 16, Ok((6, 0.99, 0.99))),
        ("a box of 10^31 m", brick([1e31; 3], [0.0; 3]), 16, Err("12 rejected; the first: `triangle 0` (a.obj:9)")),
        ("a box of 10^-160 m", brick([1e-160; 3], [0.0; 3]), 16, Err("bake-impostor: no tile draws as much as four")),
        ("a box of nothing", brick([5e-324; 3], [0.0; 3]), 16, Err("voxelize: cells of 0 m are too small")),
        ("a box 10^15 m away", brick([1.0; 3], [1e15; 3]), 16, Err("voxelize: cells of 0.0625 m cannot be told apart")),
        ("a box 10^9 m away", brick([1.0; 3], [1e9; 3]), 16, Ok((6, 0.99, 0.99))),
    ] {
        let mesh = read(&[("a.obj", text.as_bytes())]).map_err(|e| e.to_string());
        // What is drawn is measured at length: once is enough.
        let fills = if expected.is_ok() { &["winding"][..] } else { &["winding", "parity", "flood"] };
        for &fill in fills {
            match (mesh.clone().and_then(|mesh| impostor(&mesh, resolution, fill)), expected) {
                (Err(e), Err(said)) => assert!(e.contains(said), "{name}, {fill}: {e}"),
                (Ok(out), Ok((quads, silhouette, drawn))) => {
                    assert!(out.len() >= quads && out.len() <= 2 * quads, "{name}, {fill}: {} quads", out.len());
                    let worth = &out.worth;
                    assert!(worth.silhouette > silhouette && worth.drawn > drawn, "{name}, {fill}: {worth:?}");
                }
                (got, _) => panic!("{name}, {fill}: {:?}", got.map(|q| (q.len(), q.worth))),
            }
        }
    }
}

/// Nodes half a cell outside are black there: one white layer is left around them.
#[test]
fn surfaces_to_the_edge() {
    let mesh = read(&[("a.obj", brick([1.0; 3], [0.0; 3]).as_bytes())]).unwrap();
    for resolution in [1, 2, 3, 16, 33] {
        let how = json!({"resolution": resolution, "fill": "surface"});
        let voxels = operator("voxelize", how, &[], &[("mesh", &mesh)]).0.unwrap();
        let tiles = operator("vote-tile", json!({"min-votes": 1}), &[], &[("voxels", &voxels)]).0.unwrap();
        let tiles = lodge::op::cast::<PlaneTiles>(tiles).len();
        assert!(resolution < 3 || tiles >= 6, "{resolution}: {tiles}");
    }
}

/// A million triangles at one place: read, put on a grid, searched.
#[test]
fn a_million_at_one_place() {
    let text = obj(&SQUARE[..3], &[]) + &"f 1 2 3\n".repeat(1_000_000);
    let mesh = read(&[("a.obj", text.as_bytes())]).unwrap();
    for fill in ["winding", "parity", "flood"] {
        let how = json!({"resolution": 32, "fill": fill});
        let voxels = operator("voxelize", how, &[], &[("mesh", &mesh)]).0.unwrap();
        let tiles = operator("vote-tile", json!({}), &[], &[("voxels", &voxels)]).0.unwrap();
        let tiles = lodge::op::cast::<PlaneTiles>(tiles).len();
        assert!((1..=2).contains(&tiles), "{fill}: {tiles}");
    }
}

/// A plate with a picture.
fn painted(png: &[u8]) -> Result<Any> {
    let text = format!("mtllib a.mtl\nvt 0 0\nvt 1 0\nvt 1 1\nusemtl m\n{}f 1/1 2/2 3/3\n", obj(&SQUARE[..3], &[]));
    read(&[("a.obj", text.as_bytes()), ("a.mtl", b"newmtl m\nmap_Kd a.png\n"), ("a.png", png)])
}

#[test]
fn pictures_that_are_hardly_any() {
    let header = |width, height| {
        let mut out = Vec::new();
        // A few bytes of what would be millions.
        let mut writer = png::Encoder::new(&mut out, width, height).write_header().unwrap();
        writer.write_chunk(png::chunk::IDAT, &[0x78, 0x9c, 0x63, 0]).unwrap();
        drop(writer);
        out
    };
    let cut = picture();
    for (bytes, said) in [
        (header(60_000, 60_000), "image 0 has 3600000000 texels, more than the 134217728 that are read"),
        (header(u32::MAX >> 1, u32::MAX >> 1), "image 0 "),
        (header(4, 4), "image 0 is damaged: "),
        (cut[..cut.len() / 2].to_vec(), "image 0 is damaged: "),
    ] {
        let mesh = painted(&bytes).unwrap();
        let e = impostor(&mesh, 32, "winding").unwrap_err();
        assert!(e.starts_with(&format!("bake-impostor: {said}")), "{said}: {e}");
        let e = views::sheet(&lodge::op::cast::<Mesh>(mesh)).unwrap_err();
        assert!(e.message.starts_with(said), "{said}: {e}");
    }
    assert!(impostor(&painted(&cut).unwrap(), 32, "winding").is_ok());
}

#[test]
fn whole_runs() {
    let place = Place::new();
    place.write(
        "p.toml",
        "[params]\nmesh = 'plate.obj'\nresolution = 32\n\
         [node.mesh]\nop = 'read-mesh'\npath = '${mesh}'\n\
         [node.voxels]\nop = 'voxelize'\nin.mesh = 'mesh'\nresolution = '${resolution}'\n\
         [node.tiles]\nop = 'vote-tile'\nin.voxels = 'voxels'\n\
         [node.impostor]\nop = 'bake-impostor'\nin = { mesh = 'mesh', tiles = 'tiles' }\n\
         [node.glb]\nop = 'write-glb'\nin.model = 'impostor'\npath = 'a.glb'\n",
    );
    place.write("plate.obj", obj(&SQUARE, &[&[0, 1, 2, 3]]));
    place.write("empty.obj", "");
    place.write("nothing.stl", "solid\nendsolid\n");
    let mut glb = Glb::default();
    let at = glb.floats(&[&[0.0, 0.0, 0.0], &[1.0, 0.0, 0.0], &[0.0, 1.0, 0.0]], None);
    let root = json!({"meshes": [{"primitives": [{"attributes": {"POSITION": at}}]}], "nodes": [{"mesh": 0}]});
    let mut outside = glb.finish(root);
    let json_end = 20 + u32::from_le_bytes(outside[12..16].try_into().unwrap()) as usize;
    let text = String::from_utf8(outside[20..json_end].to_vec()).unwrap();
    let text = text.replace("\"byteLength\":36}]", "\"byteLength\":36,\"uri\":\"../secret.bin\"}]");
    assert!(text.contains("secret"));
    outside = text.into_bytes();
    place.write("in/outside.gltf", outside);
    place.write("secret.bin", [0; 36]);
    let run = |sets: &[&str]| {
        let mut args = vec!["--json", "run", "p.toml"];
        sets.iter().for_each(|s| args.extend(["--set", s]));
        let done = place.lodge(&args);
        let (out, err) = [&done.stdout, &done.stderr].map(|b| String::from_utf8_lossy(b).into_owned()).into();
        assert!(!err.contains("panicked"), "{err}");
        (done.status.code().unwrap(), out, err)
    };
    let (code, out, _) = run(&[]);
    assert_eq!(code, 0, "{out}");
    assert_eq!(node(&serde_json::from_str(&out).unwrap(), "impostor")["status"], "ran");
    for (sets, said) in [
        (&["resolution=1"][..], "must be at least 2 cells, got 1 cells"),
        (&["resolution=4096"], "must be at most 1024 cells, got 4096 cells"),
        (&["resolution=0"], "must be at least 2 cells, got 0 cells"),
        (&["mesh='gone.obj'"], "gone.obj"),
        (&["mesh='empty.obj'"], "`empty.obj`: the file is empty"),
        (&["mesh='nothing.stl'"], "no triangles in the input: 0 read, 0 filtered, 0 rejected"),
        (&["mesh='in/outside.gltf'"], "`../secret.bin`, which it names, lies outside the file's folder"),
        (&["mesh='p.toml'"], "this is no mesh, or it ends early (known are glTF, GLB, OBJ, PLY and STL)"),
    ] {
        let (code, out, err) = run(sets);
        assert!(code != 0 && (out.contains(said) || err.contains(said)), "{sets:?}: {code} {out} {err}");
    }
}

// ------------------------------------------------------------------------------------------- bytes that are hardly

/// Files that are right: name, bytes, what lies beside.
fn seeds() -> Vec<(&'static str, Vec<u8>, Vec<(&'static str, Vec<u8>)>)> {
    let painted = format!(
        "mtllib a.mtl\n{}vt 0 0\nvt 1 0\nvn 0 0 1\no a\nusemtl m\nf 1/1/1 2/2/1 3/1/1 4/2/1\ng b\nusemtl n\nf -4//1 -2//1 -1//1\nl 1 2\n",
        obj(&SQUARE, &[])
    );
    let library = b"newmtl m\nKd 0.5 1 1\nmap_Kd -clamp on a.png\nnewmtl n\nd 0.5\n".to_vec();
    let beside = vec![("a.mtl", library), ("a.png", picture())];
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment TextureFile a.png\nelement vertex 4\nproperty float x\nproperty float y\n\
             property double z\nproperty uchar red\nproperty float s\nproperty float t\nelement face 2\n\
             property list uchar int vertex_indices\nelement tristrips 1\nproperty list int short vertex_index\nend_header\n"
        )
    };
    let mut plies = [head("ascii"), head("binary_little_endian"), head("binary_big_endian")].map(String::into_bytes);
    for [x, y, z] in SQUARE {
        plies[0].extend(format!("{x} {y} {z} 200 {x} {y}\n").into_bytes());
        let [f, g] = [x, y].map(|v| v as f32);
        plies[1].extend(
            [&f.to_le_bytes()[..], &g.to_le_bytes(), &z.to_le_bytes(), &[200], &f.to_le_bytes(), &g.to_le_bytes()]
                .concat(),
        );
        plies[2].extend(
            [&f.to_be_bytes()[..], &g.to_be_bytes(), &z.to_be_bytes(), &[200], &f.to_be_bytes(), &g.to_be_bytes()]
                .concat(),
        );
    }
    plies[0].extend(b"3 0 1 2\n4 0 1 2 3\n5 0 1 2 -1 3\n");
    for (ply, big) in [(1, false), (2, true)] {
        let four = |v: i32| if big { v.to_be_bytes() } else { v.to_le_bytes() };
        let two = |v: i16| if big { v.to_be_bytes() } else { v.to_le_bytes() };
        let out = &mut plies[ply];
        for face in [&[0, 1, 2][..], &[0, 1, 2, 3]] {
            out.push(face.len() as u8);
            face.iter().for_each(|&v| out.extend(four(v)));
        }
        out.extend(four(5));
        [0, 1, 2, -1, 3].iter().for_each(|&v| out.extend(two(v)));
    }
    let mut stl = vec![b' '; 80];
    stl.extend(2u32.to_le_bytes());
    for corners in [[0, 1, 2], [0, 2, 3]] {
        stl.extend([0; 12]);
        corners.iter().for_each(|&c: &usize| stl.extend(SQUARE[c].iter().flat_map(|v| (*v as f32).to_le_bytes())));
        stl.extend([0; 2]);
    }
    let facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    let mut out = vec![
        ("a.glb", scene(), vec![]),
        ("a.glb", bent(), vec![]),
        ("a.glb", packed(&scene(), meshopt::EXT, true), vec![]),
        ("a.glb", packed(&bent(), meshopt::KHR, false), vec![]),
        ("a.obj", painted.into_bytes(), beside),
        ("a.stl", stl, vec![]),
        ("a.stl", format!("solid a\n{facet}endsolid a\nsolid b\n{facet}endsolid\n").into_bytes(), vec![]),
    ];
    out.extend(plies.map(|bytes| ("a.ply", bytes, vec![("a.png", picture())])));
    out
}

/// A skin, a sparse accessor, morph targets, one node in another; small numbers.
fn bent() -> Vec<u8> {
    let mut glb = Glb::default();
    let at = glb.floats(&[&[0.0, 0.0, 0.0], &[1.0, 0.0, 0.0], &[0.0, 1.0, 0.0]], None);
    let weights = glb.floats(&[&[1.0, 0.0, 0.0, 0.0][..]; 3], None);
    let binds =
        glb.floats(&[&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0][..]; 2], None);
    glb.accessors[binds]["type"] = "MAT4".into();
    let indices = glb.indices(&[2, 1, 0]);
    let joints = glb.view(&[0, 1, 0, 0, 1, 0, 0, 0, 1, 1, 0, 0], None);
    glb.accessors.push(json!({"bufferView": joints, "componentType": 5121, "count": 3, "type": "VEC4"}));
    let joints = glb.accessors.len() - 1;
    let sparse = json!({"count": 2, "indices": {"bufferView": glb.accessors[indices]["bufferView"], "byteOffset": 2, "componentType": 5123},
        "values": {"bufferView": glb.accessors[at]["bufferView"]}});
    glb.accessors[at]["sparse"] = sparse;
    let primitive = json!({"attributes": {"POSITION": at, "WEIGHTS_0": weights, "JOINTS_0": joints}, "indices": indices,
        "targets": [{"POSITION": at}]});
    glb.finish(json!({
        "nodes": [{"mesh": 0, "skin": 0}, {"children": [2], "translation": [1, 2, 3]}, {"scale": [1, 2, 1]}],
        "meshes": [{"primitives": [primitive], "weights": [0.5]}],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": binds}],
    }))
}

/// One change: bytes replaced, a word, a number of the text, a piece taken out or doubled, all from there on cut off.
#[derive(Clone, Debug)]
enum Change {
    Byte(u8),
    Word(u32),
    Number(&'static str),
    Remove(usize),
    Double(usize),
    Cut,
}

fn change() -> impl Strategy<Value = Change> {
    let byte = prop_oneof![prop::sample::select(b"0123456789.-+e[]{}\",:/ \n\xff\0".to_vec()), any::<u8>()];
    let words =
        vec![0, 1, 3, 255, 65_535, 1 << 20, i32::MAX as u32, 1 << 31, u32::MAX, 0x7fc0_0000, 0x7f80_0000, 0x7149_f2ca];
    let numbers = vec![
        "0",
        "1",
        "2",
        "7",
        "-1",
        "3.5",
        "255",
        "65536",
        "4294967295",
        "4294967296",
        "18446744073709551615",
        "1e9",
        "1e30",
        "1e300",
        "-1e-300",
        "1000000000000",
        "null",
        "nan",
        "[]",
        "{}",
        "\"\"",
        "true",
        "99999999999999999999999",
    ];
    prop_oneof![
        4 => byte.prop_map(Change::Byte),
        4 => prop::sample::select(words).prop_map(Change::Word),
        8 => prop::sample::select(numbers).prop_map(Change::Number),
        2 => (1..40usize).prop_map(Change::Remove),
        2 => (1..200usize).prop_map(Change::Double),
        1 => Just(Change::Cut),
    ]
}

fn changed(bytes: &[u8], changes: &[(Index, Change)]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for (at, change) in changes {
        if out.is_empty() {
            break;
        }
        let at = at.index(out.len());
        let end = |n: usize| (at + n).min(out.len());
        match change {
            Change::Byte(b) => out[at] = *b,
            Change::Word(w) => w.to_le_bytes().iter().zip(&mut out[at..]).for_each(|(b, o)| *o = *b),
            Change::Number(n) => {
                // The text of a GLB may grow or shrink: its lengths are put right again.
                let of_glb = out.starts_with(b"glTF") && out.len() >= 20;
                let text = of_glb.then(|| 20 + u32::from_le_bytes(out[12..16].try_into().unwrap()) as usize);
                let text = text.filter(|&end| end <= out.len());
                let (first, limit) = (if text.is_some() { 20 } else { 0 }, text.unwrap_or(out.len()));
                let is = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'-');
                let at = first + at % (limit - first).max(1);
                let Some(from) = out[at.min(limit)..limit].iter().position(is).map(|i| at + i) else { continue };
                let length = out[from..limit].iter().take_while(|b| is(b)).count();
                out.splice(from..from + length, n.bytes());
                if let Some(end) = text {
                    let end = end - length + n.len();
                    let fill = (4 - end % 4) % 4;
                    out.splice(end..end, std::iter::repeat_n(b' ', fill));
                    let (all, own) = (out.len() as u32, (end + fill - 20) as u32);
                    out[8..12].copy_from_slice(&all.to_le_bytes());
                    out[12..16].copy_from_slice(&own.to_le_bytes());
                }
            }
            Change::Remove(n) => drop(out.drain(at..end(*n))),
            Change::Double(n) => {
                let piece = out[at..end(*n)].to_vec();
                out.splice(at..at, piece);
            }
            Change::Cut => out.truncate(at),
        }
    }
    out
}

/// What every user of a mesh trusts in.
fn sound(mesh: &Mesh) {
    let n = mesh.positions.len();
    assert!(
        mesh.triangles
            .iter()
            .flatten()
            .all(|&v| (v as usize) < n && mesh.positions[v as usize].iter().all(|c| c.abs() <= 1e30))
    );
    assert!(mesh.features.len() == n && mesh.features.iter().all(|&f| (f as usize) < mesh.feature_ids.iter().count()));
    let mut next = 0;
    for p in &mesh.primitives {
        assert!(p.first_triangle == next && p.material.is_none_or(|m| (m as usize) < mesh.surface.materials.len()));
        next += p.triangles;
    }
    assert_eq!(next as usize, mesh.triangles.len());
    let look = &mesh.surface;
    assert!([look.normals.len(), look.uvs.len(), look.colours.len()].iter().all(|&l| l == 0 || l == n));
    assert!(look.materials.iter().all(|m| m.texture.is_none_or(|t| (t.image as usize) < look.images.len())));
}

fn few() -> ProptestConfig {
    let mut config = ProptestConfig { failure_persistence: None, ..ProptestConfig::default() };
    if std::env::var_os("PROPTEST_CASES").is_none() {
        config.cases = 60;
    }
    if std::env::var_os("PROPTEST_RNG_SEED").is_none() {
        config.rng_seed = proptest::test_runner::RngSeed::Fixed(7);
    }
    config
}

/// Meshes that were baked.
static BAKED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());

proptest! {
    // The same few cases each time; PROPTEST_CASES and PROPTEST_RNG_SEED ask for more and others.
    #![proptest_config(few())]

    #[test]
    fn changed_meshes_never_panic(
        changes in prop::collection::vec((any::<Index>(), change()), 1..5),
        beside in prop::collection::vec((any::<Index>(), change()), 0..3),
        packed in any::<bool>(),
    ) {
        for (name, bytes, more) in seeds() {
            let bytes = changed(&bytes, &changes);
            let bytes = if packed { gzip(&bytes) } else { bytes };
            let more: Vec<_> = more.iter().map(|(n, b)| (*n, changed(b, &beside))).collect();
            let mut files = vec![(name, &bytes[..])];
            files.extend(more.iter().map(|(n, b)| (*n, &b[..])));
            let listed = (ALL.get("read-mesh").unwrap().beside)(&Source::of_bytes(name, bytes.clone()));
            prop_assert!(listed.iter().all(|n| n.split(['/', '\\']).all(|part| part != "..") && !n.starts_with('/')), "{listed:?}");
            let Ok(out) = read(&files) else { continue };
            let mesh: Arc<Mesh> = lodge::op::cast(out.clone());
            sound(&mesh);
            if mesh.triangles.len() > 1000 || changes.len() > 1 {
                continue;
            }
            let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
            for p in &mesh.positions {
                (0..3).for_each(|k| (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k])));
            }
            let side = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
            // Many changes change nothing that is drawn; to bake takes more than all else.
            let is_new = BAKED.lock().unwrap().insert(format!("{mesh:?}"));
            if is_new && (0..3).all(|k| low[k].abs() < 1e9 * side) {
                let _ = impostor(&out, 8, "winding");
            }
        }
    }
}
