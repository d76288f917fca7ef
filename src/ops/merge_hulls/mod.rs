//! One ring around the children of every dendrogram node, growing simpler towards the root.
//!
//! In:     footprints, n buildings; dendrogram over the same n.
//! Out:    2n - 1 counter-clockwise simple rings; each contains its members' outer rings and its children's rings;
//!         vertices are input vertices, numbered in the dendrogram's leaf order (so that ties hang neither on the
//!         order of the features nor on the direction of north). Courtyards are filled and count as negative space;
//!         overlapping footprints count once.
//! Rules:  a leaf keeps its ring; a building of several parts is their hull, merged in order. An outline that
//!         crosses or touches itself is taken as the ring around its edges, one without area gives an empty ring
//!         and its parent takes the sibling's: both reported by id.
//!         Edges are counted without collinear vertices.
//!         The ring of a node keeps max(`keep` * edges of its children, `floor` * edges of its own) edges, rounded
//!         up, or more where it is convex before that; then vertices are exchanged for better ones, as many as there
//!         are (`merge = "simplified"`).
//! Errors: the footprints and the dendrogram differ in their number of buildings.
//! Cost:   near O(n log n), parallel over subtrees.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, sections 5, 6; the
//!         exchange of vertices is ours.
//! Tried:  simplifying the best 6 connection pairs of each node and keeping the least area: 1.2 % less negative space
//!         for more than twice the time.

mod assemble;
mod heights;
mod leaves;
mod nodes;
mod sizes;
mod walk;

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use self::assemble::Rings;
use self::leaves::Leaves;
use self::nodes::Work;
use self::sizes::{Built, measure};
use self::walk::Walk;
use crate::artifact::hulls::HullState;
use crate::artifact::{Dendrogram, Footprints, Hulls};
use crate::diag::{Diagnostic, Note, Result};
use crate::op::{Ctx, NEVER, Op};
use crate::{inputs, params};

/// What a node merges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Merge {
    /// Its children's simplified rings: nested, linear in n.
    Simplified,
    /// Its children's unsimplified rings; simplify-polyline simplifies a copy of each.
    Source,
}

/// The height of a cluster from its buildings'.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Height {
    /// Weighted by area.
    Mean,
    /// The smallest height that half of the area does not exceed.
    Median,
}

params! {
    /// One ring around the children of every node.
    pub struct MergeHulls {
        /// What a node merges: its children's `simplified` rings (every parent contains its children's), or the
        /// unsimplified ones as in the `source`.
        pub merge: Merge = Merge::Simplified,
        /// Share of the children's edges that a ring keeps, rounded up.
        #[schemars(range(min = 0.01, max = 1.0))]
        pub keep: f64 = 0.666666,
        /// Share of its own merged ring's edges that a ring keeps at least.
        #[schemars(range(min = 0.0, max = 1.0))]
        pub floor: f64 = 0.01,
        /// A cluster's height above ground: area-weighted `mean` or `median` of its buildings'.
        pub height: Height = Height::Mean,
    }
}

inputs! {
    /// Ground polygons of all buildings.
    footprints: Footprints,
    /// Merge tree over the same buildings.
    dendrogram: Dendrogram,
}

impl Op for MergeHulls {
    const NAME: &'static str = "merge-hulls";
    const VERSION: u32 = 2;
    type In = In;
    type Out = Hulls;

    fn run(&self, ctx: &Ctx, input: In) -> Result<Hulls> {
        let (footprints, tree) = (&*input.footprints, &*input.dendrogram);
        if footprints.len() != tree.leaf_count() {
            let message = format!(
                "the dendrogram is over {} buildings, the footprints are {}",
                tree.leaf_count(),
                footprints.len()
            );
            return Err(Diagnostic::error("other-buildings", message).help("cluster the same footprints"));
        }
        let Some((hulls, repairs)) = merge_until(footprints, tree, self, ctx.stop) else {
            return Err(Ctx::interrupted());
        };
        repairs.into_iter().for_each(|note| ctx.report.repair(note));
        Ok(hulls)
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        match self.merge {
            Merge::Simplified => (4 << 20) + 7 * input_bytes / 2,
            // Rings that keep their corners: n log n of them, in blocks with many.
            Merge::Source => (2 << 20) + 10 * input_bytes,
        }
    }
}

/// The hulls, and what had to be repaired.
pub fn merge_hulls(footprints: &Footprints, tree: &Dendrogram, how: &MergeHulls) -> (Hulls, Vec<Note>) {
    merge_until(footprints, tree, how, &NEVER).expect("nobody stops it")
}

