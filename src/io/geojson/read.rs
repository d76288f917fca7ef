//! Features of a file one by one: a FeatureCollection in any layout, features one after the other (newline-delimited,
//! RFC 8142), or a bare geometry. Never the whole file at once.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Read;

use crate::diag::{Diagnostic, Result};
use crate::io::json::{Json, Parsed, Scalar};
use crate::io::place::Said;
use crate::io::stream::{Stream, stream};

/// One feature; texts borrow from the file's.
pub struct Feature<'a> {
    /// Line on which it starts.
    pub line: u64,
    pub id: Scalar<'a>,
    pub properties: Vec<(Cow<'a, str>, Scalar<'a>)>,
    /// Why this member of `features` is none.
    pub fault: Option<&'static str>,
}

/// Coordinates as they stand in the file: of a point, line, polygon, or several.
#[derive(Default)]
pub struct Geometry {
    pub kind: GeometryKind,
    pub points: Vec<[f64; 2]>,
    /// End of each line or ring in `points`.
    pub rings: Vec<u32>,
    /// End of each polygon in `rings`.
    pub polygons: Vec<u32>,
    /// Why the coordinates are not those of their type.
    pub fault: Option<&'static str>,
    depth: u32,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum GeometryKind {
    #[default]
    Null,
    Point,
    MultiPoint,
    LineString,
    MultiLineString,
    Polygon,
    MultiPolygon,
    /// GeometryCollection, and what is no GeoJSON.
    Other(String),
}

impl GeometryKind {
    pub fn name(&self) -> &str {
        match self {
            Self::Null => "null",
            Self::Point => "Point",
            Self::MultiPoint => "MultiPoint",
            Self::LineString => "LineString",
            Self::MultiLineString => "MultiLineString",
            Self::Polygon => "Polygon",
            Self::MultiPolygon => "MultiPolygon",
            Self::Other(name) => name,
        }
    }

    fn of(name: &str) -> Self {
        let all =
            [Self::Point, Self::MultiPoint, Self::LineString, Self::MultiLineString, Self::Polygon, Self::MultiPolygon];
        all.into_iter().find(|k| k.name() == name).unwrap_or_else(|| Self::Other(name.to_string()))
    }

    /// How deep the coordinates are nested; a position is 1.
    fn depth(&self) -> u32 {
        match self {
            Self::Null | Self::Other(_) => 0,
            Self::Point => 1,
            Self::MultiPoint | Self::LineString => 2,
            Self::MultiLineString | Self::Polygon => 3,
            Self::MultiPolygon => 4,
        }
    }
}

/// What a file says beside its features.
#[derive(Debug, Default)]
pub struct Header {
    /// What its objects say in `crs` (GeoJSON 2008; QGIS and GDAL still write it), and the line that says it first.
    said: BTreeMap<Said, u64>,
}

/// Calls `each` with every feature in order. An error names file and line.
pub fn read(
    name: &str,
    reader: Box<dyn Read + Send>,
    mut each: impl FnMut(Feature, &Geometry) -> Result<()>,
) -> Result<Header> {
    stream(name, reader, |text| {
        let mut header = Header::default();
        let mut geometry = Geometry::default();
        while text.peek()?.is_some() {
            // One object may be parsed twice, where a block ends in it: saying the same again is as good as once.
            let mut own = Header::default();
            let (start, is_collection) = text.parse(|json, line| match item(json, line, &mut own, &mut geometry)? {
                Item::Collection => Ok((line, true)),
                Item::Feature(feature) => Ok(each(feature, &geometry).map(|()| (line, false))?),
                Item::Other(kind) => {
                    let e = Diagnostic::error("not-geojson", format!("{name}:{line}: not GeoJSON: its type is {kind}"));
                    Err(if kind.contains("CityJSON") { e.help("read it with read-cityjson") } else { e }.into())
                }
            })?;
            let has_features = !is_collection || collection(name, text, &mut own, &mut geometry, &mut each)?;
            if has_features && own.said.is_empty() {
                own.say(Said::Nothing, start);
            }
            own.said.into_iter().for_each(|(said, line)| header.say(said, line));
        }
        Ok(header)
    })
}

/// After `"features": [`: the features, then the collection's other members, more features among them. True where
/// there was one.
fn collection(
    name: &str,
    text: &mut Stream,
    header: &mut Header,
    geometry: &mut Geometry,
    each: &mut impl FnMut(Feature, &Geometry) -> Result<()>,
) -> Result<bool> {
    let mut any = false;
    let mut in_features = true;
    loop {
        if in_features {
            let mut more = !text.parse(|json, _| json.take(b']'))?;
            any |= more;
            while more {
                text.peek()?;
                more = text.parse(|json, line| {
                    let feature = member(json, line, geometry)?;
                    let more = json.goes_on(b']')?;
                    each(feature, geometry)?;
                    Ok(more)
                })?;
            }
        }
        if !text.parse(|json, _| json.goes_on(b'}'))? {
            return Ok(any);
        }
        text.peek()?;
        in_features = text.parse(|json, line| {
            match &*json.key()? {
                "crs" => header.read(json, line)?,
                "features" if json.take(b'[')? => return Ok(true),
                "features" => {
                    let message = format!("{name}:{line}: not GeoJSON: its second `features` is not a list");
                    return Err(Diagnostic::error("not-geojson", message).into());
                }
                _ => json.skip()?,
            }
            json.peek().map(|_| false)
        })?;
    }
}

/// A member of `features`; what is no feature has a `fault`.
fn member<'a>(json: &mut Json<'a>, line: u64, geometry: &mut Geometry) -> Parsed<Feature<'a>> {
    let start = json.at;
    if json.peek()? == b'{'
        && let Item::Feature(feature) = item(json, line, &mut Header::default(), geometry)?
    {
        return Ok(feature);
    }
    json.at = start;
    json.skip()?;
    geometry.clear();
    Ok(Feature { line, id: Scalar::Null, properties: Vec::new(), fault: Some("not a feature") })
}

