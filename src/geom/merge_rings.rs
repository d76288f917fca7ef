//! Two simple rings into one that contains both and has no other vertices than theirs.
//!
//! - Disjoint: two connection edges; of the two loops the larger. Signed area >= area(R) + area(S) proves that it
//!   contains both. An edge (u in R, v in S) is *clear* when it meets both rings in nothing but u and v; the pair
//!   that adds the least area is taken from the 16 shortest clear ones. (The two shortest add 2.5 times as much.)
//! - One inside the other: the outer one; of equal ones the first.
//! - Crossing: the outline of the union; where it turns at a crossing point, the edge between the vertices before
//!   and after. ([`outline`](self::outline); adds less than erosion.)
//! - Touching, interlocked, or where such an edge is not clear: [`erode`](super::erode).
//!
//! The ring begins at its vertex of lowest id. Ties go by lengths, then by places in the two rings. Source: Chang et
//! al., Hierarchical Simplification of City Models to Maintain Urban Legibility, section 5.

use super::Point;
use super::bridge::Bridge;
use super::erode::erode;
use super::outline;
use super::predicates::{orient, segments_meet};
use super::ring::{Side, contains, side};
use super::segments::{Rect, Segment, near_pairs};

/// A ring: where its vertices are, and their numbers among all (equal points by equal numbers).
#[derive(Clone, Copy, Debug)]
pub struct Ring<'a> {
    pub at: &'a [Point],
    pub ids: &'a [u32],
}

impl Ring<'_> {
    #[inline]
    pub(super) fn after(&self, i: usize) -> usize {
        if i + 1 == self.at.len() { 0 } else { i + 1 }
    }
    #[inline]
    pub(super) fn before(&self, i: usize) -> usize {
        if i == 0 { self.at.len() - 1 } else { i - 1 }
    }
    #[inline]
    pub(super) fn edge(&self, i: usize) -> Segment {
        [self.at[i], self.at[self.after(i)]]
    }
    /// True where the way from vertex `i` to `p` sets out into the open outside of the ring.
    #[inline]
    pub(super) fn leaves(&self, i: usize, p: Point) -> bool {
        let (a, v, b) = (self.at[self.before(i)], self.at[i], self.at[self.after(i)]);
        let (from, to) = (orient(a, v, p) < 0, orient(v, b, p) < 0);
        if orient(a, v, b) > 0 { from || to } else { from && to }
    }
}

/// How many of the shortest clear edges compete. 8 leave 18 % more negative space, 40 take off 5 %.
const CLEAR: usize = 16;

/// Up to so many pairs of vertices all are looked at.
const ALL_PAIRS: usize = 1024;

/// A connection: squared length, then the places of its ends in R and S.
pub(super) type Chord = (i64, u32, u32);

/// Working memory for many merges, and the last one's ring.
#[derive(Default)]
pub struct Merger {
    pub at: Vec<Point>,
    pub ids: Vec<u32>,
    edges: [Vec<(u32, Segment)>; 2],
    contacts: Vec<(u32, u32)>,
    near: [Vec<u32>; 2],
    chords: Vec<Chord>,
    pairs: Pairs,
    bridge: Bridge,
    outline: outline::Outline,
}

/// Clear connections, and the pair of them that adds the least.
#[derive(Default)]
pub(super) struct Pairs {
    /// Of each ring its doubled area up to each vertex, seen from R's first.
    sums: [Vec<i64>; 2],
    /// With what their loops' areas are made of: see `offer`.
    clear: Vec<(Chord, i64)>,
    /// What it adds and how long it is; in the order of the larger loop: R from the first to the second, S from the
    /// second to the first.
    best: Option<((i64, i64), Chord, Chord)>,
}

