//! Read a mesh from glTF, GLB, OBJ, PLY or STL.
//!
//! In:     one file, plain or gzipped; its bytes say what it is. Files beside it that it names are read as well:
//!         buffers, material libraries, pictures of base colours. glTF may be packed by meshopt, as gltfpack does it
//!         (EXT_meshopt_compression, KHR_meshopt_compression); where it has a plain copy beside, that is taken.
//! Out:    triangles, z up, in the file's unit (metres, one hopes), around its own origin; base colours, pictures as they
//!         came, colours and normals of vertices. A feature is a node of glTF, an object or group of OBJ, a solid of STL.
//!         Polygons are cut into triangles; points and lines are filtered, and triangles that are there 16 times already, to
//!         the last bit (material, corners, their order). Vertices of no triangle are left out, equal corners of STL become one. Skinned meshes stand as their joints do, morphed ones have no weights.
//! Errors: a file that is none of these, ends early, or contradicts itself; Draco and KTX2, with a remedy; more than
//!         2^26 vertices or corners, 2^32 bytes, or 2^30 unpacked by meshopt; no triangle left, too many rejects. Triangles with an index
//!         beyond the vertices, or a corner that is no finite number or beyond 10^30, are rejected and counted; the first
//!         10,000 are listed. A library or picture that is not there is told, and what it paints is white. Files outside
//!         the file's folder are not read: who made the file must not choose among the reader's.
//! Facts:  read, accepted, rejected, filtered: triangles (of what is filtered whole points, lines or primitives);
//!         filtered_by_type, rejected_by_cause, repaired_by_cause.
//! Cost:   O(n log n); the file and the mesh in memory.
//! Source: glTF 2.0; Wavefront's OBJ and MTL; Turk's PLY; 3D Systems' STL.

use std::io::BufReader;

use serde::{Deserialize, Serialize};

use crate::artifact::Mesh;
use crate::diag::{Diagnostic, Result};
use crate::io::ledger::{self, Ledger, Needed};
use crate::io::mesh::{self, Files, Up};
use crate::io::reader::{account, is_packed};
use crate::io::stream::{at_most, unpacked};
use crate::op::{Ctx, Op, Source};

/// Which way is up in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Upward {
    Y,
    Z,
}

crate::params! {
    /// A mesh from a file of one of the common formats.
    pub struct ReadMesh {
        /// The file: .gltf, .glb, .obj, .ply or .stl; `.gz` of any.
        #[schemars(extend("x-file" = true, "x-required" = true))]
        pub path: String = String::new(),
        /// Which way is up in the file: `y` if not said in OBJ, `z` in PLY and STL. glTF is always y up.
        pub up: Option<Upward> = None,
        /// Largest share of triangles that may be rejected.
        #[schemars(range(min = 0.0, max = 1.0))]
        pub max_rejected: f64 = 0.5,
    }
}

crate::inputs! {}

impl Op for ReadMesh {
    const NAME: &'static str = "read-mesh";
    const VERSION: u32 = 3;
    type In = In;
    type Out = Mesh;
    const FACTS: &'static [(&'static str, &'static str)] = &FACTS;

    fn beside(source: &Source) -> Vec<String> {
        let Ok(read) = (source.open)().and_then(unpacked) else { return Vec::new() };
        let name = source.name.strip_suffix(".gz").unwrap_or(&source.name);
        mesh::beside(name, &mut BufReader::new(read))
    }

    fn run(&self, ctx: &Ctx, _: In) -> Result<Mesh> {
        account(ctx.report, "triangles", Needed::One { max_rejected: self.max_rejected }, |ledger| {
            read_mesh(self, ctx, ledger)
        })
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (1 << 20) + if is_packed(&self.path) { 12 * input_bytes } else { 5 * input_bytes }
    }
}

const FACTS: [(&str, &str); 6] = {
    let mut all = ledger::facts::<1, 7>([ledger::BY_TYPE]);
    all[0].1 = "triangles in the file, and primitives of other kinds: accepted + rejected + filtered";
    all[1].1 = "triangles in the result";
    all[2].1 = "triangles left out because something is wrong with them; listed with place and cause";
    all[3].1 = "points, lines, or primitives of them; triangles that are there 16 times already";
    all[4].1 = "rejected triangles of each cause";
    // No rule repairs.
    [all[0], all[1], all[2], all[3], all[4], all[6]]
};

