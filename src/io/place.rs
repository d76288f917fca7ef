//! Which frame the coordinates of an input get, and which features have no place in it.

use crate::diag::{Diagnostic, Report, Result};
use crate::geom::crs::{Crs, CrsKind, LONLAT};
use crate::geom::frame::{Frame, Projection, Projector};

/// What coordinates mean where nobody says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsaid {
    /// RFC 7946, if they look like it.
    LonLat,
    Local,
}

/// What a file, or an object in it, says of its system.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Said {
    Name(String),
    Nothing,
    /// There is none, not even lon/lat.
    NoSystem,
    /// Something that cannot be read.
    Odd,
}

/// A frame for features, and those that have no place in it.
pub struct Placed {
    pub frame: Frame,
    pub projector: Projector,
    /// Why feature i has none.
    pub causes: Vec<Option<&'static str>>,
}

/// Smallest and largest coordinates of a feature: min x, min y, max x, max y in source coordinates.
pub type Bounds = [f64; 4];

/// The box of nothing.
pub const NOWHERE: Bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];

pub fn bounds_of(points: &[[f64; 2]]) -> Bounds {
    points.iter().fold(NOWHERE, |b, p| [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])])
}

/// Higher buildings, and ground higher or lower than that, are mistakes (metres).
pub const HIGHEST: f64 = 10_000.0;

/// No projected system reaches farther (metres or feet).
const FARTHEST: f64 = 1e8;

/// The system: `crs` as the user says, else what the files say (all the same), else `unsaid`.
/// Coordinates that the system cannot have cost their feature; the others choose the frame.
pub fn place(
    bounds: &[Bounds],
    crs: &str,
    said: &[(String, Said)],
    unsaid: Unsaid,
    origin: Option<[f64; 2]>,
    report: &Report,
) -> Result<Placed> {
    let crs = if crs.is_empty() { from_files(said, unsaid, report)? } else { Some(Crs::parse(crs)?) };
    let unsaid = if said.iter().any(|s| s.1 == Said::NoSystem) { Unsaid::Local } else { unsaid };
    let degrees = |b: &Bounds| b[0] >= -180.0 && b[2] <= 180.0 && b[1] >= -90.0 && b[3] <= 90.0;
    let crs = match crs {
        None if unsaid == Unsaid::LonLat => {
            // One broken coordinate must not make metres of degrees.
            if 2 * bounds.iter().filter(|b| degrees(b)).count() > bounds.len() {
                Some(Crs::parse(LONLAT)?)
            } else {
                report.warn("coordinates are neither named by `crs` nor lon/lat: taken as metres of an unknown system");
                None
            }
        }
        crs => crs,
    };
    if let Some(crs) = crs.as_ref().filter(|c| c.national_heights) {
        report.warn(format!(
            "heights of `{}` belong to a national system but are taken as ellipsoidal; `height-offset` of write-tileset mends it",
            crs.name
        ));
    }
    let in_degrees = crs.as_ref().is_some_and(|c| c.kind == CrsKind::Degrees);
    let mut causes: Vec<Option<&'static str>> = bounds
        .iter()
        .map(|b| {
            if in_degrees {
                (!degrees(b)).then_some("a coordinate outside lon -180 to 180, lat -90 to 90")
            } else {
                (!b.iter().all(|v| v.abs() <= FARTHEST)).then_some("a coordinate beyond 100,000 km")
            }
        })
        .collect();
    let mut all = NOWHERE;
    for (b, cause) in bounds.iter().zip(&mut causes) {
        // A system may not reach everywhere.
        let outside = |crs: &Crs| crs.lonlat([b[0], b[1]]).is_none() || crs.lonlat([b[2], b[3]]).is_none();
        if cause.is_none() && crs.as_ref().is_some_and(|c| c.kind == CrsKind::Stretched && outside(c)) {
            *cause = Some("a coordinate outside the coordinate reference system");
        }
        if cause.is_none() {
            all = [all[0].min(b[0]), all[1].min(b[1]), all[2].max(b[2]), all[3].max(b[3])];
        }
    }
    if all == NOWHERE {
        all = [0.0; 4];
    }
    let frame = Frame::choose(crs.as_ref(), all, origin)?;
    let projector = frame.projector()?;
    Ok(Placed { frame, projector, causes })
}

/// The system that the files name; they must agree, and a file that names none must mean the same.
fn from_files(said: &[(String, Said)], unsaid: Unsaid, report: &Report) -> Result<Option<Crs>> {
    let mut found: Option<(&str, Crs)> = None;
    for (file, said) in said {
        let Said::Name(name) = said else { continue };
        let crs = Crs::parse(name).map_err(|e| {
            Diagnostic::error("bad-crs", format!("{file}: {}", e.message))
                .value(name)
                .help("say it by `crs = \"EPSG:..\"`")
        })?;
        match &found {
            Some((first, other)) if other.name != crs.name => {
                let message = format!("`{first}` is in `{}` but `{file}` in `{}`", other.name, crs.name);
                return Err(Diagnostic::error("bad-crs", message).help("read them by a node each"));
            }
            Some(_) => {}
            None => found = Some((file, crs)),
        }
    }
    if let Some((file, _)) = said.iter().find(|s| s.1 == Said::Odd) {
        let what = "a `crs` that is neither a name nor null is not read";
        report.warn(format!("`{file}`: {what}; say it by `crs = \"EPSG:..\"`"));
    }
    let Some((first, crs)) = found else { return Ok(None) };
    let others = || said.iter().filter(|s| !matches!(s.1, Said::Name(_)));
    let none = others().find(|s| s.1 == Said::NoSystem).map(|s| (s, "says that it has none"));
    let lonlat = || others().next().filter(|_| !crs.is_lonlat()).map(|s| (s, "names none, which means lon/lat"));
    if let Some(((file, _), what)) = none.or_else(|| lonlat().filter(|_| unsaid == Unsaid::LonLat)) {
        let message = format!("`{first}` is in `{}` but `{file}` {what}", crs.name);
        let help = "read them by a node each, or say the system of all by `crs`";
        return Err(Diagnostic::error("bad-crs", message).help(help));
    }
    if let (Unsaid::Local, Some((file, _))) = (unsaid, others().next()) {
        let more = match others().count() - 1 {
            0 => String::new(),
            n => format!(" (nor do {n} more)"),
        };
        report.warn(format!("`{file}` names no system{more}: taken to be in `{}`, as `{first}` is", crs.name));
    }
    Ok(Some(crs))
}

/// What to say where a feature lies too far from the frame's origin.
pub fn too_far(id: &str, place: &str, frame: &Frame) -> Box<Diagnostic> {
    let [x, y] = match frame.projection {
        Projection::Local { origin } | Projection::Projected { origin } | Projection::TransverseMercator { origin } => {
            origin
        }
    };
    let message = format!("`{id}` ({place}) lies farther than 2^29 mm (537 km) from the frame's origin, {x}, {y}");
    Diagnostic::error("too-far", message).help("leave out what lies far away by `where`, or pin `origin`")
}
