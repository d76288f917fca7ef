//! City objects as a file has them: a CityJSON object, or one and CityJSONFeatures after it (CityJSONSeq).
//!
//! Read are types, parents, attributes, surfaces, their meaning, vertices, transform and reference system. Left
//! unread are appearances, templates, addresses and members of extensions: an object says which of them it had.

use std::borrow::Cow;
use std::io::Read;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifact::buildings::{GROUND, OTHER, ROOF, WALL};
use crate::diag::{Diagnostic, Result};
use crate::io::json::{Json, Parsed, Scalar};
use crate::io::stream::stream;

/// Vertex * scale + translate = coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Transform {
    pub scale: [f64; 3],
    pub translate: [f64; 3],
}

/// A CityJSON object or a CityJSONFeature.
#[derive(Default)]
pub struct Model<'a> {
    /// Line on which it starts.
    pub line: u64,
    /// A CityJSONFeature: transform and system are its header's.
    pub is_feature: bool,
    pub transform: Option<Transform>,
    /// There is one, but not of two times three finite numbers.
    pub bad_transform: bool,
    pub crs: Option<String>,
    pub objects: Vec<Object<'a>>,
    /// Before the transform.
    pub vertices: Vec<[f64; 3]>,
}

pub struct Object<'a> {
    pub id: Cow<'a, str>,
    /// `Building`, `BuildingPart`, `Road`, ..
    pub kind: String,
    pub line: u64,
    pub parents: Vec<Cow<'a, str>>,
    pub attributes: Vec<(Cow<'a, str>, Scalar<'a>)>,
    pub geometries: Vec<Boundary>,
    /// Members that were not read, each as often as it was there: its own (`address`, ..), those of its surfaces'
    /// geometries (`material`, `texture`, ..) and of their semantics (`semantics.slope`, `semantics.type Window`, ..).
    pub left: Vec<Cow<'a, str>>,
    /// Why it is no city object.
    pub fault: Option<&'static str>,
}

/// The surfaces of one geometry.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Boundary {
    /// `Solid`, `MultiSurface`, ..
    pub kind: String,
    pub lod: String,
    /// Vertices of all rings, one after the other.
    pub indices: Vec<u32>,
    /// End of each ring in `indices`.
    pub rings: Vec<u32>,
    /// End of each surface in `rings`.
    pub surfaces: Vec<u32>,
    /// End of each shell in `surfaces`; surfaces without shells are one.
    pub shells: Vec<u32>,
    /// `GROUND`, `WALL`, `ROOF` or `OTHER` of each surface; empty where the file says nothing.
    pub semantics: Vec<u8>,
    /// Why the boundaries are not those of their type.
    pub fault: Option<&'static str>,
    depth: u32,
}

/// Names of surfaces that a building stands on.
pub const GROUND_TYPES: &[&str] = &["GroundSurface"];

fn meaning(name: &str) -> u8 {
    match name {
        _ if GROUND_TYPES.contains(&name) => GROUND,
        "WallSurface" => WALL,
        "RoofSurface" => ROOF,
        _ => OTHER,
    }
}

impl Boundary {
    /// Vertices of the rings of surface `s`, the shell first.
    pub fn rings_of(&self, s: usize) -> impl Iterator<Item = &[u32]> {
        let from = |ends: &[u32], i: usize| if i == 0 { 0 } else { ends[i - 1] as usize };
        let rings = from(&self.surfaces, s)..self.surfaces[s] as usize;
        rings.map(move |r| &self.indices[from(&self.rings, r)..self.rings[r] as usize])
    }

    /// Made of surfaces, not of points, lines, or a template.
    pub fn is_surface(&self) -> bool {
        self.wanted_depth() >= 3
    }

    fn wanted_depth(&self) -> u32 {
        match self.kind.as_str() {
            "MultiSurface" | "CompositeSurface" => 3,
            "Solid" => 4,
            "MultiSolid" | "CompositeSolid" => 5,
            _ => 0,
        }
    }
}

