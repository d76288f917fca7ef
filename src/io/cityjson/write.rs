//! Buildings and groups of them as CityJSON 2.0 or CityJSONSeq, in the input's system.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde_json::{Map, Value, json};

use crate::artifact::buildings::{GROUND, ROOF, WALL};
use crate::artifact::{Attributes, Buildings, Values};
use crate::diag::{Diagnostic, Result};
use crate::geom::crs::LONLAT;
use crate::geom::frame::{Frame, Projector};

/// A geometry to write: surfaces of rings of points in millimetres, and what each is.
#[derive(Clone, Debug, Default)]
pub struct Form {
    pub lod: String,
    pub surfaces: Vec<Vec<Vec<[i32; 3]>>>,
    pub semantics: Vec<u8>,
}

/// A city object to write.
#[derive(Clone, Debug, Default)]
pub struct Piece {
    pub id: String,
    /// `Building` or `CityObjectGroup`.
    pub kind: &'static str,
    pub attributes: Map<String, Value>,
    pub parents: Vec<String>,
    pub children: Vec<String>,
    pub forms: Vec<Form>,
}

/// Whether CityJSON 2.0 has a name for a level of detail: `0` to `3`, and those of Biljecki et al., `0.0` to `3.3`.
pub fn is_level(lod: &str) -> bool {
    matches!(lod.as_bytes(), [b'0'..=b'3'] | [b'0'..=b'3', b'.', b'0'..=b'3'])
}

/// The buildings as CityJSONSeq: a header, then a building a line. An error where one has a level without a name.
pub fn buildings(layer: &Buildings) -> Result<Vec<u8>> {
    if let Some(g) = (0..layer.lods.len()).find(|&g| !is_level(layer.lods.get(g))) {
        let (id, lod) = (layer.ids.get(layer.starts.partition_point(|&s| s as usize <= g) - 1), layer.lods.get(g));
        let message = format!("building `{id}` has the level of detail {lod:?}, for which CityJSON 2.0 has no name");
        return Err(Diagnostic::error("bad-lod", message).value(lod).help("`write-cityjson` leaves such levels out"));
    }
    sequence(&layer.frame, &pieces(layer).collect::<Vec<_>>())
}

/// CityJSONSeq: a header, then a piece a line.
pub fn sequence(frame: &Frame, pieces: &[Piece]) -> Result<Vec<u8>> {
    let ground = Ground::of(frame)?;
    let mut out = ground.header().to_string().into_bytes();
    for piece in pieces {
        let mut vertices = Vertices::default();
        let object = ground.object(piece, &mut vertices);
        let feature = json!({
            "type": "CityJSONFeature",
            "id": piece.id,
            "CityObjects": { piece.id.clone(): object },
            "vertices": vertices.all,
        });
        out.push(b'\n');
        out.extend(feature.to_string().into_bytes());
    }
    out.push(b'\n');
    Ok(out)
}

/// One CityJSON object.
pub fn model(frame: &Frame, pieces: &[Piece]) -> Result<Vec<u8>> {
    let ground = Ground::of(frame)?;
    let mut vertices = Vertices::default();
    // Objects as texts: as values they take ten times the room.
    let texts = pieces.iter().map(|piece| (piece.id.as_str(), ground.object(piece, &mut vertices).to_string()));
    let texts: BTreeMap<&str, String> = texts.collect();
    let mut out = String::with_capacity(texts.values().map(|t| t.len() + 40).sum::<usize>() + 30 * vertices.all.len());
    let separate = |out: &mut String, first: bool, key: &str| {
        let comma = if first { "" } else { "," };
        write!(out, "{comma}{}:", Value::from(key)).expect("a string grows");
    };
    for (i, (key, value)) in ground.header().as_object().expect("a header is an object").iter().enumerate() {
        out.push_str(if i == 0 { "{" } else { "" });
        separate(&mut out, i == 0, key);
        match key.as_str() {
            "CityObjects" => {
                out.push('{');
                for (i, (id, text)) in texts.iter().enumerate() {
                    separate(&mut out, i == 0, id);
                    out.push_str(text);
                }
                out.push('}');
            }
            "vertices" => {
                out.push('[');
                for (i, [x, y, z]) in vertices.all.iter().enumerate() {
                    let comma = if i == 0 { "" } else { "," };
                    write!(out, "{comma}[{x},{y},{z}]").expect("a string grows");
                }
                out.push(']');
            }
            _ => write!(out, "{value}").expect("a string grows"),
        }
    }
    out.push_str("}\n");
    Ok(out.into_bytes())
}

