//! Plane tiles for other programs: as JSON with all their sticks, and as quads that one can look at.

use serde_json::json;

use crate::artifact::mesh::{Material, Primitive, Surface};
use crate::artifact::voxels::{STEPS, stick_of};
use crate::artifact::{Attributes, Column, Mesh, PlaneTiles, Values};
use crate::diag::Result;
use crate::geom::space::{cross, dot};

use super::gltf::{self, Written};

/// Patterns that a plane makes, of both orientations of the stick: 5 x 5 x 4 and 3 x 3 x 2 nodes.
const DICTIONARY: [u32; 2] = [32_986, 442];

/// `{"tiles": [..], "left_over": {..}, "dictionary": {..}, "grid": {..}}`, metres, z up. Of a tile: `normal` (unit,
/// outward), `offset` (inside is normal . x <= offset), `votes`, `captured`, `stage`, `w` (the plane as exact integers:
/// its field at the grid's corners (0,0,0), (N,N,0), (N,0,N), (0,N,N)), `sticks` (all captured ones, [black, white],
/// the `votes` that voted first). `left_over` counts the sticks of no tile by cause; `dictionary` has the patterns of both
/// orientations of a stick.
pub fn json(of: &PlaneTiles) -> Result<Vec<u8>> {
    // Tile by tile: as one value, ten times the memory.
    let mut out = String::from("{\"tiles\": [");
    for i in 0..of.len() {
        let (normal, offset) = of.lattice.plane(of.planes[i]);
        let sticks: Vec<[[f64; 3]; 2]> = of.taken(i).iter().map(|&number| ends(of, number)).collect();
        let tile = json!({
            "normal": normal, "offset": offset, "votes": of.votes[i], "captured": sticks.len(),
            "stage": if of.stages[i] == 0 { "flat" } else { "small" }, "w": of.planes[i], "sticks": sticks,
        });
        out += if i > 0 { ",\n" } else { "\n" };
        out += &tile.to_string();
    }
    let mut left = serde_json::to_value(of.left_over).expect("four numbers");
    left["membrane"] = json!(of.left_over.membrane);
    let [large, small] = DICTIONARY;
    let grid = json!({ "origin": of.lattice.origin, "cell": of.lattice.cell, "cells": of.lattice.cells });
    let tail = json!({ "large": large, "small": small });
    out += &format!("\n],\n\"left_over\": {left},\n\"dictionary\": {tail},\n\"grid\": {grid}}}\n");
    Ok(out.into_bytes())
}

/// Black and white end of a stick, metres.
fn ends(of: &PlaneTiles, number: u64) -> [[f64; 3]; 2] {
    let (black, direction) = stick_of(number);
    let step = STEPS[usize::from(direction)].map(f64::from);
    let black = black.map(f64::from);
    [black, [0, 1, 2].map(|k| black[k] + step[k])].map(|p| of.lattice.to_metres(p))
}

/// The quads of [`quads`] as one GLB; what each tile is are attributes of its feature.
pub fn glb(of: &PlaneTiles) -> Result<Written> {
    gltf::mesh(&quads(of))
}

/// A picture of the quads from 14 sides.
pub fn sheet(of: &PlaneTiles) -> Result<Vec<u8>> {
    super::views::sheet(&quads(of))
}

/// Each tile as the rectangle in its plane that spans its sticks, one colour each.
pub fn quads(of: &PlaneTiles) -> Mesh {
    let n = of.len();
    let mut positions = Vec::with_capacity(4 * n);
    let (mut normals, mut colours) = (Vec::with_capacity(4 * n), Vec::with_capacity(4 * n));
    for i in 0..n {
        let (normal, offset) = of.lattice.plane(of.planes[i]);
        positions.extend(rectangle(of, i, normal, offset));
        normals.extend([normal.map(|c| c as f32); 4]);
        colours.extend([colour(i as u32); 4]);
    }
    let column = |name: &str, values: Values| Column { name: name.into(), values, present: vec![true; n] };
    let captured = (0..n).map(|i| of.taken(i).len() as u32).collect();
    let stages = of.stages.iter().map(|&s| if s == 0 { "flat" } else { "small" }).collect();
    Mesh {
        frame: of.frame.clone(),
        positions,
        triangles: (0..n as u32).flat_map(|q| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|c| 4 * q + c))).collect(),
        features: (0..4 * n as u32).map(|v| v / 4).collect(),
        primitives: vec![Primitive {
            name: "tiles".into(),
            first_triangle: 0,
            triangles: 2 * n as u32,
            material: Some(0),
        }],
        feature_ids: (0..n).map(|i| format!("tile-{i}")).collect::<Vec<_>>().iter().map(|s| &**s).collect(),
        attributes: Attributes {
            columns: vec![
                column("captured", Values::U32(captured)),
                column("stage", Values::Text(stages)),
                column("votes", Values::U32(of.votes.clone())),
            ],
        },
        surface: Surface {
            normals,
            colours,
            materials: vec![Material { name: "tiles".into(), double_sided: true, ..Material::default() }],
            ..Surface::default()
        },
    }
}

