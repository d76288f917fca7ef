//! What leaves draw: ground polygons raised, or the highest level of detail of `buildings`, and what it costs.

use rayon::prelude::*;

use crate::artifact::{Attributes, Buildings, Footprints, Landmarks, Values, buildings};
use crate::geom::Point;

/// Bytes of a vertex and of a triangle in a GLB: position (3 f32), normal (4 i8), feature (f32); three u32.
const VERTEX: u32 = 20;
const TRIANGLE: u32 = 12;
/// Bytes of a feature's own columns: three u32, six f64 and a flag, rounded up.
const FEATURE: u32 = 72;

/// The original of each place of the leaf order.
pub struct Originals<'a> {
    pub footprints: &'a Footprints,
    pub buildings: Option<&'a Buildings>,
    /// Row of the building at each place.
    pub order: Vec<u32>,
    /// Geometry number in `buildings`; `u32::MAX` where the ground polygons are raised.
    solid: Vec<u32>,
    pub triangles: Vec<u32>,
    /// Upper bound of its bytes in a GLB, attributes included.
    pub bytes: Vec<u32>,
    /// Largest height difference between the raised footprint's roof and the highest level of detail, metres.
    pub off: Vec<f64>,
}

/// Triangles of walls and roof over a polygon's rings, or several polygons' (an upper bound there).
pub fn raised(rings: impl Iterator<Item = usize>) -> u32 {
    let (count, edges) = rings.fold((0u32, 0), |(count, edges), ring| (count + 1, edges + ring));
    (3 * edges as u32 + 2 * count.saturating_sub(1)).saturating_sub(2)
}

/// Bytes of an extruded feature of so many triangles: flat walls need four vertices an edge, the roof one.
pub fn raised_bytes(triangles: u32) -> u64 {
    let edges = u64::from(triangles) / 3 + 1;
    edges * 5 * u64::from(VERTEX) + u64::from(triangles) * u64::from(TRIANGLE) + u64::from(FEATURE)
}

impl<'a> Originals<'a> {
    pub fn new(footprints: &'a Footprints, marks: &Landmarks, solids: Option<&'a Buildings>) -> Self {
        let by_id = solids.map(|b| {
            let mut rows: Vec<u32> = (0..b.len() as u32).collect();
            rows.sort_unstable_by_key(|&r| b.ids.get(r as usize));
            rows
        });
        let one = |&row: &u32| {
            let row = row as usize;
            let attributes = attribute_bytes(&footprints.attributes, row) + footprints.ids.get(row).len() as u32 + 8;
            if let (Some(b), Some(rows)) = (solids, &by_id) {
                let id = footprints.ids.get(row);
                let found = rows.binary_search_by_key(&id, |&r| b.ids.get(r as usize)).ok();
                if let Some(g) = found.and_then(|f| b.geometries_of(rows[f] as usize).next_back()) {
                    let (triangles, vertices) = surface_counts(b, g);
                    if triangles > 0 {
                        let bytes = vertices * VERTEX + triangles * TRIANGLE + FEATURE + attributes;
                        return (g as u32, triangles, bytes, roof_off(b, g, footprints.top[row]));
                    }
                }
            }
            let polygons = &footprints.polygons;
            let rings = polygons.polygons_of(row).flat_map(|p| polygons.rings_of(p));
            let triangles = raised(rings.map(|r| polygons.ring(r).len()));
            (u32::MAX, triangles, raised_bytes(triangles) as u32 + attributes, 0.0)
        };
        let all: Vec<(u32, u32, u32, f64)> = marks.order.par_iter().map(one).collect();
        Self {
            footprints,
            buildings: solids,
            order: marks.order.clone(),
            solid: all.iter().map(|o| o.0).collect(),
            triangles: all.iter().map(|o| o.1).collect(),
            bytes: all.iter().map(|o| o.2).collect(),
            off: all.iter().map(|o| o.3).collect(),
        }
    }

    /// The rings of the building at a place.
    pub fn outline(&self, place: usize) -> impl Iterator<Item = &'a [Point]> + Clone + use<'a> {
        let polygons = &self.footprints.polygons;
        polygons.polygons_of(self.order[place] as usize).flat_map(|p| polygons.rings_of(p)).map(|r| polygons.ring(r))
    }

    /// The geometry of `buildings` that stands for the building at a place.
    pub fn solid(&self, place: usize) -> Option<(&'a Buildings, usize)> {
        self.buildings.filter(|_| self.has_solid(place)).map(|b| (b, self.solid[place] as usize))
    }

    pub fn has_solid(&self, place: usize) -> bool {
        self.solid[place] != u32::MAX
    }

    /// Places without a solid, where `buildings` are given.
    pub fn missing(&self) -> usize {
        if self.buildings.is_none() { 0 } else { self.solid.iter().filter(|&&s| s == u32::MAX).count() }
    }
}

/// Triangles and vertices of a geometry, its ground left out (tiles show none).
fn surface_counts(all: &Buildings, geometry: usize) -> (u32, u32) {
    let surfaces = &all.surfaces;
    let drawn = surfaces.polygons_of(geometry).filter(|&p| all.semantics[p] != buildings::GROUND);
    drawn.fold((0, 0), |(triangles, vertices), p| {
        let rings = surfaces.rings_of(p);
        let holes = rings.len().saturating_sub(1) as u32;
        let edges = rings.map(|r| surfaces.ring(r).len() as u32).sum::<u32>();
        (triangles + (edges + 2 * holes).saturating_sub(2), vertices + edges)
    })
}

/// Largest difference between the roof surfaces (all, where none is marked) and the height `top`.
fn roof_off(all: &Buildings, geometry: usize, top: f64) -> f64 {
    let surfaces = &all.surfaces;
    let polygons = || surfaces.polygons_of(geometry);
    let roofs = polygons().any(|p| all.semantics[p] == buildings::ROOF);
    let heights = polygons()
        .filter(|&p| if roofs { all.semantics[p] == buildings::ROOF } else { all.semantics[p] == buildings::OTHER })
        .flat_map(|p| surfaces.rings_of(p))
        .flat_map(|r| surfaces.ring(r))
        .map(|p| f64::from(p[2]) / 1000.0);
    if roofs {
        heights.map(|z| (z - top).abs()).fold(0.0, f64::max)
    } else {
        // Unmarked surfaces reach the ground: only what stands above counts.
        heights.map(|z| z - top).fold(0.0, f64::max)
    }
}

/// Bytes of one row of an attribute table in a GLB.
fn attribute_bytes(all: &Attributes, row: usize) -> u32 {
    let one = |c: &crate::artifact::Column| match &c.values {
        Values::U32(_) | Values::I32(_) => 4,
        Values::F64(_) => 8,
        Values::Bool(_) => 1,
        Values::Text(t) => t.get(row).len() as u32 + 8,
    };
    all.columns.iter().map(one).sum()
}
