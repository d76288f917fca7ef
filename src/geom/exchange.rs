//! A better choice of as many vertices: what [`outer_hull`](super::outer_hull) left of a ring, improved by exchanges.
//!
//! Taking the smallest triangle first is short-sighted: of a chain between two kept vertices it often leaves the wrong
//! one. Here a kept vertex moves to another of its chain, or one comes back and another goes elsewhere, as long as
//! that takes area off. The number of vertices stays, or falls where one has come to lie between collinear ones.
//!
//! Two steps are sound by themselves, and everything is made of them. R is the ring that was simplified, P what is
//! left of it; a chain is the part of R between two neighbours a, b in P.
//! - v leaves P: where it is concave and no vertex of P lies in the closed triangle a, v, b (as in `outer_hull`).
//! - w of a chain joins P: where no other vertex of the chain lies in the closed triangle a, w, b, and no edge of it
//!   crosses the triangle, from side to side or from a or b. So the rest of the chain stays inside.
//!
//! Cost: O(m^2) to O(m^3) for chains of m vertices; longer ones than [`LONG`] stay as they are. Beside that near O(n).
//! Source: ours. tokyo_centre, sum over nodes: 44.75 km2 of negative space become 44.30,
//! for a twentieth more time.

use super::Point;
use super::predicates::{orient, segments_meet};
use super::vertex_grid::{Grid, NONE, blocks};

/// Vertices of a chain that is still looked at.
const LONG: usize = 64;

/// Up to so many vertices all are looked at.
const FEW: usize = 64;

/// After so many rounds what is still to be had is small.
const ROUNDS: usize = 4;

/// Working memory for many rings, one after the other.
#[derive(Default)]
pub struct Exchange {
    grid: Grid,
    /// Of each vertex of R, [`NONE`] where it is not in P.
    live: Vec<u32>,
    gains: Vec<(i64, usize, u32)>,
    costs: Vec<(i64, usize)>,
    touched: Vec<bool>,
}

/// The ring and its chains.
#[derive(Clone, Copy)]
struct Ring<'a>(&'a [Point]);

impl Ring<'_> {
    fn at(self, i: u32) -> Point {
        self.0[i as usize]
    }
    fn after(self, i: u32) -> u32 {
        if i as usize + 1 == self.0.len() { 0 } else { i + 1 }
    }
    /// Vertices between two of P.
    fn between(self, a: u32, b: u32) -> usize {
        let n = self.0.len() as u32;
        (if b > a { b - a } else { b + n - a }) as usize - 1
    }
    /// These, in order.
    fn chain(self, a: u32, b: u32) -> impl Iterator<Item = u32> + Clone {
        std::iter::successors(Some(self.after(a)), move |&i| Some(self.after(i))).take_while(move |&i| i != b)
    }

    /// The vertex between a and b that takes most off, more than `least`, and how much (doubled area).
    fn best(self, a: u32, b: u32, least: i64) -> Option<(i64, u32)> {
        let many = self.between(a, b);
        if many == 0 || many > LONG {
            return None;
        }
        let (p, q) = (self.at(a), self.at(b));
        let mut best: Option<(i64, u32)> = None;
        for w in self.chain(a, b) {
            let gain = orient(p, q, self.at(w));
            if gain > best.map_or(least, |b| b.0) && self.is_open(a, b, w) {
                best = Some((gain, w));
            }
        }
        best
    }

    /// True where nothing of the chain reaches into the triangle a, w, b.
    fn is_open(self, a: u32, b: u32, w: u32) -> bool {
        let (p, q, at) = (self.at(a), self.at(b), self.at(w));
        let mut last = a;
        for c in self.chain(a, b).chain([b]) {
            let edge = (last, c);
            last = c;
            if c != w && c != b && blocks(p, at, q, self.at(c)) {
                return false;
            }
            // One from a can only cross the other side.
            let (from, to) = if edge.0 == a { (q, at) } else { (p, at) };
            if edge.0 != w && edge.1 != w && segments_meet(from, to, self.at(edge.0), self.at(edge.1)) {
                return false;
            }
        }
        true
    }
}

