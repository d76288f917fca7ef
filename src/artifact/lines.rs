//! Lines: roads, rails, water; barriers for `cluster`.

use serde_json::{Map, Value, json};

use super::{Artifact, Kind, Strings};
use crate::geom::frame::Frame;

crate::columns! {
    /// n polylines on the millimetre grid of the local frame; a closed one repeats its first point at the end.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Lines {
        pub frame: Frame,
        pub ids: Strings,
        /// n + 1 offsets into `points`.
        pub starts: Vec<u32>,
        pub points: Vec<[i32; 2]>,
    }
}

impl Lines {
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
    pub fn line(&self, i: usize) -> &[[i32; 2]] {
        &self.points[self.starts[i] as usize..self.starts[i + 1] as usize]
    }
}

impl Artifact for Lines {
    const KIND: &'static Kind = &Kind::of::<Self>("Lines", "polylines").keys(&[
        ("lines", "number of lines"),
        ("vertices", "points of all lines"),
        ("bounds_m", "least x, y and greatest x, y in the local frame"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let mut out = Map::new();
        out.insert("lines".into(), json!(self.len()));
        out.insert("vertices".into(), json!(self.points.len()));
        out.insert("bounds_m".into(), super::bounds_m(&self.points));
        out
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