impl Pairs {
    fn start(&mut self, r: Ring, s: Ring) {
        let origin = r.at[0];
        for (ring, out) in [r, s].into_iter().zip(&mut self.sums) {
            out.clear();
            let mut sum = 0i64;
            out.push(0);
            for w in ring.at.windows(2) {
                sum = sum.wrapping_add(orient(origin, w[0], w[1]));
                out.push(sum);
            }
            out.push(sum.wrapping_add(orient(origin, ring.at[ring.at.len() - 1], ring.at[0])));
        }
        self.forget();
    }

    fn forget(&mut self) {
        self.clear.clear();
        self.best = None;
    }

    /// Weighs a clear connection with all before it, which are shorter. True once enough have been seen.
    #[inline]
    pub(super) fn offer(&mut self, r: Ring, s: Ring, chord: Chord) -> bool {
        let (p, q) = (r.at[chord.1 as usize], s.at[chord.2 as usize]);
        let (all_r, all_s) = (self.sums[0][r.at.len()], self.sums[1][s.at.len()]);
        let both = all_r.wrapping_add(all_s);
        // A loop's doubled area is share(second) - share(first), and a whole ring where a chain runs over its end;
        // the other loop has what is left of both rings' areas.
        let share = self.sums[0][chord.1 as usize]
            .wrapping_sub(self.sums[1][chord.2 as usize])
            .wrapping_add(orient(r.at[0], p, q));
        let mut least = self.best.map_or(i64::MAX, |b| b.0.0);
        for &(other, its) in &self.clear {
            let mut area = share.wrapping_sub(its);
            if chord.1 < other.1 {
                area = area.wrapping_add(all_r);
            }
            if other.2 < chord.2 {
                area = area.wrapping_add(all_s);
            }
            let swap = area < both.wrapping_sub(area);
            let adds = if swap { area.wrapping_neg() } else { area.wrapping_sub(both) };
            if adds > least || adds < 0 || chord.1 == other.1 || chord.2 == other.2 {
                continue;
            }
            let key = (adds, chord.0.saturating_add(other.0));
            if self.best.is_some_and(|b| b.0 <= key) {
                continue;
            }
            if !segments_meet(p, q, r.at[other.1 as usize], s.at[other.2 as usize]) {
                least = adds;
                self.best = Some(if swap { (key, chord, other) } else { (key, other, chord) });
            }
        }
        self.clear.push((chord, share));
        self.clear.len() >= CLEAR && self.best.is_some()
    }
}

impl Merger {
    /// Puts the ring around `r` and `s` into `at` and `ids`. Both are simple and counter-clockwise, and so is it.
    pub fn merge(&mut self, r: Ring, s: Ring) {
        self.at.clear();
        self.ids.clear();
        let (rect_r, rect_s) = (Rect::of(r.at.iter().copied()), Rect::of(s.at.iter().copied()));
        let touching = rect_r.meets(&rect_s) && self.find_contacts(r, s, &rect_r.intersection(&rect_s));
        let holds = |outer: Ring, inner: Ring| match touching {
            true => contains(outer.at, inner.at),
            false => side(outer.at, inner.at[0].map(|c| 2 * i64::from(c))) == Side::In,
        };
        if rect_r.contains(&rect_s) && holds(r, s) {
            self.take(r);
        } else if rect_s.contains(&rect_r) && holds(s, r) {
            self.take(s);
        } else {
            let done = match touching {
                true => self.outline.trace(r, s, &self.contacts, &mut self.at, &mut self.ids),
                false => self.connect(r, s, &rect_r, &rect_s),
            };
            if !done {
                self.erode(r, s);
            }
        }
        let first = (0..self.ids.len()).min_by_key(|&i| self.ids[i]).unwrap_or(0);
        self.ids.rotate_left(first);
        self.at.rotate_left(first);
    }

    fn take(&mut self, ring: Ring) {
        self.at.extend_from_slice(ring.at);
        self.ids.extend_from_slice(ring.ids);
    }

