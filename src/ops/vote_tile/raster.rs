//! Counters of one block of 16 x 16 x 16 sampled planes, and the cones that are drawn into them.
//!
//! For each row of 16 samples along the block's first axis a cone's half-spaces leave an interval; sixteen rows are
//! worked out and counted side by side: counters lie with the second axis fastest, then the first. All numbers that
//! decide are multiples of 1/4 below 2^22, exact in f32; a quotient is off by at most 10^-5, and no boundary comes nearer
//! to a sample than 1/16,500: rounding never decides.

use super::cones::{Facet, axes};
use crate::geom::wide::{self, Work};

/// Samples along each side of a block.
pub const SIDE: usize = 16;
pub type Counters = [u16; SIDE * SIDE * SIDE];

/// First and last sample of a box in a block, per axis.
pub type Span = [[i32; 2]; 3];

/// Corner values of a block's first sample, and which of them the axes are.
#[derive(Clone, Copy)]
pub struct Origin {
    pub w: [i64; 4],
    pub fixed: usize,
}

/// Where a half-space meets a block.
pub enum Meets {
    Nowhere,
    Everywhere,
    /// The value at the first sample and what a step along each axis adds.
    Somewhere([f32; 4]),
}

impl Facet {
    /// The value at a block's first sample and what a step along each axis adds.
    #[inline(always)]
    fn plane(&self, w: [i32; 4], axes: [usize; 3]) -> [f32; 4] {
        let start: i32 = (0..4).map(|i| i32::from(self.a[i]) * w[i]).sum();
        let [x, y, z] = axes.map(|axis| 2.0 * f32::from(self.a[axis]));
        [start as f32 + 0.25 * f32::from(self.sign), x, y, z]
    }

    /// How the half-space meets the samples of `span`.
    #[inline]
    pub fn meets(&self, origin: &Origin, span: &Span) -> Meets {
        let start: i64 = (0..4).map(|i| i64::from(self.a[i]) * origin.w[i]).sum();
        let steps = axes(origin.fixed).map(|axis| 2 * i64::from(self.a[axis]));
        let (mut least, mut most) = (start, start);
        for (step, [first, last]) in steps.into_iter().zip(*span) {
            let (a, b) = (step * i64::from(first), step * i64::from(last));
            least += a.min(b);
            most += a.max(b);
        }
        let holds = |v: i64| v > 0 || v == 0 && self.sign > 0;
        if !holds(most) {
            return Meets::Nowhere;
        }
        if holds(least) {
            return Meets::Everywhere;
        }
        let quarter = 0.25 * f32::from(self.sign);
        Meets::Somewhere([start as f32 + quarter, steps[0] as f32, steps[1] as f32, steps[2] as f32])
    }
}

/// Adds `by` (1, or -1 as a u16) to every sample of the span that all half-spaces hold. False where none does.
pub fn draw(counters: &mut Counters, planes: &[[f32; 4]], span: &Span, by: u16) -> bool {
    wide::run(Draw { counters, planes, span, by })
}

struct Draw<'a> {
    counters: &'a mut Counters,
    planes: &'a [[f32; 4]],
    span: &'a Span,
    by: u16,
}

impl Work for Draw<'_> {
    type Out = bool;
    #[inline(always)]
    fn work(self) -> bool {
        draw_by(self)
    }
}

/// Counters of 4^3 samples each: how many cones may reach any of them.
pub type Rough = [u32; 64];

/// Adds `by` (1, or -1 as a u32) wherever none of a cone's half-spaces keeps it from all samples. False where one
/// always does.
pub fn rough(counters: &mut Rough, facets: &[Facet], origin: &Origin, by: u32) -> bool {
    wide::run(Roughly { counters, facets, origin, by })
}

struct Roughly<'a> {
    counters: &'a mut Rough,
    facets: &'a [Facet],
    origin: &'a Origin,
    by: u32,
}

impl Work for Roughly<'_> {
    type Out = bool;
    #[inline(always)]
    fn work(self) -> bool {
        const X: [f32; 16] = [0., 4., 8., 12., 0., 4., 8., 12., 0., 4., 8., 12., 0., 4., 8., 12.];
        const Y: [f32; 16] = [0., 0., 0., 0., 4., 4., 4., 4., 8., 8., 8., 8., 12., 12., 12., 12.];
        let (w, axes) = (self.origin.w.map(|v| v as i32), axes(self.origin.fixed));
        // (1) of each half-space the best that the parts of the first slice have
        let mut slices = [([0.0f32; 16], 0.0f32); 16];
        for (facet, slice) in self.facets.iter().zip(&mut slices) {
            let [start, dx, dy, dz] = facet.plane(w, axes);
            let most = |d: f32| if d > 0.0 { 3.0 * d } else { 0.0 };
            let start = start + most(dx) + most(dy) + most(dz);
            for i in 0..16 {
                slice.0[i] = start + dx * X[i] + dy * Y[i];
            }
            slice.1 = 4.0 * dz;
        }
        let slices = &slices[..self.facets.len()];
        // (2) slice by slice, 16 parts side by side
        let mut any = [0u32; 16];
        for (z, counters) in self.counters.as_chunks_mut::<16>().0.iter_mut().enumerate() {
            let mut least = [1.0f32; 16];
            for (slice, dz) in slices {
                let dz = dz * z as f32;
                for i in 0..16 {
                    let at = slice[i] + dz;
                    least[i] = if at < least[i] { at } else { least[i] };
                }
            }
            for i in 0..16 {
                let inside = if least[i] > 0.0 { self.by } else { 0 };
                counters[i] = counters[i].wrapping_add(inside);
                any[i] |= inside;
            }
        }
        any.iter().fold(0, |a, i| a | i) != 0
    }
}

