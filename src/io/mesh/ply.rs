//! PLY, as text or binary in either order: vertices with normals, colours, picture places; polygons and strips.
//!
//! Colours are those of a screen. A picture is the `TextureFile` of a comment, as MeshLab writes it. Other elements and
//! properties are skipped.

use std::io::{BufRead, Read};

use super::mtl::picture;
use super::obj::unit;
use super::polygon::Faces;
use super::{Draft, Files, MOST, linear};
use crate::artifact::mesh::{Material, Texture, Wrap};
use crate::diag::Result;
use crate::io::ledger::Ledger;

#[derive(Clone, Copy, PartialEq)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }
    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
    /// The largest value of a colour.
    fn most(self) -> f64 {
        match self {
            Self::I8 => 127.0,
            Self::U8 => 255.0,
            Self::I16 => 32767.0,
            Self::U16 => 65535.0,
            Self::I32 | Self::U32 | Self::F32 | Self::F64 => 1.0,
        }
    }
}

struct Property {
    name: String,
    /// Of a list its length's type.
    list: Option<Type>,
    kind: Type,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

#[derive(Clone, Copy, PartialEq)]
enum Order {
    Text,
    Little,
    Big,
}

struct Header {
    order: Order,
    elements: Vec<Element>,
    pictures: Vec<String>,
    /// Bytes up to the body.
    length: usize,
}

/// Pictures that the header names.
pub fn pictures(read: &mut dyn BufRead) -> Vec<String> {
    let mut head = Vec::new();
    while head.len() < 1 << 20 && matches!(Read::take(&mut *read, 1 << 16).read_until(b'\n', &mut head), Ok(n) if n > 0)
    {
        if head.ends_with(b"end_header\n") || head.ends_with(b"end_header\r\n") {
            break;
        }
    }
    String::from_utf8_lossy(&head).lines().filter_map(texture_file).collect()
}

fn texture_file(line: &str) -> Option<String> {
    let rest = line.trim().strip_prefix("comment")?.trim_start().strip_prefix("TextureFile")?;
    Some(rest.trim().replace('\\', "/"))
}

fn header(files: &Files) -> Result<Header> {
    let mut out = Header { order: Order::Text, elements: Vec::new(), pictures: Vec::new(), length: 0 };
    let mut order = None;
    let mut number = 0;
    loop {
        let rest = &files.bytes[out.length..];
        // Old files end lines with a carriage return alone.
        let Some(end) = rest.iter().position(|&b| b == b'\n' || b == b'\r') else {
            return Err(files.broken("the header has no `end_header`"));
        };
        let both = rest[end] == b'\r' && rest.get(end + 1) == Some(&b'\n');
        out.length += end + 1 + usize::from(both);
        number += 1;
        let line = String::from_utf8_lossy(&rest[..end]);
        let wrong = |what: &str| files.broken(format!("line {number}: {what}"));
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["end_header"] => break,
            ["format", kind, _] => {
                order = Some(match kind {
                    "ascii" => Order::Text,
                    "binary_little_endian" => Order::Little,
                    "binary_big_endian" => Order::Big,
                    _ => return Err(wrong(&format!("`{kind}` is no format of PLY"))),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| wrong(&format!("`{count}` is no count")))?;
                out.elements.push(Element { name: name.into(), count, properties: Vec::new() });
            }
            ["property", ref rest @ ..] => {
                let of = |word: &str| Type::of(word).ok_or_else(|| wrong(&format!("`{word}` is no type of PLY")));
                let property = match *rest {
                    ["list", length, kind, name] => {
                        Property { name: name.into(), list: Some(of(length)?), kind: of(kind)? }
                    }
                    [kind, name] => Property { name: name.into(), list: None, kind: of(kind)? },
                    _ => return Err(wrong("a property needs a type and a name")),
                };
                out.elements.last_mut().ok_or_else(|| wrong("a property of no element"))?.properties.push(property);
            }
            _ => out.pictures.extend(texture_file(&line)),
        }
    }
    out.order = order.ok_or_else(|| files.broken("the header names no format"))?;
    Ok(out)
}

/// The body, value by value.
struct Body<'a> {
    order: Order,
    rest: &'a [u8],
    files: &'a Files<'a>,
    element: String,
    row: u64,
}