    /// Edges that meet a rectangle, with their places.
    fn gather_edges(&mut self, r: Ring, s: Ring, rect: &Rect) {
        for (ring, out) in [r, s].into_iter().zip(&mut self.edges) {
            out.clear();
            let mut a = ring.at[ring.at.len() - 1];
            let mut from = ring.at.len() as u32 - 1;
            for (i, &b) in ring.at.iter().enumerate() {
                if rect.meets_segment(a, b) {
                    out.push((from, [a, b]));
                }
                (a, from) = (b, i as u32);
            }
        }
    }

    /// Pairs of edges that share a point, into `contacts`.
    fn find_contacts(&mut self, r: Ring, s: Ring, rect: &Rect) -> bool {
        self.contacts.clear();
        self.gather_edges(r, s, rect);
        let [of_r, of_s] = &self.edges;
        let contacts = &mut self.contacts;
        if of_r.len() * of_s.len() <= 4096 {
            for &(i, [a, b]) in of_r {
                let rect = Rect::of([a, b]);
                for &(j, [c, d]) in of_s {
                    if rect.meets_segment(c, d) && segments_meet(a, b, c, d) {
                        contacts.push((i, j));
                    }
                }
            }
        } else {
            let plain = |of: &[(u32, Segment)]| -> Vec<Segment> { of.iter().map(|e| e.1).collect() };
            near_pairs(&plain(of_r), &plain(of_s), |i, j| {
                let ((i, [a, b]), (j, [c, d])) = (of_r[i as usize], of_s[j as usize]);
                if segments_meet(a, b, c, d) {
                    contacts.push((i, j));
                }
                false
            });
            contacts.sort_unstable();
            contacts.dedup();
        }
        !contacts.is_empty()
    }

    // ------------------------------------------------------------------------------------------------ disjoint

    fn connect(&mut self, r: Ring, s: Ring, rect_r: &Rect, rect_s: &Rect) -> bool {
        self.pairs.start(r, s);
        let extent = |k: usize| {
            let (low, high) = (rect_r.low[k].min(rect_s.low[k]), rect_r.high[k].max(rect_s.high[k]));
            i64::from(high) - i64::from(low)
        };
        // Nothing is farther apart than this, and nothing nearer than the gaps between the boxes.
        let all = extent(0) + extent(1);
        let gap = |k: usize| {
            let (after, before) = (
                i64::from(rect_s.low[k]) - i64::from(rect_r.high[k]),
                i64::from(rect_r.low[k]) - i64::from(rect_s.high[k]),
            );
            after.max(before).max(0)
        };
        let few = r.at.len() * s.at.len() <= ALL_PAIRS;
        if few && Bridge::spans(r, s, all) {
            self.bridge.find(r, s, &mut self.pairs);
            return self.join(r, s);
        }
        let mut margin = if few { all } else { (gap(0) + gap(1) + 4000).min(all) };
        loop {
            self.find_chords(r, s, rect_r, rect_s, margin, few);
            let enough = self.choose(r, s);
            // Where no longer ones exist these must do.
            if (enough || margin >= all) && self.join(r, s) {
                return true;
            }
            if margin >= all {
                return false;
            }
            margin = (3 * margin).min(all);
        }
    }

    /// The loop over the best pair; false where there is none.
    fn join(&mut self, r: Ring, s: Ring) -> bool {
        let Some((_, one, two)) = self.pairs.best else { return false };
        self.splice(r, one.1, two.1);
        self.splice(s, two.2, one.2);
        true
    }

