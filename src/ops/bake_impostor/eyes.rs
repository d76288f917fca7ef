//! What eyes all around see of a mesh, and where they see through its quads.
//!
//! Two eyes look along each line, one from each end: they share the places of corners and the pixels of triangles.

use super::canvas::Window;
use super::pieces::Piece;
use super::planes::Scene;
use crate::artifact::mesh::Alpha;
use crate::geom::raster::{self, PARTS};
use crate::geom::space::{Vec3, cross, dot, sub, unit};
use crate::io::views::is_inside;

/// Lines of sight, evenly spread over half of all directions.
pub const LINES: usize = 64;
/// Pixels of a picture a cell, about: its side is the next multiple of a word of marks, at most so many.
const A_CELL: f64 = 8.0;
const MOST: u32 = 512;
/// Pixels from the outline within which nothing is missing.
const OUTLINE: u32 = 2;
/// Triangles of so many pixels, so much longer than high, are marked along their sides as well.
const LONG: i64 = 8;
const POINTED: i64 = 3;
/// Quads and lines closer to parallel than that do not show.
const GRAZING: f64 = 1e-6;
/// Parts of a texel.
const FIXED: f64 = (1u64 << 32) as f64;

/// Two eyes that look along a line.
pub struct Eyes {
    /// Right, up, and towards the first of them.
    pub axes: [Vec3; 3],
    middle: Vec3,
    /// Pixels a metre.
    scale: f64,
    /// Pixels along each side of their pictures.
    side: u32,
}

/// A place of the mesh that an eye sees where no quad draws anything.
pub struct Missing {
    /// Towards the eye.
    pub eye: Vec3,
    pub triangle: usize,
    /// Of its corners.
    pub weights: [f64; 3],
    /// Of the copies of its picture.
    pub level: usize,
}

/// Pixels of a picture that are marked, row by row, 64 a word.
struct Marked(Vec<u64>);

impl Marked {
    fn of<T>(pixels: &[T], is_marked: impl Fn(&T) -> bool) -> Self {
        let word = |w: &[T]| w.iter().enumerate().map(|(b, t)| u64::from(is_marked(t)) << b).sum();
        Self(pixels.chunks(64).map(word).collect())
    }

    #[inline]
    fn has(&self, i: usize) -> bool {
        self.0[i / 64] >> (i % 64) & 1 == 1
    }

    /// Those that are marked, in order.
    fn all(&self) -> impl Iterator<Item = usize> {
        self.0.iter().enumerate().flat_map(|(w, &word)| {
            let rest = std::iter::successors(Some(word), |rest| Some(rest & rest.wrapping_sub(1)));
            rest.take_while(|&rest| rest != 0).map(move |rest| 64 * w + rest.trailing_zeros() as usize)
        })
    }
}

/// Pixels of a window's upper left corner, and of one column and one row on.
struct Laid {
    corner: [f64; 2],
    column: [f64; 2],
    row: [f64; 2],
}

/// What can be drawn without sticking out.
pub struct Outline {
    pub eyes: Eyes,
    /// Where the mesh is, from whichever side.
    inside: Marked,
    /// Half a cell around as well.
    around: Marked,
}

/// A piece as eyes see it.
pub struct Shown<'a> {
    pub piece: &'a Piece,
    pub two_sided: bool,
    texels: Vec<bool>,
}

impl<'a> Shown<'a> {
    /// Only those texels that are `within`.
    pub fn new(piece: &'a Piece, within: impl Fn(&Window, &mut Vec<u32>)) -> Self {
        let is_shown = |&i: &u32| piece.texels[i as usize].is_some();
        let mut shown: Vec<u32> = (0..piece.texels.len() as u32).filter(is_shown).collect();
        within(&piece.window, &mut shown);
        let mut texels = vec![false; piece.texels.len()];
        shown.into_iter().for_each(|i| texels[i as usize] = true);
        Self { piece, two_sided: piece.two_sided(), texels }
    }

    pub fn draws(&self, p: Vec3) -> bool {
        self.piece.window.texel_at(p).is_some_and(|i| self.texels[i])
    }
}

/// What an eye sees of the mesh.
pub struct Seen {
    drawn: Marked,
    /// The nearest at each pixel of these, row by row.
    triangles: Vec<u32>,
}

/// Depth and number of the nearest triangle at each pixel.
struct DepthBuffer {
    near: Vec<f32>,
    triangle: Vec<u32>,
}

/// Those of two eyes, used again for the next two.
pub struct DepthBuffers([DepthBuffer; 2]);

const NONE: u32 = u32::MAX;

