//! Layers as a FeatureCollection, a feature a line, in the input's system: within 2 mm of its coordinates.

use std::io::Write;

use crate::artifact::{Attributes, Footprints, Hulls, Lines, Values};
use crate::diag::Result;
use crate::geom::Point;
use crate::geom::crs::LONLAT;
use crate::geom::frame::{Frame, Projector};
use crate::geom::predicates::orient;

/// Properties: `id`, `base`, `height` (above it), and the attributes that are not called so.
pub fn footprints(layer: &Footprints) -> Result<Vec<u8>> {
    let mut out = Collection::start(&layer.frame)?;
    for i in 0..layer.len() {
        let id = layer.ids.get(i);
        out.feature(Some(id));
        out.text("id", id);
        out.number("base", layer.base[i]);
        out.number("height", layer.top[i] - layer.base[i]);
        out.attributes(&layer.attributes, i, &["id", "base", "height"]);
        let polygons = layer.polygons.polygons_of(i);
        let rings = |out: &mut Collection, p: usize| {
            let rings: Vec<&[Point]> = layer.polygons.rings_of(p).map(|r| layer.polygons.ring(r)).collect();
            out.rings(&rings);
        };
        if polygons.len() == 1 {
            out.geometry("Polygon");
            rings(&mut out, polygons.start);
        } else {
            out.geometry("MultiPolygon");
            out.list(polygons, rings);
        }
        out.end(true);
    }
    Ok(out.finish())
}

/// Property: `id`.
pub fn lines(layer: &Lines) -> Result<Vec<u8>> {
    let mut out = Collection::start(&layer.frame)?;
    for i in 0..layer.len() {
        let id = layer.ids.get(i);
        out.feature(Some(id));
        out.text("id", id);
        out.geometry("LineString");
        out.points(layer.line(i).iter().copied());
        out.end(true);
    }
    Ok(out.finish())
}

/// Properties: `cluster`, `parent` (null at the root, and in a cut), `buildings`, `edges` (without collinear
/// vertices), `merged_edges`, `area_m2`, `negative_space_m2`, `ground`, `height`. A node without a ring has no
/// geometry.
pub fn hulls(layer: &Hulls) -> Result<Vec<u8>> {
    let mut out = Collection::start(&layer.frame)?;
    for i in 0..layer.len() {
        let ring: Vec<Point> = layer.points(i).collect();
        out.feature(None);
        out.whole("cluster", layer.cluster[i]);
        match layer.parent[i] {
            u32::MAX => out.raw("parent", "null"),
            parent => out.whole("parent", parent),
        }
        out.whole("buildings", layer.buildings[i]);
        out.whole("edges", corners(&ring));
        out.whole("merged_edges", layer.merged_edges[i]);
        out.number("area_m2", layer.area_m2[i]);
        out.number("negative_space_m2", layer.negative_space_m2[i]);
        out.number("ground", layer.ground[i]);
        out.number("height", layer.height[i]);
        if ring.is_empty() {
            out.end(false);
        } else {
            out.geometry("Polygon");
            out.rings(&[&ring]);
            out.end(true);
        }
    }
    Ok(out.finish())
}

/// Vertices at which a ring turns.
fn corners(ring: &[Point]) -> u32 {
    let n = ring.len();
    (0..n).filter(|&k| orient(ring[(k + n - 1) % n], ring[k], ring[(k + 1) % n]) != 0).count() as u32
}

/// A FeatureCollection being written.
struct Collection {
    out: Vec<u8>,
    way: Projector,
    /// 10 to the number of decimals: 8 of degrees (1.1 mm), 3 of metres.
    unit: i64,
    features: u64,
    properties: u64,
}

impl Collection {
    fn start(frame: &Frame) -> Result<Self> {
        let way = frame.projector()?;
        let mut out = b"{\"type\":\"FeatureCollection\",".to_vec();
        // RFC 7946 is lon/lat; other systems as GeoJSON 2008 said them; null is none at all.
        match frame.crs.as_str() {
            LONLAT => {}
            "" => out.extend(b"\"crs\":null,"),
            name => {
                let name = serde_json::to_string(&urn(name)).expect("a text");
                write!(out, "\"crs\":{{\"type\":\"name\",\"properties\":{{\"name\":{name}}}}},").expect("memory");
            }
        }
        out.extend(b"\"features\":[");
        let unit = if way.degrees() { 100_000_000 } else { 1000 };
        Ok(Self { out, way, unit, features: 0, properties: 0 })
    }

