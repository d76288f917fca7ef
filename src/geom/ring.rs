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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas() {
        assert_eq!(area_m2(&[[0, 0], [2000, 0], [2000, 1000], [0, 1000]]), 2.0);
        assert_eq!(area_m2(&[[0, 0], [0, 1000], [2000, 1000], [2000, 0]]), -2.0);
        assert_eq!(doubled_area(&[]), 0);
    }
}
