//! What filters pack comes out within their rounding.

use meshoptimizer_rs::Workspace;
use meshoptimizer_rs::codec::{self, ExpMode};
use serde_json::{Value, json};

use super::support::Random;
use super::support::meshopt::{EXT, KHR, Packed, attributes, triangles};
use super::{read, read_all};

const N: usize = 200;

/// A fan over all vertices.
fn fan(glb: &mut Packed) -> usize {
    let corners: Vec<u32> = (1..N as u32 - 1).flat_map(|i| [0, i, i + 1]).collect();
    glb.view("TRIANGLES", None, corners.len(), 2, &triangles(&corners))
}

/// Places that are no line, on a grid of sixteenths.
fn places() -> Vec<f32> {
    (0..N).flat_map(|i| [(i % 17) as f32 / 16.0, (i / 17) as f32, (i * i % 31) as f32 / 4.0]).collect()
}

fn bytes(floats: &[f32]) -> Vec<u8> {
    floats.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// The fan with one more attribute, packed by a filter: (semantic, type, component type), filter, bytes an element.
fn with(name: &'static str, (semantic, kind, component): (&str, &str, u32), filter: &str, packed: &[u8]) -> Vec<u8> {
    let stride = packed.len() / N;
    let mut glb = Packed::new(name);
    let at = glb.view("ATTRIBUTES", None, N, 12, &attributes(name, &bytes(&places()), 12));
    let corners = fan(&mut glb);
    let more = glb.view("ATTRIBUTES", Some(filter), N, stride, &attributes(name, packed, stride));
    let float = |view: usize| json!({"bufferView": view, "componentType": 5126, "count": N, "type": "VEC3"});
    let mut of = float(at);
    of["bufferView"] = more.into();
    of["componentType"] = component.into();
    of["normalized"] = (component != 5126).into();
    of["type"] = kind.into();
    let indices = json!({"bufferView": corners, "componentType": 5123, "count": 3 * (N - 2), "type": "SCALAR"});
    glb.finish(json!({
        "accessors": [float(at), indices, of],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, semantic: 2}, "indices": 1}]}], "nodes": [{"mesh": 0}]}))
}

fn directions() -> Vec<[f32; 4]> {
    let mut random = Random::new("directions");
    let mut out = Vec::new();
    for i in 0..N {
        let v: [f64; 4] = match i {
            0..6 => [0, 1, 2, 3].map(|k| if k == i / 2 { 1.0 - 2.0 * (i % 2) as f64 } else { 0.0 }),
            _ => std::array::from_fn(|_| random.below(2001) as f64 / 1000.0 - 1.0),
        };
        out.push(v.map(|c| c as f32));
    }
    out
}

fn unit<const K: usize>(v: &[f32; 4]) -> [f64; K] {
    let v: [f64; K] = std::array::from_fn(|k| f64::from(v[k]));
    let length = v.iter().map(|c| c * c).sum::<f64>().sqrt();
    v.map(|c| c / length)
}

#[test]
fn normals_of_eight_and_of_sixteen_bits() {
    let all: Vec<[f64; 3]> = directions().iter().map(unit).collect();
    let flat: Vec<f32> = all.iter().flat_map(|n| [n[0], n[1], n[2], 0.0]).map(|c| c as f32).collect();
    for (stride, bits, component, most) in [(4, 8, 5120, 0.03), (8, 12, 5122, 2e-3), (8, 16, 5122, 2e-4)] {
        let packed = codec::encode_filter_oct(N, stride, bits, &flat, &mut Workspace::default()).unwrap();
        for name in [EXT, KHR] {
            let mesh = read(&with(name, ("NORMAL", "VEC3", component), "OCTAHEDRAL", &packed));
            assert_eq!(mesh.surface.normals.len(), N);
            for (n, [x, y, z]) in mesh.surface.normals.iter().zip(&all) {
                let off = (0..3).map(|k| (f64::from(n[k]) - [*x, 0.0 - z, *y][k]).abs()).fold(0.0, f64::max);
                assert!(off < most, "{bits} bits: {n:?}, wanted {x} {y} {z}");
            }
            // Axes are met.
            assert_eq!(mesh.surface.normals[..2], [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], "{bits} bits");
        }
    }
}

#[test]
fn colours_of_eight_and_of_sixteen_bits() {
    let mut random = Random::new("colours");
    let all: Vec<f32> = (0..4 * N).map(|_| random.below(1001) as f32 / 1000.0).collect();
    for (stride, bits, component, most) in [(4, 8, 5121, 0.011), (8, 12, 5123, 7e-4), (8, 16, 5123, 5e-5)] {
        let packed = codec::encode_filter_color(N, stride, bits, &all, &mut Workspace::default()).unwrap();
        let mesh = read(&with(KHR, ("COLOR_0", "VEC4", component), "COLOR", &packed));
        for (got, wanted) in mesh.surface.colours.as_flattened().iter().zip(&all) {
            assert!((got - wanted).abs() < most, "{bits} bits: {got}, wanted {wanted}");
        }
    }
}

