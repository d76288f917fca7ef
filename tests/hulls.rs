//! merge-hulls and simplify-polyline on all real cities (`LODGE_DATA`): what must hold of every node.

use std::sync::Arc;

use lodge::artifact::hulls::HullState;
use lodge::artifact::{Dendrogram, Footprints, Hulls};
use lodge::geom::Point;
use lodge::geom::ring::{contains, convex_hull, doubled_area};
use lodge::geom::segments::is_simple;
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::cluster::Cluster;
use lodge::ops::landmarks::landmarks;
use lodge::ops::merge_hulls::{Merge, MergeHulls, merge_hulls};
use lodge::ops::read_geojson::ReadGeojson;
use lodge::ops::simplify_polyline::{SimplifyPolyline, simplify_polyline};
use rayon::prelude::*;

fn city(name: &str) -> Option<(Footprints, Dendrogram)> {
    let Some(folder) = std::env::var_os("LODGE_DATA") else {
        println!("skipped: LODGE_DATA is not set");
        return None;
    };
    let path = std::path::Path::new(&folder).join(format!("buildings/{name}.geojson.gz"));
    let mut bench = Bench::default();
    bench.sources = vec![Source::of_bytes("city.geojson.gz", std::fs::read(path).unwrap())];
    let params = if name.contains("_osm") { "where.layer = 'building'" } else { "" };
    let read: ReadGeojson = toml::from_str(params).unwrap();
    let footprints = read.run(&bench.ctx(), Inputs::take(Vec::new())).unwrap();
    let given = vec![vec![Arc::new(footprints.clone()) as _], vec![]];
    let tree = Cluster::default().run(&bench.ctx(), Inputs::take(given)).unwrap();
    Some((footprints, tree))
}

/// Two operators weigh a cluster's buildings; what one calls its height is the other's.
#[test]
fn heights_of_hulls_and_landmarks_agree() {
    // The town has outlines that cross themselves, parts, and courtyards.
    let town = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/town/buildings.geojson");
    let mut bench = Bench::default();
    bench.sources = vec![Source::of_bytes("town.geojson", std::fs::read(town).unwrap())];
    let footprints = ReadGeojson::default().run(&bench.ctx(), Inputs::take(Vec::new())).unwrap();
    let given = Inputs::take(vec![vec![Arc::new(footprints.clone()) as _], vec![]]);
    let tree = Cluster::default().run(&bench.ctx(), given).unwrap();
    let (hulls, _) = merge_hulls(&footprints, &tree, &MergeHulls::default());
    let marks = landmarks(&footprints, &tree);
    for c in 0..tree.cluster_count() {
        let (a, b) = (hulls.height[c], marks.cluster_height[c]);
        assert!((a - b).abs() < 1e-9 * a.max(1.0), "cluster {c}: {a} and {b}");
    }
}

fn points(hulls: &Hulls, i: usize) -> Vec<Point> {
    hulls.points(i).collect()
}

/// Every ring simple and counter-clockwise, leaves around their footprints, parents around their children; with
/// that, everything around its members. Returns the number of nodes that are not.
fn unsound(footprints: &Footprints, tree: &Dendrogram, hulls: &Hulls) -> usize {
    (0..hulls.len())
        .into_par_iter()
        .filter(|&c| {
            let ring = points(hulls, c);
            let holds = |inner: &[Point]| inner.is_empty() || contains(&ring, inner);
            let sound = match tree.children(c as u32) {
                _ if ring.is_empty() => tree.children(c as u32).is_none(),
                None => footprints.polygons.shells(c).all(|s| !is_simple(s) || holds(s)),
                Some(both) => both.iter().all(|&child| holds(&points(hulls, child as usize))),
            };
            let ok = sound && (ring.is_empty() || (is_simple(&ring) && doubled_area(&ring) > 0));
            if !ok {
                println!("cluster {c}: {:?} {ring:?}", tree.children(c as u32));
            }
            !ok
        })
        .count()
}

fn threads<R: Send>(n: usize, work: impl FnOnce() -> R + Send) -> R {
    rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(work)
}

#[test]
fn every_node_of_every_city_in_the_default_mode() {
    for name in [
        "tokyo_centre",
        "boston_z13_footprints",
        "liechtenstein_osm",
        "monaco_osm",
        "helsinki_osm",
        "andorra_osm",
        "tokyo_setagaya",
    ] {
        let Some((footprints, tree)) = city(name) else { return };
        let how = MergeHulls::default();
        let (hulls, repairs) = threads(1, || merge_hulls(&footprints, &tree, &how));
        for n in [2, 8] {
            assert!(
                threads(n, || merge_hulls(&footprints, &tree, &how)) == (hulls.clone(), repairs.clone()),
                "{name}: {n} threads"
            );
        }
        assert_eq!(unsound(&footprints, &tree, &hulls), 0, "{name}");
        let edges = |c: u32| {
            let ring = points(&hulls, c as usize);
            lodge::geom::ring::edges_without_collinear(&ring)
        };
        for c in footprints.len()..hulls.len() {
            let [l, r] = tree.children(c as u32).unwrap().map(edges);
            let own = hulls.ring(c).len();
            let most = ((l + r) as f64 * how.keep).ceil() as usize;
            assert!(own <= most || l * r == 0 || own == convex_hull(&points(&hulls, c)).len(), "{name}: cluster {c}");
            assert!(hulls.negative_space_m2[c] >= 0.0);
        }
        println!("{name}: {} nodes, {} repairs", hulls.len(), repairs.len());
    }
}

#[test]
fn every_node_in_the_mode_of_the_source() {
    for name in ["liechtenstein_osm", "monaco_osm", "helsinki_osm", "andorra_osm"] {
        let Some((footprints, tree)) = city(name) else { return };
        let how = MergeHulls { merge: Merge::Source, ..MergeHulls::default() };
        let (merged, _) = merge_hulls(&footprints, &tree, &how);
        assert_eq!(unsound(&footprints, &tree, &merged), 0, "{name}");
        let simple = simplify_polyline(&merged, &SimplifyPolyline::default());
        assert_eq!(simple.state, HullState::SourceSimplified);
        let bad = (0..simple.len()).into_par_iter().filter(|&c| {
            let (ring, was) = (points(&simple, c), points(&merged, c));
            // The largest ones take long to compare vertex by vertex; they grow by the same steps.
            !ring.is_empty() && (!is_simple(&ring) || (was.len() < 5000 && !contains(&ring, &was)))
        });
        assert_eq!(bad.count(), 0, "{name}");
    }
}
