//! Read lines from GeoJSON: roads, rails, water, borders; or the outlines of polygons.
//!
//! In:     files as read-geojson takes them.
//! Out:    n polylines on the millimetre grid, in input order; a ring ends where it starts. A feature of several
//!         lines or rings gives as many rows `id/0`, `id/1`, ...
//! Errors: broken JSON (with its line), a file cut off, two coordinate systems (no `crs` is lon/lat; the parameter
//!         `crs` settles it), an attribute that no feature has, too many rejects. None
//!         left is none left: barriers may be absent.
//! Facts:  read = accepted + rejected + filtered counts features; filtered_by_where, filtered_by_type,
//!         rejected_by_cause, repaired_by_cause.
//! Cost:   linear.

use crate::artifact::{Lines, Strings, Table};
use crate::diag::{Diagnostic, Note, Result};
use crate::geom::Point;
use crate::geom::frame::grid;
use crate::io::geojson::{self, GeometryKind};
use crate::io::ledger::{self, Ledger, Needed};
use crate::io::pick::{self, Names, Seen, Where};
use crate::io::place::{Bounds, Placed, Said, Unsaid, bounds_of, place, too_far};
use crate::io::reader::{account, crs_mistake, is_packed};
use crate::op::{Ctx, Mistake, Op, Source};
use crate::{inputs, reader_params};

reader_params! {
    /// Lines, or outlines of polygons, from GeoJSON files.
    pub struct ReadLines {
        /// Only features whose attributes have these values (or one of a list).
        pub r#where: Where = Where::new(),
        /// Attribute that names the line (of a list the first present). An empty list: the feature's own id, the
        /// attribute `id`, or the row.
        pub id: Names = Names::of(&[]),
    }
}

inputs! {}

impl Op for ReadLines {
    const NAME: &'static str = "read-lines";
    const VERSION: u32 = 2;
    type In = In;
    type Out = Lines;
    const FACTS: &'static [(&'static str, &'static str)] = &ledger::facts::<2, 8>([ledger::BY_WHERE, ledger::BY_TYPE]);

    fn check(&self) -> Vec<Mistake> {
        crs_mistake(&self.crs).map(|message| Mistake { param: "crs", message }).into_iter().collect()
    }

    fn run(&self, ctx: &Ctx, _: In) -> Result<Lines> {
        account(ctx.report, "lines", Needed::None { max_rejected: self.max_rejected }, |ledger| {
            settle(gather(self, ctx, ledger)?, self, ctx, ledger)
        })
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (4 << 20) + if is_packed(&self.path) { 6 * input_bytes } else { input_bytes }
    }
}

/// Features as the files have them.
#[derive(Default)]
struct Draft {
    ids: Strings,
    /// Row, file and line of each feature.
    from: Vec<(u64, String)>,
    bounds: Vec<Bounds>,
    lines: Vec<Vec<Vec<[f64; 2]>>>,
    said: Vec<(String, Said)>,
}

fn gather(params: &ReadLines, ctx: &Ctx, ledger: &mut Ledger) -> Result<Draft> {
    let mut draft = Draft::default();
    let mut names = Table::default();
    let single = params.r#where.keys().map(|name| ("where", name.clone()));
    let id = if let Names::One(name) = &params.id { Some(("id", name.clone())) } else { None };
    let mut seen = Seen::new(single.chain(id));
    for Source { name, open, .. } in ctx.sources {
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
            use GeometryKind::{LineString, MultiLineString, MultiPolygon, Null, Polygon};
            if !matches!(geometry.kind, Null | LineString | MultiLineString | Polygon | MultiPolygon) {
                ledger.filter_type(geometry.kind.name());
                return Ok(());
            }
            let id = pick::id_of(&feature.id, &feature.properties, &params.id).map_or(row.to_string(), str::to_string);
            let place = format!("{name}:{}", feature.line);
            let cause = match geometry.fault {
                _ if geometry.kind == Null => Some("no geometry"),
                None if geometry.points.is_empty() => Some("an empty geometry"),
                fault => fault,
            };
            if let Some(cause) = cause {
                ledger.reject(Note { row, id, place, cause: cause.to_string() });
                return Ok(());
            }
            draft.ids.push(&id);
            draft.from.push((row, place));
            draft.bounds.push(bounds_of(&geometry.points));
            draft.lines.push((0..geometry.rings.len()).map(|r| geometry.ring(r).to_vec()).collect());
            Ok(())
        })?;
        draft.said.extend(header.said(name));
    }
    // Of an empty file nothing can be asked.
    if ledger.read > 0 {
        seen.finish(names.names())?;
    }
    Ok(draft)
}

