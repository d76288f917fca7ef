//! What overlapping buildings cover twice, for every cluster of a tree at once.
//!
//! Only groups of buildings that overlap, directly or through others, matter; their union is measured wherever two
//! or more members of a group come together, so that threefold overlaps count once as well.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::Point;
use super::near_boxes;
use super::predicates::{orient, segments_cross, segments_meet};
use super::ring::doubled_area;
use super::segments::{Rect, Segment, edges, near_pairs};
use super::union_area::{Polygon, doubled_union_area};

/// A merge tree as this module needs it: leaves at places 0..n, clusters over ranges of places.
pub struct Tree<'a> {
    /// First place and number of leaves of each cluster.
    pub first: &'a [u32],
    pub size: &'a [u32],
    /// Parent of each cluster, `u32::MAX` at the root.
    pub parent: &'a [u32],
    /// Cluster of the leaf at each place.
    pub leaf: &'a [u32],
}

/// The polygons of the building at a place.
pub type Polygons<'a, 'f> = &'f (dyn Fn(usize) -> Vec<Polygon<'a>> + Sync);

/// For every cluster what its children's unions cover both, doubled square millimetres: area of the union =
/// sum over both children - this. `area` and `polygons` are of the buildings by place.
pub fn covered_twice<'a>(tree: &Tree, area: &[f64], polygons: Polygons<'a, '_>) -> Vec<f64> {
    let of_groups: Vec<Vec<(u32, f64)>> =
        groups(area.len(), polygons).par_iter().map(|group| of_group(tree, area, polygons, group)).collect();
    let mut out = vec![0.0; tree.size.len()];
    of_groups.iter().flatten().for_each(|&(cluster, twice)| out[cluster as usize] += twice);
    out
}

/// What the buildings at these places cover twice, by cluster.
fn of_group(tree: &Tree, area: &[f64], polygons: Polygons, group: &[u32]) -> Vec<(u32, f64)> {
    let mut out = Vec::new();
    // Excess of the sum of the areas over the union, by cluster: at every place where members come together.
    let mut excess: BTreeMap<(u32, u32), f64> = BTreeMap::new();
    let mut joins: Vec<u32> = group.windows(2).map(|w| common(tree, w[0], w[1])).collect();
    joins.sort_unstable_by_key(|&c| (tree.size[c as usize], c));
    joins.dedup();
    for cluster in joins {
        let (from, size) = (tree.first[cluster as usize], tree.size[cluster as usize]);
        let below = &group[group.partition_point(|&p| p < from)..group.partition_point(|&p| p < from + size)];
        let all: Vec<Polygon> = below.iter().flat_map(|&p| polygons(p as usize)).collect();
        let sum: f64 = below.iter().map(|&p| area[p as usize]).sum();
        let now = sum - doubled_union_area(&all);
        // Members that came together further down: their excess is known there.
        let inner: Vec<(u32, u32)> = excess.range((from, 0)..(from + size, 0)).map(|(k, _)| *k).collect();
        let before: f64 = inner.iter().map(|k| excess.remove(k).unwrap_or(0.0)).sum();
        out.push((cluster, now - before));
        excess.insert((from, size), now);
    }
    out
}

/// The lowest cluster over two places.
fn common(tree: &Tree, p: u32, q: u32) -> u32 {
    let mut cluster = tree.leaf[p as usize];
    while !(tree.first[cluster as usize]..tree.first[cluster as usize] + tree.size[cluster as usize]).contains(&q) {
        cluster = tree.parent[cluster as usize];
    }
    cluster
}

/// Places that overlap each other, directly or through others; sorted, by first place.
fn groups(n: usize, polygons: Polygons) -> Vec<Vec<u32>> {
    let outline = |p: usize| Rect::of(polygons(p).iter().flat_map(|q| q.shell.iter().copied()));
    let boxes: Vec<Rect> = (0..n).into_par_iter().map(outline).collect();
    let pairs = near_boxes::overlapping(&boxes);
    let true_pairs: Vec<(u32, u32)> = pairs
        .into_par_iter()
        .filter(|&(i, j)| {
            let (p, q) = (polygons(i as usize), polygons(j as usize));
            p.iter().any(|p| q.iter().any(|q| overlap(p.shell, q.shell)))
        })
        .collect();
    let mut root: Vec<u32> = (0..n as u32).collect();
    fn find(root: &mut [u32], mut i: u32) -> u32 {
        while root[i as usize] != i {
            root[i as usize] = root[root[i as usize] as usize];
            i = root[i as usize];
        }
        i
    }
    for (i, j) in true_pairs {
        let (a, b) = (find(&mut root, i), find(&mut root, j));
        root[a.max(b) as usize] = a.min(b);
    }
    let mut members: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for p in 0..n as u32 {
        let top = find(&mut root, p);
        if top != p {
            members.entry(top).or_insert_with(|| vec![top]).push(p);
        }
    }
    members.into_values().collect()
}

