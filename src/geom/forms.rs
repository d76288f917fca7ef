//! Simpler forms of a ring: half its edges, the rectangle of equal area, (with `ring::convex_hull`) the convex ring.

use super::Point;
use super::outer_hull::Simplifier;
use super::ring::{convex_hull_into, doubled_area};

/// Working memory for the forms of many rings, one after the other.
#[derive(Default)]
pub struct Draft {
    simplifier: Simplifier,
    ids: Vec<u32>,
    kept: Vec<u32>,
    sorted: Vec<Point>,
    joined: Vec<Point>,
    hull: Vec<Point>,
    local: Vec<[f64; 2]>,
}

impl Draft {
    /// Into `out` the ring grown outwards until it has half its edges (rounded up), or is convex. It contains the one
    /// given.
    pub fn half(&mut self, ring: &[Point], out: &mut Vec<Point>) {
        self.ids.extend(self.ids.len() as u32..ring.len() as u32);
        let edges = ring.len().div_ceil(2).max(3);
        self.simplifier.keep(ring, &self.ids[..ring.len()], edges, &mut self.kept);
        out.clear();
        out.extend(self.kept.iter().map(|&i| ring[i as usize]));
    }

    /// Into `out` the convex ring around points, as by [`super::ring::convex_hull`].
    pub fn convex(&mut self, points: &[Point], out: &mut Vec<Point>) {
        convex_hull_into(points, &mut self.sorted, out);
    }

    /// The rectangle as large as the region, around its centroid, with the direction and side ratio of the smallest
    /// box around it, and the area that both share (m2). The region is the rings' signed sum: shells turn left, holes
    /// right. None where the region has no area.
    pub fn rectangle(&mut self, rings: &[&[Point]]) -> Option<([Point; 4], f64)> {
        // One ring's fits, but parts may lie over each other.
        let area = rings.iter().map(|r| i128::from(doubled_area(r))).sum::<i128>() as f64 / 2e6;
        let points = match rings {
            [one] => one,
            _ => {
                self.joined.clear();
                rings.iter().for_each(|r| self.joined.extend_from_slice(r));
                &self.joined[..]
            }
        };
        convex_hull_into(points, &mut self.sorted, &mut self.hull);
        if area <= 0.0 || self.hull.len() < 3 {
            return None;
        }
        let from = self.hull[0];
        let local = |p: &Point| [0, 1].map(|k| (i64::from(p[k]) - i64::from(from[k])) as f64 / 1000.0);
        self.local.clear();
        self.local.extend(self.hull.iter().map(local));
        let (along, sides) = smallest_box(&self.local);
        let middle = centroid(rings.iter().map(|r| r.iter().map(local)), area);
        let scale = (area / (sides[0] * sides[1])).sqrt() / 2.0;
        let rectangle = Turned { middle, along, half: sides.map(|s| s * scale) };
        let shared = rings.iter().map(|r| rectangle.shared(r.iter().map(local))).sum();
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[u, v]| {
            let (u, v) = (u * rectangle.half[0], v * rectangle.half[1]);
            let p = [middle[0] + u * along[0] - v * along[1], middle[1] + u * along[1] + v * along[0]];
            [0, 1].map(|k| from[k].saturating_add((p[k] * 1000.0).round() as i32))
        });
        Some((corners, shared))
    }
}

/// A rectangle of any direction, metres from `middle`.
struct Turned {
    middle: [f64; 2],
    /// Unit vector of the first side.
    along: [f64; 2],
    /// Half of each side.
    half: [f64; 2],
}

