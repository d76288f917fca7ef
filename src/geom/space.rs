//! Vectors in space, as the artifacts keep them: three numbers.

use glam::DVec3;

pub type Vec3 = [f64; 3];

#[inline(always)]
pub fn sub(a: Vec3, b: Vec3) -> Vec3 {
    (DVec3::from_array(a) - DVec3::from_array(b)).to_array()
}

#[inline(always)]
pub fn dot(a: Vec3, b: Vec3) -> f64 {
    DVec3::from_array(a).dot(DVec3::from_array(b))
}

#[inline(always)]
pub fn cross(a: Vec3, b: Vec3) -> Vec3 {
    DVec3::from_array(a).cross(DVec3::from_array(b)).to_array()
}

/// Of length one; 0, 0, 0 where it has no direction.
pub fn unit(v: Vec3) -> Vec3 {
    let length = DVec3::from_array(v).length();
    if length.is_normal() { v.map(|c| c / length) } else { [0.0; 3] }
}

/// Across a triangle, on the side from which its corners turn left; as long as twice its area.
pub fn doubled_area([a, b, c]: [Vec3; 3]) -> Vec3 {
    cross(sub(b, a), sub(c, a))
}

/// Least and greatest coordinates; infinite, least above greatest, where there are no points.
pub fn bounds(points: impl IntoIterator<Item = Vec3>) -> (Vec3, Vec3) {
    points.into_iter().fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(l, h), p| {
        ([0, 1, 2].map(|k| l[k].min(p[k])), [0, 1, 2].map(|k| h[k].max(p[k])))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle() {
        let t = [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 2.0, 0.0]];
        assert_eq!(doubled_area(t), [0.0, 0.0, 4.0]);
        assert_eq!(unit(doubled_area(t)), [0.0, 0.0, 1.0]);
        assert_eq!((unit([0.0; 3]), unit([f64::NAN, 0.0, 0.0])), ([0.0; 3], [0.0; 3]));
        assert_eq!(bounds(t), ([1.0, 0.0, 0.0], [3.0, 2.0, 0.0]));
        assert_eq!(dot(sub(t[1], t[0]), t[1]), 6.0);
    }
}