/// Calls `each` with every CityJSON object and CityJSONFeature in order.
pub fn read(name: &str, reader: Box<dyn Read + Send>, mut each: impl FnMut(Model) -> Result<()>) -> Result<()> {
    stream(name, reader, |text| {
        while text.peek()?.is_some() {
            text.parse(|json, line| {
                let start = json.at;
                let (kind, model) = model(json, line)?;
                match kind.as_str() {
                    "CityJSON" | "CityJSONFeature" => Ok(each(model)?),
                    other => {
                        let message = format!("{name}:{line}: not CityJSON: its type is `{other}`");
                        let e = Diagnostic::error("not-cityjson", message);
                        let geojson = other.starts_with("Feature") && start < json.at;
                        Err(if geojson { e.help("read it with read-geojson") } else { e }.into())
                    }
                }
            })?;
        }
        Ok(())
    })
}

fn model<'a>(json: &mut Json<'a>, line: u64) -> Parsed<(String, Model<'a>)> {
    let mut out = Model { line, ..Default::default() };
    let mut kind = "missing".to_string();
    // Lines are counted along: from the last place, to the next.
    let mut counted = (json.at, line);
    json.object(|json, key| {
        match &*key {
            "type" => kind = text(json)?,
            "transform" => {
                out.transform = if json.peek()? == b'{' { transform(json)? } else { json.skip().map(|()| None)? };
                out.bad_transform = out.transform.is_none();
            }
            "metadata" if json.peek()? == b'{' => json.object(|json, key| match &*key {
                "referenceSystem" => Ok(out.crs = Some(text(json)?).filter(|t| !t.is_empty())),
                _ => json.skip(),
            })?,
            "CityObjects" => json.object(|json, id| {
                counted.1 += json.lines(counted.0);
                counted.0 = json.at;
                out.objects.push(object(json, id, counted.1)?);
                Ok(())
            })?,
            "vertices" => json.list(|json| {
                let mut v = [0.0; 3];
                let mut n = 0;
                json.list(|json| {
                    let x = json.number()?;
                    if n < 3 {
                        v[n] = x;
                    }
                    n += 1;
                    Ok(())
                })?;
                if n != 3 {
                    return json.bad("expected a vertex of three numbers");
                }
                out.vertices.push(v);
                Ok(())
            })?,
            _ => json.skip()?,
        }
        Ok(())
    })?;
    out.is_feature = kind == "CityJSONFeature";
    Ok((kind, out))
}

/// A text, or the written form of another scalar.
fn text(json: &mut Json) -> Parsed<String> {
    Ok(match json.scalar()? {
        Scalar::Text(t) => t.into_owned(),
        Scalar::Number(_, written) => written.to_string(),
        _ => String::new(),
    })
}

fn transform(json: &mut Json) -> Parsed<Option<Transform>> {
    let mut parts = [None; 2];
    json.object(|json, key| {
        let part = match &*key {
            "scale" => 0,
            "translate" => 1,
            _ => return json.skip(),
        };
        let mut v = Vec::new();
        if json.peek()? != b'[' {
            return json.skip();
        }
        json.list(|json| Ok(if json.at_number()? { v.push(json.number()?) } else { json.skip()? }))?;
        parts[part] = v.try_into().ok();
        Ok(())
    })?;
    let finite = |v: &[f64; 3]| v.iter().all(|x| x.is_finite());
    Ok(match parts {
        [Some(scale), Some(translate)] if finite(&scale) && finite(&translate) => Some(Transform { scale, translate }),
        _ => None,
    })
}

fn object<'a>(json: &mut Json<'a>, id: Cow<'a, str>, line: u64) -> Parsed<Object<'a>> {
    let mut out = Object {
        id,
        kind: String::new(),
        line,
        parents: Vec::new(),
        attributes: Vec::new(),
        geometries: Vec::new(),
        left: Vec::new(),
        fault: None,
    };
    if json.peek()? != b'{' {
        out.fault = Some("not a city object");
        json.skip()?;
        return Ok(out);
    }
    json.object(|json, key| {
        match &*key {
            "type" => out.kind = text(json)?,
            "parents" if json.peek()? == b'[' => json.list(|json| Ok(out.parents.push(json.string()?)))?,
            "attributes" if json.peek()? == b'{' => json.object(|json, key| {
                let value = json.scalar()?;
                out.attributes.push((key, value));
                Ok(())
            })?,
            "geometry" if json.peek()? == b'[' => json.list(|json| {
                if json.peek()? != b'{' {
                    out.fault = Some("a geometry that is not an object");
                    return json.skip();
                }
                let before = out.left.len();
                out.geometries.push(boundary(json, &mut out.left)?);
                if out.geometries.last().is_some_and(|b| !b.is_surface()) {
                    out.left.truncate(before);
                }
                Ok(())
            })?,
            // The other end of `parents`, and what follows from the geometries.
            "children" | "geographicalExtent" => json.skip()?,
            _ => {
                out.left.push(key);
                json.skip()?;
            }
        }
        Ok(())
    })?;
    Ok(out)
}

