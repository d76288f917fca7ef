//! Flatten buildings to footprints: the union of their ground surfaces, a base and a top.
//!
//! In:     buildings with surfaces for each level of detail.
//! Out:    one footprint for each building that has a ground and a roof above it, in order, with its attributes.
//! Ground: surfaces called so; where a level has none, its flat faces that look down; where it has flat faces only,
//!         those (LoD 0). `lod` empty: the highest level that has a ground. Where none has: what the roof of the
//!         highest level covers, at the building's lowest point.
//! Top:    mean height of the roof surfaces, weighted by plan area; `"max"`, their highest point; or an attribute
//!         with the roof's elevation (`measuredHeight` counts from the base). Without roof surfaces, faces that look up.
//! Errors: an unknown `lod` or attribute, nothing left. Rejected: no ground, no roof above it.
//! Facts:  read = accepted + rejected + filtered (0); rejected_by_cause, repaired_by_cause, `lods` (how many took which).
//! Cost:   near O(n log n) in the ground's vertices.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::artifact::buildings::{GROUND, ROOF};
use crate::artifact::{Attributes, Buildings, Footprints, Shapes, Strings, Values};
use crate::diag::{Diagnostic, Note, Result};
use crate::geom::Point;
use crate::geom::repair::{self, Repairs};
use crate::geom::union::union;
use crate::io::ledger::{self, Ledger, Needed};
use crate::io::pick::Seen;
use crate::io::reader::account;
use crate::op::{Ctx, Op};
use crate::{inputs, params};

params! {
    /// Ground polygons and heights of buildings.
    pub struct Footprint {
        /// Level of detail that gives ground and roof, `"1.2"`; empty: the highest that has a ground.
        pub lod: String = String::new(),
        /// `"mean"` of the roof, weighted by area; `"max"`; or an attribute that holds the roof's elevation.
        pub top: String = "mean".into(),
        /// Largest share of buildings that may be rejected.
        #[schemars(range(min = 0.0, max = 1.0))]
        pub max_rejected: f64 = 0.5,
    }
}

inputs! {
    /// Surfaces for each level of detail.
    buildings: Buildings,
}

impl Op for Footprint {
    const NAME: &'static str = "footprint";
    const VERSION: u32 = 1;
    type In = In;
    type Out = Footprints;
    const FACTS: &'static [(&'static str, &'static str)] =
        &ledger::facts::<1, 7>([("lods", "buildings for each level of detail that gave their ground")]);

    fn run(&self, ctx: &Ctx, input: In) -> Result<Footprints> {
        account(ctx.report, "buildings", Needed::One { max_rejected: self.max_rejected }, |ledger| {
            footprints(&input.buildings, self, ctx, ledger)
        })
    }

    fn estimate(&self, input_bytes: u64) -> u64 {
        (2 << 20) + 2 * input_bytes
    }
}

/// The ground and the roof of one building.
struct Flat {
    /// Geometry that gave it.
    geometry: usize,
    polygons: Vec<Vec<Vec<Point>>>,
    /// Metres.
    base: f64,
    top: f64,
    repairs: Repairs,
}

fn footprints(b: &Buildings, params: &Footprint, ctx: &Ctx, ledger: &mut Ledger) -> Result<Footprints> {
    if !params.lod.is_empty() && !b.lods.iter().any(|l| l == params.lod) {
        let all: std::collections::BTreeSet<&str> = b.lods.iter().collect();
        let message = format!("no building has the level of detail `{}`", params.lod);
        let known = all.into_iter().collect::<Vec<_>>().join(", ");
        return Err(Diagnostic::error("unknown-lod", message).value(&params.lod).help(format!("there are {known}")));
    }
    let elevations = match params.top.as_str() {
        "mean" | "max" => None,
        name => Some(numbers(&b.attributes, name)?),
    };
    let flat: Vec<Result<Flat, &'static str>> =
        (0..b.len()).into_par_iter().map(|i| flatten(b, i, params, elevations.as_deref())).collect();
    ctx.check()?;
    let (mut kept, mut lods) = (Vec::new(), BTreeMap::<&str, u64>::new());
    let (mut base, mut top) = (Vec::new(), Vec::new());
    let mut polygons = Shapes::default();
    for (i, flat) in flat.into_iter().enumerate() {
        ledger.read += 1;
        let note = |cause: &str| Note {
            row: i as u64,
            id: b.ids.get(i).to_string(),
            place: format!("building {i}"),
            cause: cause.to_string(),
        };
        match flat {
            Err(cause) => ledger.reject(note(cause)),
            Ok(flat) => {
                flat.repairs.causes().for_each(|cause| ledger.repair(note(cause)));
                *lods.entry(b.lods.get(flat.geometry)).or_default() += 1;
                for rings in &flat.polygons {
                    rings.iter().for_each(|ring| polygons.push_ring(ring));
                    polygons.end_polygon();
                }
                polygons.end_shape();
                base.push(flat.base);
                top.push(flat.top);
                kept.push(i as u32);
            }
        }
    }
    ctx.report.fact("lods", serde_json::json!(lods));
    let ids = kept.iter().map(|&i| b.ids.get(i as usize)).collect::<Strings>();
    Ok(Footprints { frame: b.frame.clone(), ids, polygons, base, top, attributes: b.attributes.select(&kept) })
}

