use super::*;
use crate::artifact::Impostors;
use crate::artifact::mesh::{Material, Primitive, Surface};
use crate::artifact::plane_tiles::{Given, LeftOver};
use crate::geom::frame::Frame;
use crate::geom::lattice::Lattice;

/// A box of 8 x 8 x 4 m, another colour a side.
fn brick() -> Mesh {
    let positions: Vec<[f64; 3]> =
        (0..24).map(|i| [0, 1, 2].map(|k| if ((i % 8) >> k) & 1 == 1 { [8.0, 8.0, 4.0][k] } else { 0.0 })).collect();
    // Three corners meet at each place: one for each axis' faces.
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let quads: Vec<[u32; 4]> = quads.iter().enumerate().map(|(f, q)| q.map(|c| c + 8 * (f as u32 / 2))).collect();
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let colours =
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]];
    let material = |c: [f32; 3]| Material { base_colour: [c[0], c[1], c[2], 1.0], ..Material::default() };
    let primitive = |f: u32| Primitive { name: "mesh".into(), first_triangle: 2 * f, triangles: 2, material: Some(f) };
    Mesh {
        frame: Frame::local(),
        positions,
        triangles,
        features: vec![0; 24],
        primitives: (0..6).map(primitive).collect(),
        feature_ids: ["a"].into_iter().collect(),
        attributes: Default::default(),
        surface: Surface { materials: colours.map(material).to_vec(), ..Surface::default() },
    }
}

/// The six planes of the box's sides, half a cell inside, as fields of the corners' values.
fn six() -> PlaneTiles {
    let lattice = Lattice::around([0.0; 3], [8.0, 8.0, 4.0], 16);
    let n = f64::from(lattice.cells);
    let corners = [[0.0; 3], [n, n, 0.0], [n, 0.0, n], [0.0, n, n]];
    let mut planes = Vec::new();
    for k in 0..3 {
        for (side, sign) in [(0.0, 1.0), ([8.0, 8.0, 4.0][k], -1.0)] {
            let at = (side - lattice.origin[k]) / lattice.cell + 0.5 * sign;
            planes.push(corners.map(|c| (sign * (c[k] - at) * 1000.0).round() as i64));
        }
    }
    PlaneTiles {
        frame: Frame::local(),
        lattice,
        planes,
        votes: vec![9; 6],
        stages: vec![0; 6],
        starts: vec![0; 7],
        sticks: Vec::new(),
        given: Given { reach_cells: 1.0, ..Given::default() },
        left_over: LeftOver::default(),
    }
}

fn bake(mesh: &Mesh, tiles: &PlaneTiles, how: &BakeImpostor) -> Result<Impostors> {
    bake_impostor(mesh, tiles, how, || Ok(()))
}

#[test]
fn a_box_is_six_quads_of_its_colours() {
    let (mesh, tiles) = (brick(), six());
    let out = bake(&mesh, &tiles, &BakeImpostor::default()).unwrap();
    assert_eq!((out.len(), out.tiles.clone()), (6, vec![0, 1, 2, 3, 4, 5]));
    let w = out.worth;
    assert!(w.drawn > 0.999 && w.silhouette > 0.85, "{w:?}");
    assert_eq!((w.error_m, w.texels_per_cell), (0.5, 2.0));
    // Each looks outside, and lies half a cell off the wall.
    for q in 0..6 {
        let [a, b, c] = [0, 1, 2].map(|i| out.corners[4 * q + i]);
        let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let axis = q / 2;
        assert!(n[axis] * (q as f64 % 2.0 - 0.5) > 0.0, "quad {q}: {n:?}");
        let wall = if q % 2 == 0 { 0.25 } else { [8.0, 8.0, 4.0][axis] - 0.25 };
        assert!((a[axis] - wall).abs() < 1e-3, "quad {q}: {a:?}");
    }
    // What is drawn of a side has its colour, what is bled as well.
    let atlas = crate::io::picture::Picture::decode(&out.colour).unwrap();
    let colours: std::collections::BTreeSet<[u8; 4]> =
        atlas.levels[0].texels.iter().copied().filter(|t| t[3] == 255).collect();
    assert_eq!(colours.len(), 6, "{colours:?}");
    assert!(atlas.levels[0].texels.iter().all(|t| *t == [0; 4] || colours.contains(&[t[0], t[1], t[2], 255])));
}

