//! Against a greedy that knows nothing but the definition.

use std::sync::Arc;

use super::*;
use crate::artifact::{Attributes, Shapes};
use crate::geom::Point;
use crate::geom::frame::Frame;
use crate::geom::gap::gap;
use crate::geom::predicates::segments_meet;
use crate::op::Bench;

fn cluster(footprints: &Footprints, barriers: Vec<[Point; 2]>, how: &Cluster) -> Dendrogram {
    super::cluster(footprints, barriers, how, &AtomicBool::new(false))
}

/// The definition, O(n^3): of all pairs the first in (crosses, cost, ranks), again and again.
fn brute_force(ids: &Strings, distance: impl Fn(usize, usize) -> (f64, bool)) -> Dendrogram {
    let n = ids.len();
    let never = AtomicBool::new(false);
    let ranking = Ranking::new(ids, &never);
    let pairs: Vec<(f64, bool)> = (0..n * n).map(|k| distance(k / n, k % n)).collect();
    let mut clusters: Vec<(u32, u32, Vec<usize>)> = (0..n).map(|i| (i as u32, ranking.of[i], vec![i])).collect();
    let mut out = Dendrogram { leaves: vec![n as u32], ..Dendrogram::default() };
    while clusters.len() > 1 {
        let mut best: Option<((bool, f64, u32, u32), usize, usize, f64)> = None;
        for a in 0..clusters.len() {
            for b in a + 1..clusters.len() {
                let (ca, cb) = (&clusters[a], &clusters[b]);
                let (mut seen, mut plain) = (f64::INFINITY, f64::INFINITY);
                for &x in &ca.2 {
                    for &y in &cb.2 {
                        let (d, sees) = pairs[x * n + y];
                        assert_eq!(d.to_bits(), pairs[y * n + x].0.to_bits());
                        plain = plain.min(d);
                        seen = if sees { seen.min(d) } else { seen };
                    }
                }
                let (crosses, d) = if seen.is_finite() { (false, seen) } else { (true, plain) };
                let cost = (ca.2.len() as u64 * cb.2.len() as u64) as f64 * d;
                let key = (crosses, cost, ca.1.min(cb.1), ca.1.max(cb.1));
                if best.is_none_or(|(k, ..)| key < k) {
                    best = Some((key, a, b, d));
                }
            }
        }
        let Some(((crosses, ..), a, b, d)) = best else { unreachable!() };
        let sizes: Vec<usize> = clusters.iter().map(|c| c.2.len()).filter(|&s| s > 1).collect();
        let avg = if sizes.is_empty() { 1.0 } else { sizes.iter().sum::<usize>() as f64 / sizes.len() as f64 };
        let cb = clusters.remove(b);
        let ca = std::mem::take(&mut clusters[a]);
        let (left, right) = if ca.1 < cb.1 { (ca, cb) } else { (cb, ca) };
        out.left.push(left.0);
        out.right.push(right.0);
        out.distance.push(d / 1000.0);
        out.cost.push((left.2.len() * right.2.len()) as f64 * (d / 1000.0) / (avg * avg));
        out.size.push((left.2.len() + right.2.len()) as u32);
        out.crosses_barrier.push(crosses);
        clusters[a] = ((n + out.size.len() - 1) as u32, left.1, [left.2, right.2].concat());
    }
    out
}

fn centre_distance(centres: &[Point]) -> impl Fn(usize, usize) -> (f64, bool) {
    |a, b| {
        let d = |k: usize| i64::from(centres[a][k]) - i64::from(centres[b][k]);
        (((d(0) * d(0) + d(1) * d(1)) as f64).sqrt().max(10.0), true)
    }
}

fn footprints(rings: &[Vec<Point>], salt: u32) -> Footprints {
    let mut polygons = Shapes::default();
    for ring in rings {
        polygons.push_ring(ring);
        polygons.end_polygon();
        polygons.end_shape();
    }
    Footprints {
        frame: Frame::local(),
        ids: (0..rings.len()).map(|i| format!("b{}-{salt}", i)).collect(),
        polygons,
        base: vec![0.0; rings.len()],
        top: vec![3.0; rings.len()],
        attributes: Attributes::default(),
    }
}

