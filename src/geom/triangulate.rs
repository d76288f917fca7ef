//! Polygons with holes to triangles: earcut over exact integers, and the seams that it leaves closed again.
//!
//! In:   rings of points, the first the shell, the others its holes, open (first point not repeated).
//! Out:  triangles as places in the rings' points put one behind the other; of a polygon that is simple they cover
//!       it once and every ring edge is the edge of exactly one triangle, collinear vertices included (watertight).
//! Degenerate input (fewer than three points, no area) gives no triangles; a ring that crosses itself gives some.
//! Cost: near O(n log n). Source: earcut (mapbox), ear slicing with z-order.

use earcut::Earcut;
use earcut::int::EarcutI32;

use super::Point;
use super::predicates::{on_segment, orient};

/// Range of earcut's integers, each side of the middle.
const SMALL: i64 = 1 << 19;

/// Buffers to use again from polygon to polygon.
#[derive(Default)]
pub struct Triangulator {
    small: EarcutI32,
    large: Earcut<f64>,
    plan: Vec<Point>,
    local: Vec<Point>,
    local_f64: Vec<[f64; 2]>,
    ends: Vec<u32>,
    holes: Vec<u32>,
    indices: Vec<u32>,
}

impl Triangulator {
    pub fn new() -> Self {
        Self::default()
    }

    /// Appends the triangles of a plan polygon to `out`, counter-clockwise whatever the rings' directions.
    pub fn plan<'a>(&mut self, rings: impl IntoIterator<Item = &'a [Point]>, out: &mut Vec<[u32; 3]>) {
        self.plan.clear();
        self.ends.clear();
        for ring in rings {
            self.plan.extend_from_slice(ring);
            self.ends.push(self.plan.len() as u32);
        }
        self.fill(out);
    }

    /// Appends the triangles of a flat polygon in space to `out`, turning as its shell does. The polygon is looked at
    /// along the axis in which its normal (Newell's) is longest; points a little off the plane do no harm.
    pub fn space<'a>(&mut self, rings: impl IntoIterator<Item = &'a [[i32; 3]]>, out: &mut Vec<[u32; 3]>) {
        let mut rings = rings.into_iter();
        let Some(shell) = rings.next() else { return };
        let normal = doubled_normal(shell);
        let size = normal.map(i128::unsigned_abs);
        let axis = (0..3).max_by_key(|&k| (size[k], k)).unwrap_or(2);
        if size[axis] == 0 {
            return;
        }
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        self.plan.clear();
        self.ends.clear();
        for ring in std::iter::once(shell).chain(rings) {
            self.plan.extend(ring.iter().map(|p| [p[u], p[v]]));
            self.ends.push(self.plan.len() as u32);
        }
        let before = out.len();
        self.fill(out);
        if normal[axis] < 0 {
            out[before..].iter_mut().for_each(|t| t.swap(1, 2));
        }
    }

    /// Triangulates `plan`, whose rings end at `ends`.
    fn fill(&mut self, out: &mut Vec<[u32; 3]>) {
        let Some(&shell) = self.ends.first() else { return };
        let before = out.len();
        if shell < 3 {
            return;
        }
        if self.ends.len() == 1 && shell <= 4 && few(&self.plan, out) {
            return;
        }
        let (low, high) = self.plan.iter().fold(([i32::MAX; 2], [i32::MIN; 2]), |(l, h), p| {
            ([l[0].min(p[0]), l[1].min(p[1])], [h[0].max(p[0]), h[1].max(p[1])])
        });
        let middle = [0, 1].map(|k| (i64::from(low[k]) + i64::from(high[k])).div_euclid(2));
        let fits = (0..2).all(|k| i64::from(high[k]) - middle[k] <= SMALL && middle[k] - i64::from(low[k]) <= SMALL);
        self.holes.clear();
        self.holes.extend_from_slice(&self.ends[..self.ends.len() - 1]);
        let moved = |p: &Point| [i64::from(p[0]) - middle[0], i64::from(p[1]) - middle[1]];
        if fits {
            self.local.clear();
            self.local.extend(self.plan.iter().map(|p| moved(p).map(|v| v as i32)));
            self.small.earcut_slice(&self.local, &self.holes, &mut self.indices);
        } else {
            // Beyond a kilometre: products of differences are exact in f64 up to 67 km.
            self.local_f64.clear();
            self.local_f64.extend(self.plan.iter().map(|p| moved(p).map(|v| v as f64)));
            self.large.earcut_slice(&self.local_f64, &self.holes, &mut self.indices);
        }
        for t in self.indices.as_chunks::<3>().0 {
            match orient(self.plan[t[0] as usize], self.plan[t[1] as usize], self.plan[t[2] as usize]) {
                0 => {}
                o if o > 0 => out.push(*t),
                _ => out.push([t[0], t[2], t[1]]),
            }
        }
        if out.len() - before + 2 < self.plan.len() + 2 * self.holes.len() {
            let mut found = out.split_off(before);
            self.stitch(&mut found, out);
        }
    }

    /// Splits triangles at the vertices that lie on their edges: earcut drops collinear vertices, and without them
    /// neighbours (walls) would not meet the polygon edge by edge.
    fn stitch(&self, todo: &mut Vec<[u32; 3]>, out: &mut Vec<[u32; 3]>) {
        let mut known = Vec::with_capacity(self.plan.len() + 3 * todo.len());
        let mut start = 0;
        for &end in &self.ends {
            for i in start..end {
                let next = if i + 1 == end { start } else { i + 1 };
                known.extend([(i, next), (next, i)]);
            }
            start = end;
        }
        known.extend(todo.iter().flat_map(|t| [(t[1], t[0]), (t[2], t[1]), (t[0], t[2])]));
        known.sort_unstable();
        let mut by_x: Vec<u32> = (0..self.plan.len() as u32).collect();
        by_x.sort_unstable_by_key(|&i| (self.plan[i as usize], i));
        let point = |i: u32| self.plan[i as usize];
        todo.reverse();
        while let Some(t) = todo.pop() {
            let split = (0..3).find_map(|k| {
                let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
                if known.binary_search(&(a, b)).is_ok() {
                    return None;
                }
                let (low, high) = (point(a).min(point(b)), point(a).max(point(b)));
                let from = by_x.partition_point(|&i| point(i) <= low);
                let to = by_x.partition_point(|&i| point(i) < high);
                let on = by_x.get(from..to)?.iter().find(|&&i| on_segment(low, high, point(i)))?;
                Some((a, b, c, *on))
            });
            match split {
                // Both halves keep a side that may hold more; they shrink, so this ends.
                Some((a, b, c, on)) => todo.extend([[on, b, c], [a, on, c]]),
                None => out.push(t),
            }
        }
    }
}

