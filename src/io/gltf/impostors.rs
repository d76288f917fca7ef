//! GLB of impostors: quads of one atlas, drawn where the atlas is opaque.
//!
//! Unlit; with a normal map, matt and with tangents, so that light falls on them. `extras` of the scene say how far off a
//! quad may be and from where that is less than a pixel.
//! Source: glTF 2.0; KHR_materials_unlit; EXT_texture_webp.

use serde_json::{Map, Value, json};

use super::Builder;
use crate::artifact::Impostors;
use crate::diag::{Diagnostic, Result};
use crate::geom::space::bounds;
use crate::io::picture::Picture;

/// How the atlas is packed: PNG as it is, or WebP without loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    Png,
    Webp,
}

/// The file. Cost: O(quads), and with WebP the atlas packed anew.
pub fn glb(of: &Impostors, packing: Packing) -> Result<Vec<u8>> {
    let mut file = Builder::default();
    // Around their middle, y up.
    let up = |[x, y, z]: [f64; 3]| [x, z, 0.0 - y];
    let (low, high) = bounds(of.corners.iter().map(|&corner| up(corner)));
    let middle = [0, 1, 2].map(|k| if low[k] <= high[k] { (low[k] + high[k]) / 2.0 } else { 0.0 });
    let place = |p: &[f64; 3]| {
        let p = up(*p);
        [0, 1, 2].map(|k| (p[k] - middle[k]) as f32)
    };
    let positions: Vec<[f32; 3]> = of.corners.iter().map(place).collect();
    let lit = !of.normal_map.is_empty();
    let mut attributes = Map::new();
    attributes.insert("POSITION".into(), json!(file.vectors(&positions, true)));
    attributes.insert("TEXCOORD_0".into(), json!(file.vectors(&of.uvs, false)));
    if lit {
        let turned = |v: &[f32; 3]| [v[0], v[2], 0.0 - v[1]];
        let normals: Vec<[f32; 3]> = of.normals.iter().flat_map(|n| [turned(n); 4]).collect();
        attributes.insert("NORMAL".into(), json!(file.vectors(&normals, false)));
        // Up is the normal x right: a sign of 1.
        let tangent = |v: &[f32; 3]| {
            let [x, y, z] = turned(v);
            [[x, y, z, 1.0]; 4]
        };
        let tangents: Vec<[f32; 4]> = of.tangents.iter().flat_map(tangent).collect();
        attributes.insert("TANGENT".into(), json!(file.vectors(&tangents, false)));
    }
    let (mut primitives, mut materials): (Vec<Value>, Vec<Value>) = (Vec::new(), Vec::new());
    for two_sided in [false, true] {
        let quads = (0..of.len() as u32).filter(|&q| of.two_sided[q as usize] == two_sided);
        let triangles: Vec<[u32; 3]> =
            quads.flat_map(|q| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|c| 4 * q + c))).collect();
        if triangles.is_empty() {
            continue;
        }
        let indices = file.corners(&triangles, of.corners.len());
        primitives.push(json!({"attributes": attributes, "indices": indices, "material": materials.len()}));
        let mut material = json!({
            "name": if two_sided { "impostor-two-sided" } else { "impostor" },
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1},
            "alphaMode": "MASK", "alphaCutoff": 0.5, "doubleSided": two_sided,
        });
        if lit {
            material["normalTexture"] = json!({"index": 1});
        } else {
            material["extensions"] = json!({"KHR_materials_unlit": {}});
        }
        materials.push(material);
    }
    let (mut images, mut textures) = (Vec::new(), Vec::new());
    for picture in [&of.colour, &of.normal_map].into_iter().filter(|p| !p.is_empty()) {
        let source = images.len();
        let (kind, bytes) = match packing {
            Packing::Png => ("image/png", picture.clone()),
            Packing::Webp => ("image/webp", webp(picture)?),
        };
        images.push(json!({"bufferView": file.view(&[], bytes), "mimeType": kind}));
        textures.push(match packing {
            Packing::Png => json!({"source": source, "sampler": 0}),
            Packing::Webp => json!({"sampler": 0, "extensions": {"EXT_texture_webp": {"source": source}}}),
        });
    }
    if u32::try_from(file.size + (1 << 20)).is_err() {
        return Err(Diagnostic::error("too-large", "the impostors need more than 4 GiB, which GLB cannot say"));
    }
    let mut used = Vec::new();
    if !lit {
        used.push("KHR_materials_unlit");
    }
    let worth = &of.worth;
    let mut root = json!({
        "asset": {"version": "2.0", "generator": "lodge"},
        "scene": 0,
        "scenes": [{"nodes": [0], "extras": {"error": worth.error_m, "distance": worth.distance_m}}],
        "nodes": [{"name": "impostor", "mesh": 0, "translation": middle}],
        "meshes": [{"primitives": primitives}],
        "materials": materials,
        "textures": textures,
        // Smooth, with smaller copies; clamped.
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "images": images,
        "accessors": file.accessors,
        "bufferViews": file.views,
    });
    if packing == Packing::Webp {
        used.push("EXT_texture_webp");
        root["extensionsRequired"] = json!(["EXT_texture_webp"]);
    }
    if !used.is_empty() {
        root["extensionsUsed"] = json!(used);
    }
    let Value::Object(root) = root else { unreachable!("written as one above") };
    Ok(file.finish(root))
}

