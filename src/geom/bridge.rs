//! The two connections between two small disjoint rings: as `merge_rings` says, by looking at all pairs of vertices.
//!
//! Which vertices of a ring can be left towards a point, and not into the ring, is one word of bits for each point.
//! Such a connection can meet the ring again only in a pocket: from outside of the convex hull, or through a
//! pocket's mouth, a straight line comes back to no convex body. So only edges that are not on the hull are asked.

use super::Point;
use super::merge_rings::{Chord, Pairs, Ring, squared};
use super::predicates::{orient, segments_meet};
use super::segments::{Rect, Segment};

/// An edge's place, itself and its box.
type Wall = (u32, Segment, Rect);

/// Working memory.
#[derive(Default)]
pub struct Bridge {
    /// Of each ring its edges that are not on its convex hull.
    walls: [Vec<Wall>; 2],
    /// Of each vertex the other ring's that a connection may set out from, as bits.
    open: [Vec<u64>; 2],
    /// Squared length and places, shortest first.
    keys: Vec<u64>,
}

/// Rings have at most so many vertices.
const MOST: usize = 64;

/// Connections are shorter: their squares leave room for two places.
const LONGEST: i64 = 1 << 26;

impl Bridge {
    /// True where the rings are few and near enough. `reach`: no two of their points are farther apart.
    pub(super) fn spans(r: Ring, s: Ring, reach: i64) -> bool {
        r.at.len().max(s.at.len()) <= MOST && reach < LONGEST
    }

    /// Offers the clear connections, shortest first, until `pairs` has enough.
    pub(super) fn find(&mut self, r: Ring, s: Ring, pairs: &mut Pairs) {
        for (k, ring, other) in [(0, r, s), (1, s, r)] {
            let convex = convex(ring.at);
            find_walls(ring, convex, &mut self.walls[k]);
            self.open[k].clear();
            self.open[k].extend(other.at.iter().map(|&p| open(ring.at, convex, p)));
        }
        let [from_r, from_s] = &self.open;
        self.keys.clear();
        for (v, &q) in s.at.iter().enumerate() {
            let mut us = from_r[v];
            while us != 0 {
                let u = us.trailing_zeros() as usize;
                us &= us - 1;
                if from_s[u] >> v & 1 == 1 {
                    self.keys.push((squared(r.at[u], q) as u64) << 12 | (u << 6 | v) as u64);
                }
            }
        }
        self.keys.sort_unstable();
        for &key in &self.keys {
            let chord: Chord = ((key >> 12) as i64, (key >> 6) as u32 & 63, key as u32 & 63);
            let ends = [chord.1, chord.2].map(|i| i as usize);
            let (p, q) = (r.at[ends[0]], s.at[ends[1]]);
            if is_clear(&self.walls[0], p, q, [ends[0], r.before(ends[0])])
                && is_clear(&self.walls[1], p, q, [ends[1], s.before(ends[1])])
                && pairs.offer(r, s, chord)
            {
                break;
            }
        }
    }
}

/// Bit i: vertex i is strictly convex.
fn convex(ring: &[Point]) -> u64 {
    let n = ring.len();
    let turn = |i: usize| {
        let (a, b) = (if i == 0 { n - 1 } else { i - 1 }, if i + 1 == n { 0 } else { i + 1 });
        orient(ring[a], ring[i], ring[b])
    };
    (0..n).fold(0, |bits, i| bits | u64::from(turn(i) > 0) << i)
}

/// Bit i: the way from vertex i to `p` sets out into the open outside of the ring.
fn open(ring: &[Point], convex: u64, p: Point) -> u64 {
    let n = ring.len();
    // Edges, each from the vertex of its number, that `p` is to the right of.
    let mut right = u64::from(orient(ring[n - 1], ring[0], p) < 0) << (n - 1);
    for (i, w) in ring.windows(2).enumerate() {
        right |= u64::from(orient(w[0], w[1], p) < 0) << i;
    }
    let before = right << 1 | right >> (n - 1);
    let all = u64::MAX >> (64 - n);
    (convex & (before | right) | !convex & before & right) & all
}

fn find_walls(ring: Ring, convex: u64, out: &mut Vec<Wall>) {
    out.clear();
    let n = ring.at.len();
    if convex.count_ones() as usize == n {
        return;
    }
    for i in 0..n {
        let [a, b] = ring.edge(i);
        if ring.at.iter().any(|&p| orient(a, b, p) < 0) {
            out.push((i as u32, [a, b], Rect::of([a, b])));
        }
    }
}

/// True where p-q meets none of the edges, but for the two at `own` places (which it only leaves).
#[inline]
fn is_clear(walls: &[Wall], p: Point, q: Point, own: [usize; 2]) -> bool {
    let rect = Rect::of([p, q]);
    walls.iter().all(|(i, [a, b], of)| !rect.meets(of) || own.contains(&(*i as usize)) || !segments_meet(p, q, *a, *b))
}
