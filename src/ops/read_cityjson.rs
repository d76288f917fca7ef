//! Read buildings with all their levels of detail from CityJSON 1.1, 2.0 and CityJSONSeq.
//!
//! In:     files: a CityJSON object, or a header and a CityJSONFeature a line; plain or gzipped.
//! Out:    n buildings in input order on the millimetre grid of a local frame. Surfaces of a building's parts are
//!         its own, level by level. So are their attributes that the building lacks itself, where all parts that have
//!         one say the same; the others are left out and counted.
//! Twice:  of several geometries of one object and one level the best stays: one with semantics, else one of solids,
//!         else the first.
//! Errors: broken JSON (with its line), no transform or a broken one, features without a header
//!         (then `transform` and `crs` say it), two coordinate systems, nothing left, too many rejects, a building farther than 2^29 mm from the origin.
//! Facts:  read = accepted + rejected + filtered counts objects that are nobody's part; filtered_by_type,
//!         rejected_by_cause, repaired_by_cause; parts, filtered_geometries (points, lines, templates),
//!         repeated_geometries; left_part_attributes; left_members (appearances, addresses, extensions, attributes of
//!         surfaces: what a building here has no place for).
//! Cost:   linear; a CityJSON object is held in memory as a whole, CityJSONSeq line by line.

use std::borrow::Cow;
use std::collections::BTreeMap;

use crate::artifact::buildings::OTHER;
use crate::artifact::{Buildings, Shapes, Strings, Table};
use crate::diag::{Diagnostic, Note, Result};
use crate::geom::frame::{Projector, grid};
use crate::io::cityjson::{self, Boundary, Model, Object, Transform};
use crate::io::json::Scalar;
use crate::io::ledger::{self, Ledger, Needed};
use crate::io::pick;
use crate::io::place::{Bounds, HIGHEST, NOWHERE, Placed, Said, Unsaid, place, too_far};
use crate::io::reader::{account, crs_mistake, is_packed};
use crate::op::{Ctx, Mistake, Op, Source};
use crate::{inputs, reader_params};

reader_params! {
    /// Buildings with all their levels of detail from CityJSON files.
    pub struct ReadCityjson {
        /// `scale` and `translate` of features that come without a header.
        pub transform: Option<Transform> = None,
    }
}

inputs! {}

impl Op for ReadCityjson {
    const NAME: &'static str = "read-cityjson";
    const VERSION: u32 = 4;
    type In = In;
    type Out = Buildings;
    const FACTS: &'static [(&'static str, &'static str)] = &ledger::facts::<6, 12>([
        ledger::BY_TYPE,
        ("parts", "building parts, which belong to their buildings"),
        ("filtered_geometries", "geometries of kinds that are not taken (points, lines, templates), by kind"),
        ("repeated_geometries", "geometries left out for a better one of the same object and level"),
        ("left_part_attributes", "buildings whose parts say otherwise than themselves or each other, by attribute"),
        (
            "left_members",
            "what buildings, parts, their geometries and their surfaces' semantics had beside, by name (material, address, ..)",
        ),
    ]);

    fn check(&self) -> Vec<Mistake> {
        crs_mistake(&self.crs).map(|message| Mistake { param: "crs", message }).into_iter().collect()
    }

    fn run(&self, ctx: &Ctx, _: In) -> Result<Buildings> {
        account(ctx.report, "buildings", Needed::One { max_rejected: self.max_rejected }, |ledger| {
            settle(gather(self, ctx, ledger)?, self, ctx, ledger)
        })
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        // One object is held as text and as values; of a sequence one feature. Packed text is some five times as long.
        let plain = if is_packed(&self.path) { 5 * input_bytes } else { input_bytes };
        let sequence = self.path.trim_end_matches(".gz").ends_with(".jsonl");
        (4 << 20) + if sequence { 11 * plain / 4 } else { 9 * plain / 2 }
    }
}

/// Buildings as the files have them: coordinates in the source's system.
#[derive(Default)]
struct Draft {
    ids: Strings,
    /// Of each building: row, place.
    from: Vec<(u64, String)>,
    bounds: Vec<Bounds>,
    levels: Vec<Vec<Level>>,
    table: Table,
    said: Vec<(String, Said)>,
}

/// One level of detail of one building.
#[derive(Default)]
struct Level {
    lod: String,
    surfaces: Shapes<[f64; 3]>,
    semantics: Vec<u8>,
}

