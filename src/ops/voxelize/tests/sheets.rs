//! What thickening never does, on random small meshes in all fills; and the layer of a plate against its definition.

use super::turns::FILLS;
use super::*;
use crate::artifact::voxels::stick_of;

/// Numbers that a seed gives.
struct Dice(u64);

impl Dice {
    /// From -1 to 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / f64::from(1 << 23) - 1.0
    }
    fn place(&mut self, wide: f64) -> [f64; 3] {
        [0; 3].map(|_| wide * self.next())
    }
    /// A plate so thick that leans as it comes; a single face where that is 0.
    fn plate(&mut self, half: f64, thick: f64) -> Mesh {
        let n = self.place(1.0);
        let u = [n[1] - n[2], n[2] - n[0], n[0] - n[1]];
        let v = crate::geom::space::cross(n, u);
        let unit = |v: [f64; 3]| v.map(|c| c / v.iter().map(|c| c * c).sum::<f64>().sqrt());
        let axes = [unit(u), unit(v), unit(n)];
        let mut it = block([-half, -half, -thick / 2.0], [half, half, thick / 2.0]);
        let middle = self.place(0.5);
        let place = |p: [f64; 3]| [0, 1, 2].map(|k| middle[k] + (0..3).map(|i| p[i] * axes[i][k]).sum::<f64>());
        it.positions.iter_mut().for_each(|p| *p = place(*p));
        if thick == 0.0 {
            it.triangles = vec![[4, 5, 7], [4, 7, 6]];
        }
        it
    }
}

fn joined(all: impl IntoIterator<Item = Mesh>) -> Mesh {
    let mut out = mesh(Vec::new(), Vec::new());
    for one in all {
        let base = out.positions.len() as u32;
        out.positions.extend(one.positions);
        out.triangles.extend(one.triangles.iter().map(|t| t.map(|v| v + base)));
    }
    mesh(out.positions, out.triangles)
}

/// To so many parts of a metre.
fn coarse(of: Mesh, parts: f64) -> Mesh {
    mesh(of.positions.iter().map(|p| p.map(|c| (c * parts).round() / parts)).collect(), of.triangles)
}

/// About 12 m wide: loose triangles, plates that cross, shells with walls of half a metre, a plate on a body.
fn odd(dice: &mut Dice, kind: usize) -> Mesh {
    match kind {
        0 => joined((0..6).map(|_| mesh((0..3).map(|_| dice.place(6.0)).collect(), vec![[0, 1, 2]]))),
        1 => joined([0.0, 0.3, 0.8].map(|thick| dice.plate(6.0, thick))),
        2 => {
            let (wall, size) = (0.25 + 0.25 * dice.next(), 5.0 + dice.next());
            let mut inner = block([wall - size; 3], [size - wall; 3]);
            inner.triangles.iter_mut().for_each(|t| t.swap(0, 1));
            joined([block([-size; 3], [size; 3]), inner])
        }
        3 => joined([block(dice.place(6.0), [6.0; 3]), dice.plate(6.0, 0.4)]),
        // Two sheets about a cell apart, one a single face at the end of the box's longest side; what makes it the longest.
        _ => {
            let mut face = block([-6.0, -5.0, 5.0], [6.0, 5.0, 5.0 + dice.next().abs()]);
            face.triangles = vec![[4, 5, 7], [4, 7, 6]];
            joined([block([-6.0, -5.0, 4.0], [6.0, 5.0, 4.4]), face, block([-1.0, -1.0, -9.0], [1.0, 1.0, -8.0])])
        }
    }
}

