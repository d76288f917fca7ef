//! From the best sampled plane to a plane nearby for which more sticks vote.
//!
//! Two moves in turns, each kept only where it gains votes: the plane of least squares through the sticks nearby that
//! run along its main axis, and along ten lines through the plane the place where most cones overlap, found exactly by
//! a sweep over their ends.
//! Tried: a pattern search over the 26 neighbours in ever smaller steps: stopped at half of the votes on turned boxes.

use super::cones::{Cones, Reach, axes, sample};
use super::search::Best;
use super::sticks::Stick;
use crate::artifact::voxels::STEPS;
use crate::geom::lattice::Field;

/// Parts of a sample that a polished plane is kept in.
pub const PARTS: i64 = 256;

/// What may vote: cones, their sticks, and who is left.
pub struct Voters<'a> {
    pub cones: &'a Cones,
    pub sticks: &'a [(Stick, u16)],
    /// Alive sticks, and reaches of alive sticks by cube.
    pub left: &'a [u32],
    pub reaches: &'a [Vec<u32>; 8],
    pub cells: u32,
}

/// The plane in about 1/256 of a corner value; it has at least the votes of the sample.
pub fn polish(voters: &Voters, best: &Best) -> [i64; 4] {
    let mut w = sample(voters.cells, best.cube, best.at).map(|v| v * PARTS);
    let mut most = best.votes as usize;
    loop {
        let before = most;
        // A fit may stand at the foot of a higher hill, with fewer votes than the sample.
        let mut starts = vec![(w, most)];
        for reach in [0.75, 1.5, 2.5] {
            starts.extend(voters.fits(&w, reach));
        }
        starts.retain(|s| 2 * s.1 > most);
        starts.dedup();
        for (mut to, mut votes) in starts {
            voters.climb(&mut to, &mut votes);
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
        let n = self.cells as i32;
        // Sums of whole numbers: no order, no rounding. Places are doubled, from the middle of the grid.
        let mut sums = [0i128; 9];
        for &s in self.left {
            let stick = &self.sticks[s as usize].0;
            let m = stick.doubled_middle();
            if usize::from(stick.direction) == direction && (field.doubled(m) as f64).abs() <= limit {
                let [x, y, z] = [u, v, main].map(|k| i64::from(m[k] - n));
                for (sum, add) in sums.iter_mut().zip([x * x, x * y, y * y, x, y, 1, x * z, y * z, z]) {
                    *sum += i128::from(add);
                }
            }
        }
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
        let n = f64::from(n);
        let corner = |at: [f64; 3]| sign * (a * at[u] + b * at[v] + c - at[main]);
        let values = [[-n, -n, -n], [n, n, -n], [n, -n, n], [-n, n, n]].map(corner);
        let largest = values.iter().fold(0.0, |l: f64, v| l.max(v.abs()));
        let to = values.map(|v| (v / largest * 2.0 * n * PARTS as f64).round() as i64);
        (to.iter().all(|v| v.abs() <= 2 * i64::from(self.cells) * PARTS))
            .then(|| (to, self.left.iter().filter(|&&s| self.cones.holds(s, &to)).count()))
    }

    /// Line by line to where most cones overlap: shifts, tilts about three axes and about six diagonals.
    fn climb(&self, w: &mut [i64; 4], most: &mut usize) {
        const LINES: [[i64; 4]; 10] = [
            [1, 1, 1, 1],
            [-1, 1, 1, -1],
            [-1, 1, -1, 1],
            [-1, -1, 1, 1],
            [-1, 1, 0, 0],
            [0, 0, 1, -1],
            [-1, 0, 0, 1],
            [0, 1, -1, 0],
            [-1, 0, 1, 0],
            [0, 1, 0, -1],
        ];
        let mut ends = Vec::new();
        let mut idle = 0;
        for line in LINES.iter().cycle() {
            let near = self.around(w);
            let to = self.along(w, line, &near, &mut ends);
            let votes = |w: &[i64; 4]| near.iter().filter(|&&s| self.cones.holds(s, w)).count();
            let count = votes(&to);
            idle += 1;
            if count > *most {
                (*w, *most, idle) = (to, count, 0);
            }
            if idle == LINES.len() {
                return;
            }
        }
    }

    /// The plane w + t line, t within four samples, in the middle of where most cones overlap; of equal stretches the
    /// longest, then the first.
    fn along(&self, w: &[i64; 4], line: &[i64; 4], near: &[u32], ends: &mut Vec<(f64, i32)>) -> [i64; 4] {
        let limit = (8 * PARTS) as f64;
        ends.clear();
        for &s in near {
            let (mut low, mut high) = (-limit, limit);
            for f in self.cones.facets(s) {
                let dot = |v: &[i64; 4]| (0..4).map(|i| i64::from(f.a[i]) * v[i]).sum::<i64>();
                let (at, slope) = (dot(w), dot(line));
                let root = 0.0 - at as f64 / slope as f64;
                match slope.signum() {
                    1 => low = low.max(root),
                    -1 => high = high.min(root),
                    _ if at < 0 || at == 0 && f.sign < 0 => high = f64::NEG_INFINITY,
                    _ => {}
                }
            }
            if low < high {
                ends.extend([(low, 1), (high, -1)]);
            }
        }
        // Where one cone ends and another begins, the end comes first.
        ends.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (mut count, mut best) = (0, (0, 0.0, 0.0));
        for (i, &(at, step)) in ends.iter().enumerate() {
            count += step;
            let length = ends.get(i + 1).map_or(0.0, |next| next.0 - at);
            if count > best.0 && length > 0.0 || count == best.0 && length > best.1 {
                best = (count, length, at + length / 2.0);
            }
        }
        let t = best.2.round() as i64;
        [0, 1, 2, 3].map(|i| w[i] + t * line[i])
    }

    /// Sticks whose reach comes within four samples of the plane, each once.
    fn around(&self, w: &[i64; 4]) -> Vec<u32> {
        let fixed = (0..4).rev().max_by_key(|&i| w[i].abs()).expect("four values");
        let cube = 2 * fixed + usize::from(w[fixed] < 0);
        let scale = f64::from(self.cells) / w[fixed].abs() as f64;
        let at = axes(fixed).map(|a| w[a] as f64 * scale + f64::from(self.cells) - 0.5);
        let near =
            |r: &Reach| (0..3).all(|k| f64::from(r.low[k]) - 4.0 <= at[k] && at[k] <= f64::from(r.high[k]) + 4.0);
        let all = self.reaches[cube].iter().map(|&r| &self.cones.reaches[r as usize]);
        all.filter(|r| near(r)).map(|r| r.stick).collect()
    }
}
