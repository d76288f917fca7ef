//! The figures of the impostors' operators on real meshes: `LODGE_DATA=.. cargo bench --bench impostor [-- NAME..]`.
//!
//! Names choose: `voxelize`, `winding`, `vote`, `meshes`, `memory`, `tiles`. Best of three; one thread and two.

mod support;

use std::sync::Arc;
use std::time::Duration;

use lodge::artifact::{Mesh, PlaneTiles, Voxels};
use lodge::geom::scatter::Scatter;
use lodge::geom::space::dot;
use lodge::io::paint::Paint;
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::ALL;
use lodge::ops::read_mesh::ReadMesh;
use lodge::ops::vote_tile::{Stages, VoteTile, vote_tile};
use lodge::ops::voxelize::{Fill, Thin, Voxelize};
use support::measure;

const MESHES: [&str; 9] = [
    "happy_buddha_100k.obj.gz",
    "stanford_bunny.ply.gz",
    "machine_counter.stl",
    "antique_camera.glb",
    "japanese_temple.glb",
    "lamborghini_huracan.glb",
    "house_scene.glb",
    "nasa_ingenuity.glb",
    "toy_car/ToyCar.gltf",
];

fn read(name: &str) -> Option<Arc<Mesh>> {
    let path = std::path::Path::new(&std::env::var_os("LODGE_DATA")?).join("meshes").join(name);
    let source = Source::of_file(&path, None);
    let beside = (ALL.get("read-mesh")?.beside)(&source);
    let mut bench = Bench::default();
    bench.sources = vec![source];
    bench.sources.extend(beside.iter().map(|name| Source::of_file(&path.with_file_name(name), Some(name))));
    let how = ReadMesh { path: name.into(), ..ReadMesh::default() };
    Some(Arc::new(how.run(&bench.ctx(), Inputs::take(Vec::new())).expect("a mesh")))
}

fn voxels(mesh: &Arc<Mesh>, how: &Voxelize) -> Voxels {
    let given = vec![vec![Arc::clone(mesh) as _]];
    how.run(&Bench::default().ctx(), Inputs::take(given)).expect("voxels")
}

/// For each number of tiles, in the order found, the share of a million points, spread over the area, that are within
/// reach of one of them and look its way: what bake-impostor draws.
fn drawn(mesh: &Mesh, tiles: &PlaneTiles) -> Vec<f64> {
    const POINTS: u64 = 1_000_000;
    let paint = Paint::new(mesh);
    let scatter = Scatter::new((0..mesh.triangles.len()).map(|t| mesh.corners(t)));
    let reach = tiles.given.reach_cells * tiles.lattice.cell;
    let planes: Vec<([f64; 3], f64)> = tiles.planes.iter().map(|&w| tiles.lattice.plane(w)).collect();
    let mut firsts = vec![0u64; planes.len()];
    for i in 0..POINTS {
        let (t, weights) = scatter.point(i, POINTS);
        let corners = mesh.corners(t);
        let p = [0, 1, 2].map(|k| (0..3).map(|c| weights[c] * corners[c][k]).sum());
        let normal = paint.normal(t, weights);
        let draws = |(n, offset): &([f64; 3], f64)| dot(*n, normal) > 0.0 && (dot(*n, p) - offset).abs() <= reach;
        if let Some(first) = planes.iter().position(draws) {
            firsts[first] += 1;
        }
    }
    let mut all = 0;
    firsts.iter().map(|n| (all += n, all as f64 / POINTS as f64).1).collect()
}