impl DepthBuffers {
    pub fn new() -> Self {
        Self([(); 2].map(|()| DepthBuffer { near: Vec::new(), triangle: Vec::new() }))
    }
}

impl DepthBuffer {
    fn clear(&mut self, pixels: usize) {
        self.near.clear();
        self.near.resize(pixels, f32::NEG_INFINITY);
        self.triangle.clear();
        self.triangle.resize(pixels, NONE);
    }

    fn seen(&self) -> Seen {
        let drawn = Marked::of(&self.triangle, |&t| t != NONE);
        let triangles = drawn.all().map(|i| self.triangle[i]).collect();
        Seen { drawn, triangles }
    }
}

impl Eyes {
    /// Along the line of this number: they spiral from the pole to the equator. `half`: half of the picture's width.
    pub fn new(middle: Vec3, half: f64, cell: f64, i: usize) -> Self {
        let z = 1.0 - (2 * i + 1) as f64 / (2 * LINES) as f64;
        let around = (1.0 - z * z).sqrt();
        // The golden angle.
        let (sin, cos) = libm::sincos(i as f64 * 2.399_963_229_728_653);
        let eye = [around * cos, around * sin, z];
        let right = unit(cross([0.0, 0.0, 1.0], eye));
        let side = ((2.0 * half / cell * A_CELL / 64.0).ceil() * 64.0).min(f64::from(MOST)) as u32;
        Self { axes: [right, cross(eye, right), eye], middle, scale: f64::from(side / 2) / half, side }
    }

    fn pixels(&self) -> usize {
        (self.side * self.side) as usize
    }

    /// Where a place is on the picture, in parts of a pixel, and how near to the first eye.
    fn place(&self, p: Vec3) -> ([i64; 2], f32) {
        let middle = f64::from(self.side / 2);
        let [x, y, z] = self.axes.map(|a| dot(a, sub(p, self.middle)) * self.scale);
        // Not below zero on the picture: as a number without its part is the floor.
        let part = |v: f64| (v * PARTS as f64 + 0.5) as i64;
        ([part(middle + x), part(middle - y)], z as f32)
    }

    /// What each of the two sees of the mesh, and what may be drawn: up to a `margin` around.
    pub fn look(self, scene: &Scene, margin: f64, on: &mut DepthBuffers) -> (Outline, [Seen; 2]) {
        let (seen, mut sides) = self.seen(scene, &mut on.0);
        let mut inside = Marked(seen[0].drawn.0.iter().zip(&seen[1].drawn.0).map(|(a, b)| a | b).collect());
        sides.retain(|&i| !self.is_near(i, &inside));
        sides.into_iter().for_each(|i| inside.0[i / 64] |= 1 << (i % 64));
        let far = (margin * self.scale) as usize;
        let around = grown(&inside, self.side as usize / 64, far.clamp(1, self.side as usize));
        (Outline { eyes: self, inside, around }, seen)
    }

    /// And pixels along the sides of pointed triangles, near whose ends no pixel's middle may lie.
    fn seen(&self, scene: &Scene, both: &mut [DepthBuffer; 2]) -> ([Seen; 2], Vec<usize>) {
        let Scene { mesh, paint, .. } = scene;
        both.iter_mut().for_each(|buffer| buffer.clear(self.pixels()));
        let mut sides = Vec::new();
        let placed: Vec<([i64; 2], f32)> = mesh.positions.iter().map(|&p| self.place(p)).collect();
        for (t, corners) in mesh.triangles.iter().enumerate() {
            let corners = corners.map(|v| placed[v as usize]);
            let flat = corners.map(|c| c.0);
            let area = raster::doubled_area(&flat);
            self.mark_sides(&flat, area, &mut sides);
            let material = paint.material(t);
            // Counter-clockwise from outside is counter-clockwise for the first: y is down there.
            let shows = [area < 0 || material.double_sided, area > 0 || material.double_sided];
            let mask = match material.alpha {
                Alpha::Opaque => None,
                _ => paint.mask(t, self.level(scene, t, area)),
            };
            let nearness = corners.map(|c| f64::from(c.1) / area.abs() as f64);
            raster::values(&flat, [self.side; 2], |x, y, values, area| {
                let near = (0..3).map(|c| values[c] as f64 * nearness[c]).sum::<f64>() as f32;
                let i = (y * self.side + x) as usize;
                let is_drawn = || mask.as_ref().is_none_or(|mask| mask.shows(values.map(|v| v as f64 / area as f64)));
                for (k, near) in [near, -near].into_iter().enumerate() {
                    if shows[k] && near > both[k].near[i] && is_drawn() {
                        both[k].near[i] = near;
                        both[k].triangle[i] = t as u32;
                    }
                }
            });
        }
        (both.each_ref().map(DepthBuffer::seen), sides)
    }

