//! The generalized winding number of a triangle soup: how often it surrounds a point.
//!
//! A tree over the triangles; far groups count by the first three terms of their expansion, near triangles by their
//! solid angle. Source: Barill, Dickson, Schmidt, Levin, Jacobson: Fast winding numbers for soups and clouds, with
//! beta = 2 as there. Places in cells. Cost: O(log n) a point, some microseconds.

use super::crossings::{Snapped, UNIT};
use crate::geom::space::{Vec3, cross, dot, doubled_area, sub};

const LEAF: usize = 8;
/// A group counts as far from this many of its radii.
const BETA: f64 = 2.0;

/// A group of triangles; its children are the next one and `skip`'s neighbour.
struct Group {
    centre: Vec3,
    /// Square of BETA times the radius.
    far2: f64,
    /// Sum of area vectors, and of their products with the offset of each triangle's middle, by rows of the area
    /// vector; second moments in the order xx, xy, xz, yy, yz, zz.
    area: Vec3,
    first: [Vec3; 3],
    second: [[f64; 6]; 3],
    /// Triangles of a leaf; the group after this one's whole subtree.
    range: (u32, u32),
    skip: u32,
}

pub struct Tree {
    triangles: Vec<[Vec3; 3]>,
    groups: Vec<Group>,
}

