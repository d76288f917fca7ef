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
    /// The last ring's edges.
    lines: Vec<Line>,
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

    /// The edges of a ring that have some of it on their right; its strictly convex vertices, as bits.
    fn find_walls(&mut self, k: usize, ring: Ring, from: impl Fn(Point) -> [i64; 2]) -> u64 {
        let (n, walls) = (ring.at.len(), &mut self.walls[k]);
        walls.clear();
        let turn = |i: usize| orient(ring.at[ring.before(i)], ring.at[i], ring.at[ring.after(i)]);
        let convex = (0..n).fold(0, |bits, i| bits | u64::from(turn(i) > 0) << i);
        if convex.count_ones() as usize == n {
            return convex;
        }
        for (i, line) in self.lines.iter().enumerate() {
            if ring.at.iter().fold(0, |any, &p| any | line.right(from(p))) == 1 {
                let edge = ring.edge(i);
                walls.push((i as u32, edge, Rect::of(edge)));
            }
        }
        convex
    }

    /// Offers the clear connections, shortest first, until `pairs` has enough.
    pub(super) fn find(&mut self, r: Ring, s: Ring, pairs: &mut Pairs) {
        for (k, ring, other) in [(0, r, s), (1, s, r)] {
            let origin = ring.at[0];
            let from = |p: Point| [0, 1].map(|k| i64::from(p[k]) - i64::from(origin[k]));
            self.lines.clear();
            self.lines.extend((0..ring.at.len()).map(|i| Line::through(ring.edge(i).map(from))));
            let convex = self.find_walls(k, ring, from);
            self.open[k].clear();
            self.open[k].extend(other.at.iter().map(|&p| open(&self.lines, convex, from(p))));
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

/// A directed line: where x * d + y * e < f is its right side.
struct Line {
    d: i64,
    e: i64,
    f: i64,
}

impl Line {
    fn through([a, b]: [[i64; 2]; 2]) -> Self {
        let (d, e) = (a[1] - b[1], b[0] - a[0]);
        Self { d, e, f: a[0] * d + a[1] * e }
    }
    /// 1 where `p` is on its right, else 0.
    #[inline]
    fn right(&self, p: [i64; 2]) -> u64 {
        (p[0] * self.d + p[1] * self.e - self.f) as u64 >> 63
    }
}

/// Bit i: the way from vertex i to `p` sets out into the open outside of the ring. `convex`: the strictly convex ones.
#[inline]
fn open(lines: &[Line], convex: u64, p: [i64; 2]) -> u64 {
    let n = lines.len();
    let right = lines.iter().rev().fold(0, |bits, line| bits << 1 | line.right(p));
    let before = right << 1 | right >> (n - 1);
    let all = u64::MAX >> (64 - n);
    (convex & (before | right) | !convex & before & right) & all
}

/// True where p-q meets none of the edges, but for the two at `own` places (which it only leaves).
#[inline]
fn is_clear(walls: &[Wall], p: Point, q: Point, own: [usize; 2]) -> bool {
    let rect = Rect::of([p, q]);
    walls.iter().all(|(i, [a, b], of)| !rect.meets(of) || own.contains(&(*i as usize)) || !segments_meet(p, q, *a, *b))
}
