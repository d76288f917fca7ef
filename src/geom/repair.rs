//! Polygons as real data has them, to polygons as `Footprints` promises them.
//!
//! Rules: the closing point goes; repeated points and spikes (there and back on one line) go; a ring of fewer than
//! three corners goes, with its shell the part; a hole that starts outside its shell goes; shells are turned
//! counter-clockwise, holes clockwise. What crosses itself stays. Cost: linear; holes times shell for the test of holes.

use super::Point;
use super::predicates::{on_segment, orient};
use super::ring::doubled_area;

/// What was done to a polygon.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repairs {
    pub unclosed: bool,
    pub repeated: bool,
    pub spikes: bool,
    pub flat_parts: bool,
    pub flat_holes: bool,
    pub holes_outside: bool,
}

impl Repairs {
    /// In words, for notes.
    pub fn causes(self) -> impl Iterator<Item = &'static str> {
        [
            (self.unclosed, "an open ring was closed"),
            (self.repeated, "repeated points were dropped"),
            (self.spikes, "spikes were dropped"),
            (self.flat_parts, "a part of fewer than three corners was dropped"),
            (self.flat_holes, "a hole of fewer than three corners was dropped"),
            (self.holes_outside, "a hole outside its shell was dropped"),
        ]
        .into_iter()
        .filter_map(|(done, cause)| done.then_some(cause))
    }

    pub fn any(self) -> bool {
        self != Self::default()
    }
}

/// A polygon's rings, shell first, as the file has them (the last point repeats the first). None where the shell has
/// fewer than three corners.
pub fn polygon(rings: impl IntoIterator<Item = Vec<Point>>, repairs: &mut Repairs) -> Option<Vec<Vec<Point>>> {
    let mut out: Vec<Vec<Point>> = Vec::new();
    for mut ring in rings {
        if ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        } else {
            repairs.unclosed |= ring.len() > 2;
        }
        tidy(&mut ring, repairs);
        if ring.len() < 3 {
            if out.is_empty() {
                return None;
            }
            repairs.flat_holes = true;
            continue;
        }
        if out.first().is_some_and(|shell| outside(&ring, shell)) {
            repairs.holes_outside = true;
            continue;
        }
        if (doubled_area(&ring) > 0) != out.is_empty() {
            ring.reverse();
        }
        out.push(ring);
    }
    (!out.is_empty()).then_some(out)
}

/// Drops repeated points and spikes of an open ring, around its end as well.
pub fn tidy(ring: &mut Vec<Point>, repairs: &mut Repairs) {
    let mut n = 0;
    for i in 0..ring.len() {
        let p = ring[i];
        while n >= 2 && is_spike(ring[n - 2], ring[n - 1], p) {
            repairs.spikes = true;
            n -= 1;
        }
        if n >= 1 && ring[n - 1] == p {
            repairs.repeated = true;
            continue;
        }
        ring[n] = p;
        n += 1;
    }
    ring.truncate(n);
    let mut start = 0;
    while ring.len() - start >= 2 {
        let (first, last) = (ring[start], ring[ring.len() - 1]);
        if first == last {
            repairs.repeated = true;
            ring.pop();
        } else if is_spike(ring[ring.len() - 2], last, first) {
            repairs.spikes = true;
            ring.pop();
        } else if is_spike(last, first, ring[start + 1]) {
            repairs.spikes = true;
            start += 1;
        } else {
            break;
        }
    }
    ring.drain(..start);
}

/// From a to b and back over a.
#[inline]
fn is_spike(a: Point, b: Point, c: Point) -> bool {
    let d = |p: Point, q: Point, k: usize| i64::from(q[k]) - i64::from(p[k]);
    orient(a, b, c) == 0 && d(a, b, 0) * d(b, c, 0) + d(a, b, 1) * d(b, c, 1) < 0
}

/// The first point of `hole` that is not on the shell's line lies outside; or none is, and the hole is the shell.
fn outside(hole: &[Point], shell: &[Point]) -> bool {
    hole.iter()
        .find_map(|&p| inside(shell, p))
        .map_or_else(|| doubled_area(hole).abs() >= doubled_area(shell).abs(), |within| !within)
}

