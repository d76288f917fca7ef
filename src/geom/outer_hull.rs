//! Outer simplification of a simple ring: concave vertices go one by one, smallest added area first, so that the
//! ring only grows, towards its convex hull.
//!
//! Removing concave v keeps the ring simple if and only if no other vertex lies in the closed triangle
//! (previous, v, next): an edge could enter it only over the new edge and would have to end inside.
//! Vertices between collinear neighbours add nothing and always go, whatever the target.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, section 6;
//! order and stop as in GEOS' `PolygonHullSimplify` (outer, vertex count).

use super::Point;
use super::predicates::orient;

/// The ring with concave vertices removed until it has `target_edges`, or is convex. Simple, counter-clockwise
/// ring in, the same out; it contains the one given, its vertices are some of them. Ties: earlier vertex first.
pub fn simplify(ring: &[Point], target_edges: usize) -> Vec<Point> {
    let ids: Vec<u32> = (0..ring.len() as u32).collect();
    let mut kept = Vec::new();
    keep(ring, &ids, target_edges, &mut kept);
    kept.iter().map(|&i| ring[i as usize]).collect()
}

/// How many edges a ring keeps: a share of `of` edges, at least another of its `own`, rounded up.
pub fn target(keep: f64, of: u32, floor: f64, own: u32) -> usize {
    // A share that is whole but for rounding is whole.
    let share = |part: f64, edges: u32| (part * f64::from(edges) - 1e-9).ceil() as usize;
    share(keep, of).max(share(floor, own))
}

/// As [`simplify`]: the places of the vertices that stay, ascending. Ties are broken by smaller `ids`.
pub fn keep(ring: &[Point], ids: &[u32], target_edges: usize, kept: &mut Vec<u32>) {
    kept.clear();
    kept.extend(0..ring.len() as u32);
    while kept.len() > 3 {
        let n = kept.len();
        let at = |i: usize| ring[kept[i % n] as usize];
        let mut best: Option<(i64, u32, usize)> = None;
        for i in 0..n {
            let (a, v, b) = (at(i + n - 1), at(i), at(i + 1));
            let added = -orient(a, v, b);
            let key = (added, ids[kept[i] as usize], i);
            if added < 0 || best.is_some_and(|b| b <= key) || (added > 0 && n <= target_edges) {
                continue;
            }
            let blocks = |p: Point| p != a && p != v && p != b && in_triangle(a, b, v, p);
            if added == 0 || !(0..n).any(|j| blocks(at(j))) {
                best = Some(key);
            }
        }
        match best {
            Some((_, _, i)) => drop(kept.remove(i)),
            None => return,
        }
    }
}

/// True where `p` lies in the closed counter-clockwise triangle.
fn in_triangle(a: Point, b: Point, c: Point, p: Point) -> bool {
    orient(a, b, p) >= 0 && orient(b, c, p) >= 0 && orient(c, a, p) >= 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_l_becomes_convex_and_collinear_vertices_always_go() {
        let l = [[0, 0], [5, 0], [9, 0], [9, 4], [4, 4], [4, 9], [0, 9]];
        assert_eq!(simplify(&l, 99), [[0, 0], [9, 0], [9, 4], [4, 4], [4, 9], [0, 9]]);
        assert_eq!(simplify(&l, 5), [[0, 0], [9, 0], [9, 4], [4, 9], [0, 9]]);
        assert_eq!(simplify(&l, 3), [[0, 0], [9, 0], [9, 4], [4, 9], [0, 9]]);
    }
}
