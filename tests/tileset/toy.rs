//! Tile trees made by hand.

use lodge::artifact::{Attributes, Column, Shapes, TileTree, Values, buildings};
use lodge::geom::frame::Frame;

/// A tree without tiles.
pub fn empty(frame: Frame) -> TileTree {
    TileTree {
        frame,
        parent: vec![],
        error: vec![],
        error_negative_space: vec![],
        error_height: vec![],
        source_first: vec![],
        source_count: vec![],
        tile_features: vec![0],
        is_leaf: vec![],
        feature_first: vec![],
        feature_count: vec![],
        landmark: vec![],
        footprint_area_m2: vec![],
        height_min: vec![],
        height_max: vec![],
        negative_space_m2: vec![],
        base: vec![],
        top: vec![],
        plans: Shapes::default(),
        solids: Shapes::default(),
        semantics: vec![],
        ids: Default::default(),
        attributes: Attributes::default(),
        levels: vec![],
    }
}

fn tile(t: &mut TileTree, parent: u32, error: f64, sources: std::ops::Range<u32>, leaf: bool) {
    t.parent.push(parent);
    t.error.push(error);
    t.error_negative_space.push(error * 0.75);
    t.error_height.push(error);
    t.source_first.push(sources.start);
    t.source_count.push(sources.end - sources.start);
    t.is_leaf.push(leaf);
}

fn feature(t: &mut TileTree, sources: std::ops::Range<u32>, landmark: bool, rings: &[&[[i32; 2]]], z: [f64; 2]) {
    t.feature_first.push(sources.start);
    t.feature_count.push(sources.end - sources.start);
    t.landmark.push(landmark);
    t.footprint_area_m2.push(100.0 * f64::from(sources.end - sources.start));
    t.height_min.push(z[1] - z[0]);
    t.height_max.push(z[1] - z[0] + 1.5);
    t.negative_space_m2.push(if sources.len() > 1 { 33.25 } else { 0.0 });
    t.base.push(z[0]);
    t.top.push(z[1]);
    rings.iter().for_each(|r| t.plans.push_ring(r));
    if !rings.is_empty() {
        t.plans.end_polygon();
    }
    t.plans.end_shape();
    t.solids.end_shape();
}

fn end(t: &mut TileTree) {
    t.tile_features.push(t.feature_first.len() as u32);
}

fn square(x: i32, y: i32, size: i32) -> [[i32; 2]; 4] {
    [[x, y], [x + size, y], [x + size, y + size], [x, y + size]]
}

/// Plan of building `i` (0..256): in leaf order, quarters of quarters. 10 m wide, 15 m apart.
fn place(i: u32, shift: [i32; 2]) -> [i32; 2] {
    let (mut x, mut y) = (0, 0);
    for bit in 0..4 {
        x |= (i >> (2 * bit) & 1) << bit;
        y |= (i >> (2 * bit + 1) & 1) << bit;
    }
    [x as i32 * 15_000 + shift[0], y as i32 * 15_000 + shift[1]]
}

