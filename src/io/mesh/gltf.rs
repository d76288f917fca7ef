//! glTF 2.0 and GLB: what is drawn of the default scene, in its rest pose.
//!
//! A feature is a node with a mesh (or an instance of it). Base colours only: a specular-glossiness material gives its
//! diffuse colour. Source: glTF 2.0; KHR_texture_transform, KHR_mesh_quantization, KHR_materials_pbrSpecularGlossiness,
//! EXT_texture_webp, EXT_mesh_gpu_instancing, EXT_meshopt_compression and KHR_meshopt_compression. Geometry packed by Draco
//! and KTX2 pictures are errors that name a remedy.

use std::cell::{Cell, OnceCell};
use std::io::{BufRead, Read};

use serde::Deserialize;
use serde_json::Value;

use super::accessor::{Accessor, Buffer, Data, View, fetch, file_name};
use super::scene::{self, Mesh, Node, Skin};
use super::{Draft, Files, image_type, meshopt};
use crate::artifact::mesh::{Alpha, Material, Texture, Wrap};
use crate::diag::Result;
use crate::io::ledger::Ledger;

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
pub struct Root {
    asset: Asset,
    extensions_required: Vec<String>,
    pub scene: Option<usize>,
    pub scenes: Vec<Scene>,
    pub nodes: Vec<Node>,
    pub meshes: Vec<Mesh>,
    pub skins: Vec<Skin>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<View>,
    buffers: Vec<Buffer>,
    materials: Vec<Look>,
    textures: Vec<Map>,
    images: Vec<Image>,
    samplers: Vec<Sampler>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Asset {
    version: String,
}

#[derive(Deserialize, Default)]
#[serde(default)]
pub struct Scene {
    pub nodes: Vec<usize>,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
struct Look {
    name: String,
    pbr_metallic_roughness: Pbr,
    alpha_mode: String,
    alpha_cutoff: Option<f32>,
    double_sided: bool,
    extensions: Value,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
struct Pbr {
    base_color_factor: Option<[f32; 4]>,
    base_color_texture: Option<TextureUse>,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
struct SpecularGlossiness {
    diffuse_factor: Option<[f32; 4]>,
    diffuse_texture: Option<TextureUse>,
}

#[derive(Deserialize, Default, Clone)]
#[serde(default, rename_all = "camelCase")]
struct TextureUse {
    index: usize,
    tex_coord: usize,
    extensions: Value,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct Map {
    sampler: Option<usize>,
    source: Option<usize>,
    extensions: Value,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
struct Image {
    uri: Option<String>,
    buffer_view: Option<usize>,
    mime_type: String,
}

#[derive(Deserialize, Default)]
#[serde(default, rename_all = "camelCase")]
struct Sampler {
    mag_filter: u32,
    wrap_s: u32,
    wrap_t: u32,
}

/// A material in the draft, and where its picture lies on a vertex.
#[derive(Clone)]
pub struct Painted {
    pub number: u32,
    pub uv_set: usize,
    pub transform: Transform,
}

/// KHR_texture_transform.
#[derive(Clone, Copy, Deserialize)]
#[serde(default)]
pub struct Transform {
    offset: [f64; 2],
    rotation: f64,
    scale: [f64; 2],
}

impl Default for Transform {
    fn default() -> Self {
        Self { offset: [0.0; 2], rotation: 0.0, scale: [1.0; 2] }
    }
}

impl Transform {
    /// Scaled, turned counter-clockwise as one sees it (v is down), moved.
    pub fn of(&self, [u, v]: [f64; 2]) -> [f32; 2] {
        let (u, v) = (u * self.scale[0], v * self.scale[1]);
        let (s, c) = libm::sincos(self.rotation);
        [(c * u + s * v + self.offset[0]) as f32, (c * v - s * u + self.offset[1]) as f32]
    }
}

const SPECULAR: &str = "KHR_materials_pbrSpecularGlossiness";

impl Look {
    /// Factor and texture of the base colour.
    fn base(&self) -> ([f32; 4], Option<TextureUse>) {
        let pbr = &self.pbr_metallic_roughness;
        if pbr.base_color_texture.is_none()
            && let Some(value) = self.extensions.get(SPECULAR)
            && let Ok(s) = serde_json::from_value::<SpecularGlossiness>(value.clone())
        {
            return (s.diffuse_factor.unwrap_or([1.0; 4]), s.diffuse_texture);
        }
        (pbr.base_color_factor.unwrap_or([1.0; 4]), pbr.base_color_texture.clone())
    }
}

impl Map {
    /// The image that is read: WebP where there is one, else the plain one.
    fn image(&self) -> Option<usize> {
        let webp = self.extensions["EXT_texture_webp"]["source"].as_u64().map(|i| i as usize);
        webp.or(self.source)
    }
}

/// Files that buffers and base colours lie in.
pub fn beside(read: &mut dyn BufRead) -> Vec<String> {
    let mut head = Vec::new();
    if Read::take(&mut *read, 20).read_to_end(&mut head).is_err() {
        return Vec::new();
    }
    let json = match head.starts_with(b"glTF") && head.len() == 20 {
        true => {
            let length = u32::from_le_bytes([head[12], head[13], head[14], head[15]]);
            head.clear();
            Read::take(&mut *read, u64::from(length)).read_to_end(&mut head)
        }
        false => Read::take(&mut *read, 1 << 28).read_to_end(&mut head),
    };
    let Ok(root) = json.map_err(|_| ()).and_then(|_| serde_json::from_slice::<Root>(trim(&head)).map_err(|_| ()))
    else {
        return Vec::new();
    };
    let pictures = root.materials.iter().filter_map(|m| {
        let map = root.textures.get(m.base().1?.index)?;
        root.images.get(map.image()?)?.uri.as_ref()
    });
    let all = root.buffers.iter().filter_map(|b| b.uri.as_ref()).chain(pictures);
    let mut out: Vec<String> = Vec::new();
    for uri in all.filter(|u| !u.starts_with("data:")) {
        let name = file_name(uri);
        if !out.contains(&name) {
            out.push(name);
        }
    }
    out
}

fn trim(json: &[u8]) -> &[u8] {
    json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json)
}

/// The text of a file and its binary chunk.
fn chunks<'a>(files: &Files<'a>) -> Result<(&'a [u8], Option<&'a [u8]>)> {
    let bytes = files.bytes;
    if !bytes.starts_with(b"glTF") {
        return Ok((trim(bytes), None));
    }
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let early = || files.broken("the file ends early").help("it was cut off; fetch it again");
    let (version, length) = (word(4).ok_or_else(early)?, word(8).ok_or_else(early)?);
    if version != 2 {
        return Err(files.broken(format!("GLB of version {version}, only 2 is read")));
    }
    if length as usize > bytes.len() {
        return Err(early());
    }
    let bytes = &bytes[..length as usize];
    let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let (mut at, mut text, mut chunk) = (12, None, None);
    while at < bytes.len() {
        let (size, kind) = (word(at).ok_or_else(early)? as usize, word(at + 4).ok_or_else(early)?);
        let body = bytes.get(at + 8..).and_then(|b| b.get(..size)).ok_or_else(early)?;
        match kind {
            0x4e4f_534a if text.is_none() => text = Some(body),
            0x004e_4942 if chunk.is_none() => chunk = Some(body),
            _ => {}
        }
        at += 8 + size;
    }
    Ok((text.ok_or_else(|| files.broken("a GLB without its text"))?, chunk))
}

/// Extensions that may be required: they are read, or change nothing that is kept.
fn is_harmless(name: &str) -> bool {
    const KNOWN: &[&str] = &[
        "KHR_texture_transform",
        "KHR_mesh_quantization",
        "KHR_lights_punctual",
        "KHR_animation_pointer",
        "EXT_texture_webp",
        "EXT_mesh_gpu_instancing",
        "EXT_mesh_features",
        "EXT_structural_metadata",
    ];
    KNOWN.contains(&name) || name.starts_with("KHR_materials_") || meshopt::is_known(name)
}

/// These are named where they are met: a file may have a plain copy beside.
fn is_told_later(name: &str) -> bool {
    name == "KHR_draco_mesh_compression" || name == "KHR_texture_basisu"
}

pub fn read(files: &Files, draft: &mut Draft, ledger: &mut Ledger) -> Result<()> {
    let (text, chunk) = chunks(files)?;
    let root: Root = serde_json::from_slice(text).map_err(|e| files.broken(format!("this is no glTF: {e}")))?;
    if !root.asset.version.starts_with("2.") {
        return Err(files.broken(format!("glTF of version `{}`, only 2 is read", root.asset.version.escape_debug())));
    }
    if let Some(name) = root.extensions_required.iter().find(|n| !is_harmless(n) && !is_told_later(n)) {
        let help = "write it again without that extension";
        return Err(files.broken(format!("it requires `{}`, which is not read", name.escape_debug())).help(help));
    }
    let data = Data {
        files,
        accessors: &root.accessors,
        views: &root.buffer_views,
        buffers: &root.buffers,
        chunk,
        read: root.buffers.iter().map(|_| OnceCell::new()).collect(),
        unpacked: root.buffer_views.iter().map(|_| OnceCell::new()).collect(),
        unpacked_bytes: Cell::new(0),
        wasted: Cell::new(0),
    };
    let mut paint = Paint { root: &root, data: &data, known: vec![None; root.materials.len()], images: Vec::new() };
    scene::read(&root, &data, &mut paint, draft, ledger)
}

/// Materials that were met.
pub struct Paint<'a> {
    root: &'a Root,
    data: &'a Data<'a>,
    known: Vec<Option<Painted>>,
    /// Of images of the file those of the draft; none where one cannot be had.
    images: Vec<(usize, Option<u32>)>,
}

impl Paint<'_> {
    pub fn material(&mut self, i: usize, draft: &mut Draft) -> Result<Painted> {
        let files = self.data.files;
        let look = self.root.materials.get(i).ok_or_else(|| files.broken(format!("there is no material {i}")))?;
        if let Some(known) = &self.known[i] {
            return Ok(known.clone());
        }
        let (base_colour, map) = look.base();
        let mut out = Painted { number: 0, uv_set: 0, transform: Transform::default() };
        let mut texture = None;
        if let Some(map) = map {
            let transform = &map.extensions["KHR_texture_transform"];
            out.uv_set = transform["texCoord"].as_u64().map_or(map.tex_coord, |i| i as usize);
            out.transform = serde_json::from_value(transform.clone()).unwrap_or_default();
            texture = self.texture(map.index, draft)?;
        }
        let name = if look.name.is_empty() { format!("material-{i}") } else { look.name.clone() };
        let alpha = match &*look.alpha_mode {
            "MASK" => Alpha::Mask(look.alpha_cutoff.unwrap_or(0.5)),
            "BLEND" => Alpha::Blend,
            _ => Alpha::Opaque,
        };
        out.number = draft.material(Material { name, base_colour, texture, alpha, double_sided: look.double_sided });
        self.known[i] = Some(out.clone());
        Ok(out)
    }

