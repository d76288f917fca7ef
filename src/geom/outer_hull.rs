//! Outer simplification of a simple ring: concave vertices go one by one, smallest added area first, so that the
//! ring only grows, towards its convex hull.
//!
//! Removing concave v keeps the ring simple if and only if no other vertex lies in the closed triangle
//! (previous, v, next): an edge could enter it only over the new edge and would have to end inside. So the index is
//! one of vertices, not of edges. A blocked vertex waits for the one that blocks it, or for a new neighbour.
//! Vertices between collinear neighbours add nothing and always go, whatever the target.
//!
//! Three ways to the same result: up to [`SMALL`] vertices by looking at all; then by a heap and a grid; from
//! [`LARGE`] on pocket by pocket (a pocket is the chain between two vertices of the convex hull), since what happens
//! in one pocket never matters to another: their orders are merged afterwards.
//! Source: Chang et al., Hierarchical Simplification of City Models to Maintain Urban Legibility, section 6;
//! order and stop as in GEOS' `PolygonHullSimplify` (outer, vertex count).

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rayon::prelude::*;

use super::Point;
use super::predicates::orient;
use super::segments::Rect;
use super::vertex_grid::{Grid, NONE, blocks};

const SMALL: usize = 48;
const LARGE: usize = 8192;
const NEVER: i64 = i64::MAX;
const GONE: Point = [i32::MIN; 2];

/// The ring with concave vertices removed until it has `target_edges`, or is convex. Simple, counter-clockwise
/// ring in, the same out; it contains the one given, its vertices are some of them. Ties: earlier vertex first.
pub fn simplify(ring: &[Point], target_edges: usize) -> Vec<Point> {
    let ids: Vec<u32> = (0..ring.len() as u32).collect();
    let mut kept = Vec::new();
    Simplifier::default().keep(ring, &ids, target_edges, &mut kept);
    kept.iter().map(|&i| ring[i as usize]).collect()
}

/// When a ring is simple enough: at that many edges, or when the next step would add more than `single`, or all steps
/// together more than `total` (doubled square millimetres).
pub struct Stop {
    pub edges: usize,
    pub single: i64,
    pub total: i64,
}

impl Stop {
    fn at(edges: usize) -> Self {
        Self { edges, single: i64::MAX, total: i64::MAX }
    }
}

/// How many edges a ring keeps: a share of `of` edges, at least another of its `own`, rounded up.
pub fn target(keep: f64, of: u32, floor: f64, own: u32) -> usize {
    // A share that is whole but for rounding is whole.
    let share = |part: f64, edges: u32| (part * f64::from(edges) - 1e-9).ceil() as usize;
    share(keep, of).max(share(floor, own))
}

/// Twice what removing v between a and b adds; negative where v is convex.
#[inline]
fn added(a: Point, v: Point, b: Point) -> i64 {
    -orient(a, v, b)
}

/// Working memory for many rings, one after the other.
#[derive(Default)]
pub struct Simplifier {
    chain: Chain,
}

impl Simplifier {
    /// As [`simplify`]: the places of the vertices that stay, ascending. Ties are broken by smaller `ids`.
    pub fn keep(&mut self, ring: &[Point], ids: &[u32], target: usize, kept: &mut Vec<u32>) {
        kept.clear();
        if ring.len() <= SMALL {
            small(ring, ids, target, kept);
        } else if ring.len() < LARGE {
            let all = 0..ring.len() as u32;
            self.chain.set(ring, all.clone(), ids);
            self.chain.run(&Stop::at(target), true);
            kept.extend(all.filter(|&i| self.chain.next[i as usize] != NONE));
        } else {
            pockets(ring, ids, target, kept);
        }
    }
}

impl Simplifier {
    /// As [`Self::keep`], with more ways to stop; ties go to the earlier vertex. A clockwise ring loses convex
    /// vertices instead and shrinks.
    pub fn keep_within(&mut self, ring: &[Point], stop: &Stop, kept: &mut Vec<u32>) {
        let all: Vec<u32> = (0..ring.len() as u32).collect();
        self.chain.set(ring, all.iter().copied(), &all);
        self.chain.run(stop, true);
        kept.clear();
        kept.extend(all.into_iter().filter(|&i| self.chain.next[i as usize] != NONE));
    }
}

