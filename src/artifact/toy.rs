//! Small made-up cities for tests: footprints of several shapes, their merge tree, and rings with notches.

use super::hulls::HullState;
use super::{Attributes, Column, Dendrogram, Footprints, Hulls, Landmarks, Shapes, Values};
use crate::geom::Point;
use crate::geom::cover::Cover;
use crate::geom::frame::Frame;
use crate::geom::predicates::{orient, segments_meet};
use crate::geom::ring::{area_m2, convex_hull};

/// A hash of a number, for choices that look random.
pub fn mix(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Everything that `tile` takes.
pub struct Toy {
    pub footprints: Footprints,
    pub dendrogram: Dendrogram,
    pub hulls: Hulls,
    pub landmarks: Landmarks,
}

/// The city of these buildings (numbers are identities: the same number is the same building in any row).
pub fn city(numbers: &[u64], seed: u64) -> Toy {
    let footprints = footprints(numbers, seed);
    let dendrogram = dendrogram(&footprints, numbers);
    let hulls = hulls(&footprints, &dendrogram);
    let (order, first) = dendrogram.leaf_order();
    let height: Vec<f64> = order.iter().map(|&b| footprints.height(b as usize)).collect();
    let landmarks = Landmarks {
        maxima: Landmarks::maxima_of(&height),
        size: hulls.buildings.clone(),
        cluster_height: hulls.height.clone(),
        order,
        first,
        height,
    };
    Toy { footprints, dendrogram, hulls, landmarks }
}

fn footprints(numbers: &[u64], seed: u64) -> Footprints {
    let mut polygons = Shapes::default();
    let (mut base, mut top, mut floors) = (Vec::new(), Vec::new(), Vec::new());
    for &b in numbers {
        let h = mix(seed ^ mix(b));
        let at = [(b % 8) as i32 * 30_000 + (h % 9_000) as i32, (b / 8) as i32 * 28_000 + (h / 9_000 % 8_000) as i32];
        let (w, d) = (8_000 + (h >> 20) as i32 % 6_000, 7_000 + (h >> 34) as i32 % 6_000);
        let ring: &[[i32; 2]] = match h >> 60 {
            0..5 => &[[0, 0], [6, 0], [6, 6], [0, 6]],
            5..8 => &[[0, 0], [6, 1], [5, 6], [1, 5]],
            8..11 => &[[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]],
            11..13 => &[[0, 0], [6, 0], [6, 6], [4, 6], [4, 2], [2, 2], [2, 6], [0, 6]],
            13..15 => &[[0, 0], [3, 1], [6, 0], [5, 3], [6, 6], [3, 5], [0, 6], [1, 3]],
            _ => &[[0, 0], [6, 0], [3, 6]],
        };
        let place = |p: &Point| [at[0] + p[0] * w / 6, at[1] + p[1] * d / 6];
        polygons.push_ring(&ring.iter().map(place).collect::<Vec<_>>());
        if h >> 60 == 2 {
            polygons.push_ring(&[[2, 2], [2, 4], [4, 4], [4, 2]].map(|p| place(&p)));
        }
        polygons.end_polygon();
        polygons.end_shape();
        let storeys = if (h >> 48).is_multiple_of(4) { 6 + (h >> 52) % 40 } else { 2 + (h >> 52) % 3 };
        base.push((h >> 40) as f64 % 4.0);
        top.push(base[base.len() - 1] + storeys as f64 * 3.0);
        floors.push(storeys as u32);
    }
    let present = vec![true; numbers.len()];
    Footprints {
        frame: Frame::local(),
        ids: numbers.iter().map(|b| format!("b{b}")).collect(),
        polygons,
        base,
        top,
        attributes: Attributes {
            columns: vec![Column { name: "floors".into(), values: Values::U32(floors), present }],
        },
    }
}

/// Size-weighted single link over first vertices, by brute force; the left child holds the lower rank.
fn dendrogram(footprints: &Footprints, numbers: &[u64]) -> Dendrogram {
    let n = numbers.len();
    let at = |i: usize| footprints.polygons.ring(footprints.polygons.polygons[i] as usize)[0].map(f64::from);
    let mut out = Dendrogram { leaves: vec![n as u32], ..Dendrogram::default() };
    let mut open: Vec<(u32, Vec<usize>)> = (0..n).map(|i| (i as u32, vec![i])).collect();
    let rank = |members: &[usize]| members.iter().map(|&i| mix(!numbers[i])).min();
    while open.len() > 1 {
        let mut best: Option<(f64, _, _, usize, usize)> = None;
        for a in 0..open.len() {
            for b in 0..open.len() {
                let (low, high) = (rank(&open[a].1), rank(&open[b].1));
                if low >= high {
                    continue;
                }
                let gaps = open[a].1.iter().flat_map(|&i| {
                    open[b].1.iter().map(move |&j| {
                        let (p, q) = (at(i), at(j));
                        ((p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1])).sqrt()
                    })
                });
                let cost = (open[a].1.len() * open[b].1.len()) as f64 * gaps.fold(f64::INFINITY, f64::min);
                if best.is_none_or(|t| (cost, low, high) < (t.0, t.1, t.2)) {
                    best = Some((cost, low, high, a, b));
                }
            }
        }
        let (cost, .., a, b) = best.unwrap();
        let (l, r) = (open[a].clone(), open[b].clone());
        let size = l.1.len() + r.1.len();
        out.left.push(l.0);
        out.right.push(r.0);
        out.size.push(size as u32);
        out.distance.push(cost / 1000.0);
        out.cost.push(cost / 1000.0);
        out.crosses_barrier.push(false);
        open[a] = ((n + out.left.len() - 1) as u32, [l.1, r.1].concat());
        open.remove(b);
    }
    out
}

