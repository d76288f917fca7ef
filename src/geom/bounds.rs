//! Boxes of points: joined, apart, and how large a thin one can look.

use super::Point;

/// An axis-aligned box, both corners inside; empty where `low` is above `high`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    pub low: Point,
    pub high: Point,
}

impl Bounds {
    pub const EMPTY: Self = Self { low: [i32::MAX; 2], high: [i32::MIN; 2] };

    pub fn of(points: impl IntoIterator<Item = Point>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| b.with(p))
    }

    pub fn with(self, p: Point) -> Self {
        Self {
            low: [self.low[0].min(p[0]), self.low[1].min(p[1])],
            high: [self.high[0].max(p[0]), self.high[1].max(p[1])],
        }
    }

    pub fn join(&self, other: &Self) -> Self {
        Self {
            low: [self.low[0].min(other.low[0]), self.low[1].min(other.low[1])],
            high: [self.high[0].max(other.high[0]), self.high[1].max(other.high[1])],
        }
    }

    pub fn is_empty(&self) -> bool {
        self.low[0] > self.high[0]
    }

    pub fn contains(&self, p: Point) -> bool {
        (0..2).all(|k| self.low[k] <= p[k] && p[k] <= self.high[k])
    }

    /// Width and depth, metres.
    pub fn sides(&self) -> [f64; 2] {
        if self.is_empty() {
            return [0.0; 2];
        }
        [0, 1].map(|k| (i64::from(self.high[k]) - i64::from(self.low[k])) as f64 / 1000.0)
    }

    /// Squared distance to a point: exact in `i64`, then rounded once.
    #[inline]
    pub fn square_to_point(&self, p: Point) -> f64 {
        self.square_to(&Self { low: p, high: p })
    }

    /// Squared distance to another box, 0 where they meet: exact in `i64`, then rounded once.
    #[inline]
    pub fn square_to(&self, other: &Self) -> f64 {
        let gap = |k: usize| i64::from((self.low[k] - other.high[k]).max(other.low[k] - self.high[k]).max(0));
        let (dx, dy) = (gap(0), gap(1));
        (dx * dx + dy * dy) as f64
    }
}

/// The side of the square that a negative space fills on the screen at most, metres: sqrt(S), where
/// S = sqrt((ab)^2 + (bh)^2 + (ha)^2) is what a box shows from its worst direction, h is `height`, and a, b have
/// the area of the negative space (m2) and the ratio of the ring's box (`sides`).
/// Source: Legible cities, section 8; S by Cauchy-Schwarz over directions.
pub fn shown_error(negative_space: f64, sides: [f64; 2], height: f64) -> f64 {
    if negative_space <= 0.0 || sides[0] <= 0.0 || sides[1] <= 0.0 {
        return 0.0;
    }
    // The same to the bit for a box that is turned by 90 degrees.
    let ratio = sides[0].max(sides[1]) / sides[0].min(sides[1]);
    let (a, b) = ((negative_space * ratio).sqrt(), (negative_space / ratio).sqrt());
    let (ab, bh, ha) = (negative_space, b * height, height * a);
    (ab * ab + bh * bh + ha * ha).sqrt().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes() {
        let b = Bounds::of([[0, 5], [3000, -1], [10, 999]]);
        assert_eq!(b.sides(), [3.0, 1.0]);
        assert!(b.contains([3000, 999]) && !b.contains([3001, 0]));
        assert_eq!(Bounds::of([]).sides(), [0.0, 0.0]);
    }

    #[test]
    fn distances_between_boxes() {
        let unit = Bounds::of([[0, 0], [1, 1]]);
        assert_eq!(unit.square_to(&Bounds::of([[4, 5], [9, 9]])), 25.0);
        assert_eq!(unit.square_to(&Bounds::of([[1, 1]])), 0.0);
        assert_eq!(unit.square_to_point([-3, 0]), 9.0);
        let l = crate::geom::LIMIT_MM;
        let far = Bounds::of([[l, l]]).square_to_point([-l, -l]);
        assert_eq!(far, 2.0 * (2.0 * f64::from(l)) * (2.0 * f64::from(l)));
    }

    #[test]
    fn what_a_box_shows() {
        // A flat one shows its top, a cube sqrt(3) of a face.
        assert_eq!(shown_error(100.0, [7.0, 7.0], 0.0), 10.0);
        assert!((shown_error(9.0, [50.0, 50.0], 3.0) - (9.0 * 3f64.sqrt()).sqrt()).abs() < 1e-12);
        assert_eq!(shown_error(0.0, [7.0, 7.0], 9.0), 0.0);
        assert!(shown_error(10.0, [100.0, 1.0], 9.0) > shown_error(10.0, [10.0, 10.0], 9.0));
    }
}