/// The largest counter and the first place that has it, with the first axis fastest.
pub fn largest(counters: &Counters) -> (u16, u16) {
    let most = wide::run(Most(counters));
    (most, first_place(counters, most))
}

/// The first sample, with the first axis fastest, that has a count.
pub fn first_place<T: PartialEq + Copy>(counters: &[T], count: T) -> u16 {
    let slice = counters.chunks(SIDE * SIDE).position(|slice| slice.contains(&count)).expect("it is there");
    let has = |&(y, x): &(usize, usize)| counters[(slice * SIDE + x) * SIDE + y] == count;
    let (y, x) = (0..SIDE * SIDE).map(|i| (i / SIDE, i % SIDE)).find(has).expect("it is there");
    ((slice * SIDE + y) * SIDE + x) as u16
}

struct Most<'a>(&'a Counters);

impl Work for Most<'_> {
    type Out = u16;
    #[inline(always)]
    fn work(self) -> u16 {
        let mut most = [0u16; SIDE];
        for row in self.0.as_chunks::<SIDE>().0 {
            for x in 0..SIDE {
                most[x] = most[x].max(row[x]);
            }
        }
        most.into_iter().fold(0, u16::max)
    }
}

/// A half-space along the rows: for each y the bound of x less what z adds, times `dx`.
#[derive(Clone, Copy)]
struct Slope {
    at: [f32; SIDE],
    dz: f32,
    by: f32,
}

#[inline(always)]
fn draw_by(Draw { counters, planes, span, by: add }: Draw) -> bool {
    /// Adding it leaves the nearest whole number in the lowest bits.
    const SHIFT: f32 = 12_582_912.0;
    let [[x0, x1], [y0, y1], [z0, z1]] = *span;
    let lanes: [f32; SIDE] = std::array::from_fn(|y| y as f32);
    // (1) bounds from below, from above; planes along x only say which y are left
    let mut slopes = [Slope { at: [0.0; SIDE], dz: 0.0, by: 0.0 }; 16];
    let (mut below, mut above) = (0, 16);
    let mut flat = [[0.0; 4]; 16];
    let mut flats = 0;
    for &[start, dx, dy, dz] in planes {
        if dx == 0.0 {
            flat[flats] = [start, dx, dy, dz];
            flats += 1;
            continue;
        }
        // Half a sample further: then the nearest whole number is the first inside, or the first no longer inside.
        let start = start - 0.5 * dx;
        let slope = Slope { at: std::array::from_fn(|y| start + dy * lanes[y]), dz, by: -1.0 / dx };
        if dx > 0.0 {
            slopes[below] = slope;
            below += 1;
        } else {
            above -= 1;
            slopes[above] = slope;
        }
    }
    let (from_below, from_above) = (&slopes[..below], &slopes[above..]);
    let outside: [bool; SIDE] = std::array::from_fn(|y| (y as i32) < y0 || y as i32 > y1);
    let ends: [f32; SIDE] = std::array::from_fn(|y| if outside[y] { -1.0 } else { (x1 + 1) as f32 });
    // Slices that some plane has no part of, for any x and y.
    let mut gone = [0u16; SIDE];
    for &[start, dx, dy, dz] in planes {
        let most = |d: f32, first: i32, last: i32| d * (if d > 0.0 { last } else { first }) as f32;
        let start = start + most(dx, x0, x1) + most(dy, y0, y1);
        for z in 0..SIDE {
            gone[z] |= if start + dz * lanes[z] <= 0.0 { u16::MAX } else { 0 };
        }
    }
    let mut any = false;
    for z in z0..=z1 {
        if gone[z as usize % SIDE] != 0 {
            continue;
        }
        // (2) for each y the first x inside and the first no longer inside
        let (mut low, mut high) = ([x0 as f32; SIDE], ends);
        let depth = z as f32;
        for s in from_below {
            let dz = s.dz * depth;
            for y in 0..SIDE {
                let at = (s.at[y] + dz) * s.by;
                low[y] = if at > low[y] { at } else { low[y] };
            }
        }
        for s in from_above {
            let dz = s.dz * depth;
            for y in 0..SIDE {
                let at = (s.at[y] + dz) * s.by;
                high[y] = if at < high[y] { at } else { high[y] };
            }
        }
        for &[start, _, dy, dz] in &flat[..flats] {
            let start = start + dz * depth;
            for y in 0..SIDE {
                high[y] = if start + dy * lanes[y] <= 0.0 { -1.0 } else { high[y] };
            }
        }
        let (mut first, mut end) = ([0u16; SIDE], [0u16; SIDE]);
        for y in 0..SIDE {
            let l = if low[y] < 16.0 { low[y] } else { 16.0 };
            let h = if high[y] > 0.0 { high[y] } else { 0.0 };
            first[y] = (l + SHIFT).to_bits() as u16;
            end[y] = (h + SHIFT).to_bits() as u16;
        }
        let (mut starts, mut rests) = ([0u16; SIDE], [0u16; SIDE]);
        for y in 0..SIDE {
            let empty = if first[y] < end[y] { 0 } else { 16 };
            starts[y] = first[y] | empty;
            rests[y] = (16 - end[y]) | empty;
        }
        // (3) column by column, all y at once
        let (from, rest) = (least(starts), least(rests));
        if from + rest >= 16 {
            continue;
        }
        let to = 16 - rest;
        any = true;
        let slice = &mut counters[z as usize * SIDE * SIDE..][..SIDE * SIDE];
        let columns = &mut slice.as_chunks_mut::<SIDE>().0[usize::from(from)..usize::from(to)];
        // How far the column is behind the first one inside, and how far it may be.
        let mut behind: [u16; SIDE] = std::array::from_fn(|y| from.wrapping_sub(first[y]));
        let long: [u16; SIDE] = std::array::from_fn(|y| end[y].saturating_sub(first[y]));
        for column in columns {
            for y in 0..SIDE {
                column[y] = column[y].wrapping_add(if behind[y] < long[y] { add } else { 0 });
                behind[y] = behind[y].wrapping_add(1);
            }
        }
    }
    any
}

