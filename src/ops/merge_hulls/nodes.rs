//! The rings of the inner nodes, each from its children's, subtrees in parallel.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use super::leaves::Leaves;
use super::{Merge, MergeHulls};
use crate::artifact::Dendrogram;
use crate::geom::merge_rings::{Merger, Ring};
use crate::geom::outer_hull::{self, Simplifier};
use crate::geom::{Point, ring};

/// Rings of some clusters, in the order they were made.
#[derive(Default)]
pub struct Part {
    pub cluster: Vec<u32>,
    ends: Vec<u32>,
    pub rings: Vec<u32>,
    pub merged_edges: Vec<u32>,
    /// Edges of the ring after its simplification, without collinear vertices.
    edges: Vec<u32>,
}

impl Part {
    pub fn ring(&self, i: usize) -> &[u32] {
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

pub struct Work<'a> {
    pub tree: &'a Dendrogram,
    pub leaves: &'a Leaves,
    pub how: &'a MergeHulls,
    /// Once true, rings no longer matter.
    pub stop: &'a AtomicBool,
}

/// Subtrees of at most so many leaves are one piece of work.
const GRAIN: u32 = 256;

impl Work<'_> {
    /// All rings of a subtree; the last of the last part is the top's.
    pub fn subtree(&self, top: u32, parts: &mut Vec<Part>) {
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
        if self.stop.load(Relaxed) {
            return part.push(cluster, [], 0, 0);
        }
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
