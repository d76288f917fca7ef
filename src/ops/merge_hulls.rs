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
//!         up, or more where it is convex before that.
//! Cost:   near O(n log n), parallel over subtrees.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, sections 5, 6.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifact::hulls::HullState;
use crate::artifact::{Dendrogram, Footprints, Hulls};
use crate::diag::{Diagnostic, Note, Result};
use crate::geom::merge_rings::{Merger, Ring};
use crate::geom::outer_hull::Simplifier;
use crate::geom::segments::is_simple;
use crate::geom::union_area::Polygon;
use crate::geom::{Point, distinct, erode, outer_hull, overlaps, ring};
use crate::op::{Ctx, Op};
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
    const VERSION: u32 = 1;
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
        let (hulls, repairs) = merge_hulls(footprints, tree, self);
        repairs.into_iter().for_each(|note| ctx.report.repair(note));
        Ok(hulls)
    }
}

/// The hulls, and what had to be repaired.
pub fn merge_hulls(footprints: &Footprints, tree: &Dendrogram, how: &MergeHulls) -> (Hulls, Vec<Note>) {
    let (order, _) = tree.leaf_order();
    let leaves = Leaves::new(footprints, &order);
    let work = Work { tree, leaves: &leaves, how };
    let rings = || {
        let mut parts = Vec::new();
        tree.root().into_iter().for_each(|root| work.subtree(root, &mut parts));
        parts
    };
    let (parts, built) = rayon::join(rings, || Built::new(footprints, tree, &leaves.crossed));

    // Rings in the order of the clusters.
    let count = tree.cluster_count();
    let mut places = vec![(0u32, 0u32); count];
    let mut merged_edges = vec![0u32; count];
    for (p, part) in parts.iter().enumerate() {
        for (i, &cluster) in part.cluster.iter().enumerate() {
            places[cluster as usize] = (p as u32, i as u32);
            merged_edges[cluster as usize] = part.merged_edges[i];
        }
    }
    let mut starts = Vec::with_capacity(count + 1);
    let mut rings = Vec::with_capacity(parts.iter().map(|p| p.rings.len()).sum());
    starts.push(0);
    for &(p, i) in &places {
        rings.extend_from_slice(parts[p as usize].ring(i as usize));
        starts.push(rings.len() as u32);
    }
    drop(parts);

    let repairs = leaves.repairs.iter().map(|&(row, cause)| {
        let id = footprints.ids.get(row as usize).to_string();
        Note { row: row.into(), id, place: String::new(), cause: cause.to_string() }
    });
    let repairs = repairs.collect();
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
        area_m2: Vec::new(),
        negative_space_m2: Vec::new(),
        ground: Vec::new(),
        height: Vec::new(),
    };
    measure(&mut hulls, footprints, tree, how.height, &built);
    (hulls, repairs)
}

// ------------------------------------------------------------------------------------------------------ leaves