fn boundary<'a>(json: &mut Json<'a>, left: &mut Vec<Cow<'a, str>>) -> Parsed<Boundary> {
    let mut out = Boundary::default();
    let mut types: Vec<u8> = Vec::new();
    let mut values = Nest::Null;
    json.object(|json, key| {
        match &*key {
            "type" => out.kind = text(json)?,
            "lod" => out.lod = text(json)?,
            "boundaries" if json.peek()? == b'[' => out.depth = nest(json, &mut out, 0)?,
            "semantics" if json.peek()? == b'{' => json.object(|json, key| match &*key {
                "surfaces" if json.peek()? == b'[' => json.list(|json| {
                    let mut kind = OTHER;
                    json.object(|json, key| match &*key {
                        "type" => {
                            let name = text(json)?;
                            kind = meaning(&name);
                            if kind == OTHER {
                                left.push(format!("semantics.type {name}").into());
                            }
                            Ok(())
                        }
                        "parent" | "children" => json.skip(),
                        name => {
                            left.push(format!("semantics.{name}").into());
                            json.skip()
                        }
                    })?;
                    types.push(kind);
                    Ok(())
                }),
                "values" => Ok(values = Nest::read(json, 0)?),
                _ => json.skip(),
            })?,
            _ => {
                left.push(key);
                json.skip()?;
            }
        }
        Ok(())
    })?;
    let wanted = out.wanted_depth();
    if wanted > 0 && out.depth != 0 && out.depth != wanted && out.fault.is_none() {
        out.fault = Some("boundaries nested otherwise than their type says");
    }
    if !matches!(values, Nest::Null) {
        out.semantics = Vec::with_capacity(out.surfaces.len());
        let mut lists = Vec::new();
        values.shells(wanted, &mut lists);
        let mut from = 0;
        for (i, &end) in out.shells.iter().enumerate() {
            let said = lists.get(i).copied().unwrap_or(&[]);
            for s in 0..(end - from) as usize {
                let kind = match said.get(s) {
                    Some(Nest::Leaf(k)) => types.get(*k as usize).copied().unwrap_or(OTHER),
                    _ => OTHER,
                };
                out.semantics.push(kind);
            }
            from = end;
        }
    }
    Ok(out)
}

/// Lists of vertices, of such, ..: how deep they are (a ring is 1, an empty list 0).
fn nest(json: &mut Json, out: &mut Boundary, above: u32) -> Parsed<u32> {
    let mut below = 0;
    let mut bad = false;
    let start = out.indices.len();
    json.list(|json| {
        let depth = match json.peek()? {
            b'[' if above < 8 => 1 + nest(json, out, above + 1)?,
            _ if json.at_number()? => {
                let v = json.number()?;
                if v.fract() == 0.0 && (0.0..f64::from(u32::MAX)).contains(&v) {
                    out.indices.push(v as u32);
                } else {
                    bad = true;
                }
                1
            }
            _ => {
                json.skip()?;
                bad = true;
                1
            }
        };
        bad |= below > 1 && depth > 1 && depth != below;
        bad |= (below == 1) != (depth == 1) && below != 0;
        below = below.max(depth);
        Ok(())
    })?;
    if bad {
        out.fault = Some("boundaries that are not lists of vertices");
    }
    match below {
        1 if out.indices.len() > start => out.rings.push(out.indices.len() as u32),
        2 => out.surfaces.push(out.rings.len() as u32),
        3 => out.shells.push(out.surfaces.len() as u32),
        _ => {}
    }
    Ok(below)
}