/// Looks at all vertices for every one that goes.
fn small(ring: &[Point], ids: &[u32], target: usize, kept: &mut Vec<u32>) {
    let n = ring.len();
    // What removal adds, the same where it may go now, and where it is (far away once it is gone).
    let mut key = [0i64; SMALL];
    let mut open = [NEVER; SMALL];
    let mut at = [GONE; SMALL];
    let (mut prev, mut next) = ([0u8; SMALL], [0u8; SMALL]);
    // Who waits, as bits, and on whom.
    let (mut waiting, mut waits) = (0u64, [0u8; SMALL]);
    at[..n].copy_from_slice(ring);
    for i in 0..n {
        let (a, b) = (if i == 0 { n - 1 } else { i - 1 }, if i + 1 == n { 0 } else { i + 1 });
        (prev[i], next[i]) = (a as u8, b as u8);
        key[i] = added(ring[a], ring[i], ring[b]);
        open[i] = if key[i] < 0 { NEVER } else { key[i] };
    }
    let mut left = n;
    while left > 3 {
        let area = open[..n].iter().fold(NEVER, |least, &a| least.min(a));
        if area == NEVER || (area > 0 && left <= target) {
            break;
        }
        let equal = (0..n).filter(|&i| open[i] == area);
        let Some(i) = equal.min_by_key(|&i| ids[i]) else { break };
        let (a, b) = (usize::from(prev[i]), usize::from(next[i]));
        if area > 0 {
            let rect = Rect::of([at[a], at[i], at[b]]);
            let blocker =
                |&j: &usize| rect.holds(at[j]) && ![a, i, b].contains(&j) && blocks(at[a], at[i], at[b], at[j]);
            if let Some(by) = (0..n).find(blocker) {
                waits[i] = by as u8;
                waiting |= 1 << i;
                open[i] = NEVER;
                continue;
            }
        }
        left -= 1;
        (at[i], open[i]) = (GONE, NEVER);
        (next[a], prev[b]) = (b as u8, a as u8);
        let mut others = waiting;
        while others != 0 {
            let j = others.trailing_zeros() as usize;
            others &= others - 1;
            if usize::from(waits[j]) == i {
                waiting &= !(1 << j);
                open[j] = key[j];
            }
        }
        for j in [a, b] {
            key[j] = added(at[usize::from(prev[j])], at[j], at[usize::from(next[j])]);
            open[j] = if key[j] < 0 { NEVER } else { key[j] };
            waiting &= !(1 << j);
        }
    }
    kept.extend((0..n as u32).filter(|&i| at[i as usize] != GONE));
}

/// A ring, or a chain between two fixed ends, under simplification.
#[derive(Default)]
struct Chain {
    at: Vec<Point>,
    ids: Vec<u32>,
    prev: Vec<u32>,
    /// `NONE` once a vertex is gone.
    next: Vec<u32>,
    /// What removal adds, doubled; negative for what never goes.
    key: Vec<i64>,
    waits_on: Vec<u32>,
    /// Lists of who waits on whom, by index into `waiting`; entries may be out of date.
    waiters: Vec<u32>,
    waiting: Vec<(u32, u32)>,
    heap: BinaryHeap<Reverse<(i64, u32, u32)>>,
    grid: Grid,
    /// What went, in order.
    gone: Vec<u32>,
}

impl Chain {
    fn set(&mut self, ring: &[Point], places: impl ExactSizeIterator<Item = u32> + Clone, ids: &[u32]) {
        let n = places.len();
        self.at.clear();
        self.at.extend(places.clone().map(|i| ring[i as usize]));
        self.ids.clear();
        self.ids.extend(places.map(|i| ids[i as usize]));
        self.prev.clear();
        self.prev.extend((0..n as u32).map(|i| if i == 0 { n as u32 - 1 } else { i - 1 }));
        self.next.clear();
        self.next.extend((0..n as u32).map(|i| if i + 1 == n as u32 { 0 } else { i + 1 }));
        self.waits_on.clear();
        self.waits_on.resize(n, NONE);
        self.waiters.clear();
        self.waiters.resize(n, NONE);
        self.waiting.clear();
        self.gone.clear();
    }

