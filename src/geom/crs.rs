//! Coordinate reference systems by name: EPSG codes in every spelling that files use, and the way to lon/lat.
//!
//! Datum shifts are proj4rs' (seven parameters: 0.25 to 1 m for national datums such as RD New). proj4rs uses the
//! platform's sine, so what comes from it is rounded: see [`Crs::lonlat`].

use proj4rs::Proj;
use proj4rs::transform::transform;

/// A system that cannot be used, or a point that it does not have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CrsError {
    pub message: String,
    /// What the user or the file said.
    pub value: String,
}

impl CrsError {
    pub fn new(message: impl Into<String>, value: impl Into<String>) -> Self {
        Self { message: message.into(), value: value.into() }
    }
}

impl std::fmt::Display for CrsError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for CrsError {}

/// A system that a file or a user names.
#[derive(Clone, Debug)]
pub struct Crs {
    /// `"EPSG:7415"`, `"OGC:CRS84"`.
    pub name: String,
    pub kind: CrsKind,
    /// Heights belong to a national system, not to the ellipsoid.
    pub national_heights: bool,
    proj: Option<Proj>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CrsKind {
    /// Lon, lat in degrees.
    Degrees,
    /// East, north; a unit is so many metres. Lengths are true but for a thousandth or so.
    Metres(f64),
    /// East, north; lengths are not true (web Mercator).
    Stretched,
}

/// RFC 7946: what GeoJSON is in when it does not say.
pub const LONLAT: &str = "OGC:CRS84";

impl Crs {
    /// WGS 84 lon, lat in degrees.
    pub fn lonlat_degrees() -> Self {
        Self { name: LONLAT.into(), kind: CrsKind::Degrees, national_heights: false, proj: None }
    }

    /// `EPSG:28992`, `28992`, `urn:ogc:def:crs:EPSG::7415`, `https://www.opengis.net/def/crs/EPSG/0/7415`,
    /// `urn:ogc:def:crs:OGC:1.3:CRS84`, `EPSG:28992+5709`, `urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::5709`.
    pub fn parse(text: &str) -> Result<Self, CrsError> {
        let unknown = || CrsError::new(format!("unknown coordinate reference system `{text}`"), text);
        let upper = text.trim().to_ascii_uppercase();
        if upper.ends_with("CRS84") || upper.ends_with("CRS84H") {
            return Ok(Self::lonlat_degrees());
        }
        // The first run of digits that ends a part is the code; versions (`0`, `1.3`, `9.8.5`) stand before it.
        let main = upper.split([',', '+']).find(|p| p.ends_with(|c: char| c.is_ascii_digit())).ok_or_else(unknown)?;
        let digits = main.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap_or_default();
        let prefix = &main[..main.len() - digits.len()];
        if !(prefix.is_empty() || prefix.contains("EPSG")) {
            return Err(unknown());
        }
        let compound = upper.matches([',', '+']).count() > usize::from(upper.starts_with("URN:OGC:DEF:CRS,"));
        let code: u16 = digits.parse().map_err(|_| unknown())?;
        let def = crs_definitions::from_code(code).ok_or_else(unknown)?;
        let name = if compound { format!("EPSG:{}", numbers(&upper)) } else { format!("EPSG:{code}") };
        Self::of_proj(name, def.proj4, compound || def.proj4.contains("+vunits"))
            .map_err(|why| CrsError::new(format!("cannot use the coordinate reference system `{text}`: {why}"), text))
    }

    fn of_proj(name: String, text: &str, national_heights: bool) -> Result<Self, String> {
        // Grid files are not shipped: without them the datum is taken as WGS 84.
        let text: Vec<&str> = text.split_whitespace().filter(|p| !p.starts_with("+nadgrids")).collect();
        let text = text.join(" ");
        let proj = Proj::from_proj_string(&text).map_err(|e| e.to_string())?;
        if proj.is_geocent() {
            return Err("its coordinates are geocentric; convert to a projected system first".into());
        }
        if !proj.has_inverse() {
            return Err(format!("projection `{}` has no way back to lon/lat", proj.projname()));
        }
        if proj.is_latlong() {
            let as_good_as_wgs84 = text.contains("+datum=WGS84")
                || text.contains("+datum=NAD83")
                || text.contains("+towgs84=0,0,0,0,0,0,0")
                || !(text.contains("+datum") || text.contains("+towgs84") || text.contains("+pm"));
            let proj = (!as_good_as_wgs84).then_some(proj);
            return Ok(Self { name, kind: CrsKind::Degrees, national_heights, proj });
        }
        let kind = match proj.projname() {
            "merc" => CrsKind::Stretched,
            _ => CrsKind::Metres(proj.to_meter()),
        };
        Ok(Self { name, kind, national_heights, proj: Some(proj) })
    }