/// Along the horizontal of the plane; half a cell around the sticks' middles, so that none has no area.
fn rectangle(of: &PlaneTiles, i: usize, n: [f64; 3], offset: f64) -> [[f64; 3]; 4] {
    let level = (n[0] * n[0] + n[1] * n[1]).sqrt();
    let u = if level > 1e-9 { [-n[1] / level, n[0] / level, 0.0] } else { [1.0, 0.0, 0.0] };
    let v = cross(n, u);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for &number in of.taken(i) {
        let [black, white] = ends(of, number);
        let middle = [0, 1, 2].map(|k| (black[k] + white[k]) / 2.0);
        for (k, axis) in [u, v].into_iter().enumerate() {
            let at = dot(middle, axis);
            (low[k], high[k]) = (low[k].min(at), high[k].max(at));
        }
    }
    let half = of.lattice.cell / 2.0;
    let [a, b] = [0, 1].map(|k| if low[k] <= high[k] { [low[k] - half, high[k] + half] } else { [0.0; 2] });
    [(a[0], b[0]), (a[1], b[0]), (a[1], b[1]), (a[0], b[1])]
        .map(|(s, t)| [0, 1, 2].map(|k| s * u[k] + t * v[k] + offset * n[k]))
}

/// Colours that differ from their neighbours'.
fn colour(i: u32) -> [f32; 4] {
    // The golden ratio in hue, thirds in brightness.
    let hue = (f64::from(i) * 0.618_033_988_75).fract() * 6.0;
    let light = 1.0 - 0.2 * f64::from(i % 3);
    let channel = |shift: f64| {
        let d = (hue + shift).rem_euclid(6.0);
        let v = (d - 3.0).abs() - 1.0;
        (light * (0.2 + 0.8 * v.clamp(0.0, 1.0))) as f32
    };
    [channel(0.0), channel(4.0), channel(2.0), 1.0]
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::artifact::plane_tiles::{Given, LeftOver};
    use crate::artifact::voxels::stick_number;
    use crate::geom::frame::Frame;
    use crate::geom::lattice::Lattice;

    /// A plane z = 0.5 m with four sticks, looking up.
    fn one() -> PlaneTiles {
        let lattice = Lattice::around([0.0; 3], [4.0, 2.0, 1.0], 4);
        let stick = |x, y| stick_number([x, y, 3], 4);
        PlaneTiles {
            frame: Frame::local(),
            lattice,
            planes: vec![[1, 1, -1, -1]],
            votes: vec![3],
            stages: vec![0],
            starts: vec![0, 4],
            sticks: vec![stick(2, 3), stick(3, 3), stick(2, 4), stick(3, 4)],
            given: Given { sticks: 9, ..Given::default() },
            left_over: LeftOver { not_a_pattern: 2, membrane: 3, ..LeftOver::default() },
        }
    }

    #[test]
    fn as_the_contract_says() {
        let value: Value = serde_json::from_slice(&json(&one()).unwrap()).unwrap();
        let tile = &value["tiles"][0];
        assert_eq!(tile["normal"], json!([0.0, 0.0, 1.0]));
        assert!((tile["offset"].as_f64().unwrap() - 0.5).abs() < 1e-12);
        assert_eq!((&tile["votes"], &tile["captured"], &tile["stage"]), (&json!(3), &json!(4), &json!("flat")));
        assert_eq!(tile["w"], json!([1, 1, -1, -1]));
        assert_eq!(tile["sticks"][1], json!([[1.5, 0.5, 0.0], [1.5, 0.5, 1.0]]));
        let left = json!({"below-min-votes": 0, "unsampled": 0, "not-a-pattern": 2, "membrane": 3});
        assert_eq!((&value["left_over"], &value["dictionary"]["large"]), (&left, &json!(32_986)));
        assert_eq!(value["grid"], json!({"origin": [-1.5, -2.5, -3.0], "cell": 1.0, "cells": 7}));
    }

    #[test]
    fn a_quad_spans_its_sticks() {
        let mesh = quads(&one());
        let corner = |x, y| [x, y, 0.5];
        let mut found = mesh.positions.clone();
        found.sort_by(|a, b| a.partial_cmp(b).unwrap());
        let want = [corner(0.0, 0.0), corner(0.0, 2.0), corner(2.0, 0.0), corner(2.0, 2.0)];
        assert!(found.iter().flatten().zip(want.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
        // Counter-clockwise from outside.
        let [a, b, c] = mesh.triangles[0].map(|v| mesh.positions[v as usize]);
        assert!((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0);
        let bytes = glb(&one()).unwrap().bytes;
        assert_eq!(::gltf::Gltf::from_slice(&bytes).unwrap().nodes().next().unwrap().name(), Some("tile-0"));
    }
}
