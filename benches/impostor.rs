//! The figures of the impostors' operators on real meshes: `LODGE_DATA=.. cargo bench --bench impostor [-- NAME..]`.
//!
//! Names choose: `voxelize`, `winding`, `vote`, `meshes`. Best of three; one thread and two.

mod support;

use std::sync::Arc;
use std::time::Duration;

use lodge::artifact::{Mesh, Voxels};
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::read_mesh::ReadMesh;
use lodge::ops::vote_tile::{Stages, VoteTile, vote_tile};
use lodge::ops::voxelize::{Fill, Thin, Voxelize};
use support::measure;

const MESHES: [&str; 8] = [
    "happy_buddha_100k.obj.gz",
    "stanford_bunny.ply.gz",
    "machine_counter.stl",
    "antique_camera.glb",
    "japanese_temple.glb",
    "lamborghini_huracan.glb",
    "house_scene.glb",
    "nasa_ingenuity.glb",
];

fn read(name: &str) -> Option<Arc<Mesh>> {
    let path = std::path::Path::new(&std::env::var_os("LODGE_DATA")?).join("meshes").join(name);
    let mut bench = Bench::default();
    bench.sources = vec![Source::of_file(&path, None)];
    let how = ReadMesh { path: name.into(), ..ReadMesh::default() };
    Some(Arc::new(how.run(&bench.ctx(), Inputs::take(Vec::new())).expect("a mesh")))
}

fn voxels(mesh: &Arc<Mesh>, how: &Voxelize) -> Voxels {
    let given = vec![vec![Arc::clone(mesh) as _]];
    how.run(&Bench::default().ctx(), Inputs::take(given)).expect("voxels")
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
        line(
            "voxelize winding, car 128, 2 threads",
            measure(2, || pools[1].install(|| voxels(&car, &how))),
            String::new(),
        );
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
}