impl Tree {
    /// `flip`: the mesh is inside out.
    pub fn new(mesh: &Snapped, flip: bool) -> Self {
        let place = |v: u32| mesh.vertices[v as usize].map(|c| f64::from(c) / UNIT as f64);
        let mut triangles: Vec<[Vec3; 3]> = mesh.triangles.iter().map(|t| t.map(place)).collect();
        if flip {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let mut out = Self { triangles, groups: Vec::new() };
        let n = out.triangles.len();
        if n > 0 {
            out.build(0, n);
        }
        out
    }

    fn build(&mut self, first: usize, end: usize) {
        let me = self.groups.len();
        self.groups.push(self.group(first, end));
        if end - first > LEAF {
            let middle = |t: &[Vec3; 3]| [0, 1, 2].map(|k| t[0][k] + t[1][k] + t[2][k]);
            let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
            for t in &self.triangles[first..end] {
                let m = middle(t);
                for k in 0..3 {
                    (low[k], high[k]) = (low[k].min(m[k]), high[k].max(m[k]));
                }
            }
            let axis = (0..3).max_by(|&i, &j| (high[i] - low[i]).total_cmp(&(high[j] - low[j]))).expect("three axes");
            let half = (end - first) / 2;
            let key = |t: &[Vec3; 3]| (middle(t)[axis], t[0], t[1]);
            let order = |a: &[Vec3; 3], b: &[Vec3; 3]| key(a).partial_cmp(&key(b)).expect("finite");
            self.triangles[first..end].select_nth_unstable_by(half, order);
            self.build(first, first + half);
            self.build(first + half, end);
        }
        self.groups[me].skip = self.groups.len() as u32;
    }

    fn group(&self, first: usize, end: usize) -> Group {
        let own = &self.triangles[first..end];
        let mut weight = 0.0;
        let (mut centre, mut plain) = ([0.0; 3], [0.0; 3]);
        let areas: Vec<Vec3> = own.iter().map(|t| doubled_area(*t).map(|v| v / 2.0)).collect();
        for (t, a) in own.iter().zip(&areas) {
            let area = dot(*a, *a).sqrt();
            weight += area;
            for k in 0..3 {
                let middle = (t[0][k] + t[1][k] + t[2][k]) / 3.0;
                centre[k] += area * middle;
                plain[k] += middle / own.len() as f64;
            }
        }
        let centre = if weight > 0.0 { centre.map(|c| c / weight) } else { plain };
        let (mut radius2, mut area) = (0.0, [0.0; 3]);
        let (mut one, mut two) = ([[0.0; 3]; 3], [[0.0; 6]; 3]);
        for (t, a) in own.iter().zip(&areas) {
            let corners = t.map(|p| sub(p, centre));
            for p in corners {
                radius2 = f64::max(radius2, dot(p, p));
            }
            let middle = [0, 1, 2].map(|k| (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0);
            // Mean of p p^T over a triangle: (sum of corners' + 9 times the middle's) / 12.
            let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
            let moment = pairs
                .map(|(i, j)| (corners.iter().map(|p| p[i] * p[j]).sum::<f64>() + 9.0 * middle[i] * middle[j]) / 12.0);
            for r in 0..3 {
                area[r] += a[r];
                for k in 0..3 {
                    one[r][k] += a[r] * middle[k];
                }
                for k in 0..6 {
                    two[r][k] += a[r] * moment[k];
                }
            }
        }
        let leaf = end - first <= LEAF;
        let range = if leaf { (first as u32, end as u32) } else { (0, 0) };
        Group { centre, far2: BETA * BETA * radius2, area, first: one, second: two, range, skip: 0 }
    }

    /// The winding number at a place, in turns.
    pub fn at(&self, q: Vec3) -> f64 {
        let (mut sum, mut i) = (0.0, 0);
        while i < self.groups.len() {
            let g = &self.groups[i];
            let d = sub(g.centre, q);
            let d2 = dot(d, d);
            if d2 > g.far2 {
                sum += g.expansion(d, d2);
                i = g.skip as usize;
            } else {
                if g.range.1 > 0 {
                    let own = &self.triangles[g.range.0 as usize..g.range.1 as usize];
                    sum += own.iter().map(|t| solid_angle(t, q)).sum::<f64>();
                }
                i += 1;
            }
        }
        sum / (4.0 * std::f64::consts::PI)
    }
}

impl Group {
    /// Terms of order 0, 1 and 2 of the sum of a . r / |r|^3 around the centre; d from the point to it.
    #[inline(always)]
    fn expansion(&self, d: Vec3, d2: f64) -> f64 {
        let r = 1.0 / d2.sqrt();
        let (r3, r5) = (r / d2, r / (d2 * d2));
        let r7 = r5 / d2;
        let zero = dot(self.area, d) * r3;
        let trace = self.first[0][0] + self.first[1][1] + self.first[2][2];
        let along: f64 = (0..3).map(|i| d[i] * dot(self.first[i], d)).sum();
        let one = trace * r3 - 3.0 * along * r5;
        // Half of the second derivatives of d_i / |d|^3, contracted.
        let (mut mixed, mut cubic) = (0.0, 0.0);
        let mut traced = 0.0;
        for i in 0..3 {
            let m = &self.second[i];
            let full = [[m[0], m[1], m[2]], [m[1], m[3], m[4]], [m[2], m[4], m[5]]];
            let v = [dot(full[0], d), dot(full[1], d), dot(full[2], d)];
            mixed += v[i];
            cubic += d[i] * dot(v, d);
            traced += d[i] * (m[0] + m[3] + m[5]);
        }
        let two = 0.5 * (-3.0 * (2.0 * mixed + traced) * r5 + 15.0 * cubic * r7);
        zero + one + two
    }
}

/// Van Oosterom and Strackee: positive where the point sees the triangle's back.
fn solid_angle(t: &[Vec3; 3], q: Vec3) -> f64 {
    let (a, b, c) = (sub(t[0], q), sub(t[1], q), sub(t[2], q));
    let (la, lb, lc) = (dot(a, a).sqrt(), dot(b, b).sqrt(), dot(c, c).sqrt());
    let up = dot(a, cross(b, c));
    let down = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
    if up == 0.0 && down <= 0.0 {
        // On the triangle's plane and over it: on the surface, half a turn either way.
        return 0.0;
    }
    2.0 * atan2(up, down)
}

/// Within 2e-8 of the angle; the same on every machine.
#[inline(always)]
fn atan2(y: f64, x: f64) -> f64 {
    use std::f64::consts::{FRAC_PI_2, PI};
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax < ay { (ax, ay) } else { (ay, ax) };
    if large == 0.0 {
        return 0.0;
    }
    let t = small / large;
    let s = t * t;
    // Abramowitz and Stegun, Handbook of Mathematical Functions, 4.4.49.
    let p = [
        1.0,
        -0.333_331_452_8,
        0.199_935_508_5,
        -0.142_088_994_4,
        0.106_562_639_3,
        -0.075_289_640_0,
        0.042_909_613_8,
        -0.016_165_736_7,
        0.002_866_225_7,
    ];
    let mut sum = 0.0;
    for c in p.iter().rev() {
        sum = sum * s + c;
    }
    let mut angle = sum * t;
    if ax < ay {
        angle = FRAC_PI_2 - angle;
    }
    if x < 0.0 {
        angle = PI - angle;
    }
    if y < 0.0 { -angle } else { angle }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles() {
        for i in 0..100_000 {
            let a = f64::from(i) * 6.26e-5 - 3.13;
            let off = atan2(libm::sin(a), libm::cos(a)) - a;
            assert!(off.abs() < 2e-8, "{a}: {off}");
        }
    }

    /// A ball of triangles: one inside, none outside, and the sum of solid angles everywhere.
    #[test]
    fn around_a_ball() {
        let mut mesh = Snapped { vertices: Vec::new(), triangles: Vec::new() };
        let (n, m) = (40u32, 20u32);
        for j in 0..=m {
            for i in 0..n {
                let (a, b) = (f64::from(i) * 0.157_079_632_7, f64::from(j) * 0.157_079_632_7);
                let p = [libm::sin(b) * libm::cos(a), libm::sin(b) * libm::sin(a), libm::cos(b)];
                mesh.vertices.push(p.map(|v| ((20.0 + 10.0 * v) * UNIT as f64) as i32));
            }
        }
        for j in 0..m {
            for i in 0..n {
                let at = |i: u32, j: u32| j * n + i % n;
                mesh.triangles.push([at(i, j), at(i, j + 1), at(i + 1, j)]);
                mesh.triangles.push([at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)]);
            }
        }
        let open = Snapped { vertices: mesh.vertices.clone(), triangles: mesh.triangles[200..].to_vec() };
        let (tree, part) = (Tree::new(&mesh, false), Tree::new(&open, false));
        for i in 0..2000u32 {
            let q = [i % 13, i / 13 % 13, i / 169].map(|v| f64::from(v) * 3.1 + 0.37);
            let exact: f64 = part.triangles.iter().map(|t| solid_angle(t, q)).sum::<f64>() / 12.566_370_614_359_172;
            assert!((part.at(q) - exact).abs() < 0.01, "{q:?}: {} against {exact}", part.at(q));
            let r = dot(sub(q, [20.0; 3]), sub(q, [20.0; 3])).sqrt();
            if (r - 10.0).abs() > 0.3 {
                assert!((tree.at(q) - f64::from(r < 10.0)).abs() < 0.01, "{q:?}: {}", tree.at(q));
            }
        }
    }
}
