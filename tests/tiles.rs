//! Voxels and plane tiles of whole meshes: boxes at any turn, thin plates, real meshes with holes, meshes that are hardly
//! any.

mod support;

use std::fmt::Write as _;
use std::sync::Arc;

use lodge::artifact::voxels::STEPS;
use lodge::artifact::{Mesh, PlaneTiles, Voxels};
use lodge::diag::Result;
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::read_mesh::ReadMesh;
use lodge::ops::vote_tile::{Stages, VoteTile, vote_tile};
use lodge::ops::voxelize::{Fill, Thin, Voxelize};
use support::{Random, read_files, real_data};

/// The lines of an OBJ: a box between two corners, turned.
fn block(low: [f64; 3], high: [f64; 3], turn: impl Fn([f64; 3]) -> [f64; 3]) -> String {
    let mut out = String::new();
    for i in 0..8 {
        let [x, y, z] = turn([0, 1, 2].map(|k| if i >> k & 1 == 0 { low[k] } else { high[k] }));
        writeln!(out, "v {x} {y} {z}").unwrap();
    }
    for [a, b, c, d] in [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]] {
        writeln!(out, "f {a} {b} {c}\nf {a} {c} {d}").unwrap();
    }
    out
}

fn mesh(obj: &str) -> Arc<Mesh> {
    Arc::new(read_files::<ReadMesh>("path = \"it.obj\"", &[("it.obj", obj.into())]).0.unwrap())
}

/// Voxels, and triangles that were rejected.
fn voxels(mesh: &Arc<Mesh>, how: &Voxelize) -> (Result<Voxels>, usize) {
    let bench = Bench::default();
    let out = how.run(&bench.ctx(), Inputs::take(vec![vec![Arc::clone(mesh) as _]]));
    (out, bench.report.finish().rejects.len())
}

fn tiles(voxels: &Voxels, how: &VoteTile) -> PlaneTiles {
    vote_tile(voxels, how, || Ok(())).unwrap()
}

fn real(name: &str) -> Option<Arc<Mesh>> {
    let mut bench = Bench::default();
    bench.sources = vec![Source::of_file(&real_data()?.join("meshes").join(name), None)];
    let how = ReadMesh { path: name.into(), ..ReadMesh::default() };
    Some(Arc::new(how.run(&bench.ctx(), Inputs::take(Vec::new())).unwrap()))
}

/// A turn by quaternion.
fn turned(q: [f64; 4], p: [f64; 3]) -> [f64; 3] {
    let n = q.iter().map(|c| c * c).sum::<f64>();
    let [w, v] = [[q[0]; 3], [q[1], q[2], q[3]]];
    let cross =
        |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3]);
    let once = cross(v, p);
    let twice = cross(v, once);
    [0, 1, 2].map(|k| p[k] + 2.0 * (w[k] * once[k] + twice[k]) / n)
}

/// Share of a grid's sticks that some plane stabs: the black end inside, the white one not.
fn stabbed(all: &Voxels, tiles: &PlaneTiles) -> f64 {
    let sticks = all.sticks();
    let inside = |w: [i64; 4], n: [i32; 3]| lodge::geom::lattice::inside(all.lattice.cells, w, n);
    let stabs = |&&(node, direction): &&([u16; 3], u8)| {
        let black = node.map(i32::from);
        let white = [0, 1, 2].map(|k| black[k] + STEPS[usize::from(direction)][k]);
        tiles.planes.iter().any(|&w| inside(w, black) && !inside(w, white))
    };
    sticks.iter().filter(stabs).count() as f64 / sticks.len() as f64
}