/// The process' memory in MB as the system counts it: now (`VmRSS`) or at most (`VmHWM`).
fn memory(which: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with(which));
    line.and_then(|l| l.split_whitespace().nth(1)?.parse::<f64>().ok()).unwrap_or(f64::NAN) / 1024.0
}

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let wants = |name: &str| wanted.is_empty() || wanted.iter().any(|w| name.contains(w.as_str()));
    let Some(buddha) = read(MESHES[0]) else { return println!("skipped: LODGE_DATA is not set") };
    let pools = [1, 2].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads"));
    let line = |name: &str, (wall, cpu): (Duration, Duration), more: String| {
        println!("{name:44} wall {:8.4} s, cpu {:8.4} s  {more}", wall.as_secs_f64(), cpu.as_secs_f64());
    };
    if wants("voxelize") {
        for resolution in [128, 256, 512] {
            for (threads, pool) in pools.iter().enumerate() {
                let how = Voxelize { resolution, fill: Fill::Parity, thin: Thin::Keep };
                let time = measure(3, || pool.install(|| voxels(&buddha, &how)));
                line(&format!("voxelize parity, buddha {resolution}, {} threads", threads + 1), time, String::new());
            }
        }
    }
    if wants("winding") {
        let car = read("lamborghini_huracan.glb").expect("checked above");
        let how = Voxelize::default();
        for (threads, pool) in pools.iter().enumerate() {
            let time = measure(2, || pool.install(|| voxels(&car, &how)));
            line(&format!("voxelize winding, car 128, {} threads", threads + 1), time, String::new());
        }
    }
    let vote = |name: &str, voxels: &Voxels, how: &VoteTile| {
        for (threads, pool) in pools.iter().enumerate() {
            let run = || pool.install(|| vote_tile(voxels, how, || Ok(())).expect("tiles"));
            let tiles = run();
            line(&format!("{name}, {} threads", threads + 1), measure(2, run), format!("{} tiles", tiles.len()));
        }
    };
    let flat = VoteTile { stages: Stages::Flat, min_votes: 1, polish: false, ..VoteTile::default() };
    if wants("vote") {
        for resolution in [64, 128, 256] {
            let all = voxels(&buddha, &Voxelize { resolution, fill: Fill::Parity, thin: Thin::Keep });
            vote(&format!("vote-tile flat, all tiles, buddha {resolution}"), &all, &flat);
            vote(&format!("vote-tile both, polish, buddha {resolution}"), &all, &VoteTile::default());
        }
    }
    if wants("meshes") {
        for name in MESHES {
            let Some(mesh) = read(name) else { return };
            let all = voxels(&mesh, &Voxelize::default());
            vote(&format!("vote-tile both, {name} 128"), &all, &VoteTile::default());
        }
    }
    if wants("memory") {
        for resolution in [128, 256] {
            let all = voxels(&buddha, &Voxelize { resolution, fill: Fill::Parity, thin: Thin::Keep });
            // Asks the system to count the most anew.
            let anew = std::fs::write("/proc/self/clear_refs", "5").is_ok();
            let before = memory("VmRSS");
            let tiles = pools[0].install(|| vote_tile(&all, &VoteTile::default(), || Ok(())).expect("tiles"));
            let most = memory("VmHWM") - before;
            println!("memory of vote-tile both, buddha {resolution}: {most:.1} MB ({} tiles, {anew})", tiles.len());
        }
    }
    if wants("tiles") {
        for resolution in [64, 128] {
            for thin in [Thin::Thicken, Thin::Keep] {
                let all = voxels(&buddha, &Voxelize { resolution, thin, ..Voxelize::default() });
                for min_votes in [8, 4] {
                    let how = VoteTile { min_votes, ..VoteTile::default() };
                    let tiles = vote_tile(&all, &how, || Ok(())).expect("tiles");
                    let shares = drawn(&buddha, &tiles);
                    let until = |share: f64| match shares.iter().position(|&s| s >= share) {
                        Some(i) => format!("{share} after {}", i + 1),
                        None => format!("{share} never"),
                    };
                    let last = shares.last().copied().unwrap_or(0.0);
                    let most = [0.5, 0.8, 0.9, 0.95].map(until).join(", ");
                    let name = format!("tiles of the buddha at {resolution}, {thin:?}, min-votes {min_votes}");
                    println!("{name}: {most}; {last:.4} by all {}", tiles.len());
                }
            }
        }
    }
}