    /// Its coordinates are those of WGS 84.
    pub fn is_lonlat(&self) -> bool {
        self.kind == CrsKind::Degrees && self.proj.is_none()
    }

    /// Lon, lat in degrees on WGS 84, rounded to 1e-10 degrees (10 micrometres) where proj4rs has a hand in it.
    pub fn lonlat(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        let Some(proj) = &self.proj else { return Some(p) };
        let mut q = match self.kind {
            CrsKind::Degrees => (p[0].to_radians(), p[1].to_radians(), 0.0),
            _ => (p[0], p[1], 0.0),
        };
        transform(proj, world(), &mut q).ok()?;
        let rounded = |v: f64| (v.to_degrees() * 1e10).round() / 1e10;
        (q.0.is_finite() && q.1.is_finite()).then(|| [rounded(q.0), rounded(q.1)])
    }

    /// The other way, rounded to a hundredth of a millimetre.
    pub fn of_lonlat(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        let Some(proj) = &self.proj else { return Some(p) };
        let mut q = (p[0].to_radians(), p[1].to_radians(), 0.0);
        transform(world(), proj, &mut q).ok()?;
        let (q, unit) = match self.kind {
            CrsKind::Degrees => ([q.0.to_degrees(), q.1.to_degrees()], 1e10),
            _ => ([q.0, q.1], 1e5),
        };
        (q[0].is_finite() && q[1].is_finite()).then(|| q.map(|v| (v * unit).round() / unit))
    }
}

fn world() -> &'static Proj {
    static WORLD: std::sync::LazyLock<Proj> = std::sync::LazyLock::new(|| {
        Proj::from_proj_string("+proj=longlat +datum=WGS84 +no_defs").expect("proj4rs knows WGS 84")
    });
    &WORLD
}

/// `28992+5709` of a compound spelling.
fn numbers(upper: &str) -> String {
    let parts = upper.split([',', '+']).filter(|p| p.ends_with(|c: char| c.is_ascii_digit()));
    let codes = parts.map(|p| p.rsplit(|c: char| !c.is_ascii_digit()).next().unwrap_or_default());
    codes.collect::<Vec<_>>().join("+")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spellings() {
        for text in [
            "EPSG:28992",
            "28992",
            "epsg:28992",
            "urn:ogc:def:crs:EPSG::28992",
            "https://www.opengis.net/def/crs/EPSG/0/28992",
            "http://www.opengis.net/def/crs/EPSG/9.8.5/28992",
        ] {
            let crs = Crs::parse(text).unwrap();
            assert_eq!(
                (crs.name.as_str(), crs.kind, crs.national_heights),
                ("EPSG:28992", CrsKind::Metres(1.0), false)
            );
        }
        for text in ["urn:ogc:def:crs:OGC:1.3:CRS84", "OGC:CRS84", "http://www.opengis.net/def/crs/OGC/0/CRS84h"] {
            assert_eq!(Crs::parse(text).unwrap().name, LONLAT);
        }
        for text in ["EPSG:28992+5709", "urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::5709"] {
            let crs = Crs::parse(text).unwrap();
            assert_eq!((crs.name.as_str(), crs.national_heights), ("EPSG:28992+5709", true));
            assert_eq!(Crs::parse(&crs.name).unwrap().name, crs.name);
        }
        assert!(Crs::parse("urn:ogc:def:crs:EPSG::7415").unwrap().national_heights);
        assert_eq!(Crs::parse("EPSG:6697").unwrap().kind, CrsKind::Degrees);
        assert_eq!(Crs::parse("EPSG:3857").unwrap().kind, CrsKind::Stretched);
        for text in ["", "EPSG:", "EPSG:1", "EPSG:99999999", "ESRI:102100", "EPSG:4978", "WGS 84"] {
            assert!(Crs::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn rd_new_on_the_globe() {
        // The tower in Amersfoort is RD's origin: 52.15517 N, 5.38720 E on ETRS89.
        let rd = Crs::parse("EPSG:7415").unwrap();
        let p = rd.lonlat([155_000.0, 463_000.0]).unwrap();
        assert!((p[0] - 5.387_206).abs() < 2e-5 && (p[1] - 52.155_174).abs() < 2e-5, "{p:?}");
        let back = rd.of_lonlat(p).unwrap();
        assert!((back[0] - 155_000.0).abs() < 1e-3 && (back[1] - 463_000.0).abs() < 1e-3, "{back:?}");
    }
}