enum Item<'a> {
    Feature(Feature<'a>),
    /// A FeatureCollection; its first feature comes next.
    Collection,
    Other(String),
}

/// An object: a feature, a geometry, or the start of a collection.
fn item<'a>(json: &mut Json<'a>, line: u64, header: &mut Header, geometry: &mut Geometry) -> Parsed<Item<'a>> {
    geometry.clear();
    let mut kind = None;
    let mut feature = Feature { line, id: Scalar::Null, properties: Vec::new(), fault: None };
    let mut is_bare = false;
    json.expect(b'{')?;
    let mut more = !json.take(b'}')?;
    while more {
        let key = json.key()?;
        match &*key {
            "type" => kind = Some(json.scalar()?),
            "id" => feature.id = json.scalar()?,
            "properties" if json.peek()? == b'{' => {
                feature.properties.reserve(4);
                json.object(|json, key| {
                    let value = json.scalar()?;
                    feature.properties.push((key, value));
                    Ok(())
                })?;
            }
            "geometry" if json.peek()? == b'{' => geometry.read(json)?,
            "coordinates" if json.peek()? == b'[' => {
                is_bare = true;
                geometry.coordinates(json)?;
            }
            "crs" => header.read(json, line)?,
            "features" if json.peek()? == b'[' => {
                json.expect(b'[')?;
                return Ok(Item::Collection);
            }
            _ => json.skip()?,
        }
        more = json.goes_on(b'}')?;
    }
    Ok(match kind {
        Some(Scalar::Text(kind)) if kind == "Feature" => Item::Feature(feature),
        None if !is_bare && !matches!(geometry.kind, GeometryKind::Null) => Item::Feature(feature),
        Some(Scalar::Text(kind)) => match GeometryKind::of(&kind) {
            GeometryKind::Other(name) if name != "GeometryCollection" => Item::Other(format!("`{name}`")),
            kind => {
                geometry.kind = kind;
                geometry.judge();
                Item::Feature(feature)
            }
        },
        _ => Item::Other("missing".into()),
    })
}

impl Header {
    /// What file `name` says, in the order of its lines; where it says several things, each with its line.
    pub fn said(self, name: &str) -> impl Iterator<Item = (String, Said)> {
        let mut all: Vec<(u64, Said)> = self.said.into_iter().map(|(said, line)| (line, said)).collect();
        all.sort();
        let one = all.len() == 1;
        all.into_iter().map(move |(line, said)| (if one { name.to_string() } else { format!("{name}:{line}") }, said))
    }

    fn say(&mut self, said: Said, line: u64) {
        self.said.entry(said).or_insert(line);
    }

    /// `{"type": "name", "properties": {"name": ".."}}`, the name alone, or null.
    fn read(&mut self, json: &mut Json, line: u64) -> Parsed<()> {
        let mut said = Said::Odd;
        if json.peek()? == b'{' {
            json.object(|json, key| {
                if key != "properties" || json.peek()? != b'{' {
                    return json.skip();
                }
                json.object(|json, key| {
                    if let ("name", Scalar::Text(text)) = (&*key, json.scalar()?) {
                        said = Said::Name(text.into_owned());
                    }
                    Ok(())
                })
            })?;
        } else {
            match json.scalar()? {
                Scalar::Null => said = Said::NoSystem,
                Scalar::Text(text) => said = Said::Name(text.into_owned()),
                _ => {}
            }
        }
        self.say(said, line);
        Ok(())
    }
}

