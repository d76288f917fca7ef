//! Buildings: id, attributes, and surfaces for each level of detail.

use serde_json::{Map, Value, json};

use super::{Artifact, Attributes, Kind, Shapes, Strings};
use crate::geom::frame::Frame;

/// What a surface is, after CityJSON's semantics.
pub const GROUND: u8 = 0;
pub const WALL: u8 = 1;
pub const ROOF: u8 = 2;
/// Said otherwise, or not at all.
pub const OTHER: u8 = 3;

crate::columns! {
    /// n buildings. Parts belong to their building. Geometry g is one level of detail of one building: its
    /// surfaces are the polygons of shape g, each with a meaning.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Buildings {
        pub frame: Frame,
        pub ids: Strings,
        pub attributes: Attributes,
        /// n + 1 offsets into geometries; a building's levels ascend.
        pub starts: Vec<u32>,
        /// Level of detail of each geometry, as text: `"1.2"`.
        pub lods: Strings,
        /// Surfaces of each geometry; x, y, z in millimetres.
        pub surfaces: Shapes<[i32; 3]>,
        /// `GROUND`, `WALL`, `ROOF` or `OTHER` of each polygon.
        pub semantics: Vec<u8>,
    }
}

impl Buildings {
    pub fn len(&self) -> usize {
        self.ids.len()
    }
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }
    /// Geometry numbers of building `i`.
    pub fn geometries_of(&self, i: usize) -> std::ops::Range<usize> {
        self.starts[i] as usize..self.starts[i + 1] as usize
    }
}

impl Artifact for Buildings {
    const KIND: &'static Kind =
        &Kind::of::<Self>("Buildings", "surfaces of buildings for each level of detail").keys(&[
            ("buildings", "number of buildings"),
            ("geometries", "geometries of all levels of detail"),
            ("surfaces", "surfaces of all geometries"),
            ("vertices", "points of all surfaces"),
            ("lods", "number of geometries by level of detail"),
            ("bounds_m", "least x, y and greatest x, y in the local frame"),
        ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut lods = std::collections::BTreeMap::<&str, u64>::new();
        self.lods.iter().for_each(|l| *lods.entry(l).or_default() += 1);
        let plan: Vec<[i32; 2]> = self.surfaces.points.iter().map(|p| [p[0], p[1]]).collect();
        let mut out = Map::new();
        out.insert("buildings".into(), json!(self.len()));
        out.insert("geometries".into(), json!(self.lods.len()));
        out.insert("surfaces".into(), json!(self.semantics.len()));
        out.insert("vertices".into(), json!(self.surfaces.points.len()));
        out.insert("lods".into(), json!(lods));
        out.insert("bounds_m".into(), super::bounds_m(&plan));
        out
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