/// The leaves' own rings.
struct Leaves {
    vertices: Vec<Point>,
    /// By building: offsets into `rings`, vertex numbers.
    starts: Vec<u32>,
    rings: Vec<u32>,
    repairs: Vec<(u32, &'static str)>,
    /// By building: an outline of its crosses or touches itself.
    crossed: Vec<bool>,
}

const CROSSED: &str = "outline crosses or touches itself: taken as the ring around its edges";
const NO_AREA: &str = "outline without area: no ring";

impl Leaves {
    fn new(footprints: &Footprints, order: &[u32]) -> Self {
        let shapes = &footprints.polygons;
        let shells = || order.iter().flat_map(|&b| shapes.shells(b as usize));
        let points: Vec<Point> = shells().flatten().copied().collect();
        let (vertices, numbers) = distinct::number(points.into_iter());
        // Where each building's shells begin in `numbers`.
        let mut from = vec![0u32; footprints.len() + 1];
        let mut at = 0u32;
        for &b in order {
            from[b as usize] = at;
            at += shapes.shells(b as usize).map(|s| s.len() as u32).sum::<u32>();
        }
        let built: Vec<(Vec<u32>, Option<&'static str>)> = (0..footprints.len())
            .into_par_iter()
            .map(|b| {
                let mut numbers = &numbers[from[b] as usize..];
                let mut hull: (Vec<Point>, Vec<u32>) = (Vec::new(), Vec::new());
                let mut cause = None;
                for shell in shapes.shells(b) {
                    let (mine, rest) = numbers.split_at(shell.len());
                    numbers = rest;
                    let (outline, why) = clean(shell, mine);
                    cause = cause.or(why);
                    if hull.0.is_empty() {
                        hull = outline;
                    } else if !outline.0.is_empty() {
                        let mut merger = Merger::default();
                        merger.merge(Ring { at: &hull.0, ids: &hull.1 }, Ring { at: &outline.0, ids: &outline.1 });
                        hull = (merger.at, merger.ids);
                    }
                }
                if hull.0.is_empty() {
                    cause = Some(NO_AREA);
                }
                (hull.1, cause)
            })
            .collect();
        let mut leaves = Self {
            vertices,
            starts: vec![0],
            rings: Vec::with_capacity(numbers.len()),
            repairs: Vec::new(),
            crossed: Vec::new(),
        };
        for (b, (ring, cause)) in built.iter().enumerate() {
            leaves.rings.extend_from_slice(ring);
            leaves.starts.push(leaves.rings.len() as u32);
            leaves.crossed.push(cause.is_some());
            leaves.repairs.extend(cause.map(|c| (b as u32, c)));
        }
        leaves
    }
    fn ring(&self, building: u32) -> &[u32] {
        let b = building as usize;
        &self.rings[self.starts[b] as usize..self.starts[b + 1] as usize]
    }
}

/// A simple counter-clockwise ring around an outline, and what was wrong with it; empty where it has no area.
fn clean(shell: &[Point], numbers: &[u32]) -> ((Vec<Point>, Vec<u32>), Option<&'static str>) {
    let (mut at, mut ids) = (shell.to_vec(), numbers.to_vec());
    at.dedup();
    ids.dedup();
    while at.len() > 1 && at[0] == at[at.len() - 1] {
        at.pop();
        ids.pop();
    }
    if at.len() >= 3 && is_simple(&at) {
        if ring::doubled_area(&at) < 0 {
            at.reverse();
            ids.reverse();
        }
        return ((at, ids), None);
    }
    match erode::around(&at) {
        Some(places) => {
            let pick = |i: &u32| (at[*i as usize], ids[*i as usize]);
            (places.iter().map(pick).unzip(), Some(CROSSED))
        }
        None => ((Vec::new(), Vec::new()), Some(NO_AREA)),
    }
}

// ------------------------------------------------------------------------------------------------------- nodes

/// Rings of some clusters, in the order they were made.
#[derive(Default)]
struct Part {
    cluster: Vec<u32>,
    ends: Vec<u32>,
    rings: Vec<u32>,
    merged_edges: Vec<u32>,
    /// Edges of the ring after its simplification, without collinear vertices.
    edges: Vec<u32>,
}

impl Part {
    fn ring(&self, i: usize) -> &[u32] {
        let from = if i == 0 { 0 } else { self.ends[i - 1] };
        &self.rings[from as usize..self.ends[i] as usize]
    }
    fn clear(&mut self) {
        for column in [&mut self.cluster, &mut self.ends, &mut self.rings, &mut self.merged_edges, &mut self.edges] {
            column.clear();
        }
    }
    fn push(&mut self, cluster: u32, ring: impl IntoIterator<Item = u32>, merged_edges: u32, edges: u32) {
        self.cluster.push(cluster);
        self.rings.extend(ring);
        self.ends.push(self.rings.len() as u32);
        self.merged_edges.push(merged_edges);
        self.edges.push(edges);
    }
}

/// Working memory of one thread.
#[derive(Default)]
struct Desk {
    merger: Merger,
    simplifier: Simplifier,
    points: [Vec<Point>; 2],
    kept: Vec<u32>,
}

struct Work<'a> {
    tree: &'a Dendrogram,
    leaves: &'a Leaves,
    how: &'a MergeHulls,
}

/// Subtrees of at most so many leaves are one piece of work.
const GRAIN: u32 = 256;

impl Work<'_> {
    /// All rings of a subtree; the last of the last part is the top's.
    fn subtree(&self, top: u32, parts: &mut Vec<Part>) {
        match self.tree.children(top) {
            Some([left, right]) if self.tree.size_of(top) > GRAIN => {
                let mut others = Vec::new();
                rayon::join(|| self.subtree(left, parts), || self.subtree(right, &mut others));
                let last = |parts: &[Part]| (parts.len() - 1, parts[parts.len() - 1].cluster.len() - 1);
                let ((p, i), (q, j)) = (last(parts), last(&others));
                let mut part = Part::default();
                self.node(top, (&parts[p], i), (&others[q], j), &mut Desk::default(), &mut part);
                parts.append(&mut others);
                parts.push(part);
            }
            _ => parts.push(self.sequential(top)),
        }
    }