    fn feature(&mut self, id: Option<&str>) {
        self.out.extend(if self.features > 0 { &b",\n"[..] } else { b"\n" });
        self.features += 1;
        self.properties = 0;
        self.out.extend(b"{\"type\":\"Feature\",");
        if let Some(id) = id {
            self.out.extend(b"\"id\":");
            self.value(&id);
            self.out.push(b',');
        }
        self.out.extend(b"\"properties\":{");
    }

    /// Anything that serde_json writes: numbers in their shortest exact form.
    fn value(&mut self, value: &impl serde::Serialize) {
        serde_json::to_writer(&mut self.out, value).expect("plain data into memory");
    }

    fn key(&mut self, key: &str) {
        if self.properties > 0 {
            self.out.push(b',');
        }
        self.properties += 1;
        self.value(&key);
        self.out.push(b':');
    }

    fn raw(&mut self, key: &str, value: &str) {
        self.key(key);
        self.out.extend(value.as_bytes());
    }
    fn text(&mut self, key: &str, value: &str) {
        self.key(key);
        self.value(&value);
    }
    fn whole(&mut self, key: &str, value: u32) {
        self.key(key);
        self.value(&value);
    }
    /// Rounded to a ten-millionth, so that sums look like what was summed.
    fn number(&mut self, key: &str, value: f64) {
        self.key(key);
        self.value(&((value * 1e7).round() / 1e7 + 0.0));
    }

    fn attributes(&mut self, all: &Attributes, row: usize, but: &[&str]) {
        for c in all.columns.iter().filter(|c| c.present[row] && !but.contains(&c.name.as_str())) {
            self.key(&c.name);
            match &c.values {
                Values::U32(v) => self.value(&v[row]),
                Values::I32(v) => self.value(&v[row]),
                Values::F64(v) => self.value(&v[row]),
                Values::Bool(v) => self.value(&v[row]),
                Values::Text(v) => self.value(&v.get(row)),
            }
        }
    }

    fn geometry(&mut self, kind: &str) {
        write!(self.out, "}},\"geometry\":{{\"type\":\"{kind}\",\"coordinates\":").expect("memory");
    }

    fn end(&mut self, has_geometry: bool) {
        self.out.extend(if has_geometry { &b"}}"[..] } else { b"},\"geometry\":null}" });
    }

    fn list<T>(&mut self, all: impl Iterator<Item = T>, mut each: impl FnMut(&mut Self, T)) {
        self.out.push(b'[');
        for (k, item) in all.enumerate() {
            if k > 0 {
                self.out.push(b',');
            }
            each(self, item);
        }
        self.out.push(b']');
    }

    /// Open rings, written closed.
    fn rings(&mut self, rings: &[&[Point]]) {
        self.list(rings.iter(), |out, ring| out.points(ring.iter().chain(ring.first()).copied()));
    }

    fn points(&mut self, points: impl Iterator<Item = Point>) {
        self.list(points, |out, p| {
            let q = out.way.source(p);
            out.list(q.into_iter(), |out, v| fixed(&mut out.out, (v * out.unit as f64).round() as i64, out.unit));
        });
    }

    fn finish(mut self) -> Vec<u8> {
        self.out.extend(b"\n]}\n");
        self.out
    }
}

/// `v / unit` in decimals, without trailing zeros. `unit` is a power of ten.
fn fixed(out: &mut Vec<u8>, v: i64, unit: i64) {
    if v < 0 {
        out.push(b'-');
    }
    let (whole, mut rest) = (v.unsigned_abs() / unit as u64, v.unsigned_abs() % unit as u64);
    write!(out, "{whole}").expect("memory");
    if rest > 0 {
        out.push(b'.');
        let mut place = unit as u64 / 10;
        while rest > 0 {
            out.push(b'0' + (rest / place) as u8);
            rest %= place;
            place /= 10;
        }
    }
}

