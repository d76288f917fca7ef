//! A simpler ring for every hull: concave vertices go, smallest added area first; the ring only grows.
//!
//! In:     hulls as `merge-hulls` makes them with `merge = "source"`, or a cut.
//! Out:    the same hulls with simplified rings: simple, counter-clockwise, containing the ring given, vertices a
//!         subset of its vertices. Areas and negative space follow the new rings.
//! Rules:  in a hierarchy a ring keeps max(`keep` * edges of its children once simplified, `floor` * edges of its
//!         own), rounded up, and a leaf keeps its ring; in a cut a ring keeps `keep` of its own edges. It keeps more
//!         where it is convex before that. Edges are counted without collinear vertices, which always go. Ties:
//!         smaller added area, then smaller vertex index (numbered in the dendrogram's leaf order).
//! Facts:  edges_before.
//! Errors: hulls that were simplified while they were merged: a parent would no longer contain its children.
//! Cost:   near O(m log m) for m vertices of all rings, parallel over rings.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, section 6.

use rayon::prelude::*;

use crate::artifact::Hulls;
use crate::artifact::hulls::HullState;
use crate::diag::{Diagnostic, Result};
use crate::geom::{Point, outer_hull, ring};
use crate::op::{Ctx, Op};
use crate::{inputs, params};

params! {
    /// A simpler ring for every hull.
    pub struct SimplifyPolyline {
        /// Share of the children's edges (in a cut: of its own) that a ring keeps, rounded up.
        #[schemars(range(min = 0.01, max = 1.0))]
        pub keep: f64 = 0.666666,
        /// Share of its own edges that a ring keeps at least.
        #[schemars(range(min = 0.0, max = 1.0))]
        pub floor: f64 = 0.01,
    }
}

inputs! {
    /// Unsimplified hulls of all clusters, or a cut.
    hulls: Hulls,
}

impl Op for SimplifyPolyline {
    const NAME: &'static str = "simplify-polyline";
    const VERSION: u32 = 1;
    type In = In;
    type Out = Hulls;
    const FACTS: &'static [(&'static str, &'static str)] = &[("edges_before", "edges of all rings before")];

    fn run(&self, ctx: &Ctx, input: In) -> Result<Hulls> {
        let hulls = &*input.hulls;
        if matches!(hulls.state, HullState::Simplified | HullState::SourceSimplified) {
            let message = match hulls.state {
                HullState::Simplified => "these hulls were simplified while they were merged",
                _ => "these hulls are simplified already",
            };
            return Err(Diagnostic::error("simplified-already", message)
                .help("set `keep` of merge-hulls instead, or take hulls made with `merge = \"source\"`"));
        }
        let out = simplify_polyline(hulls, self);
        ctx.report.fact("edges_before", hulls.rings.len());
        Ok(out)
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (2 << 20) + 5 * input_bytes / 2
    }
}

/// The hulls with simplified rings. Their state is `Merged` or `Cut`.
pub fn simplify_polyline(hulls: &Hulls, how: &SimplifyPolyline) -> Hulls {
    let rings = if hulls.state == HullState::Cut {
        (0..hulls.len())
            .into_par_iter()
            .map(|i| {
                let own = own_edges(hulls, i);
                simplified(hulls, i, outer_hull::target(how.keep, own, how.floor, own))
            })
            .collect()
    } else {
        hierarchy(hulls, how)
    };
    let mut out = hulls.clone();
    out.state = if hulls.state == HullState::Cut { HullState::Cut } else { HullState::SourceSimplified };
    out.starts.clear();
    out.starts.push(0);
    out.rings.clear();
    for ring in &rings {
        out.rings.extend_from_slice(ring);
        out.starts.push(out.rings.len() as u32);
    }
    let areas: Vec<f64> = (0..out.len()).into_par_iter().map(|i| ring::area_m2(&points(&out, i))).collect();
    for (i, &area) in areas.iter().enumerate() {
        out.negative_space_m2[i] += area - out.area_m2[i];
    }
    out.area_m2 = areas;
    out
}

/// Clusters whose children are done, layer by layer.
fn hierarchy(hulls: &Hulls, how: &SimplifyPolyline) -> Vec<Vec<u32>> {
    let count = hulls.len();
    let mut children = vec![[u32::MAX; 2]; count];
    let mut layer = vec![0u32; count];
    // Parents come after their children.
    for (c, &parent) in hulls.parent.iter().enumerate().filter(|(_, p)| **p != u32::MAX) {
        let slot = usize::from(children[parent as usize][0] != u32::MAX);
        children[parent as usize][slot] = c as u32;
        layer[parent as usize] = layer[parent as usize].max(layer[c] + 1);
    }
    let mut order: Vec<u32> = (0..count as u32).collect();
    order.sort_by_key(|&c| layer[c as usize]);
    let mut rings: Vec<Vec<u32>> = vec![Vec::new(); count];
    let mut edges = vec![0u32; count];
    for same in order.chunk_by(|&a, &b| layer[a as usize] == layer[b as usize]) {
        let done: Vec<(Vec<u32>, u32)> = same
            .par_iter()
            .map(|&c| {
                let c = c as usize;
                let [l, r] = children[c];
                if l == u32::MAX {
                    return (hulls.ring(c).to_vec(), own_edges(hulls, c));
                }
                let (l, r) = (l as usize, r as usize);
                // A child without an outline: its sibling's ring is the parent's.
                if let Some(only) = [(l, r), (r, l)].iter().find(|(none, _)| hulls.ring(*none).is_empty()) {
                    return (rings[only.1].clone(), edges[only.1]);
                }
                let target = outer_hull::target(how.keep, edges[l] + edges[r], how.floor, hulls.merged_edges[c]);
                let ring = simplified(hulls, c, target);
                let edges = ring.len() as u32;
                (ring, edges)
            })
            .collect();
        for (&c, (ring, count)) in same.iter().zip(done) {
            rings[c as usize] = ring;
            edges[c as usize] = count;
        }
    }
    rings
}