impl Body<'_> {
    fn value(&mut self, kind: Type) -> Result<f64> {
        if self.order == Order::Text {
            let from = self.rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or_else(|| self.early())?;
            let rest = &self.rest[from..];
            let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
            self.rest = &rest[end..];
            let word = std::str::from_utf8(&rest[..end]).ok();
            return word.and_then(|w| w.parse().ok()).ok_or_else(|| {
                let word = String::from_utf8_lossy(&rest[..end.min(20)]).into_owned();
                self.files.broken(format!(
                    "row {} of `{}`: `{}` is no number",
                    self.row,
                    self.element,
                    word.escape_debug()
                ))
            });
        }
        let (own, rest) = self.rest.split_at_checked(kind.bytes()).ok_or_else(|| self.early())?;
        self.rest = rest;
        let mut b = [0; 8];
        b[..own.len()].copy_from_slice(own);
        if self.order == Order::Big {
            b[..own.len()].reverse();
        }
        let [b0, b1, b2, b3, ..] = b;
        let four = [b0, b1, b2, b3];
        Ok(match kind {
            Type::I8 => f64::from(b0 as i8),
            Type::U8 => f64::from(b0),
            Type::I16 => f64::from(i16::from_le_bytes([b0, b1])),
            Type::U16 => f64::from(u16::from_le_bytes([b0, b1])),
            Type::I32 => f64::from(i32::from_le_bytes(four)),
            Type::U32 => f64::from(u32::from_le_bytes(four)),
            Type::F32 => f64::from(f32::from_le_bytes(four)),
            Type::F64 => f64::from_le_bytes(b),
        })
    }

    /// A list's length, not more than there is.
    fn length(&mut self, kind: Type) -> Result<usize> {
        let n = self.value(kind)?;
        if !(n >= 0.0 && n <= self.rest.len() as f64) {
            return Err(self.files.broken(format!("row {} of `{}`: a list of {n}", self.row, self.element)));
        }
        Ok(n as usize)
    }

    fn skip(&mut self, property: &Property) -> Result<()> {
        let n = if let Some(list) = property.list { self.length(list)? } else { 1 };
        (0..n).try_for_each(|_| self.value(property.kind).map(|_| ()))
    }

    fn early(&self) -> Box<crate::diag::Diagnostic> {
        let message = format!("the file ends in row {} of `{}`", self.row, self.element);
        self.files.broken(message).help("the file was cut off; fetch it again")
    }
}

/// What a vertex's property is.
#[derive(Clone, Copy)]
enum Role {
    Place(usize),
    Normal(usize),
    Colour(usize, f64),
    At(usize),
    None,
}

fn role(p: &Property) -> Role {
    if p.list.is_some() {
        return Role::None;
    }
    match p.name.as_str() {
        "x" => Role::Place(0),
        "y" => Role::Place(1),
        "z" => Role::Place(2),
        "nx" => Role::Normal(0),
        "ny" => Role::Normal(1),
        "nz" => Role::Normal(2),
        "red" | "r" | "diffuse_red" => Role::Colour(0, p.kind.most()),
        "green" | "g" | "diffuse_green" => Role::Colour(1, p.kind.most()),
        "blue" | "b" | "diffuse_blue" => Role::Colour(2, p.kind.most()),
        "alpha" | "a" | "diffuse_alpha" => Role::Colour(3, p.kind.most()),
        "s" | "u" | "texture_u" | "s0" | "u0" => Role::At(0),
        "t" | "v" | "texture_v" | "t0" | "v0" => Role::At(1),
        _ => Role::None,
    }
}

/// Corners of faces and strips, one after the other.
#[derive(Default)]
struct Lists {
    values: Vec<f64>,
    /// Row, whether it is a strip, where its corners end.
    ends: Vec<(u64, bool, usize)>,
}

