//! A mesh turned by 90 degrees about each axis, corners where snapping changes nothing: the grid turned.

use super::*;
use crate::artifact::voxels::stick_of;

/// Corners moved to `parts` to a cell of 1 m: the longest side is 24 m, from -12 to 12.
fn on_parts(mut body: Mesh, parts: f64) -> Mesh {
    let most = body.positions.iter().flatten().fold(0.0, |m: f64, c| m.max(c.abs()));
    body.positions.iter_mut().for_each(|p| *p = p.map(|c| (c / most * 12.0 * parts).round() / parts));
    body
}

/// A quarter turn about an axis, of a place and of a node.
fn turned(axis: usize, p: [f64; 3]) -> [f64; 3] {
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut out = p;
    (out[i], out[j]) = (0.0 - p[j], p[i]);
    out
}

fn turned_node(axis: usize, last: usize, n: [usize; 3]) -> [usize; 3] {
    turned(axis, n.map(|c| 2.0 * c as f64 - last as f64)).map(|c| (c as i64 + last as i64) as usize / 2)
}

fn octahedron() -> Mesh {
    let positions = (0..6).map(|i| [0, 1, 2].map(|k| if i / 2 == k { [1.0, -1.0][i % 2] } else { 0.0 })).collect();
    let sides = (0..8u32).map(|s| [s & 1, 2 + (s >> 1 & 1), 4 + (s >> 2 & 1)]);
    mesh(positions, sides.map(|[x, y, z]| if (x + y + z) % 2 == 0 { [x, y, z] } else { [x, z, y] }).collect())
}

#[test]
fn quarter_turns_about_each_axis() {
    let flat = {
        let mut it = torus(3.0, 1.0);
        it.positions.iter_mut().for_each(|p| p[1] *= 0.6);
        it
    };
    let open = {
        let mut it = flat.clone();
        it.triangles.retain(|t| it.positions[t[0] as usize][0] < 2.5);
        it
    };
    // Sides of 24, 15 and 9 cells: the first ends half way between nodes, the others on nodes.
    let plain = block([-12.0, -7.5, -4.5], [12.0, 7.5, 4.5]);
    // Coarse corners, in halves of a cell: many nodes lie on faces, and many faces run along rays.
    let bodies = [
        ("torus", on_parts(flat.clone(), 1024.0)),
        ("open torus", on_parts(open, 1024.0)),
        ("coarse torus", on_parts(flat, 2.0)),
        ("box", plain),
        ("octahedron", on_parts(octahedron(), 1.0)),
    ];
    for (name, body) in &bodies {
        for fill in FILLS {
            is_turned(name, body, &Voxelize { resolution: 24, fill, thin: Thin::Keep });
        }
    }
}

/// A plate of a fifth of a cell, not in the middle, held by a post.
#[test]
fn quarter_turns_of_a_thickened_plate() {
    for height in [3.6, 4.1] {
        let (post, plate) =
            (block([-12.0; 3], [-8.0, -8.0, 12.0]), block([-9.0, -9.0, height], [12.0, 12.0, height + 0.2]));
        let triangles = post.triangles.iter().copied().chain(plate.triangles.iter().map(|t| t.map(|v| v + 8)));
        let body = mesh([post.positions, plate.positions].concat(), triangles.collect());
        for fill in FILLS {
            let how = Voxelize { resolution: 24, fill, thin: Thin::Thicken };
            is_turned("plate", &body, &how);
            assert!(fill == Fill::Surface || grid(&body, &how).losses.thickened > 400);
        }
    }
}

/// A slanted plate of a third of a cell: its layer is up to three nodes thick, its rim does not vote.
#[test]
fn quarter_turns_of_a_slanted_plate() {
    let slanted = |[x, y, z]: [f64; 3]| [x + 0.37, 0.8 * y - 0.6 * z - 0.55 * x, 0.6 * y + 0.8 * z + 0.21];
    let mut plate = block([-9.0, -7.0, -0.15], [9.0, 7.0, 0.15]);
    plate.positions.iter_mut().for_each(|p| *p = slanted(*p).map(|c| (c * 1024.0).round() / 1024.0));
    for fill in [Fill::Winding, Fill::Parity, Fill::Flood] {
        let how = Voxelize { resolution: 24, fill, thin: Thin::Thicken };
        is_turned("plate", &plate, &how);
        let thick = grid(&plate, &how);
        assert!(thick.losses.thickened > 400 && thick.membrane.len() > 40, "{:?}", thick.losses);
    }
}

pub const FILLS: [Fill; 4] = [Fill::Winding, Fill::Parity, Fill::Flood, Fill::Surface];

/// Turned about each axis: no node differs, and no stick over a hole.
fn is_turned(name: &str, body: &Mesh, how: &Voxelize) {
    for axis in 0..3 {
        let mut other = body.clone();
        other.positions.iter_mut().for_each(|p| *p = turned(axis, *p));
        let (a, b) = (grid(body, how), grid(&other, how));
        let last = a.lattice.side() - 1;
        let differ = all(&a).filter(|&n| a.is_black(n) != b.is_black(turned_node(axis, last, n))).count();
        assert_eq!(differ, 0, "{name} about {axis}, {how:?}");
        assert_eq!(a.inside(), b.inside());
        let holes = |v: &Voxels| v.membrane.iter().map(|&m| stick_of(m)).collect::<Vec<_>>();
        let mut holes_turned: Vec<u64> = holes(&a)
            .into_iter()
            .map(|(black, direction)| {
                let to = turned(axis, STEPS[usize::from(direction)].map(f64::from)).map(|c| c as i32);
                let direction = STEPS.iter().position(|&s| s == to).unwrap() as u8;
                stick_number(turned_node(axis, last, black.map(usize::from)).map(|c| c as u16), direction)
            })
            .collect();
        holes_turned.sort_unstable();
        assert_eq!(holes_turned, b.membrane, "{name} about {axis}, {how:?}");
    }
}