/// Squares of side 2 around centres.
fn dots(centres: &[Point], salt: u32) -> Footprints {
    let around = |&[x, y]: &Point| vec![[x - 1, y - 1], [x + 1, y - 1], [x + 1, y + 1], [x - 1, y + 1]];
    footprints(&centres.iter().map(around).collect::<Vec<_>>(), salt)
}

/// A small generator of its own: the same numbers everywhere.
struct Dice(u64);

impl Dice {
    fn below(&mut self, n: i32) -> i32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (((self.0 >> 33) * n as u64) >> 31) as i32
    }
}

/// Layouts that break one method or another.
fn layouts(seed: u64) -> Vec<(&'static str, Vec<Point>)> {
    let mut dice = Dice(seed);
    let mut random = |n: usize, side: i32, step: i32| -> Vec<Point> {
        (0..n).map(|_| [dice.below(side) * step, dice.below(side) * step]).collect()
    };
    let mut all = vec![
        ("random", random(60, 100_000, 1)),
        ("few places, many ties", random(60, 9, 100)),
        ("within the floor", random(40, 12, 1)),
        ("sites", {
            let sites = random(5, 50_000, 1);
            random(60, 5, 1).iter().map(|p| sites[p[0] as usize]).collect()
        }),
        ("towns", {
            let (towns, near) = (random(6, 2_000_000, 1), random(60, 3_000, 1));
            near.iter().enumerate().map(|(i, p)| [towns[i % 6][0] + p[0], towns[i % 6][1] + p[1]]).collect()
        }),
    ];
    all.push(("grid", (0..64).map(|i| [i % 8 * 1000, i / 8 * 1000]).collect()));
    all.push(("rows", (0..60).map(|i| [i % 20 * 1000, i / 20 * 7000]).collect()));
    all.push(("squares on a line", (0..50).map(|i| [i * i * 100, 0]).collect()));
    // The wall merges first, then the two single points through it.
    let wall = (0..10).map(|i| [0, -45 * 100 + i * 1000]);
    all.push(("through the wall", wall.chain([[-100_000, 0], [100_000, 0]]).collect()));
    all
}

#[test]
fn equals_brute_force() {
    for seed in 0..12 {
        for (name, centres) in layouts(seed) {
            let all = dots(&centres, seed as u32);
            let tree = cluster(&all, Vec::new(), &Cluster::default());
            assert_eq!(tree, brute_force(&all.ids, centre_distance(&centres)), "{name}, seed {seed}");
        }
    }
}

/// Barriers as random segments, a street grid, and a comb of dead ends.
fn barriers(seed: u64, centres: &[Point]) -> Vec<Vec<[Point; 2]>> {
    let mut dice = Dice(seed);
    let all = crate::geom::bounds::Bounds::of(centres.iter().copied());
    let size = [(all.high[0] - all.low[0]).max(4), (all.high[1] - all.low[1]).max(4)];
    let mut random = || [all.low[0] + dice.below(size[0]), all.low[1] + dice.below(size[1])];
    let few = (0..6).map(|_| [random(), random()]).collect();
    let short = (0..40).map(|_| random()).map(|p| [p, [p[0] + size[0] / 9, p[1] + size[1] / 13]]).collect();
    let [x, y] = all.low;
    let streets = (0..4).flat_map(|i| {
        let (dx, dy) = (size[0] / 4 * i + size[0] / 9, size[1] / 4 * i + size[1] / 7);
        [[[x + dx, y - 9], [x + dx + 1, y + size[1] + 9]], [[x - 9, y + dy], [x + size[0] + 9, y + dy]]]
    });
    let comb = (0..8).map(|i| x + size[0] / 8 * i + 1).map(|at| [[at, y - 5], [at, y + size[1] * 3 / 4]]);
    vec![few, short, streets.collect(), comb.collect()]
}

