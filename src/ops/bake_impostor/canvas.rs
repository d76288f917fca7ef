//! A canvas in a tile's plane: what a camera that looks along its normal sees of the surface within its reach.

use super::holes::{Limit, Mending};
use super::planes::{STEEP, Scene};
use crate::geom::raster::{self, PARTS};
use crate::geom::space::{Vec3, cross, dot, sub, unit};
use crate::io::picture::screen;

/// Texels beyond its own that a tile draws in any case.
const OVERLAP: u32 = 1;
/// Cells beyond its own in which a tile draws what there is hidden behind its neighbours: so seams close up to where two
/// planes meet, and no quad sticks out.
const BEHIND: f64 = 2.0;
/// Texels of the largest canvas.
const LARGEST: u64 = 1 << 24;

/// A rectangle in a plane, in texels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Right, up and outside.
    pub axes: [Vec3; 3],
    /// Left and upper end along the axes, and the plane's offset, metres.
    pub corner: [f64; 3],
    /// Side of a texel, metres.
    pub texel: f64,
    /// Columns and rows.
    pub size: [u32; 2],
}

impl Window {
    /// Column and row of a place, in texels from the upper left.
    pub fn place(&self, p: Vec3) -> [f64; 2] {
        [(dot(self.axes[0], p) - self.corner[0]) / self.texel, (self.corner[1] - dot(self.axes[1], p)) / self.texel]
    }

    /// The place in the plane of a column and a row.
    pub fn point(&self, [x, y]: [f64; 2]) -> Vec3 {
        let (a, b) = (self.corner[0] + x * self.texel, self.corner[1] - y * self.texel);
        [0, 1, 2].map(|k| a * self.axes[0][k] + b * self.axes[1][k] + self.corner[2] * self.axes[2][k])
    }

    /// The texel that a place is in.
    pub fn texel_at(&self, p: Vec3) -> Option<usize> {
        let [x, y] = self.place(p).map(f64::floor);
        let within = x >= 0.0 && y >= 0.0 && x < f64::from(self.size[0]) && y < f64::from(self.size[1]);
        within.then(|| y as usize * self.size[0] as usize + x as usize)
    }

    /// The texels along a line, and around it: at its end as far as `spread`, ever less towards its start.
    fn fan(&self, from: Vec3, to: Vec3, spread: f64) -> impl Iterator<Item = usize> {
        let along = sub(to, from);
        // Two places a texel.
        let steps = (2.0 * dot(along, along).sqrt() / self.texel).ceil().max(1.0);
        let size = self.size.map(|s| s as i64);
        (0..=steps as u32).flat_map(move |s| {
            let share = f64::from(s) / steps;
            let middle = self.place([0, 1, 2].map(|k| from[k] + share * along[k]));
            let far = share * spread / self.texel;
            let [x, y] = middle.map(|c| c.floor() as i64);
            let square = far as i64 + 1;
            let near = move |u: i64, v: i64| {
                let [dx, dy] = [(u, middle[0]), (v, middle[1])].map(|(c, m)| c as f64 + 0.5 - m);
                (u, v) == (x, y) || dx * dx + dy * dy <= far * far
            };
            let all = (-square..=square).flat_map(move |dy| (-square..=square).map(move |dx| (x + dx, y + dy)));
            let inside = move |&(u, v): &(i64, i64)| (0..size[0]).contains(&u) && (0..size[1]).contains(&v);
            all.filter(inside).filter(move |&(u, v)| near(u, v)).map(move |(u, v)| (v * size[0] + u) as usize)
        })
    }

    /// Corners, counter-clockwise from outside, from the lower left.
    pub fn corners(&self) -> [Vec3; 4] {
        let [w, h] = self.size.map(f64::from);
        [[0.0, h], [w, h], [w, 0.0], [0.0, 0.0]].map(|at| self.point(at))
    }

    /// Whether it can be drawn within memory.
    pub fn fits(&self) -> bool {
        self.size.iter().map(|&s| u64::from(s)).product::<u64>() <= LARGEST
    }

    pub fn texels(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }

    /// The part of these first and last columns and rows.
    pub fn part(&self, low: [u32; 2], high: [u32; 2]) -> Self {
        let [x, y] = low.map(|c| f64::from(c) * self.texel);
        let corner = [self.corner[0] + x, self.corner[1] - y, self.corner[2]];
        Self { corner, size: [0, 1].map(|k| high[k] - low[k] + 1), ..*self }
    }
}

/// What a texel shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Texel {
    /// On a screen.
    pub colour: [u8; 3],
    /// Unit normal along the window's axes.
    pub normal: [f32; 3],
    pub two_sided: bool,
}

/// A fragment: how near to the eye, and whether it belongs to this tile.
#[derive(Clone, Copy)]
struct Fragment {
    near: f64,
    best: bool,
    /// Drawn here, it lies behind the tile that it belongs to.
    behind: bool,
    texel: Texel,
}

