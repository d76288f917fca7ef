//! From the best sampled plane to a plane nearby for which more sticks vote.
//!
//! Two moves in turns, each kept only where it gains votes: the plane of least squares through the sticks nearby that
//! run along its main axis, and along ten lines through the plane the place where most cones overlap, found exactly by
//! a sweep over their ends.
//! Tried: a pattern search over the 26 neighbours in ever smaller steps: stopped at half of the votes on turned boxes.

use rayon::prelude::*;

use super::climb::climb;
use super::cones::{Cones, axes, sample};
use super::search::Best;
use super::sticks::Stick;
use crate::artifact::voxels::STEPS;
use crate::geom::lattice::Field;
use crate::geom::wide::{self, Work};

/// Parts of a sample that a polished plane is kept in.
pub const PARTS: i64 = 256;

/// What may vote: cones, and where their sticks are that are left.
pub struct Voters<'a> {
    pub(super) cones: &'a Cones,
    cells: u32,
    by_direction: [Middles; 6],
    by_cube: [Boxes; 8],
}

/// Sticks of one direction: their middles, doubled, and their numbers, ascending.
#[derive(Default)]
struct Middles {
    at: [Vec<f64>; 3],
    stick: Vec<u32>,
}

/// Reaches in one cube: their first and last samples, and the numbers of their sticks, ascending.
#[derive(Default)]
struct Boxes {
    low: [Vec<i16>; 3],
    high: [Vec<i16>; 3],
    stick: Vec<u32>,
}

impl<'a> Voters<'a> {
    pub fn new(cones: &'a Cones, sticks: &[(Stick, u16)], cells: u32) -> Self {
        let mut out = Self { cones, cells, by_direction: Default::default(), by_cube: Default::default() };
        for (i, (stick, _)) in sticks.iter().enumerate() {
            let row = &mut out.by_direction[usize::from(stick.direction)];
            let middle = stick.doubled_middle();
            row.at.iter_mut().zip(middle).for_each(|(all, v)| all.push(f64::from(v)));
            row.stick.push(i as u32);
        }
        for reach in &cones.reaches {
            let row = &mut out.by_cube[usize::from(reach.cube)];
            row.low.iter_mut().zip(reach.low).for_each(|(all, v)| all.push(v as i16));
            row.high.iter_mut().zip(reach.high).for_each(|(all, v)| all.push(v as i16));
            row.stick.push(reach.stick);
        }
        out
    }

    /// Forgets the sticks that are not alive.
    pub fn retain(&mut self, is_alive: impl Fn(u32) -> bool) {
        fn keep<T>(all: &mut Vec<T>, stays: &[bool]) {
            let mut stays = stays.iter();
            all.retain(|_| stays.next() == Some(&true));
        }
        for row in &mut self.by_direction {
            let stays: Vec<bool> = row.stick.iter().map(|&s| is_alive(s)).collect();
            row.at.iter_mut().for_each(|all| keep(all, &stays));
            keep(&mut row.stick, &stays);
        }
        for row in &mut self.by_cube {
            let stays: Vec<bool> = row.stick.iter().map(|&s| is_alive(s)).collect();
            row.low.iter_mut().chain(&mut row.high).for_each(|all| keep(all, &stays));
            keep(&mut row.stick, &stays);
        }
    }

    /// Sticks that vote for a plane, ascending.
    pub fn voting(&self, w: &[i64; 4]) -> Vec<u32> {
        let field = Field::new(self.cells, *w);
        let mut out = Vec::new();
        for (direction, row) in self.by_direction.iter().enumerate() {
            let along: i64 = (0..3).map(|k| field.gradient[k] * i64::from(STEPS[direction][k])).sum();
            if along < 0 {
                // Between the ends of a stick the field changes by `along`, doubled by twice that.
                row.near(&field, along.abs() as f64, |i| out.push(row.stick[i]));
            }
        }
        out.retain(|&i| self.cones.holds(i, w));
        out.sort_unstable();
        out
    }
}

