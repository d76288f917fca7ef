//! Simpler outlines for any polygon layer: shells only grow, courtyards only shrink.
//!
//! In:     footprints.
//! Out:    footprints; ids, heights and attributes stay. Vertices are some of the input's.
//! Rules:  of every ring the vertex goes whose removal adds the least area to the building (a concave one of a
//!         shell, a convex one of a courtyard), never making the ring touch itself; so a shell contains what it was,
//!         a courtyard lies in what it was, and rings of one polygon that did not cross cannot begin to. Polygons do
//!         not look at each other. A ring is done as soon as it has at most `max-edges` edges, or when the next step
//!         would add more than `max-area`, or bring all steps above `max-area-ratio` of the ring's own first area.
//!         A courtyard of at most `max-area` is filled. Vertices on a straight line always go. Ties: first vertex.
//!         A ring that crosses or touches itself is kept as it is, and reported by id.
//! Facts:  vertices_before.
//! Errors: none of `max-edges`, `max-area-ratio`, `max-area` is given.
//! Cost:   O(m log m) for m vertices, parallel over features.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, section 6.

use rayon::prelude::*;

use crate::artifact::{Footprints, Shapes};
use crate::diag::{Note, Result};
use crate::geom::Point;
use crate::geom::outer_hull::{Simplifier, Stop};
use crate::geom::ring::doubled_area;
use crate::geom::segments::is_simple;
use crate::op::{Ctx, Mistake, Op};
use crate::{inputs, params};

params! {
    /// Simpler outlines for any polygon layer.
    pub struct SimplifyFootprints {
        /// A ring with at most so many edges is simple enough.
        #[schemars(range(min = 3))]
        pub max_edges: Option<u32> = None,
        /// Largest area that all steps together add, as a share of the ring's own.
        #[schemars(range(min = 0.0))]
        pub max_area_ratio: Option<f64> = None,
        /// Largest area that one step adds.
        #[schemars(range(min = 0.0), extend("x-unit" = "m2"))]
        pub max_area: Option<f64> = None,
    }
}

inputs! {
    /// Polygons to simplify.
    footprints: Footprints,
}

impl Op for SimplifyFootprints {
    const NAME: &'static str = "simplify-footprints";
    const VERSION: u32 = 1;
    type In = In;
    type Out = Footprints;
    const FACTS: &'static [(&'static str, &'static str)] = &[("vertices_before", "points of all rings before")];

    fn check(&self) -> Vec<Mistake> {
        let none = self.max_edges.is_none() && self.max_area_ratio.is_none() && self.max_area.is_none();
        let message = "one of `max-edges`, `max-area-ratio`, `max-area` is needed: when is a ring simple enough?";
        none.then(|| Mistake { param: "", message: message.into() }).into_iter().collect()
    }

    fn run(&self, ctx: &Ctx, input: In) -> Result<Footprints> {
        let (out, kept) = simplify_footprints(&input.footprints, self);
        for row in kept {
            let id = out.ids.get(row as usize).to_string();
            let cause = "outline crosses or touches itself: kept as it is".to_string();
            ctx.report.repair(Note { row: row.into(), id, place: String::new(), cause });
        }
        ctx.report.fact("vertices_before", input.footprints.polygons.points.len());
        Ok(out)
    }
}

/// The simpler footprints, and the rows of those with a ring that had to be kept.
pub fn simplify_footprints(footprints: &Footprints, how: &SimplifyFootprints) -> (Footprints, Vec<u32>) {
    let shapes = &footprints.polygons;
    let done: Vec<(Shapes<Point>, bool)> = (0..footprints.len())
        .into_par_iter()
        .map_init(Simplifier::default, |simplifier, i| {
            let mut out = Shapes::default();
            let mut kept = false;
            for p in shapes.polygons_of(i) {
                for (k, r) in shapes.rings_of(p).enumerate() {
                    match simpler(shapes.ring(r), k > 0, how, simplifier) {
                        Some(ring) if ring.is_empty() && k > 0 => {}
                        Some(ring) => out.push_ring(&ring),
                        None => {
                            out.push_ring(shapes.ring(r));
                            kept = true;
                        }
                    }
                }
                out.end_polygon();
            }
            out.end_shape();
            (out, kept)
        })
        .collect();
    let mut out = footprints.clone();
    out.polygons = Shapes::default();
    done.iter().for_each(|(shape, _)| out.polygons.push_from(shape, 0));
    let kept = done.iter().enumerate().filter(|(_, d)| d.1).map(|(i, _)| i as u32).collect();
    (out, kept)
}