/// Direction and sides of the smallest box around a convex ring; it lies along one of its edges (the first of several).
fn smallest_box(hull: &[[f64; 2]]) -> ([f64; 2], [f64; 2]) {
    let mut best = (f64::INFINITY, [1.0, 0.0], [1.0, 1.0]);
    for (i, a) in hull.iter().enumerate() {
        let b = hull[(i + 1) % hull.len()];
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = (dx * dx + dy * dy).sqrt();
        let along = [dx / length, dy / length];
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in hull {
            let t = [p[0] * along[0] + p[1] * along[1], p[1] * along[0] - p[0] * along[1]];
            for k in 0..2 {
                low[k] = low[k].min(t[k]);
                high[k] = high[k].max(t[k]);
            }
        }
        let sides = [high[0] - low[0], high[1] - low[1]];
        if sides[0] * sides[1] < best.0 {
            best = (sides[0] * sides[1], along, sides);
        }
    }
    (best.1, best.2)
}

/// The centre of gravity of rings that turn left, less those that turn right.
fn centroid<R>(rings: impl Iterator<Item = R>, area: f64) -> [f64; 2]
where
    R: Iterator<Item = [f64; 2]>,
{
    let mut sum = [0.0; 2];
    for ring in rings {
        edges(ring, |a, b| {
            let cross = a[0] * b[1] - b[0] * a[1];
            (0..2).for_each(|k| sum[k] += (a[k] + b[k]) * cross);
        });
    }
    sum.map(|s| s / (6.0 * area))
}

fn edges(ring: impl Iterator<Item = [f64; 2]>, mut visit: impl FnMut([f64; 2], [f64; 2])) {
    let mut first = None;
    let mut last = None;
    for p in ring {
        if let Some(a) = last {
            visit(a, p);
        }
        first.get_or_insert(p);
        last = Some(p);
    }
    if let (Some(a), Some(b)) = (last, first) {
        visit(a, b);
    }
}

impl Turned {
    /// Area that a ring shares with the rectangle, signed by the ring's direction: the integral of the ring's outline,
    /// held within the rectangle.
    fn shared(&self, ring: impl Iterator<Item = [f64; 2]>) -> f64 {
        let [w, h] = self.half;
        let to = |p: [f64; 2]| {
            let (x, y) = (p[0] - self.middle[0], p[1] - self.middle[1]);
            [x * self.along[0] + y * self.along[1], y * self.along[0] - x * self.along[1]]
        };
        let mut sum = 0.0;
        edges(ring, |a, b| {
            let (a, b) = (to(a), to(b));
            let (u0, u1) = (a[0].clamp(-w, w), b[0].clamp(-w, w));
            if u0 == u1 {
                return;
            }
            let slope = (b[1] - a[1]) / (b[0] - a[0]);
            let v = |u: f64| a[1] + (u - a[0]) * slope;
            sum -= clamped_integral(v(u0), v(u1), h) * (u1 - u0);
        });
        sum
    }
}

