//! The error of what is drawn, measured in metres.

use std::ops::Range;

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

/// Largest height difference between a node's block and its members not taller than `limit`: of heights above the own
/// ground, or of roofs, whichever differ more (on slopes they are not the same). Shows the others, in order.
pub fn of_heights(city: &City, x: u32, limit: f64, mut landmark: impl FnMut(usize)) -> f64 {
    let (height, roof) = (city.height(x), city.ground(x) + city.height(x));
    let off = |[low, high]: [f64; 2], own: f64| (low - own).abs().max((high - own).abs());
    let mut worst = 0.0f64;
    let places = city.places(x);
    if places.len() <= FEW {
        // Looking at all is faster.
        for place in places {
            let own = city.marks.height[place];
            if own > limit {
                landmark(place);
            } else {
                worst = worst.max((own - height).abs()).max((city.roof[place] - roof).abs());
            }
        }
        return worst;
    }
    let mut among = |range: Range<usize>| {
        if !range.is_empty() {
            worst = worst.max(off(city.heights.within(&city.marks.height, range.clone()), height));
            worst = worst.max(off(city.roofs.within(&city.roof, range), roof));
        }
    };
    let mut from = places.start;
    city.marks.taller(places.clone(), limit, |place| {
        among(from..place);
        landmark(place);
        from = place + 1;
    });
    among(from..places.end);
    worst
}

/// Members of a cluster that is small.
const FEW: usize = 48;

/// Error of a node's ring, and its triangles together with its landmarks' as they are. Of a leaf: of the original.
pub fn of_ring(city: &City, x: u32) -> (f64, u64) {
    if city.is_leaf(x) {
        return (0.0, city.triangles(x));
    }
    let cluster = city.cluster[x as usize] as usize;
    if city.hulls.ring(cluster).len() < 3 {
        // Nothing would stand over its members: never drawn.
        return (f64::INFINITY, 0);
    }
    let ring = Bounds::of(city.hulls.points(cluster));
    let e0 = e0(city.negative_space(x), ring, city.height(x));
    let mut triangles = u64::from(super::forms::prism(city.hulls.ring(cluster).len()));
    let height =
        of_heights(city, x, limit(city, x, e0), |place| triangles += u64::from(city.originals.triangles[place]));
    (e0.max(height), triangles)
}
