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
use crate::geom::merge_rings::{Vertex, merge};
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
            let message = format!("the dendrogram is over {} buildings, the footprints are {}", tree.leaf_count(), footprints.len());
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
    let mut parts = Vec::new();
    if let Some(root) = tree.root() {
        work.subtree(root, &mut parts);
    }

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
        vertices: leaves.vertices.clone(),
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
    measure(&mut hulls, footprints, tree, how.height, &leaves.crossed);
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
                let mut hull: Vec<Vertex> = Vec::new();
                let mut cause = None;
                for shell in shapes.shells(b) {
                    let (mine, rest) = numbers.split_at(shell.len());
                    numbers = rest;
                    let outline: Vec<Vertex> = mine.iter().zip(shell).map(|(&id, &at)| Vertex { id, at }).collect();
                    let (outline, why) = clean(outline);
                    cause = cause.or(why);
                    hull = match (hull.is_empty(), outline.is_empty()) {
                        (true, _) => outline,
                        (false, true) => hull,
                        (false, false) => merge(&hull, &outline),
                    };
                }
                if hull.is_empty() {
                    cause = Some(NO_AREA);
                }
                (hull.iter().map(|v| v.id).collect(), cause)
            })
            .collect();
        let mut leaves = Self { vertices, starts: vec![0], rings: Vec::with_capacity(numbers.len()), repairs: Vec::new(), crossed: Vec::new() };
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
fn clean(mut outline: Vec<Vertex>) -> (Vec<Vertex>, Option<&'static str>) {
    outline.dedup_by_key(|v| v.at);
    while outline.len() > 1 && outline[0].at == outline[outline.len() - 1].at {
        outline.pop();
    }
    let points: Vec<Point> = outline.iter().map(|v| v.at).collect();
    if outline.len() >= 3 && is_simple(&points) {
        if ring::doubled_area(&points) < 0 {
            outline.reverse();
        }
        return (outline, None);
    }
    match erode::around(&points) {
        Some(places) => (places.iter().map(|&i| outline[i as usize]).collect(), Some(CROSSED)),
        None => (Vec::new(), Some(NO_AREA)),
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
    fn push(&mut self, cluster: u32, ring: impl IntoIterator<Item = u32>, merged_edges: u32, edges: u32) {
        self.cluster.push(cluster);
        self.rings.extend(ring);
        self.ends.push(self.rings.len() as u32);
        self.merged_edges.push(merged_edges);
        self.edges.push(edges);
    }
}

/// A child as its parent sees it.
#[derive(Clone, Copy)]
struct Child<'a> {
    ring: &'a [u32],
    edges: u32,
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
                let last = |parts: &[Part]| parts.len() - 1;
                let mut part = Part::default();
                {
                    let child = |part: &Part| -> (Vec<u32>, u32) {
                        let i = part.cluster.len() - 1;
                        (part.ring(i).to_vec(), part.edges[i])
                    };
                    let (l, r) = (child(&parts[last(parts)]), child(&others[last(&others)]));
                    self.node(top, Child { ring: &l.0, edges: l.1 }, Child { ring: &r.0, edges: r.1 }, &mut part);
                }
                parts.append(&mut others);
                parts.push(part);
            }
            _ => parts.push(self.sequential(top)),
        }
    }

    fn sequential(&self, top: u32) -> Part {
        let mut part = Part::default();
        let mut todo = vec![(top, false)];
        let mut done: Vec<usize> = Vec::new();
        while let Some((cluster, ready)) = todo.pop() {
            match self.tree.children(cluster) {
                None => {
                    let ring = self.leaves.ring(cluster);
                    let edges = self.edges_of(ring);
                    part.push(cluster, ring.iter().copied(), edges, edges);
                }
                Some([left, right]) if !ready => {
                    todo.extend([(cluster, true), (right, false), (left, false)]);
                    continue;
                }
                Some(_) => {
                    let (r, l) = (done.pop().expect("two children"), done.pop().expect("two children"));
                    let mut one = Part::default();
                    let child = |i: usize| Child { ring: part.ring(i), edges: part.edges[i] };
                    self.node(cluster, child(l), child(r), &mut one);
                    part.push(cluster, one.rings, one.merged_edges[0], one.edges[0]);
                }
            }
            done.push(part.cluster.len() - 1);
        }
        part
    }

    fn vertices(&self, ring: &[u32]) -> Vec<Vertex> {
        ring.iter().map(|&id| Vertex { id, at: self.leaves.vertices[id as usize] }).collect()
    }

    fn edges_of(&self, ring: &[u32]) -> u32 {
        let points: Vec<Point> = ring.iter().map(|&id| self.leaves.vertices[id as usize]).collect();
        ring::edges_without_collinear(&points) as u32
    }

    /// The ring of one inner node.
    fn node(&self, cluster: u32, left: Child, right: Child, part: &mut Part) {
        if left.ring.is_empty() || right.ring.is_empty() {
            let only = if left.ring.is_empty() { right } else { left };
            part.push(cluster, only.ring.iter().copied(), only.edges, only.edges);
            return;
        }
        let merged = merge(&self.vertices(left.ring), &self.vertices(right.ring));
        let points: Vec<Point> = merged.iter().map(|v| v.at).collect();
        let own = ring::edges_without_collinear(&points) as u32;
        if self.how.merge == Merge::Source {
            part.push(cluster, merged.iter().map(|v| v.id), own, own);
            return;
        }
        let ids: Vec<u32> = merged.iter().map(|v| v.id).collect();
        let target = outer_hull::target(self.how.keep, left.edges + right.edges, self.how.floor, own);
        let mut kept = Vec::new();
        outer_hull::keep(&points, &ids, target, &mut kept);
        part.push(cluster, kept.iter().map(|&i| ids[i as usize]), own, kept.len() as u32);
    }
}