    fn sequential(&self, top: u32) -> Part {
        let (mut part, mut one) = (Part::default(), Part::default());
        let mut desk = Desk::default();
        let mut todo = vec![(top, false)];
        let mut done: Vec<usize> = Vec::new();
        while let Some((cluster, ready)) = todo.pop() {
            match self.tree.children(cluster) {
                None => {
                    let ring = self.leaves.ring(cluster);
                    self.place(ring, &mut desk.points[0]);
                    let edges = ring::edges_without_collinear(&desk.points[0]) as u32;
                    part.push(cluster, ring.iter().copied(), edges, edges);
                }
                Some([left, right]) if !ready => {
                    todo.extend([(cluster, true), (right, false), (left, false)]);
                    continue;
                }
                Some(_) => {
                    let (r, l) = (done.pop().expect("two children"), done.pop().expect("two children"));
                    one.clear();
                    self.node(cluster, (&part, l), (&part, r), &mut desk, &mut one);
                    part.push(cluster, one.rings.iter().copied(), one.merged_edges[0], one.edges[0]);
                }
            }
            done.push(part.cluster.len() - 1);
        }
        part
    }

    fn place(&self, ring: &[u32], out: &mut Vec<Point>) {
        out.clear();
        out.extend(ring.iter().map(|&id| self.leaves.vertices[id as usize]));
    }

    /// Appends the ring of one inner node to `part`, from its children's.
    fn node(&self, cluster: u32, left: (&Part, usize), right: (&Part, usize), desk: &mut Desk, part: &mut Part) {
        let [l, r] = [left, right].map(|(part, i)| (part.ring(i), part.edges[i]));
        if l.0.is_empty() || r.0.is_empty() {
            let only = if l.0.is_empty() { r } else { l };
            return part.push(cluster, only.0.iter().copied(), only.1, only.1);
        }
        let Desk { merger, simplifier, points: [at_l, at_r], kept } = desk;
        self.place(l.0, at_l);
        self.place(r.0, at_r);
        merger.merge(Ring { at: at_l, ids: l.0 }, Ring { at: at_r, ids: r.0 });
        let own = ring::edges_without_collinear(&merger.at) as u32;
        if self.how.merge == Merge::Source {
            return part.push(cluster, merger.ids.iter().copied(), own, own);
        }
        let target = outer_hull::target(self.how.keep, l.1 + r.1, self.how.floor, own);
        simplifier.keep(&merger.at, &merger.ids, target, kept);
        part.push(cluster, kept.iter().map(|&i| merger.ids[i as usize]), own, kept.len() as u32);
    }
}

// ------------------------------------------------------------------------------------------------------- sizes

/// Doubled square millimetres: whole numbers but for overlaps, so that sums are exact.
struct Built {
    /// Of each building, without its courtyards.
    own: Vec<f64>,
    /// Of the union of each cluster's buildings.
    union: Vec<f64>,
}