/// True where the insides of two outlines share a point; touching is not enough. Exact for simple outlines.
pub fn overlap(r: &[Point], s: &[Point]) -> bool {
    if parts(r, s) || parts(s, r) {
        return false;
    }
    let (a, b): (Vec<Segment>, Vec<Segment>) = (edges(r).collect(), edges(s).collect());
    let mut touching = false;
    let crossing = near_pairs(&a, &b, |i, j| {
        let ([p, q], [c, d]) = (a[i as usize], b[j as usize]);
        touching |= segments_meet(p, q, c, d);
        segments_cross(p, q, c, d)
    });
    if crossing || !touching {
        return crossing || r.first().is_some_and(|&p| inside(s, p)) || s.first().is_some_and(|&p| inside(r, p));
    }
    // All places where they meet are vertices now, so the shared area is a whole number of half square millimetres.
    let one = |ring| doubled_union_area(&[Polygon { shell: ring, holes: Vec::new() }]);
    let both = [r, s].map(|shell| Polygon { shell, holes: Vec::new() });
    one(r) + one(s) - doubled_union_area(&both) > 0.5
}

/// True where an edge of the counter-clockwise outline `r` lies on a line between the two.
fn parts(r: &[Point], s: &[Point]) -> bool {
    edges(r).any(|[a, b]| a != b && s.iter().all(|&p| orient(a, b, p) <= 0) && r.iter().all(|&p| orient(a, b, p) >= 0))
}

/// True where the outline winds around a point that is not on it.
fn inside(ring: &[Point], p: Point) -> bool {
    edges(ring).filter(|&[a, b]| (a[1] > p[1]) != (b[1] > p[1]) && (orient(a, b, p) > 0) == (b[1] > a[1])).count() % 2
        == 1
}

/// Doubled area of a building without its courtyards; `simple`: its only ring crosses nothing.
pub fn built_area(polygons: &[Polygon], simple: bool) -> f64 {
    match polygons {
        [one] if simple && one.holes.is_empty() => doubled_area(one.shell).abs() as f64,
        _ => doubled_union_area(polygons),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: i32, y: i32, side: i32) -> Vec<Point> {
        vec![[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
    }

    #[test]
    fn overlapping_or_touching() {
        let big = square(0, 0, 9);
        assert!(overlap(&big, &square(5, 5, 9)));
        assert!(overlap(&big, &square(2, 2, 2)) && overlap(&square(2, 2, 2), &big) && overlap(&big, &big));
        assert!(overlap(&big, &square(0, 0, 4)));
        assert!(!overlap(&big, &square(9, 0, 9)) && !overlap(&big, &square(9, 9, 2)));
    }

    #[test]
    fn three_over_each_other() {
        // Leaves 0, 1, 2; cluster 3 = (0, 1), cluster 4 = (3, 2). All three cover [4, 6] x [4, 6].
        let shells = [square(0, 0, 6), square(4, 4, 6), square(2, 2, 6)];
        let polygons = |p: usize| vec![Polygon { shell: &shells[p][..], holes: vec![] }];
        let tree =
            Tree { first: &[0, 1, 2, 0, 0], size: &[1, 1, 1, 2, 3], parent: &[3, 3, 4, 4, u32::MAX], leaf: &[0, 1, 2] };
        let twice = covered_twice(&tree, &[72.0; 3], &polygons);
        // 0 and 1 share 2 x 2; then the third shares 4 x 4 with each, 2 x 2 of it with both.
        assert_eq!(twice, [0.0, 0.0, 0.0, 8.0, 2.0 * (16.0 + 16.0 - 4.0)]);
    }
}