    /// Removes until the stop says so. A `closed` chain is a ring; else its first and last vertex stay.
    fn run(&mut self, stop: &Stop, closed: bool) {
        let n = self.at.len();
        self.key.clear();
        for i in 0..n {
            let [a, b] = [self.prev[i], self.next[i]].map(|j| self.at[j as usize]);
            self.key.push(if !closed && (i == 0 || i + 1 == n) { i64::MIN } else { added(a, self.at[i], b) });
        }
        let mut first = std::mem::take(&mut self.heap).into_vec();
        first.clear();
        let concave = (0..n as u32).filter(|&i| self.key[i as usize] >= 0);
        first.extend(concave.map(|i| Reverse((self.key[i as usize], self.ids[i as usize], i))));
        self.heap = BinaryHeap::from(first);
        self.grid.build(&self.at, (0..n as u32).filter(|_| true), n);
        let mut left = n;
        let mut rebuild = n / 2;
        let mut total = 0;
        while let Some(Reverse((area, _, v))) = self.heap.pop() {
            let enough = left <= stop.edges || area > stop.single || area > stop.total - total;
            if left <= 3 && closed || (enough && area > 0) {
                break;
            }
            let (i, b) = (v as usize, self.next[v as usize]);
            // Out of date: gone, waiting, or with another key that has its own entry.
            if b == NONE || self.key[i] != area || self.waits_on[i] != NONE {
                continue;
            }
            let a = self.prev[i];
            let (pa, pv, pb) = (self.at[a as usize], self.at[i], self.at[b as usize]);
            if area > 0
                && let Some(by) = self.grid.blocker(pa, pv, pb, [a, v, b], &self.next)
            {
                self.waits_on[i] = by;
                self.waiting.push((v, self.waiters[by as usize]));
                self.waiters[by as usize] = self.waiting.len() as u32 - 1;
                continue;
            }
            self.next[i] = NONE;
            self.next[a as usize] = b;
            self.prev[b as usize] = a;
            self.gone.push(v);
            left -= 1;
            total += area;
            for u in [a, b] {
                let i = u as usize;
                if self.key[i] != i64::MIN {
                    let now = added(self.at[self.prev[i] as usize], self.at[i], self.at[self.next[i] as usize]);
                    let was = std::mem::replace(&mut self.key[i], now);
                    let waited = std::mem::replace(&mut self.waits_on[i], NONE) != NONE;
                    if now >= 0 && (now != was || waited) {
                        self.heap.push(Reverse((now, self.ids[i], u)));
                    }
                }
            }
            let mut entry = std::mem::replace(&mut self.waiters[i], NONE);
            while entry != NONE {
                let (w, following) = self.waiting[entry as usize];
                if self.waits_on[w as usize] == v && self.next[w as usize] != NONE {
                    self.waits_on[w as usize] = NONE;
                    self.heap.push(Reverse((self.key[w as usize], self.ids[w as usize], w)));
                }
                entry = following;
            }
            if left == rebuild && left > 64 {
                rebuild = left / 2;
                let next = &self.next;
                self.grid.build(&self.at, (0..n as u32).filter(|&i| next[i as usize] != NONE), left);
            }
        }
    }
}

/// What one pocket lost, in order: place in the ring, own key, and the largest key so far.
struct Pocket {
    gone: Vec<(u32, i64)>,
    most: Vec<(i64, u32)>,
}

