//! A primitive of a glTF mesh: its numbers, and its triangles where a node draws it.

use serde::Deserialize;
use serde_json::{Map, Value};

use super::accessor::Data;
use super::gltf::{Paint, Transform};
use super::obj::unit;
use super::scene::{Matrix, apply, cofactors};
use super::{Draft, MOST};
use crate::diag::Result;
use crate::io::ledger::Ledger;

#[derive(Deserialize, Default)]
#[serde(default)]
pub struct Primitive {
    attributes: Map<String, Value>,
    indices: Option<usize>,
    material: Option<usize>,
    mode: Option<u32>,
    extensions: Value,
}

impl Primitive {
    /// How many corners it draws, as far as one knows without reading them.
    pub fn corners(&self, data: &Data) -> u64 {
        let place = || self.attributes.get("POSITION")?.as_u64().map(|i| i as usize);
        let drawn = self.mode.is_none_or(|m| m > 3);
        self.indices.or_else(place).filter(|_| drawn).and_then(|i| data.count(i).ok()).unwrap_or(0)
    }
}

/// A primitive's numbers before they are placed.
pub struct Part {
    name: String,
    /// Where it is in the file.
    pub at: String,
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
pub fn part(p: &Primitive, data: &Data, paint: &mut Paint, draft: &mut Draft) -> Result<Option<Part>> {
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
    let n = data.count(place)?;
    let mut corners: Vec<u64> = match p.indices {
        Some(i) => data.values(i, None)?.1.into_iter().map(|v| if v >= 0.0 { v as u64 } else { u64::MAX }).collect(),
        None if n > MOST => return Err(files.broken(format!("accessor {place}: more than the {MOST} that are read"))),
        // Every vertex is one: they are numbered once they are known to be there.
        None => Vec::new(),
    };
    // Many parts may share a long list of vertices: of a long one only what is needed.
    let needed = (p.indices.is_some() && corners.len() as u64 * 4 < n).then(|| {
        let mut needed: Vec<u32> = corners.iter().filter(|&&c| c < n.min(MOST)).map(|&c| c as u32).collect();
        needed.sort_unstable();
        needed.dedup();
        let number = |c: u64| u32::try_from(c).ok().and_then(|c| needed.binary_search(&c).ok());
        corners.iter_mut().for_each(|c| *c = number(*c).map_or(u64::MAX, |i| i as u64));
        needed
    });
    let only = needed.as_deref();
    // Elements that there are not are another's mistake.
    let reach = |i: usize, what: &str| match data.count(i)? < n {
        true => Err(files.broken(format!("accessor {i}: {what} of {} vertices, but there are {n}", data.count(i)?))),
        false => Ok(i),
    };
    let positions = data.rows::<3>(place, "positions", only)?;
    if p.indices.is_none() {
        corners = (0..n).collect();
    }
    let painted = p.material.map(|m| paint.material(m, draft)).transpose()?;
    let uv_set = painted.as_ref().map_or(0, |m| m.uv_set);
    let textured = painted.as_ref().is_some_and(|m| draft.surface.materials[m.number as usize].texture.is_some());
    let uvs = attribute(&format!("TEXCOORD_{uv_set}")).filter(|_| textured);
    let mut bound = Vec::new();
    for k in 0..4 {
        if let (Some(j), Some(w)) = (attribute(&format!("JOINTS_{k}")), attribute(&format!("WEIGHTS_{k}"))) {
            let joints = data.rows::<4>(reach(j, "joints")?, "joints", only)?;
            bound.push((joints, data.rows::<4>(reach(w, "weights")?, "weights", only)?));
        }
    }
    let colours = attribute("COLOR_0").map(|i| data.values(reach(i, "colours")?, only)).transpose()?;
    let colours = colours.filter(|c| c.0 == 3 || c.0 == 4);
    let normals = attribute("NORMAL").map(|i| data.rows::<3>(reach(i, "normals")?, "normals", only)).transpose()?;
    let uvs = uvs.map(|i| data.rows::<2>(reach(i, "picture places")?, "picture places", only)).transpose()?;
    Ok(Some(Part {
        name: painted.as_ref().map_or("mesh".into(), |m| draft.surface.materials[m.number as usize].name.clone()),
        at: String::new(),
        normals,
        uvs,
        transform: painted.as_ref().map_or_else(Transform::default, |m| m.transform),
        colours,
        bound,
        corners,
        mode,
        material: painted.map(|m| m.number),
        positions,
    }))
}

impl Part {
    /// Vertices or corners, whichever it has more of.
    pub fn size(&self) -> u64 {
        self.positions.len().max(self.corners.len()) as u64
    }

    pub fn draw(
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
            draft.triangle(of, files, ledger, &|| format!("{}, triangle {t}", self.at));
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
