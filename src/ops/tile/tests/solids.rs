//! Buildings with roofs of their own.

use super::*;
use crate::artifact::Shapes;
use crate::artifact::{Attributes, Strings, buildings};

/// A gabled roof over the box of every second building.
fn gables(toy: &Toy) -> Buildings {
    let mut out = Buildings {
        frame: toy.footprints.frame.clone(),
        ids: Strings::default(),
        attributes: Attributes::default(),
        starts: vec![0],
        lods: Strings::default(),
        surfaces: Shapes::default(),
        semantics: Vec::new(),
    };
    for b in (0..toy.footprints.len()).step_by(2) {
        out.ids.push(toy.footprints.ids.get(b));
        let Bounds { low: [x0, y0], high: [x1, y1] } = Bounds::of(toy.footprints.polygons.shells(b).flatten().copied());
        let (z, top) = ((toy.footprints.base[b] * 1000.0) as i32, (toy.footprints.top[b] * 1000.0) as i32);
        let ym = (y0 + y1) / 2;
        for (lod, eaves) in [("1.2", top), ("2.2", top - 2000)] {
            out.lods.push(lod);
            let surfaces: [(u8, &[[i32; 3]]); 7] = [
                (buildings::GROUND, &[[x0, y0, z], [x0, y1, z], [x1, y1, z], [x1, y0, z]]),
                (buildings::WALL, &[[x0, y0, z], [x1, y0, z], [x1, y0, eaves], [x0, y0, eaves]]),
                (buildings::WALL, &[[x1, y1, z], [x0, y1, z], [x0, y1, eaves], [x1, y1, eaves]]),
                (buildings::WALL, &[[x1, y0, z], [x1, y1, z], [x1, y1, eaves], [x1, ym, top], [x1, y0, eaves]]),
                (buildings::WALL, &[[x0, y1, z], [x0, y0, z], [x0, y0, eaves], [x0, ym, top], [x0, y1, eaves]]),
                (buildings::ROOF, &[[x0, y0, eaves], [x1, y0, eaves], [x1, ym, top], [x0, ym, top]]),
                (buildings::ROOF, &[[x1, y1, eaves], [x0, y1, eaves], [x0, ym, top], [x1, ym, top]]),
            ];
            for (meaning, ring) in surfaces {
                out.surfaces.push_ring(ring);
                out.surfaces.end_polygon();
                out.semantics.push(meaning);
            }
            out.surfaces.end_shape();
        }
        out.starts.push(out.lods.len() as u32);
    }
    out
}

#[test]
fn leaves_and_landmarks_keep_the_highest_level_of_detail() {
    let toy = toy(40, 2);
    let tile = Tile { prefer: Prefer::Fewest, ..small(300) };
    let (tree, found) = tile_with(&toy, &tile, Some(gables(&toy)));
    assert_eq!(found.facts["extruded"], 20);
    assert_eq!(found.warnings.len(), 1);
    let mut solid_landmarks = 0;
    for t in 0..tree.len() {
        for f in tree.features_of(t) {
            let solid = !tree.solids.polygons_of(f).is_empty();
            assert!(solid == tree.plans.polygons_of(f).is_empty(), "one or the other");
            if tree.is_leaf[t] {
                let even = toy.landmarks.order[tree.feature_first[f] as usize].is_multiple_of(2);
                assert_eq!(solid, even);
            }
            solid_landmarks += usize::from(solid && tree.landmark[f]);
            if solid {
                assert_eq!(tree.solids.polygons_of(f).len(), 6, "the second level, without its ground");
            }
        }
    }
    assert_eq!(tree.semantics.len(), tree.solids.polygons.len() - 1);
    assert!(solid_landmarks > 0);
}