/// The column as numbers, NaN where it has none.
fn numbers(attributes: &Attributes, name: &str) -> Result<Vec<f64>> {
    let Some(column) = attributes.get(name) else {
        let seen = Seen::new([("top", name.to_string())]);
        seen.finish(attributes.columns.iter().map(|c| c.name.as_str()))?;
        return Ok(Vec::new());
    };
    let value = |i: usize| match &column.values {
        Values::U32(v) => f64::from(v[i]),
        Values::I32(v) => f64::from(v[i]),
        Values::F64(v) => v[i],
        Values::Text(v) => v.get(i).trim().parse().unwrap_or(f64::NAN),
        Values::Bool(_) => f64::NAN,
    };
    Ok((0..column.values.len()).map(|i| if column.present[i] { value(i) } else { f64::NAN }).collect())
}

fn flatten(b: &Buildings, i: usize, params: &Footprint, elevations: Option<&[f64]>) -> Result<Flat, &'static str> {
    // (1) The ground, from the highest level down; where none has one, the outline of the highest roof.
    let levels: Vec<usize> =
        b.geometries_of(i).rev().filter(|&g| params.lod.is_empty() || b.lods.get(g) == params.lod).collect();
    let stand = |faces: &dyn Fn(usize) -> Vec<usize>| {
        levels.iter().find_map(|&g| {
            let faces = faces(g);
            let mut repairs = Repairs::default();
            let polygons: Vec<_> = faces.iter().filter_map(|&p| plan(b, p, &mut repairs)).collect();
            repairs.flat_parts |= polygons.len() < faces.len();
            (!polygons.is_empty()).then_some((g, faces, polygons, repairs))
        })
    };
    let said = stand(&|g| ground(b, g));
    let none = said.is_none();
    let (geometry, faces, mut polygons, repairs) =
        said.or_else(|| stand(&|g| roofs(b, g))).ok_or("no ground surface")?;
    if polygons.len() > 1 {
        polygons = union(&polygons);
    }
    if polygons.is_empty() {
        return Err("no ground surface");
    }
    let under = if none { b.surfaces.polygons_of(geometry).collect() } else { faces };
    let lowest = under.iter().flat_map(|&p| shell(b, p)).map(|v| v[2]).min().ok_or("no ground surface")?;
    let base = f64::from(lowest) / 1000.0;
    // (2) The roof: of the level that gave the ground, else of the highest that has one above it.
    let top = match (params.top.as_str(), elevations) {
        ("measuredHeight", Some(v)) => base + v[i],
        (_, Some(v)) => v[i],
        (how, None) => {
            let all: Vec<f64> =
                std::iter::once(&geometry).chain(&levels).filter_map(|&g| roof(b, g, how == "max")).collect();
            *all.iter().find(|&&top| top > base).or(all.first()).ok_or("no roof surface")?
        }
    };
    if top.is_nan() {
        return Err("no elevation of the roof among its attributes");
    }
    if top <= base {
        return Err("a roof that is not above its ground");
    }
    Ok(Flat { geometry, polygons, base, top, repairs })
}

fn shell(b: &Buildings, polygon: usize) -> &[[i32; 3]] {
    b.surfaces.ring(b.surfaces.rings_of(polygon).start)
}

/// The polygons of geometry `g` on which it stands.
fn ground(b: &Buildings, g: usize) -> Vec<usize> {
    let all = b.surfaces.polygons_of(g);
    let said: Vec<usize> = all.clone().filter(|&p| b.semantics[p] == GROUND).collect();
    if !said.is_empty() {
        return said;
    }
    let ups: Vec<f64> = all.clone().map(|p| up(shell(b, p))).collect();
    // Flat within 25 degrees or so, and looking down; or nothing but flat faces, whichever way they look.
    let down: Vec<usize> = all.clone().zip(&ups).filter(|(_, up)| **up < -0.9).map(|(p, _)| p).collect();
    if !down.is_empty() {
        return down;
    }
    if ups.iter().all(|up| up.abs() > 0.9) { all.collect() } else { Vec::new() }
}

