//! Area of a union of polygons, overlaps counted once, however many lie over each other.
//!
//! Every edge is split where others meet it. A piece with the union on its left and nothing on its right bounds
//! it; the area is half the sum of cross(a, b) over such pieces, and a piece of an edge has just its share of the
//! edge's cross product. Pieces that lie over each other count once. Exact but for rounding of doubles.

use super::Point;
use super::predicates::orient;
use super::segments::{Rect, Segment, edges, near_pairs};

/// A polygon: what its shell winds around, without what its holes wind around. Rings may cross.
pub struct Polygon<'a> {
    pub shell: &'a [Point],
    pub holes: Vec<&'a [Point]>,
}

struct Edge {
    ends: Segment,
    ring: u32,
}

/// Doubled area of the union, square millimetres. Quadratic in the number of edges whose polygons' boxes meet.
pub fn doubled_union_area(polygons: &[Polygon]) -> f64 {
    // Rings: of each polygon the shell, then the holes.
    let mut edge_list: Vec<Edge> = Vec::new();
    let mut rings: Vec<(usize, std::ops::Range<usize>, Rect)> = Vec::new();
    for (p, polygon) in polygons.iter().enumerate() {
        for ring in std::iter::once(&polygon.shell).chain(&polygon.holes) {
            let from = edge_list.len();
            let number = rings.len() as u32;
            edge_list.extend(edges(ring).filter(|e| e[0] != e[1]).map(|ends| Edge { ends, ring: number }));
            rings.push((p, from..edge_list.len(), Rect::of(ring.iter().copied())));
        }
    }
    let Some(origin) = edge_list.first().map(|e| e.ends[0]) else { return 0.0 };
    let segments: Vec<Segment> = edge_list.iter().map(|e| e.ends).collect();

    // (1) Where edges meet, as shares of each; pieces that lie over each other.
    let mut stops: Vec<(u32, f64)> = Vec::new();
    let mut twins: Vec<(u32, u32)> = Vec::new();
    near_pairs(&segments, &segments, |i, j| {
        if i < j {
            let ([a, b], [c, d]) = (segments[i as usize], segments[j as usize]);
            let (oc, od, oa, ob) = (orient(a, b, c), orient(a, b, d), orient(c, d, a), orient(c, d, b));
            if oc == 0 && od == 0 {
                for (e, [p, q], other) in [(i, [a, b], [c, d]), (j, [c, d], [a, b])] {
                    stops.extend(other.map(|o| (e, share(p, q, o))));
                }
                twins.extend([(i, j), (j, i)]);
            } else if oc.signum() * od.signum() <= 0 && oa.signum() * ob.signum() <= 0 {
                stops.push((i, oa as f64 / (oa as f64 - ob as f64)));
                stops.push((j, oc as f64 / (oc as f64 - od as f64)));
            }
        }
        false
    });
    let by_edge = |a: &(u32, f64), b: &(u32, f64)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1));
    stops.sort_unstable_by(by_edge);
    twins.sort_unstable();
    twins.dedup();

    // (2) The pieces.
    let mut sum = 0.0;
    let mut at = 0;
    let mut inside = [vec![0i32; rings.len()], vec![0i32; rings.len()]];
    for (i, edge) in edge_list.iter().enumerate() {
        let [a, b] = edge.ends;
        let weight = orient(origin, a, b) as f64;
        let from = at;
        while at < stops.len() && stops[at].0 == i as u32 {
            at += 1;
        }
        let mine = &twins[twins.partition_point(|t| t.0 < i as u32)..twins.partition_point(|t| t.0 <= i as u32)];
        let mut low = 0.0;
        for high in stops[from..at].iter().map(|s| s.1.clamp(0.0, 1.0)).chain([1.0]) {
            if high <= low {
                continue;
            }
            let middle = (low + high) / 2.0;
            let over: Vec<u32> =
                mine.iter().map(|t| t.1).filter(|&j| covers(a, b, segments[j as usize], middle)).collect();
            if over.iter().all(|&j| j > i as u32) {
                windings(i, middle, &over, &edge_list, &rings, &mut inside);
                let [left, right] = [0, 1].map(|k| in_union(&rings, &inside[k]));
                sum += weight * (high - low) * (f64::from(u8::from(left)) - f64::from(u8::from(right)));
            }
            low = high;
        }
    }
    sum
}

/// Where `p` lies on the line through a and b: 0 at a, 1 at b.
fn share(a: Point, b: Point, p: Point) -> f64 {
    let k = usize::from((b[0] - a[0]).abs() < (b[1] - a[1]).abs());
    (f64::from(p[k]) - f64::from(a[k])) / (f64::from(b[k]) - f64::from(a[k]))
}

/// True where the collinear segment lies over the place `t` of a-b.
fn covers(a: Point, b: Point, other: Segment, t: f64) -> bool {
    let [p, q] = other.map(|o| share(a, b, o));
    p.min(q) < t && t < p.max(q)
}

