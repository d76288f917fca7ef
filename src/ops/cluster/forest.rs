//! The clusters while they grow: members in ascending lists, and a summary of them in every node of the tree.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

use super::join::{Merge, Sites};
use crate::geom::bounds::Bounds;
use crate::geom::nearest::Tree;

pub const NONE: u32 = u32::MAX;

/// A site as a member of its cluster. Clusters are named by their first member.
pub struct Member {
    pub of: AtomicU32,
    /// Size and lowest rank of the cluster.
    pub size: AtomicU32,
    pub rank: AtomicU32,
    /// The cluster's next member, ascending.
    pub next: AtomicU32,
}

/// What a site's last search found: the nearest foreign site and the size of its cluster then; or, without a
/// site, that nothing foreign has a smaller product of size and distance.
#[derive(Clone, Copy)]
pub struct Near {
    pub distance: f64,
    pub size: u32,
    pub to: u32,
}

/// A cluster's nearest, and the partner's size then: still true while that is its size. Without a partner: size 0
/// where nobody has looked, else 1: it sees nobody, and never will.
#[derive(Clone, Copy, PartialEq)]
pub struct Nearest {
    pub to: u32,
    pub size: u32,
    pub distance: f64,
}

#[derive(Clone, Copy)]
#[repr(align(32))]
pub struct Node {
    pub bounds: Bounds,
    /// The smallest cluster size below, and the lowest rank among clusters of that size: larger ones are dearer by
    /// more than any rounding, so that their ranks never decide.
    pub size: u32,
    pub rank: u32,
    /// The cluster of all that is below, where it is one.
    pub only: u32,
}

pub struct Forest<'a, S: Sites> {
    pub sites: &'a S,
    pub tree: &'a Tree,
    pub nodes: Vec<Node>,
    pub members: Vec<Member>,
    pub near: Vec<[AtomicU64; 2]>,
    pub nearest: Vec<[AtomicU64; 2]>,
    stop: &'a AtomicBool,
}

impl<'a, S: Sites> Forest<'a, S> {
    pub fn new(sites: &'a S, tree: &'a Tree, ranks: &[u32], together: Option<&[u32]>, stop: &'a AtomicBool) -> Self {
        let n = sites.len();
        let member = |i: usize, rank: u32| Member {
            of: AtomicU32::new(i as u32),
            size: AtomicU32::new(1),
            rank: AtomicU32::new(rank),
            next: AtomicU32::new(NONE),
        };
        let pair = |_| [AtomicU64::new(0), AtomicU64::new(u64::from(NONE))];
        let mut out = Self {
            sites,
            tree,
            nodes: Vec::new(),
            members: ranks.iter().enumerate().map(|(i, &r)| member(i, r)).collect(),
            near: (0..n).map(pair).collect(),
            nearest: (0..n).map(pair).collect(),
            stop,
        };
        if let Some(together) = together {
            let mut sorted: Vec<(u32, u32)> = together.iter().zip(0..).map(|(&t, i)| (t, i)).collect();
            sorted.sort_unstable();
            for group in sorted.chunk_by(|a, b| a.0 == b.0) {
                let rank = group.iter().map(|&(_, i)| ranks[i as usize]).min().unwrap_or(NONE);
                for (k, &(_, i)) in group.iter().enumerate() {
                    let m = &out.members[i as usize];
                    m.of.store(group[0].1, Relaxed);
                    m.size.store(group.len() as u32, Relaxed);
                    m.rank.store(rank, Relaxed);
                    m.next.store(group.get(k + 1).map_or(NONE, |g| g.1), Relaxed);
                }
            }
        }
        let empty = Node { bounds: Bounds::EMPTY, size: NONE, rank: NONE, only: NONE };
        out.nodes = vec![empty; 2 * tree.leaves];
        for k in 0..tree.leaves {
            let bounds = tree.places(k).map(|x| sites.bounds(x)).fold(Bounds::EMPTY, |all, b| all.join(&b));
            out.nodes[tree.leaves + k].bounds = bounds;
        }
        for i in (1..tree.leaves).rev() {
            out.nodes[i].bounds = out.nodes[2 * i].bounds.join(&out.nodes[2 * i + 1].bounds);
        }
        out.refresh();
        out
    }

    /// True once nobody waits for the merges any more.
    pub fn stopped(&self) -> bool {
        self.stop.load(Relaxed)
    }

    pub fn heads(&self) -> Vec<u32> {
        (0..self.members.len() as u32).filter(|&c| self.members[c as usize].of.load(Relaxed) == c).collect()
    }

