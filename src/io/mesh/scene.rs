//! The nodes of a glTF scene and what they draw.

use serde::Deserialize;
use serde_json::{Map, Value};

use super::accessor::Data;
use super::gltf::{Paint, Root, Transform};
use super::obj::unit;
use super::{Draft, MOST};
use crate::diag::Result;
use crate::io::ledger::Ledger;

#[derive(Deserialize, Default)]
#[serde(default)]
pub struct Node {
    name: String,
    children: Vec<usize>,
    mesh: Option<usize>,
    skin: Option<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
    extensions: Value,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub struct Mesh {
    name: String,
    primitives: Vec<Primitive>,
    weights: Vec<f64>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Primitive {
    attributes: Map<String, Value>,
    indices: Option<usize>,
    material: Option<usize>,
    mode: Option<u32>,
    extensions: Value,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub struct Skin {
    inverse_bind_matrices: Option<usize>,
    joints: Vec<usize>,
}

/// Three rows of an affine map.
type Matrix = [[f64; 4]; 3];

const ONE: Matrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

fn times(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|r| {
        std::array::from_fn(|c| {
            let sum: f64 = (0..3).map(|k| a[r][k] * b[k][c]).sum();
            if c == 3 { sum + a[r][3] } else { sum }
        })
    })
}

fn apply(m: &Matrix, p: [f64; 3]) -> [f64; 3] {
    m.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3])
}

/// Of columns, as files have them.
fn of_columns(m: &[f64; 16]) -> Matrix {
    std::array::from_fn(|r| std::array::from_fn(|c| m[4 * c + r]))
}

fn of_parts(t: [f64; 3], [x, y, z, w]: [f64; 4], s: [f64; 3]) -> Matrix {
    let turn = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ];
    std::array::from_fn(|r| [turn[r][0] * s[0], turn[r][1] * s[1], turn[r][2] * s[2], t[r]])
}

/// Cofactors of the linear part, which turn normals, and its determinant.
fn cofactors(m: &Matrix) -> ([[f64; 3]; 3], f64) {
    let c = |i: usize, j: usize| {
        let (a, b, u, v) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][u] * m[b][v] - m[a][v] * m[b][u]
    };
    let all: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| c(i, j)));
    let det = (0..3).map(|j| m[0][j] * all[0][j]).sum();
    (all, det)
}

impl Node {
    fn matrix(&self) -> Matrix {
        match &self.matrix {
            Some(m) => of_columns(m),
            None => of_parts(
                self.translation.unwrap_or_default(),
                self.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]),
                self.scale.unwrap_or([1.0; 3]),
            ),
        }
    }
}

