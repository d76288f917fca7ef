//! The three solid fills against the winding number at every node, and what `winding` makes of open bodies.

use super::*;

/// A turn about all three axes by angles that a seed gives.
fn at_random(mesh: &Mesh, seed: u64) -> Mesh {
    let mut out = mesh.clone();
    let mut state = seed;
    for axis in 0..3 {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let angle = (state >> 40) as f64 / f64::from(1 << 24) * TURN;
        let (s, c) = (libm::sin(angle), libm::cos(angle));
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        out.positions.iter_mut().for_each(|p| (p[i], p[j]) = (c * p[i] - s * p[j], s * p[i] + c * p[j]));
    }
    out
}

/// Nodes where a fill says other than the winding number of the snapped mesh, and those left out of it: they lie on
/// the snapped surface itself, where the number jumps, and are black by rule.
fn differing(mesh: &Mesh, resolution: u32, fill: Fill) -> (Vec<[usize; 3]>, usize) {
    let (mut snapped, lattice, _) = snap(mesh, resolution).unwrap();
    snapped.without_duplicates();
    let flip = snapped.volume() < 0;
    let on = crossings::of(&snapped, flip).on;
    let tree = winding::Tree::new(&snapped, flip);
    let (v, _) = voxelize(&snapped, lattice, &mesh.frame, &Voxelize { resolution, fill, thin: Thin::Keep });
    assert!(on.iter().all(|&key| v.is_black(node_of(key))));
    let nodes: Vec<[usize; 3]> = all(&v).filter(|&n| on.binary_search(&key_of(n)).is_err()).collect();
    let differs = |n: &&[usize; 3]| (tree.at(n.map(|c| c as f64)) >= 0.5) != v.is_black(**n);
    (nodes.par_iter().filter(differs).copied().collect(), on.len())
}

#[test]
fn fills_are_the_winding_number_of_closed_bodies() {
    let mut left_out = 0;
    for seed in 1..=4 {
        for body in [block([0.0; 3], [5.0, 4.0, 3.0]), torus(3.0, 1.0)] {
            for fill in SOLID {
                let (differ, on) = differing(&at_random(&body, seed), 32, fill);
                assert!(differ.is_empty(), "{fill:?}, turn {seed}: {differ:?}");
                left_out += on;
            }
        }
    }
    // Of 24 times 46,656 nodes.
    assert_eq!(left_out, 0, "nodes on the surface");
}

