//! The planes that a stick votes for: a cone in the space of corner values, and the sampled planes near it.
//!
//! Sampled planes are the centres of (2N)^3 cells in each of eight cubes. In cube c = 2 i + s (s = 0: +, 1: -) the value
//! w_i is +2N or -2N and the others, in order, are 2 k + 1 - 2N for k in 0..2N: whole numbers, never 0 together.

use rayon::prelude::*;

use super::dictionary::Dictionary;
use super::sticks::Stick;

/// A half-space of planes: `a . w + sign / 4 > 0`. With whole w that is a . w >= 0 for a black node (sign 1) and
/// a . w < 0 for a white one (sign -1, a negated), and never an equality.
#[derive(Clone, Copy, Debug)]
pub struct Facet {
    pub a: [i16; 4],
    pub sign: i16,
}

impl Facet {
    /// Whether the plane w, given `scale` times too large, is inside.
    pub fn holds(&self, w: &[i64; 4]) -> bool {
        let dot: i64 = (0..4).map(|i| i64::from(self.a[i]) * w[i]).sum();
        dot > 0 || dot == 0 && self.sign > 0
    }
}

/// Samples that the cone of a stick may hold in one cube.
#[derive(Clone, Copy, Debug)]
pub struct Reach {
    pub stick: u32,
    pub cube: u8,
    /// First and last sample along each axis of the cube.
    pub low: [u16; 3],
    pub high: [u16; 3],
}

/// The cones of all voting sticks.
pub struct Cones {
    /// n + 1 offsets into `facets`.
    starts: Vec<u32>,
    facets: Vec<Facet>,
    pub reaches: Vec<Reach>,
    /// A plane well inside of each cone.
    pub middles: Vec<[i64; 4]>,
}

impl Cones {
    /// Sticks with their dictionary entries; numbers of sticks are places in this list.
    pub fn new(sticks: &[(Stick, u16)], dictionary: &Dictionary, cells: u32) -> Self {
        let nodes: Vec<[i32; 3]> = (0..dictionary.nodes()).map(|n| dictionary.node(n)).collect();
        // Pieces of one size whatever the number of threads.
        let parts: Vec<Cones> = sticks
            .par_chunks(1024)
            .enumerate()
            .map(|(part, sticks)| {
                let mut out =
                    Cones { starts: Vec::new(), facets: Vec::new(), reaches: Vec::new(), middles: Vec::new() };
                let mut clip = Clip::default();
                for (i, (stick, entry)) in sticks.iter().enumerate() {
                    for (n, black) in dictionary.facets(*entry) {
                        let sign = if black { 1 } else { -1 };
                        let a = stick.factors(nodes[n], cells).map(|v| sign * v as i16);
                        out.facets.push(Facet { a, sign });
                    }
                    out.starts.push(out.facets.len() as u32);
                    clip.start(dictionary.rays(*entry).map(|(ray, on)| (stick.to_corners(ray, cells), on)));
                    out.middles.push([0, 1, 2, 3].map(|k| clip.rays.iter().map(|r| r.w[k]).sum()));
                    clip.reaches(1024 * part as u32 + i as u32, cells, &mut out.reaches);
                }
                out
            })
            .collect();
        let mut out = Cones { starts: vec![0], facets: Vec::new(), reaches: Vec::new(), middles: Vec::new() };
        for part in parts {
            let base = out.facets.len() as u32;
            out.starts.extend(part.starts.iter().map(|s| s + base));
            out.facets.extend(part.facets);
            out.reaches.extend(part.reaches);
            out.middles.extend(part.middles);
        }
        out
    }

    pub fn facets(&self, stick: u32) -> &[Facet] {
        let s = stick as usize;
        &self.facets[self.starts[s] as usize..self.starts[s + 1] as usize]
    }
    /// Whether the stick votes for w (at any scale).
    pub fn holds(&self, stick: u32, w: &[i64; 4]) -> bool {
        self.facets(stick).iter().all(|f| f.holds(w))
    }
}

/// Corner values of a sample.
pub fn sample(cells: u32, cube: u8, at: [u16; 3]) -> [i64; 4] {
    let n = i64::from(cells);
    let fixed = usize::from(cube / 2);
    let mut out = [if cube.is_multiple_of(2) { 2 * n } else { -2 * n }; 4];
    for (axis, k) in axes(fixed).into_iter().zip(at) {
        out[axis] = 2 * i64::from(k) + 1 - 2 * n;
    }
    out
}

/// The three values that a cube leaves free.
pub fn axes(fixed: usize) -> [usize; 3] {
    match fixed {
        0 => [1, 2, 3],
        1 => [0, 2, 3],
        2 => [0, 1, 3],
        _ => [0, 1, 2],
    }
}