/// Everything that is drawn.
pub fn read(root: &Root, data: &Data, paint: &mut Paint, draft: &mut Draft, ledger: &mut Ledger) -> Result<()> {
    let files = data.files;
    // (1) Where the nodes stand. Each has one parent, or ten nodes could draw a thousand meshes.
    let mut parents = vec![0u32; root.nodes.len()];
    for &child in root.nodes.iter().flat_map(|n| &n.children) {
        let parent = parents.get_mut(child).ok_or_else(|| files.broken(format!("there is no node {child}")))?;
        *parent += 1;
        if *parent > 1 {
            return Err(files.broken(format!("node {child} has two parents")));
        }
    }
    let all = || (0..root.nodes.len()).filter(|&n| parents[n] == 0).collect::<Vec<_>>();
    let roots = match (root.scene, root.scenes.first()) {
        (None, None) => all(),
        (Some(i), _) => root.scenes.get(i).ok_or_else(|| files.broken(format!("there is no scene {i}")))?.nodes.clone(),
        (None, Some(first)) => first.nodes.clone(),
    };
    let mut places: Vec<Option<Matrix>> = vec![None; root.nodes.len()];
    let mut order = Vec::new();
    let mut todo: Vec<(usize, Matrix)> = roots.into_iter().rev().map(|n| (n, ONE)).collect();
    while let Some((n, above)) = todo.pop() {
        let node = root.nodes.get(n).ok_or_else(|| files.broken(format!("there is no node {n}")))?;
        if places[n].is_some() {
            return Err(files.broken(format!("node {n} is in the scene twice")));
        }
        let place = times(&above, &node.matrix());
        places[n] = Some(place);
        order.push(n);
        todo.extend(node.children.iter().rev().map(|&c| (c, place)));
    }

    // (2) What they draw.
    let mut morphed = false;
    for n in order {
        let node = &root.nodes[n];
        let Some(mesh) = node.mesh else { continue };
        let mesh = root.meshes.get(mesh).ok_or_else(|| files.broken(format!("there is no mesh {mesh}")))?;
        morphed |= mesh.weights.iter().any(|w| *w != 0.0);
        let own = [&node.name, &mesh.name].into_iter().find(|name| !name.is_empty());
        let name = own.cloned().unwrap_or_else(|| format!("node-{n}"));
        let place = places[n].expect("it is in the order");
        let skin = node.skin.map(|s| joints(root, data, s, &places)).transpose()?;
        let copies = match node.extensions.get("EXT_mesh_gpu_instancing") {
            Some(instancing) => instances(data, &instancing["attributes"])?,
            None => vec![ONE],
        };
        let parts = mesh.primitives.iter().map(|p| part(p, data, paint, draft)).collect::<Result<Vec<_>>>()?;
        let new: u64 = parts.iter().flatten().map(|p| p.positions.len().max(p.corners.len()) as u64).sum();
        if (new * copies.len() as u64).saturating_add(draft.positions.len().max(draft.triangles.len()) as u64) > MOST {
            return Err(files.broken(format!("it draws more than the {MOST} vertices that are read")));
        }
        for copy in copies {
            let feature = draft.feature(&name);
            for part in &parts {
                match part {
                    Some(part) => part.draw(&times(&place, &copy), skin.as_deref(), feature, data, draft, ledger)?,
                    None => {
                        ledger.read += 1;
                        ledger.filter_type("points and lines");
                    }
                }
            }
        }
    }
    if morphed {
        files.warn("morph targets are not heeded: shapes are those of no weights");
    }
    Ok(())
}

/// Places of instances below their node.
fn instances(data: &Data, attributes: &Value) -> Result<Vec<Matrix>> {
    let index = |name: &str| attributes[name].as_u64().map(|i| i as usize);
    let moves = index("TRANSLATION").map(|i| data.rows::<3>(i, "translations")).transpose()?;
    let turns = index("ROTATION").map(|i| data.rows::<4>(i, "rotations")).transpose()?;
    let scales = index("SCALE").map(|i| data.rows::<3>(i, "scales")).transpose()?;
    let counts = [moves.as_ref().map(Vec::len), turns.as_ref().map(Vec::len), scales.as_ref().map(Vec::len)];
    let n = counts.into_iter().flatten().min().unwrap_or(1);
    let one = |i: usize| {
        let turn = turns.as_ref().map_or([0.0, 0.0, 0.0, 1.0], |a| a[i]);
        of_parts(moves.as_ref().map_or([0.0; 3], |a| a[i]), turn, scales.as_ref().map_or([1.0; 3], |a| a[i]))
    };
    Ok((0..n).map(one).collect())
}

/// Where each joint takes a vertex.
fn joints(root: &Root, data: &Data, skin: usize, places: &[Option<Matrix>]) -> Result<Vec<Matrix>> {
    let skin = root.skins.get(skin).ok_or_else(|| data.files.broken(format!("there is no skin {skin}")))?;
    let binds = skin.inverse_bind_matrices.map(|i| data.rows::<16>(i, "bind matrices")).transpose()?;
    let joint = |(i, &n): (usize, &usize)| {
        let place = places.get(n).copied().flatten();
        let place = place.ok_or_else(|| data.files.broken(format!("joint {n} is not in the scene")))?;
        let bind = binds.as_ref().and_then(|b| b.get(i)).map_or(ONE, of_columns);
        Ok(times(&place, &bind))
    };
    skin.joints.iter().enumerate().map(joint).collect()
}

