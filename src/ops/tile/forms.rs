//! The forms in which a building or a cluster may stand in an inner tile.

use rayon::prelude::*;

use super::city::City;
use super::error::{self, SEEN_FLAT, SEEN_TALL};
use crate::geom::Point;
use crate::geom::bounds::Bounds;
use crate::geom::forms::Draft;
use crate::geom::ring::area_m2;

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

/// Working memory for the forms of many nodes, one after the other.
#[derive(Default)]
pub struct Pen {
    draft: Draft,
    ring: Vec<Point>,
    half: Vec<Point>,
    convex: Vec<Point>,
    forced: Vec<(f64, u32)>,
    rest: Vec<(f64, u32)>,
}

/// In what a cluster may be drawn, and what its members add to the price.
#[derive(Clone, Debug)]
pub struct Offers {
    /// The first is the truest: the ring.
    pub forms: Vec<Form>,
    /// The ring with half its edges, where that is one of them.
    pub half: Box<[Point]>,
    /// What the members not taller than the cluster show wrong together.
    pub low: f64,
    /// (what it shows wrong where it is not drawn, its place) of each taller member: those above the ring's limit, in
    /// leaf order ..
    pub forced: Box<[(f64, u32)]>,
    /// .. and the others, from the largest down, with the sum from each on.
    pub rest: Box<[(f64, u32)]>,
    pub hidden_after: Box<[f64]>,
}

/// The form of a cluster over so many edges; its height's error is not in it yet.
fn block(city: &City, x: u32, bounds: Bounds, shape: Shape, edges: usize, negative_space: f64) -> Form {
    let error_space = error::e0(negative_space, bounds, city.height(x));
    let limit = error::limit(city, x, error_space);
    let shown = SEEN_FLAT * negative_space;
    Form { shape, triangles: prism(edges), negative_space, error_space, error_height: 0.0, limit, shown }
}

/// A cluster's ring.
pub fn ring(city: &City, x: u32) -> Form {
    let ring = || city.hulls.points(city.cluster[x as usize] as usize);
    let form = block(city, x, Bounds::of(ring()), Shape::Ring, ring().len(), city.negative_space(x));
    Form { error_height: error::of_heights(city, x, form.limit, |_| {}), ..form }
}

impl Offers {
    pub fn of(city: &City, x: u32, pen: &mut Pen) -> Self {
        let Pen { draft, ring, half, convex, forced, rest } = pen;
        city.ring(x, ring);
        let bounds = Bounds::of(ring.iter().copied());
        let built = area_m2(ring) - city.negative_space(x);
        let form = |shape, edges, space| block(city, x, bounds, shape, edges, space);
        let mut forms = Vec::with_capacity(3);
        forms.push(form(Shape::Ring, ring.len(), city.negative_space(x)));
        draft.half(ring, half);
        let mut kept: Box<[Point]> = Box::default();
        if half.len() < ring.len() {
            kept = half.as_slice().into();
            forms.push(form(Shape::Half, half.len(), area_m2(half) - built));
            draft.convex(half, convex);
            if convex.len() < half.len() {
                forms.push(form(Shape::Convex, convex.len(), area_m2(convex) - built));
            }
        }
        for f in &mut forms {
            f.error_height = error::of_heights(city, x, f.limit, |_| {});
        }

        // What its members add.
        let (height, limit) = (city.height(x), forms[0].limit);
        let mut low = 0.0;
        forced.clear();
        rest.clear();
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
        }
        rest.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut sum = 0.0;
        let after = |&(hidden, _): &(f64, u32)| {
            sum += hidden;
            sum
        };
        let mut hidden_after: Vec<f64> = rest.iter().rev().map(after).collect();
        hidden_after.reverse();
        let (forced, rest) = (forced.as_slice().into(), rest.as_slice().into());
        Self { forms, half: kept, low, forced, rest, hidden_after: hidden_after.into() }
    }
}

/// The forms of all single buildings, by place.
#[derive(Default)]
pub struct Alone {
    /// Offsets of each place's forms, and the end.
    starts: Vec<u32>,
    forms: Vec<Brief>,
}

/// A building's form, in short.
#[derive(Clone, Copy)]
struct Brief {
    negative_space: f64,
    error_space: f64,
    triangles: u32,
    shape: Shape,
}

/// Places that are worked out together.
const TOGETHER: usize = 4096;

