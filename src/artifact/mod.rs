//! The types on the edges: plain values, no paths, no clock. Encoded as named columns (`sections`).

pub mod attributes;
pub mod buildings;
pub mod dendrogram;
pub mod files;
pub mod footprints;
pub mod hulls;
pub mod impostors;
pub mod landmarks;
pub mod lines;
pub mod mesh;
pub mod plane_tiles;
pub mod sections;
pub mod shapes;
pub mod table;
pub mod tile_tree;
#[cfg(test)]
pub mod toy;
pub mod voxels;

crate::json_field!(crate::geom::frame::Frame);

use std::any::Any;
use std::sync::Arc;

use serde_json::{Map, Value};

pub use attributes::{Attributes, Column, Strings, Values};
pub use buildings::Buildings;
pub use dendrogram::Dendrogram;
pub use files::{Blob, Files};
pub use footprints::Footprints;
pub use hulls::Hulls;
pub use impostors::Impostors;
pub use landmarks::Landmarks;
pub use lines::Lines;
pub use mesh::Mesh;
pub use plane_tiles::PlaneTiles;
pub use shapes::Shapes;
pub use table::{Cell, Table};
pub use tile_tree::TileTree;
pub use voxels::Voxels;

use crate::diag::Result;
use sections::{Decoder, Encoder};

/// What travels on an edge.
pub struct Kind {
    pub name: &'static str,
    pub doc: &'static str,
    /// Keys of its summary and what they mean.
    pub keys: &'static [(&'static str, &'static str)],
    pub decode: fn(&mut Decoder) -> Result<Arc<dyn AnyArtifact>>,
}

impl Kind {
    pub const fn of<A: Artifact>(name: &'static str, doc: &'static str) -> Self {
        Self { name, doc, keys: &[], decode: |from| Ok(Arc::new(A::decode(from)?)) }
    }
}

impl Kind {
    /// With the keys of its summary: what [`Artifact::summary`] gives, for the manual.
    pub const fn keys(mut self, keys: &'static [(&'static str, &'static str)]) -> Self {
        self.keys = keys;
        self
    }
}

impl std::fmt::Debug for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

impl PartialEq for Kind {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

/// A value that operators pass on.
pub trait Artifact: Any + Send + Sync + Sized {
    const KIND: &'static Kind;
    fn encode<'a>(&'a self, out: &mut Encoder<'a>);
    fn decode(from: &mut Decoder) -> Result<Self>;
    /// Counts, bounds, areas, extremes: what a person would check. Keys are stable and documented by `ops`.
    fn summary(&self) -> Map<String, Value>;
    /// Blobs that the artifact names beside its own bytes.
    fn blobs(&self) -> Vec<Blob> {
        Vec::new()
    }
    /// Where local coordinates lie, if the artifact has any.
    fn frame(&self) -> Option<&crate::geom::frame::Frame> {
        None
    }
}

/// An artifact without its type, as the engine sees it.
pub trait AnyArtifact: Send + Sync {
    fn kind(&self) -> &'static Kind;
    fn encode<'a>(&'a self, out: &mut Encoder<'a>);
    fn summary(&self) -> Map<String, Value>;
    fn blobs(&self) -> Vec<Blob>;
    fn frame(&self) -> Option<&crate::geom::frame::Frame>;
    fn as_any(&self) -> &dyn Any;
    fn into_any(self: Arc<Self>) -> Arc<dyn Any + Send + Sync>;
}

impl<A: Artifact> AnyArtifact for A {
    fn kind(&self) -> &'static Kind {
        A::KIND
    }
    fn encode<'a>(&'a self, out: &mut Encoder<'a>) {
        Artifact::encode(self, out);
    }
    fn summary(&self) -> Map<String, Value> {
        Artifact::summary(self)
    }
    fn blobs(&self) -> Vec<Blob> {
        Artifact::blobs(self)
    }
    fn frame(&self) -> Option<&crate::geom::frame::Frame> {
        Artifact::frame(self)
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn into_any(self: Arc<Self>) -> Arc<dyn Any + Send + Sync> {
        self
    }
}

/// Every kind there is, by name: how the engine reads an object back.
pub static KINDS: &[&Kind] = &[
    Buildings::KIND,
    Dendrogram::KIND,
    Files::KIND,
    Footprints::KIND,
    Hulls::KIND,
    Impostors::KIND,
    Landmarks::KIND,
    Lines::KIND,
    Mesh::KIND,
    PlaneTiles::KIND,
    TileTree::KIND,
    Voxels::KIND,
];

/// `[min x, min y, max x, max y]` in metres of points in millimetres, for summaries; null where there are none.
pub fn bounds_m(points: &[[i32; 2]]) -> Value {
    let Some(&first) = points.first() else { return Value::Null };
    let (low, high) = points
        .iter()
        .fold((first, first), |(l, h), p| ([l[0].min(p[0]), l[1].min(p[1])], [h[0].max(p[0]), h[1].max(p[1])]));
    let m = |v: i32| f64::from(v) / 1000.0;
    serde_json::json!([m(low[0]), m(low[1]), m(high[0]), m(high[1])])
}

impl From<crate::geom::crs::CrsError> for Box<crate::diag::Diagnostic> {
    fn from(e: crate::geom::crs::CrsError) -> Self {
        let out = crate::diag::Diagnostic::error("bad-crs", e.message);
        if e.value.is_empty() { out } else { out.value(e.value) }
    }
}
