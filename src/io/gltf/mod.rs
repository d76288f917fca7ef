//! GLB: triangles with a feature number on every vertex and a table of the features.
//!
//! Out:    glTF 2.0 binary; y up, metres; features by EXT_mesh_features, their table by EXT_structural_metadata,
//!         normals as normalised bytes by KHR_mesh_quantization. The same parts give the same bytes.
//! Source: glTF 2.0 sections 3.7 and 4.4, the three extensions' pages.

pub mod impostors;
pub mod painted;
pub mod table;

use std::borrow::Cow;

use serde_json::{Map, Value, json};

use crate::artifact::{Column, Mesh, Values};
use crate::diag::{Diagnostic, Result};
use crate::geom::space::bounds;

/// Triangles of one material.
#[derive(Clone, Debug, Default)]
pub struct Part {
    /// `"wall"`, `"roof"`, `"ground"`, or what the source calls it.
    pub name: String,
    pub vertices: Vec<Vertex>,
    pub triangles: Vec<[u32; 3]>,
}

/// A corner as it lies in the file: y up.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct Vertex {
    position: [f32; 3],
    /// Times 127, and a gap. Left out of the file where the model has none.
    normal: [i8; 4],
    /// Below 2^16 features its lower half is the number as u16, and the file says so.
    feature: u32,
}

impl Vertex {
    /// A corner by its place and its normal times 127, z up.
    #[inline]
    pub fn new([x, y, z]: [f32; 3], [i, j, k]: [i8; 3], feature: u32) -> Self {
        Self { position: [x, z, 0.0 - y], normal: [i, k, -j, 0], feature }
    }

    /// Its place, z up.
    #[inline]
    pub fn position(&self) -> [f32; 3] {
        let [x, y, z] = self.position;
        [x, 0.0 - z, y]
    }
}

/// What becomes of a GLB.
#[derive(Clone, Debug, Default)]
pub struct Model<'a> {
    pub parts: &'a [Part],
    /// Without normals viewers shade each triangle flat.
    pub normals: bool,
    /// Features, numbered from 0.
    pub features: usize,
    /// One value for each feature, without gaps.
    pub own: &'a [Column],
    /// What the source says of each feature, with gaps.
    pub attributes: &'a [Column],
    /// Where the model stands, z up, metres.
    pub origin: [f64; 3],
}

/// The model as a file. Parts without triangles are left out; a model without any has a table only.
pub fn glb(model: &Model) -> Vec<u8> {
    let mut file = Builder::default();
    let wide = model.features > 1 << 16;
    let ids = match model.features {
        0 => json!({}),
        n => json!({ "EXT_mesh_features": { "featureIds": [
            { "featureCount": n, "attribute": 0, "propertyTable": 0 }
        ] } }),
    };
    let mut primitives = Vec::new();
    let mut materials = Vec::new();
    for part in model.parts.iter().filter(|p| !p.triangles.is_empty()) {
        let attributes = file.vertices(part, model.normals, wide);
        primitives.push(json!({
            "attributes": attributes,
            "indices": file.triangles(part),
            "material": materials.len(),
            "mode": 4,
            "extensions": ids,
        }));
        materials.push(material(&part.name));
    }
    let metadata = table::write(&mut file, model.features, model.own, model.attributes);
    let mut root = Map::new();
    root.insert("asset".into(), json!({ "version": "2.0", "generator": "lodge" }));
    if !primitives.is_empty() {
        let mut node = json!({ "mesh": 0 });
        if model.origin != [0.0; 3] {
            let [x, y, z] = model.origin;
            node["translation"] = json!([x, z, 0.0 - y]);
        }
        root.insert("scene".into(), json!(0));
        root.insert("scenes".into(), json!([{ "nodes": [0] }]));
        root.insert("nodes".into(), json!([node]));
        root.insert("meshes".into(), json!([{ "primitives": primitives }]));
        root.insert("materials".into(), json!(materials));
        root.insert("accessors".into(), json!(file.accessors));
    }
    let drawn = !primitives.is_empty();
    let used: Vec<&str> = [
        (drawn && model.features > 0, "EXT_mesh_features"),
        (metadata.is_some(), "EXT_structural_metadata"),
        (drawn && model.normals, "KHR_mesh_quantization"),
    ]
    .into_iter()
    .filter_map(|(used, name)| used.then_some(name))
    .collect();
    if used.last() == Some(&"KHR_mesh_quantization") {
        root.insert("extensionsRequired".into(), json!(["KHR_mesh_quantization"]));
    }
    if !used.is_empty() {
        root.insert("extensionsUsed".into(), json!(used));
    }
    if let Some(metadata) = metadata {
        root.insert("extensions".into(), json!({ "EXT_structural_metadata": metadata }));
    }
    root.insert("bufferViews".into(), json!(file.views));
    file.finish(root)
}