/// Triangles and convex quads need no ear slicing. False where it is neither.
fn few(p: &[Point], out: &mut Vec<[u32; 3]>) -> bool {
    if p.len() == 3 {
        match orient(p[0], p[1], p[2]) {
            0 => {}
            o if o > 0 => out.push([0, 1, 2]),
            _ => out.push([0, 2, 1]),
        }
        return true;
    }
    let turns = [0, 1, 2, 3].map(|k| orient(p[k], p[(k + 1) % 4], p[(k + 2) % 4]));
    if turns.iter().all(|&o| o > 0) {
        out.extend([[0, 1, 2], [0, 2, 3]]);
    } else if turns.iter().all(|&o| o < 0) {
        out.extend([[0, 2, 1], [0, 3, 2]]);
    } else {
        return false;
    }
    true
}

/// Newell's normal of a ring in space, twice its area long. Exact.
pub fn doubled_normal(ring: &[[i32; 3]]) -> [i128; 3] {
    let Some((first, rest)) = ring.split_first() else { return [0; 3] };
    let mut sum = [0i128; 3];
    for w in rest.windows(2) {
        let d = |p: &[i32; 3], k: usize| i128::from(p[k]) - i128::from(first[k]);
        for (k, s) in sum.iter_mut().enumerate() {
            let (u, v) = ((k + 1) % 3, (k + 2) % 3);
            *s += d(&w[0], u) * d(&w[1], v) - d(&w[0], v) * d(&w[1], u);
        }
    }
    sum
}

/// [`Triangulator::plan`] for one polygon.
pub fn plan<'a>(rings: impl IntoIterator<Item = &'a [Point]>) -> Vec<[u32; 3]> {
    let mut out = Vec::new();
    Triangulator::new().plan(rings, &mut out);
    out
}

