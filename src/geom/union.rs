//! Union of polygons on the millimetre grid.

use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay::Overlay;
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::i_float::int::point::IntPoint;

use super::Point;

/// What any of the polygons covers, as polygons without overlap: rings with the shell first, shells counter-clockwise,
/// holes clockwise, in the order of their lowest points. Where edges cross between grid points, the crossing moves to
/// the nearest one. Inputs are rings of the same orientation. Cost: near O(n log n).
pub fn union(polygons: &[Vec<Vec<Point>>]) -> Vec<Vec<Vec<Point>>> {
    let contours: Vec<Vec<IntPoint<i32>>> =
        polygons.iter().flatten().map(|ring| ring.iter().map(|p| IntPoint::new(p[0], p[1])).collect()).collect();
    let shapes = Overlay::from_subj(&contours).overlay(OverlayRule::Subject, FillRule::NonZero);
    let mut out: Vec<Vec<Vec<Point>>> = shapes
        .into_iter()
        .map(|rings| rings.into_iter().map(|ring| ring.into_iter().map(|p| [p.x, p.y]).collect()).collect())
        .collect();
    out.sort_by_key(|rings| rings[0].iter().min().copied());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::ring::doubled_area;

    fn square(x: i32, y: i32, side: i32) -> Vec<Point> {
        vec![[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
    }

    #[test]
    fn overlapping_touching_apart() {
        let all = [vec![square(5, 5, 10)], vec![square(0, 0, 10)], vec![square(15, 5, 5)], vec![square(100, 0, 10)]];
        let out = union(&all);
        assert_eq!(out.len(), 2);
        let area: i64 = out.iter().flatten().map(|r| doubled_area(r)).sum();
        assert_eq!(area, 2 * (100 + 100 - 25 + 25 + 100));
        assert!(out.iter().all(|rings| doubled_area(&rings[0]) > 0));
    }

    #[test]
    fn a_ring_of_four_has_a_courtyard() {
        let bar = |x, y, w, h| vec![vec![[x, y], [x + w, y], [x + w, y + h], [x, y + h]]];
        let out = union(&[bar(0, 0, 30, 10), bar(0, 20, 30, 10), bar(0, 0, 10, 30), bar(20, 0, 10, 30)]);
        assert_eq!((out.len(), out[0].len()), (1, 2));
        assert_eq!(doubled_area(&out[0][1]), -200);
    }
}
