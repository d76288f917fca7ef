//! What a browser must draw too: models with lodge's pictures of their 14 sides, for `.ci/browse.sh`, which draws the same
//! with three.js and compares pixel by pixel.
//!
//! Kept in `target/tmp/views`: `NAME.views.json` (which model, which cameras), `NAME.views.rgba`, and models of our own.

mod support;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use lodge::artifact::mesh::Alpha;
use lodge::artifact::{Files, Impostors, Mesh, PlaneTiles, Voxels};
use lodge::io::paint::Paint;
use lodge::io::views::{self, SIDE, View};
use lodge::op::{Bench, Inputs, Op, Source};
use lodge::ops::bake_impostor::BakeImpostor;
use lodge::ops::read_mesh::ReadMesh;
use lodge::ops::vote_tile::VoteTile;
use lodge::ops::voxelize::Voxelize;
use lodge::ops::write_glb::{Packing, WriteGlb};
use serde_json::json;

fn folder() -> PathBuf {
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("views");
    std::fs::create_dir_all(&out).unwrap();
    out
}

/// Pictures of a mesh, with the model that they are to be compared with.
fn keep(name: &str, model: &Path, mesh: &Mesh, cameras: &[View; 14], sharp: bool) {
    let seen = views::all(mesh, &Paint::new(mesh), cameras, false);
    let bytes: Vec<u8> = seen.iter().flat_map(|s| s.pixels.as_flattened()).copied().collect();
    let bare = mesh.surface.materials.is_empty();
    let spec = json!({
        "model": model, "side": SIDE, "half": cameras[0].half, "middle": cameras[0].middle, "bare": bare, "sharp": sharp,
        "views": cameras.iter().map(|c| c.axes).collect::<Vec<_>>(),
    });
    std::fs::write(folder().join(format!("{name}.views.rgba")), bytes).unwrap();
    std::fs::write(folder().join(format!("{name}.views.json")), spec.to_string()).unwrap();
}

fn read(path: &Path) -> Arc<Mesh> {
    let mut bench = Bench::default();
    let main = Source::of_file(path, None);
    let beside = ReadMesh::beside(&main);
    bench.sources.push(main);
    bench.sources.extend(beside.iter().map(|n| Source::of_file(&path.with_file_name(n), Some(n))));
    let out = ReadMesh::default().run(&bench.ctx(), Inputs::take(vec![])).unwrap();
    assert!(bench.report.finish().warnings.is_empty());
    Arc::new(out)
}

/// Runs an operator; what it writes as well.
fn run<O: Op>(op: &O, inputs: Vec<Vec<Arc<dyn lodge::artifact::AnyArtifact>>>) -> (O::Out, Bench) {
    let bench = Bench::default();
    let out = op.run(&bench.ctx(), O::In::take(inputs)).unwrap();
    (out, bench)
}

/// The impostor of a mesh.
fn bake(mesh: &Arc<Mesh>, resolution: u32, how: &BakeImpostor) -> Arc<Impostors> {
    let grid = Voxelize { resolution, ..Voxelize::default() };
    let voxels: Voxels = run(&grid, vec![vec![mesh.clone()]]).0;
    let tiles: PlaneTiles = run(&VoteTile::default(), vec![vec![Arc::new(voxels)]]).0;
    Arc::new(run(how, vec![vec![mesh.clone()], vec![Arc::new(tiles)]]).0)
}

/// Its GLB, kept.
fn write(name: &str, quads: &Arc<Impostors>, atlas: Packing) -> PathBuf {
    let (files, bench): (Files, _) = run(&WriteGlb { path: "a.glb".into(), atlas }, vec![vec![quads.clone()]]);
    let glb = bench.blobs.0.lock().unwrap()[&files.files[0].blob.digest].clone();
    let path = folder().join(format!("{name}.glb"));
    std::fs::write(&path, glb).unwrap();
    path
}

/// The impostor of a mesh, its GLB kept, drawn from where the mesh is.
fn impostor(name: &str, mesh: &Arc<Mesh>, resolution: u32) -> Impostors {
    let quads = bake(mesh, resolution, &BakeImpostor::default());
    let path = write(name, &quads, Packing::Png);
    keep(name, &path, &quads.mesh(), &views::cameras(mesh), true);
    Arc::unwrap_or_clone(quads)
}

#[test]
fn a_scene_of_everything() {
    let path = folder().join("scene.glb");
    std::fs::write(&path, support::scene::scene()).unwrap();
    let mesh = read(&path);
    assert!(mesh.surface.materials.iter().any(|m| m.alpha == Alpha::Blend));
    // A brick, five quads, three bricks.
    assert_eq!(mesh.triangles.len(), 12 + 6 * 2 + 3 * 12);
    keep("scene", &path, &mesh, &views::cameras(&mesh), false);
    let quads = impostor("scene-impostor", &mesh, 64);
    assert!(quads.len() > 10);
}

#[test]
fn the_pavilion() {
    let path = support::project().join("fixtures/pavilion/pavilion.glb");
    let mesh = read(&path);
    keep("pavilion", &path, &mesh, &views::cameras(&mesh), false);
    impostor("pavilion-impostor", &mesh, 64);
}

/// With a normal map, and packed as WebP: for `.ci/validate.sh`, which looks at every GLB here.
#[test]
fn of_every_kind() {
    let mesh = read(&support::project().join("fixtures/pavilion/pavilion.glb"));
    let quads = bake(&mesh, 16, &BakeImpostor { normal_map: true, ..BakeImpostor::default() });
    for (name, atlas, kind) in
        [("pavilion-normals", Packing::Png, "image/png"), ("pavilion-webp", Packing::Webp, "image/webp")]
    {
        let bytes = std::fs::read(write(name, &quads, atlas)).unwrap();
        // Of WebP that reader knows nothing.
        let model = gltf::Gltf::from_slice_without_validation(&bytes).unwrap();
        assert!(model.materials().all(|m| m.normal_texture().is_some()), "{name}");
        let kinds: Vec<_> = model.document.into_json().images.into_iter().map(|i| i.mime_type.unwrap().0).collect();
        assert_eq!(kinds, [kind; 2], "{name}");
    }
}

/// Originals and impostors of the real meshes: at 128 cells these look like those.
#[test]
fn real_meshes() {
    let Some(data) = support::real_data() else { return };
    // Least share of the silhouettes in common, largest difference of colours.
    for (name, file, silhouette, colour) in [
        ("toy_car", "toy_car/ToyCar.gltf", 0.95, 7.0),
        ("lamborghini_huracan", "lamborghini_huracan.glb", 0.95, 14.0),
        ("house_scene", "house_scene.glb", 0.93, 6.0),
        ("nasa_ingenuity", "nasa_ingenuity.glb", 0.79, 28.0),
        ("antique_camera", "antique_camera.glb", 0.91, 24.0),
        ("japanese_temple", "japanese_temple.glb", 0.93, 12.0),
        ("happy_buddha", "happy_buddha_100k.obj.gz", 0.95, 7.5),
    ] {
        let path = data.join("meshes").join(file);
        let mesh = read(&path);
        // Viewers read no OBJ.
        if !file.ends_with(".obj.gz") {
            keep(name, &path, &mesh, &views::cameras(&mesh), false);
        }
        let worth = impostor(&format!("{name}-impostor"), &mesh, 128).worth;
        assert!(worth.silhouette >= silhouette && worth.colour_error <= colour, "{name}: {worth:?}");
    }
}
