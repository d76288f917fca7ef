//! The exact greedy order of a size-weighted single link, by local decisions.
//!
//! With every distance above zero the cost is *reducible*: a union is dearer to any third cluster than the cheaper
//! of its parts was. So two clusters that are each other's nearest, in the total order (cost, ranks), may merge at
//! any time, and sorting all merges by that order afterwards is the greedy order. Two schedules use this: rounds
//! (all mutual nearest pairs at once, in parallel) while a round merges enough, then chains (each cluster leads to
//! its nearest until two are mutual), which no input can slow down.
//!
//! A cluster's nearest is found from its members. A member keeps what its last search found: the nearest foreign
//! site, or a lower bound of what any may cost. Sizes only grow and the foreign sites only get fewer, so these never
//! become too high, and most members are passed over by one comparison.

use std::cell::RefCell;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

use crate::geom::nearest::{Bounds, Tree};

/// Things with a distance, 0..n in the order of a tree's places.
pub trait Sites: Sync {
    /// What a search from one site carries along.
    type Probe: Copy;
    fn len(&self) -> usize;
    fn bounds(&self, x: usize) -> Bounds;
    fn probe(&self, x: usize) -> Self::Probe;
    /// No site in the box has a smaller squared distance (before rounding the root, before the floor).
    fn square_to_box(&self, probe: Self::Probe, bounds: &Bounds) -> f64;
    /// The same for one site.
    fn square_to(&self, probe: Self::Probe, y: usize) -> f64;
    /// Millimetres, symmetric to the last bit; none where the two do not see each other.
    fn distance(&self, x: usize, y: usize, square: f64) -> Option<f64>;
    /// True where two sites have the same distance to everything.
    fn same(&self, x: usize, y: usize) -> bool;
    /// True where a root of `square_to_box` is never above the distances below it, by not even one rounding.
    const EXACT: bool;
    /// Every distance is at least this, above 0.
    fn floor(&self) -> f64;
}

/// One merge: of all pairs at that moment the first in the order (cost, low, high).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merge {
    /// (size * size) * distance, in millimetres.
    pub cost: f64,
    pub distance: f64,
    /// The lowest rank of either cluster, the lower one first.
    pub low: u32,
    pub high: u32,
}

const NONE: u32 = u32::MAX;
/// Relative slack where two ways of rounding meet. A few roundings make 1e-15.
const SLACK: f64 = 1e-12;
/// How far beyond what matters now a search looks, so that it need not be repeated soon.
const BEYOND: f64 = 2.0;
/// Rounds go on while they merge at least one cluster in this many.
const ROUNDS: usize = 33;

/// Merges sites until none sees a foreign one, and returns the merges in no particular order, but always the same.
///
/// `ranks` are distinct, one a site. Sites with the same entry in `together` begin as one cluster.
pub fn join<S: Sites>(sites: &S, tree: &Tree, ranks: &[u32], together: Option<&[u32]>) -> Vec<Merge> {
    let mut forest = Forest::new(sites, tree, ranks, together);
    let mut merges = Vec::with_capacity(sites.len().saturating_sub(1));
    let mut live = forest.heads();
    while live.len() > 1 {
        let pairs = forest.mutual(&live);
        let few = pairs.len() * ROUNDS < live.len();
        merges.par_extend(pairs.par_iter().map(|&[a, b]| forest.merge(a as usize, b as usize)));
        forest.refresh();
        live.retain(|&c| forest.members[c as usize].of.load(Relaxed) == c && !forest.alone(c as usize));
        if few {
            break;
        }
    }
    forest.chains(&live, &mut merges);
    merges
}

/// A site as a member of its cluster. Clusters are named by their first member.
struct Member {
    of: AtomicU32,
    /// Size and lowest rank of the cluster.
    size: AtomicU32,
    rank: AtomicU32,
    /// The cluster's next member, ascending.
    next: AtomicU32,
}

/// What a site's last search found: the nearest foreign site and the size of its cluster then; or, without a
/// site, that nothing foreign has a smaller product of size and distance.
#[derive(Clone, Copy)]
struct Near {
    distance: f64,
    size: u32,
    to: u32,
}

/// A cluster's nearest, and the partner's size then: still true while that is its size. Without a partner: size 0
/// where nobody has looked, else 1: it sees nobody, and never will.
#[derive(Clone, Copy, PartialEq)]
struct Nearest {
    to: u32,
    size: u32,
    distance: f64,
}

#[derive(Clone, Copy)]
#[repr(align(32))]
struct Node {
    bounds: Bounds,
    /// The smallest cluster size below, and the lowest rank among clusters of that size: larger ones are dearer by
    /// more than any rounding, so that their ranks never decide.
    size: u32,
    rank: u32,
    /// The cluster of all that is below, where it is one.
    only: u32,
}

struct Forest<'a, S: Sites> {
    sites: &'a S,
    tree: &'a Tree,
    nodes: Vec<Node>,
    members: Vec<Member>,
    near: Vec<[AtomicU64; 2]>,
    nearest: Vec<[AtomicU64; 2]>,
}

