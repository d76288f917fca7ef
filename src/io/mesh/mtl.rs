//! Material libraries of OBJ: base colours, pictures, what shines through.

use std::collections::BTreeMap;
use std::io::{BufRead, Read};

use super::{Draft, Files, image_type, linear};
use crate::artifact::mesh::{Alpha, Material, Texture, Wrap};

/// Pictures of a material library, relative to the folder that `library` is relative to.
pub fn pictures(library: &str, read: &mut dyn BufRead) -> Vec<String> {
    let mut text = Vec::new();
    if Read::take(&mut *read, 1 << 24).read_to_end(&mut text).is_err() {
        return Vec::new();
    }
    let mut out: Vec<String> = Vec::new();
    for material in parse(&String::from_utf8_lossy(&text)).values() {
        if let Some(map) = &material.map {
            out.push(join(library, &map.name));
        }
    }
    out
}

/// As all but one system write it.
pub fn forward(name: &str) -> String {
    name.replace('\\', "/")
}

fn join(library: &str, name: &str) -> String {
    library.rsplit_once('/').map_or(name.to_string(), |(folder, _)| format!("{folder}/{name}"))
}

/// A material as its library has it.
#[derive(Clone, Default)]
struct Mtl {
    kd: Option<[f64; 3]>,
    /// 1 is opaque.
    d: Option<f64>,
    map: Option<Map>,
    /// The picture of `map_d`.
    alpha: Option<String>,
}

#[derive(Clone, Default)]
struct Map {
    name: String,
    clamp: bool,
    /// Options that are not heeded.
    other: bool,
}

fn parse(text: &str) -> BTreeMap<String, Mtl> {
    let mut out = BTreeMap::<String, Mtl>::new();
    let mut name: Option<String> = None;
    for line in text.lines() {
        let line = line.trim();
        let (word, rest) = line.split_once([' ', '\t']).unwrap_or((line, ""));
        let rest = rest.trim();
        if word == "newmtl" {
            // Of equal names the first counts.
            name = (!out.contains_key(rest)).then(|| rest.to_string());
            if let Some(name) = &name {
                out.insert(name.clone(), Mtl::default());
            }
            continue;
        }
        let Some(m) = name.as_ref().and_then(|n| out.get_mut(n)) else { continue };
        let number = |word: Option<&str>| word.and_then(|w| w.parse::<f64>().ok()).filter(|v| v.is_finite());
        let mut words = rest.split_ascii_whitespace();
        match word {
            "Kd" => {
                // One number is a grey.
                if let Some(r) = number(words.next()) {
                    let mut next = || number(words.next()).unwrap_or(r);
                    m.kd = Some([r, next(), next()]);
                }
            }
            "d" => {
                m.d = number(words.next().filter(|w| *w != "-halo").or_else(|| rest.split_ascii_whitespace().last()))
            }
            "Tr" => m.d = m.d.or(number(words.next()).map(|t| 1.0 - t)),
            "map_Kd" => m.map = Some(map(rest)),
            "map_d" => m.alpha = Some(map(rest).name),
            _ => {}
        }
    }
    out
}

/// Options, then a name that may have spaces.
fn map(rest: &str) -> Map {
    let mut out = Map::default();
    let mut rest = rest.trim();
    while rest.starts_with('-') {
        let (option, after) = rest.split_once([' ', '\t']).unwrap_or((rest, ""));
        rest = after.trim_start();
        let values = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        out.clamp |= option == "-clamp" && rest.starts_with("on");
        out.other |= values == 3;
        for n in 0..values {
            let (value, after) = rest.split_once([' ', '\t']).unwrap_or((rest, ""));
            if n > 0 && value.parse::<f64>().is_err() {
                break;
            }
            rest = after.trim_start();
        }
    }
    out.name = forward(rest);
    out
}

/// Materials and pictures that were asked for.
#[derive(Default)]
pub struct Looks {
    known: BTreeMap<String, Mtl>,
    /// Of each known one the library.
    from: BTreeMap<String, String>,
    pub names: Vec<String>,
    numbers: BTreeMap<String, u32>,
    /// Pictures by their names; none where one is missing.
    images: BTreeMap<String, Option<u32>>,
    /// A library is missing: that its materials are not known is told already.
    missing: bool,
}

impl Looks {
    pub fn library(&mut self, name: &str, files: &Files) {
        match files.beside(name) {
            Ok(bytes) => {
                for (material, mtl) in parse(&String::from_utf8_lossy(&bytes)) {
                    if !self.known.contains_key(&material) {
                        self.from.insert(material.clone(), name.to_string());
                        self.known.insert(material, mtl);
                    }
                }
            }
            Err(why) => {
                self.missing = true;
                files.warn(format!("`{name}` {why}: what it paints is white"));
            }
        }
    }

    pub fn material(&mut self, name: &str, files: &Files, draft: &mut Draft) -> u32 {
        if let Some(&i) = self.numbers.get(name) {
            return i;
        }
        let mut out = Material { name: name.to_string(), double_sided: true, ..Material::default() };
        match self.known.get(name).cloned() {
            None if self.missing => {}
            None => files.warn(format!("no library has the material `{name}`: what it paints is white")),
            Some(mtl) => {
                let library = self.from[name].clone();
                let map = mtl.map.as_ref().filter(|m| !m.name.is_empty());
                let d = mtl.d.unwrap_or(1.0).clamp(0.0, 1.0) as f32;
                // A picture takes the colour's place, unless that is more than black.
                let kd = mtl.kd.unwrap_or([1.0; 3]);
                let kd = if map.is_some() && kd == [0.0; 3] { [1.0; 3] } else { kd };
                let [r, g, b] = kd.map(linear);
                out.base_colour = [r, g, b, d];
                out.alpha = if d < 1.0 { Alpha::Blend } else { Alpha::Opaque };
                if let Some(map) = map {
                    if map.other {
                        files.warn(format!("material `{name}`: -o, -s and -t of its picture are not heeded"));
                    }
                    let image = self.image(&join(&library, &map.name), files, draft);
                    let wrap = if map.clamp { Wrap::Clamp } else { Wrap::Repeat };
                    out.texture = image.map(|image| Texture { image, wrap: [wrap; 2], nearest: false });
                }
                match mtl.alpha {
                    Some(alpha) if map.is_some_and(|m| m.name == alpha) => out.alpha = Alpha::Mask(0.5),
                    Some(_) => files.warn(format!("material `{name}`: its `map_d` is not heeded")),
                    None => {}
                }
            }
        }
        self.names.push(name.to_string());
        let number = draft.material(out);
        self.numbers.insert(name.to_string(), number);
        number
    }

    fn image(&mut self, name: &str, files: &Files, draft: &mut Draft) -> Option<u32> {
        if let Some(&known) = self.images.get(name) {
            return known;
        }
        let image = picture(name, files, draft);
        self.images.insert(name.to_string(), image);
        image
    }
}

/// Takes a picture beside the file; a sentence where that cannot be.
pub fn picture(name: &str, files: &Files, draft: &mut Draft) -> Option<u32> {
    let why = match files.beside(name) {
        Err(why) => why,
        Ok(bytes) => match image_type(&bytes) {
            Ok(kind) => {
                draft.surface.images.push(kind, &bytes);
                return Some(draft.surface.images.len() as u32 - 1);
            }
            Err(why) => why,
        },
    };
    files.warn(format!("the picture `{name}` {why}; what it covers has its material's colour"));
    None
}
