//! Meshes for other programs: OBJ and PLY. Neither holds pictures; what is not in the file is told.
//!
//! Places are written so that reading gives the same numbers. Colours of vertices are those of a screen.
//! Source: Wavefront's appendix B; Turk's PLY.

use std::fmt::Write as _;

use crate::artifact::Mesh;
use crate::diag::Result;
use crate::io::gltf::Written;
use crate::io::picture::screen;

/// OBJ, y up: an object for each feature, `usemtl` for each material (if there are any), whose looks are left to a library.
pub fn obj(mesh: &Mesh) -> Result<Written> {
    let surface = &mesh.surface;
    let mut out = String::from("# lodge, metres, y up\n");
    let one = "a string grows";
    for (i, [x, y, z]) in mesh.positions.iter().enumerate() {
        write!(out, "v {x} {z} {}", 0.0 - y).expect(one);
        if let Some([r, g, b, _]) = surface.colours.get(i) {
            let [r, g, b] = [r, g, b].map(|c| on_screen(*c));
            write!(out, " {r} {g} {b}").expect(one);
        }
        out.push('\n');
    }
    for [u, v] in &surface.uvs {
        writeln!(out, "vt {u} {}", 1.0 - f64::from(*v)).expect(one);
    }
    for [x, y, z] in &surface.normals {
        writeln!(out, "vn {x} {z} {}", 0.0 - y).expect(one);
    }
    let (mut feature, mut material) = (None, None);
    for primitive in &mesh.primitives {
        let first = primitive.first_triangle as usize;
        for t in &mesh.triangles[first..first + primitive.triangles as usize] {
            let own = mesh.features[t[0] as usize];
            if feature != Some(own) {
                feature = Some(own);
                writeln!(out, "o {}", on_a_line(mesh.feature_ids.get(own as usize))).expect(one);
            }
            if material != Some(primitive.material) && !surface.materials.is_empty() {
                material = Some(primitive.material);
                let name = primitive.material.map_or(&primitive.name, |m| &surface.materials[m as usize].name);
                writeln!(out, "usemtl {}", on_a_line(name)).expect(one);
            }
            out.push('f');
            for v in t {
                let normal = surface.normals.get(*v as usize).is_some_and(|n| *n != [0.0; 3]);
                let i = v + 1;
                match (surface.uvs.is_empty(), normal) {
                    (true, false) => write!(out, " {i}"),
                    (true, true) => write!(out, " {i}//{i}"),
                    (false, false) => write!(out, " {i}/{i}"),
                    (false, true) => write!(out, " {i}/{i}/{i}"),
                }
                .expect(one);
            }
            out.push('\n');
        }
    }
    let told = told(mesh, "an OBJ", false);
    Ok(Written { bytes: out.into_bytes(), told })
}

/// A name that is not its line's end.
fn on_a_line(name: &str) -> String {
    let name: String = name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    if name.trim().is_empty() { "mesh".into() } else { name }
}

fn on_screen(light: f32) -> f64 {
    let l = f64::from(light).clamp(0.0, 1.0);
    let v = if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * libm::pow(l, 1.0 / 2.4) - 0.055 };
    (v * 1e6).round() / 1e6
}

/// PLY, binary, z up.
pub fn ply(mesh: &Mesh) -> Result<Written> {
    let surface = &mesh.surface;
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\ncomment lodge, metres\nelement vertex {}\n",
        mesh.positions.len()
    );
    let names = |out: &mut String, kind: &str, all: &[&str], there: bool| {
        let lines = all.iter().filter(|_| there).map(|name| format!("property {kind} {name}\n"));
        out.extend(lines);
    };
    names(&mut out, "double", &["x", "y", "z"], true);
    names(&mut out, "float", &["nx", "ny", "nz"], !surface.normals.is_empty());
    names(&mut out, "double", &["s", "t"], !surface.uvs.is_empty());
    names(&mut out, "uchar", &["red", "green", "blue", "alpha"], !surface.colours.is_empty());
    write!(out, "element face {}\nproperty list uchar uint vertex_indices\nend_header\n", mesh.triangles.len())
        .expect("a string grows");
    let mut out = out.into_bytes();
    for (i, p) in mesh.positions.iter().enumerate() {
        p.iter().for_each(|c| out.extend(c.to_le_bytes()));
        if let Some(n) = surface.normals.get(i) {
            n.iter().for_each(|c| out.extend(c.to_le_bytes()));
        }
        if let Some(&[u, v]) = surface.uvs.get(i) {
            [f64::from(u), 1.0 - f64::from(v)].iter().for_each(|c| out.extend(c.to_le_bytes()));
        }
        if let Some(&[r, g, b, a]) = surface.colours.get(i) {
            out.extend([screen(r), screen(g), screen(b), (a.clamp(0.0, 1.0) * 255.0).round() as u8]);
        }
    }
    for t in &mesh.triangles {
        out.push(3);
        t.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    let told = told(mesh, "a PLY", true);
    Ok(Written { bytes: out, told })
}

