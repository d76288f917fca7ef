//! What gltfpack makes of meshes, against the meshes. `.ci/run` brings it; without it this is left out.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use lodge::artifact::Mesh;

use super::support::meshopt::parts;
use super::support::{Place, project, real_data};
use super::{modes, read, read_all, turned};

/// What of a mesh stays as it is when it is quantised and put in another order.
#[derive(Debug)]
struct Gist {
    triangles: usize,
    bounds: [[f64; 3]; 2],
    area: f64,
    /// Means over the surface: place, colour, place in the picture of what has one, and how well normals agree with faces.
    centre: [f64; 3],
    colour: [f64; 3],
    uv: [f64; 2],
    upright: f64,
}

fn gist(mesh: &Mesh) -> Gist {
    let mut out = Gist {
        triangles: mesh.triangles.len(),
        bounds: [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
        area: 0.0,
        centre: [0.0; 3],
        colour: [0.0; 3],
        uv: [0.0; 2],
        upright: 0.0,
    };
    let look = &mesh.surface;
    let mut painted = 0.0;
    for run in &mesh.primitives {
        let material = run.material.map(|m| &look.materials[m as usize]);
        for t in &mesh.triangles[run.first_triangle as usize..][..run.triangles as usize] {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            for p in [a, b, c] {
                (0..3).for_each(|k| out.bounds[0][k] = out.bounds[0][k].min(p[k]));
                (0..3).for_each(|k| out.bounds[1][k] = out.bounds[1][k].max(p[k]));
            }
            let [u, v] = [b, c].map(|p| [0, 1, 2].map(|k| p[k] - a[k]));
            let cross = [0, 1, 2].map(|k| u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3]);
            let area = cross.iter().map(|c| c * c).sum::<f64>().sqrt() / 2.0;
            let textured = material.is_some_and(|m| m.texture.is_some()) && !look.uvs.is_empty();
            out.area += area;
            painted += if textured { area } else { 0.0 };
            for &v in t {
                let v = v as usize;
                let share = area / 3.0;
                for k in 0..3 {
                    let base = material.map_or(1.0, |m| f64::from(m.base_colour[k]));
                    out.centre[k] += share * mesh.positions[v][k];
                    out.colour[k] += share * base * look.colours.get(v).map_or(1.0, |c| f64::from(c[k]));
                    out.upright += look.normals.get(v).map_or(0.0, |n| f64::from(n[k]) * cross[k] / 6.0);
                }
                if textured {
                    (0..2).for_each(|k| out.uv[k] += share * f64::from(look.uvs[v][k]));
                }
            }
        }
    }
    out.centre.iter_mut().chain(&mut out.colour).chain([&mut out.upright]).for_each(|v| *v /= out.area);
    out.uv.iter_mut().for_each(|v| *v /= painted.max(1e-300));
    out
}

fn meshes() -> Vec<PathBuf> {
    let mut all = vec![project().join("fixtures/pavilion/pavilion.glb")];
    if let Some(data) = real_data() {
        let folder = std::fs::read_dir(data.join("meshes")).unwrap().map(|e| e.unwrap().path());
        all.extend(folder.filter(|p| p.extension().is_some_and(|e| e == "glb")));
    }
    all.sort();
    all
}

/// Packs a file; false where there is no gltfpack.
fn gltfpack(how: &str, from: &Path, to: &Path) -> bool {
    let mut command = Command::new("gltfpack");
    command.args(how.split(' ')).arg("-i").arg(from).arg("-o").arg(to);
    match command.output() {
        Err(_) => {
            println!("skipped: no gltfpack");
            false
        }
        Ok(done) => {
            assert!(done.status.success(), "{how} {}: {done:?}", from.display());
            true
        }
    }
}

