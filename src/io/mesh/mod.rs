//! Meshes as other programs write them: glTF and GLB, OBJ, PLY, STL. What a file is shows in its bytes, not its name.

mod accessor;
mod gltf;
mod meshopt;
mod mtl;
mod obj;
mod ply;
mod polygon;
mod primitive;
mod scene;
mod stl;
mod weld;
pub mod write;

use std::io::{BufRead, Read};

use super::ledger::Ledger;
use crate::artifact::Mesh;
use crate::artifact::mesh::{Material, Primitive, Surface};
use crate::diag::{Diagnostic, Note, Result};
use crate::geom::frame::Frame;

/// Which way is up in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Up {
    Y,
    Z,
}

/// A file in memory, unpacked, and those beside it by the names it gives them.
pub struct Files<'a> {
    pub name: &'a str,
    pub bytes: &'a [u8],
    pub beside: &'a dyn Fn(&str) -> Option<Result<Vec<u8>>>,
    /// Takes sentences for the user.
    pub warn: &'a dyn Fn(String),
}

impl Files<'_> {
    /// A file that this one names, or why it cannot be had.
    fn beside(&self, name: &str) -> Result<Vec<u8>, String> {
        if !is_below(name) {
            return Err("lies outside the file's folder: put it there and name it so".into());
        }
        match (self.beside)(name) {
            None => Err("is not there".into()),
            Some(Err(e)) => Err(e.message),
            Some(Ok(bytes)) => Ok(bytes),
        }
    }

    fn broken(&self, what: impl std::fmt::Display) -> Box<Diagnostic> {
        Diagnostic::error("bad-mesh", format!("`{}`: {what}", self.name))
    }

    /// A mistake that lies in this part of the file.
    fn within(&self, part: impl std::fmt::Display, mut mistake: Box<Diagnostic>) -> Box<Diagnostic> {
        let file = format!("`{}`: ", self.name);
        let at = if mistake.message.starts_with(&file) { file.len() } else { 0 };
        mistake.message.insert_str(at, &format!("{part}: "));
        mistake
    }

    fn warn(&self, what: impl std::fmt::Display) {
        (self.warn)(format!("`{}`: {what}", self.name));
    }
}

/// More triangles or vertices than that are a mistake, or a bomb: a file of some kilobytes can ask for 10^12.
pub const MOST: u64 = 1 << 26;

/// More triangles at one place are left out: whoever goes through them meets them all, everywhere.
pub const MOST_EQUAL: u32 = 16;

/// Corners further out are no places: what is computed of them is infinite soon.
const FARTHEST: f64 = 1e30;

/// Larger files are not read, packed or not: GLB cannot be larger either.
pub const MOST_BYTES: u64 = 1 << 32;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Gltf,
    Obj,
    Ply,
    Stl,
}

fn format(bytes: &[u8]) -> Option<Format> {
    if bytes.starts_with(b"glTF") {
        return Some(Format::Gltf);
    }
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
        return Some(Format::Ply);
    }
    if stl::is_binary(bytes) {
        return Some(Format::Stl);
    }
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let text = text.trim_ascii_start();
    if text.starts_with(b"{") {
        return Some(Format::Gltf);
    }
    let head = &text[..text.len().min(4096)];
    if head.contains(&0) {
        return None;
    }
    if text.len() >= 5 && text[..5].eq_ignore_ascii_case(b"solid") {
        return Some(Format::Stl);
    }
    obj::is_likely(head).then_some(Format::Obj)
}

/// Names of the files beside this one that reading it needs: of a material library its pictures.
pub fn beside(name: &str, read: &mut dyn BufRead) -> Vec<String> {
    let ends = |end: &str| name.len() >= end.len() && name[name.len() - end.len()..].eq_ignore_ascii_case(end);
    // What is unpacked comes in pieces, the first as short as two bytes.
    let mut head = Vec::new();
    if Read::take(&mut *read, 512).read_to_end(&mut head).is_err() {
        return Vec::new();
    }
    let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&head).trim_ascii_start();
    let read = &mut head.chain(read);
    let names = if ends(".mtl") {
        mtl::pictures(name, read)
    } else if head.starts_with(b"glTF") || text.starts_with(b"{") {
        gltf::beside(read)
    } else if head.starts_with(b"ply") {
        ply::pictures(read)
    } else if !stl::is_binary(&head) && !head.contains(&0) {
        obj::libraries(read)
    } else {
        Vec::new()
    };
    names.into_iter().filter(|n| is_below(n)).collect()
}

/// Whether a name is a place in a folder or below: what a file from elsewhere names must not take what is not its own.
fn is_below(name: &str) -> bool {
    let mut depth = 0i32;
    let stays = name.split(['/', '\\']).all(|part| {
        depth += match part {
            "" | "." => 0,
            ".." => -1,
            _ => 1,
        };
        depth >= 0
    });
    stays && !name.is_empty() && !name.starts_with(['/', '\\']) && !name.contains([':', '\0'])
}

