//! The outline of two rings that cross, in their own vertices.
//!
//! Walks along the union's boundary, from one ring to the other at every crossing point. Such a point is no vertex;
//! the boundary turns right there, so the edge from the vertex before to the vertex after lies outside and adds no
//! more than the triangle it cuts off. Where that edge is not clear of both rings, or where rings touch without
//! crossing, nothing is traced.

use super::Point;
use super::merge_rings::Ring;
use super::predicates::{on_segment, orient, segments_cross, segments_meet};
use super::ring::contains;
use super::segments::Rect;

/// Where a crossing lies on an edge: the edge, its share as a fraction, the crossing's number.
#[derive(Clone, Copy)]
struct Stop {
    edge: u32,
    share: (i64, i64),
    crossing: u32,
}

/// Working memory.
#[derive(Default)]
pub struct Outline {
    /// On either ring, in order.
    stops: [Vec<Stop>; 2],
    /// Of each crossing its places in `stops`.
    places: Vec<[u32; 2]>,
    /// Ring and place of each vertex passed, and whether a crossing lies before it.
    walk: Vec<(usize, u32, bool)>,
}

impl Outline {
    /// Appends the outline to `at` and `ids`; false, and nothing appended, where there is none by the rules above.
    /// `contacts` are all pairs of edges that share a point.
    pub fn trace(
        &mut self,
        r: Ring,
        s: Ring,
        contacts: &[(u32, u32)],
        at: &mut Vec<Point>,
        ids: &mut Vec<u32>,
    ) -> bool {
        let rings = [r, s];
        if !self.find_stops(rings, contacts) || !self.walk(rings) || !self.is_sound(rings) {
            return false;
        }
        for &(k, place, _) in &self.walk {
            at.push(rings[k].at[place as usize]);
            ids.push(rings[k].ids[place as usize]);
        }
        // A ring with an edge of its own here has its inside on the inside; else look.
        for (k, ring) in rings.into_iter().enumerate() {
            let n = self.walk.len();
            let has_edge = (0..n).any(|i| {
                let (next, _, crossing) = self.walk[(i + 1) % n];
                self.walk[i].0 == k && next == k && !crossing
            });
            if !has_edge && !contains(at, ring.at) {
                at.clear();
                ids.clear();
                return false;
            }
        }
        true
    }

    /// False where rings touch without crossing.
    fn find_stops(&mut self, [r, s]: [Ring; 2], contacts: &[(u32, u32)]) -> bool {
        self.stops.iter_mut().for_each(Vec::clear);
        self.places.clear();
        self.places.resize(contacts.len(), [0; 2]);
        for (crossing, &(i, j)) in contacts.iter().enumerate() {
            let ([a, b], [c, d]) = (r.edge(i as usize), s.edge(j as usize));
            if !segments_cross(a, b, c, d) {
                return false;
            }
            for (k, edge, from, to) in
                [(0, i, orient(c, d, a), orient(c, d, b)), (1, j, orient(a, b, c), orient(a, b, d))]
            {
                // The ends lie on two sides.
                let share = (from.abs(), from.abs() + to.abs());
                self.stops[k].push(Stop { edge, share, crossing: crossing as u32 });
            }
        }
        for (k, stops) in self.stops.iter_mut().enumerate() {
            stops.sort_unstable_by(|x, y| {
                let product = |a: i64, b: i64| i128::from(a) * i128::from(b);
                let share = product(x.share.0, y.share.1).cmp(&product(y.share.0, x.share.1));
                x.edge.cmp(&y.edge).then(share)
            });
            for (place, stop) in stops.iter().enumerate() {
                self.places[stop.crossing as usize][k] = place as u32;
            }
        }
        true
    }

    /// Along the boundary from a vertex that is on it for sure. False if it does not close.
    fn walk(&mut self, rings: [Ring; 2]) -> bool {
        self.walk.clear();
        let lowest = |k: usize| (0..rings[k].at.len()).map(|i| (rings[k].at[i], k, i)).min();
        let Some((_, first_ring, first)) = lowest(0).into_iter().chain(lowest(1)).min() else { return false };
        let (mut k, mut place) = (first_ring, first);
        let mut crossing = false;
        let limit = rings[0].at.len() + rings[1].at.len();
        loop {
            self.walk.push((k, place as u32, crossing));
            crossing = false;
            let mut edge = place as u32;
            let mut stop = self.stops[k].partition_point(|s| s.edge < edge);
            let mut turns = 0;
            while let Some(&at) = self.stops[k].get(stop).filter(|s| s.edge == edge) {
                crossing = true;
                turns += 1;
                k = 1 - k;
                let there = self.places[at.crossing as usize][k] as usize;
                edge = self.stops[k][there].edge;
                stop = there + 1;
                if turns > self.places.len() {
                    return false;
                }
            }
            place = rings[k].after(edge as usize);
            if (k, place) == (first_ring, first) {
                self.walk[0].2 = crossing;
                return true;
            }
            if self.walk.len() > limit {
                return false;
            }
        }
    }

    /// True where all new edges are clear of the rings and of each other.
    fn is_sound(&self, rings: [Ring; 2]) -> bool {
        let n = self.walk.len();
        let new = |i: usize| {
            let ((j, p, _), (k, q, crossing)) = (self.walk[if i == 0 { n - 1 } else { i - 1 }], self.walk[i]);
            crossing.then_some(((j, p as usize), (k, q as usize)))
        };
        let point = |(k, p): (usize, usize)| rings[k].at[p];
        let clear = |a: (usize, usize), b: (usize, usize)| {
            let (p, q) = (point(a), point(b));
            let rect = Rect::of([p, q]);
            rings[a.0].leaves(a.1, q)
                && rings[b.0].leaves(b.1, p)
                && (0..2).all(|k| {
                    let ring = rings[k];
                    (0..ring.at.len()).all(|i| {
                        let [c, d] = ring.edge(i);
                        let ends = [(k, i), (k, ring.after(i))];
                        !rect.meets_segment(c, d)
                            || ends.contains(&a)
                            || ends.contains(&b)
                            || !segments_meet(p, q, c, d)
                    })
                })
        };
        if n < 3 || !(0..n).filter_map(new).all(|(a, b)| clear(a, b)) {
            return false;
        }
        // Among each other: few, and neighbours share an end.
        let count = (0..n).filter(|&i| self.walk[i].2).count();
        count < 2 || {
            let all: Vec<_> = (0..n).filter_map(new).collect();
            all.len() <= 200
                && all.iter().enumerate().all(|(x, &(a, b))| {
                    all[..x].iter().all(|&(c, d)| {
                        let [p, q, u, v] = [a, b, c, d].map(point);
                        match (a == d, b == c) {
                            (true, true) => false,
                            (true, false) => !on_segment(p, q, u) && !on_segment(u, v, q),
                            (false, true) => !on_segment(p, q, v) && !on_segment(u, v, p),
                            _ => !segments_meet(p, q, u, v),
                        }
                    })
                })
        }
    }
}
