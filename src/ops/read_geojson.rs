//! Read building footprints and their heights from GeoJSON.
//!
//! In:     files: a FeatureCollection in any layout, or features one after the other; plain or gzipped.
//! Out:    n footprints on the millimetre grid of a local frame, in input order; metres. A MultiPolygon is one.
//! Height: the first of `height` that can be read (a number, or a text such as "12.5" or "12 m"), else `levels` of
//!         3 m, else `default-height`; all counted. A height of 0 or less rejects its feature.
//! Errors: broken JSON (with its line), a file cut off, two coordinate systems (no `crs` is lon/lat; the parameter
//!         `crs` settles it), an attribute that no feature has, nothing left, too many rejects,
//!         a feature farther than 2^29 mm from the origin.
//! Facts:  read = accepted + rejected + filtered; filtered_by_where, filtered_by_type, rejected_by_cause,
//!         repaired_by_cause; heights_from_levels, defaulted_heights, unreadable_heights.
//! Cost:   linear; one thread unpacks, one parses, then all project.

use rayon::prelude::*;

use crate::artifact::{Footprints, Shapes, Strings, Table};
use crate::diag::{Diagnostic, Note, Result};
use crate::geom::Point;
use crate::geom::frame::{Projector, grid};
use crate::geom::repair::{self, Repairs};
use crate::io::geojson::{self, Feature, Geometry, GeometryKind};
use crate::io::ledger::{self, Ledger, Needed};
use crate::io::pick::{self, Metres, Names, Seen, Where};
use crate::io::place::{Bounds, HIGHEST, Placed, Said, Unsaid, bounds_of, place, too_far};
use crate::io::reader::{account, crs_mistake, is_packed};
use crate::op::{Ctx, Mistake, Op, Source};
use crate::{inputs, reader_params};

reader_params! {
    /// Building footprints and their heights from GeoJSON files.
    pub struct ReadGeojson {
        /// The building's height: an attribute in metres (of a list the first present), or a number for all.
        #[schemars(extend("x-unit" = "m"))]
        pub height: Metres = Metres::of(&["height", "measuredHeight"]),
        /// The ground below it: an attribute in metres (of a list the first present), or a number for all. Features
        /// without it stand on 0.
        #[schemars(extend("x-unit" = "m"))]
        pub base: Metres = Metres::Value(0.0),
        /// Number of storeys, of 3 m each, for features without a height.
        pub levels: Names = Names::of(&["levels", "building:levels"]),
        /// Height of features that have neither.
        #[schemars(range(min = 0.01, max = 10000.0), extend("x-unit" = "m"))]
        pub default_height: f64 = 3.0,
        /// Attribute that names the building (of a list the first present). An empty list: the feature's own id, the
        /// attribute `id`, or the row.
        pub id: Names = Names::of(&[]),
        /// Only features whose attributes have these values (or one of a list).
        pub r#where: Where = Where::new(),
    }
}

inputs! {}

impl Op for ReadGeojson {
    const NAME: &'static str = "read-geojson";
    const VERSION: u32 = 2;
    type In = In;
    type Out = Footprints;
    const FACTS: &'static [(&'static str, &'static str)] = &ledger::facts::<5, 11>([
        ledger::BY_WHERE,
        ledger::BY_TYPE,
        ("heights_from_levels", "buildings whose height is their storeys times 3 m"),
        ("defaulted_heights", "buildings that got `default-height`"),
        ("unreadable_heights", "buildings with a height that is no number of metres"),
    ]);

    fn check(&self) -> Vec<Mistake> {
        let mut out = Vec::new();
        if let Metres::Value(v) = self.height
            && !(v > 0.0 && v <= HIGHEST)
        {
            out.push(Mistake {
                param: "height",
                message: format!("`height` must be above 0 and at most {HIGHEST} m, got {v}"),
            });
        }
        out.extend(crs_mistake(&self.crs).map(|message| Mistake { param: "crs", message }));
        out
    }

    fn run(&self, ctx: &Ctx, _: In) -> Result<Footprints> {
        account(ctx.report, "buildings", Needed::One { max_rejected: self.max_rejected }, |ledger| {
            settle(gather(self, ctx, ledger)?, self, ctx, ledger)
        })
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        // Packed text is up to seven times as long.
        (4 << 20) + if is_packed(&self.path) { 9 * input_bytes } else { 3 * input_bytes / 2 }
    }
}

/// Metres of a storey.
const LEVEL: f64 = 3.0;

/// Features as the files have them: coordinates in the source's system.
#[derive(Default)]
struct Draft {
    ids: Strings,
    /// Of each feature: file, line, row.
    from: Vec<(u32, u32, u64)>,
    bounds: Vec<Bounds>,
    shapes: Shapes<[f64; 2]>,
    base: Vec<f64>,
    height: Vec<f64>,
    table: Table,
    files: Vec<String>,
    said: Vec<(String, Said)>,
}