fn hulls(footprints: &Footprints, tree: &Dendrogram) -> Hulls {
    let n = footprints.len();
    let (order, first) = tree.leaf_order();
    let shell = |i: u32| footprints.polygons.shells(i as usize).next().unwrap();
    let parents = tree.parents();
    let mut rings: Vec<Vec<Point>> = Vec::new();
    let mut out = Hulls {
        frame: footprints.frame.clone(),
        state: HullState::Simplified,
        vertices: Vec::new(),
        starts: vec![0],
        rings: Vec::new(),
        cluster: (0..tree.cluster_count() as u32).collect(),
        parent: parents,
        buildings: (0..tree.cluster_count() as u32).map(|c| tree.size_of(c)).collect(),
        merged_edges: Vec::new(),
        area_m2: Vec::new(),
        negative_space_m2: Vec::new(),
        ground: Vec::new(),
        height: Vec::new(),
    };
    for c in 0..tree.cluster_count() {
        let places = first[c] as usize..(first[c] + tree.size_of(c as u32)) as usize;
        let members: Vec<usize> = order[places].iter().map(|&b| b as usize).collect();
        let ring = match tree.children(c as u32) {
            None => shell(c as u32).to_vec(),
            Some([l, r]) => {
                let inside = [&rings[l as usize][..], &rings[r as usize]];
                let hull = convex_hull(&inside.concat());
                let ring = notched(&hull, &inside);
                let cover = Cover::new(std::iter::once(&ring[..]));
                if inside.concat().iter().all(|&p| cover.holds(p)) { ring } else { hull }
            }
        };
        let areas: Vec<f64> = members.iter().map(|&b| footprints.area_m2(b)).collect();
        let built: f64 = areas.iter().sum();
        let mean = |v: &dyn Fn(usize) -> f64| members.iter().zip(&areas).map(|(&b, a)| v(b) * a).sum::<f64>() / built;
        out.merged_edges.push(ring.len() as u32);
        out.area_m2.push(area_m2(&ring));
        out.negative_space_m2.push(area_m2(&ring) - built);
        out.ground.push(if c < n { footprints.base[c] } else { mean(&|b| footprints.base[b]) });
        out.height.push(if c < n { footprints.height(c) } else { mean(&|b| footprints.height(b)) });
        rings.push(ring);
    }
    out.vertices = rings.concat();
    out.vertices.sort_unstable();
    out.vertices.dedup();
    for ring in &rings {
        out.rings.extend(ring.iter().map(|p| out.vertices.binary_search(p).unwrap() as u32));
        out.starts.push(out.rings.len() as u32);
    }
    out
}

/// The convex ring with a dent in every edge where a dent of an eighth of its length meets nothing inside.
fn notched(hull: &[Point], inside: &[&[Point]]) -> Vec<Point> {
    let mut out = Vec::new();
    for (i, &a) in hull.iter().enumerate() {
        let b = hull[(i + 1) % hull.len()];
        let m = [a[0] / 2 + b[0] / 2 - (b[1] - a[1]) / 8, a[1] / 2 + b[1] / 2 + (b[0] - a[0]) / 8];
        out.push(a);
        let free = |ring: &[Point]| {
            ring.iter().enumerate().all(|(k, &p)| {
                let q = ring[(k + 1) % ring.len()];
                let within = orient(a, m, p) <= 0 && orient(m, b, p) <= 0;
                let shares = |v: Point| p == v || q == v;
                let meets = (!shares(a) && segments_meet(a, m, p, q)) || (!shares(b) && segments_meet(m, b, p, q));
                [p, q] != [a, b] && (p == a || p == b || !within) && !meets
            })
        };
        if orient(a, m, b) < 0 && inside.iter().all(|r| free(r)) {
            out.push(m);
        }
    }
    out
}
