//! GLB of a mesh with looks: materials and pictures as they came, colours, normals and picture places of vertices.
//!
//! A feature is a node of its name, its triangles a primitive for each part of the mesh. Pictures are not touched, so
//! WebP comes by EXT_texture_webp. Where the mesh has attributes, features come by EXT_mesh_features as well, with their
//! table. Parts without a material get a quiet one, seen from both sides, for glTF's own default is a mirror.
//! What `read-mesh` makes of the file is the mesh again, but for triangles of a feature that stood apart.
//! Source: glTF 2.0 sections 3.7 to 3.9; EXT_texture_webp.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use super::{Builder, Written, quiet_colour, table};
use crate::artifact::mesh::{Alpha, Material, Texture, Wrap};
use crate::artifact::{Column, Mesh, Values};

/// The file. Told is what a file cannot hold: numbers that are none, normals of a part of a triangle's corners.
pub fn glb(mesh: &Mesh, origin: [f64; 3]) -> Written {
    let mut out = Painter { mesh, origin, file: Builder::default(), looks: Looks::default(), odd: 0 };
    let (runs, half_normals) = runs(mesh);
    let features = mesh.feature_ids.len() as u32;
    let metadata = match mesh.attributes.columns.is_empty() {
        true => None,
        false => {
            let ids = Values::Text(mesh.feature_ids.clone());
            let own = [Column { name: "id".into(), values: ids, present: vec![true; features as usize] }];
            table::write(&mut out.file, features as usize, &own, &mesh.attributes.columns)
        }
    };
    let (mut nodes, mut meshes) = (Vec::new(), Vec::new());
    for feature in 0..features {
        let mut node = json!({ "name": mesh.feature_ids.get(feature as usize) });
        let own = runs.range((feature, 0, false)..(feature + 1, 0, false));
        let primitives: Vec<Value> = own
            .map(|(&(_, part, bare), triangles)| out.primitive(part, !bare, triangles, metadata.is_some()))
            .collect();
        if !primitives.is_empty() {
            node["mesh"] = json!(meshes.len());
            meshes.push(json!({ "primitives": primitives }));
            if origin != [0.0; 3] {
                node["translation"] = json!([origin[0], origin[2], 0.0 - origin[1]]);
            }
        }
        nodes.push(node);
    }
    let mut told = Vec::new();
    if out.odd > 0 {
        told.push(format!("{} numbers of picture places, colours or normals are none; 0 is written", out.odd));
    }
    if out.looks.beyond > 0 {
        told.push(format!(
            "{} numbers of base colours are not between 0 and 1; the nearest is written",
            out.looks.beyond
        ));
    }
    if half_normals > 0 {
        told.push(format!("{half_normals} triangles have normals at some corners only; they are written without"));
    }
    Written { bytes: out.finish(nodes, meshes, metadata), told }
}

/// Triangles by feature, part, and whether they go without normals; and how many lose some.
fn runs(mesh: &Mesh) -> (BTreeMap<(u32, u32, bool), Vec<[u32; 3]>>, usize) {
    let normals = &mesh.surface.normals;
    let has = |v: &u32| normals.get(*v as usize).is_some_and(|n| *n != [0.0; 3]);
    let (mut out, mut half) = (BTreeMap::<_, Vec<_>>::new(), 0);
    for (part, primitive) in mesh.primitives.iter().enumerate() {
        let first = primitive.first_triangle as usize;
        for t in &mesh.triangles[first..first + primitive.triangles as usize] {
            let with = t.iter().filter(|v| has(v)).count();
            half += usize::from(with == 1 || with == 2);
            out.entry((mesh.features[t[0] as usize], part as u32, with < 3)).or_default().push(*t);
        }
    }
    (out, half)
}

struct Painter<'a> {
    mesh: &'a Mesh,
    origin: [f64; 3],
    file: Builder<'a>,
    looks: Looks,
    /// Numbers that are none.
    odd: usize,
}