fn points(hulls: &Hulls, i: usize) -> Vec<Point> {
    hulls.points(i).collect()
}

fn own_edges(hulls: &Hulls, i: usize) -> u32 {
    ring::edges_without_collinear(&points(hulls, i)) as u32
}

fn simplified(hulls: &Hulls, i: usize, target: usize) -> Vec<u32> {
    let ids = hulls.ring(i);
    let mut kept = Vec::new();
    outer_hull::Simplifier::default().keep(&points(hulls, i), ids, target, &mut kept);
    kept.iter().map(|&k| ids[k as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::frame::Frame;
    use crate::geom::ring::{area_m2, contains};
    use crate::geom::segments::is_simple;
    use crate::op::Bench;
    use std::sync::Arc;

    /// Two leaves, an L and a box, and their merged ring: a comb of three teeth.
    fn comb(state: HullState) -> Hulls {
        let vertices = vec![
            [0, 0],
            [4, 0],
            [4, 4],
            [2, 4],
            [2, 9],
            [0, 9], // L
            [6, 0],
            [9, 0],
            [9, 8],
            [6, 8], // box
        ];
        let (l, b) = (vec![0, 1, 2, 3, 4, 5], vec![6, 7, 8, 9]);
        let both = vec![0, 1, 6, 7, 8, 9, 2, 3, 4, 5];
        let area = |ring: &[u32]| area_m2(&ring.iter().map(|&v| vertices[v as usize]).collect::<Vec<Point>>());
        let areas = [area(&l), area(&b), area(&both)];
        Hulls {
            frame: Frame::local(),
            state,
            starts: vec![0, 6, 10, 20],
            rings: [l, b, both].concat(),
            cluster: vec![0, 1, 2],
            parent: vec![2, 2, u32::MAX],
            buildings: vec![1, 1, 2],
            merged_edges: vec![6, 4, 8],
            negative_space_m2: vec![0.0, 0.0, areas[2] - areas[0] - areas[1]],
            area_m2: areas.to_vec(),
            ground: vec![0.0; 3],
            height: vec![3.0; 3],
            vertices,
        }
    }

    #[test]
    fn a_hierarchy_counts_its_childrens_edges_and_leaves_stay() {
        let hulls = comb(HullState::Merged);
        let out = simplify_polyline(&hulls, &SimplifyPolyline { keep: 0.65, ..SimplifyPolyline::default() });
        assert_eq!(out.state, HullState::SourceSimplified);
        assert_eq!((out.ring(0), out.ring(1)), (hulls.ring(0), hulls.ring(1)));
        // 0 - 1 - 6 - 7 is straight; of 10 edges 7 stay: the smallest notch goes.
        assert_eq!(out.ring(2), [0, 7, 8, 9, 3, 4, 5]);
        let grown = out.area_m2[2] - hulls.area_m2[2];
        assert!((out.negative_space_m2[2] - hulls.negative_space_m2[2] - grown).abs() < 1e-15 && grown > 0.0);
    }

    #[test]
    fn a_cut_counts_its_own_edges() {
        let mut hulls = comb(HullState::Cut);
        hulls.parent = vec![u32::MAX; 3];
        let out = simplify_polyline(&hulls, &SimplifyPolyline { keep: 0.8, ..SimplifyPolyline::default() });
        assert_eq!(out.state, HullState::Cut);
        assert_eq!(out.ring(0), [0, 1, 2, 4, 5]);
        assert_eq!(out.ring(1).len(), 4);
    }

    #[test]
    fn what_is_simplified_already_is_refused() {
        for state in [HullState::Simplified, HullState::SourceSimplified] {
            let bench = Bench::default();
            let error = SimplifyPolyline::default().run(&bench.ctx(), In { hulls: Arc::new(comb(state)) }).unwrap_err();
            assert_eq!(error.code, "simplified-already");
        }
    }

    #[test]
    fn every_ring_holds_what_it_was() {
        let hulls = comb(HullState::Merged);
        for keep in [0.01, 0.3, 0.5, 0.7, 1.0] {
            let out = simplify_polyline(&hulls, &SimplifyPolyline { keep, ..SimplifyPolyline::default() });
            for i in 0..3 {
                assert!(is_simple(&points(&out, i)) && contains(&points(&out, i), &points(&hulls, i)));
            }
        }
    }
}