    /// Whether one of the pixels around, two far, is marked.
    fn is_near(&self, i: usize, marked: &Marked) -> bool {
        let side = self.side as usize;
        let around = |c: usize| c.saturating_sub(2)..(c + 3).min(side);
        around(i / side).any(|y| around(i % side).any(|x| marked.has(y * side + x)))
    }

    /// Pixels along a pointed triangle's sides.
    fn mark_sides(&self, flat: &[[i64; 2]; 3], doubled_area: i64, out: &mut Vec<usize>) {
        let sides = [0, 1, 2].map(|i| [0, 1].map(|k| flat[(i + 1) % 3][k] - flat[i][k]));
        let lengths = sides.map(|[x, y]| x.abs().max(y.abs()));
        let longest = lengths.into_iter().max().expect("three sides");
        if longest < LONG * PARTS || POINTED * doubled_area.abs() >= longest * longest {
            return;
        }
        let side = i64::from(self.side);
        for ((from, along), length) in flat.iter().zip(sides).zip(lengths) {
            let steps = length / PARTS + 1;
            for s in 0..steps {
                let [x, y] = [0, 1].map(|k| (from[k] + along[k] * s / steps).div_euclid(PARTS));
                if (0..side).contains(&x) && (0..side).contains(&y) {
                    out.push((y * side + x) as usize);
                }
            }
        }
    }

    fn level(&self, scene: &Scene, triangle: usize, area: i64) -> usize {
        scene.paint.level(triangle, area.abs() as f64 / (2 * PARTS * PARTS) as f64)
    }

    /// Where a place is on the picture, in pixels.
    fn spot(&self, p: Vec3) -> [f64; 2] {
        let (p, middle) = (sub(p, self.middle), f64::from(self.side / 2));
        [middle + dot(self.axes[0], p) * self.scale, middle - dot(self.axes[1], p) * self.scale]
    }

    /// How texels lie on the picture.
    fn laid(&self, window: &Window) -> Laid {
        let texel = window.texel * self.scale;
        let along = |a: Vec3, sign: f64| [dot(a, self.axes[0]) * sign * texel, -dot(a, self.axes[1]) * sign * texel];
        Laid {
            corner: self.spot(window.point([0.0; 2])),
            column: along(window.axes[0], 1.0),
            row: along(window.axes[1], -1.0),
        }
    }

    /// Pixels where quads draw something: bit k for eye k.
    fn covered(&self, pieces: &[Shown]) -> Vec<u8> {
        let side = self.side;
        let mut out = vec![0; self.pixels()];
        for shown in pieces {
            let window = &shown.piece.window;
            let facing = dot(window.axes[2], self.axes[2]);
            if facing.abs() < GRAZING {
                continue;
            }
            let bits = if shown.two_sided { 3 } else { 1 << u8::from(facing < 0.0) };
            let Laid { corner, column: [xu, yu], row: [xv, yv] } = self.laid(window);
            // The way back: a pixel right and one down are so many columns and rows.
            let all = xu * yv - xv * yu;
            let [ux, uy, vx, vy] = [yv / all, -xv / all, -yu / all, xu / all];
            let [w, h] = window.size.map(f64::from);
            let [width, right, bottom] = [window.size[0], window.size[0] - 1, window.size[1] - 1].map(i64::from);
            let ends = [0.0, w * yu, h * yv, w * yu + h * yv].map(|y| corner[1] + y);
            let low = ends.into_iter().fold(f64::INFINITY, f64::min).max(0.0) as u32;
            let high = ends.into_iter().fold(0.0, f64::max).min(f64::from(side)) as u32;
            for y in low..(high + 1).min(side) {
                // (1) Of the row the pixels that lie in the window.
                let down = f64::from(y) + 0.5 - corner[1];
                let (u0, v0) = (uy * down - ux * corner[0], vy * down - vx * corner[0]);
                let (mut first, mut last) = (0.0f64, f64::from(side));
                for (at, step, end) in [(u0, ux, w), (v0, vx, h)] {
                    let (a, b) = (-at / step, (end - at) / step);
                    if step != 0.0 {
                        (first, last) = (first.max(a.min(b)), last.min(a.max(b)));
                    } else if at < 0.0 || at >= end {
                        last = 0.0;
                    }
                }
                // (2) Their texels, at their middles; in whole numbers, which step faster.
                let (first, last) = ((first + 0.5) as u32, ((last + 0.5) as u32).min(side));
                let at = f64::from(first) + 0.5;
                let fixed = |v: f64| (v * FIXED) as i64;
                let (mut u, mut v) = (fixed(u0 + ux * at), fixed(v0 + vx * at));
                let (du, dv) = (fixed(ux), fixed(vx));
                let row = (y * side) as usize;
                for pixel in out.iter_mut().take(row + last as usize).skip(row + first as usize) {
                    let texel = (v >> 32).min(bottom) * width + (u >> 32).min(right);
                    if shown.texels.get(texel as usize) == Some(&true) {
                        *pixel |= bits;
                    }
                    (u, v) = (u + du, v + dv);
                }
            }
        }
        out
    }

