//! Footprints: ground polygons with base and top heights.

use serde_json::{Map, Value, json};

use super::{Artifact, Attributes, Kind, Shapes, Strings};
use crate::geom::frame::Frame;
use crate::geom::overlaps::built_area;
use crate::geom::segments::is_simple;
use crate::geom::union_area::Polygon;

crate::columns! {
    /// n buildings' ground polygons on the millimetre grid of the local frame. Shells are counter-clockwise, holes
    /// clockwise, without repeated vertices and spikes; they may cross themselves or each other (real data does).
    #[derive(Clone, Debug, PartialEq)]
    pub struct Footprints {
        pub frame: Frame,
        /// Unique.
        pub ids: Strings,
        pub polygons: Shapes<[i32; 2]>,
        /// Ground, metres.
        pub base: Vec<f64>,
        /// Roof, metres, above `base`.
        pub top: Vec<f64>,
        pub attributes: Attributes,
    }
}

impl Footprints {
    pub fn len(&self) -> usize {
        self.base.len()
    }
    pub fn is_empty(&self) -> bool {
        self.base.is_empty()
    }
    /// Height of building `i` above its own ground, metres.
    pub fn height(&self, i: usize) -> f64 {
        self.top[i] - self.base[i]
    }
    /// Area of building `i` without its courtyards; what parts or an outline that crosses itself cover twice counts
    /// once.
    pub fn area_m2(&self, i: usize) -> f64 {
        let polygon = |p: usize| {
            let mut rings = self.polygons.rings_of(p).map(|r| self.polygons.ring(r));
            Some(Polygon { shell: rings.next()?, holes: rings.collect() })
        };
        let all: Vec<Polygon> = self.polygons.polygons_of(i).filter_map(polygon).collect();
        built_area(&all, all.iter().all(|p| is_simple(p.shell))) / 2e6
    }
}

impl Artifact for Footprints {
    const KIND: &'static Kind = &Kind::of::<Self>("Footprints", "ground polygons, base and top heights").keys(&[
        ("footprints", "number of footprints"),
        ("polygons", "polygons of all footprints"),
        ("rings", "shells and holes"),
        ("vertices", "points of all rings"),
        ("bounds_m", "least x, y and greatest x, y in the local frame"),
        ("height_min_m", "height of the lowest above its base"),
        ("height_max_m", "height of the highest above its base"),
    ]);
    crate::coded_as_columns!();

    fn summary(&self) -> Map<String, Value> {
        let heights = self.base.iter().zip(&self.top).map(|(b, t)| t - b);
        let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let mut out = Map::new();
        out.insert("footprints".into(), json!(self.len()));
        out.insert("polygons".into(), json!(self.polygons.polygons.len() - 1));
        out.insert("rings".into(), json!(self.polygons.rings.len() - 1));
        out.insert("vertices".into(), json!(self.polygons.points.len()));
        out.insert("bounds_m".into(), super::bounds_m(&self.polygons.points));
        if !self.is_empty() {
            out.insert("height_min_m".into(), json!(low));
            out.insert("height_max_m".into(), json!(high));
        }
        out
    }
    fn frame(&self) -> Option<&Frame> {
        Some(&self.frame)
    }
}