#[test]
fn places_of_few_bits_and_of_all() {
    let wanted: Vec<[f64; 3]> =
        places().as_chunks().0.iter().map(|&[x, y, z]| [x, 0.0 - z, y].map(f64::from)).collect();
    let of = |bits: u32, mode: ExpMode, name: &'static str| {
        let packed = codec::encode_filter_exp(N, 12, bits, &places(), mode, &mut Workspace::default()).unwrap();
        read(&with(name, ("POSITION", "VEC3", 5126), "EXPONENTIAL", &packed)).positions
    };
    for name in [EXT, KHR] {
        // Sixteenths below 32 need nine bits and a sign.
        for mode in [ExpMode::Separate, ExpMode::SharedVector, ExpMode::SharedComponent] {
            assert_eq!(of(15, mode, name), wanted, "{mode:?}");
        }
        let rough = of(5, ExpMode::SharedVector, name);
        let off = rough.iter().zip(&wanted).flat_map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs())).fold(0.0, f64::max);
        assert!(off > 0.1 && off < 1.1, "{off}");
    }
}

/// Exponents out of range: what is infinite or no number is rejected as in any file, and has one way of being none.
#[test]
fn exponents_out_of_range() {
    let word = |exponent: i8, mantissa: i32| (i32::from(exponent) << 24 | (mantissa & 0xff_ffff)).to_le_bytes();
    let mut packed: Vec<u8> = [word(-4, 16), word(0, 3), word(2, -5)].concat().repeat(N);
    packed[36..48].copy_from_slice(&[word(-128, 0), word(0, 0), word(0, 0)].concat());
    packed[72..84].copy_from_slice(&[word(127, 0x7f_ffff), word(0, 0), word(0, 0)].concat());
    for name in [EXT, KHR] {
        let (mesh, findings) = read_all(&[("a.glb", &with(name, ("POSITION", "VEC3", 5126), "EXPONENTIAL", &packed))]);
        assert_eq!(mesh.unwrap().positions[1], [1.0, 20.0, 3.0]);
        assert_eq!(findings.facts["rejected_by_cause"], json!({"a corner that is no finite number": 4}));
    }
    let pairs: Vec<u8> = [word(-128, 0), word(-1, 1)].concat().repeat(N);
    let glb = with(EXT, ("TEXCOORD_0", "VEC2", 5126), "EXPONENTIAL", &pairs);
    let (mut root, chunk) = super::parts(&glb);
    root["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
    root["textures"] = json!([{"source": 0}]);
    root["images"] = json!([{"uri": "data:;base64,iVBORw0KGgo="}]);
    root["meshes"][0]["primitives"][0]["material"] = 0.into();
    let mesh = read(&super::whole(&root, &chunk));
    assert!(mesh.surface.uvs.iter().all(|uv| uv.map(f32::to_bits) == [0x7fc0_0000; 2]), "{:?}", mesh.surface.uvs[0]);
}

/// Turned copies, whose quaternions are packed.
#[test]
fn turns_of_sixteen_bits() {
    let copies: Vec<[f64; 4]> = directions().iter().map(unit).collect();
    let flat: Vec<f32> = copies.iter().flatten().map(|c| *c as f32).collect();
    let accessor = |view: usize, component: u32, count: usize, kind: &str| json!({"bufferView": view, "componentType": component, "count": count, "type": kind, "normalized": component == 5122});
    let of = |packed: Option<(&'static str, u32)>| {
        let name = packed.map_or(EXT, |p| p.0);
        let mut glb = Packed::new(name);
        let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0];
        let at = glb.view("ATTRIBUTES", None, 3, 12, &attributes(name, &bytes(&corners), 12));
        let (view, component) = match packed {
            None => (glb.plain(&bytes(&flat)), 5126),
            Some((_, bits)) => {
                let packed = codec::encode_filter_quat(N, 8, bits, &flat, &mut Workspace::default()).unwrap();
                (glb.view("ATTRIBUTES", Some("QUATERNION"), N, 8, &attributes(name, &packed, 8)), 5122)
            }
        };
        let copies: Value = json!({"EXT_mesh_gpu_instancing": {"attributes": {"ROTATION": 1}}});
        read(&glb.finish(json!({
            "accessors": [accessor(at, 5126, 3, "VEC3"), accessor(view, component, N, "VEC4")],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "nodes": [{"mesh": 0, "extensions": copies}]})))
    };
    let wanted = of(None);
    assert_eq!((wanted.triangles.len(), wanted.feature_ids.len()), (N, N));
    for (name, bits, most) in [(EXT, 16, 4e-4), (KHR, 16, 4e-4), (EXT, 10, 0.02)] {
        let got = of(Some((name, bits)));
        for (a, b) in got.positions.iter().zip(&wanted.positions) {
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < most), "{bits} bits: {a:?}, wanted {b:?}");
        }
    }
}