/// `urn:ogc:def:crs:EPSG::28992`; of a compound system the form with commas.
fn urn(name: &str) -> String {
    match name.strip_prefix("EPSG:") {
        Some(codes) if codes.contains('+') => {
            let parts: Vec<String> = codes.split('+').map(|c| format!("crs:EPSG::{c}")).collect();
            format!("urn:ogc:def:crs,{}", parts.join(","))
        }
        Some(code) => format!("urn:ogc:def:crs:EPSG::{code}"),
        None => name.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::hulls::HullState;
    use crate::artifact::{Shapes, Table};
    use crate::geom::frame::Projection;
    use crate::io::geojson::{GeometryKind, read};
    use crate::io::place::Said;

    #[test]
    fn decimals() {
        let text = |v: i64, unit: i64| {
            let mut out = Vec::new();
            fixed(&mut out, v, unit);
            String::from_utf8(out).unwrap()
        };
        assert_eq!(
            [text(0, 1000), text(-5, 1000), text(1230, 1000), text(-12_000, 1000)],
            ["0", "-0.005", "1.23", "-12"]
        );
    }

    fn layer(frame: Frame) -> Footprints {
        let mut polygons = Shapes::default();
        for x in [0, 100_000] {
            polygons.push_ring(&[[x, 0], [x + 9_001, 0], [x + 9_001, 9_000], [x, 9_000]]);
            if x == 0 {
                polygons.push_ring(&[[3000, 3000], [3000, 6000], [6000, 6000], [6000, 3000]]);
                polygons.end_polygon();
                polygons.push_ring(&[[20_000, 0], [21_000, 0], [20_000, 1_000]]);
            }
            polygons.end_polygon();
            polygons.end_shape();
        }
        let mut table = Table::default();
        let c = table.column("name");
        table.set(1, c, crate::artifact::Cell::Text("ä\"b"));
        let (base, top) = (vec![0.0, 1.1], vec![3.0, 13.4]);
        Footprints { frame, ids: ["a", "7"].iter().collect(), polygons, base, top, attributes: table.finish(2) }
    }

    #[test]
    fn there_and_back() {
        for frame in [
            Frame { crs: LONLAT.into(), projection: Projection::TransverseMercator { origin: [139.65, 35.65] } },
            Frame { crs: "EPSG:7415".into(), projection: Projection::Projected { origin: [85_000.0, 447_000.0] } },
            Frame {
                crs: "EPSG:28992+5709".into(),
                projection: Projection::Projected { origin: [85_000.0, 447_000.0] },
            },
            Frame { crs: "EPSG:3857".into(), projection: Projection::TransverseMercator { origin: [139.65, 35.65] } },
            Frame::local(),
        ] {
            let layer = layer(frame.clone());
            let bytes = footprints(&layer).unwrap();
            let mut points = Vec::new();
            let mut kinds = Vec::new();
            let way = frame.projector().unwrap();
            let header = read("a", Box::new(std::io::Cursor::new(bytes.clone())), |f, g| {
                kinds.push((g.kind.clone(), f.properties.len()));
                for r in 0..g.rings.len() {
                    let ring = g.ring(r);
                    points.extend(
                        ring[..ring.len() - 1].iter().map(|&p| crate::geom::frame::grid(way.local(p)).unwrap()),
                    );
                }
                Ok(())
            })
            .unwrap();
            assert_eq!(kinds, [(GeometryKind::MultiPolygon, 3), (GeometryKind::Polygon, 4)]);
            let far =
                points.iter().zip(&layer.polygons.points).map(|(a, b)| (a[0] - b[0]).abs().max((a[1] - b[1]).abs()));
            assert!(far.max().unwrap() <= 1 && points.len() == layer.polygons.points.len(), "{frame:?}");
            let said: Vec<Said> = header.said("a").map(|s| s.1).collect();
            match &said[..] {
                [Said::Name(name)] => assert_eq!(crate::geom::crs::Crs::parse(name).unwrap().name, frame.crs),
                [Said::Nothing] => assert_eq!(frame.crs, LONLAT),
                [Said::NoSystem] => assert_eq!(frame.crs, ""),
                _ => panic!("{said:?}"),
            }
        }
    }

    #[test]
    fn hulls_have_the_documented_properties() {
        let layer = Hulls {
            frame: Frame::local(),
            state: HullState::Simplified,
            vertices: vec![[0, 0], [1000, 0], [2000, 0], [2000, 2000]],
            starts: vec![0, 0, 4],
            rings: vec![0, 1, 2, 3],
            cluster: vec![0, 1],
            parent: vec![1, u32::MAX],
            buildings: vec![1, 2],
            merged_edges: vec![0, 5],
            area_m2: vec![0.0, 2.0],
            negative_space_m2: vec![0.0, 0.1 + 0.2],
            ground: vec![0.0, -1.5],
            height: vec![3.0, 4.0],
        };
        let text = String::from_utf8(hulls(&layer).unwrap()).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], r#"{"type":"FeatureCollection","crs":null,"features":["#);
        assert_eq!(
            lines[1],
            r#"{"type":"Feature","properties":{"cluster":0,"parent":1,"buildings":1,"edges":0,"merged_edges":0,"area_m2":0.0,"negative_space_m2":0.0,"ground":0.0,"height":3.0},"geometry":null},"#
        );
        assert_eq!(
            lines[2],
            r#"{"type":"Feature","properties":{"cluster":1,"parent":null,"buildings":2,"edges":3,"merged_edges":5,"area_m2":2.0,"negative_space_m2":0.3,"ground":-1.5,"height":4.0},"geometry":{"type":"Polygon","coordinates":[[[0,0],[1,0],[2,0],[2,2],[0,0]]]}}"#
        );
    }
}