/// The vertices of a file or feature, each once.
#[derive(Default)]
struct Vertices {
    index: BTreeMap<[i32; 3], u32>,
    all: Vec<[i64; 3]>,
}

/// The buildings of a layer, each level a form.
pub fn pieces(layer: &Buildings) -> impl Iterator<Item = Piece> {
    (0..layer.len()).map(|i| Piece {
        id: layer.ids.get(i).to_string(),
        kind: "Building",
        attributes: attributes(&layer.attributes, i),
        forms: layer.geometries_of(i).map(|g| form(layer, g)).collect(),
        ..Piece::default()
    })
}

fn form(layer: &Buildings, g: usize) -> Form {
    let polygons = layer.surfaces.polygons_of(g);
    Form {
        lod: layer.lods.get(g).to_string(),
        semantics: layer.semantics[polygons.clone()].to_vec(),
        surfaces: polygons
            .map(|p| layer.surfaces.rings_of(p).map(|r| layer.surfaces.ring(r).to_vec()).collect())
            .collect(),
    }
}

/// A feature's attributes as JSON. One of an extension loses the `+` before its name: nobody declares the extension here.
pub fn attributes(all: &Attributes, row: usize) -> Map<String, Value> {
    let present = all.columns.iter().filter(|c| c.present[row]);
    present
        .map(|c| {
            let value = match &c.values {
                Values::U32(v) => json!(v[row]),
                Values::I32(v) => json!(v[row]),
                Values::F64(v) => json!(v[row]),
                Values::Bool(v) => json!(v[row]),
                Values::Text(v) => json!(v.get(row)),
            };
            let plain = c.name.strip_prefix('+').filter(|name| all.get(name).is_none());
            (plain.unwrap_or(&c.name).to_string(), value)
        })
        .collect()
}

/// Millimetres to a file's whole numbers: in metres they are the same, shifted; in degrees 1e-8 of one (1.1 mm).
struct Ground {
    crs: String,
    way: Projector,
    scale: [f64; 3],
    translate: [f64; 3],
    is_shift: bool,
}

impl Ground {
    fn of(frame: &Frame) -> Result<Self> {
        let way = frame.projector()?;
        let (scale, translate, is_shift) = match way.shift() {
            Some((origin, unit)) => {
                ([0.001 / unit, 0.001 / unit, 0.001], [origin[0] / unit, origin[1] / unit, 0.0], true)
            }
            None => {
                let unit = if way.degrees() { 1e-8 } else { 1e-3 };
                let round = |v: f64| (v * 100.0).round() / 100.0 + 0.0;
                let [x, y] = way.source([0, 0]).map(round);
                ([unit, unit, 0.001], [x, y, 0.0], false)
            }
        };
        Ok(Self { crs: frame.crs.clone(), way, scale, translate, is_shift })
    }

    fn header(&self) -> Value {
        let mut out = json!({
            "type": "CityJSON",
            "version": "2.0",
            "transform": { "scale": self.scale, "translate": self.translate },
            "CityObjects": {},
            "vertices": [],
        });
        let system = match self.crs.as_str() {
            "" => return out,
            LONLAT => "OGC/0/CRS84h".to_string(),
            // Of a compound system the plan's part: the schema knows no other form.
            name => name.split('+').next().unwrap_or_default().replacen("EPSG:", "EPSG/0/", 1),
        };
        out["metadata"] = json!({ "referenceSystem": format!("https://www.opengis.net/def/crs/{system}") });
        out
    }

