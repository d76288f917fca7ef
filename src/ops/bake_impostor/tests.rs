use super::*;
use crate::artifact::Impostors;
use crate::artifact::mesh::{Material, Primitive, Surface, Texture, Wrap};
use crate::artifact::plane_tiles::{Given, LeftOver};
use crate::geom::frame::Frame;
use crate::geom::lattice::Lattice;
use crate::geom::space::{Vec3, bounds, cross, dot, doubled_area, sub, unit};
use crate::io::picture::{Level, Picture};

/// Of the brick, metres.
const SIZE: Vec3 = [8.0, 8.0, 4.0];

/// A box of 8 x 8 x 4 m, another colour a side.
fn brick() -> Mesh {
    let positions: Vec<[f64; 3]> =
        (0..24).map(|i| [0, 1, 2].map(|k| if ((i % 8) >> k) & 1 == 1 { SIZE[k] } else { 0.0 })).collect();
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

/// Planes across an axis, as fields of the corners' values: (axis, where in metres, 1 if its outside is the axis' far end).
fn across(lattice: Lattice, all: &[(usize, f64, f64)]) -> PlaneTiles {
    let n = f64::from(lattice.cells);
    let corners = [[0.0; 3], [n, n, 0.0], [n, 0.0, n], [0.0, n, n]];
    let plane = |&(k, at, outside): &(usize, f64, f64)| {
        let at = (at - lattice.origin[k]) / lattice.cell;
        corners.map(|c| (outside * (at - c[k]) * 1000.0).round() as i64)
    };
    PlaneTiles {
        frame: Frame::local(),
        lattice,
        planes: all.iter().map(plane).collect(),
        votes: vec![9; all.len()],
        stages: vec![0; all.len()],
        starts: vec![0; all.len() + 1],
        sticks: Vec::new(),
        given: Given { reach_cells: 1.0, ..Given::default() },
        left_over: LeftOver::default(),
    }
}

/// The six planes of the box's sides, half a cell inside.
fn six() -> PlaneTiles {
    around(SIZE, 0.25)
}

/// The six planes of a box's sides, so far inside.
fn around(size: Vec3, inside: f64) -> PlaneTiles {
    let side = |i: usize| [(i / 2, inside, -1.0), (i / 2, size[i / 2] - inside, 1.0)][i % 2];
    across(Lattice::around([0.0; 3], size, 16), &[0, 1, 2, 3, 4, 5].map(side))
}

/// Boards that lie on one plane a quarter of a metre below, seen from above.
fn boards(corners: &[[Vec3; 4]]) -> (Mesh, PlaneTiles) {
    let mut mesh = brick();
    mesh.positions = corners.as_flattened().to_vec();
    mesh.triangles =
        (0..corners.len() as u32).flat_map(|b| [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|c| 4 * b + c))).collect();
    mesh.features.truncate(mesh.positions.len());
    mesh.primitives.truncate(1);
    mesh.primitives[0].triangles = mesh.triangles.len() as u32;
    (mesh, across(six().lattice, &[(2, -0.25, 1.0)]))
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
    assert!(w.drawn > 0.999 && w.silhouette > 0.99, "{w:?}");
    assert_eq!((w.error_m, w.texels_per_cell), (0.5, 2.0));
    // Each looks outside, and lies on the wall, though its plane is half a cell inside.
    for q in 0..6 {
        let [a, b, c] = [0, 1, 2].map(|i| out.corners[4 * q + i]);
        let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let axis = q / 2;
        assert!(n[axis] * (q as f64 % 2.0 - 0.5) > 0.0, "quad {q}: {n:?}");
        let wall = if q % 2 == 0 { 0.0 } else { [8.0, 8.0, 4.0][axis] };
        assert!((a[axis] - wall).abs() < 1e-6, "quad {q}: {a:?}");
    }
    // What is drawn of a side has its colour, what is bled as well.
    let atlas = Picture::decode(&out.colour).unwrap();
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
    let (mesh, tiles) = boards(&[[at(0.0, 0.0), at(10.0, 0.0), at(10.0, 0.4), at(0.0, 0.4)]]);
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

/// What one plane has in two places is two quads, each as large as what it shows.
#[test]
fn parts_far_apart_get_quads_of_their_own() {
    let board =
        |[x, y]: [f64; 2], [w, h]: [f64; 2]| [[x, y, 0.0], [x + w, y, 0.0], [x + w, y + h, 0.0], [x, y + h, 0.0]];
    let all = [board([0.5, 1.0], [1.0, 2.5]), board([5.0, 6.0], [2.0, 1.5])];
    let (mesh, tiles) = boards(&all);
    let out = bake(&mesh, &tiles, &BakeImpostor { texels_per_cell: 8.0, ..BakeImpostor::default() }).unwrap();
    assert_eq!(out.tiles, [0, 0]);
    let boxes = |corners: &[Vec3]| -> Vec<(Vec3, Vec3)> {
        let mut all: Vec<_> = corners.chunks(4).map(|quad| bounds(quad.iter().copied())).collect();
        all.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
        all
    };
    // Within two texels of a sixteenth of a metre.
    for (quad, board) in boxes(&out.corners).into_iter().zip(boxes(all.as_flattened())) {
        let off = |k: usize| (quad.0[k] - board.0[k]).abs().max((quad.1[k] - board.1[k]).abs());
        assert!(off(0) < 0.126 && off(1) < 0.126, "{quad:?} for {board:?}");
    }
    assert!(out.worth.drawn > 0.99, "{:?}", out.worth);
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
    let map = Picture::decode(&out.normal_map).unwrap();
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

/// A picture of 4 x 4 blocks: white on a side's own colour, an L in one corner. Turned or mirrored it is another one.
fn letter(side: usize, [u, v]: [f64; 2]) -> [u8; 4] {
    const COLOURS: [[u8; 4]; 6] = [
        [200, 30, 30, 255],
        [30, 160, 30, 255],
        [40, 40, 200, 255],
        [170, 160, 20, 255],
        [20, 150, 160, 255],
        [160, 30, 170, 255],
    ];
    let block = [u, v].map(|c| (c * 4.0) as u32);
    if [[0, 0], [0, 1], [0, 2], [1, 2]].contains(&block) { [255; 4] } else { COLOURS[side] }
}

/// Where a place on a side across an axis is in its picture.
fn in_picture(p: Vec3, axis: usize) -> [f64; 2] {
    [(axis + 1) % 3, (axis + 2) % 3].map(|k| p[k] / SIZE[k])
}

/// The box, another picture a side.
fn painted() -> Mesh {
    let mut mesh = brick();
    let places = mesh.positions.iter().enumerate();
    mesh.surface.uvs = places.map(|(i, &p)| in_picture(p, i / 8).map(|c| c as f32)).collect();
    for side in 0..6 {
        let middle = |i: u32| (f64::from(i) + 0.5) / 32.0;
        let texels = (0..32 * 32).map(|i| letter(side, [middle(i % 32), middle(i / 32)])).collect();
        mesh.surface.images.push("image/png", &Level { width: 32, height: 32, texels }.png());
        let texture = Some(Texture { image: side as u32, wrap: [Wrap::Clamp; 2], nearest: false });
        mesh.surface.materials[side] = Material { texture, ..Material::default() };
    }
    mesh
}

/// Texels of the quads that look along a direction, where they stand for a place, found as a viewer does: by corners
/// and their places in the atlas.
fn shown(of: &Impostors, atlas: &Level, p: Vec3, outside: Vec3) -> Vec<[u8; 4]> {
    let texel = |q: usize| {
        let [a, b, d] = [0, 1, 3].map(|i| of.corners[4 * q + i]);
        let (right, up, to) = (sub(b, a), sub(d, a), sub(p, a));
        let [x, y] = [right, up].map(|side| dot(to, side) / dot(side, side));
        let looks = dot(unit(cross(right, up)), outside) > 0.9;
        if !looks || !(0.0..1.0).contains(&x) || !(0.0..1.0).contains(&y) {
            return None;
        }
        let [a, b, d] = [0, 1, 3].map(|i| of.uvs[4 * q + i].map(f64::from));
        let [u, v] = [0, 1].map(|k| a[k] + x * (b[k] - a[k]) + y * (d[k] - a[k]));
        let (column, row) = ((u * f64::from(atlas.width)) as usize, (v * f64::from(atlas.height)) as usize);
        Some(atlas.texels[row * atlas.width as usize + column])
    };
    (0..of.len()).filter_map(texel).filter(|t| t[3] == 255).collect()
}

#[test]
fn each_side_shows_its_own_picture_the_right_way_round() {
    // On the walls themselves: half a cell inside, an eye at a corner sees every edge of a picture somewhere else.
    let out = bake(&painted(), &around(SIZE, 0.0), &BakeImpostor::default()).unwrap();
    let atlas = &Picture::decode(&out.colour).unwrap().levels[0];
    for side in 0..6 {
        let (axis, far) = (side / 2, side % 2);
        let mut outside = [0.0; 3];
        outside[axis] = [-1.0, 1.0][far];
        for block in 0..16 {
            let mut p = [0.0; 3];
            p[axis] = SIZE[axis] * far as f64;
            p[(axis + 1) % 3] = SIZE[(axis + 1) % 3] * (f64::from(block % 4) + 0.5) / 4.0;
            p[(axis + 2) % 3] = SIZE[(axis + 2) % 3] * (f64::from(block / 4) + 0.5) / 4.0;
            let (found, wanted) = (shown(&out, atlas, p, outside), letter(side, in_picture(p, axis)));
            let near = |t: &[u8; 4]| (0..4).all(|k| t[k].abs_diff(wanted[k]) <= 2);
            assert!(found.len() == 1 && found.iter().all(near), "side {side}, {p:?}: {found:?} for {wanted:?}");
        }
    }
    assert!(out.worth.colour_error < 1.0, "{:?}", out.worth);
}

/// A ball of 4 m with smooth normals, a face of a cube at a time.
fn ball() -> Mesh {
    const STEPS: u32 = 16;
    let mut mesh = brick();
    (mesh.positions, mesh.triangles) = Default::default();
    for face in 0..6 {
        let (axis, outside) = (face / 2, [-1.0, 1.0][face % 2]);
        let first = mesh.positions.len() as u32;
        for i in 0..(STEPS + 1) * (STEPS + 1) {
            let mut p = [outside; 3];
            p[(axis + 1) % 3] = f64::from(i % (STEPS + 1)) * 2.0 / f64::from(STEPS) - 1.0;
            p[(axis + 2) % 3] = f64::from(i / (STEPS + 1)) * 2.0 / f64::from(STEPS) - 1.0;
            let normal = unit(p);
            mesh.positions.push(normal.map(|c| 4.0 + 4.0 * c));
            mesh.surface.normals.push(normal.map(|c| c as f32));
        }
        for i in 0..STEPS * STEPS {
            let a = first + i / STEPS * (STEPS + 1) + i % STEPS;
            let (b, c, d) = (a + 1, a + STEPS + 2, a + STEPS + 1);
            let turned = |[a, b, c]: [u32; 3]| if outside > 0.0 { [a, b, c] } else { [a, c, b] };
            mesh.triangles.extend([[a, b, c], [a, c, d]].map(turned));
        }
    }
    mesh.features = vec![0; mesh.positions.len()];
    mesh.primitives.truncate(1);
    mesh.primitives[0].triangles = mesh.triangles.len() as u32;
    mesh
}

/// Six planes around a ball, each through a cap that it shows: what a viewer makes of the map is the ball's own normal.
#[test]
fn normals_of_a_ball_are_its_own() {
    let mesh = ball();
    let middle = [4.0; 3];
    assert!(
        (0..mesh.triangles.len()).all(|t| dot(doubled_area(mesh.corners(t)), sub(mesh.corners(t)[0], middle)) > 0.0)
    );
    let mut tiles = around([8.0; 3], 0.75);
    tiles.given.reach_cells = 2.0;
    let out = bake(&mesh, &tiles, &BakeImpostor { normal_map: true, ..BakeImpostor::default() }).unwrap();
    let [colour, map] = [&out.colour, &out.normal_map].map(|png| Picture::decode(png).unwrap().levels.swap_remove(0));
    let (mut worst, mut count) = (0f64, 0);
    for q in 0..out.len() {
        let [a, b, _, d] = [0, 1, 2, 3].map(|i| out.corners[4 * q + i]);
        let place = |i: usize| {
            let uv = out.uvs[4 * q + i];
            [uv[0] * map.width as f32, uv[1] * map.height as f32].map(|c| c.round() as u32)
        };
        let ([left, bottom], [right, _], [_, top]) = (place(0), place(1), place(3));
        // As glTF has it: what is up is the normal x the tangent.
        let [normal, tangent] = [out.normals[q], out.tangents[q]].map(|v| v.map(f64::from));
        let up = cross(normal, tangent);
        for (x, y) in (top..bottom).flat_map(|y| (left..right).map(move |x| (x, y))) {
            let i = (y * map.width + x) as usize;
            let share = |at: u32, from: u32, to: u32| (f64::from(at - from) + 0.5) / f64::from(to - from);
            let (s, t) = (share(x, left, right), 1.0 - share(y, top, bottom));
            let p = [0, 1, 2].map(|k| a[k] + s * (b[k] - a[k]) + t * (d[k] - a[k]) - middle[k]);
            let flat = [dot(p, tangent), dot(p, up)];
            let beside = (flat[0] * flat[0] + flat[1] * flat[1]).sqrt() / 4.0;
            // At its edges a quad goes on over what its neighbours show.
            if colour.texels[i][3] < 255 || beside > 0.75 {
                continue;
            }
            let own = [flat[0] / 4.0, flat[1] / 4.0, (1.0 - beside * beside).sqrt()];
            let said = [0, 1, 2].map(|k| (f64::from(map.texels[i][k]) - 128.0) / 127.0);
            worst = worst.max(dot(unit(said), own).clamp(-1.0, 1.0).acos().to_degrees());
            count += 1;
        }
    }
    assert!(count > 2000, "{count} texels");
    assert!(worst < 0.5, "{worst} degrees");
}

#[test]
fn the_same_on_any_number_of_threads() {
    let (mesh, tiles) = (painted(), six());
    let how = BakeImpostor { normal_map: true, ..BakeImpostor::default() };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bake(&mesh, &tiles, &how).unwrap())
    };
    let one = on(1);
    for threads in [2, 8] {
        let other = on(threads);
        // Which sign a zero has is told by the text only.
        assert!(other == one && format!("{other:?}") == format!("{one:?}"), "{threads} threads");
    }
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