#[inline(always)]
fn least(a: [u16; SIDE]) -> u16 {
    let b: [u16; 8] = std::array::from_fn(|i| a[i].min(a[i + 8]));
    let c: [u16; 4] = std::array::from_fn(|i| b[i].min(b[i + 4]));
    let d: [u16; 2] = std::array::from_fn(|i| c[i].min(c[i + 2]));
    d[0].min(d[1])
}

#[cfg(test)]
mod tests {
    use super::super::cones::sample;
    use super::*;

    /// Every sample of a block against exact arithmetic, for thin and wide cones.
    #[test]
    fn drawn_as_counted() {
        let mut state = 3u64;
        let mut dice = |n: i64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) as i64 % n
        };
        let mut drawn = 0;
        for round in 0..3000 {
            let cells = [9u32, 67, 131, 1027][round % 4];
            let cube = dice(8) as u8;
            let blocks = (2 * i64::from(cells)) / 16;
            let block = [0; 3].map(|_| dice(blocks.max(1)) as u16);
            let origin = Origin { w: sample(cells, cube, block.map(|b| 16 * b)), fixed: usize::from(cube / 2) };
            // Half-spaces that pass near a sample of the block.
            let near = sample(cells, cube, block.map(|b| 16 * b + dice(16) as u16));
            let n = i64::from(cells);
            let facet = |dice: &mut dyn FnMut(i64) -> i64| {
                let node = [0; 3].map(|_| dice(n + 1) as i32);
                let a = crate::geom::lattice::factors(cells, node);
                let v: i64 = (0..4).map(|i| i64::from(a[i]) * near[i]).sum();
                let sign = if v >= 0 { 1 } else { -1 };
                Facet { a: a.map(|v| (i32::from(sign) * v) as i16), sign }
            };
            let facets: Vec<Facet> = (0..4 + dice(5)).map(|_| facet(&mut dice)).collect();
            let mut side = || {
                let (a, b) = (dice(16) as i32, dice(16) as i32);
                [a.min(b), a.max(b)]
            };
            let span = if round % 3 == 0 { [[0, 15]; 3] } else { [side(), side(), side()] };
            let mut counters = [7u16; 4096];
            let mut planes = Vec::new();
            let mut nowhere = false;
            for f in &facets {
                match f.meets(&origin, &span) {
                    Meets::Nowhere => nowhere = true,
                    Meets::Everywhere => {}
                    Meets::Somewhere(plane) => planes.push(plane),
                }
            }
            let any = !nowhere && draw(&mut counters, &planes, &span, 1);
            let mut count = 0;
            for (i, &c) in counters.iter().enumerate() {
                let at = [i / 16 % 16, i % 16, i / 256];
                let w = sample(cells, cube, [0, 1, 2].map(|k| 16 * block[k] + at[k] as u16));
                let in_span = (0..3).all(|k| span[k][0] <= at[k] as i32 && at[k] as i32 <= span[k][1]);
                let held = in_span && facets.iter().all(|f| f.holds(&w));
                assert_eq!(c, 7 + u16::from(held), "round {round}, sample {at:?}");
                count += usize::from(held);
            }
            assert_eq!(any, count > 0);
            drawn += count;
            if any {
                draw(&mut counters, &planes, &span, u16::MAX);
                assert!(counters.iter().all(|&c| c == 7));
            }
        }
        assert!(drawn > 50_000);
    }
}
