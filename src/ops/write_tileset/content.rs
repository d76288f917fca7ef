//! A tile's features as triangles along the tile's own axes.

use std::ops::Range;

use crate::artifact::{Column, Shapes, Strings, TileTree, Values, buildings};
use crate::geom::chart::Chart;
use crate::geom::triangulate::{Triangulator, doubled_normal};
use crate::io::gltf::{Part, Vertex};

/// What one tile draws.
pub struct Drawn {
    /// Wall, roof, ground.
    pub parts: [Part; 3],
    /// Corners of the box around all vertices as they are written; infinite where there are none.
    pub low: [f64; 3],
    pub high: [f64; 3],
    pub triangles: u64,
    /// Features (numbers in the tree) that came to no triangle at all.
    pub empty: Vec<usize>,
}

const UP: [i8; 3] = [0, 0, 127];

/// The triangles of tile `tile`; `offset` metres are added to every height.
pub fn draw(tree: &TileTree, tile: usize, chart: &Chart, offset: f64) -> Drawn {
    let part = |name: &str| Part { name: name.into(), ..Part::default() };
    let features = tree.features_of(tile);
    let mut parts = [part("wall"), part("roof"), part("ground")];
    let corners = corners(&tree.plans, &features);
    parts[0].vertices.reserve(4 * corners);
    parts[0].triangles.reserve(2 * corners);
    parts[1].vertices.reserve(corners);
    parts[1].triangles.reserve(corners);
    let scissors = Triangulator::new();
    let mut pen = Pen { chart, offset, scissors, triangles: Vec::new(), places: Vec::new(), parts };
    let mut empty = Vec::new();
    for f in features.clone() {
        let before: usize = pen.parts.iter().map(|p| p.triangles.len()).sum();
        let number = (f - features.start) as u32;
        if tree.solids.polygons_of(f).is_empty() {
            pen.extrude(tree, f, number);
        } else {
            pen.solid(tree, f, number);
        }
        if before == pen.parts.iter().map(|p| p.triangles.len()).sum::<usize>() {
            empty.push(f);
        }
    }
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for v in pen.parts.iter().flat_map(|p| &p.vertices) {
        let p = v.position();
        low = [0, 1, 2].map(|k| low[k].min(p[k]));
        high = [0, 1, 2].map(|k| high[k].max(p[k]));
    }
    let triangles = pen.parts.iter().map(|p| p.triangles.len() as u64).sum();
    Drawn { parts: pen.parts, low: low.map(f64::from), high: high.map(f64::from), triangles, empty }
}

struct Pen<'a> {
    chart: &'a Chart<'a>,
    offset: f64,
    scissors: Triangulator,
    triangles: Vec<[u32; 3]>,
    /// Of each point of a ring: along the ground, at the base, at the top.
    places: Vec<([f64; 2], [f32; 3], [f32; 3])>,
    parts: [Part; 3],
}

/// Points of features' plans.
fn corners(plans: &Shapes<[i32; 2]>, features: &Range<usize>) -> usize {
    let end = |f: usize| plans.rings[plans.polygons[plans.shapes[f] as usize] as usize] as usize;
    end(features.end) - end(features.start)
}

