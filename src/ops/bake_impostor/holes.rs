//! What 128 eyes around the mesh have to say of its quads: what sticks out, and which tile closes a hole.
//!
//! In:     the scene, and every tile's pieces.
//! Out:    outlines, and patches for each tile. (1) What lies farther than half a cell outside the mesh's outline on any
//!         picture is not drawn. (2) Quads of neighbouring parts lie up to a reach off the surface, so an eye can see
//!         between their ends. A point is missing that an eye sees of the mesh, more than 2 pixels from its outline, where
//!         no quad draws anything. Of the tiles that draw the point and turn to the eye, the one whose texels have to go
//!         on least goes on, at most two cells, up to where the ray meets its plane, and around there for the eyes that
//!         lie between; where there is none, the tile that the ray meets first shows the point. (3) That is inside every
//!         outline if it can be, else half a cell around; else what (1) took away there comes back.
//! Cost:   O(eyes x (triangles + pixels of triangles and quads) + texels x eyes).
//! Source: ours. The eyes are not those of the report, which so measures what eyes in other places see.
//! Tried:  at 128, silhouette and missing pixels in the report of a Buddha (min-votes 8) and of a car on a folded cloth
//!         (min-votes 2). Without (1), each hole closed by a line for each of 36 eyes: .953, 690 and .964, 329; without
//!         (1), with pictures of 256 pixels and 200 eyes: .953, 378 (128 eyes) and .964, 10; as it is: .978, 4 and .976, 6;
//!         with 200 eyes, which take half as long again: .978, 8 and .978, 0; (1) without the half cell: .967, 24 and
//!         .973, 8; (1) without (3): 3,600 pixels of the cloth. Patches up to four cells wide: .975, 8 and .977, 0, but a
//!         house .966 for .970. Tiles that go on into nothing up to where their planes meet, along every seam: .930. At 32
//!         cells, pictures of 512 pixels instead of eight pixels a cell take up to three times the time: the Buddha .876 and
//!         1,480 (as it is: .896, 2,292), a bunny .922, 34 (.928, 152); a third of a cell instead of a half: .910, 2,958.

use std::cell::LazyCell;

use rayon::prelude::*;

use super::canvas::Window;
use super::eyes::{DepthBuffers, Eyes, LINES, Missing, Outline, Seen, Shown};
use super::pieces::Piece;
use super::planes::Scene;
use crate::geom::space::{Vec3, dot, sub};
use crate::io::views;

/// Cells that a tile's texels go on.
const LONGEST: f64 = 2.0;
/// Cells from its plane within which a tile shows a point that none draws.
const FAR: f64 = 4.0;
/// Quads that turn away more than that close nothing.
const STEEP: f64 = 0.2;
/// Eyes that lie between see through so far around what closes a hole, for each metre from there to the surface; and at
/// most so many cells.
const SPREAD: f64 = 2.0;
const WIDEST: f64 = 1.0;

/// What eyes around the mesh have to say of the quads: what sticks out, and what closes holes.
pub struct Mending {
    outlines: Vec<Outline>,
    of_tile: Vec<Vec<Patch>>,
}

/// Where something may be drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// Inside every outline.
    Inside,
    /// Or no more than half a cell outside.
    Around,
    /// Where it would be without a look at outlines.
    Drawn,
}

impl Mending {
    pub fn none() -> Self {
        Self { outlines: Vec::new(), of_tile: Vec::new() }
    }

    /// Of these pieces.
    pub fn new(scene: &Scene, pieces: &[Piece]) -> Self {
        let views::View { middle, half, .. } = views::cameras(scene.mesh)[0];
        let margin = 0.5 * scene.planes.cell;
        // (1) What eyes see of the mesh.
        let look = |buffers: &mut DepthBuffers, i: usize| {
            Eyes::new(middle, half, scene.planes.cell, i).look(scene, margin, buffers)
        };
        let (outlines, seen): (Vec<Outline>, Vec<[Seen; 2]>) =
            (0..LINES).into_par_iter().map_init(DepthBuffers::new, look).unzip();
        let mut out = Self { outlines, of_tile: vec![Vec::new(); scene.planes.len()] };

        // (2) And of the pieces, without what sticks out.
        let shown: Vec<Shown> = pieces.par_iter().map(|p| Shown::new(p, |w, texels| out.keep(w, texels))).collect();
        let compare = |(outline, seen): (&Outline, [Seen; 2])| outline.eyes.missing(scene, &seen, &shown);
        let missing: Vec<Vec<Missing>> = out.outlines.par_iter().zip(seen).map(compare).collect();

        // (3) What closes the holes.
        let mut of_tile = vec![Vec::new(); scene.planes.len()];
        shown.iter().for_each(|s| of_tile[s.piece.tile].push(s));
        let close = |missing: &Missing| patch(scene, missing, &of_tile, |p, limit| out.is_within(p, limit));
        let found: Vec<(usize, Patch)> = missing.par_iter().flatten().filter_map(close).collect();
        found.into_iter().for_each(|(k, patch)| out.of_tile[k].push(patch));
        out
    }

    /// What closes holes, of a tile.
    pub fn patches(&self, tile: usize) -> &[Patch] {
        self.of_tile.get(tile).map_or(&[], Vec::as_slice)
    }

    /// Of a window's texels those that stick out for no eye.
    pub fn keep(&self, window: &Window, texels: &mut Vec<u32>) {
        self.outlines.iter().for_each(|o| o.keep(window, true, texels));
    }

