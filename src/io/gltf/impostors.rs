//! GLB of impostors: quads of one atlas, unlit, drawn where the atlas is opaque.
//!
//! `extras` of the scene say how far off a quad may be and from where that is less than a pixel.
//! Source: glTF 2.0; KHR_materials_unlit.

use serde_json::{Value, json};

use crate::artifact::Impostors;
use crate::diag::{Diagnostic, Result};

/// The file.
pub fn glb(of: &Impostors) -> Result<Vec<u8>> {
    let mut chunk = Vec::new();
    let mut views = Vec::new();
    let mut view = |bytes: &[u8], target: Option<u32>| {
        chunk.resize(chunk.len().next_multiple_of(4), 0);
        let mut out = json!({"buffer": 0, "byteOffset": chunk.len(), "byteLength": bytes.len()});
        if let Some(target) = target {
            out["target"] = target.into();
        }
        views.push(out);
        chunk.extend_from_slice(bytes);
        views.len() - 1
    };
    // Around their middle, y up.
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for [x, y, z] in &of.corners {
        for (k, c) in [*x, *z, 0.0 - y].into_iter().enumerate() {
            (low[k], high[k]) = (low[k].min(c), high[k].max(c));
        }
    }
    let middle = [0, 1, 2].map(|k| if low[k] <= high[k] { (low[k] + high[k]) / 2.0 } else { 0.0 });
    let place = |&[x, y, z]: &[f64; 3]| [x - middle[0], z - middle[1], 0.0 - y - middle[2]].map(|c| c as f32);
    let positions: Vec<[f32; 3]> = of.corners.iter().map(place).collect();
    let least = |f: fn(f32, f32) -> f32, from: f32| {
        let all = positions.iter().fold([from; 3], |a, p| [0, 1, 2].map(|k| f(a[k], p[k])));
        if positions.is_empty() { [0.0; 3] } else { all }
    };
    let (low, high) = (least(f32::min, f32::INFINITY), least(f32::max, f32::NEG_INFINITY));
    let bytes = |all: &[f32]| all.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let n = of.corners.len();
    let mut accessors = Vec::new();
    let at = view(&bytes(positions.as_flattened()), Some(34962));
    accessors
        .push(json!({"bufferView": at, "componentType": 5126, "count": n, "type": "VEC3", "min": low, "max": high}));
    let at = view(&bytes(of.uvs.as_flattened()), Some(34962));
    accessors.push(json!({"bufferView": at, "componentType": 5126, "count": n, "type": "VEC2"}));
    let (mut primitives, mut materials): (Vec<Value>, Vec<Value>) = (Vec::new(), Vec::new());
    for two_sided in [false, true] {
        let quads = (0..of.len() as u32).filter(|&q| of.two_sided[q as usize] == two_sided);
        let indices: Vec<u32> = quads.flat_map(|q| [0, 1, 2, 0, 2, 3].map(|c| 4 * q + c)).collect();
        if indices.is_empty() {
            continue;
        }
        let at = view(&indices.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>(), Some(34963));
        accessors.push(json!({"bufferView": at, "componentType": 5125, "count": indices.len(), "type": "SCALAR"}));
        let attributes = json!({"POSITION": 0, "TEXCOORD_0": 1});
        let (indices, material) = (accessors.len() - 1, materials.len());
        primitives.push(json!({"attributes": attributes, "indices": indices, "material": material}));
        materials.push(json!({
            "name": if two_sided { "impostor-two-sided" } else { "impostor" },
            "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0, "roughnessFactor": 1},
            "alphaMode": "MASK", "alphaCutoff": 0.5, "doubleSided": two_sided,
            "extensions": {"KHR_materials_unlit": {}},
        }));
    }
    let picture = view(&of.colour, None);
    chunk.resize(chunk.len().next_multiple_of(4), 0);
    let worth = &of.worth;
    let root = json!({
        "asset": {"version": "2.0", "generator": "lodge"},
        "scene": 0,
        "scenes": [{"nodes": [0], "extras": {"error": worth.error_m, "distance": worth.distance_m}}],
        "nodes": [{"name": "impostor", "mesh": 0, "translation": middle}],
        "meshes": [{"primitives": primitives}],
        "materials": materials,
        "textures": [{"source": 0, "sampler": 0}],
        // Smooth, with smaller copies; clamped.
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071}],
        "images": [{"bufferView": picture, "mimeType": "image/png"}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": chunk.len()}],
        "extensionsUsed": ["KHR_materials_unlit"],
    });
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = u32::try_from(28 + text.len() + chunk.len())
        .map_err(|_| Diagnostic::error("too-large", "the impostors need more than 4 GiB, which GLB cannot say"))?;
    let mut out = Vec::with_capacity(length as usize);
    out.extend_from_slice(b"glTF\x02\0\0\0");
    out.extend_from_slice(&length.to_le_bytes());
    for (kind, body) in [(b"JSON", &text), (b"BIN\0", &chunk)] {
        out.extend_from_slice(&(body.len() as u32).to_le_bytes());
        out.extend_from_slice(kind);
        out.extend_from_slice(body);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::impostors::Worth;
    use crate::diag::Report;
    use crate::geom::frame::Frame;
    use crate::io::ledger::Ledger;
    use crate::io::mesh::{self, Files};
    use crate::io::picture::Level;

    /// Two quads, there and back.
    #[test]
    fn what_is_written_is_read() {
        let quad = |z: f64| [[0.0, 0.0, z], [2.0, 0.0, z], [2.0, 1.0, z], [0.0, 1.0, z]];
        let of = Impostors {
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
        };
        let bytes = glb(&of).unwrap();
        let document = gltf::Gltf::from_slice(&bytes).unwrap();
        assert_eq!(document.materials().count(), 2);
        let report = Report::default();
        let files = Files { name: "a.glb", bytes: &bytes, beside: &|_| None, warn: &|w| panic!("{w}") };
        let back = mesh::read(&files, None, &mut Ledger::new(&report)).unwrap();
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
}