/// The same; none soon after `stop` has become true.
fn merge_until(
    footprints: &Footprints,
    tree: &Dendrogram,
    how: &MergeHulls,
    stop: &AtomicBool,
) -> Option<(Hulls, Vec<Note>)> {
    let walk = Walk::new(tree);
    let (order, _) = tree.leaf_order();
    let leaves = Leaves::new(footprints, &order);
    let work = Work { walk: &walk, leaves: &leaves, how, stop };
    let rings = || {
        let mut parts = Vec::new();
        walk.root().into_iter().for_each(|root| work.subtree(root, &mut parts));
        parts
    };
    let (parts, built) = rayon::join(rings, || Built::new(footprints, &walk, &leaves.crossed));

    if stop.load(Relaxed) {
        return None;
    }
    let Rings { starts, rings, merged_edges, area } = Rings::new(&walk, &leaves, parts);
    let repairs = leaves.repairs.iter().map(|&(row, cause)| {
        let id = footprints.ids.get(row as usize).to_string();
        Note { row: row.into(), id, place: String::new(), cause: cause.to_string() }
    });
    let repairs = repairs.collect();
    let count = tree.cluster_count();
    let mut hulls = Hulls {
        frame: footprints.frame.clone(),
        state: if how.merge == Merge::Simplified { HullState::Simplified } else { HullState::Merged },
        vertices: leaves.vertices,
        starts,
        rings,
        cluster: (0..count as u32).collect(),
        parent: tree.parents(),
        buildings: (0..count as u32).map(|c| tree.size_of(c)).collect(),
        merged_edges,
        area_m2: area,
        negative_space_m2: Vec::new(),
        ground: Vec::new(),
        height: Vec::new(),
    };
    measure(&mut hulls, footprints, &walk, how.height, &built);
    Some((hulls, repairs))
}

#[cfg(test)]
mod tests {
    use super::leaves::{NO_AREA, clean};
    use super::*;
    use crate::artifact::{Attributes, Shapes, Strings};
    use crate::geom::frame::Frame;
    use crate::geom::ring::{contains, convex_hull, doubled_area};
    use crate::geom::segments::is_simple;
    use crate::geom::union_area::Polygon;
    use crate::geom::{Point, outer_hull, ring};

    /// Buildings of one ring each, as high as their number.
    fn town(shells: &[Vec<Point>]) -> Footprints {
        let mut polygons = Shapes::default();
        for shell in shells {
            polygons.push_ring(shell);
            polygons.end_polygon();
            polygons.end_shape();
        }
        Footprints {
            frame: Frame::local(),
            ids: (0..shells.len()).map(|i| format!("b{i}")).collect::<Strings>(),
            polygons,
            base: vec![1.0; shells.len()],
            top: (0..shells.len()).map(|i| 2.0 + i as f64).collect(),
            attributes: Attributes::default(),
        }
    }

    /// A tree by halving at the median, along x and y in turns.
    fn bisect(footprints: &Footprints) -> Dendrogram {
        fn halve(mut all: Vec<(u32, Point)>, axis: usize, n: u32, out: &mut Dendrogram) -> (u32, u32) {
            if all.len() == 1 {
                return (all[0].0, 1);
            }
            all.sort_by_key(|a| (a.1[axis], a.1[1 - axis], a.0));
            let right = all.split_off(all.len() / 2);
            let (l, a) = halve(all, 1 - axis, n, out);
            let (r, b) = halve(right, 1 - axis, n, out);
            out.left.push(l);
            out.right.push(r);
            out.size.push(a + b);
            (n + out.left.len() as u32 - 1, a + b)
        }
        let n = footprints.len() as u32;
        let mut out = Dendrogram { leaves: vec![n], ..Dendrogram::default() };
        let centre = |i: usize| {
            let ring =
                footprints.polygons.ring(footprints.polygons.rings_of(footprints.polygons.polygons_of(i).start).start);
            ring.first().copied().unwrap_or([0, 0])
        };
        halve((0..n).map(|i| (i, centre(i as usize))).collect(), 0, n, &mut out);
        let merges = out.left.len();
        out.distance = vec![1.0; merges];
        out.cost = vec![1.0; merges];
        out.crosses_barrier = vec![false; merges];
        out
    }

    struct Random(u64);
    impl Random {
        fn below(&mut self, n: i32) -> i32 {
            self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((self.0 >> 33) % n as u64) as i32
        }
    }