fn pockets(ring: &[Point], ids: &[u32], target: usize, kept: &mut Vec<u32>) {
    let n = ring.len() as u32;
    let corners = hull_places(ring);
    let ends = |k: usize| (corners[k], corners[(k + 1) % corners.len()]);
    let done: Vec<Pocket> = (0..corners.len())
        .into_par_iter()
        .map_init(Chain::default, |chain, k| {
            let (from, to) = ends(k);
            let length = (to + n - from - 1) % n + 2;
            if length <= 2 {
                return Pocket { gone: Vec::new(), most: Vec::new() };
            }
            chain.set(ring, (0..length).map(|i| (from + i) % n), ids);
            chain.run(&Stop::at(0), false);
            let mut most = Vec::with_capacity(chain.gone.len());
            let mut so_far = (i64::MIN, 0);
            for &v in &chain.gone {
                so_far = so_far.max((chain.key[v as usize], chain.ids[v as usize]));
                most.push(so_far);
            }
            let gone = chain.gone.iter().map(|&v| ((from + v) % n, chain.key[v as usize])).collect();
            Pocket { gone, most }
        })
        .collect();

    // The order of the whole: always the pocket whose next one is least, so by the largest key so far. As many go
    // as bring the ring to its target, and whatever adds nothing then.
    let wanted = (ring.len()).saturating_sub(target);
    let count = |limit: (i64, u32)| -> usize { done.iter().map(|p| p.most.partition_point(|&m| m <= limit)).sum() };
    let (mut low, mut high) = (0i64, i64::MAX);
    // Largest area whose whole class may go without passing the target.
    while low + 1 < high {
        let middle = low + (high - low) / 2;
        if count((middle, NONE)) <= wanted { low = middle } else { high = middle }
    }
    let mut taken: Vec<usize> = done.iter().map(|p| p.most.partition_point(|&m| m <= (low, NONE))).collect();
    let mut total: usize = taken.iter().sum();
    let next = |k: usize, taken: &[usize]| done[k].most.get(taken[k]).map(|&m| (m, k));
    let free = |k: usize, taken: &[usize]| done[k].gone.get(taken[k]).is_some_and(|g| g.1 == 0);
    loop {
        let k = match (0..done.len()).find(|&k| free(k, &taken)) {
            Some(k) => k,
            None if total >= wanted => break,
            None => match (0..done.len()).filter_map(|k| next(k, &taken)).min() {
                Some((_, k)) => k,
                None => break,
            },
        };
        taken[k] += 1;
        total += 1;
    }
    let mut stays = vec![true; ring.len()];
    for (pocket, &taken) in done.iter().zip(&taken) {
        pocket.gone[..taken].iter().for_each(|g| stays[g.0 as usize] = false);
    }
    kept.extend((0..n).filter(|&i| stays[i as usize]));
}

/// Places of the strictly convex hull's vertices in a simple ring, ascending. Melkman, O(n).
fn hull_places(ring: &[Point]) -> Vec<u32> {
    let n = ring.len();
    let at = |i: u32| ring[i as usize];
    // From the lowest of the leftmost: a vertex of the hull.
    let start = (0..n).min_by_key(|&i| ring[i]).unwrap_or(0) as u32;
    let mut hull: std::collections::VecDeque<u32> = std::collections::VecDeque::new();
    for i in (0..n as u32).map(|k| (start + k) % n as u32) {
        if hull.len() < 3 {
            if hull.len() == 2 && orient(at(hull[0]), at(hull[1]), at(i)) == 0 {
                // Still on a line: the farther one from the start counts.
                let far = |j: u32| (0..2).map(|k| (i64::from(at(j)[k]) - i64::from(at(hull[0])[k])).abs()).sum::<i64>();
                if far(i) > far(hull[1]) {
                    hull[1] = i;
                }
                continue;
            }
            hull.push_back(i);
            if hull.len() == 3 {
                // Counter-clockwise, the newest at both ends.
                if orient(at(hull[0]), at(hull[1]), at(hull[2])) < 0 {
                    hull.swap(0, 1);
                }
                hull.push_front(i);
            }
            continue;
        }
        let m = hull.len();
        let inside =
            orient(at(hull[0]), at(hull[1]), at(i)) >= 0 && orient(at(hull[m - 2]), at(hull[m - 1]), at(i)) >= 0;
        if inside {
            continue;
        }
        while orient(at(hull[0]), at(hull[1]), at(i)) <= 0 && hull.len() > 2 {
            hull.pop_front();
        }
        hull.push_front(i);
        while hull.len() > 2 && orient(at(hull[hull.len() - 2]), at(hull[hull.len() - 1]), at(i)) <= 0 {
            hull.pop_back();
        }
        hull.push_back(i);
    }
    hull.pop_back();
    let mut places: Vec<u32> = hull.into();
    places.sort_unstable();
    // Collinear ones may be left beside the start.
    let m = places.len();
    let corner = |k: usize| orient(at(places[(k + m - 1) % m]), at(places[k]), at(places[(k + 1) % m])) > 0;
    (0..m).filter(|&k| corner(k)).map(|k| places[k]).collect()
}

#[cfg(test)]
mod tests {
    use super::super::ring::{contains, convex_hull};
    use super::super::segments::is_simple;
    use super::*;