/// Geometries that were not taken.
#[derive(Default)]
struct Left {
    by_kind: BTreeMap<String, u64>,
    repeated: u64,
    part_attributes: BTreeMap<String, u64>,
    members: BTreeMap<String, u64>,
}

fn gather(params: &ReadCityjson, ctx: &Ctx, ledger: &mut Ledger) -> Result<Draft> {
    let mut draft = Draft::default();
    let mut left = Left::default();
    let mut parts = 0;
    for Source { name, open, .. } in ctx.sources {
        let reader = open().map_err(|e| Diagnostic::error("unreadable-file", format!("cannot open `{name}`: {e}")))?;
        let mut header: Option<Transform> = None;
        // The systems of its headers; where there is a second, with its line.
        let mut said: Vec<(u64, String)> = Vec::new();
        let mut has_header = false;
        cityjson::read(name, reader, |model| {
            ctx.check()?;
            if model.is_feature && !has_header && (params.transform.is_none() || params.crs.is_empty()) {
                let message = format!("{name}:{}: a CityJSONFeature without a header before it", model.line);
                return Err(
                    Diagnostic::error("no-header", message).help("say `transform` and `crs`, or put the header first")
                );
            }
            if !model.is_feature {
                has_header = true;
                header = model.transform.clone();
                if let Some(crs) = model.crs.as_ref().filter(|&crs| said.last().is_none_or(|s| s.1 != *crs)) {
                    said.push((model.line, crs.clone()));
                }
            }
            let transform = header.as_ref().or(params.transform.as_ref());
            let Some(transform) = transform else {
                if model.bad_transform {
                    let what = "its `transform` must have `scale` and `translate`, three finite numbers each";
                    return Err(Diagnostic::error("bad-transform", format!("{name}:{}: {what}", model.line)));
                }
                let message = format!("{name}:{}: this CityJSON has no `transform`", model.line);
                let help =
                    "CityJSON 1.1 and later need one; `cjio in.json upgrade save out.json` gives an older file one";
                return Err(Diagnostic::error("no-transform", message).help(help));
            };
            parts += buildings(&model, name, transform, &mut draft, &mut left, ledger);
            Ok(())
        })?;
        if said.is_empty() {
            draft.said.push((name.clone(), Said::Nothing));
        }
        let one = said.len() == 1;
        let place = |line: u64| if one { name.clone() } else { format!("{name}:{line}") };
        draft.said.extend(said.into_iter().map(|(line, crs)| (place(line), Said::Name(crs))));
    }
    ctx.report.fact("parts", parts);
    for (key, counts) in [
        ("filtered_geometries", &left.by_kind),
        ("left_part_attributes", &left.part_attributes),
        ("left_members", &left.members),
    ] {
        if !counts.is_empty() {
            ctx.report.fact(key, serde_json::json!(counts));
        }
    }
    ctx.report.fact("repeated_geometries", left.repeated);
    Ok(draft)
}