/// A board of 0.4 x 10 m that lies askew in one plane: its quad is about as large as it, and shows all of it.
#[test]
fn rectangles_lie_along_what_they_show() {
    let along = [0.8, 0.6];
    let at = |u: f64, v: f64| [2.0 + u * along[0] - v * along[1], 2.0 + u * along[1] + v * along[0], 0.0];
    let mut mesh = brick();
    mesh.positions = vec![at(0.0, 0.0), at(10.0, 0.0), at(10.0, 0.4), at(0.0, 0.4)];
    mesh.triangles = vec![[0, 1, 2], [0, 2, 3]];
    mesh.features.truncate(4);
    mesh.primitives.truncate(1);
    let mut tiles = six();
    tiles.planes = vec![tiles.planes[4].map(|w| -w)];
    for primitive in &mut tiles.planes {
        // z = -0.25 m, seen from above.
        let n = f64::from(tiles.lattice.cells);
        let z = (-0.25 - tiles.lattice.origin[2]) / tiles.lattice.cell;
        *primitive = [0.0, 0.0, n, n].map(|c| ((z - c) * 1000.0).round() as i64);
    }
    tiles.votes.truncate(1);
    tiles.stages.truncate(1);
    tiles.starts.truncate(2);
    let how = BakeImpostor { texels_per_cell: 8.0, ..BakeImpostor::default() };
    let out = bake(&mesh, &tiles, &how).unwrap();
    assert_eq!(out.len(), 1);
    let [a, b, c] = [0, 1, 2].map(|i| out.corners[i]);
    let length = |p: [f64; 3], q: [f64; 3]| (0..3).map(|k| (p[k] - q[k]) * (p[k] - q[k])).sum::<f64>().sqrt();
    let mut sides = [length(a, b), length(b, c)];
    sides.sort_by(f64::total_cmp);
    assert!((0.3..0.6).contains(&sides[0]) && (9.9..10.2).contains(&sides[1]), "{sides:?}");
    assert!(out.worth.drawn > 0.9, "{:?}", out.worth);
}

/// Planes a quarter of a cell outside the walls do not reach each other: an eye at a corner sees between them, until they go on.
#[test]
fn holes_between_quads_are_closed() {
    let (mesh, mut tiles) = (brick(), six());
    for plane in &mut tiles.planes {
        // From half a cell inside.
        *plane = plane.map(|w| w + 750);
    }
    let (paint, planes) = (Paint::new(&mesh), Planes::new(&tiles));
    let reached = Reached::new(&mesh, &planes);
    let scene = Scene { mesh: &mesh, paint: &paint, planes: &planes, reached: &reached };
    let (how, mut density) = (BakeImpostor::default(), 2.0);
    let mut baked = |mending: &Mending| fit(&scene, mending, &how, &mut density, || Ok(())).unwrap().0;
    let open = baked(&Mending::none());
    let closed = baked(&Mending::new(&scene, &open));
    let [before, after] = [&open, &closed].map(|pieces| holes::missing(&scene, pieces));
    assert!(before > 1000 && 20 * after < before, "{before} pixels missing, then {after}");
    let texels = |pieces: &[Piece]| pieces.iter().map(|p| p.counts()[0]).sum::<usize>();
    assert!(texels(&closed) > texels(&open));
}

#[test]
fn normals_of_flat_sides_point_outside() {
    let out = bake(&brick(), &six(), &BakeImpostor { normal_map: true, ..BakeImpostor::default() }).unwrap();
    let map = crate::io::picture::Picture::decode(&out.normal_map).unwrap();
    assert_eq!([map.levels[0].width, map.levels[0].height], out.worth.atlas);
    assert!(map.levels[0].texels.iter().all(|t| *t == [128, 128, 255, 255]));
    // Right and up of each quad are its corners'.
    for (q, tangent) in out.tangents.iter().enumerate() {
        let [a, b] = [0, 1].map(|i| out.corners[4 * q + i]);
        let along: f64 = (0..3).map(|k| (b[k] - a[k]) * f64::from(tangent[k])).sum();
        let length: f64 = (0..3).map(|k| (b[k] - a[k]) * (b[k] - a[k])).sum::<f64>().sqrt();
        assert!((along - length).abs() < 1e-3 * length, "quad {q}");
    }
}

#[test]
fn the_same_on_one_thread() {
    let (mesh, tiles) = (brick(), six());
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let how = BakeImpostor::default();
    assert_eq!(one.install(|| bake(&mesh, &tiles, &how).unwrap()), bake(&mesh, &tiles, &how).unwrap());
}

#[test]
fn small_atlases_and_no_tiles() {
    let (mesh, mut tiles) = (brick(), six());
    let out = bake(&mesh, &tiles, &BakeImpostor { max_atlas_px: 64, ..BakeImpostor::default() }).unwrap();
    assert!(out.worth.texels_per_cell < 1.0 && out.worth.atlas.iter().all(|&s| s <= 64), "{:?}", out.worth);
    tiles.frame.crs = "EPSG:4326".into();
    assert_eq!(bake(&mesh, &tiles, &BakeImpostor::default()).unwrap_err().code, "other-frame");
    tiles.frame = Frame::local();
    tiles.planes.clear();
    assert_eq!(bake(&mesh, &tiles, &BakeImpostor::default()).unwrap_err().code, "no-tiles");
}