/// With thin parts thickened: a body's edges are none, though the grid's edges clip them.
#[test]
fn a_box_at_any_turn_is_six_tiles() {
    let mut random = Random(5);
    let mut dice = || random.below(1 << 20) as f64 / f64::from(1 << 20) - 0.5;
    let straight = [[1.0, 0.0, 0.0, 0.0], [3.0, 1.0, 0.0, 0.0]];
    for (i, q) in straight.into_iter().chain((0..14).map(|_| [dice(), dice(), dice(), dice()])).enumerate() {
        let body = mesh(&block([0.0; 3], [5.0, 4.0, 3.0], |p| turned(q, p)));
        for resolution in [32, 48] {
            let all = voxels(&body, &Voxelize { resolution, ..Voxelize::default() }).0.unwrap();
            let tiles = tiles(&all, &VoteTile::default());
            assert_eq!(tiles.len(), 6, "turn {i} at {resolution}: {:?}", tiles.votes);
            assert_eq!(all.losses.thickened, 0, "turn {i} at {resolution}: {} edges clipped", all.losses.lost);
            assert!(tiles.sticks.len() * 100 >= 99 * tiles.given.sticks as usize, "turn {i} at {resolution}");
            let share = stabbed(&all, &tiles);
            assert!(share >= 0.99, "turn {i} at {resolution}: {share}");
        }
    }
}

/// Two tiles that look away from each other, and nothing else.
fn is_a_plate(what: &str, plate: &Arc<Mesh>, resolution: u32) {
    let all = voxels(plate, &Voxelize { resolution, ..Voxelize::default() }).0.unwrap();
    let found = tiles(&all, &VoteTile { stages: Stages::Both, ..VoteTile::default() });
    assert_eq!(found.len(), 2, "{what}: {:?}, {:?}", found.votes, found.given);
    let [a, b] = [0, 1].map(|i| found.lattice.plane(found.planes[i]).0);
    let cosine: f64 = (0..3).map(|k| a[k] * b[k]).sum();
    assert!(cosine < -0.99, "{what}: {cosine}");
    // Of the side that it looks to, each draws what lies within its reach.
    let far = |&w: &[i64; 4]| {
        let (n, offset) = found.lattice.plane(w);
        let height = |p: [f64; 3]| (0..3).map(|k| n[k] * p[k]).sum::<f64>() - offset;
        // Vertices are of both sides: those that lie further out.
        let mut all: Vec<f64> = plate.positions.iter().map(|&p| height(p)).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() - 4..].iter().map(|h| h.abs()).fold(0.0, f64::max)
    };
    let far = found.planes.iter().map(far).fold(0.0, f64::max) / found.lattice.cell;
    assert!(far < 1.2, "{what}: {far} cells off");
    let captured = found.sticks.len() as f64 / found.given.sticks as f64;
    assert!(captured > 0.85, "{what}: {captured}");
}

/// Half of all slants, and those of the grid's own planes: from a fifteenth of a cell to a whole one.
#[test]
fn a_thin_plate_is_two_tiles_at_any_slant() {
    let half = 1.0 / libm::sqrt(2.0) - 0.5;
    let own = [[1.0, 0.0, 0.0, 0.0], [0.5 + half, 0.5 - half, 0.0, 0.0], [5.0, 1.0, 0.0, 0.0], [4.0, 1.0, 1.0, 0.3]];
    let diagonal = [0.888_073_834, 0.325_057_584, -0.325_057_584, 0.0];
    let mut random = Random(7);
    let mut dice = || random.below(1 << 20) as f64 / f64::from(1 << 20) - 0.5;
    let turns = own.into_iter().chain([diagonal]).chain((0..11).map(|_| [dice(), dice(), dice(), dice()]));
    for (i, q) in turns.enumerate() {
        for (resolution, thick) in [(32, 0.02), (37, 0.1), (29, 0.2)] {
            let plate = mesh(&block([0.0; 3], [10.0, 7.0, thick], |p| turned(q, p)));
            is_a_plate(&format!("turn {i}, {thick} m"), &plate, resolution);
        }
        let corners = [[0.0, 0.0], [10.0, 0.0], [10.0, 7.0], [0.0, 7.0]].map(|[x, y]| turned(q, [x, y, 0.0]));
        let vertices: String = corners.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
        is_a_plate(&format!("turn {i}, one face"), &mesh(&format!("{vertices}f 1 2 3 4\n")), 32);
    }
}

