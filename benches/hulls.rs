//! merge-hulls and simplify-polyline on real cities, against the yardstick T (see `support`).
//!
//!     LODGE_DATA=.. cargo bench --bench hulls [-- FILE..]
//!
//! Files are names in `buildings/`, or paths; without any: tokyo_centre and tokyo_setagaya. Wall and processor
//! seconds (in brackets), the best of three. With `LODGE_RINGS=folder` the root ring of `merge = "source"` is
//! written to `folder/<name>.csv`; `-- --ring FILE COUNT..` simplifies such a ring (for `geos_hull.py`).

mod support;

use std::time::Instant;

use lodge::artifact::{Dendrogram, Hulls};
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::cluster::Cluster;
use lodge::ops::merge_hulls::{Merge, MergeHulls, merge_hulls};
use lodge::ops::read_geojson::ReadGeojson;
use lodge::ops::simplify_polyline::{SimplifyPolyline, simplify_polyline};

fn main() {
    let args: Vec<String> = std::env::args().collect();
    if let Some(at) = args.iter().position(|a| a == "--ring") {
        return simplify_ring(&args[at + 1], &args[at + 2..]);
    }
    let Some(data) = std::env::var_os("LODGE_DATA") else {
        return println!("skipped: LODGE_DATA is not set");
    };
    let mut files: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    if files.is_empty() {
        files = vec!["tokyo_centre".into(), "tokyo_setagaya".into()];
    }
    for file in files {
        let path = if file.contains('/') {
            std::path::PathBuf::from(&file)
        } else {
            std::path::Path::new(&data).join(format!("buildings/{file}.geojson.gz"))
        };
        measure(&file, &std::fs::read(path).expect("the file is there"));
    }
}

fn measure(name: &str, bytes: &[u8]) {
    let params = if name.contains("_osm") { "where.layer = 'building'" } else { "" };
    let mut bench = Bench::default();
    bench.sources = vec![Source::of_bytes("city.geojson.gz", bytes.to_vec())];
    let footprints = toml::from_str::<ReadGeojson>(params).unwrap();
    let footprints = footprints.run(&bench.ctx(), Inputs::take(Vec::new())).unwrap();
    let given = vec![vec![std::sync::Arc::new(footprints.clone()) as _], vec![]];
    let tree: Dendrogram = Cluster::default().run(&bench.ctx(), Inputs::take(given)).unwrap();
    println!("{name}: {} buildings, {} vertices", footprints.len(), footprints.polygons.points.len());

    let (t, t_cpu) = support::yardstick().expect("LODGE_DATA is set");
    let t = (t.as_secs_f64(), t_cpu.as_secs_f64());
    println!("  T {:.3} ({:.3})", t.0, t.1);
    let simplified = MergeHulls::default();
    let source = MergeHulls { merge: Merge::Source, ..MergeHulls::default() };
    for threads in [1, 2] {
        let hulls = timed("merge-hulls, simplified", threads, t, || merge_hulls(&footprints, &tree, &simplified).0);
        if threads == 1 {
            quality(&hulls);
        }
    }
    if footprints.len() > 300_000 {
        return;
    }
    let merged = timed("merge-hulls, source", 2, t, || merge_hulls(&footprints, &tree, &source).0);
    quality(&merged);
    let after = timed("simplify-polyline", 2, t, || simplify_polyline(&merged, &SimplifyPolyline::default()));
    quality(&after);
    // The ring that GEOS is compared on.
    if let Some(folder) = std::env::var_os("LODGE_RINGS") {
        write_root(&merged, &std::path::Path::new(&folder).join(format!("{name}.csv")));
    }
}

/// Seconds that this process has computed, all threads.
fn processor() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<f64> = stat.rsplit(')').next().unwrap_or("").split(' ').map(|f| f.parse().unwrap_or(0.0)).collect();
    fields.get(12).copied().unwrap_or(0.0) / 100.0 + fields.get(13).copied().unwrap_or(0.0) / 100.0
}

fn timed<R: Send>(what: &str, threads: usize, t: (f64, f64), work: impl Fn() -> R + Sync) -> R {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut best = (f64::INFINITY, f64::INFINITY);
    let mut out = None;
    for _ in 0..3 {
        let (wall, cpu) = (Instant::now(), processor());
        out = Some(pool.install(&work));
        best = (best.0.min(wall.elapsed().as_secs_f64()), best.1.min(processor() - cpu));
    }
    println!(
        "  {what}, {threads} threads: {:.3} s ({:.2}) = {:.1} T ({:.1})",
        best.0,
        best.1,
        best.0 / t.0,
        best.1 / t.1
    );
    out.unwrap()
}

fn quality(hulls: &Hulls) {
    let negative: f64 = hulls.negative_space_m2.iter().sum();
    let root = hulls.len() - 1;
    println!(
        "    negative space {:.3} km2, {} edges, root {} edges, {:.3} km2",
        negative / 1e6,
        hulls.rings.len(),
        hulls.ring(root).len(),
        hulls.negative_space_m2[root] / 1e6
    );
}

/// Lines of `vertices,area in m2,seconds on one thread,seconds on two`.
fn simplify_ring(path: &str, counts: &[String]) {
    let text = std::fs::read_to_string(path).expect("the ring is there");
    let point = |line: &str| {
        let mut numbers = line.split(',').map(|n| n.parse().expect("whole millimetres"));
        [numbers.next().unwrap(), numbers.next().unwrap()]
    };
    let ring: Vec<[i32; 2]> = text.lines().map(point).collect();
    for count in counts.iter().filter_map(|c| c.parse().ok()) {
        let seconds = [1, 2].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let run = || {
                let from = Instant::now();
                std::hint::black_box(pool.install(|| lodge::geom::outer_hull::simplify(&ring, count)));
                from.elapsed().as_secs_f64()
            };
            (0..5).map(|_| run()).fold(f64::INFINITY, f64::min)
        });
        let simple = lodge::geom::outer_hull::simplify(&ring, count);
        let area = lodge::geom::ring::area_m2(&simple);
        println!("{},{area:.6},{:.4},{:.4}", simple.len(), seconds[0], seconds[1]);
    }
}

/// The root's ring, a vertex a line, for `geos_hull.py`.
fn write_root(hulls: &Hulls, path: &std::path::Path) {
    let text: String = hulls.points(hulls.len() - 1).map(|p| format!("{},{}\n", p[0], p[1])).collect();
    std::fs::write(path, text).unwrap();
}