/// Takes the buildings of one CityJSON object or feature; gives the number of their parts.
fn buildings(
    model: &Model,
    file: &str,
    transform: &Transform,
    draft: &mut Draft,
    left: &mut Left,
    ledger: &mut Ledger,
) -> u64 {
    let index: BTreeMap<&str, usize> = model.objects.iter().enumerate().map(|(i, o)| (&*o.id, i)).collect();
    // (1) To whom a part belongs: the building up its line of parents, else itself.
    let owner = |i: usize| {
        let mut at = i;
        // Parents in a circle, or that are no buildings, are none.
        for _ in 0..8 {
            let parent = model.objects[at].parents.first().and_then(|p| index.get(&**p)).copied();
            match (model.objects[at].kind.as_str(), parent) {
                ("Building", _) | ("BuildingPart", None) => return at,
                ("BuildingPart", Some(parent)) => at = parent,
                _ => return i,
            }
        }
        i
    };
    let mut members: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (i, object) in model.objects.iter().enumerate() {
        if object.kind == "BuildingPart" && owner(i) != i {
            members.entry(owner(i)).or_default().push(i);
        }
    }
    // (2) Every object that is nobody's part is a row.
    let mut parts = 0;
    for (i, object) in model.objects.iter().enumerate() {
        let is_part = object.kind == "BuildingPart";
        if is_part && owner(i) != i {
            parts += 1;
            continue;
        }
        let row = ledger.read;
        ledger.read += 1;
        let note = |cause: &str| Note {
            row,
            id: object.id.to_string(),
            place: format!("{file}:{}", object.line),
            cause: cause.to_string(),
        };
        if object.kind != "Building" && !is_part {
            match object.fault {
                Some(cause) if object.kind.is_empty() => ledger.reject(note(cause)),
                _ => ledger.filter_type(&object.kind),
            }
            continue;
        }
        let own = members.get(&i).map_or(&[][..], Vec::as_slice);
        let all: Vec<&Object> = std::iter::once(i).chain(own.iter().copied()).map(|k| &model.objects[k]).collect();
        match levels(&all, model, transform, left) {
            Ok((levels, bounds)) => {
                if is_part {
                    ledger.repair(note("a part without its building stands for itself"));
                }
                let row_in_table = draft.ids.len();
                pick::store(&mut draft.table, row_in_table, &object.attributes);
                pick::store(&mut draft.table, row_in_table, &of_parts(&all, left));
                for name in all.iter().flat_map(|o| &o.left) {
                    *left.members.entry(name.to_string()).or_default() += 1;
                }
                draft.ids.push(&object.id);
                draft.from.push((row, note("").place));
                draft.bounds.push(bounds);
                draft.levels.push(levels);
            }
            Err(None) => ledger.filter_type(&all.iter().flat_map(|o| &o.geometries).next().expect("one at least").kind),
            Err(Some(cause)) => ledger.reject(note(cause)),
        }
    }
    parts
}

/// The attributes that a building, the first of `all`, takes from its parts. Counts those that it does not take.
fn of_parts<'a>(all: &[&'a Object<'a>], left: &mut Left) -> Vec<(Cow<'a, str>, Scalar<'a>)> {
    let same = |a: &Scalar, b: &Scalar| match (a, b) {
        (Scalar::Number(a, _), Scalar::Number(b, _)) => a == b,
        _ => a == b,
    };
    // By name: what was said first, and whether all others agree.
    let mut said: BTreeMap<&str, (&Scalar, bool)> = BTreeMap::new();
    for (name, value) in all.iter().skip(1).flat_map(|part| &part.attributes).filter(|(_, v)| *v != Scalar::Null) {
        let first = said.entry(name).or_insert((value, true));
        first.1 &= same(first.0, value);
    }
    let mut out = Vec::new();
    for (name, (value, agreed)) in said {
        let own = all.first().and_then(|building| pick::get(&building.attributes, name));
        match own {
            None if agreed => out.push((Cow::Borrowed(name), value.clone())),
            Some(own) if agreed && same(own, value) => {}
            _ => *left.part_attributes.entry(name.to_string()).or_default() += 1,
        }
    }
    out
}

/// The levels of a building and its parts, ascending, and the box around them. An error without a cause: only
/// geometries of kinds that are not taken.
fn levels(
    objects: &[&Object],
    model: &Model,
    transform: &Transform,
    left: &mut Left,
) -> Result<(Vec<Level>, Bounds), Option<&'static str>> {
    let mut out: Vec<Level> = Vec::new();
    let mut bounds = NOWHERE;
    let mut others = 0;
    for object in objects {
        if let Some(fault) = object.fault {
            return Err(Some(fault));
        }
        let mut best: Vec<&Boundary> = Vec::new();
        for b in &object.geometries {
            if !b.is_surface() {
                *left.by_kind.entry(b.kind.clone()).or_default() += 1;
                others += 1;
                continue;
            }
            if let Some(fault) = b.fault {
                return Err(Some(fault));
            }
            let rank = |b: &Boundary| (!b.semantics.is_empty(), b.kind.contains("Solid"));
            match best.iter_mut().find(|other| other.lod == b.lod) {
                Some(other) => {
                    left.repeated += 1;
                    if rank(b) > rank(other) {
                        *other = b;
                    }
                }
                None => best.push(b),
            }
        }
        for b in best.into_iter().filter(|b| !b.surfaces.is_empty()) {
            let at = out.iter().position(|l| l.lod == b.lod).unwrap_or_else(|| {
                out.push(Level { lod: b.lod.clone(), ..Default::default() });
                out.len() - 1
            });
            add(b, model, transform, &mut out[at], &mut bounds)?;
        }
    }
    if out.is_empty() {
        return Err((others == 0).then_some("no geometry"));
    }
    out.iter_mut().for_each(|l| l.surfaces.end_shape());
    let number = |l: &Level| l.lod.parse::<f64>().unwrap_or(f64::INFINITY);
    out.sort_by(|a, b| number(a).total_cmp(&number(b)).then_with(|| a.lod.cmp(&b.lod)));
    Ok((out, bounds))
}