/// Meshes with holes: the two outer layers stay white, and the volume is the same at twice the resolution.
#[test]
fn open_meshes_do_not_leak() {
    for name in ["lamborghini_huracan.glb", "house_scene.glb", "japanese_temple.glb"] {
        let Some(open) = real(name) else { return };
        let volume = |resolution: u32| {
            let how = Voxelize { resolution, fill: Fill::Winding, thin: Thin::Keep };
            let all = voxels(&open, &how).0.unwrap();
            let side = all.lattice.side();
            for i in 0..side * side {
                for edge in [0, side - 1] {
                    let (a, b) = (i % side, i / side);
                    assert!([[edge, a, b], [a, edge, b], [a, b, edge]].iter().all(|&n| !all.is_black(n)), "{name}");
                }
            }
            let cell = all.lattice.cell;
            all.inside() as f64 * cell * cell * cell
        };
        let ratio = volume(64) / volume(32);
        assert!((0.7..1.4).contains(&ratio), "{name}: {ratio}");
    }
}

#[test]
fn two_fills_agree_on_closed_meshes() {
    let body = mesh(&block([0.1, 0.2, 0.3], [4.0, 3.0, 2.5], |[x, y, z]| [0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y, z]));
    let mut bodies = vec![body];
    bodies.extend(real("happy_buddha_100k.obj.gz"));
    for body in bodies {
        let of = |fill| voxels(&body, &Voxelize { resolution: 48, fill, thin: Thin::Keep }).0.unwrap().black;
        assert!(of(Fill::Winding) == of(Fill::Parity));
    }
}

#[test]
fn a_real_mesh_on_one_thread_and_on_two() {
    let Some(car) = real("lamborghini_huracan.glb") else { return };
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let all = voxels(&car, &Voxelize { resolution: 48, ..Voxelize::default() }).0.unwrap();
            let found = tiles(&all, &VoteTile::default());
            (all, found)
        })
    };
    assert!(with(1) == with(2));
}

#[test]
fn hardly_a_mesh() {
    let how = Voxelize { resolution: 16, ..Voxelize::default() };
    let one = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    // One triangle: a plate of two sides.
    let all = voxels(&mesh(one), &how).0.unwrap();
    assert!(tiles(&all, &VoteTile::default()).len() >= 2);
    // A million times the same one: the same nodes.
    let mut many = (*mesh(one)).clone();
    many.triangles = vec![many.triangles[0]; 1_000_000];
    let again = voxels(&Arc::new(many), &how).0.unwrap();
    assert_eq!((again.inside(), again.losses.lost > 0), (all.inside(), all.losses.lost > 0));
    // A corner that is no number: that triangle is rejected and counted; with no other, an error.
    let mut broken = (*mesh(&block([0.0; 3], [1.0; 3], |p| p))).clone();
    broken.positions[0][1] = f64::NAN;
    let (some, rejected) = voxels(&Arc::new(broken.clone()), &how);
    assert!(some.unwrap().inside() > 0 && rejected >= 4);
    broken.positions.fill([f64::INFINITY; 3]);
    assert_eq!(voxels(&Arc::new(broken), &how).0.unwrap_err().code, "empty-mesh");
    // 100,000 : 1.
    let bar = mesh(&block([0.0; 3], [100_000.0, 1.0, 1.0], |[x, y, z]| [x, y + 0.3, z + 0.3]));
    assert!(tiles(&voxels(&bar, &how).0.unwrap(), &VoteTile::default()).len() <= 4);
}

/// Refused before anything is allocated.
#[test]
fn resolutions_out_of_range() {
    let place = support::Place::new();
    place.write("it.obj", block([0.0; 3], [1.0; 3], |p| p));
    for resolution in [0, 1, 4096] {
        let text = format!(
            "[node.read]\nop = \"read-mesh\"\npath = \"it.obj\"\n\n[node.grid]\nop = \"voxelize\"\nin.mesh = \"read\"\nresolution = {resolution}\n"
        );
        place.write("it.toml", &text);
        let done = place.lodge(&["run", "it.toml"]);
        let printed = String::from_utf8_lossy(&done.stderr);
        assert!(
            !done.status.success() && printed.contains("resolution") && printed.contains("must be at"),
            "{printed}"
        );
    }
}