    /// Boxes, L-shapes, slanted boxes on a coarse grid (so that they touch, overlap, nest and repeat) and crossed ones.
    fn random_town(seed: u64, n: usize) -> Vec<Vec<Point>> {
        let mut r = Random(seed);
        let width = 20 * (n as f64).sqrt() as i32 + 10;
        (0..n)
            .map(|_| {
                let (x, y) = (r.below(width), r.below(width));
                let (w, h) = (4 + r.below(20), 4 + r.below(20));
                let shape: Vec<Point> = match r.below(8) {
                    0..=2 => vec![[0, 0], [w, 0], [w, h], [0, h]],
                    3 | 4 => vec![[0, 0], [w, 0], [w, h / 2], [w / 2, h / 2], [w / 2, h], [0, h]],
                    5 => vec![[0, 0], [w / 2, 0], [w, 0], [w, h], [w / 2, h + 3], [0, h]],
                    6 => vec![[0, 0], [w, r.below(5)], [w + 3, h], [r.below(5), h]],
                    _ => vec![[0, 0], [w, h], [w, 0], [0, h], [-3, h / 2]],
                };
                shape.into_iter().map(|p| [p[0] + x, p[1] + y]).collect()
            })
            .collect()
    }

    fn points(hulls: &Hulls, i: usize) -> Vec<Point> {
        hulls.points(i).collect()
    }

    fn assert_sound(footprints: &Footprints, tree: &Dendrogram, hulls: &Hulls, context: &str) {
        let (order, first) = tree.leaf_order();
        for c in 0..hulls.len() {
            let ring = points(hulls, c);
            assert!(is_simple(&ring), "{context}: cluster {c} is not simple: {ring:?}");
            assert!(doubled_area(&ring) > 0, "{context}: cluster {c} is clockwise");
            let members = &order[first[c] as usize..(first[c] + tree.size_of(c as u32)) as usize];
            let mut input: Vec<Point> = Vec::new();
            for &b in members {
                for shell in footprints.polygons.shells(b as usize) {
                    input.extend_from_slice(shell);
                    let ((outline, _), _) = clean(shell, &(0..shell.len() as u32).collect::<Vec<_>>());
                    assert!(contains(&ring, &outline), "{context}: cluster {c} does not cover building {b}");
                }
            }
            assert!(ring.iter().all(|p| input.contains(p)), "{context}: cluster {c} has a new vertex");
            let shells: Vec<Polygon> = members
                .iter()
                .flat_map(|&b| footprints.polygons.shells(b as usize))
                .map(|shell| Polygon { shell, holes: vec![] })
                .collect();
            let union = crate::geom::union_area::doubled_union_area(&shells);
            let negative = (doubled_area(&ring) as f64 - union) / 2e6;
            assert!((hulls.negative_space_m2[c] - negative.max(0.0)).abs() < 1e-12, "{context}: negative space of {c}");
            if let Some(children) = tree.children(c as u32) {
                for child in children {
                    let inner = points(hulls, child as usize);
                    assert!(contains(&ring, &inner), "{context}: cluster {c} does not contain {child}");
                }
            }
        }
    }

    #[test]
    fn a_wish_to_stop_ends_it() {
        let square = |x: i32| vec![[x, 0], [x + 9, 0], [x + 9, 9], [x, 9]];
        let (footprints, tree, _) = default_hulls(&[square(0), square(20), square(50)]);
        assert!(merge_until(&footprints, &tree, &MergeHulls::default(), &AtomicBool::new(true)).is_none());
    }

    fn default_hulls(shells: &[Vec<Point>]) -> (Footprints, Dendrogram, Hulls) {
        let footprints = town(shells);
        let tree = bisect(&footprints);
        let (hulls, _) = merge_hulls(&footprints, &tree, &MergeHulls::default());
        (footprints, tree, hulls)
    }

    #[test]
    fn two_boxes() {
        let (_, _, hulls) = default_hulls(&[
            vec![[0, 0], [1000, 0], [1000, 1000], [0, 1000]],
            vec![[3000, 0], [4000, 0], [4000, 3000], [3000, 3000]],
        ]);
        // Eight edges, of which 2/3 rounded up are six.
        assert_eq!(points(&hulls, 2), [[0, 0], [4000, 0], [4000, 3000], [3000, 3000], [1000, 1000], [0, 1000]]);
        assert_eq!((hulls.merged_edges[2], hulls.buildings[2]), (6, 2));
        assert_eq!(hulls.area_m2[2], 1.0 + 3.0 + 4.0);
        assert_eq!((hulls.negative_space_m2[2], hulls.negative_space_m2[0]), (4.0, 0.0));
        assert_eq!((hulls.ground[2], hulls.height[2]), (1.0, (1.0 + 3.0 * 2.0) / 4.0));
    }