#[test]
fn equals_brute_force_with_barriers() {
    let mut crossed = 0;
    for seed in 0..4 {
        for (name, centres) in layouts(seed) {
            for (k, barriers) in barriers(seed + 50, &centres).into_iter().enumerate() {
                let all = dots(&centres, seed as u32);
                let meets = |a: Point, b: Point| barriers.iter().any(|s| segments_meet(a, b, s[0], s[1]));
                let plain = centre_distance(&centres);
                let tree = cluster(&all, barriers.clone(), &Cluster::default());
                let sure = brute_force(&all.ids, |a, b| (plain(a, b).0, !meets(centres[a], centres[b])));
                assert_eq!(tree, sure, "{name}, seed {seed}, barriers {k}");
                crossed += tree.crosses_barrier.iter().filter(|&&c| c).count();
            }
        }
    }
    assert!(crossed > 500);
}

/// L-shapes, slivers and squares of different sizes around the centres: apart, touching, overlapping, nested.
fn houses(centres: &[Point], size: i32, seed: u64) -> Vec<Vec<Point>> {
    let mut dice = Dice(seed);
    let house = |&[x, y]: &Point| {
        let (w, h) = (2 + dice.below(size), 2 + dice.below(size));
        match dice.below(3) {
            0 => vec![[x, y], [x + 2 * w, y], [x + 2 * w, y + h], [x + w, y + h], [x + w, y + 2 * h], [x, y + 2 * h]],
            1 => vec![[x, y], [x + w, y + h / 3], [x + w / 2, y + h]],
            _ => vec![[x, y], [x + w, y], [x + w, y + h], [x, y + h]],
        }
    };
    centres.iter().map(house).collect()
}

#[test]
fn equals_brute_force_between_outlines() {
    let how = Cluster { distance: Distance::Footprint, ..Cluster::default() };
    for seed in 0..1 {
        for (name, centres) in layouts(seed) {
            for size in [30, 8000] {
                let rings = houses(&centres, size, seed + 5);
                let all = footprints(&rings, seed as u32);
                let gaps = |a: usize, b: usize| gap(&[&rings[a]], &[&rings[b]]).max(10.0);
                let sure = brute_force(&all.ids, |a, b| (gaps(a, b), true));
                assert_eq!(cluster(&all, Vec::new(), &how), sure, "{name}, seed {seed}, size {size}");
                for (k, barriers) in barriers(seed + 50, &centres).into_iter().enumerate() {
                    let grid = SegmentGrid::new(barriers.clone());
                    let sees = |a: usize, b: usize| !outlines::blocked(&[&rings[a]], &[&rings[b]], &grid);
                    let sure = brute_force(&all.ids, |a, b| (gaps(a, b), a == b || sees(a, b)));
                    assert_eq!(cluster(&all, barriers, &how), sure, "{name}, seed {seed}, size {size}, barriers {k}");
                }
            }
        }
    }
}

#[test]
fn a_wish_to_stop_ends_it() {
    let stop = AtomicBool::new(true);
    for how in [Distance::Centroid, Distance::Footprint] {
        for barriers in [Vec::new(), vec![[[0, -9], [0, 9]]]] {
            let how = Cluster { distance: how, ..Cluster::default() };
            let tree = super::cluster(&dots(&[[-5, 0], [5, 0], [9, 0]], 0), barriers, &how, &stop);
            assert_eq!((tree.left.len(), tree.leaf_count()), (0, 3));
        }
    }
    let bench = Bench::interrupted();
    let input = In { footprints: Arc::new(dots(&[[0, 0], [1000, 0]], 0)), barriers: Vec::new() };
    assert_eq!(Cluster::default().run(&bench.ctx(), input).unwrap_err().code, "interrupted");
}

#[test]
fn smallest_cases() {
    for n in 0..4 {
        let centres: Vec<Point> = (0..n).map(|i| [i * 5000, 0]).collect();
        let all = dots(&centres, 0);
        let tree = cluster(&all, Vec::new(), &Cluster::default());
        assert_eq!(tree.leaf_count(), n as usize);
        assert_eq!(tree.left.len(), (n as usize).saturating_sub(1));
        assert_eq!(tree, brute_force(&all.ids, centre_distance(&centres)));
    }
    let two = cluster(&dots(&[[0, 0], [3000, 4000]], 0), Vec::new(), &Cluster::default());
    assert_eq!((two.distance, two.cost, two.size), (vec![5.0], vec![5.0], vec![2]));
}