/// A simpler shell or courtyard, empty where it is filled; none where the ring is not simple. A courtyard is
/// clockwise, so what turns right, and may go, is convex.
fn simpler(
    ring: &[Point],
    courtyard: bool,
    how: &SimplifyFootprints,
    simplifier: &mut Simplifier,
) -> Option<Vec<Point>> {
    if !is_simple(ring) {
        return None;
    }
    let area = doubled_area(ring);
    let doubled = |m2: f64| (m2 * 2e6) as i64;
    let single = how.max_area.map_or(i64::MAX, doubled);
    if courtyard && how.max_area.is_some() && area.abs() <= single {
        return Some(Vec::new());
    }
    let mut turned = ring.to_vec();
    if (area < 0) != courtyard {
        turned.reverse();
    }
    let stop = Stop {
        edges: how.max_edges.unwrap_or(0) as usize,
        single,
        total: how.max_area_ratio.map_or(i64::MAX, |ratio| (ratio * area.abs() as f64) as i64),
    };
    let mut kept = Vec::new();
    simplifier.keep_within(&turned, &stop, &mut kept);
    Some(kept.iter().map(|&i| turned[i as usize]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::{Attributes, Strings};
    use crate::geom::frame::Frame;
    use crate::geom::ring::{area_m2, contains};

    fn one(rings: &[&[Point]]) -> Footprints {
        let mut polygons = Shapes::default();
        rings.iter().for_each(|r| polygons.push_ring(r));
        polygons.end_polygon();
        polygons.end_shape();
        Footprints {
            frame: Frame::local(),
            ids: ["a"].into_iter().collect::<Strings>(),
            polygons,
            base: vec![0.0],
            top: vec![3.0],
            attributes: Attributes::default(),
        }
    }

    /// Two notches, of 1 and of 4 m2, in a square of 10 m; a courtyard with one corner cut off.
    const SHELL: &[Point] = &[
        [0, 0],
        [10000, 0],
        [10000, 10000],
        [8000, 10000],
        [8000, 9000],
        [7000, 9000],
        [7000, 10000],
        [5000, 10000],
        [5000, 8000],
        [3000, 8000],
        [3000, 10000],
        [0, 10000],
    ];
    const YARD: &[Point] = &[[2000, 2000], [2000, 6000], [5000, 6000], [6000, 5000], [6000, 2000]];

    #[test]
    fn each_stop_stops() {
        let plan = one(&[SHELL, YARD]);
        let rings = |how: SimplifyFootprints| {
            let (out, kept) = simplify_footprints(&plan, &how);
            assert!(kept.is_empty());
            let n = out.polygons.rings_of(0).len();
            (0..n).map(|r| out.polygons.ring(r).to_vec()).collect::<Vec<_>>()
        };
        let by_edges = rings(SimplifyFootprints { max_edges: Some(8), ..SimplifyFootprints::default() });
        assert_eq!((by_edges[0].len(), by_edges[1].len()), (8, 5));
        // The small notch goes: in two steps of half a square metre. So does half a corner of the yard.
        let by_step = rings(SimplifyFootprints { max_area: Some(0.5), ..SimplifyFootprints::default() });
        assert_eq!(area_m2(&by_step[0]), 96.0);
        let by_ratio = rings(SimplifyFootprints { max_area_ratio: Some(0.02), ..SimplifyFootprints::default() });
        assert_eq!(area_m2(&by_ratio[0]), 96.0);
        let filled = rings(SimplifyFootprints { max_area: Some(20.0), ..SimplifyFootprints::default() });
        assert_eq!((filled.len(), area_m2(&filled[0])), (1, 100.0));
    }

    #[test]
    fn shells_grow_and_courtyards_shrink() {
        let plan = one(&[SHELL, YARD]);
        for edges in 3..13 {
            let how = SimplifyFootprints { max_edges: Some(edges), ..SimplifyFootprints::default() };
            let (out, _) = simplify_footprints(&plan, &how);
            let [shell, yard] = [0, 1].map(|r| out.polygons.ring(r).to_vec());
            let back: Vec<Point> = yard.iter().rev().copied().collect();
            assert!(is_simple(&shell) && contains(&shell, SHELL) && is_simple(&yard));
            assert!(contains(&YARD.iter().rev().copied().collect::<Vec<_>>(), &back), "{edges}");
            assert!(area_m2(&yard) < 0.0 && yard.len() <= YARD.len().min(edges.max(3) as usize));
        }
    }

    #[test]
    fn a_crossed_ring_is_kept_and_reported() {
        let plan = one(&[&[[0, 0], [9, 9], [9, 0], [0, 9]]]);
        let how = SimplifyFootprints { max_edges: Some(3), ..SimplifyFootprints::default() };
        let (out, kept) = simplify_footprints(&plan, &how);
        assert_eq!((kept, out.polygons), (vec![0], plan.polygons));
        assert_eq!(how.check(), []);
        assert_eq!(SimplifyFootprints::default().check().len(), 1);
    }
}