    #[test]
    fn random_towns_are_sound_in_both_modes() {
        for seed in 0..40 {
            let footprints = town(&random_town(seed, 3 + 4 * (seed as usize % 8)));
            let tree = bisect(&footprints);
            for merge in [Merge::Simplified, Merge::Source] {
                let how = MergeHulls { merge, ..MergeHulls::default() };
                let (hulls, _) = merge_hulls(&footprints, &tree, &how);
                assert_sound(&footprints, &tree, &hulls, &format!("seed {seed}, {merge:?}"));
                for c in tree.leaf_count()..hulls.len() {
                    let [l, r] = tree.children(c as u32).unwrap().map(|c| {
                        outer_hull::target(
                            1.0,
                            ring::edges_without_collinear(&points(&hulls, c as usize)) as u32,
                            0.0,
                            0,
                        )
                    });
                    let edges = hulls.ring(c).len();
                    let convex = convex_hull(&points(&hulls, c)).len();
                    if merge == Merge::Simplified {
                        assert!(
                            edges <= (l + r) * 2 / 3 + 1 || edges == convex,
                            "seed {seed}: cluster {c}: {edges} edges"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn the_same_turned_moved_and_in_another_order() {
        for seed in 0..12 {
            let shells = random_town(seed, 40);
            let (footprints, tree, hulls) = default_hulls(&shells);
            let motions: [fn(Point) -> Point; 2] = [|p| [-p[1], p[0]], |p| [p[0] + 400_000_000, p[1] - 3_000_000]];
            for motion in motions {
                let moved: Vec<Vec<Point>> = shells.iter().map(|s| s.iter().map(|&p| motion(p)).collect()).collect();
                let (there, _) = merge_hulls(&town(&moved), &tree, &MergeHulls::default());
                assert_eq!(there.rings, hulls.rings, "seed {seed}");
                assert_eq!(there.vertices, hulls.vertices.iter().map(|&p| motion(p)).collect::<Vec<_>>());
                assert_eq!(there.area_m2, hulls.area_m2);
            }
            // Buildings backwards: leaf b is now n - 1 - b, all else as it was.
            let n = shells.len() as u32;
            let back = |c: u32| if c < n { n - 1 - c } else { c };
            let turned = town(&shells.iter().rev().cloned().collect::<Vec<_>>());
            let mut other = tree.clone();
            other.left.iter_mut().chain(&mut other.right).for_each(|c| *c = back(*c));
            let (there, _) = merge_hulls(&turned, &other, &MergeHulls::default());
            assert_eq!(there.vertices, hulls.vertices);
            for c in 0..hulls.len() as u32 {
                assert_eq!(there.ring(back(c) as usize), hulls.ring(c as usize), "seed {seed}, cluster {c}");
                assert_eq!(there.negative_space_m2[back(c) as usize], hulls.negative_space_m2[c as usize]);
            }
            assert_eq!(footprints.len(), n as usize);
        }
    }

    #[test]
    fn what_has_no_area_gets_no_ring_and_the_parent_takes_the_siblings() {
        let square = vec![[0, 0], [9, 0], [9, 9], [0, 9]];
        let footprints = town(&[square.clone(), vec![[20, 0], [30, 0]], vec![[40, 0], [50, 0], [60, 0]]]);
        let tree = bisect(&footprints);
        let (hulls, repairs) = merge_hulls(&footprints, &tree, &MergeHulls::default());
        assert_eq!(points(&hulls, 4), square);
        assert!(hulls.ring(1).is_empty() && hulls.ring(2).is_empty());
        assert_eq!(
            repairs.iter().map(|r| (&r.id[..], &r.cause[..])).collect::<Vec<_>>(),
            [("b1", NO_AREA), ("b2", NO_AREA)]
        );
    }

    #[test]
    fn medians_are_of_area() {
        let square = |x: i32, side: i32| vec![[x, 0], [x + side, 0], [x + side, side], [x, side]];
        let footprints = town(&[square(0, 9), square(20, 9), square(40, 20)]);
        let tree = bisect(&footprints);
        let how = MergeHulls { height: Height::Median, ..MergeHulls::default() };
        let (hulls, _) = merge_hulls(&footprints, &tree, &how);
        assert_eq!(hulls.height[..3], [1.0, 2.0, 3.0]);
        assert_eq!(hulls.height[4], 3.0);
    }
}
