//! One simple ring around any set of segments: the convex hull, eroded.
//!
//! Constrained Delaunay triangulation of the ends. Segments that cross are not inserted, but every triangle that
//! they pass is occupied, and triangulation edges that they run along are walls: one of two crossing constraints
//! would have to give way, and which one must not hang on the library's order. What can be reached from outside
//! without passing a wall or an occupied triangle is free. Then, from the convex hull, the free triangle behind
//! the longest border edge is taken off as long as its third vertex is not on the border yet. After every step the
//! ring is simple, covers all segments, and has no other vertices than their ends.
//! Largest area first leaves a third more area than longest first (11.4 against 8.5 km2, tokyo_centre).

use std::collections::BinaryHeap;

use spade::{ConstrainedDelaunayTriangulation, Intersection, LineIntersectionIterator, Point2, Triangulation};

use super::Point;
use super::predicates::segments_cross;
use super::segments::near_pairs;

const NONE: u32 = u32::MAX;

/// The ring as places in `points`, counter-clockwise from the lowest place; none where all points are on a line.
/// `points` are distinct; ties go by their order. Cost near O(n log n).
pub fn erode(points: &[Point], segments: &[[u32; 2]]) -> Option<Vec<u32>> {
    let at = |i: u32| points[i as usize];
    let ends: Vec<[Point; 2]> = segments.iter().map(|s| s.map(at)).collect();
    let mut crossed = vec![false; segments.len()];
    near_pairs(&ends, &ends, |i, j| {
        let ([a, b], [c, d]) = (ends[i as usize], ends[j as usize]);
        if i < j && segments_cross(a, b, c, d) {
            crossed[i as usize] = true;
            crossed[j as usize] = true;
        }
        false
    });

    // (1) Triangles, walls, and what is occupied.
    let mut mesh = ConstrainedDelaunayTriangulation::<Point2<f64>>::new();
    let origin = *points.first()?;
    let handles: Vec<_> = points
        .iter()
        .map(|p| [0, 1].map(|k| f64::from(p[k]) - f64::from(origin[k])))
        .map(|[x, y]| mesh.insert(Point2::new(x, y)).expect("coordinates are small whole numbers"))
        .collect();
    if mesh.all_vertices_on_line() {
        return None;
    }
    for (s, _) in segments.iter().zip(&crossed).filter(|(_, crossed)| !**crossed) {
        mesh.add_constraint(handles[s[0] as usize], handles[s[1] as usize]);
    }
    let mut wall: Vec<bool> = mesh.undirected_edges().map(|e| e.is_constraint_edge()).collect();
    let mut occupied = vec![false; mesh.num_all_faces()];
    for (s, _) in segments.iter().zip(&crossed).filter(|(_, crossed)| **crossed) {
        let (from, to) = (handles[s[0] as usize], handles[s[1] as usize]);
        for met in LineIntersectionIterator::new_from_handles(&mesh, from, to) {
            match met {
                Intersection::EdgeIntersection(e) => {
                    occupied[e.face().fix().index()] = true;
                    occupied[e.rev().face().fix().index()] = true;
                }
                Intersection::EdgeOverlap(e) => wall[e.as_undirected().fix().index()] = true,
                Intersection::VertexIntersection(_) => {}
            }
        }
    }

    // (2) What is free, from outside.
    let outside = mesh.outer_face().fix().index();
    let mut free = vec![false; mesh.num_all_faces()];
    let mut next = vec![NONE; points.len()];
    let mut open = Vec::new();
    let mut border = BinaryHeap::new();
    let key = |a: u32, b: u32| {
        let d = |k: usize| i64::from(points[a as usize][k]) - i64::from(points[b as usize][k]);
        (d(0) * d(0) + d(1) * d(1), std::cmp::Reverse((a.min(b), a.max(b))))
    };
    for e in mesh.outer_face().adjacent_edge().into_iter().flat_map(|first| {
        std::iter::successors(Some(first), move |e| Some(e.next()).filter(|e| e.fix() != first.fix()))
    }) {
        let inward = e.rev();
        let (a, b) = (inward.from().index() as u32, inward.to().index() as u32);
        next[a as usize] = b;
        border.push((key(a, b), a, inward.fix()));
        open.push(inward);
    }
    while let Some(e) = open.pop() {
        let face = e.face().fix().index();
        if face == outside || free[face] || occupied[face] || wall[e.as_undirected().fix().index()] {
            continue;
        }
        free[face] = true;
        open.extend([e.next().rev(), e.prev().rev()]);
    }

    // (3) Erosion.
    while let Some((_, a, e)) = border.pop() {
        let e = mesh.directed_edge(e);
        let tip = e.next().to().index() as u32;
        if wall[e.as_undirected().fix().index()] || !free[e.face().fix().index()] || next[tip as usize] != NONE {
            continue;
        }
        let b = e.to().index() as u32;
        next[a as usize] = tip;
        next[tip as usize] = b;
        border.push((key(a, tip), a, e.prev().rev().fix()));
        border.push((key(tip, b), tip, e.next().rev().fix()));
    }
    let first = next.iter().position(|&n| n != NONE)? as u32;
    let ring = std::iter::successors(Some(first), |&v| Some(next[v as usize]).filter(|&n| n != first));
    Some(ring.collect())
}

/// A ring around the edges of `ring`, which may cross and touch itself: see [`erode`]. Places in `ring`, the first
/// of equal points; none where all are on a line.
pub fn around(ring: &[Point]) -> Option<Vec<u32>> {
    let mut order: Vec<u32> = (0..ring.len() as u32).collect();
    order.sort_by_key(|&i| (ring[i as usize], i));
    let mut same = vec![0u32; ring.len()];
    for w in 0..order.len() {
        let twin = w > 0 && ring[order[w] as usize] == ring[order[w - 1] as usize];
        same[order[w] as usize] = if twin { same[order[w - 1] as usize] } else { order[w] };
    }
    let firsts: Vec<u32> = (0..ring.len() as u32).filter(|&i| same[i as usize] == i).collect();
    let mut place = vec![0u32; ring.len()];
    firsts.iter().enumerate().for_each(|(k, &i)| place[i as usize] = k as u32);
    let points: Vec<Point> = firsts.iter().map(|&i| ring[i as usize]).collect();
    let n = ring.len();
    let segments: Vec<[u32; 2]> =
        (0..n).map(|i| [i, (i + 1) % n].map(|i| place[same[i] as usize])).filter(|s| s[0] != s[1]).collect();
    Some(erode(&points, &segments)?.into_iter().map(|k| firsts[k as usize]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bow_tie_gets_a_ring_around_it() {
        let ring = [[0, 0], [10, 10], [10, 0], [0, 10]];
        assert_eq!(around(&ring).unwrap(), [0, 2, 1, 3]);
        assert_eq!(around(&[[0, 0], [5, 5], [9, 9]]), None);
    }

    #[test]
    fn a_simple_ring_stays_itself() {
        let ring = [[0, 0], [9, 0], [9, 9], [6, 9], [6, 3], [3, 3], [3, 9], [0, 9]];
        assert_eq!(around(&ring).unwrap(), [0, 1, 2, 3, 4, 5, 6, 7]);
    }
}