/// A primitive's numbers before they are placed.
struct Part {
    name: String,
    positions: Vec<[f64; 3]>,
    normals: Option<Vec<[f64; 3]>>,
    uvs: Option<Vec<[f64; 2]>>,
    transform: Transform,
    colours: Option<(usize, Vec<f64>)>,
    /// Joints and weights, four at a time.
    bound: Vec<(Vec<[f64; 4]>, Vec<[f64; 4]>)>,
    corners: Vec<u64>,
    mode: u32,
    material: Option<u32>,
}

/// None of points and lines.
fn part(p: &Primitive, data: &Data, paint: &mut Paint, draft: &mut Draft) -> Result<Option<Part>> {
    let files = data.files;
    let mode = p.mode.unwrap_or(4);
    if mode < 4 {
        return Ok(None);
    }
    if mode > 6 {
        return Err(files.broken(format!("{mode} is no mode of a primitive")));
    }
    let attribute = |name: &str| p.attributes.get(name).and_then(Value::as_u64).map(|i| i as usize);
    let draco = p.extensions.get("KHR_draco_mesh_compression").is_some();
    let dracos = || {
        files
            .broken("its geometry is compressed by KHR_draco_mesh_compression, which is not read")
            .help("open it in Blender and export it without compression")
    };
    let Some(place) = attribute("POSITION") else {
        return if draco { Err(dracos()) } else { Ok(None) };
    };
    // Compressed accessors have no view of their own.
    if draco && data.accessors.get(place).is_some_and(|a| !a.has_view()) {
        return Err(dracos());
    }
    let positions = data.rows::<3>(place, "positions")?;
    let painted = p.material.map(|m| paint.material(m, draft)).transpose()?;
    let uv_set = painted.as_ref().map_or(0, |m| m.uv_set);
    let textured = painted.as_ref().is_some_and(|m| draft.surface.materials[m.number as usize].texture.is_some());
    let uvs = attribute(&format!("TEXCOORD_{uv_set}")).filter(|_| textured);
    let mut bound = Vec::new();
    for k in 0..4 {
        if let (Some(j), Some(w)) = (attribute(&format!("JOINTS_{k}")), attribute(&format!("WEIGHTS_{k}"))) {
            bound.push((data.rows::<4>(j, "joints")?, data.rows::<4>(w, "weights")?));
        }
    }
    let colours = attribute("COLOR_0").map(|i| data.values(i)).transpose()?.filter(|c| c.0 == 3 || c.0 == 4);
    let corners = match p.indices {
        Some(i) => data.values(i)?.1.into_iter().map(|v| if v >= 0.0 { v as u64 } else { u64::MAX }).collect(),
        None => (0..positions.len() as u64).collect(),
    };
    let part = Part {
        name: painted.as_ref().map_or("mesh".into(), |m| draft.surface.materials[m.number as usize].name.clone()),
        normals: attribute("NORMAL").map(|i| data.rows::<3>(i, "normals")).transpose()?,
        uvs: uvs.map(|i| data.rows::<2>(i, "picture places")).transpose()?,
        transform: painted.as_ref().map_or_else(Transform::default, |m| m.transform),
        colours,
        bound,
        corners,
        mode,
        material: painted.map(|m| m.number),
        positions,
    };
    let n = part.positions.len();
    let short = |len: Option<usize>| len.is_some_and(|l| l < n);
    let lengths = [part.normals.as_ref().map(Vec::len), part.uvs.as_ref().map(Vec::len)];
    let colours = part.colours.as_ref().map(|(w, all)| all.len() / w);
    let joints = part.bound.iter().any(|(j, w)| j.len() < n || w.len() < n);
    if lengths.into_iter().any(short) || short(colours) || joints {
        return Err(files.broken(format!("a primitive of {n} positions has fewer of another attribute")));
    }
    Ok(Some(part))
}