/// How often heights came from where.
#[derive(Default)]
struct Heights {
    from_levels: u64,
    defaulted: u64,
    unreadable: u64,
}

/// Reads the features of all files that have a polygon, an id and a height.
fn gather(params: &ReadGeojson, ctx: &Ctx, ledger: &mut Ledger) -> Result<Draft> {
    let mut draft = Draft::default();
    let mut heights = Heights::default();
    let mut names = Table::default();
    let mut seen = Seen::new(single_names(params));
    for (number, Source { name, open, .. }) in ctx.sources.iter().enumerate() {
        let reader = open().map_err(|e| Diagnostic::error("unreadable-file", format!("cannot open `{name}`: {e}")))?;
        let header = geojson::read(name, reader, |feature, geometry| {
            let row = ledger.read;
            ledger.read += 1;
            if row.is_multiple_of(4096) {
                ctx.check()?;
            }
            if let Some(cause) = feature.fault {
                let place = format!("{name}:{}", feature.line);
                ledger.reject(Note { row, id: row.to_string(), place, cause: cause.to_string() });
                return Ok(());
            }
            for (key, _) in &feature.properties {
                names.column(key);
            }
            seen.look(&feature.properties);
            if !pick::holds(&params.r#where, &feature.properties) {
                ledger.filter_where();
                return Ok(());
            }
            if !matches!(geometry.kind, GeometryKind::Null | GeometryKind::Polygon | GeometryKind::MultiPolygon) {
                ledger.filter_type(geometry.kind.name());
                return Ok(());
            }
            let own;
            let id = match pick::id_of(&feature.id, &feature.properties, &params.id) {
                Some(id) => id,
                None => {
                    own = row.to_string();
                    &own
                }
            };
            match judge(params, &feature, geometry, &mut heights) {
                Err(cause) => {
                    let place = format!("{name}:{}", feature.line);
                    ledger.reject(Note { row, id: id.to_string(), place, cause: cause.to_string() });
                }
                Ok((base, height)) => {
                    pick::store(&mut draft.table, draft.ids.len(), &feature.properties);
                    draft.ids.push(id);
                    draft.from.push((number as u32, feature.line as u32, row));
                    draft.bounds.push(bounds_of(&geometry.points));
                    draft.base.push(base);
                    draft.height.push(height);
                    for p in 0..geometry.polygons.len() {
                        geometry.polygon(p).for_each(|ring| draft.shapes.push_ring(ring));
                        draft.shapes.end_polygon();
                    }
                    draft.shapes.end_shape();
                }
            }
            Ok(())
        })?;
        draft.said.extend(header.said(name));
        draft.files.push(name.clone());
    }
    seen.finish(names.names())?;
    ctx.report.fact("heights_from_levels", heights.from_levels);
    ctx.report.fact("defaulted_heights", heights.defaulted);
    ctx.report.fact("unreadable_heights", heights.unreadable);
    Ok(draft)
}

/// Attribute names that stand alone: some feature must have them.
fn single_names(params: &ReadGeojson) -> Vec<(&'static str, String)> {
    let mut out = Vec::new();
    for (param, metres) in [("height", &params.height), ("base", &params.base)] {
        if let Metres::One(name) = metres {
            out.push((param, name.clone()));
        }
    }
    for (param, names) in [("levels", &params.levels), ("id", &params.id)] {
        if let Names::One(name) = names {
            out.push((param, name.clone()));
        }
    }
    out.extend(params.r#where.keys().map(|name| ("where", name.clone())));
    out
}

/// Base and height, or why the feature cannot be used.
fn judge(
    params: &ReadGeojson,
    feature: &Feature,
    geometry: &Geometry,
    heights: &mut Heights,
) -> Result<(f64, f64), &'static str> {
    if geometry.kind == GeometryKind::Null {
        return Err("no geometry");
    }
    if let Some(fault) = geometry.fault {
        return Err(fault);
    }
    if geometry.points.is_empty() {
        return Err("an empty geometry");
    }
    let base = params.base.find(&feature.properties).0.unwrap_or(0.0);
    let (height, unreadable) = params.height.find(&feature.properties);
    heights.unreadable += u64::from(unreadable);
    let levels = || params.levels.find(&feature.properties).and_then(pick::metres).filter(|&l| l > 0.0);
    let height = match height {
        Some(height) => height,
        None => match levels() {
            Some(levels) => {
                heights.from_levels += 1;
                levels * LEVEL
            }
            None => {
                heights.defaulted += 1;
                params.default_height
            }
        },
    };
    if height <= 0.0 {
        return Err("a height of 0 or less");
    }
    if height > HIGHEST || base.abs() > HIGHEST {
        return Err("a height or base beyond 10,000 m");
    }
    Ok((base, height))
}