#[test]
fn the_order_of_the_features_does_not_matter() {
    for (name, centres) in layouts(77) {
        let all = dots(&centres, 0);
        let n = all.len();
        let order: Vec<usize> = (0..n).map(|i| (i * 37 + 5) % n).collect();
        let mut seen = order.clone();
        seen.sort_unstable();
        seen.dedup();
        if seen.len() < n {
            continue;
        }
        let mut shuffled = dots(&order.iter().map(|&i| centres[i]).collect::<Vec<_>>(), 0);
        shuffled.ids = order.iter().map(|&i| all.ids.get(i)).collect();
        let (a, b) =
            (cluster(&all, Vec::new(), &Cluster::default()), cluster(&shuffled, Vec::new(), &Cluster::default()));
        let back = |c: u32| if (c as usize) < n { order[c as usize] as u32 } else { c };
        assert_eq!(a.left, b.left.iter().map(|&c| back(c)).collect::<Vec<_>>(), "{name}");
        assert_eq!(a.right, b.right.iter().map(|&c| back(c)).collect::<Vec<_>>(), "{name}");
        assert_eq!((a.cost, a.distance, a.size), (b.cost, b.distance, b.size), "{name}");
    }
}

#[test]
fn turned_and_moved() {
    for (name, centres) in layouts(5) {
        let tree = cluster(&dots(&centres, 0), Vec::new(), &Cluster::default());
        let turned: Vec<Point> = centres.iter().map(|p| [-p[1], p[0]]).collect();
        assert_eq!(tree, cluster(&dots(&turned, 0), Vec::new(), &Cluster::default()), "{name}");
        let moved: Vec<Point> = centres.iter().map(|p| [p[0] + 500_000_000, p[1] - 500_000_000]).collect();
        assert_eq!(tree, cluster(&dots(&moved, 0), Vec::new(), &Cluster::default()), "{name}");
    }
}

/// How often a merge is cheaper than the one before it, among those that cross no barrier and among those that do;
/// and how often one that crosses comes before one that does not. Costs without `avg`, to the last bits: a distance in
/// metres is one rounding away from that in millimetres.
fn falls(tree: &Dendrogram) -> usize {
    let size = |c: u32| u64::from(tree.size_of(c));
    let plain = |i: usize| (size(tree.left[i]) * size(tree.right[i])) as f64 * tree.distance[i];
    let crosses = &tree.crosses_barrier;
    let falls = |i: &usize| match (crosses[i - 1], crosses[*i]) {
        (false, true) => false,
        (true, false) => true,
        _ => plain(i - 1) > plain(*i) * (1.0 + 1e-15),
    };
    (1..tree.left.len()).filter(falls).count()
}

#[test]
fn costs_never_fall() {
    for (name, centres) in layouts(9) {
        let tree = cluster(&dots(&centres, 0), Vec::new(), &Cluster::default());
        assert_eq!(falls(&tree), 0, "{name}");
        for barriers in barriers(9, &centres) {
            assert_eq!(falls(&cluster(&dots(&centres, 0), barriers, &Cluster::default())), 0, "{name}, barriers");
        }
        // It can fail: with a last merge that waited too long, with a first one that pretends to cross.
        let mut late = tree.clone();
        *late.distance.last_mut().unwrap() = 1e-9;
        assert_eq!(falls(&late), 1, "{name}");
        let mut crossing = tree;
        crossing.crosses_barrier[0] = true;
        assert_eq!(falls(&crossing), 1, "{name}");
    }
}

#[test]
fn any_number_of_threads() {
    let mut dice = Dice(3);
    let centres: Vec<Point> = (0..5000).map(|_| [dice.below(300) * 500, dice.below(300) * 500]).collect();
    let all = dots(&centres, 0);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| cluster(&all, Vec::new(), &Cluster::default()))
    };
    let one = with(1);
    assert_eq!(one.left.len(), 4999);
    assert_eq!(one, with(2));
    assert_eq!(one, with(8));
}

#[test]
fn as_an_operator() {
    let bench = Bench::default();
    let input = In { footprints: Arc::new(dots(&[[0, 0], [1000, 0], [5000, 0]], 0)), barriers: Vec::new() };
    let tree = Cluster::default().run(&bench.ctx(), input).unwrap();
    assert_eq!(tree.distance, [1.0, 4.0]);
}
