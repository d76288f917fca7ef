//! Mesh: triangles with a feature number per vertex.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{Artifact, Attributes, Kind, Strings};
use crate::geom::frame::Frame;

/// A run of triangles with one meaning.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Primitive {
    /// `"wall"`, `"roof"`, `"ground"`, or a name of the source.
    pub name: String,
    pub first_triangle: u32,
    pub triangles: u32,
}

crate::json_field!(Vec<Primitive>);

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
    }
}

impl Artifact for Mesh {
    const KIND: &'static Kind = &Kind::of::<Self>("Mesh", "triangles with a feature number per vertex").keys(&[
        ("vertices", "points of all triangles"),
        ("triangles", "number of triangles"),
        ("features", "number of features"),
        ("<part>_triangles", "triangles of each part: wall, roof, ground, ..."),
        ("bounds_m", "least and greatest x, y, z in the local frame"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for p in &self.positions {
            for k in 0..3 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        let mut out = Map::new();
        out.insert("vertices".into(), json!(self.positions.len()));
        out.insert("triangles".into(), json!(self.triangles.len()));
        out.insert("features".into(), json!(self.feature_ids.len()));
        for p in &self.primitives {
            out.insert(format!("{}_triangles", p.name), json!(p.triangles));
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
