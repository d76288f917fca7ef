//! The nodes of a glTF scene and what they draw.

use serde::Deserialize;
use serde_json::Value;

use super::accessor::Data;
use super::gltf::{Paint, Root};
use super::primitive::{Part, Primitive, part};
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
    weights: Vec<f64>,
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
#[serde(default, rename_all = "camelCase")]
pub struct Skin {
    inverse_bind_matrices: Option<usize>,
    joints: Vec<usize>,
}

/// Three rows of an affine map.
pub type Matrix = [[f64; 4]; 3];

const ONE: Matrix = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

fn times(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|r| {
        std::array::from_fn(|c| {
            let sum: f64 = (0..3).map(|k| a[r][k] * b[k][c]).sum();
            if c == 3 { sum + a[r][3] } else { sum }
        })
    })
}

pub fn apply(m: &Matrix, p: [f64; 3]) -> [f64; 3] {
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
pub fn cofactors(m: &Matrix) -> ([[f64; 3]; 3], f64) {
    let c = |i: usize, j: usize| {
        let (a, b, u, v) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
        m[a][u] * m[b][v] - m[a][v] * m[b][u]
    };
    let all: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| c(i, j)));
    let det = (0..3).map(|j| m[0][j] * all[0][j]).sum();
    (all, det)
}

impl Node {
    /// How often its mesh is drawn.
    fn copies(&self, data: &Data) -> u64 {
        let Some(instancing) = self.extensions.get("EXT_mesh_gpu_instancing") else { return 1 };
        let count = |name: &str| data.count(instancing["attributes"][name].as_u64()? as usize).ok();
        ["TRANSLATION", "ROTATION", "SCALE"].into_iter().filter_map(count).min().unwrap_or(1)
    }

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

    // (2) How much they draw, before any of it is read.
    let mut sizes: Vec<Option<u64>> = vec![None; root.meshes.len()];
    let mut sum = 0u64;
    for &n in &order {
        let node = &root.nodes[n];
        let Some((m, mesh)) = node.mesh.and_then(|m| Some((m, root.meshes.get(m)?))) else { continue };
        let size = *sizes[m].get_or_insert_with(|| mesh.primitives.iter().map(|p| p.corners(data)).sum());
        sum = sum.saturating_add(size.saturating_mul(node.copies(data)));
        if sum > MOST {
            let message = format!("nodes[{n}]: up to here it draws more than the {MOST} corners that are read");
            return Err(files.broken(message));
        }
    }

    // (3) What they draw.
    let mut scene = Scene { root, data, places, skins: vec![None; root.skins.len()], drawn: 0, morphed: false };
    for n in order {
        scene.node(n, paint, draft, ledger).map_err(|e| files.within(format!("nodes[{n}]"), e))?;
    }
    if scene.morphed {
        files.warn("morph targets are not heeded: shapes are those of no weights");
    }
    Ok(())
}

/// What is being drawn.
struct Scene<'a, 'd> {
    root: &'a Root,
    data: &'a Data<'d>,
    places: Vec<Option<Matrix>>,
    /// Joints of the skins that were met.
    skins: Vec<Option<Vec<Matrix>>>,
    /// Vertices or corners so far, whichever a part has more of.
    drawn: u64,
    morphed: bool,
}

impl Scene<'_, '_> {
    fn node(&mut self, n: usize, paint: &mut Paint, draft: &mut Draft, ledger: &mut Ledger) -> Result<()> {
        let (root, data, files) = (self.root, self.data, self.data.files);
        let node = &root.nodes[n];
        let Some(m) = node.mesh else { return Ok(()) };
        let mesh = root.meshes.get(m).ok_or_else(|| files.broken(format!("there is no mesh {m}")))?;
        let weights = if node.weights.is_empty() { &mesh.weights } else { &node.weights };
        self.morphed |= weights.iter().any(|w| *w != 0.0);
        let own = [&node.name, &mesh.name].into_iter().find(|name| !name.is_empty());
        let name = own.cloned().unwrap_or_else(|| format!("node-{n}"));
        let place = self.places[n].expect("it is in the order");
        if let Some(s) = node.skin
            && self.skins.get(s).is_none_or(Option::is_none)
        {
            let new = joints(root, data, s, &self.places)?;
            self.skins[s] = Some(new);
        }
        let copies = match node.extensions.get("EXT_mesh_gpu_instancing") {
            Some(instancing) => instances(data, &instancing["attributes"])?,
            None => vec![ONE],
        };
        // One copy is drawn part by part; of several the parts are kept.
        let mut parts = Vec::new();
        let mut feature = 0;
        for (k, p) in mesh.primitives.iter().enumerate() {
            let at = format!("meshes[{m}].primitives[{k}]");
            let mut part = part(p, data, paint, draft).map_err(|e| files.within(&at, e))?;
            if let Some(part) = &mut part {
                part.at = format!("nodes[{n}], {at}");
                self.drawn = self.drawn.saturating_add(part.size().saturating_mul(copies.len() as u64));
                if self.drawn > MOST {
                    return Err(files.broken(format!("{at}: more than the {MOST} vertices that are read")));
                }
            }
            let skin = node.skin.and_then(|s| self.skins[s].as_deref());
            if copies.len() != 1 {
                parts.push(part);
                continue;
            }
            if k == 0 {
                feature = draft.feature(&name);
            }
            draw(part.as_ref(), &times(&place, &copies[0]), skin, feature, data, draft, ledger)?;
        }
        let skin = node.skin.and_then(|s| self.skins[s].as_deref());
        for copy in copies.iter().filter(|_| !parts.is_empty()) {
            let feature = draft.feature(&name);
            for part in &parts {
                draw(part.as_ref(), &times(&place, copy), skin, feature, data, draft, ledger)?;
            }
        }
        Ok(())
    }
}

fn draw(
    part: Option<&Part>,
    place: &Matrix,
    skin: Option<&[Matrix]>,
    feature: u32,
    data: &Data,
    draft: &mut Draft,
    ledger: &mut Ledger,
) -> Result<()> {
    match part {
        Some(part) => part.draw(place, skin, feature, data, draft, ledger),
        None => {
            ledger.read += 1;
            ledger.filter_type("points and lines");
            Ok(())
        }
    }
}

/// Places of instances below their node.
fn instances(data: &Data, attributes: &Value) -> Result<Vec<Matrix>> {
    let index = |name: &str| attributes[name].as_u64().map(|i| i as usize);
    let moves = index("TRANSLATION").map(|i| data.rows::<3>(i, "translations", None)).transpose()?;
    let turns = index("ROTATION").map(|i| data.rows::<4>(i, "rotations", None)).transpose()?;
    let scales = index("SCALE").map(|i| data.rows::<3>(i, "scales", None)).transpose()?;
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
    let binds = skin.inverse_bind_matrices.map(|i| data.rows::<16>(i, "bind matrices", None)).transpose()?;
    let joint = |(i, &n): (usize, &usize)| {
        let place = places.get(n).copied().flatten();
        let place = place.ok_or_else(|| data.files.broken(format!("joint {n} is not in the scene")))?;
        let bind = binds.as_ref().and_then(|b| b.get(i)).map_or(ONE, of_columns);
        Ok(times(&place, &bind))
    };
    skin.joints.iter().enumerate().map(joint).collect()
}