impl Middles {
    /// Sticks in whose middle the doubled field is at most `limit`, by their places in the lists.
    fn near(&self, field: &Field, limit: f64, found: impl FnMut(usize)) {
        wide::run(Near { row: self, field, limit, found });
    }
}

struct Near<'a, F> {
    row: &'a Middles,
    field: &'a Field,
    limit: f64,
    found: F,
}

impl<F: FnMut(usize)> Work for Near<'_, F> {
    type Out = ();
    #[inline(always)]
    fn work(mut self) {
        // Whole numbers below 2^53: exact.
        let start = 2.0 * self.field.start as f64;
        let [gx, gy, gz] = self.field.gradient.map(|g| g as f64);
        let [x, y, z] = [0, 1, 2].map(|k| self.row.at[k].as_chunks::<16>());
        let limit = self.limit;
        let at = |x: f64, y: f64, z: f64| (start + gx * x + gy * y + gz * z).abs();
        for (part, ((x, y), z)) in x.0.iter().zip(y.0).zip(z.0).enumerate() {
            let all: [f64; 16] = std::array::from_fn(|i| at(x[i], y[i], z[i]));
            let least = all.iter().fold(f64::INFINITY, |l, &v| if v < l { v } else { l });
            if least <= limit {
                (0..16).filter(|&i| all[i] <= limit).for_each(|i| (self.found)(16 * part + i));
            }
        }
        let rest = 16 * x.0.len();
        for (i, ((&x, &y), &z)) in x.1.iter().zip(y.1).zip(z.1).enumerate() {
            if at(x, y, z) <= limit {
                (self.found)(rest + i);
            }
        }
    }
}

/// The plane in about 1/256 of a corner value; it has at least the votes of the sample.
pub fn polish(voters: &Voters, best: &Best) -> [i64; 4] {
    let mut w = sample(voters.cells, best.cube, best.at).map(|v| v * PARTS);
    let mut most = best.votes as usize;
    // Where a climb began or ended: it would end there, or as it did.
    let mut known: Vec<([i64; 4], usize)> = Vec::new();
    loop {
        let before = most;
        // A fit may stand at the foot of a higher hill, with fewer votes than the sample.
        let fits: Vec<Vec<([i64; 4], usize)>> =
            [0.75, 1.5, 2.5].into_par_iter().map(|reach| voters.fits(&w, reach).collect()).collect();
        let mut starts = vec![(w, most)];
        starts.extend(fits.into_iter().flatten());
        starts.retain(|s| {
            let is_new = 2 * s.1 > most && !known.contains(s);
            if is_new {
                known.push(*s);
            }
            is_new
        });
        starts.par_iter_mut().for_each(|(to, votes)| climb(voters, to, votes));
        for (to, votes) in starts {
            known.push((to, votes));
            if votes > most {
                (w, most) = (to, votes);
            }
        }
        if most == before {
            break;
        }
    }
    // Of nearly equal ones the plane through the middle of the sticks: the last vote is often bought by a tilt.
    let fit = voters.fits(&w, 0.75).last();
    match fit {
        Some((to, votes)) if votes >= best.votes as usize && 50 * votes >= 49 * most => to,
        _ => w,
    }
}

