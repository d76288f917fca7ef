//! Mesh: triangles with a feature number per vertex.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{Artifact, Attributes, Kind, Strings};
use crate::geom::frame::Frame;
use crate::geom::space::bounds;

/// A run of triangles with one meaning and one material.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Primitive {
    /// `"wall"`, `"roof"`, `"ground"`, or a name of the source.
    pub name: String,
    pub first_triangle: u32,
    pub triangles: u32,
    /// A number of [`Surface::materials`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<u32>,
}

/// What a surface looks like, in glTF's terms: base colour only.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    pub name: String,
    /// Linear red, green, blue, alpha; times the texture, times the vertices' colours.
    pub base_colour: [f32; 4],
    pub texture: Option<Texture>,
    pub alpha: Alpha,
    pub double_sided: bool,
}

impl Default for Material {
    fn default() -> Self {
        let (name, texture) = (String::new(), None);
        Self { name, base_colour: [1.0; 4], texture, alpha: Alpha::Opaque, double_sided: false }
    }
}

/// An image, and how it goes on beyond its edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Texture {
    /// A number of [`Surface::images`].
    pub image: u32,
    pub wrap: [Wrap; 2],
    /// The nearest texel instead of a mix of four.
    pub nearest: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wrap {
    #[default]
    Repeat,
    Mirror,
    Clamp,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Alpha {
    #[default]
    Opaque,
    /// Drawn where alpha is at least this.
    Mask(f32),
    Blend,
}

crate::json_field!(Vec<Primitive>, Vec<Material>);

crate::columns! {
    /// Files as they came: PNG, JPEG or WebP.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct Images {
        /// What each is: `image/png`, `image/jpeg`, `image/webp`.
        pub types: Strings,
        /// Ends of the files in `bytes`.
        pub ends: Vec<u64>,
        pub bytes: Vec<u8>,
    }
}

impl Images {
    pub fn len(&self) -> usize {
        self.ends.len()
    }
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }
    pub fn push(&mut self, media_type: &str, bytes: &[u8]) {
        self.types.push(media_type);
        self.bytes.extend_from_slice(bytes);
        self.ends.push(self.bytes.len() as u64);
    }
    pub fn image(&self, i: usize) -> &[u8] {
        let first = if i == 0 { 0 } else { self.ends[i - 1] };
        &self.bytes[first as usize..self.ends[i] as usize]
    }
}

crate::columns! {
    /// Looks of a mesh; nothing of it where a mesh has none.
    #[derive(Clone, Debug, Default, PartialEq)]
    pub struct Surface {
        /// Unit normal of each vertex, 0, 0, 0 where the source has none; or empty: flat.
        pub normals: Vec<[f32; 3]>,
        /// Place of each vertex in its material's texture, u right, v down, or none.
        pub uvs: Vec<[f32; 2]>,
        /// Linear colour of each vertex with alpha, or none: white.
        pub colours: Vec<[f32; 4]>,
        pub materials: Vec<Material>,
        pub images: Images,
    }
}

crate::columns! {
    /// Triangles, counter-clockwise seen from outside; metres, z up, local frame.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Mesh {
        pub frame: Frame,
        pub positions: Vec<[f64; 3]>,
        pub triangles: Vec<[u32; 3]>,
        /// Feature of each vertex.
        pub features: Vec<u32>,
        pub primitives: Vec<Primitive>,
        /// Names of the features (ids, or `cluster-17`).
        pub feature_ids: Strings,
        /// Attributes of the features.
        pub attributes: Attributes,
        pub surface: Surface,
    }
}

impl Mesh {
    /// Places of a triangle's corners.
    pub fn corners(&self, triangle: usize) -> [[f64; 3]; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }
}

impl Artifact for Mesh {
    const KIND: &'static Kind = &Kind::of::<Self>("Mesh", "triangles with a feature number per vertex").keys(&[
        ("vertices", "points of all triangles"),
        ("triangles", "number of triangles"),
        ("features", "number of features"),
        ("materials", "number of materials, where there are any"),
        ("images", "number of images, where there are any"),
        ("<part>_triangles", "triangles of each part: wall, roof, ground, ..."),
        ("bounds_m", "least and greatest x, y, z in the local frame"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let (low, high) = bounds(self.positions.iter().copied());
        let mut out = Map::new();
        out.insert("vertices".into(), json!(self.positions.len()));
        out.insert("triangles".into(), json!(self.triangles.len()));
        out.insert("features".into(), json!(self.feature_ids.len()));
        if !self.surface.materials.is_empty() {
            out.insert("materials".into(), json!(self.surface.materials.len()));
            out.insert("images".into(), json!(self.surface.images.len()));
        }
        for name in ["wall", "roof", "ground"] {
            let all = self.primitives.iter().filter(|p| p.name == name);
            if let Some(count) = all.map(|p| p.triangles).reduce(|a, b| a + b) {
                out.insert(format!("{name}_triangles"), json!(count));
            }
        }
        if !self.positions.is_empty() {
            out.insert("bounds_m".into(), json!([low, high]));
        }
        out
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
