//! Tiles as planes in space: which of them reach a triangle, and which is the best for a place of the surface.

use rayon::prelude::*;

use crate::artifact::{Mesh, PlaneTiles};
use crate::geom::scatter::Scatter;
use crate::geom::space::{Vec3, dot};
use crate::io::paint::Paint;

/// Surfaces that turn away more than that smear: only a tile that they face most draws them, and none lies by them.
pub const STEEP: f64 = 0.3;

/// The tiles' planes: inside is normal . x <= offset.
pub struct Planes {
    all: Vec<(Vec3, f64)>,
    /// How far outside its plane each tile's quads lie.
    lifts: Vec<f64>,
    /// How far from a plane the surface is that it stands for.
    pub reach: f64,
    pub cell: f64,
}

impl Planes {
    pub fn new(tiles: &PlaneTiles) -> Self {
        let all: Vec<(Vec3, f64)> = tiles.planes.iter().map(|&w| tiles.lattice.plane(w)).collect();
        let cell = tiles.lattice.cell;
        let reach = tiles.given.reach_cells * cell;
        Self { lifts: vec![0.0; all.len()], all, reach, cell }
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    pub fn normal(&self, k: usize) -> Vec3 {
        self.all[k].0
    }

    /// The offset at which a tile's quads lie.
    pub fn seat(&self, k: usize) -> f64 {
        self.all[k].1 + self.lifts[k]
    }

    /// How far outside a tile's quads a place is.
    pub fn above(&self, k: usize, p: Vec3) -> f64 {
        dot(self.all[k].0, p) - self.seat(k)
    }

    /// Lays each tile's quads where the surface that the tile is best for lies on average: what they show is the same, and
    /// they stick out less. A layer of nodes that stands for a thin sheet is up to a cell off it.
    pub fn settle(&mut self, mesh: &Mesh, paint: &Paint, reached: &Reached) {
        let scatter = Scatter::new((0..mesh.triangles.len()).map(|t| mesh.corners(t)));
        if scatter.is_empty() {
            return;
        }
        // Whole parts of the reach add up to the same in any order.
        let part = self.reach / f64::from(1 << 24);
        let sound = |i: u64| {
            let point = Point::new(mesh, paint, &scatter, (i, SOUNDINGS));
            let turned = point.two_sided.then(|| point.normal.map(|c| -c));
            [Some(point.normal), turned].map(|normal| {
                let k = self.best(reached.tiles(point.triangle), point.at, normal?)?;
                let off = (self.distance(k, point.at) / part).round() as i64;
                (dot(self.all[k].0, normal?) > STEEP).then_some((k, off))
            })
        };
        let found: Vec<[Option<(usize, i64)>; 2]> = (0..SOUNDINGS).into_par_iter().map(sound).collect();
        let mut sums = vec![(0, 0); self.len()];
        for (k, off) in found.into_iter().flatten().flatten() {
            sums[k].0 += off;
            sums[k].1 += 1;
        }
        let mean = |&(sum, count): &(i64, i64)| if count == 0 { 0.0 } else { part * sum as f64 / count as f64 };
        self.lifts = sums.iter().map(mean).collect();
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
/// And for where quads lie.
const SOUNDINGS: u64 = 1 << 18;

/// One of points spread evenly over the area.
struct Point {
    triangle: usize,
    at: Vec3,
    normal: Vec3,
    two_sided: bool,
}

impl Point {
    /// A point, and of how many.
    fn new(mesh: &Mesh, paint: &Paint, scatter: &Scatter, (i, count): (u64, u64)) -> Self {
        let (triangle, w) = scatter.point(i, count);
        let corners = mesh.corners(triangle);
        let at = [0, 1, 2].map(|k| (0..3).map(|c| w[c] * corners[c][k]).sum());
        let two_sided = paint.material(triangle).double_sided;
        Self { triangle, at, normal: paint.normal(triangle, w), two_sided }
    }
}

impl Scene<'_> {
    /// Share of points, spread evenly over the area, that some tile draws which they face.
    pub fn share_drawn(&self, draws: impl Fn(usize, Vec3) -> bool + Sync) -> f64 {
        let (mesh, planes) = (self.mesh, self.planes);
        let scatter = Scatter::new((0..mesh.triangles.len()).map(|t| mesh.corners(t)));
        if scatter.is_empty() {
            return 0.0;
        }
        let drawn = |i: u64| {
            let point = Point::new(mesh, self.paint, &scatter, (i, POINTS));
            self.reached.tiles(point.triangle).iter().any(|&k| {
                let k = k as usize;
                let facing = dot(planes.normal(k), point.normal);
                (facing > 0.0 || point.two_sided && facing < 0.0)
                    && planes.distance(k, point.at).abs() <= planes.reach
                    && draws(k, point.at)
            })
        };
        let count = (0..POINTS).into_par_iter().filter(|&i| drawn(i)).count();
        count as f64 / POINTS as f64
    }
}