impl Painter<'_> {
    fn primitive(&mut self, part: u32, normals: bool, triangles: &[[u32; 3]], features: bool) -> Value {
        let (mesh, of) = (self.mesh, &self.mesh.primitives[part as usize]);
        // Vertices in the mesh's order: what is read back is numbered alike.
        let mut vertices: Vec<u32> = triangles.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let number = |v: u32| vertices.binary_search(&v).expect("it is one of them") as u32;
        let corners: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(number)).collect();

        let surface = &mesh.surface;
        let up = |[x, y, z]: [f32; 3]| [x, z, 0.0 - y];
        let place = |&v: &u32| {
            let p = mesh.positions[v as usize];
            up([0, 1, 2].map(|k| (p[k] - self.origin[k]) as f32))
        };
        let positions: Vec<[f32; 3]> = vertices.iter().map(place).collect();
        let mut attributes = Map::new();
        let at = self.floats(&positions, true);
        attributes.insert("POSITION".into(), json!(at));
        let of_all = |i: &u32| *i as usize;
        if normals {
            let all: Vec<[f32; 3]> = vertices.iter().map(|v| up(surface.normals[of_all(v)])).collect();
            attributes.insert("NORMAL".into(), json!(self.floats(&all, false)));
        }
        let textured = of.material.is_some_and(|m| surface.materials[m as usize].texture.is_some());
        if let Some(all) = picked(&surface.uvs, &vertices)
            && (textured || all.iter().any(|uv| *uv != [0.0; 2]))
        {
            attributes.insert("TEXCOORD_0".into(), json!(self.floats(&all, false)));
        }
        let colours = picked(&surface.colours, &vertices).filter(|all| all.iter().any(|c| *c != [1.0; 4]));
        let coloured = colours.is_some();
        if let Some(all) = colours {
            attributes.insert("COLOR_0".into(), json!(self.floats(&all, false)));
        }
        let mut out = json!({ "mode": 4 });
        if features {
            let wide = mesh.feature_ids.len() > 1 << 16;
            let number = |&v: &u32| mesh.features[v as usize];
            let at = match wide {
                true => self.floats(&vertices.iter().map(|v| [number(v) as f32]).collect::<Vec<_>>(), false),
                false => self.shorts(&vertices.iter().map(number).collect::<Vec<_>>()),
            };
            attributes.insert("_FEATURE_ID_0".into(), json!(at));
            let ids = json!([{ "featureCount": mesh.feature_ids.len(), "attribute": 0, "propertyTable": 0 }]);
            out["extensions"] = json!({ "EXT_mesh_features": { "featureIds": ids } });
        }
        out["attributes"] = Value::Object(attributes);
        out["indices"] = json!(self.file.corners(&corners, vertices.len()));
        let (material, name) = self.looks.material(mesh, of.material, &of.name, coloured);
        out["material"] = json!(material);
        if name != of.name {
            out["extras"] = json!({ "name": of.name });
        }
        out
    }

    /// An accessor of floats; a number that is none becomes 0.
    fn floats<const N: usize>(&mut self, all: &[[f32; N]], bounded: bool) -> usize {
        self.odd += all.as_flattened().iter().filter(|v| !v.is_finite()).count();
        let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
        let all: Vec<[f32; N]> = all.iter().map(|v| v.map(finite)).collect();
        self.file.vectors(&all, bounded)
    }

    /// An accessor of numbers below 2^16, each in four bytes, for alignment.
    fn shorts(&mut self, all: &[u32]) -> usize {
        let bytes: Vec<u8> = all.iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.file.view(&[("byteStride", 4), ("target", 34962)], bytes);
        let accessor = json!({ "bufferView": view, "componentType": 5123, "count": all.len(), "type": "SCALAR" });
        self.file.accessors.push(accessor);
        self.file.accessors.len() - 1
    }

    fn finish(mut self, nodes: Vec<Value>, meshes: Vec<Value>, metadata: Option<Value>) -> Vec<u8> {
        let surface = &self.mesh.surface;
        let mut images = Vec::new();
        for i in 0..surface.images.len() {
            let view = self.file.view(&[], surface.images.image(i));
            images.push(json!({ "bufferView": view, "mimeType": surface.images.types.get(i) }));
        }
        let Looks { materials, mut textures, texture_of, samplers, .. } = self.looks;
        let mut webp = false;
        for (texture, of) in textures.iter_mut().zip(texture_of) {
            if surface.images.types.get(of.image as usize) == "image/webp" {
                *texture = json!({
                    "sampler": texture["sampler"],
                    "extensions": { "EXT_texture_webp": { "source": of.image } },
                });
                webp = true;
            }
        }
        let mut root = Map::new();
        root.insert("asset".into(), json!({ "version": "2.0", "generator": "lodge" }));
        let mut used = Vec::new();
        if let Some(metadata) = metadata {
            used.extend(["EXT_mesh_features", "EXT_structural_metadata"]);
            root.insert("extensions".into(), json!({ "EXT_structural_metadata": metadata }));
        }
        if webp {
            used.push("EXT_texture_webp");
            root.insert("extensionsRequired".into(), json!(["EXT_texture_webp"]));
        }
        if !nodes.is_empty() {
            root.insert("scene".into(), json!(0));
            root.insert("scenes".into(), json!([{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }]));
        }
        let used = used.into_iter().map(Value::from).collect();
        for (key, list) in [
            ("extensionsUsed", used),
            ("nodes", nodes),
            ("meshes", meshes),
            ("materials", materials),
            ("textures", textures),
            ("samplers", samplers),
            ("images", images),
            ("accessors", std::mem::take(&mut self.file.accessors)),
            ("bufferViews", self.file.views.clone()),
        ] {
            if !list.is_empty() {
                root.insert(key.into(), Value::Array(list));
            }
        }
        self.file.finish(root)
    }
}

