//! Counters of one block of 16 x 16 x 16 sampled planes, and the cones that are drawn into them.
//!
//! For each row of 16 samples along the block's first axis a cone's half-spaces leave an interval; sixteen rows are
//! worked out side by side. All numbers that decide are multiples of 1/4 below 2^22, exact in f32; a quotient is
//! off by at most 10^-5, and no boundary comes nearer to a sample than 1/16,500: rounding never decides.

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

/// The largest counter and the first place that has it.
pub fn largest(counters: &Counters) -> (u16, u16) {
    let most = wide::run(Most(counters));
    let rows = counters.as_chunks::<SIDE>().0;
    let row = rows.iter().position(|row| row.contains(&most)).expect("it is the largest");
    (most, (row * SIDE + rows[row].iter().position(|&c| c == most).expect("it is there")) as u16)
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

/// `MASKS[first][last + 1]`: all bits at first..=last.
static MASKS: [[[u16; SIDE]; SIDE + 1]; SIDE + 1] = {
    let mut out = [[[0; SIDE]; SIDE + 1]; SIDE + 1];
    let mut first = 0;
    while first <= SIDE {
        let mut end = 0;
        while end <= SIDE {
            let mut x = first;
            while x < end {
                out[first][end][x] = u16::MAX;
                x += 1;
            }
            end += 1;
        }
        first += 1;
    }
    out
};

/// Of a number in 0..2^16 that is whole or farther than 1/40,000 below the next whole one: rounds to the last bit of a
/// number at 2^23. Two additions; a cast would also ask for what is too large and what is no number.
#[inline(always)]
fn floor(v: f32) -> i32 {
    const SHIFT: f32 = 8_388_608.0;
    ((v - 0.499_975) + SHIFT).to_bits() as i32 - SHIFT.to_bits() as i32
}

#[inline(always)]
fn draw_by(Draw { counters, planes, span, by: add }: Draw) -> bool {
    let [[x0, x1], [y0, y1], [z0, z1]] = *span;
    let lanes: [f32; SIDE] = std::array::from_fn(|y| y as f32);
    let mut any = false;
    for z in z0..=z1 {
        let mut low = [(x0 - 1) as f32; SIDE];
        let mut high = [(x1 + 1) as f32; SIDE];
        for &[start, dx, dy, dz] in planes {
            let start = start + dz * z as f32;
            if dx == 0.0 {
                for y in 0..SIDE {
                    high[y] = if start + dy * lanes[y] <= 0.0 { -1.0 } else { high[y] };
                }
                continue;
            }
            let by = -1.0 / dx;
            if dx > 0.0 {
                for y in 0..SIDE {
                    let at = (start + dy * lanes[y]) * by;
                    low[y] = if at > low[y] { at } else { low[y] };
                }
            } else {
                for y in 0..SIDE {
                    let at = (start + dy * lanes[y]) * by;
                    high[y] = if at < high[y] { at } else { high[y] };
                }
            }
        }
        // Samples x with low < x < high; both are between -1 and 16 now, so that truncation is floor after a shift.
        let (mut first, mut end) = ([0i32; SIDE], [0i32; SIDE]);
        for y in 0..SIDE {
            let l = if low[y] < 16.0 { low[y] } else { 16.0 };
            let h = if high[y] > -1.0 { high[y] } else { -1.0 };
            first[y] = floor(l + 17.0) - 16;
            end[y] = 17 - floor(17.0 - h);
        }
        for y in y0 as usize..=y1 as usize {
            if first[y] < end[y] {
                any = true;
                let mask = MASKS[first[y] as usize][end[y] as usize];
                let row = (z as usize * SIDE + y) * SIDE;
                let row: &mut [u16; SIDE] = (&mut counters[row..row + SIDE]).try_into().expect("16 counters");
                // Read whole, then written whole: nobody has to know that the two do not overlap.
                let old = *row;
                *row = std::array::from_fn(|x| old[x].wrapping_add(mask[x] & add));
            }
        }
    }
    any
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
                let at = [i % 16, i / 16 % 16, i / 256];
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