/// The parts' quiet colours; roofs lighter than walls, so that blocks read from above.
fn quiet_colour(name: &str) -> [f32; 3] {
    match name {
        "roof" => [0.72, 0.68, 0.62],
        "ground" => [0.36, 0.36, 0.36],
        "wall" => [0.52, 0.50, 0.47],
        _ => [0.60, 0.60, 0.60],
    }
}

fn material(name: &str) -> Value {
    // The shortest text of each.
    let colour = quiet_colour(name).map(|c| (f64::from(c) * 100.0).round() / 100.0);
    json!({
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [colour[0], colour[1], colour[2], 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0,
        },
    })
}

/// Buffer views and accessors as they come, over one buffer whose pieces are joined at the end.
#[derive(Default)]
pub struct Builder<'a> {
    pieces: Vec<Cow<'a, [u8]>>,
    size: usize,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl<'a> Builder<'a> {
    /// A buffer view over `bytes`, from a multiple of 8.
    fn view(&mut self, more: &[(&str, u32)], bytes: impl Into<Cow<'a, [u8]>>) -> usize {
        let bytes = bytes.into();
        let mut view = Map::new();
        view.insert("buffer".into(), json!(0));
        view.insert("byteOffset".into(), json!(self.size));
        view.insert("byteLength".into(), json!(bytes.len()));
        more.iter().for_each(|&(k, v)| _ = view.insert(k.into(), json!(v)));
        let gap = bytes.len().next_multiple_of(8) - bytes.len();
        self.size += bytes.len() + gap;
        self.pieces.push(bytes);
        self.pieces.push(Cow::Borrowed(&[0; 8][..gap]));
        self.views.push(Value::Object(view));
        self.views.len() - 1
    }

    /// Corners, interleaved: position (12 bytes), normal (3 and a gap), feature (2 and a gap, or 4).
    fn vertices(&mut self, part: &'a Part, normals: bool, wide: bool) -> Value {
        let stride = if normals { 20 } else { 16 };
        let bytes: Cow<[u8]> = if normals && !wide {
            Cow::Borrowed(bytemuck::cast_slice(&part.vertices))
        } else {
            let mut out = Vec::with_capacity(part.vertices.len() * stride as usize);
            for v in &part.vertices {
                let feature = if wide { (v.feature as f32).to_bits() } else { v.feature };
                out.extend_from_slice(bytemuck::bytes_of(&v.position));
                if normals {
                    out.extend_from_slice(bytemuck::bytes_of(&v.normal));
                }
                out.extend_from_slice(&feature.to_le_bytes());
            }
            Cow::Owned(out)
        };
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for v in &part.vertices {
            for k in 0..3 {
                low[k] = low[k].min(v.position[k]);
                high[k] = high[k].max(v.position[k]);
            }
        }
        let view = self.view(&[("byteStride", stride), ("target", 34962)], bytes);
        let count = part.vertices.len();
        let mut attributes = Map::new();
        let mut accessor = |name: &str, offset: u32, kind: &str, component: u32, more: &[(&str, Value)]| {
            let mut a = Map::new();
            a.insert("bufferView".into(), json!(view));
            a.insert("byteOffset".into(), json!(offset));
            a.insert("componentType".into(), json!(component));
            a.insert("count".into(), json!(count));
            a.insert("type".into(), json!(kind));
            more.iter().for_each(|(k, v)| _ = a.insert((*k).into(), v.clone()));
            attributes.insert(name.into(), json!(self.accessors.len()));
            self.accessors.push(Value::Object(a));
        };
        let exact = |p: [f32; 3]| json!(p.map(f64::from));
        accessor("POSITION", 0, "VEC3", 5126, &[("min", exact(low)), ("max", exact(high))]);
        if normals {
            accessor("NORMAL", 12, "VEC3", 5120, &[("normalized", json!(true))]);
        }
        accessor("_FEATURE_ID_0", stride - 4, "SCALAR", if wide { 5126 } else { 5123 }, &[]);
        Value::Object(attributes)
    }

    fn triangles(&mut self, part: &'a Part) -> usize {
        let bytes = narrow(&part.triangles, part.vertices.len());
        let wide = || Cow::Borrowed(bytemuck::cast_slice(&part.triangles));
        self.indices(bytes.is_some(), 3 * part.triangles.len(), bytes.map_or_else(wide, Cow::Owned))
    }

    /// The same for triangles that do not live as long as the file.
    fn corners(&mut self, triangles: &[[u32; 3]], vertices: usize) -> usize {
        let bytes = narrow(triangles, vertices);
        let wide = || bytemuck::cast_slice(triangles).to_vec();
        self.indices(bytes.is_some(), 3 * triangles.len(), Cow::Owned(bytes.unwrap_or_else(wide)))
    }

    fn indices(&mut self, narrow: bool, count: usize, bytes: Cow<'a, [u8]>) -> usize {
        let view = self.view(&[("target", 34963)], bytes);
        self.accessors.push(json!({
            "bufferView": view, "byteOffset": 0, "componentType": if narrow { 5123 } else { 5125 },
            "count": count, "type": "SCALAR",
        }));
        self.accessors.len() - 1
    }

    /// An accessor over vectors of finite numbers; `bounded`: with their least and greatest.
    fn vectors<const N: usize>(&mut self, all: &[[f32; N]], bounded: bool) -> usize {
        let bytes = bytemuck::cast_slice::<f32, u8>(all.as_flattened()).to_vec();
        let view = self.view(&[("target", 34962)], bytes);
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        let mut accessor = json!({ "bufferView": view, "componentType": 5126, "count": all.len(), "type": kind });
        if bounded {
            let end = |f: fn(f32, f32) -> f32| {
                let least = all.iter().copied().reduce(|a, b| std::array::from_fn(|k| f(a[k], b[k])));
                least.map(|a| a.map(f64::from).to_vec())
            };
            (accessor["min"], accessor["max"]) = (json!(end(f32::min)), json!(end(f32::max)));
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Header, JSON, bytes. Both chunks begin and end at multiples of 8, as EXT_structural_metadata wants.
    fn finish(self, mut root: Map<String, Value>) -> Vec<u8> {
        if self.size == 0 {
            root.remove("bufferViews");
        } else {
            root.insert("buffers".into(), json!([{ "byteLength": self.size }]));
        }
        let mut text = serde_json::to_vec(&root).expect("JSON values can be written");
        // The second chunk's own header is 8 bytes long.
        text.resize((20 + text.len()).next_multiple_of(8) - 20, b' ');
        let total = 20 + text.len() + if self.size == 0 { 0 } else { 8 + self.size };
        let mut out = Vec::with_capacity(total);
        let word = |out: &mut Vec<u8>, v: usize| out.extend_from_slice(&(v as u32).to_le_bytes());
        out.extend_from_slice(b"glTF");
        word(&mut out, 2);
        word(&mut out, total);
        word(&mut out, text.len());
        out.extend_from_slice(b"JSON");
        out.extend_from_slice(&text);
        if self.size > 0 {
            word(&mut out, self.size);
            out.extend_from_slice(b"BIN\0");
            self.pieces.iter().for_each(|p| out.extend_from_slice(p));
        }
        out
    }
}

/// Indices in two bytes each, where they fit; 65,535 itself is the restart mark.
fn narrow(triangles: &[[u32; 3]], vertices: usize) -> Option<Vec<u8>> {
    (vertices <= 65_535).then(|| {
        let mut out = Vec::with_capacity(6 * triangles.len());
        triangles.iter().for_each(|t| out.extend_from_slice(bytemuck::bytes_of(&t.map(|i| i as u16))));
        out
    })
}

/// A file, and sentences on what of the mesh it does not hold.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Written {
    pub bytes: Vec<u8>,
    pub told: Vec<String>,
}

impl From<Vec<u8>> for Written {
    fn from(bytes: Vec<u8>) -> Self {
        Self { bytes, told: Vec::new() }
    }
}

/// A mesh as one GLB: with its looks where it has any ([`painted`]), else in quiet colours ([`plain`]). Positions are kept
/// relative to the middle of the mesh in whole kilometres; the nodes' translation puts them back.
pub fn mesh(mesh: &Mesh) -> Result<Written> {
    let (low, high) = bounds(mesh.positions.iter().copied());
    let origin = if mesh.positions.is_empty() {
        [0.0; 3]
    } else {
        [0, 1, 2].map(|k| ((low[k] + high[k]) / 2000.0).round() * 1000.0 + 0.0)
    };
    let looks = &mesh.surface;
    let bare = looks.materials.is_empty() && looks.images.is_empty();
    let written = match bare && looks.normals.is_empty() && looks.uvs.is_empty() && looks.colours.is_empty() {
        true => plain(mesh, origin).into(),
        false => painted::glb(mesh, origin),
    };
    let bytes = written.bytes.len();
    if u32::try_from(bytes).is_err() {
        return Err(Diagnostic::error("too-large", format!("a GLB holds 4 GiB, this one would be {bytes} bytes")));
    }
    Ok(written)
}

/// A primitive for each part of the mesh, the features' ids as `id`, their attributes beside them. Vertices stay shared
/// (no normals), so that what is watertight stays so.
fn plain(mesh: &Mesh, origin: [f64; 3]) -> Vec<u8> {
    let vertex = |i: u32| {
        let p = mesh.positions[i as usize];
        Vertex::new([0, 1, 2].map(|k| (p[k] - origin[k]) as f32), [0; 3], mesh.features[i as usize])
    };
    let mut place = vec![u32::MAX; mesh.positions.len()];
    let mut parts = Vec::new();
    for primitive in &mesh.primitives {
        let mut part = Part { name: primitive.name.clone(), ..Part::default() };
        let first = primitive.first_triangle as usize;
        place.fill(u32::MAX);
        for t in &mesh.triangles[first..first + primitive.triangles as usize] {
            part.triangles.push(t.map(|i| {
                if place[i as usize] == u32::MAX {
                    place[i as usize] = part.vertices.len() as u32;
                    part.vertices.push(vertex(i));
                }
                place[i as usize]
            }));
        }
        parts.push(part);
    }
    let features = mesh.feature_ids.len();
    let ids = Values::Text(mesh.feature_ids.clone());
    let own = [Column { name: "id".into(), values: ids, present: vec![true; features] }];
    let attributes = &mesh.attributes.columns;
    glb(&Model { parts: &parts, normals: false, features, own: &own, attributes, origin })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::mesh::Primitive;
    use crate::artifact::sections::{Decoder, Encoder};
    use crate::artifact::{Artifact, Attributes};
    use crate::geom::frame::Frame;

    /// A closed box of two features (walls and lids), 2.5 km from the frame's origin.
    fn block() -> Mesh {
        let corner = |i: u32| [2500.0 + f64::from(i & 1), f64::from(i >> 1 & 1) * 2.0, f64::from(i >> 2) * 3.0];
        Mesh {
            frame: Frame::local(),
            positions: (0..8).map(corner).collect(),
            triangles: vec![
                [0, 1, 5],
                [0, 5, 4],
                [1, 3, 7],
                [1, 7, 5],
                [3, 2, 6],
                [3, 6, 7],
                [2, 0, 4],
                [2, 4, 6],
                [4, 5, 7],
                [4, 7, 6],
                [0, 3, 1],
                [0, 2, 3],
            ],
            features: vec![0, 0, 0, 0, 1, 1, 1, 1],
            primitives: vec![
                Primitive { name: "wall".into(), first_triangle: 0, triangles: 8, material: None },
                Primitive { name: "roof".into(), first_triangle: 8, triangles: 2, material: None },
                Primitive { name: "ground".into(), first_triangle: 10, triangles: 2, material: None },
            ],
            feature_ids: ["a", "ü-17"].into_iter().collect(),
            attributes: Attributes {
                columns: vec![Column {
                    name: "floors".into(),
                    values: Values::U32(vec![3, 0]),
                    present: vec![true, false],
                }],
            },
            surface: Default::default(),
        }
    }

    fn json_of(bytes: &[u8]) -> (Value, Vec<u8>) {
        let glb = gltf::Glb::from_slice(bytes).unwrap();
        (serde_json::from_slice(&glb.json).unwrap(), glb.bin.map(|b| b.into_owned()).unwrap_or_default())
    }

    #[test]
    fn mesh_and_back() {
        let mesh = block();
        let bytes = super::mesh(&mesh).unwrap().bytes;
        let (json, bin) = json_of(&bytes);
        // EXT_structural_metadata: the second chunk's bytes begin at a multiple of 8.
        assert_eq!((bytes.len() - bin.len()) % 8, 0);
        assert_eq!(json["nodes"][0]["translation"], json!([3000.0, 0.0, 0.0]));
        let document = gltf::Gltf::from_slice(&bytes).unwrap().document;
        let mut corners = Vec::new();
        for p in document.meshes().flat_map(|m| m.primitives().collect::<Vec<_>>()) {
            let reader = p.reader(|_| Some(&bin));
            let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            corners.extend(reader.read_indices().unwrap().into_u32().map(|i| positions[i as usize]));
        }
        let want = mesh.triangles.iter().flatten().map(|&i| mesh.positions[i as usize]);
        let want: Vec<[f32; 3]> = want.map(|p| [p[0] as f32 - 3000.0, p[2] as f32, -p[1] as f32]).collect();
        assert_eq!(corners, want);
        let class = &json["extensions"]["EXT_structural_metadata"]["schema"]["classes"]["feature"]["properties"];
        assert_eq!(class["id"]["type"], "STRING");
        assert_eq!(class["floors"], json!({ "type": "SCALAR", "componentType": "UINT32", "noData": u32::MAX }));
        assert!(json.get("extensionsRequired").is_none(), "any reader can take it");
    }

    /// What comes out of the store is written as what was just made.
    #[test]
    fn as_from_the_store() {
        let mesh = block();
        let mut encoder = Encoder::new("Mesh");
        mesh.encode(&mut encoder);
        let bytes = encoder.to_bytes();
        let mut decoder = Decoder::new(&bytes, "Mesh").unwrap();
        let stored = <Mesh as Artifact>::decode(&mut decoder).unwrap();
        assert_eq!(super::mesh(&stored).unwrap(), super::mesh(&mesh).unwrap());
    }

    #[test]
    fn nothing_at_all_is_a_file_too() {
        let mesh = Mesh {
            positions: vec![],
            triangles: vec![],
            features: vec![],
            primitives: vec![],
            feature_ids: Default::default(),
            attributes: Default::default(),
            surface: Default::default(),
            ..block()
        };
        let (json, bin) = json_of(&super::mesh(&mesh).unwrap().bytes);
        assert!(json.get("meshes").is_none() && bin.is_empty());
        gltf::Gltf::from_slice(&super::mesh(&mesh).unwrap().bytes).unwrap();
    }

    #[test]
    fn wide_numbers() {
        // More features than u16 holds, more vertices than u16 indices reach.
        let n = 70_000u32;
        let vertices = (0..3 * n).map(|i| Vertex::new([i as f32, (i % 3) as f32, 0.0], [0, 0, 127], i / 3));
        let part = Part {
            name: "roof".into(),
            vertices: vertices.collect(),
            triangles: (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
        };
        let own = [Column { name: "n".into(), values: Values::U32((0..n).collect()), present: vec![true; n as usize] }];
        let parts = [part];
        let model =
            Model { parts: &parts, normals: true, features: n as usize, own: &own, attributes: &[], origin: [0.0; 3] };
        let (json, bin) = json_of(&glb(&model));
        let last = &json["accessors"][2];
        assert_eq!(last["componentType"], 5126);
        assert_eq!(json["accessors"][3]["componentType"], 5125);
        let at = 20 * (3 * n as usize - 1) + 16;
        assert_eq!(f32::from_le_bytes(bin[at..at + 4].try_into().unwrap()), (n - 1) as f32);
    }
}
