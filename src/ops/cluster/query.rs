//! Queries of the tree: members that lie close together ask for what is foreign and near.

use std::sync::atomic::Ordering::Relaxed;

use super::forest::{Forest, NONE, Near, Node, cost};
use super::join::Sites;
use crate::geom::bounds::Bounds;

/// Relative slack where two ways of rounding meet. A few roundings make 1e-15.
pub const SLACK: f64 = 1e-12;
/// How far beyond what matters now a search looks, so that it need not be repeated soon.
pub const BEYOND: f64 = 2.0;

/// A candidate for a cluster's nearest; ordered by cost, rank, distance.
#[derive(Clone, Copy)]
pub struct Found {
    pub cost: f64,
    pub rank: u32,
    pub distance: f64,
    pub of: u32,
    pub size: u32,
    /// The site of that cluster.
    pub at: u32,
}

impl Found {
    pub const NOTHING: Self =
        Self { cost: f64::INFINITY, rank: NONE, distance: f64::INFINITY, of: NONE, size: 1, at: NONE };

    #[inline]
    fn before(&self, cost: f64, rank: u32, distance: f64) -> bool {
        (self.cost, self.rank, self.distance) <= (cost, rank, distance)
    }

    #[inline]
    pub fn offer(&mut self, other: Self) {
        if !self.before(other.cost, other.rank, other.distance) {
            *self = other;
        }
    }
}

/// One member that searches for its nearest foreign site.
pub struct Asker {
    pub x: u32,
    /// Squared product of size and distance above which nothing is of interest, with slack.
    pub limit: f64,
    /// The limit without slack, not squared.
    reach: f64,
    pub best: Found,
    /// The smallest product of size and distance passed over that may yet come before `best` when the own size
    /// has changed, because the order of two near ties can hang on its rounding.
    rival: f64,
}

impl Asker {
    pub fn new(x: u32, reach: f64) -> Self {
        let mut out = Self { x, limit: 0.0, reach, best: Found::NOTHING, rival: f64::INFINITY };
        out.narrow(reach);
        out
    }

    #[inline]
    fn narrow(&mut self, reach: f64) {
        self.reach = reach;
        self.limit = squared(reach);
    }

    /// What is to be remembered of the search.
    pub fn near(&self) -> Near {
        let best = &self.best;
        if best.of == NONE {
            return Near { distance: self.reach, size: 1, to: NONE };
        }
        let product = f64::from(best.size) * best.distance;
        if self.rival <= product * (1.0 + 4.0 * SLACK) {
            return Near { distance: product * (1.0 - SLACK), size: 1, to: NONE };
        }
        Near { distance: best.distance, size: best.size, to: best.at }
    }

    /// Remembers a rival that is not behind the best in size, rank and distance alike.
    #[inline]
    fn passing(&mut self, size: u32, rank: u32, distance: f64) {
        let best = &self.best;
        if size < best.size || rank < best.rank || distance < best.distance {
            self.rival = self.rival.min(f64::from(size) * distance);
        }
    }

    /// True where a node within the slack of the limit holds nothing better.
    fn passes<S: Sites>(&mut self, forest: &Forest<S>, own_size: u32, node: &Node) -> bool {
        let sites = forest.sites;
        let square = sites.square_to_box(sites.probe(self.x as usize), &node.bounds);
        if product_squared(node.size, square, sites.floor()) > self.limit {
            return true;
        }
        if self.best.of == NONE {
            return false;
        }
        let slack = if S::EXACT { 1.0 } else { 1.0 - SLACK };
        let distance = (square.sqrt() * slack).max(sites.floor());
        let passed = self.best.before(cost(own_size, node.size, distance), node.rank, distance);
        if passed {
            self.passing(node.size, node.rank, distance);
        }
        passed
    }
}

/// Squared, with slack for the roundings of products and squares.
#[inline]
fn squared(reach: f64) -> f64 {
    reach * reach * (1.0 + 8.0 * SLACK)
}

#[inline]
fn product_squared(size: u32, square: f64, floor: f64) -> f64 {
    let size = f64::from(size);
    size * size * square.max(floor * floor * (1.0 - SLACK))
}

/// The search of one cluster's members that lie close together.
pub struct Query<'a, S: Sites> {
    pub forest: &'a Forest<'a, S>,
    pub own: u32,
    pub own_size: u32,
    pub bounds: Bounds,
    pub askers: &'a mut Vec<Asker>,
    /// The highest of the askers' limits.
    pub limit: f64,
}