    #[test]
    fn an_l_becomes_convex_and_collinear_vertices_always_go() {
        let l = [[0, 0], [5, 0], [9, 0], [9, 4], [4, 4], [4, 9], [0, 9]];
        assert_eq!(simplify(&l, 99), [[0, 0], [9, 0], [9, 4], [4, 4], [4, 9], [0, 9]]);
        assert_eq!(simplify(&l, 5), [[0, 0], [9, 0], [9, 4], [4, 9], [0, 9]]);
        assert_eq!(simplify(&l, 3), [[0, 0], [9, 0], [9, 4], [4, 9], [0, 9]]);
    }

    /// The rule itself, word by word.
    fn plain(ring: &[Point], target: usize) -> Vec<Point> {
        let mut kept: Vec<usize> = (0..ring.len()).collect();
        while kept.len() > 3 {
            let n = kept.len();
            let at = |i: usize| ring[kept[i % n]];
            let goes = |i: &usize| {
                let (a, v, b) = (at(i + n - 1), at(*i), at(i + 1));
                let area = added(a, v, b);
                let blocked = (0..n).any(|j| ![a, v, b].contains(&at(j)) && blocks(a, v, b, at(j)));
                area == 0 || (area > 0 && n > target && !blocked)
            };
            match (0..n).filter(goes).min_by_key(|&i| (added(at(i + n - 1), at(i), at(i + 1)), kept[i])) {
                Some(i) => kept.remove(i),
                None => break,
            };
        }
        kept.into_iter().map(|i| ring[i]).collect()
    }

    /// A simple ring that winds: a walk around a comb of random teeth, within a random polygon of few ties.
    fn winding(seed: u64, teeth: usize, step: i32) -> Vec<Point> {
        let mut state = seed;
        let mut next = |n: i32| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            ((state >> 33) % n as u64) as i32
        };
        let mut ring = vec![[0, 0], [teeth as i32 * 8 * step, 0]];
        for k in (0..teeth as i32).rev() {
            let (x, deep) = (k * 8 * step, 1 + next(60) * step);
            // A tooth with a bulge at its foot: concave vertices block each other.
            ring.extend([
                [x + 7 * step, 100 * step + next(9) * step],
                [x + 6 * step, 99 * step - deep],
                [x + 7 * step, 98 * step - deep],
                [x + 7 * step - 1, 30 * step - next(20) * step],
                [x + 2 * step, 30 * step - next(20) * step],
                [x + step, 95 * step - deep],
                [x + 2 * step, 99 * step - deep / 2],
            ]);
        }
        ring.push([0, 100 * step]);
        ring
    }

    #[test]
    fn every_way_gives_what_the_rule_says() {
        for (seed, teeth) in [(1, 3), (2, 5), (3, 6), (4, 20), (5, 30)] {
            for step in [1, 1000] {
                let ring = winding(seed, teeth, step);
                let ring: Vec<Point> = if is_simple(&ring) { ring } else { simplify(&convex_hull(&ring), 0) };
                let ids: Vec<u32> = (0..ring.len() as u32).collect();
                for part in 0..12 {
                    let target = ring.len() * part / 11;
                    let want = plain(&ring, target);
                    assert!(is_simple(&want) && contains(&want, &ring));
                    assert_eq!(simplify(&ring, target), want, "seed {seed}, target {target}");
                    let (mut kept, mut chain) = (Vec::new(), Chain::default());
                    let chosen = |kept: &[u32]| -> Vec<Point> { kept.iter().map(|&i| ring[i as usize]).collect() };
                    pockets(&ring, &ids, target, &mut kept);
                    assert_eq!(chosen(&kept), want, "pockets, seed {seed}, target {target}");
                    chain.set(&ring, 0..ring.len() as u32, &ids);
                    chain.run(&Stop::at(target), true);
                    kept = ids.iter().copied().filter(|&i| chain.next[i as usize] != NONE).collect();
                    assert_eq!(chosen(&kept), want, "heap, seed {seed}, target {target}");
                }
            }
        }
    }

    #[test]
    fn hulls_of_rings() {
        for seed in 0..20 {
            let ring = winding(seed, 9, 3);
            let mut places: Vec<Point> = hull_places(&ring).into_iter().map(|i| ring[i as usize]).collect();
            let mut hull = convex_hull(&ring);
            places.sort_unstable();
            hull.sort_unstable();
            assert_eq!(places, hull);
        }
    }
}