    fn texture(&mut self, i: usize, draft: &mut Draft) -> Result<Option<Texture>> {
        let files = self.data.files;
        let map = self.root.textures.get(i).ok_or_else(|| files.broken(format!("there is no texture {i}")))?;
        let Some(image) = map.image() else {
            if map.extensions.get("KHR_texture_basisu").is_some() {
                let help = "write it again with PNG, JPEG or WebP pictures";
                return Err(files.broken("its pictures are KTX2 (KHR_texture_basisu), which is not read").help(help));
            }
            if let Some(name) = map.extensions.as_object().and_then(|all| all.keys().next()) {
                let name = name.escape_debug();
                files.warn(format!("texture {i} is only told by `{name}`, which is not read; what it covers is plain"));
            }
            return Ok(None);
        };
        let Some(image) = self.image(image, draft)? else { return Ok(None) };
        let none = Sampler::default();
        let sampler = map.sampler.and_then(|s| self.root.samplers.get(s)).unwrap_or(&none);
        let wrap = |w: u32| match w {
            33071 => Wrap::Clamp,
            33648 => Wrap::Mirror,
            _ => Wrap::Repeat,
        };
        let wrap = [wrap(sampler.wrap_s), wrap(sampler.wrap_t)];
        Ok(Some(Texture { image, wrap, nearest: sampler.mag_filter == 9728 }))
    }

    fn image(&mut self, i: usize, draft: &mut Draft) -> Result<Option<u32>> {
        if let Some((_, known)) = self.images.iter().find(|(n, _)| *n == i) {
            return Ok(*known);
        }
        let files = self.data.files;
        let image = self.root.images.get(i).ok_or_else(|| files.broken(format!("there is no image {i}")))?;
        let fetched;
        let bytes: &[u8] = match (&image.uri, image.buffer_view) {
            (_, Some(view)) => self.data.view(view)?,
            (Some(uri), None) => {
                fetched = fetch(files, uri);
                match &fetched {
                    Ok(bytes) => bytes,
                    Err(e) => {
                        files.warn(format!("image {i}: {}; what it covers has its material's colour", e.message));
                        self.images.push((i, None));
                        return Ok(None);
                    }
                }
            }
            (None, None) => return Err(files.broken(format!("image {i} ({}) has no data", image.mime_type))),
        };
        let kind = image_type(bytes).map_err(|why| files.broken(format!("image {i} {why}")))?;
        draft.surface.images.push(kind, bytes);
        let number = draft.surface.images.len() as u32 - 1;
        self.images.push((i, Some(number)));
        Ok(Some(number))
    }
}