fn add(
    b: &Boundary,
    model: &Model,
    t: &Transform,
    out: &mut Level,
    bounds: &mut Bounds,
) -> Result<(), Option<&'static str>> {
    let mut ring = Vec::new();
    for s in 0..b.surfaces.len() {
        for indices in b.rings_of(s) {
            ring.clear();
            for &i in indices {
                let v = model.vertices.get(i as usize).ok_or(Some("a vertex that does not exist"))?;
                let p: [f64; 3] = std::array::from_fn(|k| v[k] * t.scale[k] + t.translate[k]);
                if !p.iter().all(|x| x.is_finite()) {
                    return Err(Some("a coordinate that is not finite"));
                }
                if p[2].abs() > HIGHEST {
                    return Err(Some("a vertex higher or lower than 10,000 m"));
                }
                *bounds = [bounds[0].min(p[0]), bounds[1].min(p[1]), bounds[2].max(p[0]), bounds[3].max(p[1])];
                ring.push(p);
            }
            out.surfaces.push_ring(&ring);
        }
        out.surfaces.end_polygon();
        out.semantics.push(b.semantics.get(s).copied().unwrap_or(OTHER));
    }
    Ok(())
}

/// Chooses the frame and brings the surfaces onto its grid.
fn settle(draft: Draft, params: &ReadCityjson, ctx: &Ctx, ledger: &mut Ledger) -> Result<Buildings> {
    let Placed { frame, projector, causes } =
        place(&draft.bounds, &params.crs, &draft.said, Unsaid::Local, params.origin, ctx.report)?;
    let mut seen = std::collections::BTreeSet::new();
    let mut kept = Vec::new();
    let mut out = Buildings {
        frame,
        ids: Strings::default(),
        attributes: Default::default(),
        starts: vec![0],
        lods: Strings::default(),
        surfaces: Shapes::default(),
        semantics: Vec::new(),
    };
    for i in 0..draft.ids.len() {
        let id = draft.ids.get(i);
        let (row, place) = &draft.from[i];
        let note = |cause: &str| Note { row: *row, id: id.to_string(), place: place.clone(), cause: cause.to_string() };
        let cause = if seen.insert(id) { causes[i] } else { Some("an id that an earlier building has") };
        if let Some(cause) = cause {
            ledger.reject(note(cause));
            continue;
        }
        let (before, mut lost) = (out.semantics.len(), false);
        let (geometries, points) = (out.lods.len(), out.surfaces.mark());
        for level in &draft.levels[i] {
            match on_grid(level, &projector, &mut out.surfaces, &mut out.semantics) {
                Some(dropped) => lost |= dropped,
                None => return Err(too_far(id, place, &out.frame)),
            }
            out.lods.push(&level.lod);
        }
        if out.semantics.len() == before {
            out.surfaces.cut(points);
            out.lods = out.lods.iter().take(geometries).collect();
            ledger.reject(note("no surface of three corners"));
            continue;
        }
        if lost {
            ledger.repair(note("surfaces or holes of fewer than three corners were dropped"));
        }
        out.ids.push(id);
        out.starts.push(out.lods.len() as u32);
        kept.push(i as u32);
    }
    let attributes = draft.table.finish(draft.levels.len());
    out.attributes = if kept.len() == draft.levels.len() { attributes } else { attributes.select(&kept) };
    Ok(out)
}