/// Vertical part of the unit normal (Newell): 1 looks up. 0 for what has no area.
fn up(ring: &[[i32; 3]]) -> f64 {
    let mut n = [0.0; 3];
    let o = ring[0].map(f64::from);
    let mut a = ring[ring.len() - 1];
    for &b in ring {
        let (p, q): ([f64; 3], [f64; 3]) =
            (std::array::from_fn(|k| f64::from(a[k]) - o[k]), std::array::from_fn(|k| f64::from(b[k]) - o[k]));
        n = [n[0] + p[1] * q[2] - p[2] * q[1], n[1] + p[2] * q[0] - p[0] * q[2], n[2] + p[0] * q[1] - p[1] * q[0]];
        a = b;
    }
    let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
    if length > 0.0 { n[2] / length } else { 0.0 }
}

/// A surface seen from above.
fn plan(b: &Buildings, polygon: usize, repairs: &mut Repairs) -> Option<Vec<Vec<Point>>> {
    let rings = b.surfaces.rings_of(polygon).map(|r| {
        let mut ring: Vec<Point> = b.surfaces.ring(r).iter().map(|v| [v[0], v[1]]).collect();
        // As files have them: closed.
        ring.extend(ring.first().copied());
        ring
    });
    repair::polygon(rings, repairs)
}

/// The polygons of geometry `g` that are called roofs; where none is, those that look up.
fn roofs(b: &Buildings, g: usize) -> Vec<usize> {
    let all = b.surfaces.polygons_of(g);
    let said: Vec<usize> = all.clone().filter(|&p| b.semantics[p] == ROOF).collect();
    if said.is_empty() { all.filter(|&p| up(shell(b, p)) > 0.1).collect() } else { said }
}

/// Elevation of the roof in metres: its mean weighted by plan area, or its highest point.
fn roof(b: &Buildings, g: usize, highest: bool) -> Option<f64> {
    let faces = roofs(b, g);
    if highest {
        return faces.iter().flat_map(|&p| shell(b, p)).map(|v| f64::from(v[2]) / 1000.0).reduce(f64::max);
    }
    let (mut area, mut volume) = (0.0, 0.0);
    for p in faces {
        let [mut face_area, mut face_volume] = [0.0; 2];
        for (k, r) in b.surfaces.rings_of(p).enumerate() {
            let [a, v] = below(b.surfaces.ring(r));
            // A hole takes away, whichever way it turns.
            let sign = if k == 0 || (a > 0.0) != (face_area > 0.0) { 1.0 } else { -1.0 };
            face_area += sign * a;
            face_volume += sign * v;
        }
        let sign = if face_area < 0.0 { -1.0 } else { 1.0 };
        area += sign * face_area;
        volume += sign * face_volume;
    }
    (area > 0.0).then(|| volume / area)
}

