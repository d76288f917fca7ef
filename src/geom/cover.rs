//! Is a point covered? For many points and the same rings.

use super::Point;
use super::bounds::Bounds;
use super::predicates::orient;

/// The edges of some rings, sorted into rows by y. Asking looks at one row: O(edges that cross it).
pub struct Cover {
    pub bounds: Bounds,
    /// A point's row is its height above the lowest, shifted.
    shift: u32,
    /// rows + 1 offsets into `edges`.
    starts: Vec<u32>,
    edges: Vec<[Point; 2]>,
}

impl Cover {
    /// The region inside an odd number of the rings, borders included.
    pub fn new<'a>(rings: impl Iterator<Item = &'a [Point]> + Clone) -> Self {
        let bounds = Bounds::of(rings.clone().flatten().copied());
        let count: usize = rings.clone().map(<[Point]>::len).sum();
        let mut out = Self { bounds, shift: 0, starts: Vec::new(), edges: Vec::new() };
        if bounds.is_empty() {
            return out;
        }
        let extent = (i64::from(bounds.high[1]) - i64::from(bounds.low[1])) as u64;
        while (extent >> out.shift) + 1 > (count as u64 / 2).clamp(1, 4096) {
            out.shift += 1;
        }
        let rows = (extent >> out.shift) as usize + 1;
        let edges = || {
            rings
                .clone()
                .flat_map(|r| r.iter().enumerate().map(move |(i, &a)| [a, r[if i + 1 == r.len() { 0 } else { i + 1 }]]))
        };
        let span = |out: &Self, [a, b]: [Point; 2]| out.row(a[1].min(b[1]))..=out.row(a[1].max(b[1]));
        let mut starts = vec![0u32; rows + 1];
        edges().for_each(|e| span(&out, e).for_each(|row| starts[row + 1] += 1));
        (0..rows).for_each(|row| starts[row + 1] += starts[row]);
        out.edges = vec![[[0; 2]; 2]; starts[rows] as usize];
        let mut next = starts.clone();
        for e in edges() {
            for row in span(&out, e) {
                out.edges[next[row] as usize] = e;
                next[row] += 1;
            }
        }
        out.starts = starts;
        out
    }

    fn row(&self, y: i32) -> usize {
        ((i64::from(y) - i64::from(self.bounds.low[1])) >> self.shift) as usize
    }

    pub fn holds(&self, p: Point) -> bool {
        if !self.bounds.contains(p) {
            return false;
        }
        let row = self.row(p[1]);
        let mut odd = false;
        for &[a, b] in &self.edges[self.starts[row] as usize..self.starts[row + 1] as usize] {
            let (low, high) = if a[1] < b[1] { (a[1], b[1]) } else { (b[1], a[1]) };
            if p[1] < low || high < p[1] || (a[0] < p[0] && b[0] < p[0]) {
                continue;
            }
            let turn = orient(a, b, p);
            if turn == 0 && a[0].min(b[0]) <= p[0] {
                return true;
            }
            // Left of an edge that goes up, right of one that goes down: the edge is to the right of the point.
            odd ^= high > p[1] && (turn > 0) == (b[1] > a[1]);
        }
        odd
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_with_a_court() {
        let shell: &[Point] = &[[0, 0], [10, 0], [10, 10], [5, 4], [0, 10]];
        let court: &[Point] = &[[4, 1], [4, 2], [6, 2], [6, 1]];
        let cover = Cover::new([shell, court].into_iter());
        let expected = |p: Point| match p {
            [x, y] if !(0..=10).contains(&x) || !(0..=10).contains(&y) => false,
            [5, y] if y > 1 && y < 2 => false,
            [x, y] if x <= 5 => y * 5 <= 50 - 6 * x,
            [x, y] => y * 5 <= 6 * x - 10,
        };
        for x in -1..12 {
            for y in -1..12 {
                assert_eq!(cover.holds([x, y]), expected([x, y]), "{x} {y}");
            }
        }
        assert!(!Cover::new([&[][..]].into_iter()).holds([0, 0]));
    }

    #[test]
    fn many_rows() {
        let comb: Vec<Point> = (0..100)
            .flat_map(|i| {
                [[if i % 2 == 0 { 100 } else { 50 }, i * 10], [if i % 2 == 0 { 100 } else { 50 }, i * 10 + 9]]
            })
            .chain([[0, 999], [0, 0]])
            .collect();
        let cover = Cover::new([&comb[..]].into_iter());
        for i in 0..100 {
            assert_eq!(cover.holds([75, i * 10 + 5]), i % 2 == 0);
            assert!(cover.holds([25, i * 10 + 5]));
        }
    }
}
