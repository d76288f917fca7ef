//! Tiles as planes in space: which of them reach a triangle, and which is the best for a place of the surface.

use rayon::prelude::*;

use crate::artifact::{Mesh, PlaneTiles};
use crate::geom::scatter::Scatter;
use crate::geom::space::{Vec3, dot};
use crate::io::paint::Paint;

/// The tiles' planes: inside is normal . x <= offset.
pub struct Planes {
    all: Vec<(Vec3, f64)>,
    /// How far from a plane the surface is that it stands for.
    pub reach: f64,
    pub cell: f64,
}

impl Planes {
    pub fn new(tiles: &PlaneTiles) -> Self {
        let all = tiles.planes.iter().map(|&w| tiles.lattice.plane(w)).collect();
        let cell = tiles.lattice.cell;
        let reach = tiles.given.reach_cells * cell;
        Self { all, reach, cell }
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    pub fn normal(&self, k: usize) -> Vec3 {
        self.all[k].0
    }

    pub fn offset(&self, k: usize) -> f64 {
        self.all[k].1
    }

    /// How far outside a place is.
    pub fn distance(&self, k: usize, p: Vec3) -> f64 {
        dot(self.all[k].0, p) - self.all[k].1
    }

    /// Of these tiles that reach `p` the one that a surface of this normal faces most, then the nearest, then the first.
    pub fn best(&self, among: &[u32], p: Vec3, normal: Vec3) -> Option<usize> {
        let mut best: Option<(f64, f64, usize)> = None;
        for &k in among {
            let facing = dot(self.all[k as usize].0, normal);
            if best.is_none_or(|(f, ..)| facing >= f) {
                let d = self.distance(k as usize, p).abs();
                if d <= self.reach && best.is_none_or(|(f, other, _)| facing > f || d < other) {
                    best = Some((facing, d, k as usize));
                }
            }
        }
        best.map(|(.., k)| k)
    }
}

/// Tiles that reach each triangle, and triangles that each tile reaches.
pub struct Reached {
    ends: Vec<usize>,
    tiles: Vec<u32>,
    pub triangles: Vec<Vec<u32>>,
}

/// Triangles at a time.
const BATCH: usize = 1024;

impl Reached {
    pub fn new(mesh: &Mesh, planes: &Planes) -> Self {
        let of_batch = |batch: &[[u32; 3]]| {
            let (mut tiles, mut counts) = (Vec::new(), Vec::with_capacity(batch.len()));
            for t in batch {
                let corners = t.map(|v| mesh.positions[v as usize]);
                let before = tiles.len();
                for k in 0..planes.len() {
                    let d = corners.map(|p| planes.distance(k, p));
                    if d.iter().any(|&d| d >= -planes.reach) && d.iter().any(|&d| d <= planes.reach) {
                        tiles.push(k as u32);
                    }
                }
                counts.push(tiles.len() - before);
            }
            (tiles, counts)
        };
        let batches: Vec<(Vec<u32>, Vec<usize>)> = mesh.triangles.par_chunks(BATCH).map(of_batch).collect();
        let mut out = Self {
            ends: Vec::with_capacity(mesh.triangles.len()),
            tiles: Vec::new(),
            triangles: vec![Vec::new(); planes.len()],
        };
        for (tiles, counts) in batches {
            out.tiles.extend(tiles);
            for count in counts {
                out.ends.push(out.ends.last().copied().unwrap_or(0) + count);
                let t = out.ends.len() - 1;
                for i in out.range(t) {
                    out.triangles[out.tiles[i] as usize].push(t as u32);
                }
            }
        }
        out
    }

    fn range(&self, triangle: usize) -> std::ops::Range<usize> {
        let first = if triangle == 0 { 0 } else { self.ends[triangle - 1] };
        first..self.ends[triangle]
    }

    pub fn tiles(&self, triangle: usize) -> &[u32] {
        &self.tiles[self.range(triangle)]
    }
}

/// What there is to draw, and on what.
pub struct Scene<'a> {
    pub mesh: &'a Mesh,
    pub paint: &'a Paint<'a>,
    pub planes: &'a Planes,
    pub reached: &'a Reached,
}

/// Points of the surface that are asked for.
const POINTS: u64 = 1_000_000;

impl Scene<'_> {
    /// Share of points, spread evenly over the area, that some tile draws which they face.
    pub fn share_drawn(&self, draws: impl Fn(usize, Vec3) -> bool + Sync) -> f64 {
        let (mesh, planes) = (self.mesh, self.planes);
        let scatter = Scatter::new((0..mesh.triangles.len()).map(|t| mesh.corners(t)));
        if scatter.is_empty() {
            return 0.0;
        }
        let drawn = |i: u64| {
            let (t, w) = scatter.point(i, POINTS);
            let corners = mesh.corners(t);
            let p = [0, 1, 2].map(|k| (0..3).map(|c| w[c] * corners[c][k]).sum());
            let normal = self.paint.normal(t, w);
            let two_sided = self.paint.material(t).double_sided;
            self.reached.tiles(t).iter().any(|&k| {
                let k = k as usize;
                let facing = dot(planes.normal(k), normal);
                (facing > 0.0 || two_sided && facing < 0.0)
                    && planes.distance(k, p).abs() <= planes.reach
                    && draws(k, p)
            })
        };
        let count = (0..POINTS).into_par_iter().filter(|&i| drawn(i)).count();
        count as f64 / POINTS as f64
    }
}