pub fn read(files: &Files, draft: &mut Draft, ledger: &mut Ledger) -> Result<()> {
    let header = header(files)?;
    let rest = &files.bytes[header.length..];
    let mut body = Body { order: header.order, rest, files, element: String::new(), row: 0 };
    draft.feature("mesh");
    let mut faces = Faces::default();
    let mut lists = Lists::default();
    for element in &header.elements {
        let width = |p: &Property| match (header.order, p.list) {
            (Order::Text, _) => 2,
            (_, Some(list)) => list.bytes(),
            (_, None) => p.kind.bytes(),
        };
        let least: usize = element.properties.iter().map(width).sum();
        // The last word of a text needs no space behind it.
        let needed = (element.count as u128 * least as u128).saturating_sub(1);
        if needed > body.rest.len() as u128 {
            let (count, left) = (element.count, body.rest.len());
            let what = format!("the header promises {count} of `{}`, but only {left} bytes are left", element.name);
            return Err(files.broken(what).help("the file was cut off; fetch it again"));
        }
        if least == 0 {
            continue;
        }
        body.element.clone_from(&element.name);
        let is_face = element.name == "face";
        let is_strip = element.name == "tristrips";
        let is_list = |p: &Property| p.list.is_some() && matches!(&*p.name, "vertex_indices" | "vertex_index");
        if element.name == "vertex" {
            vertices(element, &mut body, draft)?;
        } else if (is_face || is_strip) && element.properties.iter().any(is_list) {
            if element.properties.iter().any(|p| p.name == "texcoord") {
                files.warn("picture places of faces' corners (`texcoord`) are not read");
            }
            for row in 0..element.count {
                body.row = row;
                for p in &element.properties {
                    let Some(list) = p.list.filter(|_| is_list(p)) else {
                        body.skip(p)?;
                        continue;
                    };
                    for _ in 0..body.length(list)? {
                        lists.values.push(body.value(p.kind)?);
                    }
                    lists.ends.push((row, is_strip, lists.values.len()));
                }
            }
        } else {
            for row in 0..element.count {
                body.row = row;
                element.properties.iter().try_for_each(|p| body.skip(p))?;
            }
        }
    }
    // Faces may come before the vertices.
    let mut first = 0;
    for &(row, is_strip, end) in &lists.ends {
        let all = &lists.values[first..end];
        first = end;
        let index = |v: f64| if (0.0..4e9).contains(&v) { v as u64 } else { u64::MAX };
        let place = || format!("face {row}");
        if draft.triangles.len() as u64 > MOST {
            return Err(files.broken(format!("more than the {MOST} triangles that are read")));
        }
        if !is_strip {
            let corners: Vec<u64> = all.iter().map(|&v| index(v)).collect();
            faces.add(&corners, draft, files, ledger, &place);
            continue;
        }
        for strip in all.split(|&v| v < 0.0) {
            for i in 2..strip.len() {
                let [a, b, c] = [i - 2, i - 1, i].map(|k| index(strip[k]));
                // Strips have flat triangles at their bends.
                if a != b && b != c && a != c {
                    let of = if i % 2 == 0 { [a, b, c] } else { [b, a, c] };
                    draft.triangle(of, files, ledger, &place);
                }
            }
        }
    }
    let material = header.pictures.first().filter(|_| !draft.surface.uvs.is_empty()).and_then(|name| {
        let image = picture(name, files, draft)?;
        let texture = Some(Texture { image, wrap: [Wrap::Repeat; 2], nearest: false });
        Some(draft.material(Material { name: name.clone(), texture, double_sided: true, ..Material::default() }))
    });
    draft.primitive("mesh", 0, material);
    Ok(())
}

fn vertices(element: &Element, body: &mut Body, draft: &mut Draft) -> Result<()> {
    let roles: Vec<Role> = element.properties.iter().map(role).collect();
    let has = |is: fn(&Role) -> bool| roles.iter().any(is);
    if !(has(|r| matches!(r, Role::Place(0)))
        && has(|r| matches!(r, Role::Place(1)))
        && has(|r| matches!(r, Role::Place(2))))
    {
        return Err(body.files.broken("vertices need `x`, `y` and `z`"));
    }
    if element.count > MOST {
        return Err(body.files.broken(format!("{} vertices are more than the {MOST} that are read", element.count)));
    }
    let normals = has(|r| matches!(r, Role::Normal(_)));
    let colours = has(|r| matches!(r, Role::Colour(0..=2, _)));
    let places = has(|r| matches!(r, Role::At(0))) && has(|r| matches!(r, Role::At(1)));
    for row in 0..element.count {
        body.row = row;
        let (mut p, mut n, mut c, mut at) = ([0.0; 3], [0.0; 3], [1.0; 4], [0.0; 2]);
        for (property, role) in element.properties.iter().zip(&roles) {
            match *role {
                Role::None => body.skip(property)?,
                Role::Place(k) => p[k] = body.value(property.kind)?,
                Role::Normal(k) => n[k] = body.value(property.kind)?,
                Role::Colour(k, most) => c[k] = body.value(property.kind)? / most,
                Role::At(k) => at[k] = body.value(property.kind)?,
            }
        }
        draft.positions.push(p);
        draft.features.push(0);
        if normals {
            draft.surface.normals.push(unit(n));
        }
        if colours {
            draft.surface.colours.push([linear(c[0]), linear(c[1]), linear(c[2]), c[3].clamp(0.0, 1.0) as f32]);
        }
        if places {
            // Up in the file, down here.
            draft.surface.uvs.push([at[0] as f32, (1.0 - at[1]) as f32]);
        }
    }
    Ok(())
}