/// What became of one feature's polygons on the grid.
enum Fate {
    Kept(Repairs),
    Lost(&'static str),
    TooFar,
}

/// Chooses the frame and brings the features onto its grid.
fn settle(draft: Draft, params: &ReadGeojson, ctx: &Ctx, ledger: &mut Ledger) -> Result<Footprints> {
    let Placed { frame, projector, mut causes } =
        place(&draft.bounds, &params.crs, &draft.said, Unsaid::LonLat, params.origin, ctx.report)?;
    for i in repeated(&draft.ids) {
        causes[i].get_or_insert("an id that an earlier feature has");
    }
    ctx.check()?;
    // (1) In pieces of equal size, whatever the number of threads.
    let rows: Vec<usize> = (0..causes.len()).collect();
    let pieces: Vec<(Shapes<Point>, Vec<Fate>)> = rows
        .par_chunks(1024)
        .map(|rows| {
            let mut shapes = Shapes::default();
            let fates = rows.iter().map(|&i| match causes[i] {
                Some(cause) => Fate::Lost(cause),
                None => on_grid(&draft.shapes, i, &projector, &mut shapes),
            });
            let fates = fates.collect();
            (shapes, fates)
        })
        .collect();
    // (2) Gathered in input order.
    let note = |i: usize, cause: &str| {
        let (file, line, row) = draft.from[i];
        let place = format!("{}:{line}", draft.files[file as usize]);
        Note { row, id: draft.ids.get(i).to_string(), place, cause: cause.to_string() }
    };
    let mut kept: Vec<u32> = Vec::with_capacity(rows.len());
    let mut polygons = Shapes::default();
    let mut i = 0;
    for (shapes, fates) in &pieces {
        polygons.append(shapes);
        for fate in fates {
            match fate {
                Fate::Kept(repairs) => {
                    repairs.causes().for_each(|cause| ledger.repair(note(i, cause)));
                    kept.push(i as u32);
                }
                Fate::Lost(cause) => ledger.reject(note(i, cause)),
                Fate::TooFar => {
                    let n = note(i, "");
                    return Err(too_far(&n.id, &n.place, &frame));
                }
            }
            i += 1;
        }
    }
    let attributes = draft.table.finish(rows.len());
    let all = kept.len() == rows.len();
    let pick = |v: &[f64]| kept.iter().map(|&i| v[i as usize]).collect::<Vec<_>>();
    let base = pick(&draft.base);
    let top = pick(&draft.height).iter().zip(&base).map(|(h, b)| b + h).collect();
    Ok(Footprints {
        frame,
        ids: if all { draft.ids } else { kept.iter().map(|&i| draft.ids.get(i as usize)).collect() },
        polygons,
        base,
        top,
        attributes: if all { attributes } else { attributes.select(&kept) },
    })
}

/// Features whose id an earlier one has.
fn repeated(ids: &Strings) -> Vec<usize> {
    #[allow(clippy::disallowed_types, reason = "asked only whether it holds a text: its order gets nowhere")]
    let mut seen = std::collections::HashSet::with_capacity(ids.len());
    ids.iter().enumerate().filter(|(_, id)| !seen.insert(*id)).map(|(i, _)| i).collect()
}

/// Adds shape `i`, projected and mended, to `out`.
fn on_grid(shapes: &Shapes<[f64; 2]>, i: usize, projector: &Projector, out: &mut Shapes<Point>) -> Fate {
    let mut repairs = Repairs::default();
    let mut parts = Vec::new();
    let mut lost = false;
    for p in shapes.polygons_of(i) {
        let mut rings = Vec::with_capacity(1);
        for r in shapes.rings_of(p) {
            match shapes.ring(r).iter().map(|&q| grid(projector.local(q))).collect::<Option<Vec<Point>>>() {
                Some(ring) => rings.push(ring),
                None => return Fate::TooFar,
            }
        }
        match repair::polygon(rings, &mut repairs) {
            Some(rings) => parts.push(rings),
            None => lost = true,
        }
    }
    if parts.is_empty() {
        return Fate::Lost("fewer than three corners");
    }
    repairs.flat_parts |= lost;
    for rings in &parts {
        rings.iter().for_each(|ring| out.push_ring(ring));
        out.end_polygon();
    }
    out.end_shape();
    Fate::Kept(repairs)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::op::Bench;

    fn run(params: &str, text: &str) -> (Result<Footprints>, crate::diag::Findings) {
        let mut bench = Bench::default();
        bench.sources.push(Source::of_bytes("a.geojson", text.into()));
        let op: ReadGeojson = toml::from_str(params).unwrap();
        let out = op.run(&bench.ctx(), In {});
        (out, bench.report.finish())
    }

    fn feature(properties: &str, coordinates: &str) -> String {
        format!(
            r#"{{"type":"Feature","properties":{{{properties}}},"geometry":{{"type":"Polygon","coordinates":{coordinates}}}}}"#
        )
    }

    const SQUARE: &str = "[[[7.001,43.001],[7.002,43.001],[7.002,43.002],[7.001,43.002],[7.001,43.001]]]";

    #[test]
    fn one_square() {
        let (out, findings) = run("", &feature(r#""id":"a","height":12.5,"storeys":4"#, SQUARE));
        let out = out.unwrap();
        assert_eq!(out.ids.iter().collect::<Vec<_>>(), ["a"]);
        assert_eq!((out.base[0], out.top[0]), (0.0, 12.5));
        assert_eq!(out.frame.projection, crate::geom::frame::Projection::TransverseMercator { origin: [7.0, 43.0] });
        // A thousandth of a degree: 111.1 m north, 81.5 m east.
        let area = crate::geom::ring::area_m2(out.polygons.ring(0));
        assert!((area - 111.1 * 81.47).abs() < 10.0, "{area}");
        assert_eq!(out.attributes.columns.len(), 3);
        assert_eq!(findings.facts["read"], 1);
        assert_eq!(findings.facts["accepted"], 1);
        assert_eq!(findings.facts["defaulted_heights"], 0);
    }

    #[test]
    fn heights() {
        let of = |properties: &str, params: &str| {
            let (out, f) = run(params, &feature(properties, SQUARE));
            (out.map(|o| o.top[0] - o.base[0]), f.facts)
        };
        assert_eq!(of("", "").0.unwrap(), 3.0);
        assert_eq!(of("", "").1["defaulted_heights"], 1);
        assert_eq!(of(r#""height":"12 m""#, "").0.unwrap(), 12.0);
        assert_eq!(of(r#""height":"tall","levels":"4""#, "").0.unwrap(), 12.0);
        assert_eq!(of(r#""height":"tall","levels":"4""#, "").1["unreadable_heights"], 1);
        assert_eq!(of(r#""measuredHeight":7,"height":null"#, "").0.unwrap(), 7.0);
        assert_eq!(of(r#""h":7"#, "height = 'h'").0.unwrap(), 7.0);
        assert_eq!(of("", "height = 5.5").0.unwrap(), 5.5);
        assert_eq!(of(r#""height":-1"#, "").1["rejected_by_cause"]["a height of 0 or less"], 1);
        let e = of(r#""hieght":1"#, "height = 'height'").0.unwrap_err();
        assert_eq!(e.to_string(), "no feature has the attribute `height` that `height` names (did you mean `hieght`?)");
    }

    #[test]
    fn ids_and_rows() {
        let text = [r#""id":5"#, "", r#""id":"5""#, r#""name":"x""#].map(|p| feature(p, SQUARE)).join("\n");
        let (out, findings) = run("", &text);
        assert_eq!(out.unwrap().ids.iter().collect::<Vec<_>>(), ["5", "1", "3"]);
        assert_eq!(findings.rejects.len(), 1);
        assert_eq!((findings.rejects[0].row, findings.rejects[0].place.as_str()), (2, "a.geojson:3"));
        let (out, _) = run("id = ['name', 'id']", &text);
        assert_eq!(out.unwrap().ids.iter().collect::<Vec<_>>(), ["5", "1", "x"]);
    }

    #[test]
    fn nothing_left() {
        let (out, _) = run("where.layer = 'a'", &feature(r#""layer":"b""#, SQUARE));
        assert_eq!(out.unwrap_err().to_string(), "no buildings in the input: 1 read, 1 filtered, 0 rejected");
        let (out, _) = run("", "");
        assert_eq!(out.unwrap_err().code, "no-features");
    }

    #[test]
    fn a_frame_in_metres() {
        let square = "[[[1000,2000],[1010,2000],[1010,2010],[1000,2010],[1000,2000]]]";
        let (out, findings) = run("", &feature("", square));
        let out = out.unwrap();
        assert_eq!(out.polygons.points, [[0, 0], [10_000, 0], [10_000, 10_000], [0, 10_000]]);
        assert_eq!(findings.warnings.len(), 1);
        let (out, _) = run("crs = 'EPSG:28992'\norigin = [1000.0, 2005.0]", &feature("", square));
        assert_eq!(out.unwrap().polygons.points[0], [0, -5_000]);
    }
}
