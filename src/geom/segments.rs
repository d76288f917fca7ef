//! Pairs of segments that may meet, among many: the plane is halved until few are left.

use super::Point;
use super::predicates::{on_segment, segments_meet};

/// A closed segment.
pub type Segment = [Point; 2];

/// Smallest and largest coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    pub low: Point,
    pub high: Point,
}

impl Rect {
    pub const EMPTY: Rect = Rect { low: [i32::MAX; 2], high: [i32::MIN; 2] };

    pub fn of(points: impl IntoIterator<Item = Point>) -> Self {
        points.into_iter().fold(Self::EMPTY, |mut r, p| {
            r.add(p);
            r
        })
    }
    #[inline]
    pub fn add(&mut self, p: Point) {
        self.low = [self.low[0].min(p[0]), self.low[1].min(p[1])];
        self.high = [self.high[0].max(p[0]), self.high[1].max(p[1])];
    }
    /// True where the closed rectangles share a point.
    #[inline]
    pub fn meets(&self, other: &Rect) -> bool {
        self.low[0] <= other.high[0]
            && other.low[0] <= self.high[0]
            && self.low[1] <= other.high[1]
            && other.low[1] <= self.high[1]
    }
    /// As `meets` with the rectangle of the segment.
    #[inline]
    pub fn meets_segment(&self, a: Point, b: Point) -> bool {
        a[0].min(b[0]) <= self.high[0]
            && a[0].max(b[0]) >= self.low[0]
            && a[1].min(b[1]) <= self.high[1]
            && a[1].max(b[1]) >= self.low[1]
    }
    #[inline]
    pub fn holds(&self, p: Point) -> bool {
        self.low[0] <= p[0] && p[0] <= self.high[0] && self.low[1] <= p[1] && p[1] <= self.high[1]
    }
    pub fn contains(&self, other: &Rect) -> bool {
        self.holds(other.low) && self.holds(other.high)
    }
    pub fn intersection(&self, other: &Rect) -> Rect {
        let pick = |k: usize| (self.low[k].max(other.low[k]), self.high[k].min(other.high[k]));
        let ((x0, x1), (y0, y1)) = (pick(0), pick(1));
        Rect { low: [x0, y0], high: [x1, y1] }
    }
}

/// Visits pairs (i, j) whose rectangles meet; a pair may come more than once. Stops when `visit` gives true, and
/// says whether it did. Near O((n + m) log (n + m) + pairs) for segments that are short beside the whole.
pub fn near_pairs(a: &[Segment], b: &[Segment], mut visit: impl FnMut(u32, u32) -> bool) -> bool {
    if a.len() * b.len() <= BRUTE {
        return brute(a, b, 0..a.len() as u32, 0..b.len() as u32, &mut visit);
    }
    halve(a, b, (0..a.len() as u32).collect(), (0..b.len() as u32).collect(), 48, &mut visit)
}

const BRUTE: usize = 1024;

fn brute(
    a: &[Segment],
    b: &[Segment],
    ia: impl Iterator<Item = u32>,
    ib: impl Iterator<Item = u32> + Clone,
    visit: &mut impl FnMut(u32, u32) -> bool,
) -> bool {
    for i in ia {
        let rect = Rect::of(a[i as usize]);
        for j in ib.clone() {
            let [p, q] = b[j as usize];
            if rect.meets_segment(p, q) && visit(i, j) {
                return true;
            }
        }
    }
    false
}

