mod fills;
mod sheets;
mod turns;

use super::*;

fn mesh(positions: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> Mesh {
    let features = vec![0; positions.len()];
    Mesh {
        frame: Frame::local(),
        positions,
        triangles,
        features,
        primitives: Vec::new(),
        feature_ids: ["it"].into_iter().collect(),
        attributes: Default::default(),
        surface: Default::default(),
    }
}

/// A closed box between two corners, faces outside.
fn block(low: [f64; 3], high: [f64; 3]) -> Mesh {
    let positions = (0..8).map(|i| [0, 1, 2].map(|k| if i >> k & 1 == 0 { low[k] } else { high[k] })).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    mesh(positions, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect())
}

/// A grid of n x m quads wrapped both ways (a torus) or once with two poles (a sphere).
fn wrapped(n: u32, m: u32, torus: bool, at: impl Fn(f64, f64) -> [f64; 3]) -> Mesh {
    let rows = if torus { m } else { m + 1 };
    let positions = (0..rows)
        .flat_map(|j| (0..n).map(move |i| (f64::from(i) / f64::from(n), f64::from(j) / f64::from(m))))
        .map(|(u, v)| at(u, v))
        .collect();
    let triangles = (0..m)
        .flat_map(|j| (0..n).map(move |i| (i, j)))
        .flat_map(|(i, j)| {
            let v = |i: u32, j: u32| j % rows * n + i % n;
            [[v(i, j), v(i, j + 1), v(i + 1, j)], [v(i + 1, j), v(i, j + 1), v(i + 1, j + 1)]]
        })
        .filter(|t| t[0] != t[1] && t[1] != t[2] && t[0] != t[2])
        .collect();
    mesh(positions, triangles)
}

const TURN: f64 = std::f64::consts::TAU;

fn sphere(r: f64, c: [f64; 3]) -> Mesh {
    wrapped(96, 48, false, |u, v| {
        let (a, b) = (u * TURN, v * TURN / 2.0);
        [c[0] + r * libm::sin(b) * libm::cos(a), c[1] + r * libm::sin(b) * libm::sin(a), c[2] + r * libm::cos(b)]
    })
}

fn torus(r: f64, tube: f64) -> Mesh {
    wrapped(120, 48, true, |u, v| {
        let (a, b) = (u * TURN, v * TURN);
        let out = r + tube * libm::cos(b);
        [out * libm::cos(a), out * libm::sin(a), 0.0 - tube * libm::sin(b)]
    })
}

fn grid(mesh: &Mesh, how: &Voxelize) -> Voxels {
    let (snapped, lattice, _) = snap(mesh, how.resolution).unwrap();
    voxelize(&snapped, lattice, &mesh.frame, how).0
}

fn all(v: &Voxels) -> impl Iterator<Item = [usize; 3]> {
    let n = v.lattice.side();
    (0..n * n * n).map(move |i| [i % n, i / n % n, i / (n * n)])
}

/// Every node with its distance (positive inside) from a body that the mesh approximates to `band`.
fn agrees(v: &Voxels, band: f64, inside: impl Fn([f64; 3]) -> f64) {
    let mut decided = 0;
    for node in all(v) {
        let d = inside(v.lattice.to_metres(node.map(|c| c as f64)));
        if d.abs() > band {
            assert_eq!(v.is_black(node), d > 0.0, "{node:?}: {d}");
            decided += 1;
        }
    }
    assert!(decided > v.lattice.side().pow(3) * 8 / 10);
}

const SOLID: [Fill; 3] = [Fill::Winding, Fill::Parity, Fill::Flood];

#[test]
fn analytic_bodies() {
    for fill in SOLID {
        let how = Voxelize { resolution: 40, fill, thin: Thin::Keep };
        let (low, high) = ([0.13, -1.7, 2.0], [9.0, 3.31, 4.77]);
        agrees(&grid(&block(low, high), &how), 1e-9, |p| {
            (0..3).map(|k| (p[k] - low[k]).min(high[k] - p[k])).fold(f64::INFINITY, f64::min)
        });
        let c = [3.0, 4.0, 5.1];
        agrees(&grid(&sphere(2.0, c), &how), 0.006, |p| {
            2.0 - (0..3).map(|k| (p[k] - c[k]) * (p[k] - c[k])).sum::<f64>().sqrt()
        });
        let v = grid(&torus(3.0, 1.0), &how);
        agrees(&v, 0.01, |p| {
            let off = (p[0] * p[0] + p[1] * p[1]).sqrt() - 3.0;
            1.0 - (off * off + p[2] * p[2]).sqrt()
        });
        assert!(!v.losses.leaked && v.membrane.is_empty());
    }
}

#[test]
fn nodes_on_the_surface_are_black() {
    // Corners on nodes: the box of 4 x 4 x 4 nodes, at a resolution that puts them there.
    let mut body = block([0.0; 3], [4.0; 3]);
    for fill in SOLID {
        // 5 cells over a box of 5 would end between nodes: pad with a far corner to shift the grid by half a cell.
        body.positions.push([0.0; 3]);
        let how = Voxelize { resolution: 5, fill, thin: Thin::Keep };
        let (mut snapped, lattice, _) = snap(&body, how.resolution).unwrap();
        // Whole cells: 2 to 6 on every axis.
        snapped.vertices.iter_mut().for_each(|v| {
            *v = v.map(|c| if i64::from(c) > 4 * UNIT { 6 * UNIT as i32 } else { 2 * UNIT as i32 });
        });
        let (v, _) = voxelize(&snapped, lattice, &body.frame, &how);
        assert_eq!(v.inside(), 125, "{fill:?}");
        assert!(v.membrane.is_empty(), "{fill:?}");
    }
}

/// A body inside out, two that overlap, one inside another that looks the same way.
#[test]
fn winding_of_odd_bodies() {
    let how = Voxelize { resolution: 30, thin: Thin::Keep, ..Voxelize::default() };
    let mut turned = torus(3.0, 1.0);
    turned.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    assert_eq!(grid(&turned, &how).black, grid(&torus(3.0, 1.0), &how).black);

    let join = |a: Mesh, b: Mesh| {
        let base = a.positions.len() as u32;
        let positions = a.positions.into_iter().chain(b.positions).collect();
        mesh(positions, a.triangles.into_iter().chain(b.triangles.iter().map(|t| t.map(|v| v + base))).collect())
    };
    let two = join(block([0.0; 3], [4.0, 3.0, 2.0]), block([2.0, 1.0, 1.0], [6.0, 2.0, 5.0]));
    agrees(&grid(&two, &how), 1e-9, |p| {
        let inside = |low: [f64; 3], high: [f64; 3]| {
            (0..3).map(|k| (p[k] - low[k]).min(high[k] - p[k])).fold(f64::INFINITY, f64::min)
        };
        inside([0.0; 3], [4.0, 3.0, 2.0]).max(inside([2.0, 1.0, 1.0], [6.0, 2.0, 5.0]))
    });
    let nested = join(block([0.0; 3], [4.0; 3]), block([1.0; 3], [3.0; 3]));
    assert_eq!(grid(&nested, &how).black, grid(&block([0.0; 3], [4.0; 3]), &how).black);
}

/// A sphere with a hole: `winding` closes it, `flood` says that it ran out.
#[test]
fn an_open_body_does_not_leak() {
    let mut open = sphere(2.0, [0.0; 3]);
    let closed = grid(&open, &Voxelize { resolution: 32, thin: Thin::Keep, ..Voxelize::default() });
    // A cap of 22 degrees.
    open.triangles.retain(|t| open.positions[t[0] as usize][2] < 1.85);
    let v = grid(&open, &Voxelize { resolution: 32, thin: Thin::Keep, ..Voxelize::default() });
    let differ = all(&v).filter(|&n| n[2] < v.lattice.side() * 4 / 5 && v.is_black(n) != closed.is_black(n)).count();
    // The open one is a little lower, so its grid is shifted: a shell's worth of nodes at most.
    assert!(differ as f64 <= 0.12 * closed.inside() as f64, "{differ}");
    assert!(!v.membrane.is_empty());
    let mut keys: Vec<u64> = v.membrane.clone();
    keys.dedup();
    assert_eq!(keys.len(), v.membrane.len());
    let flooded = grid(&open, &Voxelize { resolution: 32, fill: Fill::Flood, thin: Thin::Keep });
    assert!(flooded.losses.leaked);
}

/// The shortcuts of `winding` against the number itself at every node.
#[test]
fn winding_as_defined() {
    let mut open = torus(3.0, 1.0);
    open.triangles.retain(|t| open.positions[t[0] as usize][0] < 2.5 || open.positions[t[0] as usize][1] > 0.5);
    let how = Voxelize { resolution: 48, thin: Thin::Keep, ..Voxelize::default() };
    let (snapped, lattice, _) = snap(&open, how.resolution).unwrap();
    let (v, doubtful) = voxelize(&snapped, lattice, &open.frame, &how);
    assert!(doubtful > 1000);
    let tree = winding::Tree::new(&snapped, false);
    let differ = all(&v).filter(|&n| (tree.at(n.map(|c| c as f64)) >= 0.5) != v.is_black(n)).count();
    assert!(differ <= 20, "{differ} of {}", v.inside());
}

#[test]
fn a_turn_by_90_degrees_turns_the_result() {
    let body = {
        let mut it = torus(3.0, 1.0);
        it.triangles.retain(|t| it.positions[t[0] as usize][0] < 2.5);
        it.positions.iter_mut().for_each(|p| p[1] *= 0.6);
        it
    };
    let mut turned = body.clone();
    turned.positions.iter_mut().for_each(|p| *p = [-p[1], p[0], p[2]]);
    for fill in [Fill::Winding, Fill::Parity, Fill::Flood, Fill::Surface] {
        let how = Voxelize { resolution: 24, fill, thin: Thin::Thicken };
        let (a, b) = (grid(&body, &how), grid(&turned, &how));
        let last = a.lattice.side() - 1;
        let differ = all(&a).filter(|&[x, y, z]| a.is_black([x, y, z]) != b.is_black([last - y, x, z])).count();
        // Corners snap to the grid, halves up: a node or two on an edge may differ.
        assert!(differ <= 2, "{fill:?}: {differ}");
        assert!(a.sticks().len().abs_diff(b.sticks().len()) <= 8);
    }
}

#[test]
fn a_thin_plate_is_thickened() {
    // 0.2 of a cell thick.
    let plate = block([0.0; 3], [10.0, 7.0, 0.1]);
    let how = Voxelize { resolution: 20, ..Voxelize::default() };
    let kept = grid(&plate, &Voxelize { thin: Thin::Keep, ..how });
    assert_eq!(kept.inside(), 0);
    assert!(kept.losses.lost > 0);
    let thick = grid(&plate, &how);
    assert!(thick.inside() >= 20 * 14);
    // Both sides vote, the rim does not.
    let is_flat = |&s: &u64| crate::artifact::voxels::stick_of(s).1 < 4;
    let rim = thick.sticks().iter().filter(|s| s.1 < 4).count();
    assert!(rim > 60 && thick.membrane.len() == rim && thick.membrane.iter().all(is_flat), "{rim}");
    let layers: std::collections::BTreeSet<usize> = all(&thick).filter(|&n| thick.is_black(n)).map(|n| n[2]).collect();
    assert_eq!(layers.len(), 1);
}

#[test]
fn near_the_surface() {
    let body = sphere(2.0, [0.0; 3]);
    let v = grid(&body, &Voxelize { resolution: 20, fill: Fill::Surface, thin: Thin::Keep });
    for node in all(&v) {
        let p = v.lattice.to_metres(node.map(|c| c as f64));
        let off = ((p.iter().map(|c| c * c).sum::<f64>().sqrt() - 2.0) / v.lattice.cell).abs();
        if (off - 0.5).abs() > 0.03 {
            assert_eq!(v.is_black(node), off < 0.5, "{node:?}: {off}");
        }
    }
}

#[test]
fn odd_meshes() {
    let how = Voxelize { resolution: 8, ..Voxelize::default() };
    assert!(snap(&mesh(vec![], vec![]), 8).is_err());
    let nan = mesh(vec![[f64::NAN; 3], [0.0; 3], [1.0; 3]], vec![[0, 1, 2]]);
    assert!(snap(&nan, 8).is_err());
    let huge = mesh(vec![[-1e308; 3], [1e308; 3], [0.0; 3]], vec![[0, 1, 2]]);
    assert!(snap(&huge, 8).is_err());
    // One triangle, a point, a bar of 100,000 : 1.
    let one = mesh(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]);
    assert!(grid(&one, &how).inside() > 0);
    grid(&mesh(vec![[1.0; 3]; 3], vec![[0, 1, 2]]), &how);
    // It lies between the nodes: no edge of the grid is crossed, and nothing is left of it.
    let bar = grid(&block([0.0; 3], [100_000.0, 1.0, 1.0]), &how);
    assert_eq!((bar.inside(), bar.losses.crossed), (0, 0));
}

#[test]
fn the_same_on_any_number_of_threads() {
    let mut open = torus(3.0, 1.0);
    open.triangles.retain(|t| open.positions[t[0] as usize][0] < 2.5);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| grid(&open, &Voxelize { resolution: 30, ..Voxelize::default() }))
    };
    assert_eq!(with(1), with(2));
    assert_eq!(with(1), with(8));
}
