//! cluster on the real cities (`LODGE_DATA`): pieces of them against a greedy that knows nothing but the contract, whole
//! ones against what must hold of any.

mod support;

use std::sync::Arc;

use lodge::artifact::{AnyArtifact, Attributes, Dendrogram, Footprints, Lines, Shapes, Strings};
use lodge::geom::Point;
use lodge::geom::gap::{gap, shortest};
use lodge::geom::predicates::segments_meet;
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::cluster::{Cluster, Distance};
use lodge::ops::read_geojson::ReadGeojson;
use lodge::ops::read_lines::ReadLines;

fn read<O: Op>(params: &str, bytes: &[u8]) -> O::Out {
    let mut bench = Bench::default();
    bench.sources = vec![Source::of_bytes("city.geojson.gz", bytes.to_vec())];
    let op: O = toml::from_str(params).unwrap();
    op.run(&bench.ctx(), O::In::take(Vec::new())).unwrap()
}

/// A city's buildings, and the lines that part them where the file has any.
fn city(name: &str) -> Option<(Footprints, Option<Lines>)> {
    let bytes = std::fs::read(support::real_data()?.join(format!("buildings/{name}.geojson.gz"))).unwrap();
    if !name.ends_with("_osm") {
        return Some((read::<ReadGeojson>("", &bytes), None));
    }
    let lines = read::<ReadLines>("where.layer = ['road', 'rail', 'water', 'waterway']", &bytes);
    Some((read::<ReadGeojson>("where.layer = 'building'", &bytes), Some(lines)))
}

const CITIES: [&str; 7] = [
    "andorra_osm",
    "helsinki_osm",
    "monaco_osm",
    "liechtenstein_osm",
    "boston_z13_footprints",
    "tokyo_centre",
    "tokyo_setagaya",
];

fn cluster(footprints: &Footprints, barriers: Option<&Lines>, distance: Distance) -> Dendrogram {
    let bench = Bench::default();
    let barriers: Vec<Arc<dyn AnyArtifact>> = barriers.map(|l| Arc::new(l.clone()) as _).into_iter().collect();
    let input = Inputs::take(vec![vec![Arc::new(footprints.clone())], barriers]);
    Cluster { distance, ..Cluster::default() }.run(&bench.ctx(), input).unwrap()
}