impl Built {
    fn new(footprints: &Footprints, tree: &Dendrogram, crossed: &[bool]) -> Self {
        let (order, first) = tree.leaf_order();
        let shapes = &footprints.polygons;
        let polygons = |b: usize| -> Vec<Polygon> {
            let polygon = |p: usize| {
                let mut rings = shapes.rings_of(p).map(|r| shapes.ring(r));
                Some(Polygon { shell: rings.next()?, holes: rings.collect() })
            };
            shapes.polygons_of(b).filter_map(polygon).collect()
        };
        let n = footprints.len();
        let own: Vec<f64> = (0..n).into_par_iter().map(|b| overlaps::built_area(&polygons(b), !crossed[b])).collect();
        let size: Vec<u32> = (0..tree.cluster_count() as u32).map(|c| tree.size_of(c)).collect();
        let by_place: Vec<f64> = order.iter().map(|&b| own[b as usize]).collect();
        let by = overlaps::Tree { first: &first, size: &size, parent: &tree.parents(), leaf: &order };
        let twice = overlaps::covered_twice(&by, &by_place, &|place| polygons(order[place] as usize));
        let mut union = own.clone();
        for (merge, (&l, &r)) in tree.left.iter().zip(&tree.right).enumerate() {
            union.push(union[l as usize] + union[r as usize] - twice[n + merge]);
        }
        Self { own, union }
    }
}

/// Fills areas, negative space and heights.
fn measure(hulls: &mut Hulls, footprints: &Footprints, tree: &Dendrogram, height: Height, built: &Built) {
    let n = tree.leaf_count();
    let above: Vec<f64> = footprints.top.iter().zip(&footprints.base).map(|(t, b)| t - b).collect();
    let mut sums: Vec<[f64; 3]> =
        (0..n).map(|b| [built.own[b], built.own[b] * footprints.base[b], built.own[b] * above[b]]).collect();
    let mut plain: Vec<[f64; 2]> = (0..n).map(|b| [footprints.base[b], above[b]]).collect();
    hulls.ground = footprints.base.clone();
    hulls.height = above.clone();
    for (merge, (&l, &r)) in tree.left.iter().zip(&tree.right).enumerate() {
        let (l, r) = (l as usize, r as usize);
        let sum = [0, 1, 2].map(|k| sums[l][k] + sums[r][k]);
        let even = [0, 1].map(|k| plain[l][k] + plain[r][k]);
        let size = f64::from(tree.size[merge]);
        // Members without any area weigh alike.
        let mean = |k: usize| if sum[0] > 0.0 { sum[k + 1] / sum[0] } else { even[k] / size };
        hulls.ground.push(mean(0));
        hulls.height.push(mean(1));
        sums.push(sum);
        plain.push(even);
    }
    if height == Height::Median {
        medians(&mut hulls.height, tree, &built.own, &above);
    }
    let areas: Vec<f64> = (0..hulls.len())
        .into_par_iter()
        .map_init(Vec::new, |points, i| {
            points.clear();
            points.extend(hulls.points(i));
            ring::doubled_area(points) as f64
        })
        .collect();
    hulls.negative_space_m2 = areas.iter().zip(&built.union).map(|(a, b)| (a - b).max(0.0) / 2e6).collect();
    hulls.area_m2 = areas.iter().map(|a| a / 2e6).collect();
}

/// Area-weighted medians: the leaves of every cluster sorted by height, by merging its children's.
fn medians(out: &mut [f64], tree: &Dendrogram, weight: &[f64], height: &[f64]) {
    let (mut sorted, first) = tree.leaf_order();
    let n = sorted.len();
    let mut buffer: Vec<u32> = Vec::new();
    for (merge, (&l, &r)) in tree.left.iter().zip(&tree.right).enumerate() {
        let from = first[l as usize] as usize;
        let middle = first[r as usize] as usize;
        let to = from + tree.size[merge] as usize;
        buffer.clear();
        let (mut i, mut j) = (from, middle);
        while i < middle || j < to {
            let left = j == to || (i < middle && height[sorted[i] as usize] <= height[sorted[j] as usize]);
            buffer.push(sorted[if left { i } else { j }]);
            if left { i += 1 } else { j += 1 }
        }
        sorted[from..to].copy_from_slice(&buffer);
        let total: f64 = buffer.iter().map(|&b| weight[b as usize]).sum();
        let weigh = |b: u32| if total > 0.0 { weight[b as usize] } else { 1.0 };
        let half = if total > 0.0 { total } else { buffer.len() as f64 } / 2.0;
        let mut below = 0.0;
        for &b in &buffer {
            below += weigh(b);
            if below >= half {
                out[n + merge] = height[b as usize];
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::{Attributes, Shapes, Strings};
    use crate::geom::frame::Frame;
    use crate::geom::ring::{contains, convex_hull, doubled_area};

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