/// What such a file does not hold.
fn told(mesh: &Mesh, file: &str, names_as_well: bool) -> Vec<String> {
    let surface = &mesh.surface;
    let mut lost = Vec::new();
    let mut count = |n: usize, one: &str, many: &str| match n {
        0 => {}
        1 => lost.push(one.to_string()),
        n => lost.push(format!("{n} {many}")),
    };
    count(surface.images.len(), "a picture", "pictures");
    count(surface.materials.len(), "the looks of a material", "materials' looks");
    count(mesh.attributes.columns.len(), "an attribute of features", "attributes of features");
    count(if names_as_well && mesh.feature_ids.len() > 1 { mesh.feature_ids.len() } else { 0 }, "", "features' names");
    count(if names_as_well { 0 } else { surface.colours.iter().filter(|c| c[3] != 1.0).count() }, "an alpha", "alphas");
    match lost.is_empty() {
        true => Vec::new(),
        false => vec![format!("{file} file does not hold {}; a .glb does", lost.join(", "))],
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Files, read};
    use super::*;
    use crate::artifact::mesh::{Primitive, Surface};
    use crate::diag::Report;
    use crate::geom::frame::Frame;
    use crate::io::ledger::Ledger;
    use crate::io::picture::linear;

    fn two() -> Mesh {
        let corner = |i: u32| [0.1 * f64::from(i), f64::from(i * i) + 1.0 / 3.0, -f64::from(i % 3)];
        let part = |first_triangle| Primitive { name: "mesh".into(), first_triangle, triangles: 1, material: None };
        Mesh {
            frame: Frame::local(),
            positions: (0..6).map(corner).collect(),
            triangles: vec![[0, 1, 2], [3, 4, 5]],
            features: vec![0, 0, 0, 1, 1, 1],
            primitives: vec![Primitive { triangles: 2, ..part(0) }],
            feature_ids: ["a b", "c"].into_iter().collect(),
            attributes: Default::default(),
            surface: Surface {
                normals: vec![[0.0, 0.6, 0.8]; 6],
                uvs: (0..6u8).map(|i| [0.3 * f32::from(i), 0.7 - f32::from(i)]).collect(),
                colours: (0..6).map(|i| [linear()[40 * i], 0.0, 1.0, 1.0]).collect(),
                ..Surface::default()
            },
        }
    }

    fn back(name: &str, bytes: &[u8]) -> Mesh {
        let report = Report::default();
        read(&Files { name, bytes, beside: &|_| None, warn: &|_| () }, None, &mut Ledger::new(&report)).unwrap()
    }

    #[test]
    fn there_and_back() {
        let mesh = two();
        for (name, written) in [("a.obj", obj(&mesh)), ("a.ply", ply(&mesh))] {
            let written = written.unwrap();
            let found = back(name, &written.bytes);
            assert_eq!((&found.positions, &found.triangles), (&mesh.positions, &mesh.triangles), "{name}");
            assert_eq!(found.surface.uvs, mesh.surface.uvs, "{name}");
            let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
            assert!(near(found.surface.normals.as_flattened(), mesh.surface.normals.as_flattened()), "{name}");
            assert!(near(found.surface.colours.as_flattened(), mesh.surface.colours.as_flattened()), "{name}");
        }
        assert_eq!(back("a.obj", &obj(&mesh).unwrap().bytes).feature_ids, mesh.feature_ids);
        assert_eq!(obj(&mesh).unwrap().told, [""; 0]);
        assert_eq!(ply(&mesh).unwrap().told, ["a PLY file does not hold 2 features' names; a .glb does"]);
    }
}