/// 256 buildings: one with a courtyard, one with a gabled roof of its own; a root, two halves, four leaves.
pub fn town(frame: Frame, shift: [i32; 2]) -> TileTree {
    let mut t = empty(frame);
    let height = |i: u32| 4.0 + f64::from(i * 7 % 11) + if i == 200 { 60.0 } else { 0.0 };
    let block = |t: &mut TileTree, first: u32, count: u32| {
        let ([a, b], side) = (place(first, shift), count.isqrt() as i32 * 15_000 - 5_000);
        // Blocks of half a square are two squares wide.
        let wide = if count.isqrt().pow(2) == count { side } else { (count / 2).isqrt() as i32 * 30_000 - 5_000 };
        let high = if wide == side { side } else { wide / 2 - 2_500 };
        feature(
            t,
            first..first + count,
            false,
            &[&[[a, b], [a + wide, b], [a + wide, b + high], [a, b + high]]],
            [2.5, 12.25],
        );
    };
    let tower = |t: &mut TileTree| {
        let [x, y] = place(200, shift);
        feature(t, 200..201, true, &[&square(x, y, 10_000)], [2.0, 2.0 + height(200)]);
    };
    tile(&mut t, u32::MAX, 60.0, 0..256, false);
    (0..4).for_each(|q| block(&mut t, q * 64, 64));
    tower(&mut t);
    end(&mut t);
    for half in 0..2 {
        tile(&mut t, 0, 20.0, half * 128..(half + 1) * 128, false);
        (0..8).for_each(|q| block(&mut t, half * 128 + q * 16, 16));
        if half == 1 {
            tower(&mut t);
        }
        end(&mut t);
    }
    for quarter in 0..4u32 {
        tile(&mut t, 1 + quarter / 2, 0.0, quarter * 64..(quarter + 1) * 64, true);
        for i in quarter * 64..(quarter + 1) * 64 {
            let [x, y] = place(i, shift);
            let z = [2.0, 2.0 + height(i)];
            match i {
                70 => {
                    let court: Vec<_> = square(x + 3000, y + 3000, 4000).into_iter().rev().collect();
                    feature(&mut t, i..i + 1, false, &[&square(x, y, 10_000), &court], z);
                }
                90 => {
                    feature(&mut t, i..i + 1, false, &[], [2.0, 9.0]);
                    gabled(&mut t, x, y);
                }
                _ => feature(&mut t, i..i + 1, false, &[&square(x, y, 10_000)], z),
            }
        }
        end(&mut t);
    }
    t.ids = (0..256).map(|i| format!("house-{i}")).collect();
    let gap = |i: usize| !i.is_multiple_of(3);
    let column = |name: &str, values, present: &dyn Fn(usize) -> bool| Column {
        name: name.into(),
        values,
        present: (0..256).map(present).collect(),
    };
    t.attributes.columns = vec![
        column(
            "1 kind",
            Values::Text((0..256).map(|i| if gap(i) { ["", "-", "church"][i % 3] } else { "" }).collect()),
            &gap,
        ),
        column("altitude", Values::I32((0..256).map(|i| 5 - i).collect()), &|_| true),
        column("id", Values::U32((0..256).map(|i| if i == 1 { u32::MAX } else { i }).collect()), &gap),
        column("listed", Values::Bool((0..256).map(|i| i % 5 == 1).collect()), &gap),
        column("only here", Values::F64((0..256).map(f64::from).collect()), &|i| i == 17),
        column("roof:shape", Values::Bool((0..256).map(|i| i % 7 == 1).collect()), &|_| true),
    ];
    t.levels = vec![Default::default(); 3];
    t
}

/// Replaces the last feature's empty solid by a house with a ridge.
fn gabled(t: &mut TileTree, x: i32, y: i32) {
    let p = |dx: i32, dy: i32, z: i32| [x + dx, y + dy, z];
    let s = 10_000;
    let (a, b, c, d) = (p(0, 0, 2000), p(s, 0, 2000), p(s, s, 2000), p(0, s, 2000));
    let (e, f, g, h) = (p(0, 0, 6000), p(s, 0, 6000), p(s, s, 6000), p(0, s, 6000));
    let (k, l) = (p(0, s / 2, 9000), p(s, s / 2, 9000));
    t.solids.shapes.pop();
    for (ring, meaning) in [
        (vec![d, c, b, a], buildings::GROUND),
        (vec![a, b, f, e], buildings::WALL),
        (vec![b, c, g, l, f], buildings::WALL),
        (vec![c, d, h, g], buildings::OTHER),
        (vec![d, a, e, k, h], buildings::WALL),
        (vec![e, f, l, k], buildings::ROOF),
        (vec![k, l, g, h], buildings::OTHER),
    ] {
        t.solids.push_ring(&ring);
        t.solids.end_polygon();
        t.semantics.push(meaning);
    }
    t.solids.end_shape();
}

/// A root that is a leaf, with one building.
pub fn one(frame: Frame) -> TileTree {
    let mut t = empty(frame);
    tile(&mut t, u32::MAX, 0.0, 0..1, true);
    feature(&mut t, 0..1, false, &[&square(0, 0, 10_000)], [0.0, 9.0]);
    end(&mut t);
    t.ids = ["only"].into_iter().collect();
    t
}

/// A chain: every tile has a leaf of one building and the rest below it.
pub fn chain(frame: Frame, depth: u32) -> TileTree {
    let mut t = empty(frame);
    let mut parent = u32::MAX;
    for i in 0..depth {
        let me = t.parent.len() as u32;
        tile(&mut t, parent, 1.0, i..depth + 1, false);
        feature(&mut t, i..depth + 1, false, &[&square(0, 0, 10_000)], [0.0, 9.0]);
        end(&mut t);
        tile(&mut t, me, 0.0, i..i + 1, true);
        feature(&mut t, i..i + 1, false, &[&square(0, 0, 10_000)], [0.0, 9.0]);
        end(&mut t);
        parent = me;
    }
    tile(&mut t, parent, 0.0, depth..depth + 1, true);
    feature(&mut t, depth..depth + 1, false, &[&square(0, 0, 10_000)], [0.0, 9.0]);
    end(&mut t);
    t.ids = (0..=depth).map(|i| i.to_string()).collect();
    t
}
