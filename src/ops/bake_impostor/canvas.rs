//! One tile's canvas: what a camera that looks along its normal sees of the surface within its reach.

use rayon::prelude::*;

use crate::artifact::{Mesh, PlaneTiles};
use crate::geom::raster::{self, PARTS};
use crate::io::paint::Paint;

type Vec3 = [f64; 3];

fn dot(a: Vec3, b: Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The tiles' planes: inside is normal . x <= offset.
pub struct Planes {
    all: Vec<(Vec3, f64)>,
    reach: f64,
    cell: f64,
}

/// Surfaces that turn away more than that smear: only a tile that they face most draws them.
const STEEP: f64 = 0.3;
/// Texels beyond its own that a tile draws.
const OVERLAP: u32 = 1;

impl Planes {
    pub fn new(tiles: &PlaneTiles) -> Self {
        let all = tiles.planes.iter().map(|&w| tiles.lattice.plane(w)).collect();
        Self { all, reach: tiles.given.reach_cells * tiles.lattice.cell, cell: tiles.lattice.cell }
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    pub fn normal(&self, k: usize) -> Vec3 {
        self.all[k].0
    }

    fn distance(&self, k: usize, p: Vec3) -> f64 {
        dot(self.all[k].0, p) - self.all[k].1
    }

    /// Whether no tile that reaches `p` is better for a surface of this normal than tile k, which it faces by `facing`.
    fn is_best(&self, k: usize, p: Vec3, normal: Vec3, facing: f64) -> bool {
        let own = self.distance(k, p).abs();
        self.all.iter().enumerate().all(|(other, (n, offset))| {
            let f = dot(*n, normal);
            if f < facing || other == k {
                return true;
            }
            let d = (dot(*n, p) - offset).abs();
            d > self.reach || f == facing && (d, other) > (own, k)
        })
    }
}

/// A texel: the surface there, and whether it belongs to this tile.
#[derive(Clone, Copy)]
struct Texel {
    near: f64,
    best: bool,
    light: [f32; 3],
    two_sided: bool,
}

/// A part of a canvas: first and last column and row, inclusive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    pub low: [u32; 2],
    pub high: [u32; 2],
    pub texels: u32,
    /// Of these, those of two-sided materials.
    pub two_sided: u32,
}

impl Piece {
    pub fn width(&self) -> u32 {
        self.high[0] - self.low[0] + 1
    }
    pub fn height(&self) -> u32 {
        self.high[1] - self.low[1] + 1
    }
    fn area(&self) -> f64 {
        f64::from(self.width()) * f64::from(self.height())
    }
    fn with(&self, other: &Self) -> Self {
        Self {
            low: [0, 1].map(|k| self.low[k].min(other.low[k])),
            high: [0, 1].map(|k| self.high[k].max(other.high[k])),
            texels: self.texels + other.texels,
            two_sided: self.two_sided + other.two_sided,
        }
    }
}

pub struct Canvas {
    /// Right, up and outside.
    axes: [Vec3; 3],
    /// Left and upper end along the axes, and the plane's offset, metres.
    corner: [f64; 3],
    texel: f64,
    size: [u32; 2],
    /// Light of what is drawn, and whether its back is seen.
    texels: Vec<Option<([f32; 3], bool)>>,
    pub pieces: Vec<Piece>,
}

impl Canvas {
    pub fn draw(mesh: &Mesh, paint: &Paint, planes: &Planes, k: usize, density: f64) -> Self {
        let (normal, offset) = planes.all[k];
        let axes = axes(normal);
        let texel = planes.cell / density;
        // (1) What lies within reach, and how much room it needs.
        let reached: Vec<u32> = (0..mesh.triangles.len() as u32)
            .filter(|&t| {
                let d = mesh.triangles[t as usize].map(|v| dot(normal, mesh.positions[v as usize]) - offset);
                d.iter().any(|&d| d >= -planes.reach) && d.iter().any(|&d| d <= planes.reach)
            })
            .collect();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for &v in reached.iter().flat_map(|&t| &mesh.triangles[t as usize]) {
            for a in 0..2 {
                let c = dot(axes[a], mesh.positions[v as usize]);
                (low[a], high[a]) = (low[a].min(c), high[a].max(c));
            }
        }
        let corner = [low[0], high[1], offset];
        let size = [0, 1].map(|a| if low[a] <= high[a] { ((high[a] - low[a]) / texel).ceil() as u32 + 1 } else { 0 });
        let n = size[0] as usize * size[1] as usize;
        let mut out = Self { axes, corner, texel, size, texels: vec![None; n], pieces: Vec::new() };

        // (2) Every fragment; a tile's own go before others, then what is nearer to the eye.
        let mut drawn: Vec<Option<Texel>> = vec![None; n];
        let part = |v: f64| (v / texel * PARTS as f64).round() as i64;
        for &t in &reached {
            let t = t as usize;
            let corners = mesh.triangles[t].map(|v| mesh.positions[v as usize]);
            let flat = corners.map(|p| [part(dot(axes[0], p) - low[0]), part(high[1] - dot(axes[1], p))]);
            let two_sided = paint.material(t).double_sided;
            let pixels = raster::doubled_area(&flat).abs() as f64 / (2 * PARTS * PARTS) as f64;
            let level = paint.level(t, pixels);
            raster::cover(&flat, size, |x, y, w| {
                let p = [0, 1, 2].map(|a| (0..3).map(|c| w[c] * corners[c][a]).sum());
                let near = dot(normal, p) - offset;
                let mut smooth = paint.normal(t, w);
                let mut facing = dot(smooth, normal);
                if two_sided && facing < 0.0 {
                    (smooth, facing) = (smooth.map(|c| -c), -facing);
                }
                if near.abs() > planes.reach || facing <= 0.0 {
                    return;
                }
                let i = (y * size[0] + x) as usize;
                let before = drawn[i].map_or((false, f64::NEG_INFINITY), |d| (d.best, d.near));
                if before.0 && near <= before.1 {
                    return;
                }
                let best = planes.is_best(k, p, smooth, facing);
                if (!best && facing < STEEP) || (best, near) <= before {
                    return;
                }
                if let Some(light) = paint.at(t, w, level) {
                    drawn[i] = Some(Texel { near, best, light, two_sided });
                }
            });
        }

        // (3) Its own texels, and one around them.
        for y in 0..size[1] {
            for x in 0..size[0] {
                let own = |x: u32, y: u32| drawn[(y * size[0] + x) as usize].is_some_and(|d| d.best);
                let i = (y * size[0] + x) as usize;
                let beside = || {
                    let rows = y.saturating_sub(OVERLAP)..=(y + OVERLAP).min(size[1] - 1);
                    rows.into_iter()
                        .any(|v| (x.saturating_sub(OVERLAP)..=(x + OVERLAP).min(size[0] - 1)).any(|u| own(u, v)))
                };
                out.texels[i] = drawn[i].filter(|d| d.best || beside()).map(|d| (d.light, d.two_sided));
            }
        }
        out.pieces = out.split();
        out
    }

    /// Corners of a piece, counter-clockwise from outside, from the lower left.
    pub fn corners(&self, piece: &Piece) -> [Vec3; 4] {
        let [left, top] = piece.low.map(f64::from);
        let [right, bottom] = piece.high.map(|c| f64::from(c) + 1.0);
        [(left, bottom), (right, bottom), (right, top), (left, top)].map(|(x, y)| {
            let (a, b) = (self.corner[0] + x * self.texel, self.corner[1] - y * self.texel);
            [0, 1, 2].map(|k| a * self.axes[0][k] + b * self.axes[1][k] + self.corner[2] * self.axes[2][k])
        })
    }

    pub fn at(&self, x: u32, y: u32) -> Option<[f32; 3]> {
        self.texels[(y * self.size[0] + x) as usize].map(|t| t.0)
    }

    /// Whether a place is drawn here.
    fn draws(&self, p: Vec3) -> bool {
        let x = ((dot(self.axes[0], p) - self.corner[0]) / self.texel).floor();
        let y = ((self.corner[1] - dot(self.axes[1], p)) / self.texel).floor();
        let within = x >= 0.0 && y >= 0.0 && x < f64::from(self.size[0]) && y < f64::from(self.size[1]);
        within && {
            let (x, y) = (x as u32, y as u32);
            let inside = |q: &Piece| (q.low[0]..=q.high[0]).contains(&x) && (q.low[1]..=q.high[1]).contains(&y);
            self.at(x, y).is_some() && self.pieces.iter().any(inside)
        }
    }

    /// Connected pieces (texels up to four apart), joined while that costs little.
    fn split(&self) -> Vec<Piece> {
        let [width, height] = self.size.map(|s| s as i64);
        let mut label = vec![false; self.texels.len()];
        let mut pieces: Vec<Piece> = Vec::new();
        let mut todo: Vec<[i64; 2]> = Vec::new();
        for first in 0..self.texels.len() {
            if label[first] || self.texels[first].is_none() {
                continue;
            }
            label[first] = true;
            let at = [first as u32 % self.size[0], first as u32 / self.size[0]];
            let mut piece = Piece { low: at, high: at, texels: 0, two_sided: 0 };
            todo.push(at.map(i64::from));
            while let Some([x, y]) = todo.pop() {
                let own = [x as u32, y as u32];
                let two_sided = self.texels[(y * width + x) as usize].is_some_and(|t| t.1).into();
                piece = piece.with(&Piece { low: own, high: own, texels: 1, two_sided });
                for v in (y - 4).max(0)..=(y + 4).min(height - 1) {
                    for u in (x - 4).max(0)..=(x + 4).min(width - 1) {
                        let i = (v * width + u) as usize;
                        if !label[i] && self.texels[i].is_some() {
                            label[i] = true;
                            todo.push([u, v]);
                        }
                    }
                }
            }
            pieces.push(piece);
        }
        pieces.retain(|p| p.texels >= 4);
        // Each join may make another one worth it.
        'again: loop {
            for a in 0..pieces.len() {
                for b in a + 1..pieces.len() {
                    let both = pieces[a].with(&pieces[b]);
                    if both.area() <= 1.3 * (pieces[a].area() + pieces[b].area()) {
                        pieces[a] = both;
                        pieces.remove(b);
                        continue 'again;
                    }
                }
            }
            return pieces;
        }
    }
}

