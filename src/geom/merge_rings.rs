//! Two simple rings into one that contains both and has no other vertices than theirs.
//!
//! - Disjoint: two connection edges; of the two loops the larger. Signed area >= area(R) + area(S) proves that it
//!   contains both. An edge (u in R, v in S) is *clear* when it meets both rings in nothing but u and v; the pair
//!   that adds the least area is taken from the 16 shortest clear ones. (The two shortest add 2.5 times as much.)
//! - One inside the other: the outer one; of equal ones the first.
//! - Touching, crossing, or interlocked: [`erode`](super::erode).
//!
//! Ties go by lengths, then by vertex ids. Source: Chang et al., Hierarchical Simplification of City Models to
//! Maintain Urban Legibility, section 5.

use super::Point;
use super::erode::erode;
use super::predicates::{on_segment, orient, segments_meet};
use super::ring::contains;
use super::segments::{Rect, Segment, near_pairs};

/// A ring's vertex: where, and its number among all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Vertex {
    pub id: u32,
    pub at: Point,
}

/// How many of the shortest clear edges compete. 8 leave 18 % more negative space, 40 take off 5 %.
const CLEAR: usize = 16;

/// The ring around `r` and `s`: both simple, counter-clockwise, equal points by equal ids. What comes out is too.
pub fn merge(r: &[Vertex], s: &[Vertex]) -> Vec<Vertex> {
    let (rect_r, rect_s) = (Rect::of(r.iter().map(|v| v.at)), Rect::of(s.iter().map(|v| v.at)));
    let touching = rect_r.meets(&rect_s) && in_contact(r, s, &rect_r.intersection(&rect_s));
    let points = |ring: &[Vertex]| -> Vec<Point> { ring.iter().map(|v| v.at).collect() };
    if rect_r.contains(&rect_s) && contains(&points(r), &points(s)) {
        return r.to_vec();
    }
    if rect_s.contains(&rect_r) && contains(&points(s), &points(r)) {
        return s.to_vec();
    }
    if !touching && let Some(ring) = connect(r, s, &rect_r, &rect_s) {
        return ring;
    }
    eroded(r, s)
}

fn pair(ring: &[Vertex], i: usize) -> Segment {
    [ring[i].at, ring[if i + 1 == ring.len() { 0 } else { i + 1 }].at]
}

fn edges_in(ring: &[Vertex], rect: &Rect) -> Vec<Segment> {
    (0..ring.len()).map(|i| pair(ring, i)).filter(|&[a, b]| rect.meets_segment(a, b)).collect()
}

/// True where the outlines share a point.
fn in_contact(r: &[Vertex], s: &[Vertex], rect: &Rect) -> bool {
    let (a, b) = (edges_in(r, rect), edges_in(s, rect));
    near_pairs(&a, &b, |i, j| {
        let ([a, b], [c, d]) = (a[i as usize], b[j as usize]);
        segments_meet(a, b, c, d)
    })
}

/// A candidate connection: squared length, vertex of R, vertex of S (places).
type Chord = (i64, u32, u32);

fn connect(r: &[Vertex], s: &[Vertex], rect_r: &Rect, rect_s: &Rect) -> Option<Vec<Vertex>> {
    let (sum_r, sum_s) = (sums(r), sums(s));
    let small = r.len() * s.len() <= 1024;
    let widest = |k: usize| i64::from(rect_r.high[k].max(rect_s.high[k])) - i64::from(rect_r.low[k].min(rect_s.low[k]));
    let all = widest(0).max(widest(1)) * 2;
    let gap = |k: usize| {
        let apart = (i64::from(rect_s.low[k]) - i64::from(rect_r.high[k]))
            .max(i64::from(rect_r.low[k]) - i64::from(rect_s.high[k]));
        apart.max(0)
    };
    let mut margin = if small { all } else { gap(0) + gap(1) + 4000 };
    loop {
        let chords = chords(r, s, rect_r, rect_s, margin);
        let found = best_pair(r, s, &sum_r, &sum_s, chords, margin >= all);
        if found.is_some() || margin >= all {
            return found;
        }
        margin = (3 * margin).min(all);
    }
}

/// Partial sums of cross products along a ring relative to its first vertex: what a chain adds to a doubled area.
fn sums(ring: &[Vertex]) -> Vec<i64> {
    let mut out = Vec::with_capacity(ring.len() + 1);
    let mut sum = 0i64;
    out.push(0);
    for i in 0..ring.len() {
        let [a, b] = pair(ring, i);
        sum = sum.wrapping_add(orient(ring[0].at, a, b));
        out.push(sum);
    }
    out
}