/// Around all that a tile reaches, and its patches; no texels where that is nothing.
pub fn around(scene: &Scene, k: usize, texel: f64, mending: &Mending) -> Window {
    let axes = axes(scene.planes.normal(k));
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mesh = scene.mesh;
    let reached = scene.reached.triangles[k].iter().flat_map(|&t| mesh.corners(t as usize));
    let ends = mending.patches(k).iter().map(|patch| (patch.to, patch.spread));
    for (p, far) in reached.map(|p| (p, 0.0)).chain(ends) {
        for a in 0..2 {
            let c = dot(axes[a], p);
            (low[a], high[a]) = (low[a].min(c - far), high[a].max(c + far));
        }
    }
    let size = [0, 1].map(|a| if low[a] <= high[a] { ((high[a] - low[a]) / texel).ceil() as u32 + 1 } else { 0 });
    Window { axes, corner: [low[0], high[1], scene.planes.seat(k)], texel, size }
}

/// Draws tile k: its own texels and what closes seams around them, without what sticks out; and patches.
pub fn draw(scene: &Scene, k: usize, window: &Window, mending: &Mending) -> Vec<Option<Texel>> {
    let Scene { mesh, paint, planes, reached } = scene;
    let ([right, up, normal], [left, top, _], size) = (window.axes, window.corner, window.size);
    // (1) Every fragment; a tile's own go before others, then what is nearer to the eye.
    let mut drawn: Vec<Option<Fragment>> = vec![None; window.texels()];
    let part = |v: f64| (v / window.texel * PARTS as f64).round() as i64;
    for &t in &reached.triangles[k] {
        let t = t as usize;
        let corners = mesh.triangles[t].map(|v| mesh.positions[v as usize]);
        let flat = corners.map(|p| [part(dot(right, p) - left), part(top - dot(up, p))]);
        let two_sided = paint.material(t).double_sided;
        let pixels = raster::doubled_area(&flat).abs() as f64 / (2 * PARTS * PARTS) as f64;
        let level = paint.level(t, pixels);
        raster::cover(&flat, size, |x, y, w| {
            let p = [0, 1, 2].map(|a| (0..3).map(|c| w[c] * corners[c][a]).sum());
            let near = planes.distance(k, p);
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
            let owner = planes.best(reached.tiles(t), p, smooth).unwrap_or(k);
            let best = owner == k;
            if (!best && facing < STEEP) || (best, near) <= before {
                return;
            }
            if let Some(light) = paint.at(t, w, level) {
                let along = window.axes.map(|a| dot(a, smooth) as f32);
                let above = planes.above(k, p);
                let shown = [0, 1, 2].map(|a| p[a] - above * normal[a]);
                let behind = planes.above(owner, shown) <= 0.0;
                drawn[i] = Some(Fragment {
                    near,
                    best,
                    behind,
                    texel: Texel { colour: light.map(screen), normal: along, two_sided },
                });
            }
        });
    }

    // (2) Its own texels, and ring by ring those around them.
    let mut kept: Vec<bool> = drawn.iter().map(|d| d.is_some_and(|d| d.best)).collect();
    let mut edge: Vec<usize> = (0..kept.len()).filter(|&i| kept[i]).collect();
    for ring in 0..OVERLAP.max((BEHIND * planes.cell / window.texel).ceil() as u32) {
        let more = |&i: &usize| !kept[i] && drawn[i].is_some_and(|d| ring < OVERLAP || d.behind);
        let mut next: Vec<usize> = edge.iter().flat_map(|&i| neighbours(i, size)).filter(more).collect();
        next.sort_unstable();
        next.dedup();
        next.iter().for_each(|&i| kept[i] = true);
        edge = next;
    }
    // (3) Without those that stick out.
    let mut shown: Vec<u32> = (0..kept.len() as u32).filter(|&i| kept[i as usize]).collect();
    mending.keep(window, &mut shown);
    let mut out: Vec<Option<Texel>> = vec![None; kept.len()];
    shown.into_iter().map(|i| i as usize).for_each(|i| out[i] = drawn[i].map(|d| d.texel));

    // (4) Patches, where nothing is yet.
    let patches = mending.patches(k);
    let mut asked = [(); 3].map(|()| vec![false; if patches.is_empty() { 0 } else { out.len() }]);
    for patch in patches {
        let texel = Texel {
            colour: patch.light.map(screen),
            normal: window.axes.map(|a| dot(a, patch.normal) as f32),
            two_sided: patch.two_sided,
        };
        let asked = &mut asked[patch.limit as usize];
        for i in window.fan(patch.from, patch.to, patch.spread) {
            if out[i].is_some() || std::mem::replace(&mut asked[i], true) {
                continue;
            }
            let middle = [i as u32 % size[0], i as u32 / size[0]].map(|c| f64::from(c) + 0.5);
            let fits = match patch.limit {
                Limit::Drawn => kept[i],
                limit => mending.is_within(window.point(middle), limit),
            };
            if fits {
                out[i] = Some(drawn[i].map_or(texel, |d| d.texel));
            }
        }
    }
    out
}

/// Up to eight texels around one.
pub fn neighbours(i: usize, size: [u32; 2]) -> impl Iterator<Item = usize> {
    let [w, h] = size.map(|s| s as usize);
    let (x, y) = (i % w, i / w);
    let rows = y.saturating_sub(1)..=(y + 1).min(h - 1);
    rows.flat_map(move |v| (x.saturating_sub(1)..=(x + 1).min(w - 1)).map(move |u| v * w + u)).filter(move |&j| j != i)
}

/// Right, up and the normal: up is z where that can be seen.
fn axes(normal: Vec3) -> [Vec3; 3] {
    let up = if normal[2].abs() < 0.999 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
    let right = unit(cross(up, normal));
    [right, cross(normal, right), normal]
}
