//! Rings: open lists of points, the first not repeated.

use super::Point;
use super::predicates::{on_segment, orient, segments_cross};
use super::segments::{Segment, edges, near_pairs};

/// Twice the signed area: positive for counter-clockwise. Exact; only a ring that winds several times around the whole
/// plane has more than fits, and gets the most that does.
pub fn doubled_area(ring: &[Point]) -> i64 {
    // Relative to the first point, so that every product is of differences.
    let Some((&first, rest)) = ring.split_first() else { return 0 };
    let sum: i128 = rest.windows(2).map(|w| i128::from(orient(first, w[0], w[1]))).sum();
    sum.clamp((-i64::MAX).into(), i64::MAX.into()) as i64
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
    let (mut sorted, mut hull) = (Vec::new(), Vec::with_capacity(16));
    convex_hull_into(points, &mut sorted, &mut hull);
    hull
}

/// [`convex_hull`] into `hull`; `sorted` is working memory.
pub fn convex_hull_into(points: &[Point], sorted: &mut Vec<Point>, hull: &mut Vec<Point>) {
    sorted.clear();
    sorted.extend_from_slice(points);
    sorted.sort_unstable();
    sorted.dedup();
    hull.clear();
    if sorted.len() < 3 {
        hull.append(sorted);
        return;
    }
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
}

/// Where a point lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    In,
    On,
    Out,
}

/// Where `p`, in *half* millimetres, lies of a ring. Exact.
pub fn side(ring: &[Point], p: [i64; 2]) -> Side {
    let mut inside = false;
    for [a, b] in edges(ring) {
        let [a, b] = [a, b].map(|q| q.map(|c| 2 * i64::from(c)));
        if (a[1] > p[1] && b[1] > p[1]) || (a[1] < p[1] && b[1] < p[1]) || (a[0] < p[0] && b[0] < p[0]) {
            continue;
        }
        let product = |u: i64, v: i64| i128::from(u) * i128::from(v);
        let turn = product(b[0] - a[0], p[1] - a[1]) - product(b[1] - a[1], p[0] - a[0]);
        if turn == 0 && a[0].min(b[0]) <= p[0] && p[0] <= a[0].max(b[0]) {
            return Side::On;
        }
        if (a[1] > p[1]) != (b[1] > p[1]) && (turn > 0) == (b[1] > a[1]) {
            inside = !inside;
        }
    }
    if inside { Side::In } else { Side::Out }
}

/// True where the closed region of simple `inner` lies in that of simple `outer`; touching is allowed. Exact.
/// All vertices and edge midpoints inside are not enough: an edge may lie over the mouth of a notch.
pub fn contains(outer: &[Point], inner: &[Point]) -> bool {
    let (all, mine): (Vec<Segment>, Vec<Segment>) = (edges(outer).collect(), edges(inner).collect());
    // Between two places where the inner ring touches the outer one it is in, on or out as a whole.
    let mut stops: Vec<(u32, Point, bool)> = Vec::new();
    let mut along: Vec<(u32, Segment)> = Vec::new();
    let mut touches = vec![false; mine.len()];
    let crossing = near_pairs(&mine, &all, |i, j| {
        let ([a, b], [c, d]) = (mine[i as usize], all[j as usize]);
        stops.extend([c, d].into_iter().filter(|&p| on_segment(a, b, p)).map(|p| (i, p, true)));
        touches[i as usize] |= on_segment(c, d, a);
        if orient(a, b, c) == 0 && orient(a, b, d) == 0 {
            along.push((i, [c, d]));
        }
        segments_cross(a, b, c, d)
    });
    if crossing || outer.len() < 3 {
        return false;
    }
    stops.extend((0..mine.len()).map(|i| {
        let next = if i + 1 == mine.len() { 0 } else { i + 1 };
        (i as u32, mine[i][1], touches[next])
    }));
    let far = |&(i, p, _): &(u32, Point, bool)| {
        let [a, _] = mine[i as usize];
        (i, (0..2).map(|k| (i64::from(p[k]) - i64::from(a[k])).abs()).sum::<i64>())
    };
    stops.sort_by_key(far);
    along.sort_unstable();
    along.dedup();
    let mut known = false;
    let mut last = None;
    stops.into_iter().all(|(i, p, touch)| {
        let start = match last {
            Some((edge, point)) if edge == i => point,
            _ => {
                known &= !touches[i as usize];
                mine[i as usize][0]
            }
        };
        last = Some((i, p));
        let of = &along[along.partition_point(|l| l.0 < i)..along.partition_point(|l| l.0 <= i)];
        let covered = || of.iter().any(|&(_, [c, d])| on_segment(c, d, start) && on_segment(c, d, p));
        let fine = start == p
            || known
            || covered()
            || side(outer, [0, 1].map(|k| i64::from(start[k]) + i64::from(p[k]))) != Side::Out;
        known = (known || start != p) && !touch;
        fine
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas() {
        assert_eq!(area_m2(&[[0, 0], [2000, 0], [2000, 1000], [0, 1000]]), 2.0);
        assert_eq!(area_m2(&[[0, 0], [0, 1000], [2000, 1000], [2000, 0]]), -2.0);
        assert_eq!(doubled_area(&[]), 0);
        let far = (1 << 29) - 1;
        let mut wound = [[-far, -far], [far, -far], [far, far], [-far, far]].repeat(5);
        assert_eq!(doubled_area(&wound[..4]), 8 * i64::from(far).pow(2));
        assert_eq!(doubled_area(&wound), i64::MAX);
        wound.reverse();
        assert_eq!(doubled_area(&wound), -i64::MAX);
    }

    #[test]
    fn one_in_another() {
        let notched = [[0, 0], [9, 0], [9, 9], [6, 9], [6, 3], [3, 3], [3, 9], [0, 9]];
        let lid = [[0, 5], [9, 5], [9, 9], [0, 9]];
        assert!(contains(&notched, &notched));
        assert!(contains(&notched, &[[0, 0], [9, 0], [6, 3], [3, 3]]));
        assert!(!contains(&notched, &lid));
        assert!(!contains(&notched, &[[4, 5], [5, 5], [5, 6]]));
        assert!(!contains(&[[4, 5], [5, 5], [5, 6]], &notched));
        assert_eq!(side(&notched, [9, 6]), Side::On);
        assert_eq!(side(&notched, [9, 7]), Side::Out);
        assert_eq!(side(&notched, [5, 7]), Side::In);
    }

    #[test]
    fn convex_hulls() {
        let square = [[0, 0], [2, 0], [4, 0], [4, 4], [1, 1], [0, 4], [0, 2], [4, 4]];
        assert_eq!(convex_hull(&square), [[0, 0], [4, 0], [4, 4], [0, 4]]);
        assert_eq!(convex_hull(&[[0, 0], [1, 1], [2, 2]]), [[0, 0], [2, 2]]);
        assert_eq!(convex_hull(&[[3, 3], [3, 3]]), [[3, 3]]);
    }
}