impl<'a, S: Sites> Forest<'a, S> {
    fn new(sites: &'a S, tree: &'a Tree, ranks: &[u32], together: Option<&[u32]>) -> Self {
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

    fn heads(&self) -> Vec<u32> {
        (0..self.members.len() as u32).filter(|&c| self.members[c as usize].of.load(Relaxed) == c).collect()
    }

    // --------------------------------------------------------------------------------------------------- rounds

    /// All pairs of mutual nearest clusters, the first member's cluster first.
    fn mutual(&self, live: &[u32]) -> Vec<[u32; 2]> {
        live.par_iter().with_min_len(64).for_each(|&c| {
            self.nearest_of(c as usize);
        });
        let partner = |c: u32| Nearest::load(&self.nearest[c as usize]).to;
        live.par_iter()
            .with_min_len(1024)
            .filter_map(|&c| {
                let to = partner(c);
                (to != NONE && c < to && partner(to) == c).then_some([c, to])
            })
            .collect()
    }

    /// The cluster's nearest, searched anew where its partner has changed.
    fn nearest_of(&self, c: usize) -> Nearest {
        let known = Nearest::load(&self.nearest[c]);
        if known.to != NONE {
            let partner = &self.members[known.to as usize];
            if partner.of.load(Relaxed) == known.to && partner.size.load(Relaxed) == known.size {
                return known;
            }
        } else if known.size == 1 {
            return known;
        }
        let found = self.search(c);
        found.store(&self.nearest[c]);
        found
    }

    fn alone(&self, c: usize) -> bool {
        let known = Nearest::load(&self.nearest[c]);
        known.to == NONE && known.size == 1
    }

    /// Makes one cluster of two. Touches nothing but their members.
    fn merge(&self, a: usize, b: usize) -> Merge {
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
    fn refresh(&mut self) {
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

    // --------------------------------------------------------------------------------------------------- chains

    /// From each cluster to its nearest, until two are mutual; then on from what they have become. To go back to
    /// where the chain began would search a large cluster anew after every merge of small ones beside it.
    fn chains(&mut self, live: &[u32], merges: &mut Vec<Merge>) {
        for &start in live {
            if self.members[start as usize].of.load(Relaxed) != start {
                continue;
            }
            let mut at = start;
            loop {
                let nearest = self.nearest_of(at as usize).to;
                if nearest == NONE {
                    // Sees nobody; so nobody leads here.
                    break;
                }
                if self.nearest_of(nearest as usize).to == at {
                    merges.push(self.merge(at as usize, nearest as usize));
                    at = at.min(nearest);
                    self.refresh_along(at as usize);
                } else {
                    at = nearest;
                }
            }
        }
    }

    /// `refresh` for the nodes above one cluster's members.
    fn refresh_along(&mut self, c: usize) {
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

    // ------------------------------------------------------------------------------------------------- searches

    fn search(&self, c: usize) -> Nearest {
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

#[inline]
fn cost(a: u32, b: u32, distance: f64) -> f64 {
    (u64::from(a) * u64::from(b)) as f64 * distance
}

/// A candidate for a cluster's nearest; ordered by cost, rank, distance.
#[derive(Clone, Copy)]
struct Found {
    cost: f64,
    rank: u32,
    distance: f64,
    of: u32,
    size: u32,
    /// The site of that cluster.
    at: u32,
}

impl Found {
    const NOTHING: Self =
        Self { cost: f64::INFINITY, rank: NONE, distance: f64::INFINITY, of: NONE, size: 1, at: NONE };

    #[inline]
    fn before(&self, cost: f64, rank: u32, distance: f64) -> bool {
        (self.cost, self.rank, self.distance) <= (cost, rank, distance)
    }

    #[inline]
    fn offer(&mut self, other: Self) {
        if !self.before(other.cost, other.rank, other.distance) {
            *self = other;
        }
    }
}

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
        askers.extend(todo.iter().filter(|t| !self.beyond(t.0)).map(|t| Asker::new(self, t.1, reach)));
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

/// One member that searches for its nearest foreign site.
struct Asker {
    x: u32,
    /// Squared product of size and distance above which nothing is of interest, with slack.
    limit: f64,
    /// The limit without slack, not squared.
    reach: f64,
    best: Found,
    /// The smallest product of size and distance passed over that may yet come before `best` when the own size
    /// has changed, because the order of two near ties can hang on its rounding.
    rival: f64,
}

impl Asker {
    fn new<S: Sites>(_: &Search<S>, x: u32, reach: f64) -> Self {
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
    fn near(&self) -> Near {
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
struct Query<'a, S: Sites> {
    forest: &'a Forest<'a, S>,
    own: u32,
    own_size: u32,
    bounds: Bounds,
    askers: &'a mut Vec<Asker>,
    /// The highest of the askers' limits.
    limit: f64,
}

impl<S: Sites> Query<'_, S> {
    fn run(&mut self, from: usize, stack: &mut Vec<(f64, usize)>) {
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
        self.askers.iter_mut().fold(true, |all, asker| asker.passes(forest, size, node) && all)
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
struct Probe<'a, S: Sites> {
    forest: &'a Forest<'a, S>,
    own: u32,
    bounds: Bounds,
}

impl<S: Sites> Probe<'_, S> {
    /// A lower bound of the product of size and distance to anything foreign, for all in the box; `reach` where
    /// that is lower. `from` holds nothing foreign.
    fn least_product(&self, from: usize, reach: f64, stack: &mut Vec<(f64, usize)>) -> f64 {
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
    fn load(from: &[AtomicU64; 2]) -> Self {
        let low = from[1].load(Relaxed);
        Self { distance: f64::from_bits(from[0].load(Relaxed)), size: (low >> 32) as u32, to: low as u32 }
    }
    #[inline]
    fn store(self, to: &[AtomicU64; 2]) {
        to[0].store(self.distance.to_bits(), Relaxed);
        to[1].store(u64::from(self.size) << 32 | u64::from(self.to), Relaxed);
    }
}

impl Nearest {
    #[inline]
    fn load(from: &[AtomicU64; 2]) -> Self {
        let Near { distance, size, to } = Near::load(from);
        Self { to, size, distance }
    }
    #[inline]
    fn store(self, to: &[AtomicU64; 2]) {
        Near { distance: self.distance, size: self.size, to: self.to }.store(to);
    }
}