fn settle(draft: Draft, params: &ReadLines, ctx: &Ctx, ledger: &mut Ledger) -> Result<Lines> {
    let unsaid = if draft.bounds.is_empty() { Unsaid::Local } else { Unsaid::LonLat };
    let Placed { frame, projector, causes } =
        place(&draft.bounds, &params.crs, &draft.said, unsaid, params.origin, ctx.report)?;
    let mut out = Lines { frame, ids: Strings::default(), starts: vec![0], points: Vec::new() };
    let mut seen = std::collections::BTreeSet::new();
    for (i, lines) in draft.lines.iter().enumerate() {
        let id = draft.ids.get(i);
        let (row, place) = &draft.from[i];
        let note = |cause: &str| Note { row: *row, id: id.to_string(), place: place.clone(), cause: cause.to_string() };
        if let Some(cause) = if seen.insert(id) { causes[i] } else { Some("an id that an earlier feature has") } {
            ledger.reject(note(cause));
            continue;
        }
        let mut parts: Vec<Vec<Point>> = Vec::new();
        let mut short = false;
        for line in lines {
            let points: Option<Vec<Point>> = line.iter().map(|&p| grid(projector.local(p))).collect();
            let Some(mut points) = points else { return Err(too_far(id, place, &out.frame)) };
            points.dedup();
            if points.len() < 2 {
                short = true;
            } else {
                parts.push(points);
            }
        }
        if parts.is_empty() {
            ledger.reject(note("a line without length"));
            continue;
        }
        if short {
            ledger.repair(note("a part without length was dropped"));
        }
        for (k, points) in parts.iter().enumerate() {
            out.ids.push(&if parts.len() == 1 { id.to_string() } else { format!("{id}/{k}") });
            out.points.extend(points);
            out.starts.push(out.points.len() as u32);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::op::Bench;

    fn run(params: &str, text: &str) -> (Result<Lines>, crate::diag::Findings) {
        let mut bench = Bench::default();
        bench.sources.push(Source::of_bytes("a.geojson", text.into()));
        let op: ReadLines = toml::from_str(params).unwrap();
        let out = op.run(&bench.ctx(), In {});
        (out, bench.report.finish())
    }

    #[test]
    fn lines_and_outlines() {
        let text = r#"{"type":"FeatureCollection","crs":null,"features":[
            {"type":"Feature","id":"a","properties":{"layer":"road"},"geometry":{"type":"LineString","coordinates":[[0,0],[1,0],[1,0],[1,1]]}},
            {"type":"Feature","id":"b","properties":{"layer":"road"},"geometry":{"type":"Polygon","coordinates":[[[0,0],[5,0],[5,5],[0,0]],[[2,1],[3,1],[3,2],[2,1]]]}},
            {"type":"Feature","id":"c","properties":{"layer":"road"},"geometry":{"type":"Point","coordinates":[0,0]}},
            {"type":"Feature","id":"d","properties":{"layer":"road"},"geometry":{"type":"LineString","coordinates":[[3,3]]}},
            {"type":"Feature","id":"e","properties":{"layer":"house"},"geometry":null}]}"#;
        let (out, f) = run("where.layer = 'road'", text);
        let out = out.unwrap();
        assert_eq!(out.ids.iter().collect::<Vec<_>>(), ["a", "b/0", "b/1"]);
        assert_eq!(out.line(0), [[0, 0], [1000, 0], [1000, 1000]]);
        assert_eq!(out.line(1).first(), out.line(1).last());
        assert_eq!((&f.facts["read"], &f.facts["accepted"], &f.facts["filtered"]), (&5.into(), &2.into(), &2.into()));
        assert_eq!(f.rejects[0].cause, "a line without length");
        assert_eq!(
            run("where.layr = 'road'", text).0.unwrap_err().suggestion.as_deref(),
            Some("did you mean `layer`?")
        );
    }

    #[test]
    fn none_is_none() {
        let (out, f) = run("", r#"{"type":"FeatureCollection","features":[]}"#);
        assert_eq!(out.unwrap().len(), 0);
        assert_eq!(f.facts["read"], 0);
    }
}
