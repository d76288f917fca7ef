//! The local frame: millimetres around an origin, and the origin's place on the globe.

use serde::{Deserialize, Serialize};

use super::crs::{Crs, CrsError, CrsKind};
use super::globe::{Globe, Way};
use super::mercator::Mercator;
use super::{LIMIT_MM, Point};

/// What the local coordinates were before their origin was taken off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Projection {
    /// Metres of an unknown system.
    Local { origin: [f64; 2] },
    /// Metres of the projected `crs`, shifted by `origin` (whole kilometres).
    Projected { origin: [f64; 2] },
    /// Transverse Mercator on WGS 84 (ellipsoidal, k = 1) around `origin` = lon, lat in degrees.
    TransverseMercator { origin: [f64; 2] },
}

/// Local metres = source coordinates by `projection`. Stored with every artifact that has coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// `"EPSG:28992"`, `"OGC:CRS84"`; empty where unknown.
    pub crs: String,
    pub projection: Projection,
}

impl Frame {
    /// A frame without a place on the globe.
    pub fn local() -> Self {
        Self { crs: String::new(), projection: Projection::Local { origin: [0.0, 0.0] } }
    }

    /// The frame of data that fills `bounds` (min x, min y, max x, max y in source coordinates): lon/lat around the
    /// middle rounded to 0.01 degree, metres around the middle rounded to whole kilometres, so that a small edit
    /// moves nothing. `origin`, in source coordinates, pins it.
    pub fn choose(crs: Option<&Crs>, bounds: [f64; 4], origin: Option<[f64; 2]>) -> Result<Self, CrsError> {
        let middle = [(bounds[0] + bounds[2]) / 2.0, (bounds[1] + bounds[3]) / 2.0];
        let to_km = |v: f64| (v / 1000.0).round() * 1000.0 + 0.0;
        let Some(crs) = crs else {
            let origin = origin.unwrap_or(middle.map(to_km));
            return Ok(Self { crs: String::new(), projection: Projection::Local { origin } });
        };
        let projection = match crs.kind {
            CrsKind::Metres(unit) => {
                let origin = origin.map(|o| o.map(|v| v * unit)).unwrap_or(middle.map(|v| to_km(v * unit)));
                Projection::Projected { origin }
            }
            CrsKind::Degrees | CrsKind::Stretched => {
                let place = origin.unwrap_or(middle);
                let place = crs
                    .lonlat(place)
                    .ok_or_else(|| CrsError::new(format!("{place:?} is outside `{}`", crs.name), &crs.name))?;
                let origin = if origin.is_some() { place } else { place.map(|v| (v * 100.0).round() / 100.0 + 0.0) };
                Projection::TransverseMercator { origin }
            }
        };
        Ok(Self { crs: crs.name.clone(), projection })
    }

    /// The way from source coordinates to local metres and back.
    pub fn projector(&self) -> Result<Projector, CrsError> {
        let crs = if self.crs.is_empty() { None } else { Some(Crs::parse(&self.crs)?) };
        Ok(match (self.projection, crs) {
            (Projection::TransverseMercator { origin }, crs) => {
                Projector(Step::Mercator(Mercator::new(origin), crs.unwrap_or_else(Crs::lonlat_degrees)))
            }
            (Projection::Projected { origin }, Some(Crs { kind: CrsKind::Metres(unit), .. })) => {
                Projector(Step::Shift { origin, unit })
            }
            (Projection::Projected { origin } | Projection::Local { origin }, _) => {
                Projector(Step::Shift { origin, unit: 1.0 })
            }
        })
    }

    /// The frame's place on the globe; none where the system is unknown.
    pub fn globe(&self) -> Result<Option<Globe>, CrsError> {
        Ok(match self.projection {
            Projection::Local { .. } => None,
            Projection::TransverseMercator { origin } => Some(Globe(Way::Mercator(Mercator::new(origin)))),
            Projection::Projected { origin } => {
                let crs = Crs::parse(&self.crs)?;
                let unit = if let CrsKind::Metres(unit) = crs.kind { unit } else { 1.0 };
                Some(Globe(Way::Projected { crs, origin, unit }))
            }
        })
    }