/// A mesh in the making. Lists that only some parts of a source have are filled with what means none.
#[derive(Default)]
pub struct Draft {
    pub positions: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
    pub features: Vec<u32>,
    pub feature_ids: Vec<String>,
    pub primitives: Vec<Primitive>,
    pub surface: Surface,
}

impl Draft {
    /// Fills the gaps that vertices added since then left: no normal is 0, 0, 0, no colour is white.
    fn pad(&mut self) {
        let n = self.positions.len();
        let all = &mut self.surface;
        if !all.normals.is_empty() {
            all.normals.resize(n, [0.0; 3]);
        }
        if !all.uvs.is_empty() {
            all.uvs.resize(n, [0.0; 2]);
        }
        if !all.colours.is_empty() {
            all.colours.resize(n, [1.0; 4]);
        }
    }

    /// A new feature; its name is made its own by a number.
    fn feature(&mut self, name: &str) -> u32 {
        self.feature_ids.push(name.to_string());
        self.feature_ids.len() as u32 - 1
    }

    /// Adds a triangle, or says why not: `vertices` is how many there are, `place` where it stands.
    fn triangle(&mut self, corners: [u64; 3], files: &Files, ledger: &mut Ledger, place: &dyn Fn() -> String) {
        let n = self.positions.len() as u64;
        let cause = if corners.iter().any(|&c| c >= n) {
            "an index beyond the vertices"
        } else if corners.iter().any(|&c| self.positions[c as usize].iter().any(|v| !v.is_finite())) {
            "a corner that is no finite number"
        } else if corners.iter().any(|&c| self.positions[c as usize].iter().any(|v| v.abs() > FARTHEST)) {
            "a corner beyond 10^30"
        } else {
            ledger.read += 1;
            return self.triangles.push(corners.map(|c| c as u32));
        };
        reject(ledger, files, cause, place);
    }

    /// Closes a run of triangles that began at `first`.
    fn primitive(&mut self, name: &str, first: usize, material: Option<u32>) {
        let count = self.triangles.len() - first;
        if count == 0 {
            return;
        }
        if let Some(last) = self.primitives.last_mut()
            && last.name == name
            && last.material == material
        {
            last.triangles += count as u32;
            return;
        }
        let (first_triangle, triangles) = (first as u32, count as u32);
        self.primitives.push(Primitive { name: name.to_string(), first_triangle, triangles, material });
    }

    fn material(&mut self, material: Material) -> u32 {
        self.surface.materials.push(material);
        self.surface.materials.len() as u32 - 1
    }

    /// Leaves out triangles that are there [`MOST_EQUAL`] times already, to the last bit of their corners' places, colours
    /// and places in pictures.
    fn drop_repeats(&mut self, ledger: &mut Ledger) {
        self.pad();
        let all = &self.surface;
        let key = |i: usize| {
            let uv = all.uvs.get(i).map_or([0; 2], |v| v.map(f32::to_bits));
            let colour = all.colours.get(i).map_or([0; 4], |v| v.map(f32::to_bits));
            (self.positions[i].map(f64::to_bits), uv, colour)
        };
        let keys: Vec<_> = (0..self.positions.len()).map(key).collect();
        let (number, _) = weld::weld(&keys);
        let corners: Vec<[u32; 3]> = self.triangles.iter().map(|t| t.map(|v| number[v as usize])).collect();
        let mut materials = vec![u32::MAX; corners.len()];
        for p in &self.primitives {
            let first = p.first_triangle as usize;
            materials[first..first + p.triangles as usize].fill(p.material.unwrap_or(u32::MAX));
        }
        let again = weld::repeated(&corners, |t| materials[t], MOST_EQUAL);
        if !again.contains(&true) {
            return;
        }
        let mut next = 0;
        for p in &mut self.primitives {
            let range = p.first_triangle as usize..(p.first_triangle + p.triangles) as usize;
            let left = again[range].iter().filter(|a| !**a).count() as u32;
            (p.first_triangle, p.triangles, next) = (next, left, next + left);
        }
        self.primitives.retain(|p| p.triangles > 0);
        let mut t = 0;
        self.triangles.retain(|_| (!again[t], t += 1).0);
        again.iter().filter(|a| **a).for_each(|_| ledger.filter_type("triangles that are there 16 times already"));
    }

