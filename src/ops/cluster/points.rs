//! Buildings as their centres.

use rayon::prelude::*;

use super::join::Sites;
use crate::artifact::Shapes;
use crate::geom::Point;
use crate::geom::bounds::Bounds;
use crate::geom::nearest::Tree;
use crate::geom::segment_grid::SegmentGrid;

/// Centres in the order of a tree's places.
pub struct Points<'a> {
    at: Vec<Point>,
    floor: f64,
    barriers: Option<&'a SegmentGrid>,
}

impl<'a> Points<'a> {
    /// The centres `which`, and their tree, which numbers them in that order.
    pub fn new(centres: &[Point], which: &[u32], floor: f64, barriers: Option<&'a SegmentGrid>) -> (Self, Tree) {
        let boxes: Vec<Bounds> = which.iter().map(|&i| Bounds::of([centres[i as usize]])).collect();
        let tree = Tree::new(&boxes);
        let at = tree.order.iter().map(|&i| boxes[i as usize].low).collect();
        (Self { at, floor, barriers }, tree)
    }
}

impl Sites for Points<'_> {
    type Probe = Point;
    const EXACT: bool = true;
    fn len(&self) -> usize {
        self.at.len()
    }
    fn bounds(&self, x: usize) -> Bounds {
        Bounds { low: self.at[x], high: self.at[x] }
    }
    #[inline]
    fn probe(&self, x: usize) -> Point {
        self.at[x]
    }
    #[inline]
    fn square_to_box(&self, probe: Point, bounds: &Bounds) -> f64 {
        bounds.square_to_point(probe)
    }
    #[inline]
    fn square_to(&self, [x, y]: Point, other: usize) -> f64 {
        let [u, v] = self.at[other];
        let (dx, dy) = (i64::from(x - u), i64::from(y - v));
        (dx * dx + dy * dy) as f64
    }
    #[inline]
    fn distance(&self, x: usize, y: usize, square: f64) -> Option<f64> {
        let blocked = self.barriers.is_some_and(|b| b.meet(self.at[x], self.at[y]));
        (!blocked).then(|| square.sqrt().max(self.floor))
    }
    #[inline]
    fn same(&self, x: usize, y: usize) -> bool {
        self.at[x] == self.at[y]
    }
    fn floor(&self) -> f64 {
        self.floor
    }
}

/// The centre of each building: the area centroid of its shells; the mean of their vertices where the area is 0, or
/// where shells that cross themselves throw the centroid out of their own bounds (a bow tie of nearly no area: half a
/// thousand kilometres, seen). Exact, then rounded to the millimetre grid, halves up.
pub fn centres(polygons: &Shapes<Point>) -> Vec<Point> {
    (0..polygons.len()).into_par_iter().with_min_len(1024).map(|i| centre(polygons.shells(i))).collect()
}

fn centre<'a>(shells: impl Iterator<Item = &'a [Point]>) -> Point {
    // Relative to the first point, so that the numbers stay small; whole millimetres do not touch the rounding.
    let mut origin = None;
    let (mut weight, mut area) = ([0i128; 2], 0i128);
    let (mut sum, mut count) = ([0i128; 2], 0i128);
    let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
    for ring in shells.filter(|ring| !ring.is_empty()) {
        let o: Point = *origin.get_or_insert(ring[0]);
        let local = |p: Point| [i64::from(p[0]) - i64::from(o[0]), i64::from(p[1]) - i64::from(o[1])];
        let mut p = local(ring[ring.len() - 1]);
        for &q in ring {
            let q = local(q);
            let turn = i128::from(p[0]) * i128::from(q[1]) - i128::from(q[0]) * i128::from(p[1]);
            area += turn;
            for k in 0..2 {
                weight[k] += turn * i128::from(p[k] + q[k]);
                sum[k] += i128::from(q[k]);
                (low[k], high[k]) = (low[k].min(q[k]), high[k].max(q[k]));
            }
            count += 1;
            p = q;
        }
    }
    let Some(origin) = origin else { return [0, 0] };
    let mean = [0, 1].map(|k| round_half_up(sum[k], count));
    let offset = match area {
        0 => mean,
        _ => [0, 1].map(|k| round_half_up(weight[k], 3 * area)),
    };
    let within = (0..2).all(|k| (i128::from(low[k])..=i128::from(high[k])).contains(&offset[k]));
    let offset = if within { offset } else { mean };
    [0, 1].map(|k| origin[k] + offset[k] as i32)
}

/// `a / b` to the nearest whole number, halves up.
fn round_half_up(a: i128, b: i128) -> i128 {
    let (a, b) = if b < 0 { (-a, -b) } else { (a, b) };
    (2 * a + b).div_euclid(2 * b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(ring: &[Point]) -> Point {
        centre([ring].into_iter())
    }

    #[test]
    fn centres_of_area() {
        assert_eq!(of(&[[0, 0], [10, 0], [10, 4], [0, 4]]), [5, 2]);
        // An L: 3 squares of side 10.
        assert_eq!(of(&[[0, 0], [20, 0], [20, 10], [10, 10], [10, 20], [0, 20]]), [8, 8]);
        // Halves go up, on either side of zero.
        assert_eq!(of(&[[0, 0], [1, 0], [1, 3], [0, 3]]), [1, 2]);
        assert_eq!(of(&[[-1, -3], [0, -3], [0, 0], [-1, 0]]), [0, -1]);
        // Two equal parts.
        let parts: [&[Point]; 2] = [&[[0, 0], [2, 0], [2, 2], [0, 2]], &[[10, 0], [12, 0], [12, 2], [10, 2]]];
        assert_eq!(centre(parts.into_iter()), [6, 1]);
    }

    #[test]
    fn a_bow_tie_keeps_its_centre() {
        // Its halves take each other's area away, all but a little.
        assert_eq!(of(&[[0, 0], [12_000, 9_001], [12_000, 0], [0, 9_000]]), [6_000, 4_500]);
    }

    #[test]
    fn without_area_the_mean_of_the_vertices() {
        assert_eq!(of(&[[0, 0], [1, 0], [8, 0]]), [3, 0]);
        assert_eq!(of(&[[7, 7]]), [7, 7]);
        let l = crate::geom::LIMIT_MM - 1;
        assert_eq!(of(&[[-l, -l], [l, -l], [l, l], [-l, l]]), [0, 0]);
    }
}
