//! A GLB with everything in it, written by hand.

use lodge::io::picture::Level;
use serde_json::json;

/// Bytes of a glTF being written: views and accessors in the order of their making.
#[derive(Default)]
pub struct Glb {
    chunk: Vec<u8>,
    views: Vec<serde_json::Value>,
    pub accessors: Vec<serde_json::Value>,
}

impl Glb {
    pub fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.chunk.resize(self.chunk.len().next_multiple_of(4), 0);
        self.views.push(json!({"buffer": 0, "byteOffset": self.chunk.len(), "byteLength": bytes.len()}));
        if let Some(target) = target {
            self.views.last_mut().unwrap()["target"] = target.into();
        }
        self.chunk.extend(bytes);
        self.views.len() - 1
    }

    pub fn floats(&mut self, rows: &[&[f32]], target: Option<u32>) -> usize {
        let width = rows[0].len();
        let bytes: Vec<u8> = rows.iter().flat_map(|r| r.iter().flat_map(|v| v.to_le_bytes())).collect();
        let least = |f: fn(f32, f32) -> f32| (0..width).map(|k| rows.iter().map(|r| r[k]).reduce(f).unwrap()).collect();
        let (low, high): (Vec<f32>, Vec<f32>) = (least(f32::min), least(f32::max));
        let view = self.view(&bytes, target);
        self.accessors.push(json!({"bufferView": view, "componentType": 5126, "count": rows.len(),
            "type": format!("VEC{width}"), "min": low, "max": high}));
        self.accessors.len() - 1
    }

    pub fn indices(&mut self, all: &[u16]) -> usize {
        let view = self.view(&all.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>(), Some(34963));
        self.accessors.push(json!({"bufferView": view, "componentType": 5123, "count": all.len(), "type": "SCALAR"}));
        self.accessors.len() - 1
    }

    pub fn finish(mut self, mut root: serde_json::Value) -> Vec<u8> {
        self.chunk.resize(self.chunk.len().next_multiple_of(4), 0);
        root["asset"] = json!({"version": "2.0"});
        root["buffers"] = json!([{"byteLength": self.chunk.len()}]);
        root["bufferViews"] = self.views.into();
        root["accessors"] = self.accessors.into();
        let mut text = root.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut out = b"glTF\x02\0\0\0".to_vec();
        out.extend(((28 + text.len() + self.chunk.len()) as u32).to_le_bytes());
        for (kind, body) in [(b"JSON", &text), (b"BIN\0", &self.chunk)] {
            out.extend((body.len() as u32).to_le_bytes());
            out.extend(kind);
            out.extend(body);
        }
        out
    }
}

const VERTICES: Option<u32> = Some(34962);

/// A picture without any symmetry; its middle shows through.
pub fn picture() -> Vec<u8> {
    let texel = |x: u32, y: u32| {
        let hole = (x.abs_diff(30)).pow(2) + (y.abs_diff(20)).pow(2) < 100;
        let [r, g] = [x, y].map(|v| 40 + 3 * v as u8);
        [r, g, if x < 16 && y < 16 { 250 } else { 20 }, if hole { 0 } else { 255 }]
    };
    let texels = (0..64 * 64).map(|i| texel(i % 64, i / 64)).collect();
    Level { width: 64, height: 64, texels }.png()
}