    /// Points of the frame `from`, moved into this one and back onto its grid. Frames of one system differ by a
    /// shift; others meet on the globe. An error where one has no place there, or a point lies too far away.
    pub fn adopt(&self, points: &[Point], from: &Frame) -> Result<Vec<Point>, CrsError> {
        use Projection::{Local, Projected};
        if self == from {
            return Ok(points.to_vec());
        }
        let step: Box<dyn Fn([f64; 2]) -> [f64; 2]> = match (self.projection, from.projection) {
            (Local { origin: to }, Local { origin }) => Box::new(move |p| shift(p, origin, to)),
            (Projected { origin: to }, Projected { origin }) if self.crs == from.crs => {
                Box::new(move |p| shift(p, origin, to))
            }
            (to, _) => {
                let unknown = || {
                    let message =
                        "a frame without a coordinate reference system cannot be joined with another; name it by `crs`";
                    CrsError::new(message, &from.crs)
                };
                let globe = from.globe()?.ok_or_else(unknown)?;
                let there = self.globe()?.ok_or_else(unknown)?;
                Box::new(move |p| {
                    let lonlat = globe.lonlat(p[0], p[1]);
                    match (&there.0, to) {
                        (Way::Mercator(m), _) => m.forward(lonlat),
                        (Way::Projected { crs, origin, unit }, _) => crs
                            .of_lonlat(lonlat)
                            .map_or([f64::NAN; 2], |q| [q[0] * unit - origin[0], q[1] * unit - origin[1]]),
                    }
                })
            }
        };
        let moved = points.iter().map(|&p| grid(step([f64::from(p[0]) / 1000.0, f64::from(p[1]) / 1000.0])));
        moved.collect::<Option<_>>().ok_or_else(|| {
            CrsError::new(
                "a point of the other input lies farther than 2^29 mm (537 km) from the frame's origin",
                &from.crs,
            )
        })
    }
}

fn shift(p: [f64; 2], from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
    [p[0] + (from[0] - to[0]), p[1] + (from[1] - to[1])]
}

/// Local metres to the millimetre grid, halves up; none farther than 2^29 mm (and of NaN).
#[inline]
pub fn grid(p: [f64; 2]) -> Option<Point> {
    let whole = |v: f64| {
        let v = v * 1000.0 + 0.5;
        // Not `floor`: without SSE 4.1 that is a call.
        let cut = if v.abs() < f64::from(LIMIT_MM) { v as i32 } else { return None };
        let down = cut - i32::from(f64::from(cut) > v);
        (down > -LIMIT_MM).then_some(down)
    };
    Some([whole(p[0])?, whole(p[1])?])
}

/// Source coordinates to local metres and back: `Frame::projector`.
#[derive(Clone, Debug)]
pub struct Projector(Step);

#[derive(Clone, Debug)]
enum Step {
    Shift { origin: [f64; 2], unit: f64 },
    Mercator(Mercator, Crs),
}

impl Projector {
    /// Local metres. NaN where the system does not reach.
    #[inline]
    pub fn local(&self, p: [f64; 2]) -> [f64; 2] {
        match &self.0 {
            Step::Shift { origin, unit } => [p[0] * unit - origin[0], p[1] * unit - origin[1]],
            Step::Mercator(m, crs) => crs.lonlat(p).map_or([f64::NAN; 2], |q| m.forward(q)),
        }
    }

    /// Source coordinates of a grid point: within a millimetre of what it came from.
    pub fn source(&self, p: Point) -> [f64; 2] {
        let p = p.map(|v| f64::from(v) / 1000.0);
        match &self.0 {
            Step::Shift { origin, unit } => [(p[0] + origin[0]) / unit, (p[1] + origin[1]) / unit],
            Step::Mercator(m, crs) => crs.of_lonlat(m.inverse(p)).unwrap_or([f64::NAN; 2]),
        }
    }

    /// Where the way is a shift only: the origin in metres, and metres a unit of the source.
    pub fn shift(&self) -> Option<([f64; 2], f64)> {
        match self.0 {
            Step::Shift { origin, unit } => Some((origin, unit)),
            Step::Mercator(..) => None,
        }
    }