impl Part {
    fn draw(
        &self,
        place: &Matrix,
        skin: Option<&[Matrix]>,
        feature: u32,
        data: &Data,
        draft: &mut Draft,
        ledger: &mut Ledger,
    ) -> Result<()> {
        let files = data.files;
        let first = draft.positions.len();
        let first_triangle = draft.triangles.len();
        let skin = skin.filter(|_| !self.bound.is_empty());
        let (mut turn, mut det) = cofactors(place);
        // A skinned vertex stands where its joints take it, wherever its node is.
        for (i, p) in self.positions.iter().enumerate() {
            if let Some(skin) = skin {
                let m = self.bent(i, skin).ok_or_else(|| files.broken("a vertex is bound to a joint that is not"))?;
                draft.positions.push(apply(&m, *p));
                (turn, det) = cofactors(&m);
            } else {
                draft.positions.push(apply(place, *p));
            }
            draft.features.push(feature);
            if let Some(n) = &self.normals {
                let n = turn.map(|r| (r[0] * n[i][0] + r[1] * n[i][1] + r[2] * n[i][2]) * det.signum());
                draft.surface.normals.resize(first + i, [0.0; 3]);
                draft.surface.normals.push(unit(n));
            }
            if let Some(uvs) = &self.uvs {
                draft.surface.uvs.resize(first + i, [0.0; 2]);
                draft.surface.uvs.push(self.transform.of(uvs[i]));
            }
            if let Some((width, all)) = &self.colours {
                let c = &all[i * width..][..*width];
                draft.surface.colours.resize(first + i, [1.0; 4]);
                draft.surface.colours.push([0, 1, 2, 3].map(|k| c.get(k).map_or(1.0, |v| *v as f32)));
            }
        }
        // What mirrors turns faces inside out; so does a negative scale.
        let mirrored = det < 0.0;
        let corner = |i: usize| self.corners[i].saturating_add(first as u64);
        let count = if self.mode == 4 { self.corners.len() / 3 } else { self.corners.len().saturating_sub(2) };
        for t in 0..count {
            let mut of = match self.mode {
                4 => [3 * t, 3 * t + 1, 3 * t + 2],
                5 if t % 2 == 0 => [t, t + 1, t + 2],
                5 => [t + 1, t, t + 2],
                _ => [0, t + 1, t + 2],
            };
            if mirrored {
                of.swap(1, 2);
            }
            let of = of.map(corner);
            // Strips have flat triangles at their bends.
            if self.mode == 5 && (of[0] == of[1] || of[1] == of[2] || of[0] == of[2]) {
                continue;
            }
            draft.triangle(of, files, ledger, &|| format!("{} of `{}`", t, draft_name(&self.name)));
        }
        draft.primitive(&self.name, first_triangle, self.material);
        Ok(())
    }

    /// The map of a skinned vertex: the mean of its joints'.
    fn bent(&self, i: usize, skin: &[Matrix]) -> Option<Matrix> {
        let mut out = [[0.0; 4]; 3];
        let mut sum = 0.0;
        for (joints, weights) in &self.bound {
            for k in 0..4 {
                let w = weights[i][k];
                if w == 0.0 {
                    continue;
                }
                let m = skin.get(joints[i][k] as usize)?;
                sum += w;
                for r in 0..3 {
                    for c in 0..4 {
                        out[r][c] += w * m[r][c];
                    }
                }
            }
        }
        if sum > 0.0 {
            out.iter_mut().flatten().for_each(|v| *v /= sum);
        }
        Some(out)
    }
}

fn draft_name(name: &str) -> String {
    name.chars().take(40).collect()
}