impl Voters<'_> {
    /// Fits through ever nearer sticks, from those within `reach`: a face's own lie within half a cell of it.
    fn fits(&self, w: &[i64; 4], reach: f64) -> impl Iterator<Item = ([i64; 4], usize)> {
        let mut to = *w;
        let next = move |reach| {
            let fit = self.fit(&to, reach)?;
            to = fit.0;
            Some(fit)
        };
        [reach, 0.75, 0.6, 0.6].into_iter().map_while(next)
    }

    /// The plane of least squares through the middles of the sticks that run along the plane's main axis, on its side,
    /// and within `reach` cells of it along that axis; and its votes.
    fn fit(&self, w: &[i64; 4], reach: f64) -> Option<([i64; 4], usize)> {
        let field = Field::new(self.cells, *w);
        let main = (0..3).max_by_key(|&k| field.gradient[k].abs())?;
        let direction =
            (0..6).find(|&d| STEPS[d][main] != 0 && i64::from(STEPS[d][main]) * field.gradient[main] < 0)?;
        let limit = 2.0 * reach * field.gradient[main].abs() as f64;
        let (u, v) = ((main + 1) % 3, (main + 2) % 3);
        let n = f64::from(self.cells);
        let row = &self.by_direction[direction];
        // Sums of whole numbers: no order, no rounding. Places are doubled, from the middle of the grid.
        let mut sums = [0i64; 9];
        row.near(&field, limit, |i| {
            let [x, y, z] = [u, v, main].map(|k| (row.at[k][i] - n) as i64);
            for (sum, add) in sums.iter_mut().zip([x * x, x * y, y * y, x, y, 1, x * z, y * z, z]) {
                *sum += add;
            }
        });
        let [xx, xy, yy, x, y, one, xz, yz, z] = sums.map(|s| s as f64);
        // z = a x + b y + c
        let det = |m: [[f64; 3]; 3]| {
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
                + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        };
        let all = det([[xx, xy, x], [xy, yy, y], [x, y, one]]);
        if all.abs() < 0.5 {
            return None;
        }
        let a = det([[xz, xy, x], [yz, yy, y], [z, y, one]]) / all;
        let b = det([[xx, xz, x], [xy, yz, y], [x, z, one]]) / all;
        let c = det([[xx, xy, xz], [xy, yy, yz], [x, y, z]]) / all;
        // The field at the corners, which lie at -N or N on each axis: inside is where it is not negative.
        let sign = f64::from(STEPS[direction][main]);
        let corner = |at: [f64; 3]| sign * (a * at[u] + b * at[v] + c - at[main]);
        let values = [[-n, -n, -n], [n, n, -n], [n, -n, n], [-n, n, n]].map(corner);
        let largest = values.iter().fold(0.0, |l: f64, v| l.max(v.abs()));
        let to = values.map(|v| (v / largest * 2.0 * n * PARTS as f64).round() as i64);
        (to.iter().all(|v| v.abs() <= 2 * i64::from(self.cells) * PARTS)).then(|| (to, self.voting(&to).len()))
    }
}

impl Voters<'_> {
    /// Sticks whose reach comes within four samples of the plane, each once.
    pub(super) fn around(&self, w: &[i64; 4]) -> Vec<u32> {
        let fixed = (0..4).rev().max_by_key(|&i| w[i].abs()).expect("four values");
        let cube = 2 * fixed + usize::from(w[fixed] < 0);
        let scale = f64::from(self.cells) / w[fixed].abs() as f64;
        let at = axes(fixed).map(|a| w[a] as f64 * scale + f64::from(self.cells) - 0.5);
        // Whole numbers on one side of it and on the other.
        let (below, above) = (at.map(|v| v.floor() as i16 + 4), at.map(|v| v.ceil() as i16 - 4));
        let mut out = Vec::new();
        wide::run(Holding { boxes: &self.by_cube[cube], below, above, out: &mut out });
        out
    }
}

/// Sticks of boxes that begin at `below` or before and end at `above` or after.
struct Holding<'a> {
    boxes: &'a Boxes,
    below: [i16; 3],
    above: [i16; 3],
    out: &'a mut Vec<u32>,
}

impl Work for Holding<'_> {
    type Out = ();
    #[inline(always)]
    fn work(self) {
        let Boxes { low, high, stick } = self.boxes;
        let n = stick.len();
        for first in (0..n).step_by(64) {
            let end = (first + 64).min(n);
            let mut inside = [u16::MAX; 64];
            for k in 0..3 {
                let (low, high) = (&low[k][first..end], &high[k][first..end]);
                for ((inside, low), high) in inside.iter_mut().zip(low).zip(high) {
                    *inside &= if *low <= self.below[k] && *high >= self.above[k] { u16::MAX } else { 0 };
                }
            }
            if inside[..end - first].iter().fold(0, |a, i| a | i) != 0 {
                self.out.extend(stick[first..end].iter().zip(inside).filter(|s| s.1 != 0).map(|s| s.0));
            }
        }
    }
}