    fn vertex(&self, p: [i32; 3]) -> [i64; 3] {
        if self.is_shift {
            return p.map(i64::from);
        }
        let q = self.way.source([p[0], p[1]]);
        let whole = |k: usize| ((q[k] - self.translate[k]) / self.scale[k]).round() as i64;
        [whole(0), whole(1), i64::from(p[2])]
    }

    fn object(&self, piece: &Piece, vertices: &mut Vertices) -> Value {
        let mut out = json!({ "type": piece.kind });
        if !piece.attributes.is_empty() {
            out["attributes"] = Value::Object(piece.attributes.clone());
        }
        for (key, ids) in [("parents", &piece.parents), ("children", &piece.children)] {
            if !ids.is_empty() {
                out[key] = json!(ids);
            }
        }
        let forms: Vec<Value> = piece.forms.iter().map(|f| self.geometry(f, vertices)).collect();
        if !forms.is_empty() {
            out["geometry"] = forms.into();
        }
        out
    }

    fn geometry(&self, form: &Form, vertices: &mut Vertices) -> Value {
        let mut number = |p: [i32; 3]| {
            *vertices.index.entry(p).or_insert_with(|| {
                vertices.all.push(self.vertex(p));
                vertices.all.len() as u32 - 1
            })
        };
        let surfaces: Vec<Vec<Vec<u32>>> = form
            .surfaces
            .iter()
            .map(|rings| rings.iter().map(|ring| ring.iter().map(|&p| number(p)).collect()).collect())
            .collect();
        let solid = is_solid(&surfaces);
        let mut out = json!({ "type": if solid { "Solid" } else { "MultiSurface" }, "lod": form.lod });
        out["boundaries"] = if solid { json!([surfaces]) } else { json!(surfaces) };
        // Only kinds that occur, in this order.
        let kinds: Vec<(u8, &str)> = [(GROUND, "GroundSurface"), (WALL, "WallSurface"), (ROOF, "RoofSurface")]
            .into_iter()
            .filter(|(kind, _)| form.semantics.contains(kind))
            .collect();
        if !kinds.is_empty() {
            let place = |k: &u8| kinds.iter().position(|(kind, _)| kind == k);
            let values: Vec<Option<usize>> = form.semantics.iter().map(place).collect();
            let names: Vec<Value> = kinds.iter().map(|(_, name)| json!({ "type": name })).collect();
            out["semantics"] =
                json!({ "surfaces": names, "values": if solid { json!([values]) } else { json!(values) } });
        }
        out
    }
}