/// All connections not longer than `margin`.
fn chords(r: &[Vertex], s: &[Vertex], rect_r: &Rect, rect_s: &Rect, margin: i64) -> Vec<Chord> {
    let near = |ring: &[Vertex], rect: &Rect| -> Vec<u32> {
        let within = |v: &Vertex| {
            (0..2).all(|k| {
                let c = i64::from(v.at[k]);
                c >= i64::from(rect.low[k]) - margin && c <= i64::from(rect.high[k]) + margin
            })
        };
        (0..ring.len() as u32).filter(|&i| within(&ring[i as usize])).collect()
    };
    let (us, mut vs) = (near(r, rect_s), near(s, rect_r));
    vs.sort_by_key(|&v| s[v as usize].at[0]);
    let mut out = Vec::new();
    for &u in &us {
        let p = r[u as usize].at;
        let from = vs.partition_point(|&v| i64::from(s[v as usize].at[0]) < i64::from(p[0]) - margin);
        for &v in &vs[from..] {
            let d = [0, 1].map(|k| i64::from(s[v as usize].at[k]) - i64::from(p[k]));
            if d[0] > margin {
                break;
            }
            let length = d[0] * d[0] + d[1] * d[1];
            if d[1].abs() <= margin && (length as f64) <= (margin as f64) * (margin as f64) {
                out.push((length, u, v));
            }
        }
    }
    out
}

/// Of the shortest clear connections the pair that adds the least. `last`: no longer ones exist, so make do.
fn best_pair(
    r: &[Vertex],
    s: &[Vertex],
    sum_r: &[i64],
    sum_s: &[i64],
    mut chords: Vec<Chord>,
    last: bool,
) -> Option<Vec<Vertex>> {
    let key = |c: &Chord| (c.0, r[c.1 as usize].id, s[c.2 as usize].id);
    let mut clear: Vec<Chord> = Vec::with_capacity(CLEAR);
    let mut best: Option<((i64, i64, usize, usize), Chord, Chord)> = None;
    let mut done = 0;
    let mut step = 64;
    let mut obstacles: Vec<Segment> = Vec::new();
    let mut known = Rect::EMPTY;
    while done < chords.len() {
        let rest = &mut chords[done..];
        let take = step.min(rest.len());
        if take < rest.len() {
            rest.select_nth_unstable_by_key(take - 1, key);
        }
        rest[..take].sort_unstable_by_key(key);
        let batch = &rest[..take];
        let rect = Rect::of(batch.iter().flat_map(|c| [r[c.1 as usize].at, s[c.2 as usize].at]));
        if !known.contains(&rect) {
            known = Rect::of(
                [known.low, known.high, rect.low, rect.high]
                    .into_iter()
                    .filter(|p| p[0] != i32::MAX && p[0] != i32::MIN),
            );
            obstacles = edges_in(r, &known);
            obstacles.extend(edges_in(s, &known));
        }
        for &chord in batch {
            let ends = [r[chord.1 as usize].at, s[chord.2 as usize].at];
            if !is_clear(ends, &obstacles) {
                continue;
            }
            for (k, &other) in clear.iter().enumerate() {
                if let Some(added) = added(r, s, sum_r, sum_s, other, chord) {
                    let key = (added, chord.0 + other.0, k, clear.len());
                    if best.as_ref().is_none_or(|b| key < b.0) {
                        best = Some((key, other, chord));
                    }
                }
            }
            clear.push(chord);
            if clear.len() >= CLEAR
                && let Some((_, one, two)) = best
            {
                return Some(trace(r, s, sum_r, sum_s, one, two));
            }
        }
        done += take;
        step *= 2;
    }
    let (_, one, two) = best.filter(|_| last)?;
    Some(trace(r, s, sum_r, sum_s, one, two))
}

/// True where the connection meets the outlines in nothing but its own ends.
fn is_clear([u, v]: [Point; 2], obstacles: &[Segment]) -> bool {
    let rect = Rect::of([u, v]);
    obstacles.iter().all(|&[a, b]| {
        if !rect.meets_segment(a, b) {
            return true;
        }
        let shared = |end: Point| if a == end { Some(b) } else { Some(a).filter(|_| b == end) };
        match shared(u).or_else(|| shared(v)) {
            Some(other) => !on_segment(u, v, other) && !(on_segment(a, b, u) && on_segment(a, b, v)),
            None => !segments_meet(u, v, a, b),
        }
    })
}

/// Doubled area of the loop: R from `one` to `two`, over to S, S from `two` to `one`, and back.
fn loop_area(r: &[Vertex], s: &[Vertex], sum_r: &[i64], sum_s: &[i64], one: Chord, two: Chord) -> i64 {
    // Relative to R's first vertex; S's sums are relative to its own, so the chain is moved by what its ends tell.
    let o = r[0].at;
    let chain = |sum: &[i64], from: u32, to: u32| {
        let part = sum[to as usize].wrapping_sub(sum[from as usize]);
        if to < from { part.wrapping_add(sum[sum.len() - 1]) } else { part }
    };
    let (u1, v1) = (r[one.1 as usize].at, s[one.2 as usize].at);
    let (u2, v2) = (r[two.1 as usize].at, s[two.2 as usize].at);
    // sum of cross(a - o, b - o) over a chain p..q = the same about o' + cross(o' - o, q - p).
    let moved = orient(
        o,
        s[0].at,
        [s[0].at[0].wrapping_add(v1[0]).wrapping_sub(v2[0]), s[0].at[1].wrapping_add(v1[1]).wrapping_sub(v2[1])],
    );
    chain(sum_r, one.1, two.1)
        .wrapping_add(orient(o, u2, v2))
        .wrapping_add(chain(sum_s, two.2, one.2))
        .wrapping_add(moved)
        .wrapping_add(orient(o, v1, u1))
}