    /// Whether nothing is known yet.
    pub fn is_none(&self) -> bool {
        self.outlines.is_empty()
    }

    /// Whether what is drawn there sticks out for no eye.
    pub fn is_within(&self, p: Vec3, limit: Limit) -> bool {
        self.outlines.iter().all(|o| o.has(p, limit == Limit::Around))
    }
}

/// A tile's texels go on along a line of its plane.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    pub from: Vec3,
    pub to: Vec3,
    /// So far around its end, and ever less towards its start, eyes nearby see through as well.
    pub spread: f64,
    pub limit: Limit,
    /// Linear.
    pub light: [f32; 3],
    /// On the side that the tile shows.
    pub normal: Vec3,
    pub two_sided: bool,
}

/// Pixels of all eyes where something is missing.
#[cfg(test)]
pub fn missing(scene: &Scene, pieces: &[Piece]) -> usize {
    let views::View { middle, half, .. } = views::cameras(scene.mesh)[0];
    let shown: Vec<Shown> = pieces.iter().map(|p| Shown::new(p, |_, _| ())).collect();
    let of_line = |i: usize| {
        let (outline, seen) = Eyes::new(middle, half, scene.planes.cell, i).look(scene, 0.0, &mut DepthBuffers::new());
        outline.eyes.missing(scene, &seen, &shown).len()
    };
    (0..LINES).map(of_line).sum()
}

/// What closes the hole at a place that the eye should see.
fn patch(
    scene: &Scene,
    hit: &Missing,
    of_tile: &[Vec<&Shown>],
    is_within: impl Fn(Vec3, Limit) -> bool,
) -> Option<(usize, Patch)> {
    let (planes, t) = (scene.planes, hit.triangle);
    let corners = scene.mesh.corners(t);
    let p = [0, 1, 2].map(|k| (0..3).map(|c| hit.weights[c] * corners[c][k]).sum::<f64>());
    let (smooth, two_sided) = (scene.paint.normal(t, hit.weights), scene.paint.material(t).double_sided);
    // Too small to have a direction.
    if smooth == [0.0; 3] {
        return None;
    }
    // (1) Every tile that turns to the surface and to the eye: how far it is, and where the eye's ray meets it; inside
    //     the outline that every eye sees.
    let meets = |k: usize| {
        let (normal, off) = (planes.normal(k), planes.above(k, p));
        let (facing, shown) = (dot(normal, smooth), dot(normal, hit.eye));
        let turned = shown.abs() >= STEEP && (two_sided || facing > 0.0 && shown > 0.0);
        let to = [0, 1, 2].map(|c| p[c] - off / shown * hit.eye[c]);
        (turned && off.abs() <= FAR * planes.cell).then_some((off, to, facing, shown))
    };
    let length = |v: Vec3| dot(v, v).sqrt();

    // (2) Of those that draw it, the one that has to go on least.
    let goes_on = |k: usize| {
        let (off, to, facing, shown) = meets(k)?;
        let from = [0, 1, 2].map(|c| p[c] - off * planes.normal(k)[c]);
        let draws = |s: &&&Shown| (shown > 0.0 || s.two_sided) && s.draws(from);
        let beside = length(sub(to, from));
        let can = off.abs() <= planes.reach && beside <= LONGEST * planes.cell && of_tile[k].iter().any(|s| draws(&s));
        can.then_some((beside, k, from, to, facing))
    };
    let reached = || scene.reached.tiles(t).iter().map(|&k| k as usize);
    // (3) Where none draws it, the one that the ray meets first.
    let is_met = |k: usize| {
        let (_, to, facing, _) = meets(k)?;
        Some((length(sub(to, p)), k, to, to, facing))
    };
    type Found = (f64, usize, Vec3, Vec3, f64);
    let least = |a: &Found, b: &Found| a.0.total_cmp(&b.0);
    // Few are asked of every eye: the first that all let pass is taken.
    let sorted = |mut all: Vec<Found>| {
        all.sort_by(least);
        all
    };
    let drawing = sorted(reached().filter_map(goes_on).collect());
    let met = LazyCell::new(|| sorted((0..planes.len()).filter_map(is_met).collect()));
    let within = |limit: Limit| {
        let passes = |found: &&Found| is_within(found.3, limit);
        drawing.iter().find(passes).or_else(|| met.iter().find(passes)).copied()
    };
    // (4) Or what was drawn there, though it sticks out.
    let was_drawn = |k: usize| {
        let (_, to, facing, shown) = meets(k)?;
        let drew = |s: &&&Shown| (shown > 0.0 || s.two_sided) && s.piece.draws(to);
        of_tile[k].iter().any(|s| drew(&s)).then_some((length(sub(to, p)), k, to, to, facing))
    };
    let (limit, (_, k, from, to, facing)) =
        [Limit::Inside, Limit::Around, Limit::Drawn].into_iter().find_map(|limit| {
            let found = match limit {
                Limit::Drawn => reached().filter_map(was_drawn).min_by(least),
                _ => within(limit),
            };
            Some((limit, found?))
        })?;
    let wide = (SPREAD * length(sub(to, p))).min(WIDEST * planes.cell);
    let spread = if limit == Limit::Around { 0.0 } else { wide };
    let normal = if facing < 0.0 { smooth.map(|c| -c) } else { smooth };
    let light = scene.paint.at(t, hit.weights, hit.level).unwrap_or_default();
    Some((k, Patch { from, to, spread, limit, light, normal, two_sided }))
}