/// [`Triangulator::space`] for one polygon.
pub fn space<'a>(rings: impl IntoIterator<Item = &'a [[i32; 3]]>) -> Vec<[u32; 3]> {
    let mut out = Vec::new();
    Triangulator::new().space(rings, &mut out);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::ring::doubled_area;
    use proptest::prelude::*;

    fn area(points: &[Point], triangles: &[[u32; 3]]) -> i64 {
        let p = |i: u32| points[i as usize];
        triangles
            .iter()
            .map(|t| {
                let o = orient(p(t[0]), p(t[1]), p(t[2]));
                assert!(o > 0);
                o
            })
            .sum()
    }

    /// Every ring edge is in exactly one triangle, every other edge in two, once each way.
    fn watertight(rings: &[&[Point]], triangles: &[[u32; 3]]) {
        let mut edges: Vec<(u32, u32)> =
            triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
        edges.sort_unstable();
        assert!(edges.windows(2).all(|w| w[0] != w[1]));
        let mut start = 0;
        for ring in rings {
            let n = ring.len() as u32;
            for i in 0..n {
                let (a, b) = (start + i, start + (i + 1) % n);
                assert!(edges.contains(&(a, b)) != edges.contains(&(b, a)), "edge {a}-{b}");
            }
            start += n;
        }
    }

    #[test]
    fn square_with_a_hole() {
        let shell: &[Point] = &[[0, 0], [10, 0], [10, 10], [0, 10]];
        let hole: &[Point] = &[[2, 2], [2, 4], [4, 4], [4, 2]];
        let t = plan([shell, hole]);
        assert_eq!(t.len(), 8);
        assert_eq!(area(&[shell, hole].concat(), &t), 2 * (100 - 4));
        watertight(&[shell, hole], &t);
    }

    #[test]
    fn degenerate_gives_nothing() {
        let none: [&[Point]; 0] = [];
        assert!(plan(none).is_empty());
        for ring in [&[][..], &[[1, 1]], &[[1, 1], [2, 2]], &[[0, 0], [1, 1], [2, 2]], &[[3, 3]; 5]] {
            assert!(plan([ring]).is_empty(), "{ring:?}");
        }
        assert!(space([&[[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3]][..]]).is_empty());
        // A hole of two points, a hole outside, a bow tie: no panic.
        let shell: &[Point] = &[[0, 0], [10, 0], [10, 10], [0, 10]];
        plan([shell, &[[1, 1], [2, 2]]]);
        plan([shell, &[[20, 20], [20, 24], [24, 24]]]);
        plan([&[[0, 0], [10, 10], [10, 0], [0, 10]][..]]);
    }

    #[test]
    fn collinear_vertices_stay() {
        let ring: &[Point] = &[[0, 0], [5, 0], [10, 0], [10, 5], [10, 10], [4, 10], [0, 10]];
        let t = plan([ring]);
        assert_eq!(area(ring, &t), 200);
        watertight(&[ring], &t);
    }

    #[test]
    fn large_and_far() {
        let l = crate::geom::LIMIT_MM - 1;
        let ring: &[Point] = &[[-l, -l], [l, -l], [l, l], [0, 0], [-l, l]];
        assert_eq!(area(ring, &plan([ring])), doubled_area(ring));
        let near: &[Point] = &[[l - 9, l - 9], [l, l - 9], [l, l], [l - 5, l - 5], [l - 9, l]];
        assert_eq!(area(near, &plan([near])), doubled_area(near));
    }

    #[test]
    fn walls_turn_as_their_shell() {
        let wall = [[0, 0, 0], [4000, 3000, 0], [4000, 3000, 9000], [1000, 750, 12000], [0, 0, 9000]];
        let n = doubled_normal(&wall);
        for t in space([&wall[..]]) {
            let [a, b, c] = t.map(|i| wall[i as usize]);
            let m = doubled_normal(&[a, b, c]);
            assert!((0..3).all(|k| m[k].signum() == n[k].signum()));
        }
        let back: Vec<_> = wall.iter().rev().copied().collect();
        assert_eq!(space([&back[..]]).len(), 3);
    }

    proptest! {
        /// Star-shaped rings on a coarse grid are simple where no two points share a direction, and full of
        /// collinear triples.
        #[test]
        fn stars_are_covered(radii in prop::collection::vec(1i32..6, 8), size in prop::sample::select(vec![1, 1000, 1_000_000])) {
            let ways = [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]];
            let ring: Vec<Point> = ways.iter().zip(&radii).map(|(w, r)| [w[0] * r * size, w[1] * r * size]).collect();
            let t = plan([&ring[..]]);
            prop_assert_eq!(area(&ring, &t), doubled_area(&ring));
            watertight(&[&ring], &t);
        }
    }
}