    /// What is missing for the two.
    pub fn missing(&self, scene: &Scene, seen: &[Seen; 2], pieces: &[Shown]) -> Vec<Missing> {
        let covered = self.covered(pieces);
        let mut missing = Vec::new();
        for k in 0..2 {
            let eye = self.axes[2].map(|c| if k == 0 { c } else { -c });
            let Seen { drawn, triangles } = &seen[k];
            for (i, &triangle) in drawn.all().zip(triangles) {
                if covered[i] >> k & 1 == 0 && is_inside(self.side, OUTLINE, i, |j| drawn.has(j)) {
                    let triangle = triangle as usize;
                    let flat = scene.mesh.corners(triangle).map(|p| self.place(p).0);
                    let (values, area) = raster::value_at(&flat, [i as u32 % self.side, i as u32 / self.side]);
                    let weights = values.map(|v| v as f64 / area as f64);
                    let level = self.level(scene, triangle, area);
                    missing.push(Missing { eye, triangle, weights, level });
                }
            }
        }
        missing
    }
}

impl Outline {
    /// Of these texels those whose middles are in it, or `around` it.
    pub fn keep(&self, window: &Window, around: bool, texels: &mut Vec<u32>) {
        let laid = self.eyes.laid(window);
        let width = window.size[0];
        texels.retain(|&i| {
            let (u, v) = (f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
            self.marks([0, 1].map(|k| laid.corner[k] + u * laid.column[k] + v * laid.row[k]), around)
        });
    }

    /// Whether a place is in it, or `around` it.
    pub fn has(&self, p: Vec3, around: bool) -> bool {
        self.marks(self.eyes.spot(p), around)
    }

    #[inline]
    fn marks(&self, [x, y]: [f64; 2], around: bool) -> bool {
        let side = f64::from(self.eyes.side);
        let pixels = if around { &self.around } else { &self.inside };
        let at = |x: f64, y: f64| y as usize * self.eyes.side as usize + x as usize;
        x >= 0.0 && y >= 0.0 && x < side && y < side && pixels.has(at(x, y))
    }
}

/// Pixels at most `far` from one of these, along rows of so many `words` and columns.
fn grown(pixels: &Marked, words: usize, far: usize) -> Marked {
    let mut out = pixels.0.clone();
    for _ in 0..far {
        for row in out.chunks_exact_mut(words) {
            let mut left = 0;
            for w in 0..words {
                let (here, right) = (row[w], row.get(w + 1).copied().unwrap_or(0));
                row[w] |= here << 1 | left >> 63 | here >> 1 | right << 63;
                left = here;
            }
        }
        let before = out.clone();
        for w in 0..out.len() {
            let [above, below] = [w.wrapping_sub(words), w + words].map(|n| before.get(n).copied().unwrap_or(0));
            out[w] |= above | below;
        }
    }
    Marked(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_grow_to_all_sides_and_stay_on_the_picture() {
        for side in [64, 512] {
            for (x, y) in
                [(0, 0), (63, 5), (64, 5), (20, 30), (200, 300), (side - 1, side - 1), (0, 10), (side - 1, 100)]
            {
                if x >= side || y >= side {
                    continue;
                }
                let all: Vec<usize> = (0..side * side).collect();
                let one = Marked::of(&all, |&i| i == y * side + x);
                for far in [1, 3, 70] {
                    let grown = grown(&one, side / 64, far);
                    let near = |i: usize| (i % side).abs_diff(x) <= far && (i / side).abs_diff(y) <= far;
                    assert!(all.iter().all(|&i| grown.has(i) == near(i)), "{x}, {y} of {side}: {far}");
                    assert!(grown.all().eq(all.iter().copied().filter(|&i| near(i))));
                }
            }
        }
    }
}