/// Those of some vertices, where there are any.
fn picked<T: Copy>(all: &[T], vertices: &[u32]) -> Option<Vec<T>> {
    (!all.is_empty()).then(|| vertices.iter().map(|&v| all[v as usize]).collect())
}

/// Materials of the mesh as they are met, and what they need.
#[derive(Default)]
struct Looks {
    /// Material of the mesh, or name and whether vertices bring the colour; its number and name here.
    known: Vec<(Option<u32>, String, bool, usize)>,
    materials: Vec<Value>,
    textures: Vec<Value>,
    texture_of: Vec<Texture>,
    samplers: Vec<Value>,
    /// Numbers of base colours that are not between 0 and 1.
    beyond: usize,
}

impl Looks {
    /// Number and name of a part's material.
    fn material(&mut self, mesh: &Mesh, material: Option<u32>, part: &str, coloured: bool) -> (usize, String) {
        let own = material.map(|m| &mesh.surface.materials[m as usize]);
        let name = own.map_or(part, |m| &m.name);
        let same = |k: &&(Option<u32>, String, bool, usize)| {
            k.0 == material && (material.is_some() || k.1 == name && k.2 == coloured)
        };
        if let Some((_, name, _, number)) = self.known.iter().find(same) {
            return (*number, name.clone());
        }
        let quiet = || {
            let [r, g, b] = if coloured { [1.0; 3] } else { quiet_colour(part) };
            let base_colour = [r, g, b, 1.0];
            Material { name: part.into(), base_colour, double_sided: true, ..Material::default() }
        };
        let value = self.value(&own.cloned().unwrap_or_else(quiet));
        self.materials.push(value);
        let number = self.materials.len() - 1;
        self.known.push((material, name.to_string(), coloured, number));
        (number, name.to_string())
    }