impl<S: Sites> Query<'_, S> {
    pub fn run(&mut self, from: usize, stack: &mut Vec<(f64, usize)>) {
        if self.forest.nodes[from].only != self.own {
            self.scan(from);
        }
        let mut i = from;
        while i > 1 {
            self.descend(i ^ 1, stack);
            i /= 2;
        }
    }

    /// Squared product of size and distance, at least, below a node.
    #[inline]
    fn least(&self, node: &Node) -> f64 {
        product_squared(node.size, self.bounds.square_to(&node.bounds), self.forest.sites.floor())
    }

    fn descend(&mut self, from: usize, stack: &mut Vec<(f64, usize)>) {
        let (nodes, leaves) = (&self.forest.nodes, self.forest.tree.leaves);
        stack.push((self.least(&nodes[from]), from));
        while let Some((least, mut i)) = stack.pop() {
            if self.passed(least, i) {
                continue;
            }
            // The nearer child first; of equals, the one with the lower rank.
            while i < leaves {
                let (a, b) = (&nodes[2 * i], &nodes[2 * i + 1]);
                let (la, lb) = (self.least(a), self.least(b));
                let a_first = (la, a.rank) <= (lb, b.rank);
                let (near, far) = if a_first { ((la, 2 * i), (lb, 2 * i + 1)) } else { ((lb, 2 * i + 1), (la, 2 * i)) };
                if far.0 <= self.limit {
                    stack.push(far);
                }
                i = near.1;
                if self.passed(near.0, i) {
                    i = 0;
                    break;
                }
            }
            if i > 0 {
                self.scan(i);
            }
        }
    }

    /// True where a node holds nothing better than what is known.
    #[inline]
    fn passed(&mut self, least: f64, i: usize) -> bool {
        if least > self.limit {
            return true;
        }
        let node = &self.forest.nodes[i];
        if node.only == self.own || node.size == NONE {
            return true;
        }
        // Only near ties are worth a closer look.
        if least * (1.0 + 16.0 * SLACK) < self.limit {
            return false;
        }
        let (forest, size) = (self.forest, self.own_size);
        let mut all = true;
        // Everyone is asked: each notes what it saw.
        for asker in self.askers.iter_mut() {
            all &= asker.passes(forest, size, node);
        }
        all
    }

    fn scan(&mut self, leaf: usize) {
        let forest = self.forest;
        let node = &forest.nodes[leaf];
        let places = forest.tree.places(leaf - forest.tree.leaves);
        let mut narrowed = false;
        let mut least_cost = f64::INFINITY;
        for asker in &mut *self.askers {
            if asker.passes(forest, self.own_size, node) {
                continue;
            }
            let probe = forest.sites.probe(asker.x as usize);
            let far = asker.limit / (f64::from(node.size) * f64::from(node.size)) * (1.0 + SLACK);
            for y in places.clone() {
                let square = forest.sites.square_to(probe, y);
                if square > far {
                    continue;
                }
                let other = &forest.members[y];
                let of = other.of.load(Relaxed);
                if of == self.own {
                    continue;
                }
                let theirs = other.size.load(Relaxed);
                if product_squared(theirs, square, forest.sites.floor()) > asker.limit {
                    continue;
                }
                let Some(distance) = forest.sites.distance(asker.x as usize, y, square) else { continue };
                let found = Found {
                    cost: cost(self.own_size, theirs, distance),
                    rank: other.rank.load(Relaxed),
                    distance,
                    of,
                    size: theirs,
                    at: y as u32,
                };
                let product = f64::from(theirs) * distance;
                if asker.best.of == NONE {
                    if product > asker.reach * (1.0 + SLACK) {
                        continue;
                    }
                    asker.best = found;
                } else if asker.best.before(found.cost, found.rank, found.distance) {
                    asker.passing(found.size, found.rank, found.distance);
                    continue;
                } else {
                    let old = std::mem::replace(&mut asker.best, found);
                    asker.passing(old.size, old.rank, old.distance);
                }
                asker.narrow(product);
                least_cost = least_cost.min(found.cost);
                narrowed = true;
            }
        }
        if narrowed {
            // What one has found tells the others how far to look.
            let reach = least_cost / f64::from(self.own_size) * BEYOND;
            self.limit = 0.0;
            for asker in &mut *self.askers {
                if asker.best.of == NONE && reach < asker.reach {
                    asker.narrow(reach);
                }
                self.limit = self.limit.max(asker.limit);
            }
        }
    }
}

/// A box in search of how near anything foreign is to it.
pub struct Probe<'a, S: Sites> {
    pub forest: &'a Forest<'a, S>,
    pub own: u32,
    pub bounds: Bounds,
}

impl<S: Sites> Probe<'_, S> {
    /// A lower bound of the product of size and distance to anything foreign, for all in the box; `reach` where
    /// that is lower. `from` holds nothing foreign.
    pub fn least_product(&self, from: usize, reach: f64, stack: &mut Vec<(f64, usize)>) -> f64 {
        let (nodes, tree, floor) = (&self.forest.nodes, self.forest.tree, self.forest.sites.floor());
        let least = |i: usize| product_squared(nodes[i].size, self.bounds.square_to(&nodes[i].bounds), floor);
        let mut limit = reach * reach;
        let mut i = from;
        while i > 1 {
            stack.push((least(i ^ 1), i ^ 1));
            while let Some((low, at)) = stack.pop() {
                if low >= limit || nodes[at].only == self.own {
                    continue;
                }
                if at >= tree.leaves {
                    for y in tree.places(at - tree.leaves) {
                        let other = &self.forest.members[y];
                        if other.of.load(Relaxed) != self.own {
                            let square = self.bounds.square_to(&self.forest.sites.bounds(y));
                            limit = limit.min(product_squared(other.size.load(Relaxed), square, floor));
                        }
                    }
                    continue;
                }
                let (a, b) = ((least(2 * at), 2 * at), (least(2 * at + 1), 2 * at + 1));
                let (near, far) = if a.0 <= b.0 { (a, b) } else { (b, a) };
                stack.push(far);
                stack.push(near);
            }
            i /= 2;
        }
        limit.sqrt()
    }
}
