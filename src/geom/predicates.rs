//! Exact signs over the millimetre grid.

use super::Point;

/// Twice the signed area of the triangle a, b, c: positive where they turn left. Exact.
#[inline]
pub fn orient(a: Point, b: Point, c: Point) -> i64 {
    let d = |p: Point, k: usize| i64::from(p[k]) - i64::from(a[k]);
    d(b, 0) * d(c, 1) - d(b, 1) * d(c, 0)
}

/// True where `p` lies on the closed segment `a`-`b`.
#[inline]
pub fn on_segment(a: Point, b: Point, p: Point) -> bool {
    orient(a, b, p) == 0
        && p[0] >= a[0].min(b[0])
        && p[0] <= a[0].max(b[0])
        && p[1] >= a[1].min(b[1])
        && p[1] <= a[1].max(b[1])
}

/// True where the closed segments share a point.
pub fn segments_meet(a: Point, b: Point, c: Point, d: Point) -> bool {
    let apart = |k: usize| a[k].max(b[k]) < c[k].min(d[k]) || c[k].max(d[k]) < a[k].min(b[k]);
    if apart(0) || apart(1) {
        return false;
    }
    let (o1, o2) = (orient(a, b, c).signum(), orient(a, b, d).signum());
    let (o3, o4) = (orient(c, d, a).signum(), orient(c, d, b).signum());
    // The boxes meet, so collinear segments need no further test than zero signs.
    o1 * o2 <= 0 && o3 * o4 <= 0
}

/// True where the open segments cross in one point that is an end of neither.
pub fn segments_cross(a: Point, b: Point, c: Point, d: Point) -> bool {
    let (o1, o2) = (orient(a, b, c).signum(), orient(a, b, d).signum());
    o1 * o2 < 0 && orient(c, d, a).signum() * orient(c, d, b).signum() < 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_at_the_limit() {
        let l = super::super::LIMIT_MM;
        assert_eq!(orient([-l, -l], [l, -l], [l, l]), 4 * i64::from(l) * i64::from(l));
        assert_eq!(orient([0, 0], [2, 2], [1, 1]), 0);
    }

    #[test]
    fn segments() {
        assert!(segments_meet([0, 0], [2, 2], [0, 2], [2, 0]));
        assert!(segments_meet([0, 0], [2, 0], [2, 0], [3, 5]));
        assert!(segments_meet([0, 0], [4, 0], [1, 0], [2, 0]));
        assert!(!segments_meet([0, 0], [1, 0], [2, 0], [3, 0]));
        assert!(!segments_meet([0, 0], [4, 4], [1, 0], [4, 3]));
    }
}