/// Colours and marks, of a grid that keeps to the rules.
fn sound(name: &str, body: &Mesh, how: &Voxelize) -> Voxels {
    let thick = grid(body, how);
    let kept = grid(body, &Voxelize { thin: Thin::Keep, ..*how });
    assert!(kept.black.iter().zip(&thick.black).all(|(k, t)| k & !t == 0), "{name}: whitened");
    assert_eq!(thick.inside() - kept.inside(), thick.losses.thickened, "{name}: nodes that were black");
    assert_eq!((kept.losses.crossed, kept.losses.lost), (thick.losses.crossed, thick.losses.lost));
    let sticks: Vec<u64> = thick.sticks().iter().map(|&(black, d)| stick_number(black, d)).collect();
    assert!(
        thick.membrane.is_sorted_by(|a, b| a < b) && thick.membrane.iter().all(|m| sticks.binary_search(m).is_ok()),
        "{name}: no stick"
    );
    // The surface ends half a cell from the second layer.
    let (last, white) = (thick.lattice.side() - 1, if how.fill == Fill::Surface { 1 } else { 2 });
    let outer = |n: &[usize; 3]| n.iter().any(|&c| c < white || c + white > last);
    assert_eq!(all(&thick).filter(outer).find(|&n| thick.is_black(n)), None, "{name}: black in an outer layer");
    thick
}

#[test]
fn thickening_keeps_to_its_rules() {
    let pools = [1, 3].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    for (seed, kind) in (0..24).flat_map(|seed| (0..5).map(move |kind| (seed, kind))) {
        // As they come, on halves of metres, and far away: there corners lie up to 1/500 of a cell off.
        let body = match (odd(&mut Dice(seed), kind), seed % 3) {
            (body, 0) => body,
            (body, 1) => coarse(body, 2.0),
            (body, _) => {
                let to = Dice(seed).place(5e12);
                mesh(body.positions.iter().map(|p| [0, 1, 2].map(|k| p[k] + to[k])).collect(), body.triangles)
            }
        };
        for fill in FILLS {
            let resolution = [2, 3, 12, 17][seed as usize % 4];
            let name = format!("seed {seed}, kind {kind}, {fill:?} at {resolution}");
            let how = Voxelize { resolution, fill, ..Voxelize::default() };
            let [a, b] = [0, 1].map(|i: usize| pools[i].install(|| sound(&name, &body, &how)));
            assert_eq!(a, b, "{name}: threads");
        }
    }
}

/// Closed plates and shells in a mirror, corners on nodes and between: nodes and marks in the mirror.
#[test]
fn a_mirror_shows_the_mirrored_layer() {
    for (seed, parts) in (0..12).flat_map(|seed| [(seed, 1024.0), (seed, 4.0), (seed, 2.0)]) {
        let (mut dice, kind) = (Dice(seed), seed % 4);
        let own = match kind {
            // Faces that are parallel to the last bit.
            0 => {
                let plate = coarse(dice.plate(6.0, 0.6), parts);
                let [a, b, c, d] = [0, 1, 2, 4].map(|i| plate.positions[i]);
                let place = |i: usize, k: usize| {
                    let step = |bit: usize, to: [f64; 3]| if i >> bit & 1 == 1 { to[k] - a[k] } else { 0.0 };
                    a[k] + step(0, b) + step(1, c) + step(2, d)
                };
                mesh((0..8).map(|i| [0, 1, 2].map(|k| place(i, k))).collect(), plate.triangles)
            }
            1 => coarse(odd(&mut dice, 2), parts),
            // Its lower face on nodes, or its middle half way between them.
            2 => block([-6.9, -4.9, 1.5], [6.9, 4.9, 1.6]),
            _ => block([-6.9, -4.9, 1.7], [6.9, 4.9, 1.8]),
        };
        // 36 cells of half a metre: an even number, so that of two nodes one is nearer to the middle.
        let body = joined([own, mesh(vec![[-8.25; 3], [8.25; 3]], vec![[0; 3], [1; 3]])]);
        // Distances to slanted faces are rounded: nodes just half a cell off may differ in `surface`.
        let fills = if kind == 0 { &FILLS[..3] } else { &FILLS };
        for (&fill, axis) in fills.iter().flat_map(|fill| (0..3).map(move |axis| (fill, axis))) {
            let how = Voxelize { resolution: 33, fill, thin: Thin::Thicken };
            let mut other = body.clone();
            other.positions.iter_mut().for_each(|p| p[axis] = 0.0 - p[axis]);
            other.triangles.iter_mut().for_each(|t| t.swap(1, 2));
            let (a, b) = (grid(&body, &how), grid(&other, &how));
            let mirrored = |n: [usize; 3]| [0, 1, 2].map(|k| if k == axis { 36 - n[k] } else { n[k] });
            // A line through the very edge of a slanted plate belongs to one of two faces: its rim is 5 m off.
            let is_far = |n: &[usize; 3]| n.iter().all(|c| kind != 0 || (10..=26).contains(c));
            let name = format!("seed {seed}, 1/{parts}, {fill:?}, axis {axis}");
            let differ: Vec<_> = all(&a).filter(|n| is_far(n) && a.is_black(*n) != b.is_black(mirrored(*n))).collect();
            assert!(differ.is_empty(), "{name}: {differ:?}");
            let mut marks = [&a, &b].map(|v| v.membrane.iter().map(|&m| stick_of(m)).collect::<Vec<_>>());
            for (black, direction) in &mut marks[1] {
                *black = mirrored(black.map(usize::from)).map(|c| c as u16);
                *direction ^= u8::from(usize::from(*direction / 2) == axis);
            }
            let [a, mut b] =
                marks.map(|all| all.into_iter().filter(|m| is_far(&m.0.map(usize::from))).collect::<Vec<_>>());
            b.sort_by_key(|&(black, direction)| stick_number(black, direction));
            assert_eq!(a, b, "{name}");
        }
    }
}

