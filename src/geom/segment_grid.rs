//! Many segments in a grid: which of them does a segment meet?

use super::Point;
use super::bounds::Bounds;
use super::predicates::segments_meet;

/// Closed segments, each listed in every cell that it may pass.
pub struct SegmentGrid {
    pub all: Vec<[Point; 2]>,
    pub grid: Cells,
    /// Offsets of the cells in `listed`.
    starts: Vec<u32>,
    listed: Vec<u32>,
}

/// Square cells over a box.
pub struct Cells {
    low: Point,
    cell: i64,
    columns: i64,
    rows: i64,
}

impl SegmentGrid {
    /// Cells are about as large as a segment is long, but not many more than there are segments.
    pub fn new(all: Vec<[Point; 2]>) -> Self {
        let bounds = Bounds::of(all.iter().flatten().copied());
        let length = |s: &[Point; 2]| i64::from((s[0][0] - s[1][0]).abs().max((s[0][1] - s[1][1]).abs()));
        let mean = all.iter().map(length).sum::<i64>() / all.len().max(1) as i64;
        let grid = Cells::new(bounds, mean, 2 * all.len());
        let mut starts = vec![0u32; grid.cells() + 1];
        for s in &all {
            grid.each_cell(s[0], s[1], |cell| {
                starts[cell + 1] += 1;
                true
            });
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut listed = vec![0; starts[starts.len() - 1] as usize];
        for (s, i) in all.iter().zip(0..) {
            grid.each_cell(s[0], s[1], |cell| {
                listed[next[cell] as usize] = i;
                next[cell] += 1;
                true
            });
        }
        Self { all, grid, starts, listed }
    }

    /// The numbers of the segments in a cell, ascending.
    #[inline]
    pub fn in_cell(&self, cell: usize) -> &[u32] {
        &self.listed[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// True where the closed segment `a`-`b` shares a point with any of these.
    pub fn meet(&self, a: Point, b: Point) -> bool {
        let clear = |cell| {
            self.in_cell(cell).iter().all(|&i| {
                let [c, d] = self.all[i as usize];
                !segments_meet(a, b, c, d)
            })
        };
        !self.grid.each_cell(a, b, clear)
    }
}

impl Cells {
    /// Cells at least `cell` mm wide, and about `most` of them at the most.
    fn new(bounds: Bounds, cell: i64, most: usize) -> Self {
        let span = |k: usize| (i64::from(bounds.high[k]) - i64::from(bounds.low[k])).max(0) + 1;
        let (w, h) = (span(0), span(1));
        let fit = (w as f64 * h as f64 / most.max(1) as f64).sqrt() as i64;
        // A thin box would get a cell a millimetre.
        let cell = cell.max(fit).max(w.max(h) / most.max(1) as i64).max(1);
        let (columns, rows) = ((w - 1) / cell + 1, (h - 1) / cell + 1);
        let low = if bounds == Bounds::EMPTY { [0, 0] } else { bounds.low };
        Self { low, cell, columns, rows }
    }

    pub fn cells(&self) -> usize {
        (self.columns * self.rows) as usize
    }

    pub fn row(&self, y: i64) -> i64 {
        (y - i64::from(self.low[1])).div_euclid(self.cell)
    }

    pub fn column(&self, x: i64) -> i64 {
        (x - i64::from(self.low[0])).div_euclid(self.cell)
    }

    /// The lowest x of a column.
    pub fn left_of(&self, column: i64) -> i64 {
        i64::from(self.low[0]) + column * self.cell
    }

    /// The number of a cell; none outside.
    pub fn cell(&self, column: i64, row: i64) -> Option<usize> {
        let inside = (0..self.columns).contains(&column) && (0..self.rows).contains(&row);
        inside.then(|| (row * self.columns + column) as usize)
    }

    pub fn last_column(&self) -> i64 {
        self.columns - 1
    }

    /// Calls `see` for every cell that the segment may pass, each once, until it says false; then false.
    pub fn each_cell(&self, a: Point, b: Point, mut see: impl FnMut(usize) -> bool) -> bool {
        let (a, b) = if a[1] <= b[1] { (a, b) } else { (b, a) };
        let (ax, ay, bx, by) = (i64::from(a[0]), i64::from(a[1]), i64::from(b[0]), i64::from(b[1]));
        let (least, most) = (ax.min(bx), ax.max(bx));
        let slope = if by > ay { (bx - ax) as f64 / (by - ay) as f64 } else { 0.0 };
        for row in self.row(ay).max(0)..=self.row(by).min(self.rows - 1) {
            // Where it enters and leaves the row, a millimetre wider than rounding can be wrong.
            let bottom = (i64::from(self.low[1]) + row * self.cell).max(ay);
            let top = (i64::from(self.low[1]) + (row + 1) * self.cell).min(by);
            let (low, high) = if ay == by {
                (least, most)
            } else {
                let at = |y: i64| ax as f64 + (y - ay) as f64 * slope;
                let (p, q) = (at(bottom), at(top));
                (((p.min(q) - 1.0).floor() as i64).max(least), ((p.max(q) + 1.0).ceil() as i64).min(most))
            };
            for column in self.column(low).max(0)..=self.column(high).min(self.columns - 1) {
                if !see((row * self.columns + column) as usize) {
                    return false;
                }
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equals_asking_all() {
        let mut state = 7u64;
        let mut dice = |n: i32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (((state >> 33) * n as u64) >> 31) as i32
        };
        for (side, count) in [(20, 10), (1000, 60), (400_000_000, 30)] {
            let mut random = || [dice(side) - side / 2, dice(side) - side / 2];
            let all: Vec<[Point; 2]> = (0..count).map(|_| [random(), random()]).collect();
            let queries: Vec<[Point; 2]> = (0..500).map(|_| [random(), random()]).collect();
            let segments = SegmentGrid::new(all.clone());
            for [a, b] in queries {
                let near = [a[0] + (b[0] - a[0]) / 16, a[1] + (b[1] - a[1]) / 16];
                for q in [b, near, a] {
                    let any = all.iter().any(|s| segments_meet(a, q, s[0], s[1]));
                    assert_eq!(segments.meet(a, q), any, "{a:?} {q:?}");
                }
            }
        }
    }

    #[test]
    fn none_and_points() {
        assert!(!SegmentGrid::new(Vec::new()).meet([0, 0], [5, 5]));
        let dot = SegmentGrid::new(vec![[[3, 3], [3, 3]]]);
        assert!(dot.meet([0, 0], [5, 5]) && !dot.meet([0, 0], [5, 4]));
    }
}