/// How often each ring winds around the two sides, left and right, of edge `i` at its place `t`.
fn windings(
    i: usize,
    t: f64,
    over: &[u32],
    edge_list: &[Edge],
    rings: &[(usize, std::ops::Range<usize>, Rect)],
    out: &mut [Vec<i32>; 2],
) {
    let [a, b] = edge_list[i].ends;
    let d = [0, 1].map(|k| f64::from(b[k]) - f64::from(a[k]));
    let m = [0, 1].map(|k| f64::from(a[k]) + t * d[k]);
    // A ray along axis k towards the right side; `side` = +1 or -1 along that axis.
    let k = usize::from(d[1].abs() < d[0].abs());
    let side = if k == 0 { d[1].signum() } else { -d[0].signum() };
    for (r, (_, range, rect)) in rings.iter().enumerate() {
        out[1][r] = 0;
        let reach = |c: usize| f64::from(rect.low[c]) <= m[c] && m[c] <= f64::from(rect.high[c]);
        if reach(1 - k) {
            for j in range.clone() {
                let [p, q] = edge_list[j].ends.map(|p| p.map(f64::from));
                let o = 1 - k;
                if j == i || (p[o] > m[o]) == (q[o] > m[o]) || over.contains(&(j as u32)) {
                    continue;
                }
                let cut = p[k] + (m[o] - p[o]) / (q[o] - p[o]) * (q[k] - p[k]);
                if (cut - m[k]) * side > 0.0 {
                    // An edge that crosses the ray with the ray's start on its left winds around it.
                    let rising = if q[o] > p[o] { 1 } else { -1 };
                    out[1][r] += rising * (if k == 0 { 1 } else { -1 }) * (side as i32);
                }
            }
        }
        out[0][r] = out[1][r];
    }
    for &j in over.iter().chain([&(i as u32)]) {
        let [p, q] = edge_list[j as usize].ends.map(|p| p.map(f64::from));
        let along = (q[0] - p[0]) * d[0] + (q[1] - p[1]) * d[1] > 0.0;
        out[0][edge_list[j as usize].ring as usize] += if along { 1 } else { -1 };
    }
}

fn in_union(rings: &[(usize, std::ops::Range<usize>, Rect)], inside: &[i32]) -> bool {
    let mut r = 0;
    while r < rings.len() {
        let polygon = rings[r].0;
        let shell = inside[r] != 0;
        let mut hole = false;
        r += 1;
        while r < rings.len() && rings[r].0 == polygon {
            hole |= inside[r] != 0;
            r += 1;
        }
        if shell && !hole {
            return true;
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(shells: &[&[Point]]) -> f64 {
        let all: Vec<Polygon> = shells.iter().map(|shell| Polygon { shell, holes: vec![] }).collect();
        doubled_union_area(&all) / 2.0
    }

    #[test]
    fn plain_crossing_equal_and_nested() {
        let big: &[Point] = &[[0, 0], [4, 0], [4, 4], [0, 4]];
        assert_eq!(area(&[big]), 16.0);
        assert_eq!(area(&[big, big, big]), 16.0);
        assert_eq!(area(&[big, &[[1, 1], [2, 1], [2, 2], [1, 2]]]), 16.0);
        assert_eq!(area(&[big, &[[4, 0], [8, 0], [8, 4], [4, 4]]]), 32.0);
        assert_eq!(area(&[big, &[[2, -2], [6, 2], [2, 6]]]), 16.0 + 8.0);
        // A bow tie: both wings.
        assert_eq!(area(&[&[[0, 0], [4, 4], [4, 0], [0, 4]]]), 8.0);
    }

    #[test]
    fn holes_with_something_in_them() {
        let (shell, hole, tower): (&[Point], &[Point], &[Point]) =
            (&[[0, 0], [9, 0], [9, 9], [0, 9]], &[[2, 2], [2, 7], [7, 7], [7, 2]], &[[1, 3], [4, 3], [4, 4], [1, 4]]);
        let yard = || Polygon { shell, holes: vec![hole] };
        assert_eq!(doubled_union_area(&[yard()]) / 2.0, 81.0 - 25.0);
        assert_eq!(doubled_union_area(&[yard(), Polygon { shell: tower, holes: vec![] }]) / 2.0, 81.0 - 25.0 + 2.0);
        // A hole that reaches over its shell takes only what is there.
        let over: &[Point] = &[[8, 8], [8, 12], [12, 12], [12, 8]];
        assert_eq!(doubled_union_area(&[Polygon { shell, holes: vec![over] }]) / 2.0, 80.0);
    }

    #[test]
    fn boxes_as_by_counting_cells() {
        let mut seed = 11u64;
        let mut next = |n: u64| {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((seed >> 33) % n) as i32
        };
        for _ in 0..200 {
            let boxes: Vec<Vec<Point>> = (0..6)
                .map(|_| {
                    let (x, y, w, h) = (next(8), next(8), 1 + next(5), 1 + next(5));
                    vec![[x, y], [x + w, y], [x + w, y + h], [x, y + h]]
                })
                .collect();
            let inside =
                |x: i32, y: i32| boxes.iter().any(|b| b[0][0] <= x && x < b[2][0] && b[0][1] <= y && y < b[2][1]);
            let cells = (0..16).flat_map(|x| (0..16).map(move |y| (x, y))).filter(|&(x, y)| inside(x, y)).count();
            let shells: Vec<&[Point]> = boxes.iter().map(|b| &b[..]).collect();
            assert!((area(&shells) - cells as f64).abs() < 1e-9, "{boxes:?}");
        }
    }
}