/// Adds the surfaces of a level as one shape; true where some had no area on the grid, none where one lies too far.
fn on_grid(level: &Level, way: &Projector, out: &mut Shapes<[i32; 3]>, semantics: &mut Vec<u8>) -> Option<bool> {
    let mut lost = false;
    let mut ring: Vec<[i32; 3]> = Vec::new();
    for p in level.surfaces.polygons_of(0) {
        let mut rings = 0;
        for r in level.surfaces.rings_of(p) {
            ring.clear();
            for q in level.surfaces.ring(r) {
                let [x, y] = grid(way.local([q[0], q[1]]))?;
                let [z, _] = grid([q[2], 0.0])?;
                if ring.last() != Some(&[x, y, z]) {
                    ring.push([x, y, z]);
                }
            }
            while ring.len() > 1 && ring.first() == ring.last() {
                ring.pop();
            }
            if ring.len() < 3 {
                lost = true;
                if rings == 0 {
                    break;
                }
                continue;
            }
            out.push_ring(&ring);
            rings += 1;
        }
        if rings > 0 {
            out.end_polygon();
            semantics.push(level.semantics[p]);
        }
    }
    out.end_shape();
    Some(lost)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artifact::buildings::{GROUND, ROOF, WALL};
    use crate::op::Bench;

    fn run(params: &str, text: &str) -> (Result<Buildings>, crate::diag::Findings) {
        let mut bench = Bench::default();
        bench.sources.push(Source::of_bytes("a.city.json", text.into()));
        let op: ReadCityjson = toml::from_str(params).unwrap();
        let out = op.run(&bench.ctx(), In {});
        (out, bench.report.finish())
    }

    const TRANSFORM: &str = r#""transform":{"scale":[0.01,0.01,0.01],"translate":[85000.0,447000.0,1.0]}"#;
    const VERTICES: &str = r#""vertices":[[0,0,0],[1000,0,0],[1000,1000,0],[0,1000,0],[0,0,500],[1000,0,500],[1000,1000,500],[0,1000,500]]"#;
    const CUBE: &str = r#"{"type":"Solid","lod":"1.2","boundaries":[[[[0,3,2,1]],[[4,5,6,7]],[[0,1,5,4]],[[1,2,6,5]],[[2,3,7,6]],[[3,0,4,7]]]],
        "semantics":{"surfaces":[{"type":"GroundSurface"},{"type":"RoofSurface"},{"type":"WallSurface"}],"values":[[0,1,2,2,2,2]]}}"#;

    fn city(objects: &str) -> String {
        format!(r#"{{"type":"CityJSON","version":"2.0",{TRANSFORM},"CityObjects":{{{objects}}},{VERTICES}}}"#)
    }

    #[test]
    fn a_cube() {
        let (out, findings) = run(
            "",
            &city(&format!(
                r#""a":{{"type":"Building","attributes":{{"n":3}},"geometry":[{CUBE}]}},"r":{{"type":"Road"}}"#
            )),
        );
        let out = out.unwrap();
        assert_eq!((out.len(), out.lods.iter().collect::<Vec<_>>(), out.starts.clone()), (1, vec!["1.2"], vec![0, 1]));
        assert_eq!(out.semantics, [GROUND, ROOF, WALL, WALL, WALL, WALL]);
        assert_eq!(out.surfaces.ring(0), [[0, 0, 1000], [0, 10_000, 1000], [10_000, 10_000, 1000], [10_000, 0, 1000]]);
        assert_eq!(out.attributes.columns[0].name, "n");
        assert_eq!(findings.facts["filtered_by_type"]["Road"], 1);
        assert_eq!(findings.facts["read"], 2);
    }

    #[test]
    fn parts_belong_to_their_building() {
        let part = |id: &str, parent: &str| {
            format!(
                r#""{id}":{{"type":"BuildingPart","parents":["{parent}"],"attributes":{{"h":"{id}"}},"geometry":[{CUBE}]}}"#
            )
        };
        let (out, f) = run(
            "",
            &city(&format!(r#"{},"a":{{"type":"Building"}},{},{}"#, part("p", "a"), part("q", "a"), part("z", "gone"))),
        );
        let out = out.unwrap();
        assert_eq!(out.ids.iter().collect::<Vec<_>>(), ["a", "z"]);
        assert_eq!(out.surfaces.polygons_of(0).len(), 12);
        assert_eq!((f.facts["parts"].as_u64(), f.repairs.len()), (Some(2), 1));
        assert_eq!(out.attributes.columns[0].present, [false, true]);
    }

    #[test]
    fn attributes_of_parts() {
        let object = |id: &str, kind: &str, more: &str| {
            format!(r#""{id}":{{"type":"{kind}",{more},"children":[],"geometry":[{CUBE}]}}"#)
        };
        let part = |id: &str, attributes: &str| {
            object(id, "BuildingPart", &format!(r#""parents":["a"],"attributes":{{{attributes}}}"#))
        };
        let (out, f) = run(
            "",
            &city(
                &[
                    object("a", "Building", r#""attributes":{"own":1,"both":2,"null":null}"#),
                    part("p", r#""own":9,"both":2.0,"null":3,"some":true,"year":1990,"roof":"flat""#),
                    part("q", r#""both":2,"null":3,"year":1990,"roof":"hipped","some":null"#),
                ]
                .join(","),
            ),
        );
        let names: Vec<_> = out.unwrap().attributes.columns.into_iter().map(|c| c.name).collect();
        assert_eq!(names, ["both", "null", "own", "some", "year"]);
        assert_eq!(f.facts["left_part_attributes"], serde_json::json!({ "own": 1, "roof": 1 }));
        assert!(!f.facts.contains_key("left_members"), "{:?}", f.facts);
    }

    #[test]
    fn what_has_no_place_is_counted() {
        let more = r#""material":{"m":{"value":0}},"texture":{},"lod":"1.2""#;
        let painted = CUBE.replace(r#""lod":"1.2""#, more).replace(r#""RoofSurface""#, r#""RoofSurface","slope":30"#);
        let point = r#"{"type":"MultiPoint","lod":"0","boundaries":[0],"material":{}}"#;
        let building = format!(r#""a":{{"type":"Building","address":[],"geometry":[{painted},{point}],"+x":1}}"#);
        let (out, f) = run("", &city(&format!(r#"{building},"r":{{"type":"Road","address":[]}}"#)));
        assert_eq!(out.unwrap().semantics.len(), 6);
        let left = serde_json::json!({ "+x": 1, "address": 1, "material": 1, "semantics.slope": 1, "texture": 1 });
        assert_eq!(f.facts["left_members"], left);
    }

    #[test]
    fn the_better_of_two() {
        let plain = r#"{"type":"MultiSurface","lod":"1.2","boundaries":[[[0,3,2,1]]]}"#;
        let (out, f) = run("", &city(&format!(r#""a":{{"type":"Building","geometry":[{plain},{CUBE},{plain}]}}"#)));
        assert_eq!(out.unwrap().semantics.len(), 6);
        assert_eq!(f.facts["repeated_geometries"], 2);
    }

    #[test]
    fn what_cannot_be_read() {
        let building = format!(r#""a":{{"type":"Building","geometry":[{CUBE}]}}"#);
        let text = city(&building).replace(TRANSFORM, r#""extra":1"#);
        assert_eq!(run("", &text).0.unwrap_err().code, "no-transform");
        let feature = city(&building).replace("\"CityJSON\"", "\"CityJSONFeature\"").replace(TRANSFORM, "\"id\":\"a\"");
        assert_eq!(run("", &feature).0.unwrap_err().code, "no-header");
        let told =
            "crs = 'EPSG:28992'\ntransform = { scale = [0.01, 0.01, 0.01], translate = [85000.0, 447000.0, 0.0] }";
        assert_eq!(run(told, &feature).0.unwrap().len(), 1);
        // A vertex too many, no geometry, a template: each with its cause, and the rest is there.
        let odd = r#","b":{"type":"Building","geometry":[{"type":"MultiSurface","lod":"1","boundaries":[[[0,1,99]]]}]},
            "c":{"type":"Building"},"d":{"type":"Building","geometry":[{"type":"GeometryInstance","template":0,"boundaries":[0],"transformationMatrix":[]}]},
            "e":{"type":"Building","geometry":[{"type":"MultiSurface","lod":"1","boundaries":[[[0,0,1]]]}]}"#;
        let (out, f) = run("max-rejected = 0.9", &city(&format!("{building}{odd}")));
        assert_eq!(out.unwrap().len(), 1);
        let causes: Vec<_> = f.rejects.iter().map(|n| (n.id.as_str(), n.place.as_str(), n.cause.as_str())).collect();
        assert_eq!(
            causes,
            [
                ("b", "a.city.json:2", "a vertex that does not exist"),
                ("c", "a.city.json:3", "no geometry"),
                ("e", "a.city.json:4", "no surface of three corners"),
            ]
        );
        assert_eq!(f.facts["filtered_by_type"]["GeometryInstance"], 1);
        assert_eq!(
            run("", r#"{"type":"FeatureCollection","features":[]}"#).0.unwrap_err().suggestion.as_deref(),
            Some("read it with read-geojson")
        );
    }
}