impl Exchange {
    /// Improves `kept`, the places of the vertices of P in R, ascending. R is simple and counter-clockwise.
    pub fn improve(&mut self, ring: &[Point], kept: &mut Vec<u32>) {
        if kept.len() < 4 || kept.len() == ring.len() {
            return;
        }
        let ring = Ring(ring);
        self.live.clear();
        self.live.resize(ring.0.len(), NONE);
        kept.iter().for_each(|&k| self.live[k as usize] = 0);
        if ring.0.len() > FEW {
            self.grid.build(ring.0, 0..ring.0.len() as u32, ring.0.len());
        }
        for _ in 0..ROUNDS {
            let moved = self.relocate(ring, kept);
            kept.sort_unstable();
            if !self.trade(ring, kept) && !moved {
                break;
            }
        }
        drop_straight(ring, kept);
    }

    /// What the vertex at a place of P costs to take away: twice what it adds.
    fn cost(ring: Ring, [a, v, b]: [u32; 3]) -> i64 {
        -orient(ring.at(a), ring.at(v), ring.at(b))
    }

    /// True where a concave vertex may go.
    fn may_go(&self, ring: Ring, kept: &[u32], [a, v, b]: [u32; 3]) -> bool {
        let [p, at, q] = [a, v, b].map(|i| ring.at(i));
        if ring.0.len() > FEW {
            return self.grid.blocker(p, at, q, [a, v, b], &self.live).is_none();
        }
        !kept.iter().any(|&k| k != a && k != v && k != b && blocks(p, at, q, ring.at(k)))
    }

    /// Each concave vertex to the best place of its chain. True where one moved.
    fn relocate(&mut self, ring: Ring, kept: &mut [u32]) -> bool {
        let mut moved = false;
        for i in 0..kept.len() {
            let three = neighbours(kept, i);
            let [a, v, b] = three;
            let now = Self::cost(ring, three);
            if now < 0 || ring.between(a, b) == 1 {
                continue;
            }
            if let Some(w) = self.better(ring, kept, three, now) {
                kept[i] = w;
                (self.live[v as usize], self.live[w as usize]) = (NONE, 0);
                moved = true;
            }
        }
        moved
    }

    /// The vertex between a and b that takes most off in place of v, more than v does: it joins on its side of v, and
    /// then v goes; or v goes first.
    fn better(&self, ring: Ring, kept: &[u32], [a, v, b]: [u32; 3], least: i64) -> Option<u32> {
        if ring.between(a, b) > LONG {
            return None;
        }
        let (p, q) = (ring.at(a), ring.at(b));
        let may_go = std::cell::OnceCell::new();
        let mut best = (least, None);
        let sides = ring.chain(a, v).map(|w| (w, true)).chain(ring.chain(v, b).map(|w| (w, false)));
        for (w, before) in sides {
            let gain = orient(p, q, ring.at(w));
            if gain <= best.0 {
                continue;
            }
            let rest = if before { [w, v, b] } else { [a, v, w] };
            let joins = if before { ring.is_open(a, v, w) } else { ring.is_open(v, b, w) };
            let concave = Self::cost(ring, rest) >= 0;
            let inner =
                orient(ring.at(if before { a } else { v }), ring.at(if before { v } else { b }), ring.at(w)) > 0;
            if (joins && inner && concave && self.may_go(ring, kept, rest))
                || (ring.is_open(a, b, w) && *may_go.get_or_init(|| self.may_go(ring, kept, [a, v, b])))
            {
                best = (gain, Some(w));
            }
        }
        best.1
    }