impl Alone {
    pub fn new(city: &City) -> Self {
        let mut out = Self { starts: vec![0], forms: Vec::new() };
        let count = city.leaves.len();
        out.starts.reserve_exact(count);
        let parts: Vec<(Vec<u8>, Vec<Brief>)> = (0..count.div_ceil(TOGETHER))
            .into_par_iter()
            .map_init(Pen::default, |pen, i| {
                let (mut counts, mut forms) = (Vec::new(), Vec::new());
                for place in i * TOGETHER..count.min((i + 1) * TOGETHER) {
                    let before = forms.len();
                    of_building(city, place, pen, &mut forms);
                    counts.push((forms.len() - before) as u8);
                }
                (counts, forms)
            })
            .collect();
        out.forms.reserve_exact(parts.iter().map(|p| p.1.len()).sum());
        for (counts, forms) in parts {
            for count in counts {
                out.starts.push(out.starts[out.starts.len() - 1] + u32::from(count));
            }
            out.forms.extend(forms);
        }
        out
    }

    #[inline]
    pub fn forms(&self, city: &City, place: usize) -> impl ExactSizeIterator<Item = Form> {
        // How far a flat roof is off the building's highest level of detail, and how wide.
        let (off, side) = (city.originals.off[place], city.side[place]);
        self.forms[self.starts[place] as usize..self.starts[place + 1] as usize].iter().map(move |f| {
            let error_height = if f.shape == Shape::Original { 0.0 } else { off };
            Form {
                shape: f.shape,
                triangles: f.triangles,
                negative_space: f.negative_space,
                error_space: f.error_space,
                error_height,
                limit: f64::INFINITY,
                shown: SEEN_FLAT * f.negative_space.max(0.0) + SEEN_TALL * error_height * side,
            }
        })
    }
}

/// Appends all forms of a building that some other does not beat in everything.
fn of_building(city: &City, place: usize, pen: &mut Pen, out: &mut Vec<Brief>) {
    let (x, first, off) = (city.leaves[place], out.len(), city.originals.off[place]);
    let (height, built) = (city.height(x), city.built(x));
    let form = |shape, triangles, negative_space: f64, bounds| Brief {
        negative_space,
        error_space: error::e0(negative_space, bounds, height),
        triangles,
        shape,
    };
    let Pen { draft, ring, half, convex, .. } = pen;
    city.ring(x, ring);
    let bounds = Bounds::of(ring.iter().copied());
    let most = city.originals.triangles[place];
    out.push(form(Shape::Original, most, 0.0, bounds));
    let mut add = |f: Brief| {
        let error = |f: &Brief| f.error_space.max(if f.shape == Shape::Original { 0.0 } else { off });
        let beats =
            |g: &Brief| g.triangles <= f.triangles && g.negative_space <= f.negative_space && error(g) <= error(&f);
        if !out[first..].iter().any(beats) {
            out.push(f);
        }
    };
    if city.originals.has_solid(place) {
        let triangles = super::originals::raised(city.outline(place).map(|r| r.len()));
        add(form(Shape::Footprint, triangles, 0.0, bounds));
    }
    if ring.len() < 3 {
        return;
    }
    add(form(Shape::Ring, prism(ring.len()), (area_m2(ring) - built).max(0.0), bounds));
    // Against four corners a rectangle saves nothing.
    let rectangle = (most > prism(4)).then(|| rectangle(city, place, draft)).flatten();
    if let Some((corners, shared)) = rectangle.filter(|&(_, shared)| shared > 0.5 * built) {
        let wrong = (area_m2(&corners) + built - 2.0 * shared).max(0.0);
        add(form(Shape::Rectangle, prism(4), wrong, Bounds::of(corners)));
    }
    draft.half(ring, half);
    if half.len() < ring.len() {
        add(form(Shape::Half, prism(half.len()), area_m2(half) - built, bounds));
        draft.convex(half, convex);
        add(form(Shape::Convex, prism(convex.len()), area_m2(convex) - built, bounds));
    }
}

fn rectangle(city: &City, place: usize, draft: &mut Draft) -> Option<([Point; 4], f64)> {
    let mut rings = city.outline(place);
    match (rings.next(), rings.next()) {
        (Some(one), None) => draft.rectangle(&[one]),
        _ => draft.rectangle(&city.outline(place).collect::<Vec<_>>()),
    }
}

/// The plan of a form that is not the original (nor the footprint): one ring.
pub fn plan<'a>(city: &City, x: u32, shape: Shape, pen: &'a mut Pen) -> &'a [Point] {
    let Pen { draft, ring, half, convex, .. } = pen;
    city.ring(x, ring);
    match shape {
        Shape::Original | Shape::Footprint => unreachable!("drawn by their polygons"),
        Shape::Ring => return ring,
        Shape::Half => draft.half(ring, half),
        Shape::Convex => {
            draft.convex(ring, convex);
            return convex;
        }
        Shape::Rectangle => {
            half.clear();
            half.extend(rectangle(city, city.first(x), draft).expect("only offered where there is one").0);
        }
    }
    half
}