// ------------------------------------------------------------------------------------------------------- sizes

/// Fills areas, negative space and heights.
fn measure(hulls: &mut Hulls, footprints: &Footprints, tree: &Dendrogram, height: Height, crossed: &[bool]) {
    let n = tree.leaf_count();
    let (order, first) = tree.leaf_order();
    let (order, first) = (&order[..], &first[..]);
    let shapes = &footprints.polygons;
    let polygons = |b: usize| -> Vec<Polygon> {
        let polygon = |p: usize| {
            let mut rings = shapes.rings_of(p).map(|r| shapes.ring(r));
            Some(Polygon { shell: rings.next()?, holes: rings.collect() })
        };
        shapes.polygons_of(b).filter_map(polygon).collect()
    };
    let own: Vec<f64> =
        (0..n).into_par_iter().map(|b| overlaps::built_area(&polygons(b), !crossed[b])).collect();
    let size: Vec<u32> = hulls.buildings.clone();
    let by_place: Vec<f64> = order.iter().map(|&b| own[b as usize]).collect();
    let by = overlaps::Tree { first, size: &size, parent: &hulls.parent, leaf: order };
    let twice = overlaps::covered_twice(&by, &by_place, &|place| polygons(order[place] as usize));

    // Doubled square millimetres: whole numbers, so sums are exact.
    let mut built = own.clone();
    built.extend(tree.left.iter().map(|_| 0.0));
    let mut sums: Vec<[f64; 3]> = (0..n)
        .map(|b| {
            let (ground, above) = (footprints.base[b], footprints.top[b] - footprints.base[b]);
            [own[b], own[b] * ground, own[b] * above]
        })
        .collect();
    let mut plain: Vec<[f64; 2]> = (0..n).map(|b| [footprints.base[b], footprints.top[b] - footprints.base[b]]).collect();
    hulls.ground = footprints.base.clone();
    hulls.height = plain.iter().map(|p| p[1]).collect();
    for (merge, (&l, &r)) in tree.left.iter().zip(&tree.right).enumerate() {
        let (l, r) = (l as usize, r as usize);
        built[n + merge] = built[l] + built[r] - twice[n + merge];
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
        let above: Vec<f64> = (0..n).map(|b| footprints.top[b] - footprints.base[b]).collect();
        medians(&mut hulls.height, tree, order, first, &own, &above);
    }
    let areas: Vec<f64> = (0..hulls.len())
        .into_par_iter()
        .map(|i| ring::doubled_area(&hulls.points(i).collect::<Vec<_>>()) as f64)
        .collect();
    hulls.negative_space_m2 = areas.iter().zip(&built).map(|(a, b)| (a - b).max(0.0) / 2e6).collect();
    hulls.area_m2 = areas.iter().map(|a| a / 2e6).collect();
}

/// Area-weighted medians: the leaves of every cluster sorted by height, by merging its children's.
fn medians(out: &mut [f64], tree: &Dendrogram, order: &[u32], first: &[u32], weight: &[f64], height: &[f64]) {
    let n = order.len();
    let mut sorted = order.to_vec();
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