    /// All connections not longer than `margin` that set out and arrive outside of the rings.
    fn find_chords(&mut self, r: Ring, s: Ring, rect_r: &Rect, rect_s: &Rect, margin: i64, few: bool) {
        self.chords.clear();
        if few {
            for (u, &p) in r.at.iter().enumerate() {
                for (v, &q) in s.at.iter().enumerate() {
                    if r.leaves(u, q) && s.leaves(v, p) {
                        self.chords.push((squared(p, q), u as u32, v as u32));
                    }
                }
            }
            return;
        }
        for (k, ring, rect) in [(0, r, rect_s), (1, s, rect_r)] {
            let within = |p: Point| {
                (0..2).all(|k| {
                    let c = i64::from(p[k]);
                    c >= i64::from(rect.low[k]) - margin && c <= i64::from(rect.high[k]) + margin
                })
            };
            self.near[k].clear();
            self.near[k].extend((0..ring.at.len() as u32).filter(|&i| within(ring.at[i as usize])));
        }
        let [us, vs] = &mut self.near;
        vs.sort_unstable_by_key(|&v| (s.at[v as usize][0], v));
        for &u in us.iter() {
            let p = r.at[u as usize];
            let from = vs.partition_point(|&v| i64::from(s.at[v as usize][0]) < i64::from(p[0]) - margin);
            for &v in &vs[from..] {
                let q = s.at[v as usize];
                if i64::from(q[0]) - i64::from(p[0]) > margin {
                    break;
                }
                let length = squared(p, q);
                if i128::from(length) <= i128::from(margin) * i128::from(margin)
                    && r.leaves(u as usize, q)
                    && s.leaves(v as usize, p)
                {
                    self.chords.push((length, u, v));
                }
            }
        }
    }

    /// Weighs the clear ones among the connections, shortest first. True where enough are clear.
    fn choose(&mut self, r: Ring, s: Ring) -> bool {
        let mut chords = std::mem::take(&mut self.chords);
        let enough = self.choose_from(r, s, &mut chords);
        self.chords = chords;
        enough
    }

    fn choose_from(&mut self, r: Ring, s: Ring, chords: &mut [Chord]) -> bool {
        self.pairs.forget();
        let mut known = Rect::EMPTY;
        let (mut done, mut step) = (0, 40);
        while done < chords.len() {
            let rest = &mut chords[done..];
            let take = step.min(rest.len());
            if take < rest.len() {
                rest.select_nth_unstable(take - 1);
            }
            rest[..take].sort_unstable();
            let mut rect = known;
            for c in &rest[..take] {
                rect.add(r.at[c.1 as usize]);
                rect.add(s.at[c.2 as usize]);
            }
            if rect != known {
                known = rect;
                self.gather_edges(r, s, &known);
            }
            for &chord in &rest[..take] {
                let (u, v) = (chord.1 as usize, chord.2 as usize);
                let (p, q) = (r.at[u], s.at[v]);
                if is_clear(&self.edges[0], p, q, [u, r.before(u)])
                    && is_clear(&self.edges[1], p, q, [v, s.before(v)])
                    && self.pairs.offer(r, s, chord)
                {
                    return true;
                }
            }
            done += take;
            step *= 2;
        }
        false
    }

    /// Appends the chain of `ring` from one place to another, both included.
    fn splice(&mut self, ring: Ring, from: u32, to: u32) {
        let (from, to) = (from as usize, to as usize);
        let n = ring.at.len();
        let pieces = if from <= to { [from..to + 1, 0..0] } else { [from..n, 0..to + 1] };
        for piece in pieces {
            self.at.extend_from_slice(&ring.at[piece.clone()]);
            self.ids.extend_from_slice(&ring.ids[piece]);
        }
    }

    // -------------------------------------------------------------------------------------------- all the rest

    fn erode(&mut self, r: Ring, s: Ring) {
        let mut sorted: Vec<(u32, Point)> = Vec::with_capacity(r.at.len() + s.at.len());
        for ring in [r, s] {
            sorted.extend(ring.ids.iter().copied().zip(ring.at.iter().copied()));
        }
        sorted.sort_unstable();
        sorted.dedup();
        let mut segments = Vec::with_capacity(sorted.len());
        for ring in [r, s] {
            let place = |id: u32| sorted.binary_search_by_key(&id, |v| v.0).expect("all are there") as u32;
            let places: Vec<u32> = ring.ids.iter().map(|&id| place(id)).collect();
            segments.extend((0..places.len()).map(|i| [places[i], places[ring.after(i)]]));
        }
        let points: Vec<Point> = sorted.iter().map(|v| v.1).collect();
        let ring = erode(&points, &segments).expect("rings have area");
        self.at.clear();
        self.ids.clear();
        for i in ring {
            self.ids.push(sorted[i as usize].0);
            self.at.push(sorted[i as usize].1);
        }
    }
}