/// Semantic values: numbers of surface types, in lists as deep as the boundaries less two. A null may stand anywhere.
enum Nest {
    Null,
    Leaf(u32),
    List(Vec<Nest>),
}

impl Nest {
    fn read(json: &mut Json, above: u32) -> Parsed<Self> {
        Ok(match json.peek()? {
            b'[' if above < 8 => {
                let mut all = Vec::new();
                json.list(|json| Ok(all.push(Self::read(json, above + 1)?)))?;
                Self::List(all)
            }
            _ if json.at_number()? => Self::Leaf(json.number()? as u32),
            _ => json.skip().map(|()| Self::Null)?,
        })
    }

    /// The list of each shell (of the whole, where there are no shells).
    fn shells<'n>(&'n self, depth: u32, out: &mut Vec<&'n [Self]>) {
        match self {
            Self::List(all) if depth > 3 => all.iter().for_each(|n| n.shells(depth - 1, out)),
            Self::List(all) => out.push(all),
            _ => out.push(&[]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(geometry: &str) -> Boundary {
        let text = format!(
            r#"{{"type":"CityJSON","CityObjects":{{"a":{{"type":"Building","geometry":[{geometry}]}}}},"vertices":[]}}"#
        );
        let mut out = None;
        read("a", Box::new(std::io::Cursor::new(text.into_bytes())), |mut m| {
            out = m.objects[0].geometries.pop();
            Ok(())
        })
        .unwrap();
        out.unwrap()
    }

    #[test]
    fn a_solid_with_a_cavity() {
        let b = of(
            r#"{"semantics":{"values":[[1,null,0],null],"surfaces":[{"type":"GroundSurface"},{"type":"RoofSurface","slope":3}]},
            "boundaries":[[[[0,1,2],[3,4,5]],[[1,2,3]],[[2,3,4]]],[[[5,6,7]]]],"type":"Solid","lod":2.2}"#,
        );
        assert_eq!((b.kind.as_str(), b.lod.as_str(), b.fault), ("Solid", "2.2", None));
        assert_eq!(
            (&b.rings[..], &b.surfaces[..], &b.shells[..]),
            (&[3, 6, 9, 12, 15][..], &[2, 3, 4, 5][..], &[3, 4][..])
        );
        assert_eq!(b.semantics, [ROOF, OTHER, GROUND, OTHER]);
        assert_eq!(b.rings_of(0).collect::<Vec<_>>(), [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(b.rings_of(3).collect::<Vec<_>>(), [[5, 6, 7]]);
    }

    #[test]
    fn other_kinds() {
        let b = of(
            r#"{"type":"MultiSurface","lod":"1","boundaries":[[[0,1,2]],[[1,2,3]]],"semantics":{"surfaces":[{"type":"WallSurface"}],"values":[0,null]}}"#,
        );
        assert_eq!((b.semantics, b.surfaces.len(), b.shells.len()), (vec![WALL, OTHER], 2, 1));
        let b = of(
            r#"{"type":"MultiSolid","lod":"1","boundaries":[[[[[0,1,2]],[[1,2,3]]]],[[[[4,5,6]]]]],"semantics":{"surfaces":[{"type":"RoofSurface"}],"values":[[[0,0]],[null]]}}"#,
        );
        assert_eq!((b.semantics, b.shells), (vec![ROOF, ROOF, OTHER], vec![2, 3]));
        assert!(!of(r#"{"type":"MultiPoint","lod":"1","boundaries":[0,1]}"#).is_surface());
        assert!(!of(r#"{"type":"GeometryInstance","template":0,"boundaries":[0]}"#).is_surface());
        assert!(of(r#"{"type":"Solid","lod":"1","boundaries":[[[0,1,2]]]}"#).fault.is_some());
        assert!(of(r#"{"type":"MultiSurface","lod":"1","boundaries":[[[0,-1,2]]]}"#).fault.is_some());
        assert!(of(r#"{"type":"MultiSurface","lod":"1","boundaries":[[[0,1,2],3]]}"#).fault.is_some());
        assert_eq!(of(r#"{"type":"Solid","lod":"1","boundaries":[]}"#).surfaces.len(), 0);
    }
}