/// What the better of the two loops adds to the areas of both, doubled; none where the pair cannot be used.
fn added(r: &[Vertex], s: &[Vertex], sum_r: &[i64], sum_s: &[i64], one: Chord, two: Chord) -> Option<i64> {
    if one.1 == two.1 || one.2 == two.2 {
        return None;
    }
    let at = |c: Chord| [r[c.1 as usize].at, s[c.2 as usize].at];
    let ([a, b], [c, d]) = (at(one), at(two));
    if segments_meet(a, b, c, d) {
        return None;
    }
    let both = sum_r[r.len()].wrapping_add(sum_s[s.len()]);
    let area = loop_area(r, s, sum_r, sum_s, one, two).max(loop_area(r, s, sum_r, sum_s, two, one));
    Some(area - both).filter(|&a| a >= 0)
}

fn trace(r: &[Vertex], s: &[Vertex], sum_r: &[i64], sum_s: &[i64], one: Chord, two: Chord) -> Vec<Vertex> {
    let swap = loop_area(r, s, sum_r, sum_s, two, one) > loop_area(r, s, sum_r, sum_s, one, two);
    let (one, two) = if swap { (two, one) } else { (one, two) };
    let mut out = Vec::new();
    let mut chain = |ring: &[Vertex], from: u32, to: u32| {
        let (from, to) = (from as usize, to as usize);
        if from <= to {
            out.extend_from_slice(&ring[from..=to]);
        } else {
            out.extend_from_slice(&ring[from..]);
            out.extend_from_slice(&ring[..=to]);
        }
    };
    chain(r, one.1, two.1);
    chain(s, two.2, one.2);
    out
}

/// What is in contact or interlocked.
fn eroded(r: &[Vertex], s: &[Vertex]) -> Vec<Vertex> {
    let mut vertices: Vec<Vertex> = r.iter().chain(s).copied().collect();
    let mut sorted = vertices.clone();
    sorted.sort_unstable();
    sorted.dedup();
    let place = |v: Vertex| sorted.binary_search(&v).expect("all are there") as u32;
    let mut segments = Vec::with_capacity(vertices.len());
    for ring in [r, s] {
        let places: Vec<u32> = ring.iter().map(|&v| place(v)).collect();
        segments.extend((0..places.len()).map(|i| [places[i], places[(i + 1) % places.len()]]));
    }
    let points: Vec<Point> = sorted.iter().map(|v| v.at).collect();
    let ring = erode(&points, &segments).expect("rings have area");
    vertices.clear();
    vertices.extend(ring.iter().map(|&i| sorted[i as usize]));
    vertices
}

#[cfg(test)]
mod tests {
    use super::super::ring::doubled_area;
    use super::super::segments::is_simple;
    use super::*;

    fn ring(points: &[Point]) -> Vec<Vertex> {
        // Ids that do not depend on the order, and are equal for equal points.
        points.iter().map(|&at| Vertex { id: ((at[0] + 500) * 1000 + at[1] + 500) as u32, at }).collect()
    }
    fn points(r: &[Vertex]) -> Vec<Point> {
        r.iter().map(|v| v.at).collect()
    }
    fn square(x: i32, y: i32, side: i32) -> Vec<Vertex> {
        ring(&[[x, y], [x + side, y], [x + side, y + side], [x, y + side]])
    }

    #[test]
    fn two_squares_apart() {
        assert_eq!(
            points(&merge(&square(0, 0, 2), &square(5, 0, 2))),
            [[2, 2], [0, 2], [0, 0], [2, 0], [5, 0], [7, 0], [7, 2], [5, 2]]
        );
    }

    #[test]
    fn nested_equal_touching_and_crossing() {
        let big = square(0, 0, 9);
        assert_eq!(merge(&big, &square(2, 2, 3)), big);
        assert_eq!(merge(&square(0, 0, 3), &big), big);
        assert_eq!(merge(&big, &big), big);
        // A shared wall: the two ends of the wall stay as collinear vertices.
        let walls = merge(&square(0, 0, 4), &square(4, 0, 4));
        assert_eq!(doubled_area(&points(&walls)), 2 * 32);
        let cross = merge(&ring(&[[0, 3], [9, 3], [9, 6], [0, 6]]), &ring(&[[3, 0], [6, 0], [6, 9], [3, 9]]));
        assert_eq!((cross.len(), is_simple(&points(&cross))), (8, true));
        // A lid over a notch: all vertices and all edge midpoints are on the other ring, yet it is not inside.
        let notch = ring(&[[0, 0], [90, 0], [90, 9], [30, 9], [30, 3], [10, 3], [10, 9], [0, 9]]);
        let lid = ring(&[[0, 5], [90, 5], [90, 9], [0, 9]]);
        assert_eq!(doubled_area(&points(&merge(&notch, &lid))), 2 * 90 * 9);
    }
}