#[inline]
pub(super) fn squared(p: Point, q: Point) -> i64 {
    let d = [0, 1].map(|k| i64::from(p[k]) - i64::from(q[k]));
    d[0] * d[0] + d[1] * d[1]
}

/// True where p-q meets none of the edges, but for the two at `own` places (which it only leaves).
#[inline]
fn is_clear(edges: &[(u32, Segment)], p: Point, q: Point, own: [usize; 2]) -> bool {
    let rect = Rect::of([p, q]);
    edges
        .iter()
        .all(|&(i, [a, b])| !rect.meets_segment(a, b) || own.contains(&(i as usize)) || !segments_meet(p, q, a, b))
}

#[cfg(test)]
mod tests {
    use super::super::ring::doubled_area;
    use super::super::segments::is_simple;
    use super::*;

    fn merge(r: &[Point], s: &[Point]) -> Vec<Point> {
        // Ids that do not depend on the order, and are equal for equal points.
        let ids = |ring: &[Point]| -> Vec<u32> {
            ring.iter().map(|at| ((at[0] + 500) * 1000 + at[1] + 500) as u32).collect()
        };
        let mut merger = Merger::default();
        merger.merge(Ring { at: r, ids: &ids(r) }, Ring { at: s, ids: &ids(s) });
        assert!(is_simple(&merger.at) && contains(&merger.at, r) && contains(&merger.at, s));
        merger.at
    }
    fn square(x: i32, y: i32, side: i32) -> Vec<Point> {
        vec![[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
    }

    #[test]
    fn two_squares_apart() {
        assert_eq!(
            merge(&square(0, 0, 2), &square(5, 0, 2)),
            [[0, 0], [2, 0], [5, 0], [7, 0], [7, 2], [5, 2], [2, 2], [0, 2]]
        );
    }

    #[test]
    fn nested_equal_touching_and_crossing() {
        let big = square(0, 0, 9);
        assert_eq!(merge(&big, &square(2, 2, 3)), big);
        assert_eq!(merge(&square(0, 0, 3), &big), big);
        assert_eq!(merge(&big, &big), big);
        // A shared wall: the two ends of the wall stay as collinear vertices.
        assert_eq!(doubled_area(&merge(&square(0, 0, 4), &square(4, 0, 4))), 2 * 32);
        // A cross: four corners are cut.
        let cross = merge(&[[0, 3], [9, 3], [9, 6], [0, 6]], &[[3, 0], [6, 0], [6, 9], [3, 9]]);
        assert_eq!((cross.len(), doubled_area(&cross)), (8, 2 * 27 * 2 - 18 + 4 * 9));
        // A lid over a notch: all vertices and all edge midpoints are on the other ring, yet it is not inside.
        let notch = [[0, 0], [90, 0], [90, 9], [30, 9], [30, 3], [10, 3], [10, 9], [0, 9]];
        assert_eq!(doubled_area(&merge(&notch, &[[0, 5], [90, 5], [90, 9], [0, 9]])), 2 * 90 * 9);
    }

    #[test]
    fn one_corner_in_the_other() {
        // Outline of the union, with the two crossings at (4, 6) and (6, 4) cut off.
        assert_eq!(merge(&square(0, 0, 6), &square(4, 4, 6)), [[0, 0], [6, 0], [10, 4], [10, 10], [4, 10], [0, 6]]);
    }
}
