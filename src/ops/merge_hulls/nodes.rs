//! The rings of the clusters, each from its children's, subtrees in parallel.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use super::leaves::Leaves;
use super::walk::{GRAIN, Walk};
use super::{Merge, MergeHulls};
use crate::geom::exchange::Exchange;
use crate::geom::merge_rings::{Merger, Ring};
use crate::geom::outer_hull::{self, Simplifier};
use crate::geom::{Point, ring};

/// Of some places of the postorder, one after the other.
#[derive(Default)]
pub struct Part {
    /// Where each ring ends in `rings`; leaves' are not among them.
    ends: Vec<u32>,
    pub rings: Vec<u32>,
    pub merged_edges: Vec<u32>,
    /// Doubled areas, square millimetres.
    pub area: Vec<f64>,
    /// Edges of the last ring, simplified.
    edges: u32,
}

impl Part {
    pub fn len(&self) -> usize {
        self.ends.len()
    }
    /// The ring of an inner node.
    pub fn ring(&self, i: usize) -> &[u32] {
        let from = if i == 0 { 0 } else { self.ends[i - 1] };
        &self.rings[from as usize..self.ends[i] as usize]
    }
    /// After its vertices are appended to `rings`.
    fn end(&mut self, at: &[Point], merged_edges: u32) {
        self.ends.push(self.rings.len() as u32);
        self.merged_edges.push(merged_edges);
        self.area.push(ring::doubled_area(at) as f64);
    }
}

/// Working memory of one thread: rings that wait for their sibling, end to end.
#[derive(Default)]
struct Desk {
    merger: Merger,
    simplifier: Simplifier,
    exchange: Exchange,
    kept: Vec<u32>,
    at: Vec<Point>,
    ids: Vec<u32>,
    /// Of each ring where it begins, and its edges without collinear vertices.
    waiting: Vec<(usize, u32)>,
}

pub struct Work<'a> {
    pub walk: &'a Walk<'a>,
    pub leaves: &'a Leaves,
    pub how: &'a MergeHulls,
    /// Once true, rings no longer matter.
    pub stop: &'a AtomicBool,
}

impl Work<'_> {
    /// All of a subtree in postorder; the last of the last part is the top.
    pub fn subtree(&self, top: usize, parts: &mut Vec<Part>) {
        let Some(([left, right], _)) = self.walk.children(top).filter(|(_, [a, b])| a + b > GRAIN) else {
            return parts.push(self.sequential(top));
        };
        let mut others = Vec::new();
        rayon::join(|| self.subtree(left, parts), || self.subtree(right, &mut others));
        let (mut desk, mut part) = (Desk::default(), Part::default());
        for (place, parts) in [(left, &*parts), (right, &others)] {
            let last = &parts[parts.len() - 1];
            let ring = match self.walk.children(place) {
                None => self.leaves.ring(self.walk.postorder[place]),
                Some(_) => last.ring(last.len() - 1),
            };
            let from = desk.at.len();
            desk.waiting.push((from, last.edges));
            self.lay(ring, &mut desk);
        }
        self.node(&mut desk, &mut part);
        parts.append(&mut others);
        parts.push(part);
    }

    fn sequential(&self, top: usize) -> Part {
        let (mut desk, mut part) = (Desk::default(), Part::default());
        let places = self.walk.subtree(top);
        let many = places.clone().count();
        part.ends.reserve_exact(many);
        part.merged_edges.reserve_exact(many);
        part.area.reserve_exact(many);
        for place in places {
            if !self.walk.is_leaf(place) {
                self.node(&mut desk, &mut part);
                continue;
            }
            let from = desk.at.len();
            self.lay(self.leaves.ring(self.walk.postorder[place]), &mut desk);
            let edges = ring::edges_without_collinear(&desk.at[from..]) as u32;
            desk.waiting.push((from, edges));
            part.edges = edges;
            part.end(&desk.at[from..], edges);
        }
        part.rings.shrink_to_fit();
        part
    }

    /// Lays a ring on the desk.
    fn lay(&self, ring: &[u32], desk: &mut Desk) {
        desk.at.extend(ring.iter().map(|&id| self.leaves.vertices[id as usize]));
        desk.ids.extend_from_slice(ring);
    }

    /// Puts the ring around the two last on the desk in their place, and at the end of `part`.
    fn node(&self, desk: &mut Desk, part: &mut Part) {
        let (middle, right) = desk.waiting.pop().expect("two children");
        let (from, left) = desk.waiting.pop().expect("two children");
        if self.stop.load(Relaxed) {
            desk.at.truncate(from);
            desk.ids.truncate(from);
        }
        let (at, ids) = (&desk.at[from..], &desk.ids[from..]);
        let middle = middle.min(desk.at.len()) - from;
        let (mut edges, mut merged) = (left.max(right), left.max(right));
        // Where one of them is empty the other is already there.
        if middle > 0 && middle < at.len() {
            let merger = &mut desk.merger;
            merger.merge(
                Ring { at: &at[..middle], ids: &ids[..middle] },
                Ring { at: &at[middle..], ids: &ids[middle..] },
            );
            desk.at.truncate(from);
            desk.ids.truncate(from);
            merged = ring::edges_without_collinear(&merger.at) as u32;
            edges = merged;
            if self.how.merge == Merge::Source {
                desk.at.extend_from_slice(&merger.at);
                desk.ids.extend_from_slice(&merger.ids);
            } else {
                let target = outer_hull::target(self.how.keep, left + right, self.how.floor, merged);
                desk.simplifier.keep(&merger.at, &merger.ids, target, &mut desk.kept);
                desk.exchange.improve(&merger.at, &mut desk.kept);
                desk.at.extend(desk.kept.iter().map(|&i| merger.at[i as usize]));
                desk.ids.extend(desk.kept.iter().map(|&i| merger.ids[i as usize]));
                edges = desk.kept.len() as u32;
            }
        }
        desk.waiting.push((from, edges));
        part.edges = edges;
        part.rings.extend_from_slice(&desk.ids[from..]);
        part.end(&desk.at[from..], merged);
    }
}