impl Geometry {
    /// The rings of polygon `p`, open or closed as in the file.
    pub fn polygon(&self, p: usize) -> impl Iterator<Item = &[[f64; 2]]> {
        let start = if p == 0 { 0 } else { self.polygons[p - 1] as usize };
        (start..self.polygons[p] as usize).map(|r| self.ring(r))
    }

    pub fn ring(&self, r: usize) -> &[[f64; 2]] {
        let start = if r == 0 { 0 } else { self.rings[r - 1] as usize };
        &self.points[start..self.rings[r] as usize]
    }

    fn clear(&mut self) {
        self.kind = GeometryKind::Null;
        self.points.clear();
        self.rings.clear();
        self.polygons.clear();
        self.fault = None;
        self.depth = 0;
    }

    fn read(&mut self, json: &mut Json) -> Parsed<()> {
        let mut kind = None;
        json.object(|json, key| {
            match &*key {
                "type" => kind = Some(json.scalar()?),
                "coordinates" if json.peek()? == b'[' => self.coordinates(json)?,
                _ => json.skip()?,
            }
            Ok(())
        })?;
        self.kind = match kind {
            Some(Scalar::Text(kind)) => GeometryKind::of(&kind),
            _ => GeometryKind::Other("missing".into()),
        };
        self.judge();
        Ok(())
    }

    fn coordinates(&mut self, json: &mut Json) -> Parsed<()> {
        self.depth = self.nest(json, 0)?;
        Ok(())
    }

    /// A position or a list of such, of such ..: how deep it is. An empty list has any depth (0).
    fn nest(&mut self, json: &mut Json, above: u32) -> Parsed<u32> {
        json.expect(b'[')?;
        if json.at_number()? {
            return self.position(json).map(|()| 1);
        }
        if json.take(b']')? {
            return Ok(0);
        }
        let mut below = 0;
        loop {
            let depth = match json.peek()? {
                b'[' if above < 8 => self.nest(json, above + 1)?,
                _ => {
                    json.skip()?;
                    self.fault = Some("coordinates that are not numbers");
                    below
                }
            };
            if below != 0 && depth != 0 && depth != below {
                self.fault = Some("coordinates nested in two ways");
            }
            below = below.max(depth);
            if !json.goes_on(b']')? {
                break;
            }
        }
        match below {
            1 => self.rings.push(self.points.len() as u32),
            2 => self.polygons.push(self.rings.len() as u32),
            _ => {}
        }
        Ok(if below == 0 { 0 } else { below + 1 })
    }

    /// After `[`, a number ahead: x, y and what may follow.
    #[inline]
    fn position(&mut self, json: &mut Json) -> Parsed<()> {
        let x = json.number()?;
        if !json.goes_on(b']')? {
            self.fault = Some("a position of one number");
            return Ok(());
        }
        if !json.at_number()? {
            self.fault = Some("coordinates that are not numbers");
            json.skip()?;
        } else {
            let y = json.number()?;
            self.points.push([x, y]);
        }
        while json.goes_on(b']')? {
            json.skip()?;
        }
        Ok(())
    }