    /// Source coordinates are degrees.
    pub fn degrees(&self) -> bool {
        matches!(&self.0, Step::Mercator(_, crs) if crs.kind == CrsKind::Degrees)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_edit_moves_nothing() {
        let lonlat = Crs::lonlat_degrees();
        let a = Frame::choose(Some(&lonlat), [139.6, 35.6, 139.7, 35.7], None).unwrap();
        let b = Frame::choose(Some(&lonlat), [139.6, 35.6, 139.7001, 35.7], None).unwrap();
        assert_eq!(a, b);
        assert_eq!(a.projection, Projection::TransverseMercator { origin: [139.65, 35.65] });
        let rd = Crs::parse("EPSG:7415").unwrap();
        let f = Frame::choose(Some(&rd), [84_386.9, 446_948.3, 85_040.6, 447_638.5], None).unwrap();
        assert_eq!(f.projection, Projection::Projected { origin: [85_000.0, 447_000.0] });
        let f = Frame::choose(None, [-10.0, -10.0, 10.0, 10.0], None).unwrap();
        assert_eq!(f, Frame::local());
    }

    #[test]
    fn there_and_back() {
        for (name, p) in [
            ("OGC:CRS84", [139.6625134, 35.6320086]),
            ("EPSG:28992", [84_956.106, 447_256.086]),
            ("EPSG:3857", [15_546_000.25, 4_250_000.75]),
            ("EPSG:2263", [987_654.321, 201_234.567]),
        ] {
            let crs = Crs::parse(name).unwrap();
            let frame = Frame::choose(Some(&crs), [p[0], p[1], p[0] + 0.01, p[1] + 0.01], None).unwrap();
            let way = frame.projector().unwrap();
            let q = way.source(grid(way.local(p)).unwrap());
            let unit = if way.degrees() { 111_320.0 } else { 1.0 };
            assert!((0..2).all(|k| (q[k] - p[k]).abs() * unit < 2.5e-3), "{name}: {p:?} {q:?}");
        }
    }

    #[test]
    fn frames_meet_on_the_globe() {
        let rd =
            Frame { crs: "EPSG:28992".into(), projection: Projection::Projected { origin: [85_000.0, 447_000.0] } };
        let other = Frame { projection: Projection::Projected { origin: [84_000.0, 447_000.0] }, ..rd.clone() };
        let points = [[0, 0], [123_456, -654_321]];
        assert_eq!(rd.adopt(&points, &other).unwrap(), [[-1_000_000, 0], [-876_544, -654_321]]);
        let lonlat =
            Frame { crs: "OGC:CRS84".into(), projection: Projection::TransverseMercator { origin: [4.36, 52.0] } };
        let there = lonlat.adopt(&points, &rd).unwrap();
        let back = rd.adopt(&there, &lonlat).unwrap();
        for (a, b) in points.iter().zip(&back) {
            assert!((a[0] - b[0]).abs() <= 1 && (a[1] - b[1]).abs() <= 1, "{a:?} {b:?}");
        }
        assert!(lonlat.adopt(&points, &Frame::local()).is_err());
        let far =
            Frame { crs: "OGC:CRS84".into(), projection: Projection::TransverseMercator { origin: [20.0, 52.0] } };
        assert!(far.adopt(&points, &rd).is_err());
    }

    #[test]
    fn the_globe_agrees_with_the_frame() {
        let frame =
            Frame { crs: "OGC:CRS84".into(), projection: Projection::TransverseMercator { origin: [139.65, 35.65] } };
        let globe = frame.globe().unwrap().unwrap();
        let p = globe.lonlat(1234.5, -987.6);
        let q = frame.projector().unwrap().local(p);
        assert!((q[0] - 1234.5).abs() < 1e-6 && (q[1] + 987.6).abs() < 1e-6);
        assert!(Frame::local().globe().unwrap().is_none());
    }

    #[test]
    fn the_edge_of_the_grid() {
        assert_eq!(grid([536_870.911, 0.0005]), Some([536_870_911, 1]));
        assert_eq!(grid([536_870.912, 0.0]), None);
        assert_eq!(grid([-536_870.911, 0.0]), Some([-536_870_911, 0]));
        assert_eq!(grid([-536_870.912, 0.0]), None);
        assert_eq!(grid([-536_870.911_8, 0.0]), None);
        assert_eq!(grid([f64::NAN, 0.0]), None);
        assert_eq!(grid([-0.0005, -0.0006]), Some([0, -1]));
    }
}