    /// Makes one cluster of two. Touches nothing but their members.
    pub fn merge(&self, a: usize, b: usize) -> Merge {
        let m = &self.members;
        let distance = Nearest::load(&self.nearest[a]).distance;
        let (sa, sb) = (m[a].size.load(Relaxed), m[b].size.load(Relaxed));
        let (ra, rb) = (m[a].rank.load(Relaxed), m[b].rank.load(Relaxed));
        let (low, high) = (ra.min(rb), ra.max(rb));
        let merge = Merge { cost: cost(sa, sb, distance), distance, low, high };
        // (1) Both lists ascend: so does the joint one.
        let head = a.min(b);
        let (mut x, mut y) = (a as u32, b as u32);
        let mut last = NONE;
        while x != NONE || y != NONE {
            let at = if x < y { &mut x } else { &mut y };
            let member = &m[*at as usize];
            member.of.store(head as u32, Relaxed);
            member.size.store(sa + sb, Relaxed);
            member.rank.store(low, Relaxed);
            if last != NONE {
                m[last as usize].next.store(*at, Relaxed);
            }
            last = *at;
            *at = member.next.load(Relaxed);
        }
        // (2) Its nearest is unknown.
        Nearest { to: NONE, size: 0, distance: 0.0 }.store(&self.nearest[head]);
        merge
    }

    /// What the nodes say of the clusters below them.
    pub fn refresh(&mut self) {
        let (members, tree) = (&self.members, self.tree);
        let (inner, leaves) = self.nodes.split_at_mut(tree.leaves);
        leaves.par_iter_mut().with_min_len(512).enumerate().for_each(|(k, node)| sum_up(node, k, members, tree));
        let mut below: &[Node] = leaves;
        let mut above = inner;
        while above.len() > 1 {
            let level;
            (above, level) = above.split_at_mut(above.len() / 2);
            level.par_iter_mut().with_min_len(2048).enumerate().for_each(|(k, node)| {
                join_up(node, &below[2 * k], &below[2 * k + 1]);
            });
            below = level;
        }
    }

    /// `refresh` for the nodes above one cluster's members.
    pub fn refresh_along(&mut self, c: usize) {
        let mut x = c as u32;
        let mut done = 0;
        while x != NONE {
            let leaf = self.tree.leaf_of(x as usize);
            x = self.members[x as usize].next.load(Relaxed);
            if leaf == done {
                continue;
            }
            done = leaf;
            let mut i = leaf;
            let mut node = self.nodes[i];
            sum_up(&mut node, i - self.tree.leaves, &self.members, self.tree);
            while node.summary() != self.nodes[i].summary() {
                self.nodes[i] = node;
                i /= 2;
                if i == 0 {
                    break;
                }
                node = self.nodes[i];
                join_up(&mut node, &self.nodes[2 * i], &self.nodes[2 * i + 1]);
            }
        }
    }
}

#[inline]
pub fn cost(a: u32, b: u32, distance: f64) -> f64 {
    (u64::from(a) * u64::from(b)) as f64 * distance
}

#[inline]
fn sum_up(node: &mut Node, k: usize, members: &[Member], tree: &Tree) {
    let mut least = (NONE, NONE);
    let mut only = NONE;
    for (i, m) in members[tree.places(k)].iter().enumerate() {
        least = least.min((m.size.load(Relaxed), m.rank.load(Relaxed)));
        let of = m.of.load(Relaxed);
        only = if i == 0 || only == of { of } else { NONE };
    }
    (node.size, node.rank, node.only) = (least.0, least.1, only);
}

#[inline]
fn join_up(node: &mut Node, a: &Node, b: &Node) {
    (node.size, node.rank) = (a.size, a.rank).min((b.size, b.rank));
    node.only = if a.only == b.only { a.only } else { NONE };
}

impl Node {
    fn summary(&self) -> [u32; 3] {
        [self.size, self.rank, self.only]
    }
}

impl Near {
    #[inline]
    pub fn load(from: &[AtomicU64; 2]) -> Self {
        let low = from[1].load(Relaxed);
        Self { distance: f64::from_bits(from[0].load(Relaxed)), size: (low >> 32) as u32, to: low as u32 }
    }
    #[inline]
    pub fn store(self, to: &[AtomicU64; 2]) {
        to[0].store(self.distance.to_bits(), Relaxed);
        to[1].store(u64::from(self.size) << 32 | u64::from(self.to), Relaxed);
    }
}

impl Nearest {
    #[inline]
    pub fn load(from: &[AtomicU64; 2]) -> Self {
        let Near { distance, size, to } = Near::load(from);
        Self { to, size, distance }
    }
    #[inline]
    pub fn store(self, to: &[AtomicU64; 2]) {
        Near { distance: self.distance, size: self.size, to: self.to }.store(to);
    }
}