/// Everything that a reader of glTF can get wrong, in one scene: turned, mirrored and copied nodes, strips and fans,
/// wrapped, moved and turned pictures, colours of vertices, culled backs, masks, what shines through.
pub fn scene() -> Vec<u8> {
    let mut glb = Glb::default();
    let image = glb.view(&picture(), None);
    // A brick of 4 corners a side, each with the whole picture.
    let (mut corners, mut uvs, mut indices) = (Vec::new(), Vec::new(), Vec::<u16>::new());
    for side in 0..6 {
        let (axis, sign) = (side / 2, if side % 2 == 0 { 1.0 } else { -1.0 });
        for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            let mut p = [0f32; 3];
            p[axis] = sign;
            p[(axis + 1) % 3] = u * sign;
            p[(axis + 2) % 3] = v;
            corners.push([p[0], p[1] * 0.6, p[2] * 0.3]);
            uvs.push([u / 2.0 + 0.5, 0.5 - v / 2.0]);
        }
        indices.extend([0, 1, 2, 0, 2, 3].map(|i| 4 * side as u16 + i));
    }
    let rows = |all: &[[f32; 3]]| all.to_vec();
    let brick = glb.floats(&rows(&corners).iter().map(|r| &r[..]).collect::<Vec<_>>(), VERTICES);
    let places = glb.floats(&uvs.iter().map(|r| &r[..]).collect::<Vec<_>>(), VERTICES);
    let faces = glb.indices(&indices);
    let square = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]];
    let square = glb.floats(&square.each_ref().map(|r| &r[..]), VERTICES);
    let wide = [[-0.5, 2.25], [1.75, 2.25], [1.75, -0.5], [-0.5, -0.5]];
    let wide = glb.floats(&wide.each_ref().map(|r| &r[..]), VERTICES);
    let whole = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    let whole = glb.floats(&whole.each_ref().map(|r| &r[..]), VERTICES);
    let colours: [[f32; 4]; 4] =
        [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0], [1.0, 1.0, 0.0, 1.0]];
    let colours = glb.floats(&colours.each_ref().map(|r| &r[..]), VERTICES);
    let strip = glb.indices(&[0, 1, 3, 2]);
    let fan = glb.indices(&[0, 1, 2, 3]);
    let copies: [[f32; 3]; 3] = [[-2.5, -2.0, 0.0], [0.0, -2.0, 1.0], [2.5, -2.0, -1.0]];
    let copies = glb.floats(&copies.each_ref().map(|r| &r[..]), None);
    let textured = |texture: u32, more: serde_json::Value| {
        let mut map = json!({"index": texture});
        if !more.is_null() {
            map["extensions"] = json!({"KHR_texture_transform": more});
        }
        json!({"pbrMetallicRoughness": {"baseColorTexture": map}})
    };
    let mut masked = textured(1, json!(null));
    masked["alphaMode"] = "MASK".into();
    masked["doubleSided"] = true.into();
    let mut mixed = textured(2, json!({"offset": [0.25, 0.5], "rotation": 0.7, "scale": [2, 0.5]}));
    mixed["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.4, 1, 0.6, 1]);
    let glass = |alpha: f64| {
        json!({"alphaMode": "BLEND", "doubleSided": true,
        "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.9, alpha]}})
    };
    let quad = |uv: usize, indices: usize, mode: u32, material: u32| json!({"attributes": {"POSITION": square, "TEXCOORD_0": uv}, "indices": indices, "mode": mode, "material": material});
    let root = json!({
        "extensionsUsed": ["KHR_texture_transform", "EXT_mesh_gpu_instancing"],
        "scene": 0, "scenes": [{"nodes": [0, 2, 3, 4, 5, 6, 7, 8]}],
        "nodes": [
            {"children": [1], "rotation": [0.18257419, 0.36514837, 0.54772256, 0.73029674], "translation": [0, 2, 0]},
            {"mesh": 0, "scale": [-1.2, 0.9, 1.1], "translation": [0.3, 0, 0]},
            {"mesh": 1, "translation": [3, 0.2, 0.5]},
            {"mesh": 2, "translation": [-3, 0.2, 0.5], "rotation": [0, 0.38268343, 0, 0.92387953]},
            {"mesh": 3, "translation": [0, 0, 3], "scale": [1, -1, 1]},
            {"mesh": 4, "translation": [0, 0, -3], "rotation": [0.6, 0, 0, 0.8]},
            {"mesh": 5, "translation": [3, 2.6, -1.5]},
            {"mesh": 6, "translation": [-3, 2.6, -1.5]},
            {"mesh": 7, "scale": [0.5, 0.5, 0.5],
                "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": copies}}}}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": brick, "TEXCOORD_0": places}, "indices": faces, "material": 0}]},
            {"primitives": [quad(wide, strip, 5, 1)]},
            {"primitives": [quad(wide, fan, 6, 2)]},
            {"primitives": [quad(whole, fan, 6, 0)]},
            {"primitives": [{"attributes": {"POSITION": square, "COLOR_0": colours}, "indices": fan, "mode": 6, "material": 5}]},
            {"primitives": [quad(whole, fan, 6, 3)]},
            {"primitives": [quad(whole, fan, 6, 4)]},
            {"primitives": [{"attributes": {"POSITION": brick, "TEXCOORD_0": places}, "indices": faces, "material": 2}]}],
        "materials": [textured(0, json!(null)), masked, mixed, glass(0.7), glass(0.3), {"doubleSided": true}],
        "textures": [{"source": 0, "sampler": 0}, {"source": 0, "sampler": 1}, {"source": 0, "sampler": 2}],
        "samplers": [{"wrapS": 33071, "wrapT": 33071, "minFilter": 9987}, {"wrapS": 10497, "wrapT": 33648, "minFilter": 9987},
            {"wrapS": 33648, "wrapT": 10497, "magFilter": 9728, "minFilter": 9984}],
        "images": [{"bufferView": image, "mimeType": "image/png"}],
    });
    glb.finish(root)
}
