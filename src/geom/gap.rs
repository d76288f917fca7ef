//! The smallest gap between two buildings' outlines.

use super::Point;
use super::bounds::Bounds;
use super::predicates::segments_meet;
use super::ring::{Side, side};

/// Distance in millimetres between the areas of the shells: 0 where they overlap, touch or lie in one another.
/// The same to the last bit whichever comes first.
pub fn gap(a: &[&[Point]], b: &[&[Point]]) -> f64 {
    let mut best = f64::INFINITY;
    for &r in a {
        let around = Bounds::of(r.iter().copied());
        for &s in b {
            let other = Bounds::of(s.iter().copied());
            if around.square_to(&other) == 0.0 && overlap(r, s) {
                return 0.0;
            }
            nearest(r, s, &other, &mut |_, _, d| best = best.min(d));
            nearest(s, r, &around, &mut |_, _, d| best = best.min(d));
        }
    }
    best
}

/// The shortest segment between the two outlines, its ends on the millimetre grid; where several are equally short
/// the middle one between parallel walls. None where the gap is 0.
pub fn shortest(a: &[&[Point]], b: &[&[Point]]) -> Option<[Point; 2]> {
    let least = gap(a, b);
    if least == 0.0 {
        return None;
    }
    // (1) All that are as short, but for rounding.
    let mut found: Vec<[[f64; 2]; 2]> = Vec::new();
    for &r in a {
        for &s in b {
            let mut keep = |p: Point, q: [f64; 2], d: f64| {
                if d <= least * (1.0 + 1e-9) {
                    found.push([p.map(f64::from), q]);
                }
            };
            nearest(r, s, &Bounds::EMPTY, &mut keep);
            let mut turned = Vec::new();
            nearest(s, r, &Bounds::EMPTY, &mut |p: Point, q: [f64; 2], d: f64| {
                if d <= least * (1.0 + 1e-9) {
                    turned.push([q, p.map(f64::from)]);
                }
            });
            found.extend(turned);
        }
    }
    // (2) From b's side the pairs are the same, turned: one written order for both.
    found.iter_mut().for_each(|pair| {
        if pair[1] < pair[0] {
            pair.swap(0, 1);
        }
    });
    found.sort_by(|p, q| p.partial_cmp(q).unwrap_or(std::cmp::Ordering::Equal));
    // (3) Parallel walls give the two ends of what they share: the first, and the farthest of the same direction.
    let first = *found.first()?;
    let along = |pair: &[[f64; 2]; 2]| [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
    let d = along(&first);
    let parallel = |pair: &&[[f64; 2]; 2]| {
        let e = along(pair);
        let shift = [pair[0][0] - first[0][0], pair[0][1] - first[0][1]];
        let len = least * least;
        (d[0] * e[1] - d[1] * e[0]).abs() <= 1e-6 * len && (d[0] * shift[0] + d[1] * shift[1]).abs() <= 1.0 + 1e-6 * len
    };
    let last = *found.iter().rev().find(parallel).unwrap_or(&first);
    let middle = |k: usize| [0, 1].map(|c| ((first[k][c] + last[k][c]) / 2.0 + 0.5).floor() as i32);
    Some([middle(0), middle(1)])
}

/// From every vertex of `r` to the nearest point of every edge of `s`, leaving out vertices that are farther from
/// the box around `s` than what was found.
fn nearest(r: &[Point], s: &[Point], around: &Bounds, see: &mut impl FnMut(Point, [f64; 2], f64)) {
    let mut best = f64::INFINITY;
    for &p in r {
        if *around != Bounds::EMPTY && around.square_to_point(p).sqrt() > best * (1.0 + 1e-12) {
            continue;
        }
        for (i, &a) in s.iter().enumerate() {
            let b = s[if i + 1 == s.len() { 0 } else { i + 1 }];
            let (q, d) = to_segment(p, a, b);
            best = best.min(d);
            see(p, q, d);
        }
    }
}

/// The nearest point of `a`-`b`, and the distance.
pub fn to_segment(p: Point, a: Point, b: Point) -> ([f64; 2], f64) {
    let minus = |u: Point, v: Point| [i64::from(u[0]) - i64::from(v[0]), i64::from(u[1]) - i64::from(v[1])];
    let dot = |u: [i64; 2], v: [i64; 2]| u[0] * v[0] + u[1] * v[1];
    // From the lower end, so that both directions round alike.
    let (a, b) = if a <= b { (a, b) } else { (b, a) };
    let (edge, from) = (minus(b, a), minus(p, a));
    let (along, length) = (dot(edge, from), dot(edge, edge));
    let to = |q: Point| {
        let d = minus(p, q);
        (q.map(f64::from), (dot(d, d) as f64).sqrt())
    };
    if along <= 0 {
        return to(a);
    }
    if along >= length {
        return to(b);
    }
    let t = along as f64 / length as f64;
    let foot = [0, 1].map(|k| f64::from(a[k]) + t * edge[k] as f64);
    let cross = (edge[0] * from[1] - edge[1] * from[0]).abs();
    (foot, cross as f64 / (length as f64).sqrt())
}

fn overlap(r: &[Point], s: &[Point]) -> bool {
    let edges = |ring: &[Point]| -> Vec<[Point; 2]> {
        (0..ring.len()).map(|i| [ring[i], ring[(i + 1) % ring.len()]]).collect()
    };
    let (er, es) = (edges(r), edges(s));
    er.iter().any(|e| es.iter().any(|f| segments_meet(e[0], e[1], f[0], f[1]))) || within(r, s) || within(s, r)
}

/// True where the first vertex of `r` lies in `s`: without crossings, all of it.
fn within(r: &[Point], s: &[Point]) -> bool {
    let doubled = |p: Point| p.map(|v| 2 * i64::from(v));
    r.first().is_some_and(|&p| !matches!(side(s, doubled(p)), Side::Out))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: i32, y: i32, side: i32) -> Vec<Point> {
        vec![[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
    }

    #[test]
    fn gaps() {
        let a = square(0, 0, 10);
        let gap_to = |b: Vec<Point>| {
            let (there, back) = (gap(&[&a], &[&b]), gap(&[&b], &[&a]));
            assert_eq!(there.to_bits(), back.to_bits());
            assert_eq!(shortest(&[&a], &[&b]).map(|[p, q]| [p.min(q), p.max(q)]), shortest(&[&b], &[&a]));
            there
        };
        assert_eq!(gap_to(square(13, 14, 5)), 5.0);
        assert_eq!(gap_to(square(20, 3, 5)), 10.0);
        assert_eq!(gap_to(square(2, 2, 5)), 0.0);
        assert_eq!(gap_to(square(-5, -5, 50)), 0.0);
        assert_eq!(gap_to(square(10, 10, 5)), 0.0);
        assert_eq!(gap_to(vec![[10, 20], [15, 15], [20, 20]]), 50f64.sqrt());
    }

    #[test]
    fn the_middle_between_walls() {
        let (a, b) = (square(0, 0, 10), square(20, 4, 10));
        assert_eq!(shortest(&[&a], &[&b]), Some([[10, 7], [20, 7]]));
        assert_eq!(shortest(&[&a], &[&square(13, 14, 5)]), Some([[10, 10], [13, 14]]));
        assert_eq!(shortest(&[&a], &[&a]), None);
    }
}