#[derive(Clone, Copy)]
struct Edge {
    w: [i64; 4],
    /// Facets of the cone and planes of the cube that it lies on.
    on: u32,
}

/// Cuts a cone by the sides of the cubes, exactly. Rays are intersections of three hyperplanes with factors below
/// 2^13, so with their common factor taken out they stay below 2^42.
#[derive(Default)]
struct Clip {
    rays: Vec<Edge>,
    work: Vec<Edge>,
    next: Vec<Edge>,
}

impl Clip {
    fn start(&mut self, rays: impl Iterator<Item = ([i64; 4], u16)>) {
        self.rays.clear();
        self.rays.extend(rays.map(|(w, on)| Edge { w, on: u32::from(on) }));
    }

    /// The samples' boxes in all cubes that the cone meets.
    fn reaches(&mut self, stick: u32, cells: u32, out: &mut Vec<Reach>) {
        for cube in 0..8u8 {
            let (fixed, sign) = (usize::from(cube / 2), if cube % 2 == 0 { 1 } else { -1 });
            if self.rays.iter().all(|r| sign * r.w[fixed] <= 0) {
                continue;
            }
            let axes = axes(fixed);
            self.work.clone_from(&self.rays);
            let mut cut = true;
            for (k, axis) in axes.into_iter().enumerate() {
                for (s, up) in [1, -1].into_iter().enumerate() {
                    cut = cut && self.cut(|w| sign * w[fixed] + up * w[axis], 1 << (16 + 2 * k + s));
                }
            }
            if !cut {
                continue;
            }
            let (mut low, mut high) = ([0; 3], [0; 3]);
            let n2 = 2.0 * f64::from(cells);
            for (k, axis) in axes.into_iter().enumerate() {
                let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
                for r in &self.work {
                    // From -2N to 2N; a sample's number is (value + 2N - 1) / 2.
                    let at = n2 * (r.w[axis] as f64 / (sign * r.w[fixed]) as f64);
                    least = least.min(at);
                    most = most.max(at);
                }
                low[k] = (((least + n2 - 1.0) / 2.0 - 1e-6).ceil()).max(0.0) as i32;
                high[k] = (((most + n2 - 1.0) / 2.0 + 1e-6).floor()).min(n2 - 1.0) as i32;
            }
            if (0..3).all(|k| low[k] <= high[k]) {
                out.push(Reach { stick, cube, low: low.map(|v| v as u16), high: high.map(|v| v as u16) });
            }
        }
    }

    /// Keeps the part of `work` where `side` is not negative; false where nothing of it has any extent.
    fn cut(&mut self, side: impl Fn(&[i64; 4]) -> i64, bit: u32) -> bool {
        let at = |r: &Edge| side(&r.w);
        if self.work.iter().all(|r| at(r) > 0) {
            return true;
        }
        if self.work.iter().all(|r| at(r) <= 0) {
            return false;
        }
        self.work.iter_mut().filter(|r| side(&r.w) == 0).for_each(|r| r.on |= bit);
        self.next.clear();
        self.next.extend(self.work.iter().filter(|r| at(r) >= 0));
        for (i, p) in self.work.iter().enumerate().filter(|(_, r)| at(r) > 0) {
            for (j, q) in self.work.iter().enumerate().filter(|(_, r)| at(r) < 0) {
                let common = p.on & q.on;
                let third = |k: usize| k != i && k != j && self.work[k].on & common == common;
                if common.count_ones() >= 2 && !(0..self.work.len()).any(third) {
                    let (v, u) = (i128::from(at(p)), i128::from(at(q)));
                    let w = [0, 1, 2, 3].map(|k| v * i128::from(q.w[k]) - u * i128::from(p.w[k]));
                    self.next.push(Edge { w: reduced(w), on: common | bit });
                }
            }
        }
        std::mem::swap(&mut self.work, &mut self.next);
        true
    }
}

fn reduced(w: [i128; 4]) -> [i64; 4] {
    let mut g = 0u128;
    for v in w {
        let (mut a, mut b) = (g, v.unsigned_abs());
        while b != 0 {
            // Small numbers soon: then in half the width.
            if let (Ok(x), Ok(y)) = (u64::try_from(a), u64::try_from(b)) {
                let (mut x, mut y) = (x, y);
                while y != 0 {
                    (x, y) = (y, x % y);
                }
                (a, b) = (u128::from(x), 0);
            } else {
                (a, b) = (b, a % b);
            }
        }
        g = a;
    }
    w.map(|v| (v / g as i128) as i64)
}