/// Nodes three cells from the rim are black where the plane's definition says so: |distance| <= (|a| + |b| + |c|) / 2.
#[test]
fn a_plate_is_a_digital_plane() {
    let (half, mut decided, mut black) = (12.0, 0, 0);
    for seed in 0..40 {
        let plate = Dice(100 + seed).plate(half, [0.0, 0.05, 0.4, 0.9][seed as usize % 4]);
        let p = &plate.positions;
        let middle = [0, 1, 2].map(|k| (p[0][k] + p[7][k]) / 2.0);
        let along = |i: usize, j: usize| [0, 1, 2].map(|k| (p[j][k] - p[i][k]) / (2.0 * half));
        let (u, v, n) = (along(0, 1), along(0, 2), crate::geom::space::cross(along(0, 1), along(0, 2)));
        // Wide enough that a cell is a metre.
        let width = (0..3).map(|k| p.iter().map(|p| p[k]).fold(f64::MIN, f64::max) * 2.0 - 2.0 * middle[k]);
        let resolution = width.fold(0.0, f64::max).round() as u32;
        for fill in [Fill::Winding, Fill::Parity, Fill::Flood] {
            let it = grid(&plate, &Voxelize { resolution, fill, thin: Thin::Thicken });
            let cell = it.lattice.cell;
            let reach = n.iter().map(|c| c.abs()).sum::<f64>() / 2.0;
            // What the normal's code and the slack for it make of the reach at most.
            let most = n.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
            let slack = most * (0.5 / (most / (2.0 * reach) - 0.0091) + 0.001) - reach;
            for node in all(&it) {
                let at = it.lattice.to_metres(node.map(|c| c as f64));
                let off = [0, 1, 2].map(|k| (at[k] - middle[k]) / cell);
                let [x, y, z] = [u, v, n].map(|axis| crate::geom::space::dot(axis, off));
                if x.abs().max(y.abs()) > half / cell - 3.0 || (z.abs() > reach - 0.001 && z.abs() < reach + slack) {
                    continue;
                }
                assert_eq!(it.is_black(node), z.abs() < reach, "seed {seed}, {fill:?}, {node:?}: {z} of {reach}");
                decided += 1;
                black += usize::from(it.is_black(node));
            }
        }
    }
    assert!(decided > 500_000 && black > 40_000, "{black} of {decided}");
}
