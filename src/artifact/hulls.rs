//! Hulls: one ring per dendrogram node, over shared vertices.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::{Artifact, Kind};
use crate::geom::frame::Frame;

/// What the rings of a `Hulls` are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HullState {
    /// All nodes; each ring contains its children's simplified rings (`merge = "simplified"`).
    Simplified,
    /// All nodes; unsimplified rings of unsimplified rings (`merge = "source"`).
    Merged,
    /// All nodes; a simplified copy of each `Merged` ring.
    SourceSimplified,
    /// Some nodes that partition the leaves.
    Cut,
}

crate::json_field!(HullState);

crate::columns! {
    /// m nodes with a ring each. Rings are counter-clockwise and simple, lists of indices into `vertices`, an
    /// inner node's from its lowest one; an empty one stands for a leaf without an outline (degenerate, counted by its maker).
    #[derive(Clone, Debug, PartialEq)]
    pub struct Hulls {
        pub frame: Frame,
        pub state: HullState,
        /// Distinct input vertices in order of first occurrence, buildings in the dendrogram's leaf order,
        /// millimetres: so ties by index hang neither on the order of rows nor on where north is.
        pub vertices: Vec<[i32; 2]>,
        /// m + 1 offsets into `rings`.
        pub starts: Vec<u32>,
        pub rings: Vec<u32>,
        /// Dendrogram cluster of each node; all clusters in order, but in a cut.
        pub cluster: Vec<u32>,
        /// Cluster of the parent; `u32::MAX` at the root, and in a cut.
        pub parent: Vec<u32>,
        /// Buildings below.
        pub buildings: Vec<u32>,
        /// Edges of the merged ring before its simplification, without collinear vertices; a leaf's own.
        pub merged_edges: Vec<u32>,
        pub area_m2: Vec<f64>,
        /// area - area of the union of the members' footprints.
        pub negative_space_m2: Vec<f64>,
        /// Ground and height above it, metres: means of the members weighted by area without courtyards.
        pub ground: Vec<f64>,
        pub height: Vec<f64>,
    }
}

impl Hulls {
    pub fn len(&self) -> usize {
        self.cluster.len()
    }
    pub fn is_empty(&self) -> bool {
        self.cluster.is_empty()
    }
    /// Vertex indices of node `i`'s ring.
    pub fn ring(&self, i: usize) -> &[u32] {
        &self.rings[self.starts[i] as usize..self.starts[i + 1] as usize]
    }
    /// Points of node `i`'s ring, millimetres.
    pub fn points(&self, i: usize) -> impl ExactSizeIterator<Item = [i32; 2]> + '_ {
        self.ring(i).iter().map(|&v| self.vertices[v as usize])
    }
}

impl Artifact for Hulls {
    const KIND: &'static Kind = &Kind::of::<Self>("Hulls", "one ring per cluster").keys(&[
        ("hulls", "number of clusters"),
        ("state", "merged, simplified or source-simplified: every cluster of the tree; cut: a partition"),
        ("vertices", "points that the rings use"),
        ("edges", "edges of all rings"),
        ("empty", "clusters without a ring"),
        ("bounds_m", "least x, y and greatest x, y in the local frame"),
        ("area_m2_sum", "areas of all rings together"),
        ("negative_space_m2_sum", "their areas without buildings together"),
        ("root_edges", "edges of the outermost ring"),
        ("root_area_m2", "its area"),
        ("root_negative_space_m2", "its area without buildings"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut out = Map::new();
        out.insert("hulls".into(), json!(self.len()));
        out.insert("state".into(), json!(self.state));
        out.insert("vertices".into(), json!(self.vertices.len()));
        out.insert("edges".into(), json!(self.rings.len()));
        out.insert("empty".into(), json!((0..self.len()).filter(|&i| self.ring(i).is_empty()).count()));
        out.insert("bounds_m".into(), super::bounds_m(&self.vertices));
        out.insert("area_m2_sum".into(), json!(self.area_m2.iter().sum::<f64>()));
        out.insert("negative_space_m2_sum".into(), json!(self.negative_space_m2.iter().sum::<f64>()));
        if let Some(root) = self.len().checked_sub(1).filter(|_| self.state != HullState::Cut) {
            out.insert("root_edges".into(), json!(self.ring(root).len()));
            out.insert("root_area_m2".into(), json!(self.area_m2[root]));
            out.insert("root_negative_space_m2".into(), json!(self.negative_space_m2[root]));
        }
        out
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