/// The area centroid of the shells by the contract: exact, halves up; the mean of the vertices where the area is 0 or
/// the centroid leaves the shells' box.
fn centre(shells: &[&[Point]]) -> Point {
    let (mut area, mut moment, mut sum, mut n) = (0i128, [0i128; 2], [0i128; 2], 0i128);
    let (mut low, mut high) = ([i128::MAX; 2], [i128::MIN; 2]);
    for ring in shells {
        for (i, p) in ring.iter().enumerate() {
            let q = ring[(i + 1) % ring.len()];
            let (p, q) = (p.map(i128::from), q.map(i128::from));
            let cross = p[0] * q[1] - p[1] * q[0];
            area += cross;
            for k in 0..2 {
                moment[k] += cross * (p[k] + q[k]);
                sum[k] += p[k];
                (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
            }
            n += 1;
        }
    }
    let rounded = |a: i128, b: i128| (2 * a * b.signum() + b.abs()).div_euclid(2 * b.abs());
    let of_area = [0, 1].map(|k| if area == 0 { i128::MAX } else { rounded(moment[k], 3 * area) });
    let inside = (0..2).all(|k| low[k] <= of_area[k] && of_area[k] <= high[k]);
    let c = if inside { of_area } else { sum.map(|s| rounded(s, n)) };
    c.map(|v| i32::try_from(v).unwrap())
}

fn ranks(ids: &Strings) -> Vec<u32> {
    let hash = |i: usize| u64::from_le_bytes(blake3::hash(ids.get(i).as_bytes()).as_bytes()[..8].try_into().unwrap());
    let mut order: Vec<usize> = (0..ids.len()).collect();
    order.sort_by_key(|&i| (hash(i), i));
    let mut out = vec![0; ids.len()];
    (0..).zip(order).for_each(|(rank, i)| out[i] = rank);
    out
}

/// Of all pairs the first in (crosses, cost, lower rank, other rank), again and again, O(n^3).
fn greedy(ids: &Strings, pair: impl Fn(usize, usize) -> (f64, bool)) -> Dendrogram {
    struct Part {
        number: u32,
        rank: u32,
        size: u64,
    }
    let n = ids.len();
    let mut parts: Vec<Part> =
        (0..).zip(ranks(ids)).take(n).map(|(number, rank)| Part { number, rank, size: 1 }).collect();
    // Between two parts: the smallest distance, and the smallest of pairs that see each other.
    let mut plain = vec![vec![f64::INFINITY; n]; n];
    let mut seen = plain.clone();
    for a in 0..n {
        for b in 0..a {
            let (d, sees) = pair(a, b);
            (plain[a][b], plain[b][a]) = (d, d);
            if sees {
                (seen[a][b], seen[b][a]) = (d, d);
            }
        }
    }
    let mut live: Vec<usize> = (0..n).collect();
    let mut out = Dendrogram { leaves: vec![n as u32], ..Dendrogram::default() };
    while live.len() > 1 {
        let mut best: Option<((bool, f64, u32, u32), usize, usize, f64)> = None;
        for (k, &a) in live.iter().enumerate() {
            for &b in &live[..k] {
                let crosses = seen[a][b].is_infinite();
                let d = if crosses { plain[a][b] } else { seen[a][b] };
                let cost = (parts[a].size * parts[b].size) as f64 * d;
                let key = (crosses, cost, parts[a].rank.min(parts[b].rank), parts[a].rank.max(parts[b].rank));
                if best.is_none_or(|(other, ..)| key < other) {
                    best = Some((key, a, b, d));
                }
            }
        }
        let ((crosses, ..), a, b, d) = best.unwrap();
        let larger: Vec<u64> = live.iter().map(|&i| parts[i].size).filter(|&s| s > 1).collect();
        let avg = if larger.is_empty() { 1.0 } else { larger.iter().sum::<u64>() as f64 / larger.len() as f64 };
        let (l, r) = if parts[a].rank < parts[b].rank { (a, b) } else { (b, a) };
        out.left.push(parts[l].number);
        out.right.push(parts[r].number);
        out.distance.push(d / 1000.0);
        out.cost.push((parts[l].size * parts[r].size) as f64 * (d / 1000.0) / (avg * avg));
        out.size.push((parts[l].size + parts[r].size) as u32);
        out.crosses_barrier.push(crosses);
        parts[l].size += parts[r].size;
        parts[l].number = (n + out.size.len() - 1) as u32;
        live.retain(|&i| i != r);
        for &i in &live {
            for table in [&mut plain, &mut seen] {
                let d = table[l][i].min(table[r][i]);
                (table[l][i], table[i][l]) = (d, d);
            }
        }
    }
    out
}

/// Some rows of a layer, as a layer.
fn piece(all: &Footprints, rows: &[usize]) -> Footprints {
    let mut polygons = Shapes::default();
    for &i in rows {
        for p in all.polygons.polygons_of(i) {
            all.polygons.rings_of(p).for_each(|r| polygons.push_ring(all.polygons.ring(r)));
            polygons.end_polygon();
        }
        polygons.end_shape();
    }
    Footprints {
        frame: all.frame.clone(),
        ids: rows.iter().map(|&i| all.ids.get(i)).collect(),
        polygons,
        base: rows.iter().map(|&i| all.base[i]).collect(),
        top: rows.iter().map(|&i| all.top[i]).collect(),
        attributes: Attributes::default(),
    }
}

#[test]
fn pieces_of_real_cities_are_as_the_greedy_has_them() {
    for name in CITIES {
        let Some((all, lines)) = city(name) else { return };
        let centres: Vec<Point> = (0..all.len()).map(|i| centre(&all.polygons.shells(i).collect::<Vec<_>>())).collect();
        // Lines lie in a frame of their own: cluster moves them, and so does this test.
        let segments: Vec<[Point; 2]> = lines.as_ref().map_or(Vec::new(), |lines| {
            let points = all.frame.adopt(&lines.points, &lines.frame).unwrap();
            let line = |i: usize| &points[lines.starts[i] as usize..lines.starts[i + 1] as usize];
            (0..lines.len()).flat_map(|i| line(i).windows(2).map(|w| [w[0], w[1]])).collect()
        });
        let mut crossing = 0;
        for around in [1, 4, 7] {
            // A building and those nearest to it.
            let middle = centres[all.len() * around / 9];
            let far = |i: &usize| (0..2).map(|k| (centres[*i][k] - middle[k]).abs()).max();
            let mut rows: Vec<usize> = (0..all.len()).collect();
            rows.sort_by_key(|i| (far(i), *i));
            rows.truncate(300);
            rows.sort_unstable();
            let some = piece(&all, &rows);
            let shells: Vec<Vec<&[Point]>> = (0..some.len()).map(|i| some.polygons.shells(i).collect()).collect();
            let all_points = || shells.iter().flatten().flat_map(|ring| ring.iter());
            let low = [0, 1].map(|k| all_points().map(|p| p[k]).min().unwrap());
            let high = [0, 1].map(|k| all_points().map(|p| p[k]).max().unwrap());
            // Only what comes into their box can part them.
            let near = |s: &&[Point; 2]| {
                (0..2).all(|k| s[0][k].min(s[1][k]) <= high[k] + 9 && s[0][k].max(s[1][k]) >= low[k] - 9)
            };
            let walls: Vec<[Point; 2]> = segments.iter().filter(near).copied().collect();
            let clear = |p: Point, q: Point| !walls.iter().any(|w| segments_meet(p, q, w[0], w[1]));

            let c: Vec<Point> = rows.iter().map(|&i| centres[i]).collect();
            let between = |a: usize, b: usize| {
                let d = |k: usize| i64::from(c[a][k]) - i64::from(c[b][k]);
                (((d(0) * d(0) + d(1) * d(1)) as f64).sqrt().max(10.0), clear(c[a], c[b]))
            };
            let sure = greedy(&some.ids, between);
            crossing += sure.crosses_barrier.iter().filter(|&&c| c).count();
            assert!(cluster(&some, lines.as_ref(), Distance::Centroid) == sure, "{name}, {around}: centroids");

            let between = |a: usize, b: usize| {
                let (a, b) = (&shells[a], &shells[b]);
                (gap(a, b).max(10.0), walls.is_empty() || shortest(a, b).is_none_or(|[p, q]| clear(p, q)))
            };
            let sure = greedy(&some.ids, between);
            assert!(cluster(&some, lines.as_ref(), Distance::Footprint) == sure, "{name}, {around}: outlines");
        }
        println!("{name}: {} barriers, {crossing} merges across them", segments.len());
        assert_eq!(crossing > 0, name.ends_with("_osm"), "{name}");
    }
}

#[test]
fn whole_cities_hold_what_must_hold() {
    for name in CITIES {
        let Some((all, lines)) = city(name) else { return };
        for distance in [Distance::Centroid, Distance::Footprint] {
            let tree = cluster(&all, lines.as_ref(), distance);
            let (n, what) = (all.len(), format!("{name}, {distance:?}"));
            assert_eq!((tree.leaf_count(), tree.left.len()), (n, n - 1), "{what}");
            let ranks = ranks(&all.ids);
            // (1) Every cluster is merged once, after it was made; the left child has the lower rank; sizes add up.
            let mut lowest = ranks;
            let mut size = vec![1u32; n];
            let mut used = vec![false; 2 * n - 1];
            for i in 0..n - 1 {
                let [l, r] = [tree.left[i] as usize, tree.right[i] as usize];
                assert!(l < n + i && r < n + i, "{what}: merge {i}");
                assert!(
                    !std::mem::replace(&mut used[l], true) && !std::mem::replace(&mut used[r], true),
                    "{what}: {i}"
                );
                assert!(lowest[l] < lowest[r], "{what}: merge {i}");
                lowest.push(lowest[l]);
                size.push(size[l] + size[r]);
                assert_eq!(tree.size[i], size[n + i], "{what}: merge {i}");
                assert!(tree.distance[i] >= 0.01, "{what}: merge {i}");
            }
            assert_eq!(used.iter().filter(|&&u| u).count(), 2 * n - 2, "{what}");
            // (2) Costs never fall, apart from where crossing begins; what crosses comes last.
            let plain = |i: usize| {
                let sizes = u64::from(size[tree.left[i] as usize]) * u64::from(size[tree.right[i] as usize]);
                sizes as f64 * tree.distance[i]
            };
            for i in 1..n - 1 {
                let [before, now] = [i - 1, i].map(|i| tree.crosses_barrier[i]);
                assert!(before <= now, "{what}: merge {i} crosses nothing");
                assert!(before != now || plain(i - 1) <= plain(i) * (1.0 + 1e-15), "{what}: merge {i} is cheaper");
            }
            let crossing = tree.crosses_barrier.iter().filter(|&&c| c).count();
            assert_eq!(crossing > 0, lines.is_some(), "{what}");
            println!("{what}: {n} buildings, {crossing} merges cross");
        }
    }
}

/// A tree's clusters as sets of buildings: each named by the sum of its members' hashes.
fn groups(tree: &Dendrogram, ids: &Strings) -> std::collections::BTreeSet<u64> {
    let hash = |id: &str| u64::from_le_bytes(blake3::hash(id.as_bytes()).as_bytes()[8..16].try_into().unwrap());
    let mut sums: Vec<u64> = ids.iter().map(hash).collect();
    for (&l, &r) in tree.left.iter().zip(&tree.right) {
        sums.push(sums[l as usize].wrapping_add(sums[r as usize]));
    }
    sums.into_iter().skip(ids.len()).collect()
}

/// A quarter turn: centres on a half millimetre go up whichever way that is, all others turn, and where all turn so does
/// the tree.
#[test]
fn turned_by_a_quarter_only_halves_differ() {
    let turn = |p: &Point| [-p[1], p[0]];
    for name in CITIES {
        let Some((all, _)) = city(name) else { return };
        let mut turned = all.clone();
        turned.polygons.points = all.polygons.points.iter().map(turn).collect();
        let of = |f: &Footprints, i: usize| centre(&f.polygons.shells(i).collect::<Vec<_>>());
        let odd: Vec<[Point; 2]> =
            (0..all.len()).map(|i| [turn(&of(&all, i)), of(&turned, i)]).filter(|[a, b]| a != b).collect();
        // By one millimetre, where y was a half.
        assert!(odd.iter().all(|[a, b]| a[1] == b[1] && b[0] - a[0] == 1), "{name}: {odd:?}");
        let (a, b) = (cluster(&all, None, Distance::Centroid), cluster(&turned, None, Distance::Centroid));
        let (a, b) = (groups(&a, &all.ids), groups(&b, &all.ids));
        let other = a.difference(&b).count();
        println!("{name}: {} of {} centres differ, and {other} clusters", odd.len(), all.len());
        assert!(!odd.is_empty() || a == b, "{name}");
        // A hundredth of the clusters at most: the others hang on no half millimetre.
        assert!(100 * other <= a.len(), "{name}");
        assert!(
            cluster(&all, None, Distance::Footprint) == cluster(&turned, None, Distance::Footprint),
            "{name}: outlines turn, whatever the centres do"
        );
    }
}

/// Barriers in another system than the buildings, and ones that no system can move.
#[test]
fn barriers_in_another_frame_are_moved_or_refused() {
    // Four houses in a row in RD New, 20 m apart, and a road between the second and the third, in lon/lat.
    let ring = |x: f64| format!("[[[{x},440000],[{0},440000],[{0},440010],[{x},440010],[{x},440000]]]", x + 10.0);
    let houses: Vec<String> = (0..4)
        .map(|i| {
            let coordinates = ring(90_000.0 + 20.0 * f64::from(i));
            format!(r#"{{"type":"Feature","id":{i},"properties":{{}},"geometry":{{"type":"Polygon","coordinates":{coordinates}}}}}"#)
        })
        .collect();
    let houses: Footprints = read::<ReadGeojson>("crs = 'EPSG:28992'", houses.join("\n").as_bytes());
    let way = houses.frame.projector().unwrap();
    let lonlat = |p: Point| {
        let q = way.source(p);
        lodge::geom::crs::Crs::parse("EPSG:28992").unwrap().lonlat(q).unwrap()
    };
    let first = houses.polygons.points[0];
    let [a, b] = [-100_000, 100_000].map(|dy| lonlat([first[0] + 35_000, first[1] + dy]));
    let road = format!(
        r#"{{"type":"Feature","id":"r","properties":{{}},"geometry":{{"type":"LineString","coordinates":[[{},{}],[{},{}]]}}}}"#,
        a[0], a[1], b[0], b[1]
    );
    let road = read::<ReadLines>("", road.as_bytes());
    assert_ne!(road.frame, houses.frame);
    let free = cluster(&houses, None, Distance::Centroid);
    assert!(free.crosses_barrier.iter().all(|c| !c));
    for distance in [Distance::Centroid, Distance::Footprint] {
        let tree = cluster(&houses, Some(&road), distance);
        assert_eq!(tree.crosses_barrier, [false, false, true], "{distance:?}");
        // Two and two.
        assert_eq!((tree.size, tree.left.iter().max()), (vec![2, 2, 4], Some(&tree.left[2])), "{distance:?}");
    }
    // Metres of no known system cannot be moved among those of a known one.
    let local =
        r#"{"type":"Feature","properties":{},"geometry":{"type":"LineString","coordinates":[[900000,0],[900000,9]]}}"#;
    let local = read::<ReadLines>("", local.as_bytes());
    let bench = Bench::default();
    let input = Inputs::take(vec![vec![Arc::new(houses) as _], vec![Arc::new(local) as _]]);
    let e = Cluster::default().run(&bench.ctx(), input).unwrap_err();
    assert_eq!(e.code, "frames-differ");
    assert!(e.message.starts_with("`barriers`: "), "{e}");
}