fn halve(
    a: &[Segment],
    b: &[Segment],
    mut ia: Vec<u32>,
    mut ib: Vec<u32>,
    depth: u32,
    visit: &mut impl FnMut(u32, u32) -> bool,
) -> bool {
    let rect = |s: &[Segment], of: &[u32]| Rect::of(of.iter().flat_map(|&i| s[i as usize]));
    let both = rect(a, &ia).intersection(&rect(b, &ib));
    ia.retain(|&i| both.meets_segment(a[i as usize][0], a[i as usize][1]));
    ib.retain(|&j| both.meets_segment(b[j as usize][0], b[j as usize][1]));
    if ia.len() * ib.len() <= BRUTE || depth == 0 {
        return brute(a, b, ia.iter().copied(), ib.iter().copied(), visit);
    }
    let extent = |k: usize| i64::from(both.high[k]) - i64::from(both.low[k]);
    let axis = usize::from(extent(1) > extent(0));
    let middle = (i64::from(both.low[axis]) + i64::from(both.high[axis])).div_euclid(2) as i32;
    let part = |s: &[Segment], of: &[u32], low: bool| -> Vec<u32> {
        let inside = |i: &u32| {
            let [p, q] = s[*i as usize];
            if low { p[axis].min(q[axis]) <= middle } else { p[axis].max(q[axis]) > middle }
        };
        of.iter().copied().filter(inside).collect()
    };
    let (la, lb) = (part(a, &ia, true), part(b, &ib, true));
    let (ra, rb) = (part(a, &ia, false), part(b, &ib, false));
    // Long segments that lie across everything: halving no longer helps.
    if la.len() * lb.len() + ra.len() * rb.len() >= ia.len() * ib.len() {
        return brute(a, b, ia.iter().copied(), ib.iter().copied(), visit);
    }
    drop((ia, ib));
    halve(a, b, la, lb, depth - 1, visit) || halve(a, b, ra, rb, depth - 1, visit)
}

/// The edges of a ring, edge i from point i to the next.
pub fn edges(ring: &[Point]) -> impl ExactSizeIterator<Item = Segment> + Clone {
    (0..ring.len()).map(|i| [ring[i], ring[if i + 1 == ring.len() { 0 } else { i + 1 }]])
}

/// True where edges meet in nothing but the vertices that neighbours share. At least three points.
pub fn is_simple(ring: &[Point]) -> bool {
    let n = ring.len();
    let clash = |i: usize, j: usize, [a, b]: Segment, [c, d]: Segment| {
        if j == i + 1 {
            a == b || c == d || on_segment(a, b, d) || on_segment(c, d, a)
        } else if i == 0 && j == n - 1 {
            a == b || c == d || on_segment(a, b, c) || on_segment(c, d, b)
        } else {
            segments_meet(a, b, c, d)
        }
    };
    if n * n <= BRUTE {
        let edge = |i: usize| [ring[i], ring[if i + 1 == n { 0 } else { i + 1 }]];
        let alone = |i: usize| {
            let mine = edge(i);
            let rect = Rect::of(mine);
            (i + 1..n).all(|j| {
                let other = edge(j);
                !rect.meets_segment(other[0], other[1]) || !clash(i, j, mine, other)
            })
        };
        return n >= 3 && (0..n).all(alone);
    }
    let all: Vec<Segment> = edges(ring).collect();
    !near_pairs(&all, &all, |i, j| i < j && clash(i as usize, j as usize, all[i as usize], all[j as usize]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simple_and_not() {
        assert!(is_simple(&[[0, 0], [4, 0], [0, 4]]));
        assert!(!is_simple(&[[0, 0], [4, 0], [2, 0]]));
        assert!(!is_simple(&[[0, 0], [4, 4], [4, 0], [0, 4]]));
        // Touching itself in a vertex, and along an edge.
        assert!(!is_simple(&[[0, 0], [4, 0], [2, 2], [4, 4], [0, 4], [2, 2]]));
        assert!(!is_simple(&[[0, 0], [9, 0], [9, 5], [5, 5], [5, 0], [3, 0], [3, 5], [0, 5]]));
        assert!(is_simple(&[[0, 0], [2, 0], [4, 0], [4, 4]]));
    }

    #[test]
    fn pairs_as_by_brute_force() {
        let mut seed = 7u64;
        let mut next = |n: u64| {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((seed >> 33) % n) as i32
        };
        let mut some = |n: usize| -> Vec<Segment> {
            let mut one = || {
                let p = [next(1000), next(1000)];
                [p, [p[0] + next(40) - 20, p[1] + next(40) - 20]]
            };
            (0..n).map(|_| one()).collect()
        };
        let (a, b) = (some(300), some(200));
        let mut got = Vec::new();
        near_pairs(&a, &b, |i, j| {
            got.push((i, j));
            false
        });
        got.sort_unstable();
        got.dedup();
        let all = (0..300u32).flat_map(|i| (0..200u32).map(move |j| (i, j)));
        let want: Vec<_> = all.filter(|&(i, j)| Rect::of(a[i as usize]).meets(&Rect::of(b[j as usize]))).collect();
        assert_eq!(got, want);
    }
}