/// Twice the plan area of a ring in square metres, and twice the volume between it and height 0; negative where it
/// turns clockwise.
fn below(ring: &[[i32; 3]]) -> [f64; 2] {
    let metres = |v: [i32; 3], o: [i32; 3]| [0, 1].map(|k| (f64::from(v[k]) - f64::from(o[k])) / 1000.0);
    let mut sum = [0.0; 2];
    for w in ring[1..].windows(2) {
        let (p, q) = (metres(w[0], ring[0]), metres(w[1], ring[0]));
        let area = p[0] * q[1] - p[1] * q[0];
        let height = (f64::from(ring[0][2]) + f64::from(w[0][2]) + f64::from(w[1][2])) / 3000.0;
        sum = [sum[0] + area, sum[1] + area * height];
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::artifact::buildings::{OTHER, WALL};
    use crate::geom::frame::Frame;
    use crate::geom::ring::area_m2;
    use crate::op::Bench;

    /// Faces of a box with a roof that rises from `low` to `high` along x.
    fn shed(x: i32, low: i32, high: i32) -> Vec<(u8, Vec<[i32; 3]>)> {
        let p = |dx: i32, y: i32, z: i32| [x + dx, y, z];
        let (l, h) = (low, high);
        vec![
            (GROUND, vec![p(0, 0, 0), p(0, 10_000, 0), p(10_000, 10_000, 0), p(10_000, 0, 0)]),
            (ROOF, vec![p(0, 0, l), p(10_000, 0, h), p(10_000, 10_000, h), p(0, 10_000, l)]),
            (WALL, vec![p(0, 0, 0), p(10_000, 0, 0), p(10_000, 0, h), p(0, 0, l)]),
        ]
    }

    type Geometry<'a> = (&'a str, Vec<(u8, Vec<[i32; 3]>)>);

    fn buildings(all: &[Vec<Geometry>]) -> Buildings {
        let mut b = Buildings {
            frame: Frame::local(),
            ids: (0..all.len()).map(|i| format!("b{i}")).collect(),
            attributes: Default::default(),
            starts: vec![0],
            lods: Strings::default(),
            surfaces: Shapes::default(),
            semantics: Vec::new(),
        };
        for geometries in all {
            for (lod, faces) in geometries {
                b.lods.push(lod);
                for (kind, ring) in faces {
                    b.surfaces.push_ring(ring);
                    b.surfaces.end_polygon();
                    b.semantics.push(*kind);
                }
                b.surfaces.end_shape();
            }
            b.starts.push(b.lods.len() as u32);
        }
        b
    }

    fn run(params: &str, b: &Buildings) -> (Result<Footprints>, crate::diag::Findings) {
        let bench = Bench::default();
        let op: Footprint = toml::from_str(params).unwrap();
        let out = op.run(&bench.ctx(), In { buildings: Arc::new(b.clone()) });
        (out, bench.report.finish())
    }

    #[test]
    fn mean_and_highest_roof() {
        let b = buildings(&[vec![("2.2", shed(0, 4_000, 8_000))]]);
        let out = run("", &b).0.unwrap();
        assert_eq!((out.base[0], out.top[0]), (0.0, 6.0));
        assert_eq!(area_m2(out.polygons.ring(0)), 100.0);
        assert_eq!(run("top = 'max'", &b).0.unwrap().top, [8.0]);
        assert_eq!(run("top = 'height'", &b).0.unwrap_err().code, "unknown-attribute");
    }

    #[test]
    fn without_semantics() {
        let faces = shed(0, 4_000, 8_000).into_iter().map(|(_, r)| (OTHER, r)).collect();
        let out = run("", &buildings(&[vec![("1", faces)]])).0.unwrap();
        assert_eq!((out.base[0], out.top[0], area_m2(out.polygons.ring(0))), (0.0, 6.0, 100.0));
    }

    #[test]
    fn levels_of_detail() {
        let ground = vec![(OTHER, vec![[0, 0, 0], [20_000, 0, 0], [20_000, 10_000, 0], [0, 10_000, 0]])];
        let no_ground = shed(0, 9_000, 9_000).split_off(2);
        let b = buildings(&[vec![("0", ground), ("1.2", shed(0, 3_000, 3_000)), ("2.2", no_ground)]]);
        let (out, f) = run("", &b);
        assert_eq!(out.unwrap().top, [3.0]);
        assert_eq!(f.facts["lods"]["1.2"], 1);
        // A footprint alone has no roof above it.
        let (out, f) = run("lod = '0'\nmax-rejected = 1.0", &b);
        assert_eq!(out.unwrap_err().code, "no-features");
        assert_eq!(f.rejects[0].cause, "a roof that is not above its ground");
        let e = run("lod = '3'", &b).0.unwrap_err();
        assert_eq!(e.suggestion.as_deref(), Some("there are 0, 1.2, 2.2"));
    }

    #[test]
    fn without_a_floor() {
        let open = shed(0, 4_000, 8_000).into_iter().map(|(_, r)| (OTHER, r)).skip(1).collect();
        let out = run("", &buildings(&[vec![("1", open)]])).0.unwrap();
        assert_eq!((out.base[0], out.top[0], area_m2(out.polygons.ring(0))), (0.0, 6.0, 100.0));
    }

    #[test]
    fn parts_are_joined() {
        let two = |x| [shed(0, 2_000, 2_000), shed(x, 6_000, 6_000)].concat();
        let out = run("", &buildings(&[vec![("2", two(10_000))], vec![("2", two(11_000))]])).0.unwrap();
        assert_eq!((out.polygons.polygons_of(0).len(), out.polygons.polygons_of(1).len()), (1, 2));
        assert_eq!(area_m2(out.polygons.ring(0)), 200.0);
        assert_eq!(out.top, [4.0, 4.0]);
    }
}