#[test]
fn what_gltfpack_packs_is_the_mesh_it_was() {
    let place = Place::new();
    for path in meshes() {
        let name = path.file_name().unwrap().to_str().unwrap().to_string();
        let mesh = read(&std::fs::read(&path).unwrap());
        let original = gist(&mesh);
        // Bits of places, of places in pictures and of normals that are kept (24: floats), and which streams there are.
        for (how, bits, streams) in [
            ("-noq", [24, 24, 24], ""),
            ("-c -noq", [24, 24, 24], "EXT ATTRIBUTES TRIANGLES"),
            ("-c", [14, 12, 8], "EXT ATTRIBUTES TRIANGLES"),
            ("-cc", [14, 12, 8], "EXT OCTAHEDRAL"),
            ("-cz", [14, 12, 8], "KHR OCTAHEDRAL"),
            ("-c -vpf", [14, 12, 8], "EXT EXPONENTIAL"),
            ("-cz -vpf -vtf -vnf", [14, 12, 8], "KHR EXPONENTIAL"),
            ("-c -vpn -vp 16 -vt 16 -vn 16", [16, 16, 16], "EXT ATTRIBUTES"),
            ("-cz -vp 12 -vi", [12, 12, 8], "KHR ATTRIBUTES"),
            ("-cc -mi -kn -km", [14, 12, 8], "EXT OCTAHEDRAL"),
        ] {
            let file = place.path("packed.glb");
            if !gltfpack(how, &path, &file) {
                return;
            }
            let bytes = std::fs::read(&file).unwrap();
            let text = parts(&bytes).0["bufferViews"].to_string();
            for word in streams.split(' ').filter(|w| !w.is_empty()) {
                assert!(text.contains(word), "{name} {how}: no {word} in its streams");
            }
            let packed = read(&bytes);
            let found = gist(&packed);
            let what = format!("{name} {how}: {found:#?}, wanted {original:#?}");
            let step = |bits: i32| libm::ldexp(1.0, -bits);
            let near = |a: &[f64], b: &[f64], most: f64| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= most);
            let size = (0..3).map(|k| original.bounds[1][k] - original.bounds[0][k]).fold(0.0, f64::max);
            // Triangles that came to nothing are left out.
            let lost = original.triangles as i64 - found.triangles as i64;
            assert!((0..=original.triangles as i64 / 50).contains(&lost), "{what}");
            let place = 2.0 * size * step(bits[0]);
            assert!((0..2).all(|e| near(&found.bounds[e], &original.bounds[e], place)), "{what}");
            assert!((found.area / original.area - 1.0).abs() < 1e-6 + 8.0 * step(bits[0]), "{what}");
            assert!(near(&found.centre, &original.centre, size * 1e-6 + place), "{what}");
            assert!(near(&found.uv, &original.uv, 1e-6 + 4.0 * step(bits[1])), "{what}");
            assert!(near(&found.colour, &original.colour, 1.0 / 255.0), "{what}");
            assert!((found.upright - original.upright).abs() < 1e-4 + 2.0 * step(bits[2]), "{what}");
            let pictures = |m: &Mesh| {
                (0..m.surface.images.len()).map(|i| m.surface.images.image(i).to_vec()).collect::<BTreeSet<_>>()
            };
            assert!(pictures(&packed) == pictures(&mesh), "{name} {how}: other pictures");
        }
    }
}

/// With a plain copy beside, or without it.
#[test]
fn what_gltfpack_packs_with_a_copy() {
    let place = Place::new();
    for path in meshes() {
        let (file, copy) = (place.path("packed.glb"), place.path("packed.fallback.bin"));
        if !gltfpack("-cf", &path, &file) {
            return;
        }
        let (bytes, copy) = (std::fs::read(&file).unwrap(), std::fs::read(&copy).unwrap());
        assert!(modes(&bytes, "ATTRIBUTES") > 0);
        let both = read_all(&[("packed.glb", &bytes), ("packed.fallback.bin", &copy)]).0.unwrap();
        assert!(turned(both) == turned(read(&bytes)), "{}", path.display());
    }
}
