//! The error of what is drawn, measured in metres.

use super::city::City;
use crate::geom::bounds::{Bounds, shown_error};

/// Share of a drawn area's negative space, and of a height difference times width, that is seen at the angle from
/// which cities are looked at: its sine and cosine. Doubling either costs 5 % at most (LEGIBILITY).
pub const SEEN_FLAT: f64 = 0.6;
pub const SEEN_TALL: f64 = 0.8;

/// e0 of a block: the negative-space box's side on the screen at most.
pub fn e0(negative_space: f64, bounds: Bounds, height: f64) -> f64 {
    shown_error(negative_space, bounds.sides(), height)
}

/// The height above which a node's members are its landmarks.
pub fn limit(city: &City, x: u32, e0: f64) -> f64 {
    city.height(x) + city.skyline * e0
}

/// Height difference between a node's block and a member: heights above the own ground, or roofs, whichever differ
/// more (on slopes they are not the same).
pub fn off(city: &City, x: u32, place: usize) -> f64 {
    let (height, roof) = (city.height(x), city.ground(x) + city.height(x));
    (city.marks.height[place] - height).abs().max((city.roof[place] - roof).abs())
}

/// Error of a node's ring, and its triangles together with its landmarks' as they are. Of a leaf: of the original.
pub fn of_ring(city: &City, x: u32) -> (f64, u64) {
    if city.is_leaf(x) {
        return (0.0, city.triangles[x as usize]);
    }
    let cluster = city.cluster[x as usize] as usize;
    if city.hulls.ring(cluster).len() < 3 {
        // Nothing would stand over its members: never drawn.
        return (f64::INFINITY, 0);
    }
    let ring = Bounds::of(city.hulls.points(cluster));
    let e0 = e0(city.negative_space(x), ring, city.height(x));
    let limit = limit(city, x, e0);
    let (mut error, mut triangles) = (e0, u64::from(super::forms::prism(city.hulls.ring(cluster).len())));
    for place in city.places(x) {
        if city.marks.height[place] > limit {
            triangles += u64::from(city.originals.triangles[place]);
        } else {
            error = error.max(off(city, x, place));
        }
    }
    (error, triangles)
}