    /// The mesh: z up, features of equal names numbered, vertices that no triangle has left out.
    fn finish(mut self, up: Up) -> Mesh {
        self.pad();
        let mut seen = std::collections::BTreeMap::<String, u32>::new();
        let mut taken: std::collections::BTreeSet<String> = self.feature_ids.iter().cloned().collect();
        for id in &mut self.feature_ids {
            let count = seen.entry(id.clone()).or_default();
            *count += 1;
            if *count > 1 {
                let mut new = format!("{id}#{count}");
                while !taken.insert(new.clone()) {
                    *count += 1;
                    new = format!("{id}#{count}");
                }
                *id = new;
            }
        }
        let mut used = vec![false; self.positions.len()];
        self.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        if used.iter().any(|u| !u) {
            let mut next = 0;
            let mut number = vec![0u32; used.len()];
            for (i, &u) in used.iter().enumerate() {
                number[i] = next;
                next += u32::from(u);
            }
            fn keep<T: Copy>(all: &mut Vec<T>, used: &[bool]) {
                let mut i = 0;
                all.retain(|_| (used[i], i += 1).0);
            }
            keep(&mut self.positions, &used);
            keep(&mut self.features, &used);
            keep(&mut self.surface.normals, &used);
            keep(&mut self.surface.uvs, &used);
            keep(&mut self.surface.colours, &used);
            self.triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
        }
        if up == Up::Y {
            // -0 is 0.
            self.positions.iter_mut().for_each(|p| *p = [p[0], 0.0 - p[2], p[1]]);
            self.surface.normals.iter_mut().for_each(|p| *p = [p[0], 0.0 - p[2], p[1]]);
        }
        Mesh {
            frame: Frame::local(),
            positions: self.positions,
            triangles: self.triangles,
            features: self.features,
            primitives: self.primitives,
            feature_ids: self.feature_ids.into_iter().collect(),
            attributes: Default::default(),
            surface: self.surface,
        }
    }
}

/// More rejected triangles are counted, but not listed.
pub const MOST_LISTED: u64 = 10_000;

/// Leaves out a triangle that was read.
fn reject(ledger: &mut Ledger, files: &Files, cause: &str, place: &dyn Fn() -> String) {
    let row = ledger.read;
    ledger.read += 1;
    if ledger.rejected() >= MOST_LISTED {
        return ledger.reject_unlisted(cause);
    }
    let place = format!("{}:{}", files.name, place());
    ledger.reject(Note { row, id: format!("triangle {row}"), place, cause: cause.to_string() });
}

/// Reads a mesh; `up` says which way is up where the format does not.
pub fn read(files: &Files, up: Option<Up>, ledger: &mut Ledger) -> Result<Mesh> {
    let mut draft = Draft::default();
    let own = match format(files.bytes) {
        Some(Format::Gltf) => {
            gltf::read(files, &mut draft, ledger)?;
            draft.drop_repeats(ledger);
            if up == Some(Up::Z) {
                files.warn("`up` is not heeded: glTF is always y up");
            }
            return Ok(draft.finish(Up::Y));
        }
        Some(Format::Obj) => obj::read(files, &mut draft, ledger).map(|()| Up::Y)?,
        Some(Format::Ply) => ply::read(files, &mut draft, ledger).map(|()| Up::Z)?,
        Some(Format::Stl) => stl::read(files, &mut draft, ledger).map(|()| Up::Z)?,
        None if files.bytes.is_empty() => return Err(files.broken("the file is empty")),
        None if stl::is_named(files) => return Err(stl::wrong_count(files)),
        None => {
            let known = "known are glTF, GLB, OBJ, PLY and STL";
            return Err(files.broken("this is no mesh, or it ends early").help(known));
        }
    };
    draft.drop_repeats(ledger);
    Ok(draft.finish(up.unwrap_or(own)))
}

/// A byte of a picture's colour in linear light (sRGB).
fn linear(v: f64) -> f32 {
    let v = v.clamp(0.0, 1.0);
    (if v <= 0.04045 { v / 12.92 } else { libm::pow((v + 0.055) / 1.055, 2.4) }) as f32
}

/// What an image's first bytes say it is; an error names the remedy for those that are not read.
fn image_type(bytes: &[u8]) -> Result<&'static str, String> {
    if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Ok("image/png");
    }
    if bytes.starts_with(b"\xff\xd8\xff") {
        return Ok("image/jpeg");
    }
    if bytes.len() >= 12 && &bytes[..4] == b"RIFF" && &bytes[8..12] == b"WEBP" {
        return Ok("image/webp");
    }
    let name = if bytes.starts_with(b"\xabKTX 20\xbb") {
        "KTX2"
    } else if bytes.starts_with(b"BM") {
        "BMP"
    } else if bytes.starts_with(b"DDS ") {
        "DDS"
    } else if bytes.starts_with(b"II*\0") || bytes.starts_with(b"MM\0*") {
        "TIFF"
    } else {
        return Err("is no picture that is known: PNG, JPEG and WebP are read".into());
    };
    Err(format!("is {name}: convert it to PNG, JPEG or WebP"))
}