fn webp(png: &[u8]) -> Result<Vec<u8>> {
    let wrong = |e: String| Diagnostic::error("bad-picture", format!("the atlas {e}"));
    Picture::decode(png).map_err(wrong)?.levels[0].webp().map_err(wrong)
}

#[cfg(test)]
mod tests {
    use gltf::material::AlphaMode;

    use super::*;
    use crate::artifact::impostors::Worth;
    use crate::diag::Report;
    use crate::geom::frame::Frame;
    use crate::io::ledger::Ledger;
    use crate::io::mesh::{self, Files};
    use crate::io::picture::Level;

    fn two() -> Impostors {
        let quad = |z: f64| [[0.0, 0.0, z], [2.0, 0.0, z], [2.0, 1.0, z], [0.0, 1.0, z]];
        Impostors {
            frame: Frame::local(),
            corners: [quad(0.0), quad(4.0)].concat(),
            uvs: [[[0.0, 1.0], [0.5, 1.0], [0.5, 0.0], [0.0, 0.0]]; 2].concat(),
            normals: vec![[0.0, 0.0, 1.0]; 2],
            tangents: vec![[1.0, 0.0, 0.0]; 2],
            tiles: vec![0, 1],
            two_sided: vec![true, false],
            colour: Level { width: 2, height: 1, texels: vec![[9, 8, 7, 255]; 2] }.png(),
            normal_map: Vec::new(),
            sheet: Vec::new(),
            worth: Worth { error_m: 0.5, distance_m: 468.0, ..Worth::default() },
        }
    }

    fn read(bytes: &[u8]) -> crate::artifact::Mesh {
        let report = Report::default();
        let files = Files { name: "a.glb", bytes, beside: &|_| None, warn: &|w| panic!("{w}") };
        mesh::read(&files, None, &mut Ledger::new(&report)).unwrap()
    }

    fn is_unlit(material: &gltf::Material) -> bool {
        material.extension_value("KHR_materials_unlit").is_some()
    }

    /// Drawn where the atlas is opaque, without gloss; and how far off that is fit for.
    fn is_matt_and_masked(document: &gltf::Gltf) {
        for material in document.materials() {
            assert_eq!((material.alpha_mode(), material.alpha_cutoff()), (AlphaMode::Mask, Some(0.5)));
            let look = material.pbr_metallic_roughness();
            assert_eq!((look.metallic_factor(), look.roughness_factor()), (0.0, 1.0));
            assert!(look.base_color_texture().is_some_and(|t| t.texture().index() == 0));
        }
        let extras = document.scenes().next().unwrap().extras().as_ref().unwrap().get().to_string();
        assert_eq!(extras, r#"{"distance":468.0,"error":0.5}"#);
    }

    /// Two quads, there and back.
    #[test]
    fn what_is_written_is_read() {
        let of = two();
        let bytes = glb(&of, Packing::Png).unwrap();
        let document = gltf::Gltf::from_slice(&bytes).unwrap();
        assert_eq!(document.materials().count(), 2);
        assert!(document.materials().all(|m| is_unlit(&m) && m.normal_texture().is_none()));
        assert_eq!(document.extensions_used().collect::<Vec<_>>(), ["KHR_materials_unlit"]);
        is_matt_and_masked(&document);
        let back = read(&bytes);
        let corners = |positions: &[[f64; 3]], triangles: &[[u32; 3]]| {
            let mut all: Vec<String> =
                triangles.iter().map(|t| format!("{:?}", t.map(|v| positions[v as usize]))).collect();
            all.sort();
            all
        };
        let here = of.mesh();
        assert_eq!(corners(&back.positions, &back.triangles), corners(&here.positions, &here.triangles));
        assert_eq!(back.surface.images.image(0), of.colour);
        assert_eq!(back.surface.materials.iter().map(|m| m.double_sided).collect::<Vec<_>>(), [false, true]);
    }

    #[test]
    fn webp_holds_the_same_texels() {
        let of = two();
        let back = read(&glb(&of, Packing::Webp).unwrap());
        assert_eq!(back.surface.images.types.get(0), "image/webp");
        assert_eq!(Picture::decode(back.surface.images.image(0)), Picture::decode(&of.colour));
    }

    /// With a normal map: lit, a tangent to the right, normals up, in glTF's axes.
    #[test]
    fn light_falls_on_normal_maps() {
        let mut of = two();
        of.normal_map = Level { width: 2, height: 1, texels: vec![[128, 128, 255, 255]; 2] }.png();
        let bytes = glb(&of, Packing::Png).unwrap();
        let document = gltf::Gltf::from_slice(&bytes).unwrap();
        assert!(document.materials().all(|m| !is_unlit(&m) && m.normal_texture().is_some()));
        assert_eq!(document.extensions_used().count(), 0);
        is_matt_and_masked(&document);
        let chunk = document.blob.as_deref().unwrap();
        let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
        let reader = primitive.reader(|_| Some(chunk));
        assert!(reader.read_normals().unwrap().all(|n| n == [0.0, 1.0, 0.0]));
        assert!(reader.read_tangents().unwrap().all(|t| t == [1.0, 0.0, 0.0, 1.0]));
    }
}