    fn value(&mut self, of: &Material) -> Value {
        let mut base = json!({ "metallicFactor": 0.0, "roughnessFactor": 1.0 });
        if of.base_colour != [1.0; 4] {
            // Some writers round beyond 1.
            self.beyond += of.base_colour.iter().filter(|c| !(0.0..=1.0).contains(*c)).count();
            base["baseColorFactor"] = json!(of.base_colour.map(|c| if c > 0.0 { f64::from(c.min(1.0)) } else { 0.0 }));
        }
        if let Some(texture) = of.texture {
            base["baseColorTexture"] = json!({ "index": self.number(texture) });
        }
        let mut out = json!({ "name": of.name, "pbrMetallicRoughness": base });
        match of.alpha {
            Alpha::Opaque => {}
            Alpha::Mask(cutoff) => {
                out["alphaMode"] = json!("MASK");
                out["alphaCutoff"] = json!(f64::from(cutoff));
            }
            Alpha::Blend => out["alphaMode"] = json!("BLEND"),
        }
        if of.double_sided {
            out["doubleSided"] = json!(true);
        }
        out
    }

    fn number(&mut self, of: Texture) -> usize {
        self.texture_of.iter().position(|t| *t == of).unwrap_or_else(|| {
            let code = |w: Wrap| match w {
                Wrap::Repeat => 10497,
                Wrap::Mirror => 33648,
                Wrap::Clamp => 33071,
            };
            // Smooth ones with smaller copies.
            let [mag, min] = if of.nearest { [9728, 9728] } else { [9729, 9987] };
            let sampler =
                json!({ "magFilter": mag, "minFilter": min, "wrapS": code(of.wrap[0]), "wrapT": code(of.wrap[1]) });
            let at = self.samplers.iter().position(|s| *s == sampler).unwrap_or_else(|| {
                self.samplers.push(sampler);
                self.samplers.len() - 1
            });
            self.textures.push(json!({ "sampler": at, "source": of.image }));
            self.texture_of.push(of);
            self.textures.len() - 1
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::Attributes;
    use crate::artifact::mesh::{Images, Primitive, Surface};
    use crate::diag::Report;
    use crate::geom::frame::Frame;
    use crate::io::ledger::Ledger;
    use crate::io::mesh::{self, Files};

    fn read(bytes: &[u8]) -> Mesh {
        let report = Report::default();
        let files = Files { name: "a.glb", bytes, beside: &|_| None, warn: &|w| panic!("{w}") };
        mesh::read(&files, None, &mut Ledger::new(&report)).unwrap()
    }

    const PNG: &[u8] = b"\x89PNG\r\n\x1a\n any";
    const WEBP: &[u8] = b"RIFF....WEBP any";

    /// Two features of three triangles, each of another material; all that a mesh can hold.
    fn all() -> Mesh {
        let mut images = Images::default();
        images.push("image/png", PNG);
        images.push("image/webp", WEBP);
        let texture = |image, wrap, nearest| Some(Texture { image, wrap, nearest });
        let material =
            |name: &str, texture, alpha| Material { name: name.into(), texture, alpha, ..Material::default() };
        let materials = vec![
            Material {
                base_colour: [0.1, 0.2, 0.3, 0.4],
                double_sided: true,
                ..material("paint", texture(0, [Wrap::Mirror, Wrap::Clamp], true), Alpha::Mask(0.3))
            },
            material("leaf", texture(1, [Wrap::Repeat; 2], false), Alpha::Blend),
            material("bare", None, Alpha::Opaque),
        ];
        let part = |name: &str, first_triangle, triangles, material| Primitive {
            name: name.into(),
            first_triangle,
            triangles,
            material: Some(material),
        };
        let corner = |i: u32| [1000.5 + f64::from(i), f64::from(i * i % 7), f64::from(i % 4) + 0.25];
        Mesh {
            frame: Frame::local(),
            positions: (0..9).map(corner).collect(),
            triangles: vec![[0, 1, 2], [5, 4, 3], [6, 7, 8]],
            features: vec![0, 0, 0, 0, 0, 0, 1, 1, 1],
            primitives: vec![part("paint", 0, 1, 0), part("leaf", 1, 1, 1), part("bare", 2, 1, 2)],
            feature_ids: ["a", "ü 17"].into_iter().collect(),
            attributes: Default::default(),
            surface: Surface {
                normals: (0..9).map(|i| if i < 3 { [0.0, 0.6, 0.8] } else { [0.0; 3] }).collect(),
                uvs: (0..9).map(|i| if i < 6 { [i as f32 * 0.3, -0.7] } else { [0.0; 2] }).collect(),
                colours: (0..9).map(|i| if i < 6 { [1.0; 4] } else { [0.1 * i as f32, 0.5, 0.25, 1.0] }).collect(),
                materials,
                images,
            },
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let mesh = all();
        let written = super::super::mesh(&mesh).unwrap();
        assert_eq!(written.told, [""; 0]);
        let mut back = read(&written.bytes);
        for (a, b) in back.surface.normals.iter_mut().zip(&mesh.surface.normals) {
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-6), "{a:?} {b:?}");
            *a = *b;
        }
        assert_eq!(back, mesh);
        let text = String::from_utf8_lossy(&written.bytes);
        assert!(text.contains(r#""extensionsRequired":["EXT_texture_webp"]"#));
        // With attributes as well; a part of another name than its material keeps it.
        let columns =
            vec![Column { name: "floors".into(), values: Values::U32(vec![3, 0]), present: vec![true, false] }];
        let mut named = Mesh { attributes: Attributes { columns }, ..all() };
        named.primitives[2].name = "roof".into();
        let written = super::super::mesh(&named).unwrap().bytes;
        let json: Value = serde_json::from_slice(&gltf::Glb::from_slice(&written).unwrap().json).unwrap();
        assert_eq!(json["meshes"][1]["primitives"][0]["extras"]["name"], "roof");
        assert_eq!(json["extensions"]["EXT_structural_metadata"]["propertyTables"][0]["count"], 2);
        assert_eq!(read(&written).triangles, named.triangles);
    }

    #[test]
    fn the_pavilion_there_and_back() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/pavilion/pavilion.glb");
        let first = read(&std::fs::read(file).unwrap());
        let once = read(&super::super::mesh(&first).unwrap().bytes);
        assert_eq!(once.triangles, first.triangles);
        assert_eq!(
            (&once.primitives, &once.features, &once.feature_ids),
            (&first.primitives, &first.features, &first.feature_ids)
        );
        assert_eq!((&once.surface.uvs, &once.surface.images), (&first.surface.uvs, &first.surface.images));
        assert_eq!(once.surface.materials, first.surface.materials);
        // Turned nodes give places that f32 has not; what it has stays.
        let near = |a: &[f64; 3], b: &[f64; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-6);
        assert!(once.positions.iter().zip(&first.positions).all(|(a, b)| near(a, b)));
        assert_eq!(read(&super::super::mesh(&once).unwrap().bytes).positions, once.positions);
    }

    fn material(name: &str, base_colour: [f32; 4]) -> Material {
        Material { name: name.into(), base_colour, ..Material::default() }
    }

    #[test]
    fn without_materials_and_with_odd_numbers() {
        let mut mesh = all();
        mesh.surface = Surface { colours: mesh.surface.colours, normals: mesh.surface.normals, ..Surface::default() };
        mesh.primitives.iter_mut().for_each(|p| p.material = None);
        mesh.surface.normals[1] = [0.0; 3];
        mesh.surface.colours[7][2] = f32::NAN;
        mesh.surface.materials = vec![material("paint", [1.000_000_1, 0.5, 0.5, 1.0])];
        mesh.primitives[0].material = Some(0);
        let written = super::super::mesh(&mesh).unwrap();
        assert_eq!(written.told.len(), 3, "{:?}", written.told);
        let back = read(&written.bytes);
        assert_eq!(back.triangles.len(), 3);
        let looks: Vec<_> =
            back.surface.materials.iter().map(|m| (&*m.name, m.base_colour[0], m.double_sided)).collect();
        assert_eq!(looks, [("paint", 1.0, false), ("leaf", 0.6, true), ("bare", 1.0, true)]);
        // Nothing at all is a file too.
        mesh.triangles.clear();
        mesh.primitives.clear();
        gltf::Gltf::from_slice_without_validation(&super::super::mesh(&mesh).unwrap().bytes).unwrap();
    }
}
