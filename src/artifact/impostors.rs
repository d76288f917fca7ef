//! Impostors: textured quads that stand for a mesh from afar.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::mesh::{Alpha, Images, Material, Primitive, Surface, Texture, Wrap};
use super::{Artifact, Kind, Mesh};
use crate::geom::frame::Frame;

/// What a bake is worth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct Worth {
    /// Side of a grid cell: how far off a quad may be, metres.
    pub error_m: f64,
    /// Where that is a pixel of 1080 rows and 60 degrees, metres.
    pub distance_m: f64,
    pub texels_per_cell: f64,
    /// Mean over 14 views of pixels that both draw, of those that either draws.
    pub silhouette: f64,
    /// Mean difference of a channel, 0..255.
    pub colour_error: f64,
    /// Pixels of the 14 views where no quad draws anything, more than two inside the mesh's outline.
    pub holes: u32,
    /// Share of the surface that some quad draws.
    pub drawn: f64,
    pub atlas: [u32; 2],
    /// Of the atlas' texels those that are drawn.
    pub filled: f64,
    /// Area that is drawn in four smaller copies of the atlas, of that in the atlas.
    pub coverage: [f64; 4],
    pub original_triangles: u32,
}

crate::json_field!(Worth);

crate::columns! {
    /// n quads, each two triangles seen from one side.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Impostors {
        pub frame: Frame,
        /// Four corners of each, counter-clockwise from outside.
        pub corners: Vec<[f64; 3]>,
        /// Their places in the atlas, u right, v down.
        pub uvs: Vec<[f32; 2]>,
        /// Outward normal of each quad.
        pub normals: Vec<[f32; 3]>,
        /// Right in the atlas, a unit vector of each quad.
        pub tangents: Vec<[f32; 3]>,
        /// The tile that it is a piece of.
        pub tiles: Vec<u32>,
        /// Seen from both sides, as most of what it shows.
        pub two_sided: Vec<bool>,
        /// The atlas: colour and coverage, PNG.
        pub colour: Vec<u8>,
        /// Normals along right, up and outside, PNG as large as the atlas; or empty.
        pub normal_map: Vec<u8>,
        /// 14 views of the original over those of the quads, PNG.
        pub sheet: Vec<u8>,
        pub worth: Worth,
    }
}

impl Impostors {
    pub fn len(&self) -> usize {
        self.tiles.len()
    }
    pub fn is_empty(&self) -> bool {
        self.tiles.is_empty()
    }

    /// As a mesh.
    pub fn mesh(&self) -> Mesh {
        let n = self.len() as u32;
        let mut images = Images::default();
        images.push("image/png", &self.colour);
        let texture = Some(Texture { image: 0, wrap: [Wrap::Clamp; 2], nearest: false });
        let materials = [("impostor", false), ("impostor-two-sided", true)].map(|(name, double_sided)| Material {
            name: name.into(),
            texture,
            alpha: Alpha::Mask(0.5),
            double_sided,
            ..Material::default()
        });
        let primitive = |q: u32| Primitive {
            name: "impostor".into(),
            first_triangle: 2 * q,
            triangles: 2,
            material: Some(u32::from(self.two_sided[q as usize])),
        };
        Mesh {
            frame: self.frame.clone(),
            positions: self.corners.clone(),
            triangles: (0..n).flat_map(|q| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|c| 4 * q + c))).collect(),
            features: vec![0; self.corners.len()],
            primitives: (0..n).map(primitive).collect(),
            feature_ids: ["impostor"].into_iter().collect(),
            attributes: Default::default(),
            surface: Surface {
                normals: self.normals.iter().flat_map(|&n| [n; 4]).collect(),
                uvs: self.uvs.clone(),
                colours: Vec::new(),
                materials: materials.to_vec(),
                images,
            },
        }
    }
}

impl Artifact for Impostors {
    const KIND: &'static Kind =
        &Kind::of::<Self>("Impostors", "textured quads that stand for a mesh from afar").keys(&[
            ("quads", "number of quads"),
            ("two_sided", "of these, seen from both sides"),
            ("tiles", "planes that they lie on"),
            ("original_triangles", "triangles of the mesh"),
            ("atlas_px", "width and height of the atlas"),
            ("atlas_bytes", "bytes of the atlas as PNG"),
            ("atlas_filled", "share of its texels that is drawn"),
            ("mip_coverage", "area drawn in four smaller copies of the atlas, of that in the atlas"),
            ("texels_per_cell", "texels along a grid cell"),
            ("silhouette_iou", "pixels that mesh and quads both draw, of those that either draws: mean of 14 views"),
            ("colour_error", "mean difference of a channel where either draws, 0..255"),
            (
                "hole_pixels",
                "pixels of the 14 views, more than two inside the mesh's outline, where no quad draws anything",
            ),
            ("surface_drawn", "share of the mesh's area that some quad draws"),
            ("error_m", "how far off a quad may be: a grid cell"),
            ("distance_m", "where that is one pixel of 1080 rows and 60 degrees"),
        ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut tiles = self.tiles.clone();
        tiles.dedup();
        let w = &self.worth;
        let short = |v: f64| json!((v * 1e4).round() / 1e4);
        let all = [
            ("quads", json!(self.len())),
            ("two_sided", json!(self.two_sided.iter().filter(|&&t| t).count())),
            ("tiles", json!(tiles.len())),
            ("original_triangles", json!(w.original_triangles)),
            ("atlas_px", json!(w.atlas)),
            ("atlas_bytes", json!(self.colour.len())),
            ("atlas_filled", short(w.filled)),
            ("mip_coverage", w.coverage.map(short).into_iter().collect()),
            ("texels_per_cell", short(w.texels_per_cell)),
            ("silhouette_iou", short(w.silhouette)),
            ("colour_error", short(w.colour_error)),
            ("hole_pixels", json!(w.holes)),
            ("surface_drawn", short(w.drawn)),
            ("error_m", json!(w.error_m)),
            ("distance_m", json!(w.distance_m)),
        ];
        all.into_iter().map(|(k, v)| (k.to_string(), v)).collect()
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