/// Even-odd; none on the line itself. Exact.
pub fn inside(ring: &[Point], p: Point) -> Option<bool> {
    let mut within = false;
    let mut a = *ring.last()?;
    for &b in ring {
        if on_segment(a, b, p) {
            return None;
        }
        if (a[1] > p[1]) != (b[1] > p[1]) && (orient(a, b, p) > 0) == (b[1] > a[1]) {
            within = !within;
        }
        a = b;
    }
    Some(within)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mended(rings: &[&[Point]]) -> (Option<Vec<Vec<Point>>>, Repairs) {
        let mut repairs = Repairs::default();
        (polygon(rings.iter().map(|r| r.to_vec()), &mut repairs), repairs)
    }

    const SQUARE: [Point; 5] = [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]];

    #[test]
    fn clean_ones_stay() {
        let hole = [[2, 2], [2, 4], [4, 4], [2, 2]];
        let (out, repairs) = mended(&[&SQUARE, &hole]);
        assert_eq!(out.unwrap(), [SQUARE[..4].to_vec(), hole[..3].to_vec()]);
        assert!(!repairs.any());
    }

    #[test]
    fn turned_without_a_note() {
        let clockwise: Vec<Point> = SQUARE.iter().rev().copied().collect();
        let (out, repairs) = mended(&[&clockwise, &[[2, 2], [4, 4], [2, 4], [2, 2]]]);
        let out = out.unwrap();
        assert!(doubled_area(&out[0]) > 0 && doubled_area(&out[1]) < 0 && !repairs.any());
    }

    #[test]
    fn spikes_and_repeats() {
        let (out, r) = mended(&[&[[0, 0], [10, 0], [15, 0], [10, 0], [10, 10], [10, 10], [0, 10], [0, 0]]]);
        assert_eq!(out.unwrap(), [[[0, 0], [10, 0], [10, 10], [0, 10]]]);
        assert!(r.spikes && r.repeated);
        // A spike at the start, a spike on a spike.
        let (out, _) = mended(&[&[[-5, 0], [10, 0], [10, 10], [0, 10], [0, 0], [-5, 0]]]);
        assert_eq!(out.unwrap(), [[[10, 0], [10, 10], [0, 10], [0, 0]]]);
        let (out, _) = mended(&[&[[0, 0], [10, 0], [10, 5], [12, 5], [10, 5], [10, 0], [5, 9], [0, 0]]]);
        assert_eq!(out.unwrap(), [[[0, 0], [10, 0], [5, 9]]]);
        // A collinear vertex is no spike.
        let (out, r) = mended(&[&[[0, 0], [5, 0], [10, 0], [10, 10], [0, 0]]]);
        assert!(out.unwrap()[0].len() == 4 && !r.any());
    }

    #[test]
    fn what_is_no_area() {
        for ring in [&[][..], &[[1, 1]], &[[1, 1], [2, 2], [1, 1]], &[[0, 0], [1, 1], [2, 2], [0, 0]], &[[3, 3]; 5]] {
            assert_eq!(mended(&[ring]).0, None, "{ring:?}");
        }
        // A figure of eight has area 0 and three corners: it stays.
        assert!(mended(&[&[[0, 0], [10, 10], [10, 0], [0, 10], [0, 0]]]).0.is_some());
        let (out, r) = mended(&[&SQUARE, &[[1, 1], [2, 2], [1, 1]]]);
        assert!(out.unwrap().len() == 1 && r.flat_holes);
    }

    #[test]
    fn holes_outside() {
        let (out, r) = mended(&[&SQUARE, &[[20, 20], [20, 30], [30, 30], [20, 20]]]);
        assert!(out.unwrap().len() == 1 && r.holes_outside);
        let (out, r) = mended(&[&SQUARE, &SQUARE]);
        assert!(out.unwrap().len() == 1 && r.holes_outside);
        // Touching from inside is inside.
        let (out, r) = mended(&[&SQUARE, &[[0, 0], [5, 3], [3, 5], [0, 0]]]);
        assert!(out.unwrap().len() == 2 && !r.any());
    }

    #[test]
    fn open_rings() {
        let (out, r) = mended(&[&SQUARE[..4]]);
        assert!(out.is_some() && r.unclosed);
    }

    #[test]
    fn inside_a_comb() {
        let comb = [[0, 0], [8, 0], [8, 8], [6, 8], [6, 2], [4, 2], [4, 8], [2, 8], [2, 2], [0, 8]];
        for x in 0..9 {
            for y in 0..9 {
                // Brute force: a ray to the right, half a cell up (between the grid lines), in f64.
                let p = [x * 2 - 1, y * 2 - 1];
                let doubled: Vec<Point> = comb.iter().map(|c| [c[0] * 2, c[1] * 2]).collect();
                let mut odd = false;
                for (i, a) in doubled.iter().enumerate() {
                    let b = doubled[(i + 1) % doubled.len()];
                    let (a, b, q) = (a.map(f64::from), b.map(f64::from), p.map(f64::from));
                    if (a[1] > q[1]) != (b[1] > q[1]) && q[0] < a[0] + (q[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
                        odd = !odd;
                    }
                }
                if let Some(within) = inside(&doubled, p) {
                    assert_eq!(within, odd, "{p:?}");
                }
            }
        }
    }
}
