//! The vertices of a ring by cells: does one lie in a triangle?

use super::Point;
use super::predicates::orient;
use super::segments::Rect;

/// No vertex: the `next` of one that is gone.
pub const NONE: u32 = u32::MAX;

/// True where `p` lies in the closed clockwise triangle a, v, b.
#[inline]
pub fn blocks(a: Point, v: Point, b: Point, p: Point) -> bool {
    orient(a, b, p) >= 0 && orient(b, v, p) >= 0 && orient(v, a, p) >= 0
}

/// Vertices by square cells, about two to a cell.
#[derive(Default)]
pub struct Grid {
    low: Point,
    /// A coordinate's cell is its distance to `low`, shifted.
    shift: u32,
    columns: usize,
    rows: usize,
    starts: Vec<u32>,
    held: Vec<(Point, u32)>,
}

impl Grid {
    /// Holds the `count` vertices that are live.
    pub fn build(&mut self, at: &[Point], live: impl Iterator<Item = u32> + Clone, count: usize) {
        let rect = Rect::of(live.clone().map(|i| at[i as usize]));
        let extent = [0, 1].map(|k| (i64::from(rect.high[k]) - i64::from(rect.low[k])) as u64);
        self.low = rect.low;
        self.shift = 0;
        while ((extent[0] >> self.shift) + 1) * ((extent[1] >> self.shift) + 1) > count as u64 {
            self.shift += 1;
        }
        self.columns = (extent[0] >> self.shift) as usize + 1;
        self.rows = (extent[1] >> self.shift) as usize + 1;
        self.starts.clear();
        self.starts.resize(self.columns * self.rows + 1, 0);
        for i in live.clone() {
            let [x, y] = self.cell(at[i as usize]);
            self.starts[y * self.columns + x + 1] += 1;
        }
        for c in 1..self.starts.len() {
            self.starts[c] += self.starts[c - 1];
        }
        self.held.clear();
        self.held.resize(count, ([0, 0], 0));
        for i in live {
            let [x, y] = self.cell(at[i as usize]);
            let slot = &mut self.starts[y * self.columns + x];
            self.held[*slot as usize] = (at[i as usize], i);
            *slot += 1;
        }
        // The offsets have moved on by one cell each.
        self.starts.rotate_right(1);
        self.starts[0] = 0;
    }

    #[inline]
    fn cell(&self, p: Point) -> [usize; 2] {
        [0, 1].map(|k| ((i64::from(p[k]) - i64::from(self.low[k])) >> self.shift) as usize)
    }

    /// Some vertex in the closed triangle a, v, b that is still live (its `next` is not [`NONE`]), but its own corners.
    #[inline]
    pub fn blocker(&self, a: Point, v: Point, b: Point, corners: [u32; 3], next: &[u32]) -> Option<u32> {
        let low = [0, 1].map(|k| a[k].min(v[k]).min(b[k]));
        let high = [0, 1].map(|k| a[k].max(v[k]).max(b[k]));
        let ([x0, y0], [x1, y1]) = (self.cell(low), self.cell(high));
        for y in y0..=y1 {
            let row = y * self.columns;
            let held = &self.held[self.starts[row + x0] as usize..self.starts[row + x1 + 1] as usize];
            for &(p, i) in held {
                let within = low[0] <= p[0] && p[0] <= high[0] && low[1] <= p[1] && p[1] <= high[1];
                if within && next[i as usize] != NONE && !corners.contains(&i) && blocks(a, v, b, p) {
                    return Some(i);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_by_looking_at_all() {
        let at: Vec<Point> = (0..200).map(|i| [i * 7919 % 101, i * 104_729 % 97]).collect();
        let mut next = vec![0; at.len()];
        next.iter_mut().step_by(3).for_each(|n| *n = NONE);
        let live = |i: u32| next[i as usize] != NONE;
        let mut grid = Grid::default();
        grid.build(&at, 0..at.len() as u32, at.len());
        let mut found = 0;
        for k in 0..150u32 {
            let corners = [k, k + 17, k + 43];
            let [a, v, b] = corners.map(|i| at[i as usize]);
            let inside = |i: &u32| live(*i) && !corners.contains(i) && blocks(a, v, b, at[*i as usize]);
            let sure = (0..at.len() as u32).any(|i| inside(&i));
            let got = grid.blocker(a, v, b, corners, &next);
            assert_eq!(got.is_some(), sure, "triangle {k}");
            assert!(got.is_none_or(|i| inside(&i)), "triangle {k}");
            found += usize::from(sure);
        }
        assert!(found > 20 && found < 150, "{found}");
    }
}