/// One closed shell: every edge once there and once back, and all surfaces hang together.
fn is_solid(surfaces: &[Vec<Vec<u32>>]) -> bool {
    let rings = || surfaces.iter().flatten();
    let mut edges = std::collections::BTreeSet::new();
    for ring in rings() {
        for (k, &a) in ring.iter().enumerate() {
            if !edges.insert((a, ring[(k + 1) % ring.len()])) {
                return false;
            }
        }
    }
    if edges.is_empty() || edges.iter().any(|&(a, b)| !edges.contains(&(b, a))) {
        return false;
    }
    // Vertices reached from the first along surfaces.
    let mut group: BTreeMap<u32, u32> = rings().flatten().map(|&v| (v, v)).collect();
    fn root(group: &mut BTreeMap<u32, u32>, mut v: u32) -> u32 {
        while group[&v] != v {
            let up = group[&group[&v]];
            group.insert(v, up);
            v = up;
        }
        v
    }
    for surface in surfaces {
        let mut all = surface.iter().flatten();
        let Some(&first) = all.next() else { continue };
        for &v in all {
            let (a, b) = (root(&mut group, first), root(&mut group, v));
            group.insert(a.max(b), a.min(b));
        }
    }
    let all: Vec<u32> = group.keys().copied().collect();
    let first = root(&mut group, all[0]);
    all.into_iter().all(|v| root(&mut group, v) == first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::{Shapes, Strings};
    use crate::geom::frame::Projection;
    use crate::io::cityjson::read;

    fn cube(at: i32) -> Vec<Vec<Vec<[i32; 3]>>> {
        let p = |v: usize| [at + 1000 * [0, 1, 1, 0][v % 4], 1000 * [0, 0, 1, 1][v % 4], 1000 * (v / 4) as i32];
        let faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
        faces.iter().map(|f| vec![f.iter().map(|&v| p(v)).collect()]).collect()
    }

    fn layer(frame: Frame, cubes: &[i32]) -> Buildings {
        let mut surfaces = Shapes::default();
        let mut semantics = Vec::new();
        for &at in cubes {
            for rings in cube(at) {
                surfaces.push_ring(&rings[0]);
                surfaces.end_polygon();
            }
            semantics.extend([GROUND, ROOF, WALL, WALL, WALL, 3]);
        }
        surfaces.end_shape();
        let lods = ["1.2"].iter().collect();
        let ids: Strings = ["a"].iter().collect();
        Buildings { frame, ids, attributes: Attributes::default(), starts: vec![0, 1], lods, surfaces, semantics }
    }

    #[test]
    fn there_and_back() {
        for (frame, crs, exact) in [
            (
                Frame { crs: "EPSG:7415".into(), projection: Projection::Projected { origin: [85_000.0, 447_000.0] } },
                "EPSG:7415",
                true,
            ),
            (
                Frame { crs: LONLAT.into(), projection: Projection::TransverseMercator { origin: [139.65, 35.65] } },
                LONLAT,
                false,
            ),
            (Frame::local(), "", true),
        ] {
            let layer = layer(frame.clone(), &[0]);
            let bytes = buildings(&layer).unwrap();
            let mut lines = 0;
            let mut transform = None;
            read("a", Box::new(std::io::Cursor::new(bytes)), |m| {
                lines += 1;
                if m.transform.is_some() {
                    transform = m.transform;
                    let said = m.crs.map(|c| crate::geom::crs::Crs::parse(&c).unwrap().name);
                    assert_eq!(said.unwrap_or_default(), crs);
                    return Ok(());
                }
                let b = &m.objects[0].geometries[0];
                assert_eq!((b.kind.as_str(), b.lod.as_str()), ("Solid", "1.2"));
                assert_eq!(b.semantics, layer.semantics);
                let t = transform.as_ref().unwrap();
                let way = frame.projector().unwrap();
                for (k, &i) in b.indices.iter().enumerate() {
                    let v = m.vertices[i as usize];
                    let p: [f64; 3] = std::array::from_fn(|k| v[k] * t.scale[k] + t.translate[k]);
                    let q = crate::geom::frame::grid(way.local([p[0], p[1]])).unwrap();
                    let own = layer.surfaces.points[k];
                    let far = (q[0] - own[0]).abs().max((q[1] - own[1]).abs());
                    assert!(far <= i32::from(!exact) && (p[2] * 1000.0).round() as i32 == own[2], "{q:?} {own:?}");
                }
                Ok(())
            })
            .unwrap();
            assert_eq!(lines, 2);
        }
    }

    #[test]
    fn a_level_without_a_name() {
        let mut layer = layer(Frame::local(), &[0]);
        layer.lods = ["2.5"].iter().collect();
        let e = buildings(&layer).unwrap_err();
        assert_eq!(e.message, "building `a` has the level of detail \"2.5\", for which CityJSON 2.0 has no name");
    }

    #[test]
    fn two_cubes_are_no_solid() {
        let text = |cubes: &[i32]| String::from_utf8(buildings(&layer(Frame::local(), cubes)).unwrap()).unwrap();
        assert!(text(&[0]).contains("\"Solid\""));
        assert!(text(&[0, 5000]).contains("\"MultiSurface\""));
    }
}