    /// Vertices come back where that takes off more than another adds by going. True where some did.
    fn trade(&mut self, ring: Ring, kept: &mut Vec<u32>) -> bool {
        let many = kept.len();
        self.gains.clear();
        for (i, &a) in kept.iter().enumerate() {
            let b = kept[if i + 1 == many { 0 } else { i + 1 }];
            self.gains.extend(ring.best(a, b, 0).map(|(gain, w)| (gain, i, w)));
        }
        let Some(most) = self.gains.iter().map(|g| g.0).max() else { return false };
        let mut costs = std::mem::take(&mut self.costs);
        costs.clear();
        for i in 0..many {
            let three = neighbours(kept, i);
            let cost = Self::cost(ring, three);
            if cost >= 0 && cost < most && self.may_go(ring, kept, three) {
                costs.push((cost, i));
            }
        }
        costs.sort_unstable();
        self.gains.sort_unstable_by_key(|&(gain, i, _)| (std::cmp::Reverse(gain), i));
        self.touched.clear();
        self.touched.resize(many, false);
        let (before, after) =
            (|i: usize| if i == 0 { many - 1 } else { i - 1 }, |i: usize| if i + 1 == many { 0 } else { i + 1 });
        let mut going = costs.iter().peekable();
        let mut traded = false;
        for &(gain, i, w) in &self.gains {
            let touched = &mut self.touched;
            if touched[i] || touched[after(i)] {
                continue;
            }
            // One that goes keeps its neighbours, and both ends of what is opened stay.
            let beside = |j: usize| [before(j), j, after(j)];
            let busy = |j: usize| beside(j).into_iter().any(|k| touched[k]) || j == i || j == after(i);
            while going.peek().is_some_and(|&&(_, j)| busy(j)) {
                going.next();
            }
            let Some(&(_, j)) = going.next_if(|&&(cost, _)| cost < gain) else { break };
            beside(j).into_iter().chain([i, after(i)]).for_each(|k| touched[k] = true);
            self.live[kept[j] as usize] = NONE;
            self.live[w as usize] = 0;
            traded = true;
        }
        self.costs = costs;
        if traded {
            kept.clear();
            kept.extend((0..ring.0.len() as u32).filter(|&i| self.live[i as usize] != NONE));
        }
        traded
    }
}

/// A vertex of P between its neighbours.
fn neighbours(kept: &[u32], i: usize) -> [u32; 3] {
    let last = kept.len() - 1;
    [kept[if i == 0 { last } else { i - 1 }], kept[i], kept[if i == last { 0 } else { i + 1 }]]
}