pub fn read_mesh(how: &ReadMesh, ctx: &Ctx, ledger: &mut Ledger) -> Result<Mesh> {
    let mut main = ctx.sources.iter().filter(|s| !s.beside);
    let (Some(source), None) = (main.next(), main.next()) else {
        let count = ctx.sources.iter().filter(|s| !s.beside).count();
        return Err(Diagnostic::error("bad-mesh", format!("one file is read at a time, got {count}")).value(&how.path));
    };
    let read = |source: &Source| {
        let unread = |e| Diagnostic::error("unreadable-file", format!("cannot read `{}`: {e}", source.name));
        at_most(&source.name, (source.open)().map_err(unread)?, mesh::MOST_BYTES)
    };
    let bytes = read(source)?;
    ctx.check()?;
    let beside = |name: &str| ctx.sources.iter().find(|s| s.beside && s.name == name).map(read);
    let files =
        Files { name: &source.name, bytes: &bytes, beside: &beside, warn: &|sentence| ctx.report.warn(sentence) };
    let up = how.up.map(|up| match up {
        Upward::Y => Up::Y,
        Upward::Z => Up::Z,
    });
    mesh::read(&files, up, ledger)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use serde_json::{Value, json};

    use super::*;
    use crate::artifact::mesh::Alpha;
    use crate::diag::Findings;
    use crate::op::Bench;

    fn read_all(params: &str, files: &[(&str, &[u8])]) -> (Result<Mesh>, Findings) {
        let mut bench = Bench::default();
        for (i, (name, bytes)) in files.iter().enumerate() {
            bench.sources.push(Source { beside: i > 0, ..Source::of_bytes(name, bytes.to_vec()) });
        }
        let op: ReadMesh = toml::from_str(params).unwrap();
        let out = op.run(&bench.ctx(), In {});
        (out, bench.report.finish())
    }

    fn read(name: &str, bytes: &[u8]) -> (Result<Mesh>, Findings) {
        read_all("", &[(name, bytes)])
    }

    fn error(name: &str, bytes: &[u8]) -> String {
        read(name, bytes).0.unwrap_err().to_string()
    }

    fn corners(mesh: &Mesh) -> Vec<[[f64; 3]; 3]> {
        mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize])).collect()
    }

    /// A GLB of some JSON and a chunk.
    fn glb(mut root: Value, chunk: &[u8]) -> Vec<u8> {
        root["asset"] = json!({"version": "2.0"});
        if !chunk.is_empty() && root["buffers"].is_null() {
            root["buffers"] = json!([{"byteLength": chunk.len()}]);
        }
        let mut text = root.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut out = b"glTF\x02\0\0\0".to_vec();
        let length = 12 + 8 + text.len() + 8 + chunk.len();
        out.extend((length as u32).to_le_bytes());
        for (kind, body) in [(b"JSON", &text[..]), (b"BIN\0", chunk)] {
            out.extend((body.len() as u32).to_le_bytes());
            out.extend(kind);
            out.extend(body);
        }
        out
    }

    fn floats(all: &[f32]) -> Vec<u8> {
        all.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];

    /// Four positions, then these indices as bytes.
    fn square(indices: &[u8], mode: u32) -> (Value, Vec<u8>) {
        let mut chunk = floats(&SQUARE);
        chunk.extend(indices);
        chunk.resize(chunk.len().next_multiple_of(4), 0);
        let root = json!({
            "nodes": [{"mesh": 0, "name": "a"}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
                {"bufferView": 1, "componentType": 5121, "count": indices.len(), "type": "SCALAR"}],
            "bufferViews": [
                {"buffer": 0, "byteLength": 48},
                {"buffer": 0, "byteOffset": 48, "byteLength": indices.len()}],
        });
        (root, chunk)
    }

    #[test]
    fn a_square_in_every_mode() {
        let two =
            [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]], [[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]]];
        for (indices, mode) in [(&[0, 1, 2, 0, 2, 3][..], 4), (&[0, 1, 2, 3], 6)] {
            let (root, chunk) = square(indices, mode);
            let mesh = read("a.glb", &glb(root, &chunk)).0.unwrap();
            assert_eq!(corners(&mesh), two, "mode {mode}");
            assert_eq!(mesh.feature_ids.iter().collect::<Vec<_>>(), ["a"]);
        }
        let (root, chunk) = square(&[0, 1, 3, 2], 5);
        let mesh = read("a.glb", &glb(root, &chunk)).0.unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 3], [3, 1, 2]]);
        for mode in 0..4 {
            let (root, chunk) = square(&[0, 1, 2, 3], mode);
            let message = error("a.glb", &glb(root, &chunk));
            assert_eq!(message, "no triangles in the input: 1 read, 1 filtered, 0 rejected");
        }
        let (root, chunk) = square(&[0, 1, 2], 7);
        assert!(error("a.glb", &glb(root, &chunk)).contains("7 is no mode"));
    }

    #[test]
    fn nodes_mirrors_and_instances() {
        let (mut root, mut chunk) = square(&[0, 1, 2], 4);
        root["nodes"] = json!([
            {"children": [1, 2], "translation": [10, 0, 0]},
            {"mesh": 0, "name": "a", "scale": [-1, 1, 1]},
            {"mesh": 0, "name": "a", "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1]},
            {"mesh": 0, "name": "not in the scene"}]);
        root["scenes"] = json!([{"nodes": [3]}, {"nodes": [0]}]);
        root["scene"] = json!(1);
        let mesh = read("a.glb", &glb(root.clone(), &chunk)).0.unwrap();
        assert_eq!(mesh.feature_ids.iter().collect::<Vec<_>>(), ["a", "a#2"]);
        // What is mirrored turns the other way, so that it looks the same way.
        let all = corners(&mesh);
        assert_eq!(all[0], [[10.0, 0.0, 0.0], [9.0, 0.0, 1.0], [9.0, 0.0, 0.0]]);
        assert_eq!(all[1], [[10.0, -5.0, 0.0], [10.0, -5.0, 1.0], [9.0, -5.0, 1.0]]);

        let offset = chunk.len();
        chunk.extend(floats(&[0.0, 0.0, 0.0, 0.0, 0.0, 2.0]));
        root["nodes"][3]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = json!({"TRANSLATION": 2});
        root["bufferViews"].as_array_mut().unwrap().push(json!({"buffer": 0, "byteOffset": offset, "byteLength": 24}));
        let accessor = json!({"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC3"});
        root["accessors"].as_array_mut().unwrap().push(accessor);
        root["scene"] = json!(0);
        let mesh = read("a.glb", &glb(root, &chunk)).0.unwrap();
        assert_eq!(mesh.triangles.len(), 2);
        assert_eq!(corners(&mesh)[1][0], [0.0, -2.0, 0.0]);
    }

    /// Small numbers for large ones, a picture on the second set of places, colours, and values put in sparsely.
    #[test]
    fn quantised_textured_coloured() {
        let positions: Vec<u8> =
            [0i16, 0, 0, 0, 32767, 0, 0, 0, 0, 32767, 0, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let png = b"\x89PNG\r\n\x1a\n....";
        let mut chunk = positions;
        chunk.extend([0, 0, 255, 0, 0, 255, 0, 0]); // places, two bytes each
        chunk.extend([255, 0, 0, 255, 0, 255, 0, 255, 0, 0, 255, 128]); // colours
        chunk.extend([2, 0, 0, 0]); // sparse index
        chunk.extend([0x01, 0x80, 0, 0, 0, 0, 0, 0]); // -32767
        chunk.extend(png);
        let view = |offset: usize, length: usize, stride: Option<u32>| json!({"buffer": 0, "byteOffset": offset, "byteLength": length, "byteStride": stride});
        let root = json!({
            "nodes": [{"mesh": 0, "scale": [4, 4, 4]}],
            "meshes": [{"primitives": [{"material": 0, "attributes": {"POSITION": 0, "TEXCOORD_0": 2, "TEXCOORD_1": 1, "COLOR_0": 2}}]}],
            "extensionsRequired": ["KHR_mesh_quantization", "KHR_texture_transform"],
            "materials": [{"name": "paint", "alphaMode": "MASK", "doubleSided": true, "pbrMetallicRoughness": {
                "baseColorFactor": [0.5, 1, 1, 1],
                "baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform":
                    {"texCoord": 1, "offset": [0.5, 0], "scale": [2, 1], "rotation": std::f64::consts::FRAC_PI_2}}}}}],
            "textures": [{"source": 0, "sampler": 0}], "images": [{"bufferView": 4}],
            "samplers": [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}],
            "accessors": [
                {"bufferView": 0, "componentType": 5122, "normalized": true, "count": 3, "type": "VEC3", "sparse": {
                    "count": 1, "indices": {"bufferView": 3, "componentType": 5125}, "values": {"bufferView": 3, "byteOffset": 4}}},
                {"bufferView": 1, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC2"},
                {"bufferView": 2, "componentType": 5121, "normalized": true, "count": 3, "type": "VEC4"}],
            "bufferViews": [view(0, 24, Some(8)), view(24, 8, None), view(32, 12, None), view(44, 12, None), view(56, png.len(), None)],
        });
        let mesh = read("a.glb", &glb(root, &chunk)).0.unwrap();
        assert_eq!(corners(&mesh)[0], [[0.0; 3], [4.0, 0.0, 0.0], [-4.0, 0.0, 0.0]]);
        let look = &mesh.surface;
        // (u, v) = (0, 0), (1, 0), (0, 1): scaled, turned a quarter, moved.
        let near = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() < 1e-6 && (a[1] - b[1]).abs() < 1e-6;
        assert!(near(look.uvs[0], [0.5, 0.0]) && near(look.uvs[1], [0.5, -2.0]) && near(look.uvs[2], [1.5, 0.0]));
        assert_eq!(look.colours[2], [0.0, 0.0, 1.0, 128.0 / 255.0]);
        let material = &look.materials[0];
        assert_eq!((&*material.name, material.alpha, material.double_sided), ("paint", Alpha::Mask(0.5), true));
        let texture = material.texture.unwrap();
        use crate::artifact::mesh::Wrap;
        assert_eq!((texture.wrap, texture.nearest), ([Wrap::Clamp, Wrap::Mirror], true));
        assert_eq!((look.images.types.get(0), look.images.image(0)), ("image/png", &png[..]));
    }

    #[test]
    fn skins_stand_as_their_joints_do() {
        let (mut root, mut chunk) = square(&[0, 1, 2], 4);
        let offset = chunk.len();
        chunk.extend([1, 0, 0, 0].repeat(4));
        chunk.extend(floats(&[1.0, 0.0, 0.0, 0.0].repeat(4)));
        root["nodes"] = json!([{"mesh": 0, "skin": 0, "translation": [100, 100, 100]}, {}, {"translation": [0, 7, 0]}]);
        root["skins"] = json!([{"joints": [1, 2]}]);
        root["meshes"][0]["primitives"][0]["attributes"] = json!({"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3});
        let views = root["bufferViews"].as_array_mut().unwrap();
        views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": 16}));
        views.push(json!({"buffer": 0, "byteOffset": offset + 16, "byteLength": 64}));
        let accessors = root["accessors"].as_array_mut().unwrap();
        accessors.push(json!({"bufferView": 2, "componentType": 5121, "count": 4, "type": "VEC4"}));
        accessors.push(json!({"bufferView": 3, "componentType": 5126, "count": 4, "type": "VEC4"}));
        let mesh = read("a.glb", &glb(root.clone(), &chunk)).0.unwrap();
        assert_eq!(corners(&mesh)[0], [[0.0, 0.0, 7.0], [1.0, 0.0, 7.0], [1.0, 0.0, 8.0]]);
        root["skins"] = json!([{"joints": [1]}]);
        assert!(error("a.glb", &glb(root, &chunk)).contains("joint that is not"));
    }

    #[test]
    fn wrong_indices_and_numbers_are_rejected() {
        let (root, chunk) = square(&[0, 1, 2, 0, 2, 9], 4);
        let (mesh, findings) = read("a.glb", &glb(root.clone(), &chunk));
        assert_eq!(mesh.unwrap().triangles.len(), 1);
        assert_eq!(findings.facts["rejected_by_cause"], json!({"an index beyond the vertices": 1}));
        let (mesh, _) = read_all("max-rejected = 0.2", &[("a.glb", &glb(root, &chunk))]);
        assert_eq!(mesh.unwrap_err().code, "too-many-rejects");
        let (root, mut chunk) = square(&[0, 1, 2, 0, 2, 3], 4);
        chunk[36..40].copy_from_slice(&f32::NAN.to_le_bytes());
        let (mesh, findings) = read("a.glb", &glb(root.clone(), &chunk));
        assert_eq!(mesh.unwrap().positions.len(), 3);
        assert_eq!(findings.facts["rejected_by_cause"], json!({"a corner that is no finite number": 1}));
        chunk[..4].copy_from_slice(&f32::INFINITY.to_le_bytes());
        assert!(error("a.glb", &glb(root, &chunk)).starts_with("no triangles in the input: 2 read, 0 filtered, 2 rej"));
    }

    #[test]
    fn what_cannot_be_read_says_what_to_do() {
        let (mut root, chunk) = square(&[0, 1, 2], 4);
        let with = |f: &dyn Fn(&mut Value)| {
            let mut changed = root.clone();
            f(&mut changed);
            error("a.glb", &glb(changed, &chunk))
        };
        let meshopt = with(&|r| {
            r["bufferViews"][0] = json!({"buffer": 1, "byteLength": 48, "extensions": {"EXT_meshopt_compression": {}}})
        });
        assert!(meshopt.contains("buffer view 0: EXT_meshopt_compression: missing field `buffer`"), "{meshopt}");
        let draco = with(&|r| {
            r["meshes"][0]["primitives"][0]["extensions"] = json!({"KHR_draco_mesh_compression": {}});
            r["accessors"][0]["bufferView"].take();
        });
        assert!(draco.contains("KHR_draco_mesh_compression") && draco.contains("Blender"), "{draco}");
        let ktx = with(&|r| {
            r["materials"] = json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]);
            r["textures"] = json!([{"extensions": {"KHR_texture_basisu": {"source": 0}}}]);
            r["meshes"][0]["primitives"][0]["material"] = json!(0);
        });
        assert!(ktx.contains("KTX2") && ktx.contains("PNG"), "{ktx}");
        assert!(with(&|r| r["extensionsRequired"] = json!(["EXT_new"])).contains("requires `EXT_new`"));
        // Claims beyond the file.
        assert!(with(&|r| r["accessors"][0]["count"] = json!(5)).contains("go beyond buffer view 0"));
        assert!(with(&|r| r["accessors"][0]["count"] = json!(1u64 << 60)).contains("more than the"));
        assert!(with(&|r| r["accessors"][0]["byteOffset"] = json!(u64::MAX)).contains("go beyond buffer view 0"));
        assert!(with(&|r| r["bufferViews"][0]["byteLength"] = json!(u64::MAX)).contains("beyond its buffer"));
        assert!(with(&|r| r["bufferViews"][0]["byteStride"] = json!(4)).contains("go beyond"));
        assert!(with(&|r| r["buffers"] = json!([{"byteLength": 1000}])).contains("ends early"));
        assert!(with(&|r| r["buffers"] = json!([{"byteLength": 10, "uri": "gone.bin"}])).contains("`gone.bin`"));
        for (part, what) in [("mesh", "mesh"), ("skin", "skin")] {
            assert!(with(&|r| r["nodes"][0][part] = json!(77)).contains(&format!("there is no {what} 77")));
        }
        for (part, what) in [("indices", "accessor"), ("material", "material")] {
            let message = with(&|r| r["meshes"][0]["primitives"][0][part] = json!(77));
            assert!(message.contains(&format!("there is no {what} 77")), "{message}");
        }
        // A node in itself, and a few nodes that would draw millions.
        assert!(with(&|r| r["nodes"] = json!([{"children": [0]}])).contains("no triangles"));
        assert!(
            with(&|r| {
                r["nodes"] = json!([{"children": [0]}]);
                r["scenes"] = json!([{"nodes": [0]}]);
            })
            .contains("twice")
        );
        assert!(with(&|r| r["nodes"] = json!([{"children": [1, 1]}, {"mesh": 0}])).contains("two parents"));
        root["meshes"] = json!([]);
        assert!(error("a.glb", &glb(root, &chunk)).contains("no mesh 0"));
        assert!(error("a.gltf", br#"{"asset": {"version": "1.0"}}"#).contains("version `1.0`"));
        assert_eq!(read("a.gltf", br#"{"asset": {"version": "2.0"}}"#).0.unwrap_err().code, "no-features");
        assert!(error("a.glb", b"").contains("empty"));
        assert!(error("a.xyz", b"\x7fELF\0\0\0").contains("no mesh"));
    }

    #[test]
    fn a_gltf_with_files_beside() {
        let (mut root, chunk) = square(&[0, 1, 2], 4);
        root["asset"] = json!({"version": "2.0"});
        root["buffers"] = json!([{"byteLength": chunk.len(), "uri": "a%20b.bin"}]);
        root["materials"] =
            json!([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "normalTexture": {"index": 1}}]);
        root["textures"] = json!([{"source": 0}, {"source": 1}]);
        root["images"] = json!([{"uri": "maps/c.jpg"}, {"uri": "n.jpg"}]);
        root["meshes"][0]["primitives"][0]["material"] = json!(0);
        let text = root.to_string();
        assert_eq!(ReadMesh::beside(&Source::of_bytes("a.gltf", text.clone().into())), ["a b.bin", "maps/c.jpg"]);
        let all: [(&str, &[u8]); 3] =
            [("a.gltf", text.as_bytes()), ("a b.bin", &chunk), ("maps/c.jpg", b"\xff\xd8\xff\xe0")];
        let (mesh, findings) = read_all("", &all);
        assert_eq!(mesh.unwrap().surface.images.types.get(0), "image/jpeg");
        assert!(findings.warnings.is_empty());
        let (mesh, findings) = read_all("", &all[..2]);
        assert!(mesh.unwrap().surface.images.is_empty());
        assert!(findings.warnings[0].contains("maps/c.jpg"), "{:?}", findings.warnings);
    }

    /// A file is looked at piece by piece, and the first piece may be two bytes long.
    #[test]
    fn files_beside_others() {
        let (mut root, chunk) = square(&[0, 1, 2], 4);
        root["buffers"] = json!([{"byteLength": chunk.len(), "uri": "a.bin"}]);
        let bytes = glb(root.clone(), b"");
        root["asset"] = json!({"version": "2.0"});
        let marked = format!("\u{feff} {root}").into_bytes();
        let ply = b"ply\nformat ascii 1.0\ncomment TextureFile in\\a.png\nelement vertex 0\nend_header\n".to_vec();
        for (name, bytes, beside) in
            [("a.glb", bytes, "a.bin"), ("a.gltf", marked, "a.bin"), ("a.ply", ply, "in/a.png")]
        {
            let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            packed.write_all(&bytes).unwrap();
            for bytes in [bytes, packed.finish().unwrap()] {
                assert_eq!(ReadMesh::beside(&Source::of_bytes(name, bytes)), [beside], "{name}");
            }
        }
    }

    const PAINTED: &str = "# a concave face, a quad behind it, and a line\nmtllib my paint.mtl\no front\n\
        v 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0 \nv 0 4 0\nvt 0 0\nvt 1 0\nvt 1 1\n\
        usemtl red\nf 1/1 2/2 3/3 4/1 5/2\no back\nusemtl glass#2\nf -5 -4 -3\nf -5 -3 \\\n -1\nl 1 2\nf 1 2 99\n";
    const PAINT: &str =
        "newmtl red\nKd 1 0 0.5\nmap_Kd -s 1 1 -clamp on red brick.png\nnewmtl glass#2\nKd 0 0 0\nd 0.25\n";

    #[test]
    fn an_obj_with_its_paint() {
        let library = |name: &str| ReadMesh::beside(&Source::of_bytes(name, PAINTED.into()));
        assert_eq!(library("a.obj"), ["my paint.mtl"]);
        let pictures = |name: &str| ReadMesh::beside(&Source::of_bytes(name, PAINT.into()));
        assert_eq!(pictures("my paint.mtl"), ["red brick.png"]);
        assert_eq!(pictures("in/a.mtl"), ["in/red brick.png"]);
        let png = b"\x89PNG\r\n\x1a\n";
        let all: [(&str, &[u8]); 3] =
            [("a.obj", PAINTED.as_bytes()), ("my paint.mtl", PAINT.as_bytes()), ("red brick.png", png)];
        let (mesh, findings) = read_all("", &all);
        let mesh = mesh.unwrap();
        // The concave face is cut without leaving it; y is up.
        let area = |t: &[[f64; 3]; 3]| {
            let [a, b, c] = *t;
            ((b[0] - a[0]) * (c[2] - a[2]) - (c[0] - a[0]) * (b[2] - a[2])) / 2.0
        };
        let areas: Vec<f64> = corners(&mesh).iter().map(area).collect();
        assert_eq!(areas.len(), 5);
        assert!(areas[..3].iter().all(|&a| a > 0.0));
        assert_eq!(areas[..3].iter().sum::<f64>(), 10.0);
        assert_eq!(mesh.feature_ids.iter().collect::<Vec<_>>(), ["front", "back"]);
        let look = &mesh.surface;
        assert_eq!(look.uvs[..3], [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0]]);
        assert_eq!(look.materials[0].base_colour[..2], [1.0, 0.0]);
        assert!((look.materials[0].base_colour[2] - 0.214).abs() < 1e-3);
        assert_eq!((look.materials[1].base_colour, look.materials[1].alpha), ([0.0, 0.0, 0.0, 0.25], Alpha::Blend));
        assert_eq!(look.images.len(), 1);
        assert_eq!(findings.facts["filtered_by_type"], json!({"lines": 1}));
        assert_eq!(findings.facts["rejected"], 1);
        assert!(findings.warnings.iter().all(|w| w.contains("-o, -s and -t")), "{:?}", findings.warnings);
        // Without the library all is white, and it is told once.
        let (mesh, findings) = read_all("up = 'z'", &all[..1]);
        let mesh = mesh.unwrap();
        assert_eq!(mesh.positions[2], [4.0, 4.0, 0.0]);
        assert!(mesh.surface.materials.iter().all(|m| m.base_colour == [1.0; 4]));
        assert_eq!(findings.warnings, ["`a.obj`: `my paint.mtl` is not there: what it paints is white"]);
    }

    #[test]
    fn odd_objs() {
        assert!(error("a.obj", b"v 0 0 x\n").contains("line 1: `x` is no number"));
        assert!(error("a.obj", b"v 0 0\n").contains("fewer than 3 numbers"));
        assert!(error("a.obj", b"v 0 0 0\nf 1 a 1\n").contains("line 2: `a` is no corner"));
        assert!(error("a.obj", b"v 0 0 0\n").contains("no triangles"));
        let (_, findings) = read("a.obj", b"v 0 0 0\nf 1 1\nf 1 1 0\nf -9 1 1\nf 1 99999999999 1\n");
        assert_eq!(
            findings.facts["rejected_by_cause"],
            json!({"an index beyond the vertices": 3, "fewer than three corners": 1})
        );
        // Colours of vertices, a word that nobody knows, equal faces without end.
        let text = format!("v 0 0 0 1 0 0\nv 1 0 0 1 1 1\nv 0 1 0 0 0 0\nbezier x\n{}", "f 1 2 3\n".repeat(1000));
        let (mesh, findings) = read("a.obj", text.as_bytes());
        assert_eq!(mesh.unwrap().surface.colours[..2], [[1.0, 0.0, 0.0, 1.0], [1.0; 4]]);
        assert!(findings.warnings[0].contains("bezier (1)"));
    }

    fn ply(format: &str, body: &[u8]) -> Vec<u8> {
        let mut out = format!(
            "ply\nformat {format} 1.0\ncomment made here\nelement vertex 4\nproperty short x\nproperty float y\n\
             property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement edge 1\n\
             property int a\nelement face 1\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n"
        )
        .into_bytes();
        out.extend(body);
        out
    }

    #[test]
    fn ply_in_three_ways() {
        let corners = [[0i16, 0], [2, 0], [2, 2], [0, 2]];
        let mut text = String::new();
        let (mut little, mut big) = (Vec::new(), Vec::new());
        for [x, y] in corners {
            text += &format!("{x} {y} 0.5 255 0 0\r\n");
            little.extend(x.to_le_bytes().into_iter().chain(f32::from(y).to_le_bytes()).chain(0.5f64.to_le_bytes()));
            big.extend(x.to_be_bytes().into_iter().chain(f32::from(y).to_be_bytes()).chain(0.5f64.to_be_bytes()));
            little.extend([255, 0, 0]);
            big.extend([255, 0, 0]);
        }
        text += "7\n0 4 0 1 2 3";
        little.extend(
            7i32.to_le_bytes().into_iter().chain([0, 4]).chain([0, 1, 2, 3].into_iter().flat_map(i32::to_le_bytes)),
        );
        big.extend(
            7i32.to_be_bytes().into_iter().chain([0, 4]).chain([0, 1, 2, 3].into_iter().flat_map(i32::to_be_bytes)),
        );
        let all = [ply("ascii", text.as_bytes()), ply("binary_little_endian", &little), ply("binary_big_endian", &big)];
        let meshes = all.each_ref().map(|bytes| read("a.ply", bytes).0.unwrap());
        assert_eq!(meshes[0].positions, [[0.0, 0.0, 0.5], [2.0, 0.0, 0.5], [2.0, 2.0, 0.5], [0.0, 2.0, 0.5]]);
        assert_eq!(meshes[0].triangles.len(), 2);
        assert_eq!(meshes[0].surface.colours[3], [1.0, 0.0, 0.0, 1.0]);
        assert!(meshes.iter().all(|m| *m == meshes[0]));
        // Cut off anywhere: an error, never a panic.
        for bytes in &all {
            for n in 0..bytes.len() - 1 {
                assert!(read("a.ply", &bytes[..n]).0.is_err(), "{n}");
            }
        }
    }

    #[test]
    fn odd_plys() {
        let with = |vertices: &str, faces: &str, body: &str| {
            let text = format!(
                "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
                 element face {faces}\nproperty list uchar int vertex_indices\nend_header\n{body}"
            );
            read("a.ply", text.as_bytes())
        };
        let message = with("1000000000000", "1", "0 0 0\n").0.unwrap_err().to_string();
        assert!(message.contains("promises 1000000000000 of `vertex`"), "{message}");
        let message = with("1", "99999999999999999999", "0 0 0\n").0.unwrap_err().to_string();
        assert!(message.contains("no count"), "{message}");
        assert!(with("1", "2", "0 0 0\n3 0 0 0 -1\n").0.unwrap_err().to_string().contains("a list of -1"));
        assert!(with("1", "1", "0 0 0\n1000000 0 0 0\n").0.unwrap_err().to_string().contains("a list of 1000000"));
        let (mesh, findings) = with("3", "2", "0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n3 0 1 5\n");
        assert_eq!(mesh.unwrap_err().code, "no-features");
        assert_eq!(findings.facts["rejected"], 2);
        assert!(
            error("a.ply", b"ply\nformat ascii 1.0\nelement x 1000000000000000\nend_header\n").contains("no triangles")
        );
        assert!(error("a.ply", b"ply\nelement vertex 1\nend_header\n").contains("names no format"));
    }

    #[test]
    fn stl_in_two_ways() {
        let facets = [
            [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [-0.0, 1.0, 0.0]],
        ];
        let mut binary = b"solid, or is it?".to_vec();
        binary.resize(80, 0);
        binary.extend(2u32.to_le_bytes());
        let mut text = "solid of mine\n".to_string();
        for f in facets {
            binary.extend([0; 12]);
            binary.extend(floats(f.as_flattened()));
            binary.extend([0; 2]);
            text += "facet normal 0 0 1\n outer loop\n";
            f.iter().for_each(|p| text += &format!("  vertex {} {} {}\n", p[0], p[1], p[2]));
            text += " endloop\nendfacet\n";
        }
        text += "endsolid of mine\n";
        let (a, b) = (read("a.stl", &binary).0.unwrap(), read("a.stl", text.as_bytes()).0.unwrap());
        assert_eq!((a.positions.len(), &a.triangles), (4, &vec![[0, 1, 2], [1, 3, 2]]));
        assert_eq!((&a.positions, &a.triangles), (&b.positions, &b.triangles));
        assert_eq!(b.feature_ids.get(0), "of mine");
        for n in 0..binary.len() {
            assert!(read("a.stl", &binary[..n]).0.is_err(), "{n}");
        }
        for n in 0..text.len() - 10 {
            assert!(read("a.stl", &text.as_bytes()[..n]).0.is_err(), "{n}");
        }
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        packed.write_all(&binary).unwrap();
        let packed = packed.finish().unwrap();
        assert_eq!(read("a.stl.gz", &packed).0.unwrap(), a);
        assert!(error("a.stl.gz", &packed[..packed.len() / 2]).contains("ends in the middle of its compressed data"));
    }

    /// What the file says is up, its y or its z, is the mesh's z. Of glTF all is known: another word is told, not heeded.
    #[test]
    fn up_is_what_is_said_except_in_gltf() {
        let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
            property float nx\nproperty float ny\nproperty float nz\nelement face 1\n\
            property list uchar int vertex_indices\nend_header\n\
            1 2 3 0 1 0\n4 2 3 0 1 0\n1 2 -5 0 1 0\n3 0 1 2\n";
        let stl = "solid a\nfacet normal 0 1 0\nouter loop\nvertex 1 2 3\nvertex 4 2 3\nvertex 1 2 -5\nendloop\n\
            endfacet\nendsolid a\n";
        let as_it_is = [[1.0, 2.0, 3.0], [4.0, 2.0, 3.0], [1.0, 2.0, -5.0]];
        let turned = [[1.0, -3.0, 2.0], [4.0, -3.0, 2.0], [1.0, 5.0, 2.0]];
        for (name, text) in [("a.ply", ply), ("a.stl", stl)] {
            for (params, wanted, normal) in [
                ("", as_it_is, [0.0, 1.0, 0.0]),
                ("up = 'z'", as_it_is, [0.0, 1.0, 0.0]),
                ("up = 'y'", turned, [0.0, 0.0, 1.0]),
            ] {
                let (mesh, findings) = read_all(params, &[(name, text.as_bytes())]);
                let mesh = mesh.unwrap();
                assert_eq!((corners(&mesh), findings.warnings), (vec![wanted], vec![]), "{name} {params}");
                // Normals turn with the places; STL's are not read.
                let normals = if name == "a.ply" { vec![normal; 3] } else { vec![] };
                assert_eq!(mesh.surface.normals, normals, "{name} {params}");
            }
        }
        let (root, chunk) = square(&[0, 1, 2], 4);
        let bytes = glb(root, &chunk);
        let of = |params: &str| {
            let (mesh, findings) = read_all(params, &[("a.glb", &bytes)]);
            (mesh.unwrap(), findings.warnings)
        };
        let (plain, warnings) = of("");
        assert_eq!((corners(&plain)[0][2], warnings), ([1.0, 0.0, 1.0], vec![]));
        assert_eq!(of("up = 'y'"), (plain.clone(), vec![]));
        assert_eq!(of("up = 'z'"), (plain, vec!["`a.glb`: `up` is not heeded: glTF is always y up".to_string()]));
    }

    /// Every byte of a rich GLB changed, and every length of it: an error or a mesh.
    #[test]
    fn broken_bytes() {
        let (mut root, chunk) = square(&[0, 1, 2, 0, 2, 3], 4);
        root["nodes"] = json!([{"children": [1], "rotation": [0, 0, 0, 1]}, {"mesh": 0}]);
        let bytes = glb(root, &chunk);
        for n in 0..bytes.len() {
            assert!(read("a.glb", &bytes[..n]).0.is_err(), "{n}");
            for value in [0, b'9', b'"', 0xff] {
                let mut changed = bytes.clone();
                changed[n] = value;
                let _ = read("a.glb", &changed);
            }
        }
        let obj: Vec<u8> = PAINTED.into();
        for n in 0..obj.len() {
            let mut changed = obj.clone();
            changed[n] = [b'-', b'9', 0, 0xff][n % 4];
            let _ = read("a.obj", &changed);
            let _ = read("a.obj", &obj[..n]);
        }
    }

    /// Triangles and features of every real mesh.
    #[test]
    fn real_meshes() {
        let Some(data) = std::env::var_os("LODGE_DATA") else {
            return println!("skipped: LODGE_DATA is not set");
        };
        let folder = std::path::Path::new(&data).join("meshes");
        for (name, vertices, triangles, images) in [
            ("antique_camera.glb", 21_178, 20_066, 1),
            ("happy_buddha_100k.obj.gz", 49_950, 100_000, 0),
            ("house_scene.glb", 13_141, 10_497, 1),
            ("japanese_temple.glb", 33_629, 29_696, 0),
            ("lamborghini_huracan.glb", 115_576, 145_917, 8),
            ("machine_counter.stl", 41_837, 83_750, 0),
            ("nasa_ingenuity.glb", 8_226, 9_060, 3),
            ("stanford_bunny.ply.gz", 34_834, 69_451, 0),
            ("toy_car/ToyCar.gltf", 77_429, 108_936, 2),
        ] {
            let path = folder.join(name);
            let mut bench = Bench::default();
            let main = Source::of_file(&path, None);
            let beside = ReadMesh::beside(&main);
            bench.sources.push(main);
            bench.sources.extend(beside.iter().map(|n| Source::of_file(&path.with_file_name(n), Some(n))));
            let mesh = ReadMesh::default().run(&bench.ctx(), In {}).unwrap_or_else(|e| panic!("{name}: {e}"));
            let found = (mesh.positions.len(), mesh.triangles.len(), mesh.surface.images.len());
            assert_eq!(found, (vertices, triangles, images), "{name}");
            assert!(bench.report.finish().warnings.is_empty(), "{name}");
        }
    }
}