    /// Coordinates must be as deep as the type says.
    fn judge(&mut self) {
        let wanted = self.kind.depth();
        if self.fault.is_none() && wanted > 0 && self.depth > 0 && self.depth != wanted {
            self.fault = Some("coordinates nested otherwise than the geometry's type says");
        }
        if self.fault.is_none() && self.points.iter().any(|p| !(p[0].is_finite() && p[1].is_finite())) {
            self.fault = Some("a coordinate that is not finite");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(text: &str) -> Result<Vec<String>> {
        let mut out = Vec::new();
        let header = read("a.geojson", Box::new(std::io::Cursor::new(text.as_bytes().to_vec())), |f, g| {
            let rings: Vec<usize> = (0..g.rings.len()).map(|r| g.ring(r).len()).collect();
            out.push(format!(
                "{} {:?} {:?} {} {:?} {:?} {}",
                f.line,
                f.id,
                f.properties,
                g.kind.name(),
                rings,
                g.polygons,
                g.fault.unwrap_or("-")
            ));
            Ok(())
        })?;
        out.extend(
            header.said("a").filter_map(|(_, said)| if let Said::Name(name) = said { Some(name) } else { None }),
        );
        Ok(out)
    }

    const POLYGON: &str =
        r#"{"type":"Polygon","coordinates":[[[0,0],[1,0],[1,1],[0,0]],[[0.5,0.5,9],[0.6,0.5,9],[0.5,0.6]]]}"#;

    #[test]
    fn every_layout() {
        let one = format!(r#"{{"type":"Feature","id":7,"properties":{{"a":"b"}},"geometry":{POLYGON}}}"#);
        let two = r#"{"geometry":null,"properties":null,"type":"Feature"}"#;
        let row = r#"1 Number(7.0, "7") [("a", Text("b"))] Polygon [4, 3] [2] -"#;
        let null = r#"Null [] null [] [] -"#;
        let crs = r#""crs":{"type":"name","properties":{"name":"EPSG:28992"}}"#;
        // One line, the system after the features.
        let text = format!(r#"{{"type":"FeatureCollection","features":[{one},{two}],{crs}}}"#);
        assert_eq!(rows(&text).unwrap(), [row.to_string(), format!("1 {null}"), "EPSG:28992".into()]);
        // One feature a line, the system before.
        let text = format!("{{{crs},\"features\":[\n{one},\n{two}\n]}}\n");
        assert_eq!(rows(&text).unwrap(), [row.replacen('1', "2", 1), format!("3 {null}"), "EPSG:28992".into()]);
        // Newline-delimited, with and without record separators; pretty.
        for text in [format!("{one}\n{two}\n"), format!("\u{1e}{one}\n\u{1e}{two}")] {
            assert_eq!(rows(&text).unwrap(), [row.to_string(), format!("2 {null}")]);
        }
        let pretty: serde_json::Value = serde_json::from_str(&format!(r#"{{"features":[{one}]}}"#)).unwrap();
        let pretty = serde_json::to_string_pretty(&pretty).unwrap();
        assert_eq!(rows(&pretty).unwrap(), [row.replacen('1', "3", 1)]);
        // A bare geometry; nothing at all.
        assert_eq!(rows(POLYGON).unwrap(), ["1 Null [] Polygon [4, 3] [2] -"]);
        assert_eq!(rows("").unwrap(), [""; 0]);
        assert_eq!(rows(r#"{"type":"FeatureCollection","features":[]}"#).unwrap(), [""; 0]);
    }

    #[test]
    fn odd_geometries() {
        let of =
            |g: &str| rows(&format!(r#"{{"type":"Feature","geometry":{g}}}"#)).unwrap().remove(0)[10..].to_string();
        assert_eq!(
            of(r#"{"coordinates":[[[[0,0],[1,0],[0,1]]],[[[5,5],[6,5],[5,6]]]],"type":"MultiPolygon"}"#),
            "MultiPolygon [3, 3] [1, 2] -"
        );
        assert_eq!(of(r#"{"type":"Polygon","coordinates":[]}"#), "Polygon [] [] -");
        assert_eq!(of(r#"{"type":"LineString","coordinates":[[0,0],[1,1]]}"#), "LineString [2] [] -");
        assert_eq!(
            of(r#"{"type":"Polygon","coordinates":[[0,0],[1,1]]}"#),
            "Polygon [2] [] coordinates nested otherwise than the geometry's type says"
        );
        assert_eq!(
            of(r#"{"type":"Polygon","coordinates":[[[0,NaN],[1,1],[2,2]]]}"#),
            "Polygon [3] [1] a coordinate that is not finite"
        );
        assert_eq!(
            of(r#"{"type":"Polygon","coordinates":[[[0,null],[1,1],["a",2]]]}"#),
            "Polygon [1] [1] coordinates that are not numbers"
        );
        assert_eq!(of(r#"{"type":"GeometryCollection","geometries":[]}"#), "GeometryCollection [] [] -");
        assert_eq!(of(r#"{"type":"Point","coordinates":[1]}"#), "Point [] [] a position of one number");
    }

    #[test]
    fn broken_files() {
        let e = |t: &str| rows(t).unwrap_err().to_string();
        assert_eq!(
            e("{\"features\":[\n{\"type\":\"Feature\"},\n{\"type\":\"Feature\" 1}]}"),
            "a.geojson:3: broken JSON: expected `,` or `}`"
        );
        assert_eq!(e("{\"features\":[\n{\"type\":\"Feature\"}\n"), "a.geojson:2: broken JSON: the text ends too early");
        assert_eq!(e("[1]"), "a.geojson:1: broken JSON: expected `{`");
        assert!(e(r#"{"type":"CityJSON","version":"2.0"}"#).contains("read-cityjson"));
        assert!(e(r#"{"a":1}"#).contains("not GeoJSON"));
    }
}
