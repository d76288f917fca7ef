//! The search for the cluster nearest to one, from what its members remember.

use std::cell::RefCell;
use std::sync::atomic::Ordering::Relaxed;

use super::forest::{Forest, NONE, Near, Nearest, cost};
use super::join::Sites;
use super::query::{Asker, BEYOND, Found, Probe, Query, SLACK};
use crate::geom::bounds::Bounds;

impl<S: Sites> Forest<'_, S> {
    pub fn search(&self, c: usize) -> Nearest {
        SCRATCH.with_borrow_mut(|scratch| {
            let me = &self.members[c];
            let mut search = Search { forest: self, own: c as u32, size: me.size.load(Relaxed), best: Found::NOTHING };
            search.run(scratch);
            let best = search.best;
            Nearest { to: best.of, size: best.size, distance: best.distance }
        })
    }
}

/// Buffers that searches use again and again.
#[derive(Default)]
struct Scratch {
    /// Members to ask, ascending, with their bounds.
    todo: Vec<(f64, u32)>,
    groups: Vec<Group>,
    askers: Vec<Asker>,
    /// Nodes to visit.
    stack: Vec<(f64, usize)>,
}

/// Members that lie in one node.
struct Group {
    /// The lowest bound among them.
    bound: f64,
    node: usize,
    todo: std::ops::Range<usize>,
}

thread_local! { static SCRATCH: RefCell<Scratch> = RefCell::default(); }

/// The search for the nearest of one cluster.
struct Search<'a, S: Sites> {
    forest: &'a Forest<'a, S>,
    own: u32,
    size: u32,
    best: Found,
}

impl<S: Sites> Search<'_, S> {
    fn run(&mut self, scratch: &mut Scratch) {
        let Scratch { todo, groups, askers, stack } = scratch;
        // (1) What the members know already.
        todo.clear();
        self.remember(todo);
        // (2) The others ask the tree: together where they lie in one leaf, or in a node that is all theirs.
        groups.clear();
        let mut at = 0;
        while at < todo.len() {
            let (node, end) = self.node_of(todo, at);
            let bound = todo[at..end].iter().fold(f64::INFINITY, |least, t| least.min(t.0));
            groups.push(Group { bound, node, todo: at..end });
            at = end;
        }
        if groups.len() > 1 {
            groups.sort_unstable_by(|a, b| a.bound.total_cmp(&b.bound).then(a.node.cmp(&b.node)));
        }
        for group in &*groups {
            if self.beyond(group.bound) {
                break;
            }
            self.ask(&todo[group.todo.clone()], group.node, askers, stack);
        }
    }

    /// True where a product of size and distance is too high to matter.
    #[inline]
    fn beyond(&self, product: f64) -> bool {
        f64::from(self.size) * product * (1.0 - SLACK) > self.best.cost
    }

    fn remember(&mut self, todo: &mut Vec<(f64, u32)>) {
        let forest = self.forest;
        let mut last = NONE;
        let mut x = self.own;
        while x != NONE {
            let (at, before) = (x as usize, last);
            last = x;
            x = forest.members[at].next.load(Relaxed);
            if before != NONE && forest.sites.same(before as usize, at) {
                continue;
            }
            let near = Near::load(&forest.near[at]);
            let bound = f64::from(near.size) * near.distance;
            if self.beyond(bound) || bound == f64::INFINITY {
                continue;
            }
            if near.to != NONE {
                let other = &forest.members[near.to as usize];
                let of = other.of.load(Relaxed);
                if of != self.own {
                    let theirs = other.size.load(Relaxed);
                    self.best.offer(Found {
                        cost: cost(self.size, theirs, near.distance),
                        rank: other.rank.load(Relaxed),
                        distance: near.distance,
                        of,
                        size: theirs,
                        at: near.to,
                    });
                    if theirs == near.size {
                        continue;
                    }
                }
            }
            todo.push((bound, at as u32));
        }
    }

    /// The node that the member at `todo[from]` asks from, and the end of those that lie in it too.
    fn node_of(&self, todo: &[(f64, u32)], from: usize) -> (usize, usize) {
        let (tree, nodes) = (self.forest.tree, &self.forest.nodes);
        let mut node = tree.leaf_of(todo[from].1 as usize);
        while node > 1 && nodes[node / 2].only == self.own {
            node /= 2;
        }
        let past = tree.places_below(node).end;
        let count = todo[from..].iter().take_while(|t| (t.1 as usize) < past).count();
        (node, from + count)
    }

    fn ask(&mut self, todo: &[(f64, u32)], node: usize, askers: &mut Vec<Asker>, stack: &mut Vec<(f64, usize)>) {
        let forest = self.forest;
        let reach = self.best.cost / f64::from(self.size) * BEYOND;
        // (1) Many, among their own: perhaps nothing foreign is near enough for any of them.
        if node < forest.tree.leaves && todo.len() > 2 {
            let bounds = todo.iter().fold(Bounds::EMPTY, |all, t| all.join(&forest.sites.bounds(t.1 as usize)));
            let least = Probe { forest, own: self.own, bounds }.least_product(node, reach, stack);
            if self.beyond(least) {
                let near = Near { distance: least * (1.0 - SLACK), size: 1, to: NONE };
                todo.iter().for_each(|t| near.store(&forest.near[t.1 as usize]));
                return;
            }
            let middle = forest.tree.places_below(2 * node).end;
            let (left, right) = todo.split_at(todo.partition_point(|t| (t.1 as usize) < middle));
            for (todo, node) in [(left, 2 * node), (right, 2 * node + 1)] {
                if !todo.is_empty() {
                    self.ask(todo, node, askers, stack);
                }
            }
            return;
        }
        // (2) Few, or in a leaf: each keeps what it finds.
        askers.clear();
        askers.extend(todo.iter().filter(|t| !self.beyond(t.0)).map(|t| Asker::new(t.1, reach)));
        if askers.is_empty() {
            return;
        }
        let bounds = askers.iter().fold(Bounds::EMPTY, |all, a| all.join(&forest.sites.bounds(a.x as usize)));
        let limit = askers[0].limit;
        let mut query = Query { forest, own: self.own, own_size: self.size, bounds, askers, limit };
        query.run(node, stack);
        for asker in &*query.askers {
            asker.near().store(&forest.near[asker.x as usize]);
            self.best.offer(asker.best);
        }
    }
}