/// 83,750 triangles of a real part.
#[test]
fn fills_of_a_real_body() {
    let Some(data) = std::env::var_os("LODGE_DATA") else { return println!("skipped: LODGE_DATA is not set") };
    let bytes = std::fs::read(std::path::Path::new(&data).join("meshes/machine_counter.stl")).unwrap();
    // A binary STL: 84 bytes, then 50 a triangle, its normal first.
    let number = |at: &[u8]| f64::from(f32::from_le_bytes([at[0], at[1], at[2], at[3]]));
    let corners = bytes[84..].chunks_exact(50).flat_map(|t| t[12..48].chunks_exact(12));
    let positions: Vec<[f64; 3]> = corners.map(|c| [0, 4, 8].map(|k| number(&c[k..]))).collect();
    let triangles = (0..positions.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let body = mesh(positions, triangles);
    for fill in SOLID {
        let (differ, on) = differing(&body, 48, fill);
        assert!(differ.is_empty(), "{fill:?}: {differ:?}");
        assert_eq!(on, 0, "nodes on the surface");
    }
}

/// The two outer layers on all sides.
fn outer_layers_are_white(v: &Voxels) {
    let last = v.lattice.side() - 1;
    let outer = |n: &[usize; 3]| n.iter().any(|&c| c < 2 || c + 2 > last);
    let mut outside = all(v).filter(outer);
    assert!(outside.all(|n| !v.is_black(n)));
}

/// A flat hole is closed flat by the winding number, so an open body is the closed one, but for nodes close to the lid.
#[test]
fn a_box_without_its_lid_is_the_box() {
    let (low, high) = ([0.0; 3], [5.0, 4.0, 3.0]);
    for (seed, lid) in (0..4).flat_map(|seed| (0..6).map(move |lid| (seed, lid))) {
        let turn = |body: &Mesh| if seed == 0 { body.clone() } else { at_random(body, seed) };
        let closed = turn(&block(low, high));
        let mut open = closed.clone();
        let gone = open.triangles.drain(2 * lid..2 * lid + 2).next().unwrap();
        let [a, b, c] = gone.map(|v| open.positions[v as usize]);
        let normal = crate::geom::space::doubled_area([a, b, c]);
        let length = normal.iter().map(|n| n * n).sum::<f64>().sqrt();
        let how = Voxelize { resolution: 24, thin: Thin::Keep, ..Voxelize::default() };
        let (full, v) = (grid(&closed, &how), grid(&open, &how));
        assert_eq!(full.lattice, v.lattice);
        outer_layers_are_white(&v);
        outer_layers_are_white(&grid(&open, &Voxelize { thin: Thin::Thicken, ..how }));
        let off_lid = |n: [usize; 3]| {
            let p = v.lattice.to_metres(n.map(|c| c as f64));
            ((0..3).map(|k| normal[k] * (p[k] - a[k])).sum::<f64>() / length / v.lattice.cell).abs()
        };
        let far: Vec<[usize; 3]> = all(&v).filter(|&n| off_lid(n) > 0.02).collect();
        assert!(far.len() > v.lattice.side().pow(3) * 9 / 10);
        let differ = far.iter().filter(|&&n| v.is_black(n) != full.is_black(n)).count();
        assert_eq!(differ, 0, "lid {lid}, turn {seed}");
        assert!(far.iter().filter(|&&n| v.is_black(n)).count() > 1000);
        assert!(!v.membrane.is_empty());
    }
}

#[test]
fn a_dome_without_a_floor_is_full() {
    for (axis, up) in (0..3).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
        let c = [1.0, 2.0, 3.0];
        let mut dome = sphere(2.0, c);
        let above = |p: [f64; 3]| up * (p[axis] - c[axis]);
        dome.triangles.retain(|t| t.iter().all(|&v| above(dome.positions[v as usize]) >= -1e-9));
        let v = grid(&dome, &Voxelize { resolution: 40, thin: Thin::Keep, ..Voxelize::default() });
        outer_layers_are_white(&v);
        // The sphere's own corners make a ragged edge about the axes that are not its poles'.
        let band = if axis == 2 { 0.5 * v.lattice.cell } else { 2.0 * v.lattice.cell };
        agrees(&v, band, |p| {
            let off = (0..3).map(|k| (p[k] - c[k]) * (p[k] - c[k])).sum::<f64>().sqrt();
            (2.0 - off).min(above(p))
        });
    }
}

/// Shallow trays, open to any side: what they hold is what the closed box holds, but for the layer at the missing lid.
#[test]
fn a_shallow_tray_is_full_whichever_way_it_is_open() {
    for axis in 0..3 {
        for height in [0.5, 1.0, 2.0, 3.0] {
            let high = std::array::from_fn(|k| if k == axis { height } else { 10.0 });
            let closed = block([0.0; 3], high);
            let how = Voxelize { resolution: 40, thin: Thin::Keep, ..Voxelize::default() };
            let whole = grid(&closed, &how).inside();
            for lid in [0.0, height] {
                let mut open = closed.clone();
                let positions = open.positions.clone();
                open.triangles.retain(|t| !t.iter().all(|&v| positions[v as usize][axis] == lid));
                assert_eq!(open.triangles.len(), 10);
                let inside = grid(&open, &how).inside();
                assert!(
                    2 * inside > whole && inside <= whole,
                    "axis {axis}, {height} high, open at {lid}: {inside} of {whole}"
                );
            }
        }
    }
}