/// Takes out what lies between collinear neighbours: nothing changes by it.
fn drop_straight(ring: Ring, kept: &mut Vec<u32>) {
    let mut i = 0;
    while i < kept.len() && kept.len() > 3 {
        if Exchange::cost(ring, neighbours(kept, i)) == 0 {
            kept.remove(i);
            // The one before has a new neighbour.
            i = i.saturating_sub(1);
        } else {
            i += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::outer_hull;
    use super::super::ring::{contains, doubled_area};
    use super::super::segments::is_simple;
    use super::*;

    fn improved(ring: &[Point], edges: usize) -> (Vec<Point>, Vec<Point>) {
        let ids: Vec<u32> = (0..ring.len() as u32).collect();
        let mut kept = Vec::new();
        outer_hull::Simplifier::default().keep(ring, &ids, edges, &mut kept);
        let points = |kept: &[u32]| kept.iter().map(|&k| ring[k as usize]).collect::<Vec<_>>();
        let before = points(&kept);
        Exchange::default().improve(ring, &mut kept);
        assert!(kept.is_sorted());
        (before, points(&kept))
    }

    /// The least area of any simple ring over so many of the vertices at most that contains the ring.
    fn least(ring: &[Point], edges: usize) -> i64 {
        let mut least = i64::MAX;
        for mask in 0u32..1 << ring.len() {
            if (3..=edges as u32).contains(&mask.count_ones()) {
                let some: Vec<Point> = (0..ring.len()).filter(|i| mask >> i & 1 == 1).map(|i| ring[i]).collect();
                let area = doubled_area(&some);
                if area > 0 && area < least && is_simple(&some) && contains(&some, ring) {
                    least = area;
                }
            }
        }
        least
    }

    /// Star-shaped, with deep bays.
    fn star(seed: u64, n: usize, reach: i64) -> Vec<Point> {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut random = |below: i64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as i64 % below
        };
        // Points of a circle by halves of angles would need sines: a square's border will do.
        let ring = (0..n as i64).map(|i| {
            let along = 8 * reach * i / n as i64;
            let (side, rest) = (along / (2 * reach), along % (2 * reach) - reach);
            let [x, y] = [[rest, -reach], [reach, rest], [-rest, reach], [-reach, -rest]][side as usize];
            let far = 20 + random(80);
            [(x * far / 100) as i32, (y * far / 100) as i32]
        });
        ring.collect()
    }

    #[test]
    fn the_vertex_that_is_left_is_the_right_one() {
        // A bay whose two corners differ: the smallest triangle first is that of the deep one.
        let ring = [[0, 0], [100, 0], [100, 100], [60, 100], [50, 20], [46, 96], [44, 94], [0, 100]];
        for edges in 5..8 {
            let (before, after) = improved(&ring, edges);
            assert!(doubled_area(&after) <= doubled_area(&before));
            assert_eq!(doubled_area(&after), least(&ring, edges), "{edges} edges: {after:?}");
        }
    }

    #[test]
    fn sound_never_worse_and_nearer_to_the_best_there_is() {
        let (mut gap_before, mut gap_after, mut tried) = (0, 0, 0);
        for seed in 0..150 {
            let ring = star(seed, 12, 1000);
            if !is_simple(&ring) || doubled_area(&ring) <= 0 {
                continue;
            }
            for edges in [5, 7, 9] {
                let (before, after) = improved(&ring, edges);
                assert!(is_simple(&after) && contains(&after, &ring), "seed {seed}, {edges}: {after:?}");
                assert!(after.len() <= before.len() && doubled_area(&after) <= doubled_area(&before));
                let best = least(&ring, before.len());
                assert!(doubled_area(&after) >= best);
                gap_before += doubled_area(&before) - best;
                gap_after += doubled_area(&after) - best;
                tried += 1;
            }
        }
        assert!(tried > 100, "{tried}");
        assert!(20 * gap_after < 19 * gap_before, "{gap_before} to {gap_after} over {tried}");
    }

    #[test]
    fn an_edge_from_the_end_of_a_chain_bars_the_way() {
        // 5 would take more off than 4; but the edge from 3 to 4 crosses the one from 5 to 9.
        let ring: Vec<Point> = vec![
            [149, 140],
            [242, 106],
            [271, 154],
            [304, 216],
            [256, 241],
            [223, 179],
            [163, 145],
            [208, 237],
            [243, 247],
            [300, 272],
            [300, 400],
            [0, 400],
            [0, 140],
        ];
        let mut kept = vec![0, 1, 2, 3, 4, 9, 10, 11, 12];
        Exchange::default().improve(&ring, &mut kept);
        let after: Vec<Point> = kept.iter().map(|&k| ring[k as usize]).collect();
        assert!(is_simple(&ring) && is_simple(&after) && contains(&after, &ring), "{kept:?}");
    }

    #[test]
    fn long_rings_stay_sound() {
        let mut better = 0;
        for seed in 0..12 {
            let ring = star(seed, 400, 100_000);
            if !is_simple(&ring) {
                continue;
            }
            for edges in [40, 150, 300] {
                let (before, after) = improved(&ring, edges);
                assert!(is_simple(&after) && contains(&after, &ring), "seed {seed}, {edges}");
                assert!(after.len() <= before.len() && doubled_area(&after) <= doubled_area(&before));
                better += usize::from(doubled_area(&after) < doubled_area(&before));
            }
        }
        assert!(better > 10, "{better}");
    }
}