/// Right, up and the normal: up is z where that can be seen.
fn axes(normal: Vec3) -> [Vec3; 3] {
    let up = if normal[2].abs() < 0.999 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
    let cross = |a: Vec3, b: Vec3| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let right = cross(up, normal);
    let length = dot(right, right).sqrt();
    let right = right.map(|c| c / length);
    [right, cross(normal, right), normal]
}

/// Points of the surface that are asked for.
const POINTS: u64 = 1_000_000;

/// Share of points, spread evenly over the area, that some tile draws which they face.
pub fn share_drawn(mesh: &Mesh, paint: &Paint, planes: &Planes, canvases: &[Canvas]) -> f64 {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        dot(n, n).sqrt()
    };
    let mut ends: Vec<f64> = Vec::with_capacity(mesh.triangles.len());
    let mut sum = 0.0;
    for t in &mesh.triangles {
        sum += area(t);
        ends.push(sum);
    }
    if sum <= 0.0 {
        return 0.0;
    }
    let drawn = |i: u64| {
        let at = sum * (i as f64 + 0.5) / POINTS as f64;
        let t = ends.partition_point(|&e| e <= at).min(ends.len() - 1);
        // A fixed sequence, spread evenly over the square, folded into the triangle.
        let part = |step: u64| (i.wrapping_mul(step) >> 11) as f64 / (1u64 << 53) as f64;
        let (mut a, mut b) = (part(0xc13f_a9a9_02a6_328f), part(0x91e1_0da5_c79e_7b1d));
        if a + b > 1.0 {
            (a, b) = (1.0 - a, 1.0 - b);
        }
        let w = [1.0 - a - b, a, b];
        let corners = mesh.triangles[t].map(|v| mesh.positions[v as usize]);
        let p = [0, 1, 2].map(|k| (0..3).map(|c| w[c] * corners[c][k]).sum());
        let normal = paint.normal(t, w);
        let two_sided = paint.material(t).double_sided;
        (0..planes.len()).any(|k| {
            let facing = dot(planes.normal(k), normal);
            (facing > 0.0 || two_sided && facing < 0.0)
                && planes.distance(k, p).abs() <= planes.reach
                && canvases[k].draws(p)
        })
    };
    let count = (0..POINTS).into_par_iter().filter(|&i| drawn(i)).count();
    count as f64 / POINTS as f64
}
