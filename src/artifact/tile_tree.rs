//! TileTree: what each tile of a tileset shows, in the local frame, before any format.

use serde_json::{Map, Value, json};

use super::{Artifact, Attributes, Kind, Shapes, Strings};
use crate::geom::frame::Frame;

/// The level report: one line a depth. A `TileTree` keeps it as it was measured.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct Level {
    pub depth: u32,
    pub tiles: u32,
    pub features: u64,
    pub triangles: u64,
    /// Largest geometric error, metres.
    pub error_max: f64,
    /// Buildings over which nothing stands. Always 0.
    pub lost: u64,
    /// Share of street points (4 to 25 m from a footprint) that are built over.
    pub closed: f64,
}

crate::json_field!(Vec<Level>);

crate::columns! {
    /// Tiles, parents before children; tile 0 is the root. A tile draws the features
    /// `tile_features[t]..tile_features[t + 1]`; they cover its sources, `source_first..` + `source_count` places
    /// of the leaf order, once each (landmarks are drawn beside the cluster that counts them).
    #[derive(Clone, Debug, PartialEq)]
    pub struct TileTree {
        pub frame: Frame,
        /// `u32::MAX` for the root.
        pub parent: Vec<u32>,
        /// Geometric error, metres: monotone up the tree, 0 at leaves.
        pub error: Vec<f64>,
        /// Measured: largest sqrt(S) and largest height difference drawn here.
        pub error_negative_space: Vec<f64>,
        pub error_height: Vec<f64>,
        pub source_first: Vec<u32>,
        pub source_count: Vec<u32>,
        /// t + 1 offsets into features.
        pub tile_features: Vec<u32>,
        /// True where the content is the originals.
        pub is_leaf: Vec<bool>,

        /// Place of the feature's first source in the whole leaf order.
        pub feature_first: Vec<u32>,
        pub feature_count: Vec<u32>,
        pub landmark: Vec<bool>,
        pub footprint_area_m2: Vec<f64>,
        pub height_min: Vec<f64>,
        pub height_max: Vec<f64>,
        pub negative_space_m2: Vec<f64>,
        /// Extruded features stand between these, metres; of a feature with `solids` its lowest and highest point.
        pub base: Vec<f64>,
        pub top: Vec<f64>,
        /// Plan of each feature, to be extruded; empty where `solids` has its surfaces.
        pub plans: Shapes<[i32; 2]>,
        /// Surfaces of features that keep their own geometry (highest LoD); empty for extruded ones.
        pub solids: Shapes<[i32; 3]>,
        /// Meaning of each polygon of `solids` (`buildings::GROUND` ..).
        pub semantics: Vec<u8>,

        /// In leaf order.
        pub ids: Strings,
        pub attributes: Attributes,
        pub levels: Vec<Level>,
    }
}

impl TileTree {
    pub fn len(&self) -> usize {
        self.parent.len()
    }
    pub fn is_empty(&self) -> bool {
        self.parent.is_empty()
    }
    pub fn features_of(&self, tile: usize) -> std::ops::Range<usize> {
        self.tile_features[tile] as usize..self.tile_features[tile + 1] as usize
    }
}

impl Artifact for TileTree {
    const KIND: &'static Kind =
        &Kind::of::<Self>("TileTree", "tiles with bounds, geometric error and content").keys(&[
            ("tiles", "number of tiles"),
            ("leaf_tiles", "tiles without children"),
            ("features", "features of all tiles"),
            ("sources", "source ids"),
            ("root_error_m", "geometric error of the root"),
            (
                "levels",
                "a table by depth: tiles, features, triangles, error_max (m), lost (buildings over which nothing \
                 stands: 0), closed (share of street points that are built over)",
            ),
        ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut out = Map::new();
        out.insert("tiles".into(), json!(self.len()));
        out.insert("leaf_tiles".into(), json!(self.is_leaf.iter().filter(|&&l| l).count()));
        out.insert("features".into(), json!(self.feature_first.len()));
        out.insert("sources".into(), json!(self.ids.len()));
        out.insert("root_error_m".into(), json!(self.error.first().copied().unwrap_or(0.0)));
        out.insert("levels".into(), json!(self.levels));
        out
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