/// Mean over a line from v0 to v1 of its height above -h, held between 0 and 2h.
fn clamped_integral(v0: f64, v1: f64, h: f64) -> f64 {
    let (low, high) = (v0.min(v1), v0.max(v1));
    if high - low < 1e-12 {
        return (low.clamp(-h, h)) + h;
    }
    let (a, b) = (low.clamp(-h, h), high.clamp(-h, h));
    // Below -h nothing, between a and b the trapezoid, above h all of it.
    let within = (b - a) / (high - low) * ((a + b) / 2.0 + h);
    let above = (high - b.max(low)).max(0.0) / (high - low) * 2.0 * h;
    within + if high > h { above } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::ring::area_m2;
    use proptest::prelude::*;

    #[test]
    fn a_rectangle_is_its_own_form() {
        let ring: &[Point] = &[[0, 0], [6000, 8000], [2000, 11000], [-4000, 3000]];
        let (form, shared) = Draft::default().rectangle(&[ring]).unwrap();
        assert!((area_m2(&form) - 50.0).abs() < 1e-2);
        assert!((shared - 50.0).abs() < 1e-9);
        assert!(form.iter().all(|p| ring.contains(p)));
        assert!(Draft::default().rectangle(&[&[[0, 0], [5, 5], [9, 9]]]).is_none());
        assert!(Draft::default().rectangle(&[]).is_none());
        // Parts that cover the whole plane, one over the other.
        let l = crate::geom::LIMIT_MM;
        let all: &[Point] = &[[-l, -l], [l, -l], [l, l], [-l, l]];
        assert!(Draft::default().rectangle(&[all; 5]).is_some_and(|(_, shared)| shared > 4.9 * 1.07e6 * 1.07e6));
    }

    #[test]
    fn an_l_and_a_court() {
        // Centroid of the L is (1.25, 1.25) - half of 0.25 ...: its square of area 3 lies mostly within it.
        let l: &[Point] = &[[0, 0], [2000, 0], [2000, 1000], [1000, 1000], [1000, 2000], [0, 2000]];
        let (form, shared) = Draft::default().rectangle(&[l]).unwrap();
        assert!((area_m2(&form) - 3.0).abs() < 1e-2);
        assert!(shared > 2.0 && shared < 3.0);
        let court: [&[Point]; 2] =
            [&[[0, 0], [9000, 0], [9000, 9000], [0, 9000]], &[[1000, 1000], [1000, 8000], [8000, 8000], [8000, 1000]]];
        let (form, shared) = Draft::default().rectangle(&court).unwrap();
        assert!((area_m2(&form) - 32.0).abs() < 2e-2);
        // The square of area 32 lies in the court: nothing is shared, and the caller must see that.
        assert!(shared.abs() < 1e-9);
        let mut half = Vec::new();
        Draft::default().half(l, &mut half);
        assert!(half.len() == 5);
    }

    proptest! {
        /// Against counting points of a fine grid.
        #[test]
        fn shared_area(radii in prop::collection::vec(2i32..9, 8), turn in 0usize..3) {
            let ways: [[i32; 2]; 8] = [[10, 0], [7, 7], [0, 10], [-7, 7], [-10, 0], [-7, -7], [0, -10], [7, -7]];
            let turned = |w: [i32; 2]| match turn { 0 => w, 1 => [w[0] * 3 - w[1], w[0] + w[1] * 3], _ => [-w[1], w[0]] };
            let ring: Vec<Point> = ways.iter().zip(&radii).map(|(w, r)| turned(w.map(|v| v * r * 100))).collect();
            let (form, shared) = Draft::default().rectangle(&[&ring]).unwrap();
            let inside = |ring: &[Point], p: [f64; 2]| {
                let mut odd = false;
                for (i, a) in ring.iter().enumerate() {
                    let (a, b) = (a.map(f64::from), ring[(i + 1) % ring.len()].map(f64::from));
                    if (a[1] > p[1]) != (b[1] > p[1]) && p[0] < (b[0] - a[0]) * (p[1] - a[1]) / (b[1] - a[1]) + a[0] {
                        odd = !odd;
                    }
                }
                odd
            };
            let (step, reach) = (300.0, 30_000.0);
            let mut count = 0;
            let steps = (2.0 * reach / step) as i32;
            for i in 0..steps {
                for j in 0..steps {
                    let p = [-reach + (f64::from(i) + 0.31) * step, -reach + (f64::from(j) + 0.47) * step];
                    count += i32::from(inside(&ring, p) && inside(&form, p));
                }
            }
            let counted = f64::from(count) * step * step / 1e6;
            // Counting is off by half a step along the outline at most.
            let around = |r: &[Point]| -> f64 {
                let side = |(a, b): (&Point, &Point)| (0..2).map(|k| f64::from(a[k] - b[k]).abs()).sum::<f64>();
                r.iter().zip(r.iter().cycle().skip(1)).map(side).sum()
            };
            let off = step / 2.0 * (around(&ring) + around(&form)) / 1e6;
            prop_assert!((counted - shared).abs() < off, "{} {}", counted, shared);
        }
    }
}