impl Pen<'_> {
    /// Walls between base and top around every ring, and the roof. There is no floor: nothing looks up from below.
    fn extrude(&mut self, tree: &TileTree, f: usize, number: u32) {
        let (base, top) = (tree.base[f] + self.offset, tree.top[f] + self.offset);
        let [walls, roof, _] = &mut self.parts;
        for p in tree.plans.polygons_of(f) {
            self.triangles.clear();
            self.scissors.plan(tree.plans.rings_of(p).map(|r| tree.plans.ring(r)), &mut self.triangles);
            if self.triangles.is_empty() {
                continue;
            }
            push(roof, &self.triangles);
            for ring in tree.plans.rings_of(p).map(|r| tree.plans.ring(r)) {
                self.places.clear();
                for q in ring {
                    let place = self.chart.at(q.map(|v| f64::from(v) / 1000.0));
                    self.places.push(([place.0[0], place.0[1]], along(place, base), along(place, top)));
                }
                roof.vertices.extend(self.places.iter().map(|p| Vertex::new(p.2, UP, number)));
                let Some(&last) = self.places.last().filter(|_| top > base) else { continue };
                let before = std::iter::once(&last).chain(&self.places);
                // The wall before: its normal, and its corners at the far end.
                let mut beside: Option<([i8; 3], [u32; 2])> = None;
                for (p, q) in before.zip(&self.places) {
                    let (x, y) = (q.0[0] - p.0[0], q.0[1] - p.0[1]);
                    let size = (x * x + y * y).sqrt();
                    if size == 0.0 {
                        continue;
                    }
                    let normal = narrow([y / size, -x / size, 0.0]);
                    let corner = |place| Vertex::new(place, normal, number);
                    let [low, high] = match beside {
                        // In one plane, as far as normals tell: one edge between both.
                        Some((same, edge)) if same == normal => edge,
                        _ => {
                            walls.vertices.extend([p.1, p.2].map(corner));
                            [walls.vertices.len() as u32 - 2, walls.vertices.len() as u32 - 1]
                        }
                    };
                    let far = walls.vertices.len() as u32;
                    walls.vertices.extend([q.1, q.2].map(corner));
                    walls.triangles.extend([[low, far, far + 1], [low, far + 1, high]]);
                    beside = Some((normal, [far, far + 1]));
                }
            }
        }
    }

    /// Surfaces as they are. What the source does not call wall, roof or ground is told by its slope.
    fn solid(&mut self, tree: &TileTree, f: usize, number: u32) {
        for p in tree.solids.polygons_of(f) {
            let rings = || tree.solids.rings_of(p).map(|r| tree.solids.ring(r));
            self.triangles.clear();
            self.scissors.space(rings(), &mut self.triangles);
            let Some(shell) = rings().next().filter(|_| !self.triangles.is_empty()) else { continue };
            let normal = doubled_normal(shell).map(|v| v as f64);
            let size = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
            let normal = normal.map(|v| v / size);
            let part = match tree.semantics[p] {
                buildings::WALL => 0,
                buildings::ROOF => 1,
                buildings::GROUND => 2,
                _ if normal[2] > 0.05 => 1,
                _ if normal[2] < -0.05 => 2,
                _ => 0,
            };
            // Local axes are turned against the tile's by the convergence of meridians.
            let [o, x, y] = [[0, 0], [1000, 0], [0, 1000]]
                .map(|d: [i32; 2]| self.chart.at([0, 1].map(|k| f64::from(shell[0][k] + d[k]) / 1000.0)));
            let turned =
                [0, 1, 2].map(|k| (x.0[k] - o.0[k]) * normal[0] + (y.0[k] - o.0[k]) * normal[1] + o.1[k] * normal[2]);
            let size = turned.iter().map(|v| v * v).sum::<f64>().sqrt();
            let normal = narrow(turned.map(|v| v / size));
            let part = &mut self.parts[part];
            push(part, &self.triangles);
            for q in rings().flatten() {
                let [x, y, z] = q.map(|v| f64::from(v) / 1000.0);
                let position = along(self.chart.at([x, y]), z + self.offset);
                part.vertices.push(Vertex::new(position, normal, number));
            }
        }
    }
}

/// Appends triangles over vertices that are about to be appended.
fn push(part: &mut Part, triangles: &[[u32; 3]]) {
    let first = part.vertices.len() as u32;
    part.triangles.extend(triangles.iter().map(|t| t.map(|i| i + first)));
}

#[inline]
fn along((at, up): ([f64; 3], [f64; 3]), z: f64) -> [f32; 3] {
    [0, 1, 2].map(|k| (at[k] + up[k] * z) as f32)
}

/// A unit vector times 127, halves up.
#[inline]
fn narrow(normal: [f64; 3]) -> [i8; 3] {
    normal.map(|v| ((v * 127.0 + 127.5) as i32 - 127) as i8)
}

/// What the tile tells of its features, a row for each; sources are counted from the tile's own first. A leaf's
/// features are buildings: they have their id, and, second, what else the source says of them.
pub fn table(tree: &TileTree, tile: usize) -> (Vec<Column>, Vec<Column>) {
    let features = tree.features_of(tile);
    let n = features.len();
    let first = tree.source_first[tile];
    let all = |name: &str, values: Values| Column { name: name.into(), values, present: vec![true; n] };
    let real = |name: &str, of: &[f64]| all(name, Values::F64(of[features.clone()].to_vec()));
    let mut out = vec![
        real("footprint_area_m2", &tree.footprint_area_m2),
        real("height_max", &tree.height_max),
        real("height_min", &tree.height_min),
        all("landmark", Values::Bool(tree.landmark[features.clone()].to_vec())),
        real("negative_space_m2", &tree.negative_space_m2),
        all("source_count", Values::U32(tree.feature_count[features.clone()].to_vec())),
        all("source_first", Values::U32(tree.feature_first[features.clone()].iter().map(|f| f - first).collect())),
    ];
    if tree.is_leaf[tile] {
        let rows = &tree.feature_first[features.clone()];
        let ids: Strings = rows.iter().map(|&r| tree.ids.get(r as usize)).collect();
        let mut attributes = tree.attributes.select(rows).columns;
        // Where the ids are an attribute of that name, once is enough.
        attributes.retain(|c| c.name != "id" || !matches!(&c.values, Values::Text(v) if *v == ids));
        out.push(all("id", Values::Text(ids)));
        return (out, attributes);
    }
    (out, Vec::new())
}
