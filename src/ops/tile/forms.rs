//! The forms in which a building or a cluster may stand in an inner tile.

use super::city::City;
use super::error::{self, SEEN_FLAT, SEEN_TALL};
use crate::geom::bounds::Bounds;
use crate::geom::ring::{area_m2, convex_hull};
use crate::geom::{Point, forms};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A building in its highest level of detail; without such, its ground polygons raised.
    Original,
    /// Where there is a higher level of detail: the ground polygons raised.
    Footprint,
    /// The hull's ring: courtyards filled, parts joined.
    Ring,
    /// The ring with half its edges.
    Half,
    /// The rectangle of equal area (buildings only: a cluster's could leave a member out).
    Rectangle,
    /// The convex ring.
    Convex,
}

/// A form of a node, measured.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    pub shape: Shape,
    pub triangles: u32,
    /// Area drawn but not built, and built but not drawn.
    pub negative_space: f64,
    /// e0, and the largest height difference of a member that is no landmark of it.
    pub error_space: f64,
    pub error_height: f64,
    /// Members taller than this are its landmarks.
    pub limit: f64,
    /// What it shows wrong, but for its members' heights.
    pub shown: f64,
}

impl Form {
    pub fn error(&self) -> f64 {
        self.error_space.max(self.error_height)
    }
}

/// Triangles of the walls and the roof over a ring of `edges`.
pub fn prism(edges: usize) -> u32 {
    (3 * edges as u32).saturating_sub(2)
}

/// In what a node may be drawn, and what its members add to the price.
#[derive(Debug)]
pub struct Offers {
    /// The first is the truest: the original, or the ring.
    pub forms: Box<[Form]>,
    /// What the members not taller than the cluster show wrong together.
    pub low: f64,
    /// (what it shows wrong where it is not drawn, its place) of each taller member: those above the ring's limit, in
    /// leaf order ..
    pub forced: Box<[(f64, u32)]>,
    /// .. and the others, from the largest down, with the sum from each on.
    pub rest: Box<[(f64, u32)]>,
    pub hidden_after: Box<[f64]>,
}

impl Offers {
    fn of_building(forms: Vec<Form>) -> Self {
        let none = || Box::from([]);
        Self { forms: forms.into(), low: 0.0, forced: none(), rest: none(), hidden_after: Box::from([]) }
    }
}

/// All forms of a node that some other does not beat in everything.
pub fn of(city: &City, x: u32) -> Offers {
    let ring = city.ring(x);
    if city.is_leaf(x) { of_building(city, x, &ring) } else { of_cluster(city, x, &ring) }
}

fn of_cluster(city: &City, x: u32, ring: &[Point]) -> Offers {
    let bounds = Bounds::of(ring.iter().copied());
    let built = area_m2(ring) - city.negative_space(x);
    let form = |shape, edges, negative_space| {
        let error_space = error::e0(negative_space, bounds, city.height(x));
        let limit = error::limit(city, x, error_space);
        let shown = SEEN_FLAT * negative_space;
        Form { shape, triangles: prism(edges), negative_space, error_space, error_height: 0.0, limit, shown }
    };
    let mut forms = vec![form(Shape::Ring, ring.len(), city.negative_space(x))];
    let half = forms::half(ring);
    if half.len() < ring.len() {
        forms.push(form(Shape::Half, half.len(), area_m2(&half) - built));
        let convex = convex_hull(&half);
        if convex.len() < half.len() {
            forms.push(form(Shape::Convex, convex.len(), area_m2(&convex) - built));
        }
    }

    // What its members add: see `Offers`.
    let (height, limit) = (city.height(x), forms[0].limit);
    let (mut low, mut forced, mut rest) = (0.0, Vec::new(), Vec::new());
    for place in city.places(x) {
        let own = city.marks.height[place];
        let hidden = SEEN_TALL * (own - height).abs() * city.side[place];
        if own <= height {
            low += hidden;
        } else if own > limit {
            forced.push((hidden, place as u32));
        } else {
            rest.push((hidden, place as u32));
        }
        for f in forms.iter_mut().filter(|f| own <= f.limit) {
            f.error_height = f.error_height.max(error::off(city, x, place));
        }
    }
    rest.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut sum = 0.0;
    let after = |&(hidden, _): &(f64, u32)| {
        sum += hidden;
        sum
    };
    let mut hidden_after: Vec<f64> = rest.iter().rev().map(after).collect();
    hidden_after.reverse();
    Offers { forms: forms.into(), low, forced: forced.into(), rest: rest.into(), hidden_after: hidden_after.into() }
}

fn of_building(city: &City, x: u32, ring: &[Point]) -> Offers {
    let place = city.first(x);
    let (height, built) = (city.height(x), city.built(x));
    // How far a flat roof is off the building's highest level of detail.
    let off = city.originals.off[place];
    let form = |shape, triangles, negative_space: f64, bounds, error_height| Form {
        shape,
        triangles,
        negative_space,
        error_space: error::e0(negative_space, bounds, height),
        error_height,
        limit: f64::INFINITY,
        shown: SEEN_FLAT * negative_space.max(0.0) + SEEN_TALL * error_height * city.side[place],
    };
    let bounds = Bounds::of(ring.iter().copied());
    let mut out = vec![form(Shape::Original, city.originals.triangles[place], 0.0, bounds, 0.0)];
    let most = out[0].triangles;
    let mut add = |f: Form| {
        let beats =
            |g: &Form| g.triangles <= f.triangles && g.negative_space <= f.negative_space && g.error() <= f.error();
        if !out.iter().any(beats) {
            out.push(f);
        }
    };
    let rings: Vec<&[Point]> = city.outline(place).collect();
    if city.originals.has_solid(place) {
        let triangles = super::originals::raised(rings.iter().map(|r| r.len()));
        add(form(Shape::Footprint, triangles, 0.0, bounds, off));
    }
    if ring.len() < 3 {
        return Offers::of_building(out);
    }
    add(form(Shape::Ring, prism(ring.len()), (area_m2(ring) - built).max(0.0), bounds, off));
    // Against four corners a rectangle saves nothing.
    let rectangle = (most > prism(4)).then(|| forms::rectangle(&rings)).flatten();
    if let Some((corners, shared)) = rectangle.filter(|&(_, shared)| shared > 0.5 * built) {
        let wrong = (area_m2(&corners) + built - 2.0 * shared).max(0.0);
        add(form(Shape::Rectangle, prism(4), wrong, Bounds::of(corners), off));
    }
    let half = forms::half(ring);
    if half.len() < ring.len() {
        add(form(Shape::Half, prism(half.len()), area_m2(&half) - built, bounds, off));
        let convex = convex_hull(&half);
        add(form(Shape::Convex, prism(convex.len()), area_m2(&convex) - built, bounds, off));
    }
    Offers::of_building(out)
}

/// The plan of a form that is not the original (nor the footprint): one ring.
pub fn plan(city: &City, x: u32, shape: Shape) -> Vec<Point> {
    let ring = city.ring(x);
    match shape {
        Shape::Original | Shape::Footprint => unreachable!("drawn by their polygons"),
        Shape::Ring => ring,
        Shape::Half => forms::half(&ring),
        Shape::Convex => convex_hull(&ring),
        Shape::Rectangle => {
            let rings: Vec<&[Point]> = city.outline(city.first(x)).collect();
            forms::rectangle(&rings).expect("only offered where there is one").0.to_vec()
        }
    }
}
