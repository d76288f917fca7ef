//! Rings: open lists of points, the first not repeated.

use super::Point;
use super::predicates::orient;

/// Twice the signed area: positive for counter-clockwise. Exact.
pub fn doubled_area(ring: &[Point]) -> i64 {
    // Relative to the first point, so that every product is of differences.
    let Some((&first, rest)) = ring.split_first() else { return 0 };
    rest.windows(2).map(|w| orient(first, w[0], w[1])).sum()
}

/// Area in square metres, positive for counter-clockwise.
pub fn area_m2(ring: &[Point]) -> f64 {
    doubled_area(ring) as f64 / 2e6
}

/// Number of edges once vertices on a straight line between their neighbours are gone.
pub fn edges_without_collinear(ring: &[Point]) -> usize {
    let n = ring.len();
    let at = |i: usize| ring[if i >= n { i - n } else { i }];
    (0..n).filter(|&i| orient(at(i + n - 1), at(i), at(i + 1)) != 0).count()
}

/// The convex ring around points: counter-clockwise from the lowest of the leftmost, without collinear vertices.
/// Fewer than three points where they all lie on a line.
pub fn convex_hull(points: &[Point]) -> Vec<Point> {
    let mut sorted = points.to_vec();
    sorted.sort_unstable();
    sorted.dedup();
    if sorted.len() < 3 {
        return sorted;
    }
    let mut hull: Vec<Point> = Vec::with_capacity(16);
    // Lower chain, then upper chain; neither may drop what the other began with.
    for pass in 0..2 {
        let floor = hull.len().max(1);
        let mut grow = |p: Point| {
            while hull.len() > floor && orient(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0 {
                hull.pop();
            }
            hull.push(p);
        };
        if pass == 0 {
            sorted.iter().for_each(|&p| grow(p));
        } else {
            sorted.iter().rev().skip(1).for_each(|&p| grow(p));
        }
    }
    hull.pop();
    hull
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas() {
        assert_eq!(area_m2(&[[0, 0], [2000, 0], [2000, 1000], [0, 1000]]), 2.0);
        assert_eq!(area_m2(&[[0, 0], [0, 1000], [2000, 1000], [2000, 0]]), -2.0);
        assert_eq!(doubled_area(&[]), 0);
    }

    #[test]
    fn convex_hulls() {
        let square = [[0, 0], [2, 0], [4, 0], [4, 4], [1, 1], [0, 4], [0, 2], [4, 4]];
        assert_eq!(convex_hull(&square), [[0, 0], [4, 0], [4, 4], [0, 4]]);
        assert_eq!(convex_hull(&[[0, 0], [1, 1], [2, 2]]), [[0, 0], [2, 2]]);
        assert_eq!(convex_hull(&[[3, 3], [3, 3]]), [[3, 3]]);
    }
}
